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
_LAST, _FEWEST_LAST = 8, 4  # tolerance: last frames of a stroke that tell its direction; the fewest that do
_HEADS = 10.0  # tolerance: sigma, by which they have to move
_TELLS = 10  # tolerance: frames of a stroke, from which a creep or a lag is looked for at its begin
_ON, _CREEPS = 8.0, 6  # tolerance: sigma by which the tip goes on the old way; frames for which it does, if it creeps
_SWINGS = 20.0  # tolerance: sigma, of a stroke: a shorter one tells no lag
_LOWEST = 3.0  # tolerance: sigma, within which z is at its lowest
_AT_ONCE, _FALLS = 3, 0.2  # tolerance: frames, in which z falls by so much of its depth where the tip goes on
_FEWEST = 4  # tolerance: frames of a stroke, from which an onset is looked for
_RESTS_S = 0.5  # tolerance: before a turn, for which the other degrees of freedom have to rest
_JUMPS_AT, _JUMPS_AFTER = 1.5, 3  # tolerance: of the hinge's knot, and frames after the departure: no jump is farther
_FEW_ONSETS, _MOST_GAIN = 8, 100.0  # tolerance: onsets that tell a mean gain by jumps, each cut to so much
_SHORTEST, _SHORTER = 8, 0.6  # tolerance: frames after the departure, at least; of a window that does not fit, the next
_FITS = 3.0  # tolerance: sigma of chi-square over its degrees of freedom: a window that leaves no more fits
_KNOT_AFTER = 2  # tolerance: frames after the departure, within which the knot is looked for
_LEAST_AFTER, _LEAST_WINDOW = 4, 5  # tolerance: frames of a window after the departure, and in all
_SPEED_S = 0.02  # tolerance: on either side of an onset, for the motor's speed
_GRID, _GRIDS = 61, 4  # tolerance: delays of a grid for the posterior; finer grids at most
_RESOLVED, _GRID_SIGMAS = 2.0, 6.0  # tolerance: pitches that make a standard deviation known; its half width, in sigma
_SAME_S = 2e-4  # tolerance: by less a delay is the same as before: the stops are, too
_SURELY_STILL = 0.7  # tolerance: of the frames till the tip's departure: gradual starts begin before they show
_MOVING, _STILL = 4, 3  # tolerance: frames before and after a turn that a stop has at least
_FEWEST_MOVING = 6  # tolerance: frames before a turn of which no fewer are tried; of more, the path is a parabola
_STOP_FITS = 4.0  # tolerance: as _FITS, of the frames at a stop
_NEARBY_S = np.linspace(-0.03, 0.03, 13)  # tolerance: around the delay: one of them has to fit


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
    """The onsets that are used and measure a width: hinges and brackets."""
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
    a turn the tip may still move the old way. If that is a creep it is subtracted from z, else the frames that still
    move so are left out; not in the first stroke, which follows no turn. Empty with fewer than two motor samples."""
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
    """(channels,) unit vector along which z (n, channels), in sigmas of a frame, moved in its _LAST frames; zeros if it
    moved by _HEADS or less, or with fewer than _FEWEST_LAST frames."""
    last = z[-_LAST:]
    if len(last) < _FEWEST_LAST:
        return np.zeros(z.shape[1])
    moved: Array = 0.5 * (last[-2] + last[-1] - last[0] - last[1])  # means of two: their difference has a sigma of 1
    size = float(np.sqrt(moved @ moved))
    return moved / size if size > _HEADS else np.zeros_like(moved)


def _creep(since_s: Array, z: Array, heading: Array) -> Array:
    """(n, channels) the part of z (n, channels) at since_s (n,), s after the turn, with which the tip creeps on along
    `heading` (channels,): A (1 - exp(-t / tau)), with tau one of _SETTLE_S, fitted to the frames before the tip comes
    back. Zeros if it goes on by less than _ON or for fewer frames than _CREEPS, if the shortest tau fits best, as for a
    lag, or if the creep explains less than the share _SETTLES."""
    none = np.zeros_like(z)
    if len(z) < _TELLS or not heading.any():
        return none
    ahead = _mean_of_three((z - z[0]) @ heading)
    stop = int(np.argmax(ahead))  # two frames before the middle of the furthest three
    if ahead[stop] < _ON or stop < _CREEPS:
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
    """How many frames after a turn still move the old way, because the tip lags or the delay is longer than is known
    yet: those before z (n, channels), along the stroke's direction, is within _LOWEST of its lowest. 0 if the stroke is
    short, or if z does not fall by more than _ON or not at once."""
    if len(z) < _TELLS:
        return 0
    way = _mean_of_three(z[-3:])[0] - _mean_of_three(z[:3])[0]
    swing = float(np.sqrt(way @ way))
    if swing < _SWINGS:
        return 0
    along = _mean_of_three(z @ way / swing)
    lowest = along.min()
    depth = along[0] - lowest
    # A jump back comes later, at the onset.
    at_once = along[0] - along[min(_AT_ONCE, len(along) - 1)] > max(_LOWEST, _FALLS * depth)
    return int(np.argmax(along < lowest + _LOWEST)) if depth > _ON and at_once else 0


def _mean_of_three(values: Array) -> Array:
    """(n - 2, ...) The mean of each three neighbours among values (n, ...)."""
    return np.asarray((values[:-2] + values[1:-1] + values[2:]) / 3.0)


def find_onsets(tracks: Sequence[Track], rig: Rig, delay_s: float, delay_sigma: float = 0.0) -> list[Onset]:
    """The onset of every reversal of every track, in order of time, at this delay, s. delay_sigma: its standard
    deviation, s, with which the widths' sigmas are increased."""
    onsets = []
    for number, track in enumerate(tracks):
        strokes = _strokes(track, rig, delay_s)
        for before, after in pairwise(strokes):
            onsets.append(_onset_of_stroke(number, track, before, after))
    onsets = [replace(onset, own_sigma=onset.sigma) for onset in _as_brackets_if_most_jump(onsets)]
    return with_timing_errors(onsets, tracks, rig, delay_sigma)


