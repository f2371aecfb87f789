"""How far a flexible model would close a gap: a Gaussian process that knows no physics, only what was measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import Bounds, minimize
from scipy.spatial.distance import cdist
from threadpoolctl import threadpool_limits

from tautline.diagnosis import gap
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_LENGTHS_FROM, _TRAINED_ON, _SCORED_ON = 200, 700, 3000  # tolerance: observations: for lengths, of either half, all
_RATES = np.arange(0.05, 2.0, 0.003)  # prior: Hz, of a swing: breathing, a heart, a loose mount
_HARMONICS = 6  # prior: of a motion, in which it may drive the tip
_SWINGS = 0.25  # tolerance: share of the residual's power that makes a swing
_DRIVEN, _DRIVES = 0.05, 0.4  # tolerance: of a motion's power that drive it: at its rate, at one it is a harmonic of
_SHORTEST, _LONGEST = 0.05, 20.0  # prior: length scales, of an input's standard deviation
_SIZES = 1e-3, 1e2  # prior: of a process, in what it was trained on
_JITTER = 1e-10


@dataclass(frozen=True)
class Flexible:
    """rms per coordinate of the residuals that it was given, and of what it leaves of them."""

    before: float
    after: float
    floor: float
    swing_s: float | None  # the period in which they swing, whatever motor and axes do; None where they do not

    @property
    def shrink(self) -> float:
        """Share of the residuals' rms that the process closes, 0 to 1."""
        return max(0.0, 1.0 - self.after / max(self.before, 1e-300))

    @property
    def closable_shrink(self) -> float:
        """Share of the residuals' power above the noise floor that the process closes, 0 to 1; 0 where there is
        none."""
        open_before = self.before**2 - self.floor**2
        if open_before <= 0.0:
            return 0.0
        return float(np.clip(1.0 - (self.after**2 - self.floor**2) / open_before, 0.0, 1.0))

    def to_json(self) -> dict[str, float]:
        return {
            "before": self.before,
            "after": self.after,
            "shrink": self.shrink,
            "closable_shrink": self.closable_shrink,
            **({} if self.swing_s is None else {"swing_s": self.swing_s}),
        }


