"""Hypothesis on busy machines: how long one example takes says nothing about the code. A test draws the same examples
each time, until it is changed; --hypothesis-profile fresh draws new ones (`./run test long` does).

Fixtures that several files of tests ask for by name.
"""

from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile("fresh", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("tautline", settings.get_profile("fresh"), derandomize=True)
settings.load_profile("tautline")


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
