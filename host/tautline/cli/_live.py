"""Options of the commands that use a board and a camera, the set-up that they open, and texts on what came of a run."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from tautline.cli._common import SEED, Number, NumberRange, log, progress_bar, read_rig, warn
from tautline.errors import TautError
from tautline.model import MODEL_FILE, Model
from tautline.simulated.instrument import PRESETS

if TYPE_CHECKING:
    from tautline.live.setup import Live
    from tautline.shapes import Library

board_option = click.option(
    "--board",
    metavar="BOARD",
    envvar="TAUTLINE_BOARD",
    help="Serial number of a board on USB, usbip:HOST:PORT, serial:DEVICE, or motors on a bus of their own such as "
    "dynamixel:/dev/ttyUSB0:1 (taut boards names the kinds). Default: $TAUTLINE_BOARD, the rig's, or the only one.",
)
axis_option = click.option("--axis", type=click.IntRange(0, 3), default=0, show_default=True, help="Axis of the board.")
camera_option = click.option(
    "--camera",
    metavar="SOURCE",
    help="Camera: a device number or path, a stream's address, a GStreamer pipeline (... ! appsink), or ros:TOPIC.",
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
    metavar="PRESET|MODEL",
    is_flag=False,
    flag_value="reference",
    help=f"Instead of a board: a desktop board in virtual time, with a simulated instrument ({', '.join(PRESETS)}) or "
    "that of a model's folder, the effects of a diagnosis included.",
)

end_option = click.option(
    "--end", type=Number(), help="Position there, the rig's unit. Default: that end of the rig's range."
)
way_option = click.option(
    "--to", "way", type=click.Choice(["low", "high"]), default="low", show_default=True, help="Which end to find."
)
speed_option = click.option(
    "--speed", type=NumberRange(min=0.0, min_open=True), help="Of a shape, the rig's unit per second."
)
seed_option = click.option("--seed", type=SEED, default=0, help="Of the shape 'smooth', and of the simulation.")


until_option = click.option(
    "--until",
    metavar="SIGMA",
    help="Live: go on until B(q) is known as well as this everywhere, one standard deviation: 3um, 0.003mm, 0.05deg; a "
    "bare number is in um, or deg on such a rig.  [default: 3um, or 0.05 % of a range in deg]",
)


def motion_option(none: str) -> Callable[..., Any]:
    """A decorator that gives a command the option --motion. none: what the help text says of its value "none"."""
    return click.option(
        "--motion",
        metavar="FILE|SHAPE",
        default="none",
        show_default=True,
        help=f"What the motor does: none ({none}), a CSV with t_s and q_mm or q_deg, trapezoids, smooth.",
    )


def shapes_option(without_model: str = "") -> Callable[..., Any]:
    """A decorator that gives a command the option --shapes, as its parameter library_path. without_model: a sentence
    that is appended to the help text, on what happens where no MODEL is named."""
    return click.option(
        "--shapes",
        "library_path",
        metavar="LIBRARY",
        type=click.Path(path_type=Path),
        help=f"A library (taut shapes): says so when the shaft has the shape of another of its models.{without_model}",
    )


RECALLS = " Without MODEL the motor first goes out and back twice, and the shape whose model foretells that is used."
at_option = click.option(
    "--at",
    type=Number(),
    help="Where the motor is now, the rig's unit. Default: as the board counts, 0 where it was switched on.",
)


@dataclass(frozen=True)
class LiveOptions:
    """The values of the options that say which set-up a live command uses."""

    board: str | None  # address; None: the rig's, or the only one attached
    axis: int
    camera: str | None  # None: no camera
    colour: Path  # the file with the marker's colour
    simulate: str | None  # an instrument's preset, or a model's folder; None: a real board
    at: float | None  # where the motor is, the rig's unit; None: as the board counts


def live_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """A decorator that gives a command the options --board, --axis, --camera, --colour, --simulate and --at. The
    command gets their values together, in its parameter `live`, a LiveOptions."""

    @functools.wraps(command)
    def collected(**options: Any) -> Any:
        """Takes these options out of `options` and calls the command with a LiveOptions of them as `live`."""
        live = LiveOptions(**{field.name: options.pop(field.name) for field in fields(LiveOptions)})
        return command(live=live, **options)

    wrapped: Callable[..., Any] = collected
    for option in (at_option, simulate_option, colour_option, camera_option, axis_option, board_option):
        wrapped = option(wrapped)
    return wrapped


def free_recording(out: Path) -> Path:
    """The path of a folder for a recording, beside the output folder `out`, that does not exist yet: OUT-recording, or
    OUT-recording-2 and so on."""
    return _free_folder(out, "recording")


def free_recordings(out: Path) -> Path:
    """The path of a folder for several recordings, beside the output folder `out`, that does not exist yet:
    OUT-recordings, or OUT-recordings-2 and so on."""
    return _free_folder(out, "recordings")


def _free_folder(out: Path, what: str) -> Path:
    """The first path of OUT-WHAT, OUT-WHAT-2, OUT-WHAT-3 and so on, beside `out`, that does not exist; it is not
    made."""
    names = (f"{out.name}-{what}{number}" for number in chain([""], (f"-{i}" for i in count(2))))
    return next(path for name in names if not (path := out.with_name(name)).exists())


def sigma_of(text: str, unit: str) -> float:
    """Parses the text of --until, such as "5um": returns the standard deviation of B in the rig's `unit`, "mm" or
    "deg". A number without a unit is in um on a rig in mm, else in deg. UsageError where it is not a number above 0, or
    where it is an angle on a rig in mm or a length on one in deg."""
    matched = re.fullmatch(r"\s*([0-9.]+(?:e[-+]?\d+)?)\s*(um|µm|mm|deg|)\s*", text)
    try:
        value = float(matched[1]) if matched else 0.0
    except ValueError:
        value = 0.0
    if not matched or value <= 0.0:
        raise click.UsageError(f"--until {text}: a number above 0 is wanted, with its unit: 3um, 0.003mm or 0.05deg")
    named = matched[2] or ("um" if unit == "mm" else unit)
    if (named == "deg") != (unit == "deg"):
        raise click.UsageError(f"--until {text}: the rig's motor counts in {unit}")
    return value * 1e-3 if named in ("um", "µm") else value


def _command_has(option: str) -> bool:
    """Whether the running command has a parameter with this name; False where no command runs."""
    context = click.get_current_context(silent=True)
    return context is not None and any(each.name == option for each in context.command.params)


def options_given(*names: str) -> list[str]:
    """The options that were given in the command line, such as "--tip", among the running command's parameters with
    these names."""
    context = click.get_current_context()
    return [
        each.opts[0]
        for each in context.command.params
        if each.name in names and context.get_parameter_source(each.name) is ParameterSource.COMMANDLINE
    ]


def refuse_live_options(*more: str, because: str, used: str = "") -> None:
    """Raises a UsageError if an option of LiveOptions, or of the parameters named in `more`, was given in the command
    line; for a run that is not live. because: the end of the error's text; used: a parameter that this run uses."""
    live = (field.name for field in fields(LiveOptions) if field.name != used)
    if unused := options_given(*live, *more):
        raise click.UsageError(f"only a live run uses {', '.join(unused)}: {because}")


