"""Onsets: after each reversal of the motor, the travel at which the image starts to move again, which is a width; and
the delay, from the moments at which the image stops when the motor turns.

No pose, no camera calibration: only that the image stands still while the motor crosses the backlash (eq. 1). A stroke
is what lies between two turns of the motor. y is whitened (over the stated noise) where it is called z. Positions,
travel and widths are in the unit of q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.calibration.hinge import Hinge, fit_hinge, fit_jump
from tautline.calibration.observations import Track, turning_hysteresis
from tautline.rig import Rig
from tautline.spread import of_rounding

Array = npt.NDArray[np.float64]

# Kinds of onsets: a knot with sigma, a jump between two frames, nothing moved (a lower bound), not told.
HINGE, BRACKET, BOUND, NONE = "hinge", "bracket", "bound", "none"
_LONGEST = 160  # tolerance: frames after the onset that one hinge takes in
_BEFORE = 24  # tolerance: frames before the turn that tell when the image stopped
_JUMP_GAINS = 40.0  # prior: of twice the log likelihood, over a hinge, from which an onset is a jump
_UNCERTAIN = 0.25  # tolerance: of the width or the stroke: an onset with a larger sigma does not count
_JUMP = 8.0  # tolerance: sigma: a quantised sensor's steps are no jumps
_JUMPS_TOGETHER = 8.0  # prior: mean chi-square that jumps explain; 1 to 3 where there are none
NOMINAL_S = 0.03  # prior: standard deviation of a nominal delay
_DELAY_REACH_S = 0.12  # tolerance: the delay is looked for this far around the nominal one
_AROUND_S = np.array([-0.5, 0.5])  # tolerance: of a stop: what the motor does in it, at any delay that is looked for
_SETTLE_S = np.geomspace(0.2, 8.0, 16)  # prior: time constants of a tip that creeps; the first one is a lag's
_STOPS_ANEW = 3  # tolerance: rounds
_SETTLES = 0.9  # tolerance: share of the squares after a turn that creeping must explain


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
    kind: str  # HINGE, BRACKET, BOUND or NONE
    used: bool
    reason: str = ""  # why it is not used
    slope: float = np.nan  # px (or deg) per unit of q at which the tip starts
    jump: float = 0.0  # chi-square that a jump of the image at the onset explains
    own_sigma: float = np.nan  # `sigma` without what the times of motor and sensor add

    @property
    def width(self) -> float:
        """How far the motor went from the turn to the onset, unit of q."""
        return abs(self.q2 - self.q1)

    @property
    def tells_width(self) -> bool:
        """Whether it is used and measures a width: others are bounds only."""
        return self.used and self.kind in (HINGE, BRACKET)

    @property
    def q_mean(self) -> float:
        """The middle between turn and onset, unit of q: the centre p at which B(p) is the width."""
        return 0.5 * (self.q1 + self.q2)


def with_width(onsets: Sequence[Onset]) -> list[Onset]:
    """The used onsets that measure a width; others are bounds only."""
    return [onset for onset in onsets if onset.tells_width]


# ---- strokes


@dataclass(frozen=True)
class _Stroke:
    """Frames between two turns of the motor, for a given delay."""

    start_s: float  # when the motor turned
    end_s: float  # when it turned again
    q1: float  # motor position at the turn
    direction: int  # sign of dq
    frames: npt.NDArray[np.intp]  # (frames,) of the track
    travel: Array  # (frames,) motor travel since the turn
    z: Array  # (frames, channels) whitened y, less what the tip creeps on the old way
    departure: int | None  # first frame (index into frames) at which the image has left its level
    first: bool  # it begins the recording, with no turn

    @property
    def reach(self) -> float:
        """How far the motor went from the turn in all frames, unit of q; 0 without any."""
        return float(self.travel.max(initial=0.0))


def _strokes(track: Track, rig: Rig, delay_s: float) -> list[_Stroke]:
    """The track's strokes from turn to turn of the motor, with the frames of each at this delay of the sensor, s. After
    a turn the tip may still move the old way: a creep that is found is taken off z; where none is, the first frames,
    which still move, are left out. (The first stroke follows no turn.)"""
    motor = track.motor
    q = np.ascontiguousarray(motor.q)
    hysteresis = turning_hysteresis(track.path, rig.actuator.encoder_resolution, rig.actuator.span)
    turns = _native.turns(q, hysteresis)
    if len(q) < 2:
        return []
    edges = np.concatenate([[0], turns, [len(q) - 1]])
    scene = track.scene_s(delay_s)
    q_at = track.motor_at(scene)
    inside = track.within_motor(scene)
    strokes: list[_Stroke] = []
    for k in range(len(edges) - 1):
        a, b = int(edges[k]), int(edges[k + 1])
        q1 = float(q[a])
        direction = 1 if q[b] >= q1 else -1
        start, end = float(motor.t_s[a]), float(motor.t_s[b])
        first, last = np.searchsorted(scene, (start, end))
        frames = first + np.flatnonzero(inside[first:last])
        travel = np.maximum(direction * (q_at[frames] - q1), 0.0)
        z = track.y[frames] / track.sigma[frames, None]
        if k > 0:
            creep = _creep(scene[frames] - start, z, _last_direction(strokes[-1].z))
            z = z - creep
            lagging = 0 if creep.any() else _lagging_frames(z)
            frames, travel, z = frames[lagging:], travel[lagging:], z[lagging:]
        departure = _native.still_until(np.ascontiguousarray(z))
        strokes.append(_Stroke(start, end, q1, direction, frames, travel, z, departure, first=k == 0))
    return strokes


def _last_direction(z: Array) -> Array:
    """(channels,) Unit vector along which z (n, channels), in sigmas of a frame, moved in its last eight frames; zeros
    where it moved by 10 sigmas or less, or there are fewer than four frames."""
    last = z[-8:]
    if len(last) < 4:
        return np.zeros(z.shape[1])
    moved: Array = last[-2:].mean(axis=0) - last[:2].mean(axis=0)  # means of two: their difference has a sigma of 1
    size = float(np.linalg.norm(moved))
    return moved / size if size > 10.0 else np.zeros_like(moved)


def _creep(since_s: Array, z: Array, heading: Array) -> Array:
    """(n, channels) the part of z (n, channels) at since_s (n,) after the turn with which the tip creeps on along
    `heading` (channels,), A (1 - exp(-t / tau)), fitted to the frames before it comes back. 0 where it does not creep,
    or for no longer than a lag."""
    none = np.zeros_like(z)
    if len(z) < 10 or not heading.any():
        return none
    ahead = np.convolve((z - z[0]) @ heading, np.ones(3) / 3, mode="valid")
    stop = int(np.argmax(ahead))  # two frames before the middle of the furthest three
    if ahead[stop] < 8.0 or stop < 6:  # sigma, frames
        return none
    gone = 1.0 - np.exp(-since_s / _SETTLE_S[:, None])  # (time constants, n)
    bent, off = gone[:, :stop] - gone[:, :stop].mean(axis=1, keepdims=True), z[:stop] - z[:stop].mean(axis=0)
    pull, power = bent @ off, np.sum(bent**2, axis=1)
    level, explained = float(np.sum(off**2)), np.sum(pull**2, axis=1) / power
    best = int(np.argmax(explained))
    # Less what noise alone leaves: one for each value.
    if best == 0 or level - explained[best] - off.size >= (1.0 - _SETTLES) * level:
        return none
    return np.asarray(gone[best][:, None] * pull[best] / power[best])


def _lagging_frames(z: Array) -> int:
    """How many frames after a turn still move the old way, as the tip lags or the delay is longer than is known yet:
    until z (n, channels), along the stroke's own direction, is within 3 sigma of its lowest. 0 where the stroke is
    short or z does not fall at once."""
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


def find_onsets(tracks: Sequence[Track], rig: Rig, delay_s: float, delay_sigma: float = 0.0) -> list[Onset]:
    """The onset of every reversal of every track, in order of time, at this delay, s. delay_sigma: its standard
    deviation, s, which adds to that of the widths."""
    onsets = []
    for number, track in enumerate(tracks):
        strokes = _strokes(track, rig, delay_s)
        for before, after in pairwise(strokes):
            onsets.append(_onset_of_stroke(number, track, before, after))
    onsets = [replace(onset, own_sigma=onset.sigma) for onset in _as_brackets_if_most_jump(onsets)]
    return with_timing_errors(onsets, tracks, rig, delay_sigma)


def delayed(onsets: Sequence[Onset], tracks: Sequence[Track], by_s: float) -> list[Onset]:
    """The same onsets if the delay is later by by_s, s, much less than a frame: the scene is earlier, so the motor was
    where it was then. To first order what `find_onsets` gives."""
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


def _onset_of_stroke(number: int, track: Track, before: _Stroke, after: _Stroke) -> Onset:
    """The onset in the stroke `after` a turn; number: of the track. A bracket where a jump gains more than _JUMP_GAINS
    over a hinge, else a hinge; a bound where nothing moved; not used, with a reason, where the frames do not tell
    it."""
    not_told = Onset(
        number, after.start_s, np.nan, after.direction, after.q1, after.q1 + after.direction * after.reach, np.inf,
        0.0, np.inf, NONE, False,
    )  # fmt: skip
    if len(after.frames) < 4:
        return replace(not_told, reason="fewer than 4 frames show it")
    if not track.others_still(before.start_s if before.first else before.end_s - 0.5, after.end_s):
        return replace(not_told, reason="translation or rotation moved")
    on_envelope = before.departure is not None and before.departure < len(before.frames) - 1
    if not on_envelope:
        return replace(not_told, reason="the tip was not on an envelope before it")
    if after.departure is None:
        reason = "nothing moved: the stroke is shorter than B"
        return replace(not_told, kind=BOUND, low=after.reach, used=True, reason=reason)
    window = _fit_window(after)
    if window is None:
        return replace(not_told, reason="too few frames around the onset")
    x, y, hinge = window
    jump = fit_jump(
        x, y, max(hinge.knot * 1.5, after.travel[min(after.departure + 3, len(after.travel) - 1)]), hinge.knot
    )
    gain = hinge.deviance - jump.deviance
    width, sigma = hinge.knot, max(hinge.sigma, 1e-9)
    kind = BRACKET if gain > _JUMP_GAINS and jump.size > _JUMP else HINGE
    at = _time_of_travel(track, after, width)
    onset = Onset(
        number, after.start_s, at, after.direction, after.q1, after.q1 + after.direction * width, sigma,
        jump.low, jump.high, kind, True,
        slope=float(np.linalg.norm(hinge.slope * track.sigma[after.frames[0]])),
        jump=gain if jump.size > _JUMP else 0.0,
    )  # fmt: skip
    if kind == BRACKET:
        onset = _as_bracket(onset)
    if onset.sigma > _UNCERTAIN * max(width, after.reach):
        onset = replace(onset, used=False, reason="the tip hardly moves here: the onset is too uncertain")
    return onset


def _as_bracket(onset: Onset) -> Onset:
    """The onset as a width known only between `low` and `high`: their middle, with the sigma of a uniform density."""
    middle = 0.5 * (onset.low + onset.high)
    spread = of_rounding(onset.high - onset.low)
    return replace(onset, kind=BRACKET, q2=onset.q1 + onset.direction * middle, sigma=max(float(spread), 1e-9))


def _as_brackets_if_most_jump(onsets: list[Onset]) -> list[Onset]:
    """The onsets; all as brackets if most reversals show a jump, or all together do by their mean gain: a jump is the
    rig's then."""
    fitted = with_width(onsets)
    jumping = sum(o.kind == BRACKET for o in fitted)
    together = len(fitted) >= 8 and float(np.mean([min(o.jump, 100.0) for o in fitted])) > _JUMPS_TOGETHER
    if 2 * jumping <= len(fitted) and not together:
        return onsets
    return [_as_bracket(o) if o.kind == HINGE and o.used else o for o in onsets]


