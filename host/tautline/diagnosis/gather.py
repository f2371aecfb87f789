"""Which hypotheses a diagnosis fits: single effects, and further ones on top of the most probable; what each leaves is
the evidence for the verdict. An event is an effect without a path that repeats (jitter, stick-slip). Another posture is
the shaft in another shape, a tendon at another tension or a new homing between two recordings: it changes the width,
the offset and f_remain at once, each of which is an effect of its own (`Kind.posture`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis import confounded, decide, exact, scatter
from tautline.diagnosis.candidates import Candidate, Search
from tautline.diagnosis.fit import DELAY, WIDTH, Fitter
from tautline.diagnosis.fitted import Fit, Scope
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import CaseEvidence, Weighed
from tautline.diagnosis.scatter import Scatter
from tautline.effects import EVENTS, Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

_REFITS, _RESCOPED = 8, 3  # tolerance: single effects fitted in full, and those of them in every scope
_FURTHER_REFITS = 3  # tolerance: effects fitted in full on top of others
_EXTENDED = (2, 1)  # tolerance: hypotheses of one and of two effects on top of which a further one is fitted
_MOST_EFFECTS = 1 + len(_EXTENDED)
_WIDTH_THEN_ALL = ((WIDTH,), None)  # ids of what another posture changes that are freed at once; None: all


@dataclass(frozen=True)
class Gathered:
    """All fitted hypotheses, both as evidence for the verdict and as fits."""

    evidence: CaseEvidence
    candidates: list[Candidate]  # of each of the evidence's hypotheses, in their order


def gather(
    fitter: Fitter,
    frozen: Sequence[Array],
    base: Fit,
    kinds: Sequence[Kind],
    progress: Progress,
    scopes: Sequence[Scope] = tuple(Scope),
) -> Gathered:
    """Gathers the evidence for a verdict: fits single effects, then further ones on top of the most probable. frozen:
    residuals (scored, k) of each recording by the calibrated model as it is. base: the recalibrated nominal model's
    fit. kinds: effects to try. progress: called with the share that is done and what is done now. scopes: since when an
    effect may be there; with START alone, what the model leaves of its own calibration is attributed to the effect and
    not to the model."""
    fits = 0
    expected = _REFITS + _RESCOPED + sum(_EXTENDED) * _FURTHER_REFITS

    def report(text: str) -> None:
        """Counts one more fit, and reports it with the share of the expected number of fits, 1 at most."""
        nonlocal fits
        fits += 1
        progress(min(1.0, fits / expected), text)

    search = Search(fitter, base, kinds, report, scopes)
    if confounded.load_tells_apart(fitter.segments):
        search = search.without_posture_if_load_explains()
    own_misfit = 0.0  # mean square of the model's residuals on its own calibration at the tests' noise, px^2 or deg^2
    if search.allows_later_effects:
        own_misfit = float(np.mean(np.square(frozen[0] / fitter.relative_noise[0])))
    hypotheses = _Hypotheses(search, search.power(frozen), own_misfit)
    hypotheses.add(search.base, events=True)
    hypotheses.add_single(search.on_top_of(search.base, _REFITS, rescoped=_RESCOPED))
    for size, most in enumerate(_EXTENDED, start=1):
        for _ in range(most):
            below = hypotheses.next_to_extend(size)
            if below is None:
                break
            further = search.on_top_of(below, _FURTHER_REFITS, rescoped=0)
            hypotheses.add_further(further)
            if size == 1:
                hypotheses.add_posture_where_no_effect_suffices(below, further)
    hypotheses.add_posture_beside_delay()
    return Gathered(
        hypotheses.evidence(), [candidate.with_events_as_parameters() for candidate in hypotheses.candidates]
    )


class _Hypotheses:
    """The hypotheses fitted so far, with their evidence; it decides which further ones are worth a fit."""

    def __init__(self, search: Search, frozen: Array, calibrated: float) -> None:
        """frozen: (blocks,) mean squares by the calibrated model as it is. calibrated: mean square of what that model
        leaves of its own calibration, 0 where an effect may have been there then. Both are px^2 or deg^2, each
        recording's divided by the square of its relative noise (`Fitter.relative_noise`)."""
        self.search, self._frozen, self._calibrated = search, frozen, calibrated
        self.candidates: list[Candidate] = []
        self._weighed: list[Weighed] = []  # of each candidate
        self._extended: set[tuple[str, ...]] = set()  # ids of hypotheses on top of which others were fitted
        self._log_ratios: dict[tuple[int, int], float] = {}  # of another hypothesis to one of laws, by their indices

    def add(self, candidate: Candidate, events: bool = False) -> None:
        """Adds a fitted hypothesis to the evidence. events: add also, for each event (effect without a path) and each
        scope, the hypothesis with this event on top, which is identified by the scatter of the residuals."""
        no_scatter = np.zeros_like(candidate.power)
        self._append_with_evidence(candidate, no_scatter, no_scatter)
        if not events:
            return
        kinds = [kind for kind in self.search.kinds if kind.event]
        beyond = {kind.id: self.search.beyond(candidate.fit, [kind]) for kind in kinds}
        for scope in (scope for scope in (Scope.START, Scope.TESTS) if scope in self.search.scopes):
            explained = self._explained_scatter(candidate, tests_only=bool(scope))
            for kind in kinds:
                fit = replace(candidate.fit, hypothesis=candidate.fit.hypothesis.plus(kind, scope))
                self._add_event(replace(candidate, fit=fit, beyond=beyond[kind.id]), kind, explained)

    def _append_with_evidence(self, candidate: Candidate, scatter: Array, rival: Array) -> None:
        """Appends a candidate and its evidence. Its power in the evidence contains how much recordings contradict each
        other (`power_with_surprise`). scatter, rival (blocks,): as in `Weighed`."""
        self.candidates.append(candidate)
        self._weighed.append(
            Weighed(
                candidate.ids,
                candidate.power_with_surprise,
                scatter=scatter,
                rival=rival,
                parameters=candidate.parameters,
                beyond=candidate.beyond,
                wanders=candidate.wanders,
                each=candidate.differs_by_recording,
                from_start=candidate.from_start,
            )
        )

    def _explained_scatter(self, candidate: Candidate, tests_only: bool) -> Scatter:
        """How well each event, and each rival explanation, predicts the scatter that a fit leaves. tests_only: without
        the calibration, for an event that came after it."""
        return scatter.of_fit(self.search.fitter, candidate.fit, self.search.labels, tests_only)

    def _add_event(self, candidate: Candidate, kind: Kind, explained: Scatter) -> None:
        """Adds `candidate` with the evidence for the event `kind` in the scatter that it leaves: for each block the
        log-power by the event, and by the best rival explanation, each less that of the residuals as they are."""
        rivals = (explained.loss[name] for name in scatter.RIVALS if name != kind.id)
        rival = min(rivals, key=lambda loss: float(np.mean(loss)))
        assert kind.event
        candidate = replace(candidate, scatters={kind.event.amount: explained.amount[kind.id]})
        self._append_with_evidence(candidate, explained.loss[kind.id] - explained.plain, rival - explained.plain)

    def _add_with_mean_effect(self, candidate: Candidate) -> None:
        """Adds a fit that contains an event with its mean effect, together with the evidence for that event in its
        scatter."""
        kind = next(kind for kind in candidate.fit.hypothesis.kinds if kind.event and kind.event.mean)
        self._add_event(candidate, kind, self._explained_scatter(candidate, tests_only=True))

    def add_single(self, candidates: Sequence[Candidate]) -> None:
        """Adds fits of single effects, given with the best first, and events on top of the best one and of those that
        it contains. If the best one leaves more than a right effect does, an event or another posture may hide the
        right effect: then events on top of every fit, another posture, and the mean effects of events are added too. If
        it leaves more than noise, so are fits of effects with the parts of the nominal model that they bring. Where no
        effect may have come after the calibration only events are added."""
        if not candidates:
            return
        best = candidates[0]
        best_kind, is_open = best.fit.hypothesis.kinds[0], self.is_open(best)
        floor2 = self.search.fitter.floor**2
        gap2 = float(np.mean(self.search.base.power)) - floor2
        most = learnt().center.unexplained * gap2  # that a right effect may well leave
        hidden = is_open and float(np.mean(best.power)) - floor2 > most
        for candidate in candidates:
            self.add(candidate, events=candidate is best or hidden or candidate.ids[0] in best_kind.contains)
        if not self.search.allows_later_effects:
            return
        if hidden or (is_open and best_kind.posture):
            self._add_posture(candidates)
        for candidate in self.search.with_nominal_parts() if is_open else []:
            self.add(candidate)
        if hidden:
            self._add_mean_effects(self.search.base)
            # Another width is what sticking does in the mean: on top of it no mean effect would be left.
            no_posture = next((one for one in candidates if not one.fit.hypothesis.kinds[0].posture), None)
            if no_posture is not None:
                self._add_mean_effects(no_posture)

    def _add_posture(self, candidates: Sequence[Candidate]) -> None:
        """Adds one fit in which everything that another posture of the shaft changes (B, offset, f_remain) is free at
        once: on top of the first of `candidates` (single effects) that is itself such a change, else on top of the
        nominal model."""
        part = next((one for one in candidates if one.fit.hypothesis.kinds[0].posture), self.search.base)
        candidate = self.search.with_posture(part)
        if candidate is not None:
            self.add(candidate)

    def _add_mean_effects(self, below: Candidate) -> None:
        """Adds, on top of `below`, fits of events after the calibration by their mean effect; only of events that
        explain the scatter of `below` better than all of their rivals do."""
        explained = self._explained_scatter(below, tests_only=True)
        for kind in self.search.kinds:
            if kind.event and kind.event.mean and explained.beats_rivals(kind.id):
                candidate = self.search.with_mean_effect(below, kind, explained.amount[kind.id])
                if candidate is not None:
                    self._add_with_mean_effect(candidate)

    def add_posture_where_no_effect_suffices(self, below: Candidate, further: Sequence[Candidate]) -> None:
        """Adds another posture on top of `below` if every fit of one more effect on it (`further`) leaves more than
        noise; an effect that leaves only noise is preferred, as it has fewer parameters. Does nothing where no effect
        may have come after the calibration."""
        if self.search.allows_later_effects and all(map(self.is_open, further)):
            self._add_with_posture(below)

    def add_posture_beside_delay(self) -> None:
        """Adds another posture on top of a delay, for an angle sensor: without an image a delay and a change of B look
        alike at one speed, so that no single effect may be right. Only if the delay alone was fitted, the best single
        effect leaves more than noise, and an effect may have come after the calibration."""
        if self.search.allows_later_effects and not self.search.fitter.px:
            delay = next((candidate for candidate in self.candidates if candidate.ids == (DELAY,)), None)
            if delay is not None and self._best_single_is_open():
                self._add_with_posture(delay)

    def _add_with_posture(self, below: Candidate) -> None:
        """Adds fits of `below` with another width, then with all that another posture changes; first with a constant
        change of the width, then with a curve, which can imitate a lag. It stops after the first fit that leaves only
        noise. This covers a calibration made on another machine, such as a simulator, with another nominal model. Does
        nothing where the first effect of `below` was there from the start or is itself a posture's."""
        first_kind, first_scope = below.fit.hypothesis.kinds[0], below.fit.hypothesis.scopes[0]
        if first_scope == Scope.START or first_kind.posture:
            return
        for constant_forms in (True, False):
            extended = below
            for only in _WIDTH_THEN_ALL:
                candidate = self.search.with_posture(extended, only, simple=constant_forms)
                if candidate is not None:
                    self.add(candidate)
                    extended = candidate
                    if not self.is_open(candidate):
                        return

    def add_further(self, candidates: Sequence[Candidate]) -> None:
        """Adds fits of several effects, given with the best first; on top of the best one also events, unless it has
        _MOST_EFFECTS already."""
        for i, candidate in enumerate(candidates):
            if set(candidate.ids) & EVENTS:
                self._add_with_mean_effect(candidate)
            else:
                self.add(candidate, events=i == 0 and len(candidate.ids) < _MOST_EFFECTS)

    def is_open(self, candidate: Candidate) -> bool:
        """Whether a fit leaves more than noise and what a sound calibration leaves (`decide.is_open`)."""
        return decide.is_open(self.evidence(), candidate.power)

    def _best_single_is_open(self) -> bool:
        """Whether the single effect with the smallest mean power leaves more than noise; False where none was
        fitted."""
        singles = [candidate for candidate in self.candidates if len(candidate.ids) == 1]
        return bool(singles) and self.is_open(min(singles, key=lambda candidate: float(np.mean(candidate.power))))

    def next_to_extend(self, size: int) -> Candidate | None:
        """The most probable hypothesis of `size` effects that was not extended before and of which some fit's path
        contains all effects; it is marked as extended. None where it leaves only noise, or there is none. The tests of
        whether its effects are the cause (`beyond`, `wanders`) do not count here, as a missing effect fails them
        too."""
        evidence = self.evidence()
        without_tests = tuple(replace(h, beyond=None, wanders=()) for h in evidence.hypotheses)
        verdict = decide.decide(replace(evidence, hypotheses=without_tests))
        for i in np.argsort(-verdict.posterior):
            ids = self.candidates[i].ids
            if len(ids) != size or ids in self._extended:
                continue
            # An event may be likeliest without a path: on top of its mean effect a further effect is seen.
            same = (self.candidates[i], *self.candidates)
            below = next((one for one in same if one.ids == ids and one.predicts_every_effect), None)
            if below is not None:
                self._extended.add(ids)
                return below if self.is_open(below) else None
        return None

    def evidence(self) -> CaseEvidence:
        """The evidence of all hypotheses so far, as `decide.decide` takes it."""
        fitter = self.search.fitter
        return CaseEvidence(
            floor=fitter.floor,
            frozen=self._frozen,
            hypotheses=tuple(replace(h, chance=self._chance_of_other(i)) for i, h in enumerate(self._weighed)),
            applicable=len(self.search.kinds),
            calibrated=self._calibrated,
            doubt=fitter.doubt,
            unsteady=fitter.unsteady,
        )

    def _chance_of_other(self, index: int) -> float:
        """If the effects of the candidate with this index are laws: the probability that the other single effect that
        leaves least does so by noise alone, although the candidate is right (exact.py). Else 1. Ratios of pairs are
        kept."""
        candidate, search = self.candidates[index], self.search
        if not exact.is_law(candidate.ids):
            return 1.0
        # Beside a law what the model leaves of its own calibration is noise; a law from the start has left it itself.
        calibrations_own = 0.0 if candidate.from_start else self._calibrated
        noise = max(search.fitter.floor, float(np.sqrt(calibrations_own)))
        others = [
            i
            for i, other in enumerate(self.candidates)
            if len(other.ids) == 1 and not other.scatters and other.ids[0] not in candidate.ids
        ]
        for i in others:
            if (index, i) not in self._log_ratios:
                self._log_ratios[index, i] = exact.log_likelihood_ratio(
                    candidate.held_out, self.candidates[i].held_out, search.limits, noise
                )
        return exact.chance([self._log_ratios[index, i] for i in others])
