"""Checks whether recordings are what the rig says they are: unit of the motor's range, frame size, clocks, and how much
of the motion was seen.

Each doubt is a Reason. It is fatal if, by the contradiction, nothing that is measured can be used."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from tautline.calibration.observations import Track
from tautline.geometry import coarse_range_deg, pose
from tautline.independence import stretches
from tautline.quality import Reason
from tautline.recording import Marker, Motor, Recording
from tautline.rig import MARKER, Camera, Rig

Array = npt.NDArray[np.float64]

# Sizes that a camera or a converter makes of a picture, as factors of the rig's.
_SCALES = (1 / 4, 1 / 3, 3 / 8, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 8 / 3, 3.0, 4.0)  # prior: above
_EVEN = 0.01  # tolerance: by which the two sides may be scaled differently: a rounded number of pixels
_OFF = 0.02  # prior: of the picture's width: farther from the tip's path the marker is not where the rig puts it
_FITS = 0.1  # prior: of that distance is left where another scale is right
_LIKE_COARSE = 2.0  # prior: factor within which angles that a right scale gives follow f_coarse
_MARGIN_PX, _IN_A_ROW = 2.0, 3  # tolerance: a marker outside of the picture, and frames in a row that show it there
_LOOKED_AT = 60  # tolerance: frames of a track, evenly spread, whose places are compared with the tip's path
# How many of the rig's units one of another is, and what that one is called.
_MM = (1000.0, "metres"), (25.4, "inches"), (1e-3, "micrometres")  # equation: mm of each
_DEG = ((57.3, "radians"),)  # equation: deg of each
_MISTAKEN = {"mm": _MM, "deg": _DEG}
_REACH_SLACK = 10.0  # prior: of such a factor: a motion covers a part of the range
_LEAST_REACH, _MOST_REACH = 0.02, 5.0  # prior: of the range: beyond, the two are in different units
_LEAST_BEND_DEG, _MOST_BEND_DEG = 1.0, 1000.0  # prior: three turns: no bending section's
_LOST_ENDS_S, _LOST_ENDS = 3.0, 0.05  # tolerance: of motion without frames, as a camera starts late
_SCATTERED = 0.15  # prior: of the image's motion that the motor's position leaves unexplained: more is no backlash
_RATE = 0.05  # tolerance: by which a steady frame rate may differ from the rig's
_STEADY = 0.1  # tolerance: of the frame period: what varies more is no rate
_PLACES = 12  # tolerance: of the motor's range, in each of which the marker has to be seen
_SEEN = 0.3  # tolerance: of the frames there
_FEWEST = 20  # tolerance: frames from which a share is one
_LEAVES = 0.01  # tolerance: of the motor's range: so far from its first place its motion has begun
_AROUND_S = 0.05  # tolerance: of a frame: within it the motor's direction is taken
_BINS = 24  # tolerance: edges of the bins of the motor's range in each of which the image has one mean


def rig_contradictions(
    recordings: Sequence[Recording], tracks: Sequence[Track], offsets_s: Sequence[float], rig: Rig
) -> list[Reason]:
    """Returns the doubts about recordings that contradict the rig (unit of the range, frame size, frame rate, clocks)
    or in which the marker or a part of the motion was not seen; empty if there are none. tracks: one for each
    recording, with times on the motor's clock; offsets_s: each sensor's clock less the motor's, s, which the tracks'
    times no longer contain."""
    reasons = _range_in_another_unit(tracks, rig)
    if rig.camera is not None and tracks[0].unit == "px":  # observations are of one kind
        reasons += _wrong_frame_size(recordings, tracks, rig, rig.camera)
        reasons += _wrong_rate(recordings, rig.camera)
    for recording, track, offset_s in zip(recordings, tracks, offsets_s, strict=True):
        reasons += _frames_beyond_motor(recording, track, rig.nominal_delay_s(track.sensor), offset_s)
        if recording.marker is not None and track.unit == "px":
            reasons += _marker_not_seen(recording, recording.marker, rig, offset_s)
    return reasons


def in_another_unit(reached: tuple[float, float], rig: Rig) -> bool:
    """Whether the motor's positions and the rig's range cannot be in one unit: they cover far less or far more than the
    range, or lie far beyond it. reached: lowest and highest position, unit of q."""
    share = (reached[1] - reached[0]) / rig.actuator.span
    beyond = max(rig.actuator.range[0] - reached[0], reached[1] - rig.actuator.range[1])
    return share < _LEAST_REACH or share > _MOST_REACH or beyond > _MOST_REACH * rig.actuator.span


# ---- units


def mistaken_unit(factor: float, unit: str, slack: float) -> str:
    """The name of the unit that values are probably in if they must be multiplied by `factor` to be in `unit` ("mm" or
    "deg"): 1000 and "mm" give "metres". It is the entry of _MISTAKEN[unit] with the nearest factor; empty if even that
    differs by more than a factor of `slack`."""
    distance, name = min((abs(np.log(max(factor, 1e-12) / unit_factor)), name) for unit_factor, name in _MISTAKEN[unit])
    return name if distance < np.log(slack) else ""


def _range_in_another_unit(tracks: Sequence[Track], rig: Rig) -> list[Reason]:
    """A fatal reason, in a list, if the motor's positions and the rig's range cannot be in one unit, or f_coarse bends
    the tip by more than _MOST_BEND_DEG over the range, so that coarse.gain and the range cannot be; else empty."""
    actuator, bend_deg = rig.actuator, float(np.ptp(coarse_range_deg(rig)))
    low, high = min(float(t.motor.q.min()) for t in tracks), max(float(t.motor.q.max()) for t in tracks)
    if in_another_unit((low, high), rig):
        wrong, ratio = f"q_{actuator.unit} of motor.csv", actuator.span / max(high - low, 1e-12)
        if not _LEAST_BEND_DEG < bend_deg < _MOST_BEND_DEG:  # the range is not in the unit that coarse.gain is per
            wrong, ratio = "actuator.range", 1.0 / ratio
        name = mistaken_unit(ratio, actuator.unit, _REACH_SLACK)
        return [
            Reason(
                "range",
                f"the motor goes from {low:.4g} to {high:.4g}, the rig's range is "
                f"[{actuator.range[0]:g}, {actuator.range[1]:g}] {actuator.unit}",
                f"{wrong} looks like {name}: write it in {actuator.unit}"
                if name
                else "give actuator.range in the unit of q",
                fatal=True,
            )
        ]
    if bend_deg > _MOST_BEND_DEG:
        return [
            Reason(
                "range",
                f"f_coarse bends the tip by {bend_deg:.3g} deg over the rig's range",
                f"coarse.gain is in deg per {actuator.unit}, actuator.range in {actuator.unit}: check both",
                fatal=True,
            )
        ]
    return []


# ---- frames


def _wrong_frame_size(
    recordings: Sequence[Recording], tracks: Sequence[Track], rig: Rig, camera: Camera
) -> list[Reason]:
    """A fatal reason, in a list, if a recording's frames have another size than the rig's, or else if the marker
    positions of a track are not of the rig's frame size (`_frame_size_by_places`); only the first one found. Empty if
    there is none."""
    nominal = (camera.width_px, camera.height_px)
    for recording in recordings:
        size = recording.marker.frame_px if recording.marker is not None else None
        if size is None or size == nominal:
            continue
        scale = (size[0] / nominal[0], size[1] / nominal[1])
        even = abs(scale[0] / scale[1] - 1.0) < _EVEN
        return [
            Reason(
                "frame_size",
                f"{recording.name}: its frames are {size[0]} x {size[1]} px, the rig's {nominal[0]} x {nominal[1]}",
                _remedy_of_scale(scale[0]) if even else "calibrate the camera at this size, or record at the rig's",
                fatal=True,
            )
        ]
    for track in tracks:
        if reason := _frame_size_by_places(track, rig, camera):
            return [reason]
    return []


def _remedy_of_scale(scale: float) -> str:
    """The remedy, in words, for frames whose width and height are both `scale` times the rig's."""
    return (
        "record at the rig's size, or, where the whole view was scaled and not cut, multiply fx_px, fy_px, cx_px, "
        f"cy_px, width_px and height_px by {scale:.4g}"
    )


