"""Motors that stop and turn at once, and readings with noise and no steps: where the motor was, and what it makes of B.

The plants share nothing with the library: a play in plain numpy, motions drawn at random, logs at 50 to 250 Hz."""

import math
from dataclasses import replace

import numpy as np
import pytest
from angle_plant import RIG, Motion, record, tip, width
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import chi2

from tautline import _native, encoder
from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.calibration.result import Calibration
from tautline.core.motor import MotorPath
from tautline.driven import change_factors, driven, white_noise
from tautline.model import Model
from tautline.prediction import predict, predict_with_sigma
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, AngleSensor, Coarse, Rig

COUNT = RIG.actuator.encoder_resolution
TURNS = (0, 30, -20, 25, -30, 10, -5, 20, -33, 33, 0)


def error_of(found: Calibration, truth) -> tuple[float, float]:
    """rms error of B, its unit, and its ratio to the sigma that is stated."""
    model = found.model
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    off = model.width[inside] - truth(model.q[inside])
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean((off / model.width_sigma[inside]) ** 2)))


def jerky(rng: np.random.Generator, turns: int, speed: float, reach: float, dwell_s: float) -> Motion:
    """Strokes at one speed to random places, with no time to speed up, 1 kHz."""
    ends = np.concatenate([[0.0], rng.uniform(-reach, reach, turns)])
    steps = np.abs(np.diff(ends)) / speed
    t_s = np.concatenate([[0.0], np.cumsum(np.column_stack([np.full(turns, dwell_s), steps]).ravel())])
    at = np.arange(0.0, t_s[-1], 1e-3)
    return Motion(at, np.interp(at, t_s, np.repeat(ends, 2)[:-1]))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([2, 3]), st.integers(4, 12), st.booleans())
