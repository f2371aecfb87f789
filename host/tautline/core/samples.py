"""What a sensor's samples say of themselves: their noise, their steps, and which are of something else than the tip."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import median_filter, minimum_filter1d
from scipy.spatial import KDTree

from tautline import spread
from tautline.core.motor import MotorPath

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_LEAST_PX, _LEAST_DEG = 1e-3, 1e-4  # tolerance: noise is never taken to be less
_USUAL_PX, _USUAL_DEG = 0.05, 0.01  # prior: noise of a sensor that nothing else is known of
_TELL_NOISE = 8  # tolerance: frames, or differences at equal steps, that noise is told from
_STRAY = 12.0  # prior: sigma, beside usual steps, from which a lone frame is a false sighting
_MEDIAN, _USUAL = 5, 9  # tolerance: frames whose median a lone one is beside; steps whose median is usual there
_STEEP = 4.0  # prior: of these, so many: a law is not as steep everywhere
_MOST_OF_RANGE = (0.05, 0.95)  # tolerance: quantiles, as some frames are strays
_AROUND_S = 0.5  # prior: in which steps are usual ones: a sensor's spike is over in half of it
_WHILE = 0.1  # prior: share of a recording for which a tracker may be on another blob, at once
FEW = 20  # tolerance: frames below which nothing is told of a motion
_LEVELS = 0.5  # prior: different values for each frame, below which a sensor rounds
_CORNERS = 6.0  # prior: of usual third differences: more is a turn's or a stray's
_EXACT = 1e-9  # tolerance: of the range: a difference of binary numbers
_LOW = 0.05  # tolerance: quantile of the steps between values that is a sensor's own
_APART = 10  # tolerance: samples over which a period is told: one in thirty may be lost
_WAITING = 26  # tolerance: samples, from one on or up to it, among which some hardly waited
_EVEN = 0.25  # tolerance: of the usual gap, by which an even one differs from it


def noise_of(t: Array, y: Array, least: float) -> float:
    """Standard deviation, per coordinate, of white noise on samples y (n, channels: 2 px or 1 deg) at times t (n,), s.
    It comes from third differences between frames at equal steps, which are next to nothing for a smooth motion, and is
    at least `least` and a rounding sensor's step / sqrt(12). For fewer than _TELL_NOISE frames it is a usual value
    (_USUAL_PX, _USUAL_DEG)."""
    if len(t) < _TELL_NOISE:
        return max(least, _USUAL_PX if y.shape[1] == 2 else _USUAL_DEG)
    runs = even_runs(t, 3)
    third = np.diff(y, 3, axis=0)
    third = third[runs] if runs.sum() >= _TELL_NOISE else third
    step = rounding_step(y)
    usual = spread.deviation(third)
    if step > 0.0:  # third differences are whole steps as well, and so is their median
        usual = float(np.sqrt(np.mean(np.minimum(np.abs(third), _CORNERS * max(usual, step)) ** 2)))
    of_one = usual / np.sqrt(spread.THIRD)
    return float(max(of_one, spread.of_rounding(step), least))


def period_s(t: Array) -> float:
    """Usual time, s, between samples that arrived at t (n,), s: the median over _APART of them, divided by that, as
    each one may come early or late; 0 for fewer than two."""
    apart = min(_APART, len(t) - 1)
    return float(np.median(t[apart:] - t[:-apart])) / apart if apart > 0 else 0.0


def waits_s(t: Array) -> Array:
    """(n,) By how much later, s, each sample arrived than an even clock would have it: arrival times t (n,), s, less
    that clock's. It runs at `period_s` through the least late of _WAITING samples, of those from this one on or of
    those up to it, whichever is later: a lost sample delays all after it."""
    late = t - period_s(t) * np.arange(len(t))
    ways = -(_WAITING // 2), (_WAITING - 1) // 2  # of the filter: windows that begin and end at a sample
    onward, up_to = (minimum_filter1d(late, _WAITING, mode="nearest", origin=way) for way in ways)
    return np.asarray(late - np.maximum(onward, up_to))


def least_noise(unit: str) -> float:
    """The least noise that a sensor with this unit, "px" or else deg, is taken to have, in its unit."""
    return _LEAST_PX if unit == "px" else _LEAST_DEG


def rounding_step(y: Array) -> float:
    """The step of a sensor that rounds, by the first channel of y (n, channels); 0 where it does not round: it takes
    _LEVELS different values for each frame or more."""
    levels = np.unique(y[:, 0])
    return least_step(levels) if 1 < len(levels) < _LEVELS * len(y) else 0.0


def least_step(levels: Array) -> float:
    """A low quantile of the steps between neighbouring levels (n,), two or more, rising. It is not the least one, as
    binary rounding makes two levels of one."""
    apart = np.diff(levels)
    return float(np.quantile(apart[apart > _EXACT * (levels[-1] - levels[0])], _LOW))


def repeats(y: Array) -> Mask:
    """(n,) Which samples of y (n, channels) are the same as the one before, to the last digit."""
    same = np.zeros(len(y), dtype=bool)
    same[1:] = (y[1:] == y[:-1]).all(axis=1)
    return same


def even_runs(t: Array, count: int) -> Mask:
    """(n - count,) Whether all of the `count` gaps that follow a frame are usual ones, within a share _EVEN of the
    median gap. t (n,): times, s."""
    gaps = np.diff(t)
    even = np.abs(gaps - np.median(gaps)) < _EVEN * np.median(gaps)
    return np.asarray(sliding_window_view(even, count).all(axis=1))


def strays(path: MotorPath, t: Array, y: Array, sigma: float) -> Mask:
    """(n,) Which frames, y (n, channels) at times t (n,), s, show something else than the tip. First, frames that are
    elsewhere for one or two frames: farther from the median of _MEDIAN frames than noise and the usual steps there
    explain. A jump that stays is no stray, nor is a motion that goes one way. The search is repeated without the strays
    found, as several close together look like motion. Then frames that are elsewhere for a while (`_frames_off_tip`).
    path: of the motor; sigma: the noise of a coordinate."""
    stray = np.zeros(len(y), dtype=bool)
    kept = np.arange(len(y))
    while len(kept) >= _MEDIAN:
        left = y[kept]
        away = np.linalg.norm(left - _running_median(left, _MEDIAN), axis=1)
        step = np.linalg.norm(np.diff(left, axis=0), axis=1)
        usual = _running_median(np.append(step, step[-1]), _USUAL)
        further = away > _STRAY * sigma + _STEEP * usual
        if not further.any():
            break
        stray[kept[further]] = True
        kept = kept[~further]
    t, y = t[kept], y[kept]
    anew = ~repeats(y)  # a frame that repeats the one before says nothing new of the tip, and shares its verdict
    stray[kept[_frames_off_tip(path, t[anew], y[anew], sigma)[np.cumsum(anew) - 1]]] = True
    return stray


def _frames_off_tip(path: MotorPath, t: Array, y: Array, sigma: float) -> Mask:
    """(n,) Frames between two jumps at which y (n, channels) shows something else than the tip for a while: a place
    where the tip never is, as when a tracker was on another blob, or a sensor's spike (`_spikes`). A jump is farther
    than the tip goes in _STEEP frames, both about that time and at the motor's greatest speed. A tip that snaps goes
    along its path and comes back when its motor does: it is no stray. path: of the motor; t (n,): times, s; sigma: the
    noise of a coordinate."""
    away = np.zeros(len(y), dtype=bool)
    if len(y) < FEW:
        return away
    driven, gaps = path.at(t), np.diff(t)
    low, high = np.quantile(np.column_stack([y, driven]), _MOST_OF_RANGE, axis=0)
    usual_gap = float(np.median(gaps))
    if not (high[-1] > low[-1] and usual_gap > 0.0):
        return away
    # How far the tip goes in a frame: at the motor's greatest speed, and usually about that time.
    quickest = np.linalg.norm((high - low)[:-1]) / (high[-1] - low[-1]) * np.abs(path.at(t + usual_gap) - driven).max()
    step = np.linalg.norm(np.diff(y, axis=0), axis=1)
    usual = median_filter(step, max(_USUAL, 2 * round(0.5 * _AROUND_S / usual_gap) + 1), mode="nearest")
    frames = np.maximum(gaps / usual_gap, 1.0)  # that passed, some unseen
    tip_step = np.maximum(usual, quickest)
    jumps = np.flatnonzero(step > _STRAY * sigma + _STEEP * frames * tip_step) + 1
    # Runs of frames between jumps. The tip's own are the first and last one, long ones, and the longest that hold half
    # of all frames; the others are unsure.
    edges = np.concatenate([[0], jumps, [len(y)]])
    length = np.diff(edges)
    longest = np.argsort(-length, kind="stable")
    most = longest[: 1 + int(np.searchsorted(np.cumsum(length[longest]), 0.5 * len(y)))]
    unsure = length <= _WHILE * len(y)
    unsure[most] = unsure[[0, -1]] = False
    if not unsure.any():
        return away
    away = _spikes(t, y, edges, unsure, tip_step, sigma)
    # Another blob: runs that are farther from all places of the tip than its frames are from one another.
    of_tip = KDTree(y[np.repeat(~unsure, length)])
    between = _STRAY * sigma + float(usual.max())
    for i in np.flatnonzero(unsure):
        run = slice(edges[i], edges[i + 1])
        away[run] |= bool(np.median(of_tip.query(y[run])[0]) > between)
    return away


def _spikes(t: Array, y: Array, edges: npt.NDArray[np.intp], unsure: Mask, tip_step: Array, sigma: float) -> Mask:
    """(n,) Frames of a sensor's spikes: unsure runs, one or several in a row, that y (n, channels) jumps to and comes
    back from to where it was, in less time than the tip needs to go as far as either jump. t (n,): times, s; edges (r +
    1,): where the runs begin, and n; unsure (r,): which runs may be no part of the tip's motion, not the first and
    last; tip_step (n - 1,): how far the tip goes in a frame; sigma: the noise of a coordinate."""
    away, step = np.zeros(len(y), dtype=bool), np.linalg.norm(np.diff(y, axis=0), axis=1)
    usual_gap = float(np.median(np.diff(t)))
    for first in np.flatnonzero(unsure):
        last = first
        while unsure[last]:
            begin, end = edges[first], edges[last + 1]
            # How far the tip may have gone between the frames before and after these runs.
            could = _STRAY * sigma + _STEEP * (t[end] - t[begin - 1]) / usual_gap * tip_step[[begin - 1, end - 1]].max()
            if could >= step[begin - 1]:
                break
            if could < step[end - 1] and np.linalg.norm(y[end] - y[begin - 1]) < could:
                away[begin:end] = True
            last += 1
    return away


def _running_median(values: Array, size: int) -> Array:
    """Medians of each `size` (odd) neighbours along the first axis of values (n, ...); same shape. Ends are continued
    by their own value."""
    beyond = [(size // 2, size // 2)] + [(0, 0)] * (values.ndim - 1)
    return np.asarray(np.median(sliding_window_view(np.pad(values, beyond, mode="edge"), size, axis=0), axis=-1))
