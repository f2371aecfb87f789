"""The evidence of a diagnosis: hypotheses of one effect, and of more on top of the likeliest, fitted and judged."""

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

MOST_EFFECTS = 3
_REFITS, _BOTH_SCOPES = 8, 3  # tolerance: of single effects
_FURTHER_REFITS = 3  # tolerance: of effects on top of others
_EXTENDED = (2, 1)  # tolerance: hypotheses of one and of two effects that a further one is put on


@dataclass(frozen=True)
class Gathered:
    evidence: CaseEvidence
    candidates: list[Candidate]  # of each of the evidence's hypotheses


def gather(
    fitter: Fitter,
    frozen: Sequence[Array],
    base: Fit,
    kinds: Sequence[Kind],
    progress: Progress,
    scopes: Sequence[Scope] = tuple(Scope),
) -> Gathered:
    """The evidence for a verdict: fits of single effects, then of further ones on top of the most probable. frozen:
    residuals of each recording by the calibrated model as it is. base: the recalibrated nominal's fit. scopes: since
    when an effect may be there; with START alone no recording counts as the calibration."""
    steps = [0]

    def told(text: str) -> None:
        """Reports one more fit, as a share of about as many as there may be."""
        steps[0] += 1
        progress(min(1.0, steps[0] / (_REFITS + _BOTH_SCOPES + sum(_EXTENDED) * _FURTHER_REFITS)), text)

    search = Search(fitter, base, kinds, told, scopes)
    if confounded.load_tells_apart(fitter.segments):
        search = search.by_what_is_recorded()
    own = float(np.mean(np.square(frozen[0]))) if search.later else 0.0
    weighing = _Weighing(search, search.power(frozen), own)
    weighing.add(search.base, events=True)
    weighing.add_single(search.on_top_of(search.base, _REFITS, _BOTH_SCOPES))
    for size, most in enumerate(_EXTENDED, start=1):
        for _ in range(most):
            below = weighing.next_to_extend(size)
            if below is None:
                break
            weighing.add_further(search.on_top_of(below, _FURTHER_REFITS, 0))
            if size == 1 and search.later:
                weighing.add_changed(below)
    if search.later and not fitter.px:  # nothing else than its fit tells a delay from a width at one speed
        late = next((candidate for candidate in weighing.candidates if candidate.ids == (DELAY,)), None)
        if late is not None and weighing.open():
            weighing.add_changed(late)
    return Gathered(weighing.evidence(), [candidate.reported() for candidate in weighing.candidates])


