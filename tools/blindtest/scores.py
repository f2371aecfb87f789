"""How right a method was on a campaign's cases. Nothing here knows how an answer came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from scipy.stats import binomtest

from tautline.effects import EVENTS, LIBRARY
from tools.blindtest.cases import KINDS, Label
from tools.blindtest.draws import KNOWN, UNKNOWN

NONE, UNEXPLAINED, FAILED = "none", "unknown", "failed"
STAGES: Mapping[str, str] = {name: name.split(".", 1)[0] for name in KNOWN}
_BINS = 10
_SAME = 1.001  # times a gap: no other one
CLOSABLE = 1.5  # times the noise: a gap on the further motion that there is something to say of
STRENGTHS = ((2.0, 5.0), (5.0, 20.0), (20.0, np.inf))  # times the noise, left after a recalibration
_LEAST = 1e-4  # probability below which the log score punishes no more
IMITATED = 1.3  # times the noise on the further motion: what is named stands for the cause as well as matters
_LARGEST_SET = 3  # of effects that are a useful answer
SURE = 0.9


@dataclass(frozen=True)
class Answer:
    """What one method says of one case."""

    named: tuple[str, ...]  # effects, the leading one first; empty with NONE, UNEXPLAINED and FAILED
    verdict: str  # the leading effect, NONE, UNEXPLAINED or FAILED
    core_s: float
    possible: frozenset[str] = frozenset()  # named, and what cannot be told from it
    probabilities: Mapping[str, float] | None = None  # of every effect to be the leading one, NONE and UNEXPLAINED
    stage: str | None = None
    claimed: float | None = None  # shrinkage of the gap on motions that it did not fit
    interval: tuple[float, float] | None = None  # in which another motion's is stated to be
    realised: Mapping[str, float] | None = None  # gap on the further motion: before, after, floor
    names: bool = True  # else it only shrinks the gap
    brought: frozenset[str] = frozenset()  # parts of the nominal model that a named effect changed too
    present: tuple[float, ...] = ()  # probability of each named effect to be there, given those before it


@dataclass(frozen=True)
class Share:
    """hits out of `of`, with the exact (Clopper-Pearson) 95 % interval."""

    hits: int
    of: int

    @property
    def value(self) -> float | None:
        return self.hits / self.of if self.of else None

    @property
    def interval(self) -> tuple[float, float]:
        if not self.of:
            return 0.0, 1.0
        bounds = binomtest(self.hits, self.of).proportion_ci(0.95, method="exact")
        return float(bounds.low), float(bounds.high)

    def to_json(self) -> dict[str, Any]:
        return {"hits": self.hits, "of": self.of, "share": self.value, "interval": list(self.interval)}


@dataclass(frozen=True)
class Scores:
    """Of one method. A mean over nothing is None."""

    top1: Share  # identifiable single effects whose name leads
    per_effect: Mapping[str, Share]
    by_strength: Mapping[str, Share]  # of STRENGTHS
    in_set: Share  # ... that are named or among what cannot be told from what is named
    set_size: float | None  # of such sets, over the identifiable single effects for which one was named
    probability: float | None  # mean on the truth: identifiable single effects, unknown ones, none
    stage: Share
    unknown: Share  # identifiable effects outside the library that are called unknown
    false_known: Share  # ... that get a name of the library
    none: Share
    false_alarm: Share  # nothing, called an effect
    pairs: Share  # both effects named
    pairs_covered: Share  # both `covers`
    pairs_one: Share  # at least one of them
    triples: Share  # all three named
    triples_covered: Share
    left_out: Share  # called unknown by a library that lacks the effect
    stood_for: Share  # ... or a set of three at most whose corrected model is within IMITATED on the further motion
    left_out_sure: Share  # ... or named at 90 % or more without such a model
    overall: Share  # right verdicts over single, unknown and none
    claim: float | None  # mean of claimed less realised shrinkage, in points, where there is a gap to close
    claim_size: float | None  # mean of its absolute value
    covered: Share  # of these, within the stated interval
    claim_all: float | None  # claim_size of all that was named: pairs, unknown and events too
    covered_all: Share
    worse: Share  # whatever was named: leaves more of the further motion than without, and more than noise
    several: Share  # identifiable single effects for which one was named: more than one was
    closed: float | None  # mean share of the closable gap closed on the further motion, identifiable single effects
    closed_90: Share  # of these, at least 0.9
    calibration_error: float | None  # expected, of the leading probability
    further_error: float | None  # ... of what is named beside the leading effect
    log_score: float | None  # mean logarithm of the probability on the truth: single, unknown and none
    core_s: float | None  # per case

    def to_json(self) -> dict[str, Any]:
        document: dict[str, Any] = {}
        for name in asdict(self):
            value = getattr(self, name)
            document[name] = value.to_json() if isinstance(value, Share) else value
        for name in ("per_effect", "by_strength"):
            document[name] = {of: share.to_json() for of, share in getattr(self, name).items()}
        return document


@dataclass(frozen=True)
class Bin:
    """Answers whose leading probability is within [low, high)."""

    low: float
    high: float
    stated: float  # mean probability
    right: Share


@dataclass(frozen=True)
class Paired:
    """On the same cases: how many one method has the better of, and how many the other."""

    ours: int
    theirs: int

    @property
    def p(self) -> float:
        """Exact, two-sided: McNemar's of verdicts that are right or wrong, a sign test of sizes."""
        return float(binomtest(self.ours, self.ours + self.theirs).pvalue) if self.ours + self.theirs else 1.0

    def to_json(self) -> dict[str, Any]:
        return {"ours": self.ours, "theirs": self.theirs, "p": self.p}


