"""What use shows of f_remain (bending angle over the play's centre coordinate) and B (the play's width) beyond the
range that the calibration measured, where its tables are a guess.

An offset moves the tip to such places. The guess is the mean of a prior; how surely it is known follows from how much
both curves bend where they were measured. Each frame there tells more, given the law in use (Kalman's update).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
import numpy.typing as npt

from tautline.model import Model, allowed_width

Array = npt.NDArray[np.float64]

CURVES = 4  # prior: of either table: linear and quadratic below what was measured, the same above
PLACES = 12  # prior: of the measured range, at which its curves bend, and B may have changed by itself
_NODES = 96  # tolerance: on either side: what is bent is within a fifth of a camera's noise of lines between so many
_LEVEL = 1e-6  # tolerance: of the mean slope: f_remain's least, as it is asked for p
_REACH = 0.5  # limit: of the grid, on either side of it: further than an offset takes the tip
OUTLYING = 4.0  # prior: standard deviations from which a frame counts as an outlier, and tells less (Huber's cost)


@dataclass(frozen=True)
class Beyond:
    """Corrections of a model beyond its measured range, theta (2 CURVES,) ~ N(mean, covariance): factors of `curves`,
    first of those that are added to f_remain, deg, then of those that are added to B, unit of q."""

    model: Model  # as calibrated, on a grid that goes on
    mean: Array
    covariance: Array

    @classmethod
    def prior(cls, model: Model) -> Self:
        """Returns the prior, before frames showed anything there. Its means are 0; the standard deviations of slope and
        curvature are those by which each curve's slope varies over PLACES places of the measured range. The grid of the
        model is continued by _REACH of its span on either side. A model that was measured at one place or none counts
        as measured on its whole grid."""
        if not model.measured[1] > model.measured[0]:  # one place, or none: nothing is beyond it
            model = replace(model, measured=(float(model.q[0]), float(model.q[-1])))
        low, high = model.measured
        span = float(model.q[-1] - model.q[0])
        distance = np.linspace(0.0, _REACH * span, _NODES + 1)[1:]  # of the new nodes from the end of the grid
        grid = np.concatenate([model.q[0] - distance[::-1], model.q, model.q[-1] + distance])
        width, width_sigma = (np.interp(grid, model.q, values) for values in (model.width, model.width_sigma))
        c_sigma = None if model.c_sigma is None else np.interp(grid, model.q, model.c_sigma)
        c_deg = model.remaining(grid)
        longer = replace(model, q=grid, width=width, width_sigma=width_sigma, c_deg=c_deg, c_sigma=c_sigma)
        places = np.linspace(low, high, PLACES)
        step = places[1] - places[0]
        slopes = (np.diff(np.interp(places, model.q, values)) / step for values in (model.c_deg, model.width))
        # Of slope and of curvature of f_remain, then of B: each pair once for below the range, once for above it.
        sigma = [(np.std(slope), np.std(np.diff(slope)) / step) * 2 for slope in slopes]
        return cls(longer, np.zeros(2 * CURVES), np.diag(np.square(np.concatenate(sigma))))

    def curves(self, p: npt.ArrayLike) -> Array:
        """Basis of the corrections, (CURVES, n), at centre coordinates p (n,), unit of q. With x, the distance from the
        measured range (0 within it), its rows are x and x^2 / 2 below the range, then x and x^2 / 2 above it."""
        low, high = self.model.measured
        below, above = np.maximum(low - np.asarray(p), 0.0), np.maximum(np.asarray(p) - high, 0.0)
        return np.stack([below, 0.5 * below**2, above, 0.5 * above**2])

    @cached_property
    def curves_on_grid(self) -> Array:
        """(CURVES, nodes) `curves` at the nodes of the model's grid."""
        return self.curves(self.model.q)

    @cached_property
    def posterior_model(self) -> Model:
        """The model with the mean corrections added to f_remain, kept monotone, and to B, kept within what a width can
        be (`allowed_width`)."""
        if not self.mean.any():
            return self.model
        added = self.mean.reshape(2, CURVES) @ self.curves_on_grid
        c_deg, width = self.model.c_deg + added[0], self.model.width + added[1]
        return replace(self.model, c_deg=self.monotone(c_deg), width=allowed_width(self.model.q, width))

    def monotone(self, c_deg: Array) -> Array:
        """Returns a table c_deg (nodes,), deg, of f_remain made monotone in the calibrated direction. From the middle
        of the measured range outwards, a node that turns back is set level with the one before it, but for _LEVEL of
        the mean slope, as f_remain is inverted; all other nodes stay."""
        model = self.model
        rise = model.c_deg[-1] - model.c_deg[0]
        least = _LEVEL * np.abs(rise) / len(c_deg) * np.arange(len(c_deg))
        straight = np.sign(rise) * c_deg - least  # as if rising; where it does not fall, c_deg rises by the least slope
        middle = int(np.searchsorted(model.q, 0.5 * (model.measured[0] + model.measured[1])))
        up = np.maximum.accumulate(straight[middle:])
        down = np.minimum.accumulate(straight[: middle + 1][::-1])[::-1]
        return np.asarray(np.sign(rise) * (np.concatenate([down[:-1], up]) + least))

    def updated(self, slopes: Array, residual: Array, sigma: Array) -> Beyond:
        """Returns the posterior after n frames, one Kalman update: P' = (1 + P H^T W H)^-1 P, mean' = mean + P' H^T W
        r. slopes H (n, 2 CURVES): derivatives of the predicted angles by theta; residual r (n,): angle seen less the
        one predicted, deg; sigma (n,), deg: its standard deviation by noise alone. W = 1 / sigma^2, less for outliers,
        of more than OUTLYING standard deviations (Huber)."""
        # Standard deviations of the residuals by theta and noise: what is more than OUTLYING of them is an outlier.
        spread = np.sqrt(np.einsum("ni,ij,nj->n", slopes, self.covariance, slopes) + sigma**2)
        weight = np.minimum(1.0, OUTLYING * spread / np.maximum(np.abs(residual), 1e-300)) / sigma**2
        weighted = slopes.T * weight
        covariance = np.linalg.solve(np.eye(len(slopes.T)) + self.covariance @ (weighted @ slopes), self.covariance)
        covariance = 0.5 * (covariance + covariance.T)  # symmetric in spite of rounding
        return replace(self, mean=self.mean + covariance @ (weighted @ residual), covariance=covariance)
