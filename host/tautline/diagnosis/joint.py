"""All parameters of a user's simulator at once, with what of the library is behind its tip: a play, its law, a delay.

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
from tautline.model import Effect, Model, monotone
from tautline.simulators.simulator import Declared

Array = npt.NDArray[np.float64]
Indices = npt.NDArray[np.int64]

WIDTH, LAW, DELAY = "transmission.backlash", "configuration.remaining", "acquisition.delay"
_FACTOR = 1.0  # of a positive parameter's logarithm, one standard deviation: published values differ by more than twice
_SPREADS = 3.0  # prior: of another one's declared spread
_WIDTH = 0.02  # prior: of the motor's range
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
        """Of a square."""
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
        sizes = {simulator_id(p.name): 1 for p in self.parameters} | {WIDTH: 1, LAW: _ORDER + 1, DELAY: 1}
        ends = np.cumsum([0, *sizes.values()])
        return tuple(Unknown(name, np.arange(a, b)) for name, a, b in zip(sizes, ends[:-1], ends[1:], strict=True))

    @property
    def size(self) -> int:
        return sum(len(unknown.places) for unknown in self.unknowns)

    def changes(self, u: Array) -> dict[str, float]:
        """The changes of the simulator's parameters from their declared values, by effect id, in their own units."""
        return {simulator_id(p.name): _change(p, float(x)) for p, x in zip(self.parameters, u, strict=False)}

    def model_at(self, u: Array) -> Model:
        """The model with these unknowns u (m,), the simulator's changes as its effects."""
        width, law, delay = (u[unknown.places] for unknown in self.unknowns[len(self.parameters) :])
        model = self.model
        added = tuple(Effect(name, {name: value}) for name, value in self.changes(u).items() if value)
        return replace(
            model,
            width=model.width + max(0.0, _WIDTH * model.rig.actuator.span * float(width[0])),
            c_deg=monotone(model.c_deg + _LAW_DEG * self._law @ law),
            delay_s=model.delay_s + _DELAY_S * float(delay[0]),
            effects=added,
        )

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
        width = self.unknowns[len(self.parameters)].places
        kept[width] = np.maximum(kept[width], 0.0)
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
