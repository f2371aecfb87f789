"""What all mechanisms share: branches by bracketed Newton's method, and the sliding between them."""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.family_four.slide import Feel, heavy, play, slide
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Value = FloatArray | float
BEYOND = 1.4  # of the limit: where tables end
PLAIN = 0.003  # deg rms that polynomials may leave of a healthy law; twice that of its width
TRIES = 400


@dataclass
class Demand:
    """What a mechanism is asked over time; values other than these are causes."""

    q: FloatArray
    rub: Value = 1.0  # multiplies all friction
    load: Value = 0.0  # torque at the tip, in widths of the drive's give
    law: Value = 0.0  # relative change of the geometry's main length
    wall: Value = 0.0  # share of the motion beyond the wall that it takes away
    wall_at: float = 0.0  # deg
    wall_side: float = 1.0
    feel: Feel | None = None
    elements: list[tuple[float, float]] = field(default_factory=list)  # shares and thresholds, where not one
    rounded: Value = 0.0  # 1 where they act


class Mechanism:
    """Quasi-static balance: `raw` is the drive's travel that holds the tip at x with friction f to one side."""

    unit: ClassVar[str] = "mm"
    arm: ClassVar[bool] = True  # seen from beside; else a section seen along its axis
    massive: ClassVar[bool] = False
    sluggish: ClassVar[bool] = False  # its healthy friction depends weakly on speed
    rubs: ClassVar[tuple[float, float]] = (0.02, 0.35)  # where the friction's coefficient has to lie
    widths: ClassVar[tuple[float, float]] = (1.0, 6.0)  # deg
    strokes: ClassVar[tuple[float, float]] = (2.0, 10.0)  # of the drive to each side

    def __init__(self, rng: np.random.Generator) -> None:
        for _ in range(TRIES):
            self.weak, self.weak_speed = 0.0, 1.0
            self.limit = 1.0
            self.shape(rng)
            self.xs = np.linspace(-BEYOND, BEYOND, 401) * self.limit
            if self._scale(rng) and self._plain():
                return
        raise RuntimeError(f"no plain {type(self).__name__}")

    def shape(self, rng: np.random.Generator) -> None:
        """Draws the limit and what `raw` needs."""
        raise NotImplementedError

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        """Travel for x deg; f is the signed friction coefficient, push a torque against +x in parts of the full one."""
        raise NotImplementedError

    def _scale(self, rng: np.random.Generator) -> bool:
        """Friction that gives the drawn width in the middle, then units and the middle of the drive's range."""
        lo, hi = np.log(self.widths)
        self.width_deg = float(np.exp(rng.uniform(lo, hi)))

        def along(f: float, x: float, push: float) -> float:
            return 0.5 * float(self.raw(x, f, push, 0.0) + self.raw(x, -f, push, 0.0))

        def rise(f: float) -> float:
            return along(f, 0.5, 0.0) - along(f, -0.5, 0.0)

        def off(f: float) -> float:
            return float(self.raw(0.0, f, 0.0, 0.0) - self.raw(0.0, -f, 0.0, 0.0)) - self.width_deg * rise(f)

        if not (off(self.rubs[0]) < 0 < off(self.rubs[1])):
            return False
        self.f = float(brentq(off, *self.rubs))
        self.rise, self.home, self.unit_scale = rise(self.f), along(self.f, 0.0, 0.0), 1.0
        self.give = 50 * (along(self.f, 0.0, 0.01) - along(self.f, 0.0, -0.01))
        ends = float(self.need(self.limit, 1.0)), -float(self.need(-self.limit, -1.0))
        if not min(ends) > 0:
            return False
        self.unit_scale = float(np.exp(rng.uniform(*np.log(self.strokes)))) / min(ends)
        self.reach = min(ends) * self.unit_scale
        self.width = self.width_deg * self.slope_q
        self.turn = 2 * self.reach / float(rng.uniform(1.5, 7.0))
        return True

    def _plain(self) -> bool:
        """Both branches rise, and polynomials hold law and width where the motor goes."""
        up, down = self.need(self.xs, 1.0), self.need(self.xs, -1.0)
        if not (
            np.all(np.isfinite(up)) and np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0) and np.all(up > down)
        ):
            return False
        if np.max(np.abs(np.diff(up) / np.diff(self.xs) / self.slope_q - 1)) > 0.75:
            return False
        mean, wide = 0.5 * (up + down) / self.reach, (up - down) / self.slope_q
        inside = np.abs(mean) <= 1.02
        misses = [
            v[inside] - chebyshev.chebval(mean[inside], chebyshev.chebfit(mean[inside], v[inside], n))
            for v, n in ((self.xs, 7), (wide, 5))
        ]
        return bool(np.std(misses[0]) < PLAIN and np.std(misses[1]) < 2 * PLAIN)

    @property
    def slope_q(self) -> float:
        """Units of the drive for a deg, in the middle."""
        return self.rise * self.unit_scale

    def slope(self) -> float:
        """Mean gain, deg for a unit of the drive."""
        return self.farthest() / self.reach

    def farthest(self) -> float:
        """The largest angle that the drive's range reaches."""
        q = np.array([self.reach, -self.reach])
        return float(np.max(np.abs([np.interp(q[0], self.need(self.xs, 1.0), self.xs),
                                    np.interp(q[1], self.need(self.xs, -1.0), self.xs)])))  # fmt: skip

    def tip(self, x: FloatArray) -> FloatArray:
        return x

    def need(
        self, x: Value, s: float, rub: Value = 1.0, load: Value = 0.0, law: Value = 0.0, wall: Value = 0.0,
        wall_at: float = 0.0, wall_side: float = 1.0,
    ) -> FloatArray:  # fmt: skip
        """Where the drive must be for the tip to slide at x up (s = 1) or down (s = -1)."""
        push = np.asarray(load) * self.width_deg * self.rise / self.give
        if np.any(wall):
            beyond = wall_side * np.maximum((x - wall_at) * wall_side, 0.0)
            push = push + wall / (1 - np.minimum(wall, 0.99)) * beyond * self.rise / self.give
        return (self.raw(x, s * rub * self.f, push, law) - self.home) * self.unit_scale

    def branches(self, d: Demand) -> tuple[FloatArray, FloatArray]:
        """Where the tip lies when it slides up, and down."""
        changed = np.zeros(d.q.size, dtype=bool)
        values: list[Value] = [d.rub, d.load, d.law, d.wall]
        for value, usual in zip(values, (1.0, 0.0, 0.0, 0.0), strict=True):
            changed |= np.broadcast_to(np.asarray(value) != usual, changed.shape)
        there = [np.broadcast_to(v, changed.shape)[changed] for v in values]
        out = []
        for s in (1.0, -1.0):
            x = np.interp(d.q, self.need(self.xs, s), self.xs)
            if np.any(changed):
                x[changed] = self._solve(d.q[changed], x[changed], s, there, d.wall_at, d.wall_side)
            out.append(x)
        return out[0], out[1]

    def _solve(
        self, q: FloatArray, x: FloatArray, s: float, there: list[FloatArray], at: float, side: float
    ) -> FloatArray:
        lo, hi = np.full(q.size, self.xs[0]), np.full(q.size, self.xs[-1])
        rub, load, law, wall = there

        def off_at(where: FloatArray) -> FloatArray:
            return self.need(where, s, rub, load, law, wall, at, side) - q

        for _ in range(25):
            off = off_at(x)
            hi, lo = np.where(off > 0, x, hi), np.where(off <= 0, x, lo)
            rise = (off_at(x + 1e-3) - off) / 1e-3
            new = x - off / np.maximum(rise, 1e-9)
            new = np.where((new >= lo) & (new <= hi), new, 0.5 * (lo + hi))
            moved, x = float(np.max(np.abs(new - x))), new
            if moved < 2e-4:
                break
        return x

    def run(self, d: Demand) -> FloatArray:
        low, high = self.branches(d)
        high = np.maximum(low, high)
        middle, half = 0.5 * (low + high), 0.5 * (high - low)
        if self.weak:  # Stribeck's rise at low speed, small enough to be linear
            half = half * (1 + self.weak * np.exp(-np.abs(np.gradient(d.q, STEP)) / self.weak_speed))
            low, high = middle - half, middle + half
        start = float(middle[0])
        if d.elements:
            x = np.zeros(d.q.size)
            for share, threshold in d.elements:
                r = half * (1 + d.rounded * (threshold - 1))
                x += share * play(middle - r, middle + r, start)
            low = high = x
        if self.massive:
            drag = 0.0 if d.feel is None or d.feel.drag is None else d.feel.drag
            damping = np.broadcast_to(self.damping + np.asarray(drag) * np.pi * self.rate, low.shape)
            return heavy(low, high, start, self.rate, damping, STEP)
        if d.feel is not None:
            return slide(low, high, start, d.feel, STEP)
        return low if d.elements else play(low, high, start)

    rate = 60.0  # Hz, of what has mass
    damping = 0.5