@dataclass
class _Tally:
    answers: list[tuple[Label, Answer]] = field(default_factory=list)

    def share(self, right: Any) -> Share:
        return Share(sum(bool(right(label, answer)) for label, answer in self.answers), len(self.answers))


def answer_of(record: Mapping[str, Any]) -> Answer:
    """The diagnosis' own answer, from a record of work.score_case."""
    document, core_s = record["document"], float(record["core_s"])
    verdict = document["verdict"]
    if verdict == FAILED:
        return Answer((), FAILED, core_s)
    named = tuple(effect["id"] for effect in document["effects"]) if verdict == "effect" else ()
    others = {other for effect in document["effects"] for other in effect["ambiguous_with"]} if named else set()
    probabilities = {c["id"]: float(c["probability"]) for c in document["candidates"]}
    low, high = document["gap"]["shrink_ci"]
    return Answer(
        named,
        named[0] if named else verdict,
        core_s,
        frozenset({*named, *others}),
        {**probabilities, NONE: float(document["probability_none"]), UNEXPLAINED: document["probability_unknown"]},
        document["where"]["stage"],
        float(document["gap"]["shrink"]),
        (float(low), float(high)),
        record["realised"],
        brought=frozenset(part["id"] for effect in document["effects"] for part in effect.get("brings", ()) if named),
        present=tuple(float(effect["probability"]) for effect in document["effects"]) if named else (),
    )


def to_json(answer: Answer) -> dict[str, Any]:
    sets = {"possible": sorted(answer.possible), "brought": sorted(answer.brought)}
    return {**asdict(answer), **sets, "named": list(answer.named)}


def from_json(document: Mapping[str, Any]) -> Answer:
    tuples = {name: tuple(document.get(name, ())) for name in ("named", "present")}
    interval = tuple(document["interval"]) if document.get("interval") else None
    sets = {name: frozenset(document.get(name, ())) for name in ("possible", "brought")}
    return Answer(**{**document, **tuples, **sets, "interval": interval})


def truth(label: Label) -> str:
    """The right verdict of a case with one cause or none."""
    if label.kind == "none":
        return NONE
    return UNEXPLAINED if label.kind in ("unknown", "left out") else label.effects[0]


def counts(label: Label) -> bool:
    """Whether a verdict is scored: where something is there, it must be identifiable."""
    return label.kind == "none" or label.identifiable


def all_named(label: Label, answer: Answer) -> bool:
    """Whether each of a case's effects is named."""
    return set(label.effects) <= set(answer.named)


def covers(label: Label, answer: Answer) -> bool:
    """Whether each of a case's effects is named, is a part of the nominal model that a named one is said to bring, or
    one of at most _LARGEST_SET of which one is said to be there."""
    alternatives = answer.possible if len(answer.possible) < len(answer.named) + _LARGEST_SET else frozenset()
    return set(label.effects) <= {*answer.named, *answer.brought, *alternatives}


