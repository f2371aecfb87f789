"""Whether an effect is one law: whether its amplitude is the same at all places, speeds, times, sides and loads.

An effect that only imitates a cause can follow it closely, but with another amplitude elsewhere. So what each effect of
a fit adds to the prediction is multiplied by a few functions of these; with the nominal model and all effects free
beside them, their factors say by how much the amplitude is another there, as a share of what all effects add together:
what a large one leaves because it is not exact is a large share of a small one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter, ScoredRows
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.hypotheses import Wander
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_ORDERS = {"place": 3, "speed": 2, "time": 2, "side": 1, "load": 1}  # prior: of polynomials over each
_MOVES = 0.05  # tolerance: of a fast motor's speed: a slower one rests, and counts as what it did before
_FAST, _ENDS = 0.95, (0.1, 0.9)  # tolerance: quantiles: of its speeds; between which an amplitude is told
_SAME = 1e-6  # tolerance: variance of an axis over an effect's own signal, or of a power of it: so little tells nothing


def of_fit(fitter: Fitter, fit: Fit, rows: Sequence[ScoredRows], limits: Sequence[float]) -> tuple[Wander, ...]:
    """For each effect of a fit that adds anything: the normal equations of how its amplitude varies over place, speed,
    time, side and load, everything else free. rows: of the fit (Fitter.linearised). limits: of each recording, to which
    residuals are cut."""
    slots = fit.hypothesis.slots
    if not slots:
        return ()
    places = axes_values([_course(*each) for each in zip(fitter.segments, rows, strict=True)])
    stiff = fitter.floor**2 * fitter.prior_precision(fit.hypothesis)
    signals = []
    for kind in fit.hypothesis.kinds:
        names = {parameter.name for parameter in kind.amplitudes}
        sizes = np.array([fit.state.values[s.key] if s.parameter.name in names else 0.0 for s in slots])
        signals.append([row.columns[:, :, -len(slots) :] @ sizes for row in rows])
    together = _power([np.sum(each, axis=0) for each in zip(*signals, strict=True)])
    found = []
    for kind, signal in zip(fit.hypothesis.kinds, signals, strict=True):
        # A curve over the place may be any.
        axes = {axis: at for axis, at in places.items() if not (kind.curve and axis == "place")}
        functions, told = varying_columns(axes, signal, together)
        if not told:
            continue
        wider = [
            replace(row, columns=np.concatenate([row.columns, own], axis=2))
            for row, own in zip(rows, functions, strict=True)
        ]
        parts = [
            fitter.normal(row, weight=np.minimum(1.0, limit / np.maximum(np.abs(row.residual), 1e-12)))
            for row, limit in zip(wider, limits, strict=True)
        ]
        matrix, gradient = (np.sum([getattr(part, of) for part in parts], axis=0) for of in ("matrix", "gradient"))
        matrix[: len(stiff), : len(stiff)] += stiff
        own, pull, step = _reduced_normal(matrix, gradient, len(stiff))
        left = [
            np.clip(row.residual - fitter.moved(row, step), -limit, limit)
            for row, limit in zip(wider, limits, strict=True)
        ]
        noise = max(_power_per_independent(left), fitter.floor**2)
        found.append(Wander(kind.id, own / noise, pull / noise, told))
    return tuple(found)


@dataclass(frozen=True)
class Course:
    """Where the tip of one recording was. All (n,)."""

    p: Array  # the play's centre coordinate
    t_s: Array  # rising
    session_s: Array
    load_mNm: Array
    told: npt.NDArray[np.bool_]  # what counts


def _course(segment: Segment, row: ScoredRows) -> Course:
    """The course of one recording; its load is 0 where none was recorded."""
    motor, at = segment.motor, segment.arrival_s
    load = np.zeros_like(at) if motor.load_mNm is None else np.interp(at, motor.t_s, motor.load_mNm)
    return Course(row.path.p, at, at + segment.offset_s, load, segment.scored)


def axes_values(courses: Sequence[Course]) -> dict[str, list[Array]]:
    """What an amplitude may vary with, by axis and recording (told,), scaled to -1 .. 1; of the speed the logarithm.
    At rest the speed and side of the motion before count."""
    speeds = [np.gradient(course.p, course.t_s) for course in courses]
    fast = max(float(np.quantile(np.abs(np.concatenate(speeds)), _FAST)), 1e-300)
    found: dict[str, list[Array]] = {name: [] for name in _ORDERS}
    for course, speed in zip(courses, speeds, strict=True):
        moving = np.abs(speed) > _MOVES * fast
        last = np.maximum.accumulate(np.where(moving, np.arange(len(speed)), 0))[course.told]
        found["place"].append(course.p[course.told])
        found["speed"].append(np.log(np.maximum(np.abs(speed[last]), _MOVES * fast)))
        found["time"].append(course.session_s[course.told])
        found["side"].append(np.sign(speed[last]))
        found["load"].append(course.load_mNm[course.told])
    return {name: _scaled_to_unit(values) for name, values in found.items()}


def _scaled_to_unit(values: Sequence[Array]) -> list[Array]:
    """The same values scaled linearly so that all recordings together span -1 to 1."""
    every = np.concatenate(values)
    low, high = float(every.min()), float(every.max())
    return [2.0 * (v - low) / max(high - low, 1e-300) - 1.0 for v in values]


def _power(signals: Sequence[Array]) -> float:
    """Sum of squares over all recordings."""
    return sum(float(np.sum(signal**2)) for signal in signals)


def varying_columns(
    places: dict[str, list[Array]], signals: Sequence[Array], together: float
) -> tuple[list[Array], dict[str, Array]]:
    """The columns by which an amplitude varies, (n, k, m) for each recording: the effect's signal (n, k) times
    polynomials of each axis, orthonormal over the signal's power among themselves and to a constant, times the root of
    the power `together` of all effects over its own: a factor's square is a variance of the amplitude along its axis,
    as a share of what all effects add, be the signal in a small part of the range alone. And for each axis (2, m) their
    values at its low and its high end."""
    power = [np.sum(signal**2, axis=1) for signal in signals]
    total = sum(float(np.sum(of)) for of in power)
    if total <= 0.0:
        return [], {}
    columns: list[list[Array]] = []
    ends: list[tuple[str, Array]] = []
    weight = np.concatenate(power) / total
    cuts = np.cumsum([len(of) for of in power])[:-1]
    scale = np.sqrt(together / total)
    for name, values_of in places.items():
        at = np.concatenate(values_of)
        ranked = np.argsort(at)
        last = ranked[np.searchsorted(np.cumsum(weight[ranked]), np.array(_ENDS))]
        middle = float(weight @ at)
        spread = float(np.sqrt(weight @ (at - middle) ** 2))
        before = [np.ones_like(at)]
        for degree in range(1, _ORDERS[name] + 1) if spread**2 > _SAME else ():
            function = ((at - middle) / spread) ** degree
            for own in (*before, *before):  # twice: as exact as what a small part of the range leaves of it
                function = function - float(weight @ (own * function)) * own
            variance = float(weight @ function**2)
            if variance > _SAME:
                before.append(function / np.sqrt(variance))
                columns.append(np.split(scale * before[-1], cuts))
                ends.append((name, scale * before[-1][last]))
    if not columns:
        return [], {}
    told = {axis: np.column_stack([by * (of == axis) for of, by in ends]) for axis in dict(ends)}
    functions = [
        signal[:, :, None] * np.column_stack(each)[:, None, :]
        for signal, each in zip(signals, zip(*columns, strict=True), strict=True)
    ]
    return functions, told


def _reduced_normal(matrix: Array, gradient: Array, first: int) -> tuple[Array, Array, Array]:
    """Normal matrix and gradient of the unknowns from index `first` on with all others eliminated (Schur complement),
    and the least-squares step of all unknowns."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    scaled, pull = matrix * np.outer(scale, scale), scale * gradient
    follows = np.linalg.pinv(scaled[:first, :first], rcond=1e-10, hermitian=True) @ scaled[:first, first:]
    own = scaled[first:, first:] - follows.T @ scaled[:first, first:]
    own_pull = pull[first:] - follows.T @ pull[:first]
    step = scale * np.linalg.lstsq(scaled, pull, rcond=1e-10)[0]
    of = scale[first:]
    return own / np.outer(of, of), own_pull / of, step


def _power_per_independent(left: Sequence[Array]) -> float:
    """Mean square of the residuals `left` (n, k) of each recording times the number of samples that count as one
    independent one, by the autocorrelations up to the first that is not positive."""
    summed: Array = np.zeros(max(len(values) for values in left))
    for values in left:
        for column in values.T:
            summed[: len(column)] += _autocorrelation(column)
    ends = np.flatnonzero(summed <= 0.0)
    until = int(ends[0]) if len(ends) else len(summed)
    count = sum(values.size for values in left)
    return float(2.0 * np.sum(summed[:until]) - summed[0]) / count


def _autocorrelation(values: Array) -> Array:
    """(n,) Sums of products of values (n,) with those so many samples later."""
    spectrum = np.abs(np.fft.rfft(values, 2 * len(values))) ** 2
    return np.fft.irfft(spectrum)[: len(values)]
