"""What mechanisms share: a balance of forces with dry friction, inverted at every instant, and what resists besides."""

import math
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.family.ranges import Range
from tools.family_four.causes.base import play
from tools.family_four.mechanism import BEYOND
from tools.family_three.nominal import LAW_DEGREE, WIDTH_DEGREE
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Values = FloatArray | float
PLAIN = 0.003  # deg rms: what polynomials may leave of the law; twice that of the width
CONTACTS = 16  # that slip in turn, where the onset is smooth


@dataclass
class Ask:
    """The motor over time, and what causes make of a healthy mechanism."""

    q: FloatArray
    rub: Values = 1.0  # times the friction
    pull: Values = 0.0  # torque at the tip, of the spring's at the limit
    law: Values = 0.0  # relative change of the drive's geometry
    tissue: Values = 0.0  # stiffness of an obstacle at first touch, of the spring's
    tissue_at: float = 0.0  # deg
    tissue_side: float = 1.0
    tissue_hardens: float = 0.0  # 1/deg
    spread: FloatArray | None = None  # share of the friction whose thresholds are scattered
    drag: FloatArray | None = None  # s, at `drag_gap`
    drag_gap: float = 1.0  # deg
    drag_index: float = 1.0  # of the fluid: shear stress goes with this power of the rate
    pins: FloatArray | None = None  # deg: where the tip holds until that far behind
    ring: FloatArray | None = None  # deg of the tip that a rolled ring holds back
    ring_way: float = 1.0
    ring_rolls: float = 1.0  # deg of the tip

    @property
    def resisted(self) -> bool:
        return self.drag is not None or self.pins is not None or self.ring is not None


def asked(demand: Any) -> Ask:
    """What rides on the fourth family's demand."""
    ask: Ask = vars(demand).setdefault("asked", Ask(demand.q))
    return ask


