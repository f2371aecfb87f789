"""The size of a gap: root mean squares of residuals, the sensor's noise, and intervals of both.

Residuals are (scored, k) of each recording: scored observations, k = 2 px or k = 1 deg. The noise floor is one standard
deviation of the noise of a coordinate, px or deg.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import spread
from tautline.core import samples
from tautline.diagnosis.segment import Segment
from tautline.independence import frames_each, less_its_trend, remembered, stretches
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_STILL_S = 0.6  # limit: s of rest after which the motor's own transients are over
_NO_NOISE = 4.0  # tolerance: times the median power of all rests: one that scatters more is not only noise
_OUTLIER = 8.0  # tolerance: standard deviations to which a frame is cut
_FEWEST_FRAMES, _ENOUGH = 6, 60  # tolerance: frames of a rest, degrees of freedom of all rests, that tell the noise
# Of them 35 / 18 count as one by their squares' correlation, and a median tells as much as a share 0.37 of the squares.
_OF_SECOND_DIFFERENCES = 5.2  # equation: whose median tells a deviation as well as one white sample does
_DECIMALS = 9  # tolerance: of px or deg, to which two readings are the same
_PIECE, _PIECE_ORDER = 24, 3  # tolerance: frames of a piece, order of the polynomial that a misfit is over it
_STANDARD_ERRORS = 2.0  # loss: by which the kurtosis must exceed a Gaussian's to count
BLOCK_S = 8.0  # tolerance: s of a block of manoeuvres: longer than residuals are correlated
_LEAST_LEFT = 0.05  # prior: share of a gap that another motion may leave however little the recorded ones leave
_FEWEST_BLOCKS = 4  # tolerance: of a recording: with a calibration and a test the eight that a verdict needs
_TO_A_TURN = 0.25  # tolerance: share of a block by which its end moves: none is shorter than half of an equal one
_MOST_PARTS = 12  # tolerance: equal parts of a recording whose motor turns too seldom
_LONGEST_LAG, _UNCORRELATED = 199, 0.02  # tolerance: lags of an autocorrelation at most, value that ends the sum
_EACH_WAY = 0.2  # tolerance: share of the motion that either direction must have
_DRAWS, _SEED = 400, 7  # tolerance: of a bootstrap
_LEAST_EXCESS = 1e-12  # tolerance: px^2 or deg^2: keeps a division by the power above the noise finite
_SIZE_SHARE, _SHRINK_SHARE = 0.95, 0.9  # format: shares of the draws that the interval of a size, a shrinkage holds
SURELY = 0.95  # loss: a worse model that is handed out costs as much as 19 better ones that are kept back


def rms(residuals: Sequence[Array]) -> float:
    """Root mean square over all coordinates of all frames of all recordings, in the residuals' unit."""
    values = np.concatenate([r.ravel() for r in residuals])
    return float(np.sqrt(np.mean(values**2)))


def shrinkage(before: float, after: float) -> float:
    """1 - after / before of the rms of a gap; negative where the gap grows, 0 where `before` is 0."""
    return 1.0 - after / before if before > 0.0 else 0.0


def noise_floor(
    segments: Sequence[Segment],
    residuals: Sequence[Array],
    across: Sequence[Array] | None = None,
    relative: Sequence[float] | None = None,
) -> float:
    """One standard deviation of the sensor's noise per coordinate, px or deg, at least `least_noise`. It is taken from
    the first of these sources that has enough samples. (1) The observations while the motor rests, each rest less a
    straight line. (2) `across` (scored, 1) px of each recording, the residuals across the image's path, in short pieces
    less a cubic: the tip's motion does not show there, and what else moves the image is smooth. (3) The second
    differences of the residuals, in which a smooth misfit vanishes. In the first two the noise is autoregressive of
    first order. relative: how many times as noisy as the tests each recording is (`relative_noise`); default 1."""
    series, order = _noise_series(segments, across, relative)
    each = relative or [1.0] * len(residuals)
    if series:
        seen = remembered(series, order)[1]
    else:
        seen = second_difference_noise([r / times for r, times in zip(residuals, each, strict=True)])
    return max(seen, least_noise(segments))