@contextmanager
def opened_setup(
    live: LiveOptions, rig_path: Path | None, seed: int = 0, model: Model | None = None, picks: bool = False
) -> Iterator[Live]:
    """A context that opens the live set-up of these options (board and camera, or a simulation) and yields it. The rig
    is that of --rig, else the model's, else the simulation's. seed: of a simulation; picks: whether the camera may be
    opened before the marker's colour is known. At the end it warns of frames that the camera dropped. TautError or
    UsageError where options, rig and model do not go together."""
    from tautline.live.setup import CameraSource, open_live
    from tautline.vision.colour import MarkerColour

    if live.simulate is not None and live.simulate not in PRESETS and not (Path(live.simulate) / MODEL_FILE).is_file():
        raise click.UsageError(f"--simulate {live.simulate}: choose one of {', '.join(PRESETS)}, or a model's folder")
    rig = read_rig(rig_path) if rig_path is not None else (model.rig if model is not None else None)
    if live.simulate is None and rig is None:
        raise TautError("no rig: name the set-up's file with --rig")
    if model is not None and rig is not None and rig.actuator.unit != model.rig.actuator.unit:
        raise TautError(
            f"{rig_path}: its motor is in {rig.actuator.unit}, the model's in {model.rig.actuator.unit}: name the rig "
            "that the model was calibrated with, or leave --rig out"
        )
    picks = picks or (rig is not None and rig.sees_from_tip)  # a camera on the tip sees no marker
    # If the colour's file is needed and missing, `load` raises an error that says so.
    reads_colour = live.camera is not None and live.simulate is None and (live.colour.exists() or not picks)
    with open_live(
        board=live.board,
        camera=live.camera,
        simulate=live.simulate,
        rig=rig,
        axis=live.axis,
        colour=MarkerColour.load(live.colour) if reads_colour else None,
        picks=picks,
        at=live.at,
        seed=seed,
        otherwise="use --simulate" if _command_has("simulate") else "",
    ) as setup:
        if isinstance(setup.marker_source, CameraSource) and (says := setup.marker_source.says["exposure"]):
            log(f"taut: the camera's {says}")
        yield setup
        if isinstance(setup.marker_source, CameraSource) and (dropped := setup.marker_source.dropped):
            warn(f"{dropped} frames of the camera never came: ask it for fewer or smaller ones")


