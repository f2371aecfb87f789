"""Cameras as labs have them: what they drop is counted, streams come over a network, images over ROS."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from uuid import uuid4

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference_instrument import RIG, saved_model

from tautline.cli._live import LiveOptions, opened_setup
from tautline.drivers.ros_graph import Graph, library
from tautline.errors import TautError
from tautline.live import setup
from tautline.live.setup import CameraSource, Live
from tautline.vision import exposure, ros_camera
from tautline.vision.camera import VideoCamera
from tautline.vision.drops import Drops
from tautline.vision.ros_camera import RosCamera, is_topic
from tautline.vision.timing import FrameTiming

NO_ROS = pytest.mark.skipif(find_spec("rclpy") is None, reason="the index has no ROS 2 for this Python or machine")
SECONDS, AGE_S = 20.0, 0.2
_NOW_S = 1000.0  # where the clock stands still


@given(
    rate_hz=st.floats(15.0, 120.0), jitter=st.floats(0.0, 0.1), lost=st.floats(0.0, 0.15), seed=st.integers(0, 1 << 30)
)
def test_what_never_came_is_counted(rate_hz: float, jitter: float, lost: float, seed: int) -> None:
    """Jitter in periods, rms. A gap of n frames is missing n - 1; where jitter reaches half a period one may be taken
    for two, and the next is made up for."""
    timing = FrameTiming(rate_hz, 0.05, jitter_s=jitter / rate_hz, lost=lost, seed=seed)
    drops, came = Drops(), []
    for scene_s, arrival_s in timing.frames():
        if scene_s > SECONDS:
            break
        drops.add(arrival_s)
        came.append(scene_s * rate_hz)
    counted = np.rint(np.diff(came)).astype(int)[9:] - 1  # the first ten tell the rate
    assert abs(drops.count - counted.sum()) <= 1 + 0.05 * counted.sum()


@pytest.mark.parametrize("every", [3, 10])
def test_a_frame_that_comes_together_with_the_next_is_not_lost(every: int) -> None:
    drops = Drops()
    for k in range(1000):
        drops.add(0.04 * (k + 1 if k % every == 0 else k))  # read a period late
    assert drops.count == 0


def test_a_steady_camera_drops_nothing_whatever_its_rate_is_by_this_clock() -> None:
    drops = Drops()
    for k in range(3000):
        drops.add(k / 29.97)
    assert drops.count == 0
    for k in range(1, 100):  # it is darker: half the rate. Until that is known they look like drops
        drops.add(2999 / 29.97 + 2 * k / 29.97)
    assert 0 < drops.count < 51  # the intervals of which the period is told


@pytest.mark.parametrize("rate_hz", [1.0, 5.0, 30.0, 120.0])
def test_frames_that_nobody_read_are_not_lost_by_the_camera(rate_hz: float) -> None:
    drops, t_s = Drops(), 0.0
    for pause_s in (0.0, 6.0, 30.0):
        t_s += pause_s
        for _ in range(40):
            t_s += 1.0 / rate_hz
            drops.add(t_s)
    assert drops.count == 0
    drops.add(t_s + 4.0 / rate_hz)
    assert drops.count == 3


def test_a_camera_that_becomes_much_slower_still_tells_what_it_lost() -> None:
    drops, t_s = Drops(), 0.0
    for period_s in (*[1 / 30] * 40, *[0.5] * 40):
        t_s += period_s
        drops.add(t_s)
    assert drops.count == 0
    drops.add(t_s + 1.5)
    assert drops.count == 2


class Device:
    """Frames every 4 ms by the driver's own stamps; `lost` of them never come."""

    def __init__(self, lost: set[int]) -> None:
        self._taken = iter([k for k in range(40) if k not in lost])
        self._k = 0

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        return True

    def get(self, key: int) -> float:
        return 1e3 * (_NOW_S - 0.5 + 0.004 * self._k)

    def grab(self) -> bool:
        self._k = next(self._taken)
        return True

    def retrieve(self) -> tuple[bool, np.ndarray]:
        return True, np.zeros((48, 64, 3), np.uint8)

    def release(self) -> None:
        """Nothing is held."""


def test_a_session_tells_what_its_camera_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: Device({15, 22, 23}))
    monkeypatch.setattr("tautline.vision.camera.time.monotonic", lambda: _NOW_S)
    saved_model(tmp_path / "model")

    @contextmanager
    def opened_here(**_: object) -> Iterator[Live]:
        with VideoCamera(0) as camera:
            for _ in range(37):
                camera.read()
            yield Live(None, RIG, 0, CameraSource(None, camera, None))  # type: ignore[arg-type]

    monkeypatch.setattr(setup, "open_live", opened_here)
    with opened_setup(LiveOptions(None, 0, None, Path("marker.toml"), None, None), tmp_path / "model" / "rig.toml"):
        assert capsys.readouterr().err == ""
    assert "3 frames of the camera never came" in capsys.readouterr().err


