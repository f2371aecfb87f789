"""A sensor that rounds: frames of one rest are off by the same."""

from __future__ import annotations

from dataclasses import replace

import angle_plant
import numpy as np
import pytest
from reference_instrument import RIG, moved

from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import Track, observe, rounding_step
from tautline.calibration.remaining import track_by_pose
from tautline.calibration.rounding import independence_weights, resting, shared_variance


def rests(step: float, noise: float, frames: int, seed: int) -> tuple[Track, np.ndarray]:
    """A track of 3000 rests anywhere between two steps, of so many frames each, and where the tip was."""
    rng = np.random.default_rng(seed)
    tip = np.repeat(np.cumsum(rng.uniform(2.0, 9.0, 3000) * rng.choice([-1, 1], 3000)), frames)[:, None]
    y = tip + noise * rng.normal(size=tip.shape)
    y = np.round(y / step) * step
    plain = observe([angle_plant.record(angle_plant.Motion.through((-5, 5, -5)))], angle_plant.RIG)[0]
    t_s = np.arange(len(y)) / 100.0
    return replace(plain, t_s=t_s, y=y, sigma=np.full(len(y), np.hypot(noise, step / np.sqrt(12.0))), step=step), tip


@pytest.mark.parametrize("noise", [0.0, 0.02, 0.05, 0.1, 0.2, 0.5])
@pytest.mark.parametrize("step", [0.1, 0.37])
def test_what_frames_of_a_rest_share_is_the_covariance_of_their_errors(noise: float, step: float) -> None:
    """noise: in steps."""
    track, tip = rests(step, noise * step, 8, 41)
    error = (track.y - tip).reshape(-1, 8)
    true = float(np.mean(error[:, 2] * error[:, 5]))
    told = shared_variance(track, resting(track, tip))
    assert told == pytest.approx(true, abs=0.12 * step**2 / 12.0)


@pytest.mark.parametrize(("noise", "frames"), [(0.0, 5), (0.0, 50), (0.05, 20), (2.0, 20)])
def test_a_rest_is_known_as_well_as_its_mean(noise: float, frames: int) -> None:
    """noise: in steps of 1. The mean of a rest's frames is off by as much as frames that count so much are."""
    track, tip = rests(1.0, noise, frames, 42)
    off = (track.y - tip).reshape(-1, frames).mean(axis=1)
    each = independence_weights(track, tip, np.ones(len(tip), dtype=bool), 1.0)
    told = 1.0 / float(np.sum(each.reshape(-1, frames)[7] / track.sigma[0] ** 2))
    assert told == pytest.approx(float(np.mean(off**2)), rel=0.15)


def test_a_sensor_that_moves_or_does_not_round_counts_in_full() -> None:
    track, tip = rests(0.1, 0.0, 1, 43)
    every = np.ones(len(tip), dtype=bool)
    assert np.all(independence_weights(track, tip, every, 1.0) == 1.0)
    fine = replace(track, step=0.0)
    assert np.all(independence_weights(fine, np.zeros_like(tip), every, 1.0) == 1.0)
    rested, place = rests(0.1, 0.0, 20, 43)
    assert np.all(
        independence_weights(rested, place, np.ones(len(place), dtype=bool), 100.0) > 0.99
    )  # misfit is no rounding


def test_a_step_is_found_where_most_levels_are_skipped() -> None:
    rng = np.random.default_rng(44)
    y = np.round(rng.uniform(-40.0, 40.0, 900) / 0.05) * 0.05
    y = np.concatenate([y, np.repeat(y[:300], 4)])[:, None]
    assert rounding_step(y) == pytest.approx(0.05, rel=1e-6)
    assert rounding_step(rng.normal(size=(900, 1))) == 0.0


def test_angles_by_the_pose_of_whole_pixels_have_no_step() -> None:
    made = moved([-2.0, 1.0, -1.0, 2.0, -2.0], 0.5)
    marker = made.marker
    whole = replace(made, marker=replace(marker, u_px=np.round(marker.u_px), v_px=np.round(marker.v_px)))
    track = observe([whole], RIG)[0]
    assert track.step == 1.0 and track_by_pose(track, RIG, 0.08).step == 0.0


@pytest.mark.parametrize(("quantum", "noise", "speed"), [(0.1, 0.005, 20.0), (0.1, 0.0, 30.0), (0.0879, 0.03, 20.0)])
def test_a_joint_seen_by_a_coarse_encoder_is_known_to_a_fraction_of_its_step(quantum, noise, speed) -> None:
    motion = angle_plant.Motion.through(speed=speed).then(angle_plant.Motion.through(speed=0.6 * speed))
    found = calibrate([angle_plant.record(motion, quantum=quantum, noise=noise, seed=45)], angle_plant.RIG).model
    inside = (found.q > found.measured[0]) & (found.q < found.measured[1])
    off, sigma = np.abs(found.width - angle_plant.width(found.q))[inside], found.width_sigma[inside]
    z = float(np.sqrt(np.mean((off / sigma) ** 2)))
    print(f"B {off.max():.4f} deg off at most, {z:.2f} sigma; sigma {np.median(sigma):.4f}")
    assert found.quality.verdict == "good"
    assert z < 1.7 and np.median(sigma) < 0.2 * quantum