def delayed(onsets: Sequence[Onset], tracks: Sequence[Track], by_s: float) -> list[Onset]:
    """The same onsets for a delay that is longer by by_s, s, much less than a frame: the onset's scene is earlier by
    it, and the width is less by what the motor went in that time. `find_onsets` would give the same to first order.
    Onsets without a time stay."""
    moved = []
    for onset in onsets:
        if not np.isfinite(onset.t_s):
            moved.append(onset)
            continue
        t_s = onset.t_s - by_s
        before, now = tracks[onset.track].motor_at(np.array([onset.t_s, t_s]))
        # The motor's travel in by_s, towards the stroke's direction.
        less = onset.direction * (before - now)
        low, high = max(onset.low - less, 0.0), max(onset.high - less, 0.0)
        q2 = onset.q1 + onset.direction * max(onset.width - less, 0.0)
        moved.append(replace(onset, t_s=t_s, q2=q2, low=low, high=high))
    return moved


def _onset_of_stroke(number: int, track: Track, before: _Stroke, after: _Stroke) -> Onset:
    """The onset in the stroke `after` a turn of the track with this number. A bracket if a jump gains more than
    _JUMP_GAINS over a hinge, else a hinge; a bound if nothing moved. Not used, with a reason, if the frames do not tell
    it."""
    not_told = Onset(
        number, after.start_s, np.nan, after.direction, after.q1, after.q1 + after.direction * after.reach, np.inf,
        0.0, np.inf, NONE, False,
    )  # fmt: skip
    if len(after.frames) < _FEWEST:
        return replace(not_told, reason=f"fewer than {_FEWEST} frames show it")
    if not track.others_still(before.start_s if before.first else before.end_s - _RESTS_S, after.end_s):
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
    farthest = after.travel[min(after.departure + _JUMPS_AFTER, len(after.travel) - 1)]
    jump = fit_jump(x, y, max(hinge.knot * _JUMPS_AT, farthest), hinge.knot)
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
    """The onset as a bracket: its width is the middle of `low` and `high`, with the sigma of a uniform density between
    them."""
    middle = 0.5 * (onset.low + onset.high)
    spread = of_rounding(onset.high - onset.low)
    return replace(onset, kind=BRACKET, q2=onset.q1 + onset.direction * middle, sigma=max(float(spread), 1e-9))


