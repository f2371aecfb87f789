"""Bad input, end to end: an error in one line or a result that says what could not be measured, and nothing lost."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import Finished, Taut
from reference_instrument import PLANT, moved, saved_model, saved_recording

from tautline.errors import TautError
from tautline.recording import Recording, save
from tautline.simulated import simlink


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return saved_recording(tmp_path / "run")


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return saved_model(tmp_path / "model")


def rows(path: Path, change: Callable[[pd.DataFrame], pd.DataFrame]) -> None:
    change(pd.read_csv(path)).to_csv(path, index=False)


def lines(path: Path, change: Callable[[list[str]], list[str]]) -> None:
    path.write_text("\n".join(change(path.read_text().splitlines())) + "\n")


DAMAGE: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "empty": ("motor.csv", lambda path: path.write_text(""), "empty"),
    "header only": ("motor.csv", lambda path: lines(path, lambda text: text[:1]), "no rows"),
    "one row": ("motor.csv", lambda path: lines(path, lambda text: text[:2]), "single row"),
    "foreign": ("motor.csv", lambda path: path.write_bytes(b"\x89PNG\r\n\x1a\n\0\0"), "not a text file"),
    "a web page": ("motor.csv", lambda path: path.write_text("<html>\n<body>no</body>\n</html>\n"), "t_s is missing"),
    "semicolons": ("motor.csv", lambda path: path.write_text(path.read_text().replace(",", ";")), "semicolons"),
    "NaN": ("motor.csv", lambda path: rows(path, lambda t: t.assign(q_mm=t.q_mm.where(t.index != 9))), "line 11: q_mm"),
    "unsorted": ("motor.csv", lambda path: rows(path, lambda t: t[::-1]), "goes back"),
    "repeated": ("motor.csv", lambda path: rows(path, lambda t: t.assign(t_s=t.t_s.round(2))), "repeats"),
    "missing column": ("motor.csv", lambda path: rows(path, lambda t: t.drop(columns="q_mm")), "q_mm is missing"),
    "wrong unit": (
        "motor.csv",
        lambda path: rows(path, lambda t: t.rename(columns={"q_mm": "q_deg"})),
        "expected q_mm",
    ),
    "milliseconds": ("motor.csv", lambda path: rows(path, lambda t: t.assign(t_s=1e3 * t.t_s)), "in seconds"),
    "marker column": ("marker.csv", lambda path: rows(path, lambda t: t.drop(columns="u_px")), "u_px is missing"),
    "marker empty": ("marker.csv", lambda path: path.write_text(""), "empty"),
    "marker header": ("marker.csv", lambda path: lines(path, lambda text: text[:1]), "no rows"),
    "marker unsorted": ("marker.csv", lambda path: rows(path, lambda t: t[::-1]), "goes back"),
    "other clock": ("marker.csv", lambda path: rows(path, lambda t: t.assign(t_s=t.t_s + 1e5)), "do not overlap"),
    "rig": ("rig.toml", lambda path: path.write_text('format = "rig/1"\n[actuator]\n'), "actuator.unit is missing"),
    "rig cut": ("rig.toml", lambda path: path.write_text("format = "), "TOML"),
    "no sensor": ("marker.csv", lambda path: path.unlink(), "one of them is needed"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_a_damaged_recording_is_refused_in_one_line(taut: Taut, folder: Path, tmp_path: Path, kind: str) -> None:
    file, damage, says = DAMAGE[kind]
    damage(folder / file)
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    line = taut.refuses("calibrate", folder, "--out", tmp_path / "out", "--json")
    assert says in line and str(folder) in line
    assert not (tmp_path / "out").exists() and before == {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.mark.parametrize("kind", [kind for kind, damage in DAMAGE.items() if damage[0] == "motor.csv"])
def test_a_damaged_motor_is_no_base_for_a_prediction(
    taut: Taut, folder: Path, model: Path, tmp_path: Path, kind: str
) -> None:
    _, damage, says = DAMAGE[kind]
    damage(folder / "motor.csv")
    out = tmp_path / "out.csv"
    out.write_text("an earlier result")
    assert says in taut.refuses("predict", model, folder, "--csv", out)
    assert out.read_text() == "an earlier result"


def calibrated(taut: Taut, recording: Recording, tmp_path: Path) -> Finished:
    save(recording, tmp_path / "made")
    return taut("calibrate", tmp_path / "made", "--out", tmp_path / "out", "--json")


def assert_says(done: Finished, *words: str) -> None:
    """An error in one line, or a result that has no width and says so; either names the cause."""
    text = done.err.lower()
    assert any(word in text for word in words), done.err
    if done.code in (0, 3):
        result = json.loads(done.out)
        assert done.code == 0 or result["quality"]["verdict"] == "unusable"
        assert not any(onset["used"] for onset in result["onsets"])
        low, high = result["backlash"]["measured"]
        assert low is None or not low < high
    else:
        assert done.code == 1 and json.loads(done.out)["status"] == 1 and len(done.err.splitlines()) == 1


def test_a_marker_that_is_never_seen(taut: Taut, folder: Path, tmp_path: Path) -> None:
    rows(folder / "marker.csv", lambda table: table.assign(valid=0))
    assert_says(taut("calibrate", folder, "--out", tmp_path / "out", "--json"), "marker")


def test_a_marker_that_is_seen_too_rarely(taut: Taut, folder: Path, tmp_path: Path) -> None:
    rows(folder / "marker.csv", lambda table: table[40:43])
    assert "3 frames only" in taut.refuses("calibrate", folder, "--out", tmp_path / "out")


def test_false_sightings_are_left_out(taut: Taut, folder: Path, tmp_path: Path) -> None:
    rows(folder / "marker.csv", lambda table: table.assign(u_px=table.u_px.where(table.index % 20 != 10, 5.0)))
    done = taut("calibrate", folder, "--out", tmp_path / "out", "--json")
    assert done.code == 0 and "frames show the marker elsewhere" in done.err
    result = json.loads(done.out)
    widths = [onset for onset in result["onsets"] if onset["used"]]
    true = PLANT.backlash(np.array([(onset["q1"] + onset["q2"]) / 2 for onset in widths]))
    assert widths and np.abs(np.array([onset["width"] for onset in widths]) - true).max() < 0.05


def test_a_motor_in_another_unit_is_said(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    rows(folder / "motor.csv", lambda table: table.assign(q_mm=1e3 * table.q_mm))
    done = taut("predict", model, folder, "--csv", tmp_path / "o.csv")
    assert done.code == 0 and "is its unit mm?" in done.err
    rows(folder / "motor.csv", lambda table: table.assign(q_mm=1e6 * table.q_mm))
    assert "the rig's range is [-5, 5]" in taut.refuses("predict", model, folder, "--csv", tmp_path / "o.csv")


def test_a_motion_without_reversals(taut: Taut, tmp_path: Path) -> None:
    assert_says(calibrated(taut, moved([-4.0, 4.0], 1.0), tmp_path), "revers")


def test_a_motor_that_never_moves(taut: Taut, tmp_path: Path) -> None:
    recording = moved([0.0, 0.004], 0.001)
    assert_says(calibrated(taut, recording, tmp_path), "move", "revers", "motion")


def test_strokes_shorter_than_the_backlash(taut: Taut, tmp_path: Path) -> None:
    recording = moved([0.0, *[0.2, -0.2] * 10], 0.5)
    assert_says(calibrated(taut, recording, tmp_path), "backlash", "stroke", "onset", "move")


def test_an_output_folder_of_something_else_is_left_alone(taut: Taut, folder: Path, tmp_path: Path) -> None:
    thesis = tmp_path / "thesis"
    thesis.mkdir()
    (thesis / "chapter1.tex").write_text("words")
    assert "holds other files" in taut.refuses("calibrate", folder, "--out", thesis)
    assert "is a file" in taut.refuses("calibrate", folder, "--out", thesis / "chapter1.tex")
    assert (thesis / "chapter1.tex").read_text() == "words"


@pytest.mark.parametrize("content", [b"", b"{}", b'{"format": "model/1"}', b"\xff\0", b"[1, 2", b"[" * 100000])
def test_a_damaged_model(taut: Taut, folder: Path, model: Path, tmp_path: Path, content: bytes) -> None:
    (model / "model.json").write_bytes(content)
    assert "model" in taut.refuses("predict", model, folder, "--csv", tmp_path / "o.csv")
    assert "model" in taut.refuses("report", model)
    assert "model" in taut.refuses("compare", model, folder)


@pytest.mark.parametrize("onsets", [[{}], [None], 5, [{"used": True, "t_s": "soon"}]])
def test_a_model_whose_onsets_are_damaged(taut: Taut, model: Path, onsets: object) -> None:
    document = json.loads((model / "model.json").read_text())
    document["extra"]["onsets"] = onsets
    (model / "model.json").write_text(json.dumps(document))
    assert "onsets are damaged" in taut.refuses("report", model)


def test_a_model_without_its_rig(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    (model / "rig.toml").unlink()
    assert "rig" in taut.refuses("predict", model, folder, "--csv", tmp_path / "o.csv")


def test_times_that_are_none(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    for text, says in (("", "empty"), ("t_s\n", "no rows"), ("t_s\nsoon\n", "line 2"), ("t\n1\n", "t_s is missing")):
        (tmp_path / "times.csv").write_text(text)
        line = taut.refuses("predict", model, folder, "--csv", tmp_path / "o.csv", "--times", tmp_path / "times.csv")
        assert says in line


def test_a_place_that_cannot_be_written(taut: Taut, folder: Path, model: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert "cannot be written" in taut.refuses("predict", model, folder, "--csv", tmp_path / "file" / "o.csv")
    assert "cannot be written" in taut.refuses("calibrate", folder, "--out", tmp_path / "file" / "model")


def test_a_video_that_is_none(taut: Taut, folder: Path, tmp_path: Path) -> None:
    (folder / "marker.csv").unlink()
    (folder / "video.mkv").write_bytes(b"not a video")
    line = taut.refuses("calibrate", folder, "--out", tmp_path / "out")
    assert "video.mkv" in line


def still(path: Path) -> None:
    rows(path / "motor.csv", lambda t: t.assign(q_mm=1.0))


def another_rig(path: Path) -> None:
    other = (path / "rig.toml").read_text().replace("delay_s = 0.08", "delay_s = 0.05")
    assert other != (path / "rig.toml").read_text()
    (path / "rig.toml").write_text(other)


DIAGNOSE: dict[str, tuple[str, Callable[[Path], object], str]] = {
    "no marker column": (
        "test",
        lambda path: rows(path / "marker.csv", lambda t: t.drop(columns="v_px")),
        "v_px is missing",
    ),
    "nothing seen": ("test", lambda path: (path / "marker.csv").unlink(), "one of them is needed"),
    "too short": (
        "test",
        lambda path: [rows(path / name, lambda t: t[t.t_s < 0.3]) for name in ("motor.csv", "marker.csv")],
        "full backlash both ways",
    ),
    "a test that rests": ("test", still, "full backlash both ways"),
    "a calibration that rests": ("calibration", still, "the motor does not move"),
    "the other unit": (
        "test",
        lambda path: rows(path / "motor.csv", lambda t: t.rename(columns={"q_mm": "q_deg"})),
        "expected q_mm",
    ),
    "another rig": ("test", another_rig, "say which with --rig"),
}


@pytest.mark.parametrize(("which", "change", "says"), DIAGNOSE.values(), ids=DIAGNOSE)
def test_diagnose_refuses_in_one_line_and_writes_nothing(taut, tmp_path, which, change, says):
    for name in ("calibration", "test"):
        save(moved([-2.0, 1.0, -1.0, 2.0, -2.0], 2.0), tmp_path / name)
    change(tmp_path / which)
    done: Finished = taut("diagnose", tmp_path / "calibration", tmp_path / "test", "--out", tmp_path / "out")
    assert done.code == 1 and done.out == ""
    last = done.err.strip().splitlines()[-1]
    assert says in last, done.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration", "test"]


def test_diagnose_looks_at_its_folder_before_it_begins(taut, tmp_path):
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "mine.txt").write_text("kept")
    done = taut("diagnose", tmp_path / "none", tmp_path / "none", "--out", tmp_path / "notes")
    assert done.code == 1 and "no diagnosis.json" in done.err


def test_a_desktop_board_that_is_named_but_not_there_is_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(simlink.PROGRAM, str(tmp_path / "board"))
    with pytest.raises(TautError, match=r"board, which is not there: build it, or unset TAUTLINE_DESKTOP_BOARD"):
        simlink.program()
