"""Causes that no list holds, from the motor's log to the section."""

import numpy as np

from tools.family_four import ranges
from tools.family_four.causes.base import STEP, Cause, FloatArray, Line, Part, follow, gates, play, side
from tools.family_four.causes.drive import STROKES
from tools.family_four.mechanism import Demand, Mechanism
from tools.family_three.camera import Scene


class Hidden(Cause):
    unlisted = True


class VibrationBursts(Hidden):
    id = "vibration_bursts"
    says = "a drill or suction shakes the instrument for seconds and frees it of a part of its friction"
    limits = ranges.FREED

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        shaken = follow(gates(self.rng(), line.t, (2.0, 6.0), (3.0, 9.0)), 0.06)
        d.rub = d.rub * (1 - min(self.size, 0.98) * shaken * self.on(line))


class HeartBeat(Hidden):
    id = "heart_beat"
    says = "tissue that beats against the tip: a quick rise, a slower fall, then rest"
    limits = ranges.HEART

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        rate = float(rng.uniform(0.9, 1.7))
        phase = np.mod(line.t * rate + 0.1 * np.sin(2 * np.pi * line.t * 0.25), 1.0)  # breathing varies it
        pulse = (phase / 0.12) ** 2 * np.exp(2 * (1 - phase / 0.12))
        return np.asarray(c + float(rng.choice([-1.0, 1.0])) * self.size * pulse * self.on(line))


class BentChannel(Hidden):
    id = "bent_channel"
    says = "another joint bends the channel: friction grows as it leaves its middle"
    limits = ranges.PRESSED
    needs_column = "wrist_deg"

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        bent = np.abs(line.sides["wrist_deg"]) / STROKES["wrist_deg"]
        d.rub = d.rub * (1 + self.size * bent * self.on(line))


class StickyTissue(Hidden):
    id = "sticky_tissue"
    says = "the tip touches tissue without force, and is held by it on the way back until it tears off"
    limits = ranges.ADHERES

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        way = float(rng.choice([-1.0, 1.0]))
        at, held = float(rng.uniform(-0.2, 0.4)) * line.gain * line.reach, 0.85
        out, stuck = [], False
        for x, on in zip((way * c).tolist(), self.on(line).tolist(), strict=True):
            stuck = bool(on) and (x > at or (stuck and at - x < self.size))
            out.append(at - (1 - held) * (at - x) if stuck and x < at else x)
        return way * np.array(out)


class SlippingClutch(Hidden):
    id = "slipping_clutch"
    says = "beyond a torque a clutch slips: a part of the way outwards is lost, to both sides"
    limits = ranges.SLIPS

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        least = float(self.rng().uniform(0.3, 0.6)) * line.reach
        step = np.diff(line.q, prepend=line.q[0])
        outwards = (np.abs(line.q) > least) & (step * line.q > 0)
        d.q = d.q - np.cumsum(self.on(line) * outwards * self.size * step)


class RollFlip(Hidden):
    id = "roll_flip"
    says = "far out the section rolls over by some degrees, and back only when it is far in again"
    limits = ranges.SNAPS
    needs_camera = sections = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if not self.there(line, part):
            return
        rng = self.rng()
        way, out, back = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.25, 0.5)), float(rng.uniform(-0.3, 0.0))
        u = way * c / (line.gain * line.reach)
        last = np.maximum.accumulate(np.where((u > out) | (u < back), np.arange(c.size), 0))
        scene.rotation = scene.rotation + self.size * (u[last] > out)


class AxialSquash(Hidden):
    id = "axial_squash"
    says = "the backbone shortens under the cable's pull, more while pulled than while let go"
    limits = ranges.SHORTENS
    needs_camera = sections = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rub = float(self.rng().uniform(0.3, 0.8))
            pull = 0.5 * c / (line.gain * line.reach) + 0.5 * rub * side(c, 0.5 * line.width * line.gain)
            scene.along = scene.along - self.size * pull


class PlaneTwist(Hidden):
    id = "plane_twist"
    says = "the plane of bending turns as the section bends, more one way than the other"
    limits = ranges.TWISTS
    needs_camera = sections = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            u = c / (line.gain * line.reach)
            scene.rotation = scene.rotation + self.size * (u + float(rng.uniform(0.3, 0.9)) * u * u)


class RotationPlay(Hidden):
    id = "rotation_play"
    says = "the instrument's rotation follows its log through a gap"
    limits = ranges.ROLL_PLAY
    needs_camera = True
    needs_column = "rotation_deg"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            asked = line.sides["rotation_deg"]
            turned = play(asked - self.size / 2, asked + self.size / 2, float(asked[0]))
            scene.rotation = scene.rotation + line.at(turned - asked, times)


class RollerSlip(Hidden):
    id = "roller_slip"
    says = "rollers that feed the instrument slip: it goes less far in than logged, and less far back by another share"
    limits = ranges.FEED
    needs_camera = True
    needs_column = "translation_mm"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            back = float(self.rng().uniform(0.3, 0.8))
            step = np.diff(line.sides["translation_mm"], prepend=0.0) * self.on(line)
            lost = np.cumsum(self.size * step * np.where(step > 0, 1.0, back))
            scene.along = scene.along - line.at(lost, times)


class AveragedLog(Hidden):
    id = "averaged_log"
    says = "the drive reports the mean of its position over a time"
    limits = ranges.AVERAGED

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        n = max(round(self.size / STEP), 1)
        total = np.cumsum(np.concatenate([np.full(n, q[0]), q]))
        return np.where(self.on(line) > 0, (total[n:] - total[:-n]) / n, q)


class CoarseTicks(Hidden):
    id = "coarse_ticks"
    says = "the log repeats the value of the last tick of a slow timer"
    limits = ranges.TICK

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        n = max(round(self.size / STEP), 1)
        held = q[(np.arange(q.size) - int(self.rng().integers(n))).clip(0) // n * n]
        return np.where(self.on(line) > 0, held, q)


DRIVE = (
    VibrationBursts, HeartBeat, BentChannel, StickyTissue, SlippingClutch, RollFlip, AxialSquash, PlaneTwist,
    RotationPlay, RollerSlip, AveragedLog, CoarseTicks,
)  # fmt: skip
