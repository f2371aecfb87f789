"""All parameters of a user's simulator at once, with what of the library is behind its tip: a play, its law, a delay.

The play is friction in a servo's gears as well: its width bends over the place, as a load does, and is another one at
speed than at rest (Stribeck).

Every unknown is a standard normal before anything is seen: a positive parameter by its logarithm, any other in shares
of a change that a user would notice. What is left remembers: as many readings as it takes to forget count as one, so
that what the model lacks is no evidence for its parameters. They are not whitened: that would fit the fastest of it,
which is where the model lacks most.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

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
BENDS = "bends"  # of the width over the place: no name of its own, the play has it
_FACTOR = 1.0  # of a positive parameter's logarithm, one standard deviation: published values differ by more than twice
_SPREADS = 3.0  # prior: of another one's declared spread
_WIDTH = 0.02  # prior: of the motor's range, and of what speed adds or takes
_BENDS, _BEND = 2, 0.3  # prior: order of the polynomial of its logarithm over the place, and each coefficient's
_USUAL = 0.1  # equation: of the range per second, the library's unit of speed
_SATURATION = 3.0  # prior: half of what speed does is there at a quarter of that unit: Stribeck's speed of small gears
_SPEED_S = 0.02  # prior: the library's, in which a width follows the speed
_ORDER, _LAW_DEG = 5, 3.0  # prior: of the law's polynomial, and each coefficient's
_DELAY_S = 0.05  # prior: what a bus, a filter or a servo takes, beyond the calibration's
_DIFFERENCE = 0.01  # tolerance: of a standard deviation
_ROUNDS, _STEPS = 3, 12  # tolerance: at most, of an optimum that is found
_SMALL_GAIN = 0.02  # tolerance: of twice a logarithm of a probability


@dataclass(frozen=True)
class Unknown:
    """Numbers that are there or not together: of an effect's id, at these places of the vector."""

    id: str
    places: Indices


@dataclass(frozen=True)
class Noise:
    """Of one reading, one standard deviation, and how many readings count as one."""

    sigma: float
    each: float

    @classmethod
    def of(cls, residuals: Sequence[Array], floor: float) -> Noise:
        """From residuals: their rms, at least the floor, and their autocorrelation."""
        return cls(max(gap.rms(residuals), floor), gap.residuals_per_independent(residuals))

    @property
    def weight(self) -> float:
        """What a squared residual adds to minus twice the log-likelihood: `each` of them count as one."""
        return 1.0 / (self.each * self.sigma**2)


@dataclass(frozen=True)
class _Point:
    u: Array  # (m,)
    residuals: list[Array]  # of each recording, (scored, k)


@dataclass(frozen=True)
class Fitted:
    """u has `posterior`'s mean; residuals and slopes are those there."""

    posterior: Posterior
    noise: Noise
    residuals: list[Array]  # of each recording, (scored, k)
    slopes: list[Array]  # (scored, k, m) of what is predicted
    free: Indices  # places that are not held at an end of their range

    @property
    def u(self) -> Array:
        """(m,) The unknowns at the posterior's maximum, in standard deviations of their prior."""
        return self.posterior.mean