def _frame_size_by_places(track: Track, rig: Rig, camera: Camera) -> Reason | None:
    """A fatal reason if the marker is far from the tip's path, but on it if its positions are divided by one of
    _SCALES; or if it is outside of the rig's frame for _IN_A_ROW frames in a row. None if neither is so, or with fewer
    than two frames."""
    if len(track.t_s) < 2:
        return None
    size = np.array([camera.width_px, camera.height_px])
    outside = np.any((track.y < -_MARGIN_PX) | (track.y > size - 1 + _MARGIN_PX), axis=1)
    # The tip's path leaves for many frames in a row, a false sighting for one.
    leaves = len(track.y) >= _IN_A_ROW and bool(sliding_window_view(outside, _IN_A_ROW).all(axis=1).any())
    as_is = _path_error(track, rig, 1.0)
    scaled = {scale: _path_error(track, rig, scale) for scale in _SCALES} if as_is > _OFF * camera.width_px else {}
    best = min(scaled, key=lambda scale: scaled[scale], default=1.0)
    if scaled and scaled[best] < _FITS * as_is:
        return Reason(
            "frame_size",
            f"{track.name}: the marker is {as_is:.3g} px off the tip's path, but on it if the frames were {best:.3g} "
            "times the rig's size",
            _remedy_of_scale(best),
            fatal=True,
        )
    if leaves:
        low, high = track.y[outside].min(axis=0), track.y[outside].max(axis=0)
        return Reason(
            "frame_size",
            f"{track.name}: marker positions from ({low[0]:.4g}, {low[1]:.4g}) to ({high[0]:.4g}, {high[1]:.4g}) px "
            f"are outside of the rig's {camera.width_px} x {camera.height_px} px",
            "the rig's camera is not the one that recorded this: calibrate the camera at the size of its frames",
            fatal=True,
        )
    return None


