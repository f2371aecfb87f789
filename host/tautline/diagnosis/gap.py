"""The size of a gap: root mean squares, the noise below them, and how far they can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import spread
from tautline.diagnosis.segment import Segment
from tautline.independence import frames_each, less_its_trend, remembered, stretches
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_STILL_S = 0.6  # limit: a motor at rest for so long has left its own transients behind
_UNLIKE = 4.0  # tolerance: times the median rest's power: no noise any more
_OUTLIER = 8.0  # tolerance: deviations that a frame counts at most
_FEW, _ENOUGH = 6, 60  # tolerance: frames of a rest, and degrees of freedom of all rests, that tell noise
_TOGETHER, _SMOOTH = 24, 3  # tolerance: residuals across the image's path over which a misfit is of this order
_SURE = 2.0  # loss: standard errors
BLOCK_S = 8.0  # tolerance: of a manoeuvre: longer than a residual remembers
_LITTLE = 0.05  # prior: of a gap: what another motion may leave of it however little these leave
_CUT_INTO = (12, 9)  # tolerance: blocks, tried in turn where the motor's turns make none
_REMEMBERED, _ALIKE = 199, 0.02  # tolerance: lags at most, and a correlation from which there is none
_EACH_WAY = 0.2  # tolerance: share of the motion that either way must have
_OF_A_SIZE, _SHRINKS = 0.95, 0.9  # format: shares of a size's and of a shrinkage's draws that an interval holds
SURELY = 0.95  # loss: a worse model that is handed out costs as much as 19 better ones that are kept back


def rms(residuals: Sequence[Array]) -> float:
    """Root mean square over all numbers of all recordings (a coordinate of a frame each), in the residuals' unit."""
    values = np.concatenate([r.ravel() for r in residuals])
    return float(np.sqrt(np.mean(values**2)))


def noise_floor(
    segments: Sequence[Segment], residuals: Sequence[Array], across: Sequence[Array] | None = None
) -> float:
    """One standard deviation of the sensor's noise per coordinate, px or deg. From the observations while the motor
    rests, each rest less its own straight line, as first-order autoregressive noise. Where the motor hardly ever rests,
    as such noise from `across` (scored, 1), the residuals across the image's path, a few at a time less a cubic:
    nothing of the tip is there, and what else moves the image is smooth. Without an image from the second differences
    of the residuals, which a smooth misfit does not reach. Never below the rounding noise of the sensor's step: a
    sensor that rests within one step shows no noise at all."""
    least = rounding_noise(segments)
    scatter, order = _scatter(segments, across)
    return max(remembered(scatter, order)[1] if scatter else second_difference_noise(residuals), least)


def noise_samples_per_independent(
    segments: Sequence[Segment], most: float, across: Sequence[Array] | None = None
) -> float:
    """How many noise samples, cut to `most`, tell the noise's power as well as one independent Gaussian sample: above 1
    where the noise is correlated from frame to frame (factor (1 + rho^2) / (1 - rho^2)) or has outliers (kurtosis above
    3). across: as `noise_floor`."""
    scatter, order = _scatter(segments, across)
    if not scatter:
        return 1.0
    values = np.clip(np.concatenate([part.ravel() for part in scatter]), -most, most)
    memory, _ = remembered(scatter, order)
    tailed = float(np.mean(values**4)) / max(float(np.mean(values**2)) ** 2, 1e-300)
    tailed = max(tailed - _SURE * np.sqrt(24.0 / len(values)), 3.0)  # of a Gaussian: 3
    return float(0.5 * (tailed - 1.0) * (1.0 + memory**2) / (1.0 - memory**2))


def _scatter(segments: Sequence[Segment], across: Sequence[Array] | None) -> tuple[list[Array], int]:
    """What the sensor scatters: short series (n, k), each less its own trend, and that trend's order. The observations
    of each rest of the motor; where these have fewer than 60 degrees of freedom in all, `across` a few at a time."""
    rests = [
        less_its_trend(segment.arrival_s[stretch], segment.observed[stretch])
        for segment in segments
        for stretch in still_stretches(segment)
        if stretch.stop - stretch.start >= _FEW
    ]
    if sum(rest.size - 2 * rest.shape[1] for rest in rests) >= _ENOUGH:
        return _usual(rests), 1
    few = [a[first : first + _TOGETHER] for a in across or () for first in range(0, len(a) - _TOGETHER + 1, _TOGETHER)]
    return _usual([less_its_trend(np.arange(_TOGETHER, dtype=float), part, _SMOOTH) for part in few]), _SMOOTH


