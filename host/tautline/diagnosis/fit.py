"""Fits one hypothesis (no effect, one or several) to all recordings at once, the nominal model free where it may move.

The nominal that is shared by all recordings: B and f_remain as corrections in cubic B-splines and a factor on what of
them these cannot follow, the static registration and the delay. Its Jacobian is analytic along the play (nominal.py);
the effects' Jacobian is a difference quotient of the simulation.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from tautline import effects, spread
from tautline.diagnosis.fitted import STATIC_NAMES, Fit, Hypothesis, ParameterState, Scope
from tautline.diagnosis.segment import Segment
from tautline.effects import Parameter, Path
from tautline.elements import SINGLE
from tautline.geometry import across
from tautline.least_squares import descend
from tautline.model import Model, allowed_width
from tautline.nominal import Nominal, Normal, Rows, by_width
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

WIDTH_PIECES, _REMAINING_PIECES = (
    len(effects.BY_ID[name].curve) - 3  # equation: a cubic spline's coefficients beyond its pieces
    for name in ("transmission.backlash", "configuration.remaining")
)
_ROUGH = 0.001  # prior: second difference of a correction's neighbouring coefficients, share of its range
STATIC_COLUMNS = slice(2, 8)  # format: of Seen.columns, with a camera
WIDTH, REMAINING, STATIC, DELAY = PARTS = (
    "transmission.backlash",
    "configuration.remaining",
    "registration.static",
    "acquisition.delay",
)  # of the nominal model, that a recalibration moves
_OUTLIER = 6.0  # tolerance: robust standard deviations: a residual beyond is pulled in, unless it is one of many
_AHEAD_S = 5e-3  # tolerance: over which the tip's velocity is taken
_DIFFERENCE = 0.05  # tolerance: of a parameter's scale: the step of its difference quotient
_SMALL_GAIN, _COARSE_GAIN = 1e-4, 5e-4  # tolerance: of the cost: next to nothing
_COARSE_FRAMES = 2500  # tolerance: that a fit begins with
_ROUGH_STEPS, _COARSE_STEPS, _FULL_STEPS = 3, 12, 8  # tolerance: of each start, of the best one, of all observations
_NOMINAL_STEPS = 16
_FAR, _CURVES_FAR = 30.0, 2.0  # prior: of a parameter's scale: its prior, and that of a curve's coefficients
_KNOWN = 1e-6  # of the prior, which is a step's: where a simulator is the nominal it stays
_RARE = 0.01  # tolerance: a misfit that lasts longer than this share of a recording is no outlier


@dataclass(frozen=True)
class ScoredRows(Rows):
    """One recording's scored observations. Unknowns beside B and f_remain: factors on their details and, with a camera,
    static registration and delay."""

    path: Path  # at all observations
    model: Model  # with the tables that the path was simulated with

    def moved_by_tables(self, model: Model) -> Array:
        """(scored, k) The change of the prediction, to first order, with another model's B and f_remain on the same
        grid."""
        width = np.interp(self.p, model.q, model.width - self.model.width)
        follow = np.interp(self.tip, model.q, model.c_deg - self.model.c_deg)
        return self.moved(width, follow)


@dataclass(frozen=True)
class _Shown:
    """What one recording's sensor shows at a state, at all observations. by_c, by_static: `image_with_slopes`."""

    parameters: Mapping[str, Any]
    path: Path
    model: Model  # with the tables that the path was simulated with
    seen: Array
    by_c: Array
    by_static: Array
    residual: Array  # at the scored ones


