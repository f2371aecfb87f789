"""The posterior of all parameters of a user's simulator at once, with a play, a static law and a delay behind its tip.

The play stands for friction in a servo's gears as well: its width varies smoothly over the place, as a load does, and
is another one at speed than at rest (Stribeck). Or it is slack in which nothing holds the joint, which falls to the
side that its load pulls to: a second mode, found from starts of its own.

The unknowns are a vector u (m,) with a standard normal prior: a positive parameter is its nominal value times exp(u),
any other one nominal plus u times a spread. Residuals are correlated in time: n successive readings count as one, n
from their autocorrelation, so that what the model lacks is no evidence for its parameters. They are not whitened: that
would weigh the fastest changes most, which is where the model lacks most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt

from tautline.core.posterior import Posterior
from tautline.diagnosis import gap
from tautline.diagnosis.segment import Segment
from tautline.effects import simulator_id
from tautline.least_squares import descend
from tautline.model import Effect, Model, allowed_width, monotone
from tautline.simulators.simulator import Declared

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

WIDTH, LAW, DELAY = "transmission.backlash", "configuration.remaining", "acquisition.delay"
SPEED = "transmission.rate_dependent_backlash"
LOOSE = "transmission.loose"
BENDS = "bends"  # id of the width's variation over the place
OF_WIDTH = (BENDS, LOOSE)  # ids that are reported as part of WIDTH
_FACTOR = 1.0  # prior: standard deviation of a positive parameter's logarithm: published values differ twofold
_SPREADS = 3.0  # prior: standard deviation of any other parameter, in its declared spreads
_WIDTH = 0.02  # prior: standard deviation of the width, and of what speed adds to it, in shares of the motor's range
_PULL, _DRAG = 70.0, 5.0  # prior: 1/s^2, 1/s: a rod of 20 cm that hangs; its bearing stops it in a fifth of a second
_PLACE = 0.3  # prior: standard deviation of where a load changes sides, in shares of the motor's range
_WIDTHS, _PULLS = (0.5, 1.0, 2.0), (1.0, -1.0)  # tolerance: starts of the second mode: unknowns of width, of pull
_PLACES, _DRAGS = (-1.0, 0.0, 1.0), (0.0, 3.0)  # tolerance: the same of place, of drag
PRESENT = 0.2  # prior: probability of an unknown to be present, and of a joint to be loose
_PROMISING = 2.0  # tolerance: of the squares that the other maximum leaves
_USUAL = 0.1  # equation: the library's unit of speed, motor's ranges per second
_SATURATION = 3.0  # prior: Stribeck's speed of small gears: half of what speed does is there at a quarter of that unit
_SPEED_S = 0.02  # prior: s in which a width follows the speed, as in the library
_LAW_DEG = 3.0  # prior: standard deviation of a coefficient of the law's polynomial, deg
_DELAY_S = 0.05  # prior: standard deviation of the delay beyond the calibration's: a bus, a filter or a servo
_DIFFERENCE = 0.01  # tolerance: standard deviations of an unknown: the step of its difference quotient
_LEAST_FACTOR = 1e-9  # tolerance: of a positive parameter's nominal value: 0 has no logarithm
_AT_BOUND = 1e-6  # tolerance: standard deviations: an unknown nearer to the end of its range is at it
_ROUNDS, _STEPS = 3, 12  # tolerance: rounds of the noise's estimate, Gauss-Newton steps of each at most
_REFITS = 4  # tolerance: steps of a fit without a block
_RAISED = 1.0  # tolerance: of -2 log posterior, which is not smooth where a joint begins to fall
_SMALL_GAIN = 0.02  # tolerance: of -2 log posterior: a step that gains less is the last


@dataclass(frozen=True)
class Detail:
    """How finely the law and the play's width vary over the motor's range."""

    law: int  # order of the law's polynomial
    width: int  # order of the polynomial of log(width)
    bend: float  # prior standard deviation of a coefficient of the width's polynomial


NAMING = Detail(5, 2, 0.3)  # prior: where more bends, what is named is told less well: law and width stand for others
FORETELLING = Detail(9, 5, _FACTOR)  # prior: of real joints, by blocks left out; a width is as uncertain as the rest


@dataclass(frozen=True)
class Unknown:
    """A group of numbers of the vector u that are present or absent (0) together."""

    id: str  # of the effect that they are the parameters of, or BENDS
    places: Indices  # their indices in the vector u


@dataclass(frozen=True)
class Noise:
    """The distribution of residuals: normal, with `per_independent` successive readings counting as one independent
    one."""

    sigma: float  # one standard deviation of a reading, in the observations' unit
    per_independent: float

    @classmethod
    def of(cls, residuals: Sequence[Array], floor: float) -> Noise:
        """Estimates the noise from residuals (scored, k) of each recording: sigma is their rms, at least `floor`."""
        return cls(max(gap.rms(residuals), floor), gap.residuals_per_independent(residuals))

    @property
    def weight(self) -> float:
        """The factor of a squared residual in -2 log likelihood: 1 / (n sigma^2), with n = per_independent."""
        return 1.0 / (self.per_independent * self.sigma**2)


@dataclass(frozen=True)
class _Point:
    """A point of the parameter space with what its simulation leaves."""

    u: Array  # (m,)
    residuals: list[Array]  # (scored, k) of each recording


@dataclass(frozen=True)
class Fitted:
    """The posterior, approximated as normal about its maximum, and the simulation linearised there."""

    posterior: Posterior
    noise: Noise
    residuals: list[Array]  # (scored, k) of each recording
    slopes: list[Array]  # (scored, k, m) of each recording: d prediction / d u
    free: Indices  # indices of the unknowns that are not held at an end of their range

    @property
    def u(self) -> Array:
        """(m,) The unknowns at the posterior's maximum, in standard deviations of their prior."""
        return self.posterior.mean

    def log_evidence(self, noise: Noise) -> float:
        """The log evidence of the recordings by Laplace's approximation about this maximum, up to a constant, if
        residuals have this noise."""
        covariance = self.posterior.covariance[np.ix_(self.free, self.free)]
        fit = -0.5 * _cost(noise, _Point(self.u, self.residuals))
        return fit + 0.5 * float(np.linalg.slogdet(covariance)[1])


