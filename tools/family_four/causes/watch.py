"""Effects of formats.md from the section to the frames' stamps."""

import numpy as np

from tools.family import ranges
from tools.family_four.causes.base import Cause, FloatArray, Line, Part, axis, rising, side
from tools.family_three.camera import Scene
from tools.family_three.causes.base import Picks


class NonconstantCurvature(Cause):
    id = "kinematics.nonconstant_curvature"
    says = "curvature that grows or falls along the section"
    limits = ranges.CURVATURE
    moves = needs_camera = sections = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            scene.uneven = scene.uneven + self.size * (1.0 if self.seed % 2 else -1.0)


class Static(Cause):
    id = "registration.static"
    says = "the camera was put back elsewhere"
    limits = ranges.REGISTRATION
    moves = needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            scene.tilt = scene.tilt + self.size * axis(rng)
            scene.shift = scene.shift + 0.1 * self.size * axis(rng)


class DirectionDependent(Cause):
    id = "registration.direction_dependent"
    says = "the instrument leans to one side of its channel by the way it moves"
    limits = ranges.CHANNEL_PLAY
    needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            over = float(rng.uniform(0.02, 0.15)) * line.gain * line.reach
            leaning = 0.5 * self.size * side(c, over)[:, None]
            scene.tilt, scene.shift = scene.tilt + leaning * axis(rng), scene.shift + 0.05 * leaning * axis(rng)


class Shift(Cause):
    id = "registration.shift"
    says = "a knock in the middle of a test"
    limits = ranges.REGISTRATION
    needs_camera = True
    may_start = False

    def at(self, line: Line) -> float:
        rng = self.rng()
        tests = [p for p in line.parts if p.tested]
        part = tests[int(rng.integers(len(tests)))]
        return float(part.exposed[int(rng.uniform(0.3, 0.7) * part.exposed.size)])

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng = np.random.default_rng(self.seed)
        after = self.size * (times >= self.at(line))[:, None]
        scene.tilt, scene.shift = scene.tilt + after * axis(rng), scene.shift + 0.1 * after * axis(rng)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"t_s": self.at(line)}


class Distortion(Cause):
    id = "camera.distortion"
    says = "k1 and k2 that the rig does not hold"
    limits = ranges.DISTORTION
    moves = needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            k1 = self.size * float(rng.choice([-1.0, 1.0], p=[0.8, 0.2]))
            scene.lens = scene.lens + np.array([k1, -0.25 * k1 * rng.uniform(0, 1), 0.0, 0.0, 0.0])


class Delay(Cause):
    id = "acquisition.delay"
    says = "frames come later than the rig says"
    limits = ranges.DELAY
    moves = True

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        return arrival + self.size * self.there(line, part)


class Jitter(Cause):
    id = "acquisition.jitter"
    says = "waits that are exponential in two stages"
    limits = ranges.JITTER

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        if not self.there(line, part):
            return arrival
        rng = np.random.default_rng([self.seed, part.first])
        return rising(arrival + rng.gamma(2.0, self.size / np.sqrt(2), arrival.size))


class ClockRate(Cause):
    id = "acquisition.clock_rate"
    says = "the camera's clock runs fast or slow, set right when a recording begins"
    limits = ranges.CLOCK

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        rate = self.size * (1.0 if self.seed % 2 else -1.0)
        return arrival + rate * (arrival - part.begin) * self.there(line, part)


class HeldSamples(Cause):
    id = "acquisition.held_samples"
    says = "a value is handed out again, mostly once, at times more often"
    limits = ranges.HELD

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        again = np.random.default_rng([self.seed, part.first]).random(pick.size) < self.size
        again[0] = False
        return np.asarray(pick[np.maximum.accumulate(np.where(again, 0, np.arange(pick.size)))])
