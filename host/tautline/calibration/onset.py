"""Reversals: where the image stops and where it starts again, as knots in the image position over motor position.

No pose, no camera calibration: only that the image stands still while the motor crosses the backlash (eq. 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.calibration.observations import Track, turning_hysteresis
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

HINGE, BRACKET, BOUND, NONE = "hinge", "bracket", "bound", "none"
_LONGEST = 160  # frames after the onset that one hinge takes in
_BEFORE = 24  # frames before the turn that tell when the image stopped
_JUMP = 8.0  # sigma: a quantised sensor's steps are no jumps
_JUMPS_TOGETHER = 8.0  # mean chi-square that jumps explain; 1 to 3 where there are none
_SUDDEN = 0.35  # of the window's mean slope: a path that starts slower is no hinge but a bend
_NOMINAL_S = 0.03  # standard deviation of a nominal delay
_PER_TERM = 3.5  # chi-square that one more term of a path must explain: between AIC (2) and BIC (4.5)
_DELAY_REACH_S = 0.12  # the delay is looked for this far around the nominal one
_AROUND_S = np.array([-0.5, 0.5])  # of a stop: what the motor does in it, at any delay that is looked for
_SETTLE_S = np.geomspace(0.2, 8.0, 16)  # time constants of a tip that creeps; the first one is a lag's
_SETTLES = 0.9  # share of the squares after a turn that creeping must explain


@dataclass(frozen=True)
class Onset:
    """One reversal of the motor and what the tip did after it."""

    track: int
    turn_s: float  # when the motor turned
    t_s: float  # scene time at which the tip moved again; NaN where it did not
    direction: int  # sign of dq after the turn
    q1: float  # motor position at the turn
    q2: float  # at the onset
    sigma: float  # of the width, unit of q; of a bracket: the standard deviation of a uniform density on it
    low: float  # width is at least this: the bracket's lower end, or the whole stroke where nothing moved
    high: float  # width is at most this (inf for a bound)
    kind: str
    used: bool
    reason: str = ""  # why it is not used
    slope: float = np.nan  # px (or deg) per unit of q at which the tip starts
    jump: float = 0.0  # chi-square that a jump of the image at the onset explains

    @property
    def width(self) -> float:
        return abs(self.q2 - self.q1)

    @property
    def q_mean(self) -> float:
        return 0.5 * (self.q1 + self.q2)


@dataclass(frozen=True)
class Hinge:
    """Level, then a knot, then a path: the knot's posterior mean and standard deviation."""

    knot: float
    sigma: float
    chi2: float
    freedom: int
    slope: Array  # (channels,) of whitened y per unit of x, just after the knot


# ---- least squares on many candidate knots at once


def _profile(ramp: Array, order: int, y: Array, step: Array | None = None) -> tuple[Array, Array]:
    """Best fits of level + ramp polynomial (+ jump) to y (n, channels) for K candidates at once.

    ramp (K, n): distance beyond the candidate's knot, 0 before it. Returns sums of squares (K,) and coefficients
    (K, 1 + order (+ 1), channels) of [level, ramp, ramp^2, ... (, jump)]."""
    reach = np.maximum(np.abs(ramp).max(axis=1, keepdims=True), 1e-12)
    unit = ramp / reach
    columns = [np.ones_like(unit)] + [unit**k for k in range(1, order + 1)]
    if step is not None:
        columns.append(step)
    basis = np.stack(columns, axis=2)
    centre = y - y[:1]
    transposed = basis.transpose(0, 2, 1)
    gram = transposed @ basis
    gram += 1e-11 * len(y) * np.eye(gram.shape[1])
    right = transposed @ centre
    coefficients = np.linalg.solve(gram, right)
    squares = np.sum(centre**2) - np.sum(coefficients * right, axis=(1, 2))
    coefficients[:, : 1 + order] /= reach[:, :, None] ** np.arange(order + 1)[None, :, None]
    return np.maximum(squares, 0.0), coefficients