def with_timing_errors(onsets: Sequence[Onset], tracks: Sequence[Track], rig: Rig, delay_sigma: float) -> list[Onset]:
    """The onsets, the sigma of each being its own, increased by the motor's travel during the delay's standard
    deviation, s (a nominal delay's where none was found, inf), and by the rounding of the turn to a count of the
    encoder."""
    late_s, rounded = known_to(delay_sigma), of_rounding(rig.actuator.encoder_resolution)
    return [
        replace(o, sigma=float(np.hypot(o.own_sigma, np.hypot(motor_speed(o, tracks[o.track]) * late_s, rounded))))
        if np.isfinite(o.own_sigma)
        else o
        for o in onsets
    ]


def known_to(delay_sigma: float) -> float:
    """The standard deviation of a delay, s: a nominal one's where it is inf, as none was found."""
    return delay_sigma if np.isfinite(delay_sigma) else NOMINAL_S


def motor_speed(onset: Onset, track: Track) -> float:
    """The motor's speed at the onset, unit of q per s."""
    around = track.motor_at(np.array([onset.t_s - 0.02, onset.t_s + 0.02]))
    return abs(float(around[1] - around[0])) / 0.04


def _fit_window(stroke: _Stroke) -> tuple[Array, Array, Hinge] | None:
    """The longest window from the turn that a hinge's path follows within the noise (chi-square within 3 sigma of its
    degrees of freedom): travel x (n,), whitened y (n, channels) and the hinge. None where there are too few frames."""
    departure = stroke.departure
    assert departure is not None
    frames, travel, z = stroke.frames, stroke.travel, stroke.z
    after = min(len(frames) - departure, _LONGEST)
    high = float(travel[min(departure + 2, len(travel) - 1)])
    while True:
        stop = departure + max(after, 4)
        x, y = travel[:stop], z[:stop]
        if high <= 0 or len(x) < 5:
            return None
        hinge = fit_hinge(x, y, high)
        if after <= 8 or hinge.chi2 < hinge.freedom + 3.0 * np.sqrt(2.0 * hinge.freedom):
            return x, y, hinge
        after = max(8, int(after * 0.6))


