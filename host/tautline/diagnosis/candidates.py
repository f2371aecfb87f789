"""The hypotheses that are weighed: every effect is screened on top of what is known, the leading ones are fitted, and
each fit is judged by what it leaves on blocks of manoeuvres that it did not see."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis import confined, gap, heldout, moments, wander
from tautline.diagnosis.fit import Fitter, outlier_limit
from tautline.diagnosis.fitted import Fit, ParameterState, Scope
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import Beyond, Wander
from tautline.diagnosis.screen import Screened, screen
from tautline.effects import SCATTERS, SIMULATOR, Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]


_CHANGES = 0.15  # tolerance: share of a change with time that a recording has to show
_LITTLE = 0.1  # tolerance: of an event's amount: where a fit with its mean begins
_OF_A_CURVE = 3  # prior: coefficients that count
_NOISE = 4.0  # tolerance: floors: what is more is no noise, and a lost marker counts no more than that


@dataclass(frozen=True)
class Candidate:
    """A hypothesis fitted to everything, and what it leaves of each block when it has not seen it: an imitation follows
    a motion by its other blocks, and not one of which it saw none."""

    fit: Fit
    left: list[Array]  # of each recording, (scored, k)
    power: Array  # (blocks,) mean squares of `left`, outliers pulled in
    unseen: Array  # (blocks,) of effects and several tests: with how much a recording surprises the others
    beyond: Beyond | None
    scatters: Mapping[str, float] = field(default_factory=dict)  # how much, of an effect without a path
    wanders: tuple[Wander, ...] = ()

    @property
    def each(self) -> bool:
        """Whether an effect is another in each recording."""
        return Scope.EACH in self.fit.hypothesis.scopes

    @property
    def ids(self) -> tuple[str, ...]:
        """Of its effects, in the order in which they were added; () is the nominal model alone."""
        return tuple(kind.id for kind in self.fit.hypothesis.kinds)

    @property
    def parameters(self) -> int:
        """How many of the fitted parameters a hypothesis is charged for, those of effects without a path included. A
        curve is smooth, so it counts as its level, slope and curvature. Of a parameter that each recording has for
        itself one counts, as the recordings' own blocks pay for theirs; but all do that are amplitudes of an effect
        which alone may differ from one recording to the next (`Kind.each`)."""
        hypothesis, values = self.fit.hypothesis, self.fit.state.values
        all_count = {p for kind in hypothesis.kinds if kind.each for p in kind.amplitudes}
        keys = {slot.key for slot in hypothesis.slots if slot.number <= 1 or slot.parameter in all_count}
        keys |= {p.name for kind in hypothesis.kinds for p in kind.parameters if p.searched} - SCATTERS
        curves = [{k for k in keys & values.keys() if k.split("@")[0] in kind.curve} for kind in hypothesis.kinds]
        spared = sum(max(0, len(curve) - _OF_A_CURVE) for curve in curves)
        return len(keys & values.keys()) - spared + len(self.scatters)

    @property
    def has_path(self) -> bool:
        """Whether the prediction follows every effect of this hypothesis. An event (jitter, stick-slip) has no path of
        its own; it is followed only where its mean effect is among the fitted values."""
        events = [kind.event for kind in self.fit.hypothesis.kinds if kind.event]
        return all(event.mean in self.fit.state.values for event in events)

    @property
    def follows(self) -> bool:
        """Whether the prediction follows at least one effect of this hypothesis: one that is no event, or an event
        whose mean effect was fitted."""
        kinds, values = self.fit.hypothesis.kinds, self.fit.state.values
        return any(not kind.event or kind.event.mean in values for kind in kinds)

    def of(self, state: ParameterState, left: list[Array]) -> Candidate:
        """The same effects on the nominal model and registration of `state`. left: the residuals there, (scored, k) of
        each recording; `power` stays as it was."""
        own = replace(self.fit.state, model=state.model, static=state.static)
        return replace(self, fit=replace(self.fit, state=own), left=left)

    def reported(self) -> Candidate:
        """The candidate with the amounts of its events among the fitted values, as diagnosis.json reports them. No
        residual may be computed from it any more."""
        values = {**self.fit.state.values, **self.scatters}
        return replace(self, fit=replace(self.fit, state=replace(self.fit.state, values=values)))


class Search:
    """Hypotheses on top of others, all judged on the same blocks by the same measure."""

    def __init__(
        self,
        fitter: Fitter,
        base: Fit,
        kinds: Sequence[Kind],
        progress: Progress,
        scopes: Sequence[Scope] = tuple(Scope),
    ) -> None:
        """kinds: effects to try; scopes: since when each may be there. `base`, the nominal alone, is judged first."""
        self.fitter, self.kinds, self._progress, self.scopes = fitter, kinds, progress, scopes
        self._with_path = [kind for kind in kinds if not kind.event]
        self.labels = [np.unique(gap.blocks(s), return_inverse=True)[1] for s in fitter.segments]
        self.limits = outlier_limits(fitter, base)
        self._noise_samples_each = gap.noise_samples_per_independent(
            fitter.segments, _NOISE * fitter.floor, fitter.across(base)
        )
        self.base = self.judged(base)

    @property
    def later(self) -> bool:
        """Whether an effect may have come after the calibration."""
        return Scope.TESTS in self.scopes

    def by_what_is_recorded(self) -> Search:
        """The search without effects of posture, where a fit of a measured load already leaves less than a wrong effect
        does: a cause that was recorded comes before one that was not. Else this search."""
        loads = [kind for kind in self.kinds if kind.needs == "load"]
        floor2 = self.fitter.floor**2
        little = learnt().center.unexplained_by_wrong * (float(np.mean(self.base.power)) - floor2)
        for one in Search(self.fitter, self.base.fit, loads, self._progress, self.scopes).on_top_of(self.base, 1, 1):
            if float(np.mean(one.power)) - floor2 < little:
                kinds = [kind for kind in self.kinds if not kind.posture]
                return Search(self.fitter, self.base.fit, kinds, self._progress, self.scopes)
        return self

    def judged(self, fit: Fit) -> Candidate:
        """A fit with what it leaves on blocks held out of it, what of that no law of its effects' stages could leave
        (`beyond`), and by how much its amplitudes are others elsewhere (`wanders`)."""
        rows = self.fitter.linearised(fit)
        left, surprise = heldout.residuals_and_surprise(self.fitter, fit.hypothesis, rows, self.labels, self.limits)
        power = unseen = self.power(left)
        if fit.hypothesis.kinds and fit.hypothesis.tests > 1:
            more = [
                np.bincount(label, values) / np.bincount(label)
                for label, values in zip(self.labels, surprise, strict=True)
            ]
            unseen = power + np.concatenate(more)
        wanders = wander.of_fit(self.fitter, fit, rows, self.limits)
        return Candidate(fit, left, power, unseen, self.beyond(fit), wanders=wanders)

    def beyond(self, fit: Fit, further: Sequence[Kind] = ()) -> Beyond | None:
        """Mean square of each block that no law of the stages of the fit's effects and of `further` could leave,
        residuals cut to _NOISE noise floors, and how many independent numbers it is of; None where these stages could
        leave anything."""
        left = confined.residuals(self.fitter, fit, further)
        if left is None:
            return None
        count = [
            np.bincount(label) * r.shape[1] / self._noise_samples_each
            for label, r in zip(self.labels, left, strict=True)
        ]
        return Beyond(self._power(left, [_NOISE * self.fitter.floor] * len(left)), np.concatenate(count).astype(float))

    def power(self, residuals: Sequence[Array]) -> Array:
        """(blocks,) mean squares of a coordinate, px^2 or deg^2, block after block and recording after recording.
        residuals: (scored, k) of each recording, cut to `limits`."""
        return self._power(residuals, self.limits)

    def _power(self, residuals: Sequence[Array], limits: Sequence[float]) -> Array:
        """(blocks,) mean squares of the residuals cut to each recording's limit, block after block, recording after
        recording."""
        parts = []
        for r, label, limit in zip(residuals, self.labels, limits, strict=True):
            squares = np.mean(np.minimum(np.abs(r), limit) ** 2, axis=1)
            parts.append(np.bincount(label, squares) / np.bincount(label))
        return np.concatenate(parts)

    def on_top_of(self, below: Candidate, refits: int, both_scopes: int) -> list[Candidate]:
        """Fits of one more effect on top of `below`, the smallest loss first: the `refits` effects with the largest
        linear score, each in the scope that scores best; the best `both_scopes` of them in their other scopes too."""
        seen: dict[str, dict[Scope, Screened]] = {}
        for entry in screen(self.fitter, below.fit, self._with_path, self.limits, self.scopes):
            seen.setdefault(entry.kind.id, {}).setdefault(entry.scope, entry)
        candidates: list[Candidate] = []

        def refit(entry: Screened) -> Candidate | None:
            """Fits the screened effect beside those of `below`; None where the fit fails, or its events or its drift
            are not seen in any recording. Appends to `candidates`."""
            self._progress(f"fitting {' and '.join((*below.ids, entry.kind.id))}")
            start = {**below.fit.state.values, **entry.values}
            hypothesis = below.fit.hypothesis.plus(entry.kind, entry.scope)
            fit = self.fitter.fit(hypothesis, start, below.fit.state, entry.others)
            if fit.finite and moments.moments_of(fit):
                fit = moments.refined(self.fitter, fit, self.limits)
            if not (fit.finite and moments.seen_to_happen(self.fitter, fit, self.limits) and self._seen_to_change(fit)):
                return None
            candidates.append(self.judged(fit))
            return candidates[-1]

        def as_often_as_it_helps(entry: Screened) -> None:
            """Fits what happens at moments once, then once more as long as that lowers the loss."""
            before = refit(entry)
            for often in entry.more:
                one = refit(often) if before else None
                if one is None or before is None or _mean_log_power(one) > _mean_log_power(before):
                    return
                before = one

        leading = list(seen)[:refits]
        for name, scopes in seen.items():
            best, *rest = scopes.values()
            # A linear step tells little of parts of the nominal model: the recalibrated one has moved half way; and of
            # a simulator's parameters, which it need not be straight in.
            few = best.kind.nominal or best.kind.stage == SIMULATOR
            if name in leading or (both_scopes and few):
                as_often_as_it_helps(best)
            for other in rest if both_scopes and best.kind.each else []:
                refit(other)
        candidates.sort(key=_mean_log_power)
        for one in candidates[:both_scopes]:
            kind, tried = one.fit.hypothesis.kinds[-1], one.fit.hypothesis.scopes[-1]
            for scope, other in seen[kind.id].items():
                if scope != tried and not kind.each:
                    refit(other)
        return sorted(candidates, key=_mean_log_power)

    def posture(self, below: Candidate, only: Collection[str] | None = None, simple: bool = False) -> Candidate | None:
        """Fits everything that another posture, tension or homing changes at once on top of `below`, for each recording
        separately where there are several tests. only: these effects' ids alone. simple: with their forms of one
        number, where they have one. None where nothing is to be added or the fit fails."""
        kinds = [kind for kind in self.kinds if kind.posture and not below.fit.hypothesis.find(kind.id)]
        kinds = [(simple and kind.simple) or kind for kind in kinds]
        if only is not None:
            kinds = [kind for kind in kinds if kind.id in only]
        scope = Scope.EACH if below.fit.hypothesis.tests > 1 else Scope.TESTS
        hypothesis = below.fit.hypothesis
        for kind in kinds:
            hypothesis = hypothesis.plus(kind, scope)
        self._progress("fitting another posture")
        values = {slot.key: 0.0 for slot in hypothesis.slots} | dict(below.fit.state.values)
        fit = self.fitter.fit(hypothesis, values, below.fit.state)
        return self.judged(fit) if kinds and fit.finite else None

    def with_brought(self) -> list[Candidate]:
        """Fits of effects that came after the calibration together with the parts of the nominal model that they bring
        along."""
        judged = []
        for kind in self.kinds:
            parts = [part for part in self.kinds if part.id in kind.brings]
            if not parts:
                continue
            self._progress(f"fitting {kind.id} with what it brings")
            hypothesis = self.base.fit.hypothesis
            for one in (*parts, kind):
                hypothesis = hypothesis.plus(one, Scope.TESTS)
            values = {slot.key: 0.0 for slot in hypothesis.slots}
            values |= {p.name: self.fitter.scale(p) for p in kind.amplitudes} | {
                p.name: p.shape[0] for p in kind.shapes
            }
            fit = self.fitter.fit(hypothesis, values, self.base.fit.state)
            if fit.finite:
                judged.append(self.judged(fit))
        return judged

    def in_the_mean(self, below: Candidate, kind: Kind, amount: float) -> Candidate | None:
        """An event after the calibration on top of a hypothesis, by its mean effect alone: sticking widens the play by
        about the length that the tip sticks for (what was there while calibrating is in B). amount: of the event, where
        the fit begins. None where the fit finds no such mean."""
        assert kind.event
        hypothesis = below.fit.hypothesis.plus(kind, Scope.TESTS)
        values = {**below.fit.state.values, kind.event.amount: 0.0, kind.event.mean: amount}
        little = {kind.event.mean: _LITTLE * amount}  # what is below may hold most of it already
        fit = self.fitter.fit(hypothesis, values, below.fit.state, [little])
        return self.judged(fit) if fit.finite and fit.state.values[kind.event.mean] > 0.0 else None

    def _seen_to_change(self, fit: Fit) -> bool:
        """For an effect with a course over time (drift): whether some recording shows a change of more than a share
        _CHANGES of its largest value. What is constant in every recording is another width or offset. True for all
        other effects."""
        kind, scope = fit.hypothesis.kinds[-1], fit.hypothesis.scopes[-1]
        if kind.course is None:
            return True
        values = fit.state.values
        at = [
            [kind.course(values, float(s.arrival_s[s.scored][i]) + s.offset_s) for i in (0, -1)]
            for s in self.fitter.segments
            if not (scope and s.calibration)
        ]
        most = max(abs(value) for ends in at for value in ends)
        return max(abs(last - first) for first, last in at) > _CHANGES * most


def _mean_log_power(candidate: Candidate) -> float:
    """Mean logarithm of the blocks' held-out mean squares: what hypotheses are compared by."""
    return float(np.mean(np.log(candidate.power)))


def applicable(fitter: Fitter, left_out: Collection[str] = ()) -> list[Kind]:
    """The effects of the library that these recordings could show (by sensor, load, other joints), but for those left
    out."""
    load = any(s.motor.load_mNm is not None for s in fitter.segments)
    freedom = any(
        values is not None and float(np.ptp(values)) > 0.0
        for s in fitter.segments
        for values in (s.motor.translation_mm, s.motor.rotation_deg)
    )
    joints = sorted({name for s in fitter.segments for name in s.motor.joints})
    has = {"": True, "camera": fitter.px, "sensor": fitter.delayed, "load": load, "freedom": freedom}
    known = [kind for kind in effects.LIBRARY if kind.id not in left_out]
    further = [kind.of_joint(name) for kind in known if kind.of_joint for name in joints]
    return [*(kind for kind in known if has[kind.needs]), *further]


def outlier_limits(fitter: Fitter, base: Fit) -> list[float]:
    """For each recording the magnitude to which residuals are cut, the same for all hypotheses that are compared, px or
    deg. At least 8 noise floors: noise is never cut."""
    return [max(outlier_limit(r), 8.0 * fitter.floor) for r in base.residuals]
