"""Campaigns of recordings one after the other, and of tests as bad as their calibration: what they make and count."""

import numpy as np
import pytest

from tautline.prediction import foretold
from tools import next_motion, same_misfit


def test_a_world_is_its_seeds():
    world, again = next_motion.world_of(12), next_motion.world_of(12)
    assert again.right == world.right and again.truth == world.truth
    first = world.motion(1, next_motion.strokes(world.course.plant), 100.0, 5)
    assert first.name == "test-1" and np.diff(first.motor.t_s).min() > 0.0
    assert next_motion.strokes(world.course.plant).duration_s < 60.0


def test_recordings_until_sure_are_counted_and_sure_ones_that_are_wrong():
    lag, creep = "transmission.lag", "transmission.creep"
    cases = [
        {"seed": 1, "right": [lag], "first": [lag, 0.99]},
        {"seed": 2, "right": [lag], "first": [creep, 0.99]},
        {
            "seed": 3, "right": [lag], "first": [lag, 0.6],
            "next motion": [[lag, 0.6], [lag, 0.97]], "next motion, s": 60.0,
            "fixed strokes": [[lag, 0.6], [lag, 0.8], [creep, 0.96]], "fixed strokes, s": 100.0,
        },
    ]  # fmt: skip
    told = next_motion.summary(cases)
    assert "3 cases, 1 with no answer at 95%" in told
    assert "next motion    1.00 further recordings (60 s) in the mean, sure 1, of these wrong 0" in told
    assert "fixed strokes  2.00 further recordings (100 s) in the mean, sure 1, of these wrong 1" in told
    assert "sure after the first: 2, of these wrong 1" in told


def test_the_picture_is_drawn(tmp_path):
    ways = {way: [["none", 0.6], ["none", 0.97]] for way in next_motion.WAYS}
    next_motion.picture([{"right": ["none"], **ways}], tmp_path / "sure.png")
    assert (tmp_path / "sure.png").stat().st_size > 5000


@pytest.mark.long
def test_a_misfit_that_all_recordings_share_is_none():
    case = same_misfit.run(2)
    assert 1.2 <= case["times"] <= 1.5
    assert max(abs(np.log(np.array(case["of tests"]) / case["times"]))) <= same_misfit.ALIKE
    assert case["verdict"] == "none"


@pytest.mark.long
def test_an_amplitude_scales_what_is_left():
    rng = np.random.default_rng(3)
    plant = same_misfit.plant_of(rng)
    course = same_misfit.course_of(rng, plant)
    values = {"locking": 0.3, "locking_px": 2.0}
    times, result = same_misfit.misfit(course, same_misfit.amplified("pixel_locking", values, 1.0))
    stronger = same_misfit.recorded(course, same_misfit.amplified("pixel_locking", values, 3.0), 0)
    assert foretold(result.model, stronger) > 1.5 * times * plant.noise_px
