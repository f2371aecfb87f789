"""python -m tools.naming run | score: has what was there from the first recording on one name?"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import progress_bar
from tautline.plain import plain
from tools.naming import score
from tools.naming.cases import EFFECTS, LIBRARY, SCORED_FROM, SECOND
from tools.naming.work import run as run_case

RESULTS = "names.jsonl"


@click.group()
def main() -> None:
    """Sessions with one effect from the start: what a calibration calls it, and a diagnosis of the same recordings."""


@main.command()
@click.option("--effect", "effects", multiple=True, type=click.Choice(EFFECTS), help="Default: all, and none.")
@click.option("--generator", "generators", multiple=True, type=click.Choice([SECOND, LIBRARY]), help="Default: both.")
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True, help="Of each effect and generator.")
@click.option("--first-seed", type=int, default=SCORED_FROM, show_default=True, help="Those before were tuned on.")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("build/naming"),
    help="For what was said of each case.",
)
def run(
    effects: tuple[str, ...], generators: tuple[str, ...], seeds: int, first_seed: int, jobs: int, out: Path
) -> None:
    """Records, calibrates, diagnoses; then the table."""
    chosen = effects or (*EFFECTS, "")
    cases = [
        (g, e, s)
        for s in range(first_seed, first_seed + seeds)
        for e in chosen
        for g in generators or (SECOND, LIBRARY)
    ]
    out.mkdir(parents=True, exist_ok=True)
    with (out / RESULTS).open("w") as file, progress_bar("naming") as progress:
        for done, row in enumerate(_done(cases, jobs), start=1):
            file.write(json.dumps(plain(row)) + "\n")
            file.flush()
            progress(done / len(cases), f"{row['effect'] or 'nothing'} {row['seed']}")
    click.echo(score.table(_rows(out)))


@main.command("score")
@click.argument("folders", type=click.Path(path_type=Path, exists=True), nargs=-1, required=True)
def scored(folders: tuple[Path, ...]) -> None:
    """Prints the table of what runs left in these folders."""
    click.echo(score.table([row for folder in folders for row in _rows(folder)]))


def _rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]


def _done(cases: Sequence[tuple[str, str, int]], jobs: int) -> Iterator[dict[str, Any]]:
    """Rows as they come. Workers last, with one thread each."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(run_case, *case) for case in cases]):
            yield future.result()


if __name__ == "__main__":
    main()
