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


def si(rig: Rig) -> float:
    """SI units in one of the motor's: rad per deg, or m per mm."""
    return math.radians(1.0) if rig.actuator.unit == "deg" else 1e-3


def stamp(time_ns: int) -> Any:
    return library("builtin_interfaces.msg").Time(sec=time_ns // NS, nanosec=time_ns % NS)


def joint_state(time_ns: int, positions: Mapping[str, float], frame: str = "") -> Any:
    """A JointState; positions by joint, rad or m."""
    header = library("std_msgs.msg").Header(stamp=stamp(time_ns), frame_id=frame)
    return library("sensor_msgs.msg").JointState(header=header, name=list(positions), position=list(positions.values()))


def point(time_ns: int, u_px: float, v_px: float, sigma_px: float) -> Any:
    """The marker in the image as a PointStamped: x, y in px, z its sigma in px."""
    header = library("std_msgs.msg").Header(stamp=stamp(time_ns), frame_id="image")
    geometry = library("geometry_msgs.msg")
    return geometry.PointStamped(header=header, point=geometry.Point(x=u_px, y=v_px, z=sigma_px))


def position_of(message: Any, joint: str) -> float | None:
    """The joint's position, rad, in a JointState (of its only one where it has no names); None where there is none that
    is finite and below _FARTHEST in size."""
    names, positions = list(message.name), message.position
    at = names.index(joint) if joint in names else 0 if not names and len(positions) == 1 else len(positions)
    return float(positions[at]) if at < len(positions) and abs(positions[at]) < _FARTHEST else None


def diagnostics(time_ns: int, name: str, board: str, level: str, says: str, values: Mapping[str, Any]) -> Any:
    """A DiagnosticArray; level: OK, WARN or ERROR. Values that are None are left out."""
    of = library("diagnostic_msgs.msg")
    rows = [of.KeyValue(key=key, value=_text(value)) for key, value in values.items() if value is not None]
    status = of.DiagnosticStatus(
        level=getattr(of.DiagnosticStatus, level), name=name, message=says, hardware_id=board, values=rows
    )
    return of.DiagnosticArray(header=library("std_msgs.msg").Header(stamp=stamp(time_ns)), status=[status])


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def axis_values(status: wire.Message) -> dict[str, Any]:
    """An axis' status as values for diagnostics."""
    return {
        "mode": wire.text("MODES", status.mode),
        "fault": wire.text("FAULTS", status.fault) if status.fault else None,
        "table": wire.text("TABLES", status.table),
    }
