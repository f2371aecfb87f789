"""Simulates a play at each frame of a track: the motor's positions as the frames saw them, the play's centre, and which
frames count.

Positions and B are in the unit of q; n frames of a track."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tautline.calibration.beside import FittedEffects
from tautline.calibration.observations import Mask, Track, corners
from tautline.elements import SINGLE, Hysteresis, Play
from tautline.nominal import by_width, steepness
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

_SELDOM = 0.1  # tolerance: of the positions, at which B may be less than what counts as driven through
_SLOPE_S = 0.004  # tolerance: least half interval over which the motor's speed is taken


@dataclass(frozen=True)
class Simulated:
    """What the model says at each frame of one track, (n,) all."""

    p: Array  # centre of the play
    tip: Array  # where along the followed curve: p, but for effects behind the play
    known: Mask  # the play has forgotten where it started, and motor samples cover the frame
    settled: Mask  # known, and driven through a full backlash in both directions
    side: npt.NDArray[np.int8]  # envelope that last moved p (of several elements: that last held them all)
    lean: Array  # -2 dp/dB where B is constant; of one element its side
    share: Array  # dp/dq there: of one element 1 where p moves with q at this frame, else 0
    speed: Array  # dq/dt, per s

    @property
    def half_cycle(self) -> npt.NDArray[np.intp]:
        """(n,) number of the tip's half-cycle at each frame, from 0; a new one begins when the envelope changes."""
        return np.asarray(np.cumsum(np.diff(self.side.astype(int), prepend=self.side[:1]) != 0))

    @property
    def moving(self) -> Mask:
        """(n,) frames at which the tip moves."""
        moves: Mask = self.share > 0
        return moves

    def slopes(self, keep: Mask, slope: Array) -> tuple[Array, Array]:
        """Derivatives of p at the frames that are kept: by B (kept,), and by the delay (kept,), unit of q per s. slope
        (kept,): dB/dp there."""
        lean = self.lean[keep]
        return by_width(lean, slope), -self.speed[keep] * self.share[keep] / steepness(lean, slope)


def half_slope_s(readings: Motor) -> float:
    """Half the interval, s, over which a motor's speed is taken: the median period of its samples, at least
    _SLOPE_S."""
    return max(_SLOPE_S, readings.period_s) if len(readings.t_s) > 1 else _SLOPE_S


@dataclass(frozen=True)
class MotorAtFrames:
    """The motor as the frames of one track saw it at one delay."""

    positions: Array  # (m,) all that a play needs, in order of time: extremes, and those at the frames
    at: npt.NDArray[np.intp]  # (n,) which of these are at the frames
    within: Mask  # (n,) motor samples cover the frame
    speed: Array  # (n,) dq/dt, per s

    @cached_property
    def rise(self) -> Array:
        """(m,) The largest ascent so far, unit of q: from the lowest position to any later one. Once it exceeds B the
        play has been driven through upwards."""
        return np.asarray(np.maximum.accumulate(self.positions - np.minimum.accumulate(self.positions)))

    @cached_property
    def fall(self) -> Array:
        """(m,) The largest descent so far, unit of q, from the highest position to any later one: as `rise`."""
        return np.asarray(np.maximum.accumulate(np.maximum.accumulate(self.positions) - self.positions))

    def driven_through(self, travel: float) -> int:
        """The index of the first position by which the motor has gone up by `travel`, unit of q, and down by it; m if
        there is none."""
        return max(int(np.searchsorted(self.rise, travel)), int(np.searchsorted(self.fall, travel)))