def _path_error(track: Track, rig: Rig, scale: float) -> float:
    """rms distance, px of the rig's size, between the marker and the path that the rig has for the tip, if the track's
    frames are `scale` times the rig's size; taken at _LOOKED_AT frames. Infinite if a position has no bending angle, or
    if the angles' slope by q is not f_coarse's within a factor of _LIKE_COARSE, sign included (not checked at scale
    1)."""
    some = np.linspace(0, len(track.t_s) - 1, min(_LOOKED_AT, len(track.t_s))).astype(int)
    scene_s = track.scene_s(rig.delay_s)[some]
    q, others = track.motor_at(scene_s), track.others_at(scene_s)
    # Whole numbers are the middles of pixels: the picture begins at -0.5.
    c, away = pose(rig, (track.y[some] + 0.5) / scale - 0.5, *others)
    if not np.isfinite(away).all():
        return np.inf
    gain = float(np.cov(q, c)[0, 1] / max(np.var(q, ddof=1), 1e-12)) / rig.coarse.gain
    likely = scale == 1.0 or 1.0 / _LIKE_COARSE < gain < _LIKE_COARSE
    return float(np.sqrt(np.mean(away**2))) if likely else np.inf


def _wrong_rate(recordings: Sequence[Recording], camera: Camera) -> list[Reason]:
    """A doubt, in a list, about the first recording most of whose frame intervals are equal but are neither the rig's
    frame period nor a multiple of it, as lost frames leave; else empty. Recordings of fewer than _FEWEST frames are not
    judged."""
    for recording in recordings:
        if recording.marker is None or len(recording.marker.t_s) < _FEWEST:
            continue
        step = np.diff(recording.marker.t_s)
        period = float(np.median(step))
        if np.mean(np.abs(step - period) < _STEADY * period) < 0.5:
            continue
        # Periods of the rig for each one seen: a whole number where frames were lost evenly.
        steps = period * camera.frame_rate_hz
        if abs(steps - max(round(steps), 1)) > _RATE * max(round(steps), 1):
            return [
                Reason(
                    "rate",
                    f"{recording.name}: frames come at {1 / period:.4g} Hz, the rig says {camera.frame_rate_hz:g}",
                    "set camera.frame_rate_hz, or check the times of the frames: a video that plays too fast or too "
                    "slow is on another clock than the motor",
                )
            ]
    return []


def _marker_not_seen(recording: Recording, marker: Marker, rig: Rig, offset_s: float) -> list[Reason]:
    """A doubt, in a list, if the marker is valid in fewer than the share _SEEN of the frames in one of _PLACES equal
    parts of the motor's range (parts of fewer than _FEWEST frames are not judged); else empty. offset_s: the camera's
    clock less the motor's."""
    motor = recording.motor
    scene = marker.t_s - offset_s - rig.nominal_delay_s(MARKER)
    inside = (scene >= motor.t_s[0]) & (scene <= motor.t_s[-1])
    q = np.interp(scene, motor.t_s, motor.q)
    edges = np.linspace(motor.q.min(), motor.q.max(), _PLACES + 1)
    unseen = np.zeros(_PLACES, dtype=bool)
    for k, (low, high) in enumerate(pairwise(edges)):
        in_part = inside & (q >= low) & (q <= high)
        unseen[k] = in_part.sum() >= _FEWEST and np.mean(marker.valid[in_part]) < _SEEN
    if not unseen.any():
        return []
    where = " and ".join(f"from {edges[at.start]:.3g} to {edges[at.stop]:.3g}" for at in stretches(unseen))
    seen = np.mean(marker.valid[inside])
    return [
        Reason(
            "lost",
            f"{recording.name}: {where} {rig.actuator.unit} the marker is mostly not seen ({100 * (1 - seen):.0f} % of "
            "all frames are without it)",
            "keep it in view and in light there, or pick its colour again (taut marker)",
        )
    ]


