"""Causes that no listed effect holds. Each leaves what depends on things that the list does not know: the last
stroke, rest, heat, the largest strain, the direction together with the place, the light, the breath.
"""

import math

import numpy as np
from tools.family import ranges
from tools.family.causes.base import Cause, follow
from tools.family.line import Line
from tools.family.ranges import Range


class Unlisted(Cause):
    unlisted = True

    def _span(self, line: Line) -> float:
        return line.reach * line.gain

    def _sign(self) -> int:
        return 1 if self.seed % 2 else -1


def last_stroke(line: Line) -> np.ndarray:
    """Size of the last finished stroke at each instant (a turn is one of over 2 % of the reach)."""
    size = np.empty_like(line.q)
    far = back = float(line.q[0])
    up, last = True, 0.0
    for i, q in enumerate(line.q.tolist()):
        if (up and q > far) or (not up and q < far):
            far = q
        elif abs(q - far) > 0.02 * line.reach:
            last = abs(far - back)
            back, far, up = far, q, not up
        size[i] = last
    return size


class ThermalGain(Unlisted):
    id = "thermal_gain"
    limits = Range(0.001, 0.06, "of the gain for each unit of heat, polymer drum", ranges.MADE)
    says = "the drum warms with the work done and cools at rest, and the gain follows with a time constant of its own"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        work = np.minimum((line.speed / line.usual) ** 2, 9.0)
        heat = follow(line, follow(line, work, float(r.uniform(2, 6))), float(r.uniform(12, 30)))
        return c * (1 + self.on(line) * self._sign() * self.size * heat)


class RubAfterStroke(Unlisted):
    id = "rub_after_stroke"
    limits = Range(0.002, 0.08, "of the range", ranges.MADE)
    says = "the cable climbs a rib after a long stroke and rubs at two places until a short stroke lets it down"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        climbed = follow(line, (last_stroke(line) > 0.8 * line.reach).astype(float), 0.15)
        places = r.uniform(-0.6, 0.6, 2) * self._span(line)
        dent = np.sum([np.exp(-(((c - p) / (0.12 * self._span(line))) ** 2)) for p in places], axis=0)
        return c - self.on(line) * self._sign() * self.size * self._span(line) * climbed * dent


class Walking(Unlisted):
    id = "walking_sheath"
    limits = Range(0.002, 0.3, "of the width for each reach travelled", ranges.MADE)
    says = (
        "the sheath walks one way a little with each stroke's travel upwards and springs back slowly only near one end"
    )

    def drive(self, line: Line) -> np.ndarray | float:
        dq = np.maximum(np.diff(line.q, prepend=line.q[0]), 0.0) / line.reach
        near = line.q < -0.75 * line.reach
        out, w = np.empty_like(line.q), 0.0
        for i, (d, n, dt) in enumerate(
            zip(dq.tolist(), near.tolist(), np.diff(line.t, prepend=line.t[0]).tolist(), strict=True)
        ):
            w = w * math.exp(-dt / 0.7) if n else w + d
            out[i] = w
        return self.on(line) * self._sign() * self.size * line.width * out


class Refocus(Unlisted):
    id = "refocus"
    limits = Range(0.001, 0.04, "of the scale", ranges.MADE)
    says = (
        "the autofocus hunts when the marker has moved far since it last focused; the image scale breathes and settles"
    )
    needs_camera = True

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        r = self.rng()
        trip = float(r.uniform(0.15, 0.3)) * float(np.ptp(image[:, 0]) + np.ptp(image[:, 1]))
        goal, focus, last = np.empty(len(image)), 0.0, image[0]
        pull = r.normal(size=4096)
        k = 0
        for i, m in enumerate(image):
            if abs(m[0] - last[0]) + abs(m[1] - last[1]) > trip:
                last, k = m, k + 1
                focus = float(pull[k % 4096])
            goal[i] = focus
        scale = 1 + self.on(line) * self.size * follow(line, goal, 0.35)
        centre = image.mean(axis=0)
        return centre + (image - centre) * scale[:, None] + 0.4 * (scale - 1)[:, None] * np.ptp(image, axis=0)


