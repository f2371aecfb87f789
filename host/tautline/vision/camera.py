"""Cameras: any source that OpenCV opens, and the simulated endoscope. Each frame comes with the time of its arrival."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Protocol, Self

import cv2
import numpy as np

from tautline.closable import Closable
from tautline.errors import TautError
from tautline.simulated.endoscope import Endoscope
from tautline.vision import exposure
from tautline.vision.drops import Drops
from tautline.vision.timing import FrameTiming

Array = np.ndarray
# The instrument at the times (n,) s: c in deg, translation in mm, rotation in deg, each (n,) or a scalar.
Scene = Callable[[Array], tuple[Array | float, Array | float, Array | float]]

_EXPOSURE_SAMPLES = 5


class FrameSource(Protocol):
    """Anything that frames come from, one after the other."""

    clock: str  # what the arrival times count, in words

    @property
    def exposure(self) -> str:
        """Whether the camera's exposure stays as it is, in words; "" where the source does not know."""

    @property
    def dropped(self) -> int:
        """How many frames the camera took that never came."""

    def read(self) -> tuple[Array, float] | None:
        """Waits for the next frame, BGR (height, width, 3) uint8, and when it arrived, s. None at the end of the
        source."""

    def close(self) -> None:
        """Gives the source back to the system."""


class VideoCamera(Closable):
    """A device by its index or path, a video file, a stream or a GStreamer pipeline that ends in an appsink, through
    OpenCV's VideoCapture.

    Arrival times: of a device and a stream, seconds of the host's monotonic clock, taken by the driver where it stamps
    its frames with that clock, else when the frame was grabbed; of a file, the container's, the first frame at 0.
    Use it as a context manager.
    """

    def __init__(
        self, source: int | str | Path, *, size: tuple[int, int] | None = None, rate_hz: float | None = None
    ) -> None:
        """Opens the source: a device's number or path, a file, a stream's address or a GStreamer pipeline. size (width,
        height), px, and rate_hz are asked of a device, which may choose others. TautError where OpenCV cannot open
        it."""
        self.name = f"camera {source}" if isinstance(source, int) else str(source)
        self._file = not isinstance(source, int) and Path(source).is_file()
        pipeline = not isinstance(source, int) and " ! " in str(source)
        stream = pipeline or "://" in str(source)
        if not isinstance(source, int) and not stream and not Path(source).exists():
            raise TautError(f"{source}: no such video file, device, stream address or GStreamer pipeline")
        self._device = not self._file and not stream
        self._exposure: exposure.Exposure | None = None
        with _quiet_opencv():
            if pipeline:
                self._capture = cv2.VideoCapture(str(source), cv2.CAP_GSTREAMER)
            else:
                self._capture = cv2.VideoCapture(source if isinstance(source, int) else str(source))
        if not self._capture.isOpened():
            raise TautError(f"{self.name}: OpenCV cannot open it: {self._why_not_opened(pipeline)}")
        if not self._file:
            self._capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # no stale frames where the driver obeys
            width, height = size or (0, 0)
            wanted = {cv2.CAP_PROP_FRAME_WIDTH: width, cv2.CAP_PROP_FRAME_HEIGHT: height, cv2.CAP_PROP_FPS: rate_hz}
            for key, value in wanted.items():
                if value:
                    self._capture.set(key, value)
        self.clock = "the file's own" if self._file else "not known before the first frame"
        self._first_s: float | None = None  # of a file: time of its first frame in the container
        self._drops = Drops()

    def _why_not_opened(self, pipeline: bool) -> str:
        """Returns what may be wrong with a source that OpenCV does not open, as the end of an error's text."""
        if self._file:
            return "is it a video?"
        if not pipeline:
            return "is it plugged in, and not in use by another program?"
        if _has_gstreamer():
            return "does it end in '! appsink', and run with gst-launch-1.0?"
        return "it is built without GStreamer: install one that has it, such as Debian's python3-opencv"

    @property
    def dropped(self) -> int:
        """How many frames of a device or a stream never came; 0 of a file."""
        return self._drops.count

    @property
    def frames(self) -> int | None:
        """How many frames a file holds, by its header; None for a device or a stream, or where the header does not
        say."""
        count = int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)) if self._file else 0
        return count if count > 0 else None

    def seek(self, frame: int) -> None:
        """Moves to a frame of a file, counted from 0: the next `read` gives that one or one near it, as the container
        allows."""
        self._capture.set(cv2.CAP_PROP_POS_FRAMES, frame)

    @property
    def exposure(self) -> str:
        """What came of `lock_exposure`, in a sentence; "" before that, and for a file or stream."""
        return "" if self._exposure is None else self._exposure.says

    def lock_exposure(self) -> None:
        """Locks a device's exposure where its automatic one has settled, until the camera is closed: a changing
        exposure shifts frames in time. `exposure` says what came of it. Nothing happens for a file or stream."""
        if self._device:
            self._exposure = exposure.lock(self._capture)

    def read(self) -> tuple[Array, float] | None:
        """Reads the next picture, BGR (height, width, 3) uint8, and when it arrived, s (see the class). None at a
        file's end; TautError where a device or stream ends. A driver's stamp that is 0 to 1 s old by the host's
        monotonic clock is taken to be of that clock; else the time of grabbing is used. `clock` says which."""
        if not self._capture.grab():
            self._check_end()
            return None
        grabbed_s = time.monotonic()
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        good, picture = self._capture.retrieve()
        if not good:
            self._check_end()
            return None
        if self._file:
            self._first_s = stamp_s if self._first_s is None else self._first_s
            return picture, stamp_s - self._first_s
        stamped = 0.0 <= grabbed_s - stamp_s < 1.0
        self.clock = (
            "the driver's stamps on the host's monotonic clock"
            if stamped
            else "the host's monotonic clock when the frame was grabbed"
        )
        arrival_s = stamp_s if stamped else grabbed_s
        self._drops.add(arrival_s)
        return picture, arrival_s

    def _check_end(self) -> None:
        """Raises TautError, as no frame came, if the source is a device or a stream: only a file may end."""
        if not self._file:
            raise TautError(f"{self.name}: no more frames: check its cable or the stream's sender")

    def close(self) -> None:
        """Sets a locked exposure back to automatic and closes the source."""
        exposure.release(self._capture, self._exposure)
        self._capture.release()


