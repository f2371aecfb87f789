"""An effect that the calibration named, and a diagnosis does not: it is in the corrected model, and in the gap that is
said to be left."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import trajectory
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.effects import LIBRARY
from tautline.model import Effect, Model
from tautline.prediction import predict
from tautline.recording import Marker, Motor, Recording
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 401)
NOISE = 0.05
LAG = (Effect("transmission.lag", {"lag": 0.12}),)


def recorded(truth: Model, motion: trajectory.Trajectory, begin_s: float, seed: int) -> Recording:
    """What the camera sees at 30 Hz of an instrument that is as `truth` has it."""
    t_s = np.arange(0.0, motion.duration_s, 0.005)
    q = np.interp(t_s, motion.t_s, motion.q)
    motor = Motor(begin_s + t_s, q, q)
    arrival_s = motor.t_s[20:-20:7] + truth.delay_s
    seen = predict(truth, motor, arrival_s - truth.delay_s).image_px
    assert seen is not None
    seen = seen + NOISE * np.random.default_rng(seed).normal(size=seen.shape)
    marker = Marker(arrival_s, seen[:, 0], seen[:, 1], np.ones(len(arrival_s), dtype=bool))
    return Recording(f"of {seed}", motor, marker=marker, rig=RIG)


def diagnosed(carried: tuple[Effect, ...]) -> Diagnosis:
    """Of an instrument that lags, without lag or anything like it in the library."""
    instrument = preset("reference", RIG)
    tables = Model(RIG, GRID, instrument.backlash(GRID), np.full(401, 0.003), instrument.bend(GRID), 0.08, (-4.0, 4.0))
    truth = replace(tables, effects=LAG)
    motions = (
        trajectory.back_and_forth(RIG.actuator, [0.8], 2.0, 12, 6.0),
        trajectory.trapezoids(RIG.actuator, 0.9, 2.6, 5, 8.0, 0.8),
    )
    calibration, test = (recorded(truth, motion, 100.0 * i, 3 + i) for i, motion in enumerate(motions))
    others = {kind.id for kind in LIBRARY} - {"camera.distortion"}
    return diagnose(replace(tables, effects=carried), calibration, [test], left_out=others)


def test_what_the_calibration_named_is_in_the_gap_that_is_left():
    found = diagnosed(LAG)
    assert found.verdict == "unknown" and not found.findings
    assert found.corrected.effects == LAG and found.nominal.effects == ()
    assert found.gap.before > 10.0 * NOISE and found.gap.after == pytest.approx(NOISE, rel=0.1)
    low, high = found.gap.shrink_ci
    assert found.gap.shrink == pytest.approx(1.0 - found.gap.after / found.gap.before)
    assert low < found.gap.shrink <= high


def test_what_leaves_more_of_the_tests_is_said_to():
    found = diagnosed((replace(LAG[0], parameters={"lag": 0.4}),))
    assert found.verdict == "unknown" and found.corrected.effects[0].parameters["lag"] == 0.4
    assert found.gap.after > found.gap.before and found.gap.shrink < 0.0