def relative_noise(segments: Sequence[Segment], across: Sequence[Array] | None) -> list[float]:
    """For each recording how many times as noisy the sensor is as in the tests (rms over them), by the white noise of
    `across` (as in `noise_floor`). All 1 without an image or with fewer than _ENOUGH frames in a recording, and where
    by the Schwarz criterion one noise for all is likelier than one for each."""
    if not across or min(len(each) for each in across) < _ENOUGH:
        return [1.0] * len(segments)
    count = np.array([len(each) for each in across]) / _OF_SECOND_DIFFERENCES  # white samples that tell as much
    least = samples.least_noise(segments[0].unit)
    power = np.array([max(second_difference_noise([each]), least) ** 2 for each in across])
    # Twice the gain in log likelihood by a noise for each recording: sum of n log(pooled power / own power). Schwarz:
    # each of the additional noises costs the log of the number of samples.
    gain = float(count @ np.log(count @ power / count.sum() / power))
    if gain < (len(segments) - 1) * np.log(count.sum()):
        return [1.0] * len(segments)
    of_tests = np.mean([p for p, segment in zip(power, segments, strict=True) if not segment.calibration] or power)
    return [float(times) for times in np.sqrt(power / of_tests)]


def noise_samples_per_independent(
    segments: Sequence[Segment],
    limit: float,
    across: Sequence[Array] | None = None,
    relative: Sequence[float] | None = None,
) -> float:
    """How many noise samples, cut to `limit` (px or deg), determine the noise's power as well as one independent
    Gaussian sample does: (kurtosis - 1) / 2 (1 + rho^2) / (1 - rho^2), with rho the correlation from frame to frame.
    The kurtosis counts as a Gaussian's, 3, unless it is clearly larger. 1 where no noise is seen. across, relative: as
    in `noise_floor`."""
    series, order = _noise_series(segments, across, relative)
    if not series:
        return 1.0
    values = np.clip(np.concatenate([part.ravel() for part in series]), -limit, limit)
    rho, _ = remembered(series, order)
    kurtosis = float(np.mean(values**4)) / max(float(np.mean(values**2)) ** 2, 1e-300)
    error = np.sqrt(24.0 / len(values))  # equation: standard error of a Gaussian's kurtosis
    kurtosis = max(kurtosis - _STANDARD_ERRORS * error, 3.0)  # equation: a Gaussian's is 3
    return float(0.5 * (kurtosis - 1.0) * (1.0 + rho**2) / (1.0 - rho**2))


def _noise_series(
    segments: Sequence[Segment], across: Sequence[Array] | None, relative: Sequence[float] | None
) -> tuple[list[Array], int]:
    """(Short series (n, k) of the sensor's noise, px or deg, without outliers; order of the polynomial trend that was
    subtracted from each, which costs degrees of freedom). The series are the observations of each rest of the motor
    (trend of order 1) or, where these have fewer than _ENOUGH degrees of freedom in all, pieces of _PIECE frames of
    `across` (order _PIECE_ORDER). across, relative: as in `noise_floor`; a recording's series are divided by its
    relative noise."""
    each = relative or [1.0] * len(segments)
    rests = [
        less_its_trend(segment.arrival_s[stretch], segment.observed[stretch] / times)
        for segment, times in zip(segments, each, strict=True)
        for stretch in still_stretches(segment)
        if stretch.stop - stretch.start >= _FEWEST_FRAMES
    ]
    # A straight line costs two degrees of freedom of each coordinate.
    if sum(rest.size - 2 * rest.shape[1] for rest in rests) >= _ENOUGH:
        return _without_outliers(rests), 1
    pieces = [
        a[first : first + _PIECE] / times
        for a, times in zip(across or (), each, strict=across is not None)
        for first in range(0, len(a) - _PIECE + 1, _PIECE)
    ]
    frames = np.arange(_PIECE, dtype=float)
    return _without_outliers([less_its_trend(frames, piece, _PIECE_ORDER) for piece in pieces]), _PIECE_ORDER


