"""Whether an effect is one law: whether its amplitude is constant over place, speed, time, side and load (the axes).

An effect that only imitates a cause can follow it closely, but with an amplitude that varies. So what each effect of a
fit adds to the prediction (its signal) is multiplied by a few polynomials of each axis, and the factors of these
products are estimated with the nominal model and all effects free beside them. A factor is a share of what all effects
add together, as what a large effect leaves because it is not exact is a large share of a small one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter, ScoredRows
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.heldout import RANK, scaled_solution
from tautline.diagnosis.huber import huber_weight
from tautline.diagnosis.hypotheses import Wander
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_ORDERS = {"place": 3, "speed": 2, "time": 2, "side": 1, "load": 1}  # prior: orders of the polynomials of each axis
_MOVES = 0.05  # tolerance: share of a fast motor's speed: a slower one rests, and keeps the speed and side of before
_FAST = 0.95  # tolerance: quantile of the speeds that is fast
_ENDS = (0.1, 0.9)  # format: quantiles of an axis, by the signal's power, that are its low and its high end
_SAME = 1e-6  # tolerance: variance of an axis, or of a polynomial of it, below which it is constant


def of_fit(fitter: Fitter, fit: Fit, rows: Sequence[ScoredRows], limits: Sequence[float]) -> tuple[Wander, ...]:
    """For each effect of a fit the normal equations of its factors, with all unknowns of the fit free beside them.
    Effects that add nothing, or whose axes do not vary, are left out. rows: of the fit (Fitter.linearised). limits: of
    each recording, px or deg, to which residuals are cut."""
    if not fit.hypothesis.slots:
        return ()
    axes = axes_values([_course(segment, row) for segment, row in zip(fitter.segments, rows, strict=True)])
    signals = _signals(fit, rows)
    power_of_all = _power([np.sum(of_recording, axis=0) for of_recording in zip(*signals, strict=True)])
    found = []
    for kind, signal in zip(fit.hypothesis.kinds, signals, strict=True):
        # A curve over the place is free to vary with it.
        varying_axes = {axis: values for axis, values in axes.items() if not (kind.curve and axis == "place")}
        columns, ends = varying_columns(varying_axes, signal, power_of_all)
        if ends:
            matrix, gradient = _factors_normal(fitter, fit, rows, columns, limits)
            found.append(Wander(kind.id, matrix, gradient, ends))
    return tuple(found)


def _signals(fit: Fit, rows: Sequence[ScoredRows]) -> list[list[Array]]:
    """For each effect of the fit and each recording its signal (scored, k), px or deg: what the effect adds to the
    prediction, to first order, as the columns of its amplitudes times the amplitudes."""
    slots = fit.hypothesis.slots
    signals = []
    for kind in fit.hypothesis.kinds:
        names = {parameter.name for parameter in kind.amplitudes}
        amplitudes = np.array([fit.state.values[s.key] if s.parameter.name in names else 0.0 for s in slots])
        signals.append([row.columns[:, :, -len(slots) :] @ amplitudes for row in rows])
    return signals


def _factors_normal(
    fitter: Fitter, fit: Fit, rows: Sequence[ScoredRows], columns: Sequence[Array], limits: Sequence[float]
) -> tuple[Array, Array]:
    """(Normal matrix (m, m), gradient (m,)) of the factors of `columns`, (scored, k, m) of each recording, after all
    unknowns of the fit are eliminated. Both are divided by the noise's power: the mean square of the residuals after
    all of these are fitted, times the number of successive residuals that count as one, at least floor^2."""
    precision = fitter.floor**2 * fitter.prior_precision(fit.hypothesis)
    extended = [
        replace(row, columns=np.concatenate([row.columns, further], axis=2))
        for row, further in zip(rows, columns, strict=True)
    ]
    parts = [
        fitter.normal(row, weight=huber_weight(row.residual, limit) / times**2)
        for row, limit, times in zip(extended, limits, fitter.relative_noise, strict=True)
    ]
    matrix = np.sum([part.matrix for part in parts], axis=0)
    gradient = np.sum([part.gradient for part in parts], axis=0)
    matrix[: len(precision), : len(precision)] += precision
    of_factors, gradient_of_factors, step = _reduced_normal(matrix, gradient, len(precision))
    residuals = [
        np.clip(row.residual - fitter.moved(row, step), -limit, limit) / times
        for row, limit, times in zip(extended, limits, fitter.relative_noise, strict=True)
    ]
    noise = max(_power_per_independent(residuals), fitter.floor**2)
    return of_factors / noise, gradient_of_factors / noise


@dataclass(frozen=True)
class Course:
    """The values that the axes are made of, at the n observations of a recording. All are (n,)."""

    p: Array  # the play's centre coordinate, unit of q
    t_s: Array  # rising
    session_s: Array  # the same times on the session's clock
    load_mNm: Array
    scored: npt.NDArray[np.bool_]  # which observations count


def _course(segment: Segment, row: ScoredRows) -> Course:
    """The course of one recording; the load is 0 where none was recorded."""
    motor, t = segment.motor, segment.arrival_s
    load = np.zeros_like(t) if motor.load_mNm is None else np.interp(t, motor.t_s, motor.load_mNm)
    return Course(row.path.p, t, t + segment.offset_s, load, segment.scored)


def axes_values(courses: Sequence[Course]) -> dict[str, list[Array]]:
    """{axis: (scored,) values of each recording}, scaled linearly so that they span -1 .. 1. place: p; speed: its log;
    time: of the session; side: direction of motion; load. At rest speed and side are those of the last motion."""
    speeds = [np.gradient(course.p, course.t_s) for course in courses]
    fast = max(float(np.quantile(np.abs(np.concatenate(speeds)), _FAST)), 1e-300)
    found: dict[str, list[Array]] = {name: [] for name in _ORDERS}
    for course, speed in zip(courses, speeds, strict=True):
        moving = np.abs(speed) > _MOVES * fast
        last_moving = np.maximum.accumulate(np.where(moving, np.arange(len(speed)), 0))[course.scored]
        found["place"].append(course.p[course.scored])
        found["speed"].append(np.log(np.maximum(np.abs(speed[last_moving]), _MOVES * fast)))
        found["time"].append(course.session_s[course.scored])
        found["side"].append(np.sign(speed[last_moving]))
        found["load"].append(course.load_mNm[course.scored])
    return {name: _scaled_to_unit(values) for name, values in found.items()}


def _scaled_to_unit(values: Sequence[Array]) -> list[Array]:
    """The values of each recording, scaled linearly so that all recordings together span -1 to 1; all -1 where they do
    not vary."""
    all_values = np.concatenate(values)
    low, high = float(all_values.min()), float(all_values.max())
    return [2.0 * (v - low) / max(high - low, 1e-300) - 1.0 for v in values]


def _power(signals: Sequence[Array]) -> float:
    """Sum of squares of all numbers, of all recordings."""
    return sum(float(np.sum(signal**2)) for signal in signals)


def varying_columns(
    axes: dict[str, list[Array]], signal: Sequence[Array], power_of_all: float
) -> tuple[list[Array], dict[str, Array]]:
    """(Columns (n, k, m) of each recording, {axis: (2, m) value of each column's function at the low and the high end
    of the axis}; 0 for functions of other axes). A column is the signal (n, k) of an effect times a function: a
    polynomial of an axis, times sqrt(power_of_all / the signal's sum of squares). The polynomials of an axis are
    orthonormal among themselves and to a constant, weighted by the signal's power. So a factor's square is a variance
    of the amplitude along that axis, as a share of what all effects add, even if the signal is confined to a part of
    the range. axes: values (n,) of each axis and recording; power_of_all: sum of squares of what all effects add. ([],
    {}) where nothing varies."""
    power = [np.sum(values**2, axis=1) for values in signal]
    total = sum(float(np.sum(of_recording)) for of_recording in power)
    if total <= 0.0:
        return [], {}
    weight = np.concatenate(power) / total
    scale = np.sqrt(power_of_all / total)
    cuts = np.cumsum([len(of_recording) for of_recording in power])[:-1]
    functions: list[list[Array]] = []  # of each column and recording (n,)
    at_ends: list[tuple[str, Array]] = []  # of each column its axis and its values at the ends
    for axis, values_of in axes.items():
        values = np.concatenate(values_of)
        # The observations at the weighted quantiles _ENDS of the axis.
        ranked = np.argsort(values)
        ends = ranked[np.searchsorted(np.cumsum(weight[ranked]), np.array(_ENDS))]
        for polynomial in _orthonormal_polynomials(values, weight, _ORDERS[axis]):
            functions.append(np.split(scale * polynomial, cuts))
            at_ends.append((axis, scale * polynomial[ends]))
    if not functions:
        return [], {}
    ends_of = {axis: np.column_stack([value * (of == axis) for of, value in at_ends]) for axis in dict(at_ends)}
    columns = [
        values[:, :, None] * np.column_stack(of_recording)[:, None, :]
        for values, of_recording in zip(signal, zip(*functions, strict=True), strict=True)
    ]
    return columns, ends_of


def _orthonormal_polynomials(values: Array, weight: Array, order: int) -> list[Array]:
    """Polynomials of the values (n,), of the degrees 1 to `order`, each (n,), by Gram and Schmidt. They are orthonormal
    among themselves and to a constant under the weights (n,), whose sum is 1. Those that hardly vary are left out."""
    mean = float(weight @ values)
    deviation = float(np.sqrt(weight @ (values - mean) ** 2))
    if not deviation**2 > _SAME:
        return []
    basis = [np.ones_like(values)]
    for degree in range(1, order + 1):
        polynomial = ((values - mean) / deviation) ** degree
        for lower in (*basis, *basis):  # twice, for rounding
            polynomial = polynomial - float(weight @ (lower * polynomial)) * lower
        variance = float(weight @ polynomial**2)
        if variance > _SAME:
            basis.append(polynomial / np.sqrt(variance))
    return basis[1:]


def _reduced_normal(matrix: Array, gradient: Array, first: int) -> tuple[Array, Array, Array]:
    """(Normal matrix, gradient) of the unknowns from index `first` on after all others are eliminated, by the Schur
    complement C - X'A^-1 X; and the least-squares step of all unknowns. Unknowns are scaled first, as their units
    differ; the pseudo-inverse drops directions that are not determined."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled, scaled_gradient = matrix * np.outer(scale, scale), scale * gradient
    cross = scaled[:first, first:]
    follows = np.linalg.pinv(scaled[:first, :first], rcond=RANK, hermitian=True) @ cross
    reduced = scaled[first:, first:] - follows.T @ cross
    reduced_gradient = scaled_gradient[first:] - follows.T @ scaled_gradient[:first]
    step = scale * scaled_solution(matrix, scaled_gradient, scale)
    own_scale = scale[first:]
    return reduced / np.outer(own_scale, own_scale), reduced_gradient / own_scale, step


def _power_per_independent(residuals: Sequence[Array]) -> float:
    """Mean square of the residuals, (n, k) of each recording, times the number of successive ones that count as one: 1
    + 2 sum(rho), with rho the autocorrelation up to the first lag at which it is not positive; px^2 or deg^2."""
    summed: Array = np.zeros(max(len(values) for values in residuals))
    for values in residuals:
        for column in values.T:
            summed[: len(column)] += _autocovariance_sums(column)
    not_positive = np.flatnonzero(summed <= 0.0)
    lags = int(not_positive[0]) if len(not_positive) else len(summed)
    count = sum(values.size for values in residuals)
    return float(2.0 * np.sum(summed[:lags]) - summed[0]) / count


def _autocovariance_sums(values: Array) -> Array:
    """(n,) For each lag l = 0 .. n - 1 the sum over i of values[i] values[i + l], by FFT with zero padding."""
    spectrum = np.abs(np.fft.rfft(values, 2 * len(values))) ** 2
    return np.fft.irfft(spectrum)[: len(values)]
