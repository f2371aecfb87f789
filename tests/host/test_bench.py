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

from tautline.vision.colour import pick
from tautline.vision.marker import MarkerTracker
from tools.bench import __main__ as bench
from tools.bench import calibration, control_step, diagnosis, endoscopy, faults, live_page, trackers, tracking, videos


def test_the_command_prints_its_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    score = trackers.Score("ours", 20.0, 0.01, 0.01, 1.0)
    monkeypatch.setattr(trackers, "run", lambda frames, progress: ([score], ["one is missing"]))
    monkeypatch.setattr(control_step, "run", lambda: [("control step, fixed point", 60.0, "ns")])
    monkeypatch.setattr(calibration, "run", lambda: [("calibration of it", 6.0, "s")])
    monkeypatch.setattr(diagnosis, "run", lambda: [("blind case, nothing wrong", 2.0, "core s")])
    monkeypatch.setattr(live_page, "_SECONDS", 0.5)
    monkeypatch.setattr(tracking, "REPLAYS", 1)
    monkeypatch.setattr(tracking, "SECONDS", 5.0)
    said = json.loads(CliRunner().invoke(bench.main, ["--json"]).stdout)
    in_use = [(row["name"], row["value"], row["unit"]) for row in said["tracking"]]
    monkeypatch.setattr(tracking, "run", lambda: in_use)
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


@pytest.mark.long
def test_a_law_of_friction_that_a_fit_makes_felt_throughout_is_none(tmp_path: Path) -> None:
    """In this video no frame tells of it any more, once B is fitted beside it."""
    condition = next(each for each in endoscopy.CONDITIONS if each.name == "H.264, crf 32")
    endoscopy.make(tmp_path / "recording", condition, 0, None, lambda share: None)
    status, document = videos.said("calibrate", str(tmp_path / "recording"), "--out", str(tmp_path / "model"))
    assert status == 0
    assert document["quality"]["verdict"] != "unusable"


def _used(fault: endoscopy.Fault, rests: bool = False) -> endoscopy.World:
    condition = endoscopy.Condition("plain")
    before = endoscopy.World(condition, 3, np.zeros((8, 8, 3), np.uint8))
    return endoscopy.World(condition, 3, use=endoscopy.Use(before, 7, 70.0, 45.0, 1.6, rests, fault))


def test_a_fault_does_to_the_instrument_what_its_name_says() -> None:
    since = 90.0
    sound = _used(endoscopy.Fault())
    t, c, later = sound.t, sound.c, sound.t > since + 3.0
    early = t < since
    of = {
        "lag": endoscopy.Fault(since, lag_s=0.12),
        "creep": endoscopy.Fault(since, late_share=0.05),
        "speed": endoscopy.Fault(since, wider=0.3),
        "drift": endoscopy.Fault(since, drift_mm_s=0.002),
        "wall": endoscopy.Fault(since, wall_deg=25.0),
    }
    bent = {name: _used(fault).c for name, fault in of.items()}
    for name, there in bent.items():
        assert np.array_equal(there[early], c[early]), name
        assert np.max(np.abs(there - c)[later]) > 0.2, name
    delayed = np.interp(t - 0.12, t, c)
    assert np.std((bent["lag"] - delayed)[later]) < 0.2 * np.std((bent["lag"] - c)[later])
    kept = np.polyfit(c[later], bent["creep"][later], 1)[0]
    assert 0.93 < kept < 0.99  # most of the share is still to come
    gone = (bent["drift"] - c)[later]
    assert np.polyfit(t[later], gone, 1)[0] == pytest.approx(0.002 * endoscopy.GAIN, rel=0.3)
    assert bent["wall"].max() == pytest.approx(25.0 + endoscopy.GIVES * (c[t >= since].max() - 25.0))
    rising, falling = (later & (way * np.gradient(sound.q, t) > 1.2) for way in (1.0, -1.0))
    wider = np.mean((c - bent["speed"])[rising]) + np.mean((bent["speed"] - c)[falling])
    assert wider == pytest.approx(0.3 * sound.level * endoscopy.GAIN, rel=0.35)

    place, radius = sound.seen(np.array([since - 1.0, since + 1.0]))
    moved, _ = _used(endoscopy.Fault(since, aside_mm=(0.2, 0.0, 0.0))).seen(np.array([since - 1.0, since + 1.0]))
    px_per_mm = radius[1] / endoscopy.MARKER_MM
    assert np.array_equal(moved[0], place[0]) and moved[1] - place[1] == pytest.approx([0.2 * px_per_mm, 0.0])


def test_a_user_that_rests_goes_no_faster_and_stops() -> None:
    world = _used(endoscopy.Fault(), rests=True)
    speed = np.abs(np.gradient(world.q, world.t))
    assert 1.4 < speed.max() < 1.65 and np.abs(world.q).max() < 4.0
    assert 0.1 < np.mean(speed == 0.0) < 0.6 and np.sum(np.diff(np.sign(np.diff(world.q))) != 0) > 15


def test_a_diagnosis_of_videos_is_right_where_the_fault_leads() -> None:
    gap = {"before": 2.0, "after": 0.3}
    one = {"id": "transmission.creep", "probability": 0.9, "ambiguous_with": ["transmission.lag"]}
    other = {"id": "transmission.drift", "probability": 0.6, "ambiguous_with": []}

    def right(fault: str, *effects: dict[str, object]) -> bool:
        document = {
            "effects": list(effects),
            "verdict": "effect" if effects else "none",
            "gap": gap,
            "noise_floor": 0.2,
        }
        return faults.Outcome.of("glare", fault, 1, document).right

    assert right("creep", one, other) and not right("creep", other, one) and not right("creep")
    assert right("nothing") and not right("nothing", one)
