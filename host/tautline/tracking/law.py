"""What may have changed since the calibration, and the play that it makes of the model's."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.model import Model, allowed_width

Array = npt.NDArray[np.float64]

PLACES = 7  # of the measured range, at which B may have changed by itself
OFFSET, SCALE, SHAPE, SPREAD, SKEW = 0, 1, slice(2, 2 + PLACES), 2 + PLACES, 3 + PLACES
PARAMETERS = 4 + PLACES
_LOTS = 5  # elements that a single play is split into where its onset has become gradual
_LEAST_SCALE, _MOST_SCALE = 0.02, 5.0
_LEAST_SHAPE, _MOST_SHAPE = -0.9, 4.0


def unchanged() -> Array:
    """The calibrated law: theta (PARAMETERS,) of offset (unit of q, added to it), scale of B, its shape (further shares
    of B at PLACES), spread of the elements' shares about their mean and its skew."""
    theta = np.zeros(PARAMETERS)
    theta[SCALE] = 1.0
    return theta


@dataclass(frozen=True)
class Play:
    """The play of one theta. `native` runs it; B is `width` on the model's grid."""

    native: Any
    width: Array


@dataclass(frozen=True)
class Nominal:
    """The calibrated play, of which others are made."""

    model: Model
    _kept: dict[bytes, Play] = field(default_factory=dict, repr=False)

    @cached_property
    def hats(self) -> Array:
        """(PLACES, nodes): 1 at a place, 0 at its neighbours, held beyond the ends."""
        places = self.places
        return np.array([np.interp(self.model.q, places, row) for row in np.eye(PLACES)])

    @cached_property
    def places(self) -> Array:
        low, high = self.model.measured
        if not high > low:
            low, high = float(self.model.q[0]), float(self.model.q[-1])
        return np.linspace(low, high, PLACES)

    @cached_property
    def _lots(self) -> tuple[Array, Array, Array]:
        """Shares, their deviations from the mean and weights of elements whose spread can change."""
        elements = self.model.elements
        if elements.single:
            away = (2.0 * np.arange(_LOTS) - _LOTS + 1) / _LOTS
            return np.ones(_LOTS), away, np.full(_LOTS, 1.0 / _LOTS)
        share = np.array(elements.width)
        return share, share - 1.0, np.array(elements.weight)

    def shares(self, theta: Array) -> Array:
        share, away, weight = self._lots
        return np.maximum(share + theta[SPREAD] * away + theta[SKEW] * (away**2 - weight @ away**2), 0.0)

    def lawful(self, theta: Array) -> Array:
        """The nearest theta that a play can have."""
        theta = theta.copy()
        theta[SCALE] = min(max(theta[SCALE], _LEAST_SCALE), _MOST_SCALE)
        theta[SHAPE] = np.clip(theta[SHAPE], _LEAST_SHAPE, _MOST_SHAPE)
        least = 0.0 if self.model.elements.single else -0.95
        theta[SPREAD] = min(max(theta[SPREAD], least), 1.0)
        theta[SKEW] = min(max(theta[SKEW], -0.6), 0.6)
        return theta

    def play(self, theta: Array) -> Play:
        """theta must be lawful. Cheap where it was asked for lately."""
        key = theta.tobytes()
        if key not in self._kept:
            if len(self._kept) > 8:
                self._kept.clear()
            self._kept[key] = self._made(theta)
        return self._kept[key]

    def _made(self, theta: Array) -> Play:
        model = self.model
        around = 1.0 + theta[SHAPE] @ self.hats
        width = allowed_width(model.q, theta[SCALE] * model.width * around)
        basis = np.vstack([model.width * around, theta[SCALE] * model.width * self.hats])
        share, away, weight = self._lots
        if model.elements.single and not theta[SPREAD] and not theta[SKEW]:
            spread = np.zeros((2, 1))
            return Play(_native.TrackModel(model.q, width, np.ones(1), np.ones(1), basis, spread), width)
        spread = np.vstack([away, away**2 - weight @ away**2])
        shares = self.shares(theta)
        shares = shares / (weight @ shares)  # B stays the distance between full strokes
        return Play(_native.TrackModel(model.q, width, shares, weight, basis, spread), width)

    def gradual_start(self, theta: Array) -> Array:
        """theta with a little spread: derivatives by it exist only where there are several elements."""
        theta = theta.copy()
        if self.model.elements.single and theta[SPREAD] < 0.1:
            theta[SPREAD] = 0.2
        return theta

    def ratio(self, theta: Array, low: float, high: float) -> float:
        """The least of B over the calibrated one, between the centre coordinates low and high."""
        inside = (self.model.q >= low) & (self.model.q <= high) & (self.model.width > 0.0)
        if not inside.any():
            return float(theta[SCALE])
        return float(np.min(self.play(theta).width[inside] / self.model.width[inside]))
