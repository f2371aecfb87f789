"""A live set-up: a board, what its camera sees, and the recording of both. Simulated ones run in virtual time.

One clock holds for all of it: the board's, in microseconds on the wire and seconds in recordings.
"""

from __future__ import annotations

import bisect
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Protocol

import cv2
import numpy as np

from tautline.device import wire
from tautline.device.board import Board, open_board
from tautline.errors import TautError
from tautline.geometry import coarse_range_deg, project
from tautline.recording import FRAME_COLUMNS, PICTURE_NAME, Marker, Motor, Recording
from tautline.rig import Rig
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import Instrument, of_name
from tautline.simulated.simlink import DesktopBoard, SimLink, SimulatedAxis
from tautline.vision.camera import FrameSource, SimulatedCamera, VideoCamera
from tautline.vision.colour import MarkerColour, pick
from tautline.vision.marker import MarkerTracker
from tautline.vision.ros_camera import RosCamera, is_topic
from tautline.vision.sighting import Sighting
from tautline.vision.timing import FrameTiming

Array = np.ndarray
_STEP_S = 0.02
_FLUSH_FRAMES = 25  # so much of a recording is lost where the power goes
_UNPICKED = Sighting(np.nan, np.nan, np.nan, np.nan, "the marker's colour is not picked yet")
_SLICE_S = 0.1  # of virtual time, between which the board's telemetry is taken in
_DIAMETER_PX = 15.0  # of a marker that is only projected


@dataclass(frozen=True)
class Frame:
    """What one frame showed."""

    t_us: int  # arrival in board time
    sighting: Sighting  # of the marker
    picture: Array | None  # BGR (height, width, 3) uint8; None where none was drawn


class MarkerSource(Protocol):
    """Where frames with their markers come from."""

    def look(self) -> Frame:
        """Waits for the next frame. TautError at the end of the source."""

    def use(self, colour: MarkerColour) -> None:
        """Sets the marker's colour from the next frame on."""

    def close(self) -> None:
        """Closes the camera."""


class CameraSource:
    """A real camera. Arrival times are of the host's monotonic clock and become board time by round trips."""

    def __init__(
        self, board: Board, camera: FrameSource, tracker: MarkerTracker | None, size: tuple[int, int] | None = None
    ) -> None:
        """tracker: None finds no marker before `use`. size: (width, height) of frames that the rig names; TautError for
        frames of another size."""
        self._board, self._camera, self._tracker, self._size = board, camera, tracker, size

    @property
    def dropped(self) -> int:
        """How many frames the camera took that never came."""
        return self._camera.dropped

    @property
    def says(self) -> dict[str, str | int]:
        """What a command's JSON says of the camera: which clock its times are of, its exposure, how many frames were
        lost."""
        return {"clock": self._camera.clock, "exposure": self._camera.exposure, "dropped": self.dropped}

    def look(self) -> Frame:
        """Waits for the next frame, tracks its marker, and aligns the board's clock by one round trip, for the
        arrival's board time. TautError where the camera ends, or its frames have another size than the rig's."""
        taken = self._camera.read()
        if taken is None:
            raise TautError("the camera's source has ended: a live session needs a camera, not a file")
        picture, arrival_s = taken
        height, width = picture.shape[:2]
        if self._size not in (None, (width, height)):
            raise TautError(
                f"the camera's frames are {width} x {height} px, the rig's {self._size[0]} x {self._size[1]}: "
                "set the camera to the rig's size, or calibrate it at this one and write that into rig.toml"
            )
        self._board.align(1)
        seen = _UNPICKED if self._tracker is None else self._tracker.track(picture)
        return Frame(self._board.clock.board_us(arrival_s), seen, picture)

    def use(self, colour: MarkerColour) -> None:
        """Sets the marker's colour from the next frame on."""
        self._tracker = MarkerTracker(colour)

    def close(self) -> None:
        """Closes the camera."""
        self._camera.close()