def test_a_sweep_is_the_gaussian_that_its_equations_say(seed, order, size, rounded):
    """Against a dense solution; readings that are not rounded leave their noise as they are."""
    rng = np.random.default_rng(seed)
    step, q = rng.uniform(0.5, 2.0, size - 1), rng.normal(0.0, 3.0, size)
    read = (rng.uniform(size=size) < 0.7).astype(np.uint8)
    read[[0, size // 2, -1]] = 1  # as many as a parabola has unknowns
    precision = read / 0.4**2
    jumped = np.where(rng.uniform(size=size - order) < 0.5, -1.0, rng.uniform(0.1, 2.0, size - order))
    at, change = np.concatenate([[0.0], np.cumsum(step)]), np.zeros((size - order, size))
    factors = np.zeros((size - order, order + 1))
    for k in range(size - order):  # the derivative of a polynomial of that degree through as many nodes
        for j, one in enumerate(np.eye(order + 1)):
            factors[k, j] = math.factorial(order) * np.polyfit(at[k : k + order + 1] - at[k], one, order)[0]
        change[k, k : k + order + 1] = factors[k]
    np.testing.assert_allclose(change_factors(order, step), factors, rtol=1e-9)
    jump = 0.3
    weight = np.where(jumped < 0, 1 / jump, 2 / (jump + jumped))
    dense = np.linalg.inv(np.diag(precision) + change.T @ (weight[:, None] * change))
    state, variance, squares = np.zeros(size), np.zeros(size), jumped.copy()
    half = 0.5 if rounded else 0.0
    holds, noise, told = _native.sweep(
        factors, q, read, half, 0.4, jump, state, precision.copy(), precision * q, squares, variance
    )
    assert holds and noise > 0 and np.isfinite(told)
    np.testing.assert_allclose(state, dense @ (precision * q), rtol=1e-5, atol=1e-7)
    np.testing.assert_allclose(variance, np.diag(dense), rtol=1e-5)
    expected = np.square(change @ state) + np.diag(change @ dense @ change.T)
    np.testing.assert_allclose(squares, expected, rtol=1e-5, atol=1e-9)


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([2, 3]), st.booleans())
def test_a_sweep_matches_the_moments_of_each_reading(seed, order, rounded):
    """Against integrals over the path's place; strays, of which only an end of the distribution tells, less closely."""
    rng, size, white = np.random.default_rng(seed), 150, 0.3**2
    change = change_factors(order, np.ones(size - 1))
    stray = rng.uniform(size=size) < 0.1
    q = np.rint(20.0 * np.sin(0.05 * np.arange(size))) + stray * rng.choice([-5.0, -3.0, 3.0, 5.0], size)
    read = (rng.uniform(size=size) < 0.8).astype(np.uint8)
    read[[0, -1]] = 1
    before = read / 0.4**2
    state, variance, precision, force = np.zeros(size), np.zeros(size), before.copy(), before * q
    squares = np.full(size - order, -1.0)
    half = 0.5 if rounded else 0.0
    holds, noise, told = _native.sweep(
        change, q, read, half, np.sqrt(white), 1e-3, state, precision, force, squares, variance
    )
    assert holds
    all_told, far = 0.0, 0
    for k in np.flatnonzero(read):
        other = 1.0 / (1.0 / variance[k] - before[k])
        without = other * (state[k] / variance[k] - before[k] * q[k])
        x = without + np.sqrt(other) * np.linspace(-14.0, 14.0, 40001)
        seen = (
            ndtr((q[k] + half - x) / np.sqrt(white)) - ndtr((q[k] - half - x) / np.sqrt(white))
            if rounded
            else np.exp(-0.5 * (q[k] - x) ** 2 / white) / np.sqrt(2 * np.pi * white)
        )
        weight = seen * np.exp(-0.5 * (x - without) ** 2 / other) / np.sqrt(2 * np.pi * other) * (x[1] - x[0])
        whole = weight.sum()
        all_told += np.log(max(whole, 1e-12))
        if whole < 1e-9:  # its tail is an exponential
            far += 1
            continue
        mean = weight @ x / whole
        matched = 1.0 / (weight @ (x - mean) ** 2 / whole)
        if matched - 1.0 / other > 1e-6:
            own = np.array([matched - 1.0 / other, mean * matched - without / other])
            expected = 0.3 * before[k] * np.array([1.0, q[k]]) + 0.7 * own
            np.testing.assert_allclose([precision[k], force[k]], expected, rtol=2e-6, atol=2e-6)
    assert told == pytest.approx(all_told, rel=1e-6, abs=0.05 * far)  # equation: by 1 / z^2 beyond six sigmas
    assert 0.0 < noise < 5.0


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 1000), st.sampled_from([50.0, 100.0, 200.0]), st.floats(3.0, 30.0))
def test_corners_between_samples_are_found(seed, hertz, speed):
    """Within three counts; an interpolated log cuts a corner by up to a quarter of a sample's way."""
    motion = jerky(np.random.default_rng(seed), 8, speed, 35.0, 0.3)
    stride = round(1000.0 / hertz)
    t_s, q = motion.t_s[::stride], np.round(motion.q[::stride] / COUNT) * COUNT
    path = driven(t_s, q, COUNT, rounded=True)
    known = motion.t_s <= t_s[-1]
    off = np.abs(np.interp(motion.t_s, path.t_s, path.q) - motion.q)[known]
    assert np.sqrt(np.mean(off**2)) < 0.5 * COUNT
    assert np.mean(off > 3.0 * COUNT) < 0.01
    assert (np.diff(path.t_s) > 0).all() and path.t_s[0] == t_s[0] and path.t_s[-1] == pytest.approx(t_s[-1])


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 1000), st.floats(0.002, 0.05), st.sampled_from([4, 1]))
def test_noise_of_readings_is_no_motion_and_its_size_is_found(seed, noise, every):
    rng = np.random.default_rng(seed)
    motion = jerky(rng, 10, 4.0, 10.0, 0.3)
    t_s, true = motion.t_s[::every], motion.q[::every]
    q = true + rng.normal(0.0, noise, len(true))
    path = driven(t_s, q, white_noise(t_s, q), rounded=False)
    off = np.interp(t_s, path.t_s, path.q) - true
    assert path.noise == pytest.approx(noise, rel=0.1)
    assert np.sqrt(np.mean(off**2)) < 0.35 * noise
    sigma = np.interp(t_s, path.t_s, path.sigma)
    assert 0.5 < np.sqrt(np.mean((off / sigma) ** 2)) < 2.0