def _as_brackets_if_most_jump(onsets: list[Onset]) -> list[Onset]:
    """The onsets with all used hinges turned into brackets, if most onsets with a width are jumps, or all together show
    jumps by their mean gain: then the image jumps at every reversal. Else the onsets as they are."""
    fitted = with_width(onsets)
    jumping = sum(o.kind == BRACKET for o in fitted)
    gains = [min(o.jump, _MOST_GAIN) for o in fitted]
    together = len(fitted) >= _FEW_ONSETS and float(np.mean(gains)) > _JUMPS_TOGETHER
    if 2 * jumping <= len(fitted) and not together:
        return onsets
    return [_as_bracket(o) if o.kind == HINGE and o.used else o for o in onsets]


def with_timing_errors(onsets: Sequence[Onset], tracks: Sequence[Track], rig: Rig, delay_sigma: float) -> list[Onset]:
    """The onsets with their own sigmas increased by errors of time: the motor's travel in delay_sigma, s (NOMINAL_S if
    that is inf, as no delay was found), and the rounding of the turn to a count of the encoder."""
    late_s, rounded = sigma_or_nominal(delay_sigma), of_rounding(rig.actuator.encoder_resolution)
    return [
        replace(o, sigma=float(np.hypot(o.own_sigma, np.hypot(motor_speed(o, tracks[o.track]) * late_s, rounded))))
        if np.isfinite(o.own_sigma)
        else o
        for o in onsets
    ]


def sigma_or_nominal(delay_sigma: float) -> float:
    """A delay's standard deviation, s; that of a nominal delay, NOMINAL_S, if it is inf, as no delay was found."""
    return delay_sigma if np.isfinite(delay_sigma) else NOMINAL_S


def motor_speed(onset: Onset, track: Track) -> float:
    """The motor's speed at the onset, unit of q per s."""
    around = track.motor_at(np.array([onset.t_s - _SPEED_S, onset.t_s + _SPEED_S]))
    return abs(float(around[1] - around[0])) / (2.0 * _SPEED_S)


def _fit_window(stroke: _Stroke) -> tuple[Array, Array, Hinge] | None:
    """The frames from the turn on to which the onset's hinge is fitted, and that hinge: travel x (n,), whitened y (n,
    channels). The longest window that a hinge fits within the noise (chi-square within _FITS sigmas of its degrees of
    freedom), or else the shortest that is tried, with _SHORTEST frames after the departure. None if there are too few
    frames."""
    departure = stroke.departure
    assert departure is not None
    frames, travel, z = stroke.frames, stroke.travel, stroke.z
    after = min(len(frames) - departure, _LONGEST)
    high = float(travel[min(departure + _KNOT_AFTER, len(travel) - 1)])
    while True:
        stop = departure + max(after, _LEAST_AFTER)
        x, y = travel[:stop], z[:stop]
        if high <= 0 or len(x) < _LEAST_WINDOW:
            return None
        hinge = fit_hinge(x, y, high)
        if after <= _SHORTEST or hinge.chi2 < hinge.freedom + _FITS * np.sqrt(2.0 * hinge.freedom):
            return x, y, hinge
        after = max(_SHORTEST, int(after * _SHORTER))


def _time_of_travel(track: Track, stroke: _Stroke, travel: float) -> float:
    """The time, s, at which the motor had gone `travel`, unit of q, beyond the turn; the stroke's end if it did not go
    so far."""
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
    """The delay at which the image stops when the motor turns: posterior mean and standard deviation, jointly over all
    reversals on an envelope. Its prior is normal about nominal_s with sigma NOMINAL_S; without such reversals the
    result is nominal_s with sigma inf. It may be negative, as for frames whose clock starts with the first of them. The
    stops are found anew at each new delay, up to _STOPS_ANEW times."""
    delay = nominal_s
    result = Delay(nominal_s, np.inf, 0)
    for _ in range(_STOPS_ANEW):
        stops = [stop for track in tracks for stop in _stops_of_track(track, rig, delay)]
        if not stops:
            return Delay(nominal_s, np.inf, 0)
        mean, spread = _posterior_of_delay(stops, nominal_s)
        moved = abs(mean - delay)
        delay, result = mean, Delay(mean, spread, len(stops))
        if moved < _SAME_S:
            break
    return result


