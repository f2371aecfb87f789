"""Options of the commands that use a board."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from tautline.errors import TautError
from tautline.instrument import PRESETS
from tautline.model import Model
from tautline.rig import Rig

board_option = click.option(
    "--board",
    metavar="BOARD",
    envvar="TAUTLINE_BOARD",
    help="Serial number of a board on USB, or usbip:HOST:PORT. Default: the only one attached, or $TAUTLINE_BOARD.",
)
axis_option = click.option("--axis", type=click.IntRange(0, 3), default=0, show_default=True, help="Axis of the board.")
camera_option = click.option(
    "--camera", metavar="SOURCE", help="Camera: a device number or path, or a stream's address."
)
colour_option = click.option(
    "--colour",
    type=click.Path(path_type=Path),
    default=Path("marker.toml"),
    show_default=True,
    help="The marker's colour, from 'taut marker'.",
)
simulate_option = click.option(
    "--simulate",
    metavar="PRESET",
    is_flag=False,
    flag_value="reference",
    help=f"Instead of a board: a desktop board with a simulated instrument ({', '.join(PRESETS)}), in virtual time.",
)


def live_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """--board, --axis, --camera, --colour, --simulate."""
    for option in (simulate_option, colour_option, camera_option, axis_option, board_option):
        command = option(command)
    return command


@contextmanager
def opened(
    board: str | None,
    axis: int,
    camera: str | None,
    colour: Path,
    simulate: str | None,
    rig_path: Path | None,
    seed: int = 0,
    pictures: bool = True,
    model: Model | None = None,
) -> Iterator[Any]:
    """The live set-up that the options name."""
    from tautline.colour import MarkerColour
    from tautline.live import open_live

    if simulate is not None and simulate not in PRESETS:
        raise click.UsageError(f"--simulate {simulate}: choose one of {', '.join(PRESETS)}")
    rig = Rig.load(rig_path) if rig_path is not None else (model.rig if model is not None else None)
    if simulate is None and rig is None:
        raise TautError("no rig: name the set-up's file with --rig")
    with open_live(
        board=board,
        camera=camera,
        simulate=simulate,
        rig=rig,
        axis=axis,
        colour=MarkerColour.load(colour) if camera is not None and simulate is None else None,
        pictures=pictures,
        seed=seed,
    ) as live:
        yield live
