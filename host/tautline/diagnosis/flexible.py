"""How far a flexible model would close a gap: Gaussian process regression of the residuals on what was measured, which
knows no physics. Residuals are (n, k) over the scored observations of all recordings, px or deg."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import Bounds, minimize
from threadpoolctl import threadpool_limits

from tautline.diagnosis import gap
from tautline.diagnosis.segment import Segment
from tautline.discrepancy import JITTER, Discrepancy, kernel
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_LENGTHS_FROM = 200  # tolerance: observations from which the hyperparameters are estimated
_TRAINED_ON = 700  # tolerance: observations of either half that the process is trained on
_SCORED_ON = 3000  # tolerance: observations of both halves that are predicted
_FEWEST = 50  # tolerance: observations of either half
_RATES = np.arange(0.05, 2.0, 0.003)  # prior: Hz, of an oscillation: breathing, a heart, a loose mount
_COHERENT_S = 160.0  # tolerance: s over which the rates' step of 0.003 Hz puts no oscillation half a period off
_FEWEST_OF_SWING = 10  # tolerance: observations that tell of an oscillation
_HARMONICS = 6  # prior: harmonics of a motion that may drive the tip
_SWINGS = 0.25  # tolerance: share of the residual's power that makes an oscillation
_DRIVEN, _DRIVES = 0.05, 0.4  # tolerance: share of a motion's power at the oscillation's rate, at a subharmonic of it
_SHORTEST, _LONGEST = 0.05, 20.0  # prior: length scales, in standard deviations of an input
_SIZES = 1e-3, 1e2  # prior: the process' variance, in mean squares of the residuals
_LEAST_NOISE, _MOST_NOISE = 1e-4, 10.0  # prior: the white noise's variance, in mean squares of the residuals
_LEAST_OF_FLOOR = 0.5  # prior: share of the floor's power below which the white noise is not
_LONGEST_TRAVEL = 0.3  # prior: of the motor's range: beyond it the last reversal is forgotten
_KEPT = 256  # tolerance: observations that a discrepancy remembers
_CONSTANT = 1e-9  # tolerance: range or standard deviation below which an input does not vary


@dataclass(frozen=True)
class Flexible:
    """What a cross-validated Gaussian process leaves of residuals. The sizes are rms per coordinate, px or deg."""

    before: float  # of the residuals
    after: float  # of what the process leaves of them on the half of the blocks that it was not trained on
    floor: float  # of the noise
    swing_s: float | None  # period, s, of an oscillation that neither motor nor axes drive; None where there is none

    @property
    def shrink(self) -> float:
        """Share of the residuals' rms that the process predicts, 0 to 1."""
        return max(0.0, gap.shrinkage(self.before, self.after))

    @property
    def closable_shrink(self) -> float:
        """Share of the residuals' power above the noise floor that the process predicts, 0 to 1; 0 where no power is
        above the floor."""
        open_before = self.before**2 - self.floor**2
        if open_before <= 0.0:
            return 0.0
        return float(np.clip(1.0 - (self.after**2 - self.floor**2) / open_before, 0.0, 1.0))

    def to_json(self) -> dict[str, float]:
        """The object `flexible` of diagnosis.json; without swing_s where there is no oscillation."""
        return {
            "before": self.before,
            "after": self.after,
            "shrink": self.shrink,
            "closable_shrink": self.closable_shrink,
            **({} if self.swing_s is None else {"swing_s": self.swing_s}),
        }


