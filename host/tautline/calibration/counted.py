"""The frames that count, of all tracks, at one state of a joint fit: what the columns of mixed models are made of.

n: counted frames; channels: 2 of an image (px), 1 of an angle (deg); lengths in the unit of q.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from tautline import _native
from tautline.calibration.observations import Mask, Track, turning_hysteresis, usual_width
from tautline.calibration.playfit import STRAY, Curves, Fitted, PlayFit
from tautline.calibration.simulated_track import PreparedTrack
from tautline.core.motor import MotorPath
from tautline.elements import Play
from tautline.independence import first_order_sums
from tautline.rig import Rig

Array = npt.NDArray[np.float64]
Sparse = Any  # a scipy.sparse matrix, or an array

_FINE_S = 0.005  # tolerance: of the path that lags
_USUAL = 1.4826  # equation: of a median without its sign, of normal values of unit variance: one over it
_NARROW = 0.2  # tolerance: of the usual B: the least width in which travel since a turn is counted


@dataclass(frozen=True)
class CountedFrames:
    """The frames that count, of all tracks one after the other, at one state of the fit: residuals, and what the
    columns of nominal model and departures are made of. All (n,) but as said; lengths in the unit of q."""

    time_s: Array  # of the session
    t: Array  # the same, -1/2 to 1/2
    p: Array  # the play's centre
    side: Array  # envelope that last moved p, +1 or -1
    slope: Array  # (n, channels) d(whitened image)/dp
    width: Array  # B(p)
    by_width: Array  # dp/dB
    by_delay: Array  # dp/d(delay), per s
    speed: Array  # of the motor, per s, where the tip moves; else 0
    moving: Mask  # the tip moves
    phase: Array  # travel since the motor turned, in widths B(p), of _NARROW of the usual one at least
    direction: Array  # of the motor since then, +1 or -1
    stroke: npt.NDArray[np.intp]  # number of the tip's half-cycle, in all tracks
    recording: npt.NDArray[np.intp]  # number of the track
    frame: npt.NDArray[np.intp]  # index in its track
    lag_columns: Callable[[tuple[float, ...]], Array]  # (n, k) what first-order lags, time constants (k,) s, add to p
    load: Array | None  # less its mean
    inverse: Array  # 1 / stated noise
    residuals: Array  # (n, channels) whitened
    weight: Array

    def along_path(self, columns: Sparse) -> sparse.csr_matrix:
        """(channels * n, m) columns of the whitened image, channel by channel, from columns (n, m) of the tip's place
        p."""
        if isinstance(columns, np.ndarray):  # every entry is stored, zeros too: in a fifth of the time
            n, m = columns.shape
            rows = self.slope.shape[1] * n
            values = (self.slope.T[:, :, None] * columns).ravel()
            ends = np.arange(rows + 1) * m
            return sparse.csr_matrix((values, np.tile(np.arange(m), rows), ends), shape=(rows, m))
        return sparse.csr_matrix(sparse.vstack([scaled_rows(slope, columns) for slope in self.slope.T]))

    def per_channel(self, columns: Sparse) -> sparse.csr_matrix:
        """(channels * n, channels * m) block-diagonal: the columns (n, m) for each channel of the whitened image
        alone."""
        return sparse.csr_matrix(sparse.block_diag([sparse.csr_matrix(columns)] * self.slope.shape[1]))

    def at_the_end(self) -> CountedFrames:
        """The same frames as if all were at the end of the session (`t` is 1/2) and in its last recording. A
        departure's columns for them say what a change during the session comes to in the end."""
        n = len(self.t)
        last = int(self.recording[np.argmax(self.time_s)]) if n else 0
        return replace(
            self, t=np.full(n, 0.5), time_s=np.full(n, self.time_s.max(initial=0.0)), recording=np.full(n, last)
        )


