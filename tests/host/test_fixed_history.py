"""The board's encoder history against numpy's interpolation."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native


def push(history, t_us, q):
    history.push(np.asarray(t_us, dtype=np.uint64), np.asarray(q, dtype=np.int32))


def read(history, t_us):
    return history.at(np.asarray(t_us, dtype=np.uint64))


@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.integers(50, 15000), st.integers(0, 2**40), st.integers(1, 2**28))
def test_any_ticks_are_kept_at_whole_milliseconds(seed, longest_us, start_us, step):
    rng = np.random.default_rng(seed)
    t = start_us + np.concatenate([[0], np.cumsum(rng.integers(1, longest_us + 1, 3000))])
    q = np.clip(np.cumsum(rng.integers(-step, step, len(t), endpoint=True)), -(2**31), 2**31 - 1)
    history = _native.History()
    push(history, t, q)

    grid = np.arange(t[0], t[-1] + 1, 1000)
    kept = np.interp(grid, t, q)
    asked = rng.integers(max(0, int(t[-1]) - 700_000), t[-1] + 2000, 500)
    got, status = read(history, asked)
    oldest = grid[max(0, len(grid) - 502)]
    ok = (asked >= oldest) & (asked <= grid[-1])
    assert np.array_equal(status == _native.HISTORY_OK, ok)
    assert np.array_equal(status == _native.HISTORY_NOT_YET, asked > grid[-1])
    assert np.array_equal(status == _native.HISTORY_TOO_OLD, asked < oldest)
    # One rounding when a millisecond is kept, one when it is read: 2/256 count at most.
    assert np.all(np.abs(got[ok] - np.interp(asked[ok], grid, kept)) <= 1.01)
    if t[-1] - t[0] > 502_000:
        assert read(history, [grid[-1] - 1000 * _native.HISTORY_SPAN_MS])[1][0] == _native.HISTORY_OK


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from([1000, 2000, 3000, 5000, 10000]))
def test_a_motor_is_found_within_a_count(seed, rate_hz):
    rng = np.random.default_rng(seed)
    t = np.round(np.arange(int(1.5 * rate_hz)) * 1e6 / rate_hz)
    frequency = rng.uniform(0.1, 8.0)
    amplitude = min(5000.0, 400_000 / (2 * np.pi * frequency) ** 2)  # up to 400000 counts/s^2

    def motor(t_us):
        return amplitude * np.sin(2 * np.pi * frequency * t_us * 1e-6)

    history = _native.History()
    push(history, t, np.round(motor(t) * 256))
    asked = rng.integers(t[-1] - 500_000, t[-1] - 1000, 300)
    got, status = read(history, asked)
    assert np.all(status == _native.HISTORY_OK)
    assert np.all(np.abs(got / 256 - motor(asked)) < 1.0)
