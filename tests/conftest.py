"""Hypothesis on busy machines: how long one example takes says nothing about the code. A test draws the same examples
each time, until it is changed; --hypothesis-profile fresh draws new ones (`./run test long` does).

Fixtures that several files of tests ask for by name.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

if TYPE_CHECKING:
    from cli_runner import Taut

settings.register_profile("fresh", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("tautline", settings.get_profile("fresh"), derandomize=True)
settings.load_profile("tautline")


@pytest.fixture
def taut(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Taut:
    """The command line, called in this process."""
    from cli_runner import Taut

    return Taut(monkeypatch, capsys)


@pytest.fixture
def no_board(monkeypatch: pytest.MonkeyPatch) -> None:
    """No board is named, nor looked for among what is plugged in here."""
    monkeypatch.delenv("TAUTLINE_BOARD", raising=False)
    monkeypatch.setattr("tautline.device.board.find_usb", list)


@pytest.fixture
def patient_buses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Answers are waited for by the wall clock, what they are for passes in virtual time: a busy machine loses none."""
    from tautline.drivers import cia402, moteus_drives, ros_joints, serial_servos

    for waits, name, long in (
        (cia402, "_ANSWER_S", 0.2),
        (cia402, "_STATE_S", 10.0),
        (moteus_drives, "_ANSWER_S", 0.2),
        (serial_servos, "_ANSWER_MS", 200.0),
        (ros_joints, "_ANSWER_S", 0.1),
    ):
        monkeypatch.setattr(waits, name, long)


@pytest.fixture
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where what is kept of drives is, of this test alone."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"
