"""Images of a ROS 2 topic as a camera: `ros:/camera/image_raw`, raw or compressed."""

from __future__ import annotations

import threading
import time
from collections import deque
from typing import Any

import cv2
import numpy as np

from tautline.closable import Closable
from tautline.drivers.ros_graph import Graph, library, sensor_qos
from tautline.errors import TautError
from tautline.vision.drops import Drops

Array = np.ndarray
_PREFIX = "ros:"
# tolerance: the waits for a publisher and for a frame; a stamp that is older is of another clock.
_FIRST_S, _NEXT_S, _OLDEST_S = 10.0, 5.0, 1.0
_KEPT = 4  # frames that wait for who reads them
_KINDS = {"sensor_msgs/msg/Image": "Image", "sensor_msgs/msg/CompressedImage": "CompressedImage"}
_TO_BGR = {  # by encoding: channels, OpenCV's conversion
    "bgr8": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
}


def is_topic(source: object) -> bool:
    """Whether a camera's name is that of a ROS topic: ros:TOPIC."""
    return isinstance(source, str) and source.startswith(_PREFIX)


class RosCamera(Closable):
    """The frames of a topic as they come. Arrival times are of the host's monotonic clock: the message's stamp, if that
    is by this machine's clock, else when the message came. Use it as a context manager."""

    exposure = ""
    frames = None  # how many there are: a topic does not end

    def __init__(self, source: str) -> None:
        """Subscribes to the topic of `source`, ros:TOPIC. TautError where nobody publishes images on it."""
        self.name, topic = source, source.removeprefix(_PREFIX)
        self.clock = "not known before the first frame"
        self._drops = Drops()
        self._frame_arrived = threading.Condition()
        self._waiting: deque[tuple[float, Any]] = deque(maxlen=_KEPT)
        self._graph = Graph("tautline_camera")
        try:
            kind = self._message_type(topic)
            self._graph.node.create_subscription(
                getattr(library("sensor_msgs.msg"), kind), topic, self._on_message, sensor_qos(_KEPT)
            )
            self._graph.begin()
        except BaseException:
            self.close()
            raise

    def _message_type(self, topic: str) -> str:
        """Waits up to _FIRST_S for a publisher of the topic. Returns the class of sensor_msgs that it sends, "Image" or
        "CompressedImage". TautError where none comes, or it sends something else."""
        end = time.monotonic() + _FIRST_S
        while time.monotonic() < end:
            offered = {
                info.topic_type for info in self._graph.node.get_publishers_info_by_topic(self._graph.topic(topic))
            }
            if found := sorted(offered & set(_KINDS)):
                return _KINDS[found[0]]
            if offered:
                raise TautError(f"{self.name}: is of {', '.join(sorted(offered))}: name one of {' or '.join(_KINDS)}")
            time.sleep(0.02)
        raise TautError(f"{self.name}: nobody publishes it: is the camera's node running, of the same $ROS_DOMAIN_ID?")

    @property
    def dropped(self) -> int:
        """How many frames never came, or were not read in time."""
        return self._drops.count

    def _on_message(self, message: Any) -> None:
        """Callback: queues a message with its arrival time, s of the host's monotonic clock: that of its stamp, if the
        stamp is 0 to _OLDEST_S old by this machine's clock, else now. `clock` says which."""
        now = time.monotonic()
        age_s = self._graph.age_s(message.header.stamp)
        stamped = 0.0 <= age_s < _OLDEST_S
        self.clock = "the messages' stamps" if stamped else "the host's monotonic clock when the message came"
        with self._frame_arrived:
            self._waiting.append((now - age_s if stamped else now, message))
            self._frame_arrived.notify()

    def read(self) -> tuple[Array, float] | None:
        """Waits for the next frame, BGR (height, width, 3) uint8, and its arrival time, s; never None, as a topic does
        not end. TautError where none comes within _NEXT_S, or its encoding is not known."""
        with self._frame_arrived:
            if not self._frame_arrived.wait_for(lambda: bool(self._waiting), _NEXT_S):
                raise TautError(f"{self.name}: no more images: is its camera still there?")
            arrival_s, message = self._waiting.popleft()
        self._drops.add(arrival_s)
        return self._picture(message), arrival_s

    def _picture(self, message: Any) -> Array:
        """Returns the picture of a message, BGR (height, width, 3) uint8: the rows of an Image, or what a
        CompressedImage (which has no field `encoding`) decodes to. TautError where it cannot be read."""
        data = np.frombuffer(message.data, np.uint8)
        if not hasattr(message, "encoding"):
            decoded = cv2.imdecode(data, cv2.IMREAD_COLOR) if len(data) else None
            if decoded is None:
                raise TautError(f"{self.name}: an image cannot be decoded (format '{message.format}')")
            return np.asarray(decoded)
        if message.encoding not in _TO_BGR:
            raise TautError(f"{self.name}: images are {message.encoding}: one of {', '.join(_TO_BGR)} is wanted")
        channels, code = _TO_BGR[message.encoding]
        if not 0 < message.width * channels <= message.step or not 0 < message.height * message.step <= len(data):
            raise TautError(
                f"{self.name}: an image holds {len(data)} bytes for {message.height} rows of {message.step}, which are "
                f"no {message.width} x {message.height} px of {message.encoding}: is its publisher sound?"
            )
        rows = data[: message.height * message.step].reshape(message.height, message.step)
        pixels = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
        return np.ascontiguousarray(pixels) if code is None else np.asarray(cv2.cvtColor(pixels, code))

    def close(self) -> None:
        """Leaves the ROS graph."""
        self._graph.close()
