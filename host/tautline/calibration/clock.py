"""The sensor's clock against the motor's: by how much the sensor's times are late, found from the data alone before
anything else is measured.

A lag is by how much the sensor's times are later than the motor's, s. It is the sum of the sensor's delay, which is
near the nominal one, and of the offset of its clock. lag_scan.py has the misfit at each lag. Delays are refined by the
image's stops (onset.py) or, for an angle sensor, by a smooth B and path (angle_delay.py)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.angle_delay import delay_of_all
from tautline.calibration.lag_scan import DELAY_REACH_S, FEWEST, FRAMES, PITCH_S, LagScan, Minimum
from tautline.calibration.observations import Track, observe
from tautline.calibration.onset import NOMINAL_S, Delay, find_delay
from tautline.calibration.steps import without_steps
from tautline.quality import Reason
from tautline.recording import Recording, shifted
from tautline.rig import ANGLE, MARKER, Rig

Array = npt.NDArray[np.float64]

REACH_S = 10.0  # prior: an offset is looked for this far around the nominal delay
FITS = 0.003  # tolerance: misfit up to which the nominal delay is as right as a search could say
_FOLLOWS = 0.25  # prior: misfit above which the sensor does not follow this motor at any offset
_RIVAL = 2.0  # prior: times the least misfit: other offsets that leave less are rivals of the best
_COARSELY = 3.0  # tolerance: times that before a minimum is refined
_NOISE = 4.0  # prior: times the share of noise: a misfit that a search could not improve on either
_EDGE_S = 0.09  # tolerance: a delay this far from the nominal one is at the edge of what find_delay looks through
_CLEARLY_LESS = 0.7  # prior: of the nominal delay's misfit: another lag fits
_BY_ITSELF_S = 0.06  # tolerance: as far as a search from the nominal delay surely comes, below _EDGE_S
_EITHER_WAY = 5  # tolerance: lags below and above the nominal delay, from which such a search may start
_NEAR_S = 1.0  # prior: around the nominal delay, where lags are tried first, and as far as an effect may make one
_BEATEN = 1.4  # prior: ratio of misfits from which a lag nearby is clearly better
_APART_S = 0.3  # prior: minima of the misfit that are nearer are one offset
_RIDGE = 3.0  # prior: times the misfit: how high it has to be between two minima that are two offsets
_LONGER = 0.01  # prior: relative difference of durations from which a stretched clock is tried for
_CLEAR, _SAME_S = 5.0, 0.004  # prior: standard deviations, and s, by which two recordings' delays differ clearly
_PARTS, _JUMP_S = 4, 0.03  # prior: parts of a recording, and s by which their delays differ where its clock jumps
_SURE_S = 0.02  # tolerance: standard deviation of a delay that is known well enough to refine an offset
_STRETCHED = 0.2  # prior: of the misfit that a stretched clock may leave at most


@dataclass(frozen=True)
class Offset:
    """The offset of a track's clock: its lag less the nominal delay."""

    offset_s: float
    misfit: float  # 0 to 1; 1 where no lag could be tried
    rivals: tuple[float, ...] = ()  # other offsets, s, that fit about as well


