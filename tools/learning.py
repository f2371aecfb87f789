"""python -m tools.learning CAMPAIGN...: learns how right and wrong hypotheses behave from blind tuning campaigns, and
from the cases of opened families that `python -m tools.family_evidence` diagnosed.

The hyperparameters that make the truth likeliest (maximum a posteriori about what was set by hand; generators weigh as
their cases do); of a family of generators that was left out what that says; and how much of the probability a set must
hold for the right effect to be in it, by split-conformal quantiles over what was left out. --write puts the result
where `taut diagnose` reads it. --claims tells alone how far apart what an unseen motion leaves is from what was
claimed, and how often what the other families learn of that covers a family's.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import minimize

from tautline.diagnosis import gap, hyperparameters, moved
from tautline.diagnosis.decide import Decision, decide, is_open, probabilities, with_moved
from tautline.diagnosis.hyperparameters import NAMES, Hyperparameters, Learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.repeated import HELD
from tautline.diagnosis.stacked import Stacked
from tautline.effects import BY_ID, EVENTS
from tools import family_evidence
from tools.blindtest import sealed, work
from tools.blindtest.campaign import WITHOUT
from tools.blindtest.cases import SCORED_FROM, Label
from tools.blindtest.page import RESULT
from tools.blindtest.scores import CLOSABLE, IMITATED, NONE, SURE, UNEXPLAINED, counts, truth
from tools.family.score import rms

Array = npt.NDArray[np.float64]

START = Hyperparameters(
    noise_tells=6.0, block_freedom=3.0, unexplained=0.02, unexplained_by_law=1e-4,
    unexplained_by_wrong=0.2, mimics=0.03, share_spread=1.5, calibration_excess=0.1, odds_none=30.0, odds_unknown=0.9,
    odds_further=0.05, odds_brought=0.3, odds_each=0.1, parameter_price=0.5, floor_known=0.2, floor_steady=0.07,
    wanders=0.01, wanders_material=0.08, disturbed=0.03,
)  # fmt: skip  # docs/diagnosis.md says why
_PRIOR = 0.7  # spread of a logarithm about START
_STEPS, _MOST, _STEP = 25, 35, 0.02  # most: slopes asked for, where a kink stops a search
_FLAT = 1e-4  # of a loss: a further step gains less
_LEAST = 0.01  # of a truth's probability: no case says more than that all is wrong
_MIX = {NONE: 0.25, UNEXPLAINED: 0.25}  # of a generator's weight; the rest is of effects
_COVERS = 0.95
_ENDS = (0.05, 0.95)  # of the interval of a claim


def family_of(generator: str) -> str:
    return generator.split(".")[0]


@dataclass(frozen=True)
class Case:
    generator: str
    truth: str
    evidence: CaseEvidence
    moved: tuple[tuple[str, float], ...] = ()  # where recalibrating closes the gap: the parts that did, with shares
    left_out: bool = False  # its effect, out of the library
    stands_in: str = ""  # ... and which other effect foretells an unseen motion as well as matters: right too

    @property
    def family(self) -> str:
        return family_of(self.generator)


def verdict_of(case: Case, by: Learnt) -> Decision:
    """As `taut diagnose` would say it."""
    verdict = decide(case.evidence, by)
    return with_moved(verdict, case.moved, by) if case.moved and verdict.name == UNEXPLAINED else verdict


def probability(case: Case, verdict: Decision) -> float:
    fixed = {NONE: verdict.none, UNEXPLAINED: verdict.unknown}
    told = fixed.get(case.truth, verdict.leading.get(case.truth, 0.0))
    return told + (verdict.leading.get(case.stands_in, 0.0) if case.stands_in else 0.0)


def _slopes(case: Case, stacked: Stacked, logarithms: Array) -> Array:
    """Loss, and its derivatives by differences. Without what a verdict does from a threshold on."""

    def loss(at: Array) -> float:
        by = Hyperparameters.of_logarithms(at)
        name = case.stands_in or case.truth
        none, unknown, effect = probabilities(stacked, name, by)
        # Of what a recalibration moved.
        told = (1.0 - float(by.mimicked(len(case.moved)))) * unknown if case.moved else 0.0
        effect += told * dict(case.moved).get(name, 0.0)
        p = {NONE: none, UNEXPLAINED: unknown - told}.get(case.truth, effect) + (effect if case.stands_in else 0.0)
        return -float(np.log((1.0 - _LEAST) * p + _LEAST))

    here = loss(logarithms)
    ahead = [(loss(logarithms + step) - here) / _STEP for step in _STEP * np.eye(len(logarithms))]
    return np.array([here, *ahead])


def load(folders: Sequence[Path], scored: bool = False) -> list[Case]:
    """scored: seeds that only a report may be made of. Without repeats that were counted: no evidence was weighed. With
    what a library said that lacks a case's effect, of campaigns that were scored."""
    cases = []
    for folder in folders:
        cases += _of_family(folder) if (folder / family_evidence.TRUTH).exists() else _of_campaign(folder, scored)
    return cases


