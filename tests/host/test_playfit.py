"""The joint fit's Jacobian against finite differences; lawful tables; positions between encoder counts."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.calibration.observations import observe
from tautline.calibration.playfit import Curves, PlayFit
from tautline.calibration.remaining import monotone, view_of
from tautline.calibration.simulated_track import PreparedTrack
from tautline.core.samples import noise_of
from tautline.encoder import between_counts
from tautline.geometry import project
from tautline.model import allowed_width, is_backlash_table
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run
from tautline.splines import Basis
from tautline.trajectory import random_smooth

RIG = reference_rig()


# The same cases each time: counts and corners leave the quotient of the delay ragged.
@settings(max_examples=12, deadline=None, derandomize=True)
@given(st.integers(0, 10_000), st.booleans())
def test_the_jacobian_is_the_residuals_slope(seed, with_view):
    rng = np.random.default_rng(seed)
    made = run(RIG, preset("random", RIG, seed), random_smooth(RIG.actuator, 1.0, 20.0, seed), noise_px=0.3, seed=seed)
    prepared = [PreparedTrack.of(track) for track in observe([made.recording], RIG)]
    view = view_of(RIG) if with_view else None
    fit = PlayFit(prepared, Basis(-5, 5, 10), Basis(-5, 5, 12), view=view, settled_only=False)
    p = fit.follow.centres
    follow = 11.0 * p[:, None] if with_view else project(RIG, 11.0 * p)
    curves = Curves(0.5 + 0.1 * rng.uniform(-1, 1, fit.backlash.size), follow, 0.08)
    rows, masks = fit.residuals(curves)
    weights = [m.astype(float) for m in masks]
    _, gradient = fit.normal(curves, rows, weights)

    def cost(at: Curves) -> float:
        rows, _ = fit.residuals(at)
        return sum(float(np.sum(r[m] ** 2)) for r, m in zip(rows, masks, strict=True))

    cut = follow.size
    for index, size in ((int(rng.integers(cut)), 1e-4), (cut + int(rng.integers(fit.backlash.size)), 2e-6)):
        step = np.zeros(len(gradient))
        step[index] = size
        slope = (cost(fit.moved(curves, step)) - cost(fit.moved(curves, -step))) / (2 * size)
        assert -2 * gradient[index] == pytest.approx(slope, rel=0.02, abs=0.02 * np.abs(2 * gradient[:cut]).max())
    later, earlier = (cost(replace(curves, delay_s=0.08 + d)) for d in (3e-3, -3e-3))
    # Over a smaller step the encoder's counts and frames that are on a corner leave the delay's slope ragged.
    assert -2 * gradient[-1] == pytest.approx((later - earlier) / 6e-3, rel=0.05, abs=1e4)


@pytest.mark.parametrize("spans", [4, 10, 40])
def test_a_curve_is_begun_as_rough_as_each_penalty_has_it(spans: int) -> None:
    """c' P c is rank(P) times the variance over the smoothing in the mean, c of the prior with precision P: the rank by
    what of P's singular values is not 0."""
    made = run(RIG, preset("random", RIG, 3), random_smooth(RIG.actuator, 1.0, 20.0, 3), noise_px=0.3, seed=3)
    basis, rng = Basis(-5, 5, spans), np.random.default_rng(spans)
    fit = PlayFit([PreparedTrack.of(track) for track in observe([made.recording], RIG)], basis, basis)
    curves = Curves(
        rng.uniform(0.3, 0.6, basis.size), project(RIG, 11.0 * basis.centres + rng.normal(size=basis.size)), 0.08
    )
    fit.begin_smoothing(curves, scale=1e2)
    for name, penalty, columns in (("backlash", basis.roughness, [curves.backlash]),
                                   ("follow", basis.bending, curves.follow.T)):  # fmt: skip
        rank = sum(np.linalg.matrix_rank(penalty) for _ in columns)
        assert fit.smoothing[name] * sum(c @ penalty @ c for c in columns) == pytest.approx(1e4 * rank)


def test_frames_that_cannot_count_change_no_fit() -> None:
    """A fit of a track of which one in three frames may count is that of these frames alone."""
    motion = random_smooth(RIG.actuator, 1.0, 40.0, 3)
    track = observe([run(RIG, preset("random", RIG, 3), motion, noise_px=0.3, seed=3).recording], RIG)[0]
    use = np.arange(len(track.t_s)) % 3 == 0
    basis = Basis(-5, 5, 10)
    start = Curves(np.full(basis.size, 0.5), project(RIG, 11.0 * basis.centres), 0.08)
    many, few = (
        PlayFit([prepared], basis, basis).solve(start)
        for prepared in (PreparedTrack.of(track, use), PreparedTrack.of(track.only(use)))
    )
    np.testing.assert_allclose(many.curves.backlash, few.curves.backlash, atol=1e-12)
    np.testing.assert_allclose(many.covariance, few.covariance, rtol=1e-9, atol=1e-18)
    assert len(many.residuals[0]) == len(track.t_s)
    np.testing.assert_allclose(many.residuals[0][use], few.residuals[0], atol=1e-9)


@given(st.lists(st.floats(-2, 5), min_size=2, max_size=40), st.floats(0.01, 1.0))
def test_a_lawful_table_is_one_and_a_lawful_one_stays(values, step):
    grid = step * np.arange(len(values))
    lawful = allowed_width(grid, np.array(values))
    assert is_backlash_table(grid, lawful)
    assert np.allclose(allowed_width(grid, lawful), lawful, atol=1e-9)
    assert (lawful <= np.maximum(values, 0) + 1e-9).all()


@given(st.lists(st.floats(-5, 5), min_size=3, max_size=40), st.booleans())
def test_monotone_is_strict_and_leaves_what_is(values, falling):
    grid = np.arange(len(values), dtype=float)
    sign = -1.0 if falling else 1.0
    curve = monotone(np.array(values), grid, falling, 0.01)
    assert (sign * np.diff(curve) > 0).all()
    again = monotone(curve, grid, falling, 0.01)
    assert again == pytest.approx(curve, abs=1e-6)


@pytest.mark.parametrize("rate", [100.0, 1000.0, 4000.0])
def test_between_counts_is_nearer_to_the_truth_and_never_off_by_a_count(rate):
    t = np.arange(0, 20, 1 / rate)
    q = 0.02 * np.sin(0.7 * t) + 0.3 * np.sin(0.13 * t)
    counted = Motor(t, np.round(q / 0.001) * 0.001)
    between = between_counts(counted, 0.001)
    assert np.abs(between.q - q).max() < 0.001
    assert np.sqrt(np.mean((between.q - q) ** 2)) < 0.4 * np.sqrt(np.mean((counted.q - q) ** 2))
    assert between_counts(Motor(t, q), 0.001).q is q


def test_noise_is_measured_beside_motion_lost_frames_and_steps_of_a_sensor():
    rng = np.random.default_rng(4)
    t = np.arange(0, 60, 0.04)
    path = np.column_stack([100 * np.sin(0.4 * t), 30 * np.cos(0.4 * t)]) + rng.normal(0, 0.07, (len(t), 2))
    keep = rng.uniform(size=len(t)) > 0.2
    assert noise_of(t[keep], path[keep], 1e-3) == pytest.approx(0.07, rel=0.15)
    steps = np.round(5 * np.sin(0.2 * t)[:, None] / 0.09) * 0.09
    assert noise_of(t, steps, 1e-4) >= 0.09 / np.sqrt(12) * 0.9
