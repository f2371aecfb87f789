"""Compensator and tracker in a loop of one's own say what they say of files."""

from dataclasses import replace

import numpy as np
import pytest

import tautline as tl
from tautline.recording import Angle
from tautline.rig import ANGLE
from tools.tracking.sessions import Instrument, ideal_model, session

MODEL = ideal_model(Instrument(1))


@pytest.fixture(scope="module")
def recording() -> tl.Recording:
    return session(Instrument(1), "scale", 1, 45.0, start_s=8.0).recording


def trajectory() -> tuple[np.ndarray, np.ndarray]:
    t_s = np.sort(np.random.default_rng(2).uniform(0.0, 3.0, 40))
    return t_s, 25.0 * np.sin(2.0 * t_s) + 5.0 * np.cos(9.0 * t_s)


@pytest.mark.parametrize("speed_max", [None, 4.0])
def test_steps_are_the_set_points_of_the_whole(speed_max):
    actuator = replace(MODEL.rig.actuator, speed_max=speed_max)
    model = replace(MODEL, rig=replace(MODEL.rig, actuator=actuator))
    t_s, c_deg = trajectory()
    whole = tl.compensate(model, t_s, c_deg, rate_hz=200)
    compensator = tl.Compensator(model, 200)
    assert compensator.clipped is False
    for t, c in zip(t_s, c_deg, strict=True):
        last = np.flatnonzero(whole.t_s <= t + 1e-9)[-1]
        assert compensator.step(c, t) == whole.q[last]
        assert compensator.clipped == whole.clipped[last]
    assert whole.clipped.any() == (speed_max is not None)
    halves = tl.Compensator(model, 200)
    parts = [halves.run(t_s[:17], c_deg[:17]), halves.run(t_s[17:], c_deg[17:])]
    for name in ("t_s", "q", "clipped"):
        assert np.array_equal(np.concatenate([getattr(part, name) for part in parts]), getattr(whole, name))


def test_a_step_back_in_time_is_refused_and_changes_nothing():
    compensator = tl.Compensator(MODEL)
    compensator.step(0.0, 10.0)
    q = compensator.step(3.0, 10.5)
    for c_deg, t_s in ((3.0, 10.5), (3.0, 9.0), (np.nan, 11.0), (3.0, 1e9)):
        with pytest.raises(tl.TautError, match="trajectory"):
            compensator.step(c_deg, t_s)
    other = tl.Compensator(MODEL)
    other.step(0.0, 10.0)
    assert other.step(3.0, 10.5) == q and other.step(-3.0, 11.0) == compensator.step(-3.0, 11.0)
    with pytest.raises(tl.TautError, match="choose one of off"):
        tl.Compensator(MODEL, mode="half")


def by_hand(recording: tl.Recording, samples: int) -> list:
    """The rows with so many motor samples at once, but each frame with all that came before its arrival."""
    tracker = tl.Tracker(MODEL)
    motor, marker = recording.motor, recording.marker
    given, rows = 0, []
    for k, t in enumerate(marker.t_s):
        while given < len(motor.t_s) and motor.t_s[given] <= t:
            piece = slice(given, given + samples)
            tracker.motor(motor.t_s[piece], motor.q[piece])
            given += samples
        seen = (marker.u_px[k], marker.v_px[k], marker.sigma_px[k]) if marker.sigma_px is not None else (
            marker.u_px[k], marker.v_px[k]
        )  # fmt: skip
        rows.append(tracker.see(t, *seen) if marker.valid[k] else tracker.see(t))
    return rows


@pytest.mark.parametrize("samples", [1, 700])
def test_the_tracker_by_hand_gives_the_rows_of_the_file(recording, samples):
    whole = tl.track(MODEL, recording)
    assert by_hand(recording, samples) == whole.rows
    assert {row.state for row in whole.rows} == {"trusted", "stale", "adapting"}


def test_the_tracker_says_what_it_was_given_wrongly(recording):
    tracker = tl.Tracker(MODEL)
    with pytest.raises(tl.TautError, match=r"motor\(t, q\) goes first"):
        tracker.see(1.0, 300.0, 200.0)
    tracker.motor([0.0, 0.1, 0.2], [0.0, 0.0, 0.0])
    for t_s, q in (([0.2], [0.0]), ([0.4, 0.3], [0.0, 0.0]), ([0.5], [np.nan])):
        with pytest.raises(tl.TautError, match="must rise"):
            tracker.motor(t_s, q)
    with pytest.raises(tl.TautError, match="differ in number"):
        tracker.motor([0.3, 0.4], [0.0])
    with pytest.raises(tl.TautError, match="u, v"):
        tracker.see(0.3, 12.0)
    tracker.see(0.3)
    with pytest.raises(tl.TautError, match="in order of time"):
        tracker.see(0.3)
    tracker.begin()
    tracker.motor(0.0, 0.0)
    assert tracker.see(0.1).state == "trusted" and tracker.changes == [] and tracker.compensation == 1.0


def test_an_angle_sensor_is_read(recording):
    model = replace(MODEL, sensor=ANGLE)
    t_s = recording.marker.t_s
    c_deg = model.simulate(recording.motor, t_s - model.delay_s)
    rows = tl.track(model, replace(recording, marker=None, angle=Angle(t_s, c_deg))).rows
    tracker = tl.Tracker(model)
    tracker.motor(recording.motor.t_s, recording.motor.q)
    assert [tracker.see(t, c) for t, c in zip(t_s, c_deg, strict=True)] == rows
