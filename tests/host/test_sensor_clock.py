"""Clocks and angle sensors: delays, offsets, held values, slow sensors and motors that step, found or refused."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from angle_plant import RIG, Motion, record, stated, width
from hypothesis import given, settings
from hypothesis import strategies as st
from slices import some

import tautline as tl
from tautline.calibration import clock
from tautline.calibration.angle_delay import delay_of_all
from tautline.calibration.calibrate import calibrate
from tautline.calibration.components import Components
from tautline.calibration.measuring import Measuring
from tautline.calibration.observations import not_held, observe
from tautline.calibration.onset import Delay
from tautline.calibration.smooth import Domain, fit_jointly, prepare_tracks
from tautline.calibration.steps import motor_jumps
from tautline.cli.diagnose import _calibrate_first
from tautline.encoder import between_counts
from tautline.errors import TautError
from tautline.model import Model
from tautline.prediction import predict, times_of
from tautline.quality import Verdict
from tautline.recording import Angle, Motor, Recording, load, save, shifted
from tautline.rig import ANGLE, MARKER, Rig
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth

CAMERA_RIG = reference_rig()
TIP_CAMERA = replace(CAMERA_RIG.camera, mount="tip", delay_s=0.3)
PLAIN = record(Motion.through(), delay_s=0.03)


def late(recording, offset_s):
    return shifted([recording], {recording.name: -offset_s})[0]


def width_error(model: Model) -> float:
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    return float(np.sqrt(np.mean((model.width - width(model.q))[inside] ** 2)))


# ---- the delay of an angle sensor


@pytest.mark.parametrize(
    ("delay_s", "sensor_hz", "within_s"), some([(0.22, 25.0, 2e-3), (0.03, 100.0, 1.5e-3), (0.15, 50.0, 1.5e-3)], 2)
)
def test_the_delay_of_an_angle_sensor_is_found(delay_s, sensor_hz, within_s):
    found = calibrate([record(Motion.through(), delay_s=delay_s, sensor_hz=sensor_hz, seed=3)], RIG)
    print(f"{1e3 * found.model.delay_s:.2f} ms of {1e3 * delay_s:.0f}, B {width_error(found.model):.4f} deg rms")
    assert abs(found.model.delay_s - delay_s) < within_s
    assert found.model.sensor == ANGLE and found.model.offset_s is None
    assert width_error(found.model) < 0.02  # of 2 deg; a delay of 30 ms that is not known makes 0.4


@pytest.mark.parametrize("sensor_hz", [10.0, 4.0])
def test_a_slow_sensor_works(sensor_hz):
    found = calibrate([record(Motion.through(), delay_s=0.03, sensor_hz=sensor_hz)], RIG)
    print(f"{sensor_hz:g} Hz: {1e3 * found.model.delay_s:.2f} ms of 30, B {width_error(found.model):.4f} deg rms")
    assert found.model.quality.verdict is not Verdict.UNUSABLE
    assert abs(found.model.delay_s - 0.03) < 3e-3 and width_error(found.model) < 0.04


@pytest.mark.parametrize(("jump_deg", "rises"), [(30.0, False), (-60.0, True)])
def test_a_spike_of_the_sensor_is_left_out(jump_deg, rises):
    """For a tenth of a second it is where the tip is at other times, at once or over some samples: its clock was taken
    for another one, and the calibration was unusable."""
    made = record(Motion.through((-35, 35, -30, 30, -35), 16.0), delay_s=0.03, noise=0.02, seed=3)
    since = made.angle.t_s - made.angle.t_s[0] - 7.4
    spike = jump_deg * ((since >= 0.0) & (since < 0.1)) * (1.0 - np.abs(since / 0.05 - 1.0) if rises else 1.0)
    found = calibrate([replace(made, angle=replace(made.angle, c_deg=made.angle.c_deg + spike))], RIG)
    assert found.model.quality.verdict is Verdict.GOOD and width_error(found.model) < 0.01
    assert any("values are elsewhere for a while: left out" in note for note in found.notes)


def test_a_motion_that_tells_no_delay_keeps_the_one_that_the_rig_states():
    there_and_back = Motion.through((-20, 20, -20), 0.8)
    found = calibrate([record(there_and_back, delay_s=0.06, noise=0.3, sensor_hz=20.0)], stated(0.06))
    assert abs(found.model.delay_s - 0.06) < 0.02


def test_a_prediction_is_of_the_scene_that_the_sensor_showed(tmp_path):
    found = calibrate([PLAIN], RIG)
    test = record(Motion.through((0, 30, -20, 25, -30, 10), 20.0), delay_s=0.03, noise=0.0, seed=9)
    save(test, tmp_path / "test")
    times = times_of(found.model, tmp_path / "test", test.motor)
    told = predict(found.model, test.motor, times.scene_s).c_deg
    settled = test.angle.t_s > 6.0
    rms = float(np.sqrt(np.mean((told - test.angle.c_deg)[settled] ** 2)))
    print(f"{rms:.4f} deg rms at 20 deg/s; a delay of 30 ms that is forgotten makes 0.6")
    assert rms < 0.03
    found.model.save(tmp_path / "model")
    again = Model.load(tmp_path / "model")
    assert again.sensor == ANGLE and again.delay_of(ANGLE) == found.model.delay_s and again.delay_of(MARKER) == 0.0


def test_a_cameras_delay_is_not_an_angle_sensors(tmp_path):
    q = np.linspace(-5.0, 5.0, 11)
    model = Model(CAMERA_RIG, q, 0.3 + 0 * q, 0.01 + 0 * q, 12.0 * q, 0.09, (-4.0, 4.0))
    motor = Motor(np.arange(0.0, 5.0, 0.01), np.linspace(-1.0, 1.0, 500))
    (tmp_path / "angle.csv").write_text("t_s,c_deg\n1.0,0\n2.0,0\n")
    assert times_of(model, tmp_path, motor).delay_s == 0.0
    (tmp_path / "marker.csv").write_text("t_s,u_px,v_px\n1.0,0,0\n")
    np.testing.assert_allclose(times_of(model, tmp_path, motor).scene_s, [0.91])


def test_the_rig_states_a_nominal_delay_and_rows_may_be_invalid(tmp_path):
    rig = stated(0.02)
    rig.save(tmp_path / "rig.toml")
    assert Rig.load(tmp_path / "rig.toml") == rig and rig.nominal_delay_s(ANGLE) == 0.02
    (tmp_path / "motor.csv").write_text("t_s,q_deg\n" + "".join(f"{0.01 * i:.2f},{0.1 * i:.1f}\n" for i in range(99)))
    (tmp_path / "angle.csv").write_text("t_s,c_deg,valid\n0.1,1,1\n0.2,999,0\n0.3,3,1\n0.4,nan,1\n")
    angle = load(tmp_path).angle
    assert angle.seen.tolist() == [True, False, True, False]
    assert observe([load(tmp_path)], rig)[0].y[:, 0].tolist() == [1.0, 3.0]
    save(load(tmp_path), tmp_path / "again")
    assert load(tmp_path / "again").angle.seen.tolist() == angle.seen.tolist()


# ---- another clock


def endoscope(seed: int = 3):
    motion = back_and_forth(CAMERA_RIG.actuator, [0.7, 1.5], 2.4, 12, 4.5)
    return run(CAMERA_RIG, preset("random", CAMERA_RIG, 31), motion, seed=seed).recording


@pytest.mark.parametrize("offset_s", some([-0.4, 9.7, 2.0], 2))
def test_an_offset_of_the_image_is_found_to_2_ms(offset_s):
    found = calibrate([late(endoscope(), offset_s)], CAMERA_RIG)
    error = found.model.delay_s + found.model.offset_s - offset_s - CAMERA_RIG.delay_s
    print(f"{offset_s} s: {1e3 * error:.2f} ms off, stated {1e3 * found.delay.sigma_s:.2f}")
    assert abs(error) < 2e-3
    assert found.model.delay_s == CAMERA_RIG.delay_s
    assert found.model.quality.reasons[0].code == "clock.offset"
    assert found.model.quality.usable and found.to_json()["offset_s"] == found.model.offset_s


@settings(max_examples=6, deadline=None)
@given(offset_s=st.floats(0.5, 9.5), sign=st.sampled_from([-1.0, 1.0]))
def test_an_offset_of_an_angle_sensor_is_found_wherever_it_is(offset_s, sign):
    aligned = clock.align(observe([late(PLAIN, sign * offset_s)], RIG), RIG)
    assert aligned.offset_s == pytest.approx(sign * offset_s + 0.03, abs=5e-3)
    assert [r.code for r in aligned.reasons] == ["clock.offset"] and not aligned.reasons[0].fatal


def test_a_clock_that_is_right_is_left_alone():
    for recording, rig in ((PLAIN, RIG), (endoscope(), CAMERA_RIG)):
        tracks = observe([recording], rig)
        aligned = clock.align(tracks, rig)
        assert aligned.tracks[0] is tracks[0] and aligned.reasons == () and aligned.offset_s is None


@pytest.mark.parametrize("late_s", [0.0, 0.17])
def test_stops_move_a_clock_only_where_the_motion_agrees(monkeypatch, late_s):
    """Behind a codec that holds back what moves little, a slow motion's stops are elsewhere, and seem certain."""
    tracks = observe([endoscope(3), late(replace(endoscope(4), name="other"), late_s)], CAMERA_RIG)
    said = {tracks[0].name: CAMERA_RIG.delay_s, "other": CAMERA_RIG.delay_s + 0.17}
    monkeypatch.setattr(clock, "delay_of_stops", lambda few, rig: Delay(said[few[0].name], 1e-3, 9))
    assert clock.align(tracks, CAMERA_RIG).offsets == ({"other": pytest.approx(0.17)} if late_s else {})


