"""Options that cannot be meant: each is refused in words, before any work and with nothing written."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from cli_runner import Taut
from reference_instrument import saved_model, saved_recording

from tautline import effects
from tautline.cli import clear, follow, stream
from tautline.errors import TautError
from tautline.live.following import Followed
from tautline.model import Model


@pytest.fixture
def taut(taut: Taut, no_board: None, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Taut:
    monkeypatch.chdir(tmp_path)
    return taut


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return saved_model(tmp_path / "model")


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return saved_recording(tmp_path / "run")


def misunderstood(taut: Taut, *words: str | Path | float) -> str:
    """What is said of a command line that cannot be understood."""
    done = taut(*words)
    assert done.code == 2 and done.out == "", done
    return done.err.splitlines()[-1]


@pytest.mark.parametrize("number", ["nan", "inf"])
@pytest.mark.parametrize(
    "words",
    [
        ("simulate", "--out", "s", "--speed"),
        ("simulate", "--out", "s", "--noise"),
        ("simulate", "--out", "s", "--motion", "sines", "--duration"),
        ("simulate", "--out", "s", "--sway", "1"),
        ("record", "--simulate", "--out", "s", "--at"),
        ("record", "--simulate", "--out", "s", "--duration"),
        ("home", "--simulate", "--speed"),
        ("shapes", "add", "library", "a", "model", "--current"),
        ("flash", "model", "--adapt", "0", "0"),
    ],
)
def test_no_option_takes_a_number_that_is_not_finite(
    taut: Taut, model: Path, tmp_path: Path, words: tuple[str, ...], number: str
) -> None:
    assert f"'{number}' is no finite number" in misunderstood(taut, *words, number)
    assert not (tmp_path / "s").exists() and not (tmp_path / "library").exists()


@pytest.mark.parametrize(
    "words", [("demo",), ("calibrate", "--simulate"), ("record", "--simulate"), ("diagnose", "--live", "--simulate")]
)
def test_no_generator_begins_below_zero(taut: Taut, tmp_path: Path, words: tuple[str, ...]) -> None:
    assert "-1 is not in the range" in misunderstood(taut, *words, "--out", "s", "--seed", -1)


def test_a_sine_takes_some_time(taut: Taut, model: Path) -> None:
    assert "0.0 is not in the range" in misunderstood(taut, "stream", model, "--sine", 10, 0)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (("calibrate", "run", "--out", "m", "--simulate", "constant"), "--simulate"),
        (("calibrate", "run", "--out", "m", "--until", "5um"), "--until"),
        (("calibrate", "run", "--out", "m", "--recording", "r"), "--recording"),
        (("diagnose", "run", "run", "--out", "m", "--camera", "0"), "--camera"),
        (("diagnose", "run", "run", "--out", "m", "--most", "2"), "--most"),
        (("diagnose", "run", "run", "--out", "m", "--workers", "2"), "--workers"),
        (("diagnose", "run", "--out", "m", "--simulator", "robot.xml", "--board", "usb"), "--board"),
        (("diagnose", "run", "--out", "m", "--simulator", "robot.xml", "--most", "2"), "--most"),
        (("live", "run", "--watch", "model"), "--watch"),
        (("shapes", "recall", "library", "run", "--simulate"), "--simulate"),
        (("export", "run", "--to", "csv", "--out", "m", "--scale", "2"), "--scale"),
    ],
)
def test_what_would_be_ignored_is_refused(
    taut: Taut, model: Path, recording: Path, tmp_path: Path, words: tuple[str, ...], option: str
) -> None:
    assert taut("shapes", "add", "library", "a", model).code == 0
    assert option in misunderstood(taut, *words)
    assert not (tmp_path / "m").exists()


def test_a_board_named_in_the_environment_is_no_live_option(
    taut: Taut, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TAUTLINE_BOARD", "usbip:localhost:1")
    assert taut("calibrate", recording, "--out", "m").code in (0, 3)


@pytest.mark.parametrize("squares", ["0x6", "-8x6"])
def test_a_board_has_squares(taut: Taut, squares: str) -> None:
    words = ("rig", "--board", "b.png", "--squares", squares, "--square-mm", 3, "--marker-mm", 2)
    assert "are no squares" in misunderstood(taut, *words)


def test_a_resolution_is_finite(taut: Taut, model: Path) -> None:
    assert "--joint" in misunderstood(taut, "flash", model, "--joint", "translation_mm=1:nan")


def test_the_picture_of_a_commissioning_can_be_written_before_a_motor_moves(
    taut: Taut, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def moved(*_: object, **__: object) -> None:
        raise AssertionError("the motor was moved")

    monkeypatch.setattr("tautline.cli.commission.opened_setup", moved)
    assert "a picture ends in" in taut.refuses("commission", "--simulate", "--yes", "--out", "steps.foo")
    (tmp_path / "file").write_text("")
    assert "cannot be written" in taut.refuses("commission", "--simulate", "--yes", "--out", "file/steps.png")


def test_a_comparison_does_not_take_the_place_of_a_model(taut: Taut, model: Path, tmp_path: Path) -> None:
    other, before = saved_model(tmp_path / "other"), (model / "model.json").read_bytes()
    assert "would be overwritten" in taut.refuses("compare", model, other, "--html", model / "model.json")
    assert (model / "model.json").read_bytes() == before


@pytest.mark.filterwarnings("error")
def test_models_that_have_no_measured_position_in_common(taut: Taut, model: Path, tmp_path: Path) -> None:
    low = Model.load(model)
    replace(low, measured=(-4.0, -3.0)).save(tmp_path / "low")
    replace(low, measured=(3.0, 4.0)).save(tmp_path / "high")
    done = taut("compare", "low", "high", "--html", "page.html")
    assert done.code == 0 and "nan" not in done.out and done.err == ""


def test_the_messages_that_name_a_list_find_it(taut: Taut) -> None:
    """A wrong key's error says that 'taut explain rig' lists them."""
    line = taut.refuses("rig", "--set", "foo=1", "--out", "r.toml")
    assert "'taut explain rig'" in line
    listed = json.loads(taut("explain", "rig", "--json").out)["topics"]
    assert "rig.actuator.range" in listed and all(code.startswith("rig.") for code in listed)
    assert "transmission.creep" not in taut("explain", "fault").out