def fit_hinge(x: Array, y: Array, order: int, low: float, high: float) -> Hinge:
    """The knot, within [low, high], of y (n, channels; unit variance) = level before it, a polynomial of (x - knot)
    without constant term after it. x (n,) is motor travel since the turn."""
    grid = np.linspace(low, high, 49)
    squares, coefficients = _ramp_profile(x, y, order, grid)
    for _ in range(6):  # towards the likelihood's bulk, whatever its width
        best = int(np.argmin(squares))
        weight = np.exp(-0.5 * np.clip(squares - squares[best], 0, 200))
        mean = float(weight @ grid / weight.sum())
        spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
        pitch = grid[1] - grid[0]
        if spread > 2.0 * pitch:
            break
        reach = max(6.0 * spread, 3.0 * pitch)
        centre = mean if spread > 0 else grid[best]
        grid = np.linspace(max(low, centre - reach), min(high, centre + reach), 49)
        if grid[-1] - grid[0] < 1e-9 * (high - low + 1e-12):
            break
        squares, coefficients = _ramp_profile(x, y, order, grid)
    best = int(np.argmin(squares))
    weight = np.exp(-0.5 * np.clip(squares - squares[best], 0, 200))
    mean = float(weight @ grid / weight.sum())
    spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
    freedom = y.size - (1 + order) * y.shape[1] - 1
    return Hinge(mean, spread, float(squares[best]), max(freedom, 1), coefficients[best, 1])


def _ramp_profile(x: Array, y: Array, order: int, knots: Array) -> tuple[Array, Array]:
    return _profile(np.maximum(x[None, :] - knots[:, None], 0.0), order, y)


@dataclass(frozen=True)
class Jump:
    """Level, then a jump of unknown size: the frames bracket the onset."""

    low: float
    high: float
    size: float  # of the jump, in sigma
    chi2: float
    freedom: int


def fit_jump(x: Array, y: Array, order: int, low: float, high: float) -> Jump:
    """As fit_hinge with a free jump at the knot: x of the last still and of the first moving frame. Where neighbouring
    brackets fit almost as well (chi-square within 9), their union."""
    edges = np.unique(x)
    edges = edges[(edges >= low) & (edges <= high)]
    if len(edges) < 2:
        return Jump(low, high, 0.0, np.inf, 1)
    knots = 0.5 * (edges[1:] + edges[:-1])
    beyond = x[None, :] - knots[:, None]
    squares, coefficients = _profile(np.maximum(beyond, 0.0), order, y, (beyond > 0).astype(float))
    best = int(np.argmin(squares))
    near = np.flatnonzero(squares < squares[best] + 9.0)
    freedom = y.size - (2 + order) * y.shape[1] - 1
    size = float(np.linalg.norm(coefficients[best, -1]))
    return Jump(float(edges[near[0]]), float(edges[near[-1] + 1]), size, float(squares[best]), max(freedom, 1))


# ---- strokes


@dataclass(frozen=True)
class _Stroke:
    """Frames between two turns of the motor, for a given delay."""

    start_s: float
    end_s: float
    q1: float
    direction: int
    frames: npt.NDArray[np.intp]
    travel: Array  # (frames,) motor travel since the turn
    z: Array  # (frames, channels) whitened positions, without what the tip still creeps the old way
    departure: int | None  # first frame (index into frames) at which the image has left its level
    first: bool

    @property
    def reach(self) -> float:
        return float(self.travel.max(initial=0.0))


def _strokes(track: Track, rig: Rig, delay_s: float) -> list[_Stroke]:
    motor = track.motor
    q = np.ascontiguousarray(motor.q)
    hysteresis = turning_hysteresis(motor, rig.actuator.encoder_resolution, rig.actuator.span)
    turns = _native.turns(q, hysteresis)
    if len(q) < 2:
        return []
    edges = np.concatenate([[0], turns, [len(q) - 1]])
    scene = track.scene_s(delay_s)
    at = track.motor_at(scene)
    inside = track.within_motor(scene)
    strokes: list[_Stroke] = []
    for k in range(len(edges) - 1):
        a, b = int(edges[k]), int(edges[k + 1])
        q1 = float(q[a])
        direction = 1 if q[b] >= q1 else -1
        start, end = float(motor.t_s[a]), float(motor.t_s[b])
        frames = np.flatnonzero((scene >= start) & (scene < end) & inside)
        travel = np.maximum(direction * (at[frames] - q1), 0.0)
        z = track.y[frames] / track.sigma[frames, None]
        if k > 0:
            creep = _settling(scene[frames] - start, z, _heading(strokes[-1].z))
            z = z - creep
            tail = 0 if creep.any() else _tail(z)
            frames, travel, z = frames[tail:], travel[tail:], z[tail:]
        strokes.append(_Stroke(start, end, q1, direction, frames, travel, z, _departure(z), k == 0))
    return strokes