class Joint:
    """Unknowns of a simulator behind recordings."""

    def __init__(self, model: Model, parameters: Sequence[Declared], segments: Sequence[Segment], floor: float) -> None:
        """segments: the robot's, each with its drive. floor: the sensor's noise, in the observations' unit."""
        self.model, self.parameters, self.segments, self.floor = model, tuple(parameters), list(segments), floor
        low = min(float(s.motor.q.min()) for s in segments)
        high = max(float(s.motor.q.max()) for s in segments)
        within = np.clip((2.0 * model.q - low - high) / max(high - low, 1e-9), -1.0, 1.0)
        self._law = np.polynomial.chebyshev.chebvander(within, _ORDER)  # beyond what was reached as at its ends

    @cached_property
    def unknowns(self) -> tuple[Unknown, ...]:
        """In the order of the vector u: the simulator's parameters, then width, law, delay, speed and bends."""
        sizes = {simulator_id(p.name): 1 for p in self.parameters} | {
            WIDTH: 1,
            LAW: _ORDER + 1,
            DELAY: 1,
            SPEED: 1,
            BENDS: _BENDS,
        }
        ends = np.cumsum([0, *sizes.values()])
        return tuple(Unknown(name, np.arange(a, b)) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True))

    @property
    def size(self) -> int:
        """Length of the vector u."""
        return sum(len(unknown.places) for unknown in self.unknowns)

    @cached_property
    def places(self) -> dict[str, Indices]:
        """Indices in the vector u, by the id of the unknown."""
        return {unknown.id: unknown.places for unknown in self.unknowns}

    def effects(self, u: Array) -> tuple[Effect, ...]:
        """What is not in the model's tables: the simulator's parameters, and what speed does to the play."""
        changes = {simulator_id(p.name): _change(p, float(x)) for p, x in zip(self.parameters, u, strict=False)}
        found = [Effect(name, {name: value}) for name, value in changes.items() if value]
        speed = float(u[self.places[SPEED]][0])
        if speed:
            per = _WIDTH * speed / _USUAL * -float(np.expm1(-_SATURATION))  # of `speed` at great speeds
            own = {"width_per_speed": per, "speed_saturation": _SATURATION, "speed_time": _SPEED_S, "width_held": 1.0}
            found.append(Effect(SPEED, own))
        return tuple(found)

    def changes(self, u: Array) -> dict[str, float]:
        """The parameters of all effects at u (m,), by name, in their own units: the simulator's as changes."""
        return {name: value for effect in self.effects(u) for name, value in effect.parameters.items()}

    def model_at(self, u: Array) -> Model:
        """The model with these unknowns u (m,), the simulator's changes and what speed does as its effects."""
        model = self.model
        return replace(
            model,
            width=allowed_width(model.q, model.width + _WIDTH * model.rig.actuator.span * self._widths(u)),
            c_deg=monotone(model.c_deg + _LAW_DEG * self._law @ u[self.places[LAW]]),
            delay_s=model.delay_s + _DELAY_S * float(u[self.places[DELAY]][0]),
            effects=self.effects(u),
        )

    def _widths(self, u: Array) -> Array:
        """(grid,) What u (m,) adds to the play's width with the motor at rest, in units of _WIDTH times the motor's
        range: a number, never negative, times the exponential of a polynomial of the place."""
        bent = _BEND * self._law[:, 1 : 1 + _BENDS] @ u[self.places[BENDS]]
        return np.asarray(max(float(u[self.places[WIDTH]][0]), 0.0) * np.exp(bent))

    def law_slopes(self) -> Array:
        """(grid, coefficients) d c_deg / d coefficient of the law, deg, on the model's grid."""
        return np.asarray(_LAW_DEG * self._law)

    def residuals(self, u: Array) -> list[Array]:
        """Observed less predicted, (scored, k) for each recording, at u (m,)."""
        model, changes = self.model_at(u), self.changes(u)
        told = [s.predict(model, changes, 0.0)[1] for s in self.segments]
        return [(s.observed - seen)[s.scored] for s, seen in zip(self.segments, told, strict=True)]

    def slopes(self, u: Array, residuals: Sequence[Array]) -> list[Array]:
        """d prediction / d u, (scored, k, m) for each recording, by difference quotients that stay within the
        parameters' ranges."""
        steps = []
        for step in _DIFFERENCE * np.eye(len(u)):
            steps.append(step if np.array_equal(self._clipped(u + step), u + step) else -step)
        for step in steps:
            for segment in self.segments:
                segment.ask(self.changes(u + step))
        columns = [np.zeros((*r.shape, len(u))) for r in residuals]
        for i, step in enumerate(steps):
            for column, then, now in zip(columns, self.residuals(u + step), residuals, strict=True):
                column[:, :, i] = (now - then) / step[i]
        return columns

    def fit(self, progress: Callable[[float], None] = lambda share: None) -> Fitted:
        """The maximum of the posterior over all unknowns, starting at the simulator as it is; the noise is estimated
        anew between rounds."""
        u = np.zeros(self.size)
        point = _Point(u, self.residuals(u))
        noise = Noise.of(point.residuals, self.floor)
        for i in range(_ROUNDS):
            point = descend(_Descent(self, noise), point, _STEPS)
            noise = Noise.of(point.residuals, self.floor)
            progress((i + 1) / _ROUNDS)
        return self._laplace(point, noise)

    def _laplace(self, point: _Point, noise: Noise) -> Fitted:
        """The posterior's normal approximation at its maximum; unknowns at an end of their range have variance 0."""
        slopes = self.slopes(point.u, point.residuals)
        matrix, gradient = _normal_equations(noise, point, slopes)
        free = np.flatnonzero(~_at_bound(self, point.u, gradient))
        names = tuple(f"{unknown.id}:{i}" for unknown in self.unknowns for i in range(len(unknown.places)))
        covariance = np.zeros((self.size, self.size))
        covariance[np.ix_(free, free)] = np.linalg.inv(matrix[np.ix_(free, free)])
        return Fitted(Posterior(names, point.u, covariance), noise, point.residuals, slopes, free)

    def _clipped(self, u: Array) -> Array:
        """u with every parameter clipped to its range, and the play not negative."""
        kept = u.copy()
        kept[: len(self.parameters)] = [
            _unknown_of_change(p, _change(p, float(x)), float(x)) for p, x in zip(self.parameters, u, strict=False)
        ]
        width, speed = self.places[WIDTH], self.places[SPEED]
        kept[width] = np.maximum(kept[width], 0.0)
        kept[speed] = np.maximum(kept[speed], -np.min(self._widths(kept)))
        return kept