def test_what_a_diagnosis_is_to_explain_is_no_clock():
    """A lag makes one motion's image stop later than another's."""
    made = [endoscope(3), late(replace(endoscope(4), name="late"), 0.06), late(replace(endoscope(5), name="off"), 2.0)]
    assert set(clock.align(observe(made, CAMERA_RIG), CAMERA_RIG).offsets) == {"late", "off"}
    (before, behind, off), _ = clock.on_motor_clock(made, CAMERA_RIG)
    assert before is made[0] and np.array_equal(behind.marker.t_s, made[1].marker.t_s)
    assert np.median(made[2].marker.t_s - off.marker.t_s) == pytest.approx(2.0, abs=5e-3)


def test_a_lag_of_half_a_second_is_an_effects_where_the_calibration_was_on_the_motors_clock():
    """Friction that grows with speed may make a tip half a second late; another clock is off by any time."""
    for late_s, found_s in ((0.5, 0.0), (2.0, 2.0)):
        made = late(endoscope(3), late_s)
        alone, beside_calibration = (
            clock.on_motor_clock([made], CAMERA_RIG, one_clock=one_clock)[0][0] for one_clock in (False, True)
        )
        assert np.median(made.marker.t_s - alone.marker.t_s) == pytest.approx(late_s, abs=5e-3)
        assert np.median(made.marker.t_s - beside_calibration.marker.t_s) == pytest.approx(found_s, abs=5e-3)


