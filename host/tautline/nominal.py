"""The nominal chain's unknowns, linearised: B(p) and the curve that follows p as cubic B-splines, and a few numbers
that every observation depends on (delay, registration, effects). Calibration and diagnosis sum their normal equations
here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from tautline import _native
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

_STEEP = 0.05  # tolerance: least dq/dp: half of what an allowed B, |B'| <= 1.8, comes down to


@dataclass(frozen=True)
class Rows:
    """Observations linearised: d prediction = by_c dc + columns dx, where dc = by_width dB(p) + by_follow df(tip)."""

    p: Array  # (n,) where B counts, unit of q
    tip: Array  # (n,) where the curve that follows p is looked up
    by_width: Array  # (n,)
    by_follow: Array  # (n,)
    by_c: Array  # (n, k) k: u and v, px, or an angle, deg
    columns: Array  # (n, k, m) of the other unknowns x
    residual: Array  # (n, k) what was seen less what is predicted

    def moved(self, width: Array, follow: Array) -> Array:
        """(n, k) The change of the predictions where B is changed by width (n,) at p, and the curve f by follow (n,) at
        tip."""
        return np.asarray(self.by_c * (self.by_width * width + self.by_follow * follow)[:, None])


@dataclass(frozen=True)
class Normal:
    """Normal equations, to which rows are added in place. Unknowns: the coefficients of B and f, then the columns'."""

    matrix: Array  # (m, m)
    gradient: Array  # (m,)

    @classmethod
    def zeros(cls, size: int) -> Normal:
        """Normal equations of no rows, for `size` unknowns; further ones are added to them in place."""
        return cls(np.zeros((size, size)), np.zeros(size))

    @classmethod
    def of_sparse(cls, blocks: Sequence[csr_matrix], weight: Array, residual: Array) -> Normal:
        """The normal equations of n rows whose entries are mostly 0. blocks: the columns, (n, m_i) each, side by side
        (their indices are sorted in place); weight (n,): of each row; residual (n,)."""
        for block in blocks:
            block.sort_indices()
        normal = cls.zeros(sum(int(block.shape[1]) for block in blocks))
        entries = [(block.indptr, block.indices, block.data, int(block.shape[1])) for block in blocks]
        _native.normal_add_sparse(entries, weight, np.ascontiguousarray(residual), normal.matrix, normal.gradient)
        return normal


@dataclass(frozen=True)
class Nominal:
    """The spline bases of B and of the curve that follows p."""

    width: Basis
    follow: Basis

    @property
    def size(self) -> int:
        """How many coefficients both curves have together."""
        return self.width.size + self.follow.size

    def add(
        self, rows: Rows, into: Normal, columns: Array | None = None, weight: Array | None = None, first: int = 0
    ) -> None:
        """Adds the rows' normal equations to `into`, in place. columns (n, k, m): used instead of the rows' own. weight
        (n, k): of each residual, by default 1. first: number of the first column whose equations are added; above 0,
        those of the columns before it, and of the curves, have been added already."""
        _native.normal_add(
            *(rows.p, rows.tip, rows.by_width, rows.by_follow, rows.by_c),
            *(np.ascontiguousarray(rows.columns if columns is None else columns), rows.residual, weight),
            *(self.width.native, self.follow.native, into.matrix, into.gradient),
            first=first,
        )

    def moved(self, rows: Rows, step: Array) -> Array:
        """(n, k) The change of the predictions by a step of the unknowns: coefficients of B, of the curve, then the
        columns' own."""
        b, both = self.width.size, self.size
        curves = rows.moved(self.width.value(step[:b], rows.p), self.follow.value(step[b:both], rows.tip))
        return np.asarray(curves + rows.columns @ step[both:])


def by_width(lean: Array, slope: Array) -> Array:
    """dp/dB (n,) of a play at a fixed motor position q, from p + lean B(p)/2 = q: -(lean / 2) / (dq/dp). lean (n,): +1
    on the rising envelope, -1 on the falling one, less between them; slope (n,): dB/dp."""
    return np.asarray(-0.5 * lean / steepness(lean, slope))


def steepness(lean: Array, slope: Array) -> Array:
    """dq/dp (n,) of p + lean B(p)/2 = q: 1 + lean slope / 2, but at least _STEEP, which no allowed B goes below. lean
    (n,): +1 on the rising envelope, -1 on the falling one; slope (n,): dB/dp."""
    return np.maximum(1.0 + 0.5 * lean * slope, _STEEP)