class _Descent:
    """The unknowns as a least-squares problem, of readings' residuals and standard normals."""

    def __init__(self, joint: Joint, noise: Noise) -> None:
        self.joint, self.noise = joint, noise

    def linearised(self, point: _Point) -> tuple[Array, Array, float]:
        """Normal matrix, gradient and cost at a point; unknowns at a bound are held."""
        slopes = self.joint.slopes(point.u, point.residuals)
        matrix, gradient = _normal_equations(self.noise, point, slopes)
        held = np.flatnonzero(_at_bound(self.joint, point.u, gradient))
        matrix[held, :] = matrix[:, held] = gradient[held] = 0.0
        matrix[held, held] = 1.0
        return matrix, gradient, _cost(self.noise, point)

    def moved(self, point: _Point, step: Array) -> _Point:
        u = self.joint._clipped(point.u + step)
        return _Point(u, self.joint.residuals(u))

    def cost(self, point: _Point) -> float:
        return _cost(self.noise, point)

    def enough(self, gained: float, cost: float) -> bool:
        """Whether a step that lowered `cost` by `gained` was the last."""
        return gained < _SMALL_GAIN


def _cost(noise: Noise, point: _Point) -> float:
    """Minus twice the log of likelihood times prior, up to a constant."""
    return noise.weight * sum(float(np.sum(r**2)) for r in point.residuals) + float(point.u @ point.u)


def _normal_equations(noise: Noise, point: _Point, slopes: Sequence[Array]) -> tuple[Array, Array]:
    """Normal matrix (m, m) of likelihood and standard-normal prior, and the gradient (m,) that lowers the cost."""
    matrix, gradient = np.eye(len(point.u)), -point.u.copy()
    for residual, slope in zip(point.residuals, slopes, strict=True):
        flat = slope.reshape(-1, slope.shape[2])
        matrix += noise.weight * flat.T @ flat
        gradient += noise.weight * flat.T @ residual.ravel()
    return matrix, gradient


def _at_bound(joint: Joint, u: Array, gradient: Array) -> npt.NDArray[np.bool_]:
    """(m,) Whether each unknown is at an end of its range and the gradient points beyond."""
    onward = u + np.sign(gradient) * 1e-6
    return np.asarray(joint._clipped(onward) != onward)


def _positive(parameter: Declared) -> bool:
    """Whether a parameter is positive by its meaning: its unknown is then the logarithm of a factor on it."""
    return parameter.nominal > 0.0 and parameter.low >= 0.0


def _change(parameter: Declared, u: float) -> float:
    """A parameter's change, own unit, for its unknown u: on a log scale where it is positive, else linear; clipped to
    its range."""
    off = parameter.nominal * np.expm1(_FACTOR * u) if _positive(parameter) else _SPREADS * parameter.spread * u
    return float(np.clip(off, parameter.low - parameter.nominal, parameter.high - parameter.nominal))


def _unknown_of_change(parameter: Declared, change: float, u: float) -> float:
    """The unknown that gives `change`: u itself, or that of the range's end where u was clipped."""
    if _positive(parameter):
        free = parameter.nominal * np.expm1(_FACTOR * u)
        return u if free == change else float(np.log1p(max(change / parameter.nominal, -1.0 + 1e-9)) / _FACTOR)
    return u if _SPREADS * parameter.spread * u == change else change / (_SPREADS * parameter.spread)