def score(cases: Sequence[tuple[Label, Answer]]) -> Scores:
    groups = {kind: _Tally() for kind in (*KINDS, "left out")}
    shrinking = _Tally()
    for label, answer in cases:
        if counts(label) and answer.names:
            groups[label.kind].answers.append((label, answer))
        if label.kind == "single" and label.identifiable and not set(label.effects) & EVENTS:
            shrinking.answers.append((label, answer))
    single, unknown, none = groups["single"], groups["unknown"], groups["none"]
    one_cause = _Tally(single.answers + unknown.answers + none.answers)

    def right(label: Label, answer: Answer) -> bool:
        return answer.verdict == truth(label)

    per_effect = {
        name: _Tally([(label, answer) for label, answer in single.answers if label.effects == (name,)]).share(right)
        for name in KNOWN
    }
    differences, within = _claims([answer for _, answer in shrinking.answers])
    scored = [answer for label, answer in cases if counts(label) and label.kind != "left out"]
    all_differences, all_within = _claims(scored)
    on_truth = [a.probabilities.get(truth(x), 0.0) for x, a in one_cause.answers if a.probabilities]
    told = [a.realised for label, a in cases if counts(label) and a.named and a.realised is not None]
    closed = [share for _, answer in shrinking.answers if (share := _shrinkage(answer)) is not None]
    return Scores(
        top1=single.share(right),
        per_effect={name: share for name, share in per_effect.items() if share.of},
        by_strength=_by_strength(single.answers),
        in_set=single.share(lambda label, answer: label.effects[0] in (answer.possible or answer.named)),
        set_size=_mean([len(a.possible or a.named) for _, a in single.answers if a.named]),
        probability=_mean(on_truth),
        stage=single.share(lambda label, answer: answer.stage == STAGES[label.effects[0]]),
        unknown=unknown.share(right),
        false_known=unknown.share(lambda label, answer: bool(answer.named)),
        none=none.share(right),
        false_alarm=none.share(lambda label, answer: bool(answer.named)),
        pairs=groups["pair"].share(all_named),
        pairs_covered=groups["pair"].share(covers),
        triples=groups["triple"].share(all_named),
        triples_covered=groups["triple"].share(covers),
        pairs_one=groups["pair"].share(lambda label, answer: bool(set(label.effects) & set(answer.named))),
        left_out=groups["left out"].share(right),
        stood_for=groups["left out"].share(lambda label, answer: right(label, answer) or _stands_for_it(answer)),
        left_out_sure=groups["left out"].share(_wrongly_sure),
        overall=one_cause.share(right),
        claim=_mean(differences),
        claim_size=_mean([abs(d) for d in differences]),
        covered=Share(sum(within), len(within)),
        claim_all=_mean([abs(d) for d in all_differences]),
        covered_all=Share(sum(all_within), len(all_within)),
        worse=Share(sum(r["after"] > max(_SAME * r["before"], CLOSABLE * r["floor"]) for r in told), len(told)),
        several=Share(sum(len(a.named) > 1 for _, a in single.answers), sum(bool(a.named) for _, a in single.answers)),
        closed=_mean(closed),
        closed_90=Share(sum(share >= 0.9 for share in closed), len(closed)),
        calibration_error=_calibration_error(reliability(cases)),
        further_error=_calibration_error(_further(cases)),
        log_score=_mean([float(np.log(max(p, _LEAST))) for p in on_truth]),
        core_s=_mean([answer.core_s for label, answer in cases if label.kind != "left out"]),
    )


def paired(cases: Sequence[tuple[Label, Answer, Answer]]) -> dict[str, Paired]:
    """Of cases with two methods' answers, by what is compared: `verdicts` of single, unknown and none, where both name
    effects; the share of the gap `closed` of single identifiable effects, where both shrink it."""
    verdicts: list[tuple[float, float]] = []
    closed: list[tuple[float, float]] = []
    for label, ours, theirs in cases:
        if label.kind in ("single", "unknown", "none") and counts(label) and ours.names and theirs.names:
            verdicts.append((ours.verdict == truth(label), theirs.verdict == truth(label)))
        own, other = _shrinkage(ours), _shrinkage(theirs)
        if own is None or other is None:
            continue
        if label.kind == "single" and label.identifiable and not set(label.effects) & EVENTS:
            closed.append((own, other))
    compared = {"verdicts": verdicts, "closed": closed}
    return {
        name: Paired(sum(a > b for a, b in pairs), sum(a < b for a, b in pairs))
        for name, pairs in compared.items()
        if pairs
    }


def strength_name(low: float, high: float) -> str:
    return f"{low:g} to {high:g} times the noise" if np.isfinite(high) else f"above {low:g} times the noise"


def _by_strength(single: Sequence[tuple[Label, Answer]]) -> dict[str, Share]:
    found = {}
    for low, high in STRENGTHS:
        here = [(label, a) for label, a in single if low <= min(label.left) / label.noise_px < high]
        if here:
            found[strength_name(low, high)] = Share(sum(a.verdict == truth(label) for label, a in here), len(here))
    return found


