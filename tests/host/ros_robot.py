"""A robot as ros2_control shows it: a broadcaster of joint states, a controller that takes positions, a description.

In virtual time beside the other emulators: a state every 10 ms of it, set-points as they come. As a process of its own:

    python ros_robot.py NAMESPACE

it turns by the wall clock until its standard input is closed.
"""

from __future__ import annotations

import sys
import threading
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from motor_emulators import Ills, Motor

_STATE_STEPS, _TURN, _WAIT_S = 10, 4096, 2.0
_URDF = """<joint name="{name}" type="{kind}"><limit {limit}/></joint>"""


@dataclass
class Joint(Motor):
    """A motor that says where it is every so many of its milliseconds."""

    says: Callable[[], None] | None = None

    def step(self) -> None:
        super().step()
        if self.says is not None and len(self.course) % _STATE_STEPS == 0:
            self.says()


class RosBus:
    """What stands where the other emulators have a pty or a virtual CAN bus."""

    def __init__(self, path: str) -> None:
        self.path, self.ills = path, Ills()
        self.taken = 0
        self.sent: Callable[[], int] = lambda: self.taken

    def settle(self) -> None:
        """Waits until all set-points that were published have been taken."""
        end = time.monotonic() + _WAIT_S
        while self.taken < self.sent() and time.monotonic() < end:
            time.sleep(2e-5)


class RosRobot:
    """Joints joint_1, joint_2, ... in rad, 4096 counts a turn, or in m, 1000 counts a mm (kind "prismatic"). It takes
    arrays, as a forward controller does, or joint states by their names (`by_name`), unless they are old."""

    def __init__(
        self,
        motors: list[Motor],
        namespace: str,
        kind: str = "revolute",
        described: bool = True,
        by_name: bool = False,
    ) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
            from sensor_msgs.msg import JointState
            from std_msgs.msg import Float64MultiArray, String

            self.motors, self._state = motors, JointState
            self._unit = 1e-6 if kind == "prismatic" else 2.0 * np.pi / _TURN
            self.names = [f"joint_{k + 1}" for k in range(len(motors))]
            self.bus = RosBus(f"{namespace}/joint_states,{namespace}/commands")
            self._context = rclpy.Context()
            self._context.init()
            self._node = rclpy.create_node("robot", context=self._context)
            kept = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            unsure = QoSProfile(depth=10, reliability=ReliabilityPolicy.BEST_EFFORT)
            self._states = self._node.create_publisher(JointState, f"{namespace}/joint_states", unsure)
            self._string, self._kept, self._description = String, kept, f"{namespace}/robot_description"
            if by_name:
                self._node.create_subscription(JointState, f"{namespace}/commands", self._take_named, 10)
            else:
                self._node.create_subscription(Float64MultiArray, f"{namespace}/commands", self._take, 10)
        self._kind = kind
        if described:
            self.describe(self.names)
        self._failed = False
        self.stamped_s: float | None = None  # how old its states say they are, where they say it
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._thread = threading.Thread(target=self._executor.spin, daemon=True)
        self._thread.start()
        for motor in motors:
            motor.on = True  # a position controller holds what it was told last
            motor.rest()
        self._closed = False
        if isinstance(motors[0], Joint):
            motors[0].says = self.say
            threading.Thread(target=self._before, daemon=True).start()

    def _before(self) -> None:
        """Until virtual time begins states come by the wall clock: a broadcaster waits for nobody."""
        while not self.motors[0].course and not self._closed:
            self.say()
            time.sleep(1e-3 * _STATE_STEPS)

    def describe(self, names: list[str]) -> None:
        """Publishes its description; without names a publisher is there that says nothing."""
        described = self._node.create_publisher(self._string, self._description, self._kept)
        limit = f'lower="{-20000 * self._unit}" upper="{20000 * self._unit}" '
        limit += f'velocity="{self.motors[0].speed_most * self._unit}" effort="1"'
        joints = [_URDF.format(name=name, kind=self._kind, limit=limit) for name in names]
        if joints:
            described.publish(self._string(data=f'<robot name="robot">{"".join(joints)}</robot>'))

    def fail(self) -> None:
        """Its hardware is deactivated: its broadcaster knows no position any more."""
        self._failed = True
        for motor in self.motors:
            motor.on = False

    def say(self) -> None:
        message = self._state(name=["wheel", *reversed(self.names)])
        places = [np.nan if self._failed else self._unit * motor.counts for motor in reversed(self.motors)]
        message.position, message.velocity = (
            [0.0, *places],
            [0.0, *(self._unit * m.speed for m in reversed(self.motors))],
        )
        if self.stamped_s is not None:
            at_ns = self._node.get_clock().now().nanoseconds - round(1e9 * self.stamped_s)
            message.header.stamp.sec, message.header.stamp.nanosec = divmod(at_ns, 10**9)
        self._states.publish(self._state(name=["gripper"], position=[0.5]))  # another broadcaster's, and a third one's
        for piece in self.bus.ills.through(message):  # none is damaged: DDS has a check of its own
            self._states.publish(piece)
        self._states.publish(self._state(name=self.names, effort=[0.1] * len(self.names)))

    def _take_named(self, message: Any) -> None:
        at = message.header.stamp
        age_s = 1e-9 * self._node.get_clock().now().nanoseconds - (at.sec + 1e-9 * at.nanosec)
        for name, place in zip(message.name, message.position, strict=True):
            if 0.0 <= age_s < _WAIT_S:
                self.motors[self.names.index(name)].aim(place / self._unit)
        self.bus.taken += 1

    def _take(self, message: Any) -> None:
        assert len(message.data) == len(self.motors)
        if not self.bus.ills.pulled and not self.bus.ills.loses():
            for motor, place in zip(self.motors, message.data, strict=True):
                motor.aim(place / self._unit)
        self.bus.taken += 1

    def close(self) -> None:
        self._closed = True
        self._executor.shutdown()
        self._thread.join()
        self._node.destroy_node()
        self._context.try_shutdown()


def main() -> None:
    motor = Motor()
    robot = RosRobot([motor], sys.argv[1])
    ended = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    due = time.monotonic()
    while not ended.is_set():
        for _ in range(_STATE_STEPS):
            motor.step()
        robot.say()
        due += 1e-3 * _STATE_STEPS
        time.sleep(max(due - time.monotonic(), 0.0))


if __name__ == "__main__":
    main()
