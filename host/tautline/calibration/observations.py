"""What a calibration works on: motor and tip, frame by frame, from any recording."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import numpy.typing as npt

from tautline import _native, geometry, spread
from tautline.calibration.sway import play_paths, probability_of_rest
from tautline.core.motor import MotorPath
from tautline.core.samples import FEW, even_runs, least_noise, least_step, noise_of, repeats, rounding_step, strays
from tautline.core.session import SessionClock
from tautline.encoder import reading_noise, smoothed_noise
from tautline.errors import TautError
from tautline.recording import Motor, Recording, Shown
from tautline.rig import ANGLE, MARKER, Rig, Sensor

Array = npt.NDArray[np.float64]
Mask = npt.NDArray[np.bool_]

_AS_STATED = (0.6, 1.6)  # prior: ratio of the noise that y shows to the stated one, in which the stated one counts
_DOUBTFUL = 3.0  # prior: frames of so many times the usual stated noise do not count
_RESOLVED = 4.0  # prior: times the least steps that a sensor shows: beyond, repeated values are no matter of resolution
_HELD, _FEWEST_RUNS = 0.25, 8  # prior: share of values that are repeated then, and how many must be seen
LITTLE = 1e-3  # tolerance: of the range: a motion or a width of less is next to none
_PARTS = 12  # tolerance: of the range, in each of which noise may be another
_DIFFERS = 2.0  # prior: times by which noise differs from part to part, where it does
_ORDER = 5  # equation: of the differences, which show noise and not motion
_FIFTH = 252.0  # equation: squares of 1, 5, 10, 10, 5, 1
# Of the rms over 1 or 2 coordinates of fifth differences of unit noise: its median (of chi square), and the standard
# deviation of that median's logarithm, times the root of their number (by simulation: neighbours are alike).
_MEDIAN = {1: spread.MEDIAN, 2: 0.8326}  # equation: above
_ERROR_OF_LOG = {1: 1.65, 2: 1.06}  # equation: above
_WORLD_DEG = 8.0  # prior: of a wall that a tip sees breathe, as a square that is followed is in an endoscope's picture
_TELL_HOLD, _CHANGES = 8, 4  # tolerance: frames and changes of the value, from which it may be held
_LONGEST_RUN = 0.95  # tolerance: quantile of the repeats that a sample is held for; longer ones are of a tip that rests
_TURNS_COUNTS, _TURNS_NOISES = 3.0, 8.0  # tolerance: of the encoder and of its noise: less is no turn
_DIFFERENCES = 8  # tolerance: frames from which fifth differences are taken
_STILL_MM, _STILL_DEG = 0.02, 0.05  # tolerance: other degrees of freedom that stay within this do not move


@dataclass(frozen=True)
class Track:
    """What one sensor saw of the tip in one recording. Frames without a marker are not in it."""

    name: str
    unit: str  # of y: "px" or "deg"
    path: MotorPath
    t_s: Array  # (n,) when a frame or a sensor's value arrived; rising
    y: Array  # (n, 2) px or (n, 1) deg
    sigma: Array  # (n,) noise of y, per coordinate
    motor_noise: float = 0.0  # of the motor's readings, unit of q, that was smoothed away
    stray: int = 0  # frames left out because they show the marker elsewhere for a while
    held: int = 0  # left out because the sensor repeated the value before
    session_s: float = 0.0  # added to its times to get the session's
    shown: Shown | None = None  # what was followed where it is no marker
    tracked_px: float = 0.0  # prior of what frames near one place are off by alike; 0 of places that others tell
    step: float = 0.0  # of y, to which the sensor rounds; 0: to nothing that shows
    posed: bool = False  # y is the bending angle, by a pose: what other degrees of freedom move is taken out

    def only(self, frames: Mask | npt.NDArray[np.intp] | slice) -> Track:
        """The track with these of its frames: mask (n,), indices or slice."""
        return replace(self, t_s=self.t_s[frames], y=self.y[frames], sigma=self.sigma[frames])

    @property
    def placed_px(self) -> float:
        """Standard deviation, px per coordinate, of the tracker's error that is drawn anew at each place of the image;
        0 if the positions are another program's."""
        return geometry.PLACED_PX if self.tracked_px else 0.0

    def scene_s(self, delay_s: float) -> Array:
        """(n,) when the scene of each frame was, s: its arrival less the delay."""
        return self.t_s - delay_s

    @property
    def motor(self) -> Motor:
        """The motor's path as straight lines between knots."""
        return self.path.lines

    @property
    def reading(self) -> Motor:
        """The motor as it was recorded."""
        return self.path.readings

    @property
    def sensor(self) -> Sensor:
        """Which of the rig's sensors saw it."""
        return MARKER if self.unit == "px" else ANGLE

    def motor_at(self, scene_s: Array) -> Array:
        """The motor's positions (n,), unit of q, at scene times (n,), s."""
        return self.path.at(scene_s)

    def others_at(self, scene_s: Array) -> tuple[Array, Array]:
        """Translation (n,), mm, and rotation (n,), deg, at scene times (n,), s."""
        return self.path.others_at(scene_s)

    def within_motor(self, scene_s: Array) -> Mask:
        """(n,) whether the motor's record covers each scene time, s."""
        inside: Mask = (scene_s >= self.motor.t_s[0]) & (scene_s <= self.motor.t_s[-1])
        return inside

    def others_still(self, from_s: float, to_s: float) -> bool:
        """Whether translation and rotation rest between two scene times, s; True if neither was recorded."""
        if self.motor.translation_mm is None and self.motor.rotation_deg is None:
            return True
        translation, rotation = self.others_at(self.path.course(from_s, to_s)[0])
        return bool(np.ptp(translation) <= _STILL_MM and np.ptp(rotation) <= _STILL_DEG)

    @property
    def others_reference(self) -> tuple[float, float]:
        """Where translation (mm) and rotation (deg) mostly are, their medians; 0 if not recorded."""
        return tuple(
            0.0 if values is None else float(np.median(values))
            for values in (self.reading.translation_mm, self.reading.rotation_deg)
        )  # type: ignore[return-value]

    def at_reference(self, scene_s: Array, reference: tuple[float, float]) -> Mask:
        """(n,) Whether translation (mm) and rotation (deg) are at `reference` at each scene time, s, within _STILL_MM
        and _STILL_DEG, so that the tip follows one curve in the image. True everywhere for a posed track."""
        if self.posed:
            return np.ones(len(scene_s), dtype=bool)
        translation, rotation = self.others_at(scene_s)
        still: Mask = (np.abs(translation - reference[0]) <= _STILL_MM) & (
            np.abs(rotation - reference[1]) <= _STILL_DEG
        )
        return still


