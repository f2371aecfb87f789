"""How many wrong programs the C tests tell from the right one: mutants by fixed operators, drawn by a seed.

    ./run trust mutants [--count 400] [--seed 1] [--jobs N] [--at FILE:LINE] [--host]

A mutant is one change in one function of common/, firmware/estimator or firmware/app: a comparison, a constant by one,
a statement dropped, a sign, a condition negated. It is killed where a program of tests/c fails or does not end, those
first that run its line, as it is or with the sanitizers with which CI runs it too; with --host also where one of the
host's tests of the fixed-point code does. What the boards' tests would see is not asked. Not counted: what does not
compile, what compiles to the same, what is in equivalent.toml. Outcomes are kept in build/mutants/outcomes.jsonl: a
run that was ended goes on, one with another --count tries only what is new, and one after a new test shows this one to
what survived.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import asdict
from pathlib import Path
from queue import SimpleQueue

from rich.progress import Progress
from scipy.stats import binomtest

from tools.kept import keep
from tools.mutation import hosted
from tools.mutation.coverage import reached
from tools.mutation.equivalent import equivalents
from tools.mutation.sites import Mutant, all_mutants, drawn
from tools.mutation.trial import Outcome, Trial, digest, programs

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "build" / "mutants"
OPERATORS = ("comparison", "constant", "dropped", "sign", "condition")


def known(file: Path, of: dict[str, str]) -> tuple[dict[Mutant, Outcome], dict[Mutant, frozenset[str]]]:
    """From a JSON lines file what holds for today's sources and tests: outcomes, and the tests that others pass.

    `of` has their digests, under "" that of the sources. A last line cut off says nothing.
    """
    outcomes, passes = {}, {}
    for line in file.read_text("utf-8").splitlines() if file.is_file() else []:
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        mutant = Mutant(**row["mutant"])
        holds = frozenset(test for test, digest_of in row["of"].items() if of.get(test) == digest_of)
        survived = row["outcome"]["how"] == "survived"
        if holds == row["of"].keys() and (not survived or holds >= of.keys() - {""}):
            outcomes[mutant] = Outcome(**row["outcome"], passes=tuple(sorted(holds)) if survived else ())
        elif survived:
            passes[mutant] = holds
    return outcomes, passes


def tried(mutants: list[Mutant], jobs: int, kept: Path, host: bool) -> dict[Mutant, Outcome]:
    """The outcome of each, tried now or before; each is kept as soon as it is there."""
    tests = [*programs(ROOT), *(hosted.OF if host else ())]
    file, of = kept / "outcomes.jsonl", {test: digest(ROOT, test) for test in ("", *tests)}
    outcomes, passes = known(file, of)
    left = [mutant for mutant in mutants if mutant not in outcomes]
    kept.mkdir(parents=True, exist_ok=True)
    jobs = min(jobs, len(left))
    with Progress(transient=True) as progress, ThreadPoolExecutor(max(1, jobs)) as pool, file.open("a") as out:
        task = progress.add_task("building the tests", total=None)
        covers = reached(ROOT, kept / "coverage", {test: of[test] for test in programs(ROOT)}) if left else {}
        covers |= hosted.covers({Path(each.file).stem: each.file for each in mutants}) if host else {}
        free: SimpleQueue[Trial] = SimpleQueue()
        for trial in pool.map(lambda number: Trial(ROOT, kept / str(number), covers), range(jobs)):
            free.put(trial)

        def one(mutant: Mutant) -> tuple[Mutant, Outcome]:
            trial = free.get()
            try:
                return mutant, trial.of(mutant, passes.get(mutant, frozenset()))
            finally:
                free.put(trial)

        progress.update(task, description="mutants", total=len(left))
        for done in as_completed([pool.submit(one, mutant) for mutant in left]):
            mutant, outcome = done.result()
            outcomes[mutant] = outcome
            asked = {test: of[test] for test in outcome.passes or (outcome.test,)}
            row = {"of": asked, "mutant": asdict(mutant), "outcome": {"how": outcome.how, "test": outcome.test}}
            out.write(json.dumps(row) + "\n")
            out.flush()
            progress.advance(task)
    return {mutant: outcomes[mutant] for mutant in mutants}


def share(killed: int, counted: int) -> str:
    """The killed share with the exact (Clopper and Pearson's) interval of 90 %."""
    if counted == 0:
        return "none counted"
    bounds = binomtest(killed, counted).proportion_ci(0.9)
    return f"{killed} of {counted} killed, {killed / counted:.1%} (90 %: {bounds.low:.1%} to {bounds.high:.1%})"


def report(outcomes: dict[Mutant, Outcome], listed: dict[Mutant, str]) -> str:
    """Prints each survivor and the shares; returns that of all."""
    ways = Counter(outcome.how for outcome in outcomes.values())
    listed = {mutant: why for mutant, why in listed.items() if mutant in outcomes}
    if killed := [mutant for mutant in listed if outcomes[mutant].how in ("killed", "time")]:
        raise SystemExit(f"mutation: {killed[0].file}:{killed[0].line} is listed as equivalent, and a test kills it")
    counted = {
        mutant: outcome
        for mutant, outcome in outcomes.items()
        if outcome.how in ("killed", "time", "survived") and mutant not in listed
    }
    for mutant, outcome in sorted(counted.items()):
        if outcome.how == "survived":
            was, becomes = mutant.change((ROOT / mutant.file).read_bytes())
            print(f"survived {mutant.file}:{mutant.line} {mutant.operator}\n    {was}\n    {becomes}")
    print(
        f"{len(outcomes)} drawn; not counted: {ways['build']} do not compile, {ways['same']} compile to the same,"
        f" {len(listed)} listed as equivalent"
    )
    said = {}
    for operator in (*OPERATORS, "all"):
        hows = [each.how for mutant, each in counted.items() if operator in (mutant.operator, "all")]
        said[operator] = share(sum(how != "survived" for how in hows), len(hows))
        print(f"{operator:11s}{said[operator]}")
    killed, alive = (sum(how.how in hows for how in outcomes.values()) for hows in (("killed", "time"), ("survived",)))
    print(f"with those listed counted as survivors: {share(killed, killed + alive)}")
    return said["all"]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=400)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="mutants at once; as many as there are cores")
    parser.add_argument("--at", metavar="FILE:LINE", default="", help="all mutants of this line instead of drawn ones")
    parser.add_argument("--host", action="store_true", help="show what survives to the host's tests of this code, too")
    options = parser.parse_args()
    mutants = all_mutants(ROOT)
    listed = equivalents(mutants, ROOT)
    chosen = drawn(mutants, options.count, options.seed)
    if options.at:
        chosen = [each for each in mutants if f"/{each.file}:{each.line}".endswith(f"/{options.at}")]
    print(f"{len(chosen)} of {len(mutants)} mutants", flush=True)
    killed = report(tried(chosen, options.jobs, KEPT, options.host), listed)
    if not options.at:
        keep("mutants", ("drawn", "killed"), [(f"{len(chosen)} by seed {options.seed}", killed)])
    return 0


if __name__ == "__main__":
    sys.exit(main())
