"""The sensor's clock against the motor's, before anything else is measured: by how much its times are late, from the
data alone.

A lag is by how much the sensor's times are later than the motor's, s. It is the sum of a delay, which is near the
nominal one, and of a clock's offset. At each lag a play of constant width and a polynomial of fifth order are fitted to
what the sensor saw. The share of the variance of y that they leave is the misfit: it needs no pose, no camera and no
model of the instrument. Delays are refined by the image's stops (onset.py), or of an angle sensor by a smooth B and
path (`delay_of_all`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.calibration.observations import Mask, Track, observe
from tautline.calibration.onset import NOMINAL_S, Delay, find_delay
from tautline.calibration.playfit import Curves, Fitted, PlayFit
from tautline.calibration.simulated_track import PreparedTrack
from tautline.calibration.steps import without_steps
from tautline.geometry import project
from tautline.independence import first_order
from tautline.quality import Reason
from tautline.recording import Recording, shifted
from tautline.rig import ANGLE, MARKER, Rig
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

REACH_S = 10.0  # prior: an offset is looked for this far around the nominal delay
DELAY_REACH_S = 0.25  # prior: what is farther from the nominal delay is no delay but another clock
FITS = 0.003  # tolerance: misfit up to which the nominal delay is as right as a search could say
_FOLLOWS = 0.25  # prior: misfit above which the sensor does not follow this motor at any offset
_RIVAL = 2.0  # prior: times the least misfit: other offsets that leave less are rivals of the best
_NOISY = 0.05  # tolerance: share of noise in the variance of y above which there is no motion to compare
_PITCH_S = 0.05  # tolerance: between lags of the search; a stroke lasts ten times longer
_EDGE_S = 0.09  # tolerance: a delay this far from the nominal one is at the edge of what find_delay looks through
_CLEARLY_LESS = 0.7  # prior: of the nominal delay's misfit: another lag fits
_BY_ITSELF_S = 0.06  # tolerance: as far as a search from the nominal delay surely comes, below _EDGE_S
_NEAR_S = 1.0  # prior: around the nominal delay, where lags are tried first
_BEATEN = 1.4  # prior: ratio of misfits from which a lag nearby is clearly better
_APART_S = 0.3  # prior: minima of the misfit that are nearer are one offset
_RIDGE = 3.0  # prior: times the misfit: how high it has to be between two minima that are two offsets
_ANEW = 8  # tolerance: lags after which all widths are tried again
_ORDER = 5  # prior: of the polynomial that stands for the path
_FRAMES = 400, 1500  # tolerance: frames, at most: to search with, to refine with
_WIDTHS = (
    0.0,
    0.01,
    0.022,
    0.04,
    0.065,
    0.1,
    0.16,
    0.26,
    0.4,
)  # tolerance: of the plays that are tried, in shares of the motor's span
_LONGER = 0.01  # prior: relative difference of durations from which a stretched clock is tried for
_CLEAR, _SAME_S = 5.0, 0.004  # prior: standard deviations, and s, by which two recordings' delays differ clearly
_PARTS, _JUMP_S = 4, 0.03  # prior: parts of a recording, and s by which their delays differ where its clock jumps
_SURE_S = 0.02  # tolerance: standard deviation of a delay that is known well enough to refine an offset
_STRETCHED = 0.2  # prior: of the misfit that a stretched clock may leave at most
_STATED_S = 0.05  # prior: standard deviation of an angle sensor's delay about what the rig states
_UNSTATED_S = 0.05, 0.07  # prior: mean and standard deviation where the rig states none: of bus, filter or servo
_SPANS = (
    (8, 16),
    (1, 6),
)  # prior: spans of B and of the path; the second, stiffer pair where the first does not tell the delay
_TOLD_S = 0.025  # tolerance: standard deviation up to which a delay counts as told
_COARSE_S = 0.02  # tolerance: between delays of the first search
_PER_STROKE = 4.0  # prior: independent residuals of a model with errors within a stroke, at most
_STROKES = 10  # prior: strokes that count for that at most: model errors repeat in further ones
_WHITE = 1.05  # tolerance: residual over noise up to which nothing but noise is in it
_CLEARLY = 1.03  # prior: ratio of residuals from which one fit is clearly worse
_LIKELY = 3.0  # prior: standard deviations within which a delay is likely
_SAMPLES, _LITTLE_S = (
    1.5,
    0.01,
)  # prior: frame periods, and s: a delay that differs by less may be an error of the model
_AROUND_S = 0.5  # prior: s: a tip follows its motor within it
_DITHER = 2e-3  # tolerance: of the motor's span: turns within it do not matter here


@dataclass(frozen=True)
class Offset:
    """The offset of a track's clock: its lag less the nominal delay. `rivals`: other offsets, s, that fit about as
    well."""

    offset_s: float
    sigma_s: float  # its standard deviation; inf where no lag could be tried
    misfit: float  # 0 to 1
    rivals: tuple[float, ...] = ()


@dataclass(frozen=True)
class AlignedTracks:
    """Tracks with their times on the motor's clock: later than the scene by one delay and no more."""

    tracks: list[Track]
    offsets_s: tuple[float, ...]  # of each track's clock, which were taken off its times
    reasons: tuple[Reason, ...]  # of clocks that were off, or cannot be aligned
    notes: tuple[str, ...] = ()

    @classmethod
    def as_it_is(cls, tracks: Sequence[Track]) -> AlignedTracks:
        """The tracks as they are: no clock is off."""
        return cls(list(tracks), (0.0,) * len(tracks), ())

    @property
    def offset_s(self) -> float | None:
        """The offset, s, that is farthest from 0; None where no clock was off."""
        return max(self.offsets_s, key=abs, default=0.0) or None

    @property
    def offsets(self) -> dict[str, float]:
        """The offsets that are not 0, s, by recording."""
        pairs = zip(self.tracks, self.offsets_s, strict=True)
        return {track.name: offset for track, offset in pairs if offset}

    def with_delay(self, delay: Delay, nominal_s: float) -> tuple[AlignedTracks, Delay]:
        """These tracks and a delay that was found on them. If every clock was off, delay and offsets cannot be told
        apart: the delay is set to the nominal one then, and the offsets take the difference."""
        if not self.offsets_s or not all(self.offsets_s):
            return self, delay
        offsets = tuple(offset + delay.delay_s - nominal_s for offset in self.offsets_s)
        return replace(self, offsets_s=offsets), replace(delay, delay_s=nominal_s)


