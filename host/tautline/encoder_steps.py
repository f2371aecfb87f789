"""An encoder's steps as its readings show them, and where the motor rests or turns: by when its counts change, and on a
path through them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg.lapack import dgels

from tautline.driven import Driven
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_COARSER = 30.0  # prior: times the rig's step, at most: what is more is a motor that steps
REST_S = 0.05  # prior: a motor that stands still for longer rests
CHANGES = 24, 4  # tolerance: of the count, most and least, that tell how a motor slows down
_SLOWING = 4  # tolerance: intervals of a path that tell how the motor slows down
_UNSEEN = 2  # tolerance: of a path's nodes, by which changes of count may put a stop too early
_INSTANT_S = 1e-4  # tolerance: between two nodes, at least
_FEWER = 0.7  # tolerance: of the changes, that are tried where all do not fit
_FITS = 0.3  # tolerance: counts rms: an encoder's step scatters by 0.29
_MOVED = 0.02  # tolerance: of a count: readings nearer to each other are one
_WHOLE, _MOST = 0.05, 0.95  # tolerance: counts beside a whole one, share of the readings that are so near


@dataclass(frozen=True)
class Steps:
    """Readings are zero + count * counts, counts whole."""

    count: float  # the size of a step, unit of the readings
    zero: float  # the reading at count 0
    counts: Array  # (n,) of each reading


def steps_of(motor: Motor, resolution: float) -> Steps | None:
    """The encoder's steps as the readings show them: of the rig's size (`resolution`, unit of q), whatever their zero,
    or of a coarser one, if a share _MOST of the readings is within _WHOLE of a whole count. None where readings have no
    steps."""
    moves = np.abs(np.diff(motor.q))
    moves = moves[moves > _MOVED * resolution]
    if len(moves) < 2:
        return None
    coarser = min(float(moves.min()), _COARSER * resolution)
    # The rig's step from 0 and from the first reading, then a coarser one: the smallest move is one of its steps.
    for count, zero in ((resolution, 0.0), (resolution, float(motor.q[0])), (coarser, float(motor.q[0]))):
        counts = (motor.q - zero) / count
        whole = np.rint(counts)
        if np.count_nonzero(np.diff(whole)) >= 2 and np.mean(np.abs(counts - whole) < _WHOLE) >= _MOST:
            return Steps(count, zero, counts=whole)
    return None


@dataclass(frozen=True)
class Rest:
    """The motor stands at `q`, the rig's unit, from start_s to end_s, s, which are equal where it turns at once. The
    count before that last changed at since_s, and it changes next at until_s."""

    q: float
    start_s: float
    end_s: float
    since_s: float
    until_s: float


@dataclass(frozen=True)
class Stops:
    """`rests`: where the motor rests or turns. `slows_down`: at half or more of the sides of these, before and after,
    it slows down or speeds up, or there are none; else its speed jumps."""

    rests: list[Rest]
    slows_down: bool


@dataclass(frozen=True)
class _Vertex:
    """How long the motor moves on beyond the change of count nearest to a stop, s, and where it stops, counts."""

    lasts_s: float
    level: float
    slows: bool  # else it hardly slows down


def rests_and_turns(motor: Motor, encoder: Steps) -> Stops:
    """Finds where the motor rests or turns: in a count in which its direction changes, or which lasts longer than
    REST_S and than both counts beside it together. The last count before a stop, in which an encoder shows nothing (13
    ms at 12 mm/s^2 and 1 um), is extrapolated from the changes of count before and after, at constant acceleration. A
    stop is left out where neither side has enough changes for that. encoder: the readings' steps."""
    t, counts = motor.t_s, encoder.counts
    moves = np.diff(counts)
    changes = np.flatnonzero(moves)
    # Of each of k changes of count: when, s, by how many counts, and where the motor is then, counts.
    at, step = 0.5 * (t[changes] + t[changes + 1]), moves[changes]
    boundary = counts[changes] + 0.5 * step
    period = motor.period_s
    stops, asked, slowing = [], 0, 0  # asked: sides of stops, before and after; slowing: those at which it slows down
    # Count i, of k + 1, holds from change i - 1 to change i.
    edges = np.concatenate([t[:1], at, t[-1:]])  # when each begins, and the last one ends
    lasts = np.diff(edges)
    turned = np.concatenate([[False], step[1:] * step[:-1] < 0, [False]])  # the motor turns in this count
    for i in np.flatnonzero(turned | _outlasts_neighbours(lasts)):
        first, last = i == 0, i == len(changes)
        centre = counts[0] if first else counts[changes[i - 1] + 1]
        since, until, turns = edges[i], edges[i + 1], turned[i]
        # How the motor comes to the stop, and, as time reversed is alike, how it leaves it.
        before = np.arange(i - 1, max(i - CHANGES[0], 0) - 1, -1)
        after = slice(i, i + CHANGES[0])
        slows = None if first else _stop_by_parabola(at[before], boundary[before], step[before], centre, period)
        starts = None if last else _stop_by_parabola(at[after], boundary[after], -step[after], centre, period)
        sides = [side for side in (slows, starts) if side is not None]
        asked += (not first) + (not last)
        slowing += sum(side.slows for side in sides)
        if not sides:
            continue
        middle = 0.5 * (since + until)
        # Without a parabola on a side the motor is taken to go as fast as through the count beside it.
        start_s = since + min(slows.lasts_s if slows else _half_count_s(t, changes, step, lasts, i - 1), middle - since)
        end_s = until - min(starts.lasts_s if starts else _half_count_s(t, changes, step, lasts, i), until - middle)
        if turns and slows is not None and starts is not None and end_s - start_s < 2 * period:
            start_s = end_s = 0.5 * (start_s + end_s)
        level = encoder.zero + encoder.count * float(np.mean([side.level for side in sides]))
        stops.append(Rest(q=level, start_s=start_s, end_s=end_s, since_s=since, until_s=until))
    return Stops(stops, 2 * slowing >= asked)


