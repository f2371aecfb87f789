"""Effects of formats.md that act on what is seen: kinematics, registration, camera, acquisition."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tools.family import ranges
from tools.family_three.causes.base import Cause, Picks, axis, rising, side, tested
from tools.family_three.line import Line, Part

if TYPE_CHECKING:
    from tools.family_three.camera import Scene

FloatArray = NDArray[np.float64]
Said = dict[str, float | str]


class NonconstantCurvature(Cause):
    id, says = "kinematics.nonconstant_curvature", "the section bends more near its base or near its tip"
    limits = ranges.CURVATURE
    moves = needs_camera = sections = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        sign = float(self.rng().choice([-1.0, 1.0]))
        scene.uneven = scene.uneven + sign * self.size * self.there(line, part)


class Static(Cause):
    id, says = "registration.static", "the camera was put back elsewhere than the rig says"
    limits = ranges.REGISTRATION
    moves = needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        rng = self.rng()
        tilt, shift = axis(rng), axis(rng) * rng.uniform(0.0, 0.15)
        scene.tilt = scene.tilt + self.size * tilt * self.there(line, part)
        scene.shift = scene.shift + self.size * shift * self.there(line, part)


class DirectionDependent(Cause):
    id, says = "registration.direction_dependent", "the instrument lies to one side of its channel, by the way it moves"
    limits = ranges.CHANNEL_PLAY
    needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        rng = self.rng()
        leans, travel = axis(rng), float(rng.uniform(0.3, 1.0))
        way = side(line.q, travel * line.width)
        scene.tilt = scene.tilt + np.outer(line.at(way * self.on(line), times), self.size * leans)


class Shift(Cause):
    id, says = "registration.shift", "the camera is knocked in a test"
    limits = ranges.REGISTRATION
    needs_camera, may_start = True, False

    def _when(self, line: Line) -> float:
        begin, end = tested(line)
        return begin + float(self.rng().uniform(0.3, 0.7)) * (end - begin)

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        rng = np.random.default_rng(self.seed)
        tilt, shift = axis(rng), axis(rng) * rng.uniform(0.0, 0.15)
        after = (times >= self._when(line)).astype(float)
        scene.tilt = scene.tilt + np.outer(after, self.size * tilt)
        scene.shift = scene.shift + np.outer(after, self.size * shift)

    def parameters(self, line: Line) -> Said:
        return {"time_s": self._when(line)}


class Distortion(Cause):
    id, says = "camera.distortion", "a lens whose k1 and k2 the rig does not hold"
    limits = ranges.DISTORTION
    moves = needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        rng = self.rng()
        sign, second = (-1.0 if rng.random() < 0.75 else 1.0), float(rng.uniform(-0.2, 0.1))
        lens = sign * self.size * np.array([1.0, second, 0.0, 0.0, 0.0])
        scene.lens = scene.lens + lens * self.there(line, part)


class Delay(Cause):
    id, says = "acquisition.delay", "frames arrive later than the rig says"
    limits = ranges.DELAY
    moves = True

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        return arrival + self.size * self.there(line, part)


class Jitter(Cause):
    id, says = "acquisition.jitter", "frames wait for a scattered time until they are stamped"
    limits = ranges.JITTER

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        rng = np.random.default_rng([self.seed, part.first])
        shape = 1.3
        waits = self.size / np.sqrt(shape) * (rng.gamma(shape, 1.0, arrival.size) - shape)
        return rising(arrival + waits) if self.there(line, part) else arrival


class ClockRate(Cause):
    id, says = "acquisition.clock_rate", "the camera's clock runs fast or slow, and is set at each recording"
    limits = ranges.CLOCK

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        sign = float(self.rng().choice([-1.0, 1.0]))
        return arrival + sign * self.size * (arrival - part.begin) * self.there(line, part)


class HeldSamples(Cause):
    id, says = "acquisition.held_samples", "values are handed out again instead of new ones"
    limits = ranges.HELD

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rng = np.random.default_rng([self.seed, part.first])
        fresh = rng.random(pick.size) >= self.size
        fresh[0] = True
        last = np.maximum.accumulate(np.where(fresh, np.arange(pick.size), 0))
        return np.asarray(pick[last])