class LockstepSource:
    """The simulated endoscope: looking advances board and instrument to the frame's arrival."""

    def __init__(self, plant: SimulatedAxis, camera: SimulatedCamera, tracker: MarkerTracker) -> None:
        """plant: the simulated board's axis with the instrument, whose scenes the camera draws."""
        self._plant, self._camera, self._tracker = plant, camera, tracker

    def look(self) -> Frame:
        """Advances board and instrument to the arrival of the camera's next frame, and returns that frame. Frames that
        passed since the last call are skipped."""
        while self._camera.next_arrival_s < self._plant.now_s:  # frames that passed while nobody looked
            self._camera.read()
        self._plant.advance_to(self._camera.next_arrival_s)
        picture, arrival_s = self._camera.read()
        return Frame(round(arrival_s * 1e6), self._tracker.track(picture), picture)

    def use(self, colour: MarkerColour) -> None:
        """Sets the marker's colour from the next frame on."""
        self._tracker = MarkerTracker(colour)

    def close(self) -> None:
        """Closes the simulated camera."""
        self._camera.close()


class PointSource:
    """As LockstepSource without pictures: the marker's projection with white noise of `noise_px`. For long runs."""

    def __init__(self, plant: SimulatedAxis, noise_px: float = 0.05, seed: int = 0) -> None:
        """plant: the simulated board's axis with the instrument; noise_px: rms per coordinate; seed: of the noise."""
        self._plant, self._noise_px = plant, noise_px
        self._frames = FrameTiming.of(plant.instrument.rig, jitter_s=plant.instrument.jitter_s).frames()
        self._rng = np.random.default_rng([seed, 0xE1E])

    def look(self) -> Frame:
        """Advances board and instrument to the next frame's arrival, and returns that frame: the marker's projection
        with noise, without a picture. Frames that passed since the last call are skipped."""
        scene_s, arrival_s = next(self._frames)
        while arrival_s < self._plant.now_s:  # frames that passed while nobody looked
            scene_s, arrival_s = next(self._frames)
        self._plant.advance_to(arrival_s)
        u, v = self._plant.marker(np.array([scene_s]))[0] + self._rng.normal(0.0, self._noise_px, 2)
        sighting = Sighting(float(u), float(v), sigma_px=self._noise_px, diameter_px=_DIAMETER_PX)
        return Frame(round(arrival_s * 1e6), sighting, None)

    def use(self, colour: MarkerColour) -> None:
        """Does nothing: without pictures the marker needs no colour to be found."""

    def close(self) -> None:
        """Does nothing: this source holds nothing open."""