def cross_validate(segments: Sequence[Segment], residuals: Sequence[Array], floor: float) -> Flexible | None:
    """Cross-validates a Gaussian process of the residuals, (scored, k) of each recording: it is trained on either half
    of the blocks and predicts the other half. Its inputs are motor position, travel since the reversal, direction,
    speed, other axes, load, time and the phase of an oscillation, if there is one. floor: one standard deviation of the
    noise. None where a half has fewer than _FEWEST observations. It takes about a second."""
    swing_s = _swing_period(segments, residuals)
    inputs, half = _inputs(segments, swing_s), _half_of_each(segments)
    seen = np.concatenate(residuals)
    if any(np.count_nonzero(half == h) < _FEWEST for h in (0, 1)):
        return None
    inputs = (inputs - inputs.mean(axis=0)) / inputs.std(axis=0)
    before = after = 0.0
    count = 0
    with threadpool_limits(1):  # many small systems
        for trained in (0, 1):
            train = _evenly_thinned(np.flatnonzero(half == trained), _TRAINED_ON)
            test = _evenly_thinned(np.flatnonzero(half != trained), _SCORED_ON // 2)
            predicted = _gp_mean(inputs[train], seen[train], floor, inputs[test])
            before += float(np.sum(seen[test] ** 2))
            after += float(np.sum((seen[test] - predicted) ** 2))
            count += seen[test].size
    return Flexible(float(np.sqrt(before / count)), float(np.sqrt(after / count)), floor, swing_s)


def _gp_mean(inputs: Array, seen: Array, floor: float, test_inputs: Array) -> Array:
    """(m, k) Posterior mean at test_inputs (m, d) of a Gaussian process trained on `seen` (n, k) at `inputs` (n, d).
    Kernel: squared exponential with a length scale for each input; noise: white, at least about `floor`, px or deg; the
    hyperparameters are those that `_likeliest_hyperparameters` finds."""
    size, lengths, white = _likeliest_hyperparameters(inputs, seen, floor)
    own = size * kernel(inputs, inputs, lengths)
    factor = cho_factor(own + (white + JITTER) * np.eye(len(inputs)), lower=True)
    predicted: Array = size * kernel(test_inputs, inputs, lengths) @ cho_solve(factor, seen)
    return predicted


def discrepancy(inputs: Array, seen: Array, floor: float, sigma: float) -> Discrepancy:
    """Makes a Discrepancy (a Gaussian process) of `seen` (n, k) at `inputs` (n, d): with the likeliest length scales
    and white noise, remembering _KEPT evenly spaced inputs. sigma: its prior standard deviation; floor: of the noise;
    both in the unit of `seen`, px or deg."""
    few = _evenly_thinned(np.arange(len(inputs)), _KEPT)
    scale = np.maximum(inputs.std(axis=0), _CONSTANT)
    with threadpool_limits(1):  # many small systems
        _, lengths, white = _likeliest_hyperparameters(inputs / scale, seen, floor)
    return Discrepancy(sigma, inputs[few], scale * lengths, white / sigma**2)


def _likeliest_hyperparameters(inputs: Array, seen: Array, floor: float) -> tuple[float, Array, float]:
    """(Variance of the process, length scales (d,), variance of the white noise) that maximise the marginal likelihood
    of _LENGTHS_FROM evenly spaced observations of `seen` (n, k) at `inputs` (n, d), whose standard deviations are about
    1. Length scales are in units of `inputs`, variances in the square of the unit of `seen`; their ranges are _SIZES,
    _SHORTEST to _LONGEST, and from _LEAST_OF_FLOOR of the noise power floor^2 on."""
    scale = float(np.sqrt(np.mean(seen**2))) or 1.0
    noise = max((floor / scale) ** 2, _LEAST_NOISE)
    d = inputs.shape[1]
    few = _evenly_thinned(np.arange(len(inputs)), _LENGTHS_FROM)
    start: Array = np.log(np.array([1.0, *np.ones(d), noise]))
    bounds = [_SIZES, *[(_SHORTEST, _LONGEST)] * d, (_LEAST_OF_FLOOR * noise, _MOST_NOISE)]
    squared_differences, values = (inputs[few, None] - inputs[few]) ** 2, seen[few] / scale
    limits = Bounds(*np.log(bounds).T)
    minimum = minimize(  # type: ignore[call-overload]  # the stubs' jac=True takes no array of any shape
        lambda logs: _negative_log_marginal(logs, squared_differences, values),
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
    )
    size, lengths, white = _hyperparameters_of(minimum.x)
    return size * scale**2, lengths, white * scale**2


def _negative_log_marginal(logs: Array, squares: Array, seen: Array) -> tuple[float, Array]:
    """(-log p(seen) of a Gaussian process up to a constant, its gradient (d + 2,) by `logs`). seen (n, k): values, each
    column one draw; logs: logarithms of the kernel's variance, the d length scales and the white noise's variance;
    squares (n, n, d): squared differences of the inputs. With K the covariance the value is tr(seen' K^-1 seen) / 2 + k
    log|K| / 2, and its differential tr((k K^-1 - K^-1 seen seen' K^-1) dK) / 2."""
    size, lengths, white = _hyperparameters_of(logs)
    smooth = size * np.exp(-0.5 * squares @ lengths**-2.0)
    factor = cho_factor(smooth + (white + JITTER) * np.eye(len(seen)), lower=True)
    weights = cho_solve(factor, seen)
    k = seen.shape[1]
    value = 0.5 * np.sum(seen * weights) + k * np.sum(np.log(np.diag(factor[0])))
    inner = k * cho_solve(factor, np.eye(len(seen))) - weights @ weights.T
    by_size = inner * smooth
    by_length = np.einsum("ij,ijk->k", by_size, squares) * lengths**-2.0
    return float(value), 0.5 * np.array([np.sum(by_size), *by_length, white * np.trace(inner)])


def _hyperparameters_of(logs: Array) -> tuple[float, Array, float]:
    """(The kernel's variance, its length scales (d,), the white noise's variance), from their logarithms (d + 2,)."""
    values = np.exp(logs)
    return float(values[0]), values[1:-1], float(values[-1])


def _inputs(segments: Sequence[Segment], swing_s: float | None) -> Array:
    """(n, d) The process' inputs at the scored observations of all recordings: the columns of `_features`, the
    session's time, the load (0 where none was recorded), and sine and cosine of the phase of an oscillation with period
    swing_s, s, if there is one. Constant columns are dropped."""
    parts = []
    span = float(np.ptp(np.concatenate([segment.motor.q for segment in segments]))) or 1.0
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
    varies: Array = inputs[:, np.ptp(inputs, axis=0) > _CONSTANT]
    return varies


def _features(segment: Segment, span: float) -> Array:
    """(n, 6) at all observations of a recording. Motor position and travel since the last reversal (at most
    _LONGEST_TRAVEL), in shares of `span`, the range of all recordings; the sign of that travel; speed in ranges per
    second; translation in mm and rotation in deg (0 where not recorded). Before the first reversal the travel is from
    the first motor sample."""
    motor, t = segment.motor, segment.arrival_s
    q = np.interp(t, motor.t_s, motor.q) / span
    direction = np.sign(np.diff(motor.q))
    moving = np.flatnonzero(direction != 0)
    reversals = moving[1:][np.diff(direction[moving]) != 0]
    last = np.searchsorted(motor.t_s[reversals], t, side="right") - 1
    at_reversal = motor.q[reversals][np.maximum(last, 0)] if len(reversals) else motor.q[0]
    start = np.where(last >= 0, at_reversal, motor.q[0]) / span
    travel = np.minimum(np.abs(q - start), _LONGEST_TRAVEL)
    rate = np.gradient(q, t) if len(t) > 1 else np.zeros_like(q)
    others = [
        np.zeros_like(q) if values is None else np.interp(t, motor.t_s, values)
        for values in (motor.translation_mm, motor.rotation_deg)
    ]
    return np.column_stack([q, travel, np.sign(q - start), np.abs(rate), *others])


def _swing_period(segments: Sequence[Segment], residuals: Sequence[Array]) -> float | None:
    """The period, s, of the sinusoid that explains most of the residuals' power. None if it explains less than a share
    _SWINGS, or if a motion may drive it: in every recording the motor or another axis moves at its rate, or the motor
    at a subharmonic of it. Powers are summed over parts of each recording that are short enough for the grid of rates
    (`_coherent_parts`). residuals: (scored, k) of each recording."""
    explained, driven, total = np.zeros(len(_RATES)), np.ones(len(_RATES), dtype=bool), 0.0
    for segment, residual in zip(segments, residuals, strict=True):
        scored_s = segment.arrival_s[segment.scored]
        parts = [part for part in _coherent_parts(scored_s) if len(part) >= _FEWEST_OF_SWING]
        driven_here = np.zeros_like(driven)
        for part in parts:
            kept = _evenly_thinned(part, _SCORED_ON // 2)
            variance = np.var(residual[kept], axis=0)
            shares = _sinusoid_shares(_waves(scored_s[kept]), residual[kept])
            explained += np.sum(shares * variance * len(part), axis=1)
            total += float(np.sum(variance)) * len(part)
            driven_here |= _is_driven(segment.motor, scored_s[kept])
        if parts:
            driven &= driven_here
    best = int(np.argmax(explained))
    if total <= 0.0 or explained[best] < _SWINGS * total or driven[best]:
        return None
    return float(1.0 / _RATES[best])


def _coherent_parts(t_s: Array) -> list[npt.NDArray[np.int64]]:
    """Splits the indices 0 .. n - 1 of rising times t_s (n,), s, into parts of equal duration, _COHERENT_S at most; []
    without times."""
    if len(t_s) == 0:
        return []
    count = int(np.ceil((t_s[-1] - t_s[0]) / _COHERENT_S)) or 1
    ends = np.searchsorted(t_s, np.linspace(t_s[0], t_s[-1], count + 1)[1:-1])
    return np.split(np.arange(len(t_s)), ends)


def _is_driven(motor: Motor, t_s: Array) -> npt.NDArray[np.bool_]:
    """(rates,) Whether at each of _RATES the motor or another axis moves with more than a share _DRIVEN of its power,
    or the motor at a subharmonic of it with more than a share _DRIVES. t_s: times (n,), s, at which the motion is
    taken."""
    axes = [np.interp(t_s, motor.t_s, x) for x in (motor.translation_mm, motor.rotation_deg) if x is not None]
    q = np.interp(t_s, motor.t_s, motor.q)
    q_and_speed = np.column_stack([q, np.gradient(q)])
    moved = np.column_stack([q_and_speed, *axes])
    driven: npt.NDArray[np.bool_] = np.max(_sinusoid_shares(_waves(t_s), moved), axis=1) > _DRIVEN
    for k in range(2, _HARMONICS + 1):  # what depends on the motor's direction oscillates at harmonics of its rate
        driven |= np.max(_sinusoid_shares(_waves(t_s, k), q_and_speed), axis=1) > _DRIVES
    return driven


def _waves(t_s: Array, subharmonic: int = 1) -> npt.NDArray[np.complex128]:
    """(rates, n) exp(2 pi i f t) at the times t_s (n,), s, for the frequencies f = _RATES / subharmonic, Hz."""
    return np.asarray(np.exp(2j * np.pi * _RATES[:, None] / subharmonic * t_s))


def _sinusoid_shares(waves: npt.NDArray[np.complex128], values: Array) -> Array:
    """(rates, k) Share of the variance of each column x of `values` (n, k), less its mean, that a sinusoid of each rate
    explains: 2 |sum(wave x)|^2 / (n sum(x^2)). waves: exp(2 pi i rate t), (rates, n)."""
    centred = values - values.mean(axis=0)
    power = np.maximum(np.sum(centred**2, axis=0), 1e-300)
    return np.asarray(2.0 * np.abs(waves @ centred) ** 2 / (len(values) * power))


def _half_of_each(segments: Sequence[Segment]) -> npt.NDArray[np.int64]:
    """(n,) For each scored observation of all recordings the half, 0 or 1, that it belongs to: blocks of manoeuvres
    alternate between the halves, counted through all recordings."""
    count, halves = 0, []
    for segment in segments:
        block = gap.blocks(segment) + count
        halves.append(block % 2)
        count = int(block.max(initial=count - 1)) + 1
    return np.concatenate(halves)


def _evenly_thinned(index: npt.NDArray[np.int64], most: int) -> npt.NDArray[np.int64]:
    """At most `most` of the indices, evenly spaced, the first and the last included."""
    if len(index) <= most:
        return index
    return index[np.linspace(0, len(index) - 1, most).astype(np.int64)]
