"""The several plays of a board that come nearest to a hysteresis, on loops of all sizes, and how far off they are."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares, nnls
from scipy.special import softmax

from tautline import _native
from tautline.elements import SINGLE, Elements, Hysteresis, Play, warp_of

Array = npt.NDArray[np.float64]

_SHARES = np.concatenate([np.linspace(0.1, 2.0, 20), [2.3, 2.7, 3.2]])  # tolerance: of B, to begin with
_FIRST = 0.05  # loss: least weight of the first: the inverse is at most 20 times as steep
_STROKES, _FULL, _ANYWHERE = 100, 0.2, 0.4  # prior: of use; shares of the strokes from end to end, and to any place
_SMALLEST = 0.2  # prior: of B, a stroke: the others have any size from there to the range, alike in its logarithm
_SAMPLES = 24  # tolerance: of the loops, a backlash
_STRICT = 1e3  # tolerance: how much more than the data the two sums weigh
_SLIGHT = 1e-3  # tolerance: a weight that is none
_STEPS = 15  # tolerance: of the search for shares and weights, at most
_FAR = 10.0  # tolerance: times a path's reach: the ends of a table that is as wide everywhere
_GAPS = -9.0, 2.0  # tolerance: logarithms between which differences of shares are
_PLAYS: int = _native.TABLE_PLAYS_MAX


@dataclass(frozen=True)
class Nearest:
    """The plays that come nearest to a hysteresis, and how near they are on the loops that they were fitted to."""

    elements: Elements
    left: float  # rms of how far they are off on these loops, unit of q
    undoes: float  # rms of what there is to undo: motor less tip

    @property
    def share(self) -> float:
        """What these plays leave, over what there is to undo: 0 is exact, 1 as bad as no compensation."""
        return self.left / max(self.undoes, 1e-300)


def nearest_plays(grid: Array, width: Array, hysteresis: Hysteresis, reached: tuple[float, float]) -> Nearest:
    """The plays nearest to a hysteresis, by least squares on loops of all sizes between the two ends `reached`, unit of
    q, and how far they are off. First the weights are fitted at fixed widths, then both. A single play where there is
    no backlash. grid, width (n,): the table of B, unit of q."""
    if not np.any(width > 0.0):
        return Nearest(SINGLE, left=0.0, undoes=0.0)
    q = _test_motion(grid, width, reached)
    p = Play(grid, width, hysteresis).forward(q)
    warp = warp_of(grid, width, Play(grid, width).narrow)
    half = 0.5 * np.interp(p, grid, width)
    # In the warp a play is equally wide everywhere: its centre there is the middle of the images of its two ends.
    y = 0.5 * (np.interp(p + half, warp.q, warp.x) + np.interp(p - half, warp.q, warp.x))
    elements = _fitted_elements(np.interp(q, warp.q, warp.x), y)
    off = Play(grid, width, elements).forward(q) - p
    left, undoes = (float(np.sqrt(np.mean(each**2))) for each in (off, q - p))
    return Nearest(elements, left=left, undoes=undoes)


def _test_motion(grid: Array, width: Array, reached: tuple[float, float]) -> Array:
    """(n,) Motor positions, unit of q, of a random motion between the two ends `reached`: full strokes, strokes to
    anywhere and small loops of all sizes, with _SAMPLES positions for each mean width of B. Its seed is fixed: each
    call gives the same motion. grid, width (n,): the table of B."""
    low, high = reached
    usual = float(np.mean(width[(grid >= low) & (grid <= high)]))
    rng = np.random.default_rng(0x100B)
    turns = [low, high, low]
    for _ in range(_STROKES):
        kind = rng.uniform()
        if kind < _FULL:
            to = high if turns[-1] < 0.5 * (low + high) else low
        elif kind < _FULL + _ANYWHERE:
            to = float(rng.uniform(low, high))
        else:
            size = np.exp(rng.uniform(np.log(_SMALLEST * usual), np.log(high - low)))
            to = float(np.clip(turns[-1] + rng.choice([-1.0, 1.0]) * size, low, high))
        turns.append(to)
    pieces = [
        np.linspace(a, b, max(2, int(abs(b - a) / usual * _SAMPLES)), endpoint=False)
        for a, b in itertools.pairwise(turns)
    ]
    return np.concatenate(pieces)


def _elements_response(x: Array, share: Array) -> Array:
    """(n, m) The centre coordinates of m plays, of the constant widths `share` (m,), along motor positions x (n,) in
    the warp; each play starts at its centre."""
    far = _FAR * float(np.abs(x).max() + share.max())
    ends = np.array([-far, far])
    return np.column_stack([_native.Plays(ends, np.full(2, one)).forward(x, float(x[0]))[0] for one in share])


def _fitted_elements(x: Array, y: Array) -> Elements:
    """Fits elements whose weighted mean is nearest to the tip y (n,) along the motor's path x (n,), both in the warp,
    where B is 1; the first has a weight of at least _FIRST. Non-negative weights are fitted first, at the widths
    _SHARES, with two more rows that hold their sum and the mean width to 1; from the merged result (`merged_elements`)
    widths and weights are fitted together."""
    sums = _STRICT * np.vstack([np.ones(len(_SHARES)), _SHARES])
    rows = np.vstack([_elements_response(x, _SHARES) - x[:, None], sums])
    weights = nnls(rows, np.concatenate([y - x, [_STRICT, _STRICT]]))[0]
    start = merged_elements(_SHARES[weights > _SLIGHT], weights[weights > _SLIGHT])
    n = len(start.width)
    gaps = np.diff(start.width, prepend=0.0)
    begin = np.concatenate([np.log(gaps), np.log(np.array(start.weight) - _FIRST * (np.arange(n) == 0) + _SLIGHT)])

    def parts(unknowns: Array) -> tuple[Array, Array]:
        """Widths (m,), whose mean is 1, and weights (m,), whose sum is 1, by unconstrained unknowns (2 m,): logarithms
        of the differences between widths, which rise so, and logarithms of the weights beyond _FIRST, up to a common
        factor."""
        weight = softmax(unknowns[n:]) * (1.0 - _FIRST) + _FIRST * (np.arange(n) == 0)
        share = np.cumsum(np.exp(np.clip(unknowns[:n], *_GAPS)))
        return share / float(weight @ share), weight

    def off(unknowns: Array) -> Array:
        """(n,) The weighted mean of the plays that these unknowns stand for, less y."""
        share, weight = parts(unknowns)
        return np.asarray(_elements_response(x, share) @ weight - y)

    share, weight = parts(least_squares(off, begin, max_nfev=_STEPS).x)
    weight = weight / weight.sum()
    return Elements(tuple((share / float(weight @ share)).tolist()), tuple(weight.tolist()))


def merged_elements(width: Array, weight: Array) -> Elements:
    """At most _PLAYS elements in place of many, width (m,) rising with their weight (m,): each replaces a run of
    neighbours by their mean, and the runs are those within which widths scatter least. The first has a weight of at
    least _FIRST. Weights are scaled to sum 1, widths to mean 1."""
    weight = weight / weight.sum()
    sums = np.array([np.concatenate([[0.0], np.cumsum(weight * width**k)]) for k in range(3)])
    ends = _least_scatter_runs(sums)
    # Of each run: the sums of its weights, and of its weights times widths.
    parts = [(sums[:, j] - sums[:, i])[:2] for i, j in itertools.pairwise(ends)]
    means = np.array([first / w for w, first in parts])
    shares = np.array([w for w, _ in parts])
    keep = np.concatenate([[True], np.diff(means) > 1e-9])
    shares = np.add.reduceat(shares, np.flatnonzero(keep))
    means = means[keep]
    shares /= shares.sum()
    means /= shares @ means
    return Elements(tuple(means.tolist()), tuple(shares.tolist()))


def _least_scatter_runs(sums: Array) -> tuple[int, ...]:
    """The ends of the runs, from 0 on, into which n sorted widths are divided: at most _PLAYS runs with the least
    weighted sum of squares about their means, found by dynamic programming; the first has a weight of at least _FIRST.
    sums (3, n + 1): cumulative sums of weight, weight times width, and weight times width^2."""
    n = sums.shape[1] - 1

    def scatter(i: int, j: int) -> float:
        """Weighted sum of squares about their mean of the widths from i to before j."""
        w, first, second = sums[:, j] - sums[:, i]
        return float(second - first * first / w)

    # By (runs, end of the last): the least scatter, and the ends of the runs that have it.
    best: dict[tuple[int, int], tuple[float, tuple[int, ...]]] = {(0, 0): (0.0, (0,))}
    for runs in range(1, _PLAYS + 1):
        for end in range(1, n + 1):
            tried = [
                (cost + scatter(begin, end), (*ends, end))
                for begin in range(runs - 1, end)
                if (known := best.get((runs - 1, begin))) is not None
                for cost, ends in (known,)
                if runs > 1 or sums[0, end] >= _FIRST  # the weight of the first run
            ]
            if tried:
                best[runs, end] = min(tried)
    return min(best[runs, n] for runs in range(1, _PLAYS + 1) if (runs, n) in best)[1]