def _heading(z: Array) -> Array:
    """(channels,) which way the image moved last; 0 where it hardly did."""
    last = z[-8:]
    if len(last) < 4:
        return np.zeros(z.shape[1])
    way: Array = last[-2:].mean(axis=0) - last[:2].mean(axis=0)
    size = float(np.linalg.norm(way))
    return way / size if size > 10.0 else np.zeros_like(way)


def _settling(since_s: Array, z: Array, heading: Array) -> Array:
    """(n, channels) what the tip goes on moving along `heading` after the motor turned at 0 s: A (1 - exp(-t / tau)),
    fitted to the frames before it comes back. 0 where it does not, or for no longer than a lag (_tail)."""
    none = np.zeros_like(z)
    if len(z) < 10 or not heading.any():
        return none
    ahead = np.convolve((z - z[0]) @ heading, np.ones(3) / 3, mode="valid")
    stop = int(np.argmax(ahead))  # two frames before the middle of the furthest three
    if ahead[stop] < 8.0 or stop < 6:
        return none
    best, least = none, np.inf
    for tau in _SETTLE_S:
        gone = 1.0 - np.exp(-since_s / tau)
        basis = np.column_stack([np.ones(stop), gone[:stop]])
        coefficients, *_ = np.linalg.lstsq(basis, z[:stop], rcond=None)
        squares = float(np.sum((z[:stop] - basis @ coefficients) ** 2))
        if squares < least:
            least, best = squares, gone[:, None] * coefficients[1] if tau > _SETTLE_S[0] else none
    level = float(np.sum((z[:stop] - z[:stop].mean(axis=0)) ** 2))
    return best if least - z[:stop].size < (1.0 - _SETTLES) * level else none


def _tail(z: Array) -> int:
    """How many frames after a turn still move the old way: the tip lags, or the delay is longer than is known yet."""
    if len(z) < 10:
        return 0
    way = z[-3:].mean(axis=0) - z[:3].mean(axis=0)
    if np.linalg.norm(way) < 20.0:
        return 0
    along = np.convolve(z @ way / np.linalg.norm(way), np.ones(3) / 3, mode="valid")
    lowest = along.min()
    depth = along[0] - lowest
    at_once = along[0] - along[min(3, len(along) - 1)] > max(3.0, 0.2 * depth)  # a jump back comes later, at the onset
    return int(np.argmax(along < lowest + 3.0)) if depth > 8.0 and at_once else 0


def _departure(z: Array) -> int | None:
    """The first frame at which whitened positions z (n, channels) have left the level that they started from."""
    n = len(z)
    if n < 3:
        return None
    total = np.concatenate([np.zeros((1, z.shape[1])), np.cumsum(z - z[0], axis=0)])
    swing = float(np.sqrt(np.max(np.sum((z - z[0]) ** 2, axis=1))))
    first: int | None = None
    for block in (1, 2, 4, 8, 16, 32):
        if n < block + 1:
            break
        j = np.arange(1, n - block + 1)
        level = total[j] / j[:, None]
        ahead = (total[j + block] - total[j]) / block
        distance = np.sqrt(np.sum((ahead - level) ** 2, axis=1))
        # 5.5 sigma by chance once in 3 million; 2 % of the whole swing keeps small wobbles inside the backlash.
        left = distance > np.maximum(5.5 * np.sqrt(1.0 / block + 1.0 / j), 0.02 * swing)
        if block == 1:  # one frame alone may be an outlier
            left[:-1] &= left[1:]
            left[-1:] = False
        if left.any():
            at = int(j[np.argmax(left)]) + block - 1
            first = at if first is None else min(first, at)
    return first


