"""What times of arrival say of when samples were taken."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.core.samples import period_s, waits_s


@settings(max_examples=60, deadline=None)
@given(
    rate_hz=st.floats(10.0, 250.0),
    wait=st.floats(0.0, 3.0),
    lost=st.floats(0.0, 0.03),
    seed=st.integers(0, 1 << 30),
)
def test_how_long_a_sample_waited_is_told(rate_hz: float, wait: float, lost: float, seed: int) -> None:
    """wait: mean, in periods, of samples that wait for a link and come in order. Their waits are told but for what is
    common to all: to a fifth of a period and less than half of how they differ."""
    rng = np.random.default_rng(seed)
    taken = np.flatnonzero(rng.random(3000) >= lost) / rate_hz
    arrival = np.maximum.accumulate(taken + 0.05 + rng.exponential(wait / rate_hz, len(taken)))
    told, truth = waits_s(arrival), arrival - taken
    assert (told >= 0.0).all() and period_s(arrival) * rate_hz == pytest.approx(1.0, abs=1e-9 + 0.03 * (wait + 0.3))
    assert np.std(told - truth) * rate_hz <= 0.2 + 0.45 * np.std(truth) * rate_hz


def test_few_samples_wait_for_nothing() -> None:
    assert waits_s(np.array([1.0])).tolist() == [0.0] and period_s(np.array([1.0])) == 0.0
    assert np.allclose(waits_s(np.arange(5.0)), 0.0)
