"""A reference for an axis: its mechanical end, found at low drive. Pressing against it takes up the slack."""

from __future__ import annotations

from dataclasses import dataclass

from tautline.device import wire
from tautline.errors import TautError
from tautline.live.setup import Live

_STEP_S = 0.02  # between two looks at the axis
_RETREAT = 0.02  # of the range: back from the end
_REACH = 1.5  # of the range: how far the end is looked for
_SPEED = 0.1  # of the range, per second
_BEYOND_S = 10.0  # what a homing may take beyond the time for its reach


@dataclass(frozen=True)
class Homing:
    """How an axis is homed. Lengths in the rig's unit; None takes what suits the rig."""

    direction: int = -1  # -1 or 1: to which side the end is
    end: float | None = None  # what the position is there; else the end of the rig's range
    retreat: float | None = None  # from the end, after it was found
    reach: float | None = None  # the farthest that the end is looked for
    speed: float | None = None  # unit/s
    drive: float = 0.0  # share of full drive that may press; 0: the settings' low one


def home(live: Live, homing: Homing | None = None) -> float:
    """Finds the axis' zero: drives to its mechanical end at low drive, sets the position there, and backs off a little.
    Returns the position afterwards, the rig's unit; the motor is off. TautError for a drive with a position loop of its
    own, which cannot press weakly, for a fault, or where the axis would rest beyond the board's limits."""
    if live.board.bus():
        raise TautError(
            f"axis {live.axis} is a drive with a position loop of its own: it would press against the end with all its "
            "force, and its zero is its own. Set that with its maker's tools, or say where it stands with --at"
        )
    homing = homing or Homing()
    low, high = live.rig.actuator.range
    span = live.rig.actuator.span
    end = homing.end if homing.end is not None else (low if homing.direction < 0 else high)
    retreat = _RETREAT * span if homing.retreat is None else homing.retreat
    reach = _REACH * span if homing.reach is None else homing.reach
    speed = min(homing.speed or _SPEED * span, 0.5 * live.top_speed)
    _check_within_limits(live, end - homing.direction * retreat)
    live.board.check_fault(live.axis)
    with live.powered():
        live.board.ask(
            "home",
            axis=live.axis,
            direction=homing.direction,
            duty=homing.drive,
            speed_s=speed / live.resolution,
            reach=reach / live.resolution,
            end=end / live.resolution,
            retreat=retreat / live.resolution,
        )
        settle(live, 2.0 * (reach + retreat) / speed + _BEYOND_S)
    live.board.check_reference(live.axis)
    return live.motor_position()


def _check_within_limits(live: Live, rest_at: float) -> None:
    """TautError where the position `rest_at`, the rig's unit, is beyond the axis' limits on the board."""
    limits = live.board.ask("get_limits", axis=live.axis)
    if not limits.q_low <= rest_at / live.resolution <= limits.q_high:
        raise TautError(
            f"axis {live.axis} would rest at {rest_at:g} {live.rig.actuator.unit}, beyond the board's limits "
            f"[{limits.q_low * live.resolution:g}, {limits.q_high * live.resolution:g}]: choose another --end"
        )


def settle(live: Live, longest_s: float) -> None:
    """Waits until the axis holds its position (mode HOLD). TautError where it has a fault, or takes more than
    longest_s."""
    waited = 0.0
    while waited < longest_s:
        live.wait(_STEP_S)
        waited += _STEP_S
        live.board.check_fault(live.axis)
        if live.board.status(live.axis).mode == wire.code("MODES", "HOLD"):
            return
    raise TautError(f"axis {live.axis} does not come to rest: check its limits and servo gains")