@dataclass(frozen=True)
class PreparedTrack:
    """One track prepared for many simulations."""

    track: Track
    corner_t: Array  # (c,) times of the motor's extremes, s
    corner_q: Array  # (c,) its positions there
    use: Mask  # (n,) frames that may count
    half_s: float  # half the interval over which the motor's speed is taken
    last: dict[float, MotorAtFrames] = field(init=False, default_factory=dict, compare=False, repr=False)  # by delay

    @classmethod
    def of(cls, track: Track, use: Mask | None = None) -> PreparedTrack:
        """The track with its motor's extremes; use (n,): frames that may count, all by default."""
        times, positions = corners(track.motor)
        use = np.ones(len(track.t_s), bool) if use is None else use
        return cls(track, times, positions, use, half_slope_s(track.reading))

    @cached_property
    def counting(self) -> PreparedTrack:
        """The track with only the frames that may count, which is all that a descent needs. For a sensor that rounds
        all frames stay, as they tell how long the tip rests."""
        if self.use.all() or self.track.step > 0.0:
            return self
        return replace(self, track=self.track.only(self.use), use=self.use[self.use])

    def course(self, scene_s: Array, q: Array) -> tuple[Array, npt.NDArray[np.intp]]:
        """The motor's positions (m,) that a play needs, in order of time: its extremes, and q (n,) at times scene_s
        (n,), s; and the indices (n,) of the latter."""
        times = np.concatenate([self.corner_t, scene_s])
        order = np.argsort(times, kind="stable")
        back = np.empty(len(times), dtype=np.intp)
        back[order] = np.arange(len(times))
        return np.concatenate([self.corner_q, q])[order], back[len(self.corner_t) :]

    def driven(self, delay_s: float) -> MotorAtFrames:
        """The motor at the frames for this delay, s; kept in `last` until another delay is asked for, as many widths
        are simulated at one delay."""
        if delay_s not in self.last:
            track, scene = self.track, self.track.scene_s(delay_s)
            # Looked up in order of time: neighbours are found at once.
            around = scene[:, None] + np.array([-self.half_s, 0.0, self.half_s])
            before, q, after = track.motor_at(around.ravel()).reshape(around.shape).T
            positions, at = self.course(scene, q)
            speed = (after - before) / (2 * self.half_s)
            self.last.clear()
            self.last[delay_s] = MotorAtFrames(positions, at, track.within_motor(scene), speed)
        return self.last[delay_s]

    def simulate(
        self, grid: Array, width: Array, delay_s: float, hysteresis: Hysteresis = SINGLE,
        effects: FittedEffects | None = None, effect_values: Array | None = None,
    ) -> Simulated:  # fmt: skip
        """The tip at each frame, by a play of B width (nodes,) on grid (nodes,) at this delay, s, and effects with
        values effect_values (parameters,), as `FittedEffects.parameters` has them. The play is run from both far ends,
        each so far away that it starts on an envelope; where both agree it has forgotten its start. A frame is settled
        once both ways nearly the least B was driven through (`_low_quantile_of_width`). With effects p, tip, side and
        lean are those of their path. Which frames count (known, settled) and when the tip moves (share, speed) stay the
        play's, as effects change them little; a fit with effects takes its derivatives from their path."""
        driven = self.driven(delay_s)
        positions, at = driven.positions, driven.at
        far = 10.0 * (abs(grid[-1] - grid[0]) + abs(positions).max(initial=1.0))
        plays = Play(grid, width, hysteresis).native
        p, side, lean, share = plays.trace(positions, -far)
        other, other_side = plays.forward(positions, far)
        known = (np.abs(p - other) < hysteresis.forgotten * (grid[-1] - grid[0]))[at] & driven.within
        settled = known & _driven_both_ways(driven, _low_quantile_of_width(grid, width, positions), side, other_side)
        play_alone = Simulated(p[at], p[at], known, settled, side[at], lean[at], share[at], driven.speed)
        if effects is None or effect_values is None:
            return play_alone
        path = effects.follow(
            self.track.reading, self.track.scene_s(delay_s), grid, width, hysteresis, effect_values
        )  # fmt: skip
        return replace(play_alone, p=path.p, tip=path.tip, side=np.sign(path.side).astype(np.int8), lean=path.lean)


def _driven_both_ways(driven: MotorAtFrames, travel: float, side: Array, other_side: Array) -> Mask:
    """(n,) frames by which the play has been driven through a full backlash in both directions: the motor has gone up
    and down by `travel`, unit of q; the run from far below has been moved by the falling envelope, and the run from far
    above by the rising one. side, other_side (m,): envelope, +1 or -1, that last moved each of these two runs."""
    return driven.at >= max(driven.driven_through(travel), _first_true(side == -1), _first_true(other_side == 1))


def _low_quantile_of_width(grid: Array, width: Array, positions: Array) -> float:
    """The travel, unit of q, after which a full backlash counts as driven through: the quantile _SELDOM of B width
    (nodes,) over the nodes of grid (nodes,) that the positions (m,) span. The least B would not do: at the ends of the
    motion B is hardly measured, and where it came out as 0 any travel would count."""
    first, last = np.searchsorted(grid, [positions.min(), positions.max()])
    rising = np.sort(width[first : max(last, first + 1)])  # np.quantile takes ten times as long for so few
    return float(np.interp(_SELDOM * (len(rising) - 1), np.arange(len(rising)), rising))


def _first_true(where: Mask) -> int:
    """The index of the first element of a mask (n,) that is True; n if none is."""
    return int(np.argmax(where)) if where.any() else len(where)
