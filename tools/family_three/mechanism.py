"""A mechanism: which motor place each place of the tip needs, sliding up or down, and what follows of it in time."""

from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.family_three.friction import Feel, heavy, project, walk
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Number = FloatArray | float
GRID = 801
MOST_STEPS = 40  # Newton's, halving where they go astray
ROUGH = 0.003  # deg: what a law of degree 7 may leave
BEYOND = 1.4  # of the limit: how far tables go


@dataclass
class Demand:
    """What is asked of a mechanism over time; numbers are constant, arrays follow the grid."""

    q: FloatArray
    rub: Number = 1.0  # friction, of the healthy
    load: Number = 0.0  # what pulls at the tip, of a `pull`
    wall: Number = 0.0  # of the motion beyond `wall_at` that is taken away
    wall_at: Number = 1e9  # deg, on the side of `wall_side`
    wall_side: float = 1.0
    law: Number = 0.0  # another geometry of the drive
    shares: tuple[tuple[float, float], ...] = ()  # presliding: (weight, threshold) of elements of the friction
    shares_from: int = 0  # the instant from which there are such
    feel: Feel = field(default_factory=Feel)

    @property
    def plain(self) -> bool:
        """Nothing but the motor changes with time."""
        return not any(isinstance(v, np.ndarray) for v in (self.rub, self.load, self.wall, self.wall_at, self.law))


