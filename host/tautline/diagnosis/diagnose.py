"""The diagnosis: from a calibrated model and recordings to verdict, effects, their shares and a corrected model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from tautline import effects
from tautline.diagnosis import (
    confounded,
    decide,
    flexible,
    gap,
    motion,
    moved,
    repeated,
    resembles,
    shapley,
    start,
    tip,
    tracker,
    where,
)
from tautline.diagnosis.candidates import Candidate, applicable
from tautline.diagnosis.fit import Fit, Fitter, Scope, key
from tautline.diagnosis.gather import Gathered, gather
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.segment import Segment, load_reference, prepare, sensed
from tautline.effects.library.registration import with_registration
from tautline.model import Effect, Model, monotone
from tautline.recording import Recording
from tautline.simulators.nominal import SimulatedNominal
from tautline.value import Value

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

FORMAT = "diagnosis/1"
_NO_NOISE = 0.8  # of a floor: a calibration that leaves less shows that it is none
_STEADY = 0.5  # share of a gap's power that does not change within a recording


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Value):
    document: dict[str, Any]  # diagnosis.json
    nominal: Model
    corrected: Model
    next_motion: motion.NextMotion | None
    segments: list[Segment]
    before: list[Array]  # residuals of each test, (scored, k)
    after: list[Array]
    conditions: list[where.Condition]
    evidence: CaseEvidence


def diagnose(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress = lambda fraction, text: None,
    left_out: Collection[str] = (),
    simulated: SimulatedNominal | None = None,
) -> Diagnosis:
    """`model` is what `calibration` gave. `left_out`: effects that the library shall not know. `simulated`: where
    model, calibration and tests are a simulator's. Raises TautError where nothing can be scored."""
    with threadpool_limits(1, "blas"):  # its systems are small: threads that wait for each other cost 10 times more
        return _diagnosis(model, calibration, tests, progress, left_out, simulated)