def _time_of_travel(track: Track, stroke: _Stroke, travel: float) -> float:
    """When, s, the motor had gone `travel` beyond the turn; the stroke's end where it did not go so far."""
    t, q = track.path.course(stroke.start_s, stroke.end_s)
    gone = np.maximum.accumulate(stroke.direction * (q - stroke.q1))
    return float(np.interp(travel, gone, t))


# ---- the delay, from the image stops


@dataclass(frozen=True)
class Delay:
    """By how much images are later than their scene."""

    delay_s: float
    sigma_s: float  # standard deviation; inf where nothing told it
    stops: int  # reversals that told it


def find_delay(tracks: Sequence[Track], rig: Rig, nominal_s: float) -> Delay:
    """Posterior mean and standard deviation of the delay at which the image stops when the motor turns, jointly over
    all reversals on an envelope, its prior normal about nominal_s with NOMINAL_S; the nominal one with sigma inf where
    there are none. It is negative where frames carry a clock that runs ahead, as a video's own times do that start with
    its first frame. The stops are found anew at each new delay."""
    delay = nominal_s
    result = Delay(nominal_s, np.inf, 0)
    for _ in range(_STOPS_ANEW):
        stops = [stop for track in tracks for stop in _stops_of_track(track, rig, delay)]
        if not stops:
            return Delay(nominal_s, np.inf, 0)
        grid = np.linspace(nominal_s - _DELAY_REACH_S, nominal_s + _DELAY_REACH_S, 61)
        for _ in range(4):
            squares = np.sum([stop.squares(grid) for stop in stops], axis=0)
            pitch = grid[1] - grid[0]
            freedom = sum(stop.freedom for stop in stops)
            inflate = max(1.0, float(squares.min()) / freedom)
            deviance = squares / inflate + ((grid - nominal_s) / NOMINAL_S) ** 2
            best = int(np.argmin(deviance))
            weight = np.exp(-0.5 * np.clip(deviance - deviance[best], 0, 200))
            mean = float(weight @ grid / weight.sum())
            spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
            if spread > 2 * pitch:
                break
            reach = max(2.0 * pitch, 6.0 * spread)
            grid = np.linspace(grid[best] - reach, grid[best] + reach, 61)
        moved = abs(mean - delay)
        delay, result = mean, Delay(mean, spread, len(stops))
        if moved < 2e-4:
            break
    return result