@pytest.mark.parametrize("um", [2.0, 5.0])
def test_noise_below_the_rigs_step_bends_no_width(um):
    """A joint of 10 mm with B of 0.5 mm, white noise on its motor's readings, 250 Hz: without a step in them."""
    rng = np.random.default_rng(7)
    rig = Rig(Actuator("mm", (-6.0, 6.0), 0.01), Coarse(10.0, 0.0))
    motion = jerky(rng, 14, 1.2, 5.0, 0.1)
    half = 0.25
    state, tips = 0.0, np.empty(len(motion.q))
    for k, at in enumerate(motion.q.tolist()):
        state = min(max(state, at - half), at + half)
        tips[k] = state
    arrival = np.arange(0.1, motion.t_s[-1] - 0.05, 1 / 60)
    c = 10.0 * np.interp(arrival - 0.03, motion.t_s, tips) + rng.normal(0.0, 0.02, len(arrival))
    read = motion.q[::4] + rng.normal(0.0, 1e-3 * um, len(motion.q[::4]))
    found = calibrate([Recording("joint", Motor(motion.t_s[::4], read), angle=Angle(arrival, c), rig=rig)], rig)
    off, over_sigma = error_of(found, lambda q: 2 * half + 0.0 * q)
    print(f"{um:g} um: B {1e3 * off:.2f} um off, {over_sigma:.2f} sigma")
    assert off < 5e-3 and over_sigma < 3.0


def test_a_motor_that_turns_at_once_is_known_at_50_hz():
    found = calibrate([record(Motion.through(), motor_hz=50.0, sensor_hz=60.0, delay_s=0.03)], RIG)
    off, over_sigma = error_of(found, width)
    print(f"B {off:.4f} deg off, {over_sigma:.2f} sigma; delay {1e3 * found.model.delay_s:.2f} ms of 30")
    assert off < 0.01 and over_sigma < 3.0
    assert abs(found.model.delay_s - 0.03) < 5e-4


def true_model() -> Model:
    q = np.linspace(-40.0, 40.0, 1025)
    bend = 0.95 * q + 2.0 * np.sin(q / 20.0)
    return Model(RIG, q, width(q), np.full(len(q), 0.01), bend, 0.0, (-35.0, 35.0))


@pytest.mark.parametrize("hertz", [50.0, 100.0, 200.0])
def test_the_tip_of_a_motor_that_turns_at_once_is_foretold(hertz):
    motion = Motion.through(TURNS, 20.0)
    stride = round(1000.0 / hertz)
    motor = Motor(motion.t_s[::stride], np.round(motion.q[::stride] / COUNT) * COUNT)
    settled = (motion.t_s > 4.0) & (motion.t_s < motor.t_s[-1])
    off = (predict(true_model(), motor, motion.t_s).c_deg - tip(motion.q))[settled]
    print(f"{hertz:g} Hz: {np.sqrt(np.mean(off**2)):.4f} deg rms, {np.abs(off).max():.4f} at most")
    assert np.abs(off).max() < 0.02


@pytest.mark.parametrize("hertz", [50.0, 100.0])
def test_a_servo_of_4096_counts_makes_no_width_by_speed(hertz):
    rng = np.random.default_rng(5)
    count, b = 0.088, 6.0
    rig = Rig(Actuator("deg", (-60.0, 60.0), count), Coarse(1.0, 0.0), angle=AngleSensor(0.02))
    t_s, q = [0.0], [0.0]
    for i, end in enumerate(rng.uniform(-50.0, 50.0, 16).tolist()):
        t_s += [t_s[-1] + abs(end - q[-1]) / (10.0, 25.0, 60.0)[i % 3], 0.0]
        t_s[-1] = t_s[-2] + 0.2
        q += [end, end]
    at = np.arange(0.0, t_s[-1], 1e-3)
    positions = np.interp(at, t_s, q)
    state, tips = 0.0, np.empty(len(at))
    for k, position in enumerate(positions.tolist()):
        state = min(max(state, position - b / 2), position + b / 2)
        tips[k] = state
    arrival = np.arange(0.1, at[-1] - 0.05, 1 / 60)
    c = np.interp(arrival - 0.02, at, 0.9 * tips + 3.0 * np.sin(tips / 30.0)) + rng.normal(0.0, 0.03, len(arrival))
    stride = round(1000.0 / hertz)
    motor = Motor(at[::stride], np.round(positions[::stride] / count) * count)
    found = calibrate([Recording("servo", motor, angle=Angle(arrival, c), rig=rig)], rig)
    off, over_sigma = error_of(found, lambda places: b + 0.0 * places)
    print(f"{hertz:g} Hz: B {off:.4f} deg of {b:g} off, {over_sigma:.2f} sigma")
    assert off < 0.05 and over_sigma < 3.0
    assert not any("rate_dependent" in reason.code for reason in found.model.quality.reasons)


