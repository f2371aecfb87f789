"""A bare instrument followed by its surface: right over what moves behind it, lost where it is hidden, none where
there is nothing."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from cli_runner import Taut

from tautline.errors import TautError
from tautline.recording import Video
from tautline.vision.camera import VideoFile
from tautline.vision.marker import track_video
from tautline.vision.patch import PatchTracker, Pose
from tautline.vision.region import REGION_FILE, Region

HEIGHT, WIDTH, SIDE = 260, 340, 40.0
RADIUS = 24.0  # of the disc that moves, px: wider than the region's half
NOISE = 2.5  # levels rms


def texture(seed: int, contrast: float) -> np.ndarray:
    """Structure of every size, as surfaces have it."""
    rng, total = np.random.default_rng(seed), np.zeros((500, 500), dtype=np.float32)
    for size in (1.5, 3.0, 6.0, 12.0):
        smooth = cv2.GaussianBlur(rng.standard_normal((500, 500)).astype(np.float32), (0, 0), size)
        total += smooth / smooth.std()
    return np.asarray(120.0 + contrast * total / total.std())


SURFACE, TISSUE = texture(1, 28.0), texture(2, 22.0)


def picture(u: float, v: float, turn_deg: float, breath: float, rng: np.random.Generator) -> np.ndarray:
    """A textured disc whose middle is at (u, v), over tissue that has gone aside by `breath` px."""
    behind = cv2.warpAffine(
        TISSUE, np.array([[1.0, 0.0, breath - 60.0], [0.0, 1.0, 0.4 * breath - 60.0]]), (WIDTH, HEIGHT)
    )
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    motion = np.array([[cos, -sin, u - 250.0 * cos + 250.0 * sin], [sin, cos, v - 250.0 * sin - 250.0 * cos]])
    front = cv2.warpAffine(SURFACE, motion, (WIDTH, HEIGHT), flags=cv2.INTER_CUBIC)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    share = np.clip(RADIUS + 0.5 - np.hypot(x - u, y - v), 0.0, 1.0)
    grey = behind + share * (front - behind) + rng.normal(0.0, NOISE, behind.shape)
    return np.repeat(np.clip(np.rint(grey), 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)


def course(frames: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places (n, 2) px, turns deg and breath px: to and fro three times, with rests at both ends."""
    phase = np.clip(1.35 * np.abs((3.0 * np.arange(frames) / frames) % 2.0 - 1.0) - 0.175, 0.0, 1.0)
    u, v = 110.0 + 110.0 * phase, 100.0 + 60.0 * phase**2
    return np.column_stack([u, v]), 40.0 * phase, 5.0 * np.sin(np.arange(frames) / 7.0)


def followed(settled: bool) -> tuple[np.ndarray, np.ndarray]:
    """Errors (n, 2) px and sigmas (n,) px."""
    places, turns, breath = course(240)
    tracker = None
    for time in range(2 if settled else 1):
        rng, seen = np.random.default_rng(5), []
        for (u, v), turn, aside in zip(places, turns, breath, strict=True):
            shown = picture(u, v, turn, aside, rng)
            tracker = tracker or PatchTracker(shown, (u, v), 1.4 * SIDE)  # its corners show what is behind
            seen.append(tracker.track(shown))
        assert tracker is not None
        if settled and time == 0:
            tracker.settle()
    return np.array([(s.u_px, s.v_px) for s in seen]) - places, np.array([s.sigma_px for s in seen])


def test_it_follows_the_instrument_and_not_the_tissue_behind() -> None:
    error, sigma = followed(settled=True)
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(error**2)) < 0.2  # tissue goes to and fro by 5 px behind nearly half of the square
    assert np.sqrt(np.mean((error / sigma[:, None]) ** 2)) < 3.0  # 14 by the corners of each picture alone
    assert np.median(sigma) < 0.1  # which are not all there is, nor half of what it may be off by
    # where the way begins, again after it: nothing adds up
    at_start = np.hypot(*(course(240)[0] - course(240)[0][0]).T) < 1.0
    assert np.abs(np.mean(error[at_start], axis=0)).max() < 0.05


