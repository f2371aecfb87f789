"""Joints of somebody's ROS 2 robot: their states from a topic, set-points to another, as ros2_control has them.

BUS is STATES,COMMANDS: a topic of sensor_msgs/JointState, and one whose subscriber takes std_msgs/Float64MultiArray (a
forward or position controller: the joints named are all of its own, in its order) or JointState. Type and limits of a
joint are the robot's description's, where it is published. A count is 1/4096 turn, or 1 um.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any
from xml.etree import ElementTree

from tautline.drivers.drives import RANGE, STARTS, Clock, Drive, DriveLimits, Goal, Measured, Missed, all_off
from tautline.drivers.ros_graph import Graph, library, sensor_qos
from tautline.errors import TautError

BAUD, RATE_HZ = 0, 100.0
_DESCRIPTION = "robot_description"  # beside the states
_TURN, _METRE = 4096, 1_000_000  # counts
_TURNS_S, _METRES_S = 1.0, 0.1  # prior: a joint's speed, where no description says it
# tolerance: the waits for topics, a description and a state; a stamp that is older is of another clock.
_FIRST_S, _DESCRIBED_S, _ANSWER_S, _OLDEST_S = 5.0, 1.0, 0.05, 0.1
_ARRAY, _STATE = "std_msgs/msg/Float64MultiArray", "sensor_msgs/msg/JointState"


class RosJoints:
    """Joints of a ROS 2 robot, as `Drives` (drives.py)."""

    watchdog = "none here: the joints' controller goes to its last set-point and holds it"
    rest_s = 0.0
    enable_s = 0.0  # a topic switches nothing

    def __init__(
        self, bus: str, names: Sequence[int | str], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """Makes a node of its own and finds the joints on the graph (`drives`). bus: topics STATES,COMMANDS; names: of
        the joints; baud, rate_hz: as every driver takes them, unused. TautError where a topic or joint is not there."""
        states, _, commands = bus.partition(",")
        if not states or not commands:
            raise TautError(f"ros:{bus}: name two topics, as in ros:/joint_states,/commands:elbow")
        self._names, self._clock = [str(name) for name in names], clock
        self._state_arrived = threading.Condition()
        self._newest: tuple[float, Any] | None = None  # when it was measured, s; the message
        self._used: Any = None  # the message that was measured from last
        self._other_joints: set[str] = set()  # joints in messages that have not all of ours
        self._positions: list[float] = []  # of each joint, rad or m, as it was measured last
        self._off_positions: list[float] = []  # where each was switched off
        self._set_points: list[float | None] = [None for _ in names]  # None while a joint is off
        self._description = ""
        self._counts: list[float] = []  # of each joint, in a rad or m
        self._graph = Graph("tautline_motors")
        try:
            self._open(states, commands)
        except BaseException:
            self.close()
            raise

    def _open(self, states: str, commands: str) -> None:
        """Subscribes to the topic `states`, publishes on `commands`, waits until both have a partner, and sets `drives`
        to what the joints are. TautError that says what is missing."""
        description = self._subscribe(states)
        advice = "are they of this machine, of the same $ROS_DOMAIN_ID, and active?"
        self._find_joints(states, advice)
        self._kind = self._command_type(commands, advice)
        self._commands = self._graph.node.create_publisher(self._message_type(), commands, 10)
        self._wait_for(lambda: self._commands.get_subscription_count() > 0, _FIRST_S)
        self._positions = [math.nan for _ in self._names]
        if any(math.isnan(m.q) for m in self.measure()):
            raise TautError(f"ros: {states} has no position of {', '.join(self._names)}: is the hardware active?")
        self._off_positions = list(self._positions)
        described = self._read_description(description)
        self.drives = [_drive_of_joint(name, described.get(name, {})) for name in self._names]
        self._counts = [float(drive.counts_per_turn) / (1.0 if drive.per == "m" else math.tau) for drive in self.drives]

    def _subscribe(self, states: str) -> str:
        """Subscribes to the joint states and to the robot's description and starts the callbacks. Returns the
        description's topic, which is in the same namespace as the states'."""
        node, qos = self._graph.node, library("rclpy.qos")
        node.create_subscription(library("sensor_msgs.msg").JointState, states, self._on_state, sensor_qos())
        kept = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        description = f"{states.rpartition('/')[0]}/{_DESCRIPTION}"
        node.create_subscription(library("std_msgs.msg").String, description, self._on_description, kept)
        self._graph.begin()
        return description

    def _find_joints(self, states: str, advice: str) -> None:
        """Waits for a joint state that has all our joints. TautError that says what came instead; `advice` is appended
        if nothing came."""
        if not self._wait_for(lambda: self._newest is not None, _FIRST_S):
            missing = ", ".join(name for name in self._names if name not in self._other_joints)
            if self._other_joints and missing:
                raise TautError(
                    f"ros: no joint {missing} in {states}, which names {', '.join(sorted(self._other_joints))}"
                )
            if self._other_joints:
                ours = ", ".join(self._names)
                raise TautError(f"ros: no message on {states} has positions of {ours}: name joints of one broadcaster")
            raise TautError(f"ros: no joint states came on {states}: {advice}")

    def _read_description(self, topic: str) -> dict[str, dict[str, str]]:
        """Returns type and limits by joint (see `_joints_of_description`) from the robot's description on `topic`; {}
        where nobody publishes one. Waits for it up to _DESCRIBED_S, as its publisher may be found later than the
        states'. TautError where it is published but does not come, or lacks a joint."""
        if not self._wait_for(lambda: bool(self._description), _DESCRIBED_S):
            if self._graph.node.count_publishers(topic):
                raise TautError(f"ros: {topic} is published but did not come: run the command again")
            return {}
        described = _joints_of_description(self._description)
        for name in self._names:
            if name not in described:
                raise TautError(f"ros: {topic} has no joint {name}: check its name")
        return described

    def _command_type(self, commands: str, advice: str) -> str:
        """Returns the message type, _ARRAY or _STATE, that subscribers of the topic `commands` take; _ARRAY where they
        take both. TautError where nobody subscribes within _FIRST_S (`advice` is appended), or subscribers take
        neither."""
        node = self._graph.node
        topic = self._graph.topic(commands)

        def subscriber_types() -> set[str]:
            """Message types of the topic's subscribers."""
            return {info.topic_type for info in node.get_subscriptions_info_by_topic(topic)}

        if not self._wait_for(lambda: bool(subscriber_types()), _FIRST_S):
            raise TautError(f"ros: nobody takes set-points on {commands}: {advice}")
        found = subscriber_types() & {_ARRAY, _STATE}
        if not found:
            raise TautError(
                f"ros: {commands} takes {', '.join(sorted(subscriber_types()))}: name one of {_ARRAY} or {_STATE}"
            )
        return min(found, key=(_ARRAY, _STATE).index)

    def _message_type(self) -> Any:
        """Imports the Python class of the set-points' message type, which is named "PACKAGE/msg/NAME"."""
        package, _, name = self._kind.split("/")
        return getattr(library(f"{package}.msg"), name)

    @staticmethod
    def _wait_for(condition: Callable[[], bool], within_s: float) -> bool:
        """Polls `condition` until it is true or within_s are over; returns whether it is true."""
        end = time.monotonic() + within_s
        while not condition() and time.monotonic() < end:
            time.sleep(0.005)
        return condition()

    def _on_state(self, message: Any) -> None:
        """Callback: keeps a joint state with the time of its measurement: its stamp's if that seems to be of this
        machine's clock (0 to _OLDEST_S old), else now. Of a message that lacks one of our joints only the names are
        kept, for errors."""
        if not set(self._names) <= set(message.name[: len(message.position)]):
            self._other_joints |= set(message.name)
            return
        age_s = self._graph.age_s(message.header.stamp)
        with self._state_arrived:
            self._newest = self._clock() - (age_s if 0.0 <= age_s < _OLDEST_S else 0.0), message
            self._state_arrived.notify()

    def _on_description(self, message: Any) -> None:
        """Callback: keeps the robot's description, a URDF."""
        self._description = message.data

    def measure(self) -> list[Measured]:
        """Returns every joint's newest state, in the order of the names; waits up to _ANSWER_S for one that was not
        returned before. Missed where none comes."""
        with self._state_arrived:
            if not self._state_arrived.wait_for(
                lambda: self._newest is not None and self._newest[1] is not self._used, _ANSWER_S
            ):
                raise Missed("no joint states")
            assert self._newest is not None
            t_s, self._used = self._newest
        return [self._measured(axis, t_s, self._used) for axis in range(len(self._names))]

    def _measured(self, axis: int, t_s: float, message: Any) -> Measured:
        """Converts one joint of a joint state to counts and counts/s; leaves it in rad or m as long as the description
        has not been read. Speed is 0 where the message has none. A joint whose position is not finite keeps the last
        one and has a fault."""
        at = list(message.name).index(self._names[axis])
        position = float(message.position[at])
        fault = "" if math.isfinite(position) else "its position is not known: is the hardware active?"
        if not fault:
            self._positions[axis] = position
        speed = float(message.velocity[at]) if at < len(message.velocity) else 0.0
        if not math.isfinite(speed):
            speed = 0.0
        counts_per_unit = self._counts[axis] if self._counts else 1.0
        q = self._positions[axis] * counts_per_unit
        return Measured(t_s, q=q, velocity=speed * counts_per_unit, current_ma=0.0, fault=fault)

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Publishes where each joint is to be; for None a joint's set-point stays as it is."""
        for axis, goal in enumerate(goals):
            if goal is not None:
                self._set_points[axis] = goal.q / self._counts[axis]
        self._publish()

    def _publish(self) -> None:
        """Publishes the set-points, rad or m, of all joints that are on, in one message. An array must have all joints:
        those that are off get the position at which they were switched off."""
        message = self._message_type()()
        if self._kind == _ARRAY:  # not the newest position of those that are off: it would give way under a load
            message.data = [
                rest if told is None else told for told, rest in zip(self._set_points, self._off_positions, strict=True)
            ]
        else:
            on = [(name, told) for name, told in zip(self._names, self._set_points, strict=True) if told is not None]
            message.name, message.position = [name for name, _ in on], [told for _, told in on]
            message.header.stamp = self._graph.node.get_clock().now().to_msg()
        self._commands.publish(message)

    def enable(self, axis: int, on: bool) -> None:
        """Switches the axis on or off. As a topic cannot switch torque, both tell the joint to stay where it is;
        switched off, it gets no further set-points of its own. Does nothing for a joint that is off already."""
        if not on and self._set_points[axis] is None:
            return
        self._set_points[axis] = self._off_positions[axis] = self._positions[axis]
        self._publish()
        if not on:
            self._set_points[axis] = None

    def stop(self) -> None:
        """Tells all joints to stay where they are."""
        all_off(len(self._names), self.enable)

    def close(self) -> None:
        """Leaves the graph; joints hold their last set-points."""
        self._graph.close()


