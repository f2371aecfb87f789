"""taut shapes add | list | recall"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tautline.cli._common import Number, emit, json_option, log, progress_bar, refuse_unusable, rig_option
from tautline.cli._live import LiveOptions, live_options, opened_setup, refuse_live_options, seed_option

if TYPE_CHECKING:
    from tautline.shapes import Library, Shape


@click.group("shapes")
def command() -> None:
    """A library of shapes: a model for each shape of the shaft, and what tells them apart.

    LIBRARY is a folder. The first shape added is the one that the others' offset and scale of B are told by. --shapes
    LIBRARY of 'taut watch', 'taut follow' and 'taut stream' proposes a shape when the shaft returns to it.
    """


@command.command("add")
@click.argument("library", type=click.Path(path_type=Path))
@click.argument("name")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.option("--current", type=Number(), help="mA: the motor's mean current in this shape.")
@json_option
def add(library: Path, name: str, model_path: Path, current: float | None, as_json: bool) -> None:
    """Remember MODEL as the shape NAME; one of that name is replaced."""
    from tautline.model import Model
    from tautline.shapes import INDEX, Library

    model = Model.load(model_path)
    refuse_unusable(model, model_path)
    known = Library.load(library) if (library / INDEX).exists() else Library(library)
    shape = known.add(name, model, current).of(name)
    unit = model.rig.actuator.unit
    text = f"{library}: {name}, offset {shape.offset:+.4g} {unit}, {100 * shape.scale:.1f} % of the first shape's B"
    emit({"name": name, "offset": shape.offset, "scale": shape.scale, "current_mA": current}, as_json, text)


@command.command("list")
@click.argument("library", type=click.Path(path_type=Path))
@json_option
def listed(library: Path, as_json: bool) -> None:
    """The shapes of LIBRARY."""
    from dataclasses import asdict

    from tautline.shapes import Library

    shapes = Library.load(library).shapes
    lines = [f"{s.name}: offset {s.offset:+.4g}, {100 * s.scale:.1f} % of the first shape's B" for s in shapes]
    emit({"shapes": [asdict(shape) for shape in shapes]}, as_json, "\n".join(lines) or f"{library}: no shapes")


@command.command("recall")
@click.argument("library", type=click.Path(path_type=Path))
@click.argument("recording_path", metavar="[RECORDING]", required=False, type=click.Path(path_type=Path))
@live_options
@rig_option
@seed_option
@json_option
def recall(
    library: Path,
    recording_path: Path | None,
    live: LiveOptions,
    rig_path: Path | None,
    seed: int,
    as_json: bool,
) -> None:
    """Which shape of LIBRARY the shaft has: the one whose model foretells RECORDING best.

    Without RECORDING a board and a camera are asked: the motor goes out and back twice where it stands, by three
    backlashes.
    """
    from tautline.live.recalling import recall as recall_live
    from tautline.shapes import Library

    known = Library.load(library)
    if recording_path is not None:
        refuse_live_options("rig_path", "seed", because="leave them out, or RECORDING")
        nearest, rms = _recall_from_recording(known, recording_path)
    else:
        with opened_setup(live, rig_path, seed, model=known.first()) as setup, progress_bar("recall") as progress:
            nearest, rms = recall_live(setup, known, progress)
    for name, off in rms.items():
        log(f"taut: {name}: off by {off:.3g} rms")
    folder = library / nearest.name
    emit(
        {"name": nearest.name, "model": folder, "rms": rms},
        as_json,
        f"{nearest.name}: load it with 'taut flash {folder}'",
    )


def _recall_from_recording(known: Library, path: Path) -> tuple[Shape, dict[str, float]]:
    """Compares the recording at `path` with the model of each shape in the library `known`. Returns the shape whose
    model predicts it best, and the rms error of each shape's model by the shape's name, px or deg."""
    from tautline.recording import load
    from tautline.shapes import recalled
    from tautline.vision.marker import with_marker

    rig = known.first().rig
    return recalled(known, with_marker(load(path, rig), rig))
