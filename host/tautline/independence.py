"""Effective sample size: how many residuals tell as much as one independent one."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def frames_each(
    residuals: Array,
    longest: int,
    *,
    least: float = -np.inf,
    window: float = np.inf,
    group: npt.NDArray[np.int_] | None = None,
) -> float:
    """1 + 2 sum of the autocorrelation of residuals (n,) or (n, channels), 1 at least, over at most `longest` lags: to
    the first below `least`, or to `window` times the correlation length found so far (Sokal). Only what has the same
    `group` (n,), in order, goes together."""
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


def first_order(residuals: Array) -> float:
    """As `frames_each` for an autocorrelation that falls geometrically, from neighbours alone: for a fit that is not
    finished, whose longer correlations are what is still to be fitted."""
    power = max(float(np.sum(residuals**2)), 1e-30)
    alike = float(np.clip(np.sum(residuals[1:] * residuals[:-1]) / power, 0.0, 0.999))
    return (1.0 + alike) / (1.0 - alike)