def find_onsets(tracks: Sequence[Track], rig: Rig, delay_s: float, delay_sigma: float = 0.0) -> list[Onset]:
    """Every reversal of every track, in order of time, with the widths that count."""
    onsets = []
    for number, track in enumerate(tracks):
        strokes = _strokes(track, rig, delay_s)
        for before, after in pairwise(strokes):
            onsets.append(_onset(number, track, before, after, rig, delay_s))
    onsets = _pooled_jumps(onsets)
    resolution = rig.actuator.encoder_resolution
    return [_with_clock_and_counts(onset, tracks[onset.track], delay_sigma, resolution) for onset in onsets]


def delayed(onsets: Sequence[Onset], tracks: Sequence[Track], by_s: float) -> list[Onset]:
    """The same onsets where the images are later by much less than a frame than they were found with: the scene is
    earlier, the motor where it was then. To first order what `find_onsets` gives."""
    moved = []
    for onset in onsets:
        if not np.isfinite(onset.t_s):
            moved.append(onset)
            continue
        t_s = onset.t_s - by_s
        before, now = tracks[onset.track].motor_at(np.array([onset.t_s, t_s]))
        less = onset.direction * (before - now)
        low, high = max(onset.low - less, 0.0), max(onset.high - less, 0.0)
        q2 = onset.q1 + onset.direction * max(onset.width - less, 0.0)
        moved.append(replace(onset, t_s=t_s, q2=q2, low=low, high=high))
    return moved


def _onset(number: int, track: Track, before: _Stroke, after: _Stroke, rig: Rig, delay_s: float) -> Onset:
    reach = after.reach
    nothing = Onset(
        number, after.start_s, np.nan, after.direction, after.q1, after.q1 + after.direction * reach, np.inf,
        0.0, np.inf, NONE, False,
    )  # fmt: skip
    if len(after.frames) < 4:
        return replace(nothing, reason="fewer than 4 frames show it")
    if not track.others_still(before.start_s if before.first else before.end_s - 0.5, after.end_s):
        return replace(nothing, reason="translation or rotation moved")
    on_envelope = before.departure is not None and before.departure < len(before.frames) - 1
    if after.departure is None:
        if not on_envelope:
            return replace(nothing, reason="the tip was not on an envelope before it")
        return replace(nothing, kind=BOUND, low=reach, used=True, reason="nothing moved: the stroke is shorter than B")
    if not on_envelope:
        return replace(nothing, reason="the tip was not on an envelope before it")
    window = _fit_window(after)
    if window is None:
        return replace(nothing, reason="too few frames around the onset")
    x, y, order, hinge = window
    jump = fit_jump(
        x, y, order, 0.0, max(hinge.knot * 1.5, after.travel[min(after.departure + 3, len(after.travel) - 1)])
    )
    inflate = max(1.0, hinge.chi2 / hinge.freedom)
    gain = (hinge.chi2 - jump.chi2) / max(1.0, jump.chi2 / jump.freedom)
    width = hinge.knot
    sigma = hinge.sigma * np.sqrt(inflate)
    kind = BRACKET if gain > 40.0 and jump.size > _JUMP else HINGE
    at = _time_at(track, after, width)
    onset = Onset(
        number, after.start_s, at, after.direction, after.q1, after.q1 + after.direction * width, max(sigma, 1e-9),
        jump.low, jump.high, kind, True,
        slope=float(np.linalg.norm(hinge.slope * track.sigma[after.frames[0]])),
        jump=gain if jump.size > _JUMP else 0.0,
    )  # fmt: skip
    if kind == BRACKET:
        onset = _as_bracket(onset)
    if onset.sigma > 0.25 * max(width, reach):
        onset = replace(onset, used=False, reason="the tip hardly moves here: the onset is too uncertain")
    return onset


def _as_bracket(onset: Onset) -> Onset:
    middle = 0.5 * (onset.low + onset.high)
    spread = (onset.high - onset.low) / np.sqrt(12.0)
    return replace(onset, kind=BRACKET, q2=onset.q1 + onset.direction * middle, sigma=max(float(spread), 1e-9))