def test_recordings_of_one_name_keep_a_clock_each():
    (right, off), _ = clock.on_motor_clock([PLAIN, late(PLAIN, 2.0)], RIG)
    assert right is PLAIN and off.angle.t_s == pytest.approx(PLAIN.angle.t_s, abs=0.05)


def test_a_diagnosis_says_which_clock_was_off_and_which_cannot_be_told(caplog, capsys, monkeypatch):
    """By the command and by the API alike; what is then diagnosed does not matter here."""
    first, off, other = (replace(record(Motion.through(), seed=n), name=f"r{n}") for n in (1, 2, 3))
    wandering = np.cumsum(np.random.default_rng(1).normal(0.0, 0.5, len(other.angle.t_s)))
    unlike = replace(other, angle=replace(other.angle, c_deg=wandering))
    made = [first, late(off, 2.0), unlike]
    _calibrate_first(made, RIG, Path("first"), lambda share, text: None)
    warned = capsys.readouterr().err.splitlines()
    says = ["r2: the sensor's clock is 2.000 s behind", "r3: at no offset within 10 s does the tip follow the motor"]
    assert len(warned) == 2 and all(f"taut: warning: {one}" in line for one, line in zip(says, warned, strict=True))
    monkeypatch.setattr("tautline.diagnosis.diagnose.diagnose", lambda *_: SimpleNamespace(findings=(), verdict="none"))
    tl.diagnose(made[0], made[1:], RIG)
    logged = [each.getMessage() for each in caplog.records if each.levelname == "WARNING"]
    assert all(map(str.startswith, logged, says)) and len(logged) == len(says)


@pytest.mark.parametrize("rig", [stated(0.3), Rig(RIG.actuator, RIG.coarse, camera=TIP_CAMERA)], ids=["sensor", "tip"])
def test_frames_that_tell_little_keep_the_delay_that_the_rig_states(rig):
    noisy = record(Motion.through((-35, 35, -35), speed=14.0), delay_s=0.3, noise=1.5)
    assert abs(delay_of_all(observe([noisy], RIG), rig).delay_s - 0.3) < 0.05


def test_a_delay_out_of_find_delays_reach_is_found():
    found = calibrate([late(endoscope(), 0.18)], CAMERA_RIG)
    assert abs(found.model.delay_s - CAMERA_RIG.delay_s - 0.18) < 2e-3 and found.model.offset_s is None


