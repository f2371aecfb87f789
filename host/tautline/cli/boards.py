"""taut boards"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import click

from tautline.cli._common import emit, json_option
from tautline.errors import TautError


@click.command("boards")
@click.option(
    "--board",
    metavar="BOARD",
    help="This one alone: its serial number, usbip:HOST:PORT, serial:DEVICE, or motors such as dynamixel:DEVICE:ID,ID.",
)
@json_option
def command(board: str | None, as_json: bool) -> None:
    """List the boards on USB and the one that $TAUTLINE_BOARD names: serial number, firmware, protocol, axes, tables.

    A board that another program uses, or that speaks another protocol, is listed and left alone. Motors on a bus of
    their own are listed where --board or $TAUTLINE_BOARD names them; else the kinds that there are.
    """
    from tautline.device.board import find
    from tautline.drivers.addresses import KINDS

    rows = [_board_row(description) for description in find(board)]
    if board is not None and not rows:
        raise TautError(f"no board '{board}' was found: 'taut boards' lists those that are attached")
    drivers = [
        {"kind": name, "motors": kind.says, "example": kind.example, "installed": kind.installed}
        for name, kind in KINDS.items()
    ]
    lines = list(map(_row_in_words, rows)) or ["no board is attached"]
    if board is None:
        lines += ["", "motors on a bus of their own, as --board or a rig's actuator.board names them:"]
        for kind in KINDS.values():
            missing = "" if kind.installed else f", not installed: {kind.remedy}"
            lines.append(f"  {kind.example} ({kind.says}{missing})")
    emit({"boards": rows, "drivers": drivers}, as_json, "\n".join(lines))


def _board_row(description: Any) -> dict[str, Any]:
    """The result's entry for one board that was found. description: its BoardAddress. The entry has its address, serial
    number, protocol and whether another program uses it (busy). A board that is not busy is opened, which adds firmware
    and axes, or `error` where that fails."""
    from tautline.device.board import Board

    row: dict[str, Any] = {
        "board": description.where,
        "serial": description.serial,
        "protocol": f"{description.protocol[0]}.{description.protocol[1]}",
        "busy": description.busy,
    }
    if description.busy:
        return row
    try:
        with Board(description) as board:
            identity = board.identity
            row |= {
                "firmware": ".".join(str(part) for part in identity.firmware),
                "protocol": f"{identity.protocol_major}.{identity.protocol_minor}",
                "build": identity.build,
                "kind": identity.port,
                "table_format": identity.table_version,
                "control_hz": identity.control_hz,
                "axes": [_axis_row(board, axis) for axis in range(board.axes)],
                "bus": board.bus(),
            }
    except TautError as error:
        row["error"] = str(error)
    return row


def _axis_row(board: Any, axis: int) -> dict[str, Any]:
    """The result's entry for one axis of an open board: mode, fault, whether the motor is commissioned, and its table
    with model, instrument and date. A value is None where there is none, or where the firmware does not tell."""
    from tautline import tables
    from tautline.device import wire

    status = board.status(axis)
    knows_settings = board.identity.protocol_minor >= wire.wire.SINCE["settings"]
    row = {
        "axis": axis,
        "mode": wire.text("MODES", status.mode),
        "fault": wire.fault_meaning(status),
        # Older firmware does not say: it drives as if the motor were commissioned.
        "commissioned": bool(status.flags & wire.code("FLAGS", "COMMISSIONED")) if knows_settings else None,
        "table": wire.text("TABLES", status.table),
        "model_id": None,
        "instrument": None,
        "created": None,
    }
    blob = board.read_table(axis) if status.table_sequence else b""
    if blob:
        table = tables.decode(blob)
        made = datetime.fromtimestamp(table.created_s, UTC).isoformat(timespec="minutes")
        row |= {"model_id": table.model_id.hex(), "instrument": table.instrument or None, "created": made}
    return row


def _row_in_words(row: dict[str, Any]) -> str:
    """A board's entry (`_board_row`) as text for a terminal: one line for the board and one for each axis."""
    if row.get("error"):
        return str(row["error"])
    if row["busy"]:
        return f"{row['board']}: in use by another program, or no permission; protocol {row['protocol']}"
    lines = [
        f"{row['board']}: {row['kind']} {row['serial']}, firmware {row['firmware']}, protocol {row['protocol']}, "
        f"{row['control_hz']} Hz"
    ]
    if row["bus"]:
        bus = row["bus"]
        lines = [
            f"{row['board']}: asked {bus['rate_hz']:.0f} times a second; where the host is lost, it begins to stop "
            f"within {bus['rest_s']:.2g} s ({bus['watchdog']})",
            *(f"  {drive}" for drive in bus["drives"]),
        ]
    for axis in row["axes"]:
        table = "no table"
        if axis["model_id"]:
            table = f"model {axis['model_id']} of {axis['created'][:10]}"
            table += f" for instrument {axis['instrument']}" if axis["instrument"] else ""
        weak = "; not commissioned: low drive alone, until 'taut commission'" if axis["commissioned"] is False else ""
        lines.append(f"  axis {axis['axis']}: {table}, {axis['fault'] or axis['mode']}{weak}")
    return "\n".join(lines)