def _pooled_jumps(onsets: list[Onset]) -> list[Onset]:
    """A jump at the onset belongs to the rig: where most reversals show it, or all together do, all are brackets."""
    fitted = [o for o in onsets if o.kind in (HINGE, BRACKET) and o.used]
    jumping = sum(o.kind == BRACKET for o in fitted)
    together = len(fitted) >= 8 and float(np.mean([min(o.jump, 100.0) for o in fitted])) > _JUMPS_TOGETHER
    if 2 * jumping <= len(fitted) and not together:
        return onsets
    return [_as_bracket(o) if o.kind == HINGE and o.used else o for o in onsets]


def _with_clock_and_counts(onset: Onset, track: Track, delay_sigma: float, resolution: float) -> Onset:
    """Adds what the delay's uncertainty and a turn that is known to a count do to the width."""
    if not np.isfinite(onset.sigma):
        return onset
    speed = 0.0
    if np.isfinite(delay_sigma):
        around = track.motor_at(np.array([onset.t_s - 0.02, onset.t_s + 0.02]))
        speed = abs(float(around[1] - around[0])) / 0.04
    extra = np.hypot(speed * (delay_sigma if speed else 0.0), resolution / np.sqrt(12.0))
    return replace(onset, sigma=float(np.hypot(onset.sigma, extra)))


