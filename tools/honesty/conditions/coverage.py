"""The motion does not show all that is asked for."""

from __future__ import annotations

import numpy as np

from tools.honesty import motion
from tools.honesty.conditions.common import Rng, camera_setup, length, motions
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import Setup


@condition("coverage", "coverage")
def five_reversals(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a, span = s.actuator, s.actuator.high - s.actuator.low
    low, high = a.low, a.high
    targets = [low, low + span * float(rng.uniform(0.25, 0.35)), low + 0.1 * span, high]
    targets += [high - span * float(rng.uniform(0.25, 0.35)), high - 0.05 * span, low]
    s.recordings = [motion.visit(targets, length(a, 1.0), 0.2, length(a, 20.0))]
    return s


@condition("coverage", "coverage")
def middle_crossed_one_way(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.recordings = [motion.one_way_middle(rng, s.actuator.low, s.actuator.high, length(s.actuator, 1.2))]
    return s


@condition("coverage", "coverage")
def a_third_of_the_range(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a, span = s.actuator, s.actuator.high - s.actuator.low
    low = a.low + span * float(rng.uniform(0.05, 0.55))
    count = int(rng.integers(25, 35))
    speeds = [length(a, v) for v in (0.7, 1.5)]
    s.recordings = [motion.wander(rng, low, low + 0.36 * span, count, speeds, 0.15 * span, 0.3 * span)]
    return s


@condition("coverage", "coverage", "acquisition.delay")
def sweeps_of_one_speed(rng: Rng) -> Setup:
    s = camera_setup(rng)
    v = length(s.actuator, float(rng.uniform(1.5, 3.0)))
    s.recordings = [motion.sweeps(rng, s.actuator.low, s.actuator.high, [v] * 5)]
    return s


@condition("coverage", "coverage")
def two_reversals(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a, span = s.actuator, s.actuator.high - s.actuator.low
    targets = [a.low + 0.1 * span, a.low + 0.8 * span, a.low + 0.3 * span, a.low + 0.9 * span]
    s.recordings = [motion.visit(targets, length(a, 1.0), 0.3, length(a, 20.0))]
    return s


@condition("strokes", "coverage")
def strokes_mostly_inside_the_backlash(rng: Rng) -> Setup:
    s = camera_setup(rng, smallest=0.8, largest=1.0, bump=0.3)
    a = s.actuator
    stroke = length(a, float(rng.uniform(0.6, 0.9)))
    s.recordings = [motion.ramp_strokes(rng, a.low, a.high, stroke, 50, [length(a, 0.8)])]
    return s


@condition("strokes", "coverage", "rate", "noise")
def four_quick_reversals(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.quick(rng, a.low, a.high, 4, length(a, 7.0))]
    return s


@condition("strokes", "coverage", "rate")
def too_fast_for_the_frames(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    s.recordings = [motion.wander(rng, a.low, a.high, 60, [length(a, 14.0)], length(a, 1.5), length(a, 5.0))]
    return s


@condition("strokes", "coverage")
def hole_in_the_middle(rng: Rng) -> Setup:
    """Two recordings that each cover an end; one slow pass joins them."""
    s = camera_setup(rng)
    a, span = s.actuator, s.actuator.high - s.actuator.low
    left = motion.wander(rng, a.low, a.low + 0.3 * span, 16, [length(a, 1.0)], 0.12 * span, 0.28 * span)
    right = motion.wander(rng, a.high - 0.3 * span, a.high, 16, [length(a, 1.0)], 0.12 * span, 0.28 * span)
    bridge = motion.visit([float(left.q[-1]), float(right.q[0])], length(a, 1.0), 0.2, length(a, 20.0))
    s.recordings = [motion.joined([left, bridge, right])]
    return s


@condition("strokes", "noise", "rate", "coverage")
def marker_noise_of_a_pixel(rng: Rng) -> Setup:
    s = camera_setup(rng)
    assert s.image is not None
    s.image.noise_px = float(rng.uniform(0.7, 1.3))
    s.recordings = [motions(rng, s.actuator, 80.0)]
    s.test = motion.Motion(s.test.t, np.asarray(s.test.q))
    return s
