"""taut compare MODEL MODEL..."""

from __future__ import annotations

from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import emit, json_option
from tautline.cli._outputs import Output, check_no_input
from tautline.errors import TautError
from tautline.model import Model
from tautline.reports import figures, pages


@click.command("compare")
@click.argument("model_paths", metavar="MODEL MODEL...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--html", "html_path", type=Output(file=True), help="Write a page with the picture.")
@json_option
def command(model_paths: tuple[Path, ...], html_path: Path | None, as_json: bool) -> None:
    """How B and f_remain changed: each model against the first."""
    if len(model_paths) < 2:
        raise click.UsageError("name two models or more")
    check_no_input(html_path, *model_paths)
    models = {name: Model.load(path) for name, path in zip(_names(model_paths), model_paths, strict=True)}
    unit = figures.common_unit(models)
    rows = pages.comparison(models)
    if html_path is not None:
        pages.write_comparison(models, html_path)
    emit({"unit": unit, "models": rows, "html": html_path}, as_json, _table(rows, next(iter(models.values()))))


def _names(paths: tuple[Path, ...]) -> list[str]:
    """Unique names for the models at these paths: the folders' names, or the whole paths if the folders' names are not
    unique. TautError where a path is given twice."""
    names = [path.absolute().name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    if len(set(names)) < len(names):
        raise TautError("a model is named twice")
    return names


def _table(rows: list[dict[str, object]], first: Model) -> str:
    """The rows of pages.comparison as the text of a table for a terminal. first: the model that the others are compared
    with; the columns are in its rig's unit."""
    unit = first.rig.actuator.unit
    table = Table(box=None, pad_edge=False)
    fine, per_unit = figures.fine_unit(unit)
    columns = {  # by title: key of a row, factor to the title's unit
        "model": ("model", 1.0),
        f"B mean ({unit})": ("width_mean", 1.0),
        f"change ({fine})": ("width_change_mean", per_unit),
        f"largest ({fine})": ("width_change_max", per_unit),
        f"at q ({unit})": ("width_change_max_at", 1.0),
        "in sigma": ("width_change_sigmas", 1.0),
        "f_remain offset (deg)": ("remaining_change_mean_deg", 1.0),
        "rest (deg rms)": ("remaining_rest_rms_deg", 1.0),
    }
    for title in columns:
        table.add_column(title, justify="left" if title == "model" else "right", no_wrap=True)
    for row in rows:
        table.add_row(*[_cell(row[key], factor) for key, factor in columns.values()])
    console = Console(width=1000, color_system=None)  # the table takes what it needs: no name or number is cut short
    with console.capture() as captured:
        console.print(table)
    return captured.get().rstrip()


def _cell(value: object, factor: float) -> str:
    """The text of a table's cell. A number is multiplied by `factor` (to the column's unit), rounded to 9 decimals and
    written with four digits; "-" stands for NaN and infinities; any other value is written as it is."""
    if not isinstance(value, int | float | np.number):
        return str(value)
    return f"{round(factor * value, 9):.4g}" if np.isfinite(value) else "-"