@dataclass(frozen=True)
class AlignedTracks:
    """Tracks with their times on the motor's clock: later than the scene by one delay and no more."""

    tracks: list[Track]
    offsets_s: tuple[float, ...]  # of each track's clock, which were taken off its times
    reasons: tuple[Reason, ...]  # of clocks that were off, or cannot be aligned
    notes: tuple[str, ...] = ()

    @classmethod
    def without_offsets(cls, tracks: Sequence[Track]) -> AlignedTracks:
        """The tracks with their times unchanged: every offset is 0."""
        return cls(list(tracks), (0.0,) * len(tracks), ())

    @property
    def offset_s(self) -> float | None:
        """The offset, s, with the largest absolute value; None if no clock was off."""
        return max(self.offsets_s, key=abs, default=0.0) or None

    @property
    def offsets(self) -> dict[str, float]:
        """The offsets that are not 0, s, by the recordings' names."""
        pairs = zip(self.tracks, self.offsets_s, strict=True)
        return {track.name: offset for track, offset in pairs if offset}

    def merged_into(self, every: Sequence[Track]) -> tuple[list[Track], list[float]]:
        """`every` track with the offset of its clock, s. These aligned tracks are those of `every` that have frames, in
        the same order, and take their places; a track without frames stays, with offset 0."""
        own = iter(zip(self.tracks, self.offsets_s, strict=True))
        pairs = [next(own) if len(track.t_s) else (track, 0.0) for track in every]
        return [track for track, _ in pairs], [offset_s for _, offset_s in pairs]

    @property
    def with_frames(self) -> AlignedTracks:
        """The same without tracks of which no frame was left, as the tip followed a step of the motor in all of
        them."""
        kept = [pair for pair in zip(self.tracks, self.offsets_s, strict=True) if len(pair[0].t_s)]
        return replace(self, tracks=[track for track, _ in kept], offsets_s=tuple(offset_s for _, offset_s in kept))

    def with_delay(self, delay: Delay, nominal_s: float) -> tuple[AlignedTracks, Delay]:
        """These tracks and a delay that was found on them. If every clock was off, delay and offsets cannot be told
        apart: then the delay is set to the nominal one, and the difference is added to the offsets. (The tracks' times
        stay.)"""
        if not self.offsets_s or not all(self.offsets_s):
            return self, delay
        offsets = tuple(offset + delay.delay_s - nominal_s for offset in self.offsets_s)
        return replace(self, offsets_s=offsets), replace(delay, delay_s=nominal_s)


def on_motor_clock(
    recordings: Sequence[Recording], rig: Rig, *, one_clock: bool = False
) -> tuple[list[Recording], tuple[Reason, ...]]:
    """(Recordings with the offsets of their sensors' clocks taken off, the reasons: what was taken off, and which
    offsets cannot be trusted). None is taken off where the tip of one of them follows a step of the motor, as that
    tells a play and no clock. A lag that is no larger than a delay may be is not taken off: an effect that is not known
    yet may make one motion's stops later than another's. one_clock: the session's calibration had sensor and motor on
    one clock; then a lag of up to _NEAR_S is sooner an effect's than another clock's, and is not taken off either."""
    every, reach_s = observe(recordings, rig), _NEAR_S if one_clock else DELAY_REACH_S
    seen = [track for track in every if len(track.t_s)]
    aligned = align(seen, rig, same_delay_for_all=False, reach_s=reach_s)
    _, offsets_s = aligned.merged_into(every)
    pairs = zip(recordings, offsets_s, strict=True)
    # What was taken off, also where `align` has reasons to refuse another track.
    off = [_offset_reason(track, by_s) for track, by_s in zip(aligned.tracks, aligned.offsets_s, strict=True) if by_s]
    # Several recordings may have one name.
    on_clock = [shifted([one], {one.name: offset_s})[0] for one, offset_s in pairs]
    return on_clock, tuple(dict.fromkeys([*off, *aligned.reasons]))


