"""Mechanisms with one place x that friction holds. Each says which motor position holds it there: `need`.

`need(x, s, torque)` is the motor's place at which the body at x is about to move up (s = 1) or down (s = -1); in
between it sticks. Friction that is not the healthy one comes as |s| != 1. `torque` pulls the body back, in units that
cost the motor one healthy width.
"""

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from tools.family_two.friction import Feel, walk
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Number = FloatArray | float
GRID = 4001


@dataclass
class Demand:
    """What a run asks of a mechanism, by instant. Causes change it; as it comes it is the healthy one."""

    q: FloatArray
    friction: FloatArray
    torque: FloatArray
    spread: FloatArray  # of the contacts' thresholds, 0 to 1; nan: as healthy
    feel: Feel = field(default_factory=Feel)
    wall: tuple[float, FloatArray] | None = None  # its place and stiffness over the transmission's
    stribeck: FloatArray | None = None

    @classmethod
    def healthy(cls, q: FloatArray) -> "Demand":
        one = np.ones(q.size)
        return cls(q.copy(), one, np.zeros(q.size), np.full(q.size, np.nan))


class Mechanism:
    unit: ClassVar[str]
    arm: ClassVar[bool] = True  # a stiff arm on a pivot; else a section that bends
    massive: ClassVar[bool] = False  # has mass: some causes of the massless ones make no sense
    reach: float
    limit: float  # of x
    friction: float
    unit_torque: float = 1.0  # of `torque`, in the mechanism's own unit
    width: float  # healthy, in the middle, in units of the motor
    half: float  # of the healthy sticking interval, in units of x
    xs: FloatArray

    def __init__(self, rng: np.random.Generator) -> None:
        raise NotImplementedError

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        raise NotImplementedError

    def tip(self, x: FloatArray) -> FloatArray:
        """Angle of the tip, deg, of the body's place."""
        return x

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        """Weight and threshold of the contacts that share the motion; thresholds in shares of the healthy one."""
        return [(0.25, 1 - spread), (0.5, 1.0), (0.25, 1 + spread)] if spread > 0 else [(1.0, 1.0)]

    def finish(self, width_deg: float) -> None:
        """Friction such that the middle loses `width_deg` of the tip; reach, torque unit and tables follow."""
        middle = np.zeros(1)

        def miss(friction: float) -> float:
            self.friction = friction
            wide = self.need(middle, 1.0) - self.need(middle, -1.0)
            return float(wide[0]) * self.slope() - width_deg

        high = 1e-4
        while miss(high) < 0 and high < 1e6:
            high *= 1.5
        self.friction = float(brentq(miss, 0.0, high, rtol=1e-12))
        self.unit_torque = 1.0
        self.width = width_deg / self.slope()
        x = np.array([-0.02, 0.02]) * self.limit
        rate = float(np.diff(self.need(x, 0.0))[0] / np.diff(x)[0])
        self.half = 0.5 * self.width / rate
        e = 1e-3
        by_one = float((self.need(middle, 0.0, e) - self.need(middle, 0.0, -e))[0]) / (2 * e)
        self.unit_torque = self.width / by_one
        ends = np.array([-self.limit, self.limit])
        self.reach = float(min(self.need(ends[1:], 1.0)[0], -self.need(ends[:1], -1.0)[0]))
        self.xs = np.linspace(-1.35, 1.35, GRID) * self.limit

    def slope(self) -> float:
        """deg of the tip for a unit of the motor, in the middle."""
        x = np.array([-0.02, 0.02]) * self.limit
        q, c = self.need(x, 0.0), self.tip(x)
        return float((c[1] - c[0]) / (q[1] - q[0]))

    def edge(self, d: Demand, s: FloatArray) -> FloatArray:
        """Where need(x, s) is the motor's place: Newton from a table, each instant with its own demand."""
        sign = 1.0 if s[0] > 0 else -1.0
        x = np.interp(d.q, self.need(self.xs, sign), self.xs)
        if d.wall is None and np.all(s == sign) and np.all(d.torque == 0):
            return x
        h = 1e-4 * self.limit
        low, high = float(self.xs[0]), float(self.xs[-1])
        for _ in range(6):
            miss = self._loaded(x, s, d) - d.q
            rate = (self._loaded(x + h, s, d) - miss - d.q) / h
            step = miss / rate
            x = np.clip(x - step, low, high)
            if np.max(np.abs(step)) < 1e-7 * self.limit:
                break
        return x

    def _loaded(self, x: FloatArray, s: FloatArray, d: Demand) -> FloatArray:
        torque = d.torque
        if d.wall is not None:
            place, stiff = d.wall
            beyond = np.maximum(x - place, 0.0) if place > 0 else np.minimum(x - place, 0.0)
            torque = torque + stiff * beyond / (self.slope() * self.width)
        return self.need(x, s, torque)

    def run(self, d: Demand) -> FloatArray:
        """Angle of the tip at each instant, deg."""
        total = np.zeros(d.q.size)
        spread = np.nan_to_num(d.spread)
        usual = self.contacts(0.0)
        there = self.contacts(float(spread.max())) if np.any(spread > 0) else usual
        if len(usual) != len(there):
            usual = [(weight, 1.0) for weight, _ in there]
        for (weight, share), (_, before) in zip(there, usual, strict=True):
            half = d.friction * np.where(spread > 0, share, before)
            lo, hi = self.edge(d, half), self.edge(d, -half)
            start = float(0.5 * (lo[0] + hi[0]))
            total += weight * walk(lo, hi, start, d.feel.scaled(self.half, self.limit), STEP)
        return self.tip(total)
