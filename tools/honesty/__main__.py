"""python -m tools.honesty run | score | list: does a calibration know what it does not know?"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from tools.honesty import score, sets, tables

RUNS, SCORES, TABLE, PICTURE = "runs.jsonl", "scores.json", "scores.md", "scores.png"


@click.group()
def main() -> None:
    """The honesty benchmark: instruments and faults that share no code with the library."""


@main.command("list")
def listed() -> None:
    """Names, families and sets of all conditions."""
    from tools.honesty.conditions import CONDITIONS

    for name, which in sets.of_each().items():
        click.echo(f"{which:7s} {CONDITIONS[name].family:26s} {name}")


@main.command()
@click.option("--set", "which", type=click.Choice(["tuning", "aside", "all"]), default="tuning", show_default=True)
@click.option("--only", multiple=True, help="A condition or a family; may be given several times.")
@click.option("--slice", "part", type=click.Choice(["ci"]), help="A few quick conditions.")
@click.option("--seeds", type=click.IntRange(1), default=5, show_default=True)
@click.option("--first-seed", type=int, default=0, show_default=True)
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True, help="Worker processes.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the scores.")
def run(which: str, only: tuple[str, ...], part: str | None, seeds: int, first_seed: int, jobs: int, out: Path) -> None:
    """Makes recordings, calibrates them, predicts an unseen motion of each, scores, deletes the data."""
    names = _chosen(which, only, part)
    cases = [(name, seed, where) for seed in range(first_seed, first_seed + seeds) for name, where in names.items()]
    out.mkdir(parents=True, exist_ok=True)
    with (out / RUNS).open("w") as file:
        for row in _progress(_done(cases, jobs), len(cases)):
            file.write(json.dumps(row) + "\n")
            file.flush()
    show(out)


@main.command("score")
@click.argument("folders", type=click.Path(path_type=Path, exists=True), nargs=-1, required=True)
@click.option("--conditions/--no-conditions", default=True, help="The table of every condition, too.")
def scored(folders: tuple[Path, ...], conditions: bool) -> None:
    """Prints the tables of a run again; several folders are put together and scored in the first."""
    show(folders[0], folders[1:], conditions)


@main.command()
@click.argument("name")
@click.argument("seed", type=int)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder of the case; OUT.truth.json is beside it.",
)
def keep(name: str, seed: int, out: Path) -> None:
    """Makes one case, runs it and keeps its recording, model and prediction."""
    from tools.honesty import runner

    out.mkdir(parents=True)
    click.echo(json.dumps(runner.run(name, seed, sets.of_each()[name], out), indent=1))


def _chosen(which: str, only: Sequence[str], part: str | None) -> dict[str, str]:
    from tools.honesty.conditions import CONDITIONS

    names = {name: where for name, where in sets.of_each().items() if which in (where, "all")}
    for name in [name for name in names if not CONDITIONS[name].possible]:
        click.echo(f"{name} is left out: it needs the package {CONDITIONS[name].needs}", err=True)
        del names[name]
    if part:
        names = {name: names[name] for name in sets.CI if name in names}
    if only:
        known = set(CONDITIONS) | {c.family for c in CONDITIONS.values()}
        if unknown := set(only) - known:
            raise click.UsageError(f"no condition or family is called {', '.join(sorted(unknown))}; 'list' shows them")
        names = {name: where for name, where in names.items() if {name, CONDITIONS[name].family} & set(only)}
        if not names:
            raise click.UsageError(f"these are not in the set '{which}': add --set all")
    return names


def _done(cases: Sequence[tuple[str, int, str]], jobs: int) -> Iterator[dict[str, Any]]:
    """Rows as they come. Workers last, with one thread each."""
    from tools.honesty import runner

    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(jobs, context, runner.warm) as pool:
        for future in as_completed([pool.submit(runner.run, *case) for case in cases]):
            yield future.result()


def _progress(rows: Iterator[dict[str, Any]], total: int) -> Iterator[dict[str, Any]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True)) as progress:
        task = progress.add_task("honesty", total=total)
        for row in rows:
            progress.update(task, advance=1, description=f"{row['name']} {row['seed']}: {row['verdict']}")
            yield row


def show(folder: Path, others: Sequence[Path] = (), conditions: bool = True) -> None:
    order = list(sets.of_each())
    rows = [json.loads(line) for path in (folder, *others) for line in (path / RUNS).read_text().splitlines()]
    rows.sort(key=lambda r: (order.index(r["name"]), r["seed"]))
    parts, table = tables.scores(rows), score.by_condition(rows)
    console = Console(width=None if sys.stdout.isatty() else 200)
    if conditions:
        console.print(tables.conditions(table))
    for title, part in parts.items():
        console.print("", tables.headline(title, part), sep="\n")
    (folder / SCORES).write_text(json.dumps({"sets": parts, "conditions": table}, indent=1))
    (folder / TABLE).write_text(tables.markdown(parts, table))
    tables.picture(rows, folder / PICTURE)
    console.print(f"\n{folder / TABLE}, {folder / PICTURE}")


if __name__ == "__main__":
    main()
