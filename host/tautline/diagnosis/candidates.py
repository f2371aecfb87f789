"""The hypotheses that a diagnosis compares. Effects are ranked by a linear step on top of a fit (screen.py), the
leading ones are fitted, and each fit is evaluated by its cross-validated residuals (heldout.py).

Residuals are (scored, k) for each recording: scored observations, k = 2 px of a marker or k = 1 deg of an angle.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.core import samples
from tautline.diagnosis import confined, gap, heldout, moments, wander
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, ParameterState, Scope
from tautline.diagnosis.heldout import Labels
from tautline.diagnosis.huber import outlier_limit
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import Beyond, Wander
from tautline.diagnosis.screen import Screened, screen
from tautline.effects import FREEDOMS, SCATTERS, SIMULATOR, Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]


_LEAST_CHANGE = 0.15  # tolerance: share of a drift's largest value by which it must change within some recording
_SMALL_START = 0.1  # tolerance: share of an event's amount from which a fit of its mean effect starts a second time
_CURVE_PARAMETERS = 3  # prior: effective parameters of a smooth curve: level, slope, curvature
_NOISE_LIMIT = 4.0  # tolerance: noise floors to which residuals that should be noise are cut: a lost marker is none
_ANOTHER = 0.75  # tolerance: of what a linear step with one moment less leaves: another moment is worth a fit
# Prior odds and the price of twelve parameters differ by 25 nats at most.
_HOPELESS = 40.0  # tolerance: nats: a first fit that is less likely than another by more is not finished
_OUTLIER_LIMIT = 8.0  # tolerance: noise floors below which a residual is never cut


@dataclass(frozen=True)
class Candidate:
    """A hypothesis fitted to all recordings, with its cross-validated residuals."""

    fit: Fit
    held_out: list[Array]  # (scored, k) of each recording: residual of every block by the fit without that block
    power: Array  # (blocks,) mean squares of `held_out`, outliers cut, px^2 or deg^2
    power_with_surprise: Array  # (blocks,) plus by how much each recording contradicts the fit of the others
    beyond: Beyond | None  # what no law of the effects' stages could leave; None where these could leave anything
    scatters: Mapping[str, float] = field(default_factory=dict)  # amount of each event, by its parameter's name
    wanders: tuple[Wander, ...] = ()  # how the amplitude of each effect with a path varies

    @property
    def differs_by_recording(self) -> bool:
        """Whether an effect has amplitudes of its own in each recording."""
        return Scope.EACH in self.fit.hypothesis.scopes

    @property
    def from_start(self) -> bool:
        """Whether an effect was there while calibrating."""
        return Scope.START in self.fit.hypothesis.scopes

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the effects in the order in which they were added; () for the nominal model alone."""
        return tuple(kind.id for kind in self.fit.hypothesis.kinds)

    @property
    def parameters(self) -> int:
        """The number of parameters that the information criterion counts (`parameter_price`): the fitted ones, those
        that are searched, and the amounts of events. A smooth curve counts as _CURVE_PARAMETERS at most. A parameter
        with a value for each recording counts once, as each value has to pay in the blocks of its own recording; but of
        effects with `Kind.each` every value counts."""
        hypothesis, values = self.fit.hypothesis, self.fit.state.values
        all_count = {p for kind in hypothesis.kinds if kind.each for p in kind.amplitudes}
        # A slot's number is 0 where all recordings share it; of those with a value each, number 1 stands for all.
        keys = {slot.key for slot in hypothesis.slots if slot.number <= 1 or slot.parameter in all_count}
        keys |= {p.name for kind in hypothesis.kinds for p in kind.parameters if p.searched} - SCATTERS
        keys &= values.keys()
        curves = [{k for k in keys if k.split("@")[0] in kind.curve} for kind in hypothesis.kinds]
        free_of_charge = sum(max(0, len(curve) - _CURVE_PARAMETERS) for curve in curves)
        return len(keys) - free_of_charge + len(self.scatters)

    @property
    def predicts_every_effect(self) -> bool:
        """Whether the simulated path contains every effect of this hypothesis. An event (jitter, stick-slip) is random:
        the path contains it only if its mean effect was fitted."""
        events = [kind.event for kind in self.fit.hypothesis.kinds if kind.event]
        return all(event.mean in self.fit.state.values for event in events)

    @property
    def predicts_an_effect(self) -> bool:
        """Whether the simulated path contains at least one effect of this hypothesis: one that is no event, or an event
        whose mean effect was fitted."""
        kinds, values = self.fit.hypothesis.kinds, self.fit.state.values
        return any(not kind.event or kind.event.mean in values for kind in kinds)

    def with_nominal(self, state: ParameterState, residuals: list[Array]) -> Candidate:
        """The same effects with the nominal model and registration of `state`, and with `residuals` (scored, k), which
        these leave of each recording, as `held_out`. `power` stays as it was."""
        moved = replace(self.fit.state, model=state.model, static=state.static)
        return replace(self, fit=replace(self.fit, state=moved), held_out=residuals)

    def with_events_as_parameters(self) -> Candidate:
        """A copy with the amounts of its events added to the fitted values, as diagnosis.json reports them. No
        residuals may be computed from this copy, as the simulation would draw a random course of the events."""
        values = {**self.fit.state.values, **self.scatters}
        return replace(self, fit=replace(self.fit, state=replace(self.fit.state, values=values)))