def _usual(series: Sequence[Array]) -> list[Array]:
    """Those that scatter as most do, outliers cut: a rest in which something happened, such as a shift, tells nothing
    of noise; a frame that is elsewhere is noise."""
    if not series:
        return []
    power = [float(np.median(np.square(each))) for each in series]
    usual = float(np.median(power))
    most = _OUTLIER * spread.deviation_of_squares(np.array(power))
    return [np.clip(each, -most, most) for each, p in zip(series, power, strict=True) if p <= _UNLIKE * usual]


def rounding_noise(segments: Sequence[Segment]) -> float:
    """One standard deviation of the rounding to the coarsest sensor's step, in the observations' unit."""
    return spread.of_rounding(max(_step(s.observed) for s in segments))


def second_difference_noise(residuals: Sequence[Array]) -> float:
    """One standard deviation of white noise by the residuals' second differences, whose variance is 6 sigma^2.
    0 where no recording has three."""
    bends = [np.diff(r, n=2, axis=0).ravel() for r in residuals if len(r) > 2]
    return spread.deviation(np.concatenate(bends)) / float(np.sqrt(6.0)) if bends else 0.0  # equation: 1, -2, 1


def _step(observed: Array) -> float:
    """The step in which a sensor counts, 0 where its values hardly repeat."""
    steps = [np.diff(np.unique(np.round(column, 9))) for column in observed.T]
    return max((float(np.median(s)) for s in steps if 0 < len(s) < len(observed) // 2), default=0.0)


def still_stretches(segment: Segment) -> list[slice]:
    """Observations while the motor and the other degrees of freedom were at rest, a slice each."""
    starts, ends = _moves(segment.motor)
    if len(starts) == 0:
        return [slice(0, len(segment.arrival_s))]
    at = np.searchsorted(ends, segment.arrival_s)
    before = np.where(at > 0, ends[np.maximum(at - 1, 0)], -np.inf)
    after = np.where(at < len(starts), starts[np.minimum(at, len(starts) - 1)], np.inf)
    # The frame's delay is well below _STILL_S: a frame counts when the motor rested before and after it.
    still = (segment.arrival_s - before > _STILL_S) & (after > segment.arrival_s)
    return stretches(still)


def _moves(motor: Motor) -> tuple[Array, Array]:
    """Times, s, from and to which the motor or another degree of freedom moved: of each such interval between two
    samples, rising."""
    moved = np.zeros(len(motor.t_s) - 1, dtype=bool)
    for values in (motor.q, motor.translation_mm, motor.rotation_deg):
        if values is not None:
            moved |= np.diff(values) != 0
    return motor.t_s[:-1][moved], motor.t_s[1:][moved]


def blocks(segment: Segment) -> npt.NDArray[np.int64]:
    """(scored,) the number of the block of manoeuvres that each scored observation is in: blocks end where the motor
    turns, after BLOCK_S at the least. Where the motor turns too rarely for every other block to hold both ways (width
    and offset are one on a single way), they are cut out of the passes, and where that cannot be, there is one."""
    t = segment.arrival_s[segment.scored]
    number = np.zeros(len(t), dtype=np.int64)
    if len(t) < 3:
        return number
    q = np.interp(t, segment.motor.t_s, segment.motor.q)
    way = np.sign(np.gradient(q))
    turns = t[1:-1][np.diff(np.sign(np.diff(q))) != 0]
    edges, last = [], t[0]
    for turn in turns:
        if turn - last >= BLOCK_S:
            edges.append(turn)
            last = turn
    for cuts in (np.array(edges), *(np.linspace(t[0], t[-1], n + 1)[1:-1] for n in _CUT_INTO)):
        number[:] = np.searchsorted(cuts, t, side="right")
        if all(_goes_both_ways(way[number % 2 == half]) for half in (0, 1)):
            return number
    return np.zeros_like(number)


def _goes_both_ways(way: Array) -> bool:
    """Whether either direction has at least a share _EACH_WAY of the moving samples. way: (n,) -1, 0 or 1."""
    moving = int(np.count_nonzero(way))
    return bool(min(np.count_nonzero(way > 0), np.count_nonzero(way < 0)) > _EACH_WAY * max(moving, 1))


def shrink_interval_elsewhere(left: float, apart: tuple[float, float]) -> tuple[float, float]:
    """90 % interval of the shrinkage 1 - after / before on a motion that was not recorded. left: after / before on the
    recorded ones. apart: the learnt 5 and 95 % quantiles of `normalised_excess` over unseen motions."""
    low, high = (left + end * _scale(left) for end in apart)
    return 1.0 - high, 1.0 - max(low, 0.0)


def normalised_excess(left: float, realised: float) -> float:
    """By how much an unseen motion left another ratio after / before (`realised`) than the recorded motions did
    (`left`), in units of `_scale`: comparable between large and small gaps."""
    return (realised - left) / _scale(left)


def _scale(left: float) -> float:
    """The typical spread of the ratio after / before between motions: proportional to the ratio, and to what was
    closed; neither factor falls below _LITTLE."""
    return (left + _LITTLE) * max(1.0 - left, _LITTLE)


def unseen(before: float, left: float, floor: float, apart: tuple[float, float]) -> float:
    """One standard deviation, px or deg, of a reading of a motion that was not recorded about its corrected prediction:
    the sensor's noise is the same, what is left beside it is more by as much as on other unseen motions. before, left:
    rms before and after the correction; floor: noise; apart: as in `shrink_interval_elsewhere`."""
    beside = float(np.sqrt(max(left**2 - floor**2, 0.0)))
    open_share = max(1.0 - beside / before, 0.0) if before > 0.0 else 0.0
    mean, deviation = 0.5 * (apart[0] + apart[1]), 0.5 * (apart[1] - apart[0]) / spread.NINE_OF_TEN
    more2 = (1.0 + mean * open_share) ** 2 + (deviation * open_share) ** 2  # equation: mean square of a normal
    return float(np.hypot(min(left, floor), beside * np.sqrt(more2)))


def residuals_per_independent(residuals: Sequence[Array]) -> float:
    """How many successive residuals tell as much as one independent one, by their autocorrelation; 1 where no recording
    is long enough."""
    long = [r - r.mean(axis=0) for r in residuals if len(r) > _REMEMBERED + 1]
    if not long:
        return 1.0
    recording = np.repeat(np.arange(len(long)), [len(r) for r in long])
    return frames_each(np.concatenate(long), _REMEMBERED, least=_ALIKE, group=recording)


def with_intervals(
    before: Sequence[Array],
    after: Sequence[Array],
    segments: Sequence[Segment],
    floor: float,
    apart: tuple[float, float],
) -> dict[str, Any]:
    """The object `gap` of diagnosis.json, with its intervals. before, after: residuals (scored, k) of each of
    `segments`. apart: as in `shrink_interval_elsewhere`; the shrinkage's interval covers blocks like the recorded ones
    and motions that were not recorded."""
    was, left = rms(before), rms(after)
    drawn = bootstrap(before, after, [blocks(segment) for segment in segments])
    own = spread.interval(1.0 - drawn[1] / drawn[0], _SHRINKS)
    other = shrink_interval_elsewhere(left / was, apart) if was > 0.0 else (0.0, 0.0)
    excess = max(was**2 - floor**2, 1e-12)
    return {
        "before": was,
        "after": left,
        "before_ci": spread.interval(drawn[0], _OF_A_SIZE),
        "after_ci": spread.interval(drawn[1], _OF_A_SIZE),
        "shrink": 1.0 - left / was if was > 0.0 else 0.0,
        "shrink_ci": [min(own[0], float(other[0])), max(own[1], float(other[1]))],
        "closable_shrink": float(np.clip(1.0 - (left**2 - floor**2) / excess, 0.0, 1.0)),
    }


def probability_of_shrinking(before: Sequence[Array], after: Sequence[Array], segments: Sequence[Segment]) -> float:
    """The probability, over bootstrap draws of the blocks, that `after` has a smaller rms than `before`."""
    drawn = bootstrap(before, after, [blocks(segment) for segment in segments])
    return float(np.mean(drawn[1] < drawn[0]))


def bootstrap(
    before: Sequence[Array], after: Sequence[Array], labels: Sequence[npt.NDArray[np.int64]], seed: int = 7
) -> Array:
    """(2, 400) rms of `before` and of `after` in each bootstrap draw of the blocks (drawn with replacement, the same
    blocks for both). labels: the block of each row of each recording."""
    sums = []
    for b, a, label in zip(before, after, labels, strict=True):
        for number in np.unique(label):
            here = label == number
            sums.append((float(np.sum(b[here] ** 2)), float(np.sum(a[here] ** 2)), int(b[here].size)))
    table = np.array(sums)
    rng = np.random.default_rng(seed)
    drawn = table[rng.integers(0, len(table), (400, len(table)))].sum(axis=1)
    result: Array = np.sqrt(drawn[:, :2] / drawn[:, 2:]).T
    return result
