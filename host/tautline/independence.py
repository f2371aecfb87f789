"""Effective sample size: how many residuals tell as much as one independent one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import cache

import numpy as np
import numpy.typing as npt

from tautline import _native

Array = npt.NDArray[np.float64]

MEMORIES = np.linspace(0.0, 0.9, 37)  # tolerance: from one frame to the next
_MOST_ALIKE = 0.999  # tolerance: correlation of neighbours: more would make all frames one


def frames_each(
    residuals: Array,
    longest: int,
    *,
    least: float = -np.inf,
    window: float = np.inf,
    group: npt.NDArray[np.int_] | None = None,
) -> float:
    """How many correlated residuals, (n,) or (n, channels), tell as much as one independent one: 1 + 2 sum of rho(lag),
    the autocorrelation; 1 at least. The sum begins at lag 1 and ends at `longest`, at the first rho below `least`, or
    at a lag of `window` times half of 1 + 2 sum so far, the correlation length (Sokal). group (n,): if given, only
    pairs of the same group are multiplied."""
    power = float(np.sum(residuals**2))
    if power <= 0.0:
        return 1.0
    total = 1.0
    for lag in range(1, min(longest, len(residuals) - 1) + 1):
        product = residuals[lag:] * residuals[:-lag]
        rho = float(np.sum(product if group is None else product[group[lag:] == group[:-lag]])) / power
        if rho < least:
            break
        total += 2.0 * rho
        if lag >= window * 0.5 * total:
            break
    return max(total, 1.0)


def stretches(mask: npt.NDArray[np.bool_]) -> list[slice]:
    """The slices of consecutive elements at which a mask (n,) is true, in order."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(int)))
    return [slice(first, end) for first, end in edges.reshape(-1, 2).tolist()]


def first_order(residuals: Array) -> float:
    """As `frames_each` of residuals (n,) or (n, channels), but from the correlation rho of neighbours alone, as if the
    autocorrelation fell as rho^lag: (1 + rho) / (1 - rho). It is for a fit that is not finished: longer correlations
    are then what is still to be fitted."""
    power = max(float(np.sum(residuals**2)), 1e-30)
    alike = float(np.clip(np.sum(residuals[1:] * residuals[:-1]) / power, 0.0, _MOST_ALIKE))
    return (1.0 + alike) / (1.0 - alike)


def less_its_trend(t: Array, values: Array, order: int = 1) -> Array:
    """values (n, k) at times t (n,) less the polynomial of this order that fits them best, for each of the k
    columns."""
    trend = _orthonormal(t, order)
    return np.asarray(values - trend @ (trend.T @ values))


def remembered(rests: Sequence[Array], order: int = 1) -> tuple[float, float]:
    """Fits first-order autoregressive noise. Returns its correlation from one frame to the next, and its standard
    deviation. rests: readings of several rests, (n, k) frames by channels each, less a trend of this order
    (`less_its_trend`). Taking off a trend removes slow noise as well, and so more of correlated than of white noise;
    both results are corrected for that (`expected_sums`)."""
    count: Counter[int] = Counter()
    for rest in rests:
        count[len(rest)] += rest.shape[1]
    squares = sum(float(np.sum(rest**2)) for rest in rests)
    follows = sum(float(np.sum(rest[1:] * rest[:-1])) for rest in rests) / max(squares, 1e-300)
    expected = np.sum([many * expected_sums(n, order) for n, many in count.items()], axis=0)  # (2, memories)
    unsure = 1.0 / np.sqrt(expected[0, 0])  # standard error of `follows`, taken off: no more memory than is shown
    memory = float(np.interp(follows - unsure, np.maximum.accumulate(expected[1] / expected[0]), MEMORIES))
    return memory, float(np.sqrt(squares / np.interp(memory, MEMORIES, expected[0])))


@cache
def expected_sums(n: int, order: int = 1) -> Array:
    """(2, len(MEMORIES)) For n samples of first-order autoregressive noise of variance 1, less their trend of this
    order: the expected sum of squares, and of products of neighbours, for each correlation rho of MEMORIES."""
    trend = _orthonormal(np.arange(n, dtype=float), order)
    # Noise x, of covariance C = rho^|i - j|, less its trend is (I - P) x, P = trend trend^T. C trend is the sum of two
    # recursions, from either end, which both count the diagonal.
    both_ways = np.hstack([trend, trend[::-1]])
    sums = np.stack([first_order_sums(both_ways, rho) for rho in MEMORIES])
    covered = sums[:, :, : order + 1] + sums[:, ::-1, order + 1 :] - trend  # C trend, (memories, n, order + 1)
    of_trend = trend.T @ covered
    neighbours = trend[:-1] * covered[:, 1:] + covered[:, :-1] * trend[1:] - (trend[:-1] @ of_trend) * trend[1:]
    squares = n - np.trace(of_trend, axis1=1, axis2=2)
    return np.array([squares, (n - 1) * MEMORIES - np.sum(neighbours, axis=(1, 2))])


def first_order_sums(values: Array, rho: float) -> Array:
    """The recursion y[k] = values[k] + rho y[k - 1] along the first axis of values (n, ...), y being 0 before the
    first; same shape."""
    sums = np.array(values, dtype=float, order="C")
    _native.first_order_sums(sums.reshape(len(sums), int(np.prod(sums.shape[1:]))), rho)
    return sums


def _orthonormal(t: Array, order: int) -> Array:
    """(n, order + 1) Orthonormal columns that span the polynomials of this order over times t (n,)."""
    span = max(float(t[-1] - t[0]), 1e-300)
    return np.asarray(np.linalg.qr(np.vander(2.0 * (t - t[0]) / span - 1.0, order + 1, increasing=True))[0])