def recall_shape(setup: Live, library: Library) -> tuple[Model, Path]:
    """Moves the motor a little to find out which shape of the library the shaft has now. Returns that shape's model and
    the model's folder, and prints the shape's name on stderr."""
    from tautline.live.recalling import recall

    with progress_bar("recall") as progress:
        shape, _ = recall(setup, library, progress)
    log(f"taut: the shaft has the shape {shape.name!r} of {library.folder}")
    return library.model(shape.name), library.folder / shape.name


def shape_text(tracking: dict[str, Any], library: Library | None) -> str:
    """The end of a result's text on the shape that a tracker has recognised; "" without a library or where it has
    recognised none beside that of the model in use. tracking: what Following.summary returned."""
    if library is None or tracking["shape"] is None:
        return ""
    folder = library.folder / tracking["shape"]
    return f"; the shaft has the shape {tracking['shape']!r}: 'taut flash {folder}' loads its tables"


def bus_text(bus: dict[str, Any]) -> str:
    """The end of a result's text on the measured timing of motors on a bus of their own. bus: what Board.bus returned,
    which is empty for a board, so that the text is ""."""
    if not bus:
        return ""
    return (
        f"; {bus['rate_hz']:.0f} Hz on the bus, jitter {1e3 * bus['jitter_s']:.2f} ms, {bus['missed']} of "
        f"{bus['cycles']} cycles missed, {bus['late']} late, the motor {1e3 * bus['lag_s']:.0f} ms behind (planned for)"
    )


def tracking_text(tracking: dict[str, Any]) -> str:
    """The end of a result's text on a tracker that may move the board's tables: the model's state and the reason for
    it, and to which offset (the rig's unit) and scale of B the tables were moved. tracking: what Following.summary
    returned, with a mover."""
    if tracking["state"] is None:
        return "not tracked: no frame came"
    moves = tracking["moves"]
    if tracking["moves_within"] is None:
        moved = "the board's tables may not be moved"
    elif not moves:
        moved = "the tables stayed as they are"
    else:
        moved = f"the tables were moved {len(moves)} times, to offset {moves[-1]['offset']:+.4g}, "
        moved += f"{100 * moves[-1]['scale']:.1f} % of B"
    return f"model {tracking['state']}{': ' + tracking['reason'] if tracking['reason'] else ''}; {moved}"
