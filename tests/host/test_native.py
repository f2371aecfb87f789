"""What the bindings do with arrays and numbers that a loop cannot work with."""

from __future__ import annotations

import resource
import subprocess
import sys

import numpy as np
import pytest

from tautline import _native

Array = np.ndarray


def run_apart(program: str) -> str:
    """What the program prints. Apart: without what it tests it would end this one, or never end."""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=20)
    assert done.returncode == 0, (done.returncode, done.stderr)
    return done.stdout


# before_end(values): an array behind which no memory is.
GUARDED = """
import ctypes, mmap
import numpy as np
from tautline import _native

def before_end(*values, dtype=float):
    page = mmap.PAGESIZE
    area = mmap.mmap(-1, 2 * page)
    start = ctypes.addressof(ctypes.c_char.from_buffer(area))
    assert ctypes.CDLL(None).mprotect(ctypes.c_void_p(start + page), page, 0) == 0
    array = np.frombuffer(area, dtype, len(values), page - len(values) * np.dtype(dtype).itemsize)
    array[:] = values
    return array
"""


@pytest.mark.skipif(sys.platform != "linux", reason="guards memory as Linux does")
@pytest.mark.parametrize(
    "reads",
    [
        # rows that begin beyond the entries, though the last one ends with them
        """
try:
    block = np.array([0, 100, 2], np.int32), before_end(0, 1, dtype=np.int32), np.ones(2), 3
    _native.normal_add_sparse([block], np.ones(2), np.ones(2), np.zeros((3, 3)), np.zeros(3))
except ValueError:
    pass""",
        # a motor of one reading at no time
        """_native.still_squares(np.zeros(1), np.zeros((1, 1)), before_end(0.0), before_end(0.0), 0.0, 0.0, 1, 1,
                                 np.array([np.nan]))""",
    ],
    ids=["sparse", "still"],
)
def test_nothing_beyond_an_array_is_read(reads: str) -> None:
    run_apart(GUARDED + reads)


def strided(values: Array) -> Array:
    return np.repeat(values, 2, axis=0)[::2]


@pytest.mark.parametrize("other", [np.float32, np.int64, strided])
def test_what_would_be_written_to_a_copy_is_refused(other) -> None:
    """numpy would convert it, and what the loop wrote would be lost."""
    refused = pytest.raises(TypeError, match="incompatible function arguments")
    with refused:
        _native.first_order_sums(other(np.ones((4, 2))), 0.5)
    rows = [(np.array([0, 1], np.int32), np.zeros(1, np.int32), np.ones(1), 2)], np.ones(1), np.ones(1)
    with refused:
        _native.normal_add_sparse(*rows, other(np.zeros((2, 2))), np.zeros(2))
    with refused:
        _native.normal_add_sparse(*rows, np.zeros((2, 2)), other(np.zeros(2)))
    frames = *(np.zeros(2),) * 4, np.ones((2, 1)), np.zeros((2, 1, 0)), np.ones((2, 1)), None, (0.0, 1.0, 4)
    with refused:
        _native.normal_add(*frames, (0.0, 1.0, 4), other(np.zeros((8, 8))), np.zeros(8))
    for written in range(5):
        zeros = [np.zeros(3 if k == 3 else 5) for k in range(5)]
        columns = [other(zeros[k]) if k == written else zeros[k] for k in range(5)]
        with refused:
            _native.sweep(np.ones((3, 3)), np.arange(5.0), np.ones(5, np.uint8), 0.5, 0.1, 1.0, *columns)


@pytest.mark.parametrize(
    "counts", [np.array([1.7, 2.0]), np.array([1.0, 2.0]), np.array([1, 2**33]), np.array([-1, -(2**31) - 1])]
)
def test_counts_that_would_lose_by_it_are_not_made_whole(counts: Array) -> None:
    """numpy would cut 1.7 down to 1 and wrap 2^33 to 0."""
    t_us, refused = np.array([1000, 2000], np.uint64), pytest.raises(TypeError, match="dtype=int32")
    with refused:
        _native.History().push(t_us, counts)
    with refused:
        _native.table_encode({}, counts, counts, bytes(8))


@pytest.mark.parametrize("t_us", [np.array([1000.5, 2000.0]), np.array([-1, 2000])])
def test_times_that_would_lose_by_it_are_not_made_whole(t_us: Array) -> None:
    with pytest.raises(TypeError, match="dtype=uint64"):
        _native.History().push(t_us, np.array([1, 2], np.int32))


def test_whole_numbers_of_any_width_are_taken_as_they_are() -> None:
    t_us, ends = np.array([1000, 2000]), np.array([-(2**31), 2**31 - 1])
    for q in (ends, ends.astype(np.int32), np.repeat(ends, 2)[::2], np.array([7, 8], np.uint8)):
        history = _native.History()
        history.push(t_us, q)
        np.testing.assert_array_equal(history.at(t_us)[0], q)


