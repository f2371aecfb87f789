"""Fits one hypothesis (no effect, one or several) to all recordings at once, the nominal model free where it may move.

The nominal that is shared by all recordings: B and f_remain as corrections in cubic B-splines and a factor on what of
them these cannot follow, the static registration and the delay. Its Jacobian is analytic along the play: on an
envelope p + side B(p)/2 = q moves by dp = -side dB(p)/2 / (1 + side B'(p)/2), and inside the backlash p keeps what it
had when an envelope last carried it. The effects' Jacobian is a difference quotient of the simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import block_diag

from tautline import effects
from tautline.diagnose.segment import Segment
from tautline.effects import Kind, Parameter, Path
from tautline.model import STEEPEST, Model
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

_WIDTH_PIECES, _REMAINING_PIECES = 12, 22
_ROUGH = 0.001  # second difference of a correction's neighbouring coefficients, share of its range
_STATIC = tuple(p.name for p in effects.BY_ID["registration.static"].amplitudes)
_OUTLIER = 6.0  # robust standard deviations: a residual beyond is pulled in, unless it is one of many
_RARE = 0.01  # a misfit that lasts longer than this share of a recording is no outlier


@dataclass(frozen=True)
class Hypothesis:
    """Effects that are present, each in all recordings or only in those after the calibration."""

    kinds: tuple[Kind, ...] = ()
    only_tests: tuple[bool, ...] = ()

    def plus(self, kind: Kind, only_tests: bool) -> Hypothesis:
        return Hypothesis((*self.kinds, kind), (*self.only_tests, only_tests))

    @property
    def parameters(self) -> list[tuple[Parameter, bool]]:
        """Amplitudes and continuous shapes, with whether they hold in the tests only."""
        return [
            (p, only)
            for kind, only in zip(self.kinds, self.only_tests, strict=True)
            for p in (*kind.amplitudes, *kind.shapes)
            if p.name not in _DISCRETE
        ]


_DISCRETE = frozenset({"contact_side", "shift_time", "width_held"})  # searched over, never differentiated


@dataclass(frozen=True)
class State:
    """A point of the parameter space."""

    model: Model  # the nominal with its corrections
    static: Mapping[str, float]  # nominal registration, all recordings
    values: Mapping[str, float] = field(default_factory=dict)  # of the effects

    def at(self, segment: Segment, hypothesis: Hypothesis) -> dict[str, float]:
        """The parameters that hold in one recording."""
        chosen = dict(self.static)
        for kind, only in zip(hypothesis.kinds, hypothesis.only_tests, strict=True):
            if only and segment.calibration:
                continue
            for p in (*kind.amplitudes, *kind.shapes):
                value = self.values.get(p.name)
                if value is not None:
                    chosen[p.name] = chosen.get(p.name, 0.0) + value if p.name in _STATIC else value
        return chosen


@dataclass(frozen=True)
class Linear:
    """Residuals and Jacobians at a state, rows of all scored coordinates of all recordings."""

    residual: Array  # (n,)
    nominal: Array  # (n, m)
    rows: list[slice]  # of each segment


@dataclass(frozen=True)
class Fit:
    hypothesis: Hypothesis
    state: State
    residuals: list[Array]  # of each segment, (scored, k)

    @property
    def freedom(self) -> int:
        """How many parameters the effects have."""
        return len(self.hypothesis.parameters)


class Fitter:
    def __init__(self, model: Model, segments: Sequence[Segment], load_reference: float = 0.0) -> None:
        self.model, self.segments, self.load_reference = model, list(segments), load_reference
        self.px = segments[0].unit == "px"
        low = min(float(s.motor.q.min()) for s in segments)
        high = max(float(s.motor.q.max()) for s in segments)
        self._width_basis = Basis(low, high, _WIDTH_PIECES)
        self._remaining_basis = Basis(low, high, _REMAINING_PIECES)
        span = model.rig.actuator.span
        gain = abs(model.rig.coarse.gain)
        # Priors keep what the motion does not excite where calibration left it.
        prior = [np.full(self._width_basis.size, 0.03 * span), np.full(self._remaining_basis.size, 0.1 * gain * span)]
        prior.append(np.ones(2))
        # What the splines cannot follow: an effect that was there during calibration left its ripple in it.
        self._details = tuple(
            _beyond(basis, model.q, values)
            for basis, values in ((self._width_basis, model.width), (self._remaining_basis, model.c_deg))
        )
        if self.px:
            prior += [np.full(3, 3.0), np.full(3, 2.0), np.full(1, 0.02)]
        self._prior = np.concatenate(prior)
        self._bending = block_diag(
            _bending(self._width_basis.size, _ROUGH * span), _bending(self._remaining_basis.size, _ROUGH * gain * span)
        )
        before = self._width_basis.size + self._remaining_basis.size + 2
        self.static_columns = slice(before, before + 6)  # of Linear.nominal, with a camera
        self.floor = 1.0
        # An obstacle that begins outside of what was reached would be another gain and offset, and no obstacle.
        ends = np.sort(model.remaining(np.array([low, high])))
        inset = 0.05 * float(ends[1] - ends[0])
        self._contact = (float(ends[0]) + inset, float(ends[1]) - inset)

    def nominal(self) -> Fit:
        """The recalibrated model without any effect."""
        return self.fit(Hypothesis(), {})

    def scale(self, parameter: Parameter) -> float:
        """A parameter's natural step in its own unit."""
        return parameter.scale * (self.model.rig.actuator.span if parameter.unit.startswith("unit") else 1.0)

    def start(self) -> State:
        return State(self.model, dict.fromkeys(_STATIC, 0.0) if self.px else {})

    def spread(self, hypothesis: Hypothesis) -> Array:
        """Standard deviations of the prior: of the nominal's corrections, then of the effects' parameters."""
        return np.concatenate([self._prior, [30.0 * self.scale(p) for p, _ in hypothesis.parameters]])

    def stiffness(self, hypothesis: Hypothesis) -> Array:
        """The prior's inverse covariance: 1 / spread^2, and B and f_remain move smoothly: where a motion hardly reaches
        they go with what is beside them."""
        stiff = np.diag(1 / self.spread(hypothesis) ** 2)
        n = len(self._bending)
        stiff[:n, :n] += self._bending
        return stiff

    def paths(self, state: State, hypothesis: Hypothesis) -> list[Path]:
        """Of every recording."""
        return [s.predict(state.model, state.at(s, hypothesis), self.load_reference)[0] for s in self.segments]

    def residual(self, state: State, hypothesis: Hypothesis, moved: Sequence[Path] | None = None) -> Array:
        """`moved` as in Segment.predict, one for each recording."""
        return np.concatenate([r.ravel() for r in self._residuals(state, hypothesis, moved)])

    def _residuals(self, state: State, hypothesis: Hypothesis, moved: Sequence[Path] | None = None) -> list[Array]:
        residuals = []
        for i, segment in enumerate(self.segments):
            parameters = state.at(segment, hypothesis)
            known = moved[i] if moved else None
            _, predicted = segment.predict(state.model, parameters, self.load_reference, known)
            residuals.append((segment.observed - predicted)[segment.scored])
        return residuals

    def linearise(self, state: State, hypothesis: Hypothesis) -> Linear:
        residuals, jacobians, rows, at = [], [], [], 0
        for segment in self.segments:
            residual, jacobian = self._linear_segment(segment, state, hypothesis)
            residuals.append(residual)
            jacobians.append(jacobian)
            rows.append(slice(at, at + len(residual)))
            at += len(residual)
        return Linear(np.concatenate(residuals), np.concatenate(jacobians), rows)

    def _linear_segment(self, segment: Segment, state: State, hypothesis: Hypothesis) -> tuple[Array, Array]:
        model, parameters = state.model, state.at(segment, hypothesis)
        path, predicted = segment.predict(model, parameters, self.load_reference)
        keep = segment.scored
        p, side, c = path.p[keep], path.side[keep], path.c_deg[keep]
        slope_b = np.interp(p, model.q, np.gradient(model.width, model.q))
        slope_f = np.interp(p, model.q, np.gradient(model.c_deg, model.q))
        d_width = slope_f * -side / 2 / np.maximum(1 + side * slope_b / 2, 0.1)
        columns_c = [
            d_width[:, None] * self._width_basis.design(p).toarray(),
            self._remaining_basis.design(p).toarray(),
            (d_width * np.interp(p, model.q, self._details[0]))[:, None],
            np.interp(p, model.q, self._details[1])[:, None],
        ]
        d_c = np.concatenate(columns_c, axis=1)
        if not self.px:
            return (segment.observed[keep] - predicted[keep]).ravel(), d_c
        motor = segment.motor
        scene = segment.arrival_s[keep] - model.delay_s
        translation = 0.0 if motor.translation_mm is None else np.interp(scene, motor.t_s, motor.translation_mm)
        turn = 0.0 if motor.rotation_deg is None else np.interp(scene, motor.t_s, motor.rotation_deg)
        after = scene + segment.offset_s >= parameters.get("shift_time", np.inf)

        def image(angle: Array, changed: Mapping[str, float]) -> Array:
            return effects.image(model, angle, translation, turn, changed, side, after)

        here = predicted[keep]
        per_deg = (image(c + 0.01, parameters) - here) / 0.01
        columns = [per_deg[:, :, None] * d_c[:, None, :]]
        for name in _STATIC:
            step = 0.01
            moved = image(c, {**parameters, name: parameters.get(name, 0.0) + step})
            columns.append(((moved - here) / step)[:, :, None])
        columns.append((-velocity(segment, path.c_deg)[keep, None] * per_deg)[:, :, None])
        jacobian = np.concatenate(columns, axis=2)
        return (segment.observed[keep] - here).ravel(), jacobian.reshape(-1, jacobian.shape[2])

    def effect_jacobian(self, state: State, hypothesis: Hypothesis) -> Array:
        """(n, k) by difference quotients, one column for each of the hypothesis' parameters."""
        if not hypothesis.parameters:
            return np.empty((sum(self._counts()), 0))
        moved = self.paths(state, hypothesis)
        base = self.residual(state, hypothesis, moved)
        columns = []
        for parameter, _ in hypothesis.parameters:
            step = 0.05 * self.scale(parameter)
            here = state.values[parameter.name]
            changed = replace(state, values={**state.values, parameter.name: here + step})
            same = None if moves_tip(parameter) else moved
            columns.append((base - self.residual(changed, hypothesis, same)) / step)
        return np.column_stack(columns)

    def fit(
        self, hypothesis: Hypothesis, values: Mapping[str, float], start: State | None = None, iterations: int = 8
    ) -> Fit:
        """Levenberg-Marquardt from `values`, the nominal from `start` (default: as calibrated)."""
        state = replace(start or self.start(), values=dict(values))
        damping = 1e-4
        for _ in range(iterations):
            linear = self.linearise(state, hypothesis)
            jacobian = np.column_stack([linear.nominal, self.effect_jacobian(state, hypothesis)])
            limit = self._limit(linear.residual)
            cost = robust_cost(linear.residual, limit)
            weight = np.minimum(1.0, limit / np.maximum(np.abs(linear.residual), 1e-12))
            prior = self.stiffness(hypothesis)
            weighted = jacobian * weight[:, None]
            normal = jacobian.T @ weighted / self.floor**2
            gradient = weighted.T @ linear.residual / self.floor**2
            improved = False
            for _ in range(8):
                damped = normal + prior + damping * np.diag(np.diag(normal))
                step = np.linalg.solve(damped, gradient)
                trial = self._moved(state, hypothesis, step)
                trial_cost = robust_cost(self.residual(trial, hypothesis), limit)
                if trial_cost < cost:
                    gain = (cost - trial_cost) / cost
                    state, cost, damping, improved = trial, trial_cost, damping / 5, True
                    break
                damping = max(damping, 1e-6) * 10
            if not improved or gain < 1e-4:
                break
        return Fit(hypothesis, state, self._residuals(state, hypothesis))

    def _counts(self) -> list[int]:
        return [int(s.scored.sum()) * s.observed.shape[1] for s in self.segments]

    def _limit(self, residual: Array) -> Array:
        """(n,) per recording: one that fits badly throughout is not an outlier of those that fit."""
        parts = np.split(residual, np.cumsum(self._counts())[:-1])
        return np.concatenate([np.full(len(r), outlier_limit(r)) for r in parts])

    def _moved(self, state: State, hypothesis: Hypothesis, step: Array) -> State:
        model = state.model
        b, f = self._width_basis.size, self._remaining_basis.size
        width = model.width + self._width_basis.value(step[:b], model.q) + step[b + f] * self._details[0]
        width = allowed_width(model.q, width)
        c_deg = model.c_deg + self._remaining_basis.value(step[b : b + f], model.q) + step[b + f + 1] * self._details[1]
        static, delay, at = state.static, model.delay_s, b + f + 2
        if self.px:
            static = {name: state.static[name] + float(step[at + i]) for i, name in enumerate(_STATIC)}
            delay, at = delay + float(step[at + 6]), at + 7
        values = dict(state.values)
        for i, (parameter, _) in enumerate(hypothesis.parameters):
            value = inside(parameter.name, values[parameter.name] + float(step[at + i]))
            values[parameter.name] = float(np.clip(value, *self._contact)) if parameter.name == "contact_c" else value
        return State(replace(model, width=width, c_deg=c_deg, delay_s=delay), static, values)


