"""How many neighbouring residuals tell as much as one: against the closed form of known processes."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logsumexp

from tautline import _native
from tautline.independence import first_order, first_order_sums, frames_each


def process(alike: float, n: int, seed: int = 1) -> np.ndarray:
    """x[k] = alike x[k-1] + white."""
    x, found = np.random.default_rng(seed).normal(size=n), np.empty(n)
    before = 0.0
    for k in range(n):
        found[k] = before = alike * before + x[k]
    return found


@pytest.mark.parametrize("alike", [0.0, 0.5, 0.8, 0.95])
@pytest.mark.parametrize("stop", [{"least": 0.01}, {"window": 5.0}], ids=lambda s: next(iter(s)))
def test_a_first_order_process_counts_as_its_closed_form_says(alike, stop):
    x = process(alike, 200_000)
    expected = (1 + alike) / (1 - alike)
    assert frames_each(x, 2000, **stop) == pytest.approx(expected, rel=0.06)
    assert first_order(x) == pytest.approx(expected, rel=0.04)


def test_it_is_the_variance_of_a_mean():
    """What it is for: a mean's variance is that of so many times fewer independent values."""
    means = [process(0.7, 1000, seed).mean() for seed in range(400)]
    x = process(0.7, 100_000)
    assert np.var(means) == pytest.approx(np.var(x) * frames_each(x, 500, window=5.0) / 1000, rel=0.2)


def test_channels_are_averaged_and_groups_kept_apart():
    x, white = process(0.8, 100_000), np.random.default_rng(2).normal(size=100_000)
    assert frames_each(np.column_stack([x, x]), 500, window=5.0) == pytest.approx(frames_each(x, 500, window=5.0))
    # Alike within pairs only: 1 + 2 * (1/2), and not at all where each is a group of its own.
    pairs = np.repeat(white, 2)
    of = np.arange(len(pairs))
    assert frames_each(pairs, 20, least=0.02) == pytest.approx(2.0, rel=0.03)
    assert frames_each(pairs, 20, least=0.02, group=of) == 1.0
    assert frames_each(pairs, 20, least=0.02, group=of // 2) == pytest.approx(2.0, rel=0.03)
    assert frames_each(pairs, 20, least=0.02, group=(of + 1) // 2) == 1.0


def test_nothing_left_is_independent():
    assert frames_each(np.zeros(100), 20) == 1.0
    assert frames_each(np.ones(1), 20) == 1.0
    assert first_order(np.zeros(100)) == 1.0


@given(st.integers(1, 6), st.integers(1, 4), st.integers(0, 2**31))
def test_hidden_regimes_against_all_ways_through_them(n, count, seed):
    rng = np.random.default_rng(seed)
    density, initial = rng.normal(0.0, 3.0, (n, count)), rng.dirichlet(np.ones(count))
    transition = rng.dirichlet(np.ones(count), count)
    begins = np.append(True, rng.random(n - 1) < 0.3)
    found = _native.regimes_forward(density, begins, transition, initial)
    for first in np.flatnonzero(begins).tolist():
        end = next((k for k in range(first + 1, n) if begins[k]), n)
        for last in range(first, end):
            ways = product(range(count), repeat=last - first + 1)
            of_each = [
                np.log(initial[way[0]])
                + sum(np.log(transition[a, b]) for a, b in pairwise(way))
                + sum(density[first + k, regime] for k, regime in enumerate(way))
                for way in ways
            ]
            assert float(np.sum(found[first : last + 1])) == pytest.approx(float(logsumexp(of_each)), abs=1e-9)


def test_a_regime_that_cannot_be_is_not_the_measure_of_those_that_can():
    """Straight from the third one to the second nothing goes, however well that one would explain a frame."""
    density = np.array([[0.0, -5.0, -9.0], [-1000.0, -1000.0, 0.0], [-2000.0, 0.0, -2000.0], [0.0, -5.0, -9.0]])
    transition = np.array([[0.5, 0.3, 0.2], [0.5, 0.3, 0.2], [0.1, 0.0, 0.9]])
    found = _native.regimes_forward(density, np.arange(4) == 0, transition, np.full(3, 1.0 / 3.0))
    assert np.isfinite(found).all() and found[2] == pytest.approx(-2000.0, abs=0.1)


def test_regimes_far_from_each_other_do_not_underflow():
    density = np.array([[0.0, -2000.0], [-2000.0, 0.0], [-5000.0, -5000.0]])
    found = _native.regimes_forward(density, np.arange(3) == 0, np.full((2, 2), 0.5), np.full(2, 0.5))
    np.testing.assert_allclose(found, [np.log(0.5), np.log(0.5), -5000.0], rtol=1e-12)


@given(st.integers(0, 30), st.integers(1, 3), st.floats(-1.0, 1.0), st.integers(0, 2**31))
def test_a_sum_remembers_the_one_before(n, columns, rho, seed):
    values = np.random.default_rng(seed).normal(size=(n, columns))
    kept, last = values.copy(), np.zeros(columns)
    sums = first_order_sums(values, rho)
    for k in range(n):
        last = values[k] + rho * last
        np.testing.assert_allclose(sums[k], last, atol=1e-12)
    np.testing.assert_array_equal(values, kept)
    np.testing.assert_allclose(first_order_sums(values[:, 0], rho), sums[:, 0], atol=1e-12)