@dataclass
class Live:
    """A live set-up: an open board with one axis that is used, its rig, and its camera."""

    board: Board
    rig: Rig
    axis: int = 0
    marker_source: MarkerSource | None = None  # None without a camera
    plant: SimulatedAxis | None = None  # the simulated instrument; None for a real one
    stopping: bool = False  # Ctrl-C came
    feeding: bool = False  # frames go on to the board: during its calibration motion

    @property
    def virtual(self) -> bool:
        """Whether time is simulated: it stands still unless it is advanced."""
        return self.plant is not None

    @property
    def resolution(self) -> float:
        """The rig's unit per count."""
        return self.rig.actuator.encoder_resolution

    def motor_position(self) -> float:
        """The motor's position now, the rig's unit, as the board has it: asks for the axis' status."""
        return float(self.board.status(self.axis).q) * self.resolution

    @contextmanager
    def interruptible(self) -> Iterator[None]:
        """A context within which Ctrl-C raises KeyboardInterrupt in the next `look` or `wait`, so that no message is
        cut in two; a second Ctrl-C raises it at once. Does nothing in another thread than the main one."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return

        def stop(number: int, frame: object) -> None:
            """Handler of SIGINT."""
            if self.stopping:
                raise KeyboardInterrupt  # asked for twice: at once
            self.stopping = True

        before = signal.signal(signal.SIGINT, stop)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)
            self.stopping = False

    @contextmanager
    def powered(self) -> Iterator[None]:
        """A context within which the motor is on and Ctrl-C is `interruptible`; afterwards the axis is at rest and the
        motor off, whatever happens."""
        with self.interruptible():
            try:
                self.board.switch_on(self.axis, self.wait)
                yield
            finally:
                self.release()

    def _check_stop(self) -> None:
        """Raises KeyboardInterrupt, once, where Ctrl-C came since the last call."""
        if self.stopping:
            self.stopping = False
            raise KeyboardInterrupt

    @property
    def top_speed(self) -> float:
        """The motor's top speed by the axis' limits, the rig's unit per second."""
        return float(self.board.ask("get_limits", axis=self.axis).speed_s) * self.resolution

    def look(self) -> Frame:
        """Waits for the next frame; meanwhile what the board sends is taken in. While `feeding`, the board is told
        where the marker is. TautError without a camera; KeyboardInterrupt after a Ctrl-C."""
        self._check_stop()
        if self.marker_source is None:
            simulated = self.plant is not None
            raise TautError("the rig has no [camera]: add one" if simulated else "no camera: name one with --camera")
        frame = self.marker_source.look()
        if self.feeding:
            seen = frame.sighting
            place = {"u": seen.u_px, "v": seen.v_px, "sigma": seen.sigma_px} if seen.valid else {}
            self.board.tell("marker", valid=int(seen.valid), arrival_us=frame.t_us, **place)
        self._take_in()
        return frame

    def wait(self, seconds: float) -> None:
        """Waits, in virtual time where the set-up is simulated. KeyboardInterrupt after a Ctrl-C."""
        self._check_stop()
        if self.plant is None:
            time.sleep(seconds)
            return
        end = self.plant.now_s + seconds
        while self.plant.now_s < end - 1e-9:
            self.plant.advance_to(min(self.plant.now_s + _SLICE_S, end))
            self._take_in()

    def _take_in(self) -> None:
        """Takes in what a simulated board has sent. Does nothing for a real one, which has a thread for that."""
        if self.plant is not None:
            self.board.sync()

    def now_us(self) -> int:
        """Returns the board's time, us: the simulation's, or the one that the board gives when asked, which is as old
        as the answer's way."""
        return round(self.plant.now_s * 1e6) if self.plant is not None else self.board.sync()

    def rest(self, timeout_s: float = 5.0) -> wire.Message:
        """Waits until the axis rests, and returns its status. TautError where it has a fault, or does not rest within
        timeout_s."""
        waited = 0.0
        while True:
            status = self.board.status(self.axis)
            if status.fault:
                self.board.check_fault(self.axis)
            if status.flags & wire.code("FLAGS", "AT_REST"):
                return status
            if waited >= timeout_s:
                raise TautError(f"axis {self.axis} does not come to rest: check its limits and servo gains")
            self.wait(_STEP_S)
            waited += _STEP_S

    def let_go(self) -> None:
        """Switches the motor off at once, from another thread than the one that drives, which may hang in the camera.
        Does nothing in a simulation: there no thread reads that could take in the board's answer."""
        if not self.virtual:
            self.board.ask("enable", axis=self.axis, on=0)

    def release(self) -> None:
        """Brings the axis to rest within its limits, whatever it does, and switches the motor off; waits for that 5 s
        at most."""
        self.board.ask("enable", axis=self.axis, on=0)
        waited = 0.0
        while self.board.status(self.axis).mode != wire.code("MODES", "OFF") and waited < 5.0:
            self.wait(_STEP_S)
            waited += _STEP_S


