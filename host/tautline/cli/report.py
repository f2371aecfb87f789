"""taut report MODEL"""

from __future__ import annotations

from pathlib import Path

import click

from tautline.cli._common import emit, json_option
from tautline.model import Model
from tautline.reports import pages
from tautline.reports.evidence import Evidence


@click.command("report")
@click.argument("model_path", metavar="MODEL", type=click.Path(path_type=Path))
@json_option
def command(model_path: Path, as_json: bool) -> None:
    """Write a model's report.html again."""
    path = pages.write(Model.load(model_path), model_path, Evidence.load(model_path))
    emit({"report": path}, as_json, str(path))
