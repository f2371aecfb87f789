"""Recordings, models and diagnoses as MCAP, rerun and CSV, opened by each format's own reader."""

from __future__ import annotations

import base64
import json
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import exported
import numpy as np
import pandas as pd
import pytest
from cli_runner import Taut

import tautline as tl
from tautline.errors import TautError
from tautline.geometry import project
from tautline.io.exporting import csv_files, export, formats, mcap_file, rerun_file
from tautline.io.exporting.log import of_source
from tautline.io.exporting.source import Source, of, read
from tautline.model import Effect
from tautline.recording import Angle, Marker, Motor, Recording, Video, save

FRAMES, SIZE = 40, (64, 48)
CREEP = Effect("transmission.creep", {"creep_share": 0.05, "creep_time": 1.0, "creep_slow": 0.0})


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """monday: a recording with a video, whose clock begins before 0; model; diagnosis."""
    root = tmp_path_factory.mktemp("export")
    model = exported.model()
    t_s = np.arange(-0.5, 2.0, 1e-3)
    q = 1.5 * np.sin(4.0 * t_s)
    arrival = -0.4 + 0.04 * np.arange(FRAMES)
    p = exported.play(q)
    image = project(model.rig, exported.law(np.interp(arrival - 0.08, t_s, p)))
    image += np.random.default_rng(0).normal(0.0, exported.NOISE_PX, image.shape)
    valid = np.arange(FRAMES) != 7
    marker = Marker(arrival, *np.where(valid[:, None], image, np.nan).T, valid)
    video = root / "video.mp4"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"mp4v"), 25.0, SIZE)
    for k in range(FRAMES):
        writer.write(np.full((SIZE[1], SIZE[0], 3), 6 * k, np.uint8))
    writer.release()
    recording = Recording("monday", Motor(t_s, q), marker, None, Video(video, arrival), model.rig)
    save(recording, root / "monday")
    model.save(root / "model")
    diagnosis = root / "diagnosis"
    model.save(diagnosis / "nominal")
    exported.model(effects=(CREEP,)).save(diagnosis / "corrected")
    document = {"format": "diagnosis/1", "unit": "px", "verdict": "effect"}
    (diagnosis / "diagnosis.json").write_text(json.dumps(document))
    return {name: root / name for name in ("monday", "model", "diagnosis")}


@pytest.fixture(scope="module")
def source(folders: dict[str, Path]) -> Source:
    return read(folders["monday"], None, folders["diagnosis"])


def messages(path: Path) -> tuple[dict[str, list[tuple[float, Any]]], dict[str, Any]]:
    """By topic, time and message as the format's own reader has them; the metadata."""
    from mcap.reader import make_reader

    found: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        for schema, channel, message in reader.iter_messages():
            assert schema is not None and channel.message_encoding == "json" and schema.encoding == "jsonschema"
            body = json.loads(message.data)
            properties = json.loads(schema.data)["properties"]
            assert body.keys() == properties.keys()
            found[channel.topic].append((message.log_time / 1e9, body))
        (metadata,) = reader.iter_metadata()
    return found, dict(metadata.metadata)


def test_an_mcap_holds_each_row_of_the_recording(source: Source, tmp_path: Path) -> None:
    out = tmp_path / "monday.mcap"
    done = export(source, "mcap", out)
    found, metadata = messages(out)
    shift = float(metadata["shift_s"])
    assert shift == 0.5  # nanoseconds are counted from 0 on
    assert source.recording is not None
    motor, marker = source.recording.motor, source.recording.marker
    assert marker is not None
    np.testing.assert_allclose([t - shift for t, _ in found["/motor"]], motor.t_s, atol=1e-9)
    np.testing.assert_array_equal([m["q_mm"] for _, m in found["/motor"]], motor.q)
    seen = found["/marker"]
    assert seen[7][1] == {"u_px": None, "v_px": None, "valid": 0.0}
    np.testing.assert_array_equal([m["u_px"] for _, m in seen if m["valid"]], marker.u_px[marker.valid])
    assert json.loads(metadata["facts"])["diagnosis"]["verdict"] == "effect"
    (curve,) = (m for _, m in found["/backlash/corrected"])
    np.testing.assert_array_equal(curve["width_mm"], exported.width(exported.GRID))
    assert done.files == (out, tmp_path / "monday.layout.json")


def test_the_frames_are_those_of_the_video_at_their_arrival(source: Source, tmp_path: Path) -> None:
    out = tmp_path / "monday.mcap"
    export(source, "mcap", out)
    frames = messages(out)[0]["/camera"]
    assert len(frames) == FRAMES
    for k, (t_s, message) in enumerate(frames):
        assert t_s == pytest.approx(0.5 - 0.4 + 0.04 * k, abs=1e-9)
        assert message["timestamp"]["sec"] + 1e-9 * message["timestamp"]["nsec"] == pytest.approx(t_s, abs=1e-9)
        picture = cv2.imdecode(np.frombuffer(base64.b64decode(message["data"]), np.uint8), cv2.IMREAD_COLOR)
        assert picture is not None and picture.shape == (SIZE[1], SIZE[0], 3)
        assert abs(picture.mean() - 6 * k) < 4  # two codecs of 8 bits