class Recorder:
    """Writes a recording while it is made: whatever ends the session, what was measured is on the disk."""

    def __init__(self, live: Live, folder: Path, video: bool = False) -> None:
        """Creates the folder with rig.toml and motor.csv; marker.csv follows with the first frame. video: the frames
        are kept too, in video.mkv and frames.csv. TautError where the folder holds a recording, or cannot be
        written."""
        self.folder, self._live = folder, live
        unit = live.rig.actuator.unit
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if (folder / "motor.csv").exists():
                raise TautError(f"{folder}: holds a recording already: name another folder")
            live.rig.save(folder / "rig.toml")
            self._motor = (folder / "motor.csv").open("w", buffering=1 << 16)
            self._motor.write(f"t_s,q_{unit},q_cmd_{unit}\n")
        except OSError as error:
            raise TautError(f"{folder}: cannot be written ({error.strerror}): name another folder") from error
        self._marker: IO[str] | None = None
        self._size = ""  # of the frames, as it stands in each row of marker.csv
        self._frames: IO[str] | None = None
        self._video: Any = None
        self._wants_video, self._pictured = video, False
        self._count = 0
        self._last_us = -1
        self._paused = False
        self._writing = threading.Lock()  # telemetry: a board's reader is another thread
        self._rows: dict[str, list[tuple[float, ...]]] = {"motor": [], "marker": []}
        live.board.listen("batch", self._write_telemetry)

    def __enter__(self) -> Recorder:
        """Has the board send its telemetry, which is recorded from now on."""
        self._live.board.ask("telemetry", axis=self._live.axis, divider=self._live.board.log_divider)
        return self

    def __exit__(self, *_: object) -> None:
        """Ends recording and closes the files."""
        with self._writing:
            self._paused = True
        self._live.board.forget("batch", self._write_telemetry)
        for file in (self._motor, self._marker, self._frames):
            if file is not None:
                file.close()
        if self._video is not None:
            self._video.release()

    def _write_telemetry(self, batch: wire.Message) -> None:
        """Listener to the message `batch`: writes its samples to motor.csv, if they are of this axis and newer than the
        last."""
        if batch.axis != self._live.axis:
            return
        resolution = self._live.resolution
        with self._writing:
            if self._paused:
                return
            for i in range(batch.count):
                t_us = batch.t_us + i * batch.period_us
                if t_us > self._last_us:
                    row = f"{t_us * 1e-6:.6f},{batch.q[i] * resolution:.7g},{batch.q_ref[i] * resolution:.7g}"
                    self._write(self._motor, "motor", row)
                    self._last_us = t_us

    def _write(self, file: IO[str], name: str, row: str) -> None:
        """Writes a CSV row to a file, and keeps its numbers in `_rows` under `name`, NaN where a field is empty."""
        file.write(row + "\n")
        self._rows[name].append(tuple(float(value or "nan") for value in row.split(",")))

    @contextmanager
    def paused(self) -> Iterator[None]:
        """A context within which telemetry is not recorded."""
        self._paused = True
        try:
            yield
        finally:
            self._paused = False

    def recording_so_far(self) -> Recording:
        """Returns a Recording of what the files hold now, with the numbers as written, without reading the files. May
        be called from any thread. TautError where no telemetry or no frame came yet."""
        motor, marker = (np.array(list(self._rows[name])) for name in ("motor", "marker"))
        if not len(motor) or not len(marker):
            raise TautError("nothing was recorded yet: no telemetry or no frame came")
        t_s, u_px, v_px, valid, sigma_px, *size = marker.T
        frame_px = (int(size[0][0]), int(size[1][0])) if size else None
        seen = Marker(t_s, u_px, v_px, valid > 0.5, sigma_px, frame_px=frame_px)
        return Recording(self.folder.name, Motor(*motor.T), seen, rig=self._live.rig)

    def motor_at(self, t_s: float) -> float:
        """The motor's position, the rig's unit, in the last recorded sample at or before t_s, board time; NaN before
        the first sample."""
        rows = self._rows["motor"]
        after = bisect.bisect_right(rows, (t_s, np.inf))
        return rows[after - 1][1] if after else float("nan")

    def add(self, frame: Frame) -> None:
        """Records one frame: a row of marker.csv, a picture of the video if one is wanted, and the first picture that
        shows the marker as a file of its own, for reports. Every _FLUSH_FRAMES frames motor.csv and marker.csv are
        flushed to the disk."""
        if self._marker is None:
            self._marker = (self.folder / "marker.csv").open("w", buffering=1 << 13)
            size = None if frame.picture is None else (frame.picture.shape[1], frame.picture.shape[0])
            self._size = "" if size is None else ",{},{}".format(*size)
            self._marker.write(",".join(["t_s,u_px,v_px,valid,sigma_px", *(FRAME_COLUMNS if size else ())]) + "\n")
        seen, t_s = frame.sighting, frame.t_us * 1e-6
        if seen.valid:
            row = f"{t_s:.6f},{seen.u_px:.4f},{seen.v_px:.4f},1,{max(seen.sigma_px, 1e-4):.4f}{self._size}"
        else:
            row = f"{t_s:.6f},,,0,{self._size}"
        self._write(self._marker, "marker", row)
        if seen.valid and frame.picture is not None and not self._pictured:
            self._pictured = cv2.imwrite(str(self.folder / PICTURE_NAME), frame.picture)
        if self._wants_video and frame.picture is not None:
            self._add_picture(frame.picture, t_s)
        self._count += 1
        if self._count % _FLUSH_FRAMES == 0:
            self._motor.flush()
            self._marker.flush()

    def _add_picture(self, picture: Array, t_s: float) -> None:
        """Writes a picture to the video, and its arrival time t_s, board time, to frames.csv; the first picture creates
        both."""
        if self._video is None:
            height, width = picture.shape[:2]
            rate = self._live.rig.camera.frame_rate_hz if self._live.rig.camera else 25.0
            code = cv2.VideoWriter.fourcc(*"MJPG")
            self._video = cv2.VideoWriter(str(self.folder / "video.mkv"), code, rate, (width, height))
            self._video.set(cv2.VIDEOWRITER_PROP_QUALITY, 95)
            self._frames = (self.folder / "frames.csv").open("w", buffering=1 << 12)
            self._frames.write("frame,t_s\n")
        assert self._frames is not None
        self._video.write(picture)
        self._frames.write(f"{self._count},{t_s:.6f}\n")