def on_motor_clock(recordings: Sequence[Recording], rig: Rig) -> list[Recording]:
    """Recordings with the offsets of their sensors' clocks taken off. Differences between recordings that are no larger
    than a delay may be are left: an effect that is not known yet may make one motion's stops later than another's."""
    tracks = [track for track in observe(recordings, rig) if len(track.t_s)]
    return shifted(recordings, align(tracks, rig, late_are_off=False).offsets)


def align(tracks: Sequence[Track], rig: Rig, *, late_are_off: bool = True) -> AlignedTracks:
    """Each track with the offset of its clock found and taken off, or the reasons why it cannot be. A track that fits
    its nominal delay stays as it is, unless late_are_off and the other recordings' images stop at another delay. Frames
    at which the tip follows a step of the motor are left out first."""
    tracks, stepping, notes = without_steps(tracks, rig)
    notes += [f"{t.name}: the sensor repeats its values, {t.held} of them were left out" for t in tracks if t.held]
    if stepping:
        return AlignedTracks(tracks, (0.0,) * len(tracks), tuple(stepping), tuple(notes))
    aligned, offsets = [], []
    reasons: list[Reason] = []
    for track in tracks:
        nominal_s = rig.nominal_delay_s(track.sensor)
        offset = find_offset(track, rig)
        refused = None if offset is None else _reason_to_refuse(track, offset, rig)
        offset_s = 0.0
        if offset is not None and offset.offset_s and offset.misfit <= _FOLLOWS:
            track, offset_s = _corrected(track, offset, nominal_s, rig)
        if refused is not None:
            reasons.append(refused)
        aligned.append(track)
        offsets.append(offset_s)
    if not reasons:
        aligned, offsets = _at_one_delay(aligned, offsets, rig, late_are_off)
        reasons = [
            _offset_reason(track, offset_s) for track, offset_s in zip(aligned, offsets, strict=True) if offset_s
        ]
    return AlignedTracks(aligned, tuple(offsets), tuple(reasons), tuple(notes))