class Fitter:
    def __init__(
        self, model: Model, segments: Sequence[Segment], load_reference: float = 0.0, *, smooth: bool = False
    ) -> None:
        """load_reference: mNm at which the model's tables hold. smooth: the model with one play, and without what of
        its curves the corrections' splines cannot follow."""
        self.segments, self.load_reference = list(segments), load_reference
        self.px = segments[0].unit == "px"
        self.delayed = segments[0].sensor == model.sensor  # the model has a delay of its own for what is observed
        low = min(float(s.motor.q.min()) for s in segments)
        high = max(float(s.motor.q.max()) for s in segments)
        self.nominal_curves = curves = Nominal(Basis(low, high, WIDTH_PIECES), Basis(low, high, _REMAINING_PIECES))
        if smooth:
            model = _smoothed(curves, model)
        self.model = model
        span = model.rig.actuator.span
        gain = abs(model.rig.coarse.gain)
        # Priors keep what the motion does not excite where calibration left it.
        # Standard deviations: of B's coefficients, unit of q, of f_remain's, deg, and of factors on their details.
        prior = [np.full(curves.width.size, 0.03 * span), np.full(curves.follow.size, 0.1 * gain * span), np.ones(2)]
        # What the splines cannot follow: an effect that was there during calibration left its ripple in it.
        self._details = tuple(
            spline_residual(basis, model.q, values)
            for basis, values in ((curves.width, model.width), (curves.follow, model.c_deg))
        )
        if self.px:
            prior += [np.full(3, 3.0), np.full(3, 2.0)]  # of the registration, deg and mm
        self._prior = np.concatenate([*prior, np.full(1, 0.02)])  # and of the delay, s
        self.from_start = all(s.drive is None for s in segments)  # else: a simulator has none of the library's effects
        if not self.from_start:
            self._prior *= _KNOWN
        self._bending = block_diag(
            curves.width.bending / (_ROUGH * span) ** 2, curves.follow.bending / (_ROUGH * gain * span) ** 2
        )
        self.floor = 1.0
        self.doubt = 0.0  # of the floor's power's logarithm: how far it may be off, where that was seen
        self.unsteady = 0.0  # its standard deviation between blocks
        # What begins outside of the angles that were reached would be another gain and offset.
        ends = np.sort(model.remaining(np.array([low, high])))
        inset = 0.05 * float(ends[1] - ends[0])  # prior: share of the angles that were reached
        self._reached = (float(ends[0]) + inset, float(ends[1]) - inset)

    @property
    def nothing(self) -> Hypothesis:
        """No effect."""
        return Hypothesis(tests=len(self.segments) - 1)

    def nominal(self, free: Collection[str] = PARTS) -> Fit:
        """The recalibrated model without any effect: of PARTS only the free ones move."""
        held = self._columns_of(set(PARTS) - set(free))
        minimum = self.descend(self.nothing, self.start(), _NOMINAL_STEPS, held=held)
        # Beside an effect as large as an obstacle a descent may stall for once.
        return self.descend(self.nothing, minimum.state, _NOMINAL_STEPS, held=held)

    def _columns_of(self, parts: Collection[str]) -> npt.NDArray[np.int64]:
        """Indices of the nominal's unknowns that belong to these of PARTS."""
        b, details = self.nominal_curves.width.size, self.nominal_curves.size
        delay = len(self._prior) - 1
        of = {
            WIDTH: [*range(b), details],
            REMAINING: [*range(b, details), details + 1],
            STATIC: list(range(details + 2, delay)),
            DELAY: [delay],
        }
        return np.array([i for part in parts for i in of[part]], dtype=np.int64)

    def scale(self, parameter: Parameter) -> float:
        """A change of a parameter that a user would notice, in its own unit; the motor's, where the parameter declares
        it as a share of the motor's range."""
        return parameter.scale * (self.model.rig.actuator.span if parameter.unit.startswith("unit") else 1.0)

    def start(self) -> ParameterState:
        """The calibrated model without effects, its registration (with a camera) as it is."""
        return ParameterState(self.model, dict.fromkeys(STATIC_NAMES, 0.0) if self.px else {})

    def residuals(self, state: ParameterState, hypothesis: Hypothesis) -> list[Array]:
        """Observed less predicted at the scored observations, (scored, k) for each recording."""
        per_segment = []
        for segment in self.segments:
            _, predicted = segment.predict(state.model, state.at(segment, hypothesis), self.load_reference)
            per_segment.append((segment.observed - predicted)[segment.scored])
        return per_segment

    def across(self, fit: Fit) -> list[Array] | None:
        """For each recording the part of a fit's residuals, (scored, 1) px, across the way that the image goes as the
        tip bends; None without a camera."""
        if not self.px:
            return None
        left = []
        for segment, shown in zip(self.segments, self.shown(fit.state, fit.hypothesis), strict=True):
            left.append(across(shown.residual, shown.by_c[segment.scored])[:, None])
        return left

    def rows(self, state: ParameterState, hypothesis: Hypothesis) -> list[ScoredRows]:
        """For each recording its residual and its derivatives by the nominal's unknowns, at the scored observations."""
        return self.rows_of(state, self.shown(state, hypothesis))

    def shown(self, state: ParameterState, hypothesis: Hypothesis) -> list[_Shown]:
        """What `rows` differentiates, of each recording."""
        every = [state.at(segment, hypothesis) for segment in self.segments]
        for segment, parameters in zip(self.segments, every, strict=True):
            segment.ask(parameters)
        return [
            self._shown(segment, state.model, parameters)
            for segment, parameters in zip(self.segments, every, strict=True)
        ]

    def _shown(self, segment: Segment, model: Model, parameters: Mapping[str, Any]) -> _Shown:
        """One recording simulated with these parameters. Without a camera the sensor shows the angle itself: by_c is 1
        and by_static is empty."""
        path = segment.follow(model, parameters, self.load_reference)
        model = effects.tabled(model, parameters)
        if self.px:
            seen, by_c, by_static = effects.image_with_slopes(model, path, parameters, segment.offset_s)
        else:
            seen = path.c_deg[:, None]
            by_c, by_static = np.ones_like(seen), np.empty((*seen.shape, 0))
        residual = (segment.observed - seen)[segment.scored]
        return _Shown(parameters, path, model, seen, by_c, by_static, residual)

    def rows_of(self, state: ParameterState, shown: Sequence[_Shown]) -> list[ScoredRows]:
        """`rows`, where `shown` is simulated at that state already."""
        slope_b = np.gradient(state.model.width, state.model.q)
        slope_f = np.gradient(state.model.c_deg, state.model.q)
        return [
            self._rows(segment, state.model, each, slope_b, slope_f)
            for segment, each in zip(self.segments, shown, strict=True)
        ]

    def _rows(self, segment: Segment, nominal: Model, shown: _Shown, slope_b: Array, slope_f: Array) -> ScoredRows:
        """`rows` of one recording. slope_b, slope_f: the nominal's dB/dq and df_remain/dq on its grid."""
        path, model, keep, by_c = shown.path, shown.model, segment.scored, shown.by_c
        if model is not nominal:
            slope_b, slope_f = np.gradient(model.width, model.q), np.gradient(model.c_deg, model.q)
        p, tip, gain = path.p[keep], path.tip[keep], path.gain[keep]
        by_b = gain * np.interp(tip, model.q, slope_f) * by_width(path.lean[keep], np.interp(p, model.q, slope_b))
        details = np.column_stack(
            [by_b * np.interp(p, model.q, self._details[0]), gain * np.interp(tip, model.q, self._details[1])]
        )
        by_delay = np.zeros_like(by_c)
        if self.delayed:
            sooner = {**shown.parameters, "delay": shown.parameters.get("delay", 0.0) - _AHEAD_S}
            later = segment.follow(nominal, sooner, self.load_reference)
            by_delay = ((path.c_deg - later.c_deg) / _AHEAD_S)[:, None] * by_c
            others = path.translation_mm is not None or path.rotation_deg is not None
            if self.px and others:  # these come late as well
                by_delay = (shown.seen - effects.image(model, later, shown.parameters, segment.offset_s)) / _AHEAD_S
        columns = np.concatenate(
            [by_c[keep][:, :, None] * details[:, None, :], shown.by_static[keep], by_delay[keep][:, :, None]], axis=2
        )
        return ScoredRows(p, tip, by_b, gain, by_c[keep], columns, shown.residual, path, model)

    def normal(
        self, rows: Rows, extra: Array | None = None, weight: Array | None = None, known: Normal | None = None
    ) -> Normal:
        """Normal matrix and gradient of one recording. extra (n, k, m): further columns, whose unknowns come after the
        others. known: the result without `extra`, which is then not summed again."""
        columns, first = rows.columns, rows.columns.shape[2]
        before = self.nominal_curves.size + first
        if extra is not None:
            columns = np.concatenate([columns, extra], axis=2)
        total = Normal.zeros(before - first + columns.shape[2])
        if known is not None:
            total.matrix[:before, :before], total.gradient[:before] = known.matrix, known.gradient
        self.nominal_curves.add(rows, total, columns, weight, first=0 if known is None else first)
        return total

    def left(self, rows: Sequence[Rows]) -> list[Array]:
        """The residual of each recording, (scored, k), after a linear least-squares step of the nominal's unknowns that
        no prior holds back."""
        parts = [self.normal(row) for row in rows]
        matrix = np.asarray(sum(part.matrix for part in parts))
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-12 * float(np.diag(matrix).max())))
        inverse = np.linalg.pinv(matrix * np.outer(scale, scale), rcond=1e-12, hermitian=True)
        step = scale * (inverse @ (scale * np.asarray(sum(part.gradient for part in parts))))
        return [row.residual - self.moved(row, step) for row in rows]

    def moved(self, row: Rows, step: Array) -> Array:
        """(n, k): by how much a step of the unknowns, those of row.columns last, moves the prediction."""
        return self.nominal_curves.moved(row, step)

    def spread(self, hypothesis: Hypothesis) -> Array:
        """Standard deviations of the prior: of the nominal's corrections, then of the effects' parameters."""
        return np.concatenate([self._prior, [_FAR * self.scale(slot.parameter) for slot in hypothesis.slots]])

    def prior_precision(self, hypothesis: Hypothesis) -> Array:
        """The inverse covariance of the unknowns' prior: 1 / spread^2, and a penalty on the bending of the corrections
        of B and f_remain, so that where a motion hardly reaches they continue smoothly."""
        stiff = np.diag(1 / self.spread(hypothesis) ** 2)
        n = len(self._bending)
        stiff[:n, :n] += self._bending
        at = len(self._prior)
        stiff[at:, at:] += self.curve_precision(hypothesis)
        return stiff

    def curve_precision(self, hypothesis: Hypothesis) -> Array:
        """The part of the slots' prior precision that belongs to effects that are curves over the motor's range:
        smooth, and zero where no motion was."""
        slots = hypothesis.slots
        stiff = np.zeros((len(slots), len(slots)))
        for curve in {kind.curve for kind in hypothesis.kinds}:
            for number in {slot.number for slot in slots}:
                own = {slot.parameter.name: i for i, slot in enumerate(slots) if slot.number == number}
                if here := [own[name] for name in curve if name in own]:
                    coefficient = slots[here[0]].parameter
                    stiff[here, here] += 1 / (_CURVES_FAR * self.scale(coefficient)) ** 2
                    stiff[np.ix_(here, here)] += self._bending_precision(coefficient, len(here))
        return stiff

    def _bending_precision(self, coefficient: Parameter, size: int) -> Array:
        """Precision of the bending of a curve with `size` cubic B-spline coefficients, as for a correction of B or
        f_remain."""
        actuator = self.model.rig.actuator
        # Second differences of the same curve go with the square of the knots' distance.
        share = _ROUGH * actuator.span * ((_REMAINING_PIECES + 3) / size) ** 2
        by_unit = 1.0 if coefficient.unit == "unit" else abs(self.model.rig.coarse.gain)
        return np.asarray(Basis(*actuator.range, size - 3).bending / (share * by_unit) ** 2)

    def effect_columns(self, state: ParameterState, hypothesis: Hypothesis, rows: Sequence[ScoredRows]) -> list[Array]:
        """Derivatives of the prediction by the hypothesis' slots, (scored, k, slots) for each recording, by difference
        quotients of the simulation, or of the tables where it is they that hold an effect."""
        slots = hypothesis.slots
        steps = [_DIFFERENCE * self.scale(slot.parameter) for slot in slots]
        there = [
            replace(state, values={**state.values, slot.key: state.values[slot.key] + step})
            for slot, step in zip(slots, steps, strict=True)
        ]
        for segment in self.segments:
            for stepped in there:
                segment.ask(stepped.at(segment, hypothesis))
        columns = [np.zeros((*row.residual.shape, len(slots))) for row in rows]
        for i, slot in enumerate(slots):  # of all recordings one after the other: they share its tables
            for segment, row, own in zip(self.segments, rows, columns, strict=True):
                if slot.holds_in(segment):
                    moved = self.change_of_prediction(segment, there[i], hypothesis, slot.parameter, row, row.residual)
                    own[:, :, i] = moved / steps[i]
        return columns

    def linearised(self, fit: Fit) -> list[ScoredRows]:
        """The rows of each recording at a fit, with the columns of its slots after the nominal's."""
        plain = self.rows(fit.state, fit.hypothesis)
        own = self.effect_columns(fit.state, fit.hypothesis, plain)
        return [
            replace(row, columns=np.concatenate([row.columns, columns], axis=2))
            for row, columns in zip(plain, own, strict=True)
        ]

    def change_of_prediction(
        self,
        segment: Segment,
        state: ParameterState,
        hypothesis: Hypothesis,
        parameter: Parameter,
        row: ScoredRows,
        residual: Array,
    ) -> Array:
        """(scored, k) The change of the prediction when `state` replaces the one that left `residual` and `row`'s path,
        the two differing by `parameter` alone; 0 where the marker would be behind the camera."""
        values = state.at(segment, hypothesis)
        if parameter.name in effects.IN_TABLES:
            moved = row.moved_by_tables(effects.tabled(state.model, values))
        else:
            path = segment.follow(state.model, values, self.load_reference) if moves_tip(parameter) else row.path
            moved = residual - (segment.observed - segment.seen(state.model, values, path))[segment.scored]
        return np.where(np.isfinite(moved), moved, 0.0)

    def fit(
        self,
        hypothesis: Hypothesis,
        values: Mapping[str, float],
        start: ParameterState,
        others: Sequence[Mapping[str, float]] = (),
    ) -> Fit:
        """The best fit of a hypothesis from several starts. The effects start from `values` and from each of `others`;
        the nominal from `start`, for a single effect also as calibrated (a recalibration has bent towards the effect),
        and if it was there from the start also with one play in place of several. A few observations choose the start;
        all of them end the fit."""
        coarse, fits, nominals = self.coarse, [], [start]
        if len(hypothesis.kinds) == 1:
            nominals.append(self.start())
            if hypothesis.scopes[0] == Scope.START and self.model.elements != SINGLE:
                nominals.append(replace(self.start(), model=replace(self.model, elements=SINGLE, friction=None)))
        for nominal in nominals:
            states = [replace(nominal, values={**values, **each}) for each in ({}, *others)]
            best = _best_fit([coarse.descend(hypothesis, state, _ROUGH_STEPS) for state in states])
            fits.append(coarse.descend(hypothesis, best.state, _COARSE_STEPS, _COARSE_GAIN))
        return self.descend(hypothesis, _best_fit(fits).state, _FULL_STEPS)

    @property
    def coarse(self) -> Fitter:
        """A fitter of the same recordings with about _COARSE_FRAMES observations."""
        self._coarse.floor = self.floor
        return self._coarse

    @cached_property
    def _coarse(self) -> Fitter:
        """As `coarse`, built once; this fitter itself where it has hardly more observations."""
        stride = round(sum(int(s.scored.sum()) for s in self.segments) / _COARSE_FRAMES)
        if stride < 2:
            return self
        return Fitter(self.model, [s.every(stride) for s in self.segments], self.load_reference)

    def descend(
        self,
        hypothesis: Hypothesis,
        state: ParameterState,
        most: int,
        enough: float = _SMALL_GAIN,
        held: npt.NDArray[np.int64] | None = None,
    ) -> Fit:
        """Damped Gauss-Newton from `state`, at most `most` steps, ended when one lowers the cost by less than a share
        `enough`. held: indices of the nominal's unknowns that stay fixed."""
        held = np.zeros(0, dtype=np.int64) if held is None else held
        minimum = descend(_Descent(self, hypothesis, enough, held), _Point(state, self.shown(state, hypothesis)), most)
        return Fit(hypothesis, minimum.state, minimum.residuals)

    def stepped(self, state: ParameterState, hypothesis: Hypothesis, step: Array) -> ParameterState:
        """The state after adding `step` to all unknowns, widths and parameters kept within their ranges."""
        model, curves = state.model, self.nominal_curves
        b, both = curves.width.size, curves.size
        width = model.width + curves.width.value(step[:b], model.q) + step[both] * self._details[0]
        width = allowed_width(model.q, width)
        c_deg = model.c_deg + curves.follow.value(step[b:both], model.q) + step[both + 1] * self._details[1]
        static = {name: value + float(step[both + 2 + i]) for i, (name, value) in enumerate(state.static.items())}
        at = len(self._prior)
        values = dict(state.values)
        for i, slot in enumerate(hypothesis.slots, at):
            value = inside(slot.parameter, values[slot.key] + float(step[i]))
            values[slot.key] = float(np.clip(value, *self._reached)) if slot.parameter.reached else value
        model = replace(model, width=width, c_deg=c_deg, delay_s=model.delay_s + float(step[at - 1]))
        return ParameterState(model, static, values)