def _fit_window(stroke: _Stroke) -> tuple[Array, Array, int, Hinge] | None:
    """The longest window after the onset that a polynomial of order 3 or less follows within the noise, the best order
    for it, and the hinge on it, averaged over the orders."""
    departure = stroke.departure
    assert departure is not None
    frames, travel, z = stroke.frames, stroke.travel, stroke.z
    after = min(len(frames) - departure, _LONGEST)
    while True:
        stop = departure + max(after, 4)
        x, y = travel[:stop], z[:stop]
        top = min(3, max(1, (after - 2) // 3))
        high = float(travel[min(departure + 2, len(travel) - 1)])
        if high <= 0 or len(x) < 5:
            return None
        fits = [(order, fit_hinge(x, y, order, 0.0, high)) for order in range(1, top + 1)]
        fits = [f for f in fits if f[0] == 1 or _sudden(x, y, f[1])]
        good = [f for f in fits if f[1].chi2 < f[1].freedom + 3.0 * np.sqrt(2.0 * f[1].freedom)]
        if good or after <= 8:
            return x, y, *_averaged(good or fits, y)
        after = max(8, int(after * 0.6))


def _averaged(fits: list[tuple[int, Hinge]], y: Array) -> tuple[int, Hinge]:
    """Best order, and the knot averaged over the orders by what they explain: the path's own bend is not known."""
    inflate = max(1.0, min(h.chi2 / h.freedom for _, h in fits))
    score = np.array([h.chi2 / inflate + _PER_TERM * order * y.shape[1] for order, h in fits])
    weight = np.exp(-0.5 * (score - score.min()))
    weight /= weight.sum()
    knots = np.array([h.knot for _, h in fits])
    mean = float(weight @ knots)
    spread = float(np.sqrt(weight @ (np.array([h.sigma for _, h in fits]) ** 2 + (knots - mean) ** 2)))
    order, best = fits[int(np.argmin(score))]
    return order, replace(best, knot=mean, sigma=spread)


def _sudden(x: Array, y: Array, hinge: Hinge) -> bool:
    """Whether the tip starts at about the speed that it goes on with."""
    gone = y[-3:].mean(axis=0) - y[: max(1, int(np.sum(x < hinge.knot)))].mean(axis=0)
    mean = gone / max(float(x[-3:].mean()) - hinge.knot, 1e-12)
    return float(hinge.slope @ mean) > _SUDDEN * float(mean @ mean)


def _time_at(track: Track, stroke: _Stroke, travel: float) -> float:
    """When the motor had gone `travel` beyond the turn."""
    motor = track.motor
    span = slice(*np.searchsorted(motor.t_s, [stroke.start_s, stroke.end_s], side="left"))
    t = motor.t_s[span]
    gone = np.maximum.accumulate(stroke.direction * (motor.q[span] - stroke.q1))
    beyond = int(np.searchsorted(gone, travel))
    if len(t) == 0 or beyond == 0:
        return stroke.start_s
    if beyond >= len(t):
        return stroke.end_s
    share = (travel - gone[beyond - 1]) / max(gone[beyond] - gone[beyond - 1], 1e-12)
    return float(t[beyond - 1] + share * (t[beyond] - t[beyond - 1]))


# ---- the delay, from the image stops


@dataclass(frozen=True)
class Delay:
    delay_s: float
    sigma_s: float
    stops: int  # reversals that told it


def find_delay(tracks: Sequence[Track], rig: Rig, nominal_s: float, passes: int = 3) -> Delay:
    """The delay at which the image stops when the motor turns, jointly over all reversals on an envelope. Less than 0
    where frames carry a clock that runs ahead, as a video's own time does that starts with its first frame."""
    delay = nominal_s
    result = Delay(nominal_s, np.inf, 0)
    for _ in range(passes):
        stops = [stop for track in tracks for stop in _stops(track, rig, delay)]
        if not stops:
            return Delay(nominal_s, np.inf, 0)
        grid = np.linspace(nominal_s - _DELAY_REACH_S, nominal_s + _DELAY_REACH_S, 61)
        for _ in range(4):
            squares = np.sum([stop.squares(grid) for stop in stops], axis=0)
            pitch = grid[1] - grid[0]
            freedom = sum(stop.freedom for stop in stops)
            inflate = max(1.0, float(squares.min()) / freedom)
            surprise = squares / inflate + ((grid - nominal_s) / _NOMINAL_S) ** 2
            best = int(np.argmin(surprise))
            weight = np.exp(-0.5 * np.clip(surprise - surprise[best], 0, 200))
            mean = float(weight @ grid / weight.sum())
            spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
            if spread > 2 * pitch:
                break
            grid = np.linspace(grid[best] - 2 * pitch, grid[best] + 2 * pitch, 61)
        moved = abs(mean - delay)
        delay, result = mean, Delay(mean, spread, len(stops))
        if moved < 2e-4:
            break
    return result


@dataclass(frozen=True)
class _Turn:
    arrival_s: Array  # (frames,)
    motor_t: Array  # around them
    motor_q: Array
    turn_s: float
    q1: float
    direction: int  # before the turn
    z: Array  # (frames, channels) as in _Stroke
    order: int

    @property
    def freedom(self) -> int:
        return int(max(1, (len(self.arrival_s) - 1 - self.order) * self.z.shape[1]))

    def squares(self, delays: Array) -> Array:
        scene = self.arrival_s[None, :] - delays[:, None]
        behind = np.minimum(self.direction * (np.interp(scene, self.motor_t, self.motor_q) - self.q1), 0.0)
        behind = np.where(scene < self.turn_s, behind, 0.0)
        return _profile(behind, self.order, self.z)[0]


def _stops(track: Track, rig: Rig, delay_s: float) -> list[_Turn]:
    strokes, motor = _strokes(track, rig, delay_s), track.motor
    stops = []
    for before, after in pairwise(strokes):
        if before.departure is None or not track.others_still(before.end_s - 0.5, after.end_s):
            continue
        moving = len(before.frames) - before.departure
        # Where the tip starts gradually, it has begun before it is noticed.
        still = len(after.frames) if after.departure is None else int(0.7 * after.departure)
        still = min(still, _BEFORE)
        if moving < 4 or still < 3:
            continue
        count = min(moving, _BEFORE)
        while True:
            frames = np.concatenate([before.frames[-count:], after.frames[:still]])
            z = np.concatenate(
                [track.y[before.frames[-count:]] / track.sigma[before.frames[-count:], None], after.z[:still]]
            )
            arrival = track.t_s[frames]
            around = slice(*np.searchsorted(motor.t_s, arrival[[0, -1]] - delay_s + _AROUND_S))
            times, positions = motor.t_s[around], motor.q[around]
            order = 2 if count > 6 else 1
            stop = _Turn(arrival, times, positions, after.start_s, after.q1, -after.direction, z, order)
            nearby = delay_s + np.linspace(-0.03, 0.03, 13)
            if count <= 6 or stop.squares(nearby).min() < stop.freedom + 4.0 * np.sqrt(2.0 * stop.freedom):
                break
            count = max(6, int(count * 0.6))
        stops.append(stop)
    return stops
