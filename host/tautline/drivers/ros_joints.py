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
    watchdog = "none here: the joints' controller goes to its last set-point and holds it"
    rest_s = 0.0
    enable_s = 0.0  # a topic switches nothing

    def __init__(
        self, bus: str, names: Sequence[int | str], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """bus: topics STATES,COMMANDS; names: the joints'; baud, rate_hz: nothing here depends on them. TautError where
        a topic or joint is not there."""
        states, _, commands = bus.partition(",")
        if not states or not commands:
            raise TautError(f"ros:{bus}: name two topics, as in ros:/joint_states,/commands:elbow")
        self._names, self._clock = [str(name) for name in names], clock
        self._came = threading.Condition()
        self._newest: tuple[float, Any] | None = None  # when it was measured, s; the message
        self._used: Any = None
        self._others: set[str] = set()  # joints in messages that have not all of ours
        self._places: list[float] = []  # of each joint, rad or m: measured last,
        self._rests: list[float] = []  # and when it was switched off
        self._told: list[float | None] = [None for _ in names]  # set-points, while they are on
        self._description = ""
        self._counts: list[float] = []  # of each joint, a rad or m
        self._graph = Graph("tautline_motors")
        try:
            self._open(states, commands)
        except BaseException:
            self.close()
            raise

    def _open(self, states: str, commands: str) -> None:
        """Subscribes to the states, publishes to the commands, and waits for both."""
        description = self._subscribe(states)
        where = "are they of this machine, of the same $ROS_DOMAIN_ID, and active?"
        self._find_joints(states, where)
        self._kind = self._command_type(commands, where)
        self._commands = self._graph.node.create_publisher(self._message_type(), commands, 10)
        self._wait_for(lambda: self._commands.get_subscription_count() > 0, _FIRST_S)
        self._places = [math.nan for _ in self._names]
        if any(math.isnan(m.q) for m in self.measure()):
            raise TautError(f"ros: {states} has no position of {', '.join(self._names)}: is the hardware active?")
        self._rests = list(self._places)
        described = self._read_description(description)
        self.drives = [_drive(name, described.get(name, {})) for name in self._names]
        self._counts = [float(drive.counts_per_turn) / (1.0 if drive.per == "m" else math.tau) for drive in self.drives]

    def _subscribe(self, states: str) -> str:
        """Subscribes to the states and to the robot's description, and begins to listen. Returns the topic of the
        description, which is beside the states'."""
        node, qos = self._graph.node, library("rclpy.qos")
        node.create_subscription(library("sensor_msgs.msg").JointState, states, self._on_state, sensor_qos())
        kept = qos.QoSProfile(depth=1, durability=qos.DurabilityPolicy.TRANSIENT_LOCAL)
        description = f"{states.rpartition('/')[0]}/{_DESCRIPTION}"
        node.create_subscription(library("std_msgs.msg").String, description, self._describe, kept)
        self._graph.begin()
        return description

    def _find_joints(self, states: str, where: str) -> None:
        """Waits for a state that has all joints. TautError that says what came instead; where: its advice if nothing
        did."""
        if not self._wait_for(lambda: self._newest is not None, _FIRST_S):
            missing = ", ".join(name for name in self._names if name not in self._others)
            if self._others and missing:
                raise TautError(f"ros: no joint {missing} in {states}, which names {', '.join(sorted(self._others))}")
            if self._others:
                ours = ", ".join(self._names)
                raise TautError(f"ros: no message on {states} has positions of {ours}: name joints of one broadcaster")
            raise TautError(f"ros: no joint states came on {states}: {where}")

    def _read_description(self, topic: str) -> dict[str, dict[str, str]]:
        """The joints' attributes by name, from the robot's description; {} where nobody publishes one. A publisher may
        be found a moment later than the states."""
        if not self._wait_for(lambda: bool(self._description), _DESCRIBED_S):
            if self._graph.node.count_publishers(topic):
                raise TautError(f"ros: {topic} is published but did not come: run the command again")
            return {}
        described = _joints_of_description(self._description)
        for name in self._names:
            if name not in described:
                raise TautError(f"ros: {topic} has no joint {name}: check its name")
        return described

    def _command_type(self, commands: str, where: str) -> str:
        """The type of message that the subscribers of set-points take, Float64MultiArray where they take both.
        TautError without any; where: its advice."""
        node = self._graph.node
        topic = self._graph.topic(commands)

        def kinds() -> set[str]:
            return {info.topic_type for info in node.get_subscriptions_info_by_topic(topic)}

        if not self._wait_for(lambda: bool(kinds()), _FIRST_S):
            raise TautError(f"ros: nobody takes set-points on {commands}: {where}")
        found = kinds() & {_ARRAY, _STATE}
        if not found:
            raise TautError(f"ros: {commands} takes {', '.join(sorted(kinds()))}: name one of {_ARRAY} or {_STATE}")
        return min(found, key=(_ARRAY, _STATE).index)

    def _message_type(self) -> Any:
        """The class of the set-points' message."""
        package, _, name = self._kind.split("/")
        return getattr(library(f"{package}.msg"), name)

    @staticmethod
    def _wait_for(there: Callable[[], bool], within_s: float) -> bool:
        """Waits until `there()` is true, at most this long; whether it is."""
        end = time.monotonic() + within_s
        while not there() and time.monotonic() < end:
            time.sleep(0.005)
        return there()

    def _on_state(self, message: Any) -> None:
        """Takes a joint state, as old as its stamp says if that is of this machine's clock. Messages without these
        joints are ignored."""
        if not set(self._names) <= set(message.name[: len(message.position)]):
            self._others |= set(message.name)
            return
        age_s = self._graph.age_s(message.header.stamp)
        with self._came:
            self._newest = self._clock() - (age_s if 0.0 <= age_s < _OLDEST_S else 0.0), message
            self._came.notify()

    def _describe(self, message: Any) -> None:
        """Takes in the robot's description, a URDF."""
        self._description = message.data

    def measure(self) -> list[Measured]:
        """The joints' newest state, waiting for one that was not used before. Missed where none comes."""
        with self._came:
            if not self._came.wait_for(
                lambda: self._newest is not None and self._newest[1] is not self._used, _ANSWER_S
            ):
                raise Missed("no joint states")
            assert self._newest is not None
            t_s, self._used = self._newest
        return [self._measured(axis, t_s, self._used) for axis in range(len(self._names))]

    def _measured(self, axis: int, t_s: float, message: Any) -> Measured:
        """A joint's position and speed, counts and counts/s (rad or m until its counts are known). Speed is 0 where
        none is told; a joint whose position is not finite keeps the last one and has a fault."""
        at = list(message.name).index(self._names[axis])
        place = float(message.position[at])
        fault = "" if math.isfinite(place) else "its position is not known: is the hardware active?"
        if not fault:
            self._places[axis] = place
        speed = float(message.velocity[at]) if at < len(message.velocity) else 0.0
        counts = self._counts[axis] if self._counts else 1.0
        return Measured(t_s, self._places[axis] * counts, speed * counts if math.isfinite(speed) else 0.0, 0.0, fault)

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Publishes where each joint is to be; None leaves one's set-point as it is."""
        for axis, goal in enumerate(goals):
            if goal is not None:
                self._told[axis] = goal.q / self._counts[axis]
        self._send()

    def _send(self) -> None:
        """Publishes the set-points of all joints, rad or m, in one message."""
        message = self._message_type()()
        if self._kind == _ARRAY:  # those that are off stay where they were: the newest place gives way under a load
            message.data = [rest if told is None else told for told, rest in zip(self._told, self._rests, strict=True)]
        else:
            on = [(name, told) for name, told in zip(self._names, self._told, strict=True) if told is not None]
            message.name, message.position = [name for name, _ in on], [told for _, told in on]
            message.header.stamp = self._graph.node.get_clock().now().to_msg()
        self._commands.publish(message)

    def enable(self, axis: int, on: bool) -> None:
        """Switches the axis; a topic switches no torque, so that on and off alike the joint is told to stay where it
        is."""
        if not on and self._told[axis] is None:
            return
        self._told[axis] = self._rests[axis] = self._places[axis]
        self._send()
        if not on:
            self._told[axis] = None

    def stop(self) -> None:
        all_off(len(self._names), self.enable)

    def close(self) -> None:
        self._graph.close()


def _joints_of_description(text: str) -> dict[str, dict[str, str]]:
    """Type and limits by joint from a URDF's text; {} where that is empty. TautError where it is no URDF."""
    try:
        joints = ElementTree.fromstring(text).iterfind("joint") if text else ()
        return {
            joint.get("name", ""): {"type": joint.get("type", "")}
            | dict(limit.attrib if (limit := joint.find("limit")) is not None else {})
            for joint in joints
        }
    except ElementTree.ParseError as error:
        raise TautError(f"ros: {_DESCRIPTION} holds no URDF ({error}): mend it, or stop who publishes it") from error


def _drive(name: str, said: dict[str, str]) -> Drive:
    """The drive of a joint by its URDF attributes, rad or m and s; without any, a joint that turns without an end. Its
    speed is 1 turn/s or 0.1 m/s unless the description says another."""
    slides = said.get("type") == "prismatic"
    per, counts = ("m", _METRE) if slides else ("turn", _TURN)
    unit = counts if slides else counts / math.tau

    def limit(key: str) -> float:
        """In counts or counts/s; 0 where the description has none."""
        try:
            value = float(said.get(key, 0.0))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise TautError(f"joint {name}: its description's limit {key} is {said[key]!r}, expected a number")
        return value * unit

    speed = limit("velocity") or (_METRES_S if slides else _TURNS_S) * counts
    low, high = -RANGE, RANGE
    if said.get("type") in ("prismatic", "revolute"):
        low, high = max(limit("lower"), -RANGE), min(limit("upper"), RANGE)
    limits = DriveLimits(low, high, speed, STARTS * speed)
    kind = said.get("type") or "joint without a description"
    return Drive(name, kind, "-", counts, limits, referenced=True, per=per)