def scaled_rows(factors: Array, columns: Sparse) -> sparse.csr_matrix:
    """(n, m) columns with each row times its factor (n,)."""
    scaled = sparse.csr_matrix(columns, dtype=float, copy=True)
    scaled.data *= np.repeat(factors, np.diff(scaled.indptr))
    return scaled


def counted_frames(fitted: Fitted, curves: Curves, rig: Rig, clock_error: Array) -> CountedFrames | None:
    """The frames that count at these curves, of all tracks. clock_error (2,), s, is taken off the tracks' times: the
    sensor's clock is off by c0 t + c1 (t^2 - 1/12), with t from -1/2 to 1/2 over the session. None if no frame counts:
    the tip was never driven through so wide a play."""
    tracks = on_clock(fitted.fit.tracks, clock_error)
    fit = replace(fitted.fit, tracks=tracks, smoothing=fitted.fit.smoothing)
    residuals, masks = fit.residuals(curves)
    if not any(mask.any() for mask in masks):
        return None
    usual = usual_width(fit.width(curves), float(fit.grid[-1] - fit.grid[0]))
    return _joined_tracks(
        [
            _of_track(fit, curves, number, residuals[number], masks[number], fitted.weights[number], usual, rig)
            for number in range(len(tracks))
        ],
        _session_span(fitted.fit.tracks),
    )


def on_clock(tracks: Sequence[PreparedTrack], clock_error: Array) -> list[PreparedTrack]:
    """The tracks with the error of the sensor's clock taken off their times. clock_error (2,), s: as in
    `counted_frames`."""
    if not clock_error.any():
        return list(tracks)
    first, length = _session_span(tracks)
    corrected = []
    for prepared in tracks:
        t = (prepared.track.t_s + prepared.track.session_s - first) / length - 0.5
        error = clock_error[0] * t + clock_error[1] * (t**2 - 1 / 12)
        corrected.append(replace(prepared, track=replace(prepared.track, t_s=prepared.track.t_s - error)))
    return corrected


def _session_span(tracks: Sequence[PreparedTrack]) -> tuple[float, float]:
    """The time of the session's first frame, s, and how long the session lasts until its last one, s."""
    ends = [prepared.track.t_s[[0, -1]] + prepared.track.session_s for prepared in tracks]
    first, last = float(np.min(ends)), float(np.max(ends))
    return first, max(last - first, 1e-9)


def _of_track(
    fit: PlayFit, curves: Curves, number: int, residuals: Array, keep: Mask, weights: Array, usual: float, rig: Rig
) -> CountedFrames:
    """The counted frames of the track `number`; `fit.residuals` must have been called with the same curves. What needs
    the other tracks is left to `_joined_tracks`: `t` is 0 here, `load` has its mean, and `stroke` counts from the
    track's first. residuals (frames, channels), keep (frames,) and weights (frames,) are of all frames of the track;
    usual: typical B, unit of q."""
    prepared, sim = fit.tracks[number], fit.simulated[number]
    track = prepared.track
    scene_s = track.scene_s(curves.delay_s)[keep]
    travel, direction = _since_turn(track.path, scene_s, rig)
    p, moving = sim.p[keep], sim.moving[keep]
    by_width, by_delay = sim.slopes(keep, fit.backlash.slope(curves.backlash, p))
    inverse = 1.0 / track.sigma[keep]
    width = np.interp(p, fit.grid, fit.width(curves))
    load = track.motor.load_mNm
    return CountedFrames(
        time_s=track.t_s[keep] + track.session_s,
        t=np.zeros(len(p)),
        p=p,
        side=sim.side[keep].astype(float),
        slope=fit.follow.slope(curves.follow, p).reshape(len(p), curves.follow.shape[1]) * inverse[:, None],
        width=width,
        by_width=by_width,
        by_delay=by_delay,
        speed=sim.speed[keep] * moving,
        moving=moving,
        phase=travel / np.maximum(width, _NARROW * usual),
        direction=direction,
        stroke=sim.half_cycle[keep],
        recording=np.full(len(p), number),
        frame=np.flatnonzero(keep),
        lag_columns=partial(_lag_columns, track, Play(fit.grid, fit.width(curves), fit.hysteresis), scene_s),
        load=None if load is None else np.interp(scene_s, track.motor.t_s, load),
        inverse=inverse,
        residuals=residuals[keep],
        # 0 means that the fit, on the clock as it was, did not count the frame, and not that it is an outlier.
        weight=np.where(weights[keep] > 0, weights[keep], 1.0),
    )