class Search:
    """Fits further effects on top of fitted hypotheses, and evaluates all of them on the same blocks with the same
    outlier limits."""

    def __init__(
        self,
        fitter: Fitter,
        base: Fit,
        kinds: Sequence[Kind],
        progress: Progress,
        scopes: Sequence[Scope] = tuple(Scope),
    ) -> None:
        """base: the recalibrated nominal model's fit, without effects. kinds: effects to try. progress: called with
        what is fitted now. scopes: since when an effect may be there."""
        self.fitter, self.kinds, self._progress, self.scopes = fitter, kinds, progress, scopes
        self._with_path = [kind for kind in kinds if not kind.event]
        self.labels = [np.unique(gap.blocks(s), return_inverse=True)[1] for s in fitter.segments]
        self.limits = outlier_limits(fitter, base)
        self._noise_samples_each = gap.noise_samples_per_independent(
            fitter.segments, _NOISE_LIMIT * fitter.floor, fitter.across(base), fitter.relative_noise
        )
        self.base = self.evaluated(base)

    @property
    def allows_later_effects(self) -> bool:
        """Whether an effect may have come after the calibration, so that the first recording is without it."""
        return Scope.TESTS in self.scopes

    def without_posture_if_load_explains(self) -> Search:
        """A search without the effects of posture (width, offset, f_remain), if an effect of the measured load alone
        leaves less of the gap than a wrong effect usually does: a cause that was recorded is preferred to one that was
        not. Otherwise this search itself. It fits the load's effects to find out."""
        loads = [kind for kind in self.kinds if kind.needs == "load"]
        floor2 = self.fitter.floor**2
        least_of_wrong = learnt().center.unexplained_by_wrong * (float(np.mean(self.base.power)) - floor2)
        by_load = Search(self.fitter, self.base.fit, loads, self._progress, self.scopes).on_top_of(self.base, 1, 1)
        if any(float(np.mean(candidate.power)) - floor2 < least_of_wrong for candidate in by_load):
            kinds = [kind for kind in self.kinds if not kind.posture]
            return Search(self.fitter, self.base.fit, kinds, self._progress, self.scopes)
        return self

    def evaluated(self, fit: Fit) -> Candidate:
        """Cross-validates a fit and adds two tests of whether its effects are the cause: `beyond`, what no law of their
        stages could leave, and `wanders`, how their amplitudes vary. With effects and more than one test,
        power_with_surprise is `power` plus the mean over each block of how much its recording contradicts the fit of
        the others (heldout.py); otherwise it is `power`, as nothing but the calibration could contradict a single
        test."""
        rows = self.fitter.linearised(fit)
        held_out, surprise = heldout.residuals_and_surprise(self.fitter, fit.hypothesis, rows, self.labels, self.limits)
        power = with_surprise = self.power(held_out)
        if fit.hypothesis.kinds and fit.hypothesis.tests > 1:
            block_means = [
                np.bincount(label, values) / np.bincount(label)
                for label, values in zip(self.labels, surprise, strict=True)
            ]
            with_surprise = power + np.concatenate(block_means)
        wanders = wander.of_fit(self.fitter, fit, rows, self.limits)
        return Candidate(fit, held_out, power, with_surprise, self.beyond(fit), wanders=wanders)

    def beyond(self, fit: Fit, further: Sequence[Kind] = ()) -> Beyond | None:
        """What the fit leaves that no law of its effects' stages could leave, whatever the law's equations
        (`confined.residuals`); None where that function returns None. `power` (blocks,): mean square of a coordinate,
        px^2, of these residuals cut to _NOISE_LIMIT noise floors. `count` (blocks,): how many independent numbers each
        mean is of, fewer than samples, as the noise of neighbouring frames is alike
        (`gap.noise_samples_per_independent`). further: effects that are not fitted but may free the angle or the time
        too."""
        residuals = confined.residuals(self.fitter, fit, further)
        if residuals is None:
            return None
        count = [
            np.bincount(label) * r.shape[1] / self._noise_samples_each
            for label, r in zip(self.labels, residuals, strict=True)
        ]
        limits = [_NOISE_LIMIT * self.fitter.floor * times for times in self.fitter.relative_noise]
        return Beyond(self._block_powers(residuals, limits, self.labels), np.concatenate(count).astype(float))

    def power(self, residuals: Sequence[Array]) -> Array:
        """(blocks,) Mean square of a coordinate in each block, px^2 or deg^2, block after block and recording after
        recording. residuals: (scored, k) of each recording; they are cut to `limits` and divided by the recording's
        relative noise (`Fitter.relative_noise`)."""
        return self._block_powers(residuals, self.limits, self.labels)

    def _block_powers(self, residuals: Sequence[Array], limits: Sequence[float], labels: Labels) -> Array:
        """As `power`, with limits (one for each recording) and block labels given. A block's power is at least that of
        the least noise that any sensor is taken to have, so that a fit without residuals still leaves noise."""
        least, parts = samples.least_noise("px" if self.fitter.px else "deg") ** 2, []
        for r, label, limit, times in zip(residuals, labels, limits, self.fitter.relative_noise, strict=True):
            squares = np.mean((np.minimum(np.abs(r), limit) / times) ** 2, axis=1)
            parts.append(np.maximum(np.bincount(label, squares) / np.bincount(label), least))
        return np.concatenate(parts)

    def on_top_of(self, below: Candidate, refits: int, rescoped: int) -> list[Candidate]:
        """Fits one more effect on top of `below` and returns the candidates, smallest `_mean_log_power` first. Effects
        are screened linearly; `_effects_to_fit` chooses some of them for a first fit, and the fits that are not
        hopeless (`_are_hopeless`) are finished. The effects of the best `rescoped` candidates are also fitted in their
        other scopes (since when they are there); 0 where `below` has an effect already. refits: number of effects with
        the largest linear score that are fitted."""
        screened: dict[str, dict[Scope, Screened]] = {}  # by id and scope, the largest score first
        for entry in screen(self.fitter, below.fit, self._with_path, self.limits, self.scopes):
            screened.setdefault(entry.kind.id, {}).setdefault(entry.scope, entry)
        tried = self._effects_to_fit(screened, refits, thorough=rescoped > 0)
        begun = [self._first_fit(below, entry) for entry in tried]
        candidates: list[Candidate] = []
        for entry, fit, hopeless in zip(tried, begun, self._are_hopeless(begun), strict=True):
            if not hopeless:
                candidates += self._finished_with_more_moments(below, entry, fit)
        candidates.sort(key=_mean_log_power)
        for candidate in candidates[:rescoped]:
            kind, since = candidate.fit.hypothesis.kinds[-1], candidate.fit.hypothesis.scopes[-1]
            for scope, other in screened[kind.id].items():
                if scope != since and not kind.each:
                    candidates += self._finished_candidates(other, self._first_fit(below, other))
        return sorted(candidates, key=_mean_log_power)

    def _effects_to_fit(
        self, screened: Mapping[str, Mapping[Scope, Screened]], refits: int, *, thorough: bool
    ) -> list[Screened]:
        """Chooses the screened effects to fit: the `refits` with the largest linear score and the effects that these
        contain (`Kind.contains`), each in the scope that scores best. With `thorough` also all effects of which a
        linear step tells little, and those with `Kind.each` in every scope. screened: {id: {scope: entry}}, the largest
        score first."""
        leading = list(screened)[:refits]
        # A simple effect takes the place of a flexible one that contains it, where it suffices: it is fitted too.
        contains = {kind.id: kind.contains for kind in self._with_path}
        leading += [contained for name in leading for contained in contains[name]]
        tried: list[Screened] = []
        for name, by_scope in screened.items():
            best, *others = by_scope.values()
            # A linear step tells little of the nominal model's parts, as the recalibration has moved them half way
            # already, and of a simulator's parameters, in which the simulation need not be linear.
            step_tells_little = best.kind.nominal or best.kind.stage == SIMULATOR
            if name in leading or (thorough and step_tells_little):
                tried.append(best)
            if thorough and best.kind.each:
                tried += others
        return tried

    def _first_fit(self, below: Candidate, entry: Screened) -> Fit:
        """A first fit, to fewer observations (`Fitter.begin`), of the effects of `below` and the screened one."""
        self._progress(f"fitting {' and '.join((*below.ids, entry.kind.id))}")
        start = {**below.fit.state.values, **entry.values}
        hypothesis = below.fit.hypothesis.plus(entry.kind, entry.scope)
        return self.fitter.begin(hypothesis, start, below.fit.state, entry.others)

    def _are_hopeless(self, begun: Sequence[Fit]) -> list[bool]:
        """For each first fit whether it is so much less likely than the best of them that it cannot be the cause, or is
        not finite. A block tells one number beyond the noise (Stacked.log_likelihood), so with powers P of the blocks,
        at least floor^2, minus the log-likelihood is sum(log P) / 2; hopeless is what exceeds the least by _HOPELESS or
        more."""
        labels = self._coarse_labels()
        floor2 = self.fitter.floor**2
        nats = [
            0.5 * float(np.sum(np.log(np.maximum(self._block_powers(fit.residuals, self.limits, labels), floor2))))
            if fit.finite
            else np.inf
            for fit in begun
        ]
        return [not n < min(nats) + _HOPELESS for n in nats]

    def _coarse_labels(self) -> Labels:
        """For each recording the block number of each observation of `Fitter.coarse`, to which first fits are made;
        numbered anew from 0, as some blocks may have no observation there."""
        return [
            np.unique(label[np.searchsorted(s.arrival_s[s.scored], few.arrival_s[few.scored])], return_inverse=True)[1]
            for s, few, label in zip(self.fitter.segments, self.fitter.coarse.segments, self.labels, strict=True)
        ]

    def _finished_candidates(self, entry: Screened, begun: Fit) -> list[Candidate]:
        """Finishes the first fit `begun` of a screened effect and returns [its candidate]; [] where the fit is not
        finite, or no recording shows its moments or its drift. Moments are searched to a frame."""
        fit = self.fitter.finish(begun)
        if fit.finite and moments.moments_of(fit):
            fit = moments.refine_moments(self.fitter, fit, self.limits)
        if not (fit.finite and moments.moments_are_seen(self.fitter, fit, self.limits) and self._drift_is_seen(fit)):
            return []
        return [self.evaluated(fit)]

    def _finished_with_more_moments(self, below: Candidate, entry: Screened, begun: Fit) -> list[Candidate]:
        """As `_finished_candidates`; for an effect that happens at moments (shift, slip) it also fits two moments,
        three and so on, until a fit fails or leaves more than the one before. What one of several moments leaves may
        hide it: as long as no fit succeeds, it goes on while linear steps leave a share of at most _ANOTHER of what
        they did with one moment less. Returns all candidates, that last one included."""
        fitted = self._finished_candidates(entry, begun)
        for fewer, repeated in pairwise((entry, *entry.more)):
            if not fitted and 1.0 - repeated.gain > _ANOTHER * (1.0 - fewer.gain):
                break
            again = self._finished_candidates(repeated, self._first_fit(below, repeated))
            before = fitted
            fitted = before + again
            if before and (not again or _mean_log_power(again[-1]) > _mean_log_power(before[-1])):
                break
        return fitted

    def with_posture(
        self, below: Candidate, only: Collection[str] | None = None, simple: bool = False
    ) -> Candidate | None:
        """Fits on top of `below`, at once, all effects that another posture, tension or homing causes (width, offset,
        f_remain), in each test separately where there are several. only: ids to which these are restricted. simple:
        take the effects' constant forms (`Kind.simple`) in place of curves over the motor's range. None where no effect
        is left to add, or the fit is not finite."""
        kinds = [kind for kind in self.kinds if kind.posture and not below.fit.hypothesis.find(kind.id)]
        kinds = [(simple and kind.simple) or kind for kind in kinds if only is None or kind.id in only]
        if not kinds:
            return None
        scope = Scope.EACH if below.fit.hypothesis.tests > 1 else Scope.TESTS
        hypothesis = below.fit.hypothesis
        for kind in kinds:
            hypothesis = hypothesis.plus(kind, scope)
        self._progress("fitting another posture")
        values = {slot.key: 0.0 for slot in hypothesis.slots} | dict(below.fit.state.values)
        fit = self.fitter.fit(hypothesis, values, below.fit.state)
        return self.evaluated(fit) if fit.finite else None

    def with_nominal_parts(self) -> list[Candidate]:
        """For each effect that may also change parts of the nominal model when it comes after the calibration
        (`Kind.brings`; friction widens the backlash): a fit of the effect together with these parts, for all tests. It
        starts from amplitudes that a user would notice (`Fitter.scale`), the first listed value of each shape, and
        unchanged parts. Effects that happen at a moment are left out, as the moment has to be searched first; so are
        fits that are not finite."""
        candidates = []
        for kind in self.kinds:
            parts = [part for part in self.kinds if part.id in kind.brings]
            if not parts or kind.scan == "moment":
                continue
            self._progress(f"fitting {kind.id} with what it brings")
            hypothesis = self.base.fit.hypothesis
            for added in (*parts, kind):
                hypothesis = hypothesis.plus(added, Scope.TESTS)
            values = {slot.key: 0.0 for slot in hypothesis.slots}
            values |= {p.name: self.fitter.scale(p) for p in kind.amplitudes} | {
                p.name: p.shape[0] * p.share(self.fitter.model.rig.actuator.span) for p in kind.shapes
            }
            fit = self.fitter.fit(hypothesis, values, self.base.fit.state)
            if fit.finite:
                candidates.append(self.evaluated(fit))
        return candidates

    def with_mean_effect(self, below: Candidate, kind: Kind, amount: float) -> Candidate | None:
        """Fits the mean effect of an event that came after the calibration, on top of `below`: in the mean a tip that
        sticks and jumps lags by half a jump, as in a wider play. amount: the event's amount, in its parameter's unit,
        from which the fit starts, beside a second start at _SMALL_START of it. None where the fit is not finite or its
        mean effect is not positive."""
        assert kind.event
        hypothesis = below.fit.hypothesis.plus(kind, Scope.TESTS)
        values = {**below.fit.state.values, kind.event.amount: 0.0, kind.event.mean: amount}
        small = {kind.event.mean: _SMALL_START * amount}  # the effects of `below` may hold most of it already
        fit = self.fitter.fit(hypothesis, values, below.fit.state, [small])
        return self.evaluated(fit) if fit.finite and fit.state.values[kind.event.mean] > 0.0 else None

    def _drift_is_seen(self, fit: Fit) -> bool:
        """Whether some recording shows the drift of the last added effect: its size (`Kind.course`) changes within that
        recording by more than a share _LEAST_CHANGE of its largest size. If it is nearly constant in every recording,
        it is another width or offset instead. True for an effect without a course."""
        kind, scope = fit.hypothesis.kinds[-1], fit.hypothesis.scopes[-1]
        if kind.course is None:
            return True
        values = fit.state.values
        ends = [  # of each recording that has the effect: its size at the first and at the last scored observation
            [kind.course(values, float(s.arrival_s[s.scored][i]) + s.offset_s) for i in (0, -1)]
            for s in self.fitter.segments
            if not (scope and s.calibration)
        ]
        largest = max(abs(value) for pair in ends for value in pair)
        return max(abs(last - first) for first, last in ends) > _LEAST_CHANGE * largest


