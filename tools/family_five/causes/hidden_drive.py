"""What no list holds: drives, cables, tissue, logs."""

import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.signal import butter, sosfiltfilt

from tools.family_five import ranges
from tools.family_five.causes.base import STEP, Ask, Cause, FloatArray, Line, Mechanism, events, follow, moving, pulses


class Hidden(Cause):
    unlisted = True


class SpeedSaturation(Hidden):
    id = "speed_saturation"
    says = "the drive cannot keep up with fast moves; the log is of the command"
    limits = ranges.LIMITED

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        most = (1 - self.size) * float(np.max(np.abs(line.speed))) * STEP
        out, here = a.q.copy(), float(a.q[0])
        for k, (q, on) in enumerate(zip(a.q.tolist(), self.on(line).tolist(), strict=True)):
            here = min(max(q, here - most), here + most) if on else q
            out[k] = here
        a.q = out


class DriveDropout(Hidden):
    id = "drive_dropout"
    says = "now and then the drive loses power for a moment, and the spring turns it a part of the way back"
    limits = ranges.FREEWHEELS

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        times = events(rng, line, self.on(line), (5.0, 14.0))
        t, out = np.arange(0.0, 2.5, STEP), float(rng.uniform(0.2, 1.5))
        gone = (1 - np.exp(-np.minimum(t, out) / 0.15)) * np.exp(-np.maximum(t - out, 0.0) / 0.06)
        a.q = a.q * (1 - self.size * pulses(line, times, np.ones(len(times)), gone))


class HiddenCompensation(Hidden):
    id = "hidden_compensation"
    says = "somebody left the controller's backlash compensation on: each turn is taken up over a ramp, outside the log"
    limits = ranges.TAKE_UP

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        ramp = float(self.rng().uniform(0.4, 1.5))
        speed = np.where(np.abs(line.speed) > 1e-3 * line.usual_speed, line.speed, 0.0)
        last = np.maximum.accumulate(np.where(speed != 0, np.arange(speed.size), 0))
        n = round(ramp / STEP)
        way = np.cumsum(np.concatenate([np.zeros(n), np.sign(speed[last])]))
        a.q = a.q + 0.5 * self.size * line.width * self.on(line) * (way[n:] - way[:-n]) / n


class EchoingShaper(Hidden):
    id = "echoing_shaper"
    says = "an input shaper sends a part of every move half a period later; the log is of what it was sent"
    limits = ranges.ECHO

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        later = line.at(a.q, line.t - float(self.rng().uniform(0.1, 0.5)))
        a.q = a.q + self.size * self.on(line) * (later - a.q)


class PayneSoftening(Hidden):
    id = "payne_softening"
    says = "a rubber part gives more the larger the last seconds' motion was"
    limits = ranges.SOFTENS

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        grown = line.t / float(self.rng().uniform(3.0, 10.0))
        swung = np.abs(c - follow(c, 3.0)) / (line.gain * line.reach)
        lately = np.maximum.accumulate(swung * np.exp(grown)) * np.exp(-grown)
        return np.asarray(c * (1 - self.size * self.on(line) * (lately / (lately + 0.4) - 0.5)))


class StarvedStrokes(Hidden):
    id = "starved_strokes"
    says = "short strokes do not draw grease into what rubs: friction is higher after them"
    limits = ranges.STARVES

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        way = np.sign(np.where(np.abs(line.speed) > 1e-3 * line.usual_speed, line.speed, 0.0))
        last = np.maximum.accumulate(np.where(way != 0, np.arange(way.size), 0))
        turns = np.concatenate([[0], np.flatnonzero(np.diff(way[last])) + 1])
        stroke = np.searchsorted(turns, np.arange(way.size), side="right") - 1
        long = np.concatenate([[2 * line.reach], np.abs(np.diff(line.q[turns]))])
        drawn = np.maximum(long[stroke], np.abs(line.q - line.q[turns][stroke]))
        a.rub = a.rub * (1 + self.size * self.on(line) * np.exp(-drawn / (0.35 * line.reach)))


class Draught(Hidden):
    id = "draught"
    says = "moving air or liquid pushes at the tip"
    limits = ranges.BLOWS

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        band = butter(2, [0.1, float(rng.uniform(0.4, 1.0))], "bandpass", fs=1 / STEP, output="sos")
        blown = sosfiltfilt(band, rng.normal(size=line.t.size))
        a.pull = a.pull + self.size * self.on(line) * np.clip(blown / np.std(blown), -2.0, 2.0)


class Coughs(Hidden):
    id = "coughs"
    says = "the patient coughs, two or three times in a row: the tip is pushed aside"
    limits = ranges.COUGHS

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        times = events(rng, line, self.on(line), (4.0, 12.0))
        t = np.arange(0.0, 2.0, STEP)
        one = t / 0.09 * np.exp(1 - t / 0.09)
        row = sum(s * np.interp(t - after, t, one, left=0.0) for after, s in ((0.0, 1.0), (0.4, 0.7), (0.75, 0.35)))
        sizes = float(rng.choice([-1, 1])) * rng.uniform(0.5, 1.0, len(times))
        return np.asarray(c + self.size * pulses(line, times, sizes, np.asarray(row)))


class PlannerLead(Hidden):
    id = "planner_lead"
    says = "the log is of a planner's queue: ahead of the motor while it moves, by more the longer it has moved"
    limits = ranges.AHEAD

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        filled = follow(moving(line), float(self.rng().uniform(1.0, 4.0)))
        return line.at(q, line.t + self.size * self.on(line) * filled)


class FlippedBits(Hidden):
    id = "flipped_bits"
    says = "one bit of the log's word is read wrong for some words"
    limits = ranges.WRONG_BITS

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        rng = self.rng()
        times = events(rng, line, self.on(line), (0.2, float(rng.uniform(1.5, 4.0))))
        wrong = pulses(line, times, np.ones(len(times)), np.ones(int(rng.integers(5, 20)))) > 0
        bit = 2 * self.size * line.reach
        odd = np.floor((q + line.reach) / bit) % 2 == 1
        return np.where(wrong, np.clip(q + np.where(odd, -bit, bit), -0.999 * line.reach, 0.999 * line.reach), q)


class ZeroPhaseLog(Hidden):
    id = "zero_phase_log"
    says = "somebody smoothed the log afterwards, forth and back: its corners are round on both sides"
    limits = ranges.WITHOUT_PHASE

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        smooth = gaussian_filter1d(q, self.size / STEP, mode="nearest")
        return np.where(self.on(line) > 0, smooth, q)


DRIVE = (
    SpeedSaturation, DriveDropout, HiddenCompensation, EchoingShaper, PayneSoftening, StarvedStrokes, Draught, Coughs,
    PlannerLead, FlippedBits, ZeroPhaseLog,
)  # fmt: skip
