"""An endoscope that sees the world from its own tip: the scene moves instead of a marker."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from cli_runner import Taut

from tautline.errors import TautError
from tautline.recording import load
from tautline.rig import ANGLE, Camera, Rig
from tautline.vision.camera import VideoFile
from tautline.vision.marker import with_marker
from tautline.vision.scene import SceneTracker
from tools.bench import inside

CAMERA = Camera(256, 208, 185.0, 185.0, 128.0, 104.0, (0.0,) * 5, 25.0, 0.08, "tip")


def calibrated(taut: Taut, folder: Path) -> tuple[int, dict[str, Any], dict[str, Any]]:
    done = taut("calibrate", folder, "--out", folder.parent / f"{folder.name}-model", "--json")
    return done.code, json.loads(done.out), json.loads((folder / "truth.json").read_text(encoding="utf-8"))


def test_onsets_width_and_delay_come_from_a_scene_that_breathes(tmp_path: Path, taut: Taut) -> None:
    inside.make(tmp_path / "vessel", inside.Inside("vessel", breath_mm=1.5), 4, (3.0, 11.0))
    code, document, truth = calibrated(taut, tmp_path / "vessel")
    true = lambda q: np.interp(q, truth["backlash"]["q"], truth["backlash"]["width"])  # noqa: E731
    used = [onset for onset in document["onsets"] if onset["used"]]
    assert len(used) >= 3
    off = [onset["width"] - true(0.5 * (onset["q1"] + onset["q2"])) for onset in used]
    assert np.abs(off).max() < 0.006  # a third of a pixel: what a breathing wall pulls
    q, width, sigma = (np.array(document["backlash"][key]) for key in ("q", "width", "sigma"))
    within = (q > document["backlash"]["measured"][0]) & (q < document["backlash"]["measured"][1])
    assert np.sqrt(np.mean(((width - true(q)) / sigma)[within] ** 2)) < 2.0
    assert abs(document["delay_s"] - truth["delay_s"]) < 0.006
    assert code == 0 and document["quality"]["verdict"] == "doubtful"
    assert "scene" in [reason["code"] for reason in document["quality"]["reasons"]]
    assert document["remaining"]["sigma_deg"] is None  # how far the wall is nothing tells

    out = tmp_path / "predicted.csv"
    taut("predict", tmp_path / "vessel-model", tmp_path / "vessel", "--csv", out)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    frames = list(csv.DictReader((tmp_path / "vessel" / "frames.csv").read_text().splitlines()))
    assert [row["t_s"] for row in rows] == [row["t_s"] for row in frames]
    assert all(row["u_px"] == "" and row["c_deg"] for row in rows)


def test_a_torn_tendon_shows_no_onset_though_most_of_the_scene_breathes(tmp_path: Path, taut: Taut) -> None:
    inside.make(tmp_path / "torn", inside.Inside("torn", breath_mm=1.5, share=0.8, still=True), 6, (3.0, 9.0))
    code, document, _ = calibrated(taut, tmp_path / "torn")
    assert not any(onset["used"] for onset in document["onsets"])
    assert code == 3 and document["quality"]["verdict"] == "unusable"


def looking(turn_deg: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A far world, seen in a direction (3,) deg: a sphere's texture by the rays' directions alone."""
    turn = cv2.Rodrigues(np.radians(turn_deg))[0]
    v, u = np.mgrid[0:208, 0:256].astype(float)
    rays = np.stack([(u - 128.0) / 185.0, (v - 104.0) / 185.0, np.ones_like(u)], axis=-1) @ turn
    around, up = (
        np.degrees(np.arctan2(rays[..., 0], rays[..., 2])),
        np.degrees(np.arctan2(rays[..., 1], np.hypot(rays[..., 0], rays[..., 2]))),
    )
    at = ((90.0 + around) * 4.0).astype(np.float32), ((60.0 + up) * 4.0).astype(np.float32)
    grey = cv2.remap(WALL, *at, cv2.INTER_CUBIC) + rng.normal(0.0, 2.0, u.shape)
    return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[..., None], 3, axis=2)


