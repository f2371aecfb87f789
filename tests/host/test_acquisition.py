"""Recordings that are not what the rig says: named, and refused where nothing that was measured can be used."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace

import angle_plant
import numpy as np
import pytest
from cli_runner import Taut

from tautline import recording as recordings
from tautline.calibration.acquisition import rig_contradictions
from tautline.calibration.calibrate import calibrate
from tautline.calibration.observations import observe
from tautline.errors import TautError
from tautline.live.setup import CameraSource
from tautline.quality import Quality, Reason, Verdict
from tautline.recording import Marker, Recording
from tautline.rig import Actuator, Rig
from tautline.simulated.instrument import preset, reference_rig
from tautline.simulated.simulate import run
from tautline.trajectory import back_and_forth

RIG = reference_rig()


@pytest.fixture(scope="module")
def made() -> Recording:
    path = back_and_forth(RIG.actuator, [1.2], 1.6, 16, 5.0, 0.1)
    return run(RIG, preset("reference", RIG), path, seed=71).recording


def quality(recording: Recording, rig: Rig = RIG) -> Quality:
    """Of what is checked before anything is fitted."""
    return Quality.of(rig_contradictions([recording], observe([recording], rig), [0.0], rig))


def reason(found: Quality, code: str) -> Reason:
    return next(r for r in found.reasons if r.code == code)


def scaled(recording: Recording, by: float, frame_px: tuple[int, int] | None = None) -> Recording:
    marker = recording.marker
    u, v = (by * (x + 0.5) - 0.5 for x in (marker.u_px, marker.v_px))
    return replace(recording, marker=replace(marker, u_px=u, v_px=v, sigma_px=None, frame_px=frame_px))


def test_nothing_is_said_of_a_recording_that_fits(made: Recording) -> None:
    found = calibrate([replace(made, marker=replace(made.marker, frame_px=(720, 576)))], RIG).model.quality
    assert found.verdict is Verdict.GOOD, found


@pytest.mark.parametrize("by", [0.5, 2 / 3, 1.5])
def test_another_frame_size_is_refused_with_its_scale_named(made: Recording, by: float) -> None:
    told = quality(scaled(made, by, (round(720 * by), round(576 * by))))
    assert told.verdict is Verdict.UNUSABLE
    assert f"{by:.4g}" in reason(told, "frame_size").remedy
    alone = quality(scaled(made, by))  # by the marker's places only
    assert alone.verdict is Verdict.UNUSABLE
    assert f"{by:.4g}" in reason(alone, "frame_size").remedy


def test_a_cut_picture_has_no_scale(made: Recording) -> None:
    found = quality(replace(made, marker=replace(made.marker, frame_px=(640, 576))))
    assert found.verdict is Verdict.UNUSABLE
    assert "multiply" not in reason(found, "frame_size").remedy


def test_marker_positions_outside_of_the_frame_are_refused(made: Recording) -> None:
    small = RIG.with_camera(width_px=200, height_px=160)
    assert reason(quality(made, small), "frame_size").fatal


def test_a_false_sighting_outside_of_the_frame_is_no_frame_size(made: Recording) -> None:
    u_px = made.marker.u_px.copy()
    u_px[100:4000:50] = -40.0
    u_px[101:4000:50] = 900.0
    found = quality(replace(made, marker=replace(made.marker, u_px=u_px)))
    assert "frame_size" not in {r.code for r in found.reasons} and found.verdict is not Verdict.UNUSABLE


def test_recordings_of_two_sizes_are_not_taken_together(made: Recording) -> None:
    fits = replace(made, name="one", marker=replace(made.marker, frame_px=(720, 576)))
    other = replace(scaled(made, 0.5, (360, 288)), name="two")
    both = [fits, other]
    found = Quality.of(rig_contradictions(both, observe(both, RIG), [0.0, 0.0], RIG))
    assert found.verdict is Verdict.UNUSABLE and "two" in reason(found, "frame_size").says


def test_a_wrong_hand_eye_is_no_frame_size(made: Recording) -> None:
    turned = replace(RIG, hand_eye=replace(RIG.hand_eye, rotation_deg=(7.0, -6.0, 5.0)))
    assert "frame_size" not in {r.code for r in quality(made, turned).reasons}


@pytest.mark.parametrize(("factor", "name"), [(1e3, "micrometres"), (1e-3, "metres")])
def test_a_range_in_another_unit_is_refused(made: Recording, factor: float, name: str) -> None:
    low, high = RIG.actuator.range
    rig = replace(RIG, actuator=Actuator("mm", (low * factor, high * factor), RIG.actuator.encoder_resolution))
    found = calibrate([made], rig).model.quality  # a model to look at, all the same
    assert found.verdict is Verdict.UNUSABLE
    assert f"actuator.range looks like {name}:" in reason(found, "range").remedy


def test_a_gain_that_bends_the_tip_round_and_round_is_refused(made: Recording) -> None:
    found = quality(made, replace(RIG, coarse=replace(RIG.coarse, gain=12_000.0)))
    assert reason(found, "range").fatal


def stretched(recording: Recording, by: float) -> Recording:
    marker = recording.marker
    first = marker.t_s[0]
    return replace(recording, marker=replace(marker, t_s=first + (marker.t_s - first) * by))


@pytest.mark.parametrize("by", [61 / 90, 1.4])
def test_a_video_that_plays_at_another_speed_contradicts_the_motor(made: Recording, by: float) -> None:
    found = quality(stretched(made, by))
    assert found.verdict is Verdict.UNUSABLE
    assert reason(found, "clock").fatal
    assert reason(found, "rate").says.endswith("the rig says 25")


def test_a_camera_that_was_stopped_early_is_only_said(made: Recording) -> None:
    marker = made.marker
    keep = marker.t_s < made.motor.t_s[0] + 0.68 * np.ptp(made.motor.t_s)
    short = replace(
        marker, **{name: getattr(marker, name)[keep] for name in ("t_s", "u_px", "v_px", "valid", "sigma_px")}
    )
    found = quality(replace(made, marker=short))
    assert not reason(found, "duration").fatal
    assert "clock" not in {r.code for r in found.reasons}


@pytest.mark.parametrize(("before_s", "after_s"), [(0.0, 9.0), (9.0, 0.0), (5.0, 4.0)])
def test_a_camera_that_runs_for_longer_than_the_motors_log_is_not_told_to(
    made: Recording, before_s: float, after_s: float
) -> None:
    """The tip rests meanwhile."""
    t_s = made.marker.t_s
    early, behind = np.arange(t_s[0] - before_s, t_s[0] - 0.01, 0.04), np.arange(t_s[-1], t_s[-1] + after_s, 0.04)[1:]
    ends = (len(early), len(behind))
    u_px, v_px, valid = (np.pad(getattr(made.marker, name), ends, "edge") for name in ("u_px", "v_px", "valid"))
    long = Marker(np.concatenate([early, t_s, behind]), u_px, v_px, valid)
    found = quality(replace(made, marker=long))
    told = reason(found, "duration")
    assert told.mild and found.verdict == Verdict.GOOD, found
    assert re.search(r": 8\.9\d? s of them are without the motor$", told.says), told
    assert "log the motor" in told.remedy and "camera first" not in told.remedy


def test_a_sensor_that_was_started_late_is_no_camera() -> None:
    whole = angle_plant.record(angle_plant.Motion.through((-35, 35, -35, 35), speed=14.0))
    late = replace(whole, angle=recordings.Angle(whole.angle.t_s[600:], whole.angle.c_deg[600:]))
    assert "start the sensor first" in reason(quality(late, angle_plant.RIG), "duration").remedy


def test_lost_frames_leave_the_rate_alone_and_a_dark_part_is_named(made: Recording) -> None:
    marker = made.marker
    some = np.arange(len(marker.t_s)) % 2 == 0
    half = replace(
        marker, **{name: getattr(marker, name)[some] for name in ("t_s", "u_px", "v_px", "valid", "sigma_px")}
    )
    assert "rate" not in {r.code for r in quality(replace(made, marker=half)).reasons}
    q = np.interp(marker.t_s - RIG.delay_s, made.motor.t_s, made.motor.q)
    dark = replace(marker, valid=marker.valid & (q > -2.5))
    assert "-2.5" in reason(quality(replace(made, marker=dark)), "lost").says


def test_the_frame_size_stays_with_a_recording(made: Recording, tmp_path) -> None:
    kept = replace(made, marker=replace(made.marker, frame_px=(720, 576)))
    recordings.save(kept, tmp_path / "one")
    assert recordings.load(tmp_path / "one").marker.frame_px == (720, 576)
    recordings.save(made, tmp_path / "two")
    assert recordings.load(tmp_path / "two").marker.frame_px is None
    file = tmp_path / "one" / "marker.csv"
    lines = file.read_text().splitlines()
    file.write_text("\n".join([*lines[:5], lines[5].replace("720", "640"), *lines[6:]]) + "\n")
    torn = recordings.load(tmp_path / "one")
    assert torn.marker.frame_px is None and any("one size" in w for w in torn.warnings)


def test_the_command_refuses_a_half_sized_recording(made: Recording, tmp_path, taut: Taut) -> None:
    recordings.save(scaled(made, 0.5, (360, 288)), tmp_path / "half")
    done = taut("calibrate", tmp_path / "half", "--out", tmp_path / "model", "--json")
    assert done.code == 3
    assert json.loads(done.out)["quality"]["reasons"][0]["code"] == "frame_size"
    assert (tmp_path / "model" / "model.json").is_file()


def test_a_live_camera_of_another_size_is_an_error_at_its_first_frame() -> None:
    class Half:
        clock = "its own"

        def read(self):
            return np.zeros((288, 360, 3), np.uint8), 0.0

        def close(self) -> None: ...

    with pytest.raises(TautError, match="360 x 288 px, the rig's 720 x 576"):
        CameraSource(None, Half(), None, (720, 576)).look()


@pytest.mark.parametrize(("factor", "name"), [(1e-3, "metres"), (1e3, "micrometres")])
def test_a_motor_in_another_unit_is_named(made: Recording, factor: float, name: str) -> None:
    scaled = replace(made, motor=replace(made.motor, q=made.motor.q * factor))
    assert f"q_mm of motor.csv looks like {name}:" in reason(quality(scaled, RIG), "range").remedy


def test_radians_are_named_where_degrees_are_meant() -> None:
    made = angle_plant.record(angle_plant.Motion.through(speed=20.0), motor_hz=100.0)
    assert made.angle is not None
    in_radians = {
        "c_deg of angle.csv": replace(made, angle=replace(made.angle, c_deg=np.radians(made.angle.c_deg))),
        "q_deg of motor.csv": replace(made, motor=replace(made.motor, q=np.radians(made.motor.q))),
    }
    for column, recording in in_radians.items():
        remedy = reason(calibrate([recording], angle_plant.RIG).model.quality, "coarse").remedy
        assert "in radians looks like this" in remedy and column in remedy and "camera" not in remedy


def test_a_frames_csv_that_is_shorter_than_its_video_is_what_is_to_be_mended(made: Recording) -> None:
    marker = made.marker
    assert marker is not None
    count = len(marker.t_s) // 2
    few = {name: getattr(marker, name)[:count] for name in ("t_s", "u_px", "v_px", "valid")}
    seen = Marker(**few, untimed=len(marker.t_s) - count)
    remedy = reason(quality(replace(made, marker=seen)), "duration").remedy
    assert f"frames.csv lists {count} of the video's {len(marker.t_s)} frames" in remedy
    assert (
        "start the camera first" in reason(quality(replace(made, marker=replace(seen, untimed=0))), "duration").remedy
    )


@pytest.mark.parametrize("late_s", [0.0, 5.0])
def test_where_the_marker_is_not_seen_is_told_part_by_part_on_any_clock(made: Recording, late_s: float) -> None:
    marker, motor = made.marker, made.motor
    q = np.interp(marker.t_s - RIG.delay_s, motor.t_s, motor.q)
    low, high = np.quantile(motor.q, [0.25, 0.75])
    hidden = replace(made, marker=replace(marker, t_s=marker.t_s + late_s, valid=marker.valid & (q > low) & (q < high)))
    told = Quality.of(rig_contradictions([hidden], observe([made], RIG), [late_s], RIG))
    says = reason(told, "lost").says
    assert says.count("from") == 2 and " and from " in says, says
    ends = [float(word) for word in says.replace(":", "").split() if word.replace(".", "").replace("-", "").isdigit()]
    assert ends[1] < np.median(motor.q) < ends[2]


def test_an_angle_sensor_without_a_value_is_no_marker(made: Recording) -> None:
    bare = Rig(RIG.actuator, RIG.coarse)
    t_s = np.arange(0.0, 20.0, 0.02)
    dead = replace(made, marker=None, angle=recordings.Angle(t_s, np.full(len(t_s), np.nan)))
    with pytest.raises(TautError, match=r"angle\.csv"):
        calibrate([dead], bare)


def test_a_marker_that_no_camera_of_the_rig_could_see_is_not_what_is_missing(made: Recording) -> None:
    t_s = np.arange(0.0, 20.0, 0.02)
    dead = replace(made, angle=recordings.Angle(t_s, np.full(len(t_s), np.nan)))
    with pytest.raises(TautError, match=r"angle\.csv"):
        calibrate([dead], Rig(RIG.actuator, RIG.coarse))


@pytest.mark.parametrize("late_s", [-90.0, 90.0])
def test_no_more_of_the_motion_is_without_frames_than_there_is(made: Recording, late_s: float) -> None:
    """Frames of another time altogether."""
    says = reason(quality(replace(made, marker=replace(made.marker, t_s=made.marker.t_s + late_s))), "duration").says
    missing = float(says.split(": ")[-1].split(" s of the motion")[0])
    assert 0.9 < missing / np.ptp(made.motor.t_s) < 1.0, says


def test_of_a_single_frame_no_size_is_told(made: Recording) -> None:
    names = ("t_s", "u_px", "v_px", "valid", "sigma_px")
    one = replace(made.marker, **{name: getattr(made.marker, name)[100:101] for name in names})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "frame_size" not in {r.code for r in quality(scaled(replace(made, marker=one), 0.5)).reasons}