def _diagnosis(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress,
    left_out: Collection[str],
    simulated: SimulatedNominal | None,
) -> Diagnosis:
    progress(0.0, "preparing")
    segments = prepare(model, calibration, tests, simulated.drives if simulated else ())
    tracked = tracker.of_videos(model, segments, load_reference(calibration), [calibration, *tests])
    segments, moving = (tracked.segments, tracked.noise) if tracked is not None else (segments, 0.0)
    fitter = Fitter(model, segments, load_reference(calibration))
    frozen = fitter.residuals(fitter.start(), fitter.nothing)
    if simulated is not None:
        segments[0] = sensed(segments[0], gap.noise_floor(segments[1:], frozen[1:]))
        fitter = Fitter(model, segments, load_reference(calibration))
        frozen = fitter.residuals(fitter.start(), fitter.nothing)
    fitter.floor = max(gap.noise_floor(segments, frozen), moving)
    if tracked is not None:
        fitter.doubt, fitter.unsteady = tracked.doubt, tracked.unsteady
    base = fitter.nominal()
    # A rest in which the tip goes on moving is no noise: the calibration has no more of it than its own fit leaves. A
    # simulator's has none at all, and the robot's sensor still has its own.
    floor = gap.noise_floor(segments, base.residuals)
    left = max(gap.rms(frozen[:1]), gap.counted(segments), gap.jitters(base.residuals[1:]))
    floor = fitter.floor = max(left if left < _NO_NOISE * floor else floor, moving)
    kinds = [*applicable(fitter, left_out), *(simulated.kinds if simulated else ())]
    hidden = confounded.hidden(kinds, segments)
    kinds = [kind for kind in kinds if kind.id not in hidden]

    gathered = gather(fitter, frozen, base, kinds, lambda done, text: progress(0.1 + 0.8 * done, text))
    verdict = decide.that_help(gathered.evidence, decide.decide(gathered.evidence))
    if verdict.name != "effect" and simulated is None and start.concerns(model):
        # Nothing that came later is the cause: what was there while calibrating, which the calibration has swallowed.
        from_start = start.of_segments(
            *(model, segments, fitter.load_reference, tracked),
            lambda done, text: progress(0.9 + 0.02 * done, text),
            left_out,
        )
        if from_start.named:
            fitter, gathered, verdict = from_start.fitter, from_start.gathered, from_start.verdict
    progress(0.92, "attributing")
    before = frozen[1:]
    before_rms, recalibrated = gap.rms(before), gap.rms(base.residuals[1:])
    still_open = decide.is_open(gathered.evidence, recalibrated**2)
    swallowed = moved.is_all(before_rms, recalibrated, floor, still_open, learnt().center.unexplained_by_law)
    parts = moved.from_the_start(fitter, frozen, base) if swallowed and verdict.name == "unknown" else []
    if parts:
        verdict = decide.with_moved(verdict, [(part.id, part.share) for part in parts])
    chosen = gathered.candidates[verdict.chosen]
    named = verdict.named if verdict.name == "effect" else ()
    if named and not chosen.follows and not _is_better(segments[1:], before, chosen.left[1:]):
        chosen = chosen.of(fitter.start(), frozen)
    after = chosen.left[1:] if named else before  # without an effect nothing is added
    after_rms = gap.rms(after)
    excess = max(before_rms**2 - floor**2, 1e-12)
    paths = [s.predict(model, {}, fitter.load_reference)[0] for s in segments[1:]]
    conditions = where.conditions(segments[1:], paths, before)
    if verdict.name == "effect" and not _changes(chosen.fit, named):
        conditions = [c for c in conditions if c.axis != "time"]
    boot = gap.bootstrap(before, after, [gap.blocks(s) for s in segments[1:]])
    shrink = 1.0 - after_rms / before_rms if before_rms > 0 else 0.0
    following = motion.best(fitter, _leading(gathered, verdict))
    ambiguous = verdict.ambiguous()
    best = _best_of_each(gathered)
    open_still = decide.is_open(gathered.evidence, after_rms**2)
    rest = flexible.close(segments[1:], after, floor) if open_still else None
    brought = {name: [part for part in verdict.brought if part in effects.BY_ID[name].brings] for name in named}
    if parts:
        shares = {part.id: part.share * shrink for part in parts}
    else:
        causes = (*named, *(verdict.brought if named else ()))
        shares = dict(zip(causes, _shapley(gathered, fitter, causes, chosen, before_rms), strict=True))
        constant = [name for name in named if effects.BY_ID[name].nominal]
        if named and len(constant) == len(named) and moved.closes(before_rms, after_rms, floor):
            parts = moved.of_named(list(shares.items()))
    document: dict[str, Any] = {
        "format": FORMAT,
        "unit": segments[0].unit,
        "verdict": verdict.name,
        "noise_floor": floor,
        "gap": {
            "before": before_rms,
            "after": after_rms,
            "before_ci": _interval(boot[0]),
            "after_ci": _interval(boot[1]),
            "shrink": shrink,
            "shrink_ci": _elsewhere(1.0 - boot[1] / boot[0], after_rms / before_rms, named) if named else [0.0, 0.0],
            "closable_shrink": float(np.clip(1.0 - (after_rms**2 - floor**2) / excess, 0.0, 1.0)) if named else 0.0,
        },
        "gap_recalibrated": {"before": recalibrated},
        "tracker": tracked.to_json() if tracked else None,  # of videos: the noise of a moving marker
        "flexible": rest.to_json() if rest else None,  # what a Gaussian process closes of the gap after
        "effects": [
            {
                "id": name,
                "probability": probability,
                "since": _since(chosen.fit, name, segments[0].end_s).since,
                "parameters": _reported(chosen.fit, name),
                **_of_each(chosen.fit, name, segments),
                **_brings(brought[name], shares),
                "shrink": shares[name] + sum(shares[part] for part in brought[name]),
                "swallowed_by_recalibration": moved.closes(before_rms, recalibrated, floor),
                "loads_on_board": effects.BY_ID[name].on_board,
                "ambiguous_with": _instead(verdict, name, ambiguous),
            }
            for name, probability in zip(named, verdict.probability, strict=False)
        ],
        "moved": [
            {"id": part.id, "share": part.share, "since": _since(chosen.fit, part.id, segments[0].end_s).since}
            for part in parts
        ],
        "candidates": [
            {
                "id": name,
                "probability": verdict.leading.get(name, 0.0),
                "shrink": 1.0 - gap.rms(best[name].left[1:]) / before_rms if name in best else 0.0,
                "identifiable": name not in ambiguous or len(ambiguous) == 1,
            }
            for name in [*verdict.ranked, *(kind.id for kind in kinds if kind.id not in verdict.leading)]
        ],
        "probability_none": verdict.none,
        "probability_unknown": verdict.unknown,
        "count": list(verdict.count),
        "where": {
            "stage": _stage(verdict),
            "conditions": [c.to_json() for c in conditions[:5]],
        },
        "signature": _signature(conditions, before) if verdict.name == "unknown" or confounded.DRIFT in named else None,
        "next_motion": {"why": following.why, "file": "next_motion.csv"} if following else None,
    }
    confounded.told(document, hidden)
    if repeated.HELD not in left_out:
        repeated.told(document, model, segments, fitter.load_reference)
    document["resembles"] = resembles.told(gathered, before_rms) if document["verdict"] == "unknown" else []
    progress(1.0, "done")
    corrected = _corrected(chosen.fit, max(segments[1:], key=lambda test: test.end_s)) if named else model
    corrected = replace(corrected, extra={**model.extra, "load_reference_mNm": fitter.load_reference})
    # With the old tables, and with the new: a simulator's are for no board.
    document["tip"] = tip.foretold(model, corrected) if named and simulated is None else None
    if simulated is not None:
        document["simulator"] = simulated.to_json(document["effects"])
    segments = [replace(segment, drive=None) for segment in segments]  # what was simulated is in motor and residuals
    return Diagnosis(
        document, model, corrected, following, segments, list(before), list(after), conditions, gathered.evidence
    )


