"""Robust least squares of one hypothesis (no effect, one or several) to all recordings, the nominal model free as well.

The nominal model's unknowns, shared by all recordings, in the order of the vector (`Unknowns`): coefficients of cubic
B-splines that are added to B and to f_remain; two factors on the details of B and f_remain that these splines cannot
follow; with a camera the static registration (turn about x y z in deg, move in mm); the sensor's delay. After them come
the effects' parameters (`Hypothesis.slots`). The nominal's Jacobian is analytic along the play (nominal.py), that of
the effects a difference quotient of the simulation. Arrays of a recording are (scored, k): k = 2 px or k = 1 deg.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from tautline import effects
from tautline.diagnosis.fitted import STATIC_NAMES, Fit, Hypothesis, ParameterState, Scope
from tautline.diagnosis.gap import relative_noise
from tautline.diagnosis.huber import huber_cost, huber_weight, outlier_limit
from tautline.diagnosis.segment import Segment
from tautline.effects import Parameter, Path
from tautline.elements import SINGLE
from tautline.geometry import across
from tautline.least_squares import descend
from tautline.model import Model, allowed_width
from tautline.nominal import Nominal, Normal, Rows, by_width
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

# Pieces of the splines over the motor's range that are added to B and to f_remain.
WIDTH_PIECES = len(effects.BY_ID["transmission.backlash"].curve) - 3  # equation: a cubic has 3 coefficients more
_FOLLOW_PIECES = 22  # prior: as fine as the law itself is measured again
_ROUGH = 0.001  # prior: standard deviation of second differences of a spline of _FOLLOW_PIECES, as a share of its range
STATIC_COLUMNS = slice(2, 8)  # format: the registration's six among ScoredRows.columns, with a camera
MOVE_COLUMNS = slice(5, 8)  # format: the last three of them: px per mm along x, y and z
WIDTH, REMAINING, STATIC, DELAY = PARTS = (
    "transmission.backlash",
    "configuration.remaining",
    "registration.static",
    "acquisition.delay",
)  # ids of the nominal model's parts, which a recalibration moves
_AHEAD_S = 5e-3  # tolerance: s over which the tip's velocity is taken as a difference
_DIFFERENCE = 0.05  # tolerance: share of a parameter's scale: the step of its difference quotient
_AT_BOUND = 1e-6  # tolerance: share of a parameter's scale: a value nearer to the end of its range is at it
_SMALL_GAIN, _COARSE_GAIN = 1e-4, 5e-4  # tolerance: share of the cost: a step that gains less is the last
_COARSE_FRAMES = 2500  # tolerance: observations that a fit begins with
_ROUGH_STEPS, _COARSE_STEPS, _FULL_STEPS = 3, 12, 8  # tolerance: of each start, of the best one, with all observations
_NOMINAL_STEPS = 16  # tolerance: of a fit without effects
_WIDTH_PRIOR, _ANGLE_PRIOR = 0.03, 0.1  # prior: standard deviations of a step of B, f_remain, shares of their range
_DETAIL_PRIOR = 1.0  # prior: standard deviation of a step of the factors on the details
_TURN_PRIOR_DEG, _MOVE_PRIOR_MM = 3.0, 2.0  # prior: standard deviations of a step of the registration
_DELAY_PRIOR_S = 0.02  # prior: standard deviation of a step of the delay
_FAR, _CURVES_FAR = 30.0, 2.0  # prior: standard deviations of an effect's parameter and of a curve's, in their scales
_KNOWN = 1e-6  # prior: factor on the nominal's standard deviations where a simulator is the nominal: it does not move
_INSET = 0.05  # prior: share of the reached angles, at either end, in which no effect begins
_RANK = 1e-12  # tolerance: relative diagonal entry, singular value, below which a direction of unknowns is not told


@dataclass(frozen=True)
class ScoredRows(Rows):
    """One recording linearised at its scored observations. Its `columns` are derivatives by the unknowns other than the
    two splines: the factors on the details, with a camera the registration, the delay, and any effects' parameters."""

    path: Path  # at all observations
    model: Model  # with the tables that the path was simulated with

    def change_by_tables(self, model: Model) -> Array:
        """(scored, k) The change of the prediction, to first order, if the tables were the B and f_remain of `model`,
        which has the same grid of q."""
        width = np.interp(self.p, model.q, model.width - self.model.width)
        follow = np.interp(self.tip, model.q, model.c_deg - self.model.c_deg)
        return self.moved(width, follow)