def observe(recordings: Sequence[Recording], rig: Rig) -> list[Track]:
    """One track for each recording, in the session's time: of its marker if it has one and the rig a camera, else of
    its angle. Sway is taken out of squares that were followed on a bare tip and of what a tip's own camera sees
    (`without_sway`). Raises TautError if a recording has neither, or some tracks are of a marker and some of an
    angle."""
    tracks = []
    for recording, session_s in zip(recordings, SessionClock.of(recordings).offset_s, strict=True):
        resolution = rig.actuator.encoder_resolution
        noise = reading_noise(recording.motor)
        noise = max(noise if noise > resolution else 0.0, smoothed_noise(recording.motor, resolution))
        path = MotorPath.closely(recording.motor, resolution)
        marker, angle = recording.marker, recording.angle
        if marker is not None and rig.has_camera:
            seen = marker.valid & np.isfinite(marker.u_px) & np.isfinite(marker.v_px)
            y = np.column_stack([marker.u_px, marker.v_px])[seen].astype(float)
            given = None if marker.sigma_px is None else marker.sigma_px[seen]
            track = _track_of_values(recording, path, "px", marker.t_s[seen], y, given)
            of_frames = recording.video is not None or marker.frame_px is not None
            track = replace(track, shown=marker.shown, tracked_px=geometry.TRACKED_PX if of_frames else 0.0)
            tracks.append(track if marker.shown is None else without_sway(track, rig, marker.shown.side_px))
        elif angle is not None:
            seen = angle.seen
            y = angle.c_deg[seen, None].astype(float)
            track = _track_of_values(recording, path, "deg", angle.t_s[seen], y, None)
            tracks.append(without_sway(track, rig, _WORLD_DEG) if rig.sees_from_tip else track)
        elif marker is not None:
            raise TautError(f"{recording.name}: marker positions need a rig with [camera]: add it to rig.toml")
        else:
            raise TautError(f"{recording.name}: holds no marker positions and no angles: track its video first")
        tracks[-1] = replace(tracks[-1], session_s=session_s, motor_noise=noise)
    if len({track.unit for track in tracks}) > 1:
        raise TautError("some recordings hold a marker and some an angle only: calibrate with one kind")
    return tracks


