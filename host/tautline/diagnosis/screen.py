"""Every effect's linear score on top of a fit: the share of the residual's sum of squares that it would explain and the
nominal model cannot.

All in normal equations: with N those of the fit's unknowns, G those of the effect's columns and X the products of both,
what the fit's unknowns cannot absorb of the effect is the Schur complement G - X'N^-1 X. Shapes are scanned over grids:
an encoder's period by the error's derivative along the play, the moment of a shift or a slip by sums over time, the
others by simulating a small amplitude. Columns are d prediction / d amplitude, (scored, k, amplitudes) of a recording.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag, cho_factor, cho_solve

from tautline.diagnosis.fit import STATIC_COLUMNS, Fitter, ScoredRows, moves_tip
from tautline.diagnosis.fitted import Fit, Hypothesis, ParameterState, Scope, key
from tautline.effects import SIMULATOR, Kind, Parameter
from tautline.nominal import Normal

Array = npt.NDArray[np.float64]

_SHIFT_STEP_S = 0.5  # tolerance: s: grid over which a moment is found first; then to a frame
_NEAR_STEPS = 1.5  # tolerance: steps of that grid about a rough moment in which every frame is tried
_PERIODS_PER_RANGE = 0.4  # tolerance: step of (motor's range / encoder_period): phases stay together over the range
_FREE = 1e-3  # tolerance: share of a column's norm that the fit's unknowns must leave of it
_BEFORE_S = 1e-3  # tolerance: s by which a moment comes before the first frame that shows it
_WITHIN_S = 2.0  # tolerance: s from a recording's ends; what comes nearer or between two, `refine_moments` reaches
_OTHERS = 1  # tolerance: further starts of an effect's shapes
_RANK = 1e-6  # tolerance: eigenvalue of the scaled normal matrix below which a direction is dropped
_FARTHEST = 10.0  # tolerance: scales of a parameter to which a start is clipped
_OTHER_WAY = 0.2  # tolerance: scales of a parameter from which it starts where its linear step has an impossible sign
_ANGLES = (0.1, 0.25, 0.5, 0.75, 0.9)  # tolerance: quantiles of the reached angles from which an angle starts
_STEEPEST = 0.1  # limit: least dq/dp that an encoder's error is divided by


@dataclass(frozen=True)
class Screened:
    """The linear score of an effect in one scope, and values from which to start a full fit of it."""

    gain: float  # share of the residual's sum of squares that the effect would explain
    kind: Kind
    scope: Scope  # since when it is there
    values: dict[str, float]  # to start from, by Slot.key
    others: tuple[dict[str, float], ...] = ()  # further starts: the next best ones with other shapes
    more: tuple[Screened, ...] = ()  # of what happens at moments: the same twice, three times, ...


def screen(
    fitter: Fitter, base: Fit, kinds: Iterable[Kind], limits: Sequence[float], scopes: Sequence[Scope] = tuple(Scope)
) -> list[Screened]:
    """Scores effects by one linear step on top of the fit `base`, in each of these scopes; the largest score first.
    Effects that `base` has already, or that its unknowns absorb, are left out. The coarse observations
    (`Fitter.coarse`) are used, except that a moment is then searched to a frame among all. limits: of each recording,
    px or deg, to which residuals are cut."""
    scan = _Scan(fitter.coarse, base, limits, scopes)
    fine: _Scan | None = None  # of all observations
    screened: list[Screened] = []
    kinds = list(kinds)
    for kind in kinds:
        scan.ask(kind)
    for kind in kinds:
        if base.hypothesis.find(kind.id) is not None:
            continue
        if kind.scan != "moment":
            screened += _best_of_each_scope(scan.scores(kind))
        elif rough := scan.moments(kind):
            fine = fine or _Scan(fitter, base, limits, scopes)
            found = fine.moments(kind, [rough[-1].values[name] for name in rough[-1].kind.moments])
            screened += [replace(once, more=tuple(found[1:])) for once in found[:1]]
    return sorted(screened, key=lambda entry: -entry.gain)


def _best_of_each_scope(entries: Iterable[Screened]) -> list[Screened]:
    """From the entries of one effect the one with the largest score in each scope; the next _OTHERS best of that scope
    become its further starts (`others`)."""
    ranked = sorted(entries, key=lambda entry: -entry.gain)
    found = []
    for scope in (Scope.TESTS, Scope.EACH, Scope.START):
        best = [entry for entry in ranked if entry.scope == scope][: 1 + _OTHERS]
        if best:
            found.append(replace(best[0], others=tuple(entry.values for entry in best[1:])))
    return found


class _Scan:
    """The normal equations of a fit, on top of which the columns of effects are scored."""

    def __init__(self, fitter: Fitter, base: Fit, limits: Sequence[float], scopes: Sequence[Scope]) -> None:
        """Linearises the fit `base` for all recordings. limits: of each recording, px or deg, to which residuals are
        cut. scopes: since when an effect may be there."""
        self.fitter, self.base, self.scopes = fitter, base, scopes
        plain = fitter.rows(base.state, base.hypothesis)
        effect_columns = fitter.effect_columns(base.state, base.hypothesis, plain)
        self.residuals = [row.residual for row in plain]  # (scored, k) of each recording, not cut
        self.rows = [
            replace(
                row,
                residual=np.clip(row.residual, -limit, limit),
                columns=np.concatenate([row.columns, columns], axis=2),
            )
            for row, columns, limit in zip(plain, effect_columns, limits, strict=True)
        ]
        # Normal equations of each recording, without new columns.
        self.known = [fitter.normal(row) for row in self.rows]
        matrix = fitter.floor**2 * fitter.prior_precision(base.hypothesis) + sum(n.matrix for n in self.known)
        self.factor = cho_factor(matrix)
        self.gradient = np.asarray(sum(n.gradient for n in self.known))
        self.absorbed = cho_solve(self.factor, self.gradient)  # (m,) the step to the optimum without new columns
        # The residual's sum of squares after that step.
        self.squares = sum(float(np.sum(row.residual**2)) for row in self.rows) - float(self.gradient @ self.absorbed)

    def scores(self, kind: Kind) -> list[Screened]:
        """Linear scores of an effect that has no moments, one for every combination of its starting shapes, the sign of
        its amplitudes, and its scope."""
        if kind.scan == "period":
            return self._encoder_scores(kind)
        signs = (1.0, -1.0) if any(p.one_way for p in kind.amplitudes) else (1.0,)
        return [
            entry
            for shapes, sign in itertools.product(_starting_shapes(self.fitter, self.base, kind), signs)
            for entry in self._scores_by_scope(kind, shapes, self._amplitude_columns(kind, shapes, sign), sign)
        ]

    def _amplitude_columns(self, kind: Kind, shapes: Mapping[str, float], sign: float) -> list[Array]:
        """(scored, k, amplitudes) for each recording: d prediction / d amplitude with these shapes, as if the effect
        were there in all recordings, by simulating a small amplitude of this sign."""
        fitter, base = self.fitter, self.base
        hypothesis = base.hypothesis.plus(kind, Scope.START)
        per_segment = [np.empty((*residual.shape, len(kind.amplitudes))) for residual in self.residuals]
        for i, parameter in enumerate(kind.amplitudes):
            state, step = self._with_small_amplitude(kind, parameter, shapes, sign)
            recordings = zip(fitter.segments, self.rows, self.residuals, per_segment, strict=True)
            for segment, row, residual, columns in recordings:
                change = fitter.change_of_prediction(segment, state, hypothesis, parameter, row, residual)
                columns[:, :, i] = change / step
        return per_segment

    def _with_small_amplitude(
        self, kind: Kind, parameter: Parameter, shapes: Mapping[str, float], sign: float
    ) -> tuple[ParameterState, float]:
        """(The base's parameters with these shapes, the amplitude `parameter` of the effect at a small step of this
        sign and its other amplitudes at 0; that step, in the parameter's unit)."""
        step = sign * parameter.probe * self.fitter.scale(parameter)
        others = {p.name: 0.0 for p in kind.amplitudes}
        values = {**self.base.state.values, **shapes, **others, parameter.name: step}
        return replace(self.base.state, values=values), step

    def ask(self, kind: Kind) -> None:
        """Announces to a user's simulator the runs that `_amplitude_columns` will need, if the effect is one of the
        simulator's own parameters; does nothing for other effects."""
        if kind.stage == SIMULATOR:
            hypothesis = self.base.hypothesis.plus(kind, Scope.START)
            for parameter in kind.amplitudes:
                state, _ = self._with_small_amplitude(kind, parameter, {}, 1.0)
                for segment in self.fitter.segments:
                    segment.ask(state.at(segment, hypothesis))

    def _scores_by_scope(
        self, kind: Kind, shapes: Mapping[str, float], columns: Sequence[Array], sign: float
    ) -> list[Screened]:
        """Linear scores of an effect with these shapes: one entry for each scope in which it may be there and is not
        absorbed. columns: d prediction / d amplitude, (scored, k, amplitudes) of each recording, the calibration first;
        sign: that of the amplitudes with which these were simulated. The score is 0 where a linear step cannot be right
        for a one-way amplitude or leaves the range (`_start_value`)."""
        parts = [
            self.fitter.normal(row, extra, known=known)
            for row, extra, known in zip(self.rows, columns, self.known, strict=True)
        ]
        tests = len(parts) - 1
        scored = []
        for scope in self.scopes:
            if not self._may_be_since(kind, scope, tests):
                continue
            present = self._normals_where_present(scope, parts, len(kind.amplitudes))
            amplitudes, gain = self.gain(present, self._prior_precision(kind, tests if scope == Scope.EACH else 1))
            if amplitudes is None:
                continue
            start, possible = self._start_values(kind, scope, amplitudes, sign)
            scored.append(Screened(gain if possible else 0.0, kind, scope, {**shapes, **start}))
        return scored

    def _normals_where_present(self, scope: Scope, parts: Sequence[Normal], count: int) -> Sequence[Normal]:
        """The normal equations of those recordings in which an effect of this scope is there. START: of all; TESTS: of
        all after the calibration; EACH: the same, with `count` amplitudes of its own for each test. parts: normal
        equations of all recordings with the effect's columns, the calibration first."""
        if scope == Scope.START:
            return parts
        tests = parts[1:]
        if scope == Scope.TESTS:
            return tests
        return [self._normal_by_recording(part, i, len(tests), count) for i, part in enumerate(tests)]

    def _prior_precision(self, kind: Kind, times: int) -> Array | float:
        """(k, k) Prior precision of the amplitudes of an effect that is a curve; 0 for other effects. It is multiplied
        by the noise power, as the normal equations are not divided by it. times: number of recordings that have
        amplitudes of their own, one block of the matrix each."""
        if not kind.curve:
            return 0.0
        precision = self.fitter.floor**2 * self.fitter.curve_precision(Hypothesis((kind,), (Scope.START,)))
        return np.asarray(block_diag(*[precision] * times))

    def _start_values(self, kind: Kind, scope: Scope, amplitudes: Array, sign: float) -> tuple[dict[str, float], bool]:
        """(Start of each amplitude of an effect, by Slot.key; whether all linear steps can be right, as `_start_value`
        says). amplitudes: the linear steps (k,), for EACH those of the first test, then of the second, and so on; sign:
        that of the amplitudes with which the columns were simulated."""
        start, all_possible = {}, True
        count = len(kind.amplitudes)
        for i, amplitude in enumerate(amplitudes):
            parameter = kind.amplitudes[i % count]
            # An amplitude without any effect, as of an axis that never moved, does not count beside others.
            without_effect = amplitude == 0.0 and bool(np.any(amplitudes))
            value, possible = self._start_value(parameter, float(amplitude), sign)
            all_possible &= possible or without_effect
            name = key(parameter.name, 1 + i // count) if scope == Scope.EACH else parameter.name
            start[name] = 0.0 if without_effect else value
        return start, all_possible

    def _start_value(self, parameter: Parameter, amplitude: float, sign: float) -> tuple[float, bool]:
        """(Start of this amplitude, whether its linear step `amplitude` can be right). The start is the step, clipped
        to the parameter's range and to _FARTHEST scales. The step cannot be right if that is 0, or if a one-way
        amplitude was simulated with the other `sign`; the start is then a little way from 0, _OTHER_WAY scales, on the
        side of `sign`."""
        scale = self.fitter.scale(parameter)
        value = self.fitter.clipped(parameter, float(np.clip(amplitude, -_FARTHEST * scale, _FARTHEST * scale)))
        if value == 0.0 or (parameter.one_way and value * sign < 0.0):
            return _OTHER_WAY * sign * scale, False
        return value, True

    def _may_be_since(self, kind: Kind, scope: Scope, tests: int) -> bool:
        """Whether an effect may be there since `scope`. START excludes parts of the nominal model, and all effects
        where a simulator was calibrated; EACH needs `Kind.each` and several tests. tests: their number."""
        if scope == Scope.START:
            return not kind.nominal and self.fitter.effects_from_start
        return scope != Scope.EACH or (kind.each and tests > 1)

    def _normal_by_recording(self, part: Normal, test: int, tests: int, count: int) -> Normal:
        """The normal equations `part` of one test, enlarged so that each test has amplitudes of its own; those of the
        other tests get zeros. test: its index; tests: their number; count: the number of amplitudes of each."""
        shared = len(self.gradient)
        size = shared + tests * count
        index = np.concatenate([np.arange(shared), shared + test * count + np.arange(count)])
        normal = Normal(np.zeros((size, size)), np.zeros(size))
        normal.matrix[np.ix_(index, index)] = part.matrix
        normal.gradient[index] = part.gradient
        return normal

    def gain(self, parts: Sequence[Normal], prior: Array | float = 0.0) -> tuple[Array | None, float]:
        """(Best amplitudes (k,), share of the residual's sum of squares that they explain) of one effect, after the
        fit's unknowns have absorbed what they can; computed as in `gains`. (None, 0) where these absorb the effect.
        parts: normal equations of the recordings with the effect, its amplitudes last; prior: precision of the
        amplitudes."""
        m = len(self.gradient)
        cross = np.asarray(sum(part.matrix[m:, :m] for part in parts))
        of_effect = np.asarray(sum(part.matrix[m:, m:] for part in parts))
        gradient = np.asarray(sum(part.gradient[m:] for part in parts)) - cross @ self.absorbed
        taken = cross @ cho_solve(self.factor, cross.T)
        amplitudes, gain = self.gains(of_effect[None], taken[None], gradient[None], prior)
        return (amplitudes[0], float(gain[0])) if gain[0] >= 0.0 else (None, 0.0)

    def gains(self, of_effect: Array, taken: Array, gradient: Array, prior: Array | float = 0.0) -> tuple[Array, Array]:
        """((n, k) best amplitudes, (n,) share of the residual's sum of squares that they explain) of n effects, each
        alone: a = (G - X'N^-1 X + prior)^+ g, share = a'g / sum of squares. The share is -1 where the fit's unknowns
        absorb an effect: they leave at most _FREE of the norm of each of its columns. For the pseudo-inverse columns
        are scaled to unit norm, and eigenvalues below _RANK are dropped, as amplitudes with the same effect cannot be
        told apart. of_effect: G, (n, k, k); taken: X'N^-1 X, (n, k, k); gradient: g after these unknowns have taken
        theirs, (n, k); prior: precision of the amplitudes, (k, k), or one number for all elements."""
        k = of_effect.shape[1]
        diagonal = np.arange(k)
        free, size = of_effect - taken, of_effect[:, diagonal, diagonal]  # size: squared norms of the columns
        absorbed = (free[:, diagonal, diagonal] <= _FREE**2 * np.maximum(size, 1e-300)).all(axis=1)
        free, size = free + prior, size + np.diag(np.broadcast_to(prior, (k, k)))
        scale = 1.0 / np.sqrt(np.maximum(size, np.maximum(1e-12 * size.max(axis=1, keepdims=True), 1e-300)))
        eigenvalues, vectors = np.linalg.eigh(free * scale[:, :, None] * scale[:, None, :])
        inverse = np.where(eigenvalues > _RANK, 1.0 / np.maximum(eigenvalues, _RANK), 0.0)
        along = inverse * np.einsum("nij,ni->nj", vectors, scale * gradient)
        amplitudes = scale * np.einsum("nij,nj->ni", vectors, along)
        explained = np.einsum("ni,ni->n", amplitudes, gradient) / self.squares
        return amplitudes, np.where(absorbed, -1.0, explained)

    # ---- shapes that are scanned densely

    def _encoder_scores(self, kind: Kind) -> list[Screened]:
        """Scores of a periodic encoder error with two harmonics, over a grid of periods. To first order an error d of
        the motor's position moves the play's centre by d(q) / (1 + side B'/2). q is the motor position at which the tip
        was last carried, p + side B/2, and side the envelope that carried it, +1 or -1."""
        fitter, model = self.fitter, self.base.state.model
        slope_f, slope_b = (np.gradient(values, model.q) for values in (model.c_deg, model.width))
        low, high = (shape * fitter.model.rig.actuator.span for shape in kind.shapes[0].shape)
        reach = max(float(np.ptp(s.motor.q)) for s in fitter.segments)
        carried, by_q = [], []
        for row, segment in zip(self.rows, fitter.segments, strict=True):
            side = row.path.side[segment.scored].astype(float)
            carried.append(row.p + 0.5 * side * np.interp(row.p, model.q, model.width))
            steep = np.maximum(1.0 + 0.5 * side * np.interp(row.p, model.q, slope_b), _STEEPEST)
            by_q.append((row.by_follow * np.interp(row.tip, model.q, slope_f) / steep)[:, None] * row.by_c)
        rates = np.arange(reach / high, reach / low, _PERIODS_PER_RANGE) / reach
        scored = []
        for rate in rates:  # periods per unit of q
            columns = []
            for q, slope in zip(carried, by_q, strict=True):
                phase = 2 * np.pi * rate * q
                waves = [np.sin(phase), np.cos(phase), np.sin(2 * phase), np.cos(2 * phase)]
                columns.append(slope[:, :, None] * np.stack(waves, axis=1)[:, None, :])
            scored += self._scores_by_scope(kind, {"encoder_period": 1.0 / rate}, columns, 1.0)
        return scored

    def moments(self, kind: Kind, near: Sequence[float] = ()) -> list[Screened]:
        """Scores of an effect that happens at moments (shift, slip): with one moment, with two, and so on, each time
        the best further moment beside those found before. It ends where the fit's unknowns absorb the effect; [] for
        recordings of a few seconds. near: rough moments, s of scene time on the session's clock, near which every frame
        is tried; without them a grid of _SHIFT_STEP_S over the session is."""
        sensor = self.fitter.segments[0].sensor
        delay = self.base.state.model.delay_of(sensor) + self.base.state.values.get("delay", 0.0)
        edges, windows = self._candidate_times([moment + delay for moment in near])
        if not len(edges):  # of recordings of a few seconds
            return []
        from_edges = _HeldFromEdges(self, self._columns_if_always(kind), edges)
        chosen: list[int] = []
        found: list[Screened] = []
        for form, window in zip((kind.happening(n + 1) for n in range(len(kind.moments))), windows, strict=False):
            tried = [i for i in window if i not in chosen]
            if not tried:
                break
            of_tried, gains = from_edges.gains(chosen, tried)
            most = int(np.argmax(gains))
            best, amplitudes, gain = tried[most], of_tried[most], float(gains[most])
            if gain < 0.0:
                break
            chosen.append(best)
            values = {p.name: float(a) for p, a in zip(form.amplitudes, amplitudes, strict=True)}
            # The scene is older than its arrival; a little before the first frame that shows it.
            times = {n: float(edges[i]) - delay - _BEFORE_S for n, i in zip(form.moments, chosen, strict=True)}
            found.append(Screened(gain, form, Scope.START, {**values, **times}))
        return found

    def _candidate_times(self, near: Sequence[float]) -> tuple[Array, Iterable[Sequence[int]]]:
        """(Arrival times, s of the session, rising, from which on an effect may hold; for each of its moments the
        indices of the times to try). Times within _WITHIN_S of a recording's ends are left out. near: rough arrival
        times of the moments; without them the times are a grid over the session."""
        times = [t for s in self.fitter.segments if len(t := s.session_s[s.scored])]
        ends = [t[[0, -1]] for t in times]
        if not near:
            edges = np.arange(min(t[0] for t in ends), max(t[1] for t in ends), _SHIFT_STEP_S)
        else:
            width = _NEAR_STEPS * _SHIFT_STEP_S
            close = [np.any([np.abs(t - rough) <= width for rough in near], axis=0) for t in times]
            edges = np.unique(np.concatenate([t[is_close] for t, is_close in zip(times, close, strict=True)]))
        edges = np.array([e for e in edges if any(a + _WITHIN_S <= e <= b - _WITHIN_S for a, b in ends)])
        if not near:
            return edges, itertools.repeat(range(len(edges)))
        return edges, [np.flatnonzero(np.abs(edges - rough) <= _NEAR_STEPS * _SHIFT_STEP_S).tolist() for rough in near]

    def _columns_if_always(self, kind: Kind) -> list[Array]:
        """(scored, k, amplitudes of one moment) for each recording: the columns of an effect that happens at moments,
        as if it had happened before the first frame."""
        once = kind.happening(1)
        if not any(moves_tip(p) for p in once.amplitudes):
            return [row.columns[:, :, STATIC_COLUMNS] for row in self.rows]
        return self._amplitude_columns(once, dict.fromkeys(once.moments, -np.inf), 1.0)


class _HeldFromEdges:
    """Normal equations of columns that are 0 before some time (edge) and hold from it on, for each of many edges. Sums
    over frames are accumulated from the last edge back to the first."""

    def __init__(self, scan: _Scan, columns: Sequence[Array], edges: Array) -> None:
        """Sums up, for each edge, over all frames from it to the session's end. columns: (scored, k, count) of each
        recording, as if they held from the first frame on; edges: rising arrival times, s of the session."""
        self.shared, self.count = len(scan.gradient), columns[0].shape[2]
        zero, total = Normal.zeros(self.shared), Normal.zeros(self.shared + self.count)
        # Of each edge, the last first, (count, shared + count + 1): the columns' rows of the normal matrix, and their
        # gradient.
        rows: list[Array] = []
        times = [s.session_s[s.scored] for s in scan.fitter.segments]
        for begin, end in reversed(list(zip(edges, [*edges[1:], np.inf], strict=True))):
            for t, row, column in zip(times, scan.rows, columns, strict=True):
                first, last = np.searchsorted(t, [begin, end])
                if first < last:
                    piece = _slice_of_rows(row, slice(int(first), int(last)))
                    part = scan.fitter.normal(piece, column[first:last], known=zero)
                    total.matrix[...] += part.matrix
                    total.gradient[...] += part.gradient
            rows.append(np.column_stack([total.matrix[self.shared :], total.gradient[self.shared :]]))
        of_edges = np.array(rows[::-1])
        cross, self._of_effect, gradient = np.split(of_edges, [self.shared, self.shared + self.count], axis=2)
        self._gradient = gradient[:, :, 0] - cross @ scan.absorbed
        self._cross, self._scan = cross, scan
        # (edges, shared, count): N^-1 X.
        absorbing = cho_solve(scan.factor, cross.reshape(-1, self.shared).T)
        self._absorbing = absorbing.reshape(self.shared, -1, self.count).transpose(1, 0, 2)

    def gains(self, chosen: Sequence[int], tried: Sequence[int]) -> tuple[Array, Array]:
        """((tried, amplitudes), (tried,)) as `_Scan.gains`, for each edge in `tried` together with all edges in
        `chosen` (indices); the columns from each of these edges on are unknowns of their own. Two edges have in common
        the frames after the later one."""
        edges = np.array([[*chosen, i] for i in tried])
        n, k = edges.shape
        # (n, k, k): two columns overlap from the later of their edges on, whose sum is their product.
        later = np.maximum(edges[:, :, None], edges[:, None, :])
        of_effect = self._of_effect[later].transpose(0, 1, 3, 2, 4).reshape(n, k * self.count, k * self.count)
        cross = self._cross[edges].reshape(n, k * self.count, self.shared)
        absorbing = self._absorbing[edges].transpose(0, 2, 1, 3).reshape(n, self.shared, k * self.count)
        return self._scan.gains(of_effect, cross @ absorbing, self._gradient[edges].reshape(n, -1))


def _slice_of_rows(row: ScoredRows, part: slice) -> ScoredRows:
    """The rows of a contiguous part of a recording's scored observations."""
    return replace(
        row,
        **{
            name: getattr(row, name)[part]
            for name in ("p", "tip", "by_width", "by_follow", "by_c", "columns", "residual")
        },
    )


def _starting_shapes(fitter: Fitter, base: Fit, kind: Kind) -> list[dict[str, float]]:
    """All combinations of the starting values of the effect's shapes, each as {name: value in the parameter's own
    unit}."""

    def values(parameter: Parameter) -> list[float]:
        """Starting values of one shape: quantiles of the angles that the recordings reach, deg, if it is such an angle
        (`Parameter.reached`), else the parameter's own list."""
        if parameter.reached:
            c = np.concatenate([s.follow(base.state.model, {}, 0.0).c_deg for s in fitter.segments])
            return [float(v) for v in np.quantile(c, _ANGLES)]
        share = parameter.share(fitter.model.rig.actuator.span)
        return [v * share for v in parameter.shape]

    choices = [[(parameter.name, value) for value in values(parameter)] for parameter in kind.shapes]
    return [dict(choice) for choice in itertools.product(*choices)]
