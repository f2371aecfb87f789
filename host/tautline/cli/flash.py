"""taut flash"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, progress_bar, warn
from tautline.cli._live import axis_option, board_option


@click.command("flash")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@board_option
@axis_option
@json_option
def command(model_path: Path, board: str | None, axis: int, as_json: bool) -> None:
    """Load MODEL's tables into an axis of a board, read them back and compare them byte for byte.

    The table is checked by the board before it replaces the one in use; a failure leaves the old one.
    """
    from tautline import tables
    from tautline.device.board import open_board
    from tautline.effects import BY_ID
    from tautline.model import Model

    model = Model.load(model_path)
    left = [effect.id for effect in model.effects if not BY_ID[effect.id].on_board]
    if left:
        warn(f"the board's tables cannot carry {', '.join(left)}: loaded are B and f_remain alone")
    blob = tables.encode(model, axis=axis)
    with open_board(board) as opened, progress_bar("flash") as progress:
        opened.load_table(axis, blob, progress)
        status = opened.status(axis)
        serial = opened.identity.serial
    table = tables.decode(blob)
    emit(
        {
            "board": serial,
            "axis": axis,
            "bytes": len(blob),
            "nodes": len(table.q),
            "model_id": table.model_id.hex(),
            "table_crc": status.table_crc,
            "verified": True,
        },
        as_json,
        f"{serial} axis {axis}: model {table.model_id.hex()}, {len(table.q)} nodes, {len(blob)} bytes, read back equal",
    )
