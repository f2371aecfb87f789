"""Huber's cost: squares of residuals up to a limit, linear beyond, so that outliers pull no fit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from tautline import spread

Array = npt.NDArray[np.float64]

_OUTLIER = 6.0  # tolerance: robust standard deviations beyond which Huber's cost is linear
_RARE, _ABOVE_RARE = 0.01, 1.2  # tolerance: share of residuals that may be outliers, factor over the largest other one
_NO_DIVISOR = 1e-12  # tolerance: px or deg: keeps a division finite


def huber_cost(residuals: Sequence[Array], limits: Sequence[float], relative_noise: Sequence[float]) -> float:
    """Twice Huber's cost, summed over all recordings: r^2 up to the recording's limit L, 2 L |r| - L^2 beyond it,
    divided by the square of its relative noise. residuals: (scored, k) of each recording. As each recording has its own
    limit, one that fits badly throughout does not count as an outlier beside the others."""
    total = 0.0
    for residual, limit, times in zip(residuals, limits, relative_noise, strict=True):
        size = np.abs(residual)
        total += float(np.sum(np.where(size < limit, size**2, 2 * limit * size - limit**2))) / times**2
    return total


def outlier_limit(residual: Array) -> float:
    """The limit of Huber's cost for the residuals of one recording, px or deg: _OUTLIER robust standard deviations, but
    at least _ABOVE_RARE times the size that a share _RARE of them exceeds, so that a misfit after every reversal still
    counts in full. 1 without residuals."""
    if residual.size == 0:
        return 1.0
    largest = _ABOVE_RARE * float(np.quantile(np.abs(residual), 1.0 - _RARE))
    return max(_OUTLIER * spread.deviation(residual), largest)


def huber_weight(residual: Array, limit: float) -> Array:
    """The weight of each residual in iteratively reweighted least squares: 1 up to the limit, limit / |r| beyond it."""
    limit = max(limit, _NO_DIVISOR)
    return np.asarray(limit / np.maximum(np.abs(residual), limit))
