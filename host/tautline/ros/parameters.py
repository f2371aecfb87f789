"""The parameters of `taut ros`, as ros2_control names those of its controllers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tautline.drivers.ros_graph import library
from tautline.errors import TautError


@dataclass(frozen=True)
class Parameters:
    """The values of the node's parameters."""

    joint: str  # that set-points are of: the tip's bending angle
    command_joint: str  # the motor's
    period_s: float  # a whole number of milliseconds
    timeout_s: float  # without a set-point: the motor comes to rest

    @classmethod
    def of(cls, node: Any) -> Parameters:
        """Declares the parameters on a node of rclpy and reads their values, which --ros-args may have set. TautError
        where one is out of its range."""
        describe = library("rcl_interfaces.msg").ParameterDescriptor
        defaults = {"joints": ["tip"], "command_joints": ["motor"], "update_rate": 250, "cmd_timeout": 0.1}
        try:
            joints, command_joints, rate_hz, timeout_s = (
                node.declare_parameter(name, value, describe(read_only=True)).value for name, value in defaults.items()
            )
        except Exception as error:  # rclpy's own, where the type is another
            raise TautError(f"a parameter cannot be used: {' '.join(str(error).split())}") from error
        for name, names in (("joints", joints), ("command_joints", command_joints)):
            if len(names) != 1 or not names[0]:
                raise TautError(f"parameter {name}: names {len(names)} joints: a node has one axis, name one")
        if joints == command_joints:
            raise TautError(f"parameters joints and command_joints: the tip and its motor are both '{joints[0]}'")
        if not 50 <= rate_hz <= 500:
            raise TautError(f"parameter update_rate: {rate_hz} Hz, and 50 to 500 may be")
        if not 0.01 <= timeout_s <= 2.0:
            raise TautError(f"parameter cmd_timeout: {timeout_s} s, and 0.01 to 2 may be")
        return cls(joints[0], command_joints[0], 1e-3 * round(1e3 / rate_hz), timeout_s)