class Webcam(Device):
    """As V4L2 drivers are: exposure in 0.1 ms, automatic (3) until it is manual (1); it settles while frames come.
    `obeys`: whether it takes a manual one; `step`: of what it takes."""

    def __init__(self, obeys: bool = True, step: float = 1.0, backend: str = "V4L2", auto: float = 3.0) -> None:
        super().__init__(set())
        self.obeys, self.step, self.backend = obeys, step, backend
        self.values = {cv2.CAP_PROP_AUTO_EXPOSURE: auto, cv2.CAP_PROP_EXPOSURE: 900.0}
        self.released: dict[int, float] | None = None
        self.shown_ms: list[float] = []

    def getBackendName(self) -> str:
        return self.backend

    def set(self, key: int, value: float) -> bool:
        if key == cv2.CAP_PROP_AUTO_EXPOSURE and not self.obeys:
            return False
        if key == cv2.CAP_PROP_EXPOSURE:
            value = self.step * round(value / self.step)
        self.values[key] = value
        return True

    def get(self, key: int) -> float:
        return self.values[key] if key in self.values else super().get(key)

    def grab(self) -> bool:
        exposure = self.values[cv2.CAP_PROP_EXPOSURE]
        if self.values[cv2.CAP_PROP_AUTO_EXPOSURE] in (3.0, 0.75):
            self.values[cv2.CAP_PROP_EXPOSURE] = max(exposure - 50.0, 156.0)
        self.shown_ms.append(0.1 * self.values[cv2.CAP_PROP_EXPOSURE])
        return super().grab()

    def release(self) -> None:
        self.released = dict(self.values)


