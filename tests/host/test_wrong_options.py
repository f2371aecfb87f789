"""Options that cannot be meant: each is refused in words, before any work and with nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import Taut
from reference_instrument import saved_model, saved_recording


@pytest.fixture
def taut(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Taut:
    monkeypatch.delenv("TAUTLINE_BOARD", raising=False)
    monkeypatch.setattr("tautline.device.board.find_usb", list)  # whatever is plugged in here
    monkeypatch.chdir(tmp_path)
    return Taut(monkeypatch, capsys)


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