@dataclass(frozen=True)
class _Simulated:
    """One recording simulated at all of its n observations, with derivatives of what the sensor shows."""

    parameters: Mapping[str, Any]  # of the effects, by name
    path: Path
    model: Model  # with the tables that the path was simulated with
    seen: Array  # (n, k)
    by_c: Array  # (n, k) per deg of the bending angle
    by_static: Array  # (n, k, 6) per deg and mm of the static registration; (n, k, 0) without a camera
    residual: Array  # (scored, k) observed less seen


@dataclass(frozen=True)
class Unknowns:
    """The positions of the unknowns in the vector of all of them, in the order of this module's docstring."""

    width: slice  # coefficients of the spline that is added to B, unit of q
    follow: slice  # coefficients of the spline that is added to f_remain, deg
    width_details: int  # the factor on the details of B
    follow_details: int  # the factor on the details of f_remain
    static: slice  # the registration, in the order of STATIC_NAMES; empty without a camera
    delay: int  # s
    effects: int  # index of the effects' first parameter; they are in the order of `Hypothesis.slots`

    @classmethod
    def of(cls, curves: Nominal, static: int) -> Unknowns:
        """The positions for these two splines and `static` numbers of the registration (6, or 0 without a camera)."""
        details, delay = curves.size, curves.size + 2 + static
        width, follow = slice(curves.width.size), slice(curves.width.size, details)
        return cls(width, follow, details, details + 1, slice(details + 2, delay), delay, delay + 1)