def _offset_reason(track: Track, offset_s: float) -> Reason:
    """The mild reason that a clock was off by offset_s and was corrected for it."""
    where = "behind" if offset_s > 0 else "ahead of"
    says = f"{track.name}: the sensor's clock is {abs(offset_s):.3f} s {where} the motor's"
    return Reason("clock.offset", says, "it was taken off: put both on one clock", mild=True)


def _at_one_delay(
    tracks: list[Track], offsets: list[float], rig: Rig, late_are_off: bool
) -> tuple[list[Track], list[float]]:
    """Tracks and their offsets, s, with all images at one delay, as a camera has one. It is that of a track whose clock
    was right; tracks whose images stop at a clearly different delay are shifted to it."""
    if len(tracks) < 2 or any(track.sensor != MARKER for track in tracks):
        return tracks, offsets
    delays = [delay_of_stops([track], rig) for track in tracks]
    right = [delay for delay, offset_s in zip(delays, offsets, strict=True) if not offset_s]
    if not right:
        return tracks, offsets
    nominal_s = rig.nominal_delay_s(MARKER)
    # The recording whose delay has the highest posterior density, by its stops and the rig's nominal delay.
    best = min(right, key=lambda d: np.log(d.sigma_s) + 0.5 * ((d.delay_s - nominal_s) / NOMINAL_S) ** 2)
    shifts = [
        delay.delay_s - best.delay_s
        if abs(delay.delay_s - best.delay_s) > max(_CLEAR * np.hypot(delay.sigma_s, best.sigma_s), _SAME_S)
        and (late_are_off or offset_s)
        and _fits_at_own_delay(track, rig, delay.delay_s, best.delay_s)
        else 0.0
        for track, delay, offset_s in zip(tracks, delays, offsets, strict=True)
    ]
    moved = [replace(t, t_s=t.t_s - shift) if shift else t for t, shift in zip(tracks, shifts, strict=True)]
    return moved, [offset_s + shift for offset_s, shift in zip(offsets, shifts, strict=True)]


def _fits_at_own_delay(track: Track, rig: Rig, own_s: float, best_s: float) -> bool:
    """Whether all frames of the track fit about as well at own_s, the delay of its stops, as at best_s. If not, only
    the stops are late, as those of a slow motion are behind a codec that holds back what moves little. Yes where frames
    tell nothing."""
    scan = _LagScan.of(track, rig, _FRAMES[0])
    if scan is None:
        return True
    own, best = (float(scan.least_misfits(np.array([lag_s]))[0]) for lag_s in (own_s, best_s))
    return own <= _BEATEN * best


def _corrected(track: Track, offset: Offset, nominal_s: float, rig: Rig) -> tuple[Track, float]:
    """The track with its offset taken off, and that offset, s, refined by the delay that is found then if that is known
    to _SURE_S."""
    offset_s = offset.offset_s
    near = replace(track, t_s=track.t_s - offset_s)
    delay = delay_of_all([near], rig) if track.sensor == ANGLE else find_delay([near], rig, nominal_s)
    if delay.sigma_s < _SURE_S:
        offset_s += delay.delay_s - nominal_s
    return replace(track, t_s=track.t_s - offset_s), offset_s


def delay_jumps(tracks: Sequence[Track], rig: Rig) -> list[Reason]:
    """A reason for each recording whose image stops at clearly different delays in different quarters."""
    reasons = []
    for track in tracks:
        parts = [track.only(at) for at in np.array_split(np.arange(len(track.t_s)), _PARTS)]
        delays = [delay_of_stops([part], rig) for part in parts if len(part.t_s) >= 8 * _ORDER]
        delays = [delay for delay in delays if delay.stops and np.isfinite(delay.sigma_s)]
        if len(delays) < 2:
            continue
        first, last = min(delays, key=lambda each: each.delay_s), max(delays, key=lambda each: each.delay_s)
        apart = last.delay_s - first.delay_s
        if apart > max(_CLEAR * float(np.hypot(first.sigma_s, last.sigma_s)), _JUMP_S):
            says = f"{track.name}: the image's delay differs by {apart * 1e3:.0f} ms between parts of the recording"
            reasons.append(Reason("clock.offset", says, "look for lost frames or a clock that was set meanwhile"))
    return reasons