def _outlasts_neighbours(lasts: Array) -> npt.NDArray[np.bool_]:
    """(k,) Which counts last longer than REST_S and than both counts beside them together: a motor that only passes
    through stays as long in each. lasts (k,): how long each count holds, s."""
    padded = np.concatenate([[0.0], lasts, [0.0]])
    beside = padded[:-2] + padded[2:]
    return np.asarray(lasts > np.maximum(beside, REST_S))


def _half_count_s(t: Array, changes: npt.NDArray[np.intp], step: Array, lasts: Array, i: int) -> float:
    """Half the time, s, that the motor takes for the shorter of the two counts beside the i-th change of count. Half a
    sample where the change is by several counts at once, 0 where there is no such change. t (n,): the samples' times,
    s; changes (k,): the last sample before each change; step (k,): by how many counts it is; lasts (k + 1,): how long
    each count holds, s."""
    if not 0 <= i < len(changes):
        return 0.0
    if abs(step[i]) > 1:
        return 0.5 * float(t[changes[i] + 1] - t[changes[i]])
    return 0.5 * float(min(lasts[i], lasts[i + 1]))


def _stop_by_parabola(at: Array, boundary: Array, step: Array, centre: float, period: float) -> _Vertex | None:
    """How the motor comes to its stop within a count: the vertex of a parabola away(s) = offset + speed s + bend s^2
    through as many of the nearest changes of count as it fits, s being the time before the nearest one. Where it has no
    vertex within a count the motor does not slow down: it stops after half the time to the second change. None for too
    few changes. Of each of the k <= CHANGES[0] changes, the nearest to the stop first: at (k,), s; boundary and step
    (k,), counts. centre: the count that it stops in; period: of the samples, s."""
    least = CHANGES[1]
    way = np.sign(step[0])
    ends = step * way <= 0.0
    ends[1:] |= np.abs(at[1:] - at[:-1]) > REST_S
    n = int(np.argmax(ends)) if ends.any() else len(at)
    every = np.abs(at - at[0])
    while n >= least:
        away, since = way * (centre - boundary[:n]), every[:n]  # counts from the stop's centre; s
        gaps = since[1:] - since[:-1]
        # A change that comes after a while is known to a fraction of a count.
        beside = np.concatenate([gaps[:1], gaps, gaps[-1:]])
        sure = np.maximum(1.0, 0.5 * (beside[:-1] + beside[1:]) / period)
        _, fitted, _ = dgels(np.stack([sure, sure * since, sure * since**2]).T, away * sure)
        if float(np.sqrt(fitted[3:] @ fitted[3:] / n)) <= _FITS:
            offset, speed, bend = fitted[:3].tolist()
            has_vertex = bend > 0.0 and speed > 0.0
            left = offset - speed**2 / (4.0 * bend) if has_vertex else -np.inf  # equation: `away` at the vertex
            if abs(left) <= 1.0:
                level = centre - way * float(np.clip(left, -0.5, 0.5))  # within the count
                return _Vertex(lasts_s=speed / (2.0 * bend), level=level, slows=True)
            return _Vertex(lasts_s=0.5 * float(since[1]), level=centre, slows=False)
        n = int(_FEWER * n)
    return None


