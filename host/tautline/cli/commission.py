"""taut commission"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import emit, json_option, log, rig_option
from tautline.cli._live import (
    LiveOptions,
    axis_option,
    board_option,
    end_option,
    opened_setup,
    simulate_option,
    way_option,
)
from tautline.cli._outputs import Output
from tautline.errors import TautError


@click.command("commission")
@board_option
@axis_option
@simulate_option
@rig_option
@way_option
@end_option
@click.option("--current", type=click.IntRange(1), help="Limit of the motor's current, mA. Default: as it is.")
@click.option("--instrument", default="", help="Serial of the instrument, 8 letters at most: other tables are refused.")
@click.option(
    "--group", type=click.IntRange(0, 4), help="Axes of one group go off together; 0: of none. Default: as it is."
)
@click.option(
    "--estop",
    type=click.Choice(["closed", "open"]),
    help="Which state of the stop input stops the axes, all of them; open: a broken wire does, too. Default: as it is.",
)
@click.option(
    "--out",
    type=Output(file=True),
    default=Path("commission.png"),
    show_default=True,
    help="Picture of the step response.",
)
@click.option("--yes", is_flag=True, help="Ask nothing: the instrument is free to move, and what is found is stored.")
@json_option
def command(
    board: str | None,
    axis: int,
    simulate: str | None,
    rig_path: Path | None,
    way: str,
    end: float | None,
    current: int | None,
    instrument: str,
    group: int | None,
    estop: str | None,
    out: Path,
    yes: bool,
    as_json: bool,
) -> None:
    """Put a motor into service: polarity, scale, current, ends and servo gains, stored on the board as its settings.

    Of a drive that has a position loop of its own: whether it goes where it is told, how late, and the range.

    Each part is asked for before the motor moves; Ctrl-C ends it with the motor at rest. The range is the rig's.
    """
    from tautline.device import wire
    from tautline.live.commission import commission
    from tautline.live.homing import Homing
    from tautline.reports import figures

    stops = None if estop is None else wire.code("ESTOPS", estop.upper())
    if len(instrument.encode()) > 8:
        raise click.UsageError("--instrument takes 8 letters at most")
    figures.check_ending(out)
    options = LiveOptions(board, axis, camera=None, colour=Path(), simulate=simulate, at=None)  # colour: of no camera
    with opened_setup(options, rig_path) as live:
        if live.plant is not None:
            live.plant.end_at(*live.rig.actuator.range)
        commissioned = commission(
            live,
            agree=(lambda question: True) if yes else (lambda question: click.confirm(question, err=True)),
            say=log,
            homing=Homing(direction=-1 if way == "low" else 1, end=end),
            wanted={"current_ma": current, "instrument": instrument or None, "group": group, "estop": stops},
        )
        serial, bus = live.board.identity.serial, live.board.bus()
    try:
        figures.save(figures.servo_steps(commissioned.steps, commissioned.factor), out)
    except TautError as error:
        raise TautError(f"{error}; all is stored on the board") from error
    step = commissioned.steps[commissioned.factor]
    changed = {name: value for name, value in commissioned.settings.items() if commissioned.before[name] != value}
    result = {
        "board": serial,
        "axis": axis,
        "q": commissioned.q,
        "friction": commissioned.friction,
        "speed_s": commissioned.speed_s,
        "current_ma": commissioned.current_ma,
        "factor": commissioned.factor,
        "error_rms": step.rms,
        "overshoot": step.overshoot,
        "settling_s": step.settling_s,
        "settings": commissioned.settings,
        "changed": sorted(changed),
        "picture": out,
        "bus": bus,
    }
    emit(result, as_json, f"{serial} axis {axis}: {_stored_in_words(changed)}\n{out} shows the steps.")


def _stored_in_words(changed: Mapping[str, Any]) -> str:
    """A text on the settings that were stored with another value than before. changed: their new values by name."""
    shown = [
        f"{name} {value:.4g}" if isinstance(value, float) else f"{name} {value}" for name, value in changed.items()
    ]
    return f"stored {', '.join(shown)}" if shown else "the settings stay as they were"
