"""What is made of an encoder's counts: stops and turns to a millisecond or two, few knots, nothing made up."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import trajectory
from tautline.encoder import between_counts, count_of, posterior_of, straight_lines, swings, with_few_knots
from tautline.recording import Motor

COUNT = 0.001


def counted(t, q, every=4) -> Motor:
    return Motor(t[::every], np.round(q[::every] / COUNT) * COUNT)


def rests(motor: Motor) -> list[tuple[float, float]]:
    still = np.flatnonzero(np.diff(motor.q) == 0)
    return [(float(motor.t_s[i]), float(motor.t_s[i + 1])) for i in still]


@settings(max_examples=15, deadline=None)
@given(
    st.floats(0.8, 3.0),
    st.floats(8.0, 25.0),
    st.floats(0.1, 1.0),
    st.lists(st.floats(-4.0, 4.0), min_size=3, max_size=6),
)
def test_rests_begin_and_end_when_the_motor_does(speed, acceleration, dwell, ends):
    points = np.array([0.0, *(round(e, 4) for e in ends)])
    if np.abs(np.diff(points)).min() < 0.3 or np.ptp(points) < 2.5:  # else a count is coarse
        points = np.array([0.0, 1.0, -1.5, 1.5])
    motion = trajectory.through(points, speed, acceleration, dwell)
    moving = np.abs(np.diff(motion.q)) > 1e-10
    edges = np.flatnonzero(np.diff(moving.astype(int)))
    stops, starts = (motion.t_s[edges[moving[edges] == was] + 1] for was in (True, False))
    lines = straight_lines(counted(motion.t_s, motion.q), COUNT)
    found = rests(lines)
    # The last count before a stop takes sqrt(2 * count / acceleration), 9 to 16 ms.
    errors = []
    for stop, start in zip(stops, starts, strict=False):
        begin, end = min(found, key=lambda rest: abs(rest[0] - stop))
        errors += [abs(begin - stop), abs(end - start)]
    assert max(errors) < 0.012
    assert np.abs(np.interp(motion.t_s, lines.t_s, lines.q) - motion.q).max() < 2.5 * COUNT


def test_stops_are_known_to_a_millisecond_in_the_mean():
    motion = trajectory.through([0.0, 1.0, -0.7, 2.3, 0.4, 1.9, -1.1], 1.0, 12.0, 0.4)
    lines = straight_lines(counted(motion.t_s, motion.q), COUNT)
    ramp, begin = 1.0 / 12.0, 0.0
    errors = []
    for a, b in zip([0.0, 1.0, -0.7, 2.3, 0.4, 1.9], [1.0, -0.7, 2.3, 0.4, 1.9, -1.1], strict=True):
        stop = begin + abs(b - a) + ramp
        errors.append(min(abs(rest[0] - stop) for rest in rests(lines)))
        begin = stop + 0.4
    assert np.mean(errors) < 0.0015


@pytest.mark.parametrize("share", [1e-4, 1e-2])
def test_few_knots_are_off_by_no_more_than_was_allowed(share):
    t_s = np.arange(0.0, 60.0, 0.01)
    motor = Motor(t_s, 3.0 * np.sin(t_s), None, 20.0 * np.cos(0.3 * t_s), None, np.sin(2.0 * t_s), {"wrist_deg": t_s})
    few = with_few_knots(motor, share)
    assert len(few.t_s) < 0.7 * len(t_s)
    columns = ("q", "translation_mm", "load_mNm")
    pairs = [(getattr(motor, name), getattr(few, name)) for name in columns]
    for was, now in [*pairs, (motor.joints["wrist_deg"], few.joints["wrist_deg"])]:
        assert np.abs(np.interp(t_s, few.t_s, now) - was).max() < 1.01 * share * np.ptp(was)
    assert few.rotation_deg is None


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("acceleration", "step_s"), [(12.0, 1e-3), (12.0, 4e-3), (30.0, 1e-3)])
def test_a_path_through_fine_counts_has_the_motors_place_and_speed(seed, acceleration, step_s):
    """A tenth of a count, a thousandth of the speed of 20 ms, which is what a law of speed leaves at a stop; the path's
    sigma covers."""
    rng = np.random.default_rng([seed, 7])
    ends = rng.uniform(1.0, 4.0, 16) * np.resize([1.0, -1.0], 16)
    motion = trajectory.through(ends, 1.37, acceleration, 0.3)
    t_s = np.arange(0.0, motion.t_s[-1], step_s)
    true = np.interp(t_s, motion.t_s, motion.q)
    motor = Motor(t_s, np.round(true / COUNT) * COUNT)
    lines, path = straight_lines(motor, COUNT), posterior_of(motor, COUNT)
    assert path is not None and len(lines.t_s) < 0.12 * motion.t_s[-1] / 1e-3
    at = np.arange(0.05, motion.t_s[-1] - 0.05, 1e-3)
    off = np.interp(at, lines.t_s, lines.q) - np.interp(at, motion.t_s, motion.q)
    speeds = (np.gradient(np.interp(at, *both), at) for both in ((lines.t_s, lines.q), (motion.t_s, motion.q)))
    found, speed = (np.convolve(np.abs(v), np.ones(20) / 20, mode="valid") for v in speeds)
    z = (path.q - np.interp(path.t_s, motion.t_s, motion.q)) / path.sigma
    print(f"{np.sqrt(np.mean(off**2)) / COUNT:.3f} counts, speed {np.sqrt(np.mean((found - speed) ** 2)):.4f}, "
          f"rms z {np.sqrt(np.mean(z**2)):.2f}, {len(lines.t_s)} knots")  # fmt: skip
    assert np.sqrt(np.mean(off**2)) < 0.12 * COUNT
    assert np.sqrt(np.mean((found - speed) ** 2)) < 0.0022 * 1.37
    assert np.mean(np.abs(z) < 2.0) >= 0.9


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1, 4, 20]), st.floats(0.5, 20.0))
def test_a_motor_that_creeps_and_trembles_is_where_its_readings_say(seed, every, counts):
    """Strokes among moves of a few counts with rests of any length: times rise, no reading is far from the lines."""
    rng = np.random.default_rng(seed)
    ends = np.concatenate([[0.0, 3.0], 3.0 + np.cumsum(rng.normal(0.0, counts * COUNT, 30)), [-1.0, -1.0 + COUNT, 2.0]])
    lasts = np.maximum(np.abs(np.diff(ends)) / 1.3, rng.uniform(0.02, 0.4, len(ends) - 1))
    rested = np.cumsum(np.column_stack([lasts, rng.uniform(0.0, 0.3, len(lasts))]).ravel())
    t_s = np.arange(0.0, rested[-1], 1e-3)[::every]
    q = np.interp(t_s, np.concatenate([[0.0], rested]), np.repeat(ends, 2)[1:])
    motor = Motor(t_s, np.round(q / COUNT) * COUNT)
    lines = straight_lines(motor, COUNT)
    assert (np.diff(lines.t_s) > 0).all()
    assert np.abs(np.interp(t_s, lines.t_s, lines.q) - motor.q).max() < 3.0 * COUNT


def test_a_turn_without_a_rest_is_where_the_motor_turned():
    motion = trajectory.through([0.0, 1.0, -0.7, 1.3, 0.0], 1.0, 12.0, 0.0)
    lines = straight_lines(counted(motion.t_s, motion.q), COUNT)
    for turn in (1.0 + 1 / 12, 1.0 + 1.7 + 2 / 12, 1.0 + 1.7 + 2.0 + 3 / 12):
        assert np.abs(lines.t_s - turn).min() < 0.003


@pytest.mark.parametrize("rest_s", [0.05, 0.9])
def test_a_jump_between_rests_is_between_two_samples(rest_s):
    """A recording in which a stretch of the motion was left out."""
    there = trajectory.through([0.0, -2.0], 1.0, 12.0, rest_s)
    back = trajectory.through([1.0, 3.0], 1.0, 12.0, 0.5)
    still = np.full(round(rest_s / 0.004), 1.0)
    q = np.concatenate([there.q[::4], still, back.q[::4]])
    motor = Motor(0.004 * np.arange(len(q)), np.round(q / COUNT) * COUNT)
    lines = straight_lines(motor, COUNT)
    assert np.abs(np.interp(motor.t_s, lines.t_s, lines.q) - motor.q).max() < 2.5 * COUNT


def test_other_axes_do_not_blur_a_rest():
    motion = trajectory.through([0.0, 1.0, -0.5], 1.0, 12.0, 0.5)
    plain = straight_lines(counted(motion.t_s, motion.q), COUNT)
    swayed = motion.with_sway(2.0, 20.0, 5.0)
    motor = counted(motion.t_s, motion.q)
    both = straight_lines(Motor(motor.t_s, motor.q, None, swayed.translation_mm[::4], swayed.rotation_deg[::4]), COUNT)
    for begin, end in rests(plain):
        assert np.ptp(both.q[(both.t_s >= begin) & (both.t_s <= end)]) == 0.0
    np.testing.assert_allclose(np.interp(plain.t_s, both.t_s, both.q), plain.q, atol=COUNT)
    np.testing.assert_allclose(np.interp(motion.t_s, both.t_s, both.translation_mm), swayed.translation_mm, atol=1.5e-3)


@pytest.mark.parametrize("count", [1, 2, 3, 50])
def test_a_motor_that_never_moves_or_chatters_stays(count):
    t = 0.004 * np.arange(count)
    assert np.ptp(straight_lines(Motor(t, np.full(count, 0.5)), COUNT).q) == 0.0
    chatters = straight_lines(Motor(t, COUNT * (np.arange(count) % 2)), COUNT)
    assert np.abs(chatters.q - 0.5 * COUNT).max() <= COUNT


def test_positions_that_are_no_counts_are_what_they_say():
    t = 0.004 * np.arange(2000)
    q = 3.0 * np.sin(0.7 * t) + 0.000123
    lines = straight_lines(Motor(t, q), COUNT)
    assert between_counts(Motor(t, q), COUNT).q is q
    np.testing.assert_allclose(np.interp(t, lines.t_s, lines.q), q, atol=1e-9)
    strokes = np.interp(t, [0, 2, 3, 5, 8], [0.000123, 2.1, 2.1, -1.7, -1.7])
    lines = straight_lines(Motor(t, strokes), COUNT)
    np.testing.assert_allclose(np.interp(t, lines.t_s, lines.q), strokes, atol=1e-9)
    assert len(lines.t_s) < 12


@pytest.mark.parametrize("count", [0.001, 0.005, 0.02, 0.1])
@pytest.mark.parametrize("noise", [0.0, 0.004])
def test_lines_are_as_near_to_the_truth_as_what_is_between_counts(count, noise):
    """Of smooth motions and of strokes, through fine counts, coarse ones and noise."""
    strokes = trajectory.through([0.0, 3.0, -2.0, 3.5, -4.0], 1.2, 12.0, 0.3)
    t = np.arange(0.0, 20.0, 0.002)
    for t_s, q in ((strokes.t_s[::4], strokes.q[::4]), (t, 3.0 * np.sin(0.7 * t) * np.cos(0.13 * t))):
        motor = Motor(t_s, np.round((q + np.random.default_rng(1).normal(0.0, noise, len(q))) / count) * count)
        lines = straight_lines(motor, count)
        errors = [
            float(np.sqrt(np.mean((np.interp(t_s, found.t_s, found.q) - q) ** 2)))
            for found in (between_counts(motor, count), lines)
        ]
        assert errors[1] < 1.2 * errors[0] + 2e-4
        assert len(lines.t_s) < 0.4 * len(t_s)


@pytest.mark.parametrize("seed", [11, 12])
def test_a_slow_motor_does_not_rest_in_every_coarse_count(seed):
    """Counts of 0.1 mm that last for 125, 67 and 25 ms, strokes that stop at once: a rest is anywhere in its count,
    0.29 of it, and when a count began is known to a millisecond."""
    count, turns, rest_s = 0.1, 26, 0.15
    ends = np.concatenate([[0.0], np.random.default_rng(seed).uniform(-4.5, 4.5, turns)])
    lasts = np.abs(np.diff(ends)) / np.resize([1.5, 4.0, 0.8], turns)
    times = np.concatenate([[0.0], np.cumsum(np.column_stack([np.full(turns, rest_s), lasts]).ravel())])
    t_s = np.arange(0.0, times[-1], 1e-3)
    q = np.interp(t_s, times, np.repeat(ends, 2)[:-1])
    lines = straight_lines(Motor(t_s, np.round(q / count) * count), count)
    off = np.interp(t_s, lines.t_s, lines.q) - q
    rests = turns * (rest_s + 0.5 * count / 0.8) / times[-1]  # with the way to the count's edge
    print(f"{1e3 * np.sqrt(np.mean(off**2)):.1f} um rms, of {1e3 * count * np.sqrt(rests / 12.0):.1f}")
    assert np.sqrt(np.mean(off**2)) < count * np.sqrt(rests / 12.0)


def test_a_count_is_what_the_readings_show_of_it():
    t = np.arange(0.0, 12.0, 0.02)
    q = 4.0 * np.sin(t)
    assert count_of(Motor(t, np.rint(q / 0.01) * 0.01), 0.01) == pytest.approx(0.01)
    assert count_of(Motor(t, np.rint(q / 0.033) * 0.033), 0.01) == pytest.approx(0.033)
    assert count_of(Motor(t, q), 0.01) < 1e-4  # a command
    assert count_of(Motor(t, q + np.random.default_rng(1).normal(0.0, 0.01, len(q))), 0.01) == 0.01


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.floats(0.003, 0.03), st.integers(200, 8000), st.floats(0.3, 0.9))
def test_a_motor_that_swings_is_taken_at_its_word_and_noisy_readings_are_not(seed, rms, readings, remembers):
    """White readings scatter about the motor's path; those that go to and fro are where it went."""
    rng = np.random.default_rng(seed)
    t = 0.01 * np.arange(readings)
    path, white = 4.0 * np.sin(0.5 * t), rng.normal(size=readings)
    swinging = np.zeros(readings)
    for k in range(1, readings):
        swinging[k] = -remembers * swinging[k - 1] + np.sqrt(1.0 - remembers**2) * white[k]
    noisy, trembling = (Motor(t, np.round((path + rms * off) / COUNT) * COUNT) for off in (white, swinging))
    assert not swings(noisy)
    smooth = between_counts(noisy, COUNT)
    assert np.sqrt(np.mean((smooth.q - path) ** 2)) < 0.5 * rms
    if readings * remembers**2 > 1000:  # fewer, or weaker ones, could be chance
        assert swings(trembling)
        assert np.abs(between_counts(trembling, COUNT).q - trembling.q).max() < COUNT


@pytest.mark.parametrize(("readings", "step_s"), [(10, 2e-4), (5, 5e-4)])
def test_readings_that_come_in_bursts_are_not_averaged_across_the_pauses(readings, step_s):
    t_s = np.repeat(np.arange(0.0, 20.0, 0.05), readings) + np.tile(step_s * np.arange(readings), 400)
    q = 3.0 * (1.37 - np.abs(t_s % 2.74 - 1.37))
    motor = Motor(t_s, np.round(q / COUNT) * COUNT)
    assert posterior_of(motor, COUNT) is not None
    lines = straight_lines(motor, COUNT)
    assert np.abs(np.interp(t_s, lines.t_s, lines.q) - q).max() < 3.0 * COUNT
