"""Nothing is wrong: what a laboratory does on a good day."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tools.honesty import motion
from tools.honesty.conditions.common import (
    LENSES,
    Array,
    Rng,
    angle_setup,
    camera_setup,
    length,
    motions,
)
from tools.honesty.conditions.registry import BENIGN, condition
from tools.honesty.motion import Motion
from tools.honesty.optics import Camera, drawn_camera
from tools.honesty.plant import Play
from tools.honesty.setup import AngleLog, Setup


def _speeds(setup: Setup, *mm_per_s: float) -> list[float]:
    return [length(setup.actuator, v) for v in mm_per_s]


@condition(BENIGN)
def ramp_with_strokes(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.ramp_strokes(rng, a.low, a.high, length(a, 1.7), 40, _speeds(s, 0.6, 1.2))]
    return s


@condition(BENIGN)
def strokes_that_wander(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.wander(rng, a.low, a.high, 45, _speeds(s, 0.8, 1.6, 3.0), length(a, 1.5), length(a, 4.0))]
    return s


@condition(BENIGN)
def sweeps_of_several_speeds_and_strokes(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [
        motion.joined(
            [
                motion.sweeps(rng, a.low, a.high, _speeds(s, 1.0, 2.0, 4.0)),
                motion.wander(rng, a.low, a.high, 30, _speeds(s, 1.0, 2.5), length(a, 1.5), length(a, 3.5)),
            ]
        )
    ]
    return s


@condition(BENIGN)
def two_sines(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.sines(rng, a.low, a.high, 150.0, 0.17, 0.0151, 0.24)]
    return s


@condition(BENIGN)
def falling_law(rng: Rng) -> Setup:
    return camera_setup(rng, sign=-1.0, seconds=130.0)


@condition(BENIGN)
def spindle_under_camera(rng: Rng) -> Setup:
    return camera_setup(rng, unit="deg")


@condition(BENIGN)
def spindle_with_angle_sensor(rng: Rng) -> Setup:
    return angle_setup(rng)


@condition(BENIGN)
def cable_with_angle_sensor_falling(rng: Rng) -> Setup:
    return angle_setup(rng, unit="mm", sign=-1.0, rate_hz=50.0, seconds=120.0)


@condition(BENIGN)
def camera_and_angle_sensor(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.angle = AngleLog(rate_hz=100.0, noise_deg=0.02)
    return s


@condition(BENIGN)
def two_recordings_one_clock(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=70.0)
    s.recordings.append(motions(rng, s.actuator, 60.0))
    return s


@condition(BENIGN)
def three_recordings_own_clocks(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=60.0)
    s.recordings += [motions(rng, s.actuator, 45.0), motions(rng, s.actuator, 45.0)]
    s.own_clocks = True
    return s


@condition(BENIGN)
def quick_camera_low_noise(rng: Rng) -> Setup:
    s = camera_setup(rng, lens=replace(LENSES[1], frame_rate=60.0, delay=0.035), seconds=70.0)
    assert s.image is not None
    s.image.noise_px = 0.03
    return s


@condition(BENIGN)
def slow_camera_more_noise(rng: Rng) -> Setup:
    s = camera_setup(rng, lens=replace(LENSES[0], frame_rate=15.0, delay=0.12), seconds=180.0)
    assert s.image is not None
    s.image.noise_px = 0.12
    return s


@condition(BENIGN)
def twenty_seconds(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.quick(rng, a.low, a.high, 14, length(a, 5.0))]
    return s


@condition(BENIGN)
def marker_missed_now_and_then(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    assert s.image is not None
    s.image.missed = 0.05
    s.image.lost = 0.02
    return s


@condition(BENIGN)
def wide_lens(rng: Rng) -> Setup:
    lens = replace(LENSES[0], fx=380.0, fy=380.0, distortion=(-0.18, 0.03, 0.0006, -0.0004, 0.0))
    return camera_setup(rng, lens=lens)


@condition(BENIGN)
def small_widths(rng: Rng) -> Setup:
    return camera_setup(rng, smallest=0.06, largest=0.12, bump=0.08, seconds=110.0)


@condition(BENIGN)
def wide_with_a_bump(rng: Rng) -> Setup:
    s = camera_setup(rng, smallest=0.7, largest=0.9, bump=0.6)
    a = s.actuator
    s.recordings = [motion.ramp_strokes(rng, a.low, a.high, length(a, 2.8), 30, _speeds(s, 1.0, 2.0))]
    return s


@condition(BENIGN)
def the_same_width_everywhere(rng: Rng) -> Setup:
    s = camera_setup(rng)
    level = length(s.actuator, float(rng.uniform(0.3, 0.9)))

    def width(p: Array) -> Array:
        return np.full(np.shape(p), level)

    s.width, s.hysteresis = width, Play(width)
    return s


@condition(BENIGN)
def a_hand_drives_it(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.teleoperated(rng, a.low, a.high, 170.0, length(a, 2.0))]
    return s


@condition(BENIGN)
def the_other_joints_move_too(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=140.0)
    s.columns = _other_joints
    return s


def _other_joints(m: Motion, rng: Rng) -> dict[str, Array]:
    """Translation and rotation are moved for a while, some times."""
    steps = [motion.visit([0.0, *rng.uniform(-1, 1, 4).tolist(), 0.0], 0.5, m.duration / 7, 5.0) for _ in range(2)]
    moved = [np.interp(m.t, step.t * m.duration / step.duration, step.q) for step in steps]
    return {"translation_mm": 2.0 * moved[0], "rotation_deg": 8.0 * moved[1]}


@condition(BENIGN)
def noise_that_is_told(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    assert s.image is not None
    s.image.sigma_column = True
    s.image.noise_wave = lambda t: 1.0 + 0.8 * np.sin(t / 7.0) ** 2
    return s


@condition(BENIGN)
def a_part_of_a_wide_range(rng: Rng) -> Setup:
    """The rig's range is wider than what was moved, as rigs' ranges are: `measured` has to say so."""
    s = camera_setup(rng, seconds=90.0)
    a = s.actuator
    inset = 0.12 * (a.high - a.low)
    s.recordings = [motions(rng, a, 90.0, edge=inset)]
    s.test = motion.teleoperated(rng, a.low + 1.4 * inset, a.high - 1.4 * inset, 35.0, length(a, 1.6))
    return s


@condition(BENIGN)
def high_definition(rng: Rng) -> Setup:
    lens = Camera(width=1920, height=1080, fx=1200.0, fy=1200.0, cx=955.0, cy=545.0, frame_rate=30.0, delay=0.09)
    s = camera_setup(rng, seconds=70.0)
    s.camera = drawn_camera(rng, lens, (-55.0, 55.0))
    assert s.image is not None
    s.image.noise_px, s.image.delay_s = 0.1, 0.094
    return s


@condition(BENIGN)
def reversal_curves(rng: Rng) -> Setup:
    """From one end to ever nearer turning points and back, and the same from the other end."""
    s = camera_setup(rng)
    a = s.actuator
    way = motion.fan(a.low, a.high, 12, length(a, 1.8))
    s.recordings = [way, Motion(way.t, a.low + a.high - way.q)]
    return s


@condition(BENIGN)
def angle_sensor_whose_delay_is_told(rng: Rng) -> Setup:
    s = angle_setup(rng, seconds=100.0)
    assert s.angle is not None
    s.angle.told_delay_s = 0.05
    s.angle.delay_s = 0.05 + float(rng.uniform(-0.006, 0.006))
    return s