def _is_better(tests: Sequence[Segment], before: Sequence[Array], after: Sequence[Array]) -> bool:
    """Whether a gap shrinks for sure (of 20 draws of the blocks in 19): another nominal model in which what has no path
    is as large is no correction."""
    boot = gap.bootstrap(before, after, [gap.blocks(segment) for segment in tests])
    return float(np.quantile(boot[1] / boot[0], 0.95)) < 1.0


def _best_of_each(gathered: Gathered) -> dict[str, Candidate]:
    """The hypothesis of each effect alone that leaves least."""
    best: dict[str, Candidate] = {}
    for candidate in gathered.candidates:
        if len(candidate.ids) == 1:
            name = candidate.ids[0]
            if name not in best or candidate.power.mean() < best[name].power.mean():
                best[name] = candidate
    return best


def _leading(gathered: Gathered, verdict: decide.Decision) -> list[Fit]:
    """Of the three likeliest effects that have a path, those that cannot be told apart or else the best two."""
    best = _best_of_each(gathered)
    names = [name for name in verdict.ranked if name in best and name not in effects.EVENTS]
    unsure = set(verdict.ambiguous())
    return [best[name].fit for i, name in enumerate(names[:3]) if i < 2 or name in unsure]


def _instead(verdict: decide.Decision, name: str, leads: Sequence[str]) -> list[str]:
    """What may be there in a named effect's place. leads: those of which one leads."""
    if name == verdict.named[0]:
        return [other for other in leads if other != name]
    return list(verdict.instead) if name == verdict.named[-1] else []


def _stage(verdict: decide.Decision) -> str | None:
    """The likeliest: every effect counts for its own."""
    if verdict.name == "none" or not verdict.leading:
        return None
    stages: dict[str, float] = {}
    for name, probability in verdict.leading.items():
        stage = effects.BY_ID[name].stage
        stages[stage] = stages.get(stage, 0.0) + probability
    return max(stages, key=lambda stage: stages[stage])


def _shapley(gathered: Gathered, fitter: Fitter, named: Sequence[str], chosen: Candidate, before: float) -> list[float]:
    """Each named effect's exact Shapley share of the shrinkage. A set of effects is worth what its own fit shrinks,
    or, where it was not tried, what the chosen fit does with the others at zero; no effect is worth nothing."""
    known: dict[frozenset[str], float] = {frozenset(): 0.0}
    for candidate in gathered.candidates:
        if candidate.ids:
            key, value = frozenset(candidate.ids), 1.0 - gap.rms(candidate.left[1:]) / before
            known[key] = max(known.get(key, -np.inf), value)
    known[frozenset(named)] = 1.0 - gap.rms(chosen.left[1:]) / before

    def worth(names: frozenset[str]) -> float:
        if names in known:
            return known[names]
        off = {p.name for name in named if name not in names for p in effects.BY_ID[name].amplitudes} | effects.SCATTERS
        values = {k: (0.0 if k.split("@")[0] in off else v) for k, v in chosen.fit.state.values.items()}
        residuals = fitter.residuals(replace(chosen.fit.state, values=values), chosen.fit.hypothesis)
        return 1.0 - gap.rms(residuals[1:]) / before

    return shapley.shares(named, worth)


