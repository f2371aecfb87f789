"""An encoder's steps as its readings show them, and where the motor rests or turns by when its counts change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_COARSER = 30.0  # times the rig's step, at most: what is more is a motor that steps
REST_S = 0.05  # a motor that stands still for longer rests
CHANGES = 24, 4  # tolerance: of the count, most and least, that tell how a motor slows down
_FITS = 0.3  # tolerance: counts rms: an encoder's step scatters by 0.29


@dataclass(frozen=True)
class Steps:
    """Readings are zero + count * counts, counts whole."""

    count: float
    zero: float
    counts: Array


def steps_of(motor: Motor, resolution: float) -> Steps | None:
    """The steps of the readings: the rig's, whatever their zero, or a coarser one; None where readings have no
    steps."""
    moves = np.abs(np.diff(motor.q))
    moves = moves[moves > 0.02 * resolution]
    if len(moves) < 2:
        return None
    coarser = min(float(moves.min()), _COARSER * resolution)
    for count, zero in ((resolution, 0.0), (resolution, float(motor.q[0])), (coarser, float(motor.q[0]))):
        counts = (motor.q - zero) / count
        whole = np.rint(counts)
        if np.count_nonzero(np.diff(whole)) >= 2 and np.mean(np.abs(counts - whole) < 0.05) >= 0.95:
            return Steps(count, zero, whole)
    return None


@dataclass(frozen=True)
class Rest:
    """The motor stands at `q`, the rig's unit, from `start_s` to `end_s`, the same where it turns at once; the count
    last changed before it at `since_s` and next changes at `until_s`."""

    q: float
    start_s: float
    end_s: float
    since_s: float
    until_s: float


def rests_and_turns(motor: Motor, encoder: Steps) -> list[Rest]:
    """Where the motor rests or turns, extrapolated from the changes of count before and after at constant acceleration:
    an encoder shows nothing of the last count before a stop, which takes 13 ms at 12 mm/s^2 and 1 um."""
    t, counts = motor.t_s, encoder.counts
    changes = np.flatnonzero(np.diff(counts))
    at, step = 0.5 * (t[changes] + t[changes + 1]), np.diff(counts)[changes]
    boundary = counts[changes] + 0.5 * step
    period = float(np.median(np.diff(t)))
    stops = []
    # The count that holds from change i - 1 to change i.
    edges = np.concatenate([t[:1], at, t[-1:]])
    turned = np.concatenate([[False], step[1:] * step[:-1] < 0, [False]])
    lasts = np.diff(edges)
    padded = np.concatenate([[0.0], lasts, [0.0]])
    beside = padded[:-2] + padded[2:]  # a motor that only passes is as long in each of its counts
    for i in np.flatnonzero(turned | (lasts > np.maximum(beside, REST_S))):
        first, last = i == 0, i == len(changes)
        centre = counts[0] if first else counts[changes[i - 1] + 1]
        since, until, turns = edges[i], edges[i + 1], turned[i]
        slows = None if first else _stop_by_parabola(at[:i][::-1], boundary[:i][::-1], step[:i][::-1], centre, period)
        starts = None if last else _stop_by_parabola(at[i:], boundary[i:], -step[i:], centre, period)
        level = [vertex[1] for vertex in (slows, starts) if vertex is not None]
        if not level:
            continue
        middle = 0.5 * (since + until)
        # Where no vertex is told it comes as fast as through the count before, within a sample where it jumps.
        start_s = since + min(slows[0] if slows else _half_count_time(t, changes, step, lasts, i - 1), middle - since)
        end_s = until - min(starts[0] if starts else _half_count_time(t, changes, step, lasts, i), until - middle)
        if turns and slows is not None and starts is not None and end_s - start_s < 2 * period:
            start_s = end_s = 0.5 * (start_s + end_s)
        stops.append(Rest(encoder.zero + encoder.count * float(np.mean(level)), start_s, end_s, since, until))
    return stops


def _half_count_time(t: Array, changes: npt.NDArray[np.intp], step: Array, lasts: Array, i: int) -> float:
    """Half the time, s, that the motor takes for a count beside the i-th change; half a sample where it is of several
    counts."""
    if not 0 <= i < len(changes):
        return 0.0
    if abs(step[i]) > 1:
        return 0.5 * float(t[changes[i] + 1] - t[changes[i]])
    return 0.5 * float(min(lasts[i], lasts[i + 1]))


def _stop_by_parabola(
    at: Array, boundary: Array, step: Array, centre: float, period: float
) -> tuple[float, float] | None:
    """How long the motor moves on beyond the change of count nearest to a stop, s, and where it stops, counts: the
    vertex of a parabola through as many changes as it fits. None for too few. at, boundary, step: of the changes, the
    nearest first."""
    most, least = CHANGES
    way = np.sign(step[0])
    one_way = np.flatnonzero((np.sign(step[:most]) != way) | (np.abs(np.diff(at[:most], prepend=at[0])) > REST_S))
    n = min(len(at), most, int(one_way[0]) if len(one_way) else most)
    while n >= least:
        away, since = way * (centre - boundary[:n]), np.abs(at[:n] - at[0])
        # A change that comes after a while is known to a fraction of a count.
        sure = np.maximum(1.0, np.gradient(since) / period)
        line = np.column_stack([np.ones(n), since, since**2])
        fitted = np.linalg.lstsq(line * sure[:, None], away * sure, rcond=None)[0]
        if float(np.sqrt(np.mean(np.square(sure * (away - line @ fitted))))) <= _FITS:
            offset, speed, bend = (float(value) for value in fitted)
            left = offset - speed**2 / (4.0 * bend) if bend > 0.0 and speed > 0.0 else -np.inf
            if abs(left) <= 1.0:
                return speed / (2.0 * bend), centre - way * float(np.clip(left, -0.5, 0.5))
            return 0.5 * float(since[1]), centre  # it hardly slows down
        n = int(0.7 * n)
    return None