def _without_outliers(series: Sequence[Array]) -> list[Array]:
    """The series (n, k) without those whose median square is above _NO_NOISE times the usual one, as something happened
    in them, such as a shift; in the others single frames are cut to _OUTLIER standard deviations."""
    if not series:
        return []
    power = [float(np.median(np.square(values))) for values in series]
    usual = float(np.median(power))
    limit = _OUTLIER * spread.deviation_of_squares(np.array(power))
    return [np.clip(values, -limit, limit) for values, p in zip(series, power, strict=True) if p <= _NO_NOISE * usual]


def least_noise(segments: Sequence[Segment]) -> float:
    """One standard deviation, px or deg, of the noise that is assumed where none is seen. It is that of rounding to the
    coarsest step of the sensor in these recordings, as a resting sensor shows none within a step; at least the smallest
    noise that any sensor is taken to have."""
    step = max(_sensor_step(segment.observed) for segment in segments)
    return max(spread.of_rounding(step), samples.least_noise(segments[0].unit))


def second_difference_noise(residuals: Sequence[Array]) -> float:
    """One standard deviation, px or deg, of white noise, from the second differences of the residuals (n, k) of each
    recording, whose variance is 6 sigma^2. 0 where no recording has three residuals."""
    differences = [np.diff(r, n=2, axis=0).ravel() for r in residuals if len(r) > 2]
    if not differences:
        return 0.0
    return spread.deviation(np.concatenate(differences)) / float(np.sqrt(6.0))  # equation: 1^2 + (-2)^2 + 1^2


