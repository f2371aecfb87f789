"""Causes from the kinematics to the recording that formats.md lists."""

import numpy as np
from numpy.typing import NDArray

from tools.family_two import ranges
from tools.family_two.camera import Scene
from tools.family_two.causes.base import Cause, IntArray, side
from tools.family_two.timeline import Part, Timeline

FloatArray = NDArray[np.float64]


def direction(rng: np.random.Generator) -> FloatArray:
    some = rng.normal(size=3)
    return np.asarray(some / np.linalg.norm(some))


class Curvature(Cause):
    id = "kinematics.nonconstant_curvature"
    says = "the section bends more near its base or near its tip"
    limits = ranges.CURVATURE
    needs_camera = sections = moves = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        sign = float(self.rng.choice([-1.0, 1.0]))
        scene.uneven = scene.uneven + sign * min(self.size, 0.95) * line.at(self.on(line), t)


class Static(Cause):
    id = "registration.static"
    says = "the camera was put back elsewhere"
    limits = ranges.REGISTRATION
    needs_camera = moves = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        on = line.at(self.on(line), t)[:, None]
        scene.turn = scene.turn + on * self.size * direction(rng)
        scene.shift = scene.shift + on * self.size * 0.1 * direction(rng)


class Leaning(Cause):
    id = "registration.direction_dependent"
    says = "the instrument leans in its holder or channel to the side that the cable drags it"
    limits = ranges.CHANNEL_PLAY
    needs_camera = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        leans = line.at(side(c, line.width * line.gain * float(rng.uniform(0.2, 0.6))) * self.on(line), t)[:, None]
        axis = np.array([0.5 * rng.normal(), float(rng.choice([-1.0, 1.0])), 0.3 * rng.normal()])
        scene.turn = scene.turn + leans * self.size * axis / np.linalg.norm(axis)


class Knock(Cause):
    id = "registration.shift"
    says = "camera or base is knocked once during a test"
    limits = ranges.REGISTRATION
    needs_camera, may_start = True, False

    def when(self, line: Timeline) -> float:
        rng = self.rng
        tests = [p for p in line.parts if p.tested]
        part = tests[int(rng.integers(len(tests)))]
        return float(rng.choice(part.exposed[part.exposed.size // 5 : 4 * part.exposed.size // 5]))

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {"at_s": self.when(line)}

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = np.random.default_rng([self.seed, 1])
        on = (t >= self.when(line)).astype(float)[:, None]
        scene.turn = scene.turn + on * self.size * direction(rng)
        scene.shift = scene.shift + on * self.size * 0.1 * direction(rng)


class Distortion(Cause):
    id = "camera.distortion"
    says = "a lens that the rig does not hold"
    limits = ranges.DISTORTION
    needs_camera = moves = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        sign = float(self.rng.choice([-1.0, -1.0, 1.0]))
        k = np.array([sign, -0.2 * sign]) * self.size
        scene.lens = scene.lens + line.at(self.on(line), t)[:, None] * k


class Delay(Cause):
    id = "acquisition.delay"
    says = "frames arrive later than the rig says"
    limits = ranges.DELAY
    moves = True

    def late(self, line: Timeline, t: FloatArray, arrival: FloatArray) -> FloatArray:
        sign = float(self.rng.choice([-0.25, 1.0]))
        return self.size * sign * line.at(self.on(line), t)


class Jitter(Cause):
    id = "acquisition.jitter"
    says = "a busy host: stamps late by gamma-distributed waits, in queues"
    limits = ranges.JITTER

    def late(self, line: Timeline, t: FloatArray, arrival: FloatArray) -> FloatArray:
        rng = np.random.default_rng([self.seed, int(t[0] * 1000)])
        shape = 1.5
        waits = rng.gamma(shape, self.size / np.sqrt(shape), t.size) * line.at(self.on(line), t)
        # a frame is not stamped before the one ahead of it
        least = 2e-4 * np.arange(t.size)
        stamped = np.maximum.accumulate(arrival + waits - least) + least
        return np.asarray(stamped - arrival)


class Clock(Cause):
    id = "acquisition.clock_rate"
    says = "the camera stamps by another clock, set right when a recording starts"
    limits = ranges.CLOCK

    def late(self, line: Timeline, t: FloatArray, arrival: FloatArray) -> FloatArray:
        sign = float(self.rng.choice([-1.0, 1.0]))
        return np.asarray(self.size * sign * (t - t[0]) * line.at(self.on(line), t))


class Held(Cause):
    id = "acquisition.held_samples"
    says = "a frame's value is handed out again"
    limits = ranges.HELD

    def pick(self, line: Timeline, part: Part, count: int) -> IntArray:
        rng = np.random.default_rng([self.seed, part.first])
        again = (rng.random(count) < min(self.size, 0.6)) & (line.at(self.on(line), part.exposed) > 0)
        again[0] = False
        return np.maximum.accumulate(np.where(again, 0, np.arange(count)))


SEEING: tuple[type[Cause], ...] = (
    Curvature, Static, Leaning, Knock, Distortion, Delay, Jitter, Clock, Held,
)  # fmt: skip
