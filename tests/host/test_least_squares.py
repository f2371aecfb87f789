"""The one optimiser, on problems whose answer is known."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import sparse

from tautline import _native
from tautline.least_squares import LinAlgError, descend, factor, inverse_of
from tautline.nominal import Normal


@dataclass
class Curve:
    """y = f(x, theta) with theta within [low, high], held at their ends; counts its linearisations."""

    x: np.ndarray
    y: np.ndarray
    low: np.ndarray
    high: np.ndarray
    enough_at: float = 1e-12
    steps: int = field(default=0)

    def residual(self, theta):
        return self.y - theta[0] * np.exp(-theta[1] * self.x)

    def linearised(self, theta):
        self.steps += 1
        wave = np.exp(-theta[1] * self.x)
        jacobian = np.column_stack([wave, -theta[0] * self.x * wave])
        matrix, gradient = jacobian.T @ jacobian, jacobian.T @ self.residual(theta)
        held = ((theta[:2] >= self.high[:2]) & (gradient > 0)) | ((theta[:2] <= self.low[:2]) & (gradient < 0))
        matrix[held, :] = matrix[:, held] = gradient[held] = 0.0
        matrix[held, held] = 1.0
        return matrix, gradient, self.cost(theta)

    def moved(self, theta, step):
        return np.clip(theta + step, self.low, self.high)

    def cost(self, theta):
        return float(np.sum(self.residual(theta) ** 2))

    def enough(self, gained, cost):
        return gained < self.enough_at * cost


def decay(theta=(2.0, 0.7), low=(-9.0, -9.0), high=(9.0, 9.0)) -> Curve:
    x = np.linspace(0, 5, 60)
    y = theta[0] * np.exp(-theta[1] * x) + np.random.default_rng(1).normal(0.0, 0.01, 60)
    return Curve(x, y, np.array(low), np.array(high))


def test_it_ends_where_the_gradient_does():
    problem = decay()
    found = descend(problem, np.array([0.5, 3.0]), 50)
    matrix, gradient, cost = problem.linearised(found)
    assert np.abs(gradient).max() < 1e-6 * np.sqrt(cost * np.diag(matrix).max())
    assert found == pytest.approx([2.0, 0.7], abs=0.03)


def test_it_never_gets_worse_and_takes_no_more_steps_than_it_may():
    problem = decay()
    start = np.array([0.1, 8.0])
    costs = [problem.cost(start)] + [problem.cost(descend(decay(), start, most)) for most in range(1, 8)]
    assert (np.diff(costs) <= 0).all()
    problem = decay()
    descend(problem, start, 3)
    assert problem.steps == 3


def test_it_stays_within_what_the_unknowns_may_be():
    problem = decay(high=(1.5, 9.0))
    found = descend(problem, np.array([0.5, 3.0]), 60)
    assert found[0] == 1.5
    rates = np.linspace(0.0, 2.0, 4001)
    assert found[1] == pytest.approx(min(rates, key=lambda rate: problem.cost(np.array([1.5, rate]))), abs=0.02)


def test_from_the_best_point_it_goes_nowhere():
    problem = decay()
    best = descend(problem, np.array([0.5, 3.0]), 60)
    assert np.array_equal(descend(problem, best, 1), best) or problem.cost(descend(problem, best, 1)) < problem.cost(
        best
    )
    exact = Curve(problem.x, 2.0 * np.exp(-0.7 * problem.x), problem.low, problem.high)
    assert np.array_equal(descend(exact, np.array([2.0, 0.7]), 5), [2.0, 0.7])


def test_an_unknown_that_nothing_depends_on_stays():
    class Idle(Curve):
        def linearised(self, theta):
            matrix, gradient, cost = super().linearised(theta)
            wide, force = np.zeros((3, 3)), np.zeros(3)
            wide[:2, :2], force[:2] = matrix, gradient
            return wide, force, cost

    plain = decay()
    problem = Idle(plain.x, plain.y, np.full(3, -9.0), np.full(3, 9.0))
    found = descend(problem, np.array([0.5, 3.0, 4.0]), 60)
    assert found[2] == 4.0 and found[:2] == pytest.approx([2.0, 0.7], abs=0.03)


def test_steps_into_nonsense_are_not_taken():
    class Edge(Curve):
        def cost(self, theta):
            return super().cost(theta) if theta[1] < 2.0 else float("nan")

    plain = decay()
    problem = Edge(plain.x, plain.y, plain.low, plain.high)
    found = descend(problem, np.array([0.01, 1.9]), 60)
    assert found == pytest.approx([2.0, 0.7], abs=0.03)


def test_a_factor_s_ridge_is_not_noticed():
    matrix = np.diag([1e8, 1.0, 1e-4])
    lower, is_lower = factor(matrix)
    triangle = np.tril(lower) if is_lower else np.triu(lower).T
    np.testing.assert_allclose(triangle @ triangle.T, matrix, rtol=1e-6)


def test_it_stays_where_nothing_is_predicted():
    """As of a marker behind the camera: whoever asked sees that it is no number, and no model is made of no number."""

    class Blind(Curve):
        def moved(self, theta, step):
            assert np.isfinite(step).all()
            return super().moved(theta, step)

    seen = decay()
    problem = Blind(seen.x, np.where(seen.x > 2.0, np.nan, seen.y), seen.low, seen.high)
    start = np.array([0.5, 3.0])
    np.testing.assert_array_equal(descend(problem, start, 50), start)


@given(st.integers(1, 40), st.integers(1, 12), st.floats(0.0, 1.0), st.integers(0, 2**31))
def test_sparse_rows_sum_to_what_dense_ones_do(rows, size, share, seed):
    rng = np.random.default_rng(seed)
    dense = np.where(rng.random((rows, size)) < share, rng.normal(size=(rows, size)), 0.0)
    design = sparse.csr_matrix(dense)
    for row in range(rows):  # in any order within a row
        within = slice(design.indptr[row], design.indptr[row + 1])
        design.indices[within], design.data[within] = design.indices[within][::-1], design.data[within][::-1]
    design.has_sorted_indices = False
    weight, residual = rng.random(rows), rng.normal(size=rows)
    blocks = [design] if size < 3 else [design[:, :2], design[:, 2:]]
    normal = Normal.of_sparse(blocks, weight, residual)
    np.testing.assert_allclose(normal.matrix, dense.T @ (weight[:, None] * dense), atol=1e-12)
    np.testing.assert_allclose(normal.gradient, dense.T @ (weight * residual), atol=1e-12)


@pytest.mark.parametrize("column", [[0, 3], [1, 0], [-1, 0]])
def test_a_column_that_is_not_there_or_out_of_order_is_refused(column):
    block = np.array([0, 2], np.int32), np.array(column, np.int32), np.ones(2), 3
    with pytest.raises(ValueError, match="columns rising"):
        _native.normal_add_sparse([block], np.ones(1), np.ones(1), np.zeros((3, 3)), np.zeros(3))


@pytest.mark.parametrize("size", [1, 2, 40])
def test_an_inverse_is_numpys(size):
    root = np.random.default_rng(size).normal(size=(size, 2 * size))
    np.testing.assert_allclose(inverse_of(root @ root.T), np.linalg.inv(root @ root.T), rtol=1e-9, atol=1e-12)
    with pytest.raises(LinAlgError):
        inverse_of(-np.eye(size))
