"""taut home"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import NumberRange, emit, json_option, rig_option
from tautline.cli._live import (
    LiveOptions,
    axis_option,
    board_option,
    end_option,
    opened_setup,
    simulate_option,
    way_option,
)


@click.command("home")
@board_option
@axis_option
@simulate_option
@rig_option
@way_option
@end_option
@click.option("--retreat", type=NumberRange(min=0.0), help="The way back from it. Default: 2 % of the range.")
@click.option(
    "--reach",
    type=NumberRange(min=0.0, min_open=True),
    help="The end must be within it, else the motor stops. Default: 1.5 times the range.",
)
@click.option(
    "--speed",
    type=NumberRange(min=0.0, min_open=True),
    help="The rig's unit per second. Default: a tenth of the range.",
)
@click.option(
    "--drive",
    type=NumberRange(0.0, 1.0, min_open=True),
    help="Share of full drive that may press. Default, and most: the low drive in the board's settings.",
)
@json_option
def command(
    board: str | None,
    axis: int,
    simulate: str | None,
    rig_path: Path | None,
    way: str,
    end: float | None,
    retreat: float | None,
    reach: float | None,
    speed: float | None,
    drive: float | None,
    as_json: bool,
) -> None:
    """Find an axis' mechanical end at low drive, and set its position by it: the board then knows where it is.

    Pressing against the end takes up the slack. The instrument must be free to go there. Ctrl-C stops it.
    """
    from tautline.live.homing import Homing, home

    direction = -1 if way == "low" else 1
    live = LiveOptions(board, axis, camera=None, colour=Path(), simulate=simulate, at=None)  # colour: of no camera
    with opened_setup(live, rig_path) as setup:
        low, high = setup.rig.actuator.range
        if setup.plant is not None:
            setup.plant.end_at(low, high)
        q = home(setup, Homing(direction, end, retreat=retreat, reach=reach, speed=speed, drive=drive or 0.0))
        at = end if end is not None else (low if direction < 0 else high)
        unit, serial = setup.rig.actuator.unit, setup.board.identity.serial
    emit(
        {"board": serial, "axis": axis, "end": at, "q": q, "unit": unit, "referenced": True},
        as_json,
        f"{serial} axis {axis}: the {way} end is {at:g} {unit}; now at {q:.4g} {unit}, motor off, position known",
    )