WALL = cv2.normalize(
    cv2.GaussianBlur(np.random.default_rng(3).standard_normal((480, 720)).astype(np.float32), (0, 0), 2.5),
    None, 40.0, 210.0, cv2.NORM_MINMAX,
)  # fmt: skip


def test_a_far_world_turns_as_the_camera_does() -> None:
    """There and back, by more than the picture is wide: by keyframes, so that nothing adds up."""
    rng, tracker = np.random.default_rng(1), SceneTracker(CAMERA)
    way = np.array([0.4, 0.9, 0.15])
    turns = np.concatenate([np.linspace(0.0, 60.0, 40), np.linspace(60.0, 0.0, 40)])[:, None] * way
    for turn in turns:
        assert tracker.track(looking(turn, rng)) is not None
    tracker.settle()
    for k in (0, 20, 39, 60, 79):
        found = tracker.track(looking(turns[k], rng))
        assert found is not None
        off = cv2.Rodrigues(cv2.Rodrigues(found)[0] @ cv2.Rodrigues(np.radians(turns[k]))[0].T)[0]
        assert np.degrees(np.linalg.norm(off)) < 0.1  # of 60: a third of a pixel
    assert tracker.track(np.full((208, 256, 3), 90, np.uint8)) is None


@pytest.mark.parametrize("noise", [0.0, 2.0])
def test_a_video_may_begin_in_the_dark(noise: float) -> None:
    rng, tracker = np.random.default_rng(1), SceneTracker(CAMERA)
    dark = [np.clip(rng.normal(0.0, noise, (208, 256, 3)), 0.0, 255.0).astype(np.uint8) for _ in range(2)]
    seen = [*dark, *(looking(np.array([0.0, turn, 0.0]), rng) for turn in np.linspace(0.0, 10.0, 8))]
    for picture in seen:
        tracker.track(picture)
    tracker.settle()
    found = [tracker.track(picture) for picture in seen]
    assert found[0] is None and found[1] is None
    turns = np.array([turn for turn in found if turn is not None])
    assert np.degrees(np.linalg.norm(turns[-1] - turns[0])) == pytest.approx(10.0, abs=0.1) and len(turns) == 8


def test_a_rig_says_where_its_camera_sits(tmp_path: Path) -> None:
    inside.make(tmp_path / "short", inside.Inside("short"), 1, (3.0, 4.0))
    path = tmp_path / "short" / "rig.toml"
    rig = Rig.load(path)
    assert rig.sees_from_tip and not rig.has_camera and rig.nominal_delay_s(ANGLE) == rig.delay_s == 0.08
    rig.save(tmp_path / "again.toml")
    assert Rig.load(tmp_path / "again.toml") == rig
    path.write_text(path.read_text().replace('mount = "tip"', 'mount = "top"'), encoding="utf-8")
    with pytest.raises(TautError, match=r'camera\.mount is .top., expected "base" or "tip"'):
        Rig.load(path)
    path.write_text(path.read_text().replace('mount = "top"', 'mount = "base"'), encoding="utf-8")
    with pytest.raises(TautError, match=r"no \[kinematics\] section"):
        Rig.load(path)
    other = replace(rig, camera=replace(rig.camera, width_px=512))
    with pytest.raises(TautError, match="frames are 256 x 208 px, the rig's 512 x 208"):
        with_marker(load(tmp_path / "short", rig), other)
    with VideoFile(tmp_path / "short" / "video.mkv", 25.0) as video:
        for _ in range(25):
            video.write(np.full((208, 256, 3), 90, np.uint8))
    with pytest.raises(TautError, match="the world is not found again"):
        with_marker(load(tmp_path / "short", rig), rig)