@pytest.mark.parametrize("where", ["x", "y"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_hinge_through_no_number_is_refused(where: str, value: float) -> None:
    """What is left of it would be 0: a perfect fit."""
    x, y = np.linspace(0.0, 1.0, 20), np.random.default_rng(0).normal(size=(20, 1))
    (x if where == "x" else y)[3] = value
    with pytest.raises(ValueError, match="finite"):
        _native.Hinge(x, y, 3, False, 1.0, 1.0, np.ones(1), 0.5, 1e-3).knot(0.5)


def test_a_stop_with_a_place_that_is_none_is_not_a_perfect_one() -> None:
    motor_s = np.linspace(0.0, 1.0, 50)
    z = np.random.default_rng(0).normal(size=(20, 1))
    z[3] = np.nan
    motor = motor_s, np.abs(motor_s - 0.5), 0.5, 0.0
    assert np.isnan(_native.still_squares(0.03 * np.arange(20), z, *motor, 1, 1, np.array([0.0, 0.05]))).all()


def test_a_sweep_without_readings_keeps_its_noise() -> None:
    unread = np.zeros(5, np.uint8)
    held = np.zeros(5), np.ones(5), np.ones(5), np.full(3, -1.0), np.zeros(5)
    assert _native.sweep(np.ones((3, 3)), np.arange(5.0), unread, 0.5, 0.1, 1.0, *held) == (True, 0.1, 0.0)


SIMULATES = """
import numpy as np
from tautline import _native
plays, c_deg, t = _native.Plays(np.array([0.0, 10.0]), np.ones(2)), np.array([0.0, 10.0]), np.linspace(0.0, 1.0, 11)
"""


def test_a_slip_ends_at_any_time_that_a_double_holds() -> None:
    """Nanoseconds are no step at a time since 1970."""
    slip = '{"slip_1": 1.0, "slip_time_1": SINCE + 0.5}'
    tip = run_apart(
        SIMULATES + "SINCE = 1.7e9; t += SINCE\n"
        f"print(*_native.simulate_effects({slip}, plays, c_deg, t, 10.0 * (t - SINCE), t)[2])"
    )
    np.testing.assert_allclose([float(c) for c in tip.split()][-5:], [6.5, 7.5, 8.5, 9.5, 10.5], atol=1e-6)


def test_an_infinite_time_is_refused() -> None:
    said = run_apart(
        SIMULATES
        + "try:\n    _native.simulate_effects({'loose_pull': 1.0}, plays, c_deg, t, t, np.array([0.0, np.inf]))\n"
        "except ValueError as refused:\n    print(refused)"
    )
    assert said.strip() == "at_s must not be infinite"


def test_plays_that_are_refused_leave_nothing_behind() -> None:
    grid = np.zeros(20_000)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(500):  # 160 MB, were they kept
        with pytest.raises(ValueError, match="not a backlash table"):
            _native.Plays(grid, grid)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # kB


def test_speeds_are_taken_whole_or_not_at_all() -> None:
    config = _native.MotionConfig()
    config.speed = [256, 512]
    with pytest.raises(TypeError):
        config.speed = [1, "fast", 3]
    with pytest.raises(ValueError, match="at most"):
        config.speed = list(range(20))
    assert config.speed == [256, 512]


def test_a_direction_that_no_byte_holds_is_refused() -> None:
    with pytest.raises(TypeError):
        _native.Motion().onset(257)


def any_of(kind: str) -> tuple[str, dict[str, object], str]:
    """A message with such a field, all its fields, and that one's name."""
    for name, message in _native.wire.MESSAGES.items():
        fields = {
            field: "" if kind == "text" else (0,) * count if count > 1 else 0
            for field, kind, count, _ in message["fields"]
        }
        for field, of, count, _ in message["fields"]:
            if of == kind or (kind == "array" and count > 1 and of != "text"):
                return name, fields, field
    raise AssertionError(kind)


@pytest.mark.parametrize(
    ("kind", "value"), [("text", 5), ("text", None), ("array", 5), ("array", None), ("array", {0, 1, 2, 3})]
)
def test_a_field_of_another_kind_is_named(kind: str, value: object) -> None:
    name, fields, field = any_of(kind)
    _native.wire.encode(name, 0, fields)
    with pytest.raises(ValueError, match=f"{field}: expected"):
        _native.wire.encode(name, 0, {**fields, field: value})


def test_a_table_s_field_out_of_range_is_named() -> None:
    empty, model = np.zeros(0, np.int32), b"12345678"
    with pytest.raises(ValueError, match="axis is not of the kind"):
        _native.table_encode({"axis": 300}, empty, empty, model)
    with pytest.raises(KeyError, match="axis"):
        _native.table_encode({}, empty, empty, model)


def test_a_picture_of_shares_is_not_taken_for_levels() -> None:
    """Converted, all of it below 1 would be black."""
    lit, expected = np.full((40, 40, 3), 0.9), _native.MarkerExpected(10.0)
    with pytest.raises(TypeError, match="incompatible function arguments"):
        _native.marker_measure(lit, np.ones(4, np.float32), 0.5, 20.0, 20.0, 10.0, 15, expected)


def test_lines_are_looked_up_among_uneven_knots_in_any_order() -> None:
    rng = np.random.default_rng(0)
    knots = np.cumsum(10.0 ** rng.uniform(-4.0, 0.0, 300))
    values, x = rng.normal(size=300), rng.uniform(-1.0, knots[-1] + 1.0, 2000)
    for at in (x, np.sort(x), np.concatenate([knots, [-np.inf, np.inf]])):
        np.testing.assert_array_equal(_native.lines_at(at, knots, values), np.interp(at, knots, values))
    assert np.isnan(_native.lines_at(np.array([np.nan]), knots, values)).all()
    np.testing.assert_array_equal(_native.lines_at(np.array([-1.0, 2.0]), np.zeros(1), np.ones(1)), [1.0, 1.0])
