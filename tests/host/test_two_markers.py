"""Something that looks like the marker, or comes in front of it: the track stays with the marker or is lost."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from tautline.recording import Video
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import reference_rig
from tautline.vision.camera import VideoFile
from tautline.vision.marker import MarkerTracker, find_colour, find_decoys, track_video, which_show_marker
from tautline.vision.sighting import Sighting

FRAMES = 80
COVERED = range(30, 42)
STATES = 30.0 * np.sin(np.linspace(-2.2, 2.4, FRAMES))
SCOPE = Endoscope(reference_rig(), seed=5)
TWIN = np.array([470.0, 180.0])


def with_twin(picture: np.ndarray, at: np.ndarray = TWIN) -> np.ndarray:
    """Another marker of the same look at a whole pixel."""
    u, v = np.rint(SCOPE.position(5.0)[0]).astype(int)
    marker = SCOPE.frame(5.0)[v - 12 : v + 13, u - 12 : u + 13]
    y, x = np.mgrid[-12:13, -12:13]
    disc = np.hypot(x, y) < 10.5
    u, v = np.rint(at).astype(int)
    picture[v - 12 : v + 13, u - 12 : u + 13][disc] = marker[disc]
    return picture


@cache
def pictures(covered: bool = True, twin_moves: bool = False) -> list[np.ndarray]:
    made = []
    for k, c in enumerate(STATES):
        picture = with_twin(SCOPE.frame(c), TWIN + ([0.9 * k, 0.0] if twin_moves else [0.0, 0.0]))
        if covered and k in COVERED:
            u, v = np.rint(SCOPE.position(c)[0]).astype(int)
            cv2.circle(picture, (int(u), int(v)), 24, (120, 118, 112), -1)
        made.append(picture)
    return made


def video(folder: Path, frames: list[np.ndarray]) -> Video:
    with VideoFile(folder / "video.mkv", 25.0) as file:
        for picture in frames:
            file.write(picture)
    return Video(folder / "video.mkv", np.arange(len(frames)) / 25.0)


def test_a_twin_that_stays_does_not_capture_the_track(tmp_path: Path) -> None:
    seen = track_video(video(tmp_path, pictures()))
    assert seen.frame_px == (720, 576)
    off = np.hypot(*(np.column_stack([seen.u_px, seen.v_px]) - SCOPE.position(STATES)).T)
    assert np.nanmax(off) < 0.5
    assert not seen.valid[COVERED.start : COVERED.stop].any()
    assert seen.valid.sum() >= FRAMES - len(COVERED) - 2


def test_what_stays_is_told_from_what_moves() -> None:
    some = pictures(covered=False)[::4]
    colour = find_colour(some)
    assert colour is not None
    (place,) = find_decoys(colour, some)
    assert np.hypot(*(place - TWIN)) < 2.0
    assert find_decoys(colour, pictures(covered=False, twin_moves=True)[::4]) == []
    assert find_decoys(colour, [some[0]] * 8) == []  # nothing moves: either may be it


def test_the_blob_near_the_last_place_is_taken_after_a_loss() -> None:
    some = pictures(covered=False)
    colour = find_colour(some[::4])
    assert colour is not None
    tracker = MarkerTracker(colour, [(float(TWIN[0]), float(TWIN[1]))])
    tracker.track(some[10])
    assert not tracker.track(np.full_like(some[0], 90)).valid
    only_twin = with_twin(np.full_like(some[0], 90))
    assert "never moves" in tracker.track(only_twin).lost
    back = tracker.track(some[12])
    assert np.hypot(*((back.u_px, back.v_px) - SCOPE.position(STATES[12])[0])) < 0.5


def sighting(u: float, diameter: float = 20.0) -> Sighting:
    return Sighting(u, 100.0, 0.05, diameter) if np.isfinite(u) else Sighting(np.nan, np.nan, np.nan, np.nan, "gone")


@pytest.mark.parametrize("elsewhere", [400.0, 30.0])
def test_a_stretch_that_cannot_be_reached_is_left_out(elsewhere: float) -> None:
    path = [sighting(150.0 + 2.0 * k) for k in range(60)]
    path[20:32] = [sighting(np.nan), *(sighting(elsewhere) for _ in range(10)), sighting(np.nan)]
    valid = which_show_marker(path)
    assert not valid[20:32].any() and valid[:20].all() and valid[32:].all()
    path = [sighting(elsewhere) for _ in range(9)] + path[9:20]
    assert not which_show_marker(path)[:9].any()  # at the start as well


def test_a_marker_that_went_on_while_it_was_hidden_is_the_marker() -> None:
    path = [sighting(150.0 + 2.0 * k) for k in range(60)]
    path[20:35] = [sighting(np.nan)] * 15
    valid = which_show_marker(path)
    assert valid.sum() == 45


def test_a_marker_of_which_a_part_is_hidden_is_left_out() -> None:
    path = [sighting(150.0 + 2.0 * k) for k in range(60)]
    path[30] = sighting(np.nan)
    path[29] = sighting(206.0, 18.0)
    valid = which_show_marker(path)
    assert not valid[29] and valid[31] and valid.sum() == 58
    path[40] = sighting(230.0, 18.0)  # nothing was lost there: light that changes
    assert which_show_marker(path)[40]


def test_the_first_frame_is_not_beside_the_last() -> None:
    path = [sighting(150.0, 21.5), *(sighting(150.0 + 2.0 * k) for k in range(1, 60))]
    path[59] = sighting(np.nan)
    assert which_show_marker(path)[0]