def test_two_offsets_that_fit_are_refused():
    repeating = Motion.through((-30, 30) * 12, 20.0)  # once in 6 s
    whole = late(record(repeating), 2.0)
    motor, angle = whole.motor, whole.angle
    k, j = (motor.t_s > 8.0) & (motor.t_s < 61.0), (angle.t_s > 11.0) & (angle.t_s < 59.0)
    part = replace(whole, motor=Motor(motor.t_s[k], motor.q[k]), angle=Angle(angle.t_s[j], angle.c_deg[j]))
    found = calibrate([part], RIG)
    reason = found.model.quality.reasons[0]
    print(reason)
    assert reason.code == "clock.offset" and reason.fatal and "fit alike" in reason.says


def test_a_repeating_motion_whose_delay_fits_is_not_refused():
    found = calibrate([record(Motion.through((-30, 30) * 8, 20.0))], RIG)
    assert found.model.quality.verdict is not Verdict.UNUSABLE and found.model.offset_s is None


def test_times_that_last_too_short_are_named():
    t_s = PLAIN.angle.t_s
    short = replace(PLAIN, angle=replace(PLAIN.angle, t_s=t_s[0] + (t_s - t_s[0]) * 61.0 / 90.0))
    reason = calibrate([short], RIG).model.quality.reasons[0]
    assert reason.code == "duration" and reason.fatal


def test_a_sensor_of_another_run_is_refused():
    other = record(Motion.through((3, -20, 14, -31, 2, 33, -9, 5, -33, 30, -17, 8, -28, 31, 4), 8.0), seed=8)
    n = min(len(PLAIN.angle.t_s), len(other.angle.t_s))
    mixed = replace(PLAIN, angle=Angle(PLAIN.angle.t_s[:n], other.angle.c_deg[:n]))
    found = calibrate([mixed], RIG)
    assert found.model.quality.verdict is Verdict.UNUSABLE
    assert found.model.quality.reasons[0].code == "clock.offset"


# ---- held values


@settings(max_examples=60, deadline=None)
@given(hold=st.integers(2, 8), seed=st.integers(0, 1000), rest=st.integers(0, 60))
def test_held_values_count_once_and_a_rest_stays_seen(hold, seed, rest):
    rng = np.random.default_rng(seed)
    there = np.cumsum(rng.uniform(0.3, 0.6, 30))
    still = np.full(rest, there[-1])
    samples = np.concatenate([there, still, there[::-1][1:] - rng.uniform(0.01, 0.2, 29)])
    fresh = not_held(np.repeat(samples, hold)[:, None])
    assert np.array_equal(np.flatnonzero(fresh), hold * np.arange(len(samples)))


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 1000), speed=st.floats(0.005, 0.3))
def test_a_coarse_sensor_or_a_tip_at_rest_is_not_held(seed, speed):
    rng = np.random.default_rng(seed)
    c = np.concatenate([np.zeros(100), np.arange(300) * speed, np.full(100, 299 * speed)]) + rng.uniform(0.0, 0.1)
    assert not_held((np.round(c / 0.088) * 0.088)[:, None]).all()
    assert not_held(c[:, None]).all()


def test_a_held_sensor_measures_nearly_as_well_as_its_own_rate_lets_it():
    held = record(Motion.through(), sensor_hz=50.0, hold_hz=10.0, delay_s=0.03)
    found = calibrate([held], RIG)
    print(f"held: B {width_error(found.model):.4f} deg rms, delay {1e3 * found.model.delay_s:.1f} ms")
    assert any("repeats its values" in note for note in found.notes)
    assert width_error(found.model) < 0.03  # 0.056 where every row counts


# ---- motors that step


def test_a_motor_that_only_steps_is_refused():
    levels = [-35, -20, -5, 10, 25, 10, -5, -20, -35, -20, 0, 20, 35, 15, -10, -30]
    for motor_hz in (1000.0, 50.0, 10.0):
        found = calibrate([record(Motion.steps(levels, 3.0), sensor_hz=50.0, motor_hz=motor_hz)], RIG)
        reason = found.model.quality.reasons[0]
        assert reason.code == "steps" and reason.fatal


def test_a_recording_that_shows_a_step_and_nothing_else_is_left_out():
    t_s = np.arange(0.0, 60.0, 0.5)
    motor = Motor(t_s, 20.0 * np.sin(0.1 * np.pi * t_s) + 8.0 * (t_s >= 25.0))
    seen_s = np.linspace(24.52, 24.98, 12)  # between the two samples of the step
    step = Recording("step", motor, angle=Angle(seen_s, np.interp(seen_s, t_s, motor.q)), rig=RIG)
    with pytest.raises(TautError, match="only where the motor steps"):
        calibrate([step], RIG)
    with_it, alone = calibrate([PLAIN, step], RIG, naming=False), calibrate([PLAIN], RIG, naming=False)
    assert np.array_equal(with_it.model.width, alone.model.width) and with_it.names == ("joint",)
    assert any("12 frames at which the tip follows" in note for note in with_it.notes)