def _of_family(folder: Path) -> list[Case]:
    """Cases with one cause or none; the folder's name is the family's. Without those whose cause the calibrated model
    holds so that it leaves noise everywhere: there is nothing to tell."""
    cases = []
    for path in sorted((folder / family_evidence.TRUTH).glob("*.json")):
        label, diagnosis = json.loads(path.read_text()), folder / sealed.DIAGNOSES / path.stem
        if len(label["causes"]) > 1 or not (diagnosis / work.EVIDENCE).exists():
            continue
        right = label["causes"][0]["id"] if label["verdict"] == "effect" else label["verdict"]
        evidence = CaseEvidence.from_json(json.loads((diagnosis / work.EVIDENCE).read_text()))
        if right != NONE and not is_open(evidence, max(float(np.mean(evidence.frozen)), evidence.calibrated)):
            continue
        document = json.loads((diagnosis / work.DOCUMENT).read_text())
        if right == HELD and _was_counted(document):
            continue
        generator = f"{folder.name}.{label['mechanism']}"
        cases.append(Case(generator, right, evidence, _moved(document, evidence)))
    return cases


def _of_campaign(folder: Path, scored: bool) -> list[Case]:
    """Cases of a blind campaign; arguments as for `load`."""
    cases = []
    for diagnosis in sorted((folder / sealed.DIAGNOSES).iterdir()):
        label = _label(folder, diagnosis.name, scored)
        document = json.loads((diagnosis / work.DOCUMENT).read_text())
        if label.kind == "pair" or (label.effects == (HELD,) and _was_counted(document)):
            continue
        case = _case_of(diagnosis, label, document)
        cases += [case] if case else []
    for diagnosis, line in _without(folder):
        label = replace(_label(folder, diagnosis.name, scored), kind="left out")
        if BY_ID[label.effects[0]].nominal:  # older campaigns have some
            continue
        document = json.loads((diagnosis / work.DOCUMENT).read_text())
        case = _case_of(diagnosis, label, document)
        cases += [replace(case, left_out=True, stands_in=_standing_in(line))] if case else []
    return cases


def _was_counted(document: Mapping[str, Any]) -> bool:
    """Whether a diagnosis names repeats, which it counts: no evidence was weighed."""
    return any(effect["id"] == HELD for effect in document.get("effects", ()))


def _label(folder: Path, name: str, scored: bool) -> Label:
    label = Label.from_json(json.loads((folder / sealed.SEALED / name / sealed.LABEL).read_text())["label"])
    if label.seed >= SCORED_FROM and not scored:
        raise click.ClickException(
            f"{folder}: seed {label.seed} is scored, not learnt from: name one of --seed 1 to {SCORED_FROM - 1}"
        )
    return label


def _case_of(diagnosis: Path, label: Label, document: Mapping[str, Any]) -> Case | None:
    """What a diagnosis' folder teaches; None where it failed, or where nothing of the cause can be seen."""
    if not (diagnosis / work.EVIDENCE).exists():
        return None
    seen = float(np.sqrt(max(document["gap"]["before"] ** 2 - label.noise_px**2, 0.0)))
    if not counts(replace(label, left=tuple(min(left, seen) for left in label.left))):
        return None
    evidence = CaseEvidence.from_json(json.loads((diagnosis / work.EVIDENCE).read_text()))
    return Case(label.generator, truth(label), evidence, _moved(document, evidence))


def _without(folder: Path) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """Folders of what was said without a case's effect in the library, and the campaign's line of each."""
    if (folder / RESULT).exists():
        for line in json.loads((folder / RESULT).read_text())["each"]:
            if line["kind"] == "left out":
                yield folder / WITHOUT / line["name"], line


def _standing_in(line: Mapping[str, Any]) -> str:
    """The effect that was named for one that the library lacks, where it leaves about the noise of an unseen motion."""
    realised = line["realised"]
    if not line["named"] or realised is None or realised["after"] > IMITATED * realised["floor"]:
        return ""
    return str(line["named"][0])


