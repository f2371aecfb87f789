"""Causes that no list holds."""

import numpy as np

from tools.family_six import ranges
from tools.family_six.causes.base import (
    STEP,
    Ask,
    Cause,
    FloatArray,
    Line,
    Mechanism,
    Part,
    Picks,
    Scene,
    View,
    axis,
    follow,
    gates,
    play,
    rising,
    swings,
)
from tools.family_three import camera


class HuntingServo(Cause):
    id, limits = "hunting_servo", ranges.HUNTS
    says = "at rest the motor swings about its set-point, which the log shows"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        rest = follow((np.abs(line.speed) < 0.04 * line.usual_speed).astype(float), 0.15)
        wave = np.abs(np.mod(line.t / float(rng.uniform(0.7, 2.0)), 1.0) - 0.5) * 4 - 1
        a.q = a.q + self.on(line) * self.size * line.width * rest * wave


class HuntingTensioner(Cause):
    id, limits = "hunting_tensioner", ranges.TENSIONER
    says = "an automatic tensioner hunts: friction swells and falls in a slow beat"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        period, phase = float(rng.uniform(4.0, 15.0)), float(rng.uniform(0.0, 6.0))
        a.rub = a.rub * (1 + self.on(line) * self.size * np.sin(2 * np.pi * line.t / period + phase))


class ServoOvershoot(Cause):
    id, limits = "servo_overshoot", ranges.RINGS
    says = "the drive's loop runs past and rings; the log is of the command"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        rung = swings(a.q, float(rng.uniform(1.2, 4.0)), float(rng.uniform(0.2, 0.45)))
        a.q = a.q + self.on(line) * self.size * (rung - a.q)


class LightCable(Cause):
    id, limits = "light_cable", ranges.LEADS
    says = "a light guide or drape dragged along: its pull saturates after a good part of the range"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        far = float(self.rng().uniform(0.15, 0.5)) * line.reach
        pull = (line.q - play(line.q - far, line.q + far, 0.0)) / far
        a.push = a.push + self.on(line) * self.size * 2 * m.f * pull


class SuperelasticLoop(Cause):
    id, limits = "superelastic_loop", ranges.PLATEAU
    says = "far out the alloy transforms under a larger torque than it comes back under"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        begins, long = float(rng.uniform(0.1, 0.4)) * line.reach, float(rng.uniform(0.1, 0.3)) * line.reach
        out = np.maximum(np.abs(line.q) - begins, 0.0)
        stressed = (out - play(np.maximum(out - long, 0.0), out, 0.0)) / long
        a.push = a.push + self.on(line) * self.size * 2 * m.f * stressed * np.sign(line.q)


class SuctionHold(Cause):
    id, limits = "suction_hold", ranges.SUCKS
    says = "suction holds the tip to tissue now and then, which gives"

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        on = gates(self.rng(), line.t, (2.0, 6.0), (2.0, 7.0)) > 0.5
        begins = np.flatnonzero(on & ~np.roll(on, 1))
        which = np.searchsorted(begins, np.arange(c.size), side="right") - 1
        at = np.where(which >= 0, c[begins[np.maximum(which, 0)]], c) if begins.size else c
        return c + self.on(line) * self.size * follow(np.where(on, at - c, 0.0), 0.05)


class StrokeRatchet(Cause):
    id, limits = "stroke_ratchet", ranges.RATCHETS
    says = "each stroke leaves a little set behind, less and less"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        strokes = np.cumsum(np.abs(line.speed) * self.on(line)) * STEP / (2 * line.reach)
        grown = strokes / 10 / (1 + strokes / 40)
        a.q = a.q + self.sign() * self.size * line.width * grown


class SparseLog(Cause):
    id, limits = "sparse_log", ranges.SPARSE
    says = "the log was kept at a low rate and joined by straight lines"

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        kept = np.arange(float(self.rng().random()) * self.size, line.t[-1], self.size)
        return q + self.on(line) * (np.interp(line.t, kept, np.interp(kept, line.t, q)) - q)


class CountedRows(Cause):
    id, limits = "counted_rows", ranges.COUNTED
    says = "rows are stamped by their number and some are lost: the log runs ahead until it is set right"

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        rng = self.rng()
        period, phase = float(rng.uniform(4.0, 12.0)), float(rng.random())
        ahead = self.size * np.mod(line.t / period + phase, 1.0)
        return q + self.on(line) * (np.interp(line.t + ahead, line.t, q) - q)


class WindowHops(Cause):
    id, limits = "window_hops", ranges.WINDOW
    says = "a tracker's window hops after the marker in the sensor's steps, and its corner is believed to be unrounded"
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        out, room, corner = seen.copy(), float(self.rng().uniform(10.0, 50.0)), seen[0]
        for k in range(seen.shape[0]):
            if np.max(np.abs(seen[k] - corner)) > room:
                corner = seen[k]
            out[k] += np.mod(corner, self.size) - 0.5 * self.size
        return out if self.there(line, part) else seen