def test_a_few_steps_between_strokes_are_left_out():
    motion = Motion.through().then(Motion.steps([-35, -10, 20, -15, 30, -35], 3.0)).then(Motion.through())
    recording = record(motion, sensor_hz=50.0, motor_hz=50.0)
    c = recording.angle.c_deg.copy()
    after = np.flatnonzero(np.abs(np.diff(c, prepend=c[0])) > 5.0)
    for at in after:  # a tip that swings in
        ring = np.arange(min(60, len(c) - at))
        c[at + ring] += 8.0 * np.exp(-ring / 12.0) * np.cos(ring / 3.0)
    found = calibrate([replace(recording, angle=replace(recording.angle, c_deg=c))], RIG)
    print(f"with steps: B {width_error(found.model):.4f} deg rms; {found.notes[0]}")
    assert found.model.quality.usable and "left out" in found.notes[0]
    assert width_error(found.model) < 0.02


@pytest.mark.parametrize("delay_s", [0.0, 0.033])
@pytest.mark.parametrize("dwell_s", [0.5, 0.507])
def test_a_frame_beside_a_step_does_not_tell_the_delay(delay_s, dwell_s):
    """The tip rests there, but the motor's speed over some milliseconds is the step's: one such frame held the delay to
    microseconds wherever it was, and B was up to five sigma off."""
    motion = Motion.through((-35, 35, -30, 30, -35), 15.0).then(Motion.steps((-35, 10, -20, 25), dwell_s))
    found = calibrate([record(motion, noise=0.03, delay_s=delay_s, seed=1)], RIG, naming=False)
    model = found.model
    q = np.linspace(-25.0, 25.0, 101)
    off = np.interp(q, model.q, model.width) - width(q)
    assert np.sqrt(np.mean((off / np.interp(q, model.q, model.width_sigma)) ** 2)) < 2.0
    assert abs(model.delay_s - delay_s) < 3.0 * found.delay.sigma_s


@settings(max_examples=60, deadline=None)
@given(rate=st.sampled_from([10.0, 50.0, 1000.0]), speed=st.floats(0.5, 60.0), seed=st.integers(0, 100))
def test_no_motion_at_a_speed_is_a_step(rate, speed, seed):
    rng = np.random.default_rng(seed)
    motion = Motion.through(tuple(rng.uniform(-35, 35, 6)), speed)
    stride = round(1000.0 / rate)
    q = motion.q[::stride]
    # A stroke of a few samples cannot be told from a step.
    if np.min(np.abs(np.diff(motion.q[np.flatnonzero(np.diff(np.sign(np.diff(motion.q))))]))) > 5 * speed / rate:
        assert len(motor_jumps(Motor(motion.t_s[::stride], np.round(q / 0.01) * 0.01), 0.01)) == 0


def test_between_counts_a_step_stays_within_its_sample():
    t_s = np.arange(0.0, 20.0, 0.02)
    q = np.where(t_s < 7.0, -3.0, np.where(t_s < 13.0, 4.0, -1.0))
    smooth = between_counts(Motor(t_s, q), 0.01)
    np.testing.assert_allclose(smooth.q, q, atol=1e-9)


@pytest.mark.parametrize(("sigma_s", "own"), [(0.02, False), (0.0002, True)])
def test_a_delay_that_departures_leave_uncertain_is_the_nominal_one(sigma_s: float, own: bool) -> None:
    tracks = observe([record(Motion.through(), delay_s=0.003)], RIG)
    joint = fit_jointly(prepare_tracks(tracks, 0.0), Domain(*RIG.actuator.range), 0.0, fit_delay=True)
    assert joint is not None and joint.curves.delay_s == pytest.approx(0.003, abs=5e-4)
    session = cast(Measuring, SimpleNamespace(framed=False, nominal_s=0.0))
    width = joint.fit.width(joint.curves)
    departing = cast(
        Components, SimpleNamespace(delay_sigma=sigma_s, width=width, sigma=0.01 * width, width_by_delay=None)
    )
    alone = Measuring._with_uncertainty_of_departures(session, joint, departing)
    assert alone.delay_sigma == sigma_s
    assert alone.curves.delay_s == (joint.curves.delay_s if own else 0.0)
