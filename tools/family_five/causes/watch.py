"""What formats.md lists of kinematics, registration, camera and acquisition."""

import numpy as np

from tools.family import ranges as first
from tools.family_five.causes.base import Cause, FloatArray, Line, Part, Picks, Scene, axis, rising, side, tested


class NonconstantCurvature(Cause):
    id = "kinematics.nonconstant_curvature"
    says = "the section bends more towards one end, the more so the further it bends"
    limits = first.CURVATURE
    moves, may_start, needs_camera, sections = True, False, True, True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            more = 0.6 + 0.4 * np.abs(c) / float(np.max(np.abs(c)))
            scene.uneven = scene.uneven + float(self.rng().choice([-1, 1])) * self.size * more


class Static(Cause):
    id = "registration.static"
    says = "the camera was put back elsewhere"
    limits = first.REGISTRATION
    moves, may_start, needs_camera = True, False, True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            scene.tilt = scene.tilt + self.size * axis(rng)
            scene.shift = scene.shift + 0.3 * self.size * axis(rng)


class DirectionDependent(Cause):
    id = "registration.direction_dependent"
    says = "the instrument rolls over in its port, by the way the tip moves, within a part of the range"
    limits = first.CHANNEL_PLAY
    needs_camera = True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            moved = np.interp(line.t, times, c)
            leans = line.at(side(moved, float(rng.uniform(0.05, 0.2)) * float(np.ptp(c))), times)
            scene.tilt = scene.tilt + self.size * leans[:, None] * axis(rng)


class Shift(Cause):
    id = "registration.shift"
    says = "the stand is knocked in a test, and settles within a second"
    limits = first.REGISTRATION
    may_start, needs_camera = False, True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        rng = self.rng()
        begin, end = tested(line)
        since = times - (begin + float(rng.uniform(0.25, 0.75)) * (end - begin))
        gone = np.where(since > 0, 1 - 0.3 * np.exp(-np.maximum(since, 0) / float(rng.uniform(0.1, 0.5))), 0.0)
        scene.tilt = scene.tilt + self.size * gone[:, None] * axis(rng)
        scene.shift = scene.shift + 0.3 * self.size * gone[:, None] * axis(rng)


class Distortion(Cause):
    id = "camera.distortion"
    says = "another lens: k1, k2 and off its axis p1, p2"
    limits = first.DISTORTION
    moves, may_start, needs_camera = True, False, True

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            k1 = float(rng.choice([-1.0, 0.4])) * self.size
            p1, p2 = (0.02 * self.size * axis(rng)[:2]).tolist()
            scene.lens = scene.lens + np.array([k1, -0.3 * k1, p1, p2, 0.0])


class Delay(Cause):
    id = "acquisition.delay"
    says = "frames come later than they did"
    limits = first.DELAY
    moves, may_start = True, False

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        return arrival + self.size if self.there(line, part) else arrival


class Jitter(Cause):
    id = "acquisition.jitter"
    says = "waits of a log-normal scheduler"
    limits = first.JITTER

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        if not self.there(line, part):
            return arrival
        rng = np.random.default_rng([self.seed, part.first])
        sigma = 0.8
        waits = rng.lognormal(0.0, sigma, arrival.size) - np.exp(0.5 * sigma**2)
        return rising(arrival + self.size * waits / np.sqrt(np.expm1(sigma**2) * np.exp(sigma**2)))


class ClockRate(Cause):
    id = "acquisition.clock_rate"
    says = "the camera's clock runs at another rate, set right when a recording begins"
    limits = first.CLOCK

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        if not self.there(line, part):
            return arrival
        rate = 1 + float(self.rng().choice([-1, 1])) * self.size
        return np.asarray(part.begin + (arrival - part.begin) * rate)


class HeldSamples(Cause):
    id = "acquisition.held_samples"
    says = "values are handed out again, in runs (Gilbert's two states)"
    limits = first.HELD

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rng = np.random.default_rng([self.seed, part.first])
        stays = float(rng.uniform(0.3, 0.75))
        enters = min(self.size * (1 - stays) / (1 - self.size), 1.0)
        held, out = False, pick.copy()
        for k, chance in enumerate(rng.random(pick.size - 1).tolist()):
            held = chance < (stays if held else enters)
            if held:
                out[k + 1] = out[k]
        return out


WATCH = (
    NonconstantCurvature, Static, DirectionDependent, Shift, Distortion, Delay, Jitter, ClockRate, HeldSamples,
)  # fmt: skip
