"""The stated error of the clock alignment is a bound, and drift is found."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline.device.clock import STEADY, BoardClock


@given(
    seed=st.integers(0, 2**32 - 1),
    drift=st.floats(-STEADY, STEADY),
    start=st.floats(0, 1e5),
    asymmetry=st.floats(0, 1),
    seconds=st.floats(0.1, 120),
    trips=st.integers(1, 200),
)
def test_error_is_a_bound(seed: int, drift: float, start: float, asymmetry: float, seconds: float, trips: int) -> None:
    rng = np.random.default_rng(seed)
    clock = BoardClock()

    def board(host: float) -> float:
        return 3.0 + (host - start) * (1 + drift)

    for sent in np.sort(start + rng.uniform(0, seconds, trips)):
        there, back = rng.exponential(0.0004, 2) + 0.0001
        there *= asymmetry
        clock.add(sent, sent + there + back, round(board(sent + there) * 1e6))
    for host in start + rng.uniform(-0.5, seconds + 5.0, 20):
        offset, error = clock.offset(host)
        assert abs(host + offset - board(host)) <= error + 2e-6


def test_drift_is_found_and_error_shrinks() -> None:
    rng = np.random.default_rng(5)
    clock = BoardClock()
    assert clock.offset(1.0)[1] == float("inf")
    for sent in np.arange(0.0, 60.0, 0.2):
        there, back = rng.exponential(0.0002, 2) + 0.0001
        clock.add(sent, sent + there + back, round((sent + there) * (1 + 40e-6) * 1e6))
    assert clock.drift == pytest.approx(40e-6, abs=5e-6)
    assert clock.offset(60.0)[1] < 0.0008
