"""Prior knowledge of B, the tip's path and its sensor's delay, from other robots: how B's logarithm and the path are
distributed between them, each as a multivariate Student t of the values at some motor positions (places), and the delay
as one of a single value.

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
# Of a prior density p of m coefficients: matrix (m, m) and gradient (m,) of -log p, its weight held; and -2 log p.
Term = tuple[Array, Array, float]

_SELDOM = 0.05  # prior: a curve as far off as so few of the others tells that it is none of them
_LEAST = 1e-3  # tolerance: of the usual B: less has no logarithm that says more


@dataclass(frozen=True, eq=False, repr=False)
class Spread(Value):
    """A multivariate Student t of a curve's values at k places."""

    q: Array  # (k,) places, unit of q, rising
    mean: Array  # (k,)
    scale: Array  # (k, k) scale matrix
    freedom: float  # degrees of freedom

    @cached_property
    def precision(self) -> Array:
        """(k, k) inverse of the scale matrix."""
        return np.asarray(np.linalg.inv(self.scale))

    def term(self, value: Array, slope: Array) -> Term:
        """The Term of a curve with value (k,) at the places, slope (k, m) its derivatives by m coefficients. The t
        density's weight (nu + k) / (nu + d^2) is held, so that it is a quadratic form."""
        off = value - self.mean
        pulled = self.precision @ off
        far = float(off @ pulled)
        size = len(self.q)
        weight = (self.freedom + size) / (self.freedom + far)
        told = (self.freedom + size) * float(np.log1p(far / self.freedom))
        return weight * (slope.T @ self.precision @ slope), weight * (slope.T @ pulled), told

    def has(self, value: Array, noise: Array) -> bool:
        """Whether a curve of value (k,) at the places, with errors of covariance noise (k, k), may be one more draw:
        its distance is exceeded by more than _SELDOM of draws (F distribution)."""
        off = value - self.mean
        far, size = float(off @ np.linalg.solve(self.scale + noise, off)), len(self.q)
        return bool(fdtrc(size, self.freedom, far / size) > _SELDOM)


@dataclass(frozen=True, eq=False, repr=False)
class Beforehand(Value):
    """What is known of a robot's B, and of its path and delay as one sensor sees them."""

    width: Spread  # of log B, B in the unit of q
    path: tuple[Spread, ...] = ()  # of each coordinate of the path, sensor's unit; empty where it is not known
    delay: Spread | None = None  # of that sensor, s, a single value

    def usual(self, q: Array) -> Array:
        """The usual B (n,), exp of the mean of log B, at positions q (n,); unit of q."""
        return np.asarray(np.exp(np.interp(q, self.width.q, self.width.mean)))

    def of_width(self, basis: Basis, coefficients: Array) -> Term:
        """The Term of log B by a spline's coefficients (m,); B counts as _LEAST of the usual one at least."""
        design = basis.design(self.width.q).toarray()
        width = np.maximum(design @ coefficients, _LEAST * np.exp(self.width.mean))
        return self.width.term(np.log(width), design / width[:, None])

    def of_path(self, basis: Basis, coefficients: Array) -> list[Term]:
        """The Term of each channel of a path by its spline coefficients (m, channels), as many as are known."""
        designs = [basis.design(each.q).toarray() for each in self.path]
        seen = zip(self.path, designs, coefficients.T, strict=True)
        return [each.term(design @ own, design) for each, design, own in seen]

    def of_delay(self, delay_s: float) -> Term:
        """The Term of the delay, matrix (1, 1) and gradient (1,); of nothing where it is not known."""
        if self.delay is None:
            return np.zeros((1, 1)), np.zeros(1), 0.0
        return self.delay.term(np.array([delay_s]), np.eye(1))


@lru_cache(maxsize=8)
def free_bending(basis: Basis, q: tuple[float, ...]) -> tuple[Array, int]:
    """Penalty (size, size) on the bending of a curve beyond that of the least bent one with the same values at places
    q, and its rank: K F (F' K F)^-1 F' K, K the spline's bending matrix, F (size, rank) the coefficients that are 0 at
    all places. The values there have a prior of their own."""
    free = null_space(basis.design(np.array(q)).toarray())
    pulled = basis.bending @ free
    return np.asarray(pulled @ np.linalg.solve(free.T @ pulled, pulled.T)), free.shape[1]
