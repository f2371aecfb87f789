"""What follows from sticking intervals: a tip that stays where it is while it can, and what resists it besides.

At each instant friction holds the tip anywhere between `low` (where it slides up) and `high` (where it slides down).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def project(low: FloatArray, high: FloatArray, start: float) -> FloatArray:
    """x[k] = x[k-1] clipped to [low[k], high[k]]. Clips in a row are one clip, so blocks go side by side."""
    n = low.size
    rows = max(int(np.sqrt(n)), 1)
    columns = -(-n // rows)
    pad = rows * columns - n
    below = np.pad(low, (0, pad), "edge").reshape(rows, columns).T.copy()
    above = np.pad(high, (0, pad), "edge").reshape(rows, columns).T.copy()
    for k in range(1, columns):  # below[k], above[k]: the clip of a block's first k + 1 instants
        first, last = below[k - 1].copy(), above[k - 1].copy()
        np.clip(first, below[k], above[k], out=first)
        np.clip(last, below[k], above[k], out=last)
        below[k], above[k] = first, last
    begin, x = np.empty(rows), start
    for row, (a, b) in enumerate(zip(below[-1].tolist(), above[-1].tolist(), strict=True)):
        begin[row] = x
        x = min(max(x, a), b)
    return np.clip(begin[None, :], below, above).T.ravel()[:n]


@dataclass
class Feel:
    """What resists the sliding besides Coulomb's friction; arrays over time, None where it is not there."""

    drag: FloatArray | None = None  # s: the time constant of viscous drag
    square: FloatArray | None = None  # s^2 for a deg: what is left behind, for each (deg/s)^2
    stick: FloatArray | None = None  # deg: breakaway above kinetic friction, each time it has come to rest
    scatter: FloatArray | None = None  # of the breakaways, one after the other
    hold: float = 0.0  # deg/s below which it comes to rest
    extra: FloatArray | None = None  # deg: breakaway one way, that wears off with sliding
    wears: float = 1.0  # deg
    way: int = 1

    @property
    def any(self) -> bool:
        return any(v is not None for v in (self.drag, self.square, self.stick, self.extra))


def walk(low: FloatArray, high: FloatArray, start: float, feel: Feel, step: float) -> FloatArray:
    """The same as `project`, step by step, with what a `Feel` holds."""
    if feel.way < 0:
        turned = Feel(**{**vars(feel), "way": 1})
        return -walk(-high, -low, -start, turned, step)
    n, zeros = low.size, np.zeros(low.size)
    share = (
        zeros + 1 if feel.drag is None else np.where(feel.drag > 0, -np.expm1(-step / np.maximum(feel.drag, 1e-9)), 1)
    )
    square = (zeros if feel.square is None else feel.square).tolist()
    stick = (zeros if feel.stick is None else feel.stick).tolist()
    extra = (zeros if feel.extra is None else feel.extra).tolist()
    scatter = [1.0] if feel.scatter is None else feel.scatter.tolist()
    x, moving, more, number, slow = start, 0, 1.0, 0, feel.hold * step
    out = []
    for lo, hi, a, c, s, e in zip(low.tolist(), high.tolist(), share.tolist(), square, stick, extra, strict=True):
        lo -= e * more
        if x < lo:
            d, way = lo - x, 1
        elif x > hi:
            d, way = x - hi, -1
        else:
            moving = 0
            out.append(x)
            continue
        if s > 0 and (way != moving or d < slow):
            if d < s * scatter[number % len(scatter)]:
                moving = 0
                out.append(x)
                continue
            number += 1
        d *= a
        if c > 0:
            d = min(d, step * (d / c) ** 0.5)
        moving = way
        x += way * d
        if e > 0:
            more = more * np.exp(-d / feel.wears) if way > 0 else min(1.0, more + d / feel.wears)
        out.append(x)
    assert len(out) == n
    return np.array(out)


def heavy(low: FloatArray, high: FloatArray, start: float, rate: float, damping: FloatArray, step: float) -> FloatArray:
    """A mass on a spring under Coulomb's friction: x'' / w^2 + 2 z x' / w + x = low (high) while it moves up (down).

    Within a step the motion is the free oscillator's, exactly, about where the branch ends in that step.
    """
    w = 2 * np.pi * rate
    moves = {z: _free(w, z, step) for z in np.unique(damping).tolist()}
    x, v = start, 0.0
    out = []
    for lo, hi, z in zip(low.tolist(), high.tolist(), damping.tolist(), strict=True):
        if v == 0.0:
            if lo <= x <= hi:
                out.append(x)
                continue
            way = 1 if x < lo else -1
        else:
            way = 1 if v > 0 else -1
        aim = lo if way > 0 else hi
        a, b, c, d = moves[z]
        off = x - aim
        x, new = aim + a * off + b * v, c * off + d * v
        v = 0.0 if new * way <= 0 and lo <= x <= hi else new
        out.append(x)
    return np.array(out)


def _free(w: float, z: float, step: float) -> tuple[float, float, float, float]:
    """What a step makes of (place, speed) of an oscillator at rest at 0; also where it is damped beyond critical."""
    root = np.sqrt(complex(z * z - 1))
    fast, slow = w * (-z + root), w * (-z - root)
    ef, es = np.exp(fast * step), np.exp(slow * step)
    between = fast - slow
    entries = ((fast * es - slow * ef), (ef - es), fast * slow * (es - ef), (fast * ef - slow * es))
    a, b, c, d = (float((e / between).real) for e in entries)
    return a, b, c, d
