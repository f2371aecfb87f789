"""The play operator in motor space against its defining equations."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline import _native
from tautline.elements import Play
from tautline.model import play_at

STEEP = 1.95


@st.composite
def tables(draw):
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 40))
    grid = np.cumsum(rng.uniform(0.01, 1.0, n)) - rng.uniform(0, 10)
    width = np.empty(n)
    width[0] = rng.uniform(0, 3)
    for i in range(1, n):
        width[i] = max(0.0, width[i - 1] + rng.uniform(-STEEP, STEEP) * (grid[i] - grid[i - 1]))
    return grid, width, rng


def solve(q, side, grid, width):
    """p + side B(p)/2 = q by bisection."""
    low, high = q - 100.0, q + 100.0
    for _ in range(200):
        middle = (low + high) / 2
        if middle + side * np.interp(middle, grid, width) / 2 < q:
            low = middle
        else:
            high = middle
    return (low + high) / 2


@given(tables(), st.booleans())
def test_forward_is_the_clamp_between_both_envelopes(table, from_centre):
    grid, width, rng = table
    q = rng.uniform(grid[0] - 2, grid[-1] + 2, 30)
    p0 = np.nan if from_centre else rng.uniform(grid[0], grid[-1])
    p, side, lean, share = _native.Plays(grid, width).trace(q, p0)
    anchor = np.maximum.accumulate(np.where(share > 0, np.arange(len(q)), -1))
    state, held, at = (q[0] if from_centre else p0), 0, -1
    for k, position in enumerate(q):
        low, high = solve(position, 1, grid, width), solve(position, -1, grid, width)
        if state < low - 1e-12:
            state, held, at = low, 1, k
        elif state > high + 1e-12:
            state, held, at = high, -1, k
        assert p[k] == pytest.approx(state, abs=1e-9)
        assert (side[k], anchor[k]) == (held, at)
        if held:
            assert p[k] + held * np.interp(p[k], grid, width) / 2 == pytest.approx(q[anchor[k]], abs=1e-9)
    assert np.array_equal(lean, side) and set(share) <= {0.0, 1.0}
    assert np.array_equal(p, _native.Plays(grid, width).forward(q, p0)[0])


@given(tables())
def test_only_turning_points_matter(table):
    """Rate-independent: more samples on straight lines between the same turning points change nothing."""
    grid, width, rng = table
    q = rng.uniform(grid[0], grid[-1] + 1, 12)
    fine = np.interp(np.linspace(0, 11, 111), np.arange(12), q)
    fine[::10] = q
    plays = _native.Plays(grid, width)
    assert plays.forward(fine, np.nan)[0][::10] == pytest.approx(plays.forward(q, np.nan)[0], abs=1e-9)


@pytest.mark.parametrize(
    ("grid", "width"),
    [([0, 1], [0, 2.0]), ([0, 0], [1, 1]), ([0, 1], [1, -0.1]), ([0, 1], [1, np.nan]), ([0, 1, 2], [1, 1])],
)
def test_tables_without_a_unique_play_are_refused(grid, width):
    with pytest.raises(ValueError, match="play:"):
        _native.Plays(np.array(grid, float), np.array(width, float))


def test_times_in_any_order_and_beyond_the_motor():
    t, q = np.array([0.0, 1.0, 2.0]), np.array([0.0, 4.0, 3.0])
    grid, width = np.array([-10.0, 10.0]), np.array([1.0, 1.0])
    at = np.array([5.0, 0.5, -3.0, 1.0])
    assert play_at(t, q, at, Play(grid, width), np.nan) == pytest.approx([3.5, 1.5, 0.0, 3.5])
