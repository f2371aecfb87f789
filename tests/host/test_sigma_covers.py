"""Stated sigmas hold what was wrong while calibrating, and no more: registration, tracker, what was out of view."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import angle_plant
import numpy as np
import pytest

import tautline as tl
from tautline import trajectory
from tautline.calibration.calibrate import calibrate
from tautline.calibration.hinge import fit_jump
from tautline.calibration.observations import NoiseByPlace, Track
from tautline.calibration.result import Calibration
from tautline.core.motor import MotorPath
from tautline.core.samples import noise_of
from tautline.prediction import predict_with_sigma
from tautline.recording import Angle, Marker, Motor, Recording, Video
from tautline.simulated import simulate
from tautline.simulated.instrument import Instrument, preset, reference_rig

sys.path.insert(0, str(Path(__file__).parents[2]))
from tools.paper import scenes

RIG = reference_rig()


def strokes(plant: Instrument, seed: int) -> simulate.Simulation:
    motion = trajectory.back_and_forth(RIG.actuator, [0.6, 1.1, 2.3], 2.1, 16, 7.0, 0.2)
    return simulate.run(RIG, plant, motion, seed=seed)


def inside(found: Calibration) -> np.ndarray:
    q, (low, high) = found.model.q, found.model.measured
    return (q > low) & (q < high)


def lit_from_the_left(made: simulate.Simulation, off_px: float) -> Recording:
    """The marker where a tracker of frames sees it."""
    marker = made.recording.marker
    seen = replace(marker, u_px=marker.u_px - off_px, v_px=marker.v_px - 0.2 * off_px)
    return replace(made.recording, marker=seen, video=Video(Path("video.mkv"), None))


@pytest.mark.parametrize(("seed", "off_px"), [(811, 0.1), pytest.param(812, -0.17, marks=pytest.mark.long)])
def test_f_remain_is_as_uncertain_as_its_tracker(seed: int, off_px: float) -> None:
    plant = preset("random", RIG, seed)
    made = strokes(plant, seed)
    plain, found = calibrate([made.recording], RIG), calibrate([lit_from_the_left(made, off_px)], RIG)
    at = inside(found)
    off = np.abs(found.model.c_deg - plant.bend(found.model.q))[at]
    sigma = found.model.c_sigma[at]
    print(f"{off_px} px: f_remain {off.max():.4f} deg off, {np.max(off / sigma):.2f} sigma")
    assert np.max(off / sigma) < 3.0 and np.median(sigma / off) < 2.5
    assert np.median(off / plain.model.c_sigma[at]) > 5.0  # what frames alone would say
    assert found.model.delay_s == pytest.approx(plain.model.delay_s, abs=2e-4)
    assert np.abs(found.model.width - plain.model.width)[at].max() < 1e-3


def test_the_image_is_foretold_as_its_own_tracker_will_show_it() -> None:
    plant = preset("random", RIG, 813)
    model = calibrate([lit_from_the_left(strokes(plant, 813), 0.15)], RIG).model
    unseen = lit_from_the_left(simulate.run(RIG, plant, trajectory.sines(RIG.actuator, 1.5, 40.0), seed=814), 0.15)
    marker: Marker = unseen.marker
    told = predict_with_sigma(model, unseen.motor, marker.t_s - model.delay_s)
    late = marker.t_s > marker.t_s[0] + 12.0
    z = (np.column_stack([marker.u_px, marker.v_px]) - told.image_px)[late] / told.image_sigma_px[late]
    within = float(np.mean(np.abs(z) < 1.645))
    print(f"{100 * within:.0f} % within what nine of ten should be")
    assert 0.8 < within < 0.97
    truth = plant.move(unseen.motor.t_s, unseen.motor.q)
    off = np.abs(told.c_deg - np.interp(marker.t_s - model.delay_s, unseen.motor.t_s, truth))[late]
    assert np.median(off / told.c_sigma_deg[late]) < 2.5  # the angle itself is off by what the tracker is


def test_a_marker_that_others_tell_is_taken_at_its_word() -> None:
    made = strokes(preset("random", RIG, 815), 815).recording
    by_others, of_frames = (tl.calibrate(each).model for each in (
        replace(made, rig=RIG), replace(made, rig=RIG, video=Video(Path("video.mkv"), None)),
    ))  # fmt: skip
    assert np.median(by_others.c_sigma) < 0.3 * np.median(of_frames.c_sigma)


@pytest.mark.parametrize("first", [0, 7])
def test_a_jump_is_bracketed_where_frames_show_the_level(first: int) -> None:
    """Frames a unit of travel apart, the image jumps by 20 sigma at 7.1 and goes on: seen from the turn on, or from
    when it moves already."""
    x = np.arange(0.5, 20.0)[first:]
    rng = np.random.default_rng(31)
    y = np.where(x > 7.1, 20.0 + 30.0 * (x - 7.1), 0.0)[:, None] * np.array([0.9, 0.3]) + rng.normal(0, 1, (len(x), 2))
    jump = fit_jump(x, y, 12.0)
    assert (jump.low == 0.0) is (first > 0) and jump.low < 7.1 < jump.high <= 8.5


def test_a_reversal_out_of_view_does_not_bend_b() -> None:
    """The paper's tilt by direction with the marker out of the picture at one end of the range."""
    rig, recording = scenes.fig7_rig(), scenes.fig7_recording(631)
    marker = recording.marker
    seen = marker.u_px < np.quantile(marker.u_px, 0.94)
    found = calibrate([replace(recording, marker=replace(marker, valid=seen))], rig, naming=False)
    off = np.abs(found.model.width - 15.0)[inside(found)]
    sigma = found.model.width_sigma[inside(found)]
    print(f"B at most {off.max():.3f} deg off, {np.max(off / sigma):.2f} sigma; sigma at most {sigma.max():.3f}")
    assert np.max(off / sigma) < 3.0 and off.max() < 0.1 and sigma.max() < 0.3


