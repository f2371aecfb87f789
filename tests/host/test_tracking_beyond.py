"""An offset moves the tip to where the calibration measured nothing: what is seen there is learnt, and nothing else."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from slices import some

from tautline import _native, trajectory
from tautline.calibration.calibrate import calibrate
from tautline.model import Model
from tautline.simulated.instrument import Instrument, of_name
from tautline.simulated.simulate import run
from tautline.tracking import off_by, replay
from tautline.tracking.beyond import CURVES, Beyond
from tautline.tracking.law import LawFamily, calibrated_theta
from tautline.tracking.visit import Visit
from tools.tracking.score import turns_of
from tools.tracking.sessions import Instrument as Drawn
from tools.tracking.sessions import ideal_model

NOISE_PX = 0.05
RATIO = 1.1  # of what is left to the noise, from the tenth reversal on


class Moved(Instrument):
    """One whose transmission's offset changes at a time."""

    def __init__(self, whole: Instrument, offset: float, at_s: float) -> None:
        super().__init__(whole.rig, whole.grid, whole.width, whole.c_deg)
        self.offset, self.at_s = offset, at_s

    def centre(self, t_s, q):
        return super().centre(t_s, np.asarray(q) + np.where(np.asarray(t_s) >= self.at_s, self.offset, 0.0))


@cache
def calibrated(seed: int) -> Model:
    instrument = of_name("random", None, seed)
    actuator = instrument.rig.actuator
    motion = trajectory.back_and_forth(actuator, (0.5, 1.0), 1.5, 40, 5.0, 0.2)
    return calibrate([run(instrument.rig, instrument, motion, seed=seed).recording], instrument.rig).model


def left(seed: int, offset: float, motion: str) -> float:
    """What the tracker leaves over the noise, from the tenth reversal after the change on, over the whole range."""
    model, whole = calibrated(seed), of_name("random", None, seed)
    actuator = whole.rig.actuator
    if motion == "trapezoids":
        way = trajectory.trapezoids(actuator, 2.0, 3.0, 30, 20.0, 0.2)
    else:
        way = trajectory.back_and_forth(actuator, (4.0,), 2.5, 20, 5.0, 0.2)
    at_s = 0.25 * way.duration_s
    made = run(whole.rig, Moved(whole, offset, at_s), way, seed=seed + 1000)
    tracked = replay(model, [made.recording])
    motor = made.recording.motor
    turns = motor.t_s[turns_of(motor.q)]
    off = off_by(tracked, [made.recording])[tracked.t_s > turns[turns > at_s][9]]
    place = model.measured
    assert np.max(made.p) > place[1] or np.min(made.p) < place[0]  # the tip was there
    return float(np.sqrt(np.nanmean(off**2)) / NOISE_PX)


@pytest.mark.parametrize(
    ("seed", "offset", "motion"),
    some(
        [(1, 0.4, "trapezoids"), (2, -0.6, "back and forth"), (1, 0.4, "back and forth"), (2, 0.4, "back and forth")], 1
    ),
)
def test_what_remains_of_an_offset_is_noise(seed, offset, motion):
    assert left(seed, offset, motion) < RATIO