def without_sway(track: Track, rig: Rig, side: float) -> Track:
    """The track with its motion about the median multiplied by the probability that the followed place follows the
    motor and does not only sway (sway.py): the expected motion of the tip. The same track with few frames or if the
    motor hardly moves. side: size of the followed square, y's unit."""
    low, high = float(track.motor.q.min()), float(track.motor.q.max())
    if len(track.t_s) < FEW or not high - low > turning_hysteresis(
        track.path, rig.actuator.encoder_resolution, rig.actuator.span
    ):
        return track
    ends = rig.coarse.gain * np.array([[low], [high]]) + rig.coarse.offset
    if track.unit == "px":
        ends = geometry.project(rig, ends.ravel())
    swing = float(np.linalg.norm(ends[1] - ends[0]))
    if not np.isfinite(swing):
        return track
    paths = play_paths(track.motor, track.scene_s(rig.delay_s))
    still = probability_of_rest(track.t_s, track.y, float(track.sigma[0]), paths, swing, side)
    return replace(track, y=track.y - still * (track.y - np.median(track.y, axis=0)))


def _track_of_values(
    recording: Recording, path: MotorPath, unit: str, t: Array, y: Array, given: Array | None
) -> Track:
    """The track of y (n, channels) at arrival times t (n,), s, without repeated values, frames of doubtful stated noise
    and strays. given (n,): noise that the recording states, or None; its median counts if y scatters about as much,
    else the noise is the one that y shows."""
    fresh = not_held(y)
    held = int(np.sum(~fresh))
    t, y, given = t[fresh], y[fresh], None if given is None else given[fresh]
    noise = noise_of(t, y, least_noise(unit))
    if given is not None and len(t) and (np.isfinite(given) & (given > 0)).any():
        good = np.isfinite(given) & (given > 0)
        stated = float(np.median(given[good]))
        # One noise for all frames, so that a still marker stays level when it is divided by it.
        keep = ~(good & (given > _DOUBTFUL * stated))
        t, y = t[keep], y[keep]
        noise = stated if _AS_STATED[0] < noise / stated < _AS_STATED[1] else noise
    noise = max(noise, 1e-9)
    stray = strays(path, t, y, noise)
    t, y = t[~stray], y[~stray]
    sigma = np.full(len(t), noise)
    step = rounding_step(y)
    return Track(recording.name, unit, path, t, y, sigma, stray=int(stray.sum()), held=held, step=step)


def not_held(y: Array) -> Mask:
    """(n,) whether each value of y (n, channels) is a new sample of the sensor. All are, unless values are sampled and
    held. That is so if many values (_HELD) are repeated though the tip moves by far more than the sensor's resolution
    (_RESOLVED). Repeats are not new then; in longer runs, of a tip at rest, one frame in as many as a value is usually
    held for counts as new."""
    fresh = np.ones(len(y), dtype=bool)
    if len(y) < _TELL_HOLD:
        return fresh
    changes = np.flatnonzero(~repeats(y))[1:]
    if len(changes) == len(y) - 1 or len(changes) < _CHANGES:
        return fresh
    step = np.linalg.norm(y[changes] - y[changes - 1], axis=1)
    runs = np.diff(changes)  # of the value that changes[i] began
    levels = np.unique(y[:, 0])
    resolution = least_step(levels) if len(levels) > 1 else np.inf
    # Runs between two changes that are both too large to be steps of the resolution: the tip moves there.
    moves = np.minimum(step[:-1], step[1:]) > _RESOLVED * resolution
    if moves.sum() < _FEWEST_RUNS or np.mean(runs[moves] > 1) < _HELD:
        return fresh
    hold = int(np.quantile(runs[moves & (runs > 1)], _LONGEST_RUN))
    edges = np.concatenate([[0], changes, [len(y)]])
    row = np.arange(len(y))
    run = np.searchsorted(edges, row, side="right") - 1
    # Frames since the run began, and until it ends.
    since, left = row - edges[run], edges[run + 1] - row
    anew: Mask = (since == 0) | ((since % hold == 0) & (left >= hold))
    return anew