def find_offset(track: Track, rig: Rig) -> Offset | None:
    """The offset of the track's clock within REACH_S: 0 if the nominal delay fits (or a lag within DELAY_REACH_S of it
    does), with infinite sigma if no lag can be tried. None if the track shows no motion to tell it by."""
    scan = _LagScan.of(track, rig, _FRAMES[0])
    if scan is None:
        return None
    nominal_s = rig.nominal_delay_s(track.sensor)
    near = nominal_s + np.arange(-round(_NEAR_S / _PITCH_S), round(_NEAR_S / _PITCH_S) + 1) * _PITCH_S
    least_misfits = scan.least_misfits(near)
    delays = np.abs(near - nominal_s) <= DELAY_REACH_S
    least = float(least_misfits[delays].min())
    at_nominal = least <= max(FITS, 4.0 * scan.noise_share) and least <= _BEATEN * least_misfits.min()
    if at_nominal and scan.moves_as_coarse(float(near[delays][int(least_misfits[delays].argmin())])):
        return Offset(0.0, 0.0, least)
    lags = nominal_s + np.arange(-round(REACH_S / _PITCH_S), round(REACH_S / _PITCH_S) + 1) * _PITCH_S
    rivals = _minima(scan, _LagScan.of(track, rig, _FRAMES[1]) or scan, lags)
    if not rivals:
        return Offset(0.0, np.inf, 1.0)
    nominal = [r for r in rivals if abs(r.lag_s - nominal_s) <= DELAY_REACH_S]
    if nominal:
        # It may be another half turn of the motion, with the wrong sign, that fits here.
        others = (
            ()
            if scan.moves_as_coarse(nominal[0].lag_s)
            else tuple(r.lag_s for r in rivals if scan.moves_as_coarse(r.lag_s))
        )
        return Offset(0.0, nominal[0].sigma_s, nominal[0].misfit, tuple(lag - nominal_s for lag in others))
    rivals = [r for r in rivals if scan.moves_as_coarse(r.lag_s)] or rivals
    others = tuple(r.lag_s - nominal_s for r in rivals[1:])
    return Offset(rivals[0].lag_s - nominal_s, rivals[0].sigma_s, rivals[0].misfit, others)


def _minima(scan: _LagScan, fine: _LagScan, lags: npt.NDArray[Any]) -> list[_Minimum]:
    """The minima of the misfit over lags (n,), s, that are within _RIVAL of the least, best first. Two with no ridge of
    _RIDGE times the misfit between them, or within _APART_S, are one. scan: few frames, to search with; fine: more, to
    refine with."""
    least_misfits = scan.least_misfits(lags)
    finite = np.where(np.isfinite(least_misfits), least_misfits, 1.0)
    padded = np.concatenate([[np.inf], finite, [np.inf]])
    lowest = (finite <= padded[:-2]) & (finite <= padded[2:]) & (finite <= 3.0 * _RIVAL * finite.min() + 1e-12)
    at = np.flatnonzero(lowest & np.isfinite(least_misfits))
    lags_by_misfit = sorted((fine.minimum_near(float(lags[i])) for i in at), key=lambda one: one.misfit)
    rivals: list[_Minimum] = []
    for one in lags_by_misfit:
        if one.misfit > _RIVAL * lags_by_misfit[0].misfit:
            break
        between = (finite[(lags > min(one.lag_s, r.lag_s)) & (lags < max(one.lag_s, r.lag_s))] for r in rivals)
        apart = all(abs(one.lag_s - r.lag_s) > _APART_S for r in rivals)
        if apart and all(len(ridge) and ridge.max() > _RIDGE * one.misfit for ridge in between):
            rivals.append(one)
    return rivals


def _reason_to_refuse(track: Track, best: Offset, rig: Rig) -> Reason | None:
    """The fatal reason why no offset of this track can be trusted: its times are stretched, several offsets fit alike,
    or none does. None where `best` can be."""
    follows = best.misfit <= _FOLLOWS
    if follows and not best.rivals:
        return None
    stretched = _stretched(track, rig, best.misfit)
    if stretched is not None:
        return stretched
    if follows:
        fits = ", ".join(f"{offset:.2f}" for offset in sorted([best.offset_s, *best.rivals])[:6])
        says = f"{track.name}: the sensor's clock is off, and offsets of {fits} s fit alike"
        return Reason("clock.offset", says, "make a motion that does not repeat, or put both on one clock", fatal=True)
    says = f"{track.name}: at no offset within {REACH_S:g} s does the tip follow the motor"
    return Reason("clock.offset", says, "check that both are of one run, and their clocks", fatal=True)