def _posterior_of_delay(stops: Sequence[_Stop], nominal_s: float) -> tuple[float, float]:
    """Posterior mean and standard deviation, s, of the delay at which the frames after each stop's turn stand still, by
    grids of delays that become finer until one resolves it. If the least squares are more than noise leaves, all
    squares are divided by that ratio, so that the delay is less sure. nominal_s: mean of the prior."""
    grid = np.linspace(nominal_s - _DELAY_REACH_S, nominal_s + _DELAY_REACH_S, _GRID)
    freedom = sum(stop.freedom for stop in stops)
    for _ in range(_GRIDS):
        squares = np.sum([stop.squares(grid) for stop in stops], axis=0)
        pitch = grid[1] - grid[0]
        inflate = max(1.0, float(squares.min()) / freedom)
        deviance = squares / inflate + ((grid - nominal_s) / NOMINAL_S) ** 2
        best = int(np.argmin(deviance))
        weight = np.exp(-0.5 * np.clip(deviance - deviance[best], 0, 200))
        mean = float(weight @ grid / weight.sum())
        spread = float(np.sqrt(weight @ (grid - mean) ** 2 / weight.sum()))
        if spread > _RESOLVED * pitch:
            break
        # The next grid is centred at the best delay and reaches some standard deviations to either side.
        reach = max(_RESOLVED * pitch, _GRID_SIGMAS * spread)
        grid = np.linspace(grid[best] - reach, grid[best] + reach, _GRID)
    return mean, spread


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
        """(delays,) sums of squared residuals over noise at each of the delays (delays,), s. z is modelled as a
        polynomial (`order`) of the travel that the motor has left until the turn, and as constant after the turn."""
        return _native.still_squares(  # type: ignore[no-any-return]
            self.arrival_s, self.z, self.motor_t, self.motor_q, self.turn_s, self.q1, self.direction, self.order, delays
        )


def _stops_of_track(track: Track, rig: Rig, delay_s: float) -> list[_Stop]:
    """The stops of a track: turns before which the tip moves and after which it rests, for _MOVING and _STILL frames at
    least, while translation and rotation rest. delay_s: delay at which the strokes are taken, s."""
    stops = []
    for before, after in pairwise(_strokes(track, rig, delay_s)):
        if before.departure is None or not track.others_still(before.end_s - _RESTS_S, after.end_s):
            continue
        moving = len(before.frames) - before.departure
        still = len(after.frames) if after.departure is None else int(_SURELY_STILL * after.departure)
        if moving >= _MOVING and still >= _STILL:
            stops.append(_stop_between(track, before, after, min(moving, _BEFORE), min(still, _BEFORE), delay_s))
    return stops


def _stop_between(track: Track, before: _Stroke, after: _Stroke, count: int, still: int, delay_s: float) -> _Stop:
    """The stop at the turn between two strokes: the last `count` frames before it, at which the tip moves, and the
    first `still` ones after it, at which it rests. `count` is reduced, to _FEWEST_MOVING at least, until the model of
    `_Stop.squares` fits within the noise (chi-square within _STOP_FITS sigmas) at some delay near delay_s."""
    while True:
        frames = np.concatenate([before.frames[-count:], after.frames[:still]])
        z = np.concatenate(
            [track.y[before.frames[-count:]] / track.sigma[before.frames[-count:], None], after.z[:still]]
        )
        arrival = track.t_s[frames]
        times, positions = track.path.course(*(arrival[[0, -1]] - delay_s + _AROUND_S).tolist())
        order = 2 if count > _FEWEST_MOVING else 1
        stop = _Stop(arrival, times, positions, after.start_s, after.q1, -after.direction, z, order)
        least = stop.squares(delay_s + _NEARBY_S).min()
        if count <= _FEWEST_MOVING or least < stop.freedom + _STOP_FITS * np.sqrt(2.0 * stop.freedom):
            return stop
        count = max(_FEWEST_MOVING, int(count * _SHORTER))
