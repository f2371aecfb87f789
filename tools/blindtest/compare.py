"""Baselines on a campaign's cases, after its labels were opened. What is done already is not done again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from tautline.errors import TautError
from tautline.folders import write_file
from tautline.pool import Pool
from tools.blindtest import baselines, scores, sealed, work
from tools.blindtest.baselines import Forest
from tools.blindtest.cases import SEVERAL, Label
from tools.blindtest.draws import KNOWN, UNKNOWN
from tools.blindtest.scores import Answer

Progress = Callable[[float, str], None]

EVERY = 2  # on two cores a campaign of the default size takes 3 h with all baselines on so many cases of each sort

TRAINING_SEED = 900_000  # tuning seeds that nothing else is tuned on
TRAINED_ON = {"single": 7, "unknown": 5, "none": 28}  # cases of each effect; with nothing
FOLDER, TRAINING = "baselines", "training.json"


def available(wanted: Sequence[str] | None) -> list[str]:
    """The methods that can be run here: all those `wanted`, or else every one whose packages are installed."""
    missing = {m for m, package in baselines.NEEDS.items() if find_spec(package) is None}
    for method in wanted or ():
        if method in missing:
            raise TautError(f"the baseline '{method}' needs more packages: run ./run setup")
    return [m for m in baselines.METHODS if (m in wanted if wanted is not None else m not in missing)]


def answers(
    methods: Sequence[str],
    records: Sequence[Mapping[str, Any]],
    root: Path,
    pool: Pool,
    progress: Progress,
    every: int = EVERY,
    stopped: bool = False,
) -> list[dict[str, Any]]:
    """`records` of campaign.run, those of `subset` with `answers`: what every method said of it, and `failed`: what
    ended a method in an error, by method. `stopped`: nothing
    more is worked out; the cases that have every method's answer already are all there are."""
    campaign = sealed.Campaign(root)
    plan = campaign.plan()
    assert plan is not None
    names = subset(records, every)
    on_cases = [m for m in methods if m in baselines.ON_CASES]
    forest = None
    if "forest" in methods:
        forest = _forest(root, pool, lambda done: progress(0.3 * done, "training a forest"), stopped)
    wanted = [*on_cases, *(["features"] if forest else [])]
    missing = {name: [m for m in wanted if m not in _found(root, name)] for name in names}
    if stopped:
        names = [name for name in names if not missing[name]]
    todo = [name for name in names if missing[name]]
    tasks = (
        (name, (campaign.case(name), campaign.open(name, plan["cases"][name]), campaign.diagnosis(name), need))
        for name in todo
        for need in [[m for m in missing[name] if m in on_cases]]
    )
    for done, (name, outcome) in enumerate(pool(work.baseline_case, tasks), 1):
        known = _found(root, name)
        errors = {**known.get("errors", {}), **outcome["errors"]}
        write_file(root / FOLDER / f"{name}.json", sealed.canonical({**known, **outcome, "errors": errors}).decode())
        progress(0.3 + 0.7 * done / len(todo), f"baselines {done} of {len(todo)}")
    chosen = set(names)
    labels = [Label.from_json(r["label"]) for r in records]
    truths = [scores.truth(x) for x in labels if scores.counts(x) and x.kind not in SEVERAL]
    result = []
    for record in records:
        answered: dict[str, Any] = {}
        failed: dict[str, str] = {}
        if record["name"] in chosen:
            outcome = _found(root, record["name"])
            answered = {method: outcome[method] for method in on_cases}
            if "majority" in methods and truths:
                answered["majority"] = scores.to_json(baselines.majority(truths))
            if forest:
                case, spent = outcome["features"], outcome["features_core_s"]
                answer = forest.answer(np.array(case), spent) if case else Answer((), scores.FAILED, spent)
                answered["forest"] = scores.to_json(answer)
            failed = {m: what for m, what in outcome.get("errors", {}).items() if m in on_cases}
        result.append({**record, "answers": {m: answered[m] for m in methods if m in answered}, "failed": failed})
    return result


def subset(records: Sequence[Mapping[str, Any]], every: int) -> list[str]:
    """The first and each further `every`-th case of each effect and kind that is scored, in the records' order."""
    seen: Counter[tuple[str, ...]] = Counter()
    names = []
    for record in records:
        label = Label.from_json(record["label"])
        if not scores.counts(label):
            continue
        sort = (label.kind, *(label.effects if label.kind not in SEVERAL else ()))
        if seen[sort] % every == 0:
            names.append(record["name"])
        seen[sort] += 1
    return names


def _found(root: Path, name: str) -> dict[str, Any]:
    path = root / FOLDER / f"{name}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def _forest(root: Path, pool: Pool, progress: Callable[[float], None], stopped: bool) -> Forest | None:
    """None where it was not trained to the end and nothing more is worked out."""
    path = root / TRAINING
    seen: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    kinds = [("single", (name,)) for name in KNOWN] + [("unknown", (name,)) for name in UNKNOWN] + [("none", ())]
    wanted: dict[str, tuple[Any, ...]] = {
        f"{' '.join(effects) or kind} {TRAINING_SEED + i}": (TRAINING_SEED + i, kind, effects)
        for kind, effects in kinds
        for i in range(TRAINED_ON[kind])
    }
    if stopped and not set(wanted) <= set(seen):
        return None
    tasks = ((name, arguments) for name, arguments in wanted.items() if name not in seen)
    for name, learnt in pool(work.learn_case, tasks):
        seen[name] = learnt
        write_file(path, sealed.canonical(seen).decode())
        progress(len(seen) / len(wanted))
    ordered = [seen[name] for name in wanted if seen[name]["features"] is not None]
    return Forest(np.array([x["features"] for x in ordered]), tuple(x["verdict"] for x in ordered))