def align(
    tracks: Sequence[Track], rig: Rig, *, same_delay_for_all: bool = True, reach_s: float = DELAY_REACH_S
) -> AlignedTracks:
    """Takes the offset of its clock off each track's times, or gives fatal reasons why an offset cannot be trusted. A
    track that fits its nominal delay is left as it is, unless same_delay_for_all and its image stops at another delay
    than those of the other recordings, as one camera has one delay. (If not same_delay_for_all, such a difference may
    be an effect's.) Frames at which the tip follows a step of the motor are left out first. reach_s: as in
    `find_offset`."""
    tracks, stepping, notes = without_steps(tracks, rig)
    notes += [f"{t.name}: the sensor repeats its values, {t.held} of them were left out" for t in tracks if t.held]
    if stepping:
        return AlignedTracks(tracks, (0.0,) * len(tracks), tuple(stepping), tuple(notes))
    aligned, offsets = [], []
    reasons: list[Reason] = []
    for track in tracks:
        nominal_s = rig.nominal_delay_s(track.sensor)
        offset = find_offset(track, rig, reach_s)
        refused = None if offset is None else _reason_to_refuse(track, offset, rig)
        offset_s = 0.0
        if offset is not None and offset.offset_s and offset.misfit <= _FOLLOWS:
            track, offset_s = _without_offset(track, offset, nominal_s, rig)
        if refused is not None:
            reasons.append(refused)
        aligned.append(track)
        offsets.append(offset_s)
    if not reasons:
        aligned, offsets = _at_one_delay(aligned, offsets, rig, same_delay_for_all)
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
    tracks: list[Track], offsets: list[float], rig: Rig, same_delay_for_all: bool
) -> tuple[list[Track], list[float]]:
    """Tracks and their offsets, s, with all images at one delay, as one camera has one. It is the delay of the
    likeliest recording among those with offset 0. A track whose image stops at a clearly different delay is shifted to
    it if all its frames fit its own delay (`_fits_at_own_delay`) and, if not same_delay_for_all, if it has an offset
    already. All stay as they are with a single track, with an angle sensor's, or if no track has offset 0."""
    if len(tracks) < 2 or any(track.sensor != MARKER for track in tracks):
        return tracks, offsets
    delays = [delay_of_stops([track], rig) for track in tracks]
    right = [delay for delay, offset_s in zip(delays, offsets, strict=True) if not offset_s]
    if not right:
        return tracks, offsets
    nominal_s = rig.nominal_delay_s(MARKER)
    # The recording whose delay has the highest posterior density, by its stops and the rig's nominal delay.
    best = min(right, key=lambda d: np.log(d.sigma_s) + 0.5 * ((d.delay_s - nominal_s) / NOMINAL_S) ** 2)
    at_one, own_offsets = [], []
    for track, delay, offset_s in zip(tracks, delays, offsets, strict=True):
        later_s = delay.delay_s - best.delay_s
        clearly = abs(later_s) > max(_CLEAR * np.hypot(delay.sigma_s, best.sigma_s), _SAME_S)
        if clearly and (same_delay_for_all or offset_s) and _fits_at_own_delay(track, rig, delay.delay_s, best.delay_s):
            track, offset_s = replace(track, t_s=track.t_s - later_s), offset_s + later_s
        at_one.append(track)
        own_offsets.append(offset_s)
    return at_one, own_offsets


def _fits_at_own_delay(track: Track, rig: Rig, own_s: float, best_s: float) -> bool:
    """Whether all frames of the track fit about as well at own_s, the delay of its stops, as at best_s. If they do not,
    only its stops are late, as those of a slow motion are behind a codec that holds back what moves little. True if
    frames tell nothing."""
    scan = LagScan.of(track, rig, FRAMES[0])
    if scan is None:
        return True
    own, best = (float(scan.least_misfits(np.array([lag_s]))[0]) for lag_s in (own_s, best_s))
    return own <= _BEATEN * best


def _without_offset(track: Track, offset: Offset, nominal_s: float, rig: Rig) -> tuple[Track, float]:
    """The track with its clock's offset taken off, and that offset, s. The offset is refined by the delay that is then
    found on the track, if that is known to _SURE_S."""
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
        delays = [delay_of_stops([part], rig) for part in parts if len(part.t_s) >= FEWEST]
        delays = [delay for delay in delays if delay.stops and np.isfinite(delay.sigma_s)]
        if len(delays) < 2:
            continue
        first, last = min(delays, key=lambda each: each.delay_s), max(delays, key=lambda each: each.delay_s)
        apart = last.delay_s - first.delay_s
        if apart > max(_CLEAR * float(np.hypot(first.sigma_s, last.sigma_s)), _JUMP_S):
            says = f"{track.name}: the image's delay differs by {apart * 1e3:.0f} ms between parts of the recording"
            reasons.append(Reason("clock.offset", says, "look for lost frames or a clock that was set meanwhile"))
    return reasons


