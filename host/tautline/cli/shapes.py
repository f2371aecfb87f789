"""taut shapes add | list | recall"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option, log, refuse_unusable


@click.group("shapes")
def command() -> None:
    """A library of shapes: a model for each shape of the shaft, and what tells them apart.

    LIBRARY is a folder. The first shape added is the one that the others' offset and scale of B are told by. 'taut
    watch --shapes LIBRARY' proposes a shape when the shaft returns to it.
    """


@command.command("add")
@click.argument("library", type=click.Path(path_type=Path))
@click.argument("name")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@click.option("--current", type=float, help="mA: the motor's mean current in this shape.")
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
@click.argument("recording_path", metavar="RECORDING", type=click.Path(path_type=Path))
@json_option
def recall(library: Path, recording_path: Path, as_json: bool) -> None:
    """Which shape of LIBRARY the shaft has in RECORDING: the one whose model foretells it best."""
    from tautline.recording import load
    from tautline.shapes import Library, foretold, recalled
    from tautline.vision.marker import with_marker

    known = Library.load(library)
    rms = {}
    for shape in known.shapes:
        model = known.model(shape.name)
        rms[shape.name] = foretold(model, with_marker(load(recording_path, model.rig), model.rig))
        log(f"taut: {shape.name}: off by {rms[shape.name]:.3g} rms")
    nearest = recalled(known, rms)
    folder = library / nearest.name
    emit(
        {"name": nearest.name, "model": folder, "rms": rms},
        as_json,
        f"{nearest.name}: load it with 'taut flash {folder}'",
    )
