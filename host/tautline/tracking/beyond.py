"""What use shows of f_remain and B beyond the range that the calibration measured: there its tables are a guess.

An offset moves the tip to such places. The guess is the mean of a prior: both curves bend as they do where they were
measured, from their ends on. Each frame there tells more, given the law in use (Kalman's update).
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
    """theta (2 CURVES,) ~ N(mean, covariance): what is added to f_remain, deg, then to B, unit of q."""

    model: Model  # as calibrated, on a grid that goes on
    mean: Array
    covariance: Array

    @classmethod
    def unseen(cls, model: Model) -> Self:
        """The prior, before frames showed anything there: means 0; standard deviations of slope and curvature are those
        by which each curve varies from place to place where it was measured."""
        if not model.measured[1] > model.measured[0]:  # one place, or none: nothing is beyond it
            model = replace(model, measured=(float(model.q[0]), float(model.q[-1])))
        low, high = model.measured
        span = float(model.q[-1] - model.q[0])
        further = np.linspace(0.0, _REACH * span, _NODES + 1)[1:]
        grid = np.concatenate([model.q[0] - further[::-1], model.q, model.q[-1] + further])
        width, width_sigma = (np.interp(grid, model.q, values) for values in (model.width, model.width_sigma))
        c_sigma = None if model.c_sigma is None else np.interp(grid, model.q, model.c_sigma)
        on = replace(model, q=grid, width=width, width_sigma=width_sigma, c_deg=model.remaining(grid), c_sigma=c_sigma)
        places = np.linspace(low, high, PLACES)
        step = places[1] - places[0]
        slopes = (np.diff(np.interp(places, model.q, values)) / step for values in (model.c_deg, model.width))
        # Of slope and of curvature: the same below and above.
        sigma = [(np.std(slope), np.std(np.diff(slope)) / step) * 2 for slope in slopes]
        return cls(on, np.zeros(2 * CURVES), np.diag(np.square(np.concatenate(sigma))))

    def curves(self, p: npt.ArrayLike) -> Array:
        """(CURVES, n) Distance, unit of q, and half its square below the measured range, then above it, at centre
        coordinates p (n,); 0 within it."""
        low, high = self.model.measured
        below, above = np.maximum(low - np.asarray(p), 0.0), np.maximum(np.asarray(p) - high, 0.0)
        return np.stack([below, 0.5 * below**2, above, 0.5 * above**2])

    @cached_property
    def on_grid(self) -> Array:
        """(CURVES, nodes) `curves` at the nodes of the model's grid."""
        return self.curves(self.model.q)

    @cached_property
    def known(self) -> Model:
        """The model with the posterior mean added beyond the measured range."""
        if not self.mean.any():
            return self.model
        more = self.mean.reshape(2, CURVES) @ self.on_grid
        c_deg, width = self.model.c_deg + more[0], self.model.width + more[1]
        return replace(self.model, c_deg=self.monotone(c_deg), width=allowed_width(self.model.q, width))

    def monotone(self, c_deg: Array) -> Array:
        """c_deg (nodes,) made monotone as calibrated, outwards from the middle of the measured range: where one end
        would turn back it is level, and what is nearer to the middle stays."""
        model = self.model
        rise = model.c_deg[-1] - model.c_deg[0]
        least = _LEVEL * np.abs(rise) / len(c_deg) * np.arange(len(c_deg))
        straight = np.sign(rise) * c_deg - least
        middle = int(np.searchsorted(model.q, 0.5 * (model.measured[0] + model.measured[1])))
        up = np.maximum.accumulate(straight[middle:])
        down = np.minimum.accumulate(straight[: middle + 1][::-1])[::-1]
        return np.asarray(np.sign(rise) * (np.concatenate([down[:-1], up]) + least))

    def updated(self, by: Array, off: Array, sigma: Array) -> Beyond:
        """The posterior after n frames (one Kalman update): off (n,), the angle seen less the one predicted, deg; sigma
        (n,); by (n, 2 CURVES), the prediction's derivatives by theta. Outliers weigh less."""
        spread = np.sqrt(np.einsum("ni,ij,nj->n", by, self.covariance, by) + sigma**2)
        precise = np.minimum(1.0, OUTLYING * spread / np.maximum(np.abs(off), 1e-300)) / sigma**2
        weighted = by.T * precise
        covariance = np.linalg.solve(np.eye(len(by.T)) + self.covariance @ (weighted @ by), self.covariance)
        covariance = 0.5 * (covariance + covariance.T)
        return replace(self, mean=self.mean + covariance @ (weighted @ off), covariance=covariance)