def _moved(document: Mapping[str, Any], evidence: CaseEvidence) -> tuple[tuple[str, float], ...]:
    before, after = document["gap"]["before"], document["gap_recalibrated"]["before"]
    if not moved.closes(before, after, document["noise_floor"]) or is_open(evidence, after**2):
        return ()
    return tuple((part["id"], part["share"]) for part in document["moved"])


def weights_of(cases: Sequence[Case]) -> Array:
    """None, unknown and effects have the same weight in every generator; it has as many cases' as it has cases."""
    sorts = [case.truth if case.truth in _MIX else "effect" for case in cases]
    count = Counter(sorts)
    share = {sort: _MIX.get(sort, 1.0 - sum(_MIX.values())) for sort in count}
    total = sum(share.values())
    return np.array([len(cases) * share[sort] / total / count[sort] for sort in sorts])


def learn(cases: Sequence[Case], jobs: int = 1) -> Learnt:
    """The likeliest hyperparameters, by their logarithms' steps from START in _PRIOR. `covers` as it would be were all
    known."""
    generators = [case.generator for case in cases]
    weight = np.zeros(len(cases))
    for name in set(generators):
        mine = [i for i, generator in enumerate(generators) if generator == name]
        weight[mine] = weights_of([cases[i] for i in mine])
    with _sloping(cases, jobs) as slopes:

        def loss(steps: Array) -> tuple[float, Array]:
            summed = weight @ slopes(START.logarithms() + _PRIOR * steps)
            return float(summed[0] + 0.5 * steps @ steps), _PRIOR * summed[1:] + steps

        nothing = np.zeros(len(NAMES))
        options = {"maxiter": _STEPS, "maxfun": _MOST, "ftol": _FLAT}
        found = minimize(loss, nothing, jac=True, method="L-BFGS-B", options=options).x
    return Learnt(Hyperparameters.of_logarithms(START.logarithms() + _PRIOR * found), _COVERS)


@contextmanager
def _sloping(cases: Sequence[Case], jobs: int) -> Iterator[Callable[[Array], Array]]:
    """Loss and derivatives of all cases, a row each; every process keeps what it has stacked."""
    count = len(cases)
    if jobs == 1:
        stacked = [Stacked(case.evidence) for case in cases]
        yield lambda at: np.array([_slopes(*each, at) for each in zip(cases, stacked, strict=True)])
        return
    with ProcessPoolExecutor(jobs, initializer=_take, initargs=(cases,)) as pool:
        yield lambda at: np.array(list(pool.map(_slopes_of_taken, range(count), [at] * count, chunksize=4)))


_taken: list[tuple[Case, Stacked]] = []  # by a worker


def _take(cases: Sequence[Case]) -> None:
    _taken[:] = [(case, Stacked(case.evidence)) for case in cases]


def _slopes_of_taken(which: int, at: Array) -> Array:
    return _slopes(*_taken[which], at)


def before_truth(case: Case, verdict: Decision) -> float:
    """Share of the effects' probability that goes to likelier ones than the right one; 1 where it is none of them."""
    total = sum(verdict.leading.values())
    if case.truth not in verdict.leading or total <= 0.0:
        return 1.0
    return sum(p for p in verdict.leading.values() if p > verdict.leading[case.truth]) / total


def conformal(verdicts: Sequence[tuple[Case, Decision]]) -> float:
    """Share that a set must hold, where effects are named for one; generators weigh the same."""
    sets = [
        (before_truth(case, verdict), case.generator)
        for case, verdict in verdicts
        if case.truth not in (NONE, UNEXPLAINED) and verdict.name == "effect"
    ]
    count = Counter(generator for _, generator in sets)
    sets.sort()
    weight = np.cumsum([1.0 / count[generator] / len(count) for _, generator in sets])
    at = int(np.searchsorted(weight, _COVERS * (1.0 + 1.0 / max(len(sets), 1))))
    return float(min(sets[min(at, len(sets) - 1)][0] + 1e-3, 0.9999)) if sets else _COVERS


@dataclass(frozen=True)
class Claim:
    generator: str
    apart: float  # gap.normalised_excess
    sort: str = "elsewhere"  # "later" where something that goes with time was named

    @property
    def family(self) -> str:
        return family_of(self.generator)


def claims(folders: Sequence[Path]) -> list[Claim]:
    """Of single effects where one was named, and the further motion has a gap to close."""
    found = []
    for folder in folders:
        found += _claims_of_family(folder) if (folder / family_evidence.TRUTH).exists() else _claims_of_campaign(folder)
    return found


