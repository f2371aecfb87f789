"""taut clear"""

from __future__ import annotations

from typing import Any

import click

from tautline.cli._common import emit, json_option
from tautline.cli._live import board_option

_LOGGED_MAX = 48  # limit: entries of the board's log, and those that wait to be stored
_SHOWN = 10  # format: entries of the log in the text for a person


@click.command("clear")
@board_option
@click.option("--axis", type=click.IntRange(0, 3), help="This axis alone. Default: every axis.")
@json_option
def command(board: str | None, axis: int | None, as_json: bool) -> None:
    """Clear the faults of a board's axes, and say of each what it was and what mends it. Nothing moves.

    What is still wrong comes back as soon as the motor is driven. Below them the board's log: the last faults, those
    before it was switched off included.
    """
    from tautline.device.board import open_board

    with open_board(board) as opened:
        if axis is not None:
            opened.check_axis(axis)
        rows = [_clear_fault(opened, each) for each in (range(opened.axes) if axis is None else [axis])]
        serial = opened.identity.serial
        log = _fault_log(opened, axis)
    lines = [*map(_result_in_words, rows), *log_text(log)]
    emit({"board": serial, "axes": rows, "log": log}, as_json, "\n".join(lines))


def _clear_fault(board: Any, axis: int) -> dict[str, Any]:
    """Clears the axis' fault, if it has one. Returns the axis' entry of the result: the fault that it had, with its
    code and time (None: it had none), the fault that is left after clearing (None: none), and whether the axis knows
    its position (referenced)."""
    from tautline.device import wire

    before = board.status(axis)
    if before.fault:
        board.ask("clear_fault", axis=axis)
    after = board.status(axis)
    return {
        "axis": axis,
        "fault": wire.fault(before) or None,
        "code": wire.name("FAULTS", before.fault) if before.fault else None,
        "fault_us": before.fault_us if before.fault else None,
        "left": wire.fault(after) or None,  # a new one, or one that is still there
        "referenced": bool(after.flags & wire.code("FLAGS", "REFERENCED")),
    }


def _fault_log(board: Any, axis: int | None) -> list[dict[str, Any]] | None:
    """Reads the board's fault log, newest first, of one axis, or of all with axis=None. Returns None where the firmware
    keeps no log."""
    from tautline.device import wire

    if board.identity.protocol_minor < wire.wire.SINCE["get_logged"]:
        return None
    rows: list[dict[str, Any]] = []
    for index in range(_LOGGED_MAX):
        entry = board.ask("get_logged", index=index)
        if entry.number == 0:  # there is no such entry
            break
        rows.append(
            {
                "axis": entry.axis,
                "fault": wire.fault_text(entry.fault, entry.value),
                "code": wire.name("FAULTS", entry.fault),
                "value": entry.value,
                "since_start_s": round(entry.t_us * 1e-6, 3),
                "starts_ago": entry.run_now - entry.run,
                "q": round(float(entry.q), 2),
            }
        )
    return [row for row in rows if axis is None or row["axis"] == axis]


def log_text(log: list[dict[str, Any]] | None) -> list[str]:
    """The newest _SHOWN entries of the fault log (`_fault_log`) as lines for a terminal; a line that says so for None,
    which means that the firmware keeps no log."""
    if log is None:
        return ["no log: the board's firmware keeps none; 'taut update' brings one that does"]
    shown = log[:_SHOWN]
    title = "the last fault:" if len(shown) == 1 else f"the last {len(shown)} faults, newest first:"
    lines = ["", title] if shown else []
    for row in shown:
        ago = row["starts_ago"]
        start = "this start" if ago == 0 else "the start before" if ago == 1 else f"the start {ago} before"
        lines.append(f"  {row['since_start_s']:.1f} s after {start}, axis {row['axis']}: {row['fault']}")
    return lines


def _result_in_words(row: dict[str, Any]) -> str:
    """An axis' entry (`_clear_fault`) as text for a terminal: its fault, and whether that was cleared."""
    text = f"axis {row['axis']}: {row['fault'] or 'no fault'}"
    text += f" ('taut explain {row['code']}' says more)" if row["code"] else ""
    if row["left"]:
        return f"{text}\n  not cleared: {row['left']}"
    if row["fault"]:
        text += "\n  cleared"
        text += "" if row["referenced"] else "; its position is not known: run 'taut home'"
    return text