class InnovationGate(Cause):
    id, limits = "innovation_gate", ranges.GATE
    says = "the tracker refuses what moves faster than it expects and repeats itself, some frames at most"

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part) or pick.size < 2:
            return pick
        steps = np.linalg.norm(np.diff(values, axis=0), axis=1)
        most, patience = (1.02 - self.size) * float(steps.max()), int(self.rng().integers(3, 8))
        out, last, refused = pick.copy(), 0, 0
        for k in range(1, pick.size):
            if np.linalg.norm(values[k] - values[last]) > most and refused < patience:
                refused += 1
            else:
                last, refused = k, 0
            out[k] = pick[last]
        return out


class OtherEye(Cause):
    id, limits, needs_camera = "other_eye", ranges.EYES, True
    says = "the recorder of a stereo endoscope takes the other eye's picture for moments"

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        rng = self.rng()
        other = line.at(gates(rng, line.t, (0.3, 2.0), (2.0, 8.0)), times) * self.gate(line, times)
        return np.asarray(seen + other[:, None] * self.size * np.array([self.sign(), float(rng.uniform(-0.1, 0.1))]))


class PanningAssistant(Cause):
    id, limits, needs_camera = "panning_assistant", ranges.PANS, True
    says = "somebody turns the camera slowly after the marker"

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        late, turned = float(self.rng().uniform(1.0, 4.0)), np.zeros(2)
        out, shares = seen.copy(), -np.expm1(-np.diff(times, prepend=times[0]) / late)
        middle = camera.picture(view, np.zeros(1), Scene.still(1))[0]
        for k, share in enumerate(shares.tolist()):
            turned = turned + share * (seen[k] - middle - turned)
            out[k] -= self.size * turned
        return out if self.there(line, part) else seen


class FoggingLens(Cause):
    id, limits, needs_camera = "fogging_lens", ranges.FOGS, True
    says = "the window fogs from one side, which draws the marker's centre off, until it is wiped"

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        rng = self.rng()
        period, phase, way = float(rng.uniform(8.0, 25.0)), float(rng.random()), float(rng.uniform(0, 6.28))
        fog = np.mod(times / period + phase, 1.0) ** 1.5 * self.gate(line, times)
        return np.asarray(seen + self.size * fog[:, None] * np.array([np.cos(way), np.sin(way)]))


class NtpSlew(Cause):
    id, limits = "ntp_slew", ranges.SLEWS
    says = "the camera's clock wanders off and is slewed back, again and again"

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        rng = self.rng()
        period, share, phase = float(rng.uniform(12.0, 35.0)), float(rng.uniform(0.5, 0.85)), float(rng.random())
        off = np.interp(np.mod(arrival / period + phase, 1.0), [0.0, share, 1.0], [-0.5, 0.5, -0.5])
        return rising(arrival + self.sign() * self.size * off * self.there(line, part))


class YieldingPort(Cause):
    id, limits, needs_camera = "yielding_port", ranges.YIELDS, True
    says = "the wall in which the instrument sits yields to its pull within seconds, and comes back as slowly"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng = self.rng()
        pull = follow(line.q / line.reach, float(rng.uniform(1.0, 5.0)))
        scene.tilt += (self.gate(line, times) * line.at(pull, times) * self.size)[:, None] * axis(rng)


class LabelSwitch(Cause):
    id, limits, needs_camera = "label_switch", ranges.LABELS, True
    says = "a square marker's corners change names as it turns past some place, back a little later"

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        rng = self.rng()
        place = float(rng.uniform(-0.5, 0.5)) * line.gain * line.reach + np.array([-3.0, 3.0])  # deg
        here, there = camera.picture(view, place, Scene.still(2))
        slack, on, named = float(rng.uniform(0.1, 0.5)), np.zeros(times.size), 0.0
        along = (seen - here) @ (there - here) / float((there - here) @ (there - here)) - 0.5
        for k, s in enumerate(along.tolist()):
            named = 1.0 if s > slack else 0.0 if s < -slack else named
            on[k] = named
        way = float(rng.uniform(0, 6.28))
        off = self.size * np.array([np.cos(way), np.sin(way)])
        return np.asarray(seen + (on * self.gate(line, times))[:, None] * off)


class BeatingCapture(Cause):
    id, limits = "beating_capture", ranges.TEARS
    says = "pictures are taken off a display of another rate: older by more and more, then fresh again"

    def later(self, line: Line, part: Part, times: FloatArray, c: FloatArray) -> FloatArray:
        rng = self.rng()
        period, phase = float(rng.uniform(1.5, 8.0)), float(rng.random())
        frame = float(np.median(np.diff(times)))
        return np.asarray(-self.gate(line, times) * self.size * frame * np.mod(times / period + phase, 1.0))


EVERY = (
    HuntingServo, HuntingTensioner, ServoOvershoot, LightCable, SuperelasticLoop, SuctionHold, StrokeRatchet,
    SparseLog, CountedRows, WindowHops, InnovationGate, OtherEye, PanningAssistant, FoggingLens, NtpSlew, YieldingPort,
    LabelSwitch, BeatingCapture,
)  # fmt: skip
