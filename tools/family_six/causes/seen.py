"""Listed effects from the base to the file."""

import numpy as np

from tools.family import ranges as first
from tools.family_six.causes.base import Cause, FloatArray, Line, Part, Picks, Scene, axis, rising, side, tested


class Uneven(Cause):
    id, limits, moves, may_start = "kinematics.nonconstant_curvature", first.CURVATURE, True, False
    needs_camera, sections = True, True
    says = "one side of the section is softer towards its base, and shows as it bends"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        bent = line.at(c, times) if c.size == line.t.size else c
        lean = 0.5 + 0.5 * np.tanh(bent / 25.0) * self.sign(1)
        scene.uneven += self.gate(line, times) * self.sign() * self.size * lean


class Static(Cause):
    id, limits, moves, may_start = "registration.static", first.REGISTRATION, True, False
    needs_camera = True
    says = "the camera was taken off and put back elsewhere"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng, on = self.rng(), self.gate(line, times)[:, None]
        scene.tilt += on * self.size * axis(rng)
        scene.shift += on * self.size * 0.15 * axis(rng)


class Direction(Cause):
    id, limits, needs_camera = "registration.direction_dependent", first.CHANNEL_PLAY, True
    says = "the instrument's clamp gives by the way the motor pulls"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng, on = self.rng(), self.gate(line, times)[:, None]
        way = line.at(side(line.q, float(rng.uniform(0.2, 0.8)) * line.width), times)[:, None]
        scene.tilt += on * 0.5 * self.size * way * axis(rng)
        scene.shift += on * 0.05 * self.size * way * axis(rng)


class Shift(Cause):
    id, limits, needs_camera, may_start = "registration.shift", first.REGISTRATION, True, False
    says = "an arm's joint gives way during a test and stops some time later"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng, (begin, end) = self.rng(), tested(line)
        when, took = begin + float(rng.uniform(0.25, 0.7)) * (end - begin), float(rng.uniform(0.1, 2.0))
        gone = np.clip((times - when) / took, 0.0, 1.0)[:, None]
        scene.tilt += gone * self.size * axis(rng)
        scene.shift += gone * 0.1 * self.size * axis(rng)


class Distortion(Cause):
    id, limits, moves, may_start = "camera.distortion", first.DISTORTION, True, False
    needs_camera = True
    says = "k1, k2 and k3 that the rig does not hold"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        lens = np.array([1.0, -0.45, 0.0, 0.0, 0.12]) * self.sign() * self.size
        scene.lens += self.gate(line, times)[:, None] * lens


class Delay(Cause):
    id, limits, moves, may_start = "acquisition.delay", first.DELAY, True, False
    says = "frames arrive later"

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        return arrival + self.size * self.there(line, part)


class Jitter(Cause):
    id, limits = "acquisition.jitter", first.JITTER
    says = "frames wait, by Weibull's law of shape 0.8 to 1.5, for a busy reader"

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        rng = np.random.default_rng([self.seed, part.first])
        wait = self.size * rng.weibull(np.random.default_rng(self.seed).uniform(0.8, 1.5), arrival.size)
        return rising(arrival + wait * self.there(line, part))


class ClockRate(Cause):
    id, limits = "acquisition.clock_rate", first.CLOCK
    says = "the camera's oscillator is off, a part of it while it warms up in each recording"

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        since = arrival - arrival[0]
        off = self.size * (since - 0.3 * 12.0 * (1 - np.exp(-since / 12.0)))
        return np.asarray(arrival + self.sign() * off * self.there(line, part))


class Held(Cause):
    id, limits = "acquisition.held_samples", first.HELD
    says = "the sensor renews its value less often than it is read: repeats come in a beat"

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rate, phase, at = 1 - self.size, float(self.rng().uniform(0.1, 0.9)), np.arange(pick.size)
        held = np.ceil((np.floor(at * rate + phase) - phase) / rate - 1e-9).astype(np.intp)
        return np.asarray(pick[np.clip(held, 0, at)])


EVERY = (Uneven, Static, Direction, Shift, Distortion, Delay, Jitter, ClockRate, Held)
