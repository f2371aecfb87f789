"""Where an image stands still: the native loops beside plain numpy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline import _native

Array = np.ndarray


def left_level(z: Array) -> int | None:
    """By its definition: the least frame at which a mean of some length sees it."""
    wobble = 0.02 * np.sqrt(np.max(np.sum((z - z[0]) ** 2, axis=1), initial=0.0))

    def off(at: int, block: int) -> bool:
        apart = z[at : at + block].mean(axis=0) - z[:at].mean(axis=0)
        return bool(np.linalg.norm(apart) > max(5.5 * np.sqrt(1 / block + 1 / at), wobble))

    seen = []
    for block in (1, 2, 4, 8, 16, 32):
        for at in range(1, len(z) - block + 1):
            if off(at, block) and (block > 1 or (at + 1 < len(z) and off(at + 1, 1))):
                seen.append(at + block - 1)
    return min(seen, default=None) if len(z) >= 3 else None


@given(
    seed=st.integers(0, 10_000),
    n=st.integers(1, 90),
    seen=st.sampled_from([1, 2]),
    begins=st.integers(0, 90),
    slope=st.sampled_from([0.0, 0.05, 0.5, 5.0]),
)
def test_a_level_is_left_where_its_definition_says(seed: int, n: int, seen: int, begins: int, slope: float) -> None:
    rng = np.random.default_rng(seed)
    z = rng.normal(0.0, 1.0, (n, seen)) + 50.0
    z[:, 0] += slope * np.maximum(np.arange(n) - begins, 0)
    assert _native.still_until(z) == left_level(z)


def test_one_frame_alone_leaves_no_level() -> None:
    z = np.zeros((40, 2))
    z[20] = 5.0, 5.0
    assert _native.still_until(z) is None
    z[21] = z[20]
    assert _native.still_until(z) == 20
    assert _native.still_until(np.zeros((0, 2))) is None


@given(
    seed=st.integers(0, 10_000),
    seen=st.sampled_from([1, 2]),
    order=st.sampled_from([1, 2]),
    direction=st.sampled_from([1, -1]),
    frames=st.integers(6, 60),
)
def test_what_a_stop_leaves_is_that_of_a_least_squares_fit(
    seed: int, seen: int, order: int, direction: int, frames: int
) -> None:
    """With its ridge as rows of the system, of a ramp in units of its furthest and places from the first one on."""
    rng = np.random.default_rng(seed)
    motor_s = np.sort(rng.uniform(0.0, 2.0, 80))
    motor_q = direction * -np.abs(motor_s - 1.0) * rng.uniform(0.3, 3.0)
    arrival = np.sort(rng.uniform(0.0, 2.2, frames))
    z = rng.normal(0.0, 5.0, (frames, seen)) + 300.0
    delays = np.linspace(-0.3, 0.3, 9)
    told = _native.still_squares(arrival, z, motor_s, motor_q, 1.0, 0.0, direction, order, delays)
    for delay, squares in zip(delays, told, strict=True):
        scene = arrival - delay
        ramp = np.where(scene < 1.0, np.minimum(direction * np.interp(scene, motor_s, motor_q), 0.0), 0.0)
        unit = ramp / max(np.abs(ramp).max(), 1e-12)
        basis = np.stack([unit**k for k in range(order + 1)], axis=1)
        rows = np.vstack([basis, np.sqrt(1e-11 * frames) * np.eye(order + 1)])
        places = np.vstack([z - z[0], np.zeros((order + 1, seen))])
        left = places - rows @ np.linalg.lstsq(rows, places, rcond=None)[0]
        assert squares == pytest.approx(np.sum(left**2), rel=1e-8)
