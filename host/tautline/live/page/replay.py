"""A recording in place of board and camera: frame by frame, as they came, with what a calibration knew by then."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, closing, contextmanager, nullcontext
from dataclasses import fields, replace
from typing import TypeVar

import cv2
import numpy as np

from tautline.calibration.clock import on_motor_clock
from tautline.errors import TautError
from tautline.live.rounds import default_until
from tautline.live.setup import Frame
from tautline.live.watch import Show, View, Watch
from tautline.recording import Angle, Marker, Motor, Recording
from tautline.rig import Rig
from tautline.vision.camera import VideoCamera
from tautline.vision.sighting import Sighting

Array = np.ndarray
Series = TypeVar("Series", Motor, Marker, Angle)

_SAME_S = 2e-3  # by which a row of marker.csv and its frame's row in frames.csv may differ
_IDLE_S = 0.02


class Played:
    """A recording that is played frame by frame. To a Watch it is both Live (`Watched`) and Recorder (`Kept`)."""

    virtual = False  # frames go on while a calibration is computed

    def __init__(self, recording: Recording, rig: Rig) -> None:
        """Nothing is played yet. TautError where the recording holds nothing that a camera saw."""
        if recording.marker is None or not rig.has_camera:
            raise TautError(f"{recording.name}: holds no marker: the page plays what a camera saw")
        self.rig, self._whole, self._marker = rig, recording, recording.marker
        (aligned,), _ = on_motor_clock([recording], rig)  # what is to be said of its clock a calibration of it says
        assert aligned.marker is not None
        self._t_s = aligned.marker.t_s  # of the frames, on the motor's clock
        self._at = -1  # the frame that was played last
        nothing = Sighting(np.nan, np.nan, np.nan, np.nan, "nothing was played yet")
        self._frame = Frame(self.now_us(), nothing, None)

    @property
    def frames(self) -> int:
        """How many frames the whole recording has."""
        return len(self._t_s)

    @property
    def played_s(self) -> float:
        """Time in the recording from its first frame to the one played last, s."""
        return float(self._t_s[max(self._at, 0)] - self._t_s[0])

    def play(self, picture: Callable[[float], Array | None]) -> Frame:
        """Advances to the next frame and returns it. picture: returns the BGR picture for an arrival time of
        marker.csv, s, or None."""
        self._at += 1
        k, marker = self._at, self._marker
        seen = Sighting(np.nan, np.nan, np.nan, np.nan, "the marker was not found")
        if marker.valid[k]:
            sigma_px = float("nan") if marker.sigma_px is None else float(marker.sigma_px[k])
            seen = Sighting(float(marker.u_px[k]), float(marker.v_px[k]), sigma_px, float("nan"))
        self._frame = Frame(self.now_us(), seen, picture(float(marker.t_s[k])))
        return self._frame

    def now_us(self) -> int:
        """The time of the frame played last, or of the first, on the motor's clock, us."""
        return round(float(self._t_s[max(self._at, 0)]) * 1e6)

    def look(self) -> Frame:
        """The frame played last once more, after _IDLE_S: only `play` advances."""
        time.sleep(_IDLE_S)
        return self._frame

    def add(self, frame: Frame) -> None:
        """Does nothing: the frame is in the recording already."""

    def paused(self) -> AbstractContextManager[None]:
        """A context that changes nothing, as nothing is recorded here."""
        return nullcontext()

    def motor_at(self, t_s: float) -> float:
        """The motor's position, the rig's unit, at a time of its clock, s; NaN before the first sample."""
        motor = self._whole.motor
        return float(np.interp(t_s, motor.t_s, motor.q, left=np.nan))

    def recording_so_far(self) -> Recording:
        """Returns the part of the recording up to the frame played last, with at least one sample of the motor; the
        whole recording once all frames were played."""
        if self._at + 1 >= self.frames:
            return self._whole
        now_s, motor = self._t_s[self._at], self._whole.motor
        return replace(
            self._whole,
            motor=_rows_of(motor, motor.t_s <= max(now_s, motor.t_s[0])),
            marker=_rows_of(self._marker, self._t_s <= now_s),
            angle=self._whole.angle and _rows_of(self._whole.angle, self._whole.angle.t_s <= now_s),
        )


def _rows_of(series: Series, rows: Array) -> Series:
    """Returns a series (motor, marker or angle) cut to the rows of a mask (n,): every column that is an array, also
    those in mappings."""
    kept = {}
    for field in fields(series):
        value = getattr(series, field.name)
        if isinstance(value, np.ndarray):
            kept[field.name] = value[rows]
        elif isinstance(value, Mapping):
            kept[field.name] = {name: column[rows] for name, column in value.items()}
    return replace(series, **kept)


class _Film:
    """A video's pictures by arrival time, which have to be asked for in their order."""

    def __init__(self, video: VideoCamera, arrival_s: Array | None) -> None:
        """arrival_s: of each frame, NaN where it is not known; None takes the times of the video itself."""
        self._video, self._arrival_s = video, arrival_s
        self._count = 0
        self._shown: Array | None = None
        self._coming = self._read()

    def at(self, t_s: float) -> Array | None:
        """Returns the last picture that had arrived at t_s, BGR; None before the first. t_s must not decrease."""
        while self._coming is not None and self._coming[1] <= t_s + _SAME_S:
            self._shown, self._coming = self._coming[0], self._read()
        return self._shown

    def _read(self) -> tuple[Array, float] | None:
        """Reads the next frame that has a time: returns the picture, BGR, and that time, s; None at the video's end."""
        while (read := self._video.read()) is not None:
            if self._arrival_s is None:
                return read
            k, self._count = self._count, self._count + 1
            if k < len(self._arrival_s) and np.isfinite(self._arrival_s[k]):
                return read[0], float(self._arrival_s[k])
        return None


@contextmanager
def _pictures(recording: Recording) -> Iterator[Callable[[float], Array | None]]:
    """A context that yields a function from arrival time, s, to BGR picture: the recording's video, or always the one
    picture that was kept, or None where there is neither."""
    if recording.video is None:
        still = None if recording.picture is None else cv2.imread(str(recording.picture), cv2.IMREAD_COLOR)
        yield lambda t_s: still
        return
    with VideoCamera(recording.video.path) as video:
        yield _Film(video, recording.video.arrival_s).at


def replay(recording: Recording, rig: Rig, show: Show, resting: Callable[[], bool], pace: float = 1.0) -> View:
    """Plays a recording as if it were a live calibration, at `pace` times its speed. show: gets what is known after
    every frame; resting: while it is true nothing is played. Returns the last View, with the calibration of all of
    it."""
    played = Played(recording, rig)
    low, high = rig.actuator.range
    view = View(low, high, rig.actuator.unit, default_until(rig.actuator), f"replay of {recording.name}")
    with closing(Watch(played, played, view, show=show)) as watch, _pictures(recording) as picture:
        began_s = time.monotonic()
        for _ in range(played.frames):
            if resting():
                rest_s = time.monotonic()
                watch.rest(resting)
                began_s += time.monotonic() - rest_s
            frame = played.play(picture)
            time.sleep(max(began_s + played.played_s / pace - time.monotonic(), 0.0))
            watch.frame(frame, 0 if view.calibration is None else len(view.calibration.onsets))
        watch.settle()
    return view
