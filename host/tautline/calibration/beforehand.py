"""What other robots tell before anything is recorded: how B's logarithm and the tip's path in the image are spread
between them, each as a multivariate Student t of values at places.

-2 log p(y) = (nu + k) log(1 + d^2 / nu), d^2 = (y - m)' S^-1 (y - m): where a robot is far off what is usual its weight
(nu + k) / (nu + d^2) falls, and S counts as that much wider.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
from scipy.linalg import null_space
from scipy.special import fdtrc

from tautline.splines import Basis
from tautline.value import Value

Array = npt.NDArray[np.float64]
Term = tuple[Array, Array, float]  # matrix (m, m) and gradient (m,) of half of -2 log p, the weight held; -2 log p

_SELDOM = 0.05  # prior: a curve as far off as so few of the others tells that it is none of them
_LEAST = 1e-3  # tolerance: of the usual B: less has no logarithm that says more


@dataclass(frozen=True, eq=False, repr=False)
class Spread(Value):
    """q (k,) rising; mean (k,) and scale matrix (k, k) there; degrees of freedom."""

    q: Array
    mean: Array
    scale: Array
    freedom: float

    @cached_property
    def precision(self) -> Array:
        """(k, k) inverse of the scale matrix."""
        return np.asarray(np.linalg.inv(self.scale))

    def term(self, value: Array, slope: Array) -> Term:
        """Matrix (m, m) and gradient (m,) of half of -2 log p by m coefficients, the t distribution's weight held, and
        -2 log p. value (k,): at the places; slope (k, m): its derivatives by the coefficients."""
        off = value - self.mean
        pulled = self.precision @ off
        far = float(off @ pulled)
        size = len(self.q)
        weight = (self.freedom + size) / (self.freedom + far)
        told = (self.freedom + size) * float(np.log1p(far / self.freedom))
        return weight * (slope.T @ self.precision @ slope), weight * (slope.T @ pulled), told

    def has(self, value: Array, noise: Array) -> bool:
        """Whether values (k,) at the places, with errors of covariance noise (k, k), may be one more of these: they are
        not farther off than all but a few of them."""
        off = value - self.mean
        far, size = float(off @ np.linalg.solve(self.scale + noise, off)), len(self.q)
        return bool(fdtrc(size, self.freedom, far / size) > _SELDOM)


@dataclass(frozen=True, eq=False, repr=False)
class Beforehand(Value):
    """Of log B, B in the unit of q; and of each coordinate of the path in the sensor's unit, where that is known."""

    width: Spread
    path: tuple[Spread, ...] = ()

    def usual(self, q: Array) -> Array:
        """The usual B (n,) at positions q (n,), both in the unit of q."""
        return np.asarray(np.exp(np.interp(q, self.width.q, self.width.mean)))

    def of_width(self, basis: Basis, coefficients: Array) -> Term:
        """The prior's Term, as Spread.term, of the logarithm of the B that a spline's coefficients (m,) give, at least
        _LEAST of the usual one."""
        design = basis.design(self.width.q).toarray()
        width = np.maximum(design @ coefficients, _LEAST * np.exp(self.width.mean))
        return self.width.term(np.log(width), design / width[:, None])

    def of_path(self, basis: Basis, coefficients: Array) -> list[Term]:
        """The prior's Term, as Spread.term, of each channel of the path's coefficients (m, channels), all of which must
        be known."""
        designs = [basis.design(each.q).toarray() for each in self.path]
        seen = zip(self.path, designs, coefficients.T, strict=True)
        return [each.term(design @ own, design) for each, design, own in seen]


@lru_cache(maxsize=8)
def free_bending(basis: Basis, q: tuple[float, ...]) -> tuple[Array, int]:
    """The penalty (size, size) on bending less what values at q tell of it, which is on how a curve departs from the
    one through them that bends least; and its rank."""
    free = null_space(basis.design(np.array(q)).toarray())
    pulled = basis.bending @ free
    return np.asarray(pulled @ np.linalg.solve(free.T @ pulled, pulled.T)), free.shape[1]
