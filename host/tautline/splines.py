"""Uniform cubic B-splines with a roughness penalty: the shape of B(q) and of f_remain while they are fitted."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import BSpline
from scipy.sparse import csr_matrix

from tautline import _native

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Basis:
    """`spans` equal spans over [low, high]; arguments beyond are moved to the nearer end."""

    low: float
    high: float
    spans: int

    @property
    def size(self) -> int:
        """How many coefficients: a cubic spline has three more than spans."""
        return self.spans + 3

    @property
    def step(self) -> float:
        """Length of one span, in the unit of x."""
        return (self.high - self.low) / self.spans

    @cached_property
    def knots(self) -> Array:
        """(size + 4,) Where the pieces meet, with three more knots beyond either end, which the first and last cubic
        basis functions need."""
        return np.asarray(self.low + self.step * np.arange(-3, self.spans + 4), dtype=float)

    @cached_property
    def centres(self) -> Array:
        """(size,) The place x at which each coefficient acts most."""
        return np.asarray(self.low + self.step * np.arange(-1, self.spans + 2), dtype=float)

    @property
    def native(self) -> tuple[float, float, int]:
        """The basis as C takes it: low, step, size."""
        return self.low, self.step, self.size

    def clip(self, x: Array) -> Array:
        """x (n,) with values beyond an end moved to that end; at the upper one to just below it, so that they are in
        the last span."""
        inside: Array = np.clip(x, self.low, self.high - 1e-9 * (self.high - self.low))
        return inside

    def design(self, x: Array) -> csr_matrix:
        """(n, size), sparse: the basis functions at x (n,); `value` is design @ coefficients."""
        return csr_matrix(BSpline.design_matrix(self.clip(x), self.knots, 3))

    def value(self, coefficients: Array, x: Array) -> Array:
        """(n,) The curve with these coefficients (size,) at x (n,); with coefficients (size, channels) it is (n,
        channels)."""
        return self._at(coefficients, x, slope=False)

    def table(self, coefficients: Array, x: Array) -> Array:
        """(n,) As `value`, for places x (n,) that are asked for again and again: their design matrix is kept
        (`_dense`)."""
        return np.asarray(_dense(self.low, self.high, self.spans, x.tobytes()) @ coefficients)

    def between(self, grid: Array, x: Array) -> Array:
        """(n, size) The design matrix at x (n,) of a curve that is sampled on a rising grid (m,) and interpolated
        linearly between its nodes."""
        last = len(grid) - 1
        position = np.interp(x, grid, np.arange(last + 1.0))
        before = np.minimum(position.astype(np.int64), last - 1)
        share = (position - before)[:, None]
        table = _dense(self.low, self.high, self.spans, grid.tobytes())
        return np.asarray(table[before] * (1.0 - share) + table[before + 1] * share)

    def slope(self, coefficients: Array, x: Array) -> Array:
        """The curve's derivative at x, shapes as of `value`; beyond an end the derivative at that end."""
        return self._at(coefficients, x, slope=True)

    def _at(self, coefficients: Array, x: Array, slope: bool) -> Array:
        """The curve, or its derivative, at x: shapes as of `value`."""
        inside = self.clip(np.asarray(x, dtype=float))
        found = _native.spline_at(inside.ravel(), self.low, self.step, coefficients.reshape(self.size, -1), slope)
        return np.asarray(found).reshape(inside.shape + coefficients.shape[1:])

    def nearest(self, x: Array, values: Array) -> Array:
        """(size,) or (size, channels) The coefficients of the curve that fits values (n,) or (n, channels) at places x
        (n,) best, by least squares. x must reach every span, or the normal matrix is singular."""
        design = self.design(x)
        return np.asarray(np.linalg.solve((design.T @ design).toarray(), design.T @ values))

    @cached_property
    def roughness(self) -> Array:
        """(size, size) Matrix R of a penalty c^T R c on coefficients c: their squared second differences, and a
        millionth of their squared first ones, by which the curve levels out where nothing is measured."""
        second, first = np.diff(np.eye(self.size), 2, axis=0), np.diff(np.eye(self.size), 1, axis=0)
        return second.T @ second + 1e-6 * first.T @ first

    @property
    def roughness_rank(self) -> int:
        """The rank of `roughness`, which is 0 of a constant alone."""
        return self.size - 1

    @cached_property
    def bending(self) -> Array:
        """(size, size) Matrix of a penalty on squared second differences of the coefficients alone, by which the curve
        goes straight on where nothing is measured."""
        second = np.diff(np.eye(self.size), 2, axis=0)
        return second.T @ second

    @property
    def bending_rank(self) -> int:
        """The rank of `bending`, which is 0 of every straight line."""
        return self.size - 2


@lru_cache(maxsize=32)
def _dense(low: float, high: float, spans: int, x: bytes) -> Array:
    """(n, size) `Basis.design` as a full array, kept for the last 32 sets of places. x: the places' bytes, float64, as
    an array cannot be a key."""
    return np.asarray(Basis(low, high, spans).design(np.frombuffer(x)).toarray())