def find_offset(track: Track, rig: Rig, reach_s: float = DELAY_REACH_S) -> Offset | None:
    """The offset of the track's clock, within REACH_S. It is 0 if the nominal delay, or a lag within reach_s of it,
    fits; misfit 1 if no lag could be tried. Other offsets that fit about as well are its rivals. None if the track
    shows no motion to tell it by. reach_s (up to _NEAR_S): a lag farther than this from the nominal delay is another
    clock, not a delay."""
    scan = LagScan.of(track, rig, FRAMES[0])
    if scan is None:
        return None
    nominal_s = rig.nominal_delay_s(track.sensor)
    near = _lags_around(nominal_s, _NEAR_S)
    least_misfits = scan.least_misfits(near)
    delays = np.abs(near - nominal_s) <= reach_s
    least = float(least_misfits[delays].min())
    at_nominal = least <= max(FITS, _NOISE * scan.noise_share) and least <= _BEATEN * least_misfits.min()
    if at_nominal and scan.moves_as_coarse(float(near[delays][int(least_misfits[delays].argmin())])):
        return Offset(0.0, least)
    rivals = _minima(scan, LagScan.of(track, rig, FRAMES[1]) or scan, _lags_around(nominal_s, REACH_S))
    if not rivals:
        return Offset(0.0, 1.0)
    nominal = [r for r in rivals if abs(r.lag_s - nominal_s) <= reach_s]
    if nominal:
        # It may be another half turn of the motion, with the wrong sign, that fits here.
        others = (
            ()
            if scan.moves_as_coarse(nominal[0].lag_s)
            else tuple(r.lag_s for r in rivals if scan.moves_as_coarse(r.lag_s))
        )
        return Offset(0.0, nominal[0].misfit, tuple(lag - nominal_s for lag in others))
    rivals = [r for r in rivals if scan.moves_as_coarse(r.lag_s)] or rivals
    others = tuple(r.lag_s - nominal_s for r in rivals[1:])
    return Offset(rivals[0].lag_s - nominal_s, rivals[0].misfit, others)


def _lags_around(lag_s: float, reach_s: float) -> Array:
    """Lags (n,), s, from lag_s - reach_s to lag_s + reach_s, PITCH_S apart."""
    steps = round(reach_s / PITCH_S)
    return np.asarray(lag_s + np.arange(-steps, steps + 1) * PITCH_S)


def _minima(scan: LagScan, fine: LagScan, lags: Array) -> list[Minimum]:
    """The minima of the misfit over lags (n,), s, that leave at most _RIVAL times the least, best first. Two minima are
    taken for one if they are within _APART_S or no ridge of _RIDGE times the misfit is between them. scan: of few
    frames, to search with, where up to _COARSELY times as much is let through; fine: of more frames, to refine each
    minimum."""
    least_misfits = scan.least_misfits(lags)
    finite = np.where(np.isfinite(least_misfits), least_misfits, 1.0)
    padded = np.concatenate([[np.inf], finite, [np.inf]])
    candidate = (finite <= padded[:-2]) & (finite <= padded[2:]) & (finite <= _COARSELY * _RIVAL * finite.min() + 1e-12)
    at = np.flatnonzero(candidate & np.isfinite(least_misfits))
    minima = sorted((fine.minimum_near(float(lags[i])) for i in at), key=lambda one: one.misfit)
    rivals: list[Minimum] = []
    for one in minima:
        if one.misfit > _RIVAL * minima[0].misfit:
            break
        between = (finite[(lags > min(one.lag_s, r.lag_s)) & (lags < max(one.lag_s, r.lag_s))] for r in rivals)
        apart = all(abs(one.lag_s - r.lag_s) > _APART_S for r in rivals)
        if apart and all(len(ridge) and ridge.max() > _RIDGE * one.misfit for ridge in between):
            rivals.append(one)
    return rivals