def _lag_columns(track: Track, play: Play, scene_s: Array, times_s: tuple[float, ...]) -> Array:
    """(n, k) what a first-order lag with each of the time constants times_s (k,), s, adds to the play's centre p, unit
    of q, at scene times (n,), s. p is simulated every _FINE_S from the record's begin, as a lag remembers what came
    before."""
    fine = np.arange(track.motor.t_s[0], track.motor.t_s[-1], _FINE_S)
    course = play.forward(track.motor_at(fine))
    return np.column_stack([np.interp(scene_s, fine, _low_pass(course, tau) - course) for tau in times_s])


def _joined_tracks(pieces: Sequence[CountedFrames], session: tuple[float, float]) -> CountedFrames:
    """The frames of all tracks as one: with `t` by the session's length, strokes numbered on from track to track, the
    load without its mean (None unless all have one), and less weight for outliers, frames whose residual is above STRAY
    times the usual one. session: time of the first frame, and length, s."""
    first, length = session
    before, strokes = 0, []
    for piece in pieces:
        strokes.append(piece.stroke + before)
        before = int(strokes[-1].max(initial=before - 1)) + 1
    arrays = {
        field.name: np.concatenate([getattr(piece, field.name) for piece in pieces])
        for field in fields(CountedFrames)
        if field.name not in ("lag_columns", "load", "stroke")
    }
    norm = np.sqrt(np.mean(arrays["residuals"] ** 2, axis=1))
    limit = STRAY * max(_USUAL * float(np.median(norm)), 1e-9)
    arrays["weight"] = np.minimum(arrays["weight"], (limit / np.maximum(norm, limit)) ** 2)
    arrays["t"] = (arrays["time_s"] - first) / length - 0.5
    loads = [piece.load for piece in pieces if piece.load is not None]
    load = np.concatenate(loads) if len(loads) == len(pieces) else None
    return CountedFrames(
        stroke=np.concatenate(strokes),
        load=None if load is None else load - load.mean(),
        lag_columns=lambda times_s: np.concatenate([piece.lag_columns(times_s) for piece in pieces]),
        **arrays,
    )


def _since_turn(path: MotorPath, at: Array, rig: Rig) -> tuple[Array, Array]:
    """How far the motor has gone since its last turn (n,), unit of q, inf before its first turn; and its direction
    since then (n,), +1 or -1. at (n,): scene times, s."""
    motor, hysteresis = path.lines, turning_hysteresis(path, rig.actuator.encoder_resolution, rig.actuator.span)
    turns = _native.turns(np.ascontiguousarray(motor.q), hysteresis)
    edges = np.concatenate([[0], turns, [len(motor.q) - 1]]).astype(int)
    directions = np.sign(np.diff(motor.q[edges]))
    which = np.clip(np.searchsorted(motor.t_s[edges], at, side="right") - 1, 0, len(directions) - 1)
    travel = np.abs(np.interp(at, motor.t_s, motor.q) - motor.q[edges[which]])
    return np.where(which == 0, np.inf, travel), directions[which]


def _low_pass(p: Array, time_s: float) -> Array:
    """p (n,), a value every _FINE_S, after a first-order low pass with time constant time_s."""
    share = np.exp(-_FINE_S / time_s)
    return np.asarray(p[0] + first_order_sums((1 - share) * (p - p[0]), share))
