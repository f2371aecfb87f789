"""`taut ros`: set-points of the tip from a topic go through the tables of an axis; what motor and tip do comes back.

Set-points are sent on as they come, once in a cycle, each once: the board leads the motor from one to the next, and
brings it to rest where none comes. States are the board's telemetry, one sample a cycle, stamped by its own clock.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from tautline import tables
from tautline.device import wire
from tautline.device.stream import SetPointStream
from tautline.drivers.ros_graph import Graph, library, sensor_qos
from tautline.geometry import pose
from tautline.live.in_use import Following
from tautline.live.setup import Frame, Live
from tautline.model import Model
from tautline.quality import Verdict
from tautline.rig import MARKER
from tautline.ros import messages
from tautline.ros.parameters import Parameters
from tautline.tracking import State

_CLOCK_READS = 3
_DIAGNOSED_S = 1.0  # between two messages, as diagnostic tools expect


class Node:
    """The topics of one axis. Messages come on the graph's thread, telemetry on the board's, frames on the camera's;
    `run` sends and publishes."""

    def __init__(self, graph: Graph, parameters: Parameters, live: Live, model: Model) -> None:
        """Creates the publishers of joint states, marker and diagnostics, subscribes to set-points, and has the board
        send telemetry each millisecond. live: the open board, with a camera or not; model: that the axis' table is
        made from."""
        self._graph, self.parameters, self._live, self._model = graph, parameters, live, model
        self.received = self.unusable = 0  # set-points: with a position of the joint, and without one
        self.replaced = 0  # by a newer one before they were sent: two in one cycle
        self._pending_rad: float | None = None  # rad, not sent on yet
        self._set_point_lock = threading.Lock()  # of _pending_rad and `replaced`
        self._batches: deque[wire.Message] = deque()  # telemetry that has not been published yet
        self._published_us = -1  # board time of the last sample that was published
        self._diagnosed_s = -math.inf  # time.monotonic() of the last diagnostics
        self._c_deg: float | None = None  # as the camera saw it last
        sensor, geometry = library("sensor_msgs.msg"), library("geometry_msgs.msg")
        node = graph.node
        names = ("joint_states", "measured_js", "setpoint_js", "motor/setpoint_js")
        self._joints = {name: node.create_publisher(sensor.JointState, name, 10) for name in names}
        diagnostic = library("diagnostic_msgs.msg").DiagnosticArray
        self._diagnostics = node.create_publisher(diagnostic, "/diagnostics", 10)
        if live.marker_source is not None:
            self._tracked = node.create_publisher(sensor.JointState, "tracked_js", 10)
            self._marker = node.create_publisher(geometry.PointStamped, "tracked_px", 10)
        live.board.listen("batch", self._batches.append)
        live.board.ask("telemetry", axis=live.axis, divider=1)
        node.create_subscription(sensor.JointState, "servo_jp", self._on_set_point, sensor_qos())

    def run(self, ended: Callable[[], bool], following: Following | None = None) -> dict[str, Any]:
        """Sends set-points and publishes, once a period, until `ended()` is true; then brings the motor to rest and
        switches it off. following: the tracker that runs beside, for diagnostics; None without a camera. Returns the
        summary that `taut stream --json` gives, with the counts of set-points. TautError where the axis has a fault or
        the board is gone."""
        parameters = self.parameters
        with SetPointStream(self._live.board, self._live.axis, parameters.timeout_s) as points:
            self._graph.begin()
            while not ended():
                self._send(points)
                self._publish()
                self._diagnose(points, following)
                points.pace(parameters.period_s)
        return points.summary() | self._counts()

    def _send(self, points: SetPointStream) -> None:
        """Sends the newest set-point that has come, if any. If the axis is still coming to rest after a silence, it is
        kept for the next cycle, unless a newer one has come meanwhile."""
        with self._set_point_lock:
            newest, self._pending_rad = self._pending_rad, None
        if newest is None or points.send(math.degrees(newest)):
            return
        with self._set_point_lock:
            if self._pending_rad is None:
                self._pending_rad = newest
            else:
                self.replaced += 1

    def _counts(self) -> dict[str, int]:
        """How many set-points came: `received`, with a position of the joint; of these `replaced` by a newer one before
        they were sent; and `unusable`, without such a position."""
        return {"received": self.received, "unusable": self.unusable, "replaced": self.replaced}

    def _on_set_point(self, message: Any) -> None:
        """Callback of the subscription: keeps the joint's position in a JointState as the next set-point, in place of
        one that has not been sent yet, and counts the message."""
        position = messages.position_of(message, self.parameters.joint)
        if position is None:
            self.unusable += 1
            return
        self.received += 1
        with self._set_point_lock:
            self.replaced += self._pending_rad is not None
            self._pending_rad = position

    def _ros_time_ns(self, t_us: float) -> int:
        """Converts a board time, us, to ROS time, ns, by this host's monotonic clock, which the board's clock is
        aligned with. The ROS clock is read between two readings of the monotonic one, _CLOCK_READS times; the quickest
        of these counts."""
        clock = self._graph.node.get_clock()
        reads = [(time.monotonic_ns(), clock.now().nanoseconds, time.monotonic_ns()) for _ in range(_CLOCK_READS)]
        before, now, after = min(reads, key=lambda read: read[2] - read[0])
        middle = (before + after) // 2
        return int(now + 1000 * t_us - 1000 * self._live.board.clock.board_us(1e-9 * middle))

    def _publish(self) -> None:
        """Publishes the telemetry that has come since the last call: the first sample of each period, with the time at
        which the board took it. Other axes' samples are dropped."""
        if not self._batches:
            return
        # One offset for all samples of this call, so that their times keep their distances.
        board_began_ns, period_us = self._ros_time_ns(0.0), round(1e6 * self.parameters.period_s)
        while self._batches:
            batch = self._batches.popleft()
            if batch.axis != self._live.axis:
                continue
            for i in range(batch.count):
                t_us = batch.t_us + i * batch.period_us
                if t_us // period_us > self._published_us // period_us:
                    self._published_us = t_us
                    time_ns = board_began_ns + 1000 * t_us
                    self._publish_state(time_ns, *(float(column[i]) for column in _columns(batch)))

    def _publish_state(self, time_ns: int, q: float, q_ref: float, c_deg: float, c_ref_deg: float) -> None:
        """Publishes one telemetry sample on the four topics of joint states, in SI units. time_ns: ROS time; q, q_ref:
        the motor's position and set-point, counts; c_deg, c_ref_deg: the tip's, deg."""
        tip, motor = self.parameters.joint, self.parameters.command_joint
        si_per_count = messages.si_per_unit(self._live.rig) * self._live.resolution
        c, c_ref = math.radians(c_deg), math.radians(c_ref_deg)
        for name, positions in (
            ("joint_states", {motor: si_per_count * q, tip: c}),
            ("measured_js", {tip: c}),
            ("setpoint_js", {tip: c_ref}),
            ("motor/setpoint_js", {motor: si_per_count * q_ref}),
        ):
            self._joints[name].publish(messages.joint_state(time_ns, positions))

    def saw(self, frame: Frame) -> None:
        """Publishes what a frame shows, if the marker was found: its place in the image, and the tip's angle by its
        pose, with the time of the scene. Only the camera's thread may call it: the search for the angle begins at the
        last one."""
        seen = frame.sighting
        if not seen.valid:
            return
        time_ns = self._ros_time_ns(frame.t_us - 1e6 * self._model.delay_of(MARKER))
        image_px = np.array([[seen.u_px, seen.v_px]])
        self._c_deg = float(pose(self._model.rig, image_px, start_deg=self._c_deg)[0][0])
        self._marker.publish(messages.point(time_ns, seen.u_px, seen.v_px, seen.sigma_px))
        angle = {self.parameters.joint: math.radians(self._c_deg)}
        self._tracked.publish(messages.joint_state(time_ns, angle))

    def _diagnose(self, points: SetPointStream, following: Following | None) -> None:
        """Publishes the state of board and calibration as diagnostics; does nothing within _DIAGNOSED_S of the last
        time. If the axis has a fault it then raises a TautError."""
        now = time.monotonic()
        if now < self._diagnosed_s + _DIAGNOSED_S:
            return
        self._diagnosed_s = now
        board, row = self._live.board, None if following is None else following.row
        status = board.status(self._live.axis)
        level, says = self._diagnostic_level(status, following)
        bus = board.bus()
        values = {
            "model": tables.model_id(self._model).hex(),
            "verdict": self._model.quality.verdict.value,
            "tracking": None if row is None else row.state.value,
            "reason": row.reason if row is not None and row.reason else None,
            "offset": None if row is None else row.offset,
            "scale": None if row is None else row.scale,
            **messages.axis_values(status),
            **self._counts(),
            "sent": points.sent,
            "refused": points.refused,
            "silences": points.silences,
            **{f"bus_{key}": bus[key] for key in ("rate_hz", "jitter_s", "missed", "late", "lag_s") if key in bus},
        }
        name = f"{self._graph.name}: {self.parameters.joint}"
        time_ns = self._graph.node.get_clock().now().nanoseconds
        self._diagnostics.publish(messages.diagnostics(time_ns, name, board.where, level, says, values))
        if status.fault:
            board.check_fault(self._live.axis)

    def _diagnostic_level(self, status: wire.Message, following: Following | None) -> tuple[str, str]:
        """The level for diagnostics, "OK", "WARN" or "ERROR", and its reason in words: the worst of the axis' fault,
        the calibration's verdict and the tracker's state. following: None where no camera tracks."""
        verdict = self._model.quality.verdict
        if status.fault:
            return "ERROR", wire.fault(status)
        if verdict is Verdict.UNUSABLE:
            return "ERROR", "the model's calibration is unusable"
        if following is not None:
            row = following.row
            if following.lost or following.beyond:
                return "WARN", following.lost or following.beyond
            if row is not None and row.state is not State.TRUSTED:
                return "WARN", f"model {row.state.value}: {row.reason}"
        if verdict is Verdict.DOUBTFUL:
            return "WARN", "the model's calibration is doubtful"
        return "OK", f"model {verdict.value}"


def _columns(batch: wire.Message) -> tuple[Any, ...]:
    """The columns of a batch of telemetry that are published, each (samples,): the motor's position and set-point,
    counts, and the tip's angle and set-point, deg."""
    return batch.q, batch.q_ref, batch.c_est, batch.c_ref
