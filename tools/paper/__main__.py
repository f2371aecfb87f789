"""python -m tools.paper [fig7|fig8|fig9|table1|fig12|all] --out DIR: the paper's experiments, simulated."""

from __future__ import annotations

import sys
from pathlib import Path

import click
import jinja2
from rich.console import Console
from rich.table import Table

from tautline.errors import TautError
from tautline.folders import write_file
from tautline.reports import figures
from tools.paper.experiments import EXPERIMENTS, Experiment, all_experiments


@click.command()
@click.argument("which", type=click.Choice([*EXPERIMENTS, "all"]), default="all")
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/paper"), help="Folder of paper.html.")
def main(which: str, out: Path) -> None:
    """Runs the paper's experiments on simulated instruments and prints its numbers beside ours."""
    done = all_experiments() if which == "all" else EXPERIMENTS[which]()
    console = Console(width=150)
    for experiment in done:
        table = Table(box=None, pad_edge=False, padding=(0, 3, 0, 0))
        table.add_column("")
        table.add_column("paper", justify="right")
        table.add_column("ours", justify="right")
        for row in experiment.rows:
            table.add_row(row.what, row.paper, row.ours)
        console.print(experiment.title, table, "", sep="\n", highlight=False)
    path = out / "paper.html"
    write_file(path, page(done))
    console.print(str(path))


def page(done: list[Experiment]) -> str:
    environment = jinja2.Environment(
        loader=jinja2.ChoiceLoader(
            [jinja2.FileSystemLoader(Path(__file__).parent), jinja2.PackageLoader("tautline.reports")],
        ),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
    )
    return environment.get_template("paper.html").render(
        title="The paper's experiments",
        footer="tautline, simulated instruments",
        experiments=[(experiment, figures.data_uri(experiment.picture)) for experiment in done],
    )


if __name__ == "__main__":
    try:
        main()
    except TautError as error:
        sys.exit(f"paper: {error}")
