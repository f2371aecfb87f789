"""The simulated endoscope draws what the geometry says; cameras say what is wrong in one line."""

from __future__ import annotations

import time

import cv2
import numpy as np
import pytest

from tautline.errors import TautError
from tautline.rig import Rig
from tautline.simulated.endoscope import Endoscope, Look, load_background
from tautline.simulated.instrument import reference_rig
from tautline.vision.camera import SimulatedCamera, VideoCamera
from tautline.vision.timing import FrameTiming

RIG = reference_rig()
QUIET = Look(noise=0.0, glint=0.0, vignetting=0.0)
BLACK = np.zeros((576, 720, 3), np.uint8)


def drawn_centre(scope: Endoscope, *state: float | np.ndarray) -> np.ndarray:
    """Centroid of what the marker adds to the picture: its green over the tube's grey and the black around."""
    picture = scope.frame(*state).astype(float)
    green = np.clip(
        picture[:, :, 1] - picture[:, :, 2], 0, None
    )  # the tube's grey is 5 levels off: below it, not marker
    green[green < 12] = 0
    y, x = np.indices(green.shape)
    return np.array([(green * x).sum(), (green * y).sum()]) / green.sum()


@pytest.fixture(scope="module")
def bare() -> Endoscope:
    """Only a marker: the tube is as thin as the arithmetic allows."""
    return Endoscope(RIG, Look(noise=0.0, glint=0.0, vignetting=0.0, tube_radius_mm=1e-6), BLACK)


@pytest.mark.parametrize("state", [(-50.0, 0.0, 0.0), (0.3, 0.0, 0.0), (17.7, 2.5, -20.0), (48.0, -3.0, 35.0)])
def test_the_marker_is_drawn_where_the_geometry_says(bare: Endoscope, state: tuple[float, float, float]) -> None:
    assert np.abs(drawn_centre(bare, *state) - bare.position(*state)[0]).max() < 0.01


def test_a_distorted_camera_draws_distorted() -> None:
    rig = RIG.with_camera(distortion=(-0.25, 0.08, 0.002, -0.001, 0.0))
    scope = Endoscope(rig, Look(noise=0.0, glint=0.0, vignetting=0.0, tube_radius_mm=1e-6), BLACK)
    assert np.abs(drawn_centre(scope, -50.0) - scope.position(-50.0)[0]).max() < 0.01
    assert np.abs(scope.position(-50.0) - Endoscope(RIG, QUIET, BLACK).position(-50.0)).max() > 5.0


def test_motion_blur_is_the_mean_over_the_exposure(bare: Endoscope) -> None:
    path = np.linspace(10.0, 15.0, 5)
    dense = bare.position(np.linspace(10.0, 15.0, 999))
    assert np.ptp(dense[:, 0]) > 15
    assert np.abs(drawn_centre(bare, path) - dense.mean(axis=0)).max() < 0.02


def test_frames_differ_by_the_noise_that_was_asked_for_and_seeds_repeat() -> None:
    look = Look(noise=3.0)
    scope = Endoscope(RIG, look, seed=1)
    first, second = scope.frame(20.0), scope.frame(20.0)
    flat = np.s_[10:80, 300:600]
    difference = first[flat].astype(float) - second[flat]
    assert abs(difference.std() / np.sqrt(2) - 3.0) < 0.15
    assert np.array_equal(Endoscope(RIG, look, seed=1).frame(20.0), first)


def test_what_is_out_of_view_is_not_drawn() -> None:
    scope = Endoscope(RIG.with_camera(width_px=200, height_px=150), QUIET)
    scope.frame(45.0)  # marker beyond the right border
    behind = Rig.from_document(
        {**RIG.to_document(), "hand_eye": {"rotation_deg": [0, 180, 0], "translation_mm": [0, 0, 0]}}, ""
    )
    assert Endoscope(behind, QUIET).frame(0.0).shape == (576, 720, 3)