def _scope(fit: Fit, name: str) -> Scope:
    """A part of the nominal that no effect stands for moved in all recordings."""
    placed = fit.hypothesis.find(name)
    return placed[1] if placed else Scope.START


def _since(fit: Fit, name: str, calibrated_s: float) -> Scope:
    """calibrated_s: the calibration's end, after which what happens at a moment was not there before."""
    placed = fit.hypothesis.find(name)
    happens_s = [fit.state.values[at] for at in placed[0].moments] if placed else []
    return Scope.TESTS if happens_s and min(happens_s) > calibrated_s else _scope(fit, name)


def _changes(fit: Fit, named: Sequence[str]) -> bool:
    """Whether some of what is named goes with the session's time; else it only seems to, because the motions do."""
    kinds = [effects.BY_ID[name] for name in named]
    return any(k.course or k.scan == "moment" or _scope(fit, k.id) == Scope.EACH for k in kinds)


def _reported(fit: Fit, name: str) -> dict[str, Any]:
    """Where each recording has its own, those of the last test."""
    kind, scope = fit.hypothesis.find(name) or (effects.BY_ID[name], Scope.START)
    values = fit.state.values if fit.hypothesis.find(name) else fit.state.static
    last = fit.hypothesis.tests
    keys = {p.name: key(p.name, last) if scope == Scope.EACH and not p.searched else p.name for p in kind.parameters}
    reported = {parameter: float(values[at]) for parameter, at in keys.items() if at in values}
    column = {"column": kind.column} if kind.column else {}
    return {**reported, **column, "since_calibration": float(bool(scope))}


def _brings(parts: Sequence[str], shares: Mapping[str, float]) -> dict[str, Any]:
    """What an effect changed of the nominal model, and what that shrinks; it is in the effect's own share too."""
    return {"brings": [{"id": part, "shrink": shares[part]} for part in parts]} if parts else {}


def _of_each(fit: Fit, name: str, segments: Sequence[Segment]) -> dict[str, Any]:
    """What each recording has, where they differ."""
    kind, scope = fit.hypothesis.find(name) or (effects.BY_ID[name], Scope.START)
    if scope != Scope.EACH:
        return {}
    values = fit.state.values
    return {
        "recordings": [
            {"name": s.name, **{p.name: float(values[key(p.name, s.number)]) for p in kind.amplitudes}}
            for s in segments[1:]
        ]
    }


def _corrected(fit: Fit, last: Segment) -> Model:
    """The fitted model with its effects, its state as at the end of the last test: a shift has happened, a drift has
    gone so far."""
    model = fit.state.model
    model = with_registration(replace(model, c_deg=monotone(model.c_deg)), fit.state.static)
    values = fit.state.at(last, fit.hypothesis)
    end = last.end_s
    added = []
    for kind in fit.hypothesis.kinds:
        own = {p.name: values[p.name] for p in kind.parameters if p.name in values}
        if kind.holds is not None:
            model = kind.holds(model, own, end)
        added.append(Effect(kind.id, own | ({"column": kind.column} if kind.column else {})))
    return replace(model, effects=tuple(added))


def _interval(values: Array) -> list[float]:
    return [float(v) for v in np.quantile(values, [0.025, 0.975])]


def _elsewhere(shrinks: Array, left: float, named: Sequence[str]) -> list[float]:
    """90 % interval of a shrinkage on another motion: what these blocks tell, and what such tests are off by."""
    later = any(effects.BY_ID[name].course for name in named)
    own = np.quantile(shrinks, [0.05, 0.95])
    other = gap.elsewhere(left, learnt().later if later else learnt().elsewhere)
    return [float(min(own[0], other[0])), float(max(own[1], other[1]))]


def _signature(conditions: Sequence[where.Condition], residuals: Sequence[Array]) -> str | None:
    """What a gap without a cause looks like: of an unknown effect, and of a drift, which only says when."""
    if not conditions:
        return None
    top = [c for c in conditions if c.share > 0.5 * conditions[0].share][:3]
    says = "largest " + ", ".join(c.says for c in top)
    if where.steady(residuals) > _STEADY:
        says = (
            "much the same throughout each recording, as where something changed between them that no column tells: "
            f"a load, a temperature, the mounting; {says}"
        )
    return says
