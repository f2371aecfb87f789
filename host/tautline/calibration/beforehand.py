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
        """The Term of a curve with value (k,) at the places and derivatives slope (k, m) by its m coefficients. The t
        density's weight (nu + k) / (nu + d^2) is held, so that matrix and gradient are those of a quadratic form."""
        off = value - self.mean
        pulled = self.precision @ off
        distance2 = float(off @ pulled)
        size = len(self.q)
        weight = (self.freedom + size) / (self.freedom + distance2)
        deviance = (self.freedom + size) * float(np.log1p(distance2 / self.freedom))
        return weight * (slope.T @ self.precision @ slope), weight * (slope.T @ pulled), deviance

    def may_contain(self, value: Array, noise: Array) -> bool:
        """Whether a curve with value (k,) at the places, known with errors of covariance noise (k, k), may be one more
        draw from this distribution: more than the share _SELDOM of draws are farther from its mean (F distribution)."""
        off = value - self.mean
        distance2, size = float(off @ np.linalg.solve(self.scale + noise, off)), len(self.q)
        return bool(fdtrc(size, self.freedom, distance2 / size) > _SELDOM)


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
        """The Term of a B with spline coefficients (m,), whose logarithm has the prior `width`. Where B is less than
        the share _LEAST of the usual one it counts as that, as it has no logarithm at 0."""
        design = basis.design(self.width.q).toarray()
        width = np.maximum(design @ coefficients, _LEAST * np.exp(self.width.mean))
        return self.width.term(np.log(width), design / width[:, None])

    def of_path(self, basis: Basis, coefficients: Array) -> list[Term]:
        """The Term of each channel of a path with spline coefficients (m, channels); as many channels as `path` has."""
        designs = [basis.design(each.q).toarray() for each in self.path]
        seen = zip(self.path, designs, coefficients.T, strict=True)
        return [each.term(design @ own, design) for each, design, own in seen]

    def of_delay(self, delay_s: float) -> Term:
        """The Term of the delay, matrix (1, 1) and gradient (1,); zeros if nothing is known of it."""
        if self.delay is None:
            return np.zeros((1, 1)), np.zeros(1), 0.0
        return self.delay.term(np.array([delay_s]), np.eye(1))


@lru_cache(maxsize=8)
def free_bending(basis: Basis, q: tuple[float, ...]) -> tuple[Array, int]:
    """Penalty (size, size) on that part of a curve's bending that its values at places q do not need: 0 for the least
    bent curve through them, as the values have a prior of their own. And the penalty's rank. It is K F (F' K F)^-1 F'
    K, where K is the spline's bending matrix and F (size, rank) spans the coefficients that are 0 at all places."""
    free = null_space(basis.design(np.array(q)).toarray())
    pulled = basis.bending @ free
    return np.asarray(pulled @ np.linalg.solve(free.T @ pulled, pulled.T)), free.shape[1]
