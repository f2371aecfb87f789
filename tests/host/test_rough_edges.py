"""What a new user runs into in the first hour: each is one line that says what to do."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import Taut
from reference_instrument import RIG, saved_model, saved_recording

from tautline.cli import marker as marker_command
from tautline.device import usb_link
from tautline.model import Model
from tautline.recording import load
from tautline.reports import pages
from tautline.reports.evidence import FILE as EVIDENCE
from tautline.simulated.endoscope import Endoscope
from tautline.vision.colour import MarkerColour
from tautline.vision.marker import find_colour

ROOT = Path(__file__).parents[2]


@pytest.fixture
def taut(taut: Taut, no_board: None) -> Taut:
    return taut


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return saved_recording(tmp_path / "run")


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return saved_model(tmp_path / "model")


def test_without_a_board_only_what_a_command_has_is_advised(taut: Taut, model: Path) -> None:
    assert usb_link.ENVIRONMENT not in os.environ
    for words in (["monitor"], ["stream"], ["clear"], ["flash", model]):
        line = taut.refuses(*words)
        assert "no board was found" in line and "--simulate" not in line and "--board" in line
    rig = model / "rig.toml"
    assert "--simulate" in taut.refuses("follow", "--rig", rig)


@pytest.mark.parametrize(
    "words", [["report", "{}"], ["calibrate", "{}", "--out", "o"], ["predict", "{}", "r", "--csv", "o"]]
)
def test_a_name_that_is_too_long(taut: Taut, words: list[str], tmp_path: Path) -> None:
    line = taut.refuses(*(word.format(tmp_path / ("x" * 300)) for word in words))
    assert "too long" in line.lower() and "internal" not in line and len(line) < 300


def test_a_folder_that_may_not_be_written(taut: Taut, folder: Path, tmp_path: Path) -> None:
    line = taut.refuses("simulate", "--motion", "sines", "--duration", 1, "--out", "/proc/new/recording")
    assert "/proc/new" in line and "internal" not in line


@pytest.mark.parametrize("key", ["q", "effects", "delay_s", "measured", "extra", "width_sigma"])
def test_a_model_without_a_key(taut: Taut, model: Path, key: str) -> None:
    document = json.loads((model / "model.json").read_text())
    del document[key]
    (model / "model.json").write_text(json.dumps(document))
    line = taut.refuses("report", model)
    assert f"{key} missing" in line and "KeyError" not in line


@pytest.mark.parametrize(
    "damage",
    [{"effects": [{}]}, {"quality": {}}, {"elements": {}}, {"measured": 3}, {"delay_s": 10**400}, {"quality": []}],
)
def test_a_model_with_a_wrong_value(taut: Taut, model: Path, damage: dict[str, object]) -> None:
    document = json.loads((model / "model.json").read_text()) | damage
    (model / "model.json").write_text(json.dumps(document))
    line = taut.refuses("report", model)
    assert "damaged" in line and "Error" not in line


def test_a_model_of_another_unit(taut: Taut, model: Path, tmp_path: Path) -> None:
    text = (model / "rig.toml").read_text()
    (tmp_path / "other.toml").write_text(text.replace('unit = "mm"', 'unit = "deg"'))
    line = taut.refuses("follow", model, "--rig", tmp_path / "other.toml", "--simulate")
    assert "in deg" in line and "in mm" in line
    (model / "rig.toml").write_text(text.replace('unit = "mm"', 'unit = "deg"'))
    for words in (["report", model], ["flash", model]):
        line = taut.refuses(*words)
        assert "model.json is in mm" in line and "in deg" in line


@pytest.mark.parametrize("damage", ["pickle", "cut", "nonsense", "object"])
def test_damaged_evidence_is_never_advised_to_be_trusted(
    taut: Taut, folder: Path, model: Path, tmp_path: Path, damage: str
) -> None:
    pages.save_model(Model.load(model), [load(folder, RIG)], tmp_path / "made")
    path = tmp_path / "made" / EVIDENCE
    if damage == "pickle":
        path.write_bytes(b"\x80\x04K\x01.")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:2000])
    elif damage == "nonsense":
        path.write_bytes(b"nonsense")
    else:
        with np.load(path) as data:
            np.savez(path, **{**data, "names": np.array([{}], dtype=object)})
    line = taut.refuses("report", tmp_path / "made")
    assert "damaged" in line and EVIDENCE in line and "pickle" not in line


@pytest.mark.parametrize("name", ["video.mkv", "marker.csv", "motor.csv", "frames.csv", "rig.toml"])
def test_a_link_to_nothing_is_named(taut: Taut, folder: Path, tmp_path: Path, name: str) -> None:
    (folder / name).unlink(missing_ok=True)
    if name == "video.mkv":
        (folder / "marker.csv").unlink()
    (folder / name).symlink_to("/media/disk/gone")
    rig = tmp_path / "rig.toml"
    RIG.save(rig)
    line = taut.refuses("calibrate", folder, "--rig", rig, "--out", tmp_path / "out")
    assert f"{folder / name}: is a link to /media/disk/gone" in line


def test_a_board_that_is_built_says_so_first(tmp_path: Path) -> None:
    """./run with a compiler that takes its time: the first thing that is said."""
    (tmp_path / "run").write_text((ROOT / "run").read_text())
    for name, text in (("tools/setup", "exit 0"), ("bin/cmake", "sleep 0.2; exit 1")):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(f"#!/bin/sh\n{text}\n")
        path.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.environ['PATH']}"}
    for words in (["board"], ["demo"]):
        done = subprocess.run(
            ["bash", tmp_path / "run", *words], env=environment, capture_output=True, text=True, check=False
        )
        assert done.returncode != 0 and "build gcc" in done.stderr.splitlines()[0]


def test_few_reversals_are_all_of_use(taut: Taut, tmp_path: Path) -> None:
    assert "warning" not in taut("simulate", "--out", tmp_path / "few", "--reversals", 12).err
    done = taut("calibrate", tmp_path / "few", "--out", tmp_path / "model", "--json")
    onsets = json.loads(done.out)["onsets"]
    assert len(onsets) == 51 and all(onset["used"] for onset in onsets)


def test_strokes_that_nothing_moves_on_are_warned_of(taut: Taut, tmp_path: Path) -> None:
    done = taut("simulate", "--out", tmp_path / "few", "--reversals", 12, "--amplitude", 1.5)
    assert done.code == 0 and "24 of the motor's strokes are shorter than the instrument's backlash" in done.err
    done = taut("simulate", "--out", tmp_path / "many", "--motion", "sines", "--duration", 20)
    assert done.code == 0 and "warning" not in done.err


# -- taut marker ------------------------------------------------------------------------------------------------------


def large_pictures(count: int) -> list[np.ndarray]:
    """Of 1920 x 1080 px."""
    scope = Endoscope(RIG)
    return [
        cv2.resize(scope.frame(c), (1920, 1080), interpolation=cv2.INTER_CUBIC) for c in np.linspace(-30, 30, count)
    ]


def test_the_colour_lies_where_it_is_looked_for(taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recording = tmp_path / "recording"
    recording.mkdir()
    writer = cv2.VideoWriter(str(recording / "video.mkv"), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (720, 576))
    scope = Endoscope(RIG)
    for c in np.linspace(0, 10, 8):
        writer.write(scope.frame(c))
    writer.release()
    monkeypatch.chdir(tmp_path)
    assert taut("marker", recording / "video.mkv").code == 0
    assert (recording / "marker.toml").is_file() and not (tmp_path / "marker.toml").exists()
    cv2.imwrite(str(tmp_path / "picture.png"), scope.frame(20.0))
    assert taut("marker", tmp_path / "picture.png").code == 0  # for --colour, which is marker.toml here
    assert (tmp_path / "marker.toml").is_file()


def test_a_large_picture_is_searched_small(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = large_pictures(6)
    slow = find_colour(pictures)
    searched: list[int] = []

    def listened(given: Sequence[np.ndarray]) -> MarkerColour | None:
        searched.append(sum(p.shape[0] * p.shape[1] for p in given))
        return find_colour(given)

    monkeypatch.setattr(marker_command, "find_colour", listened)
    quick = marker_command._find_colour(pictures)
    assert 4 * sum(searched) <= 6 * 1920 * 1080
    assert quick is not None and slow is not None
    assert np.allclose(quick.colour, slow.colour, atol=12.0) and abs(quick.diameter_px / slow.diameter_px - 1.0) < 0.1