@dataclass(frozen=True)
class _Stop:
    """The frames around one turn of the motor that tell the delay."""

    arrival_s: Array  # (frames,) when they arrived
    motor_t: Array  # (knots,) of the motor's path around them, s
    motor_q: Array  # (knots,)
    turn_s: float  # when the motor turned
    q1: float  # where
    direction: int  # of the motor before the turn
    z: Array  # (frames, channels) whitened y
    order: int  # of the polynomial

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals, 1 at least."""
        return int(max(1, (len(self.arrival_s) - 1 - self.order) * self.z.shape[1]))

    def squares(self, delays: Array) -> Array:
        """(delays,) sums of squared residuals over noise, at each of delays (delays,), s, of z as a polynomial of the
        motor's travel that is left before the turn, and level after it."""
        return _native.still_squares(  # type: ignore[no-any-return]
            self.arrival_s, self.z, self.motor_t, self.motor_q, self.turn_s, self.q1, self.direction, self.order, delays
        )


def _stops_of_track(track: Track, rig: Rig, delay_s: float) -> list[_Stop]:
    """The stops of a track, found with the strokes at this delay, s. Of the frames before a turn those count that a
    short polynomial fits within the noise (4 sigma of chi-square), of those after it the ones at which the tip still
    rests."""
    strokes = _strokes(track, rig, delay_s)
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
            times, positions = track.path.course(*(arrival[[0, -1]] - delay_s + _AROUND_S).tolist())
            order = 2 if count > 6 else 1
            stop = _Stop(arrival, times, positions, after.start_s, after.q1, -after.direction, z, order)
            nearby = delay_s + np.linspace(-0.03, 0.03, 13)
            if count <= 6 or stop.squares(nearby).min() < stop.freedom + 4.0 * np.sqrt(2.0 * stop.freedom):
                break
            count = max(6, int(count * 0.6))
        stops.append(stop)
    return stops