def _stretched(track: Track, rig: Rig, misfit: float) -> Reason | None:
    """The fatal reason that a track's times run too fast or too slow: scaled to the motor's duration they leave at most
    the share _STRETCHED of `misfit`, that of the best offset. None where they do not."""
    motor_s = float(np.ptp(track.motor.t_s))
    seen_s = float(np.ptp(track.t_s))
    if seen_s <= 0.0 or abs(motor_s / seen_s - 1.0) < _LONGER:
        return None
    times = track.motor.t_s[0] + (track.t_s - track.t_s[0]) * motor_s / seen_s
    scan = _LagScan.of(replace(track, t_s=times), rig, _FRAMES[0])
    lags = rig.nominal_delay_s(track.sensor) + np.arange(-round(1.0 / _PITCH_S), round(1.0 / _PITCH_S) + 1) * _PITCH_S
    if scan is None or float(scan.least_misfits(lags).min()) > _STRETCHED * misfit:
        return None
    return Reason(
        "duration",
        f"{track.name}: {seen_s:.4g} s of frames show {motor_s:.4g} s of motor",
        "the frames' times are wrong: record when each arrived (frames.csv), or correct the frame rate",
        fatal=True,
    )


def delay_of_stops(tracks: Sequence[Track], rig: Rig) -> Delay:
    """The delay at which the image stops (`find_delay`) around the nominal one; if that ends at the edge of what it
    looks through, around the delay at which all frames fit best."""
    nominal_s = rig.nominal_delay_s(tracks[0].sensor)
    delay = find_delay(tracks, rig, nominal_s)
    if abs(delay.delay_s - nominal_s) < _EDGE_S and np.isfinite(delay.sigma_s):
        return delay
    start_s = _start_of_search(tracks, rig, nominal_s)
    if start_s == nominal_s and np.isfinite(delay.sigma_s):
        start_s = delay.delay_s  # the edge that it ran into
    other = find_delay(tracks, rig, start_s)
    inside = abs(other.delay_s - start_s) < _EDGE_S and np.isfinite(other.sigma_s)
    return other if inside else delay