@pytest.mark.parametrize(
    "webcam, says",
    [
        (Webcam(), "exposure locked at 15.6 ms"),
        (Webcam(backend="MSMF", auto=0.75), "exposure locked at 156 in the units of MSMF"),
        (Webcam(obeys=False), "the camera refuses a manual one"),
        (Webcam(step=100.0), "the camera takes 200 where it was 156"),
        (Webcam(auto=1.0), "exposure is manual, 90 ms"),
    ],
)
def test_exposure_is_locked_where_it_settled_and_what_is_refused_is_said(
    webcam: Webcam, says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = webcam.values[cv2.CAP_PROP_AUTO_EXPOSURE]
    monkeypatch.setattr(cv2, "VideoCapture", lambda source: webcam)
    monkeypatch.setattr("tautline.vision.camera.time.monotonic", lambda: _NOW_S)
    camera = setup._open_camera(0, None, None)
    assert says in camera.exposure
    if "locked" in says:
        shown = len(webcam.shown_ms)
        for _ in range(5):
            assert camera.read() is not None
        assert set(np.round(webcam.shown_ms[shown:], 6)) == {15.6}
        assert "driver's stamps" in camera.clock
    camera.close()
    assert webcam.released is not None and webcam.released[cv2.CAP_PROP_AUTO_EXPOSURE] == before


class Switch(Webcam):
    """One that takes a manual exposure and shows another number for it, as DirectShow's drivers do."""

    def get(self, key: int) -> float:
        if key == cv2.CAP_PROP_AUTO_EXPOSURE:
            return float(self.values[key] >= 0.5)
        return super().get(key)


def test_what_is_said_to_stay_automatic_does() -> None:
    webcam = Switch(backend="DSHOW", auto=0.75)
    said = exposure.lock(webcam)  # type: ignore[arg-type]
    assert not said.locked and "stays automatic" in said.says
    assert webcam.values[cv2.CAP_PROP_AUTO_EXPOSURE] >= 0.5


def picture(level: int) -> np.ndarray:
    made = np.zeros((48, 64, 3), np.uint8)
    made[:] = (level, 2 * level % 256, 60)
    made[:, :8] = (200, 10, 30)
    return made


@contextmanager
def streamed() -> Iterator[str]:
    """JPEGs one after the other over HTTP, as network cameras send them."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
            self.end_headers()
            for k in range(200):
                data = cv2.imencode(".jpg", picture(k % 100))[1].tobytes()
                head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n"
                try:
                    self.wfile.write(head.encode() + data + b"\r\n")
                except OSError:
                    return
                time.sleep(0.01)

        def log_message(self, *_: object) -> None:
            """Nothing is said."""

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/video.mjpg"
    finally:
        server.shutdown()
        server.server_close()


def test_a_network_stream_is_read_by_its_address() -> None:
    with streamed() as address, VideoCamera(address) as camera:
        assert camera.frames is None
        reads = [read for _ in range(12) if (read := camera.read())]
        now = time.monotonic()
        times = np.array([t_s for _, t_s in reads])
        assert len(reads) == 12 and reads[0][0].shape == (48, 64, 3)
        assert np.all(np.diff(times) >= 0.0) and now - 5.0 < times[0] <= times[-1] <= now
        assert "host's monotonic clock" in camera.clock


def test_a_pipeline_is_gstreamers(monkeypatch: pytest.MonkeyPatch) -> None:
    """A real one where OpenCV has it; else one line says that it has not."""
    pipeline, asked = "videotestsrc num-buffers=5 ! videoconvert ! video/x-raw,format=BGR ! appsink", []
    if cv2.videoio_registry.hasBackend(cv2.CAP_GSTREAMER):
        with VideoCamera(pipeline) as camera:
            assert camera.read() is not None
    else:
        with pytest.raises(TautError, match=r"built without GStreamer.*python3-opencv"):
            VideoCamera(pipeline)

    def opens(source: object, *backend: int) -> Device:
        asked.append((source, *backend))
        return Device(set())

    monkeypatch.setattr(cv2, "VideoCapture", opens)
    with VideoCamera(pipeline) as camera:
        assert camera.read() is not None and camera.frames is None
    assert asked == [(pipeline, cv2.CAP_GSTREAMER)]


def test_a_stream_that_is_not_there_is_one_line() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(TautError, match="OpenCV cannot open it"):
            VideoCamera(f"http://127.0.0.1:{taken.getsockname()[1]}/nothing.mjpg")


@contextmanager
def published(kind: str, make: object, stamped: bool = True) -> Iterator[str]:
    """An image every 20 ms on a topic."""
    topic, ended = f"/n{uuid4().hex[:12]}/image", threading.Event()
    with Graph("eye") as graph:
        sender = graph.node.create_publisher(getattr(library("sensor_msgs.msg"), kind), topic, 10)

        def send() -> None:
            k = 0
            while not ended.wait(0.02):
                message = make(k)  # type: ignore[operator]
                if stamped:  # by who took it, AGE_S ago
                    at = graph.node.get_clock().now().nanoseconds - round(1e9 * AGE_S)
                    message.header.stamp.sec, message.header.stamp.nanosec = at // 10**9, at % 10**9
                sender.publish(message)
                k += 1

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        try:
            yield f"ros:{topic}"
        finally:
            ended.set()
            thread.join()


def raw(encoding: str, padding: int = 0) -> object:
    convert = {"rgb8": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_BGR2RGBA, "mono8": cv2.COLOR_BGR2GRAY}.get(encoding)

    def make(k: int) -> object:
        pixels = picture(50) if convert is None else cv2.cvtColor(picture(50), convert)
        rows = pixels.reshape(48, -1)
        data = np.hstack([rows, np.full((48, padding), 255, np.uint8)])
        image = library("sensor_msgs.msg").Image
        return image(height=48, width=64, encoding=encoding, step=data.shape[1], data=data.tobytes())

    return make


def compressed(k: int) -> object:
    data = cv2.imencode(".png", picture(50))[1].tobytes()
    return library("sensor_msgs.msg").CompressedImage(format="png", data=data)


@NO_ROS
@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "rgba8", "mono8", "png"])
@pytest.mark.parametrize("stamped", [True, False])
def test_images_of_a_topic_are_a_cameras(encoding: str, stamped: bool) -> None:
    kind, make = ("CompressedImage", compressed) if encoding == "png" else ("Image", raw(encoding, padding=5))
    with published(kind, make, stamped) as source, RosCamera(source) as camera:
        assert is_topic(source)
        before = time.monotonic()
        reads = [read for _ in range(3) if (read := camera.read())]
        expected = picture(50)
        if encoding == "mono8":
            expected = cv2.cvtColor(cv2.cvtColor(expected, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
        for found, _ in reads:
            assert np.array_equal(found, expected)
        times = np.array([t_s for _, t_s in reads])
        age_s = AGE_S if stamped else 0.0  # a frame that waited to be read may have come before that
        assert np.all(np.diff(times) > 0.0)
        assert before - age_s - 0.1 < times[0] and times[-1] <= time.monotonic() - age_s + 1e-3
        assert ("stamps" in camera.clock) is stamped


@pytest.mark.parametrize(
    ("message", "says"),
    [
        (SimpleNamespace(encoding="bgr8", height=4, width=4, step=12, data=bytes(10)), "10 bytes for 4 rows of 12"),
        (SimpleNamespace(encoding="bgr8", height=4, width=8, step=12, data=bytes(48)), "no 8 x 4 px of bgr8"),
        (SimpleNamespace(encoding="mono8", height=0, width=0, step=0, data=b""), "no 0 x 0 px of mono8"),
        (SimpleNamespace(format="jpeg", data=b""), r"cannot be decoded \(format 'jpeg'\)"),
    ],
)
def test_an_image_that_is_not_whole_is_one_line(message: SimpleNamespace, says: str) -> None:
    camera = RosCamera.__new__(RosCamera)  # without a graph
    camera.name = "ros:/eye"
    with pytest.raises(TautError, match=says):
        camera._picture(message)


@NO_ROS
def test_images_that_cannot_be_shown_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        published("Image", raw("bayer_rggb8")) as source,
        RosCamera(source) as camera,
        pytest.raises(TautError, match=r"images are bayer_rggb8: one of bgr8"),
    ):
        camera.read()
    monkeypatch.setattr(ros_camera, "_FIRST_S", 0.3)
    with pytest.raises(TautError, match="nobody publishes it"):
        RosCamera("ros:/nobody/here")
