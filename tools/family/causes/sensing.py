"""Causes at the configuration, in the registration, the camera and the acquisition that formats.md lists."""

import numpy as np
from tools.family import ranges
from tools.family.causes.base import Cause, slider
from tools.family.line import Line
from tools.family.view import ARCS


class Coupled(Cause):
    id = "configuration.axis_coupling"
    limits = ranges.COUPLING
    says = "another joint's move lengthens the cable's path, straight or through that joint's own gap"

    def column(self, line: Line) -> str:
        return str(self.rng().choice(sorted(k for k in line.sides if k != "load_mNm" and np.ptp(line.sides[k]) > 0)))

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        column = self.column(line)
        side = line.sides[column]
        stroke = float(np.max(np.abs(side)))
        if self.seed % 3 == 0:  # a gap of 8 % of its stroke
            gap = 0.08 * stroke
            side = side - gap / 2 * slider(side, gap)
        return c + self.on(line) * self.size * line.width * line.gain * side / stroke

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"column": self.column(line), "deg_per_stroke": self.size * line.width * line.gain}


class Wall(Cause):
    id = "configuration.contact"
    limits = ranges.WALL
    says = "tissue or a fixture stands in the way beyond some angle and yields a little"
    moves = True
    may_start = False

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        side = 1 if self.seed % 2 else -1
        where = side * line.reach * line.gain * float(self.rng().uniform(0.3, 0.65))
        depth = np.maximum(side * (c - where), 0.0)
        soft = 0.01 * line.reach * line.gain  # the surface gives way at first
        pressed = np.where(depth < soft, depth * depth / (2 * soft), depth - soft / 2)
        return c - self.on(line) * side * self.size * pressed


class Uneven(Cause):
    id = "kinematics.nonconstant_curvature"
    limits = ranges.CURVATURE
    says = "the section bends more near its base or its tip, more so when bent far"
    needs_camera = True
    moves = True

    def shape(self, line: Line, pieces: np.ndarray) -> np.ndarray:
        slope = np.linspace(-1, 1, ARCS) * (1 if self.seed % 2 else -1)
        c = pieces.sum(axis=1)
        grow = 0.5 + 0.5 * np.abs(c) / (line.reach * line.gain)
        return pieces * (1 + (self.on(line) * self.size * grow)[:, None] * slope)


class HandEye(Cause):
    id = "registration.static"
    limits = ranges.REGISTRATION
    says = "the camera was knocked or put back elsewhere: the hand-eye transform is another"
    needs_camera = True
    moves = True

    def _way(self) -> np.ndarray:
        way = self.rng().normal(size=6) * [1, 1, 1, 0.15, 0.15, 0.15]  # deg, mm
        return np.asarray(way / np.linalg.norm(way[:3]))

    def hand_eye(self, line: Line, c: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        way = self.size * self.on(line)[:, None] * self._way()
        return way[:, :3], way[:, 3:]

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"turn_deg": self.size}


class ChannelPlay(Cause):
    id = "registration.direction_dependent"
    limits = ranges.CHANNEL_PLAY
    says = "the instrument leans to the side of its channel that friction pushes it to, through a little travel"
    needs_camera = True

    def hand_eye(self, line: Line, c: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        r = self.rng()
        side = slider(c, line.width * line.gain * float(r.uniform(0.05, 0.3)))
        axis = np.array([np.cos(a := r.uniform(0, 6.28)), np.sin(a), 0.0])
        return (self.size * self.on(line) * side)[:, None] * axis, np.zeros((c.size, 3))

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"tilt_deg": self.size}


class Knock(HandEye):
    id = "registration.shift"
    says = "the camera or the instrument is knocked once, while a test is being recorded"
    may_start = False
    moves = False

    def _when(self, line: Line) -> float:
        r = np.random.default_rng([self.seed, 78])
        tests = [i for i, n in enumerate(line.names) if n.startswith("test")]
        t = line.t[(line.part == tests[r.integers(len(tests))]) & line.frame]
        return float(t[0] + (t[-1] - t[0]) * r.uniform(0.3, 0.7))

    def on(self, line: Line) -> np.ndarray:
        return (line.t >= self._when(line)).astype(float)


class Lens(Cause):
    id = "camera.distortion"
    limits = ranges.DISTORTION
    says = "the lens bends straight lines, and the rig does not say so (or another lens is on)"
    needs_camera = True
    moves = True

    def lens(self, line: Line) -> np.ndarray | None:
        ratio = float(self.rng().uniform(-0.3, 0.3))
        return -self.on(line)[:, None] * self.size * np.array([1.0, ratio, 0.0, 0.0, 0.0])

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"k1": -self.size}


class Later(Cause):
    id = "acquisition.delay"
    limits = ranges.DELAY
    says = "another driver, exposure or USB port: all frames come later"
    moves = True

    def late(self, line: Line, scene: np.ndarray, part: int) -> np.ndarray | float:
        if self.since == "test" and line.names[part] == "calibration":
            return 0.0
        return self.size

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"delay_s": float(self.late(line, line.t, len(line.names) - 1))}


class Jitter(Later):
    id = "acquisition.jitter"
    limits = ranges.JITTER
    says = "a busy bus: each frame waits by another amount, mostly little, now and then long"
    moves = False

    def late(self, line: Line, scene: np.ndarray, part: int) -> np.ndarray | float:
        if self.since == "test" and line.names[part] == "calibration":
            return 0.0
        wait = np.random.default_rng([self.seed, part]).gamma(1.5, 1 / np.sqrt(1.5), scene.size)
        return self.size * (wait - np.sqrt(1.5))

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"std_s": self.size}


class OtherClock(Later):
    id = "acquisition.clock_rate"
    limits = ranges.CLOCK
    says = "the camera's stamps count a clock of another rate than the motor's"
    moves = False

    def late(self, line: Line, scene: np.ndarray, part: int) -> np.ndarray | float:
        if self.since == "test" and line.names[part] == "calibration":
            return 0.0
        return (self.size if self.seed % 2 else -self.size) * (scene - line.begins[part])

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"rate": self.size if self.seed % 2 else -self.size}


class Held(Cause):
    id = "acquisition.held_samples"
    limits = ranges.HELD
    says = "the driver hands out the last value again when the new one is not ready, one to four times"

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        r = self.rng()
        out, frames, on = image.copy(), np.flatnonzero(line.frame), self.on(line)
        chance = r.random(frames.size)
        runs = r.integers(1, 5, frames.size)
        left = 0
        for k in range(1, frames.size):
            if left == 0 and chance[k] < self.size / 2.5:  # 2.5: mean length of a run
                left = int(runs[k])
            if left and on[frames[k]] and line.part[frames[k]] == line.part[frames[k - 1]]:
                out[frames[k]] = out[frames[k - 1]]
            left = max(left - 1, 0)
        return out

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"share": self.size}


class Law(Cause):
    id = "configuration.remaining"
    limits = ranges.LAW_CHANGE
    says = "the section's stiffness is another (a tool in the channel, another posture): the static law changed"
    may_start = False
    moves = True

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        x = c / (line.reach * line.gain)
        change = r.choice([-1, 1]) * x + float(r.uniform(-0.6, 0.6)) * x * x + float(r.uniform(-0.5, 0.5)) * x**3
        return c + self.on(line) * self.size * line.reach * line.gain * change
