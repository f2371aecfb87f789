"""The command line: results on stdout, the rest on stderr, exit codes, rows and times of predictions."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Taut

from tautline import tables, trajectory
from tautline.calibration.calibrate import calibrate
from tautline.cli import stream
from tautline.geometry import project
from tautline.model import Model
from tautline.recording import Recording, save
from tautline.rig import Actuator, Coarse, Rig
from tautline.simulated import instrument, simulate

RIG = instrument.reference_rig()
PLANT = instrument.preset("reference", RIG)
MOTION = trajectory.back_and_forth(RIG.actuator, [1.0], 2.0, 12, 10.0)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate.simulate(RIG, PLANT, MOTION)


@pytest.fixture(scope="module")
def folder(recording: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "monday"
    save(recording, path)
    return path


def truth(rig: Rig = RIG, plant: instrument.Instrument = PLANT) -> Model:
    q = np.linspace(*rig.actuator.range, 401)
    return Model(rig, q, plant.backlash(q), np.full_like(q, 0.01), plant.bend(q), rig.delay_s, rig.actuator.range)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "model"
    truth().save(path)
    return path


def test_calibrate_prints_what_the_formats_promise(taut: Taut, folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "model"
    done = taut("calibrate", folder, "--out", out, "--json")
    assert done.code == 0, done.err
    result = json.loads(done.out)
    q, width = np.array(result["backlash"]["q"]), np.array(result["backlash"]["width"])
    assert len(q) == len(width) == len(result["backlash"]["sigma"]) and q[0] == -5 and q[-1] == 5
    low, high = result["backlash"]["measured"]
    inside = (q > low) & (q < high)
    assert np.sqrt(np.mean((width - PLANT.backlash(q))[inside] ** 2)) < 0.02
    assert len(result["remaining"]["q"]) == len(result["remaining"]["c_deg"])
    assert abs(result["delay_s"] - 0.08) < 0.005
    used = [onset for onset in result["onsets"] if onset["used"]]
    assert len(used) > 12
    for onset in used:
        assert {"t_s", "direction", "q1", "q2", "width", "sigma"} <= onset.keys()
        assert onset["direction"] == np.sign(onset["q2"] - onset["q1"])
        assert onset["width"] == pytest.approx(abs(onset["q2"] - onset["q1"]))
    assert {path.name for path in out.iterdir()} >= {"model.json", "rig.toml", "report.html"}
    again = taut("report", out)
    assert again.code == 0 and again.out.strip() == str(out / "report.html")


def test_a_noise_stated_frame_by_frame_does_not_move_a_still_marker(recording: Recording) -> None:
    marker = recording.marker
    assert marker is not None
    stated = 0.05 * np.random.default_rng(1).uniform(0.8, 1.2, len(marker.t_s))
    found = calibrate([replace(recording, marker=replace(marker, sigma_px=stated))], RIG)
    widths = [onset for onset in found.onsets if onset.used and onset.kind == "hinge"]
    truth_mm = PLANT.backlash(np.array([onset.q_mean for onset in widths]))
    assert len(widths) > 12 and np.abs([onset.width for onset in widths] - truth_mm).max() < 0.02


def test_a_videos_own_clock_may_run_ahead(recording: Recording) -> None:
    marker = recording.marker
    assert marker is not None
    found = calibrate([replace(recording, marker=replace(marker, t_s=marker.t_s - 0.11))], RIG)
    assert abs(found.model.delay_s + 0.03) < 0.001
    inside = (found.model.q > found.model.measured[0]) & (found.model.q < found.model.measured[1])
    assert np.abs(found.model.width - PLANT.backlash(found.model.q))[inside].max() < 0.02
    assert tables.decode(tables.encode(found.model)).delay_s == 0.0


def test_the_papers_modes_in_words(taut: Taut, folder: Path, tmp_path: Path) -> None:
    words = ("--knots", "paper", "--remaining", "morphological", "--rig", folder / "rig.toml")
    done = taut("calibrate", folder, "--out", tmp_path / "model", *words)
    assert done.code == 0 and "before the tip moves" in done.out, done.err
    found = Model.load(tmp_path / "model")
    inside = np.abs(found.q) < 4
    assert np.std((found.c_deg - PLANT.bend(found.q))[inside]) < 1.0


def test_predict_one_row_per_marker_row_with_its_time_as_written(
    taut: Taut, model: Path, folder: Path, tmp_path: Path
) -> None:
    given = (folder / "marker.csv").read_text().splitlines()
    broken = tmp_path / "r"
    broken.mkdir()
    (broken / "motor.csv").write_bytes((folder / "motor.csv").read_bytes())
    rows = [f"{float(line.split(',')[0]):.4f}0,not,read" for line in given[1:]]
    (broken / "marker.csv").write_text("\n".join([given[0], *rows]) + "\n")
    out = tmp_path / "out.csv"
    assert json.loads(taut("predict", model, broken, "--csv", out, "--json").out)["rows"] == len(rows)
    lines = out.read_text().splitlines()
    assert lines[0] == "t_s,c_deg,u_px,v_px,c_sigma_deg,u_sigma_px,v_sigma_px"
    assert [line.split(",")[0] for line in lines[1:]] == [row.split(",")[0] for row in rows]


def test_prediction_is_of_the_scene_not_of_the_arrival(
    taut: Taut, model: Path, recording: Recording, folder: Path, tmp_path: Path
) -> None:
    out = tmp_path / "out.csv"
    assert taut("predict", model, folder, "--csv", out).code == 0
    table = pd.read_csv(out)
    assert recording.marker is not None
    error = np.column_stack([table.u_px - recording.marker.u_px, table.v_px - recording.marker.v_px])[50:]
    assert np.sqrt(np.nanmean(error**2)) < 0.06
    c = truth().simulate(recording.motor, recording.marker.t_s - 0.08)
    np.testing.assert_allclose(table.c_deg, c, atol=1e-6)
    np.testing.assert_allclose(table[["u_px", "v_px"]], project(RIG, c), atol=1e-4)


def test_times_without_marker_are_frames_of_the_motion(taut: Taut, model: Path, folder: Path, tmp_path: Path) -> None:
    only = tmp_path / "only"
    only.mkdir()
    (only / "motor.csv").write_bytes((folder / "motor.csv").read_bytes())
    out = tmp_path / "out.csv"
    assert taut("predict", model, only, "--csv", out).code == 0
    table = pd.read_csv(out)
    np.testing.assert_allclose(table.t_s, 0.08 + np.arange(len(table)) / 25.0, atol=1e-6)
    assert abs(table.t_s.iloc[-1] - 0.08 - MOTION.duration_s) < 0.04


def test_a_videos_frames_are_predicted_where_frames_csv_says(
    taut: Taut, model: Path, folder: Path, tmp_path: Path
) -> None:
    video = tmp_path / "video"
    video.mkdir()
    (video / "motor.csv").write_bytes((folder / "motor.csv").read_bytes())
    arrivals = [f"{0.1 + 0.04 * k + 0.003 * (k % 3):.5f}" for k in range(0, 300) if k % 50]
    (video / "frames.csv").write_text("frame,t_s\n" + "".join(f"{k},{t}\n" for k, t in enumerate(arrivals)))
    out = tmp_path / "out.csv"
    assert taut("predict", model, video, "--csv", out).code == 0
    assert [line.split(",")[0] for line in out.read_text().splitlines()[1:]] == arrivals


def test_a_prediction_is_scored_where_the_truth_lies_beside_it(
    taut: Taut, model: Path, folder: Path, tmp_path: Path
) -> None:
    told = json.loads(taut("predict", model, folder, "--csv", tmp_path / "o.csv", "--json").out)
    assert told["off_truth_deg"] is None
    made = tmp_path / "made"
    assert taut("simulate", "--out", made, "--motion", "sines", "--duration", 20).code == 0
    done = taut("predict", model, made, "--csv", tmp_path / "o.csv", "--json")
    assert json.loads(done.out)["off_truth_deg"] < 0.02
    truth = pd.read_csv(made / "truth.csv")
    truth.assign(c_deg=truth.c_deg + 1.0).to_csv(made / "truth.csv", index=False)
    assert "1 deg rms off truth.csv" in taut("predict", model, made, "--csv", tmp_path / "o.csv").out


def test_named_times_any_order_and_start(taut: Taut, model: Path, folder: Path, tmp_path: Path) -> None:
    (tmp_path / "times.csv").write_text("x,t_s\n,3.50\n,-1\n,1e3\n,3.50\n")
    out = tmp_path / "out.csv"
    words = ("--times", tmp_path / "times.csv", "--start-deg", "-45")
    assert taut("predict", model, folder, "--csv", out, *words).code == 0
    rows = [line.split(",") for line in out.read_text().splitlines()[1:]]
    assert [row[0] for row in rows] == ["3.50", "-1", "1e3", "3.50"] and rows[0] == rows[3]
    # q is held before the first sample, where the tip is where it starts
    assert float(rows[1][1]) == pytest.approx(-45.0, abs=1e-5)


def test_a_sensor_has_no_delay_and_no_image(taut: Taut, tmp_path: Path) -> None:
    rig = Rig(Actuator("deg", (0.0, 60.0), 0.044), Coarse(-0.9, 77.0))
    plant = instrument.preset("davinci", rig)
    made = simulate.simulate(rig, plant, trajectory.through([5, 50, 20, 55, 5], 40.0, 400.0), angle_noise_deg=0.0)
    save(made, tmp_path / "r")
    truth(rig, plant).save(tmp_path / "m")
    out = tmp_path / "out.csv"
    assert taut("predict", tmp_path / "m", tmp_path / "r", "--csv", out).code == 0
    table = pd.read_csv(out)
    assert made.angle is not None and table.u_px.isna().all() and table.v_px.isna().all()
    assert out.read_text().splitlines()[1].endswith(",,")
    np.testing.assert_allclose(table.c_deg, made.angle.c_deg, atol=0.05)


def test_angle_times_have_no_delay_even_with_a_camera_in_the_rig(
    taut: Taut, model: Path, folder: Path, tmp_path: Path
) -> None:
    both = tmp_path / "both"
    both.mkdir()
    (both / "motor.csv").write_bytes((folder / "motor.csv").read_bytes())
    (both / "angle.csv").write_text("t_s,c_deg\n3.0,0\n4.0,0\n")
    out = tmp_path / "out.csv"
    assert taut("predict", model, both, "--csv", out).code == 0
    table = pd.read_csv(out)
    motor = pd.read_csv(folder / "motor.csv")
    from tautline.recording import Motor

    expected = truth().simulate(Motor(motor.t_s.to_numpy(), motor.q_mm.to_numpy()), [3.0, 4.0])
    np.testing.assert_allclose(table.c_deg, expected, atol=1e-6)
    assert table.u_px.notna().all()


def test_exit_codes(taut: Taut, model: Path, folder: Path, tmp_path: Path) -> None:
    assert taut("calibrate").code == 2
    assert taut("nonsense").code == 2
    assert taut("predict", model, folder).code == 2
    assert taut("predict", model, folder, "--csv", tmp_path / "o.csv", "--start-deg", "up").code == 2
    assert taut("--help").code == 0 and taut("calibrate", "--help").code == 0
    assert "no such folder" in taut.refuses("predict", model, tmp_path / "nothing", "--csv", tmp_path / "o.csv")
    assert "no such folder" in taut.refuses("calibrate", tmp_path / "nothing", "--out", tmp_path / "m")
    assert "taut calibrate" in taut.refuses("predict", tmp_path / "nothing", folder, "--csv", tmp_path / "o.csv")


def test_every_command_takes_json_and_help(taut: Taut) -> None:
    import click

    from tautline.cli import COMMANDS
    from tautline.cli import taut as group

    for name in ("calibrate", "predict", "compare", "report"):
        command = group.get_command(click.Context(group), name)
        assert command is not None and any("--json" in option.opts for option in command.params)
        assert name in COMMANDS and taut(name, "--help").code == 0


def test_the_installed_command(folder: Path, model: Path, tmp_path: Path) -> None:
    out = tmp_path / "out.csv"
    words = [
        str(Path(sys.executable).with_name("taut")),
        "predict",
        str(model),
        str(folder),
        "--csv",
        str(out),
        "--json",
    ]
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and done.stderr == "" and json.loads(done.stdout)["csv"] == str(out)
    words[3] = str(tmp_path / "nothing")
    done = subprocess.run(words, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1 and len(done.stderr.splitlines()) == 1
    assert json.loads(done.stdout) == {"error": done.stderr.strip().removeprefix("taut: "), "status": 1}


def test_rig_option_wins(taut: Taut, folder: Path, tmp_path: Path) -> None:
    other = replace(RIG, actuator=Actuator("deg", (-5.0, 5.0), 0.001))
    other.save(tmp_path / "rig.toml")
    line = taut.refuses("calibrate", folder, "--rig", tmp_path / "rig.toml", "--out", tmp_path / "m")
    assert "expected q_deg" in line and not (tmp_path / "m").exists()


def test_set_points_may_stand_in_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "points.txt"
    path.write_text("0.5\n\n1.5\n")
    with path.open() as file:
        monkeypatch.setattr(sys, "stdin", file)
        lines = stream._Lines()
        assert lines.newest() == "1.5" and lines.ended