def test_the_residual_is_what_was_seen_less_what_the_stage_says(source: Source, tmp_path: Path) -> None:
    """The full model leaves the noise; without B, and by f_coarse, it is what the equations say."""
    export(source, "mcap", tmp_path / "x.mcap")
    found = messages(tmp_path / "x.mcap")[0]
    assert source.recording is not None and source.recording.marker is not None
    motor, marker = source.recording.motor, source.recording.marker
    rig, late = source.rig, marker.t_s > 0.9  # both ways by then
    p = np.interp(marker.t_s - 0.08, motor.t_s, exported.play(motor.q))
    coarse = project(rig, rig.coarse.gain * p + rig.coarse.offset)
    left = np.array([m["u_px"] for _, m in found["/residual/nominal/f_coarse_and_B"]], dtype=float)
    np.testing.assert_allclose(left[late], (marker.u_px - coarse[:, 0])[late], atol=0.02)
    full = np.array([m["u_px"] for _, m in found["/residual/nominal/f_remain_and_B"]], dtype=float)[late]
    assert 0.5 * exported.NOISE_PX < np.std(full) < 1.6 * exported.NOISE_PX
    assert "/residual/corrected/f_remain_and_B_and_effects" in found
    assert [m["p_mm"] for _, m in found["/prediction/nominal"]][-10:] == pytest.approx(list(p[-10:]), abs=1e-3)


