"""What a command writes: nothing of another recording stays beside it, and that it cannot be written is said first."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from cli_runner import Taut
from matplotlib.figure import Figure
from reference_instrument import RIG, saved_model, saved_recording

import tautline as tl
from tautline.errors import TautError
from tautline.folders import replaced_folder
from tautline.recording import save
from tautline.reports import figures
from tautline.rig import Actuator, Coarse, Rig

BRIEF = ("--motion", "sines", "--duration", 2, "--speed", 2)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def log(folder: Path) -> Path:
    """Of another program: its motor turns, its tip follows."""
    t_s = np.arange(0.0, 20.0, 0.02)
    path = folder / "log.csv"
    np.savetxt(path, np.c_[t_s, 20 * np.sin(t_s), 18 * np.sin(t_s)], delimiter=",", header="t_s,motor,tip", comments="")
    return path


def test_a_simulation_leaves_nothing_of_the_one_before(taut: Taut, tmp_path: Path) -> None:
    out = tmp_path / "made"
    assert taut("simulate", "--out", out, *BRIEF).code == 0
    (out / "video.mp4").write_bytes(b"of the one before")
    (out / "notes.txt").write_text("mine")
    assert taut("simulate", "--out", out, *BRIEF, "--seed", 2).code == 0
    assert "video.mp4" not in names(out) and {"notes.txt", "truth.csv", "marker.csv"} <= names(out)


def test_a_simulation_that_fails_leaves_the_one_before(
    taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "made"
    taut("simulate", "--out", out, *BRIEF)
    before = {path.name: path.read_bytes() for path in out.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("tautline.simulated.simulate.Simulation._save_video", full)
    assert "No space left" in taut.refuses("simulate", "--out", out, *BRIEF, "--video")
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before


def test_an_import_leaves_no_truth_of_a_simulation(taut: Taut, tmp_path: Path) -> None:
    out = tmp_path / "made"
    taut("simulate", "--out", out, *BRIEF)
    assert taut("import", log(tmp_path), "--out", out, "--motor", "motor:deg", "--tip", "tip:deg").code == 0
    assert names(out) == {"motor.csv", "angle.csv", "rig.toml", "import.toml"}


def test_an_import_does_not_overwrite_what_it_reads(taut: Taut, tmp_path: Path) -> None:
    source = log(tmp_path).rename(tmp_path / "motor.csv")
    before = source.read_bytes()
    told = taut.refuses("import", source, "--out", tmp_path, "--motor", "motor:deg", "--tip", "tip:deg")
    assert "would be overwritten" in told and source.read_bytes() == before


def test_a_recording_that_is_saved_leaves_nothing_of_another(tmp_path: Path) -> None:
    folder = saved_recording(tmp_path / "run")
    t_s = np.linspace(0.0, 1.0, 50)
    rig = Rig(Actuator("mm", (0.0, 1.0), 0.001), Coarse(1.0, 0.0))
    save(tl.Recording("other", tl.Motor(t_s, t_s), angle=tl.Angle(t_s, t_s), rig=rig), folder)
    assert names(folder) == {"motor.csv", "angle.csv", "rig.toml"}


def test_what_is_followed_in_a_video_is_saved_with_it(tmp_path: Path) -> None:
    folder, t_s = tmp_path / "run", np.linspace(0.0, 1.0, 50)
    folder.mkdir()
    for name in ("video.mkv", "region.toml", "region.png"):
        (folder / name).write_bytes(b"as it was")
    video = tl.recording.Video(folder / "video.mkv", None)
    save(tl.Recording("run", tl.Motor(t_s, t_s), video=video, rig=RIG), tmp_path / "copy")
    assert {"video.mkv", "region.toml", "region.png"} <= names(tmp_path / "copy")


def test_what_cannot_be_written_is_said_before_the_work(
    taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording, model = saved_recording(tmp_path / "run"), saved_model(tmp_path / "model")
    (tmp_path / "file").write_text("mine")

    def begun(*_: object, **__: object) -> None:
        raise AssertionError("the work was begun")

    for work in (
        "cli._common.load_all",
        "cli.predict.load_motor",
        "cli.compensate.read_trajectory",
        "model.Model.load",
    ):
        monkeypatch.setattr(f"tautline.{work}", begun)
    for out in (Path("/proc/new/place"), tmp_path / "file" / "place", tmp_path / ("x" * 250)):
        for words in (
            ("calibrate", recording, "--out", out),
            ("diagnose", recording, recording, "--out", out),
            ("track", model, recording, "--csv", out),
            ("track", model, recording, "--csv", tmp_path / "t.csv", "--picture", out),
            ("predict", model, recording, "--csv", out),
            ("compensate", model, "--trajectory", tmp_path / "path.csv", "--csv", out),
            ("export", recording, "--to", "csv", "--out", out),
            ("simulate", "--out", out),
            ("compare", model, model, "--html", out),
        ):
            assert "cannot be written" in taut.refuses(*words)
    assert names(tmp_path) == {"run", "model", "file"}


def test_pages_and_fleets_are_not_written_among_other_files(taut: Taut, tmp_path: Path) -> None:
    other = tmp_path / "other"
    other.mkdir()
    (other / "index.html").write_text("mine")
    saved_recording(tmp_path / "robots" / "one" / "monday")
    assert "name a new folder" in taut.refuses("explain", "--html", other)
    assert "name a new folder" in taut.refuses("fleet", tmp_path / "robots", "--out", other)
    assert names(other) == {"index.html"} and (other / "index.html").read_text() == "mine"


def test_a_picture_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "picture.png"
    figures.save(Figure(), path)
    before = path.read_bytes()

    def full(self: Figure, file: Path, **_: object) -> None:
        Path(file).write_bytes(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Figure, "savefig", full)
    with pytest.raises(TautError, match="No space left"):
        figures.save(Figure(), path)
    assert path.read_bytes() == before and names(tmp_path) == {"picture.png"}


def test_a_result_that_is_stopped_while_it_takes_its_place_leaves_the_one_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, rename = tmp_path / "out", Path.rename
    out.mkdir()
    (out / "key").write_text("before")

    def stopped(self: Path, target: Path) -> Path:
        if target == out and self.name == out.name and self.parent != tmp_path:
            raise KeyboardInterrupt
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", stopped)
    with pytest.raises(KeyboardInterrupt), replaced_folder(out, "key") as folder:
        (folder / "key").write_text("after")
    assert names(tmp_path) == {"out"} and (out / "key").read_text() == "before"
