"""Baselines on a campaign's cases, after its labels were opened. What is done already is not done again."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from tautline.blindtest import baselines, scores, sealed, work
from tautline.blindtest.baselines import Forest
from tautline.blindtest.cases import Label
from tautline.blindtest.draws import KNOWN, UNKNOWN
from tautline.blindtest.pool import Pool
from tautline.errors import TautError
from tautline.folders import write_file

Progress = Callable[[float, str], None]

TRAINING_SEED = 900_000  # tuning seeds that nothing else is tuned on
TRAINED_ON = {"single": 10, "unknown": 8, "none": 40}  # cases of each effect; with nothing
FOLDER, TRAINING = "baselines", "training.json"


def available(wanted: Sequence[str] | None) -> list[str]:
    """The methods that can be run here: all those `wanted`, or else every one whose packages are installed."""
    missing = {m for m, package in baselines.NEEDS.items() if find_spec(package) is None}
    for method in wanted or ():
        if method in missing:
            raise TautError(f"the baseline '{method}' needs more packages: pip install 'tautline[campaign]'")
    return [m for m in baselines.METHODS if (m in wanted if wanted is not None else m not in missing)]


def answers(
    methods: Sequence[str], records: Sequence[Mapping[str, Any]], root: Path, pool: Pool, progress: Progress
) -> list[dict[str, Any]]:
    """`records` of campaign.run, each with `answers`: what every method said of it."""
    campaign = sealed.Campaign(root)
    plan = campaign.plan()
    assert plan is not None
    forest = (
        _forest(root, pool, lambda done: progress(0.4 * done, "training a forest")) if "forest" in methods else None
    )
    on_cases = [m for m in methods if m in baselines.ON_CASES]
    scored = [r for r in records if r["label"]["kind"] != "left out"]
    todo = [r["name"] for r in scored if not _done(root, r["name"], on_cases)] if on_cases or forest else []
    tasks = (
        (name, (campaign.case(name), campaign.open(name, plan["cases"][name]), campaign.diagnosis(name), on_cases))
        for name in todo
    )
    for done, (name, found) in enumerate(pool(work.baseline_case, tasks), 1):
        write_file(root / FOLDER / f"{name}.json", sealed.canonical(found).decode())
        progress(0.4 + 0.6 * done / len(todo), f"baselines {done} of {len(todo)}")
    labels = [Label.from_json(r["label"]) for r in scored if r["label"]["kind"] != "pair"]
    commonest = baselines.majority([scores.truth(label) for label in labels])
    result = []
    for record in records:
        said: dict[str, Any] = {}
        if record["label"]["kind"] != "left out":
            if "majority" in methods:
                said["majority"] = scores.to_json(commonest)
            path = root / FOLDER / f"{record['name']}.json"
            found = json.loads(path.read_text()) if on_cases or forest else {}
            if forest and "features" in found:
                case = np.array(found["features"])
                said["forest"] = scores.to_json(forest.answer(case, found["features_core_s"]))
            said |= {method: found[method] for method in on_cases}
        result.append({**record, "answers": {m: said[m] for m in methods if m in said}})
    return result


def _done(root: Path, name: str, methods: Sequence[str]) -> bool:
    path = root / FOLDER / f"{name}.json"
    return path.exists() and set(methods) <= set(json.loads(path.read_text()))


def _forest(root: Path, pool: Pool, progress: Callable[[float], None]) -> Forest:
    path = root / TRAINING
    seen: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    kinds = [("single", (name,)) for name in KNOWN] + [("unknown", (name,)) for name in UNKNOWN] + [("none", ())]
    wanted: dict[str, tuple[Any, ...]] = {
        f"{' '.join(effects) or kind} {TRAINING_SEED + i}": (TRAINING_SEED + i, kind, effects)
        for kind, effects in kinds
        for i in range(TRAINED_ON[kind])
    }
    tasks = ((name, arguments) for name, arguments in wanted.items() if name not in seen)
    for name, found in pool(work.learn_case, tasks):
        seen[name] = found
        write_file(path, sealed.canonical(seen).decode())
        progress(len(seen) / len(wanted))
    ordered = [seen[name] for name in wanted if seen[name]["features"] is not None]
    return Forest(np.array([x["features"] for x in ordered]), tuple(x["verdict"] for x in ordered))