def _advance(link: SimLink, seconds: float) -> None:
    """Advances a simulated board's time by `seconds`."""
    link.ask(f"advance {round(seconds * 1e6)}")


def _with_board_instrument(rig: Rig, board: Board, axis: int) -> Rig:
    """Returns the rig with the name of the instrument in the board's settings if the rig itself has none, so that
    recordings and models carry it."""
    on_board: str = board.ask("get_settings", axis=axis).instrument
    return replace(rig, actuator=replace(rig.actuator, instrument=rig.actuator.instrument or on_board or None))


def _open_camera(source: str | int, size: tuple[int, int] | None, rate_hz: float | None) -> FrameSource:
    """Opens a camera: a ROS topic (ros:TOPIC), or a device, stream or file as VideoCamera takes it, with its exposure
    locked. size (width, height), px, and rate are asked of a device."""
    if is_topic(source):
        return RosCamera(str(source))
    camera = VideoCamera(source, size=size, rate_hz=rate_hz)
    camera.lock_exposure()
    return camera


@contextmanager
def open_live(
    *,
    board: str | None = None,
    camera: str | int | None = None,
    simulate: str | None = None,
    rig: Rig | None = None,
    axis: int = 0,
    colour: MarkerColour | None = None,
    at: float | None = None,
    pictures: bool = True,
    picks: bool = False,
    seed: int = 0,
    otherwise: str = "",
) -> Iterator[Live]:
    """A context with a live set-up: a simulated one if `simulate` is given, else the real `board` (see
    device.board.find; default: of the rig) and `camera`, if one is given. All is closed afterwards.

    simulate: an instrument preset, or the folder of a model whose effects the instrument then has; on a desktop board.
    axis: the board's, that is used. colour: the marker's.
    at: where the motor is, the rig's unit; else the board's reference holds, and a simulated one begins at 0.
    pictures: False replaces the rendered endoscope by the marker's projection, which is faster.
    picks: a camera may be opened without a colour, which `use` names later.
    seed: of simulated noise. otherwise: what else the user could give where there is no board, for the error's text.
    """
    with ExitStack() as stack:
        if simulate is not None:
            live = _start_simulation(stack, of_name(simulate, rig, seed), axis, at or 0.0, pictures, seed)
        elif rig is None:
            raise TautError("no rig: name the set-up's file with --rig")
        else:
            opened = stack.enter_context(open_board(board or rig.actuator.board, otherwise))
            opened.check_axis(axis)
            opened.align(16)
            stack.enter_context(opened.reading())
            live = Live(opened, _with_board_instrument(rig, opened, axis), axis)
            if at is not None:
                opened.ask("set_position", axis=axis, q=at / live.resolution)
            if camera is not None:
                if colour is None and not picks:
                    raise TautError("the marker's colour is not known: pick it once with 'taut marker'")
                live.marker_source = _open_camera_source(opened, camera, rig, colour)
        if live.marker_source is not None:
            stack.callback(live.marker_source.close)
        yield live