# ---- clocks


def _frames_beyond_motor(recording: Recording, track: Track, delay_s: float, offset_s: float) -> list[Reason]:
    """A doubt, in a list, if a camera or sensor started late or stopped early: the motor moves without frames, or
    frames go on without the motor, for longer than both _LOST_ENDS_S and the share _LOST_ENDS of the motor's record. It
    is mild if all motion was seen and every frame has a time; fatal if the image does not follow the motor either, as
    two clocks that contradict each other make it. Empty else, with fewer than _FEWEST frames, or if the motor never
    moves. offset_s: the sensor's clock less the motor's, which `track` is on already."""
    if len(track.t_s) < _FEWEST:
        return []
    motor, frames_s = recording.motor, track.t_s
    if track.unit == "px" and recording.marker is not None:  # with the frames in which the marker was not found
        frames_s = recording.marker.t_s - offset_s
    first, last = float(frames_s[0]) - delay_s, float(frames_s[-1]) - delay_s
    frames_last, motor_lasts = last - first, float(motor.t_s[-1] - motor.t_s[0])  # s
    slack, motion = max(_LOST_ENDS_S, _LOST_ENDS * motor_lasts), _moving_interval(motor)
    if motion is None:
        return []
    begin, end = motion
    missing = min(max(first - begin, 0.0) + max(end - last, 0.0), end - begin)  # s of the motion without frames
    if missing <= slack and frames_last - motor_lasts <= slack:
        return []
    says = f"{recording.name}: its frames last {frames_last:.4g} s, its motor {motor_lasts:.4g}"
    share = _unexplained_share(track, delay_s)
    if share > _SCATTERED:
        return [
            Reason(
                "clock",
                f"{says}, and the image does not follow the motor ({100 * share:.0f} % of its motion is elsewhere)",
                "the clocks contradict each other: give the frames' arrival times on the motor's clock (frames.csv)",
                fatal=True,
            )
        ]
    camera, mild = "camera" if track.unit == "px" else "sensor", missing <= slack  # mild: all motion was seen
    if not mild:
        what, remedy = f"{missing:.3g} s of the motion have no frames", f"start the {camera} first and stop it last"
    else:
        what = f"{frames_last - motor_lasts:.3g} s of them are without the motor"
        remedy = f"log the motor for as long as the {camera} runs, on the same clock"
    if track.unit == "px" and recording.marker is not None and (untimed := recording.marker.untimed):
        timed, mild = len(recording.marker.t_s), False
        remedy = f"frames.csv lists {timed} of the video's {timed + untimed} frames: list every one"
    return [Reason("duration", f"{says}: {what}", remedy, mild=mild)]


def _moving_interval(motor: Motor) -> tuple[float, float] | None:
    """When, s, the motor first left the position of its first sample and last was away from that of its last one, by
    more than the share _LEAVES of its range. None if it never moved."""
    off_start = np.flatnonzero(np.abs(motor.q - motor.q[0]) > _LEAVES * np.ptp(motor.q))
    off_end = np.flatnonzero(np.abs(motor.q - motor.q[-1]) > _LEAVES * np.ptp(motor.q))
    if not len(off_start) or not len(off_end):
        return None
    return float(motor.t_s[off_start[0]]), float(motor.t_s[off_end[-1]])


def _unexplained_share(track: Track, delay_s: float) -> float:
    """Share (0 to 1) of the variance of y that the motor's position does not explain: what is left after subtracting
    the mean y of each of _BINS bins of the position. It is taken for rising and for falling motion alone, so that
    backlash adds nothing, and the smaller one is returned; 0 if both have fewer than _FEWEST frames."""
    scene = track.scene_s(delay_s)
    inside = track.within_motor(scene)
    q, travel = track.motor_at(scene), track.motor_at(scene + _AROUND_S) - track.motor_at(scene - _AROUND_S)
    shares = []
    for sign in (1, -1):
        in_direction = inside & (sign * travel > 0)
        if in_direction.sum() < _FEWEST:
            continue
        bins = np.digitize(q[in_direction], np.linspace(q[in_direction].min(), q[in_direction].max(), _BINS))
        y = track.y[in_direction]
        total = float(np.sum((y - y.mean(axis=0)) ** 2))
        left = sum(float(np.sum((y[bins == k] - y[bins == k].mean(axis=0)) ** 2)) for k in np.unique(bins))
        shares.append(left / max(total, 1e-12))
    return min(shares, default=0.0)
