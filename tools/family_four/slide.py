"""What friction makes of a sticking interval [low, high] over time: play, ageing contacts, drag, a mass."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Feel:
    """What resists the sliding besides Coulomb's friction. Lengths are the tip's, deg."""

    drag: FloatArray | None = None  # s: viscous drag over stiffness
    stick: FloatArray | None = None  # breakaway above kinetic friction after a long rest
    age: float = 0.2  # s in which a contact at rest gains 63 % of it
    nap: FloatArray | None = None  # breakaway one way, after sliding the other way
    way: float = 1.0
    worn: float = 1.0  # sliding in which the nap lies down by 63 %
    seed: int = 0


def play(low: FloatArray, high: FloatArray, start: float) -> FloatArray:
    """min(max(x, low), high), instant by instant."""
    x, out = start, []
    for a, b in zip(low.tolist(), high.tolist(), strict=True):
        if x < a:
            x = a
        elif x > b:
            x = b
        out.append(x)
    return np.array(out)


def slide(low: FloatArray, high: FloatArray, start: float, feel: Feel, step: float) -> FloatArray:
    """The same where contacts age while at rest, a nap resists one way and a drag delays.

    A contact that rests for d holds stick (1 - exp(-d / age)) more; each has its own strength. What moves slower than
    stick / age goes in jumps, what is faster glides.
    """
    zero = np.zeros(low.size)
    part = 1 - np.exp(-step / np.maximum(zero if feel.drag is None else feel.drag, 1e-9))
    stick = (zero if feel.stick is None else feel.stick).tolist()
    nap = (zero if feel.nap is None else feel.nap).tolist()
    strengths = np.random.default_rng(feel.seed).uniform(0.5, 1.5, 997).tolist()
    aged = (1 - np.exp(-np.arange(low.size + 1) * step / feel.age)).tolist()
    x, out, rest, broken, lying = start, [], 0, 0, 1.0
    for k, (a, b, p) in enumerate(zip(low.tolist(), high.tolist(), part.tolist(), strict=True)):
        hold = stick[k] * strengths[broken % 997] * aged[rest + 1]  # a step old at least
        up = nap[k] * lying if feel.way > 0 else 0.0
        down = nap[k] * lying if feel.way < 0 else 0.0
        before = x
        if x < a - up - hold:
            x += p * (a - up - x)
        elif x > b + down + hold:
            x += p * (b + down - x)
        moved = x - before
        if moved:
            broken += rest > 1
            rest = 0
            lying = lying * math.exp(-abs(moved) / feel.worn) if moved * feel.way > 0 else 1.0
        else:
            rest += 1
        out.append(x)
    return np.array(out)


def heavy(low: FloatArray, high: FloatArray, start: float, rate: float, damping: FloatArray, step: float) -> FloatArray:
    """A mass on a spring: x'' / w^2 + 2 z x' / w + x = low while it moves up, high while down; friction holds at rest.

    Exact within a step for the branch held over it.
    """
    kinds, which = np.unique(damping, return_inverse=True)
    moves = [free(2 * np.pi * rate, float(z), step) for z in kinds]
    x, v, out = start, 0.0, []
    for a, b, kind in zip(low.tolist(), high.tolist(), which.tolist(), strict=True):
        way = v if v else (x < a) * 1.0 - (x > b) * 1.0
        if way:
            xx, xv, vx, vv = moves[kind]
            rest = a if way > 0 else b
            x, v = rest + xx * (x - rest) + xv * v, vx * (x - rest) + vv * v
            if v * way <= 0:
                v = 0.0
        out.append(x)
    return np.array(out)


def free(w: float, z: float, step: float) -> tuple[float, float, float, float]:
    """State transition of x'' + 2 z w x' + w^2 x = 0 over a step; overdamped as well."""
    root = np.emath.sqrt(z * z - 1) * w + 1e-9
    e, cosh = np.exp(-z * w * step), np.cosh(root * step)
    sinh = np.sinh(root * step) / root
    return tuple(float(np.real(e * m)) for m in (cosh + z * w * sinh, sinh, -w * w * sinh, cosh - z * w * sinh))  # type: ignore[return-value]


def iwan(power: float, rounded: float, count: int = 16) -> list[tuple[float, float]]:
    """Shares and thresholds (of the width) of Segalman's joint.

    Thresholds up to rounded of the width off it are distributed by a power law; their mean is 1: so is the loop's.
    """
    edges = np.linspace(0, 1, count + 1)
    shares = np.diff(edges ** (power + 1))
    places = 0.5 * (edges[1:] + edges[:-1])
    spread = (places - shares @ places) / max(1 - shares @ places, shares @ places)
    return list(zip(shares.tolist(), (1 + rounded * spread).tolist(), strict=True))