class Joint:
    """The unknowns of a simulator, and the predictions of the robot's recordings as a function of them."""

    def __init__(
        self,
        model: Model,
        parameters: Sequence[Declared],
        segments: Sequence[Segment],
        floor: float,
        loose: bool = False,
        detail: Detail = NAMING,
    ) -> None:
        """model: the simulator's nominal model. parameters: those that the simulator declares. segments: the robot's
        recordings, each with its drive. floor: one standard deviation of the sensor's noise, in the observations' unit.
        loose: whether nothing holds the joint within the play. detail: how finely law and width vary over the range."""
        self.loose, self.detail = loose, detail
        self.model, self.parameters, self.segments, self.floor = model, tuple(parameters), list(segments), floor
        low = min(float(s.motor.q.min()) for s in segments)
        high = max(float(s.motor.q.max()) for s in segments)
        # Chebyshev polynomials (grid, orders) over the range that was reached; beyond it as at its ends.
        place = np.clip((2.0 * model.q - low - high) / max(high - low, 1e-9), -1.0, 1.0)
        self._polynomials = np.polynomial.chebyshev.chebvander(place, max(detail.law, detail.width))

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """The groups of unknowns in the order of the vector u: each parameter of the simulator, then width, law, delay,
        speed, bends, and if the joint is loose one group of three: the pull of its load, the place where that changes
        sides, and its drag."""
        sizes = {simulator_id(p.name): 1 for p in self.parameters} | {
            WIDTH: 1,
            LAW: self.detail.law + 1,
            DELAY: 1,
            SPEED: 1,
            BENDS: self.detail.width,
            **({LOOSE: 3} if self.loose else {}),
        }
        ends = np.cumsum([0, *sizes.values()])
        return tuple(Unknown(name, np.arange(a, b)) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True))

    @property
    def size(self) -> int:
        """Length of the vector u."""
        return sum(len(unknown.places) for unknown in self.unknowns)

    @cached_property
    def places(self) -> dict[str, Indices]:
        """{id of an unknown: its indices in the vector u}."""
        return {unknown.id: unknown.places for unknown in self.unknowns}

    def effects(self, u: Array) -> tuple[Effect, ...]:
        """The effects at u (m,) that are not in the model's tables: the changed parameters of the simulator, the
        dependence of the width on speed if it is not 0, and, if the joint is loose, its pull, place and drag."""
        changes = {
            simulator_id(p.name): _change_from_nominal(p, float(x)) for p, x in zip(self.parameters, u, strict=False)
        }
        found = [Effect(name, {name: value}) for name, value in changes.items() if value]
        speed = float(u[self.places[SPEED]][0])
        if speed:
            # At great speeds it adds per_speed _USUAL range / (1 - exp(-_SATURATION)): here _WIDTH speed range.
            per_speed = _WIDTH * speed / _USUAL * -float(np.expm1(-_SATURATION))
            parameters = {
                "width_per_speed": per_speed,
                "speed_saturation": _SATURATION,
                "speed_time": _SPEED_S,
                "width_held": 1.0,
            }
            found.append(Effect(SPEED, parameters))
        if self.loose:
            pull, place, drag = u[self.places[LOOSE]].tolist()
            parameters = {"loose_pull": _PULL * pull, "loose_place": _PLACE * self.model.rig.actuator.span * place}
            found.append(Effect(LOOSE, {**parameters, "loose_drag": _DRAG * float(np.exp(drag))}))
        return tuple(found)

    def changes(self, u: Array) -> dict[str, float]:
        """The parameters of all `effects` at u (m,), by name, in their own units; those of the simulator as changes
        from their nominal values."""
        return {name: value for effect in self.effects(u) for name, value in effect.parameters.items()}

    def model_at(self, u: Array) -> Model:
        """The model at u (m,), with width, law and delay in its tables and the rest as its effects."""
        model = self.model
        return replace(
            model,
            width=allowed_width(model.q, model.width + _WIDTH * model.rig.actuator.span * self._added_widths(u)),
            c_deg=monotone(model.c_deg + self.law_slopes() @ u[self.places[LAW]]),
            delay_s=model.delay_s + _DELAY_S * float(u[self.places[DELAY]][0]),
            effects=self.effects(u),
        )

    def _added_widths(self, u: Array) -> Array:
        """(grid,) The width that u (m,) adds to the play of a resting motor, in units of _WIDTH times the motor's
        range: max(u_width, 0) exp(P), with P a polynomial of the place whose coefficients are those of BENDS."""
        log_shape = self.detail.bend * self._polynomials[:, 1 : 1 + self.detail.width] @ u[self.places[BENDS]]
        return np.asarray(max(float(u[self.places[WIDTH]][0]), 0.0) * np.exp(log_shape))

    def law_slopes(self) -> Array:
        """(grid, law + 1) d c_deg / d u, deg, by the law's unknowns, on the model's grid of q; the law is linear in
        them."""
        return np.asarray(_LAW_DEG * self._polynomials[:, : self.detail.law + 1])

    def residuals(self, u: Array) -> list[Array]:
        """Observed less predicted, (scored, k) for each recording, at u (m,)."""
        model, changes = self.model_at(u), self.changes(u)
        predicted = [s.predict(model, changes, 0.0)[1] for s in self.segments]
        return [(s.observed - seen)[s.scored] for s, seen in zip(self.segments, predicted, strict=True)]

    def slopes(self, u: Array, residuals: Sequence[Array]) -> list[Array]:
        """(scored, k, m) for each recording: d prediction / d u by difference quotients, backwards where a step
        forwards would leave a range. residuals: at u (m,). A simulator is told of all runs beforehand (`ask`), so that
        it can run several at once."""
        steps = []
        for step in _DIFFERENCE * np.eye(len(u)):
            steps.append(step if np.array_equal(self.within_ranges(u + step), u + step) else -step)
        for step in steps:
            for segment in self.segments:
                segment.ask(self.changes(u + step))
        columns = [np.zeros((*r.shape, len(u))) for r in residuals]
        for i, step in enumerate(steps):
            for column, stepped, residual in zip(columns, self.residuals(u + step), residuals, strict=True):
                column[:, :, i] = (residual - stepped) / step[i]
        return columns

    def fit(self, progress: Callable[[float], None] = lambda share: None, start: Array | None = None) -> Fitted:
        """The normal posterior about its maximum, found by Gauss-Newton descents from `start` (m,), by default the
        simulator as it is (u = 0). The noise is estimated anew after each of _ROUNDS descents. progress: called with
        the share of the rounds that is done, 0 to 1."""
        u = np.zeros(self.size) if start is None else start
        point = _Point(u, self.residuals(u))
        noise = Noise.of(point.residuals, self.floor)
        for i in range(_ROUNDS):
            point = descend(_Descent(self, noise), point, _STEPS)
            noise = Noise.of(point.residuals, self.floor)
            progress((i + 1) / _ROUNDS)
        return self._laplace_fit(point, noise)

    def loose_variant(self, held: Fitted) -> tuple[Joint, Array] | None:
        """(The same unknowns with a joint that is loose within the play, u from which to fit them). `held` is the fit
        of this joint. A grid of starts (width, pull, place, drag) is tried; for each the law is fitted linearly and all
        else stays as in `held`, without speed and bends; the start with the smallest sum of squares is returned. None
        if that sum is not below _PROMISING times the one of `held`."""
        joint = Joint(self.model, self.parameters, self.segments, self.floor, loose=True, detail=self.detail)
        law, weight = self.places[LAW], held.noise.weight
        rows = np.concatenate([slope[:, :, law].reshape(-1, len(law)) for slope in held.slopes])
        normal = np.eye(len(law)) + weight * rows.T @ rows
        as_before = np.concatenate([held.u, np.zeros(joint.size - self.size)])
        as_before[law] = as_before[self.places[SPEED]] = as_before[self.places[BENDS]] = 0.0
        best, least = as_before, np.inf
        for width, pull, place, drag in product(_WIDTHS, _PULLS, _PLACES, _DRAGS):
            u = as_before.copy()
            u[joint.places[WIDTH]], u[joint.places[LOOSE]] = width, (pull, place, drag)
            left = np.concatenate([residuals.ravel() for residuals in joint.residuals(u)])
            # The law's best coefficients for this start: the prediction is linear in them, with slopes as in `held`.
            u[law] = weight * np.linalg.solve(normal, rows.T @ left)
            squares = float(np.sum((left - rows @ u[law]) ** 2))
            best, least = (u, squares) if squares < least else (best, least)
        promising = least < _PROMISING * sum(float(np.sum(residuals**2)) for residuals in held.residuals)
        return (joint, best) if promising else None

    def with_more_detail(self, fitted: Fitted) -> tuple[Joint, Fitted]:
        """(The same unknowns with a law and a width of more detail (FORETELLING), their fit), found from the fit
        `fitted` of this joint."""
        joint = Joint(self.model, self.parameters, self.segments, self.floor, self.loose, FORETELLING)
        start = np.zeros(joint.size)
        for unknown in self.unknowns:
            start[joint.places[unknown.id][: len(unknown.places)]] = fitted.u[unknown.places]
        start[joint.places[BENDS]] *= self.detail.bend / joint.detail.bend
        return joint, joint.fit(start=start)

    def residuals_with_weights(self, fitted: Fitted, weights: Sequence[Array], step: Array) -> list[Array]:
        """(scored, k) of each recording: residuals of a fit in which the readings have these weights (scored,), 0 to 1.
        The fit is one linear `step` (m,) away from `fitted`, the fit of all; if that step raises the cost by _RAISED or
        more, the fit is found by a descent instead."""
        problem = _Descent(self, fitted.noise, weights)
        from_point = _Point(fitted.u, fitted.residuals)
        stepped = problem.moved(from_point, step)
        if problem.cost(stepped) < problem.cost(from_point) + _RAISED:
            return stepped.residuals
        return descend(problem, from_point, _REFITS).residuals

    def _laplace_fit(self, point: _Point, noise: Noise) -> Fitted:
        """Approximates the posterior as normal at its maximum `point`; unknowns at an end of their range get the
        variance 0."""
        slopes = self.slopes(point.u, point.residuals)
        matrix, gradient = _normal_equations(noise, point, slopes)
        free = np.flatnonzero(~_is_at_bound(self, point.u, gradient))
        names = tuple(f"{unknown.id}:{i}" for unknown in self.unknowns for i in range(len(unknown.places)))
        covariance = np.zeros((self.size, self.size))
        covariance[np.ix_(free, free)] = np.linalg.inv(matrix[np.ix_(free, free)])
        return Fitted(Posterior(names, point.u, covariance), noise, point.residuals, slopes, free)

    def within_ranges(self, u: Array) -> Array:
        """A copy of u (m,) with every parameter clipped to its range, and the width kept from being negative, at rest
        and at speed."""
        clipped = u.copy()
        clipped[: len(self.parameters)] = [
            _clipped_unknown(p, float(x)) for p, x in zip(self.parameters, u, strict=False)
        ]
        width, speed = self.places[WIDTH], self.places[SPEED]
        clipped[width] = np.maximum(clipped[width], 0.0)
        clipped[speed] = np.maximum(clipped[speed], -np.min(self._added_widths(clipped)))
        return clipped