class _Weighing:
    def __init__(self, search: Search, frozen: Array, calibrated: float) -> None:
        """frozen: (blocks,) mean squares by the calibrated model as it is. calibrated: its mean square on its own
        calibration, 0 where no recording is one."""
        self.search, self._frozen, self._calibrated = search, frozen, calibrated
        self.candidates: list[Candidate] = []
        self._weighed: list[Weighed] = []
        self._extended: set[tuple[str, ...]] = set()
        self._likelier: dict[tuple[int, int], float] = {}  # than a law's hypothesis another is

    def add(self, candidate: Candidate, events: bool = False) -> None:
        """Adds a fitted hypothesis to the evidence; with `events` also every event (an effect without a path) on top of
        it."""
        nothing = np.zeros_like(candidate.power)
        self.candidates.append(candidate)
        self._weighed.append(
            Weighed(
                *(candidate.ids, candidate.unseen, nothing, nothing, candidate.parameters),
                beyond=candidate.beyond,
                wanders=candidate.wanders,
                each=candidate.each,
            )
        )
        if not events:
            return
        kinds = [kind for kind in self.search.kinds if kind.event]
        beyond = {kind.id: self.search.beyond(candidate.fit, [kind]) for kind in kinds}
        for scope in (scope for scope in (Scope.START, Scope.TESTS) if scope in self.search.scopes):
            left = self._scatter_left(candidate, bool(scope))
            for kind in kinds:
                fit = replace(candidate.fit, hypothesis=candidate.fit.hypothesis.plus(kind, scope))
                self._add_scatter(replace(candidate, fit=fit, beyond=beyond[kind.id]), kind, left)

    def add_posture(self, candidates: Sequence[Candidate]) -> None:
        """Adds the fit of all that another posture changes, on top of the best single effect of a posture or of
        none."""
        part = next((one for one in candidates if one.fit.hypothesis.kinds[0].posture), self.search.base)
        posture = self.search.posture(part)
        if posture is not None:
            self.add(posture)

    def add_changed(self, below: Candidate) -> None:
        """Adds fits with another width, and while more than noise is left with all that another posture changes, beside
        an effect that came after the calibration: if another machine was calibrated, such as a simulator, its nominal
        is not this one's. A constant change of width comes first, as one that varies with place can imitate a lag."""
        hypothesis = below.fit.hypothesis
        if hypothesis.scopes[0] == Scope.START or hypothesis.kinds[0].posture:
            return
        for simple in (True, False):
            beside = below
            for only in ((WIDTH,), None):
                candidate = self.search.posture(beside, only, simple)
                if candidate is not None:
                    self.add(candidate)
                    beside = candidate
                    if not self._open(candidate):
                        return

    def add_in_the_mean(self, below: Candidate) -> None:
        """Adds fits of events after the calibration by their mean effect, on top of `below`, if they explain its
        scatter better than noise does."""
        left = self._scatter_left(below, True)
        for kind in self.search.kinds:
            if kind.event and kind.event.mean and left.beats_noise(kind.id):
                held = self.search.in_the_mean(below, kind, left.amount[kind.id])
                if held is not None:
                    self._add_with_scatter(held)

    def _add_with_scatter(self, candidate: Candidate) -> None:
        """Adds a fit that has an event's mean effect, with what its scatter says of that event."""
        kind = next(kind for kind in candidate.fit.hypothesis.kinds if kind.event and kind.event.mean)
        self._add_scatter(candidate, kind, self._scatter_left(candidate, True))

    def _scatter_left(self, candidate: Candidate, only_tests: bool) -> Scatter:
        """How well each event and each rival explains the scatter that a fit leaves. only_tests: of an effect that came
        after the calibration."""
        return scatter.of_fit(self.search.fitter, candidate.fit, self.search.labels, only_tests)

    def _add_scatter(self, candidate: Candidate, kind: Kind, left: Scatter) -> None:
        """Adds `candidate` with the log-likelihoods by block, from the scatter that it leaves, of the event `kind` and
        of the best rival explanation, both against plain noise."""
        rival = min(
            (left.loss[name] for name in scatter.RIVALS if name != kind.id), key=lambda loss: float(np.mean(loss))
        )
        assert kind.event
        candidate = replace(candidate, scatters={kind.event.amount: left.amount[kind.id]})
        self.candidates.append(candidate)
        self._weighed.append(
            Weighed(
                candidate.ids,
                candidate.unseen,
                scatter=left.loss[kind.id] - left.plain,
                rival=rival - left.plain,
                parameters=candidate.parameters,
                white=left.white,
                beyond=candidate.beyond,
                wanders=candidate.wanders,
                each=candidate.each,
            )
        )

    def add_single(self, candidates: Sequence[Candidate]) -> None:
        """Adds fits of single effects, the best first. Where the best still leaves much, an event may be there that
        hides what is beside it: then also events on top of each, what a posture changes, and events in the mean."""
        floor2 = self.search.fitter.floor**2
        before = float(np.mean(self.search.base.power)) - floor2
        hidden = (
            bool(candidates) and float(np.mean(candidates[0].power)) - floor2 > learnt().center.unexplained * before
        )
        hidden = hidden and self._open(candidates[0])
        contained = candidates[0].fit.hypothesis.kinds[0].contains if candidates else ()
        for i, one in enumerate(candidates):
            self.add(one, events=i == 0 or hidden or one.ids[0] in contained)
        if not self.search.later:
            return
        if hidden or (candidates and candidates[0].fit.hypothesis.kinds[0].posture and self._open(candidates[0])):
            self.add_posture(candidates)
        for one in self.search.with_brought() if candidates and self._open(candidates[0]) else []:
            self.add(one)
        if hidden:
            self.add_in_the_mean(self.search.base)
            # Another width is what sticking does in the mean: beside it nothing of that would be seen.
            best = next((one for one in candidates if not one.fit.hypothesis.kinds[0].posture), None)
            if best is not None:
                self.add_in_the_mean(best)

    def add_further(self, candidates: Sequence[Candidate]) -> None:
        """Adds fits of several effects, the best first; on the best one also events."""
        for i, one in enumerate(candidates):
            if set(one.ids) & EVENTS:
                self._add_with_scatter(one)
            else:
                self.add(one, events=i == 0 and len(one.ids) < MOST_EFFECTS)

    def open(self) -> bool:
        """Whether the best single effect leaves more than noise."""
        singles = [candidate for candidate in self.candidates if len(candidate.ids) == 1]
        return bool(singles) and self._open(min(singles, key=lambda candidate: float(np.mean(candidate.power))))

    def _open(self, candidate: Candidate) -> bool:
        """Whether a fit leaves more than noise and the nominal model's own misfit."""
        return decide.is_open(self.evidence(), candidate.power)

    def next_to_extend(self, size: int) -> Candidate | None:
        """The most probable hypothesis of `size` effects, with a path and not extended before, if it leaves more than
        noise. A missing effect may explain what is left beyond its stages and an amplitude that wanders, so neither
        counts here. None where there is no such hypothesis."""
        evidence = self.evidence()
        anyhow = tuple(replace(h, beyond=None, wanders=()) for h in evidence.hypotheses)
        verdict = decide.decide(replace(evidence, hypotheses=anyhow))
        for i in np.argsort(-verdict.posterior):
            ids = self.candidates[i].ids
            if len(ids) != size or ids in self._extended:
                continue
            # Sticking may be likeliest without a path: with one a further effect is seen beside it.
            one = next(
                (
                    candidate
                    for candidate in (self.candidates[i], *self.candidates)
                    if candidate.ids == ids and candidate.has_path
                ),
                None,
            )
            if one is not None:
                self._extended.add(ids)
                return one if self._open(one) else None
        return None

    def evidence(self) -> CaseEvidence:
        """All hypotheses so far with what they leave, as `decide` takes it."""
        fitter = self.search.fitter
        weighed = tuple(replace(h, chance=self._chance(i)) for i, h in enumerate(self._weighed))
        weighed_kinds = len(self.search.kinds)
        return CaseEvidence(
            fitter.floor, self._frozen, weighed, weighed_kinds, self._calibrated, fitter.doubt, fitter.unsteady
        )

    def _chance(self, law: int) -> float:
        """For a hypothesis of laws: the probability that some other single effect leaves so much less though the law is
        right; else 1."""
        one, search = self.candidates[law], self.search
        if not exact.is_law(one.ids):
            return 1.0
        noise = max(search.fitter.floor, float(np.sqrt(self._calibrated)))
        others = [
            i
            for i, other in enumerate(self.candidates)
            if len(other.ids) == 1 and not other.scatters and other.ids[0] not in one.ids
        ]
        for i in others:
            if (law, i) not in self._likelier:
                self._likelier[law, i] = exact.likelier(one.left, self.candidates[i].left, search.limits, noise)
        return exact.chance([self._likelier[law, i] for i in others])
