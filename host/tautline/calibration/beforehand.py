"""What is known of B before anything is recorded: a multivariate Student t of its logarithm at places.

-2 log p(b) = (nu + k) log(1 + d^2 / nu), d^2 = (log D b - m)' S^-1 (log D b - m): where a robot is far off what is
usual its weight (nu + k) / (nu + d^2) falls, and S counts as that much wider.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tautline.splines import Basis
from tautline.value import Value

Array = npt.NDArray[np.float64]

_LEAST = 1e-3  # tolerance: of the usual B: less has no logarithm that says more


@dataclass(frozen=True, eq=False, repr=False)
class Beforehand(Value):
    """q (k,) rising; mean (k,) and scale matrix (k, k) of log B there, B in the unit of q; degrees of freedom."""

    q: Array
    mean: Array
    scale: Array
    freedom: float

    @cached_property
    def _precision(self) -> Array:
        return np.asarray(np.linalg.inv(self.scale))

    def usual(self, q: Array) -> Array:
        """The usual B at any q."""
        return np.asarray(np.exp(np.interp(q, self.q, self.mean)))

    def term(self, basis: Basis, coefficients: Array) -> tuple[Array, Array, float]:
        """Of coefficients (m,) on a basis: matrix (m, m) and gradient (m,) of half of -2 log p, the weight held; and
        -2 log p itself."""
        design = basis.design(self.q).toarray()
        width = np.maximum(design @ coefficients, _LEAST * np.exp(self.mean))
        off = np.log(width) - self.mean
        pulled = self._precision @ off
        far = float(off @ pulled)
        size = len(self.q)
        weight = (self.freedom + size) / (self.freedom + far)
        told = (self.freedom + size) * float(np.log1p(far / self.freedom))
        by_coefficient = design / width[:, None]
        return (
            weight * (by_coefficient.T @ self._precision @ by_coefficient),
            weight * (by_coefficient.T @ pulled),
            told,
        )