def _start_of_search(tracks: Sequence[Track], rig: Rig, nominal_s: float) -> float:
    """Where `find_delay` is to start, s: the one of 11 lags within DELAY_REACH_S of the nominal delay that leaves the
    least misfit, where that is less than _CLEARLY_LESS of the nominal one's and the lag is farther from it than
    `find_delay` comes by itself; else the nominal delay."""
    scans = [scan for scan in (_LagScan.of(track, rig, _FRAMES[0]) for track in tracks) if scan is not None]
    if not scans:
        return nominal_s
    lags = nominal_s + np.linspace(-DELAY_REACH_S, DELAY_REACH_S, 11)
    least_misfits = np.sum([scan.least_misfits(lags) for scan in scans], axis=0)
    best = int(np.argmin(least_misfits))
    better = least_misfits[best] < _CLEARLY_LESS * least_misfits[len(lags) // 2]
    return float(lags[best]) if better and abs(lags[best] - nominal_s) > _BY_ITSELF_S else nominal_s


@dataclass(frozen=True)
class _Minimum:
    """A local minimum of the misfit over lags."""

    lag_s: float
    sigma_s: float
    misfit: float


@dataclass(frozen=True)
class _LagScan:
    """One track prepared to be fitted at many lags."""

    track: Track  # thinned out
    turn_t: Array  # (turns,) when the motor turned, s
    turn_q: Array  # (turns,) where, unit of q
    low: float  # lowest motor position
    span: float  # of the motor's positions
    noise_share: float  # of the variance of y
    reference: tuple[float, float] | None  # of the other axes; None where they rest
    coarse_direction: Array  # (channels,) in which y moves as q rises, by f_coarse

    @classmethod
    def of(cls, track: Track, rig: Rig, most: int) -> _LagScan | None:
        """The track thinned to at most `most` frames. None where nothing moves by more than noise, or other axes move
        for more than a tenth of the frames."""
        motor = track.motor
        span = float(np.ptp(motor.q))
        variance = float(np.mean(np.var(track.y, axis=0))) if len(track.t_s) else 0.0
        if len(track.t_s) < 8 * _ORDER or span <= 0.0 or variance <= 0.0:
            return None
        share = float(np.mean(track.sigma**2)) / variance
        reference = None if motor.translation_mm is None and motor.rotation_deg is None else track.others_reference
        if share > _NOISY:
            return None
        if reference is not None and np.mean(track.at_reference(track.t_s, reference)) < 0.9:
            return None
        stride = -(-len(track.t_s) // most)
        few = track.only(slice(None, None, stride))
        turns = _native.turns(np.ascontiguousarray(motor.q), _DITHER * span)
        keep = np.unique(np.concatenate([[0], turns, [len(motor.q) - 1]])).astype(np.intp)
        low = float(motor.q.min())
        ends = rig.coarse.gain * (low + np.array([0.25, 0.75]) * span) + rig.coarse.offset
        if track.sensor == MARKER:
            coarse_direction = np.diff(project(rig, ends, *track.others_reference), axis=0)[0]
        else:
            coarse_direction = np.diff(ends)
        return cls(few, motor.t_s[keep], motor.q[keep], low, span, share, reference, coarse_direction)

    def least_misfits(self, lags: npt.NDArray[Any]) -> Array:
        """The least misfit over all widths at each of lags (n,), s, which follow each other closely: the best width
        moves by one place of _WIDTHS at most from lag to lag, so all of them are tried only every _ANEW lags."""
        least, at = np.empty(len(lags)), 0
        for i, lag in enumerate(lags):
            near = range(len(_WIDTHS)) if i % _ANEW == 0 else range(max(at - 1, 0), min(at + 2, len(_WIDTHS)))
            tried = [self.misfit(float(lag), _WIDTHS[k] * self.span) for k in near]
            at = near[int(np.argmin(tried))]
            least[i] = min(tried)
        return least

    def moves_as_coarse(self, lag_s: float) -> bool:
        """Whether y rises with the play's centre the way that f_coarse says, at a lag in s."""
        width = min(_WIDTHS, key=lambda share: self.misfit(lag_s, share * self.span)) * self.span
        return bool(self._polynomial_fit(lag_s, width)[1] @ self.coarse_direction > 0.0)

    def misfit(self, lag_s: float, width: float) -> float:
        """Share of the variance of y that is left at a lag, s, and a play's width, unit of q; infinite where the
        motor's record covers fewer than half of the frames."""
        return self._polynomial_fit(lag_s, width)[0]

    def _polynomial_fit(self, lag_s: float, width: float) -> tuple[float, Array]:
        """Least squares of y by a Chebyshev polynomial of order _ORDER in p, the centre of a play of this width, unit
        of q, at a lag, s: the misfit, and the coefficients of the linear term (channels,). inf and 0 where fewer than
        half of the frames count: those that the motor's record covers, once the play has forgotten its start."""
        track = self.track
        scene = track.scene_s(lag_s)
        n = len(self.turn_t)
        times = np.concatenate([self.turn_t, scene])
        order = np.argsort(times, kind="stable")
        q = np.concatenate([self.turn_q, track.motor_at(scene)])[order]
        grid = np.array([self.low - self.span, self.low + 2.0 * self.span])
        plays = _native.Plays(grid, np.full(2, width))
        far = 10.0 * (self.span + float(np.abs(grid).max()))
        p, other = (plays.forward(q, start)[0] for start in (-far, far))
        counted = order >= n
        counted &= np.abs(p - other) < 1e-9 * self.span
        frames = order[counted] - n
        inside = track.within_motor(scene)[frames]
        if self.reference is not None:
            inside &= track.at_reference(scene, self.reference)[frames]
        frames, x = frames[inside], 2.0 * (p[counted][inside] - self.low) / self.span - 1.0
        if 2 * len(frames) < len(scene):
            return np.inf, np.zeros_like(self.coarse_direction)
        y = track.y[frames]
        y = y - y.mean(axis=0)
        design = np.polynomial.chebyshev.chebvander(x, _ORDER)
        gram = design.T @ design + 1e-9 * len(x) * np.eye(_ORDER + 1)
        pull = design.T @ y
        total = max(float(np.sum(y * y)), 1e-30)
        coefficients = np.linalg.solve(gram, pull)
        return max(1.0 - float(np.sum(pull * coefficients)) / total, 0.0), coefficients[1]

    def moving(self) -> Mask:
        """(n,) frames within _AROUND_S of which the motor moves: only they tell a delay."""
        t = self.track.t_s
        q = self.track.motor_at(t[:, None] + np.linspace(-_AROUND_S, _AROUND_S, 9))
        moves: Mask = np.ptp(q, axis=1) > _DITHER * self.span
        return moves

    def minimum_near(self, lag_s: float) -> _Minimum:
        """The minimum of the misfit over lag and width near lag_s, by a pattern search; its sigma is that of white
        residuals, from the curvature over the lag."""
        width = self.span * min(_WIDTHS, key=lambda share: self.misfit(lag_s, share * self.span))
        step_s, step = _PITCH_S, 0.3 * width + 0.005 * self.span
        best = self.misfit(lag_s, width)
        for _ in range(9):
            for other in (lag_s - step_s, lag_s + step_s):
                if (trial := self.misfit(other, width)) < best:
                    best, lag_s = trial, other
            for other in (max(width - step, 0.0), width + step):
                if (trial := self.misfit(lag_s, other)) < best:
                    best, width = trial, other
            step_s, step = 0.6 * step_s, 0.6 * step
        h = 0.02
        curvature = (self.misfit(lag_s - h, width) + self.misfit(lag_s + h, width) - 2.0 * best) / h**2
        if not np.isfinite(curvature):  # at the end of what can be tried: the other side is not known
            return _Minimum(lag_s, np.inf, best)
        sigma = np.sqrt(2.0 * best / max(curvature, 1e-12) / len(self.track.t_s))
        return _Minimum(lag_s, float(sigma), best)


def delay_of_all(tracks: Sequence[Track], rig: Rig) -> Delay:
    """The posterior of the delay at which a smooth B and a smooth path fit all frames, its prior about the nominal
    delay; the nominal delay with infinite sigma where nothing tells it. For angle sensors of real joints, which do not
    stop so sharply that stops alone tell the delay."""
    nominal_s = rig.nominal_delay_s(tracks[0].sensor)
    scans = [scan for scan in (_LagScan.of(track, rig, _FRAMES[1]) for track in tracks) if scan is not None]
    if not scans:
        return Delay(nominal_s, np.inf, 0)
    lags = nominal_s + np.linspace(-DELAY_REACH_S, DELAY_REACH_S, 21)
    start = float(lags[int(np.argmin(np.sum([scan.least_misfits(lags) for scan in scans], axis=0)))])
    try:
        prior_mean_s, prior_sigma_s = _UNSTATED_S if rig.angle is None else (nominal_s, _STATED_S)
        return _delay_posterior(scans, prior_mean_s, start, prior_sigma_s)
    except np.linalg.LinAlgError:  # the tip is seen at too few places
        return Delay(nominal_s, np.inf, 0)


def _delay_posterior(scans: Sequence[_LagScan], prior_mean_s: float, start: float, prior_sigma_s: float) -> Delay:
    """Posterior mean and standard deviation of the delay, s, by a search and ever finer grids; with stiffer curves
    where the first do not tell it to _TOLD_S. prior_mean_s, prior_sigma_s: of the normal prior; start: where plays of
    constant width fit best, s."""
    for spans in _SPANS:
        profile = _DelayDeviance(scans, spans, prior_mean_s, prior_sigma_s, start)
        best = min((prior_mean_s, 0.5 * (start + prior_mean_s), start), key=profile.deviance)
        while (better := min((best, best - _COARSE_S, best + _COARSE_S), key=profile.deviance)) != best:
            best = better
        for pitch_s in (2.0 * _COARSE_S, _COARSE_S, 0.4 * _COARSE_S, 0.12 * _COARSE_S):
            best, spread = profile.posterior(best, pitch_s)
            if spread > pitch_s:
                break
        if spread < _TOLD_S:
            break
    return Delay(best, spread, len(scans))


def period_s(tracks: Sequence[Track]) -> float:
    """Median time between frames, s."""
    return float(np.median(np.concatenate([np.diff(track.t_s) for track in tracks])))


def at_credible_delay(free: Fitted, delay: Delay, tracks: Sequence[Track], nominal_s: float) -> Fitted:
    """An angle sensor's joint fit at a delay that its model errors cannot have moved. free: with the delay fitted,
    which is kept if it leaves only noise, or clearly less than at `delay` (`delay_of_all`). Where model errors are
    there and the fitted delay is within about a sample of the nominal one, it is that one; else `delay`."""
    own_s = free.curves.delay_s
    if free.scale <= _WHITE:
        return free
    at_nominal = abs(own_s - nominal_s) <= min(_SAMPLES * period_s(tracks), _LITTLE_S)
    if not at_nominal and free.explained:
        return free
    fixed = replace(free.fit, fit_delay=False, smoothing=dict(free.fit.smoothing))
    fitted = fixed.solve(replace(free.curves, delay_s=nominal_s if at_nominal else delay.delay_s))
    likely = not at_nominal and abs(own_s - delay.delay_s) < _LIKELY * delay.sigma_s
    return free if likely and fitted.scale > _CLEARLY * free.scale else fitted


class _DelayDeviance:
    """The deviance (-2 log posterior density, but for a constant) of a delay, by all frames of all tracks and a normal
    prior. The frames' part is 2 N log(scale): scale the residual over noise of the best smooth B and path at that
    delay, N the number of independent residuals, at most _PER_STROKE a stroke, as model errors repeat."""

    def __init__(
        self,
        scans: Sequence[_LagScan],
        spans: tuple[int, int],
        prior_mean_s: float,
        prior_sigma_s: float,
        start_s: float,
    ) -> None:
        """spans: of the splines of B and of the path. prior_mean_s, prior_sigma_s: of the normal prior; start_s: the
        delay at which N is counted."""
        self._scans, self._prior_mean_s, self._prior_sigma_s = scans, prior_mean_s, prior_sigma_s
        low = min(scan.low for scan in scans)
        high = max(scan.low + scan.span for scan in scans)
        self._fit = PlayFit(
            [PreparedTrack.of(scan.track, scan.moving()) for scan in scans],
            Basis(low, high, spans[0]),
            Basis(low, high, spans[1]),
            fit_delay=False,
            settled_only=False,
        )
        self._smoothing = dict(self._fit.smoothing)
        self._found: dict[float, float] = {}
        strokes = sum(len(scan.turn_t) - 1 for scan in scans)
        self._independent = min(_independent(self._solved(start_s)), _PER_STROKE * min(strokes, _STROKES))

    def deviance(self, delay_s: float) -> float:
        """The deviance of a delay, s; kept for the next time."""
        key = round(delay_s, 7)
        if key not in self._found:
            left = 2.0 * self._independent * float(np.log(self._solved(delay_s).scale))
            self._found[key] = left + ((delay_s - self._prior_mean_s) / self._prior_sigma_s) ** 2
        return self._found[key]

    def posterior(self, centre_s: float, pitch_s: float) -> tuple[float, float]:
        """Posterior mean and standard deviation, s, on a grid of seven delays pitch_s apart around centre_s; the grid's
        own rounding is in the latter."""
        delays = centre_s + pitch_s * np.arange(-3, 4)
        deviance = np.array([self.deviance(float(delay)) for delay in delays])
        weight = np.exp(-0.5 * np.clip(deviance - deviance.min(), 0.0, 200.0))
        weight /= weight.sum()
        mean = float(weight @ delays)
        return mean, float(np.hypot(np.sqrt(weight @ (delays - mean) ** 2), pitch_s / np.sqrt(12.0)))

    def _solved(self, delay_s: float) -> Fitted:
        """The fit with the delay held at this, s, started from the constant width that fits best and the first
        smoothing."""
        fit, channels = self._fit, self._scans[0].track.y.shape[1]
        fit.smoothing = dict(self._smoothing)
        widths = [share * self._scans[0].span for share in _WIDTHS]
        width = min(widths, key=lambda w: sum(scan.misfit(delay_s, w) for scan in self._scans))
        flat = Curves(np.full(fit.backlash.size, width), np.zeros((fit.follow.size, channels)), delay_s)
        return fit.solve(flat, iterations=6)


def _independent(fitted: Fitted) -> float:
    """The number of independent residuals: frames over `first_order`, how many correlated neighbours make one; 1 at
    least."""
    count = 0.0
    for rows, mask in zip(fitted.residuals, fitted.masks, strict=True):
        r = rows[mask]
        if len(r) > 2:
            count += len(r) / first_order(r)
    return max(count, 1.0)