def close(segments: Sequence[Segment], residuals: Sequence[Array], floor: float) -> Flexible | None:
    """Cross-validated closing of `residuals` (scored, k of each recording) by a Gaussian process of motor position,
    travel since the reversal, direction, speed, other axes, load, time and a swing's phase: each half of the blocks is
    predicted from the other half. None where a half has fewer than 50 observations. About a second."""
    swing_s = _swing_period(segments, residuals)
    inputs, half = _inputs(segments, swing_s), _halves(segments)
    seen = np.concatenate(residuals)
    if any(np.count_nonzero(half == h) < 50 for h in (0, 1)):
        return None
    inputs = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    before = after = 0.0
    count = 0
    with threadpool_limits(1):  # many small systems
        for trained in (0, 1):
            known = _thinned(np.flatnonzero(half == trained), _TRAINED_ON)
            asked = _thinned(np.flatnonzero(half != trained), _SCORED_ON // 2)
            predicted = _gp_mean(inputs[known], seen[known], floor, inputs[asked])
            before += float(np.sum(seen[asked] ** 2))
            after += float(np.sum((seen[asked] - predicted) ** 2))
            count += seen[asked].size
    return Flexible(float(np.sqrt(before / count)), float(np.sqrt(after / count)), floor, swing_s)


def _gp_mean(inputs: Array, seen: Array, floor: float, asked: Array) -> Array:
    """(m, k) Posterior mean at `asked` (m, d) of a Gaussian process trained on `seen` (n, k) at `inputs` (n, d):
    squared-exponential kernel with a length scale for each input, and white noise of at least about `floor`; the
    hyperparameters maximise the marginal likelihood of a subset."""
    scale = float(np.sqrt(np.mean(seen**2))) or 1.0
    noise = max((floor / scale) ** 2, 1e-4)
    d = inputs.shape[1]
    few = _thinned(np.arange(len(inputs)), _LENGTHS_FROM)
    start: Array = np.log(np.array([1.0, *np.ones(d), noise]))
    bounds = [_SIZES, *[(_SHORTEST, _LONGEST)] * d, (0.5 * noise, 10.0)]
    apart, shown = (inputs[few, None] - inputs[few]) ** 2, seen[few] / scale
    limits = Bounds(*np.log(bounds).T)
    minimum = minimize(  # type: ignore[call-overload]  # the stubs' jac=True takes no array of any shape
        lambda at: _negative_log_marginal(at, apart, shown), start, jac=True, method="L-BFGS-B", bounds=limits
    )
    size, lengths, white = _hyper(minimum.x)
    near = size * np.exp(-0.5 * cdist(inputs / lengths, inputs / lengths, "sqeuclidean"))
    factor = cho_factor(near + (white + _JITTER) * np.eye(len(inputs)), lower=True)
    across = size * np.exp(-0.5 * cdist(asked / lengths, inputs / lengths, "sqeuclidean"))
    predicted: Array = scale * (across @ cho_solve(factor, seen / scale))
    return predicted


def _negative_log_marginal(logs: Array, squares: Array, seen: Array) -> tuple[float, Array]:
    """The negative log marginal likelihood of `seen` (n, k) up to a constant, and its gradient by `logs`: logarithms of
    the kernel's size, the d length scales and the white noise's variance. squares (n, n, d): squared differences of the
    inputs."""
    size, lengths, white = _hyper(logs)
    smooth = size * np.exp(-0.5 * squares @ lengths**-2.0)
    factor = cho_factor(smooth + (white + _JITTER) * np.eye(len(seen)), lower=True)
    weights = cho_solve(factor, seen)
    k = seen.shape[1]
    value = 0.5 * np.sum(seen * weights) + k * np.sum(np.log(np.diag(factor[0])))
    inner = k * cho_solve(factor, np.eye(len(seen))) - weights @ weights.T  # d value = tr(inner dK) / 2
    pull = inner * smooth
    by_length = np.einsum("ij,ijk->k", pull, squares) * lengths**-2.0
    return float(value), 0.5 * np.array([np.sum(pull), *by_length, white * np.trace(inner)])


def _hyper(logs: Array) -> tuple[float, Array, float]:
    """The kernel's size, its length scales (d,) and the white noise's variance, out of their logarithms (d + 2,)."""
    values = np.exp(logs)
    return float(values[0]), values[1:-1], float(values[-1])


def _inputs(segments: Sequence[Segment], swing_s: float | None) -> Array:
    """(n, d) The process' inputs at the scored observations of all recordings; constant columns are dropped."""
    parts = []
    every = np.concatenate([segment.motor.q for segment in segments])
    span = float(np.ptp(every)) or 1.0
    for segment in segments:
        t = segment.arrival_s
        load = segment.motor.load_mNm
        columns: tuple[Array, ...] = (
            _features(segment, span),
            t + segment.offset_s,
            np.zeros_like(t) if load is None else np.interp(t, segment.motor.t_s, load),
        )
        if swing_s is not None:
            phase = 2.0 * np.pi * (t + segment.offset_s) / swing_s
            columns = (*columns, np.sin(phase), np.cos(phase))
        parts.append(np.column_stack(columns)[segment.scored])
    inputs = np.concatenate(parts)
    varies: Array = inputs[:, np.ptp(inputs, axis=0) > 1e-9]
    return varies


def _features(segment: Segment, span: float) -> Array:
    """(n, 6): motor position and travel since the reversal (0.3 at most) in shares of `span`, the range of all
    recordings, direction (-1, 0, 1), speed in ranges per second, translation in mm and rotation in deg (0 where not
    recorded)."""
    motor, t = segment.motor, segment.arrival_s
    q = np.interp(t, motor.t_s, motor.q) / span
    step = np.diff(motor.q)
    way = np.sign(step)
    turning = np.flatnonzero(way != 0)
    turns = turning[1:][np.diff(way[turning]) != 0]
    last = np.searchsorted(motor.t_s[turns], t, side="right") - 1
    start = np.where(last >= 0, motor.q[turns][np.maximum(last, 0)] if len(turns) else motor.q[0], motor.q[0]) / span
    travel = np.minimum(np.abs(q - start), 0.3)
    rate = np.gradient(q, t) if len(t) > 1 else np.zeros_like(q)
    others = [
        np.zeros_like(q) if values is None else np.interp(t, motor.t_s, values)
        for values in (motor.translation_mm, motor.rotation_deg)
    ]
    return np.column_stack([q, travel, np.sign(q - start), np.abs(rate), *others])


def _swing_period(segments: Sequence[Segment], residuals: Sequence[Array]) -> float | None:
    """The period, s, of an oscillation with at least a share _SWINGS of the residuals' power that in some recording is
    neither at the rate nor at a harmonic of the motor or another axis; None where there is none."""
    taken, driven, total = np.zeros(len(_RATES)), np.ones(len(_RATES), dtype=bool), 0.0
    for segment, residual in zip(segments, residuals, strict=True):
        at = _thinned(np.arange(len(residual)), _SCORED_ON // 2)
        t, motor = segment.arrival_s[segment.scored][at], segment.motor
        if len(t) < 10:
            continue
        axes = [np.interp(t, motor.t_s, x) for x in (motor.translation_mm, motor.rotation_deg) if x is not None]
        q = np.interp(t, motor.t_s, motor.q)
        q_moves = np.column_stack([q, np.gradient(q)])
        turned = np.exp(2j * np.pi * _RATES[:, None] * t)
        taken += np.sum(_sinusoid_shares(turned, residual[at]) * np.var(residual[at], axis=0) * len(residual), axis=1)
        here = np.max(_sinusoid_shares(turned, np.column_stack([q_moves, *axes])), axis=1) > _DRIVEN
        for k in range(2, _HARMONICS + 1):  # what follows the motor's way and stroke swings at its rate's multiples
            here |= np.max(_sinusoid_shares(np.exp(2j * np.pi * _RATES[:, None] / k * t), q_moves), axis=1) > _DRIVES
        driven &= here
        total += float(np.sum(np.var(residual[at], axis=0))) * len(residual)
    best = int(np.argmax(taken))
    if taken[best] < _SWINGS * total or driven[best]:
        return None
    return float(1.0 / _RATES[best])


def _sinusoid_shares(turned: npt.NDArray[np.complex128], values: Array) -> Array:
    """(rates, k) The share of the variance of each column of `values` (n, k) that a sinusoid of each rate explains.
    turned: exp(2 pi i rate t), (rates, n)."""
    apart = values - values.mean(axis=0)
    power = np.maximum(np.sum(apart**2, axis=0), 1e-300)
    return np.asarray(2.0 * np.abs(turned @ apart) ** 2 / (len(values) * power))


def _halves(segments: Sequence[Segment]) -> npt.NDArray[np.int64]:
    """(n,) 0 or 1: the parity of each scored observation's block of manoeuvres."""
    count, halves = 0, []
    for segment in segments:
        block = gap.blocks(segment) + count
        halves.append(block % 2)
        count = int(block.max(initial=count - 1)) + 1
    return np.concatenate(halves)


def _thinned(index: npt.NDArray[np.int64], most: int) -> npt.NDArray[np.int64]:
    """At most `most` of these indices, evenly spaced."""
    if len(index) <= most:
        return index
    return index[np.linspace(0, len(index) - 1, most).astype(np.int64)]