def _claims(answers: Sequence[Answer]) -> tuple[list[float], list[bool]]:
    """Claimed less realised shrinkage in points, and whether the realised is within the stated interval, of what names
    something where the further motion has a gap to close."""
    differences, within = [], []
    for answer in answers:
        done = _realised(answer)
        if answer.claimed is None or done is None or not _can_close(answer) or (answer.names and not answer.named):
            continue
        differences.append(100.0 * (answer.claimed - done))
        if answer.interval is not None:
            within.append(answer.interval[0] <= done <= answer.interval[1])
    return differences, within


def _stands_for_it(answer: Answer) -> bool:
    if not answer.named or answer.realised is None or len(answer.possible or answer.named) > _LARGEST_SET:
        return False
    return answer.realised["after"] <= IMITATED * answer.realised["floor"]


def _wrongly_sure(_label: Label, answer: Answer) -> bool:
    sure = (answer.probabilities or {}).get(answer.verdict, 0.0) >= SURE
    return bool(answer.named) and sure and not _stands_for_it(answer)


def _realised(answer: Answer) -> float | None:
    if answer.realised is None:
        return None
    return 1.0 - answer.realised["after"] / answer.realised["before"]


def _can_close(answer: Answer) -> bool:
    return answer.realised is not None and answer.realised["before"] >= CLOSABLE * answer.realised["floor"]


def _shrinkage(answer: Answer) -> float | None:
    """Share of the closable gap (its square less the noise's) that is closed on the further motion, -1 to 1; None where
    hardly any is there to close."""
    if answer.realised is None:
        return None
    before, after, floor = (answer.realised[name] for name in ("before", "after", "floor"))
    if not _can_close(answer):
        return None
    return float(np.clip(1.0 - (after**2 - floor**2) / (before**2 - floor**2), -1.0, 1.0))


def confusion(cases: Sequence[tuple[Label, Answer]]) -> tuple[list[str], list[str], np.ndarray]:
    """(rows, columns, counts): truths with one cause (those outside the library by their own name), verdicts."""
    outside = (label.effects[0] for label, _ in cases if label.kind == "unknown")  # each generator has its own
    rows = [*dict.fromkeys([*KNOWN, *UNKNOWN, *outside]), NONE]
    # The library has effects that no case is made of.
    columns = [*dict.fromkeys([*KNOWN, *(kind.id for kind in LIBRARY)]), UNEXPLAINED, NONE, FAILED]
    drawn = {*KNOWN, UNEXPLAINED, NONE}
    table = np.zeros((len(rows), len(columns)), dtype=int)
    for label, answer in cases:
        if label.kind in ("single", "unknown", "none") and counts(label):
            table[rows.index((*label.effects, NONE)[0]), columns.index(answer.verdict)] += 1
    filled = table.sum(axis=1) > 0
    rows = [name for name, there in zip(rows, filled, strict=True) if there]
    filled_columns = (table.sum(axis=0) > 0) | [name in drawn for name in columns]
    columns = [name for name, there in zip(columns, filled_columns, strict=True) if there]
    return rows, columns, table[filled][:, filled_columns]


def reliability(cases: Sequence[tuple[Label, Answer]]) -> list[Bin]:
    """How often the most probable answer is right, over its probability; bins without an answer are left out."""
    stated, right = [], []
    for label, answer in cases:
        if label.kind in ("single", "unknown", "none") and counts(label) and answer.probabilities:
            leading = max(answer.probabilities, key=lambda name: (answer.probabilities or {})[name])
            stated.append(answer.probabilities[leading])
            right.append(leading == truth(label))
    return _bins(stated, right)


def _further(cases: Sequence[tuple[Label, Answer]]) -> list[Bin]:
    """How often what is named beside the leading effect is there, over its probability."""
    told = [
        (stated, name in label.effects)
        for label, answer in cases
        if counts(label) and label.kind != "left out"
        for name, stated in list(zip(answer.named, answer.present, strict=False))[1:]
    ]
    return _bins([stated for stated, _ in told], [there for _, there in told])


def _bins(stated: Sequence[float], right: Sequence[bool]) -> list[Bin]:
    at = np.minimum((np.array(stated) * _BINS).astype(int), _BINS - 1)
    result = []
    for i in range(_BINS):
        here = at == i
        if here.any():
            hits = Share(int(np.sum(np.array(right)[here])), int(here.sum()))
            result.append(Bin(i / _BINS, (i + 1) / _BINS, float(np.mean(np.array(stated)[here])), hits))
    return result


def _calibration_error(bins: Sequence[Bin]) -> float | None:
    total = sum(b.right.of for b in bins)
    return sum(b.right.of * abs((b.right.value or 0.0) - b.stated) for b in bins) / total if total else None


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if len(values) else None
