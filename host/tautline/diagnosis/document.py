"""The content of diagnosis.json (docs/files.md) out of what a diagnosis found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis import confounded, decide, flexible, gap, motion, moved, shapley, where
from tautline.diagnosis.candidates import Candidate
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Scope, key
from tautline.diagnosis.gather import Gathered
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.information import Rivals
from tautline.diagnosis.moved import Moved
from tautline.diagnosis.segment import Segment
from tautline.diagnosis.tracker import TrackerError
from tautline.effects import Kind
from tautline.model import Model
from tautline.trajectory import NEXT_FILE

Array = npt.NDArray[np.float64]

FORMAT = "diagnosis/1"
_STEADY = 0.5  # format: share of a gap's power, constant within each recording, from which this is said of it
_CONDITIONS = 5  # format: conditions that are listed at most, the largest share first
_RIVALS = 3  # tolerance: hypotheses with effects, the likeliest, that the next motion is to tell apart
_AS_LARGE, _SAID = 0.5, 3  # format: share of the largest condition from which another is listed, how many at most


@dataclass(frozen=True)
class Found:
    """All that a document is made of: the hypotheses of a diagnosis, and the one that was chosen. Residuals are
    (scored, k) of each recording, the calibration first."""

    model: Model  # as calibrated
    segments: Sequence[Segment]
    fitter: Fitter
    tracked: TrackerError | None  # of videos
    frozen: Sequence[Array]  # residuals by the calibrated model as it is
    recalibrated: float  # rms over the tests by the recalibrated nominal model, px or deg
    kinds: Sequence[Kind]  # the effects that were tried
    gathered: Gathered
    verdict: decide.Decision
    chosen: Candidate  # the hypothesis of what is named
    parts: Sequence[Moved]  # of the nominal model, where a recalibration closes the gap
    carried: Sequence[Array] | None  # residuals of the tests with the effects that the calibration named; None: none

    @property
    def tests(self) -> Sequence[Segment]:
        """The recordings after the calibration."""
        return self.segments[1:]

    @property
    def latest(self) -> Segment:
        """The test that ends last, whatever the order in which the tests were given; the corrected model holds at its
        end."""
        return max(self.tests, key=lambda test: test.end_s)

    @property
    def before(self) -> Sequence[Array]:
        """Residuals of the tests by the calibrated model as it is, (scored, k) each."""
        return self.frozen[1:]

    @property
    def named(self) -> tuple[str, ...]:
        """Ids of the named effects, the leading one first; () unless the verdict is "effect"."""
        return self.verdict.named if self.verdict.name == "effect" else ()

    @property
    def after(self) -> Sequence[Array]:
        """Held-out residuals of the tests by the chosen hypothesis, (scored, k) each; where nothing is named, by the
        model that is handed out: with the effects that the calibration named (`carried`), or as `before`."""
        if self.named:
            return self.chosen.held_out[1:]
        return self.before if self.carried is None else self.carried

    @property
    def floor(self) -> float:
        """One standard deviation of the noise of a coordinate, px or deg."""
        return self.fitter.floor

    @cached_property
    def conditions(self) -> list[where.Condition]:
        """How the gap varies with position, speed, time and so on, the largest share first. Time is left out where
        effects are named and none of them depends on it. [] where the residuals are exactly zero."""
        if gap.rms(self.before) == 0.0:
            return []
        all_conditions = where.conditions(self.tests, self.before)
        if self.verdict.name == "effect" and not _depends_on_time(self.chosen.fit, self.named):
            return [condition for condition in all_conditions if condition.axis != "time"]
        return all_conditions

    @cached_property
    def next_motion(self) -> motion.NextMotion | None:
        """The motion that is expected to tell most about which hypothesis is right; None where no effect with a path
        was fitted."""
        rivals = _rivals(self.gathered, self.verdict)
        return motion.plan_best_motion(self.fitter, rivals) if rivals else None

    @cached_property
    def gap(self) -> dict[str, Any]:
        """The object `gap` of diagnosis.json: rms before and after with their intervals, px or deg, and the shrinkage.
        Where nothing is named, and the model carries nothing, after equals before, and the shrinkage and its interval
        are 0."""
        goes_with_time = any(effects.BY_ID[name].course for name in self.named)
        excess = learnt().later if goes_with_time else learnt().elsewhere
        sizes = gap.with_intervals(self.before, self.after, self.tests, self.floor, excess)
        corrects = self.named or self.carried is not None
        return sizes if corrects else {**sizes, "shrink_ci": [0.0, 0.0], "closable_shrink": 0.0}

    @cached_property
    def by_gaussian_process(self) -> flexible.Flexible | None:
        """How much of what is left a Gaussian process would predict; None where only noise is left, or there are too
        few observations."""
        still_open = decide.is_open(self.gathered.evidence, self.gap["after"] ** 2)
        return flexible.cross_validate(self.tests, self.after, self.floor) if still_open else None


def to_document(found: Found, hidden: Mapping[str, str]) -> dict[str, Any]:
    """Builds the content of diagnosis.json, except for what repeated samples, the tip and a simulator add to it later.
    hidden: {id of an effect that was not fitted: id of the one it is confounded with}."""
    shares, parts = _shares_and_moved_parts(found)
    document: dict[str, Any] = {
        "format": FORMAT,
        "unit": found.segments[0].unit,
        "verdict": found.verdict.name,
        "noise_floor": found.floor,
        "gap": found.gap,
        "gap_recalibrated": {"before": found.recalibrated},
        "calibration_leaves": float(np.sqrt(found.gathered.evidence.calibrated)),  # of its own recording, rms
        "tracker": found.tracked.to_json() if found.tracked else None,  # of videos: the noise of a moving marker
        "flexible": found.by_gaussian_process.to_json() if found.by_gaussian_process else None,
        "effects": _effect_entries(found, shares),
        "moved": [
            {"id": part.id, "share": part.share, "since": _reported_scope(found, part.id).since} for part in parts
        ],
        "candidates": _candidate_entries(found),
        "probability_none": found.verdict.none,
        "probability_unknown": found.verdict.unknown,
        "unknown_from_start": found.verdict.unknown_from_start,  # share of it
        "noisier": 1.0 / found.fitter.relative_noise[0],  # the tests' noise, times the calibration's
        "count": list(found.verdict.count),
        "where": {
            "stage": _likeliest_stage(found.verdict),
            "conditions": [condition.to_json() for condition in found.conditions[:_CONDITIONS]],
        },
        "signature": _signature(found),
        "next_motion": _next_motion(found),
    }
    confounded.add_hidden(document, hidden)
    return document


def _shares_and_moved_parts(found: Found) -> tuple[dict[str, float], Sequence[Moved]]:
    """({id of each named cause: by how much it shrinks the gap's rms, as a share of the rms before}, the parts of the
    nominal model that moved). The parts are those of the verdict, or, where all named effects are parts of the nominal
    model and close the gap, these; otherwise ()."""
    if found.parts:
        return {part.id: part.share * found.gap["shrink"] for part in found.parts}, found.parts
    named = found.named
    causes = (*named, *(found.verdict.brought if named else ()))
    shrinks = dict(zip(causes, _shapley(found, causes), strict=True))
    all_of_nominal = bool(named) and all(effects.BY_ID[name].nominal for name in named)
    if all_of_nominal and moved.closes(found.gap["before"], found.gap["after"], found.floor):
        return shrinks, moved.of_named(list(shrinks.items()))
    return shrinks, ()


def _effect_entries(found: Found, shares: Mapping[str, float]) -> list[dict[str, Any]]:
    """The list `effects` of diagnosis.json, one entry for each named effect. shares: by how much each named cause
    shrinks the gap, by id; the share of an effect includes those of the parts of the nominal model that it brings."""
    fit, ambiguous = found.chosen.fit, found.verdict.ambiguous()
    brought = {
        name: [part for part in found.verdict.brought if part in effects.BY_ID[name].brings] for name in found.named
    }
    values = {name: _parameter_values(fit, name, found.latest) for name in found.named}
    return [
        {
            "id": name,
            "probability": probability,
            "since": _reported_scope(found, name).since,
            "parameters": values[name],
            **_values_by_recording(fit, name, found.segments),
            **_brings_entry(brought[name], shares),
            "shrink": shares[name] + sum(shares[part] for part in brought[name]),
            "swallowed_by_recalibration": moved.closes(found.gap["before"], found.recalibrated, found.floor),
            "loads_on_board": effects.BY_ID[name].on_board,
            "ambiguous_with": _ambiguous_with(found.verdict, name, ambiguous),
        }
        for name, probability in zip(found.named, found.verdict.probability, strict=False)
    ]


def _candidate_entries(found: Found) -> list[dict[str, Any]]:
    """The list `candidates` of diagnosis.json: the effects of the fitted hypotheses, the likeliest to lead first, then
    the effects that the linear screening left out. An effect is identifiable if it is not among those that the
    recordings cannot tell apart (`Decision.ambiguous`), or is the only one there."""
    verdict, best, before = found.verdict, best_of_each(found.gathered), found.gap["before"]
    ambiguous = verdict.ambiguous()
    names = [*verdict.ranked, *(kind.id for kind in found.kinds if kind.id not in verdict.leading)]
    return [
        {
            "id": name,
            "probability": verdict.leading.get(name, 0.0),
            "shrink": gap.shrinkage(before, gap.rms(best[name].held_out[1:])) if name in best else 0.0,
            "identifiable": name not in ambiguous or len(ambiguous) == 1,
        }
        for name in names
    ]


def best_of_each(gathered: Gathered) -> dict[str, Candidate]:
    """{id of an effect: the hypothesis of this effect alone with the smallest mean held-out power}."""
    best: dict[str, Candidate] = {}
    for candidate in gathered.candidates:
        if len(candidate.ids) == 1:
            name = candidate.ids[0]
            if name not in best or candidate.power.mean() < best[name].power.mean():
                best[name] = candidate
    return best


def _next_motion(found: Found) -> dict[str, Any] | None:
    """The object `next_motion` of diagnosis.json: the motion in words, its file, and in nats what is open and what the
    motion is expected to tell of it. None where there is no such motion."""
    following = found.next_motion
    if following is None:
        return None
    nats = {"open": following.entropy, "expected": following.information}
    return {"why": following.why, "file": NEXT_FILE, "nats": nats}


def _rivals(gathered: Gathered, verdict: decide.Decision) -> Rivals | None:
    """The hypotheses that the next motion is to tell apart: the _RIVALS likeliest with effects, all of which have a
    path, beside no effect and an unknown cause. None where no effect with a path was fitted."""
    of_effects = [
        (float(p), candidate)
        for p, candidate in zip(verdict.posterior, gathered.candidates, strict=True)
        if candidate.ids and not effects.EVENTS & set(candidate.ids)
    ]
    likeliest = sorted(of_effects, key=lambda one: -one[0])[:_RIVALS]
    if not likeliest:
        return None
    probability = [verdict.none, *(p for p, _ in likeliest), verdict.unknown]
    fits = [gathered.candidates[0].fit, *(candidate.fit for _, candidate in likeliest)]
    return Rivals.of(fits, probability, likeliest[0][1].parameters)


def _ambiguous_with(verdict: decide.Decision, name: str, ambiguous: Sequence[str]) -> list[str]:
    """The list `ambiguous_with` of a named effect: for the leading one the other effects of `ambiguous`, for the last
    one the verdict's alternatives, for those between none. ambiguous: ids that cannot be told from the leading
    effect."""
    if name == verdict.named[0]:
        return [other for other in ambiguous if other != name]
    return list(verdict.alternatives) if name == verdict.named[-1] else []


def _likeliest_stage(verdict: decide.Decision) -> str | None:
    """The stage with the largest probability to contain the leading effect; None where the verdict is none, or no
    effect has any probability to lead."""
    if verdict.name == "none" or not any(verdict.leading.values()):
        return None
    stages: dict[str, float] = {}
    for name, probability in verdict.leading.items():
        stage = effects.BY_ID[name].stage
        stages[stage] = stages.get(stage, 0.0) + probability
    return max(stages, key=lambda stage: stages[stage])


def _shapley(found: Found, named: Sequence[str]) -> list[float]:
    """The exact Shapley share of each effect of `named` in the shrinkage 1 - after / before of the rms. A set of
    effects is worth the shrinkage by its own fit or, if it was not fitted, by the chosen fit with the amplitudes of all
    other effects at zero; the empty set is worth 0."""
    chosen, before = found.chosen, gap.rms(found.before)
    known: dict[frozenset[str], float] = {frozenset(): 0.0}
    for candidate in found.gathered.candidates:
        if candidate.ids:
            ids, value = frozenset(candidate.ids), gap.shrinkage(before, gap.rms(candidate.held_out[1:]))
            known[ids] = max(known.get(ids, -np.inf), value)
    known[frozenset(named)] = gap.shrinkage(before, gap.rms(chosen.held_out[1:]))

    def worth(names: frozenset[str]) -> float:
        """Shrinkage of the rms, 1 - after / before, with this set of effects alone."""
        if names in known:
            return known[names]
        # An event's amount is off in any case: the simulation would draw a random course of it.
        off = {p.name for name in named if name not in names for p in effects.BY_ID[name].amplitudes} | effects.SCATTERS
        values = {k: (0.0 if k.split("@")[0] in off else v) for k, v in chosen.fit.state.values.items()}
        residuals = found.fitter.residuals(replace(chosen.fit.state, values=values), chosen.fit.hypothesis)
        return gap.shrinkage(before, gap.rms(residuals[1:]))

    return shapley.shares(named, worth)


def _scope_in_fit(fit: Fit, name: str) -> Scope:
    """Since when a named effect is there in this fit; START if the fit is without it, as it is for a part of the
    nominal model that moved in all recordings."""
    present = fit.hypothesis.find(name)
    return present[1] if present else Scope.START


def _reported_scope(found: Found, name: str) -> Scope:
    """Since when a named effect is there, as it is reported: as in the fit, except that a shift or slip whose moments
    all lie after the calibration's end counts as TESTS."""
    fit = found.chosen.fit
    present = fit.hypothesis.find(name)
    moments_s = [fit.state.values[moment] for moment in present[0].moments] if present else []
    after_calibration = bool(moments_s) and min(moments_s) > found.segments[0].end_s
    return Scope.TESTS if after_calibration else _scope_in_fit(fit, name)


def _depends_on_time(fit: Fit, named: Sequence[str]) -> bool:
    """Whether a named effect is a function of the session's time (drift, shift, slip) or of the recording. If none is,
    the gap varies with time only because the motions do."""
    kinds = [effects.BY_ID[name] for name in named]
    return any(k.course or k.scan == "moment" or _scope_in_fit(fit, k.id) == Scope.EACH for k in kinds)


def _parameter_values(fit: Fit, name: str, latest: Segment) -> dict[str, Any]:
    """The object `parameters` of a named effect in diagnosis.json: its fitted values by name, in their own units, the
    name of a column that it follows, and since_calibration, 0 or 1. Where each recording has its own values, those of
    `latest` are given; where the fit is without the effect, those of the nominal model's registration."""
    kind, scope = fit.hypothesis.find(name) or (effects.BY_ID[name], Scope.START)
    values = fit.state.values if fit.hypothesis.find(name) else fit.state.static
    own = {p.name for p in kind.parameters if scope == Scope.EACH and not p.searched}
    keys = {p.name: key(p.name, latest.number) if p.name in own else p.name for p in kind.parameters}
    reported = {parameter: float(values[value_key]) for parameter, value_key in keys.items() if value_key in values}
    column = {effects.COLUMN: kind.column} if kind.column else {}
    return {**reported, **column, "since_calibration": float(bool(scope))}


def _brings_entry(parts: Sequence[str], shares: Mapping[str, float]) -> dict[str, Any]:
    """{"brings": [{id of a part of the nominal model that a named effect changed too, by how much this part shrinks the
    gap}]}; {} without such parts. These shares are included in the effect's own."""
    return {"brings": [{"id": part, "shrink": shares[part]} for part in parts]} if parts else {}


def _values_by_recording(fit: Fit, name: str, segments: Sequence[Segment]) -> dict[str, Any]:
    """{"recordings": [{name of a test, the effect's amplitudes in it}]} for an effect that has amplitudes of its own in
    each test; {} for others."""
    present = fit.hypothesis.find(name)
    if present is None or present[1] != Scope.EACH:
        return {}
    kind, values = present[0], fit.state.values
    return {
        "recordings": [
            {"name": s.name, **{p.name: float(values[key(p.name, s.number)]) for p in kind.amplitudes}}
            for s in segments[1:]  # the tests
        ]
    }


def _signature(found: Found) -> str | None:
    """The conditions under which the gap is largest, in words. Only for an unknown cause, and for a drift, whose name
    does not say more than when the gap grows; else None."""
    conditions = found.conditions
    if not conditions or not (found.verdict.name == "unknown" or confounded.DRIFT in found.named):
        return None
    top = [c for c in conditions if c.share > _AS_LARGE * conditions[0].share][:_SAID]
    says = "largest " + ", ".join(c.says for c in top)
    if where.constant_share(found.before) > _STEADY:
        says = (
            "much the same throughout each recording, as where something changed between them that no column tells: "
            f"a load, a temperature, the mounting; {says}"
        )
    return says