class Glint(Unlisted):
    id = "glint"
    limits = Range(0.01, 0.6, "of the way to the highlight", ranges.MADE)
    says = "a highlight next to the marker's way draws the tracker and holds it longer on leaving than on coming"
    needs_camera = True

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        r = self.rng()
        spot = (
            image[r.integers(len(image) // 3, len(image))] + r.normal(scale=0.02, size=2) * np.ptp(image, axis=0).max()
        )
        near = 0.12 * float(np.ptp(image, axis=0).max())
        away = np.linalg.norm(image - spot, axis=1)
        caught, state = np.empty(len(image)), 0.0
        for i, d in enumerate(away.tolist()):
            state = 1.0 if d < near else 0.0 if d > 2.2 * near else state
            caught[i] = state
        drawn = self.on(line) * self.size * follow(line, caught, 0.08) * np.exp(-away / (2 * near))
        return image + drawn[:, None] * (spot - image)


class Cogging(Unlisted):
    id = "direction_cogging"
    limits = Range(0.005, 0.3, "of the width", ranges.MADE)
    says = "torque ripple twists the gear: n waves per turn one way, n + 3 the other, nothing at rest"

    def drive(self, line: Line) -> np.ndarray | float:
        r = self.rng()
        n, turn = int(r.integers(3, 7)), line.reach * float(r.uniform(0.7, 1.3))
        up = 1 / (1 + np.exp(-np.clip(line.speed / (0.05 * line.usual), -40, 40)))
        moves = np.minimum(np.abs(line.speed) / (0.1 * line.usual), 1.0)
        a, b = 2 * np.pi * n * line.q / turn, 2 * np.pi * (n + 3) * line.q / turn + 1.0
        return self.on(line) * self.size * line.width * moves * (up * np.sin(a) + (1 - up) * np.sin(b))


class Ageing(Unlisted):
    id = "friction_ageing"
    limits = ranges.AGEING
    says = "static friction grows with the logarithm of the rest before a move and wears off as it slides"

    def breakaway(self, line: Line) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
        none = np.zeros_like(line.t)
        return none, none, self.size * self.on(line), 0.6 * line.width * line.gain


class RollingShutter(Unlisted):
    id = "rolling_shutter"
    limits = ranges.READ_OUT
    says = "rows are read one after another: a marker low in the image is seen later than one high up"
    needs_camera = True

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        rows = (image[:, 1] - image[:, 1].mean()) / max(float(np.ptp(image[:, 1])), 1.0)
        speed = np.gradient(image, line.t, axis=0)
        return image + (self.on(line) * self.size * rows)[:, None] * speed


class SnapThrough(Unlisted):
    id = "snap_through"
    limits = Range(0.001, 0.05, "of the range", ranges.MADE)
    says = "a kinked sheath snaps between two shapes, each way at a place of its own, quickly but not at once"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        span = self._span(line)
        low, high = sorted((float(r.uniform(-0.5, 0.0)) * span, float(r.uniform(0.1, 0.5)) * span))
        state, out = -1.0, np.empty_like(c)
        for i, x in enumerate(c.tolist()):
            state = 1.0 if x > high else -1.0 if x < low else state
            out[i] = state
        return c + self.on(line) * self._sign() * self.size * span * follow(line, out, 0.12)


class WarmUp(Unlisted):
    id = "registration_warm_up"
    limits = Range(0.02, 3.0, "deg in the end", ranges.MADE)
    says = "the endoscope warms: its camera leans ever further, towards a limit, for minutes"
    needs_camera = True
    may_start = False

    def hand_eye(self, line: Line, c: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        way = self.rng().normal(size=3)
        course = (1 - np.exp(-line.past / 50)) * self.size
        return course[:, None] * way / np.linalg.norm(way), np.zeros((c.size, 3))


class MainsBeat(Unlisted):
    id = "mains_beat"
    limits = Range(0.02, 2.0, "px", ranges.MADE)
    says = "lamps flicker with the mains, the frames beat against it and the marker's centroid wobbles, moving or not"
    needs_camera = True

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        r = self.rng()
        rate, way = float(r.uniform(0.25, 1.8)), r.normal(size=2)
        wobble = np.sin(2 * np.pi * rate * line.t + r.uniform(0, 6)) + 0.3 * np.sin(4 * np.pi * rate * line.t)
        return image + (self.on(line) * self.size * wobble)[:, None] * way / np.linalg.norm(way)


class Breath(Unlisted):
    id = "breathing_base"
    limits = Range(0.02, 2.0, "mm", ranges.MADE)
    says = "the patient breathes and the instrument's base rides on it: slow, never quite the same twice"
    needs_camera = True

    def hand_eye(self, line: Line, c: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        r = self.rng()
        rate = ranges.BREATHS.draw(r)
        phase = 2 * np.pi * rate * line.t + 0.8 * np.sin(2 * np.pi * 0.031 * line.t + r.uniform(0, 6))
        way = r.normal(size=3) * [1.0, 1.0, 0.3]
        breath = np.sin(phase) ** 4 * (1 + 0.25 * np.sin(2 * np.pi * 0.057 * line.t))
        return np.zeros((c.size, 3)), (self.on(line) * self.size * breath)[:, None] * way / np.linalg.norm(way)


class MarkerSwap(Unlisted):
    id = "marker_swap"
    limits = Range(0.3, 20.0, "px", ranges.MADE)
    says = "in bursts the tracker follows a second mark of the instrument, next to the true one"
    needs_camera = True

    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        r = self.rng()
        begins = line.t[0] + np.cumsum(r.exponential(9.0, 400))
        lasts = r.uniform(0.25, 1.5, 400)
        swapped = np.sum([(line.t > b) & (line.t < b + d) for b, d in zip(begins, lasts, strict=True)], axis=0) > 0
        away = r.normal(size=2)
        return image + (self.on(line) * swapped * self.size)[:, None] * away / np.linalg.norm(away)


class Thixotropy(Unlisted):
    id = "thixotropic_grease"
    limits = Range(0.02, 1.0, "s after a long rest", ranges.MADE)
    says = "grease that stiffens at rest and thins while stirred: a lag that is long after a rest and soon gone"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        stirred = follow(
            line, (np.abs(line.speed) > 0.1 * line.usual).astype(float), float(self.rng().uniform(0.8, 2.5))
        )
        tau = np.maximum(self.size * (1 - stirred) ** 3, 1e-3)
        return np.where(self.on(line) > 0, follow(line, c, tau), c)


class Mullins(Unlisted):
    id = "mullins_softening"
    limits = ranges.SOFTENING
    says = "an elastomer cover softens up to the largest strain of late and heals: inner loops differ from outer ones"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        out, top = np.empty_like(c), 0.0
        for i, (x, dt) in enumerate(zip(np.abs(c).tolist(), np.diff(line.t, prepend=line.t[0]).tolist(), strict=True)):
            top = max(x, top * math.exp(-dt / 25.0))
            out[i] = top
        return c * (1 - self.on(line) * self.size * (1 - np.abs(c) / np.maximum(out, 1e-6)))


class CreepingBelt(Unlisted):
    id = "creeping_belt"
    limits = Range(0.001, 0.05, "of the reach for each reach per second", ranges.MADE)
    says = (
        "a flat belt creeps with its tension: offset grows with the net travel while moving fast and relaxes while slow"
    )

    def drive(self, line: Line) -> np.ndarray | float:
        fast = np.where(np.abs(line.speed) > 0.8 * line.usual, line.speed, 0.0) / line.reach
        return self.on(line) * self._sign() * self.size * line.reach * follow(line, fast, 6.0)