@pytest.mark.parametrize(("seed", "share"), [(21, 0.5), pytest.param(22, 0.4, marks=pytest.mark.long)])
def test_an_offset_between_two_parts_of_one_recording_is_a_slip(seed: int, share: float) -> None:
    """A servo with an encoder at either end: from one moment on the tip lies 0.6 deg further."""
    motion = angle_plant.Motion.through().then(angle_plant.Motion.through())
    recording = angle_plant.record(motion, seed=seed)
    angle = recording.angle
    after = angle.t_s > share * motion.t_s[-1]
    found = calibrate(
        [replace(recording, angle=replace(angle, c_deg=angle.c_deg + 0.6 * after))], angle_plant.RIG, naming=False
    )
    q, at = found.model.q, inside(found)
    off = np.abs(found.model.width - angle_plant.width(q))[at]
    print(found.model.quality, f"B {off.max():.4f} deg off, {np.max(off / found.model.width_sigma[at]):.2f} sigma")
    assert {reason.code for reason in found.model.quality.reasons} - {"residual"} == {"transmission.slip"}
    assert off.max() < 0.06 and np.sqrt(np.mean((off / found.model.width_sigma[at]) ** 2)) < 2.0
    ended = np.abs(found.model.c_deg - angle_plant.bend(q) - 0.6)[at]  # what it is at the end
    assert ended.max() < 0.05 and np.max(ended / found.model.c_sigma[at]) < 3.0


def wider_by_the_square_of_speed(share: float, speeds: tuple[float, float]) -> Recording:
    """A joint whose width is 2 deg for slow strokes, and more by `share` at 10 deg/s, driven at two speeds."""
    slow, fast = (angle_plant.Motion.through(speed=speed) for speed in speeds)
    motion = slow.then(fast)
    speed = np.convolve(np.abs(np.gradient(motion.q, motion.t_s)), np.ones(40) / 40.0, "same")
    state, p = float(motion.q[0]), []
    for q, half in zip(motion.q.tolist(), (1.0 + share * (speed / 10.0) ** 2).tolist(), strict=True):
        state = min(max(state, q - half), q + half)
        p.append(state)
    at_s = np.arange(0.05, motion.t_s[-1] - 0.05, 0.01)
    c = angle_plant.bend(np.interp(at_s, motion.t_s, p)) + 0.01 * np.random.default_rng(1).normal(size=len(at_s))
    return Recording("squared", Motor(motion.t_s[::4], motion.q[::4]), None, Angle(at_s, c), rig=angle_plant.RIG)


