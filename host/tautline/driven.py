"""Where a motor was between and behind its readings: a Gaussian path, with its standard deviation at every time.

Its speed, or its acceleration, is constant but for rare, large changes: the increments of a Cauchy process. Each
reading is the path with white noise, rounded to the encoder's step. Neither the noise nor how rare a change is has to
be known: the noise is the likeliest, and of ever rarer changes those are taken under which readings that are left out
are likeliest."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np
import numpy.typing as npt

from tautline import _native, spread

Array = npt.NDArray[np.float64]

_GRID_S = 0.004  # tolerance: between nodes at most: finer than a camera's frames by far
_NO_NOISE = 1e-3  # tolerance: of a step: less is none
_LEAST_NOISE = 0.2  # tolerance: of a step, to begin with
_RARER = 0.1  # tolerance: times the square of the usual change, a sweep
_RAREST = 1e-9  # tolerance: square of the usual change in a node's time, of a step: what double precision carries
_NONE = 1e-2  # tolerance: of the largest jump of speed between two readings: none
_SWEEPS = 48  # tolerance: at most
_SETTLED = 1e-3  # tolerance: log probability of a reading that one more sweep must bring


@dataclass(frozen=True, eq=False)
class Driven:
    """Posterior of a motor's path. Between its nodes it is straight."""

    t_s: Array  # (n,) rising
    q: Array  # (n,) mean, unit of the readings
    sigma: Array  # (n,) one standard deviation
    noise: float  # standard deviation of the readings' white noise, their unit; rounding is not in it
    order: int = 2  # of what is constant but for jumps: 2 its speed, 3 its acceleration


def driven(t_s: Array, q: Array, step: float, *, rounded: bool, order: int = 2) -> Driven:
    """The posterior of a motor's path, by readings q (n,) at rising times t_s (n,), s, at least four. rounded: whether
    readings are rounded to the encoder's step, `step`, their unit; if not, `step` is about their noise. order: as in
    `Driven`."""
    begin_s, end_s = float(t_s[0]), float(t_s[-1])
    t_s, readings = _block_means(t_s, q)
    usual_s = float(np.median(np.diff(t_s)))
    parts = max(int(np.ceil(usual_s / _GRID_S - 1e-6)), 1)  # of each interval of readings
    size = len(readings)
    nodes = np.interp(np.arange((size - 1) * parts + 1) / parts, np.arange(size), t_s)
    read = np.zeros(len(nodes), dtype=np.uint8)
    read[::parts] = 1
    zero = float(readings[0])
    reading = np.zeros(len(nodes))  # at each node that has one, in steps from the first
    reading[::parts] = (readings - zero) / step
    found = _fitted_path(order, np.diff(nodes) / usual_s, reading, read, rounded)
    mean, sigma = found.mean.copy(), np.sqrt(found.variance)
    # Block means put the first and last node into the middle of their blocks: the path is prolonged to the ends.
    ends = np.clip(np.array([begin_s - nodes[0], end_s - nodes[-1]]), [-_GRID_S, 0.0], [0.0, _GRID_S])
    mean[[0, -1]] += ends * np.diff(mean)[[0, -1]] / np.diff(nodes)[[0, -1]]
    nodes[[0, -1]] += ends
    if order == 2:
        shows = _shows_corners(nodes, mean, parts)
        nodes, mean, sigma = _corners_placed(nodes[shows], mean[shows], sigma[shows])
    noise = step * found.noise * float(np.sqrt(len(q) / size))  # equation: of one reading, from that of block means
    return Driven(t_s=nodes, q=zero + step * mean, sigma=step * sigma, noise=noise, order=order)


@dataclass(frozen=True)
class _Swept:
    """A path at nodes (n,) after a sweep, positions in the encoder's steps, variances in their squares."""

    told: float  # log probability of the readings, each left out in turn
    mean: Array  # (n,)
    variance: Array  # (n,)
    noise: float  # of the readings


def _fitted_path(order: int, intervals: Array, reading: Array, read: npt.NDArray[np.uint8], rounded: bool) -> _Swept:
    """Fits the path on a grid of nodes by sweeps in C that take changes to be ever rarer, until more sweeps bring
    nothing. Returns the sweep under which readings, each left out in turn, are likeliest. intervals (n - 1,): between
    nodes, over the usual one of readings; reading (n,): in the encoder's steps, where `read` (n,) is 1; order, rounded:
    as of `driven`."""
    size, seen = len(reading), np.flatnonzero(read)
    times = np.concatenate([[0.0], np.cumsum(intervals)])
    change = change_factors(order, intervals)
    noise = max(white_noise(times[seen], reading[seen]), _LEAST_NOISE if rounded else _NO_NOISE)
    state = np.interp(np.arange(size), seen, reading[seen])
    precision = read / (noise**2 + (spread.of_rounding(1.0) ** 2 if rounded else 0.0))
    force = precision * reading
    jumped, variance = np.full(len(change), -1.0), np.zeros(size)
    jump, before = max(noise, _LEAST_NOISE) ** 2, -np.inf  # usual change, squared; the sweep before's probability
    best = _Swept(-np.inf, state.copy(), np.full(size, noise**2), noise)
    for _ in range(_SWEEPS):
        # It changes its last five arguments in place: positions; of each reading as a Gaussian its precision and that
        # times its mean; mean squares of the changes; variance of the positions. holds: no number failed; scatter: the
        # likeliest noise; told: log probability of the readings, each left out in turn.
        holds, scatter, told = _native.sweep(
            change, reading, read, 0.5 if rounded else 0.0, noise, jump, state, precision, force, jumped, variance
        )
        if not holds or not np.isfinite(told):
            break
        noise = max(scatter, _NO_NOISE)
        if told > best.told:
            best = _Swept(told, state.copy(), variance.copy(), noise)
        if jump == _RAREST and told - before < _SETTLED * len(seen):
            break
        jump, before = max(_RARER * jump, _RAREST), told
    return best


