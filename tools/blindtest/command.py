"""taut blindtest"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import click

from tautline.cli._common import emit, json_option, log, progress_bar, warn
from tautline.cli._outputs import folder_option
from tautline.pool import pool
from tools.blindtest import compare, page
from tools.blindtest.baselines import METHODS
from tools.blindtest.campaign import GROUPS, Order, Progress, left_out, order_of, run
from tools.blindtest.draws import KNOWN, UNKNOWN
from tools.blindtest.generators import CHOICES, chosen

_QUICK = Order(single=1, unknown=4, none=3, pairs=1, leave_one_out=0)
_ENOUGH = 0.15  # of the work: from then on the rest can be told
_QUICK_BASELINES = ("majority", "joint", "bic")


def announcing(progress: Progress) -> Progress:
    """The same, and once, where enough is done to tell, a line that says how long the rest takes."""
    begun: list[tuple[float, float]] = []  # when a first report came, and of how much
    told: list[float] = []

    def report(done: float, text: str) -> None:
        progress(done, text)
        now_s = time.monotonic()
        begun.extend([] if begun else [(now_s, done)])
        first_s, before = begun[0]
        if not told and done - before >= _ENOUGH:
            left_s = (now_s - first_s) * (1.0 - done) / (done - before)
            told.append(left_s)
            log(f"taut: {text}; the rest takes about {max(1, round(left_s / 60.0))} min")

    return report


@click.command("blindtest")
@folder_option("--out", "Folder of the campaign. One that was interrupted goes on where it was.")
@click.option("--seed", type=int, help="Of the campaign; tuning is done below 1000000. Default: 1000000, scored.")
@click.option("--cases", type=click.IntRange(0), help="Of each known effect alone. Default: 40.")
@click.option("--unknown", type=click.IntRange(0), help="With an effect outside the library. Default: 200.")
@click.option("--none", type=click.IntRange(0), help="With nothing unmodelled. Default: 200.")
@click.option("--pairs", type=click.IntRange(0), help="With two known effects. Default: 60.")
@click.option("--triples", type=click.IntRange(0), help="With three known effects. Default: 0.")
@click.option(
    "--leave-one-out",
    type=click.IntRange(0),
    help="Of each known effect's cases: how many are also diagnosed without it in the library (parts of the nominal "
    "model are none: a recalibration has them). Default: 10, "
    "0 with --quick or --only.",
)
@click.option(
    "--only",
    multiple=True,
    metavar="EFFECT",
    type=click.Choice([*GROUPS, *KNOWN, *UNKNOWN]),
    help=f"Cases of this alone: an effect, or {', '.join(GROUPS)}. May be given several times.",
)
@click.option(
    "--generator",
    "generators",
    multiple=True,
    type=click.Choice(CHOICES),
    help="What makes the cases; as many of each. May be given several times. Default: second.",
)
@click.option(
    "--leave-out",
    "left_out_generators",
    multiple=True,
    type=click.Choice(CHOICES),
    help="Take the generators but this; alone: all others. May be given several times.",
)
@click.option(
    "--baselines",
    multiple=True,
    type=click.Choice([*METHODS, "none"]),
    help="What to score on the same cases too. May be given several times. Default: all whose packages are installed; "
    f"{', '.join(_QUICK_BASELINES)} with --quick, none with --only.",
)
@click.option(
    "--every",
    type=click.IntRange(1),
    default=compare.EVERY,
    show_default=True,
    help="Baselines answer every so manyth case of each effect and kind.",
)
@click.option(
    "--score",
    "stopped",
    is_flag=True,
    help="Work no further: close the campaign with the cases that are diagnosed, and score what is there.",
)
@click.option(
    "--quick", is_flag=True, help=f"{len(_QUICK.cases())} cases. How long it takes is said once some are diagnosed."
)
@click.option("--jobs", type=click.IntRange(1), help="Processes. Default: one on each core.")
@click.option("--dask", "dask_address", metavar="ADDRESS", help="Work on a Dask cluster: its scheduler's address.")
@json_option
def command(
    out: Path,
    seed: int | None,
    cases: int | None,
    unknown: int | None,
    none: int | None,
    pairs: int | None,
    triples: int | None,
    leave_one_out: int | None,
    only: tuple[str, ...],
    generators: tuple[str, ...],
    left_out_generators: tuple[str, ...],
    baselines: tuple[str, ...],
    every: int,
    stopped: bool,
    quick: bool,
    jobs: int | None,
    dask_address: str | None,
    as_json: bool,
) -> None:
    """Diagnoses instruments whose effect is withheld, then opens the labels and scores."""
    order = _QUICK if quick else Order(leave_one_out=0) if only else Order()
    given = {
        "seed": seed,
        "single": cases,
        "unknown": unknown,
        "none": none,
        "pairs": pairs,
        "triples": triples,
        "leave_one_out": leave_one_out,
    }
    taken, missing_ones = chosen(generators, left_out_generators)
    for name in missing_ones:
        warn(f"without the generator '{name}', whose package is not there: run ./run setup")
    numbers = {name: value for name, value in given.items() if value is not None}
    order = replace(order, only=only, generators=taken, **numbers)
    if stopped:
        order = order_of(out)
    wanted = baselines or (("none",) if order.only else _QUICK_BASELINES if quick else None)
    methods = compare.available(wanted if wanted is None else [name for name in wanted if name != "none"])
    for missing in sorted(set(METHODS) - set(methods)) if wanted is None else ():
        warn(f"without the baseline '{missing}', whose package is not there: run ./run setup")
    if not stopped:
        log(f"taut: {len(order.cases())} cases of seed {order.seed}; it may be stopped, and goes on where it was")
    with progress_bar("blind test") as bar, pool(jobs, dask_address) as workers:
        progress = announcing(bar)

        def within(low: float, high: float) -> Progress:
            return lambda done, text: progress(low + (high - low) * done, text)

        diagnosed = 1.0 - (0.2 if methods else 0.0) - (0.1 if order.leave_one_out else 0.0)
        compared = 0.9 if order.leave_one_out else 1.0
        records = run(order, out, workers, within(0.0, diagnosed), stopped)
        if methods:
            records = compare.answers(methods, records, out, workers, within(diagnosed, compared), every, stopped)
        records += left_out(order, out, records, workers, within(compared, 1.0), stopped)
    result = page.write(records, out)
    emit(result, as_json, page.text(result) + f"\n{out / page.FILE}")
