"""python -m tools.naming run | score | foretell: has what was there from the first recording on one name, and does the
calibrated model carry it?"""

from __future__ import annotations

import json
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import progress_bar
from tautline.plain import plain
from tools.naming import foretell, score
from tools.naming.cases import EFFECTS, LIBRARY, SCORED_FROM, SECOND, makes
from tools.naming.work import run as run_case

RESULTS, FORETOLD = "names.jsonl", "foretold.jsonl"
Asked = tuple[str, str, int]  # generator, effect, seed
Work = Callable[[str, str, int], dict[str, Any]]


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
    click.echo(score.table(_written(run_case, _cases(effects, generators, seeds, first_seed), jobs, out, RESULTS)))


@main.command("foretell")
@click.option("--effect", "effects", multiple=True, type=click.Choice(EFFECTS), help="Default: all, and none.")
@click.option("--generator", "generators", multiple=True, type=click.Choice([SECOND, LIBRARY]), help="Default: both.")
@click.option("--seeds", type=click.IntRange(1), default=1, show_default=True, help="Of each effect and generator.")
@click.option("--first-seed", type=int, default=SCORED_FROM, show_default=True, help="Those before were tuned on.")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/naming"), help="For each case's figures.")
def foretold(
    effects: tuple[str, ...], generators: tuple[str, ...], seeds: int, first_seed: int, jobs: int, out: Path
) -> None:
    """Calibrates on two recordings, without naming and with it, and foretells the third; then the table."""
    cases = _cases(effects, generators, seeds, first_seed)
    click.echo(foretell.table(_written(foretell.run, cases, jobs, out, FORETOLD)))


@main.command("score")
@click.argument("folders", type=click.Path(path_type=Path, exists=True), nargs=-1, required=True)
def scored(folders: tuple[Path, ...]) -> None:
    """Prints the table of what runs left in these folders."""
    click.echo(score.table([row for folder in folders for row in _rows(folder)]))


def _rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / RESULTS).read_text().splitlines()]


def _cases(effects: Sequence[str], generators: Sequence[str], seeds: int, first_seed: int) -> list[Asked]:
    chosen = effects or (*EFFECTS, "")
    by_seed = range(first_seed, first_seed + seeds)
    return [(g, e, s) for s in by_seed for e in chosen for g in generators or (SECOND, LIBRARY) if makes(g, e)]


def _written(work: Work, cases: Sequence[Asked], jobs: int, out: Path, name: str) -> list[dict[str, Any]]:
    """The rows of all cases, which go to a file of the folder as they come."""
    rows = []
    out.mkdir(parents=True, exist_ok=True)
    with (out / name).open("w") as file, progress_bar("naming") as progress:
        for row in _done(work, cases, jobs):
            rows.append(plain(row))
            file.write(json.dumps(rows[-1]) + "\n")
            file.flush()
            progress(len(rows) / len(cases), f"{row['effect'] or 'nothing'} {row['seed']}")
    return rows


def _done(work: Work, cases: Sequence[Asked], jobs: int) -> Iterator[dict[str, Any]]:
    """Rows as they come. Workers last, with one thread each."""
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for future in as_completed([pool.submit(work, *case) for case in cases]):
            yield future.result()


if __name__ == "__main__":
    main()