class Fitter:
    """Fits hypotheses to the same recordings, from the same calibrated model. `floor` is one standard deviation of the
    noise of a coordinate, px or deg; the caller sets it, with `doubt` and `unsteady`, after making a Fitter."""

    def __init__(
        self, model: Model, segments: Sequence[Segment], load_reference: float = 0.0, *, smooth: bool = False
    ) -> None:
        """model: as calibrated. segments: the recordings. load_reference: mNm at which the model's tables hold. smooth:
        start from the model with a single play, and with B and f_remain reduced to splines, without their finer
        details."""
        self.segments, self.load_reference = list(segments), load_reference
        self.px = segments[0].unit == "px"
        self.delayed = segments[0].sensor == model.sensor  # the model has a delay of its own for what is observed
        low = min(float(s.motor.q.min()) for s in segments)
        high = max(float(s.motor.q.max()) for s in segments)
        self.nominal_curves = curves = Nominal(Basis(low, high, WIDTH_PIECES), Basis(low, high, _FOLLOW_PIECES))
        if smooth:
            model = _without_details(curves, model)
        self.model = model
        span = model.rig.actuator.span
        gain = abs(model.rig.coarse.gain)
        # Priors keep what the motion does not excite where calibration left it. Standard deviations: of coefficients of
        # B, unit of q, and of f_remain, deg, and of the factors on their details.
        prior = [
            np.full(curves.width.size, _WIDTH_PRIOR * span),
            np.full(curves.follow.size, _ANGLE_PRIOR * gain * span),
            np.full(2, _DETAIL_PRIOR),
        ]
        # The details that the splines cannot follow: an effect from the start left its ripple in them.
        self._details = tuple(
            spline_residual(basis, model.q, values)
            for basis, values in ((curves.width, model.width), (curves.follow, model.c_deg))
        )
        if self.px:
            prior += [np.full(3, _TURN_PRIOR_DEG), np.full(3, _MOVE_PRIOR_MM)]
        self._prior = np.concatenate([*prior, np.full(1, _DELAY_PRIOR_S)])
        self.unknowns = Unknowns.of(curves, len(STATIC_NAMES) if self.px else 0)
        # Whether effects may have been there while calibrating: a simulator has none of the library's.
        self.effects_from_start = all(s.drive is None for s in segments)
        if not self.effects_from_start:
            self._prior *= _KNOWN
        self._bending = block_diag(
            curves.width.bending / (_ROUGH * span) ** 2, curves.follow.bending / (_ROUGH * gain * span) ** 2
        )
        self._linearised: tuple[Fit, list[ScoredRows]] | None = None
        self.floor = 1.0
        self.relative_noise = [1.0] * len(segments)  # of each recording, times `floor`: its own noise
        self.doubt = 0.0  # standard deviation of log(floor^2), where videos showed one
        self.unsteady = 0.0  # standard deviation between blocks of the logarithm of the noise's power
        # What begins outside of the angles that were reached would be another gain and offset.
        ends = np.sort(model.remaining(np.array([low, high])))
        inset = _INSET * float(ends[1] - ends[0])
        self._reached = (float(ends[0]) + inset, float(ends[1]) - inset)  # deg

    def on_recordings(self, segments: Sequence[Segment]) -> Fitter:
        """A fitter of other recordings, with the same unknowns and priors. The motor must stay within the range of
        these recordings; all are taken to be as noisy as the tests. Cached results are not taken along."""
        other = copy(self)
        other.segments, other.relative_noise, other._linearised = list(segments), [1.0] * len(segments), None
        other.__dict__.pop("_coarse", None)
        return other

    @property
    def no_effect(self) -> Hypothesis:
        """The hypothesis without any effect, for as many tests as there are recordings after the first."""
        return Hypothesis(tests=len(self.segments) - 1)

    def nominal(self, free: Collection[str] = PARTS) -> Fit:
        """The recalibrated nominal model: a fit without effects in which only those of PARTS that are in `free`
        move."""
        held = self._columns_of(set(PARTS) - set(free))
        minimum = self.descend(self.no_effect, self.start(), _NOMINAL_STEPS, held=held)
        # Where an effect as large as an obstacle is left out, one descent may stall.
        return self.descend(self.no_effect, minimum.state, _NOMINAL_STEPS, held=held)

    def recalibrated(self) -> Fit:
        """The recalibrated nominal model with all of PARTS free. Sets `relative_noise` by what it leaves; where that
        differs between recordings the model is fitted again, so that a noisy recording weighs less."""
        fit = self.nominal()
        self.relative_noise = relative_noise(self.segments, self.across(fit))
        return fit if len(set(self.relative_noise)) == 1 else self.nominal()

    def _columns_of(self, parts: Collection[str]) -> npt.NDArray[np.int64]:
        """Indices, in the vector of unknowns, of the nominal model's unknowns that belong to `parts` (ids among
        PARTS)."""
        order, all_indices = self.unknowns, range(self.unknowns.effects)
        indices = {
            WIDTH: [*all_indices[order.width], order.width_details],
            REMAINING: [*all_indices[order.follow], order.follow_details],
            STATIC: [*all_indices[order.static]],
            DELAY: [order.delay],
        }
        return np.array([i for part in parts for i in indices[part]], dtype=np.int64)

    def scale(self, parameter: Parameter) -> float:
        """A change of the parameter that a user would notice, in its own unit (`Parameter.scale`, times the motor's
        range where the parameter is in the unit of q)."""
        return parameter.scale * parameter.share(self.model.rig.actuator.span)

    def clipped(self, parameter: Parameter, value: float) -> float:
        """The value of a parameter, in its own unit, clipped to its range (`Parameter.inside`)."""
        return parameter.inside(value, self.model.rig.actuator.span)

    def start(self) -> ParameterState:
        """The state from which fits start: the calibrated model without effects, and with a camera a zero change of its
        registration."""
        return ParameterState(self.model, dict.fromkeys(STATIC_NAMES, 0.0) if self.px else {})

    def residuals(self, state: ParameterState, hypothesis: Hypothesis) -> list[Array]:
        """Observed less predicted, (scored, k) for each recording, at a point of the parameter space."""
        per_segment = []
        for segment in self.segments:
            _, predicted = segment.predict(state.model, state.at(segment, hypothesis), self.load_reference)
            per_segment.append((segment.observed - predicted)[segment.scored])
        return per_segment

    def across(self, fit: Fit) -> list[Array] | None:
        """(scored, 1) px for each recording: the component of a fit's residual across the image direction d image / dc,
        in which a tip that moves along its path leaves nothing. None without a camera."""
        if not self.px:
            return None
        simulated = self.simulated(fit.state, fit.hypothesis)
        return [
            across(of_segment.residual, of_segment.by_c[segment.scored])[:, None]
            for segment, of_segment in zip(self.segments, simulated, strict=True)
        ]

    def rows(self, state: ParameterState, hypothesis: Hypothesis) -> list[ScoredRows]:
        """For each recording the residual and its derivatives by the nominal model's unknowns, at the scored
        observations."""
        return self.rows_of(state, self.simulated(state, hypothesis))

    def simulated(self, state: ParameterState, hypothesis: Hypothesis) -> list[_Simulated]:
        """Each recording simulated at a point of the parameter space. A user's simulator is told of all runs beforehand
        (`Segment.ask`), so that it can run them at once."""
        parameters_of = [state.at(segment, hypothesis) for segment in self.segments]
        for segment, parameters in zip(self.segments, parameters_of, strict=True):
            segment.ask(parameters)
        return [
            self._simulated_segment(segment, state.model, parameters)
            for segment, parameters in zip(self.segments, parameters_of, strict=True)
        ]

    def _simulated_segment(self, segment: Segment, model: Model, parameters: Mapping[str, Any]) -> _Simulated:
        """One recording simulated with these parameters. Without a camera the sensor shows the angle itself: by_c is 1,
        and by_static has no columns."""
        path = segment.follow(model, parameters, self.load_reference)
        model = effects.tabled(model, parameters)
        if self.px:
            seen, by_c, by_static = effects.image_with_slopes(model, path, parameters, segment.offset_s)
        else:
            seen = path.c_deg[:, None]
            by_c, by_static = np.ones_like(seen), np.empty((*seen.shape, 0))
        residual = (segment.observed - seen)[segment.scored]
        return _Simulated(parameters, path, model, seen, by_c, by_static, residual)

    def rows_of(self, state: ParameterState, simulated: Sequence[_Simulated]) -> list[ScoredRows]:
        """As `rows`, from recordings that are `simulated` at `state` already."""
        slope_b = np.gradient(state.model.width, state.model.q)
        slope_f = np.gradient(state.model.c_deg, state.model.q)
        return [
            self._rows_of_segment(segment, state.model, of_segment, slope_b, slope_f)
            for segment, of_segment in zip(self.segments, simulated, strict=True)
        ]

    def _rows_of_segment(
        self, segment: Segment, nominal: Model, simulated: _Simulated, slope_b: Array, slope_f: Array
    ) -> ScoredRows:
        """As `rows`, for one recording. The angle changes by dc = gain f'(tip) dp/dB dB + gain df for changes dB of B
        and df of f_remain, and the image by dc times `by_c`. slope_b, slope_f: dB/dq and df_remain/dq of `nominal` on
        its grid; where effects have changed the tables, the slopes of the changed ones are used instead."""
        path, model, scored, by_c = simulated.path, simulated.model, segment.scored, simulated.by_c
        if model is not nominal:
            slope_b, slope_f = np.gradient(model.width, model.q), np.gradient(model.c_deg, model.q)
        p, tip, gain = path.p[scored], path.tip[scored], path.gain[scored]
        c_by_b = gain * np.interp(tip, model.q, slope_f) * by_width(path.lean[scored], np.interp(p, model.q, slope_b))
        details = np.column_stack(
            [c_by_b * np.interp(p, model.q, self._details[0]), gain * np.interp(tip, model.q, self._details[1])]
        )
        by_delay = self._by_delay(segment, nominal, simulated)
        columns = np.concatenate(
            [by_c[scored][:, :, None] * details[:, None, :], simulated.by_static[scored], by_delay[scored][:, :, None]],
            axis=2,
        )
        return ScoredRows(p, tip, c_by_b, gain, by_c[scored], columns, simulated.residual, path, model)

    def _by_delay(self, segment: Segment, nominal: Model, simulated: _Simulated) -> Array:
        """(n, k) d prediction / d delay, px or deg per s: minus the velocity of what the sensor shows, by a difference
        quotient over _AHEAD_S. Where other axes move it is the image's velocity; else that of the bending angle, times
        by_c. 0 where the model has no delay for this sensor."""
        path, by_c, parameters = simulated.path, simulated.by_c, simulated.parameters
        if not self.delayed:
            return np.zeros_like(by_c)
        less_delay = {**parameters, "delay": parameters.get("delay", 0.0) - _AHEAD_S}
        ahead = segment.follow(nominal, less_delay, self.load_reference)
        if self.px and (path.translation_mm is not None or path.rotation_deg is not None):  # these are delayed as well
            image = effects.image(simulated.model, ahead, parameters, segment.offset_s)
            return np.asarray((simulated.seen - image) / _AHEAD_S)
        return np.asarray(((path.c_deg - ahead.c_deg) / _AHEAD_S)[:, None] * by_c)

    def normal(
        self, rows: Rows, extra: Array | None = None, weight: Array | None = None, known: Normal | None = None
    ) -> Normal:
        """Normal matrix (m, m) and gradient (m,) of one recording. The unknowns are the two splines' coefficients,
        those of rows.columns, and last those of `extra`, further columns (scored, k, ...). weight (scored, k): of each
        squared residual, 1 by default. known: the result without `extra`, which is then copied and not computed
        again."""
        columns, first = rows.columns, rows.columns.shape[2]
        without_extra = self.nominal_curves.size + first
        if extra is not None:
            columns = np.concatenate([columns, extra], axis=2)
        total = Normal.zeros(without_extra - first + columns.shape[2])
        if known is not None:
            total.matrix[:without_extra, :without_extra] = known.matrix
            total.gradient[:without_extra] = known.gradient
        self.nominal_curves.add(rows, total, columns, weight, first=0 if known is None else first)
        return total

    def residuals_after_step(self, rows: Sequence[Rows]) -> list[Array]:
        """(scored, k) of each recording: the residual that is left after one linear least-squares step of all unknowns
        of the rows, common to all recordings and without any prior. It is what no combination of the columns can
        explain."""
        parts = [self.normal(row) for row in rows]
        matrix = np.asarray(sum(part.matrix for part in parts))
        # Columns are scaled to unit norm, as their units differ; what they do not determine is left at 0.
        scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), _RANK * float(np.diag(matrix).max())))
        inverse = np.linalg.pinv(matrix * np.outer(scale, scale), rcond=_RANK, hermitian=True)
        step = scale * (inverse @ (scale * np.asarray(sum(part.gradient for part in parts))))
        return [row.residual - self.moved(row, step) for row in rows]

    def moved(self, row: Rows, step: Array) -> Array:
        """(scored, k) The change of the prediction, to first order, by a step (m,) of the unknowns of `row`: first
        those of the two splines, then those of row.columns."""
        return self.nominal_curves.moved(row, step)

    def spread(self, hypothesis: Hypothesis) -> Array:
        """(m,) Prior standard deviations of all unknowns: the nominal model's, then the effects' parameters."""
        return np.concatenate([self._prior, [_FAR * self.scale(slot.parameter) for slot in hypothesis.slots]])

    def prior_precision(self, hypothesis: Hypothesis) -> Array:
        """(m, m) The inverse covariance of the unknowns' prior: 1 / spread^2 on the diagonal, a penalty on the second
        differences of the splines added to B and f_remain, so that they continue smoothly where the motion hardly
        reaches, and `curve_precision` for the effects' curves."""
        precision = np.diag(1 / self.spread(hypothesis) ** 2)
        splines, of_effects = slice(self.unknowns.follow.stop), slice(self.unknowns.effects, None)
        precision[splines, splines] += self._bending
        precision[of_effects, of_effects] += self.curve_precision(hypothesis)
        return precision

    def curve_precision(self, hypothesis: Hypothesis) -> Array:
        """(slots, slots) The additional prior precision of effects that are splines over the motor's range
        (`Kind.curve`): it keeps their coefficients small where no motion was (1 / (_CURVES_FAR scale)^2), and smooth. 0
        for other effects."""
        slots = hypothesis.slots
        precision = np.zeros((len(slots), len(slots)))
        for curve in {kind.curve for kind in hypothesis.kinds}:
            for number in {slot.number for slot in slots}:  # each recording that has a curve of its own
                index = {slot.parameter.name: i for i, slot in enumerate(slots) if slot.number == number}
                if of_curve := [index[name] for name in curve if name in index]:
                    coefficient = slots[of_curve[0]].parameter
                    precision[of_curve, of_curve] += 1 / (_CURVES_FAR * self.scale(coefficient)) ** 2
                    precision[np.ix_(of_curve, of_curve)] += self._bending_precision(coefficient, len(of_curve))
        return precision

    def _bending_precision(self, coefficient: Parameter, size: int) -> Array:
        """(size, size) Prior precision of the second differences of a curve of `size` cubic B-spline coefficients, so
        that it is as smooth as what is added to B and f_remain. coefficient: any of them, for its unit (that of q, or
        deg)."""
        actuator = self.model.rig.actuator
        # Second differences of the same curve are proportional to the square of the knots' distance.
        deviation = _ROUGH * actuator.span * (_FOLLOW_PIECES / (size - 3)) ** 2
        by_unit = 1.0 if coefficient.unit == "unit" else abs(self.model.rig.coarse.gain)
        return np.asarray(Basis(*actuator.range, size - 3).bending / (deviation * by_unit) ** 2)

    def effect_columns(self, state: ParameterState, hypothesis: Hypothesis, rows: Sequence[ScoredRows]) -> list[Array]:
        """(scored, k, slots) for each recording: derivatives of the prediction by the effects' parameters; 0 where a
        parameter is not one of that recording. Exact where an effect changes B or f_remain linearly, else a difference
        quotient with a step of _DIFFERENCE times the parameter's scale. rows: the recordings linearised at `state`."""
        slots = hypothesis.slots
        steps = [_DIFFERENCE * self.scale(slot.parameter) for slot in slots]
        stepped = [
            replace(state, values={**state.values, slot.key: state.values[slot.key] + step})
            for slot, step in zip(slots, steps, strict=True)
        ]
        for segment in (s for s in self.segments if s.drive is not None):
            for point in stepped:
                segment.ask(point.at(segment, hypothesis))
        columns = [np.zeros((*row.residual.shape, len(slots))) for row in rows]
        known = [
            _columns_by_tables(segment, state, hypothesis, row, of_segment)
            for segment, row, of_segment in zip(self.segments, rows, columns, strict=True)
        ]
        for i, slot in enumerate(slots):  # the recordings one after the other: they share the tables of a slot
            for segment, row, of_segment, by_tables in zip(self.segments, rows, columns, known, strict=True):
                if slot.holds_in(segment) and i not in by_tables:
                    change = self.change_of_prediction(
                        segment, stepped[i], hypothesis, slot.parameter, row, row.residual
                    )
                    of_segment[:, :, i] = change / steps[i]
        return columns

    def linearised(self, fit: Fit) -> list[ScoredRows]:
        """The rows of each recording at a fit, with the columns of the effects' parameters after the nominal model's.
        The result for the last fit is cached, as several tests of one fit ask for it."""
        if self._linearised is None or self._linearised[0] is not fit:
            of_nominal = self.rows(fit.state, fit.hypothesis)
            of_effects = self.effect_columns(fit.state, fit.hypothesis, of_nominal)
            rows = [
                replace(row, columns=np.concatenate([row.columns, columns], axis=2))
                for row, columns in zip(of_nominal, of_effects, strict=True)
            ]
            self._linearised = fit, rows
        return list(self._linearised[1])

    def change_of_prediction(
        self,
        segment: Segment,
        state: ParameterState,
        hypothesis: Hypothesis,
        parameter: Parameter,
        row: ScoredRows,
        residual: Array,
    ) -> Array:
        """(scored, k) By how much the prediction at `state` differs from that at the state of `row`, which left
        `residual` (scored, k); the two states must differ only in `parameter`. Computed in the cheapest valid way: to
        first order from the tables where the parameter changes these; from the bending angles where the paths differ
        only in them; else from what the sensor would show. 0 where the marker would be behind the camera."""
        values = state.at(segment, hypothesis)
        if parameter.name in effects.IN_TABLES:
            change = row.change_by_tables(effects.tabled(state.model, values))
        else:
            path = segment.follow(state.model, values, self.load_reference) if moves_tip(parameter) else row.path
            if path is not row.path and effects.bends_alone(row.path, path, values):
                change = row.by_c * (path.c_deg - row.path.c_deg)[segment.scored, None]
            else:
                change = residual - (segment.observed - segment.seen(state.model, values, path))[segment.scored]
        return np.where(np.isfinite(change), change, 0.0)

    def fit(
        self,
        hypothesis: Hypothesis,
        values: Mapping[str, float],
        start: ParameterState,
        others: Sequence[Mapping[str, float]] = (),
    ) -> Fit:
        """The best fit of a hypothesis from several starts, to all observations; arguments as for `begin`."""
        return self.finish(self.begin(hypothesis, values, start, others))

    def begin(
        self,
        hypothesis: Hypothesis,
        values: Mapping[str, float],
        start: ParameterState,
        others: Sequence[Mapping[str, float]] = (),
    ) -> Fit:
        """A first fit, to the observations of `coarse`; its residuals are of these too. values: start of the effects'
        parameters, by key; others: further starts of some of them. The nominal model starts from `start`. For a single
        effect it starts also from the calibrated model, as a recalibration has bent the model towards the effect, and,
        if that effect was there from the start, from the calibrated model with one play in place of several. The best
        fit is returned."""
        coarse, nominals = self.coarse, [start]
        if len(hypothesis.kinds) == 1:
            nominals.append(self.start())
            if hypothesis.scopes[0] == Scope.START and self.model.elements != SINGLE:
                nominals.append(replace(self.start(), model=replace(self.model, elements=SINGLE, friction=None)))
        fits = []
        for nominal in nominals:
            states = [replace(nominal, values={**values, **other}) for other in ({}, *others)]
            best = self._best_fit([coarse.descend(hypothesis, state, _ROUGH_STEPS) for state in states])
            fits.append(coarse.descend(hypothesis, best.state, _COARSE_STEPS, _COARSE_GAIN))
        return self._best_fit(fits)

    def finish(self, begun: Fit) -> Fit:
        """Continues a fit of `begin`, now with all observations."""
        return self.descend(begun.hypothesis, begun.state, _FULL_STEPS)

    def _best_fit(self, fits: Sequence[Fit]) -> Fit:
        """The fit with the lowest Huber cost; the limit of each recording is the smallest among the fits. Fits with
        non-finite residuals (marker behind the camera) count only if all are such."""
        fits = [fit for fit in fits if fit.finite] or fits
        of_segments = zip(*(fit.residuals for fit in fits), strict=True)
        limits = [min(map(outlier_limit, residuals)) for residuals in of_segments]
        return min(fits, key=lambda fit: huber_cost(fit.residuals, limits, self.relative_noise))

    @property
    def coarse(self) -> Fitter:
        """A fitter of about _COARSE_FRAMES of the observations, with this fitter's present noise."""
        self._coarse.floor, self._coarse.relative_noise = self.floor, self.relative_noise
        return self._coarse

    @cached_property
    def _coarse(self) -> Fitter:
        """The fitter that `coarse` returns, made once: of every n-th observation, or this fitter itself where it has
        fewer than 1.5 _COARSE_FRAMES."""
        stride = round(sum(int(s.scored.sum()) for s in self.segments) / _COARSE_FRAMES)
        if stride < 2:
            return self
        return Fitter(self.model, [s.coarse(stride, self.floor) for s in self.segments], self.load_reference)

    def descend(
        self,
        hypothesis: Hypothesis,
        state: ParameterState,
        most_steps: int,
        small_gain: float = _SMALL_GAIN,
        held: npt.NDArray[np.int64] | None = None,
    ) -> Fit:
        """Fits by damped Gauss-Newton from `state`: at most `most_steps` steps, ending with the first that lowers the
        cost by less than a share `small_gain`. held: indices of the nominal model's unknowns that stay fixed."""
        held = np.zeros(0, dtype=np.int64) if held is None else held
        problem = _Descent(self, hypothesis, small_gain, held)
        minimum = descend(problem, _Point(state, self.simulated(state, hypothesis)), most_steps)
        return Fit(hypothesis, minimum.state, minimum.residuals)

    def stepped(self, state: ParameterState, hypothesis: Hypothesis, step: Array) -> ParameterState:
        """The state after adding `step` (m,), in the order of `Unknowns`. B is kept an allowed width, each parameter of
        an effect within its range, and an angle at which an effect begins (`Parameter.reached`, deg) within the angles
        that the recordings reach."""
        model, curves, order = state.model, self.nominal_curves, self.unknowns
        of_width, of_follow = self._details
        width = model.width + curves.width.value(step[order.width], model.q) + step[order.width_details] * of_width
        width = allowed_width(model.q, width)
        c_deg = model.c_deg + curves.follow.value(step[order.follow], model.q) + step[order.follow_details] * of_follow
        moves = zip(state.static.items(), step[order.static], strict=True)
        static = {name: value + float(move) for (name, value), move in moves}
        values = dict(state.values)
        for slot, change in zip(hypothesis.slots, step[order.effects :], strict=True):
            value = self.clipped(slot.parameter, values[slot.key] + float(change))
            values[slot.key] = float(np.clip(value, *self._reached)) if slot.parameter.reached else value
        model = replace(model, width=width, c_deg=c_deg, delay_s=model.delay_s + float(step[order.delay]))
        return ParameterState(model, static, values)


