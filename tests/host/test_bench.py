"""The benchmark compares what it says it does, and the tracker keeps its place in it."""

from __future__ import annotations

import ast
import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

sys.path.insert(0, str(Path(__file__).parents[2]))

from tools.bench import __main__ as bench
from tools.bench import calibration, control_step, diagnosis, endoscopy, trackers, videos

from tautline.vision.colour import pick
from tautline.vision.marker import MarkerTracker


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
    assert ours.noise_px < 0.03 and ours.error_px < 0.03 and ours.detected == 1.0
    assert {score.name.split()[1].rstrip(",") for score in others} == {"SimpleBlobDetector", "ArUco"}
    for score in others:
        assert score.frames_per_s < ours.frames_per_s and score.error_px > ours.error_px


def test_the_videos_share_no_line_with_the_package_and_show_what_they_say() -> None:
    source = Path(endoscopy.__file__).read_text(encoding="utf-8")
    names = [node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.Import | ast.ImportFrom)]
    modules = {alias.name for node in names for alias in node.names} | {getattr(node, "module", "") for node in names}
    assert not any(str(module).startswith(("tautline", "tools")) for module in modules)
    condition = endoscopy.Condition("plain")
    world = endoscopy.World(condition, 3)
    scene, picture = next(world.frames())
    place, radius = world.seen(np.array([scene]))
    seen = MarkerTracker(pick(picture, (float(place[0, 0]), float(place[0, 1])))).track(picture)
    assert np.hypot(seen.u_px - place[0, 0], seen.v_px - place[0, 1]) < 0.6
    assert seen.diameter_px == pytest.approx(2.0 * radius[0], rel=0.1)


def test_z_of_a_video_is_taken_where_b_was_measured() -> None:
    truth = {"backlash": {"q": [0.0, 3.0], "width": [0.4, 0.4]}}
    said = {
        "backlash": {
            "q": [0.0, 1.0, 2.0, 3.0],
            "width": [9.0, 0.403, 0.397, 9.0],
            "sigma": [1.0, 0.001, 0.003, 1.0],
            "measured": [1.0, 2.0],
        },
        "quality": {"verdict": "doubtful", "reasons": [{"code": "residual"}]},
    }
    found = videos.Outcome.of("glare", 1, 0, said, truth)
    assert found.z == pytest.approx(np.sqrt((9.0 + 1.0) / 2.0)) and found.error_um == pytest.approx(3.0)
    assert found.reasons == ("residual",)