def _sensor_step(observed: Array) -> float:
    """The step in which a sensor counts, px or deg: the median difference between its distinct values, of the coarser
    coordinate. 0 where at least half of the values are distinct, so that no step shows. observed: (n, k)."""
    steps = [np.diff(np.unique(np.round(column, _DECIMALS))) for column in observed.T]
    return max((float(np.median(s)) for s in steps if 0 < len(s) < len(observed) // 2), default=0.0)


def still_stretches(segment: Segment) -> list[slice]:
    """The rests of a recording as slices of its observations. An observation is at rest if the motor and the other axes
    rested for the _STILL_S before its arrival and have not moved again by then."""
    starts, ends = _moving_intervals(segment.motor)
    if len(starts) == 0:
        return [slice(0, len(segment.arrival_s))]
    index = np.searchsorted(ends, segment.arrival_s)
    last_move = np.where(index > 0, ends[np.maximum(index - 1, 0)], -np.inf)
    next_move = np.where(index < len(starts), starts[np.minimum(index, len(starts) - 1)], np.inf)
    # A frame's delay is well below _STILL_S, so the motor rested at its scene time too.
    still = (segment.arrival_s - last_move > _STILL_S) & (next_move > segment.arrival_s)
    return stretches(still)


def _moving_intervals(motor: Motor) -> tuple[Array, Array]:
    """(Starts, ends), s, rising, of those intervals between neighbouring motor samples in which the motor or another
    axis moved."""
    moved = np.zeros(len(motor.t_s) - 1, dtype=bool)
    for values in (motor.q, motor.translation_mm, motor.rotation_deg):
        if values is not None:
            moved |= np.diff(values) != 0
    return motor.t_s[:-1][moved], motor.t_s[1:][moved]


def blocks(segment: Segment) -> npt.NDArray[np.int64]:
    """(scored,) For each scored observation the number, from 0, of its block of manoeuvres. Equal parts of about
    BLOCK_S, at least _FEWEST_BLOCKS, end where the motor turns, stops or starts, if it does so within a share
    _TO_A_TURN of a part. Even and odd blocks must each contain both directions of motion, as one direction does not
    tell a width from an offset. If they do not, equal parts without that shift are tried, with more and more parts up
    to _MOST_PARTS; if none fits, the recording is one block."""
    t = segment.arrival_s[segment.scored]
    number = np.zeros(len(t), dtype=np.int64)
    if len(t) < 3:
        return number
    q = np.interp(t, segment.motor.t_s, segment.motor.q)
    direction = np.sign(np.gradient(q))
    turns_s = t[1:-1][np.diff(np.sign(np.diff(q))) != 0]
    count = max(int((t[-1] - t[0]) / BLOCK_S), _FEWEST_BLOCKS)
    at_turns = _cuts_moved_to_turns(_equal_cuts(t, count), turns_s, _TO_A_TURN * (t[-1] - t[0]) / count)
    for cuts in (at_turns, *(_equal_cuts(t, n) for n in range(count, max(count, _MOST_PARTS) + 1))):
        number[:] = np.searchsorted(cuts, t, side="right")
        if all(_goes_both_ways(direction[number % 2 == half]) for half in (0, 1)):
            return number
    return np.zeros_like(number)


def _equal_cuts(t_s: Array, count: int) -> Array:
    """(count - 1,) Times, s, that divide the interval from the first to the last of t_s (n,) into `count` equal
    parts."""
    return np.linspace(t_s[0], t_s[-1], count + 1)[1:-1]


def _cuts_moved_to_turns(equal: Array, turns_s: Array, most_s: float) -> Array:
    """The dividing times `equal` (n,), s, each replaced by the nearest of the motor's turns (m,), s, if that is within
    most_s."""
    if len(turns_s) == 0:
        return equal
    nearest = turns_s[np.argmin(np.abs(turns_s - equal[:, None]), axis=1)]
    return np.where(np.abs(nearest - equal) <= most_s, nearest, equal)


def _goes_both_ways(direction: Array) -> bool:
    """Whether each direction has more than a share _EACH_WAY of the moving samples. direction: (n,) -1, 0 (at rest) or
    1."""
    moving = int(np.count_nonzero(direction))
    fewer = min(np.count_nonzero(direction > 0), np.count_nonzero(direction < 0))
    return bool(fewer > _EACH_WAY * max(moving, 1))


def shrink_interval_elsewhere(ratio: float, excess: tuple[float, float]) -> tuple[float, float]:
    """(Low, high) end of the 90 % interval of the shrinkage 1 - after / before on a motion that was not recorded.
    ratio: after / before on the recorded motions. excess: learnt 5 and 95 % quantiles of `normalised_excess` over
    unseen motions."""
    low, high = (ratio + end * _ratio_spread(ratio) for end in excess)
    return 1.0 - high, 1.0 - max(low, 0.0)


def normalised_excess(ratio: float, realised: float) -> float:
    """How much larger the ratio after / before is on an unseen motion (`realised`) than on the recorded ones (`ratio`),
    in units of `_ratio_spread(ratio)`, so that large and small gaps compare."""
    return (realised - ratio) / _ratio_spread(ratio)


def _ratio_spread(ratio: float) -> float:
    """The typical spread between motions of the ratio r = after / before: (r + e) max(1 - r, e) with e = _LEAST_LEFT,
    proportional to what is left and to what was closed."""
    return (ratio + _LEAST_LEFT) * max(1.0 - ratio, _LEAST_LEFT)


def unseen(before: float, after: float, floor: float, excess: tuple[float, float]) -> float:
    """One standard deviation, px or deg, of a reading of an unseen motion about its corrected prediction: the sensor's
    noise is as before, and the misfit above it grows as it did on other unseen motions. before, after: rms before and
    after the correction; floor: of the noise; excess: 5 and 95 % quantiles as in `shrink_interval_elsewhere`, taken as
    those of a normal distribution."""
    misfit = float(np.sqrt(max(after**2 - floor**2, 0.0)))
    closed = max(1.0 - misfit / before, 0.0) if before > 0.0 else 0.0
    mean, deviation = 0.5 * (excess[0] + excess[1]), 0.5 * (excess[1] - excess[0]) / spread.NINE_OF_TEN
    factor2 = (1.0 + mean * closed) ** 2 + (deviation * closed) ** 2  # equation: mean square of a normal variable
    return float(np.hypot(min(after, floor), misfit * np.sqrt(factor2)))


def residuals_per_independent(residuals: Sequence[Array]) -> float:
    """How many successive residuals tell as much as one independent one: 1 + 2 times the sum of their autocorrelation.
    Only recordings longer than _LONGEST_LAG count; 1 where there are none. residuals: (n, k) of each recording."""
    long = [r - r.mean(axis=0) for r in residuals if len(r) > _LONGEST_LAG + 1]
    if not long:
        return 1.0
    recording = np.repeat(np.arange(len(long)), [len(r) for r in long])
    return frames_each(np.concatenate(long), _LONGEST_LAG, least=_UNCORRELATED, group=recording)


def with_intervals(
    before: Sequence[Array],
    after: Sequence[Array],
    segments: Sequence[Segment],
    floor: float,
    excess: tuple[float, float],
) -> dict[str, Any]:
    """The object `gap` of diagnosis.json. before, after: residuals (scored, k) of each of `segments`; floor: of the
    noise; excess: as in `shrink_interval_elsewhere`. The interval of the shrinkage covers other blocks of the recorded
    motions (bootstrap) as well as motions that were not recorded."""
    rms_before, rms_after = rms(before), rms(after)
    drawn = bootstrap(before, after, [blocks(segment) for segment in segments])
    other_blocks = spread.interval(np.array([shrinkage(*rms_of_both) for rms_of_both in drawn.T]), _SHRINK_SHARE)
    other_motions = shrink_interval_elsewhere(rms_after / rms_before, excess) if rms_before > 0.0 else (0.0, 0.0)
    open_before = max(rms_before**2 - floor**2, _LEAST_EXCESS)
    return {
        "before": rms_before,
        "after": rms_after,
        "before_ci": spread.interval(drawn[0], _SIZE_SHARE),
        "after_ci": spread.interval(drawn[1], _SIZE_SHARE),
        "shrink": shrinkage(rms_before, rms_after),
        "shrink_ci": [min(other_blocks[0], float(other_motions[0])), max(other_blocks[1], float(other_motions[1]))],
        "closable_shrink": float(np.clip(1.0 - (rms_after**2 - floor**2) / open_before, 0.0, 1.0)),
    }


def probability_of_shrinking(before: Sequence[Array], after: Sequence[Array], segments: Sequence[Segment]) -> float:
    """The share, 0 to 1, of bootstrap draws of the blocks in which `after` has a smaller rms than `before`; residuals
    (scored, k) of each of `segments`."""
    drawn = bootstrap(before, after, [blocks(segment) for segment in segments])
    return float(np.mean(drawn[1] < drawn[0]))


def bootstrap(before: Sequence[Array], after: Sequence[Array], labels: Sequence[npt.NDArray[np.int64]]) -> Array:
    """(2, _DRAWS) rms of `before` and of `after` in each bootstrap draw of blocks, with replacement, the same blocks
    for both. A block is drawn with a probability proportional to its length, and as many as there are effective blocks
    (Kish: 1 / sum of squared shares), so that a draw resembles the recordings however unequal the blocks are. The seed
    is fixed. labels: (scored,) of each recording, the number of each observation's block."""
    blocks_of = []  # of each block: both mean squares, how many numbers
    for residual_before, residual_after, label in zip(before, after, labels, strict=True):
        for number in np.unique(label):
            in_block = label == number
            blocks_of.append(
                (
                    float(np.mean(residual_before[in_block] ** 2)),
                    float(np.mean(residual_after[in_block] ** 2)),
                    int(residual_before[in_block].size),
                )
            )
    table = np.array(blocks_of)
    share = table[:, 2] / table[:, 2].sum()
    effective = round(1.0 / float(np.sum(share**2)))
    chosen = np.random.default_rng(_SEED).choice(len(table), (_DRAWS, effective), p=share)
    result: Array = np.sqrt(table[chosen, :2].mean(axis=1)).T
    return result