@pytest.mark.parametrize("readings", [1500, 90, 30])
def test_a_bent_command_is_no_noise(readings):
    """A sine's third differences are large at 50 Hz, and neighbours are alike; white noise's are opposite. Of few
    readings nobody can tell."""
    t_s = 0.02 * np.arange(readings)
    q = 30.0 * np.sin(3.0 * t_s) * np.cos(0.4 * t_s)
    assert white_noise(t_s, q) > 1e-5 * np.ptp(q)
    path = MotorPath.of(Motor(t_s, q), 0.088)
    np.testing.assert_allclose(path.at(t_s), q, atol=1e-9)
    if readings < 100:
        return
    read = q + np.random.default_rng(2).normal(0.0, 0.03, len(q))
    off = MotorPath.of(Motor(t_s, read), 0.088).at(t_s) - q
    assert np.sqrt(np.mean(off**2)) < 0.03


@pytest.mark.parametrize("hertz", [100.0, 250.0])
def test_a_path_states_where_it_is_known_and_a_prediction_has_that_in_its_sigma(hertz):
    """Noise without a step: nine intervals in ten hold the motor, and at its turns it is known worse."""
    z, corner, between = [], [], []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        motion, stride = jerky(rng, 10, 8.0, 35.0, 0.3), round(1000.0 / hertz)
        t_s, true = motion.t_s[::stride], motion.q[::stride]
        path = MotorPath.of(Motor(t_s, true + rng.normal(0.0, 0.5 * COUNT, len(t_s))), COUNT)
        at = motion.t_s[motion.t_s <= t_s[-1]]
        off, sigma = path.at(at) - motion.q[: len(at)], path.sigma_at(at)
        z.append(off / sigma)
        turns = np.abs(np.diff(motion.q[: len(at)], 2, prepend=0.0, append=0.0)) > 1e-6
        corner.append(sigma[turns].mean())
        between.append(np.median(sigma))
    share = float(np.mean(np.abs(np.concatenate(z)) < 1.645))
    print(f"{hertz:g} Hz: {100 * share:.1f} % within the 90 % interval")
    assert 0.8 < share < 0.97
    assert np.mean(corner) > 1.5 * np.mean(between)
    model = replace(true_model(), width_sigma=np.full(1025, 1e-9), c_sigma=None)
    told = predict_with_sigma(model, path.readings, at, 0.0).c_sigma_deg
    assert told is not None
    known = np.sqrt(np.maximum(told**2 - model.noise_of(model.sensor) ** 2, 0.0))
    tips = [tip(motion.q[: len(at)] + shift) for shift in (0.01, -0.01)]
    away = np.abs(known - np.abs(tips[0] - tips[1]) / 0.02 * sigma)[at > 10.0]  # driven both ways before
    assert np.quantile(away, 0.95) < 0.05 * np.median(sigma)


def test_calibration_and_prediction_have_one_motion_of_it():
    """Nothing is replaced: what a calibration works on is the path that predict takes, to a rounding."""
    recording = record(Motion.through(TURNS, 20.0), motor_hz=50.0)
    track, path = observe([recording], RIG)[0], MotorPath.of(recording.motor, COUNT)
    at = np.linspace(recording.motor.t_s[0], recording.motor.t_s[-1], 5000)
    np.testing.assert_allclose(track.motor_at(at), path.at(at), atol=1e-9)
    whole = MotorPath.of(replace(recording.motor), COUNT)
    assert np.array_equal(whole.lines.q, path.lines.q)  # the same readings, the same path


