"""What many tests of the host share: the command in this process, a recording and a model."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runner import Taut
from reference_instrument import saved_model, saved_recording


@pytest.fixture
def taut(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Taut:
    return Taut(monkeypatch, capsys)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return saved_recording(tmp_path / "run")


@pytest.fixture
def model(tmp_path: Path) -> Path:
    return saved_model(tmp_path / "model")
