"""A blind campaign: cases are made, diagnosed, and only then opened and scored. What is done is not done again."""

from __future__ import annotations

import json
import secrets
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tautline.effects import BY_ID
from tautline.errors import TautError
from tautline.pool import Pool
from tools.blindtest import sealed, work
from tools.blindtest.cases import SCORED_FROM
from tools.blindtest.draws import KNOWN
from tools.blindtest.generators import GENERATORS, SECOND

Progress = Callable[[float, str], None]

FORMAT = "blindtest/1"
WITHOUT = "without"  # folder of what was said without a case's effect in the library
Wanted = tuple[int, str, tuple[str, ...], str]  # seed, kind, effects, generator

GROUPS = ("none", "unknown", "pairs", "triples")  # what `only` may name beside effects


@dataclass(frozen=True)
class Order:
    """How many cases of what."""

    seed: int = SCORED_FROM
    single: int = 40  # of each known effect
    unknown: int = 200
    none: int = 200
    pairs: int = 60
    triples: int = 0
    leave_one_out: int = 10  # of each known effect's single cases: how many are also diagnosed without it
    only: tuple[str, ...] = ()  # effects or GROUPS
    generators: tuple[str, ...] = (SECOND,)  # each makes as many

    def cases(self) -> list[Wanted]:
        """Of every generator. The seed of an effect's i-th case is the campaign's + i."""
        return [case for name in self.generators for case in self._cases_of(name)]

    def _cases_of(self, generator: str) -> list[Wanted]:
        made = GENERATORS[generator]
        wanted = set(self.only) or {*made.known, *made.unknown, *GROUPS}
        unknown = [name for name in made.unknown if name in wanted or "unknown" in wanted]
        result: list[tuple[int, str, tuple[str, ...]]] = []
        for name in made.known:
            if name in wanted:
                result += [(self.seed + i, "single", (name,)) for i in range(self.single)]
        if unknown:
            several = self.unknown if "unknown" in wanted else self.single * len(unknown)
            result += [(self.seed + i // len(unknown), "unknown", (unknown[i % len(unknown)],)) for i in range(several)]
        if "none" in wanted:
            result += [(self.seed + i, "none", ()) for i in range(self.none)]
        if "pairs" in wanted:
            result += [(self.seed + i, "pair", ()) for i in range(self.pairs)]
        if "triples" in wanted:
            result += [(self.seed + i, "triple", ()) for i in range(self.triples)]
        return [(*case, generator) for case in result]


def order_of(folder: Path) -> Order:
    """What the campaign in a folder was ordered as. Raises TautError where there is none yet."""
    plan = sealed.Campaign(folder).plan()
    if plan is None:
        raise TautError(f"{folder}: no campaign whose cases are all made is there: run it without --score first")
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in plan["order"].items()}
    return Order(**given)


def run(order: Order, folder: Path, pool: Pool, progress: Progress, stopped: bool = False) -> list[dict[str, Any]]:
    """Every case's record (work.score_case), in the plan's order. `stopped`: nothing more is diagnosed; the cases up to
    the first that is not are closed and scored, and stay all there are.
    Raises TautError where the folder holds another campaign, or something in it was changed after it was sealed."""
    campaign = sealed.Campaign(folder)
    plan = campaign.plan()
    if plan is None:
        plan = _make(order, campaign, pool, lambda done: progress(0.08 * done, "making cases"))
    elif plan["order"] != json.loads(json.dumps(asdict(order))):
        raise TautError(f"{folder}: holds another campaign (seed {plan['order']['seed']}): name a new folder")
    committed: dict[str, str] = plan["cases"]
    names = campaign.closed() or list(committed)
    todo = [name for name in names if not campaign.diagnosed(name)]
    if stopped and todo:  # up to the first: what was slow must not be left out
        names, todo = names[: names.index(todo[0])], []
        if not names:
            raise TautError(f"{folder}: nothing is diagnosed yet: run it without --score first")
    tasks = ((name, (campaign.case(name),)) for name in todo)
    for done, (name, files) in enumerate(pool(work.diagnose_case, tasks), len(names) - len(todo) + 1):
        campaign.write_diagnosis(name, files)
        progress(0.08 + 0.88 * done / len(names), f"diagnosed {done} of {len(names)}")
    campaign.close(names)

    opening = (
        (name, (campaign.case(name), campaign.open(name, committed[name]), campaign.diagnosis(name))) for name in names
    )
    records: dict[str, dict[str, Any]] = {}
    for name, record in pool(work.score_case, opening):
        records[name] = {"name": name, **record}
        progress(0.96 + 0.04 * len(records) / len(names), "opening labels")
    return [records[name] for name in names]


def interleaved(cases: Sequence[Wanted], rng: np.random.Generator) -> list[Wanted]:
    """Shuffled, but so that every beginning has its share of each effect, kind and generator: the i-th of n of one
    sort comes somewhere between i / n and (i + 1) / n."""
    count = Counter(case[1:] for case in cases)
    before: Counter[tuple[Any, ...]] = Counter()
    at = []
    for case in cases:
        sort = case[1:]
        at.append((before[sort] + rng.random()) / count[sort])
        before[sort] += 1
    return [cases[i] for i in np.argsort(at)]


def _make(order: Order, campaign: sealed.Campaign, pool: Pool, progress: Callable[[float], None]) -> dict[str, Any]:
    """The cases, interleaved: a name tells nothing."""
    wanted = order.cases()
    if not wanted:
        raise TautError("no case was asked for: raise --cases, --unknown, --none, --pairs or --triples")
    if (campaign.root / sealed.CLOSED).exists():
        raise TautError(f"{campaign.root}: its {sealed.PLAN} is gone: name a new folder")
    shuffled = interleaved(wanted, np.random.default_rng([order.seed, 0x5EA1]))
    names = {f"case-{at:04d}": case for at, case in enumerate(shuffled)}
    # A campaign that was stopped while cases were made goes on only if it was this one.
    mark = campaign.root / "making.json"
    text = sealed.canonical(asdict(order))
    if mark.exists() and mark.read_bytes() != text:
        raise TautError(f"{campaign.root}: holds the beginning of another campaign: name a new folder")
    campaign.root.mkdir(parents=True, exist_ok=True)
    mark.write_bytes(text)
    todo = [name for name in names if not campaign.made(name)]
    tasks = ((name, (*names[name][:3], secrets.token_hex(16), names[name][3])) for name in todo)
    for done, (name, (visible, hidden)) in enumerate(pool(work.make_case, tasks), len(names) - len(todo) + 1):
        campaign.write_case(name, visible, hidden)
        progress(done / len(names))
    committed = {name: campaign.sealed_commitment(name) for name in names}
    plan = {"format": FORMAT, "order": asdict(order), "cases": committed}
    campaign.commit(plan)
    mark.unlink()
    return plan


def left_out(
    order: Order,
    folder: Path,
    diagnosed: Sequence[Mapping[str, Any]],
    pool: Pool,
    progress: Progress,
    stopped: bool = False,
) -> list[dict[str, Any]]:
    """Records of `diagnosed`'s single cases diagnosed again by a library that lacks their effect: unknown is right.
    Parts of the nominal model are no effects that a library could lack: a recalibration has them. `stopped`: only of
    those that are already."""
    campaign = sealed.Campaign(folder)
    ranked: list[tuple[int, Mapping[str, Any]]] = []
    for effect in (name for name in KNOWN if not BY_ID[name].nominal):
        mine = [r for r in diagnosed if r["label"]["effects"] == [effect] and r["label"]["identifiable"]]
        ranked += enumerate(mine[: order.leave_one_out])
    folder = folder / WITHOUT
    chosen = [record for _, record in sorted(ranked, key=lambda pair: pair[0])]  # one of each effect, then the next
    if stopped:
        chosen = [record for record in chosen if (folder / record["name"]).is_dir()]
    labels = {record["name"]: {**record["label"], "kind": "left out"} for record in chosen}

    def tasks() -> Iterator[tuple[str, tuple[Any, ...]]]:
        for record in chosen:
            if not (folder / record["name"]).is_dir():
                yield record["name"], (campaign.case(record["name"]), tuple(record["label"]["effects"]))

    for name, files in pool(work.diagnose_case, tasks()):
        sealed.write(folder / name, files)
        done = sum((folder / record["name"]).is_dir() for record in chosen)
        progress(done / len(chosen), f"effects left out {done} of {len(chosen)}")
    committed = (campaign.plan() or {})["cases"]
    opening = (
        (name, (campaign.case(name), campaign.open(name, committed[name]), sealed.read(folder / name)))
        for name in labels
    )
    opened = dict(pool(work.score_case, opening))
    return [{"name": name, **opened[name], "label": label} for name, label in labels.items()]
