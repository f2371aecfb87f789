"""taut flash"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tautline.cli._common import Number, emit, json_option, progress_bar, refuse_unusable, warn
from tautline.cli._live import axis_option, board_option

if TYPE_CHECKING:
    from tautline.model import Model

_FIXED = (0.0, 1.0, 1.0)  # value of --adapt by which tables cannot be moved in use
_MUCH = 0.1  # loss: share of what there is to undo; a warning is given where plays leave more


@click.command("flash")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@board_option
@axis_option
@click.option(
    "--without-effects",
    is_flag=True,
    help="Load a corrected model though the tables cannot undo all of its effects.",
)
@click.option(
    "--joint",
    "joints",
    metavar="COLUMN=AXIS:RESOLUTION",
    multiple=True,
    help="Which axis of the board moves a column that couples in, and its unit per encoder count: "
    "translation_mm=1:0.001.",
)
@click.option(
    "--adapt",
    type=(Number(), Number(), Number()),
    metavar="OFFSET LEAST MOST",
    help="How far a host may move the tables in use: the offset, the rig's unit, and the least and the most of B. "
    "Default: a tenth of the range, 0 and 2. 0 1 1: not at all.",
)
@click.option("--force", is_flag=True, help="Load an unusable model, or one for another instrument, all the same.")
@json_option
def command(
    model_path: Path,
    board: str | None,
    axis: int,
    without_effects: bool,
    joints: tuple[str, ...],
    adapt: tuple[float, float, float] | None,
    force: bool,
    as_json: bool,
) -> None:
    """Load MODEL's tables into an axis of a board, read them back and compare them byte for byte.

    The table is checked by the board before it replaces the one in use; a failure leaves the old one. A corrected model
    (taut diagnose) with effects that no table undoes, such as stick-slip, is refused unless --without-effects is given;
    so is one that another axis couples into without --joint, and one whose rig.toml names another instrument than the
    board's settings do (taut commission --instrument) without --force.
    """
    from tautline import tables
    from tautline.device import wire
    from tautline.device.board import open_board
    from tautline.errors import TautError
    from tautline.model import Model
    from tautline.undone import Joint, in_words, not_undone

    model = Model.load(model_path)
    refuse_unusable(model, model_path, force)
    known = {column: Joint(number, resolution) for column, number, resolution in map(_parse_joint, joints)}
    remains = not_undone(model, known)
    if remains and not without_effects:
        raise TautError(
            f"{model_path}: no table can undo {in_words(remains)}: load what they can with --without-effects, or the "
            "model that was calibrated"
        )
    limits = tables.Limits.in_use(model.rig)
    if adapt is not None:
        limits = replace(limits, adapt=adapt if adapt != _FIXED else None)
    blob = tables.encode(model, axis=axis, limits=limits, joints=known)
    with open_board(board or model.rig.actuator.board) as opened, progress_bar("flash") as progress:
        opened.load_table(axis, blob, progress, any_instrument=force)
        status = opened.status(axis)
        serial = opened.identity.serial
    if status.fault:
        warn(f"axis {axis} has stopped: {wire.fault(status)}. Then run 'taut clear'")
    table, (plays, stand_in) = tables.decode(blob), _stand_in(model)
    emit(
        {
            "board": serial,
            "axis": axis,
            "bytes": len(blob),
            "nodes": len(table.q),
            "model_id": table.model_id.hex(),
            "instrument": table.instrument or None,
            "adapt": None if table.limits.adapt is None else list(table.limits.adapt),
            "table_crc": status.table_crc,
            "verified": True,
            "without_effects": remains,
            "plays": plays,
        },
        as_json,
        f"{serial} axis {axis}: model {table.model_id.hex()}, {len(table.q)} nodes, {len(blob)} bytes, read back equal"
        f"{stand_in}",
    )


def _stand_in(model: Model) -> tuple[dict[str, Any] | None, str]:
    """The plays by which the board approximates a hysteresis of the model that its tables cannot hold. Returns them as
    JSON, with the share `leaves` that they leave undone, and as the end of the command's text; None and "" for a model
    without such a hysteresis. Warns where they leave more than the share _MUCH."""
    from tautline.undone import stands_in

    near = stands_in(model)
    if near is None:
        return None, ""
    leave = f"and leave {100.0 * near.share:.2g} % of what there is to undo"
    if near.share > _MUCH:
        warn(f"the plays that stand for its hysteresis on the board {leave}: expect that much of the tip")
    plays = near.elements.to_json() | {"leaves": near.share}
    return plays, f"; {len(near.elements.width)} plays stand for its hysteresis, {leave}"


def _parse_joint(text: str) -> tuple[str, int, float]:
    """Parses a value of --joint, COLUMN=AXIS:RESOLUTION: returns the column, the board's axis, and the resolution in
    the column's unit per encoder count. UsageError where the text is not of this form."""
    column, _, rest = text.partition("=")
    axis, _, resolution = rest.partition(":")
    try:
        number, per_count = int(axis), float(resolution)
        if not math.isfinite(per_count):
            raise ValueError
    except ValueError:
        raise click.UsageError(f"--joint {text}: say it as translation_mm=1:0.001") from None
    return column, number, per_count