def fit_held_or_loose(joint: Joint, progress: Callable[[float], None] = lambda share: None) -> tuple[Joint, Fitted]:
    """Fits a joint twice, held in its play and loose within it, and returns (joint, fit) of the likelier one: as the
    prior PRESENT of being loose and the evidence of both say. Only the first is fitted where no start of the second is
    promising; without a play it cannot be loose. progress: called with the share that is done, 0 to 1."""
    held = joint.fit(lambda share: progress(0.5 * share))
    beginning = joint.loose_variant(held)
    if beginning is None:
        return joint, held
    loosened, start = beginning
    loose = loosened.fit(lambda share: progress(0.5 + 0.5 * share), start)
    noise = min(held.noise, loose.noise, key=lambda noise: noise.sigma)
    log_odds = float(np.log(PRESENT / (1.0 - PRESENT))) + loose.log_evidence(noise) - held.log_evidence(noise)
    has_play = loose.u[loosened.places[WIDTH]][0] > 0.0
    return (loosened, loose) if has_play and log_odds > 0.0 else (joint, held)


class _Descent:
    """Minimises -2 log posterior as a least-squares problem (least_squares.Problem)."""

    def __init__(self, joint: Joint, noise: Noise, weights: Sequence[Array] | None = None) -> None:
        """weights: of the readings, (scored,) of each recording, 0 to 1; by default all are 1."""
        self.joint, self.noise, self.weights = joint, noise, weights

    def _weighted(self, rows: Sequence[Array]) -> list[Array]:
        """The rows (scored, ...) of each recording, each row multiplied by the root of its reading's weight."""
        if self.weights is None:
            return list(rows)
        roots = [np.sqrt(w).reshape(-1, *[1] * (r.ndim - 1)) for r, w in zip(rows, self.weights, strict=True)]
        return [r * root for r, root in zip(rows, roots, strict=True)]

    def linearised(self, point: _Point) -> tuple[Array, Array, float]:
        """(Normal matrix (m, m), gradient (m,) as the direction that lowers the cost, cost) at a point. Unknowns at an
        end of their range get the equation 1 * step = 0, which holds them."""
        slopes = self._weighted(self.joint.slopes(point.u, point.residuals))
        weighted = _Point(point.u, self._weighted(point.residuals))
        matrix, gradient = _normal_equations(self.noise, weighted, slopes)
        held = np.flatnonzero(_is_at_bound(self.joint, point.u, gradient))
        matrix[held, :] = matrix[:, held] = gradient[held] = 0.0
        matrix[held, held] = 1.0
        return matrix, gradient, self.cost(point)

    def moved(self, point: _Point, step: Array) -> _Point:
        """The point reached by a step (m,), clipped to the unknowns' ranges, and simulated."""
        u = self.joint.within_ranges(point.u + step)
        return _Point(u, self.joint.residuals(u))

    def cost(self, point: _Point) -> float:
        """-2 log posterior at this point, up to a constant, with the readings weighted."""
        return _cost(self.noise, _Point(point.u, self._weighted(point.residuals)))

    def enough(self, gained: float, cost: float) -> bool:
        """Whether to stop after a step that lowered the cost by `gained`."""
        return gained < _SMALL_GAIN


