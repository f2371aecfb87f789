"""Change-point models of one stroke: y is level, then from a knot on (`fit_hinge`), or after a jump (`fit_jump`),
follows a path over the motor's travel x since the turn. The knot is where the image begins to move.

The path's shape is not known: f_remain, and B where it is steep, bend it. Its slope is a Wiener process over the travel
(the prior of a cubic smoothing spline), whose variance is unknown as well and summed over. The prior of its first slope
is log-normal about its mean slope: else what creeps before the onset is taken for a slow start. So a path that bends
within the few frames of a quick stroke widens the knot's posterior and does not move it.

Deviance is -2 log likelihood but for a constant. y is whitened: of unit noise, (n, channels).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline import _native

Array = npt.NDArray[np.float64]

_PIECES = 10  # tolerance: of the path, in each of which its second derivative is constant
_EVENLY = np.linspace(0.0, 1.0, 7)  # tolerance: values of its standard deviation, in its logarithm
_LEAST_BEND, _MOST_BEND = 0.3, 2.0  # prior: over the window: of the noise, nothing is seen of it; of the whole swing
_SPREAD = 0.5  # prior: of the logarithm of the start's slope over the path's mean slope
_BACKWARDS = 1e-3  # tolerance: a start against the path counts as this share of it
_CREDIBLE = 9.0  # prior: of the deviance, three standard deviations: what is no farther off may be the jump
_FLAT = 1e-9  # tolerance: precision of what is fitted, in whitened units over the window


@dataclass(frozen=True)
class Hinge:
    """A fitted hinge: the knot's posterior mean and standard deviation, in the unit of x."""

    knot: float
    sigma: float
    deviance: float  # at its best
    chi2: float  # sum of squared residuals of the best path
    freedom: float  # their degrees of freedom
    slope: Array  # (channels,) of whitened y per unit of x, just after the knot


@dataclass(frozen=True)
class Jump:
    """A fitted jump of unknown size: the onset is bracketed by two frames."""

    low: float  # travel of the last still frame, in the unit of x
    high: float  # of the first moving one
    size: float  # of the jump, in sigma
    deviance: float


def _native_hinge(x: Array, y: Array, *, jump: bool = False) -> _native.Hinge:
    """Prepares frames for the native fits: travel x (n,), whitened y (n, channels) less its first frame, and the
    priors: standard deviations of the path's bend from straight (_LEAST_BEND, in noises) to bent (_MOST_BEND times y's
    swing), evenly spaced in their logarithm. jump: adds a jump at the knot as an unknown."""
    centred = y - y[:1]
    swing = max(float(np.sqrt(np.max(np.sum(centred**2, axis=1)))), 1.0)
    bends = _LEAST_BEND * (_MOST_BEND * swing / _LEAST_BEND) ** _EVENLY
    steep = (_MOST_BEND * swing) ** -2  # prior precision of the path's slope over the window
    return _native.Hinge(x, centred, _PIECES, jump, _FLAT, steep, bends**-2, _SPREAD, _BACKWARDS)


def fit_hinge(x: Array, y: Array, high: float) -> Hinge:
    """The hinge: the posterior of its knot, within [0, high], for whitened y (n, channels) at motor travel x (n,), unit
    of q, since the turn."""
    knot, sigma, deviance, chi2, used, slope = _native_hinge(x, y).knot(high)
    # `used`: effective number of the path's parameters, for each channel; one more for the knot.
    freedom = max(1.0, (len(x) - used) * y.shape[1] - 1.0)
    return Hinge(knot, sigma, deviance, chi2, freedom, slope / max(float(x.max()), 1e-12))


def fit_jump(x: Array, y: Array, high: float, knot: float = 0.0) -> Jump:
    """The best jump of whitened y (n, channels), followed by a free path, between neighbouring frames with travel x
    (n,) within [0, high]; the bracket before the first of them begins at 0. The result's bracket reaches from the first
    to the last one whose deviance is within _CREDIBLE of the best. The search tries evenly spaced brackets, those
    around the best hinge's knot, and all near the ones that may be the jump. Deviance inf if no frames bracket it."""
    edges = np.unique(np.append(x, 0.0))
    edges = edges[(edges >= 0.0) & (edges <= high)]
    if len(edges) < 2:
        return Jump(0.0, high, 0.0, np.inf)
    around = max(int(np.searchsorted(0.5 * (edges[1:] + edges[:-1]), knot)) - 1, 0)
    each, sizes = _native_hinge(x, y, jump=True).jumps(edges, around, _CREDIBLE)
    best = int(np.argmin(each))
    near = np.flatnonzero(each < each[best] + _CREDIBLE)
    return Jump(float(edges[near[0]]), float(edges[near[-1] + 1]), float(sizes[best]), float(each[best]))