def _sizes_of_noise(track: Track, place: Array) -> Array:
    """(k, 2) places, unit of q, and the noise that y shows there, over the stated one: root mean squares of fifth
    differences, in which a fast motion shows less than in third ones, over their median for unit noise. One for each
    six frames at even times. place (n,): the tip's at the track's frames, unit of q."""
    fifth = np.diff(track.y, _ORDER, axis=0) / (np.sqrt(_FIFTH) * track.sigma[_ORDER:, None])
    least = least_noise(track.unit) / track.sigma[_ORDER:]
    size = np.maximum(np.sqrt(np.mean(fifth**2, axis=1)) / _MEDIAN[track.y.shape[1]], least)
    return np.column_stack([0.5 * (place[2:-3] + place[3:-2]), size])[even_runs(track.t_s, _ORDER)]


@dataclass(frozen=True)
class NoiseByPlace:
    """By how much the noise differs from what the tracks state, as a factor that depends on the place; its logarithm is
    linear between places. With one place only the factor is 1."""

    places: Array = field(default_factory=lambda: np.zeros(1))  # (m,) rising, unit of q
    log_times: Array = field(default_factory=lambda: np.zeros(1))  # (m,)

    @property
    def differs(self) -> bool:
        """Whether the noise differs from place to place."""
        return len(self.places) > 1

    def times(self, place: Array) -> Array:
        """(n,) the factor at places (n,), unit of q; beyond the first and last place it is as there."""
        return np.asarray(np.exp(np.interp(place, self.places, self.log_times)))

    @classmethod
    def of(cls, tracks: Sequence[Track], places: Sequence[Array]) -> Self:
        """The noise of tracks whose frames are at places (n,) each, unit of q, in _PARTS parts of the range. One noise,
        as stated, if that is likelier than parts that differ by a factor of _DIFFERS. Else each part's noise is its
        own, drawn to the mean as its few frames tell it less (by the variances of both). Tracks that round and parts of
        few frames do not count."""
        told_by = (each for each in zip(tracks, places, strict=True) if len(each[0].t_s) >= _DIFFERENCES)
        rows = [_sizes_of_noise(track, place) for track, place in told_by if track.step == 0.0]
        if not sum(map(len, rows)):
            return cls()
        at, size = np.concatenate(rows).T
        edges = np.linspace(at.min(), at.max(), _PARTS + 1)
        part = np.digitize(at, edges[1:-1])
        frames = np.bincount(part, minlength=_PARTS)
        told = np.flatnonzero(frames >= FEW)
        if len(told) < 2:
            return cls()
        log = np.log([float(np.median(size[part == k])) for k in told])
        error = _ERROR_OF_LOG[tracks[0].y.shape[1]] / np.sqrt(frames[told])
        mean = float(np.sum(log / error**2) / np.sum(error**-2))
        off, spread_of = log - mean, np.hypot(error, np.log(_DIFFERS))
        # Log likelihood of parts that differ, N(mean, spread_of^2), less that of one noise, N(mean, error^2).
        gain = 0.5 * ((off / error) ** 2 - (off / spread_of) ** 2) - np.log(spread_of / error)
        if not gain.sum() > 0.0:
            return cls()
        middles = 0.5 * (edges[1:] + edges[:-1])[told]
        # Posterior mean of each part: its distance from the mean counts by the share of the parts' variance in
        # spread_of^2.
        return cls(middles, mean + off * (np.log(_DIFFERS) / spread_of) ** 2)


def with_noise(track: Track, noise: NoiseByPlace, place: Array) -> Track:
    """The track with its sigma multiplied by the factor at its frames' places (n,), unit of q; unchanged if it
    rounds."""
    return track if track.step > 0.0 else replace(track, sigma=track.sigma * noise.times(place))


def turning_hysteresis(path: MotorPath, resolution: float, span: float) -> float:
    """How far, unit of q, a motor has to go back for a turn. Less is dither of its encoder (resolution), noise of its
    readings, or next to nothing of the range, span; all in the unit of q."""
    return float(max(_TURNS_COUNTS * resolution, _TURNS_NOISES * path.noise, LITTLE * span))


def usual_width(width: Array, span: float) -> float:
    """The median of widths (k,), unit of q; at least the share LITTLE of span, a range of q."""
    return max(float(np.median(width)) if len(width) else 0.0, LITTLE * span)


def corners(motor: Motor) -> tuple[Array, Array]:
    """Times, s, and positions (k,), unit of q, of the motor's first and last sample and all extremes between: all that
    a play needs to know of a motion."""
    q = motor.q
    if len(q) < 3:
        return motor.t_s, q
    turns = _native.turns(np.ascontiguousarray(q), 0.0)
    keep = np.unique(np.concatenate([[0], turns, [len(q) - 1]]))
    return motor.t_s[keep], q[keep]