@dataclass(frozen=True)
class _Point:
    """A point of the parameter space with its simulation."""

    state: ParameterState
    simulated: list[_Simulated]  # of each recording

    @property
    def residuals(self) -> list[Array]:
        """Observed less predicted at this point, (scored, k) of each recording."""
        return [of_segment.residual for of_segment in self.simulated]


class _Descent:
    """A hypothesis as a least-squares problem (least_squares.Problem) with Huber's cost. The limit of each recording is
    estimated anew before every step. A parameter of an effect is held fixed while it is at an end of its range and the
    gradient points beyond it."""

    def __init__(self, fitter: Fitter, hypothesis: Hypothesis, small_gain: float, held: npt.NDArray[np.int64]) -> None:
        """small_gain: share of the cost; a step that lowers it by less ends the descent. held: indices of unknowns, in
        the order of this module's docstring, that stay fixed."""
        self.fitter, self.hypothesis, self.small_gain, self.held = fitter, hypothesis, small_gain, held
        # Multiplied by the noise's power, as the cost is in px^2 or deg^2.
        self.prior_precision = fitter.floor**2 * fitter.prior_precision(hypothesis)
        self.curve_precision = fitter.floor**2 * fitter.curve_precision(hypothesis)
        self.limits: list[float] = []  # of each recording, px or deg, at the last linearisation

    def linearised(self, point: _Point) -> tuple[Array, Array, float]:
        """(Normal matrix (m, m), gradient (m,) as the direction that lowers the cost, cost) at a point, with Huber's
        weights and the priors. Sets `limits`. Unknowns that are held get the equation 1 * step = 0."""
        fitter, hypothesis = self.fitter, self.hypothesis
        rows = fitter.rows_of(point.state, point.simulated)
        self.limits = [outlier_limit(row.residual) for row in rows]
        matrix, gradient = self.prior_precision.copy(), np.zeros(len(self.prior_precision))
        columns = fitter.effect_columns(point.state, hypothesis, rows)
        for row, extra, limit, times in zip(rows, columns, self.limits, fitter.relative_noise, strict=True):
            part = fitter.normal(row, extra, huber_weight(row.residual, limit) / times**2)
            matrix += part.matrix
            gradient += part.gradient
        values = self._effect_values(point.state)
        gradient[fitter.unknowns.effects :] -= self.curve_precision @ values
        held = np.concatenate([self.held, self._at_bounds(point.state, gradient)])
        matrix[held, :] = matrix[:, held] = gradient[held] = 0.0
        matrix[held, held] = 1.0
        return matrix, gradient, self.cost(point)

    def _at_bounds(self, state: ParameterState, gradient: Array) -> npt.NDArray[np.int64]:
        """Indices, in the vector of unknowns, of the effects' parameters whose value is at an end of its range while
        the gradient points beyond it."""
        ends = []
        for i, slot in enumerate(self.hypothesis.slots, self.fitter.unknowns.effects):
            value = state.values[slot.key]
            onward = value + float(np.sign(gradient[i])) * _AT_BOUND * self.fitter.scale(slot.parameter)
            if self.fitter.clipped(slot.parameter, onward) == value:
                ends.append(i)
        return np.array(ends, dtype=np.int64)

    def moved(self, point: _Point, step: Array) -> _Point:
        """The point reached by a step (m,), simulated."""
        state = self.fitter.stepped(point.state, self.hypothesis, step)
        return _Point(state, self.fitter.simulated(state, self.hypothesis))

    def cost(self, point: _Point) -> float:
        """Huber's cost with the limits of the last linearisation, plus the prior of effects that are curves. The other
        priors only damp each step: they are centred on the point before the step, and no part of the cost."""
        values = self._effect_values(point.state)
        of_data = huber_cost(point.residuals, self.limits, self.fitter.relative_noise)
        return of_data + float(values @ self.curve_precision @ values)

    def _effect_values(self, state: ParameterState) -> Array:
        """(slots,) The effects' fitted parameters, in the order of the hypothesis' slots."""
        return np.array([state.values[slot.key] for slot in self.hypothesis.slots])

    def enough(self, gained: float, cost: float) -> bool:
        """Whether to stop after a step that lowered `cost` by `gained`."""
        return gained < self.small_gain * cost


