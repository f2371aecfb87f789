"""What `taut ros` publishes, as ROS' own messages. Its units are radians, metres and seconds (REP 103)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from tautline.device import wire
from tautline.drivers.ros_graph import library
from tautline.rig import Rig

NS = 10**9  # unit: of a second
_FARTHEST = 500.0  # limit: rad: the board's angles end at 32768 deg, which is 571 rad


def si_per_unit(rig: Rig) -> float:
    """The factor from the unit of q to ROS' SI unit: rad per deg, or m per mm."""
    return math.radians(1.0) if rig.actuator.unit == "deg" else 1e-3


def stamp(time_ns: int) -> Any:
    """A ROS time, ns since its epoch, as a builtin_interfaces/Time."""
    return library("builtin_interfaces.msg").Time(sec=time_ns // NS, nanosec=time_ns % NS)


def joint_state(time_ns: int, positions: Mapping[str, float], frame: str = "") -> Any:
    """A sensor_msgs/JointState at a ROS time, ns. positions: by joint, rad or m; frame: its frame_id."""
    header = library("std_msgs.msg").Header(stamp=stamp(time_ns), frame_id=frame)
    return library("sensor_msgs.msg").JointState(header=header, name=list(positions), position=list(positions.values()))


def point(time_ns: int, u_px: float, v_px: float, sigma_px: float) -> Any:
    """The marker's place in the image as a geometry_msgs/PointStamped at a ROS time, ns: x and y are u and v, px, and z
    is their sigma, px."""
    header = library("std_msgs.msg").Header(stamp=stamp(time_ns), frame_id="image")
    geometry = library("geometry_msgs.msg")
    return geometry.PointStamped(header=header, point=geometry.Point(x=u_px, y=v_px, z=sigma_px))


def position_of(message: Any, joint: str) -> float | None:
    """The joint's position, rad, in a JointState, or the only position of a message without names. None where there is
    none, or it is NaN or not below _FARTHEST in size."""
    names, positions = list(message.name), message.position
    if joint in names:
        index = names.index(joint)
    elif not names and len(positions) == 1:
        index = 0
    else:
        return None
    return float(positions[index]) if index < len(positions) and abs(positions[index]) < _FARTHEST else None


def diagnostics(time_ns: int, name: str, board: str, level: str, says: str, values: Mapping[str, Any]) -> Any:
    """A diagnostic_msgs/DiagnosticArray with one status at a ROS time, ns. name: of the status; board: its hardware id;
    level: "OK", "WARN" or "ERROR"; says: its message; values: by key, those that are None are left out."""
    types = library("diagnostic_msgs.msg")
    rows = [types.KeyValue(key=key, value=_value_text(value)) for key, value in values.items() if value is not None]
    status = types.DiagnosticStatus(
        level=getattr(types.DiagnosticStatus, level), name=name, message=says, hardware_id=board, values=rows
    )
    return types.DiagnosticArray(header=library("std_msgs.msg").Header(stamp=stamp(time_ns)), status=[status])


def _value_text(value: Any) -> str:
    """A value as text for diagnostics; a float with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def axis_values(status: wire.Message) -> dict[str, Any]:
    """An axis' status (tl_wire.h's message) as values for `diagnostics`: mode, fault (None without one) and table in
    words."""
    return {
        "mode": wire.text("MODES", status.mode),
        "fault": wire.fault_meaning(status),
        "table": wire.text("TABLES", status.table),
    }
