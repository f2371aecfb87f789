"""Curves: what a coefficient does to a table that is looked up linearly."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from tautline.splines import Basis


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(2, 60))
def test_between_a_grid_s_places_a_table_is_looked_up_linearly(seed, spans, places):
    rng = np.random.default_rng(seed)
    basis, grid = Basis(-2.0, 3.0, spans), np.linspace(-2.5, 3.5, places)
    coefficients, x = rng.normal(size=basis.size), rng.uniform(-4.0, 5.0, 40)
    x[:2] = grid[[0, -1]]
    looked_up = np.interp(x, grid, basis.table(coefficients, grid))
    np.testing.assert_allclose(basis.between(grid, x) @ coefficients, looked_up, atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10_000), st.integers(1, 30), st.integers(0, 3))
def test_a_curve_and_its_slope_are_those_of_its_b_splines(seed, spans, channels):
    rng = np.random.default_rng(seed)
    basis = Basis(-2.0, 3.0, spans)
    coefficients = rng.normal(size=(basis.size, channels) if channels else basis.size)
    x = np.concatenate([rng.uniform(-4.0, 5.0, 40), [-2.0, 3.0, np.nan]])
    spline = BSpline(basis.knots, coefficients, 3)
    np.testing.assert_allclose(basis.value(coefficients, x), spline(basis.clip(x)), atol=1e-12)
    np.testing.assert_allclose(basis.slope(coefficients, x), spline(basis.clip(x), 1), atol=1e-10)