def _claims_of_campaign(folder: Path) -> list[Claim]:
    """Claims of a blind campaign's result."""
    result = json.loads((folder / RESULT).read_text())
    if not result["tuning"]:
        raise click.ClickException(f"{folder}: its seeds are scored, not learnt from: name tuning campaigns")
    found = []
    for case in result["each"]:
        if case["kind"] == "single" and case["named"] and case["realised"] is not None:
            before, after, floor = (case["realised"][name] for name in ("before", "after", "floor"))
            named, generator = case["named"], case["generator"]
            found += _claim(generator, {*case["effects"], *named}, named, case["gap"], (before, after), floor)
    return found


def _claims_of_family(folder: Path) -> list[Claim]:
    """Claims of a family's cases that `family_evidence` diagnosed, its unknown ones too."""
    found = []
    for path in sorted((folder / family_evidence.TRUTH).glob("*.json")):
        label, diagnosis = json.loads(path.read_text()), folder / sealed.DIAGNOSES / path.stem
        if len(label["causes"]) != 1 or not (diagnosis / "corrected.csv").exists():
            continue
        document = json.loads((diagnosis / work.DOCUMENT).read_text())
        named = [effect["id"] for effect in (*document["effects"], *document["moved"])]
        if document["verdict"] == "effect" and named:
            seen = path.with_name(f"{path.stem}-unseen.csv")
            before, after = (
                rms(diagnosis / f"{which}.csv", seen, label["unseen_valid_from_s"])
                for which in ("nominal", "corrected")
            )
            gaps = document["gap"]["before"], document["gap"]["after"]
            generator = f"{folder.name}.{label['mechanism']}"
            found += _claim(generator, {*named}, named, gaps, (before, after), label["noise"])
    return found


def _claim(
    generator: str, ids: Set[str], named: Sequence[str], gaps: Sequence[float], realised: Sequence[float], floor: float
) -> list[Claim]:
    """A claim, unless an event is among the ids or the unseen motion has no gap. gaps, realised: rms before and after,
    of the tests and of the unseen motion."""
    if ids & EVENTS or realised[0] < CLOSABLE * floor:
        return []
    sort = "later" if any(BY_ID[name].course for name in named) else "elsewhere"
    return [Claim(generator, gap.normalised_excess(gaps[1] / gaps[0], realised[1] / realised[0]), sort)]


def elsewhere(found: Sequence[Claim]) -> tuple[float, float]:
    """Quantiles, as many cases tell of them (split-conformal); generators weigh the same."""
    count = Counter(claim.generator for claim in found)
    inwards = sorted(found, key=lambda claim: claim.apart)
    weight = np.cumsum([1.0 / count[claim.generator] / len(count) for claim in inwards])
    low, high = _ENDS[0] - _ENDS[0] / len(found), _ENDS[1] + _ENDS[1] / len(found)
    at = np.clip(np.searchsorted(weight, [low, high]), 0, len(inwards) - 1)
    return inwards[at[0]].apart, inwards[at[1]].apart


def both(found: Sequence[Claim]) -> dict[str, tuple[float, float]]:
    """By the names that Learnt has for them."""
    return {name: elsewhere([c for c in found if c.sort == name] or found) for name in ("elsewhere", "later")}


def tell_claims(found: Sequence[Claim]) -> None:
    for family in sorted({claim.family for claim in found}):
        others = [claim for claim in found if claim.family != family]
        mine = [claim for claim in found if claim.family == family]
        if others:
            of_them = both(others)
            within = [of_them[c.sort][0] <= c.apart <= of_them[c.sort][1] for c in mine]
            click.echo(f"{family}: what the others say covers {100 * np.mean(within):.0f} % of {len(mine)}")
    for name, (low, high) in both(found).items():
        click.echo(f"{name} = [{low:.3g}, {high:.3g}]")