def _mean_log_power(candidate: Candidate) -> float:
    """Mean over blocks of log(held-out mean square), by which a search ranks its fits: the smaller the better."""
    return float(np.mean(np.log(candidate.power)))


def applicable(fitter: Fitter, left_out: Collection[str] = ()) -> list[Kind]:
    """The effects of the library that these recordings could show: `Kind.needs` must be met by their sensor and their
    columns of load and other axes. An effect of other joints is listed once for each joint's column. Effects that need
    a simulator in the motor's place are left out, as are those with ids in `left_out`."""
    load = any(s.motor.load_mNm is not None for s in fitter.segments)
    moving = [
        column
        for column in FREEDOMS
        if any((x := getattr(s.motor, column)) is not None and float(np.ptp(x)) > 0.0 for s in fitter.segments)
    ]
    joints = sorted({name for s in fitter.segments for name in s.motor.joints})
    has = {
        "": True,
        "camera": fitter.px,
        "sensor": fitter.delayed,
        "load": load,
        "freedom": bool(moving),
        SIMULATOR: False,
    }
    known = [kind for kind in effects.LIBRARY if kind.id not in left_out]
    further = [kind.of_joint(name) for kind in known if kind.of_joint for name in joints]
    return [*(kind.following(moving) for kind in known if has[kind.needs]), *further]


def outlier_limits(fitter: Fitter, base: Fit) -> list[float]:
    """For each recording the magnitude, px or deg, to which residuals are cut in the comparison of hypotheses, by what
    `base` leaves; at least _OUTLIER_LIMIT times the recording's noise, so that noise is never cut."""
    least = [_OUTLIER_LIMIT * fitter.floor * times for times in fitter.relative_noise]
    return [max(outlier_limit(r), limit) for r, limit in zip(base.residuals, least, strict=True)]