class Mechanism:
    """What all have in common. `x` is the tip's angle in deg, `q` the motor's place in `unit`."""

    unit = "mm"
    arm = True  # a stiff arm on a short flexure; else a bending section
    massive = False
    rate, damping = 60.0, 0.5  # Hz and damping ratio, of those with mass
    limit = 60.0  # deg
    pull: float  # the torque that moves the middle by a width
    turn = 1.0  # units of q for a turn of the shaft that carries the encoder
    exact = True  # else friction depends weakly on speed: `weak` of it more at rest
    weak = 0.0

    def __init__(self, rng: np.random.Generator) -> None:
        raise NotImplementedError

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        """Motor place at which the tip, at `x`, is about to slide up (s = 1) or down (s = -1)."""
        raise NotImplementedError

    def settle(self) -> None:
        """Tables of the healthy mechanism; called at the end of each constructor."""
        self.xs = np.linspace(-BEYOND, BEYOND, GRID) * self.limit
        zero, small = np.zeros(1), 1e-3
        pushed = [float(np.mean([self.drive(zero, s, 1.0, t, 0.0)[0] for s in (1, -1)])) for t in (small, -small)]
        self.give = (pushed[0] - pushed[1]) / (2 * small)  # units of q for a unit of torque, in the middle
        up, down = (self.drive(zero, s, 1.0, 0.0, 0.0)[0] for s in (1, -1))
        self.width = float(up - down)
        self.pull = self.width / self.give
        self.home = float(0.5 * (up + down))  # the motor's zero is in the middle of the gap
        ends = self.drive(np.array([-1.0, 1.0]) * self.limit, 0.0, 1.0, 0.0, 0.0) - self.home
        self.reach = float(np.min(np.abs(ends))) + 0.3 * self.width

    def need(
        self,
        x: FloatArray,
        s: float,
        rub: Number = 1.0,
        load: Number = 0.0,
        law: Number = 0.0,
        wall: Number = 0.0,
        wall_at: Number = 1e9,
        wall_side: float = 1.0,
    ) -> FloatArray:
        torque = load * self.pull
        if np.any(np.asarray(wall) > 0):
            past = np.maximum(wall_side * x - wall_at, 0.0)
            past = past - 0.5 * (1 - np.exp(-2 * past))  # a soft first half degree
            stiff = wall / (1 - wall) * self.width / self.give / self.width_deg
            torque = torque + wall_side * stiff * past
        return self.drive(x, s, rub, torque, law) - self.home

    @property
    def width_deg(self) -> float:
        return self.width * self.slope()

    def slope(self) -> float:
        """deg of the tip for a unit of q, in the middle."""
        near = np.array([-0.02, 0.02]) * self.limit
        mean = 0.5 * (self.need(near, 1.0) + self.need(near, -1.0))
        return float((near[1] - near[0]) / (mean[1] - mean[0]))

    def farthest(self) -> float:
        """The largest angle within the motor's range, deg."""
        ends = np.array([-self.reach, self.reach])
        return float(np.max(np.abs(np.interp(ends, self.need(self.xs, 0.0), self.xs))))

    def tip(self, x: FloatArray) -> FloatArray:
        return x

    def branches(self, d: Demand) -> tuple[FloatArray, FloatArray]:
        """The ends of the sticking interval at each instant, deg: where it slides up, where it slides down."""
        return self._solve(d, 1.0), self._solve(d, -1.0)

    def _solve(self, d: Demand, s: float) -> FloatArray:
        if d.plain:
            table = self.need(self.xs, s, d.rub, d.load, d.law, d.wall, d.wall_at, d.wall_side)
            return np.interp(d.q, table, self.xs)
        x: FloatArray = np.interp(d.q, self.need(self.xs, s), self.xs)
        below, above = np.full(x.size, self.xs[0]), np.full(x.size, self.xs[-1])
        left, eps = np.arange(x.size), 1e-4 * self.limit
        for _ in range(MOST_STEPS):
            rub, load, law, wall, far = (
                v[left] if isinstance(v, np.ndarray) else v for v in (d.rub, d.load, d.law, d.wall, d.wall_at)
            )
            at, q = x[left], d.q[left]
            miss = self.need(at, s, rub, load, law, wall, far, d.wall_side) - q
            slope = (self.need(at + eps, s, rub, load, law, wall, far, d.wall_side) - q - miss) / eps
            below[left] = np.where(miss < 0, at, below[left])
            above[left] = np.where(miss > 0, at, above[left])
            new = at - miss / np.where(slope > 0, slope, np.inf)
            astray = (new <= below[left]) | (new >= above[left])
            new = np.where(astray, 0.5 * (below[left] + above[left]), new)
            x[left] = new
            left = left[np.abs(new - at) > 1e-6 * self.limit]
            if left.size == 0:
                break
        return x

    def run(self, d: Demand) -> FloatArray:
        """The tip over time. It starts where friction leaves it in the middle."""
        low, high = self.branches(d)
        if self.weak:
            speed = np.abs(np.gradient(d.q, STEP))
            half = 0.5 * self.weak * np.exp(-speed / (0.05 * self.reach)) * (high - low)
            low, high = low - half, high + half
        middle = 0.5 * (self.need(self.xs, 1.0) + self.need(self.xs, -1.0))
        start = float(np.clip(np.interp(d.q[0], middle, self.xs), low[0], high[0]))
        if d.shares:
            low, high = presliding(low, high, start, d)
        if self.massive:
            damping = np.full(d.q.size, self.damping)
            if d.feel.drag is not None:
                damping = damping + np.round(d.feel.drag * np.pi * self.rate, 6)
            return heavy(low, high, start, self.rate, damping, STEP)
        if d.feel.any:
            return walk(low, high, start, d.feel, STEP)
        return project(low, high, start)

    def presliding(self) -> tuple[tuple[float, float], ...]:
        """How the friction gives way before it slides: weights and thresholds, of the whole, of its elements."""
        edges = (np.arange(6) + 0.5) / 6
        return tuple((1 / 6, float(e)) for e in edges)

    def tune(self, name: str, lo: float, hi: float, width: float) -> bool:
        """Sets a number so that the width in the middle is `width` deg of the tip; says whether that can be."""

        def off(value: float) -> float:
            setattr(self, name, value)
            self.settle()
            return self.width_deg - width

        if off(lo) > 0 or off(hi) < 0:
            return False
        setattr(self, name, float(brentq(off, lo, hi, xtol=1e-9, rtol=1e-8)))
        self.settle()
        return True

    def healthy(self) -> bool:
        """Branches rise everywhere, a width apart that changes by less than a factor of five, both of them smooth."""
        up, down = self.need(self.xs, 1.0), self.need(self.xs, -1.0)
        if min(np.diff(up).min(), np.diff(down).min(), np.min(up - down)) <= 0:
            return False
        inside = np.abs(self.xs) < 1.03 * self.limit
        slopes = np.concatenate([np.diff(up[inside]), np.diff(down[inside])])
        middle, width, x = 0.5 * (up + down)[inside] / self.reach, (up - down)[inside], self.xs[inside]
        rough = x - chebyshev.chebval(middle, chebyshev.chebfit(middle, x, 7))
        uneven = width - chebyshev.chebval(middle, chebyshev.chebfit(middle, width, 5))
        return bool(
            slopes.min() > 0.25 * np.median(slopes)
            and width.min() > 0.4 * self.width
            and width.max() < 2 * self.width
            and self.width < 0.5 * self.reach
            and np.sqrt(np.mean(rough**2)) < ROUGH
            and np.sqrt(np.mean(uneven**2)) * self.slope() < 2 * ROUGH
        )


def presliding(low: FloatArray, high: FloatArray, start: float, d: Demand) -> tuple[FloatArray, FloatArray]:
    """Elements that let go one after the other carry the tip together: there the interval is one place."""
    here = slice(d.shares_from, None)
    if d.shares_from:
        start = float(project(low[: d.shares_from], high[: d.shares_from], start)[-1])
    middle, half = 0.5 * (low + high)[here], 0.5 * (high - low)[here]
    carried = np.sum([w * project(middle - r * half, middle + r * half, start) for w, r in d.shares], axis=0)
    low, high = low.copy(), high.copy()
    low[here] = high[here] = carried
    return low, high