def test_the_layout_names_only_what_is_in_the_file(source: Source, tmp_path: Path) -> None:
    export(source, "mcap", tmp_path / "x.mcap")
    found = messages(tmp_path / "x.mcap")[0]
    layout = json.loads((tmp_path / "x.layout.json").read_text())

    def leaves(tree: Any) -> list[str]:
        if isinstance(tree, str):
            return [tree]
        assert tree.keys() == {"direction", "first", "second"} and tree["direction"] in ("row", "column")
        return leaves(tree["first"]) + leaves(tree["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    plotted = set()
    for name, panel in layout["configById"].items():
        if name.startswith("Image!"):
            assert panel["imageMode"]["imageTopic"] in found
            continue
        for path in [each["value"] for each in panel["paths"]] + [panel[k] for k in ("xAxisPath",) if k in panel]:
            topic, column = path.removesuffix("[:]").rsplit(".", 1)
            value = found[topic][0][1][column]
            assert isinstance(value, list) == path.endswith("[:]")
            plotted.add(topic)
    assert plotted >= {"/motor", "/marker", "/prediction/corrected", "/backlash/corrected", "/f_remain/nominal"}


def test_a_rerun_recording_holds_each_column(source: Source, tmp_path: Path) -> None:
    from rerun.chunk import RrdReader

    out = tmp_path / "monday.rrd"
    export(source, "rerun", out)
    rows: dict[str, int] = defaultdict(int)
    values: dict[str, list[float]] = defaultdict(list)
    for chunk in RrdReader(out).stream():
        entity = str(chunk.entity_path)
        rows[entity] += chunk.num_rows
        table = chunk.to_record_batch()
        for name in table.schema.names:
            if "scalars" in name:
                values[entity] += [row[0] for row in table.column(name).to_pylist() if row]
    assert source.recording is not None and source.recording.marker is not None
    assert values["/motor/q_mm"] == source.recording.motor.q.tolist()
    assert values["/backlash/corrected/width_mm"] == exported.width(exported.GRID).tolist()
    assert rows["/marker/u_px"] == FRAMES - 1 and rows["/camera/marker"] == FRAMES - 1 and rows["/camera"] == FRAMES
    assert rows["/about"] == 1


def test_csv_gives_the_numbers_back(source: Source, tmp_path: Path) -> None:
    export(source, "csv", tmp_path / "csv")
    index = json.loads((tmp_path / "csv" / csv_files.INDEX).read_text())
    seen = of_source(source)
    parts = {part.name.replace("/", "-") + ".csv": part.columns for part in (*seen.series, *seen.curves)}
    assert {each["file"] for each in index["files"]} == set(parts)
    for file, columns in parts.items():
        table = pd.read_csv(tmp_path / "csv" / file)
        for name, values in columns.items():
            np.testing.assert_allclose(table[name], values, rtol=1e-14)


def test_a_model_alone_shows_its_onsets_and_curves(taut: Taut, folders: dict[str, Path], tmp_path: Path) -> None:
    onset = {"t_s": 1.5, "direction": 1, "q1": 0.0, "q2": 0.5, "width": 0.5, "sigma": None, "used": True}
    from dataclasses import replace

    replace(exported.model(), extra={"onsets": [onset]}).save(tmp_path / "model")
    done = taut("export", tmp_path / "model", "--to", "csv", "--out", tmp_path / "out", "--json")
    assert done.code == 0 and json.loads(done.out)["format"] == "csv"
    onsets = pd.read_csv(tmp_path / "out" / "onsets.csv")
    assert onsets["q2_mm"][0] == 0.5 and np.isnan(onsets["sigma_mm"][0])
    assert (tmp_path / "out" / "backlash-model.csv").exists()


def test_the_function_and_the_command_write_the_same(taut: Taut, folders: dict[str, Path], tmp_path: Path) -> None:
    taut("export", folders["monday"], "--to", "csv", "--out", tmp_path / "a", "--model", folders["model"])
    recording = tl.load(folders["monday"])
    tl.export(recording, "csv", tmp_path / "b", model=tl.Model.load(folders["model"]))
    for file in (tmp_path / "a").iterdir():
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


@pytest.mark.parametrize(("to", "module"), [("mcap", mcap_file), ("rerun", rerun_file), ("csv", csv_files)])
def test_what_fails_half_way_leaves_what_was_there(
    source: Source, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, to: str, module: Any
) -> None:
    out = tmp_path / "kept"
    export(source, to, out)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert before

    def fails(*words: Any, **named: Any) -> None:
        raise OSError(28, "No space left on device")

    if to == "csv":
        monkeypatch.setattr(pd.DataFrame, "to_csv", fails)
    else:
        monkeypatch.setattr(cv2, "imencode", fails)
    with pytest.raises(TautError, match="No space left"):
        export(source, to, out)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize("form", [form for form in formats.FORMATS if form.needs], ids=lambda form: form.name)
def test_a_missing_package_is_a_line_with_the_command(
    taut: Taut, folders: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, form: formats.Format
) -> None:
    import importlib.util

    known = importlib.util.find_spec
    missing = form.needs[0][0]
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *rest: None if name == missing else known(name, *rest)
    )
    line = taut.refuses("export", folders["model"], "--to", form.name, "--out", tmp_path / "x")
    assert f"pip install {form.needs[0][1]}" in line and "tautline-robotics[export]" in line


def test_frames_before_all_else_are_in_the_mcap(folders: dict[str, Path], tmp_path: Path) -> None:
    """A camera that began 0.1 s before the motor's clock did, and no track of it."""
    monday = read(folders["monday"]).recording
    assert monday is not None and monday.video is not None
    motor = Motor(monday.motor.t_s + 0.5, monday.motor.q)
    alone = replace(monday, motor=motor, marker=None, video=Video(monday.video.path, -0.1 + 0.04 * np.arange(FRAMES)))
    export(of(alone), "mcap", tmp_path / "x.mcap")
    found, facts = messages(tmp_path / "x.mcap")
    assert float(facts["shift_s"]) == pytest.approx(0.1)
    np.testing.assert_allclose([t for t, _ in found["/camera"]], 0.04 * np.arange(FRAMES), atol=1e-9)
    assert found["/motor"][0][0] == pytest.approx(0.1)


def test_a_model_without_a_camera_is_compared_with_the_angle_beside_a_marker() -> None:
    model = exported.model(camera=False)
    t_s = np.arange(0.0, 3.0, 1e-2)
    q = 2.0 * np.sin(3.0 * t_s)
    marker = Marker(t_s[::4], q[::4], q[::4], np.ones(75, bool))
    run = Recording("both", Motor(t_s, q), marker, Angle(t_s[::2], exported.law(exported.play(q))[::2]), rig=model.rig)
    series = {each.name: each for each in of_source(of(run, model)).series}
    left = series["residual/model/f_remain_and_B"]
    np.testing.assert_array_equal(left.t_s, t_s[::2])
    assert np.abs(left.columns["c_deg"][20:]).max() < 0.05 < np.abs(series["angle"].columns["c_deg"]).max()


def test_a_recording_is_no_model(taut: Taut, folders: dict[str, Path], tmp_path: Path) -> None:
    line = taut.refuses("export", folders["monday"], "--to", "linuxcnc", "--out", tmp_path / "x")
    assert "is a recording" in line and "a model or a diagnosis" in line
    other = taut.refuses(
        "export", folders["monday"], "--to", "csv", "--out", tmp_path / "x", "--model", folders["monday"]
    )
    assert "not another recording" in other


def test_the_page_names_every_format_and_what_it_needs() -> None:
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text()
    for form in formats.FORMATS:
        row = next(
            line for line in page.splitlines() if line.startswith("|") and f"`{form.name}`" in line.split("|")[1]
        )
        assert all(f"`{package}`" in row for _, package in form.needs)
        assert ("all" in row.split("|")[3]) == (len(form.takes) == 3)
