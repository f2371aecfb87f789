"""./run bench constants: all numbers that were chosen drawn anew within +-30 %, jointly or one at a time."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import log, progress_bar
from tools.constants.find import ROOT, UNSTATED, Constant, constants
from tools.constants.sessions import Session, sessions

SPREAD = 0.3
RUNS = "runs.jsonl"
AS_IT_IS = "as it is"
_ENDS = (1.0 - SPREAD, 1.0 + SPREAD)

Order = tuple[str, dict[str, float], float]  # what it is called, factors by constant, factor of what is learnt


def drawn(chosen: Sequence[Constant], draws: int, seed: int) -> list[Order]:
    """Every constant by itself and all at once, uniform within the spread."""
    orders: list[Order] = []
    for i in range(draws):
        rng = np.random.default_rng([seed, i])
        factors = rng.uniform(*_ENDS, len(chosen) + 1).tolist()
        orders.append((f"draw {seed}/{i}", {c.key: f for c, f in zip(chosen, factors, strict=False)}, factors[-1]))
    return orders


def one_by_one(chosen: Sequence[Constant]) -> list[Order]:
    return [(f"{c.key} x {factor:g}", {c.key: factor}, 1.0) for c in chosen for factor in _ENDS]


def run(orders: Sequence[Order], cases: Sequence[Session], folder: Path, jobs: int) -> Iterator[dict[str, Any]]:
    """A row a draw and session; those that were run before are read."""
    kept = folder / RUNS
    done = [json.loads(line) for line in kept.read_text().splitlines()] if kept.is_file() else []
    there = {(row["draw"], row["session"]) for row in done}
    names = {case.name for case in cases}
    yield from (row for row in done if row["session"] in names and row["draw"] in {order[0] for order in orders})
    with ThreadPoolExecutor(jobs) as pool, kept.open("a") as file:

        def rows_of(order: Order) -> list[dict[str, Any]]:
            return _worked(order, [case for case in cases if (order[0], case.name) not in there])

        for rows in pool.map(rows_of, orders):
            for row in rows:
                file.write(json.dumps(row) + "\n")
                yield row
            file.flush()


def _worked(order: Order, cases: Sequence[Session]) -> list[dict[str, Any]]:
    if not cases:
        return []
    name, factors, learnt = order
    with tempfile.TemporaryDirectory(prefix="constants-") as out:
        asked = {"factors": factors, "learnt": learnt, "sessions": [asdict(case) for case in cases], "out": out}
        made = subprocess.run(
            [sys.executable, "-m", "tools.constants.worker"],
            input=json.dumps(asked),
            text=True,
            capture_output=True,
            cwd=ROOT,
        )
    rows = [json.loads(line) for line in made.stdout.splitlines() if line.startswith("{")]
    lost = [case.name for case in cases if case.name not in {row["session"] for row in rows}]
    why = made.stderr.strip().splitlines()[-1:] or [""]
    rows += [{"session": session, "verdict": "crash", "reasons": [], "said": why[0][:300]} for session in lost]
    return [{"draw": name, **row} for row in rows]


def changed(rows: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Those whose verdict is another than with the numbers as they are."""
    own = {row["session"]: row["verdict"] for row in rows if row["draw"] == AS_IT_IS}
    return [row for row in rows if row["verdict"] != own[row["session"]]]


@click.command("constants")
@click.option("--draws", type=click.IntRange(0), default=100, show_default=True, help="Of all constants at once.")
@click.option(
    "--sessions",
    "count",
    type=click.IntRange(1),
    default=20,
    show_default=True,
    help="Sound ones, and as many with a fault.",
)
@click.option("--one-by-one", "alone", is_flag=True, help="Each constant at either end, on the sound sessions: hours.")
@click.option("--seed", type=int, default=1, show_default=True)
@click.option("--only", help="Constants of files whose name begins so.")
@click.option("--jobs", type=click.IntRange(1), default=2, show_default=True)
@click.option("--out", type=click.Path(path_type=Path), default=Path("build/constants"), show_default=True)
def command(draws: int, count: int, alone: bool, seed: int, only: str | None, jobs: int, out: Path) -> None:
    """Does a verdict hang on a number that somebody chose? What was run before is not run again."""
    found = constants()
    chosen = [each for each in found if each.varied and each.file.startswith(only or "")]
    out.mkdir(parents=True, exist_ok=True)
    log("making the sessions ...")
    cases = sessions(out, count)
    sound = [case for case in cases if case.sound]
    orders = [(AS_IT_IS, {}, 1.0), *drawn(chosen, draws, seed)]
    rows: list[dict[str, Any]] = []
    with progress_bar("draws") as progress:
        total = len(orders) * len(cases) + (2 * len(chosen) * len(sound) if alone else 0)
        for row in run(orders, cases, out, jobs):
            rows.append(row)
            progress(len(rows) / total, row["draw"])
        for row in run(one_by_one(chosen), sound, out, jobs) if alone else ():
            rows.append(row)
            progress(len(rows) / total, row["draw"])
    show(found, cases, rows)


def show(found: Sequence[Constant], cases: Sequence[Session], rows: Sequence[dict[str, Any]]) -> None:
    console = Console(width=None if sys.stdout.isatty() else 120)
    kinds = Table(title="Constants that decide")
    for kind in sorted({each.kind for each in found}, key=lambda kind: (kind == UNSTATED, kind)):
        kinds.add_column(kind, justify="right")
    kinds.add_row(*(str(sum(each.kind == str(column.header) for each in found)) for column in kinds.columns))
    console.print(kinds)
    other = changed(rows)
    table = Table(title=f"Verdicts that change within +-{SPREAD:.0%}")
    for name in ("session", "as it is", "changed", "of", "to"):
        table.add_column(name, justify="right" if name in ("changed", "of") else "left")
    for case in cases:
        mine = [row for row in rows if row["session"] == case.name]
        moved = [row for row in other if row["session"] == case.name]
        own = next(row["verdict"] for row in mine if row["draw"] == AS_IT_IS)
        to = ", ".join(sorted({row["verdict"] for row in moved}))
        table.add_row(case.name, own, str(len(moved)), str(len(mine) - 1), to)
    console.print(table)
    for sound, title in ((True, "nothing wrong"), (False, "something wrong")):
        names = {case.name for case in cases if case.sound is sound}
        tried = sum(row["session"] in names and row["draw"] != AS_IT_IS for row in rows)
        moved_here = sum(row["session"] in names for row in other)
        console.print(f"{title}: {moved_here} of {tried} verdicts change", highlight=False)
    single = [row for row in other if not row["draw"].startswith("draw ")]
    for row in single:
        console.print(f"{row['draw']}: {row['session']} is {row['verdict']}", highlight=False)