def change_factors(order: int, steps: Array) -> Array:
    """(n - order, order + 1) The factors of order + 1 neighbouring positions with which their weighted sum is the
    change of speed (order 2) or of acceleration (order 3) there, per unit of time: `order`! times a divided difference.
    steps (n - 1,): times between the nodes."""
    many = len(steps) - order + 1
    at = list(accumulate((steps[j : j + many] for j in range(order)), initial=np.zeros(many)))
    products = [math.prod(one - other for other in at if other is not one) for one in at]
    return np.column_stack([math.factorial(order) / product for product in products])


def _shows_corners(t_s: Array, q: Array, parts: int) -> npt.NDArray[np.bool_]:
    """(n,) Which nodes to keep, so that a jump of speed shows only at the nodes on either side of it. Left out is a
    node at which speed does not jump while it does at a node before and at one after it in the same interval of
    readings, as happens where times are uneven. t_s, q (n,): the nodes, s, and the path there; parts: nodes for each
    interval of readings."""
    shows = np.ones(len(t_s), dtype=bool)
    if parts < 2:
        return shows
    jump = np.zeros(len(t_s))
    jump[1:-1] = np.abs(np.diff(np.diff(q) / np.diff(t_s)))
    by_interval = np.column_stack([jump[:-1].reshape(-1, parts), jump[parts::parts]])  # with both its ends
    jumps = by_interval >= _NONE * by_interval.max(axis=1, keepdims=True)
    before = np.logical_or.accumulate(jumps, axis=1)
    after = np.logical_or.accumulate(jumps[:, ::-1], axis=1)[:, ::-1]
    shows[:-1].reshape(-1, parts)[:, 1:] = (jumps | ~(before & after))[:, 1:-1]
    return shows


def _corners_placed(t_s: Array, q: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Moves each jump of speed, which shows at two neighbouring nodes, to where the lines before and after it meet: one
    node in place of two. t_s, q, sigma (n,): the nodes, s, positions and sigmas; returns those that are left (m,)."""
    jump = np.diff(np.diff(q) / np.diff(t_s))  # at nodes 1 to n - 2
    # Of each two neighbours that jump the same way how much both do; one jump is where that is largest.
    pair = np.where(jump[1:] * jump[:-1] > 0.0, np.abs(jump[1:] + jump[:-1]), 0.0)
    around = np.concatenate([[0.0], pair, [0.0]])
    left = np.flatnonzero((pair > around[:-2]) & (pair >= around[2:])) + 1
    share = jump[left] / (jump[left - 1] + jump[left])  # of the gap; jump[left - 1] is the one at node `left`
    after_s = share * (t_s[left + 1] - t_s[left])
    t_s, q = t_s.copy(), q.copy()
    q[left] += after_s * (q[left] - q[left - 1]) / (t_s[left] - t_s[left - 1])
    t_s[left] += after_s
    return np.delete(t_s, left + 1), np.delete(q, left + 1), np.delete(sigma, left + 1)


def third_differences(t_s: Array, q: Array) -> tuple[Array, Array]:
    """For each four neighbouring readings q (n,) at rising times t_s (n,), the linear combination that is 0 on any
    parabola of time. Returns its factors (n - 3, 4), whose squares sum to 1, and its values (n - 3,): those of white
    noise have the noise's own variance."""
    factors, values = _native.third_differences_with_factors(t_s, q)
    return factors, values


def white_noise(t_s: Array, q: Array) -> float:
    """Standard deviation of the white noise on readings q (n,) of a smooth motion at rising times t_s (n,), s, in their
    unit: from the median size of their third differences; 0 for fewer than four."""
    return spread.deviation_of_squares(_native.third_differences(t_s, q) ** 2) if len(q) > 3 else 0.0


def _block_means(t_s: Array, q: Array) -> tuple[Array, Array]:
    """Times t_s, s, and readings q, (n,) each, averaged over blocks of neighbours as long as a grid interval, never
    across a pause: (m,) each. Unchanged where readings come no faster than the grid's nodes, or are few."""
    many = int(_GRID_S / float(np.median(np.diff(t_s))) + 1e-6)
    if many < 2 or len(q) < 4 * many:
        return t_s, q
    pauses = np.flatnonzero(np.diff(t_s) > _GRID_S) + 1
    begins = np.zeros(len(q), dtype=bool)
    begins[: len(q) - many + 1 : many] = begins[pauses] = True
    first = np.flatnonzero(begins)
    count = np.diff(np.append(first, len(q)))
    return np.add.reduceat(t_s, first) / count, np.add.reduceat(q, first) / count
