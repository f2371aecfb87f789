"""The benchmark compares what it says it does, and the tracker keeps its place in it."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[2]))

from tools.bench import __main__ as bench
from tools.bench import calibration, control_step, diagnosis, trackers


def test_the_command_prints_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    score = trackers.Score("ours", 20.0, 0.01, 0.01, 1.0)
    monkeypatch.setattr(trackers, "run", lambda frames, progress: ([score], ["one is missing"]))
    monkeypatch.setattr(control_step, "run", lambda: [("control step, fixed point", 60.0, "ns")])
    monkeypatch.setattr(calibration, "run", lambda: [("calibration of it", 6.0, "s")])
    monkeypatch.setattr(diagnosis, "run", lambda: [("blind case, nothing wrong", 2.0, "core s")])
    said = json.loads(CliRunner().invoke(bench.main, ["--json"]).stdout)
    assert said["trackers"][0]["frames_per_s"] == 50_000 and said["notes"] == ["one is missing"]
    text = CliRunner().invoke(bench.main, []).stdout
    for part in (
        "ours",
        "50,000",
        "control step, fixed point",
        "calibration of it",
        "nothing wrong",
        "note: one is missing",
    ):
        assert part in text


def test_the_tracker_is_the_quickest_and_most_exact_of_those_in_opencv() -> None:
    scores, _ = trackers.run(frames=8)
    ours, others = scores[0], [score for score in scores if score.name.startswith("OpenCV")]
    assert ours.noise_px < 0.03 and ours.error_px < 0.03 and ours.found == 1.0
    assert {score.name.split()[1].rstrip(",") for score in others} == {"SimpleBlobDetector", "ArUco"}
    for score in others:
        assert score.frames_per_s < ours.frames_per_s and score.error_px > ours.error_px