def _joints_of_description(text: str) -> dict[str, dict[str, str]]:
    """Reads for each joint in a URDF's text its "type" and the attributes of its <limit> (lower, upper, velocity,
    effort), as they stand there. {} where the text is empty. TautError where it is no XML."""
    try:
        joints = ElementTree.fromstring(text).iterfind("joint") if text else ()
        return {
            joint.get("name", ""): {"type": joint.get("type", "")}
            | dict(limit.attrib if (limit := joint.find("limit")) is not None else {})
            for joint in joints
        }
    except ElementTree.ParseError as error:
        raise TautError(f"ros: {_DESCRIPTION} holds no URDF ({error}): mend it, or stop who publishes it") from error


def _drive_of_joint(name: str, described: dict[str, str]) -> Drive:
    """Makes the drive of a joint, in counts, from its type and its limits in rad or m, and s (`described`, as of
    `_joints_of_description`). Where that is {} the joint turns without an end; without a speed limit it has 1 turn/s or
    0.1 m/s."""
    slides = described.get("type") == "prismatic"
    per, counts = ("m", _METRE) if slides else ("turn", _TURN)
    counts_per_unit = counts if slides else counts / math.tau

    def limit(key: str) -> float:
        """Returns a limit in counts or counts/s; 0 where the description has none. TautError where it is no finite
        number."""
        try:
            value = float(described.get(key, 0.0))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TautError(f"joint {name}: its description's limit {key} is {described[key]!r}, expected a number")
        return value * counts_per_unit

    speed = limit("velocity") or (_METRES_S if slides else _TURNS_S) * counts
    low, high = -RANGE, RANGE
    if described.get("type") in ("prismatic", "revolute"):
        low, high = max(limit("lower"), -RANGE), min(limit("upper"), RANGE)
    limits = DriveLimits(low, high, speed, STARTS * speed)
    kind = described.get("type") or "joint without a description"
    return Drive(
        name, model=kind, firmware="-", counts_per_turn=counts, limits=limits, referenced=True, per=per
    )  # fmt: skip
