"""taut monitor"""

from __future__ import annotations

import time
from typing import Any

import click

from tautline.cli._common import emit, json_option
from tautline.cli._live import board_option


@click.command("monitor")
@board_option
@click.option("--once", is_flag=True, help="Print the state once and end.")
@json_option
def command(board: str | None, once: bool, as_json: bool) -> None:
    """Watch a board's axes: mode, positions, drive, faults, and everything that was dropped. Ctrl-C ends it."""
    from tautline.device.board import open_board

    with open_board(board) as opened:
        if once or as_json:
            state = _board_state(opened)
            emit(state, as_json, "\n".join(_axis_line(axis) for axis in state["axes"]))
            return
        from rich.live import Live

        with Live(refresh_per_second=8) as view:
            while True:
                view.update(_table(_board_state(opened)))
                time.sleep(0.1)


def _board_state(board: Any) -> dict[str, Any]:
    """Asks the board for its state and returns it as the command's result: the status of each axis, with codes turned
    into words; its counters; and the error, s, of the clock's alignment, which is done anew by 4 round trips."""
    from tautline.device import wire

    axes = []
    for axis in range(board.axes):
        values = dict(board.status(axis).values)
        values["mode"] = wire.text("MODES", values["mode"])
        values["fault"] = wire.text("FAULTS", values["fault"]) if values["fault"] else None
        values["table"] = wire.text("TABLES", values["table"])
        values["flags"] = wire.flags(values["flags"])
        axes.append(values)
    return {
        "board": board.identity.serial,
        "axes": axes,
        "counters": dict(board.counters().values),
        "clock_error_s": board.align(4),  # of the board's time as the host knows it
    }


def _axis_line(axis: dict[str, Any]) -> str:
    """One axis' status, of `_board_state`, as a line for a terminal."""
    return (
        f"axis {axis['axis']}: {axis['fault'] or axis['mode']}, q {axis['q']:.1f} counts (to {axis['q_ref']:.1f}), "
        f"c {axis['c_est']:.3f} deg (to {axis['c_ref']:.3f}), drive {100 * axis['duty']:.0f} %, table {axis['table']}"
    )


def _table(state: dict[str, Any]) -> Any:
    """The state that `_board_state` returned as a table of rich, a row for each axis. Below it stand the counters of
    lost or damaged messages that are not 0, and how well the clocks agree."""
    from rich.table import Table

    table = Table(title=f"board {state['board']}")
    for name in ("axis", "mode", "q counts", "to", "c deg", "to", "drive %", "mA", "flags"):
        table.add_column(name, justify="right")
    for axis in state["axes"]:
        table.add_row(
            str(axis["axis"]),
            axis["fault"] or axis["mode"],
            *(f"{axis[key]:.1f}" for key in ("q", "q_ref")),
            *(f"{axis[key]:.3f}" for key in ("c_est", "c_ref")),
            f"{100 * axis['duty']:.0f}",
            str(axis["current_ma"]),
            " ".join(axis["flags"]),
        )
    counters = state["counters"]
    drops = {
        name: count
        for name, count in counters.items()
        if count and ("drop" in name or "bad" in name or "overrun" in name)
    }
    dropped = ", ".join(f"{name} {count}" for name, count in drops.items()) or "nothing dropped"
    table.caption = f"{dropped}; clocks agree within {1e3 * state['clock_error_s']:.2f} ms"
    return table
