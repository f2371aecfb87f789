"""taut update"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, progress_bar
from tautline.cli._live import board_option


@click.command("update")
@click.argument("path", metavar="FILE", type=click.Path(path_type=Path))
@board_option
@click.option("--force", is_flag=True, help="Take firmware that is older than what runs.")
@json_option
def command(path: Path, board: str | None, force: bool, as_json: bool) -> None:
    """Give a board on USB the firmware in FILE (an .update of a release, or build/rp2040/tautline.update).

    File and signature are checked here, and by the board before it erases anything. The firmware that runs stays: the
    new one goes beside it, is started, and counts once it has answered for two seconds. If it does not come up, or the
    power goes at any moment, the board runs the old one. All motors have to be off. Tables and settings stay.
    """
    from tautline.device.firmware import text_of
    from tautline.device.updating import update

    with progress_bar("update") as progress:
        done = update(board, path, older_too=force, progress=progress)
    emit(
        {
            "board": done.board,
            "port": done.port,
            "before": text_of(done.before),
            "firmware": text_of(done.version),
            "slot": done.slot,
            "confirmed": True,
        },
        as_json,
        f"{done.board}: firmware {text_of(done.version)} runs and is confirmed (it was {text_of(done.before)})",
    )