def times(rng: np.random.Generator, size: int, uneven: float) -> np.ndarray:
    """About 10 ms apart, each gap another by up to this share of it."""
    return np.cumsum(0.01 * (1.0 + uneven * rng.uniform(-1.0, 1.0, size)))


@given(seed=st.integers(0, 1000), uneven=st.floats(0.0, 0.95), noise=st.floats(1e-3, 1.0))
def test_noise_is_told_at_uneven_times(seed, uneven, noise):
    """Of a parabola of time nothing is noise, however its readings come; at even times third differences tell."""
    rng = np.random.default_rng(seed)
    t_s = times(rng, 2000, uneven)
    way = 3.0 + 40.0 * t_s - 2.0 * t_s**2
    assert white_noise(t_s, way) < 1e-6
    readings = way + rng.normal(0.0, noise, len(way))
    assert white_noise(t_s, readings) == pytest.approx(noise, rel=0.25)
    even = 0.01 * np.arange(len(way))
    third = np.diff(readings, 3)
    by_median = float(np.sqrt(np.median(third**2) / chi2(1).median() / 20.0))
    assert white_noise(even, readings) == pytest.approx(by_median, rel=1e-6)


@given(seed=st.integers(0, 1000), uneven=st.floats(0.0, 0.9))
def test_readings_at_uneven_times_are_smoothed_as_at_even_ones(seed, uneven):
    """Noise of a count's tenth on a turn: less than half of it is left, and nothing of the uneven times is added."""
    rng = np.random.default_rng(seed)
    t_s = times(rng, 600, uneven)
    way = 5.0 * np.sin(2.0 * t_s)
    readings = way + rng.normal(0.0, 0.1, len(way))
    left = encoder._smoothed(t_s, readings) - way
    assert np.std(left) < 0.05


@pytest.mark.parametrize("uneven", [0.0, 0.9])
def test_lines_between_uneven_samples_are_as_far_off_as_their_gaps_let_them(uneven):
    t_s = times(np.random.default_rng(2), 3000, uneven)
    motor = Motor(t_s, 5.0 * np.sin(3.0 * t_s))
    sharpest = 5.0 * 9.0 * (0.01 * (1.0 + uneven)) ** 2 / 8.0
    assert 0.3 * sharpest < encoder.between_samples(motor) < 1.2 * sharpest


def test_a_log_at_uneven_times_is_calibrated_as_one_at_even_times():
    """Times that are true, as a program's loop takes them: B was right, its sigma fifty times its error, before."""
    said = []
    for uneven in (0.0, 0.95):
        recording = record(Motion.through(speed=7.37))
        motor, rng = recording.motor, np.random.default_rng(3)
        t_s = np.arange(0.01, motor.t_s[-1], 0.01)
        t_s = t_s + 0.005 * uneven * rng.uniform(-1.0, 1.0, len(t_s))
        log = Motor(t_s, np.round(np.interp(t_s, motor.t_s, motor.q) / 0.01) * 0.01)
        said.append(calibrate([replace(recording, motor=log)], RIG).model)
    even, other = said
    assert even.quality.verdict == other.quality.verdict == "good"
    sigmas = [model.width_sigma[(model.q >= model.measured[0]) & (model.q <= model.measured[1])] for model in said]
    assert np.median(sigmas[1]) < 1.5 * np.median(sigmas[0])
    inside = (other.q >= other.measured[0]) & (other.q <= other.measured[1])
    assert np.max(np.abs(other.width - width(other.q))[inside]) < 0.01  # deg, a count


def test_coarse_counts_that_are_smoothed_leave_their_rounding():
    """Two whole counts a sample have no third difference, and a smoother is still a tenth of a count off at a turn."""
    t_s = 0.005 * np.arange(4000)
    way = 2.0 * np.abs(np.mod(t_s, 4.0) - 2.0)
    coarse, fine = (Motor(t_s, np.round(way / count) * count) for count in (0.005, 0.001))
    assert white_noise(coarse.t_s, coarse.q) < 1e-9
    assert encoder.smoothed_noise(coarse, 0.005) == pytest.approx(0.005 / np.sqrt(12.0))
    assert encoder.smoothed_noise(fine, 0.001) == 0.0