@dataclass(frozen=True)
class _Point:
    """Differentiated where a step is taken from it, and not where it was only tried or is the last."""

    state: ParameterState
    shown: list[_Shown]

    @property
    def residuals(self) -> list[Array]:
        return [each.residual for each in self.shown]


class _Descent:
    """A hypothesis as a least-squares problem: Huber's cost, its limit taken anew of each recording before every step;
    an effect's parameter stays at the end of its range where a step would lead beyond it."""

    def __init__(self, fitter: Fitter, hypothesis: Hypothesis, enough: float, held: npt.NDArray[np.int64]) -> None:
        """enough: share of the cost; a step that lowers it by less ends the descent. held: indices of unknowns that
        stay."""
        self.fitter, self.hypothesis, self.least, self.held = fitter, hypothesis, enough, held
        self.prior = fitter.floor**2 * fitter.prior_precision(hypothesis)
        self.curve_precision = fitter.floor**2 * fitter.curve_precision(hypothesis)
        self.limits: list[float] = []

    def linearised(self, point: _Point) -> tuple[Array, Array, float]:
        """Normal matrix, gradient (the direction that lowers the cost) and cost at a point."""
        fitter, hypothesis = self.fitter, self.hypothesis
        rows = fitter.rows_of(point.state, point.shown)
        self.limits = [outlier_limit(row.residual) for row in rows]
        matrix, gradient = self.prior.copy(), np.zeros(len(self.prior))
        columns = fitter.effect_columns(point.state, hypothesis, rows)
        for row, extra, limit in zip(rows, columns, self.limits, strict=True):
            weight = np.minimum(1.0, limit / np.maximum(np.abs(row.residual), 1e-12))
            part = fitter.normal(row, extra, weight)
            matrix += part.matrix
            gradient += part.gradient
        values = self._values(point.state)
        gradient[len(gradient) - len(values) :] -= self.curve_precision @ values
        held = np.concatenate([self.held, self._at_bounds(point.state, gradient)])
        matrix[held, :] = matrix[:, held] = gradient[held] = 0.0
        matrix[held, held] = 1.0
        return matrix, gradient, self.cost(point)

    def _at_bounds(self, state: ParameterState, gradient: Array) -> npt.NDArray[np.int64]:
        """Indices of the slots whose value is at an end of its range with the gradient pointing beyond it."""
        ends = []
        for i, slot in enumerate(self.hypothesis.slots, len(gradient) - len(self.hypothesis.slots)):
            value = state.values[slot.key]
            onward = value + float(np.sign(gradient[i])) * 1e-6 * self.fitter.scale(slot.parameter)
            if inside(slot.parameter, onward) == value:
                ends.append(i)
        return np.array(ends, dtype=np.int64)

    def moved(self, point: _Point, step: Array) -> _Point:
        state = self.fitter.stepped(point.state, self.hypothesis, step)
        return _Point(state, self.fitter.shown(state, self.hypothesis))

    def cost(self, point: _Point) -> float:
        """Huber's cost by the limits of the last linearisation, and the prior of effects that are curves; the other
        priors hold back a step alone."""
        values = self._values(point.state)
        return _huber_cost(point.residuals, self.limits) + float(values @ self.curve_precision @ values)

    def _values(self, state: ParameterState) -> Array:
        """(slots,) The effects' fitted parameters in the order of the hypothesis' slots."""
        return np.array([state.values[slot.key] for slot in self.hypothesis.slots])

    def enough(self, gained: float, cost: float) -> bool:
        """Whether a step that lowered `cost` by `gained` was the last."""
        return gained < self.least * cost