def test_a_background_of_ones_own(tmp_path) -> None:
    picture = np.full((40, 60, 3), (10, 200, 90), np.uint8)
    cv2.imwrite(str(tmp_path / "b.png"), picture)
    scope = Endoscope(RIG, Look(noise=0.0, vignetting=0.0), load_background(tmp_path / "b.png"))
    assert scope.frame(20.0)[5, 700].tolist() == [10, 200, 90]
    (tmp_path / "b.txt").write_text("no picture")
    with pytest.raises(TautError, match=r"b.txt: cannot be read as a picture"):
        load_background(tmp_path / "b.txt")
    with pytest.raises(TautError, match="8 bits"):
        Endoscope(RIG, background=np.zeros((4, 4), np.uint8))


def test_the_simulated_camera_shows_the_scene_of_a_delay_ago() -> None:
    asked: list[np.ndarray] = []

    def scene(t: np.ndarray) -> tuple[np.ndarray, float, float]:
        asked.append(t)
        return 10.0 * t, 0.0, 0.0

    timing = FrameTiming(25.0, 0.08, lost=0.3, seed=3)
    camera = SimulatedCamera(Endoscope(RIG, QUIET, BLACK), scene, timing)
    for expected, _ in zip(timing.frames(), range(5), strict=False):
        assert (camera.next_scene_s, camera.next_arrival_s) == expected
        _, arrival = camera.read()
        assert arrival == expected[1] and np.isclose(arrival - asked[-1].mean(), 0.08)
        assert np.isclose(np.ptp(asked[-1]), QUIET.exposure_s)


def test_a_video_file_gives_its_own_times_and_ends(tmp_path) -> None:
    path = tmp_path / "video.mkv"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
    for k in range(10):
        writer.write(np.full((48, 64, 3), 20 * k, np.uint8))
    writer.release()
    with VideoCamera(path) as camera:
        assert camera.frames == 10 and camera.clock == "the file's own"
        times = [read[1] for _ in range(10) if (read := camera.read())]
        assert np.allclose(times, np.arange(10) / 25, atol=1e-3)
        assert camera.read() is None


def test_cameras_that_do_not_open_say_why(tmp_path) -> None:
    with pytest.raises(TautError, match="no such video file, device, stream"):
        VideoCamera(tmp_path / "none.mp4")
    (tmp_path / "foreign.mkv").write_text("t_s,u_px\n")
    with pytest.raises(TautError, match="is it a video"):
        VideoCamera(tmp_path / "foreign.mkv")
    with pytest.raises(TautError, match=r"camera 97: OpenCV cannot open it: is it plugged in"):
        VideoCamera(97)


class Capture:
    """A device as OpenCV shows one, with or without stamps of the driver's."""

    def __init__(self, stamp_s: float | None, frames: int = 3) -> None:
        self.stamp_s, self.frames, self.released = stamp_s, frames, False

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        return True

    def get(self, key: int) -> float:
        return 0.0 if self.stamp_s is None else 1e3 * (time.monotonic() - self.stamp_s)

    def grab(self) -> bool:
        self.frames -= 1
        return self.frames >= 0

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, BLACK

    def release(self) -> None:
        self.released = True


@pytest.mark.parametrize(
    ("late_s", "clock"), [(0.05, "driver"), (None, "when the frame was grabbed"), (3600.0, "grabbed")]
)
def test_a_device_says_whose_clock_its_times_are_from(
    late_s: float | None, clock: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    device = Capture(late_s)
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: device)
    with VideoCamera(0) as camera:
        before = time.monotonic()
        read = camera.read()
        after = time.monotonic()
        assert read is not None and clock in camera.clock
        age = 0.05 if late_s == 0.05 else 0.0
        assert before - age - 0.001 <= read[1] <= after - age + 0.001  # the driver counts in ms
        camera.read()
        camera.read()
        with pytest.raises(TautError, match="camera 0: no more frames: check its cable"):
            camera.read()
    assert device.released