def test_slower_than_what_was_seen_speed_may_follow_another_law() -> None:
    """A line through two speeds, be it of a width by speed or of drag beside friction, goes 0.08 deg too low at rest,
    22 standard deviations of the line's own."""
    model = calibrate([wider_by_the_square_of_speed(0.1, (4.0, 10.0))], angle_plant.RIG).model
    assert [effect.id for effect in model.effects] in (
        ["transmission.rate_dependent_backlash"],
        ["transmission.lag"],
    )
    middle = np.abs(model.q) < 20.0
    off, sigma = np.abs(model.width - 2.0)[middle], model.width_sigma[middle]
    print(f"{np.mean(off):.3f} deg off, {np.mean(off / sigma):.2f} sigma")
    assert np.mean(off) > 0.05 and np.mean(off / sigma) < 2.0


def test_a_calibration_that_no_law_of_speed_fits_is_not_good() -> None:
    """Two speeds of which neither a width by speed nor drag leaves noise."""
    found = calibrate([wider_by_the_square_of_speed(0.4, (6.0, 10.0))], angle_plant.RIG)
    assert found.model.quality.verdict != "good"


@pytest.mark.parametrize("seed", [821, 822])
def test_noise_that_is_another_one_in_a_part_of_the_range_is_learnt_there(seed: int) -> None:
    """Glare: 20 times the noise above two thirds of the range."""
    plant = preset("random", RIG, seed)
    made = strokes(plant, seed)
    marker, rng = made.recording.marker, np.random.default_rng(seed)
    q = np.interp(marker.t_s - RIG.delay_s, made.recording.motor.t_s, made.recording.motor.q)
    noise = np.where(q > 1.5, 1.0, 0.0)[:, None] * rng.normal(size=(len(q), 2))
    noisy = replace(marker, u_px=marker.u_px + noise[:, 0], v_px=marker.v_px + noise[:, 1])
    found = calibrate([replace(made.recording, marker=noisy)], RIG)
    at = inside(found)
    b = (found.model.width - plant.backlash(found.model.q))[at] / found.model.width_sigma[at]
    f = (found.model.c_deg - plant.bend(found.model.q))[at] / found.model.c_sigma[at]
    print(f"B {np.sqrt(np.mean(b**2)):.2f}, f_remain {np.sqrt(np.mean(f**2)):.2f} sigma")
    assert np.sqrt(np.mean(b**2)) < 2.0 and np.sqrt(np.mean(f**2)) < 2.0
    later = marker.t_s > 15.0
    told = predict_with_sigma(found.model, made.recording.motor, marker.t_s[later] - found.model.delay_s)
    seen = np.column_stack([noisy.u_px, noisy.v_px])[later]
    z, quiet = (seen - told.image_px) / told.image_sigma_px, q[later] < 0.5
    for here in (quiet, q[later] > 2.5):
        assert np.sqrt(np.mean(z[here] ** 2)) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("channels", [1, 2])
@pytest.mark.parametrize(("beyond", "loud"), [(5.0, 1.0), (2.0, 10.0), (-1.0, 10.0), (1.5, 30.0)])
def test_one_noise_stays_one_and_another_is_found(channels: int, beyond: float, loud: float) -> None:
    rng = np.random.default_rng(5)
    place = np.tile(np.concatenate([np.linspace(-4.0, 4.0, 400), np.linspace(4.0, -4.0, 400)]), 3)
    true = 0.05 * np.where(place > beyond, loud, 1.0)
    y = np.column_stack([20.0 * place, 3.0 * place])[:, :channels]
    y = y + true[:, None] * rng.normal(size=y.shape)
    t_s = 0.04 * np.arange(len(place))
    stated = np.full(len(place), noise_of(t_s, y, 1e-3))
    track = Track("t", "px", MotorPath.of(Motor(t_s, place), 1e-3), t_s, y, stated)
    found = NoiseByPlace.of([track], [place])
    assert found.differs is (loud > 1.0)
    for here in (place > beyond + 0.7, place < beyond - 0.7):
        if here.any():
            told = np.median((stated * found.times(place) / true)[here])
            assert told == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("period_s", [1.0, 3.0])
def test_a_fast_motion_is_no_noise(period_s: float) -> None:
    rng, t_s = np.random.default_rng(6), 0.04 * np.arange(1500)
    place = 4.0 * np.sin(2.0 * np.pi * t_s / period_s)
    y = 60.0 * place[:, None] * np.array([1.0, 0.1]) + 0.05 * rng.normal(size=(len(t_s), 2))
    track = Track("t", "px", MotorPath.of(Motor(t_s, place), 1e-3), t_s, y, np.full(len(t_s), 0.05))
    assert not NoiseByPlace.of([track], [place]).differs
