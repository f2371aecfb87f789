"""taut clear"""

from __future__ import annotations

from typing import Any

import click

from tautline.cli._common import emit, json_option
from tautline.cli._live import board_option


@click.command("clear")
@board_option
@click.option("--axis", type=click.IntRange(0, 3), help="This axis alone. Default: every axis.")
@json_option
def command(board: str | None, axis: int | None, as_json: bool) -> None:
    """Clear the faults of a board's axes, and say of each what it was and what mends it. Nothing moves.

    What is still wrong comes back as soon as the motor is driven.
    """
    from tautline.device.board import open_board

    with open_board(board) as opened:
        if axis is not None:
            opened.check_axis(axis)
        rows = [_clear(opened, each) for each in (range(opened.axes) if axis is None else [axis])]
        serial = opened.identity.serial
    emit({"board": serial, "axes": rows}, as_json, "\n".join(map(_text, rows)))


def _clear(board: Any, axis: int) -> dict[str, Any]:
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


def _text(row: dict[str, Any]) -> str:
    text = f"axis {row['axis']}: {row['fault'] or 'no fault'}"
    text += f" ('taut explain {row['code']}' says more)" if row["code"] else ""
    if row["left"]:
        return f"{text}\n  not cleared: {row['left']}"
    if row["fault"]:
        text += "\n  cleared"
        text += "" if row["referenced"] else "; its position is not known: run 'taut home'"
    return text
