"""What the commands share: --json, --rig, progress on stderr, warnings.

A command ends with `emit(result, as_json, text)`. The function `progress(fraction, text)` that it hands to the library
comes from `progress_bar`.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import click

from tautline.cli._commands import Said
from tautline.errors import TautError, UnusableError
from tautline.model import Model
from tautline.plain import plain
from tautline.quality import Quality, Verdict
from tautline.recording import Recording, check_distinct, load_all, of_another_rig
from tautline.rig import Rig

Progress = Callable[[float, str], None]


class Number(click.types.FloatParamType):
    """A type of options: a finite number. Unlike it, click's own type accepts nan and inf, even within a range."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Converts the option's value to a float; a usage error where it is not a finite number."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


class NumberRange(click.FloatRange, Number):
    """A type of options: a finite number within a range."""


SEED = click.IntRange(min=0)  # numpy's generators take no negative seed

json_option = click.option("--json", "as_json", is_flag=True, help="Print the result as one JSON object on stdout.")
rig_option = click.option(
    "--rig",
    "rig_path",
    type=click.Path(path_type=Path),
    help="The rig file; wins over a rig.toml in a recording.",
)
compensation_option = click.option(
    "--compensation",
    "--mode",
    "compensation",
    type=click.Choice(["off", "backlash", "full"]),
    default="full",
    show_default=True,
    help="off: f_coarse's inverse alone; backlash: f_coarse and B; full: f_remain and B.",
)
force_option = click.option("--force", is_flag=True, help="Use a model whose calibration is unusable all the same.")


def refuse_unusable(model: Model, folder: Path, force: bool = False) -> None:
    """Raises an UnusableError, with the verdict's first reason, for a model whose calibration is unusable; to be called
    before anything is driven with it. With `force` it only prints a warning. folder: the model's, for the text."""
    if model.quality.usable:
        return
    why = model.quality.reasons[0]
    if not force:
        raise UnusableError(f"{folder}: its calibration is unusable, {why} (--force uses it all the same)")
    warn(f"{folder}: its calibration is unusable, {why}")


def warn_unusable(model: Model, folder: Path) -> None:
    """Prints a warning where a model's calibration is unusable; for commands that drive nothing with it."""
    refuse_unusable(model, folder, force=True)


def warn_tracked_alone(model: Model) -> None:
    """Prints a warning where a model has effects beside its play, as a live tracker simulates the play and f_remain
    alone; to be called before the tracker starts."""
    if model.effects:
        named = ", ".join(effect.id for effect in model.effects)
        warn(f"what the model holds beside its play ({named}) is not simulated while tracking live")


STATE_COLOURS = {"trusted": "green", "stale": "yellow", "adapting": "cyan"}  # by a tracker's state
_COLOURS = {Verdict.GOOD: "green", Verdict.DOUBTFUL: "yellow", Verdict.UNUSABLE: "red"}


def quality_lines(quality: Quality) -> list[str]:
    """Lines to print before a calibration's result: its verdict in colour, each of its reasons, and where to read more
    about the first reason."""
    word = click.style(quality.verdict.value, fg=_COLOURS[quality.verdict], bold=True)
    lines = [f"taut: calibration {word}" + (": the stated sigmas cover" if quality.verdict is Verdict.GOOD else "")]
    lines += [f"taut:   {click.style(reason.code, bold=True)} {reason}" for reason in quality.reasons]
    if quality.reasons:
        lines.append(f"taut:   'taut explain {quality.reasons[0].code}' says more")
    return lines


@contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A context with a progress bar on stderr. It yields the function that moves the bar, which is called with the
    fraction done, 0 to 1, and a text on what is being done. Where stderr is no terminal that function does nothing."""
    if not sys.stderr.isatty():
        yield lambda fraction, text: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("[bold]{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[text]}"),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(title, total=1.0, text="")
        yield lambda fraction, text: bar.update(task, completed=min(max(fraction, 0.0), 1.0), text=text)


def log(text: str) -> None:
    """Prints a line on stderr."""
    click.echo(text, err=True)


def warn(text: str) -> None:
    """Prints a warning, one line on stderr."""
    click.echo(f"taut: warning: {text}", err=True)


def emit(result: Mapping[str, Any], as_json: bool, text: str) -> None:
    """Prints the command's result on stdout: `result` as one JSON object if `as_json`, else `text` for a person. It
    notes in the context's `Said` that this was done, so that an error after it prints no second object."""
    context = click.get_current_context(silent=True)
    if context is not None and (said := context.find_object(Said)) is not None:
        said.result = True
    click.echo(json.dumps(plain(result), allow_nan=False) if as_json else text)


def read_rig(path: Path) -> Rig:
    """Reads the rig file of --rig and prints a warning for each key that may be misspelt."""
    rig = Rig.load(path)
    for said in rig.misspelt:
        warn(f"{path}: {said}")
    return rig


def read_recordings(
    paths: Sequence[Path], rig_path: Path | None, repeated: bool = False
) -> tuple[list[Recording], Rig]:
    """Reads recordings and the rig that holds for all of them, and prints the recordings' warnings. The rig is that of
    rig_path (--rig), else the rig.toml of the first recording that has one. TautError where a recording has a different
    rig.toml and rig_path is None, or where a recording is given twice, unless `repeated` allows it."""
    if rig_path is not None:
        rig = read_rig(rig_path)
        recordings = load_all(paths, rig)
    else:
        rig = _first_rig(paths)
        recordings = load_all(paths, rig)
        if other := of_another_rig(recordings, rig):
            raise TautError(
                f"{other.name}: its rig.toml differs from the one used for the others: say which with --rig"
            )
    if not repeated:
        check_distinct(recordings)
    for recording in recordings:
        for warning in recording.warnings:
            warn(warning)
    return recordings, rig


def _first_rig(paths: Sequence[Path]) -> Rig:
    """Reads the rig.toml in the first recording that has one. TautError where none has, or where one of the recordings
    before that is not a folder."""
    for path in paths:
        if not path.is_dir():
            raise TautError(f"{path}: there is no such folder: a recording is a folder with motor.csv")
        if (path / "rig.toml").exists():
            return Rig.load(path / "rig.toml")
    raise TautError(f"{paths[0]}: no rig.toml is in it: name one with --rig")
