"""Fixtures that several files of tests ask for by name."""

from __future__ import annotations

from pathlib import Path

import pytest

from tautline.drivers import cia402, moteus_drives, ros_joints, serial_servos


@pytest.fixture
def patient_buses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Answers are waited for by the wall clock, what they are for passes in virtual time: a busy machine loses none."""
    for waits, name, long in (
        (cia402, "_ANSWER_S", 0.2),
        (moteus_drives, "_ANSWER_S", 0.2),
        (serial_servos, "_ANSWER_MS", 200.0),
        (ros_joints, "_ANSWER_S", 0.1),
    ):
        monkeypatch.setattr(waits, name, long)


@pytest.fixture
def own_state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    return tmp_path / "state"