def read_picture(path: str | Path) -> Array | None:
    """Reads a picture file: BGR (height, width, 3) uint8. None where the file is missing or of no format of pictures
    (such as a video). TautError where it is broken."""
    if not (Path(path).is_file() and cv2.haveImageReader(str(path))):
        return None
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise TautError(f"{path}: cannot be read as a picture: is it whole?")
    return np.asarray(picture)


def sample_video(path: Path, count: int) -> list[Array]:
    """Returns up to `count` (2 or more) frames, BGR (height, width, 3) uint8, spread evenly over a video file; its
    first ones if its length is unknown or no more than that. TautError where it holds none."""
    with VideoCamera(path) as camera:
        total = camera.frames or 0
        pictures = []
        for k in range(count):
            if total > count:
                camera.seek(round(k * (total - 1) / (count - 1)))
            if (read := camera.read()) is None:
                break
            pictures.append(read[0])
    if not pictures:
        raise TautError(f"{path}: holds no frames: was its recording broken off?")
    return pictures


class VideoFile:
    """A video to write frames into: MJPEG, or lossless (FFV1). Use it as a context manager."""

    def __init__(self, path: Path, rate_hz: float, lossless: bool = False) -> None:
        """path: of the file, which the first picture creates; rate_hz: frames a second that its header states."""
        self._path, self._rate_hz = path, rate_hz
        self._codec = cv2.VideoWriter.fourcc(*("FFV1" if lossless else "MJPG"))
        self._writer: cv2.VideoWriter | None = None

    def write(self, picture: Array) -> None:
        """Adds a picture, BGR (height, width, 3) uint8; all have the first one's size. TautError where the file cannot
        be created."""
        if self._writer is None:
            height, width = picture.shape[:2]
            with _quiet_opencv():
                self._writer = cv2.VideoWriter(str(self._path), self._codec, self._rate_hz, (width, height))
            if not self._writer.isOpened():
                raise TautError(f"{self._path}: the video cannot be written: is there room, and may you write there?")
        self._writer.write(picture)

    def __enter__(self) -> Self:
        """Returns itself; the file is created by the first picture."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Ends the file, if a picture was written; an error of the block is not caught."""
        if self._writer is not None:
            self._writer.release()


class SimulatedCamera:
    """The simulated endoscope in lockstep with a simulated instrument: frame by frame, in virtual time.

    A frame that arrives at t shows the scene around t - delay, blurred over the exposure. `read` asks `scene` only for
    times up to `next_scene_s` + half an exposure: whoever runs the simulation advances it that far first.
    """

    clock = "the simulation's"
    exposure = ""
    dropped = 0  # what it loses is no camera's fault

    def __init__(self, endoscope: Endoscope, scene: Scene, timing: FrameTiming | None = None) -> None:
        """endoscope: draws the frames; scene: the instrument's state at any times; timing: when frames are taken and
        arrive, by default at the rig's nominal rate and delay."""
        self._endoscope, self._scene = endoscope, scene
        self._frames = (timing or FrameTiming.of(endoscope.rig)).frames()
        self._next = next(self._frames)
        half = 0.5 * endoscope.look.exposure_s
        # Times, s from the exposure's middle, whose pictures a frame is the mean of.
        self._exposure = np.linspace(-half, half, _EXPOSURE_SAMPLES) if half > 0 else np.zeros(1)

    @property
    def next_scene_s(self) -> float:
        """The middle of the next frame's exposure, s of the simulation."""
        return self._next[0]

    @property
    def next_arrival_s(self) -> float:
        """When the next frame will arrive, s of the simulation."""
        return self._next[1]

    def read(self) -> tuple[Array, float]:
        """Returns the next frame, BGR (height, width, 3) uint8, and when it arrives, s of the simulation. The frame is
        the mean of _EXPOSURE_SAMPLES pictures over its exposure."""
        scene_s, arrival_s = self._next
        self._next = next(self._frames)
        return self._endoscope.frame(*self._scene(scene_s + self._exposure)), arrival_s

    def close(self) -> None:
        """Does nothing, as nothing is held open."""


def _has_gstreamer() -> bool:
    """Whether this OpenCV is built with GStreamer."""
    return bool(cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER))


class _quiet_opencv:
    """A context in which OpenCV and FFmpeg print nothing to stderr: a TautError says in one line what failed."""

    def __enter__(self) -> None:
        """Silences OpenCV, and FFmpeg unless the environment says otherwise."""
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # FFmpeg's "quiet"
        self._level = cv2.utils.logging.getLogLevel()
        cv2.utils.logging.setLogLevel(0)  # silent

    def __exit__(self, *_: object) -> None:
        """Sets OpenCV's log level back; FFmpeg's stays."""
        cv2.utils.logging.setLogLevel(self._level)
