"""The tracker, where it learns nothing, says what `predict` says: one play, one projection, one delay.

A row knows the motor up to its scene time. With the same readings, of a motor without counts and read at that very
time, it is the same to a millionth of a pixel. An encoder's counts are smoothed by `predict` alone: what they leave is
less than the half of one by which a reading may be off.
"""

from dataclasses import replace

import numpy as np
import pytest

from tautline import trajectory
from tautline.encoder import cut
from tautline.model import Model
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.rig import ANGLE, MARKER
from tautline.simulated.instrument import preset, reference_rig
from tautline.tracking import State, Tracker

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 1025)
INSTRUMENT = preset("reference", RIG)
DELAY_S = 0.0871
COUNT = RIG.actuator.encoder_resolution
SAME_PX, SAME_DEG = 1e-6, 1e-7


def model(sensor) -> Model:
    return Model(
        RIG, GRID, INSTRUMENT.backlash(GRID), np.full(len(GRID), 0.003), INSTRUMENT.bend(GRID), DELAY_S, (-4.0, 4.0),
        sensor=sensor,
    )  # fmt: skip


def strokes() -> Motor:
    """Over the whole range, beyond what was measured, while the other axes sway; read where frames show the scene."""
    made = trajectory.trapezoids(RIG.actuator, 2.4, 3.0, 6, 20.0, 1.0).with_sway(2.0, 20.0, 17.0)
    arrivals = np.arange(DELAY_S + 0.004, made.t_s[-1], 0.004)
    t_s = arrivals - DELAY_S
    q, translation, rotation = (
        np.interp(t_s, made.t_s, values) for values in (made.q, made.translation_mm, made.rotation_deg)
    )
    return Motor(t_s, q, None, translation, rotation)


def rows(own, motor, every, seen=None):
    """The tracker's, at every so many readings; seen(k): what the k-th of those frames shows."""
    tracker = Tracker(own)
    tracker.motor(motor.t_s, motor.q, motor.translation_mm, motor.rotation_deg)
    at = np.arange(40, len(motor.t_s), every)
    arrivals = motor.t_s[at] + DELAY_S
    told = [tracker.see(t, *(() if seen is None else seen(k))) for k, t in enumerate(arrivals.tolist())]
    assert tracker.state is State.TRUSTED and not tracker.changes
    return arrivals - DELAY_S, told


@pytest.mark.parametrize("sensor", [MARKER, ANGLE])
def test_a_row_is_what_predict_says_of_the_readings_up_to_it(sensor):
    own, motor = model(sensor), strokes()
    scene, told = rows(own, motor, 16)
    for t, row in zip(scene[::7].tolist(), told[::7], strict=True):
        expected = predict(own, cut(motor, t), [t])
        assert abs(row.c_deg - expected.c_deg[0]) < SAME_DEG
        assert expected.image_px is not None
        np.testing.assert_allclose([row.u_px, row.v_px], expected.image_px[0], atol=SAME_PX, rtol=0)


def test_frames_that_show_what_was_foretold_change_nothing():
    """Beyond the measured range each frame tells: here that the tables' guess is right."""
    own, motor = model(ANGLE), strokes()
    scene, blind = rows(own, motor, 16)
    whole = predict(own, motor, scene).c_deg
    _, told = rows(own, motor, 16, lambda k: (whole[k],))
    off = np.array([row.c_deg for row in told]) - np.array([row.c_deg for row in blind])
    assert np.abs(off).max() < SAME_DEG


def test_counts_leave_less_than_a_reading_may_be_off():
    own, motor = model(ANGLE), strokes()
    counted = replace(motor, q=COUNT * np.rint(motor.q / COUNT))
    scene, told = rows(own, counted, 16)
    off = np.array([row.c_deg for row in told]) - predict(own, counted, scene).c_deg
    slope = np.abs(np.gradient(own.c_deg, own.q)).max()
    assert np.sqrt(np.mean(off**2)) < slope * 0.5 * COUNT