def _start_simulation(
    stack: ExitStack, instrument: Instrument, axis: int, at: float, pictures: bool, seed: int
) -> Live:
    """Starts a desktop board, which the stack closes, with a simulated instrument on its axis, the motor at `at`, the
    rig's unit; the axis is commissioned, checked and referenced, as a user does with a real one. pictures: whether the
    endoscope's pictures are drawn, if the instrument can be drawn; else frames have only the marker's projection."""
    rig = instrument.rig
    desktop = stack.enter_context(DesktopBoard(axes=axis + 1))
    board = stack.enter_context(open_board(desktop.where))
    link = desktop.link()
    stack.callback(link.close)
    board.trust_motor(axis)
    board.switch_on(axis, lambda seconds: _advance(link, seconds))
    board.ask("enable", axis=axis, on=0)
    _advance(link, _SLICE_S)
    place = at / rig.actuator.encoder_resolution
    link.ask(f"place {axis} {round(place * 256)}")  # 1/256 counts
    board.ask("set_position", axis=axis, q=place)
    plant = SimulatedAxis(link, instrument, axis)
    source: MarkerSource | None = None
    if pictures and instrument.drawn and rig.has_camera:
        endoscope = Endoscope(rig, seed=seed)
        middle = 0.5 * sum(coarse_range_deg(rig))
        spot = project(rig, middle)[0]  # where the marker is at mid-range: its colour is picked there
        seen_as = pick(endoscope.frame(middle, 0.0, 0.0), (float(spot[0]), float(spot[1])))
        source = LockstepSource(plant, SimulatedCamera(endoscope, plant.scene), MarkerTracker(seen_as))
    elif rig.has_camera:
        source = PointSource(plant, seed=seed)
    return Live(board, rig, axis, source, plant)


def _open_camera_source(board: Board, camera: str | int, rig: Rig, colour: MarkerColour | None) -> CameraSource:
    """Opens a camera (a device's number may be text) at the rig's size and rate, as a source of markers whose times are
    on the board's clock. colour: the marker's; None finds none until `use`."""
    source = int(camera) if isinstance(camera, str) and camera.isdigit() else camera
    size = None if rig.camera is None else (rig.camera.width_px, rig.camera.height_px)
    rate_hz = None if rig.camera is None else rig.camera.frame_rate_hz
    tracker = None if colour is None else MarkerTracker(colour)
    return CameraSource(board, _open_camera(source, size, rate_hz), tracker, size)
