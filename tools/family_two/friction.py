"""A body held by dry friction and driven through a compliant transmission: stepped through its sticking interval.

At each instant the balance of forces lets the body rest anywhere between `lo` (below it the drive pushes it up) and
`hi` (above it the drive pulls it down). The exact quasi-static motion is the projection onto that interval.
"""

from dataclasses import dataclass
from math import exp

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass
class Feel:
    """What more than Coulomb friction acts on the body, by instant.

    Lengths are in halves of the healthy sticking interval, and those of `braking` and `fastest` in the limit of the
    place, until `scaled` has made them places.
    """

    extra: FloatArray | None = None  # breakaway above kinetic friction when moving one way
    way: int = 1
    wears: float = 1.0  # sliding by which the extra falls to 1/e
    stick: FloatArray | None = None  # static above kinetic friction both ways, lost at once when it slides
    drag: FloatArray | None = None  # s, viscous drag over the transmission's stiffness
    braking: FloatArray | None = None  # deceleration by friction of a body with mass, place per s^2; inf: none coasts
    fastest: FloatArray | None = None  # place per s, down: a weak return spring
    catch: FloatArray | None = None  # by how much the drive must run ahead to free it where it is caught, moving up
    caught_at: float = 0.0

    @property
    def plain(self) -> bool:
        some = (self.extra, self.stick, self.drag, self.braking, self.fastest, self.catch)
        return all(x is None for x in some)

    def scaled(self, half: float, limit: float) -> "Feel":
        def by(values: FloatArray | None, unit: float) -> FloatArray | None:
            return None if values is None else values * unit

        return Feel(
            by(self.extra, half), self.way, self.wears * half, by(self.stick, half), self.drag,
            by(self.braking, limit), by(self.fastest, limit), by(self.catch, half), self.caught_at * limit,
        )  # fmt: skip


def project(lo: FloatArray, hi: FloatArray, start: float) -> FloatArray:
    out, p = [], start
    for low, high in zip(lo.tolist(), hi.tolist(), strict=True):
        if p < low:
            p = low
        elif p > high:
            p = high
        out.append(p)
    return np.array(out)


def walk(lo: FloatArray, hi: FloatArray, start: float, feel: Feel, step: float) -> FloatArray:
    if feel.plain:
        return project(lo, hi, start)
    if feel.braking is not None:
        return _coast(lo, hi, start, feel.braking, step)
    if feel.catch is not None:
        return _caught(lo, hi, start, feel.catch, feel.caught_at)
    if feel.fastest is not None:
        return _return(lo, hi, start, feel.fastest * step)
    if feel.way < 0:  # the same the other way up
        flipped = Feel(feel.extra, 1, feel.wears, feel.stick, feel.drag)
        return -_resist(-hi, -lo, -start, flipped, step)
    return _resist(lo, hi, start, feel, step)


def _resist(lo: FloatArray, hi: FloatArray, start: float, feel: Feel, step: float) -> FloatArray:
    """Breakaway that wears off as it slides up, sticking both ways, and drag."""
    none = np.zeros(lo.size)
    extra = none if feel.extra is None else feel.extra
    stick = none if feel.stick is None else feel.stick
    drag = none if feel.drag is None else feel.drag
    follow = np.where(drag > 0, 1 - np.exp(-step / np.maximum(drag, 1e-9)), 1.0)
    out, p, slid = [], start, 0.0
    each = zip(lo.tolist(), hi.tolist(), extra.tolist(), stick.tolist(), follow.tolist(), strict=True)
    moving = False
    for low, high, more, hold, share in each:
        if more:
            low -= more * exp(-slid / feel.wears)
        margin = 0.0 if moving and share < 1.0 else hold
        if p < low - margin:
            new = p + share * (low - p)
            slid += new - p
            p, moving = new, low - new > 0.02 * hold
        elif p > high + margin:
            p, moving = p + share * (high - p), p - high > 0.02 * hold
            slid = 0.0
        else:
            moving = False
        out.append(p)
    return np.array(out)


def _coast(lo: FloatArray, hi: FloatArray, start: float, braking: FloatArray, step: float) -> FloatArray:
    """A mass that runs on when its drive slows down, until friction or the other side of the interval stops it."""
    out, p, v = [], start, 0.0
    slows = np.minimum(braking * step, 1e9)
    for low, high, slow in zip(lo.tolist(), hi.tolist(), slows.tolist(), strict=True):
        v = max(v - slow, 0.0) if v > 0 else min(v + slow, 0.0)
        new = p + v * step
        new = low if new < low else high if new > high else new
        v = (new - p) / step
        p = new
        out.append(p)
    return np.array(out)


def _return(lo: FloatArray, hi: FloatArray, start: float, most: FloatArray) -> FloatArray:
    out, p = [], start
    for low, high, down in zip(lo.tolist(), hi.tolist(), most.tolist(), strict=True):
        if p < low:
            p = low
        elif p > high:
            p = max(high, p - down)
        out.append(p)
    return np.array(out)


def _caught(lo: FloatArray, hi: FloatArray, start: float, catch: FloatArray, place: float) -> FloatArray:
    """Something catches at one place on the way up, and lets go with a jump."""
    out, p, free = [], start, False
    for low, high, hold in zip(lo.tolist(), hi.tolist(), catch.tolist(), strict=True):
        if p < low:
            if hold and not free and p <= place < low:
                free = low > place + hold
                p = low if free else place
            else:
                p = low
        elif p > high:
            p = high
        if p < place - 0.5 * hold:
            free = False
        out.append(p)
    return np.array(out)