def _columns_by_tables(
    segment: Segment, state: ParameterState, hypothesis: Hypothesis, row: ScoredRows, into: Array
) -> set[int]:
    """Writes into `into` (scored, k, slots) the derivatives by those parameters that change B or f_remain linearly, and
    returns the indices of these slots; the other slots are left unchanged. Each derivative is a product: prediction by
    bending angle (row.by_c), angle by curve (row.by_width or row.by_follow), curve by parameter. The last is taken at
    the play's centre row.p for B and at row.tip for f_remain. row: the recording linearised at `state`."""
    values, slots = state.at(segment, hypothesis), hypothesis.slots
    written: set[int] = set()
    for kind in hypothesis.kinds:
        names = {parameter.name for parameter in kind.amplitudes if kind.slopes}
        slots_of_kind = {
            i: slot for i, slot in enumerate(slots) if slot.parameter.name in names and slot.holds_in(segment)
        }
        if not (kind.slopes and slots_of_kind):
            continue
        of_width = kind.in_tables == "width"
        slopes = kind.slopes(state.model, values, row.p if of_width else row.tip)
        if slopes is None:
            continue
        by_curve = row.by_width if of_width else row.by_follow
        change = np.column_stack([slopes[slot.parameter.name] for slot in slots_of_kind.values()]) * by_curve[:, None]
        into[:, :, list(slots_of_kind)] = row.by_c[:, :, None] * change[:, None, :]
        written |= slots_of_kind.keys()
    return written


def _without_details(curves: Nominal, model: Model) -> Model:
    """The model with a single play, and within the bases' range with B and f_remain replaced by their least-squares
    splines of these bases."""
    width = model.width - spline_residual(curves.width, model.q, model.width)
    c_deg = model.c_deg - spline_residual(curves.follow, model.q, model.c_deg)
    return replace(model, width=allowed_width(model.q, width), c_deg=c_deg, elements=SINGLE, friction=None)


def spline_residual(basis: Basis, grid: Array, values: Array) -> Array:
    """(n,) What is left of a curve's values (n,), given on a grid (n,), after subtracting their least-squares spline of
    this basis; 0 outside the basis' range."""
    inside_range = (grid >= basis.low) & (grid <= basis.high)
    design = basis.design(grid).toarray()
    coefficients = np.linalg.lstsq(design[inside_range], values[inside_range], rcond=None)[0]
    residual: Array = np.where(inside_range, values - design @ coefficients, 0.0)
    return residual


def moves_tip(parameter: Parameter) -> bool:
    """Whether the parameter changes the tip's path, and not only how that path is seen."""
    return parameter.name not in effects.PROJECTION