def test_a_fault_is_explained_without_a_number_that_nobody_measured(taut: Taut) -> None:
    assert "at duty 1/32768" not in taut("explain", "STALL").out
    assert "The number in its message: mA." in taut("explain", "CURRENT").out


def test_the_last_set_point_needs_no_line_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "points.txt"
    path.write_text("0.5\n1.5")
    with path.open() as file:
        monkeypatch.setattr("sys.stdin", file)
        lines = stream._Lines()
        assert lines.newest() == "1.5" and lines.ended


def test_one_fault_is_not_the_last_1_faults() -> None:
    row: dict[str, Any] = {"starts_ago": 0, "since_start_s": 1.0, "axis": 0, "fault": "blocked"}
    assert clear.log_text([row])[1] == "the last fault:"
    assert clear.log_text([row, row])[1] == "the last 2 faults, newest first:"


def followed(t_s: np.ndarray, counted: bool) -> Followed:
    some = np.full(len(t_s), counted)
    return Followed(t_s, 0.0 * t_s, 0.0 * t_s, some, "the camera", {"telemetry_dropped": 0})


@pytest.mark.parametrize("samples", [0, 5])
def test_a_run_in_which_nothing_is_scored(samples: int) -> None:
    result = followed(np.arange(float(samples)), False)
    text = follow._text(result, "full", None, None)
    assert "nan" not in text and "nothing is scored" in text
    assert follow._report(result, "full", None)["seconds"] == max(samples - 1.0, 0.0)


def test_it_is_said_what_a_tracker_does_not_know_also_where_it_is_not_asked_for(
    taut: Taut, model: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """--track is on by itself where MODEL and --camera are named."""
    creep = effects.BY_ID["transmission.creep"]
    told = Model.load(model)
    monkeypatch.setattr(Model, "load", lambda path: SimpleNamespace(**vars(told) | {"effects": (creep,)}))
    setup = SimpleNamespace()
    asked = []

    def run(setup: object, trajectory: str, track: bool, **_: object) -> Followed:
        asked.append(track)
        raise TautError("enough")

    class Opened:
        def __enter__(self) -> object:
            return setup

        def __exit__(self, *_: object) -> None:
            pass

    monkeypatch.setattr("tautline.live.following.follow_run", run)
    monkeypatch.setattr("tautline.cli.follow.opened_setup", lambda *_, **__: Opened())
    monkeypatch.setattr("tautline.cli.follow.refuse_unusable", lambda *_: None)
    assert "transmission.creep" in taut("follow", model, "--camera", "0").err
    assert "transmission.creep" not in taut("follow", model, "--camera", "0", "--no-track").err
    assert asked == [True, False]