def _cost(noise: Noise, point: _Point) -> float:
    """-2 log(likelihood times prior) = weight sum(r^2) + u'u, up to a constant."""
    return noise.weight * sum(float(np.sum(r**2)) for r in point.residuals) + float(point.u @ point.u)


def _normal_equations(noise: Noise, point: _Point, slopes: Sequence[Array]) -> tuple[Array, Array]:
    """(Normal matrix I + weight J'J (m, m), gradient weight J'r - u (m,), the direction that lowers the cost). slopes:
    J, (scored, k, m) of each recording."""
    matrix, gradient = np.eye(len(point.u)), -point.u.copy()
    for residual, slope in zip(point.residuals, slopes, strict=True):
        flat = slope.reshape(-1, slope.shape[2])
        matrix += noise.weight * flat.T @ flat
        gradient += noise.weight * flat.T @ residual.ravel()
    return matrix, gradient


def _is_at_bound(joint: Joint, u: Array, gradient: Array) -> npt.NDArray[np.bool_]:
    """(m,) Whether each unknown of u (m,) is at an end of its range while the gradient (m,) points beyond it."""
    onward = u + np.sign(gradient) * _AT_BOUND
    return np.asarray(joint.within_ranges(onward) != onward)


def _only_positive(parameter: Declared) -> bool:
    """Whether a parameter can only be positive; its unknown u is then the logarithm of a factor on its nominal
    value."""
    return parameter.nominal > 0.0 and parameter.low >= 0.0


def _change_from_nominal(parameter: Declared, u: float) -> float:
    """The change of a parameter from its nominal value, in its own unit, for its unknown u: nominal (exp(_FACTOR u) -
    1) for one that can only be positive, else _SPREADS spread u; clipped to the parameter's range."""
    change = _unclipped_change(parameter, u)
    return float(np.clip(change, parameter.low - parameter.nominal, parameter.high - parameter.nominal))


def _unclipped_change(parameter: Declared, u: float) -> float:
    """As `_change_from_nominal`, without regard to the parameter's range."""
    if _only_positive(parameter):
        return float(parameter.nominal * np.expm1(_FACTOR * u))
    return _SPREADS * parameter.spread * u


def _clipped_unknown(parameter: Declared, u: float) -> float:
    """The unknown u if its change is within the parameter's range; else the unknown that belongs to the nearer end of
    that range."""
    change = _change_from_nominal(parameter, u)
    if _unclipped_change(parameter, u) == change:
        return u
    if _only_positive(parameter):
        return float(np.log1p(max(change / parameter.nominal, -1.0 + _LEAST_FACTOR)) / _FACTOR)
    return change / (_SPREADS * parameter.spread)
