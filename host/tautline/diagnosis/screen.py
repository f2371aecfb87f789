"""Every effect's linear score on top of a fit: how much of the residual it would take that the nominal model cannot.

Everything is done in normal equations: with N of the nominal and X, G of the effect's columns, what the nominal cannot
absorb of them is G - X'N^-1 X. Shapes are scanned: an encoder's period by the error's derivative along the play, the
time of a shift or a slip by sums over time, the others by simulating a small amplitude.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, cho_factor, cho_solve

from tautline.diagnosis.fit import STATIC_COLUMNS, Fitter, ScoredRows, inside, moves_tip
from tautline.diagnosis.fitted import Fit, Hypothesis, ParameterState, Scope, key
from tautline.effects import SIMULATOR, Kind, Parameter
from tautline.nominal import Normal

Array = npt.NDArray[np.float64]

_SHIFT_STEP_S = 0.5  # tolerance: within which a moment is found first; then to a frame
_PERIODS_PER_RANGE = 0.4  # tolerance: step of 1 / encoder_period times the motor's range: phases stay together over it
_FREE = 1e-3  # tolerance: share of a column's norm that the nominal must leave of it
_BEFORE_S = 1e-3
_WITHIN_S = 2.0  # what happens does so within a recording: between two it is another registration or offset
_OTHERS = 1  # further starts of an effect's shapes
_RANK = 1e-6  # of the free columns' normal matrix, scaled to ones


@dataclass(frozen=True)
class Screened:
    gain: float  # share of the sum of squares that the effect would take
    kind: Kind
    scope: Scope
    values: dict[str, float]  # to start from
    others: tuple[dict[str, float], ...] = ()  # the next best ones with other shapes
    more: tuple[Screened, ...] = ()  # of what happens at a moment: twice, and more often


def screen(
    fitter: Fitter, base: Fit, kinds: Iterable[Kind], limits: Sequence[float], scopes: Sequence[Scope] = tuple(Scope)
) -> list[Screened]:
    """Effects by their linear score on top of `base`, the largest first, in each of these scopes. limits: of each
    recording, to which residuals are cut. Effects that the nominal model absorbs are left out."""
    scan = _Scan(fitter.coarse, base, limits, scopes)
    fine: _Scan | None = None  # of all observations
    screened: list[Screened] = []
    kinds = list(kinds)
    for kind in kinds:
        scan.ask(kind)
    for kind in kinds:
        if base.hypothesis.find(kind.id) is None:
            if kind.scan == "moment":
                if rough := scan.moments(kind):
                    fine = fine or _Scan(fitter, base, limits, scopes)
                    found = fine.moments(kind, [rough[-1].values[name] for name in rough[-1].kind.moments])
                    screened += [replace(once, more=tuple(found[1:])) for once in found[:1]]
                continue
            starts = sorted(scan.scores(kind), key=lambda entry: -entry.gain)
            for scope in (Scope.TESTS, Scope.EACH, Scope.START):
                best = [entry for entry in starts if entry.scope == scope][: 1 + _OTHERS]
                if best:
                    screened.append(replace(best[0], others=tuple(entry.values for entry in best[1:])))
    return sorted(screened, key=lambda entry: -entry.gain)


class _Scan:
    def __init__(self, fitter: Fitter, base: Fit, limits: Sequence[float], scopes: Sequence[Scope]) -> None:
        """Prepares the normal equations of `base` with its residuals cut to `limits`."""
        self.fitter, self.base, self.scopes = fitter, base, scopes
        plain = fitter.rows(base.state, base.hypothesis)
        known = fitter.effect_columns(base.state, base.hypothesis, plain)
        self.here = [row.residual for row in plain]
        self.rows = [
            replace(
                row,
                residual=np.clip(row.residual, -limit, limit),
                columns=np.concatenate([row.columns, columns], axis=2),
            )
            for row, columns, limit in zip(plain, known, limits, strict=True)
        ]
        self.known = [fitter.normal(row) for row in self.rows]
        matrix = fitter.floor**2 * fitter.prior_precision(base.hypothesis) + sum(n.matrix for n in self.known)
        self.factor = cho_factor(matrix)
        self.gradient = np.asarray(sum(n.gradient for n in self.known))
        self.absorbed = cho_solve(self.factor, self.gradient)
        self.squares = sum(float(np.sum(row.residual**2)) for row in self.rows) - float(self.gradient @ self.absorbed)

    def scores(self, kind: Kind) -> list[Screened]:
        """Linear scores of one effect, for every combination of starting shapes, sign and scope."""
        if kind.scan == "period":
            return self._encoder_scores(kind)
        signs = (1.0, -1.0) if any(p.one_way for p in kind.amplitudes) else (1.0,)
        return [
            entry
            for shapes, sign in itertools.product(_starting_shapes(self.fitter, self.base, kind), signs)
            for entry in self._score(kind, shapes, self._columns(kind, shapes, sign), sign)
        ]

    def _columns(self, kind: Kind, shapes: Mapping[str, float], sign: float) -> list[Array]:
        """d prediction / d amplitude for each recording, (scored, k, amplitudes), as if the effect were in all
        recordings."""
        fitter, base = self.fitter, self.base
        hypothesis = base.hypothesis.plus(kind, Scope.START)
        per_segment = [np.empty((*here.shape, len(kind.amplitudes))) for here in self.here]
        for i, parameter in enumerate(kind.amplitudes):
            state, step = self._with_small_amplitude(kind, parameter, shapes, sign)
            for segment, row, here, columns in zip(fitter.segments, self.rows, self.here, per_segment, strict=True):
                columns[:, :, i] = fitter.change_of_prediction(segment, state, hypothesis, parameter, row, here) / step
        return per_segment

    def _with_small_amplitude(
        self, kind: Kind, parameter: Parameter, shapes: Mapping[str, float], sign: float
    ) -> tuple[ParameterState, float]:
        """The base's parameters with one amplitude set to a small step, and that step."""
        step = sign * parameter.probe * self.fitter.scale(parameter)
        others = {p.name: 0.0 for p in kind.amplitudes}
        values = {**self.base.state.values, **shapes, **others, parameter.name: step}
        return replace(self.base.state, values=values), step

    def ask(self, kind: Kind) -> None:
        """Announces to a simulator the runs that this effect's columns need."""
        if kind.stage == SIMULATOR:
            hypothesis = self.base.hypothesis.plus(kind, Scope.START)
            for parameter in kind.amplitudes:
                state, _ = self._with_small_amplitude(kind, parameter, {}, 1.0)
                for segment in self.fitter.segments:
                    segment.ask(state.at(segment, hypothesis))

    def _score(self, kind: Kind, shapes: Mapping[str, float], columns: Sequence[Array], sign: float) -> list[Screened]:
        """Linear scores of an effect with given shapes, one for each scope: columns (scored, k, amplitudes) for each
        recording. Where an amplitude ends at 0 or has a sign that it cannot have, the gain is 0."""
        parts = [
            self.fitter.normal(row, extra, known=known)
            for row, extra, known in zip(self.rows, columns, self.known, strict=True)
        ]
        scored = []
        tests, count = len(parts) - 1, len(kind.amplitudes)
        prior = self.fitter.floor**2 * self.fitter.curve_precision(Hypothesis((kind,), (Scope.START,)))
        for scope in self.scopes:
            if (scope == Scope.START and (kind.nominal or not self.fitter.from_start)) or (
                scope == Scope.EACH and not (kind.each and tests > 1)
            ):
                continue
            summed = parts if scope == Scope.START else parts[1:]
            if scope == Scope.EACH:
                summed = [self._normal_of_own_amplitudes(part, i, tests, count) for i, part in enumerate(parts[1:])]
            own = block_diag(*[prior] * (tests if scope == Scope.EACH else 1)) if kind.curve else 0.0
            amplitude, gain = self.gain(summed, own)
            if amplitude is None:
                continue
            start = dict(shapes)
            for i, a in enumerate(amplitude):
                parameter = kind.amplitudes[i % count]
                reach = 10.0 * self.fitter.scale(parameter)
                value = inside(parameter, float(np.clip(a, -reach, reach)))
                unfelt = a == 0.0 and bool(np.any(amplitude))  # as of an axis that never moved: the others count
                if not unfelt and (value == 0.0 or (parameter.one_way and value * sign < 0.0)):
                    gain, value = 0.0, 0.2 * sign * self.fitter.scale(parameter)  # the other way than it can be
                start[key(parameter.name, 1 + i // count) if scope == Scope.EACH else parameter.name] = value
            scored.append(Screened(gain, kind, scope, start))
        return scored

    def _normal_of_own_amplitudes(self, part: Normal, which: int, of: int, count: int) -> Normal:
        """A test's normal equations where every test has amplitudes of its own. which: the test's index, of: number of
        tests, count: amplitudes of each."""
        cut = len(self.gradient)
        size = cut + of * count
        at = np.concatenate([np.arange(cut), cut + which * count + np.arange(count)])
        normal = Normal(np.zeros((size, size)), np.zeros(size))
        normal.matrix[np.ix_(at, at)] = part.matrix
        normal.gradient[at] = part.gradient
        return normal

    def gain(self, parts: Sequence[Normal], prior: Array | float = 0.0) -> tuple[Array | None, float]:
        """Best amplitudes and the share of the residual's sum of squares that they explain, once the nominal model has
        absorbed what it can. parts: normal equations of the recordings with the effect; prior: precision matrix of the
        amplitudes. (None, 0) where the nominal absorbs the effect."""
        cut = len(self.gradient)
        cross = np.asarray(sum(part.matrix[cut:, :cut] for part in parts))
        own = np.asarray(sum(part.matrix[cut:, cut:] for part in parts))
        force = np.asarray(sum(part.gradient[cut:] for part in parts)) - cross @ self.absorbed
        free = own - cross @ cho_solve(self.factor, cross.T)
        size = np.diag(own)
        if not (np.diag(free) > _FREE**2 * np.maximum(size, 1e-300)).any():
            return None, 0.0
        free, size = free + prior, size + np.diag(np.zeros_like(own) + prior)
        scale = 1.0 / np.sqrt(np.maximum(size, 1e-12 * size.max()))
        value, vector = np.linalg.eigh(free * np.outer(scale, scale))
        inverse = np.where(value > _RANK, 1.0 / np.maximum(value, _RANK), 0.0)
        amplitude = scale * (vector @ (inverse * (vector.T @ (scale * force))))
        return amplitude, float(amplitude @ force) / self.squares

    # ---- shapes that are scanned densely

    def _encoder_scores(self, kind: Kind) -> list[Screened]:
        """Scores of a periodic encoder error, over a grid of periods. An error d of the motor's position moves the tip
        by d(q) / (1 + side B'/2), q the motor position at which the tip was last carried."""
        fitter, model = self.fitter, self.base.state.model
        slope_f, slope_b = (np.gradient(values, model.q) for values in (model.c_deg, model.width))
        low, high = (shape * fitter.model.rig.actuator.span for shape in kind.shapes[0].shape)
        reach = max(float(np.ptp(s.motor.q)) for s in fitter.segments)
        carried, by_q = [], []
        for row, segment in zip(self.rows, fitter.segments, strict=True):
            side = row.path.side[segment.scored].astype(float)
            carried.append(row.p + 0.5 * side * np.interp(row.p, model.q, model.width))
            steep = np.maximum(1.0 + 0.5 * side * np.interp(row.p, model.q, slope_b), 0.1)
            by_q.append((row.by_follow * np.interp(row.tip, model.q, slope_f) / steep)[:, None] * row.by_c)
        rates = np.arange(reach / high, reach / low, _PERIODS_PER_RANGE) / reach
        per_segment = []
        for rate in rates:
            columns = []
            for q, slope in zip(carried, by_q, strict=True):
                angle = 2 * np.pi * rate * q
                waves = [np.sin(angle), np.cos(angle), np.sin(2 * angle), np.cos(2 * angle)]
                columns.append(slope[:, :, None] * np.stack(waves, axis=1)[:, None, :])
            per_segment += self._score(kind, {"encoder_period": 1.0 / rate}, columns, 1.0)
        return per_segment

    def moments(self, kind: Kind, near: Sequence[float] = ()) -> list[Screened]:
        """Scores of an event at moments: once, then once more at a time beside those before. near: rough moments, scene
        time, beside which every frame is tried; else a grid of _SHIFT_STEP_S."""
        delay = self.base.state.model.delay_s + self.base.state.values.get("delay", 0.0)
        edges, windows = self._candidate_times([at + delay for at in near])
        if not len(edges):  # of recordings of a few seconds
            return []
        later = _Later(self, self._columns_if_always(kind), edges)
        chosen: list[int] = []
        found: list[Screened] = []
        for form, window in zip((kind.happening(n + 1) for n in range(len(kind.moments))), windows, strict=False):
            tried = [(i, *self.gain([later.of([*chosen, i])])) for i in window if i not in chosen]
            at, amplitude, gain = max(tried, key=lambda one: one[2], default=(0, None, 0.0))
            if amplitude is None:
                break
            chosen.append(at)
            values = {p.name: float(a) for p, a in zip(form.amplitudes, amplitude, strict=True)}
            # The scene is older than its arrival; a little before the first frame that shows it.
            times = {n: float(edges[i]) - delay - _BEFORE_S for n, i in zip(form.moments, chosen, strict=True)}
            found.append(Screened(gain, form, Scope.START, {**values, **times}))
        return found

    def _candidate_times(self, near: Sequence[float]) -> tuple[Array, Iterable[Sequence[int]]]:
        """Arrival times from which an event may hold, and for each of its moments the indices of those to try. near:
        rough arrival times; without, a grid over the session."""
        times = [t for s in self.fitter.segments if len(t := (s.arrival_s + s.offset_s)[s.scored])]
        ends = [t[[0, -1]] for t in times]
        if not near:
            edges = np.arange(min(t[0] for t in ends), max(t[1] for t in ends), _SHIFT_STEP_S)
        else:
            close = [np.any([np.abs(t - at) <= 1.5 * _SHIFT_STEP_S for at in near], axis=0) for t in times]
            edges = np.unique(np.concatenate([t[here] for t, here in zip(times, close, strict=True)]))
        edges = np.array([e for e in edges if any(a + _WITHIN_S <= e <= b - _WITHIN_S for a, b in ends)])
        if not near:
            return edges, itertools.repeat(range(len(edges)))
        return edges, [np.flatnonzero(np.abs(edges - at) <= 1.5 * _SHIFT_STEP_S).tolist() for at in near]

    def _columns_if_always(self, kind: Kind) -> list[Array]:
        """The event's columns (scored, k, amplitudes) for each recording, as if it had happened before the first
        frame."""
        once = kind.happening(1)
        if not any(moves_tip(p) for p in once.amplitudes):
            return [row.columns[:, :, STATIC_COLUMNS] for row in self.rows]
        return self._columns(once, dict.fromkeys(once.moments, -np.inf), 1.0)


class _Later:
    """Normal equations of columns (n, k, m) from each of several times on, edges (e,)."""

    def __init__(self, scan: _Scan, columns: Sequence[Array], edges: Array) -> None:
        """Sums the normal equations of `columns` from the last edge back to the first. edges: rising arrival times."""
        self.cut, self.each = len(scan.gradient), columns[0].shape[2]
        nothing, total = Normal.zeros(self.cut), Normal.zeros(self.cut + self.each)
        self._own: list[Array] = []  # the last edge first: the columns' rows of the matrix, and their gradient
        times = [(s.arrival_s + s.offset_s)[s.scored] for s in scan.fitter.segments]
        for begin, end in reversed(list(zip(edges, [*edges[1:], np.inf], strict=True))):
            for t, row, column in zip(times, scan.rows, columns, strict=True):
                a, b = np.searchsorted(t, [begin, end])
                if a < b:
                    piece = _slice_of_rows(row, slice(int(a), int(b)))
                    part = scan.fitter.normal(piece, column[a:b], known=nothing)
                    total.matrix[...] += part.matrix
                    total.gradient[...] += part.gradient
            self._own.append(np.column_stack([total.matrix[self.cut :], total.gradient[self.cut :]]))
        self._own.reverse()

    def of(self, which: Sequence[int]) -> Normal:
        """Normal equations with the event's columns from each of these edges on as separate unknowns: two of them share
        the frames after the later one."""
        cut, m = self.cut, self.each
        normal = Normal.zeros(cut + len(which) * m)
        for i, at in enumerate(which):
            here = slice(cut + i * m, cut + (i + 1) * m)
            normal.matrix[here, :cut], normal.gradient[here] = self._own[at][:, :cut], self._own[at][:, -1]
            for j, other in enumerate(which):
                both = self._own[max(at, other)][:, cut : cut + m]
                normal.matrix[here, cut + j * m : cut + (j + 1) * m] = both
        return normal


def _slice_of_rows(row: ScoredRows, part: slice) -> ScoredRows:
    """The rows of a contiguous part of the scored observations."""
    return replace(
        row,
        **{
            name: getattr(row, name)[part]
            for name in ("p", "tip", "by_width", "by_follow", "by_c", "columns", "residual")
        },
    )


def _starting_shapes(fitter: Fitter, base: Fit, kind: Kind) -> list[dict[str, float]]:
    """All combinations of starting values of the effect's shape parameters, in their units."""

    def values(parameter: Parameter) -> list[float]:
        """Starting values of one shape parameter: quantiles of the reached angles, or the effect's own list."""
        if parameter.reached:
            c = np.concatenate([s.follow(base.state.model, {}, 0.0).c_deg for s in fitter.segments])
            return [float(v) for v in np.quantile(c, [0.1, 0.25, 0.5, 0.75, 0.9])]
        unit = fitter.model.rig.actuator.span if parameter.unit == "unit" else 1.0
        return [v * unit for v in parameter.shape]

    choices = [[(parameter.name, value) for value in values(parameter)] for parameter in kind.shapes]
    return [dict(choice) for choice in itertools.product(*choices)]
