"""python -m tools.tracking run | real: does a model stay calibrated in use?"""

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
from rich.table import Table

from tautline.plain import plain
from tools.tracking import real, score
from tools.tracking.cases import one
from tools.tracking.sessions import CHANGES, COST, DISTURBED, OUTSIDE

KINDS = (*CHANGES, *OUTSIDE, *DISTURBED)
RESULTS = "sessions.jsonl"


@click.group()
def main() -> None:
    """Tracking in use, scored from the truth of instruments that share no code with it, and on real tools."""


@main.command()
@click.option("--kind", "kinds", multiple=True, type=click.Choice(KINDS), help="Default: all.")
@click.option("--sessions", "count", type=click.IntRange(1), default=20, show_default=True, help="Of each kind.")
@click.option("--first-seed", type=int, default=1000, show_default=True, help="Seeds below 1000 were tuned on.")
@click.option("--seconds", type=float, default=90.0, show_default=True, help="Of a session.")
@click.option("--ideal", is_flag=True, help="Models with the true tables instead of calibrated ones: quicker.")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), help="Folder for the scores of each session.")
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def run(
    kinds: tuple[str, ...],
    count: int,
    first_seed: int,
    seconds: float,
    ideal: bool,
    jobs: int,
    out: Path | None,
    as_json: bool,
) -> None:
    """Sessions of teleoperation: changes of each kind, and disturbances without one."""
    cases = [(k, s, seconds, ideal) for s in range(first_seed, first_seed + count) for k in kinds or KINDS]
    results = sorted(_done(cases, jobs), key=lambda r: (KINDS.index(r["kind"]), r["seed"]))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        (out / RESULTS).write_text("".join(json.dumps(plain(r)) + "\n" for r in results))
    rows = score.table(results, COST)
    if as_json:
        click.echo(json.dumps(plain(rows)))
    else:
        _show(rows)


@main.command("real")
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--json", "as_json", is_flag=True, help="Print the table as JSON.")
def on_real_tools(data: Path | None, as_json: bool) -> None:
    """The da Vinci tools: calibrated on one run, tracked through the others in order. DATA: the folder with davinci and
    davinci-posture."""
    folder = data or real.find()
    if folder is None:
        raise click.ClickException("no da Vinci data beside the repository: name their folder")
    rows = real.table(folder)
    if as_json:
        click.echo(json.dumps(plain(rows)))
    else:
        _show(rows)


def _show(rows: Sequence[dict[str, Any]]) -> None:
    console = Console(width=None if sys.stdout.isatty() else 160)
    groups: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row), []).append(row)
    for names, group in groups.items():
        table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
        for i, name in enumerate(names):
            table.add_column(name, justify="right" if i else "left")
        for row in group:
            table.add_row(
                *(f"{v:.3g}" if isinstance(v, float) else ("" if v is None else str(v)) for v in row.values())
            )
        console.print(table, highlight=False)


def _done(cases: Sequence[tuple[str, int, float, bool]], jobs: int) -> Iterator[dict[str, Any]]:
    if jobs == 1:
        yield from map(one, cases)
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn")) as pool:
        for done in as_completed([pool.submit(one, case) for case in cases]):
            yield done.result()


if __name__ == "__main__":
    main()
