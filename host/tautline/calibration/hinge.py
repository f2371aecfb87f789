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
from typing import Self

import numpy as np
import numpy.typing as npt

from tautline import _native

Array = npt.NDArray[np.float64]

_KNOTS, _NARROWED = 33, 6  # tolerance: candidates at once; how often these come closer together, at most
_REACH = 6.0  # tolerance: standard deviations of the knot, as far as the next candidates reach
_PIECES = 10  # tolerance: of the path, in each of which its second derivative is constant
_BENDS = 7  # tolerance: values of its standard deviation, evenly in its logarithm
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


@dataclass(frozen=True)
class _Paths:
    """The best paths for K candidate knots and V values of the bending's standard deviation."""

    deviance: Array  # (K, V) noise as large as the residuals say, but not below the stated one
    chi2: Array  # (K, V) of the residual
    used: Array  # (K, V) effective parameters in each channel; (0, V) if not asked for
    slope: Array  # (K, V, channels) after the knot, over the window
    jump: Array  # (K, V, channels) at the knot; (0, V, channels) without


@dataclass(frozen=True)
class _Window:
    """The frames of one stroke, and the priors of a path through them."""

    x: Array  # (n,) travel
    y: Array  # (n, channels) of unit variance, from its first value on
    precision: Array  # (V, columns) of each bend's coefficients
    jump: bool

    @classmethod
    def of(cls, x: Array, y: Array, *, jump: bool = False) -> Self:
        """The window of travel x (n,) and whitened y (n, channels), with the priors of _BENDS paths from straight to
        bent. jump: with one more column, a jump at the knot."""
        centred = y - y[:1]
        swing = max(float(np.sqrt(np.max(np.sum(centred**2, axis=1)))), 1.0)
        bends = np.geomspace(_LEAST_BEND, _MOST_BEND * swing, _BENDS)
        precision = np.full((_BENDS, 2 + _PIECES + jump), _FLAT)
        precision[:, 1] = (_MOST_BEND * swing) ** -2
        precision[:, 2 : 2 + _PIECES] = bends[:, None] ** -2
        return cls(x, centred, precision, jump)

    def paths(self, knots: Array, *, used_too: bool = False) -> _Paths:
        """The best path from each of the knots (K,), in the unit of x, for each bending prior. Deviance: hinge.h."""
        told = _native.hinge(self.x, self.y, knots, self.precision, self.jump, _SPREAD, _BACKWARDS, used_too=used_too)
        return _Paths(*told)


def _moments(knots: Array, deviance: Array) -> tuple[float, float]:
    """Posterior mean and standard deviation of the knot on the grid knots (K,), summed over the bending priors;
    deviance (K, bends)."""
    weight = np.exp(-0.5 * (deviance - deviance.min())).sum(axis=1)
    mean = float(weight @ knots / weight.sum())
    return mean, float(np.sqrt(weight @ (knots - mean) ** 2 / weight.sum()))


def fit_hinge(x: Array, y: Array, high: float) -> Hinge:
    """The posterior of the knot, within [0, high], of y (n, channels) at motor travel x (n,) since the turn. The grid
    of candidate knots narrows until it resolves the posterior."""
    knots = np.linspace(0.0, high, _KNOTS)
    window = _Window.of(x, y)
    paths = window.paths(knots)
    mean, spread = _moments(knots, paths.deviance)
    for _ in range(_NARROWED):  # towards the likelihood's bulk, whatever its width
        pitch = knots[1] - knots[0]
        reach = max(_REACH * spread, 3.0 * pitch)
        closer = np.linspace(max(0.0, mean - reach), min(high, mean + reach), _KNOTS)
        if spread > 2.0 * pitch or closer[-1] - closer[0] < 1e-9 * (high + 1e-12):
            break
        knots, paths = closer, window.paths(closer)
        mean, spread = _moments(knots, paths.deviance)
    k, v = (int(i) for i in np.unravel_index(np.argmin(paths.deviance), paths.deviance.shape))
    used = float(window.paths(knots[k : k + 1], used_too=True).used[0, v])
    freedom = max(1.0, (len(x) - used) * y.shape[1] - 1.0)
    slope = paths.slope[k, v] / max(float(x.max()), 1e-12)
    return Hinge(mean, spread, float(paths.deviance[k, v]), float(paths.chi2[k, v]), freedom, slope)


def fit_jump(x: Array, y: Array, high: float, knot: float = 0.0) -> Jump:
    """The best jump, between neighbouring frames with x within [0, high] (and from 0 to the first of them),
    followed by a free path. Its bracket reaches from the first to the last one whose deviance is within _CREDIBLE of
    the best. Tried are _KNOTS of them evenly, those around the best hinge's knot, and all around what may be the jump.
    x (n,), y (n, channels); deviance inf where no frames bracket it."""
    edges = np.unique(np.append(x, 0.0))
    edges = edges[(edges >= 0.0) & (edges <= high)]
    if len(edges) < 2:
        return Jump(0.0, high, 0.0, np.inf)
    window, middles = _Window.of(x, y, jump=True), 0.5 * (edges[1:] + edges[:-1])
    stride = max(len(middles) // _KNOTS, 1)
    each, sizes = np.full(len(middles), np.inf), np.zeros(len(middles))
    wanted = np.zeros(len(middles), dtype=bool)
    wanted[::stride] = True
    wanted[max(np.searchsorted(middles, knot) - 1, 0) :][:2] = True
    near = np.flatnonzero(wanted)
    while (anew := np.flatnonzero(wanted & np.isinf(each))).size:
        paths = window.paths(middles[anew])
        best = np.argmin(paths.deviance, axis=1)
        each[anew] = paths.deviance[np.arange(len(anew)), best]
        sizes[anew] = np.linalg.norm(paths.jump[np.arange(len(anew)), best], axis=1)
        near = np.flatnonzero(each < each.min() + _CREDIBLE)
        for k in near:
            wanted[max(k - stride, 0) : k + stride] = True
    best_of_all = int(np.argmin(each))
    return Jump(float(edges[near[0]]), float(edges[near[-1] + 1]), float(sizes[best_of_all]), float(each[best_of_all]))