def _reason_to_refuse(track: Track, best: Offset, rig: Rig) -> Reason | None:
    """The fatal reason why the track's offset cannot be trusted: its times are stretched, several offsets fit alike, or
    none does. None if `best`, the offset that was found, can be trusted."""
    follows = best.misfit <= _FOLLOWS
    if follows and not best.rivals:
        return None
    stretched = _reason_of_stretch(track, rig, best.misfit)
    if stretched is not None:
        return stretched
    if follows:
        fits = ", ".join(f"{offset:.2f}" for offset in sorted([best.offset_s, *best.rivals])[:6])
        says = f"{track.name}: the sensor's clock is off, and offsets of {fits} s fit alike"
        return Reason("clock.offset", says, "make a motion that does not repeat, or put both on one clock", fatal=True)
    says = f"{track.name}: at no offset within {REACH_S:g} s does the tip follow the motor"
    return Reason("clock.offset", says, "check that both are of one run, and their clocks", fatal=True)


def _reason_of_stretch(track: Track, rig: Rig, misfit: float) -> Reason | None:
    """The fatal reason that a track's times run too fast or too slow, None if they do not. They do if frames and motor
    last differently and, once the times are scaled to the motor's duration, a lag leaves at most the share _STRETCHED
    of `misfit`, that of the best offset."""
    motor_s = float(np.ptp(track.motor.t_s))
    seen_s = float(np.ptp(track.t_s))
    if seen_s <= 0.0 or abs(motor_s / seen_s - 1.0) < _LONGER:
        return None
    times = track.motor.t_s[0] + (track.t_s - track.t_s[0]) * motor_s / seen_s
    scan = LagScan.of(replace(track, t_s=times), rig, FRAMES[0])
    lags = _lags_around(rig.nominal_delay_s(track.sensor), _NEAR_S)
    if scan is None or float(scan.least_misfits(lags).min()) > _STRETCHED * misfit:
        return None
    return Reason(
        "duration",
        f"{track.name}: {seen_s:.4g} s of frames show {motor_s:.4g} s of motor",
        "the frames' times are wrong: record when each arrived (frames.csv), or correct the frame rate",
        fatal=True,
    )


def delay_of_stops(tracks: Sequence[Track], rig: Rig) -> Delay:
    """The delay at which the image stops, looked for around the nominal one (`find_delay`). If the result is at the
    edge of what that looks through, it is looked for once more, around the delay at which all frames fit best or, if
    that is the nominal one, around the edge; the second result counts if it is not at its edge."""
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
    """Where `find_delay` is to start, s. Of 2 _EITHER_WAY + 1 lags within DELAY_REACH_S of the nominal delay the one of
    least misfit, if that is less than _CLEARLY_LESS of the nominal delay's and the lag is more than _BY_ITSELF_S away,
    as far as `find_delay` surely comes by itself; else the nominal delay."""
    scans = [scan for scan in (LagScan.of(track, rig, FRAMES[0]) for track in tracks) if scan is not None]
    if not scans:
        return nominal_s
    lags = nominal_s + np.linspace(-DELAY_REACH_S, DELAY_REACH_S, 2 * _EITHER_WAY + 1)
    least_misfits = np.sum([scan.least_misfits(lags) for scan in scans], axis=0)
    best = int(np.argmin(least_misfits))
    better = least_misfits[best] < _CLEARLY_LESS * least_misfits[_EITHER_WAY]
    return float(lags[best]) if better and abs(lags[best] - nominal_s) > _BY_ITSELF_S else nominal_s
