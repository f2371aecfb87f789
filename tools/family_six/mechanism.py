"""What all mechanisms of this family share: two branches inverted at each instant, the tip clipped to between them."""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.family_four.causes.base import STEP, play
from tools.family_four.mechanism import BEYOND
from tools.family_six.ranges import Range

FloatArray = NDArray[np.float64]
PLAIN_DEG = 0.003  # deg rms that polynomials may leave of the law; twice that of the width
FRICTION = (1e-3, 0.6)  # in which the coefficient that gives the drawn width is looked for
ELEMENTS = 9  # that let go one after the other where the onset is smooth


@dataclass
class Ask:
    """What a mechanism is asked at each instant: arrays of the grid's size (n,), or numbers that hold throughout."""

    q: FloatArray  # mm or deg of the motor
    rub: Any = 1.0  # times the healthy friction
    push: Any = 0.0  # torque at the tip, of the spring's at the limit
    law: Any = 0.0  # relative change of a dimension of the drive
    wall: Any = 0.0  # torque of an obstacle when it is pressed in by the whole limit
    wall_at: float = 0.0  # deg beyond which it is touched
    wall_side: float = 1.0
    spread: Any = 0.0  # scatter of the thresholds at which parts let go
    lip: Any = 0.0  # deg by which a lip holds the tip back until it has turned over
    lip_travel: float = 1.0  # deg of sliding in which it does
    lip_way: float = 1.0
    ridges: Any = 0.0  # deg of the largest jump
    pitch: float = 1.0  # deg between ridges
    glides: float = 1.0  # deg/s at and above which nothing sticks

    @property
    def plain(self) -> bool:
        """Whether the branches are the healthy ones."""
        healthy = ((self.rub, 1.0), (self.push, 0.0), (self.law, 0.0), (self.wall, 0.0))
        return all(np.ndim(v) == 0 and v == w for v, w in healthy)


def asked(d: Any) -> Ask:
    """The question that a demand carries; the motor's path is in both."""
    if "six" not in vars(d):
        vars(d)["six"] = Ask(d.q)
    found: Ask = vars(d)["six"]
    return found


class Mechanism:
    """A spring-held tip, a drive that gives, friction where the tip slides. x in deg, u = x / limit."""

    unit: ClassVar[str] = "mm"
    arm: ClassVar[bool] = False
    massive: ClassVar[bool] = False
    sluggish: ClassVar[bool] = False
    widths: ClassVar[Range]
    limits: ClassVar[tuple[float, float]] = (40.0, 75.0)  # deg

    def __init__(self, rng: np.random.Generator) -> None:
        while True:
            self.limit = float(rng.uniform(*self.limits))
            self.hardens, self.leans = float(rng.uniform(0.0, 0.35)), float(rng.uniform(-0.2, 0.6))
            self.tilt = float(rng.uniform(-0.35, 0.35))
            self.width_deg = self.widths.draw(rng)
            self.f, self.middle = 0.0, 0.0
            self.draw(rng)
            self.xs = np.linspace(-BEYOND, BEYOND, 801) * self.limit
            if self._settle():
                break
        self.turn = float(rng.uniform(0.3, 0.8)) * self.reach

    def draw(self, rng: np.random.Generator) -> None:
        """Draws the dimensions."""

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        """Where the motor is when the tip slides at x (deg), f being signed by the way it slides."""
        raise NotImplementedError

    def spring(self, x: Any) -> Any:
        u = x / self.limit
        return (u + self.hardens * u**3) / (1 + self.hardens)

    def pressed(self, x: Any) -> Any:
        """How hard rubs what rubs, against the middle."""
        u = x / self.limit
        return 1 + self.leans * u * u + self.tilt * u

    def need(self, x: Any, way: float, rub: Any = 1.0, push: Any = 0.0, law: Any = 0.0) -> Any:
        return self.raw(x, way * self.f * rub, push, law) - self.middle

    def _settle(self) -> bool:
        """The friction that gives the drawn width, the range and whether all is plausible."""
        step = 1e-3 * self.limit
        self.middle = float(self.raw(0.0, 0.0, 0.0, 0.0))
        gain = float(self.raw(step, 0.0, 0.0, 0.0) - self.raw(-step, 0.0, 0.0, 0.0)) / (2 * step)

        def over(f: float) -> float:
            return float(self.raw(0.0, f, 0.0, 0.0) - self.raw(0.0, -f, 0.0, 0.0)) - gain * self.width_deg

        if gain <= 0 or over(FRICTION[0]) > 0 or not over(FRICTION[1]) > 0:
            return False
        self.f = float(brentq(over, *FRICTION))
        up, down = self.need(self.xs, 1.0), self.need(self.xs, -1.0)
        if not (np.all(np.isfinite(up + down)) and np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0)):
            return False
        if np.min(up - down) <= 0:
            return False
        self.reach = float(min(self.need(self.limit, 1.0), -self.need(-self.limit, -1.0)))
        self.width = float(self.need(0.0, 1.0) - self.need(0.0, -1.0))
        if self.width > 0.5 * self.reach:
            return False
        mean, inside = 0.5 * (up + down) / self.reach, np.abs(0.5 * (up + down)) < 1.02 * self.reach
        law, wide = self.xs[inside], (up - down)[inside] / gain
        off_law = law - chebyshev.chebval(mean[inside], chebyshev.chebfit(mean[inside], law, 7))
        off_wide = wide - chebyshev.chebval(mean[inside], chebyshev.chebfit(mean[inside], wide, 5))
        return bool(np.std(off_law) < PLAIN_DEG and np.std(off_wide) < 2 * PLAIN_DEG)

    def slope(self) -> float:
        """deg of the tip for a unit of q at the middle."""
        return float(np.interp(0.0, self.need(self.xs, 1.0), np.gradient(self.xs, self.need(self.xs, 1.0))))

    def farthest(self) -> float:
        ends = (np.interp(s * self.reach, self.need(self.xs, s), self.xs) for s in (1.0, -1.0))
        return float(max(abs(x) for x in ends))

    def tip(self, x: FloatArray) -> FloatArray:
        return x

    def inverted(self, a: Ask, way: float) -> FloatArray:
        """Where the tip slides one way for each q: by table where all is healthy, else from there by Newton."""
        far = self.xs[-1]
        x: FloatArray = np.interp(a.q, self.need(self.xs, way), self.xs)
        if a.plain:
            return x
        h = 1e-4 * self.limit
        for _ in range(8):
            here, there = (self.need(y, way, a.rub, a.push + obstacle(a, y, self.limit), a.law) for y in (x, x + h))
            step = np.clip((here - a.q) * h / np.maximum(there - here, 1e-12), -0.25 * far, 0.25 * far)
            x = np.clip(x - step, -far, far)
            if np.max(np.abs(step)) < 1e-6:
                break
        return x

    def run(self, d: Any) -> FloatArray:
        """The tip (n,) in deg."""
        a = asked(d)
        low, high = self.inverted(a, 1.0), self.inverted(a, -1.0)
        if np.any(np.asarray(a.spread) > 0):
            return parted(low, high, a.spread)
        if np.any(np.asarray(a.lip) > 0) or np.any(np.asarray(a.ridges) > 0):
            return held(low, high, a)
        return play(low, np.maximum(low, high), 0.5 * float(low[0] + high[0]))


