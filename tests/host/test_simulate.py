"""The simulated instrument, its motions, frame clock and recordings, against their definitions."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner, Result
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import recording as recordings
from tautline.cli.simulate import MOTIONS, command
from tautline.errors import TautError
from tautline.geometry import project
from tautline.rig import Rig
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import PRESETS, Instrument, preset, reference_rig
from tautline.simulated.simulate import run, simulate
from tautline.trajectory import Trajectory, back_and_forth, random_smooth, sines, through, trapezoids
from tautline.vision.marker import track_video
from tautline.vision.timing import FrameTiming

RIG = reference_rig()
ACTUATOR = RIG.actuator


def play(q: np.ndarray, instrument: Instrument, p: float) -> np.ndarray:
    """Reference: the play by bisection on the true tables, sample by sample."""
    out = []
    for value in q:
        for side in (+1.0, -1.0):
            low, high = value - 3.0, value + 3.0
            for _ in range(60):
                middle = 0.5 * (low + high)
                if middle + side * instrument.backlash(middle) / 2 < value:
                    low = middle
                else:
                    high = middle
            edge = 0.5 * (low + high)
            p = max(p, edge) if side > 0 else min(p, edge)
        out.append(p)
    return np.array(out)


@given(seed=st.integers(0, 10_000), name=st.sampled_from(PRESETS))
@settings(max_examples=15, deadline=None)
def test_the_instrument_is_a_play_and_remembers(seed: int, name: str) -> None:
    instrument = preset(name, RIG, seed)
    rng = np.random.default_rng(seed)
    q = np.clip(np.cumsum(rng.normal(0, 0.6, 40)), -5, 5)
    t = np.arange(40) / 10
    whole = instrument.centre(t, q)
    assert np.allclose(whole, play(q, instrument, q[0]), atol=1e-9)
    instrument.reset()
    parts = np.concatenate([instrument.centre(t[:17], q[:17]), instrument.centre(t[17:], q[17:])])
    assert np.array_equal(parts, whole)


@given(seed=st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_random_instruments_stay_within_what_they_promise(seed: int) -> None:
    instrument = preset("random", RIG, seed)
    step = np.diff(instrument.grid)
    slope = np.diff(instrument.c_deg) / step / RIG.coarse.gain
    assert instrument.width.min() > 0 and np.abs(np.diff(instrument.width) / step).max() <= 1.21
    assert slope.min() >= 0.24 and slope.max() <= 1.61


def test_a_rig_that_falls_gets_an_instrument_that_falls() -> None:
    document = RIG.to_document()
    document["coarse"]["gain"] = -12.0
    for name in PRESETS:
        assert np.all(np.diff(preset(name, Rig.from_document(document, "rig")).c_deg) < 0)


def test_an_impossible_instrument_is_refused() -> None:
    with pytest.raises(TautError, match="slope"):
        Instrument.of(RIG, lambda p: 12.0 + 2.1 * p, lambda p: p)
    with pytest.raises(TautError, match="rise or fall"):
        Instrument.of(RIG, lambda p: 0 * p, lambda p: p**2)
    with pytest.raises(TautError, match="choose one of reference"):
        preset("none")


@pytest.mark.parametrize(
    "motion",
    [
        back_and_forth(ACTUATOR, [0.35, 1.0], 1.6, 40, 4.0, 0.1),
        back_and_forth(ACTUATOR, [1.0], 0.01, 2000, 50.0),  # strokes too short to reach full speed
        trapezoids(ACTUATOR, 1.0, 3.0, 6, 4.0, 0.5),
        sines(ACTUATOR, 1.0, 60.0),
        random_smooth(ACTUATOR, 1.0, 60.0, 5),
    ],
    ids=["back-and-forth", "tiny strokes", "trapezoids", "sines", "random"],
)
def test_motions_keep_range_speed_and_rate(motion: Trajectory) -> None:
    assert np.allclose(np.diff(motion.t_s), 1e-3) and motion.t_s[0] == 0.0
    assert motion.q.min() > -5.0001 and motion.q.max() < 5.0001
    velocity = np.diff(motion.q) * 1000
    assert np.abs(velocity).max() < 1.3
    assert np.abs(np.diff(velocity)).max() * 1000 < 50.1


def test_back_and_forth_covers_the_range_in_both_directions_at_each_speed() -> None:
    motion = back_and_forth(ACTUATOR, [0.5, 1.0], 1.5, 20, 5.0)
    assert motion.q[0] == -5.0 and np.isclose(motion.q.max(), 5.0) and np.isclose(motion.q[-1], -5.0, atol=1e-5)
    way = np.sign(np.diff(motion.q))
    assert np.count_nonzero(np.diff(way[way != 0])) == 2 * (20 + 1 + 20) + 1
    with pytest.raises(TautError, match="choose a stroke"):
        back_and_forth(ACTUATOR, [0.5], 0.1, 20, 5.0)


@given(points=st.lists(st.floats(-5, 5), min_size=2, max_size=8), dwell=st.sampled_from([0.0, 0.3]))
@settings(max_examples=40, deadline=None)
def test_through_reaches_every_point_within_its_limits(points: list[float], dwell: float) -> None:
    motion = through(points, 2.0, 5.0, dwell)
    for point in points:
        assert np.abs(motion.q - point).min() < 2.0 * 1e-3
    velocity = np.diff(motion.q) * 1000
    if len(velocity) > 1:
        assert np.abs(velocity).max() < 2.0001 and np.abs(np.diff(velocity)).max() * 1000 < 5.001


def test_frames_come_in_order_late_and_some_never() -> None:
    timing = FrameTiming(25.0, 0.08, jitter_s=0.03, lost=0.2, seed=4)
    frames = timing.frames()
    scene, arrival = np.array([next(frames) for _ in range(4000)]).T
    assert np.all(np.diff(arrival) > 0) and np.all(arrival >= scene)
    assert abs(len(scene) / (scene[-1] * 25) - 0.8) < 0.02
    assert abs(np.median(arrival - scene) - 0.08) < 0.01
    again = timing.frames()
    assert next(again) == (scene[0], arrival[0])


def test_a_simulated_recording_is_the_truth_seen_late_and_noisy() -> None:
    instrument = preset("reference", RIG)
    motion = back_and_forth(ACTUATOR, [1.0], 1.6, 30, 5.0).with_sway(1.5, 8.0, 20.0)
    result = run(RIG, instrument, motion, noise_px=0.05, timing=FrameTiming.of(RIG, lost=0.1, seed=2), seed=2)
    marker, motor = result.recording.marker, result.recording.motor
    assert marker is not None and marker.valid.all()
    assert np.allclose(marker.t_s - result.scene_s, 0.08)
    assert np.abs(motor.q - motion.q).max() <= 0.0005 + 1e-12
    at = [np.interp(result.scene_s, motion.t_s, x) for x in (motion.translation_mm, motion.rotation_deg)]
    image = project(RIG, np.interp(result.scene_s, result.t_s, result.c_deg), *at)
    error = np.column_stack([marker.u_px, marker.v_px]) - image
    assert abs(error.std() - 0.05) < 0.003 and np.abs(error.mean(axis=0)).max() < 0.005


def test_without_a_camera_an_angle_is_recorded() -> None:
    rig = Rig(ACTUATOR, RIG.coarse)
    result = run(rig, preset("davinci", rig), sines(ACTUATOR, 1.0, 30.0), angle_noise_deg=0.02)
    assert result.recording.marker is None
    angle = result.recording.angle
    assert angle is not None
    assert abs(np.std(angle.c_deg - np.interp(angle.t_s, result.t_s, result.c_deg)) - 0.02) < 0.002


def test_what_leaves_the_picture_is_not_valid() -> None:
    rig = RIG.with_camera(width_px=300)
    marker = simulate(rig, preset("reference", rig), sines(ACTUATOR, 1.0, 60.0)).marker
    assert marker is not None and 0.1 < marker.valid.mean() < 0.9
    assert np.isnan(marker.u_px[~marker.valid]).all() and np.isfinite(marker.u_px[marker.valid]).all()


def test_a_saved_simulation_loads_and_tells_the_truth(tmp_path: Path) -> None:
    result = run(RIG, preset("random", RIG, 3), sines(ACTUATOR, 1.0, 10.0), seed=3)
    result.save(tmp_path / "a")
    loaded = recordings.load(tmp_path / "a")
    assert loaded.warnings == () and loaded.rig == RIG
    truth = pd.read_csv(tmp_path / "a" / "truth.csv")
    assert np.allclose(truth["p"], result.p, atol=1e-6) and np.allclose(truth["t_s"], loaded.motor.t_s)
    document = json.loads((tmp_path / "a" / "truth.json").read_text())
    grid = np.array(document["backlash"]["q"])
    assert np.allclose(document["backlash"]["width"], result.instrument.backlash(grid))
    assert document["delay_s"] == 0.08


def test_a_simulated_video_is_tracked_to_the_same_places(tmp_path: Path) -> None:
    instrument = preset("reference", RIG)
    timing = FrameTiming.of(RIG, lost=0.1, seed=9)
    result = run(RIG, instrument, sines(ACTUATOR, 2.0, 1.0), noise_px=0.0, timing=timing)
    result.save(tmp_path / "a")
    assert (tmp_path / "a" / "marker.csv").exists()
    result.save(tmp_path / "a", Endoscope(RIG), lossless=True)
    assert not (tmp_path / "a" / "marker.csv").exists()
    video = recordings.load(tmp_path / "a").video
    assert video is not None
    tracked, expected = track_video(video), result.recording.marker
    assert expected is not None and np.allclose(tracked.t_s, expected.t_s, atol=1e-6) and tracked.valid.all()
    error = np.column_stack([tracked.u_px - expected.u_px, tracked.v_px - expected.v_px])
    assert np.sqrt(np.mean(error**2, axis=0)).max() < 0.03


def test_a_folder_of_something_else_is_not_written_to(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(TautError, match="name a new folder"):
        run(RIG, preset("constant", RIG), sines(ACTUATOR, 1.0, 1.0)).save(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def taut(*arguments: object) -> Result:
    return CliRunner().invoke(command, [str(argument) for argument in arguments])


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_command_makes_recordings_of_every_motion(motion: str, tmp_path: Path) -> None:
    asked = [
        "--motion",
        motion,
        "--seed",
        4,
        "--instrument",
        "random",
        "--speed",
        2,
        "--duration",
        8,
        "--reversals",
        14,
    ]
    result = taut("--out", tmp_path / "a", *asked, "--json")
    assert result.exit_code == 0, result.output
    said = json.loads(result.stdout)
    loaded = recordings.load(tmp_path / "a")
    assert said["frames"] == len(loaded.marker.t_s) and said["duration_s"] > 5
    again = taut("--out", tmp_path / "b", *asked)
    assert again.exit_code == 0
    for name in ("motor.csv", "marker.csv", "truth.csv"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_the_command_draws_a_video_over_ones_own_picture(tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "b.png"), np.full((50, 60, 3), (80, 90, 160), np.uint8))
    arguments = ["--motion", "random", "--duration", 1, "--video", "--background", tmp_path / "b.png"]
    assert taut("--out", tmp_path / "a", *arguments).exit_code == 0
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == [
        "frames.csv",
        "marker.toml",
        "motor.csv",
        "rig.toml",
        "truth.csv",
        "truth.json",
        "video.mkv",
    ]


def test_the_command_says_what_does_not_fit_together(tmp_path: Path) -> None:
    Rig(ACTUATOR, RIG.coarse).save(tmp_path / "rig.toml")
    result = taut("--rig", tmp_path / "rig.toml", "--out", tmp_path / "a", "--video")
    assert result.exit_code != 0 and "[camera]" in str(result.exception)
    short = ("--motion", "sines", "--duration", 0.1, "--lost", 0.9, "--seed", 1, "--video")
    result = taut("--out", tmp_path / "a", *short)
    assert isinstance(result.exception, TautError) and "no frame" in str(result.exception)
    result = taut("--out", tmp_path / "a", "--motion", "trapezoids", "--amplitude", 11)
    assert "does not fit the range" in str(result.exception)


@pytest.mark.parametrize(
    "motion",
    [
        lambda: through([0.0, 1.0], np.nan, 10.0),
        lambda: through([0.0, 1.0], 1e-9, 10.0),
        lambda: through([0.0, 1.0], 1.0, 10.0, np.nan),
        lambda: sines(RIG.actuator, np.nan, 10.0),
        lambda: sines(RIG.actuator, 1.0, np.nan),
        lambda: random_smooth(RIG.actuator, np.inf, 10.0, 1),
    ],
)
def test_a_motion_that_cannot_be_is_refused(motion: Callable[[], Trajectory]) -> None:
    with pytest.raises(TautError, match="motion"):
        motion()