def row(name: str, verdicts: Sequence[tuple[Case, Decision]], covers: float) -> list[str]:
    def share(hits: Sequence[bool]) -> str:
        return f"{100.0 * np.mean(hits):.0f} % of {len(hits)}" if hits else "-"

    def lead(verdict: Decision) -> str:
        return next(iter(verdict.named or verdict.ranked)) if verdict.name == "effect" else verdict.name

    singles = [(c, v) for c, v in verdicts if c.truth not in (NONE, UNEXPLAINED)]
    log = -np.mean([np.log((1.0 - _LEAST) * probability(c, v) + _LEAST) for c, v in verdicts])
    top = np.array([max(v.none, v.unknown, *v.leading.values(), 0.0) for _, v in verdicts])
    right = np.array([lead(v) in (c.truth, c.stands_in) for c, v in verdicts])
    edges = np.clip((10 * top).astype(int), 0, 9)
    error = sum(abs(float(np.sum(top[edges == e] - right[edges == e]))) for e in range(10)) / len(verdicts)
    return [
        name, f"{log:.3f}", share([lead(v) == c.truth for c, v in singles]),
        share([c.truth in v.ambiguous(covers) for c, v in singles if v.name == "effect"]),
        share([v.name == "unknown" for c, v in verdicts if c.truth == UNEXPLAINED and not c.left_out]),
        share([lead(v) in (UNEXPLAINED, c.stands_in) for c, v in verdicts if c.left_out]),
        share([_wrongly_sure(c, v) for c, v in verdicts if c.left_out]),
        share([v.name == "none" for c, v in verdicts if c.truth == NONE]), f"{error:.3f}",
    ]  # fmt: skip


def _wrongly_sure(case: Case, verdict: Decision) -> bool:
    """Whether another effect than one that stands for the missing one is named as good as surely."""
    name, sure = max(verdict.leading.items(), key=lambda of: of[1], default=("", 0.0))
    return verdict.name == "effect" and sure >= SURE and name != case.stands_in


@click.command()
@click.argument("campaigns", nargs=-1, required=True, type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--leave-out", multiple=True, help="Families that nothing is learnt from: they are reported alone.")
@click.option(
    "--report",
    multiple=True,
    type=click.Path(exists=True, file_okay=False, path_type=Path),
    help="Campaigns of scored seeds that nothing is learnt from.",
)
@click.option("--write", is_flag=True, help="Put what is learnt into the package.")
@click.option("--jobs", type=click.IntRange(1), default=os.cpu_count() or 1, help="Processes.")
@click.option("--claims", "only_claims", is_flag=True, help="Only how far apart claims and unseen motions are.")
def main(
    campaigns: tuple[Path, ...],
    leave_out: tuple[str, ...],
    report: tuple[Path, ...],
    write: bool,
    jobs: int,
    only_claims: bool,
) -> None:
    """Learns from blind CAMPAIGNS, and tells what that says of generators that were left out."""
    if only_claims:
        return tell_claims(claims(campaigns))
    cases = load(campaigns)
    learnable = [case for case in cases if case.family not in leave_out]
    if not learnable:
        raise click.ClickException("nothing to learn from: run taut blindtest --seed below 1000000 first")
    families = sorted({case.family for case in learnable})
    told: list[list[str]] = []
    unseen: list[tuple[Case, Decision]] = []
    by: dict[str, Learnt] = {}
    for family in track(families if len(families) > 1 else [], "leaving out"):
        by[family] = learn([case for case in learnable if case.family != family], jobs)
        unseen += [(case, verdict_of(case, by[family])) for case in learnable if case.family == family]
    everything = learn(learnable, jobs)
    covers = conformal(unseen) if unseen else _COVERS
    everything = replace(everything, covers=covers, **both(claims(campaigns)))
    started = Learnt(START, _COVERS)

    def tell(name: str, cases: Sequence[Case], ways: Mapping[str, Learnt]) -> None:
        for way, learnt in ways.items():
            said = [(case, verdict_of(case, learnt)) for case in cases]
            told.append(row(f"{name}, {way}", said, learnt.covers))

    for family in sorted({case.family for case in cases}):
        mine = [case for case in cases if case.family == family]
        ways = {"as it started": started}
        ways |= {"left out": replace(by[family], covers=everything.covers)} if family in by else {}
        tell(family, mine, {**ways, "left out" if family in leave_out else "learnt on": everything})
    if unseen:
        tell("together", learnable, {"as it started": started})
        told.append(row("together, each left out", unseen, everything.covers))
    reported = load(report, scored=True)
    for family in sorted({case.family for case in reported}):
        mine = [case for case in reported if case.family == family]
        ways = {"as it started": started, "learnt": everything}
        tell(f"{family}, report", mine, ways | ({"learnt without it": by[family]} if family in by else {}))
    table = Table(
        "generators", "-log p of the truth", "right name leads", "in its set", "unknown",
        "left out: unknown or stood for", "... wrong at 90 %", "none", "calibration error",
    )  # fmt: skip
    for cells in told:
        table.add_row(*cells)
    console = Console()
    console.print(table)
    text = everything.to_toml(Counter(case.generator for case in learnable))
    console.print(text, highlight=False, markup=False)
    if write:
        (Path(hyperparameters.__file__).parent / hyperparameters.FILE).write_text(text, "utf-8")


if __name__ == "__main__":
    main()
