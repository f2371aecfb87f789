"""Curves: what a coefficient does to a table that is looked up linearly."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

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
