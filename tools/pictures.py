"""./run pictures [--demo FOLDER]: pictures of README and gallery, and notebooks with what they print, made again.

FOLDER is a `taut demo` that is there already (tautline-demo); without it one is made.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

import click
import matplotlib as mpl
import nbformat
import numpy as np
from matplotlib.figure import Figure
from nbclient import NotebookClient

from tautline.model import Model
from tautline.reports import figures
from tautline.reports.evidence import Evidence, Run
from tools import explained

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
PICTURE = ROOT / "docs" / "pictures" / "report.png"
EXPLAINED = {"calibration.md": explained.calibration, "diagnosis.md": explained.diagnosis}  # of docs/
PAGE_PICTURE = PICTURE.with_name("live-page.png")
_PAGE_PX = 1200  # wide
TIMEOUT_S = 600  # of a notebook's cell, on a machine that does much else


@mpl.rc_context(figures.STYLE)
def readme_picture(model_folder: Path) -> Figure:
    """What a report shows first, and the trajectory that was followed, in one picture."""
    model = Model.load(model_folder)
    runs = Run.load_all(model_folder)
    made = Figure(figsize=(11, 6.2), layout="constrained")
    panels = made.subplot_mosaic([["width", "law"], ["path", "path"]], height_ratios=(1.3, 1.0))
    figures.draw_backlash(panels["width"], model, figures.onsets_of(model))
    figures.draw_characteristic(panels["law"], model, Evidence.load(model_folder))
    path = panels["path"]
    for name, colour, says in (("off", figures.DOWN, "without tables"), ("full", figures.UP, "with tables")):
        run = runs[name]
        error = np.where(run.counted, run.tip_deg - run.goal_deg, np.nan)
        path.plot(run.t_s - run.t_s[0], error, color=colour, lw=1.2, label=f"{says}: {run.rms_deg:.2g} deg rms")
    path.set(xlabel="time (s)", ylabel="tip off by (deg)", title="A trajectory of the tip, followed open loop")
    path.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.1)
    return made


def page_picture(file: Path) -> None:
    """The live page in the middle of a calibration of the simulated instrument."""
    from tools import browser  # the only picture that needs one: tools/setup browser

    with (
        tempfile.TemporaryDirectory() as folder,
        browser.page("--simulate", "--out", Path(folder) / "model") as (address, _),
        browser.browser(_PAGE_PX) as seen,
    ):
        seen.get(address)
        browser.press(seen, "start")
        browser.until(lambda: len(seen.find_elements("css selector", "#backlash path.up, #backlash path.down")) >= 6)
        browser.press(seen, "rest")
        browser.until(lambda: browser.text(seen, "doing") == "at rest")
        browser.whole_page(seen, _PAGE_PX, file)


def run_notebook(path: Path) -> nbformat.NotebookNode:
    """The notebook, run in a kernel of its own from an empty folder, with its outputs; an error in a cell is raised."""
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        NotebookClient(notebook, timeout=TIMEOUT_S, resources={"metadata": {"path": folder}}).execute()
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)  # when it was run
    return notebook


@click.command()
@click.option("--demo", type=click.Path(path_type=Path, exists=True), help="The folder of a 'taut demo'.")
@click.argument("names", nargs=-1)
def main(demo: Path | None, names: tuple[str, ...]) -> None:
    """Makes all of them, or those of NAMES: report, live-page, pages of docs, and the examples by their file's name."""
    examples = (path.stem for path in sorted(EXAMPLES.glob("*.py")))
    everything = ["report", "live-page", *EXPLAINED, *examples, *notebooks()]
    for name in names or everything:
        if name == "report":
            with tempfile.TemporaryDirectory() as folder:
                if demo is None:
                    demo = Path(folder) / "demo"
                    subprocess.run([sys.executable, "-m", "tautline", "demo", "--out", demo], check=True)
                PICTURE.parent.mkdir(exist_ok=True)
                readme_picture(demo / "model").savefig(PICTURE, dpi=90)
        elif name in EXPLAINED:
            made, says = EXPLAINED[name]()
            made.savefig(PICTURE.with_name(name).with_suffix(".png"), dpi=90, metadata={"Description": says})
            click.echo(says)
        elif name == "live-page":
            page_picture(PAGE_PICTURE)
        elif name in notebooks():
            nbformat.write(run_notebook(EXAMPLES / f"{name}.ipynb"), EXAMPLES / f"{name}.ipynb")
        elif (EXAMPLES / f"{name}.py").is_file():
            picture = EXAMPLES / "pictures" / f"{name}.png"
            subprocess.run([sys.executable, EXAMPLES / f"{name}.py", picture], check=True)
        else:
            raise click.UsageError(f"{name}: choose of {', '.join(everything)}")
        click.echo(f"{name}: made")


def notebooks() -> list[str]:
    return [path.stem for path in sorted(EXAMPLES.glob("*.ipynb"))]


if __name__ == "__main__":
    main()
