"""The one optimiser of calibration and diagnosis: Levenberg and Marquardt's damped Gauss-Newton steps.

It works on normal equations. An observation touches eight spline coefficients and a few columns, so C adds it to them
at once (host/native/normal.h): a step of two minutes of frames takes 0.8 ms, where scipy.optimize.least_squares, which
asks for the whole Jacobian, takes 6 with LSMR and 96 exactly. Nor may a loss change there, and here weights, smoothing
and what is held at the end of its range follow the residuals from step to step.
"""

from __future__ import annotations

from typing import Protocol, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.linalg.lapack import dpotrf, dpotri

Array = npt.NDArray[np.float64]
Point = TypeVar("Point")  # the unknowns and all that is known of them there: they are simulated once

_DAMPING = 1e-4  # tolerance: at first, of the diagonal
_LEAST, _MOST = 1e-9, 1e6  # tolerance: of it
_TIMES = 10.0  # tolerance: less of it after a step that helps, more after one that does not
_AGAIN = 1e3  # tolerance: of _LEAST: what it is at least before it grows
_TRIES = 8  # tolerance: of a step, ever shorter
_RIDGE, _FLOOR = 1e-9, 1e-12  # tolerance: of a factor: of the diagonal, and beside it


class Problem(Protocol[Point]):
    """A cost that `descend` makes small, of unknowns that the problem itself keeps in its points."""

    def linearised(self, point: Point) -> tuple[Array, Array, float]:
        """Normal matrix (m, m), gradient (m,) in the direction that lowers the cost, and the cost, at a point, priors
        included. The robust weights of this point hold until the next call."""
        ...

    def moved(self, point: Point, step: Array) -> Point:
        """The point that is a step (m,) further, kept within what the unknowns may be."""
        ...

    def cost(self, point: Point) -> float:
        """The cost at a point, by the weights of the last linearisation."""
        ...

    def enough(self, gained: float, cost: float) -> bool:
        """Whether to end the search after a step that lowered the cost by `gained`, from `cost`."""
        ...


def descend(problem: Problem[Point], point: Point, most: int) -> Point:
    """The best point after at most `most` damped Gauss-Newton steps from `point`. A step that does not lower the cost
    is tried again with more damping; the search ends where none of _TRIES lowers it, or where the problem has
    `enough`."""
    damping = _DAMPING
    for _ in range(most):
        matrix, gradient, cost = problem.linearised(point)
        diagonal = np.diag(np.diag(matrix))
        for _ in range(_TRIES):
            try:
                step = cho_solve(factor(matrix + damping * diagonal), gradient, check_finite=False)
            except LinAlgError:
                step = None
            if step is not None and np.isfinite(step).all():  # not from a point that predicts nothing
                trial = problem.moved(point, np.asarray(step))
                then = problem.cost(trial)
                if then < cost:
                    break
            damping = min(max(damping, _LEAST * _AGAIN) * _TIMES, _MOST)
        else:
            break
        damping = max(damping / _TIMES, _LEAST)
        point = trial
        if problem.enough(cost - then, cost):
            break
    return point


def factor(matrix: Array) -> tuple[Array, bool]:
    """Cholesky factor of the matrix (m, m) with a negligible ridge, as cho_solve takes it. LinAlgError where it is not
    positive definite."""
    factored: tuple[Array, bool] = cho_factor(with_ridge(matrix), overwrite_a=True, check_finite=False)
    return factored


def with_ridge(matrix: Array) -> Array:
    """A copy of the matrix (m, m) with a negligible ridge added to its diagonal."""
    ridged, diagonal = np.array(matrix), np.diag(matrix)
    np.fill_diagonal(ridged, diagonal + (_RIDGE * diagonal + _FLOOR))
    return ridged


def inverse_of(matrix: Array) -> Array:
    """Inverse of a symmetric positive definite matrix (m, m), by its Cholesky factor. LinAlgError where it is not
    positive definite."""
    factored, failed = dpotrf(matrix.T, lower=True)
    if failed:
        raise LinAlgError("the matrix is not positive definite")
    lower, _ = dpotri(factored, lower=True, overwrite_c=True)
    both = np.asarray(lower + lower.T)  # above the diagonal of `lower` is nothing
    np.fill_diagonal(both, np.diag(lower))
    return both
