"""taut flash"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, progress_bar, refuse_unusable, warn
from tautline.cli._live import axis_option, board_option


@click.command("flash")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@board_option
@axis_option
@click.option(
    "--without-effects",
    is_flag=True,
    help="Load B and f_remain of a corrected model though the tables cannot carry its effects.",
)
@click.option("--force", is_flag=True, help="Load an unusable model, or one for another instrument, all the same.")
@json_option
def command(model_path: Path, board: str | None, axis: int, without_effects: bool, force: bool, as_json: bool) -> None:
    """Load MODEL's tables into an axis of a board, read them back and compare them byte for byte.

    The table is checked by the board before it replaces the one in use; a failure leaves the old one. A corrected model
    (taut diagnose) whose effects the tables cannot carry, such as lag, is refused unless --without-effects is given. So
    is one whose rig.toml names another instrument than the board's settings do (taut commission --instrument), without
    --force.
    """
    from tautline import tables
    from tautline.device import wire
    from tautline.device.board import open_board
    from tautline.effects import BY_ID
    from tautline.errors import TautError
    from tautline.model import Model

    model = Model.load(model_path)
    refuse_unusable(model, model_path, force)
    left = [effect.id for effect in model.effects if not BY_ID[effect.id].on_board]
    if left and not without_effects:
        raise TautError(
            f"{model_path}: the board's tables cannot carry {', '.join(left)}: load B and f_remain alone with "
            "--without-effects, or the model that was calibrated"
        )
    blob = tables.encode(model, axis=axis)
    with open_board(board) as opened, progress_bar("flash") as progress:
        opened.load_table(axis, blob, progress, any_instrument=force)
        status = opened.status(axis)
        serial = opened.identity.serial
    if status.fault:
        warn(f"axis {axis} has stopped: {wire.fault(status)}. Then run 'taut clear'")
    table = tables.decode(blob)
    emit(
        {
            "board": serial,
            "axis": axis,
            "bytes": len(blob),
            "nodes": len(table.q),
            "model_id": table.model_id.hex(),
            "instrument": table.instrument or None,
            "table_crc": status.table_crc,
            "verified": True,
            "without_effects": left,
        },
        as_json,
        f"{serial} axis {axis}: model {table.model_id.hex()}, {len(table.q)} nodes, {len(blob)} bytes, read back equal",
    )
