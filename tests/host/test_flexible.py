"""How far a model that knows no physics would close a gap: what repeats it finds, what does not it leaves."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from tautline.diagnosis import flexible
from tautline.diagnosis.segment import Segment
from tautline.recording import Motor

NOISE = 0.05


def segment(seed: int, seconds: float = 100.0) -> Segment:
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, seconds, 0.01)
    q = 4.0 * np.sin(2 * np.pi * t / 7.3 + seed)
    frames = np.arange(1.0, seconds - 1.0, 0.04)
    return Segment(f"s{seed}", Motor(t, q, None), frames, rng.normal(0, 1, (len(frames), 2)), frames > 3.0, 0.0, False)


SEGMENTS = [segment(1), segment(2)]


def noise(seed: int) -> list[np.ndarray]:
    rng = np.random.default_rng(seed)
    return [rng.normal(0.0, NOISE, (int(s.scored.sum()), 2)) for s in SEGMENTS]


def motor(s: Segment) -> np.ndarray:
    return np.interp(s.arrival_s, s.motor.t_s, s.motor.q)[s.scored]


def test_what_goes_with_position_and_direction_is_closed():
    residuals = [
        r + np.column_stack([0.6 * np.sin(1.5 * motor(s)), 0.4 * np.sign(np.gradient(motor(s)))])
        for s, r in zip(SEGMENTS, noise(3), strict=True)
    ]
    found = flexible.cross_validate(SEGMENTS, residuals, NOISE)
    assert found is not None and found.closable_shrink > 0.9
    assert found.before == pytest.approx(np.sqrt(np.mean(np.concatenate(residuals) ** 2)), rel=0.05)


def test_a_place_is_the_same_in_a_recording_of_a_smaller_range():
    wide, other = SEGMENTS
    pair = [wide, replace(other, motor=replace(other.motor, q=0.3 * other.motor.q))]
    residuals = [
        r + np.column_stack([0.6 * np.sin(1.5 * motor(s)), 0.4 * np.cos(motor(s))])
        for s, r in zip(pair, noise(6), strict=True)
    ]
    found = flexible.cross_validate(pair, residuals, NOISE)
    assert found is not None and found.closable_shrink > 0.98


def test_noise_is_left_as_it_is():
    found = flexible.cross_validate(SEGMENTS, noise(4), NOISE)
    assert found is not None and found.shrink < 0.03 and found.after < 1.05 * found.before


def test_scatter_larger_than_the_floor_is_not_called_closable():
    residuals = [8.0 * r for r in noise(5)]
    found = flexible.cross_validate(SEGMENTS, residuals, NOISE)
    assert found is not None and found.closable_shrink < 0.1


def test_one_block_has_no_other_half():
    one = SEGMENTS[0]
    ramp = replace(one, motor=replace(one.motor, q=0.05 * one.motor.t_s))
    assert flexible.cross_validate([ramp], [np.zeros((int(ramp.scored.sum()), 2))], NOISE) is None


def test_a_swing_of_its_own_period_is_found_and_closed():
    residuals = [
        r + 0.5 * np.sin(2 * np.pi * (s.arrival_s[s.scored] + s.offset_s) / 3.1)[:, None]
        for s, r in zip(SEGMENTS, noise(6), strict=True)
    ]
    found = flexible.cross_validate(SEGMENTS, residuals, NOISE)
    assert found is not None and found.swing_s == pytest.approx(3.1, rel=0.02)
    assert found.closable_shrink > 0.9


@pytest.mark.parametrize("period_s", [3.1, 0.9, 0.6])
def test_a_swing_of_twenty_minutes_is_no_slower_one(period_s):
    """Thinned evenly to 1500 frames a fast one looks slow, and between two rates 0.003 Hz apart it turns three times
    against either."""
    long = segment(1, 1200.0)
    swing = 0.5 * np.sin(2 * np.pi * long.arrival_s[long.scored] / period_s)[:, None]
    scatter = np.random.default_rng(2).normal(0.0, NOISE, (len(swing), 2))
    assert flexible._swing_period([long], [swing + scatter]) == pytest.approx(period_s, rel=0.02)


def test_what_is_the_same_throughout_does_not_swing():
    assert flexible._swing_period(SEGMENTS, [np.ones((int(s.scored.sum()), 2)) for s in SEGMENTS]) is None


def test_what_the_motor_makes_is_no_swing():
    for made in (lambda q: 0.1 * q, lambda q: 0.03 * q**2):
        residuals = [r + made(motor(s))[:, None] for s, r in zip(SEGMENTS, noise(7), strict=True)]
        found = flexible.cross_validate(SEGMENTS, residuals, NOISE)
        assert found is not None and found.swing_s is None and found.closable_shrink > 0.9


def test_the_likelihood_s_slopes_are_its_derivatives() -> None:
    rng = np.random.default_rng(5)
    x, y = rng.normal(size=(30, 3)), rng.normal(size=(30, 2))
    squares = (x[:, None] - x) ** 2
    at = rng.normal(0.0, 0.3, 5)
    value, slopes = flexible._negative_log_marginal(at, squares, y)
    size, lengths, white = np.exp(at[0]), np.exp(at[1:4]), np.exp(at[4])
    covariance = size * np.exp(-0.5 * squares @ lengths**-2) + white * np.eye(30)
    expected = -sum(multivariate_normal(np.zeros(30), covariance).logpdf(column) for column in y.T)
    assert value == pytest.approx(expected - 30 * np.log(2 * np.pi), rel=1e-9)  # 2 columns of 30 values
    assert slopes == pytest.approx(
        approx_fprime(at, lambda z: flexible._negative_log_marginal(z, squares, y)[0], 1e-6), rel=1e-3
    )


@pytest.mark.filterwarnings("ignore:The optimal value:UserWarning")  # inputs that tell nothing
def test_a_process_follows_as_well_as_scikit_learn_s() -> None:
    sklearn = pytest.importorskip("sklearn.gaussian_process")
    kernels = sklearn.kernels
    rng = np.random.default_rng(1)
    x, asked = rng.normal(size=(300, 4)), rng.normal(size=(200, 4))
    y = np.column_stack([np.sin(2 * x[:, 0]) + 0.3 * x[:, 1], np.cos(x[:, 2])]) + rng.normal(0.0, 0.05, (300, 2))
    scale = np.sqrt(np.mean(y**2))
    kernel = kernels.ConstantKernel(1.0, (1e-3, 1e2)) * kernels.RBF(np.ones(4), (0.05, 20.0))
    kernel += kernels.WhiteKernel((0.05 / scale) ** 2, (0.5 * (0.05 / scale) ** 2, 10.0))
    few = np.linspace(0, 299, 200).astype(int)
    lengths = sklearn.GaussianProcessRegressor(kernel).fit(x[few], y[few] / scale).kernel_
    theirs = scale * sklearn.GaussianProcessRegressor(lengths, optimizer=None).fit(x, y / scale).predict(asked)
    assert np.abs(flexible._gp_mean(x, y, 0.05, asked) - theirs).max() < 1e-3
