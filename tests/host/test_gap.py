"""The noise below a gap: of a still picture, whatever it remembers and whatever happens in between."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tautline import independence
from tautline.diagnosis import gap
from tautline.diagnosis.segment import Segment
from tautline.recording import Motor

PERIOD_S = 0.04


def still(noise: np.ndarray) -> Segment:
    """Rests of 2 s between moves of 0.4 s, under this noise (n, 2)."""
    t = PERIOD_S * np.arange(len(noise))
    q = np.repeat(np.arange(np.ceil(t[-1] / 2.4) + 1), 2)
    motor_t = np.sort(np.concatenate([2.4 * np.arange(len(q) // 2), 2.4 * np.arange(len(q) // 2) + 2.0]))
    motor = Motor(t, np.interp(t, motor_t, q), None)
    return Segment("s", motor, t, noise + 3.0 * motor.q[:, None], t >= 0.0, 0.0, False)


def remembering(rho: float, seed: int, n: int = 4000) -> np.ndarray:
    white = np.random.default_rng(seed).normal(size=(n + 100, 2)) * np.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], white, axis=0)[100:]


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_floor_is_the_noise_that_is_there_between_rests_too(rho, seed):
    """Less a line over 35 frames, noise with a memory of 0.7 shows 88 % of itself."""
    noise = 0.05 * remembering(rho, seed)
    assert gap.noise_floor([still(noise)], [noise]) == pytest.approx(0.05, rel=0.05)


@pytest.mark.parametrize("rho", [0.0, 0.4, 0.7])
def test_the_floor_is_the_noise_that_is_there_where_the_motor_never_rests(rho):
    """Second differences alone would show half of noise with a memory of 0.7."""
    noise = 0.05 * remembering(rho, 4)
    t = np.arange(4000) / 60.0
    motor = Motor(t, 3.0 * np.sin(0.7 * t), None)
    left = noise + np.column_stack([0.4 * np.sign(np.sin(0.7 * t)), 0.4 * np.sin(0.7 * t + 1.0)])
    segment = Segment("s", motor, t, left, t >= 0.0, 0.0, False)
    assert gap.noise_floor([segment], [left], [left[:, 1:]]) == pytest.approx(0.05, rel=0.07)
    white = gap.noise_floor([segment], [left])
    assert white == pytest.approx(0.05 * np.sqrt((6.0 - 8.0 * rho + 2.0 * rho**2) / 6.0), rel=0.07)


def test_frames_that_are_elsewhere_count_and_a_rest_that_is_moved_does_not():
    rng = np.random.default_rng(3)
    noise = 0.05 * rng.normal(size=(4000, 2))
    strays = rng.random(4000) < 0.02
    noise[strays] += rng.normal(0.0, 0.25, (int(strays.sum()), 2))
    assert gap.noise_floor([still(noise)], [noise]) == pytest.approx(np.sqrt(np.mean(noise**2)), rel=0.05)
    moved = noise.copy()
    moved[1015:] += 20.0  # within a rest
    assert gap.noise_floor([still(moved)], [moved]) == pytest.approx(gap.noise_floor([still(noise)], [noise]), rel=0.02)


def test_what_is_left_of_a_straight_line_is_what_theory_says():
    """Sums of squares and of neighbours' products, drawn 20 000 times, against their expectation."""
    n, at = 12, 20
    rho = independence.MEMORIES[at]
    line = np.column_stack([np.ones(n), np.arange(n)])
    drawn = remembering(rho, 5, 40_000 * n)[:, 0].reshape(-1, n)
    left = drawn - drawn @ line @ np.linalg.pinv(line.T @ line) @ line.T
    squares, neighbours = independence.expected_sums(n)[:, at]
    assert np.mean(np.sum(left**2, axis=1)) == pytest.approx(squares, rel=0.02)
    assert np.mean(np.sum(left[:, 1:] * left[:, :-1], axis=1)) == pytest.approx(neighbours, rel=0.02)


@pytest.mark.parametrize(("rho", "strays"), [(0.0, 0.0), (0.7, 0.0), (0.0, 0.02)])
def test_numbers_that_tell_the_same_are_told_by_how_much_their_power_scatters(rho, strays):
    """Of blocks of 200: the variance of their mean squares, in that of white Gaussian noise."""
    rng = np.random.default_rng(8)
    noise = remembering(rho, 8, 40_000)
    noise = noise + (rng.random((40_000, 2)) < strays) * rng.normal(0.0, 6.0, (40_000, 2))
    power = np.mean(np.minimum(np.abs(noise), 5.0).reshape(200, -1) ** 2, axis=1)
    scatters = float(np.var(power) / np.mean(power) ** 2) / (2.0 / 400)
    assert gap.noise_samples_per_independent([still(noise[:8000])], 5.0) == pytest.approx(scatters, rel=0.3)