@pytest.mark.long
def test_what_remains_of_offsets_of_twenty_instruments_is_noise():
    offsets = np.random.default_rng(5).uniform(0.2, 0.6, 20) * np.tile([1.0, -1.0], 10)
    motions = ("trapezoids", "back and forth")
    ratios = [left(seed, offset, motions[seed % 4 // 2]) for seed, offset in enumerate(offsets.tolist(), 40)]
    assert sum(ratio < RATIO for ratio in ratios) >= 19, np.round(ratios, 2)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 12))
def test_frames_one_by_one_tell_what_they_tell_together(seed, count):
    """It is the posterior of a linear model with normal noise, from normal equations that are written down here."""
    rng = np.random.default_rng(seed)
    unseen = Beyond.prior(ideal_model(Drawn(seed % 5)))
    by, sigma = rng.normal(0.0, 0.3, (count, 2 * CURVES)), rng.uniform(0.05, 0.2, count)
    off = by @ (0.3 * np.sqrt(np.diag(unseen.covariance))) + rng.uniform(-1.0, 1.0, count) * sigma  # no outliers
    information = np.linalg.inv(unseen.covariance) + (by.T / sigma**2) @ by
    expected = np.linalg.solve(information, (by.T / sigma**2) @ off)
    one_by_one = unseen
    for i in range(count):
        one_by_one = one_by_one.updated(
            by[i : i + 1], off[i : i + 1] - by[i : i + 1] @ one_by_one.mean, sigma[i : i + 1]
        )
    for found in (unseen.updated(by, off, sigma), one_by_one):
        np.testing.assert_allclose(found.mean, expected, atol=1e-8)
        np.testing.assert_allclose(found.covariance, np.linalg.inv(information), atol=1e-8)


def test_an_outlier_tells_less():
    unseen = Beyond.prior(ideal_model(Drawn(1)))
    by = unseen.curves(np.full(1, unseen.model.measured[1] + 0.3)).T
    by = np.hstack([by, np.zeros_like(by)])
    near, far = (unseen.updated(by, np.array([off]), np.array([0.01])).covariance[2, 2] for off in (0.01, 1e3))
    assert near < far < unseen.covariance[2, 2]


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_inside_the_measured_range_nothing_is_told_and_nothing_changes(seed):
    rng = np.random.default_rng(seed)
    model = ideal_model(Drawn(seed % 5))
    family = LawFamily(Beyond.prior(model))
    (low, high), node = model.measured, np.diff(model.q).max()  # tables are straight from node to node
    law, p = family.law(calibrated_theta()), rng.uniform(low + node, high - node, 20)
    assert family.with_frames(family, law, p, np.zeros((20, CURVES)), law.angle(p) + 1.0, np.full(20, 0.01)) is family
    there = high + rng.uniform(0.05, 0.6, 5)
    by_width = family.beyond.curves(there).T * -0.5
    learnt = family.with_frames(family, law, there, by_width, law.angle(there) + 0.03, np.full(5, 0.003))
    other = learnt.law(calibrated_theta())
    np.testing.assert_allclose(other.angle(p), law.angle(p), atol=1e-9)
    widths = (np.interp(p, each.grid, each.width) for each in (other, law))
    np.testing.assert_allclose(*widths, atol=1e-12)
    assert (other.angle(there) - law.angle(there)).max() > 0.01


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.booleans(), st.floats(1.5, 8.0))
def test_a_curve_that_would_turn_beyond_is_level_there_and_the_same_nearer(seed, falls, turns):
    """A bend that few frames told bends on: half a range away it would lead back across all that was measured."""
    model = ideal_model(Drawn(seed % 5))
    if falls:
        model = replace(model, c_deg=-model.c_deg)
    unseen = Beyond.prior(model)
    (low, high), far = model.measured, turns * np.ptp(model.c_deg) / np.ptp(unseen.model.q) ** 2
    way = -1.0 if falls else 1.0
    for mean in ((0.0, 8.0 * far, 0.0, 0.0), (0.0, 0.0, 0.0, -8.0 * far)):
        bent = replace(unseen, mean=np.concatenate([way * np.array(mean), np.zeros(CURVES)]))
        added = bent.model.c_deg + bent.mean[:CURVES] @ bent.curves_on_grid
        assert (way * np.diff(added) < 0.0).any()  # so it would turn
        known = bent.posterior_model
        inside = (known.q >= low) & (known.q <= high)
        np.testing.assert_allclose(known.c_deg[inside], bent.model.c_deg[inside], atol=1e-4)
        assert (way * np.diff(known.c_deg) > 0.0).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.6, 1.5))
def test_derivatives_by_what_is_added_to_the_width_are_those_of_differences(seed, scale):
    rng = np.random.default_rng(seed)
    unseen = Beyond.prior(ideal_model(Drawn(seed % 5)))
    theta = calibrated_theta()
    theta[1] = scale
    corners = rng.uniform(-1.0, 1.0, 7) * np.where(np.arange(7) % 2, 5.6, -5.6)
    q = np.interp(np.linspace(0, 6, 400), np.arange(7), corners)

    def told(mean):
        law = LawFamily(Beyond(unseen.model, mean, unseen.covariance)).law(theta)
        return law.followed.run(_native.TrackState(0.0), q, True)

    mean = np.concatenate([np.zeros(CURVES), rng.normal(0.0, 0.02, CURVES)])
    slopes = told(mean)[2][:, 1:]
    for i in range(CURVES):
        step = np.eye(2 * CURVES)[CURVES + i] * 1e-6
        differences = (told(mean + step)[0] - told(mean - step)[0]) / 2e-6
        same = np.abs(differences - slopes[:, i]) < 1e-4 * (1 + np.abs(slopes[:, i]))
        assert same.mean() > 0.97  # not where a turn or a node of the table is passed within the step


def test_a_model_that_was_measured_at_one_place_is_tracked():
    model = replace(calibrated(1), measured=(0.5, 0.5))
    whole = of_name("random", None, 1)
    way = trajectory.trapezoids(whole.rig.actuator, 2.0, 3.0, 3, 20.0, 0.2)
    tracked = replay(model, [run(whole.rig, whole, way, seed=1).recording])
    assert np.isfinite(tracked.column("c_deg")).all()


def test_a_long_stay_that_nobody_saw_costs_no_more():
    """Two thousand turns within the backlash while the marker is hidden."""
    family = Beyond.prior(calibrated(1))
    visit = Visit(LawFamily(family), None)
    for _ in range(2000):
        visit.move(np.array([0.1, -0.1]))
    assert visit.full
    assert len(visit._path) <= 514