def test_smoke_that_drifts_before_it_moves_nothing() -> None:
    """At its thickest two thirds of the light: what is left is darker or brighter, and flatter."""
    places, turns, _ = course(240)
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    tracker, error = None, []
    rng = np.random.default_rng(5)
    for k, ((u, v), turn) in enumerate(zip(places, turns, strict=True)):
        shown = picture(u, v, turn, 0.0, rng).astype(float)
        thick = 0.33 * (1.0 + np.sin((x + 4.0 * k) / 40.0 + np.sin((y - 3.0 * k) / 30.0)))[:, :, None]
        smoky = np.clip(np.rint(shown * (1.0 - thick) + 205.0 * thick), 0, 255).astype(np.uint8)
        tracker = tracker or PatchTracker(smoky, (u, v), SIDE)
        seen = tracker.track(smoky)
        error.append((seen.u_px - u, seen.v_px - v))
    assert np.isfinite(error).all()
    assert np.sqrt(np.mean(np.square(error))) < 0.2  # as over tissue that moves


def test_what_stays_behind_is_known_after_a_motion() -> None:
    """Beside a keyframe's place the tissue has hardly moved against the instrument: it holds the region back there."""
    places, _, _ = course(240)
    away = np.hypot(*np.diff(places, axis=0).T) > 0.3

    def slope(error: np.ndarray) -> float:
        """Of the steps from frame to frame, how much too small they are where it moves."""
        steps, short = np.diff(places, axis=0)[away], np.diff(error, axis=0)[away]
        return float(np.std(np.sum(short * steps, axis=1) / np.sum(steps * steps, axis=1)))

    first, second = (slope(followed(settled)[0]) for settled in (False, True))
    assert second < 0.8 * first


def test_keyframes_are_moved_to_where_the_others_have_them() -> None:
    places, turns, breath = course(240)
    rng = np.random.default_rng(5)
    shown = [picture(u, v, turn, aside, rng) for (u, v), turn, aside in zip(places, turns, breath, strict=True)]
    tracker = PatchTracker(shown[0], (places[0][0], places[0][1]), SIDE)
    for one in shown[:80]:
        tracker.track(one)
    middle = len(tracker._keyframes.keys) // 2
    off = tracker._keyframes.keys[middle]
    off.pose = replace(off.pose, u=off.pose.u + 2.0)
    for one in shown[80:]:
        tracker.track(one)
    tracker.settle()
    error = [tracker.track(one).u_px for one in shown] - places[:, 0]
    assert np.abs(error).max() < 0.7  # 2 px, where that one says as much as its neighbours


def test_hidden_it_is_lost_and_then_found_again() -> None:
    places, turns, breath = course(240)
    rng, tracker, seen = np.random.default_rng(6), None, []
    for k in range(120):
        shown = picture(*places[k], turns[k], breath[k], rng)
        if 50 <= k < 60:
            shown[:] = cv2.GaussianBlur(shown, (0, 0), 40.0)
        tracker = tracker or PatchTracker(shown, tuple(places[k]), SIDE)
        seen.append(tracker.track(shown))
    assert not any(s.valid for s in seen[50:60])
    assert all(s.lost for s in seen[50:60])
    after = [s for s in seen[60:] if s.valid]
    assert len(after) > 50
    assert np.hypot(after[-1].u_px - places[119][0], after[-1].v_px - places[119][1]) < 0.5


def test_what_does_not_move_is_seen_at_rest() -> None:
    rng, tracker = np.random.default_rng(7), None
    seen = []
    for k in range(60):
        shown = picture(150.0, 120.0, 0.0, 4.0 * np.sin(k / 5.0), rng)
        tracker = tracker or PatchTracker(shown, (150.0, 120.0), SIDE)
        seen.append(tracker.track(shown))
    tracker.settle()
    again = tracker.track(shown)
    assert again.valid
    tissue = 4.0 * np.std(np.sin(np.arange(60) / 5.0))
    assert np.std([(s.u_px, s.v_px) for s in seen], axis=0).max() < 0.05 * tissue