def _bending(size: int, scale: float) -> Array:
    """Inverse covariance of coefficients whose second differences scatter by `scale`."""
    bends = np.diff(np.eye(size), n=2, axis=0) / scale
    return np.asarray(bends.T @ bends)


def _beyond(basis: Basis, grid: Array, values: Array) -> Array:
    """What of a curve on a grid the basis cannot follow."""
    reached = (grid >= basis.low) & (grid <= basis.high)
    design = basis.design(grid).toarray()
    coefficients = np.linalg.lstsq(design[reached], values[reached], rcond=None)[0]
    left: Array = np.where(reached, values - design @ coefficients, 0.0)
    return left


def moves_tip(parameter: Parameter) -> bool:
    """Whether the tip's path depends on it, and not only what is seen of it."""
    return parameter.name in effects.NATIVE or parameter.name == "delay"


def inside(name: str, value: float) -> float:
    """A parameter kept where it means something."""
    if name in ("onset_spread", "creep_share", "contact_hold"):
        return min(max(value, 0.0), 1.0)
    if name in ("lag", "stick", "width_per_speed"):
        return max(value, 0.0)
    if name in ("asymmetry_travel", "creep_time", "encoder_period"):
        return max(value, 1e-3)
    return value


def allowed_width(grid: Array, width: Array) -> Array:
    """B >= 0 and |B'| <= 1.8, by cutting what exceeds it."""
    width = np.maximum(width, 0.0)
    steepest = STEEPEST * np.diff(grid)
    for i in range(1, len(width)):
        width[i] = min(width[i], width[i - 1] + steepest[i - 1])
    for i in range(len(width) - 2, -1, -1):
        width[i] = min(width[i], width[i + 1] + steepest[i])
    return width


def robust_cost(residual: Array, limit: Array) -> float:
    """Huber's: quadratic to the limit, linear beyond."""
    size = np.abs(residual)
    return float(np.sum(np.where(size < limit, size**2, 2 * limit * size - limit**2)))


def velocity(segment: Segment, c_deg: Array) -> Array:
    """dc/dt (n,) deg/s at the observations."""
    return np.gradient(c_deg, segment.arrival_s) if len(c_deg) > 1 else np.zeros_like(c_deg)


def outlier_limit(residual: Array) -> float:
    """Of one recording: a lost marker must not decide, and what follows every reversal must."""
    if residual.size == 0:
        return 1.0
    return max(_OUTLIER * robust_deviation(residual), 1.2 * float(np.quantile(np.abs(residual), 1.0 - _RARE)))


def robust_deviation(values: Array) -> float:
    return 1.4826 * float(np.median(np.abs(values))) + 1e-12