def obstacle(a: Ask, x: FloatArray, limit: float) -> Any:
    """Torque of a ball pressed into something soft (Hertz): power 3/2 of the depth."""
    if np.ndim(a.wall) == 0 and a.wall == 0:
        return 0.0
    deep = np.maximum(a.wall_side * x - a.wall_at, 0.0) / limit
    return a.wall * a.wall_side * deep**1.5


def parted(low: FloatArray, high: FloatArray, spread: Any) -> FloatArray:
    """Parts of equal weight in parallel let go at thresholds of Weibull's law, whose mean stays."""
    mean, half = 0.5 * (low + high), 0.5 * (high - low)
    ranks = (np.arange(ELEMENTS) + 0.5) / ELEMENTS
    weakest = (-np.log(1 - ranks)) ** (1 / 0.8)
    scatter = weakest / weakest.mean() - 1
    out = np.zeros(low.size)
    for s in scatter:
        w = half * np.maximum(1 + spread * s, 0.0)
        out += play(mean - w, mean + w, float(mean[0])) / ELEMENTS
    return out


def held(low: FloatArray, high: FloatArray, a: Ask) -> FloatArray:
    """The same clipping with what holds besides: a lip that turns over, ridges between which the tip jumps."""
    n = low.size
    lip, ridges = (np.broadcast_to(np.asarray(v, float), n).tolist() for v in (a.lip, a.ridges))
    fast = [np.abs(np.gradient(v) / STEP) for v in (low, high)]
    sticks = np.maximum(1 - np.maximum(*fast) / a.glides, 0.0).tolist()
    lows, highs = low.tolist(), np.maximum(low, high).tolist()
    out, x, turned, way = np.empty(n), 0.5 * (lows[0] + highs[0]), 1.0, 0.0
    for k in range(n):
        to = min(max(x, lows[k]), highs[k])
        going = 1.0 if to > x else -1.0 if to < x else 0.0
        if lip[k] > 0 and going:
            if going != way and going == a.lip_way:
                turned = 0.0  # it lies the other way still
            way = going
            if going == a.lip_way and turned < 1:
                resists = lip[k] * (1 - turned) * (1 + 2 * turned)
                to = max(x, lows[k] - resists) if going > 0 else min(x, highs[k] + resists)
                turned = min(turned + abs(to - x) / a.lip_travel, 1.0)
        if ridges[k] > 0 and going:
            strong = ridges[k] * sticks[k] * (0.55 + 0.45 * np.sin(6.283 * x / a.pitch) * np.sin(10.166 * x / a.pitch))
            if abs(to - x) < strong:
                to = x
        out[k] = x = to
    return out


__all__ = ["BEYOND", "STEP", "Ask", "FloatArray", "Mechanism", "asked", "held", "obstacle", "parted"]