def test_another_video_begins_where_the_place_is_found_turned() -> None:
    rng = np.random.default_rng(8)
    tracker = PatchTracker(picture(120.0, 110.0, 0.0, 0.0, rng), (120.0, 110.0), SIDE)
    seen = tracker.track(picture(230.0, 150.0, 34.0, 3.0, rng))
    assert seen.valid
    assert np.hypot(seen.u_px - 230.0, seen.v_px - 150.0) < 0.5


@pytest.mark.parametrize("turn", [-40.0, 15.0])
def test_poses_follow_each_other(turn: float) -> None:
    one, other = Pose(10.0, 20.0, 1.1, 0.2), Pose(-4.0, 7.0, 0.9 * np.cos(turn), 0.9 * np.sin(turn))
    same = one.moved_by(one.motion_to(other))
    np.testing.assert_allclose([same.u, same.v, same.a, same.b], [other.u, other.v, other.a, other.b], atol=1e-12)


def test_a_place_without_structure_is_refused() -> None:
    flat = np.full((HEIGHT, WIDTH, 3), 90, dtype=np.uint8)
    with pytest.raises(TautError, match="hardly anything to follow"):
        PatchTracker(flat, (100.0, 100.0), SIDE)
    with pytest.raises(TautError, match="outside of the picture"):
        PatchTracker(flat, (400.0, 100.0), SIDE)


def test_a_video_of_another_size_is_refused() -> None:
    rng = np.random.default_rng(8)
    shown = picture(120.0, 110.0, 0.0, 0.0, rng)
    tracker = PatchTracker(shown, (120.0, 110.0), SIDE)
    with pytest.raises(TautError, match="frames are 170 x 130 px, the place was shown in one of 340 x 260"):
        tracker.track(cv2.resize(shown, None, fx=0.5, fy=0.5))


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bare") / "video.mkv"
    rng = np.random.default_rng(9)
    with VideoFile(path, 25.0) as file:
        for (u, v), turn, aside in zip(*course(120), strict=True):
            file.write(picture(u, v, turn, aside, rng))
    return path


def test_a_region_is_shown_once_and_used_for_its_video(video: Path, taut: Taut) -> None:
    places = course(120)[0]
    done = taut("marker", video, "--region", f"{places[0][0]},{places[0][1]},{SIDE}", "--json")
    said = json.loads(done.out)
    assert said["frames_seen"] == said["frames"]
    assert Path(said["picture"]).is_file()
    marker = track_video(Video(video, None))
    assert marker.valid.all()
    assert np.sqrt(np.mean((np.column_stack([marker.u_px, marker.v_px]) - places) ** 2)) < 0.15

    region = Region.load(video.parent / REGION_FILE)
    assert region.at == pytest.approx(tuple(places[0]))
    (video.parent / "marker.toml").write_text("", encoding="utf-8")
    with pytest.raises(TautError, match="is there a marker or not"):
        track_video(Video(video, None))
    (video.parent / "marker.toml").unlink()
    file = video.parent / REGION_FILE
    good = file.read_text(encoding="utf-8")
    file.write_text(good.replace("side_px = ", f"side_px = {'9' * 400} #"), encoding="utf-8")
    with pytest.raises(TautError, match="cannot be read as a place to follow"):
        Region.load(file)
    file.write_text(good, encoding="utf-8")
    (video.parent / "region.png").unlink()
    with pytest.raises(TautError, match=r"region\.png is not beside it"):
        track_video(Video(video, None))
    (video.parent / "region.png").mkdir()
    with pytest.raises(TautError, match=r"region\.png: cannot be written"):
        region.save(file)


def test_a_wrong_region_is_a_usage_error(video: Path, taut: Taut) -> None:
    assert taut("marker", video, "--region", "nowhere").code == 2
    assert taut("marker", video, "--region", "1,2", "--at", "1,2").code == 2
