"""A curve over the motor's range that an effect adds to one of a model's tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.model import Model
from tautline.splines import Basis

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class RangeSpline:
    """A cubic spline of `pieces` equal pieces over the motor's range, constant beyond it. Its coefficients are the
    effect's parameters PREFIX_0, PREFIX_1 and so on, in the unit of the curve that it is added to."""

    prefix: str
    pieces: int

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the pieces + 3 coefficients, in order."""
        return tuple(f"{self.prefix}_{i}" for i in range(self.pieces + 3))

    def on_grid(self, model: Model, values: Mapping[str, float]) -> Array:
        """(grid,) The curve's values at the nodes of the model's tables; coefficients that are not in `values` are
        0."""
        return self._basis(model).table(np.array([values.get(name, 0.0) for name in self.names]), model.q)

    def slopes(self, model: Model, p: Array) -> dict[str, Array]:
        """{name of a coefficient: (n,) derivative of the curve by it at the places p (n,), unit of q}. Interpolated
        linearly between the nodes of the model's tables, as the curve itself is."""
        return dict(zip(self.names, self._basis(model).between(model.q, p).T, strict=True))

    def _basis(self, model: Model) -> Basis:
        """The basis of this spline, with its pieces evenly spread over the motor's range."""
        return Basis(*model.rig.actuator.range, self.pieces)