def with_level_rests(path: Driven, stops: list[Rest], count: float) -> tuple[Driven, npt.NDArray[np.bool_]]:
    """Returns the path with each rest of `stops` at one level, which the motor comes to and leaves at constant
    acceleration, and with a node at each turn; and which of its nodes (n,) were put in for that. count: the encoder's
    step, unit of q."""
    nodes = np.stack([path.t_s, path.q, path.sigma])
    length = nodes.shape[1]
    kept, ends = np.ones(length, dtype=bool), np.empty((3, 0))
    at = np.searchsorted(path.t_s, [(stop.start_s, stop.end_s) for stop in stops]).reshape(-1, 2).tolist()
    for i, (first, last) in enumerate(at):
        within = at[i - 1][1] if i else 0, at[i + 1][0] if i + 1 < len(at) else length
        found = _rest_nodes(nodes, first, last, within, count) if last - first >= 2 else _turn_node(nodes, first)
        if found is not None:
            before, after, new = found
            kept[before + 1 : after] = False
            ends = np.concatenate([ends, new], axis=1)
    both = np.concatenate([nodes[:, kept], ends], axis=1)
    order = np.argsort(both[0], kind="stable")
    t_s, q, sigma = both[:, order]
    return replace(path, t_s=t_s, q=q, sigma=sigma), order >= int(kept.sum())


def _rest_nodes(
    nodes: Array, first: int, last: int, within: tuple[int, int], count: float
) -> tuple[int, int, Array] | None:
    """Replaces the nodes of a rest. Returns the last node before it, the first one after it, and the rest's two ends
    (3, 2), where the motor comes to a stand and where it starts; None where these ends cross. nodes (3, n): times, s,
    positions and sigmas, of which those from `first` to before `last` rest; within: where the stop before ends, and the
    one after begins. Nodes within half a count, `count`, of the rest's level are part of it, as no reading changes
    there."""
    (t_s, q), length = nodes[:2], nodes.shape[1]
    level, sigma = float(np.mean(q[first:last])), float(np.median(nodes[2, first:last]))
    before, after = first - 1, last
    while before >= within[0] and abs(q[before] - level) <= 0.5 * count:
        before -= 1
    while after < within[1] and abs(q[after] - level) <= 0.5 * count:
        after += 1
    since_s, until_s = float(t_s[0]), float(t_s[-1])
    if before >= 0:
        latest_s = float(t_s[min(first + _UNSEEN, last - 1)])
        since_s = _standstill_s(t_s[: before + 1], q[: before + 1], latest_s, float(t_s[first]))
    if after < length:
        latest_s = -float(t_s[max(last - 1 - _UNSEEN, first)])  # the same with time reversed
        nodes_after = slice(after, after + _SLOWING + 1)
        until_s = -_standstill_s(-t_s[nodes_after][::-1], q[nodes_after][::-1], latest_s, -float(t_s[last - 1]))
    if since_s >= until_s:
        return None
    return before, after, np.array([[since_s, until_s], [level, level], [sigma, sigma]])


def _standstill_s(t_s: Array, q: Array, latest_s: float, else_s: float) -> float:
    """The time, s, at which a motor that slows down evenly stands still, extrapolated from the speeds between its last
    nodes t_s, q (n,); else_s where there are too few nodes, it does not slow down, or that would be after latest_s."""
    if len(t_s) <= _SLOWING:
        return else_s
    t_s, q = t_s[-_SLOWING - 1 :], q[-_SLOWING - 1 :]
    middle, speeds = 0.5 * (t_s[1:] + t_s[:-1]) - t_s[-1], np.diff(q) / np.diff(t_s)
    about = middle - middle.mean()  # a straight line through the speeds: `speed` at the last node, `bend` a second
    bend = float(about @ speeds / (about @ about))
    speed = float(speeds.mean() - bend * middle.mean())
    at_s = float(t_s[-1] - speed / bend) if speed * bend < 0.0 else np.inf
    return max(at_s, float(t_s[-1]) + _INSTANT_S) if at_s <= latest_s else else_s


def _turn_node(nodes: Array, near: int) -> tuple[int, int, Array] | None:
    """Replaces the node at a turn, next to node `near`. Returns the nodes before and after it, and (3, 1) time, s,
    position and sigma where the speed, straight between the middles of intervals, is 0; None where the motor does not
    turn there. nodes: as in `_rest_nodes`."""
    t_s, q, sigma = nodes[:, max(near - _SLOWING, 0) : near + _SLOWING]
    speed, middle = np.diff(q) / np.diff(t_s), 0.5 * (t_s[1:] + t_s[:-1])
    turns = np.flatnonzero(speed[1:] * speed[:-1] < 0.0)
    if not len(turns):
        return None
    k = int(turns[np.argmin(np.abs(turns + 1 - min(near, _SLOWING)))])
    at_s = middle[k] - speed[k] * (middle[k + 1] - middle[k]) / (speed[k + 1] - speed[k])
    speed_there = float(np.interp(t_s[k + 1], middle[k : k + 2], speed[k : k + 2]))  # at the node that is replaced
    turned_q = q[k + 1] + 0.5 * speed_there * (at_s - t_s[k + 1])  # equation: it falls evenly to 0 at at_s
    first = max(near - _SLOWING, 0) + k
    return first, first + 2, np.array([[at_s], [turned_q], [sigma[k + 1]]])