class Mechanism:
    """x: the tip's angle, deg; u = x / limit. A subclass gives `shape`, `raw`, and what `moments` calls the spring."""

    unit: ClassVar[str] = "mm"
    arm: ClassVar[bool] = True  # a stiff arm seen from beside, else a bending section
    massive: ClassVar[bool] = False
    sluggish: ClassVar[bool] = False  # friction depends weakly on speed
    widths: ClassVar[Range]
    most_friction: ClassVar[float] = 0.5
    limit: float

    def __init__(self, rng: np.random.Generator) -> None:
        self.weak, self.weak_speed = 0.0, 1.0
        while True:
            self.f, self.zero = 0.0, 0.0
            self.shape(rng)
            self.xs = np.linspace(-BEYOND, BEYOND, 1401) * self.limit
            if self._settle(self.widths.draw(rng)):
                break
        self.turn = 2 * self.reach / float(rng.uniform(2.5, 7.0))

    def shape(self, rng: np.random.Generator) -> None:
        """Draws dimensions and the limit."""
        raise NotImplementedError

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        """The motor's place at which the tip at x slides; f > 0 up, f < 0 down."""
        raise NotImplementedError

    def _settle(self, width_deg: float) -> bool:
        """Solves for the friction that gives a width in the middle; whether a plain hysteresis comes of it."""
        e = 0.01 * self.limit
        per_deg = float(self.raw(e, 0.0, 0.0, 0.0) - self.raw(-e, 0.0, 0.0, 0.0)) / (2 * e)

        def wide(f: float) -> float:
            return float(self.raw(0.0, f, 0.0, 0.0) - self.raw(0.0, -f, 0.0, 0.0)) / per_deg - width_deg

        if not (per_deg > 0 and wide(self.most_friction) > 0):
            return False
        self.f, self.width_deg = float(brentq(wide, 0.0, self.most_friction)), width_deg
        self.zero = 0.5 * float(self.need(0.0, 1.0) + self.need(0.0, -1.0))
        up, down = self.need(self.xs, 1.0), self.need(self.xs, -1.0)
        mean, apart = 0.5 * (up + down), up - down
        low, high = np.interp([-self.limit, self.limit], self.xs, mean).tolist()
        self.reach, self.width = 0.5 * (high - low), float(np.interp(0, self.xs, apart))
        rising = np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0) and np.all(apart > 0)
        if not rising or max(up[0], -down[-1]) > -1.05 * self.reach:
            return False
        place, inside = mean / self.reach, np.abs(mean) < 1.05 * self.reach
        law = chebyshev.chebfit(place[inside], self.xs[inside], LAW_DEGREE)
        gap = chebyshev.chebfit(place[inside], apart[inside], WIDTH_DEGREE)
        off = self.xs[inside] - chebyshev.chebval(place[inside], law)
        other = (apart[inside] - chebyshev.chebval(place[inside], gap)) / per_deg
        return float(np.std(off)) < PLAIN and float(np.std(other)) < 2 * PLAIN

    def need(self, x: Any, way: float, rub: Values = 1.0, pull: Values = 0.0, law: Values = 0.0) -> Any:
        """The motor's place at which the tip at x slides up (way 1) or down (-1)."""
        return self.raw(x, way * self.f * rub, pull, law) - self.zero

    def tip(self, x: FloatArray) -> FloatArray:
        return x

    def slope(self) -> float:
        """deg of the tip for a unit of q, in the middle."""
        e = 0.01 * self.limit
        return 2 * e / float(self.need(e, 1.0) - self.need(-e, 1.0))

    def farthest(self) -> float:
        """deg of the tip that the motor's range reaches."""
        high = np.interp(self.reach, self.need(self.xs, 1.0), self.xs)
        return float(max(high, -np.interp(-self.reach, self.need(self.xs, -1.0), self.xs)))

    def run(self, demand: Any) -> FloatArray:
        """The tip over time."""
        ask = asked(demand)
        if self.sluggish:
            slow = np.exp(-np.abs(np.gradient(ask.q, STEP)) / self.weak_speed)
            ask.rub = ask.rub * (1 + self.weak * slow)
        low, high = self.inverted(ask, 1.0), self.inverted(ask, -1.0)
        start = 0.5 * float(low[0] + high[0])
        if ask.spread is not None:
            middle, half = 0.5 * (low + high), 0.5 * (high - low)
            share = -np.log1p(-(np.arange(CONTACTS) + 0.5) / CONTACTS)
            ways = [half * (1 + ask.spread * (s - 1)) for s in share / share.mean()]
            low = high = np.asarray(np.mean([play(middle - w, middle + w, start) for w in ways], axis=0))
        return resisted(low, high, start, ask) if ask.resisted else np.asarray(play(low, high, start))

    def pressed(self, ask: Ask, x: FloatArray) -> Values:
        """Torque beside the spring: what is hung on, and tissue that stiffens exponentially (Fung)."""
        if isinstance(ask.tissue, float):
            return ask.pull
        deep = np.maximum(ask.tissue_side * x - ask.tissue_at, 0.0)
        grown = np.expm1(np.minimum(ask.tissue_hardens * deep, 3.0)) / ask.tissue_hardens
        return np.asarray(ask.pull + ask.tissue_side * ask.tissue * grown / self.limit)

    def inverted(self, ask: Ask, way: float) -> FloatArray:
        """The tip's place on a branch at each instant: secants, kept within brackets."""
        table = self.need(self.xs, way)
        x = np.interp(ask.q, table, self.xs)
        if all(isinstance(v, float) for v in (ask.rub, ask.pull, ask.law, ask.tissue)):
            return np.asarray(x)
        slope = np.interp(x, self.xs, np.gradient(table, self.xs))
        low, high = np.full(x.size, self.xs[0]), np.full(x.size, self.xs[-1])
        before: FloatArray | None = None
        last = x
        for _ in range(40):
            off = self.need(x, way, ask.rub, self.pressed(ask, x), ask.law) - ask.q
            low, high = np.where(off < 0, x, low), np.where(off < 0, high, x)
            if float(np.max(np.abs(off))) < 1e-7 * self.reach or float(np.max(high - low)) < 1e-7:
                break
            if before is not None:
                moved = x - last
                use = np.abs(moved) > 1e-9
                secant = (off - before) / np.where(use, moved, 1.0)
                slope = np.where(use & (secant > 0), secant, slope)
            new = x - off / slope
            new = np.where((new > low) & (new < high), new, 0.5 * (low + high))
            before, last, x = off, x, np.where(np.abs(off) < 1e-9 * self.reach, x, new)
        return np.asarray(x)


def resisted(low: FloatArray, high: FloatArray, start: float, ask: Ask) -> FloatArray:
    """The sliding stepped: a fluid slows it, pins hold it until they give, a rolled ring holds it one way."""
    n, zero = low.size, np.zeros(low.size)
    drag, pins = zero if ask.drag is None else ask.drag, zero if ask.pins is None else ask.pins
    ring, way = zero if ask.ring is None else ask.ring, ask.ring_way
    rest = ask.drag_gap ** (1 - 1 / ask.drag_index)
    out, x, wound = np.empty(n), start, 1.0
    rows = zip(low.tolist(), high.tolist(), drag.tolist(), pins.tolist(), ring.tolist(), strict=True)
    for k, (a, b, slow, pin, hold) in enumerate(rows):
        if hold > 0:
            a, b = (a - hold * wound, b) if way > 0 else (a, b + hold * wound)
        gap = a - x if x < a else b - x if x > b else 0.0
        size = abs(gap)
        if size > pin:
            if slow > 0:
                size = min(size * -math.expm1(-STEP / slow), rest * size ** (1 / ask.drag_index) * STEP / slow)
            gone = size if gap > 0 else -size
            x += gone
            wound = min(max(wound - way * gone / ask.ring_rolls, 0.0), 1.0)
        out[k] = x
    return out


__all__ = ["BEYOND", "Ask", "FloatArray", "Mechanism", "Values", "asked", "play"]
