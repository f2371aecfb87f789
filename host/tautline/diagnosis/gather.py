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
    """All fitted hypotheses: as evidence for the verdict, and as fits."""

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
    """The evidence for a verdict: fits of single effects, then of further ones on top of the most probable. frozen:
    residuals (scored, k) of each recording by the calibrated model as it is. base: the recalibrated nominal model's
    fit. kinds: effects to try. scopes: since when an effect may be there. With START alone it was there while
    calibrating, so that what the model leaves of its own calibration is the effect's and no misfit of the model."""
    fits = 0
    expected = _REFITS + _RESCOPED + sum(_EXTENDED) * _FURTHER_REFITS

    def report(text: str) -> None:
        """Counts one more fit and reports the share of the expected number."""
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
    """The hypotheses fitted so far, and which further ones are worth a fit."""

    def __init__(self, search: Search, frozen: Array, calibrated: float) -> None:
        """frozen: (blocks,) mean squares by the calibrated model as it is. calibrated: its mean square on its own
        calibration, 0 where an effect may have been there then; both px^2 or deg^2, each recording's over its noise
        beside the tests' (`Fitter.relative_noise`)."""
        self.search, self._frozen, self._calibrated = search, frozen, calibrated
        self.candidates: list[Candidate] = []
        self._weighed: list[Weighed] = []  # of each candidate
        self._extended: set[tuple[str, ...]] = set()  # ids of hypotheses on top of which others were fitted
        self._log_ratios: dict[tuple[int, int], float] = {}  # of another hypothesis to one of laws, by their indices

    def add(self, candidate: Candidate, events: bool = False) -> None:
        """Adds a fitted hypothesis to the evidence. events: whether also every event (an effect without a path) on top
        of it, identified by the scatter of its residuals."""
        no_scatter = np.zeros_like(candidate.power)
        self._append(candidate, no_scatter, no_scatter)
        if not events:
            return
        kinds = [kind for kind in self.search.kinds if kind.event]
        beyond = {kind.id: self.search.beyond(candidate.fit, [kind]) for kind in kinds}
        for scope in (scope for scope in (Scope.START, Scope.TESTS) if scope in self.search.scopes):
            explained = self._explained_scatter(candidate, tests_only=bool(scope))
            for kind in kinds:
                fit = replace(candidate.fit, hypothesis=candidate.fit.hypothesis.plus(kind, scope))
                self._add_event(replace(candidate, fit=fit, beyond=beyond[kind.id]), kind, explained)

    def _append(self, candidate: Candidate, scatter: Array, rival: Array) -> None:
        """Appends a candidate and its evidence: what it leaves with by how much recordings contradict each other, and
        the tests of its effects. scatter, rival (blocks,): as in Weighed."""
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
        """How well each event and each rival explains the scatter that a fit leaves. tests_only: for an event that came
        after the calibration."""
        return scatter.of_fit(self.search.fitter, candidate.fit, self.search.labels, tests_only)

    def _add_event(self, candidate: Candidate, kind: Kind, explained: Scatter) -> None:
        """Adds `candidate` with what the scatter that it leaves says of the event `kind`: by block the log-likelihood
        of the event, and of the best rival explanation, against the residuals as they are."""
        rivals = (explained.loss[name] for name in scatter.RIVALS if name != kind.id)
        rival = min(rivals, key=lambda loss: float(np.mean(loss)))
        assert kind.event
        candidate = replace(candidate, scatters={kind.event.amount: explained.amount[kind.id]})
        self._append(candidate, explained.loss[kind.id] - explained.plain, rival - explained.plain)

    def _add_with_mean_effect(self, candidate: Candidate) -> None:
        """Adds a fit that has an event's mean effect among its parameters, with what its scatter says of that event."""
        kind = next(kind for kind in candidate.fit.hypothesis.kinds if kind.event and kind.event.mean)
        self._add_event(candidate, kind, self._explained_scatter(candidate, tests_only=True))

    def add_single(self, candidates: Sequence[Candidate]) -> None:
        """Adds fits of single effects, given the best first. Where the best leaves more than a right effect does, an
        event or another posture may hide which one it is: then also events on top of each, all that another posture
        changes, and the mean effects of events."""
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
        """Adds one fit in which all that another posture of the shaft changes is free at once: B, the offset and
        f_remain. It goes on top of the first of `candidates` (single effects) that is itself such a change, else on top
        of the nominal model."""
        part = next((one for one in candidates if one.fit.hypothesis.kinds[0].posture), self.search.base)
        candidate = self.search.with_posture(part)
        if candidate is not None:
            self.add(candidate)

    def _add_mean_effects(self, below: Candidate) -> None:
        """Adds fits of events after the calibration by their mean effect, on top of `below`, where these explain its
        scatter better than noise of another level does."""
        explained = self._explained_scatter(below, tests_only=True)
        for kind in self.search.kinds:
            if kind.event and kind.event.mean and explained.beats_noise(kind.id):
                candidate = self.search.with_mean_effect(below, kind, explained.amount[kind.id])
                if candidate is not None:
                    self._add_with_mean_effect(candidate)

    def add_posture_where_no_effect_suffices(self, below: Candidate, further: Sequence[Candidate]) -> None:
        """Adds another posture on top of `below` where each of the fits of one more effect on it, `further`, leaves
        more than noise: one that leaves only that does so with fewer parameters. Nothing where no effect may have come
        after the calibration."""
        if self.search.allows_later_effects and all(map(self.is_open, further)):
            self._add_with_posture(below)

    def add_posture_beside_delay(self) -> None:
        """Adds another posture on top of a delay alone, for an angle sensor: without an image a delay and a change of B
        look alike at one speed, so that no single effect may be right. Only if the delay alone was fitted, even the
        best single effect leaves more than noise, and an effect may have come after the calibration."""
        if self.search.allows_later_effects and not self.search.fitter.px:
            delay = next((candidate for candidate in self.candidates if candidate.ids == (DELAY,)), None)
            if delay is not None and self._best_single_is_open():
                self._add_with_posture(delay)

    def _add_with_posture(self, below: Candidate) -> None:
        """Adds fits for the case that another machine was calibrated, such as a simulator, whose nominal model is not
        this one's. To `below` is added another width, then all that another posture changes; first with a width that
        changes by a constant, then by a curve, which can imitate a lag. The first fit that leaves only noise is the
        last. Nothing is added to what was there from the start, or is itself another posture's."""
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
        """Adds fits of several effects, given the best first; on the best one also events."""
        for i, candidate in enumerate(candidates):
            if set(candidate.ids) & EVENTS:
                self._add_with_mean_effect(candidate)
            else:
                self.add(candidate, events=i == 0 and len(candidate.ids) < _MOST_EFFECTS)

    def is_open(self, candidate: Candidate) -> bool:
        """Whether a fit leaves more than noise and what a sound calibration leaves."""
        return decide.is_open(self.evidence(), candidate.power)

    def _best_single_is_open(self) -> bool:
        """Whether the single effect with the least power leaves more than noise."""
        singles = [candidate for candidate in self.candidates if len(candidate.ids) == 1]
        return bool(singles) and self.is_open(min(singles, key=lambda candidate: float(np.mean(candidate.power))))

    def next_to_extend(self, size: int) -> Candidate | None:
        """The most probable hypothesis of `size` effects on top of which a further one is to be fitted: one whose path
        contains all of them, not extended before; None where it leaves only noise, or there is none. The tests of
        whether its effects are the cause (`beyond`, `wanders`) do not count, as a missing effect fails them too."""
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
        """The evidence of all hypotheses so far, as `decide` takes it."""
        fitter = self.search.fitter
        return CaseEvidence(
            floor=fitter.floor,
            frozen=self._frozen,
            hypotheses=tuple(replace(h, chance=self._chance(i)) for i, h in enumerate(self._weighed)),
            applicable=len(self.search.kinds),
            calibrated=self._calibrated,
            noisier=fitter.noisier,
            doubt=fitter.doubt,
            unsteady=fitter.unsteady,
        )

    def _chance(self, index: int) -> float:
        """For the candidate with this index, if its effects are laws: the probability that some other single effect
        leaves so much less though the law is right (exact.py); else 1."""
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
