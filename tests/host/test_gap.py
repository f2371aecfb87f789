"""The noise below a gap: of a still picture, whatever it remembers and whatever happens in between."""

from dataclasses import replace

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


def moving(t: np.ndarray, q: np.ndarray) -> Segment:
    return Segment("s", Motor(t, q, None), t, q[:, None], t >= 0.0, 0.0, False)


def lengths(segment: Segment) -> np.ndarray:
    number = gap.blocks(segment)
    return PERIOD_S * np.bincount(number)


@pytest.mark.parametrize(("half_cycle_s", "duration_s"), [(1.1, 11.0), (1.5, 30.0), (4.0, 67.0)])
def test_blocks_are_alike_in_length_and_end_where_the_motor_turns(half_cycle_s, duration_s):
    t = np.arange(0.0, duration_s, PERIOD_S)
    strokes = moving(t, half_cycle_s * np.abs((t / half_cycle_s) % 2.0 - 1.0))
    long = lengths(strokes)
    assert len(long) == max(4, int(duration_s // gap.BLOCK_S))
    assert long.max() <= 3.0 * long.min()  # each end moves by a quarter at most
    if half_cycle_s < 0.5 * long.mean():
        ends_s = np.cumsum(long)[:-1]
        assert np.abs(ends_s / half_cycle_s - np.round(ends_s / half_cycle_s)).max() < 2.0 * PERIOD_S


def test_where_the_motor_hardly_turns_blocks_are_as_long_as_they_can_be():
    """7.4 s with one turn, after 5: halves of five parts hold both directions, and those of fewer do not."""
    t = np.arange(0.0, 7.4, PERIOD_S)
    assert lengths(moving(t, -np.abs(t - 5.0))) == pytest.approx(7.4 / 5, abs=2.0 * PERIOD_S)
    assert len(lengths(moving(t, t))) == 1


def test_a_long_block_counts_as_much_as_what_it_was_cut_into():
    """A model that is better throughout 6 of 10 s is better, whether the rest is one block or twelve."""
    before, after = np.ones((1000, 1)), np.where(np.arange(1000) < 600, 0.5, 1.01)[:, None]
    label = np.where(np.arange(1000) < 600, np.arange(1000) // 300, 2 + (np.arange(1000) - 600) * 12 // 400)
    shorter = gap.bootstrap([before], [after], [label])
    assert np.mean(shorter[1] < shorter[0]) > 0.95
    equal = gap.bootstrap([before], [after], [np.arange(1000) // 200])
    assert np.std(shorter[1]) == pytest.approx(np.std(equal[1]), rel=0.4)


def test_recordings_have_a_noise_each_where_that_is_likelier():
    rng = np.random.default_rng(6)
    white = [rng.normal(size=(16000, 1)) for _ in range(3)]
    calibration, *tests = [replace(still(np.tile(noise, 2)), calibration=k == 0) for k, noise in enumerate(white)]
    segments = [calibration, *tests]
    assert gap.relative_noise(segments, [0.05 * noise for noise in white]) == [1.0, 1.0, 1.0]
    of_each = gap.relative_noise(segments, [size * noise for size, noise in zip((0.2, 0.05, 0.1), white, strict=True)])
    tests_rms = np.sqrt(np.mean(np.square([0.05, 0.1])))
    assert of_each == pytest.approx([0.2 / tests_rms, 0.05 / tests_rms, 0.1 / tests_rms], rel=0.05)
    assert gap.relative_noise(segments, None) == [1.0, 1.0, 1.0]