def _smoothed(curves: Nominal, model: Model) -> Model:
    """The model as one play, without the details of B and f_remain that the corrections' splines cannot follow."""
    width = model.width - spline_residual(curves.width, model.q, model.width)
    c_deg = model.c_deg - spline_residual(curves.follow, model.q, model.c_deg)
    return replace(model, width=allowed_width(model.q, width), c_deg=c_deg, elements=SINGLE, friction=None)


def spline_residual(basis: Basis, grid: Array, values: Array) -> Array:
    """A curve's values on a grid less the least-squares spline of this basis; 0 outside of the basis' range."""
    reached = (grid >= basis.low) & (grid <= basis.high)
    design = basis.design(grid).toarray()
    coefficients = np.linalg.lstsq(design[reached], values[reached], rcond=None)[0]
    left: Array = np.where(reached, values - design @ coefficients, 0.0)
    return left


def moves_tip(parameter: Parameter) -> bool:
    """Whether the tip's path depends on it, and not only what is seen of it."""
    return parameter.name not in effects.PROJECTION


def inside(parameter: Parameter, value: float) -> float:
    """The value clipped to the parameter's range."""
    return min(max(value, parameter.low), parameter.high)


def _best_fit(fits: Sequence[Fit]) -> Fit:
    """The fit of the lowest Huber cost; one with non-finite residuals (marker behind the camera) only if all are."""
    fits = [fit for fit in fits if fit.finite] or fits
    limits = [min(map(outlier_limit, each)) for each in zip(*(fit.residuals for fit in fits), strict=True)]
    return min(fits, key=lambda fit: _huber_cost(fit.residuals, limits))


def _huber_cost(residuals: Sequence[Array], limits: Sequence[float]) -> float:
    """Huber's cost, twice: r^2 up to each recording's limit, linear beyond. With a limit of its own a recording that
    fits badly throughout is not an outlier beside those that fit."""
    total = 0.0
    for residual, limit in zip(residuals, limits, strict=True):
        size = np.abs(residual)
        total += float(np.sum(np.where(size < limit, size**2, 2 * limit * size - limit**2)))
    return total


def outlier_limit(residual: Array) -> float:
    """The residual magnitude beyond which one recording's observations count linearly: several robust deviations, but
    at least 1.2 times what a share _RARE of the residuals exceeds, so that a misfit after every reversal still counts
    in full. 1 where there are none."""
    if residual.size == 0:
        return 1.0
    return max(_OUTLIER * spread.deviation(residual), 1.2 * float(np.quantile(np.abs(residual), 1.0 - _RARE)))
