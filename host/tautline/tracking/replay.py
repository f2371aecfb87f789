"""Recordings replayed to the tracker, row by row, as it would have met them in use."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.model import Model
from tautline.recording import Angle, Marker, Recording
from tautline.rig import ANGLE, MARKER, Sensor
from tautline.tracking.loop import Tracker
from tautline.tracking.tracker import Change, Row
from tautline.value import Value

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

COLUMNS = "recording,t_s,state,c_deg,u_px,v_px,offset,offset_sigma,scale,scale_sigma,reason"
_REPORTED = 500  # tolerance: rows between two reports of progress


@dataclass(frozen=True, eq=False, repr=False)
class Tracked(Value):
    """The tracker's row for each frame (or reading of an angle) of the recordings, invalid ones too."""

    recording: npt.NDArray[np.intp]  # (n,) index of the recording
    t_s: Array  # (n,) arrival times
    rows: list[Row]  # n
    changes: list[Change]
    sensor: Sensor

    def column(self, name: str) -> Array:
        """(n,) The values of the field of Row with this name, in its unit, over all rows."""
        return np.array([getattr(row, name) for row in self.rows])


def replay(model: Model, recordings: Sequence[Recording], progress: Progress = lambda fraction, text: None) -> Tracked:
    """Runs a tracker over recordings in the order given; what it learnt carries over from one to the next. Each row is
    predicted from the motor up to its scene time and the rows before it. The tracker keeps the play alone: what other
    effects of the model move (`moved_by_effects`) is taken from what is seen, and added to what is predicted. progress:
    gets the share done, 0 to 1, and a text. TautError where the recordings have no sensor in common."""
    sensor = _sensor(recordings)
    tracker = Tracker(model.alone, sensor)
    number, times, rows = [], [], []
    whole = sum(len(_frames(recording, sensor).t_s) for recording in recordings)
    for i, recording in enumerate(recordings):
        frames, motor = _frames(recording, sensor), recording.motor
        if i:
            tracker.begin()
        tracker.motor(motor.t_s, motor.q, motor.translation_mm, motor.rotation_deg, motor.load_mNm)
        readings, moved = _readings(frames), moved_by_effects(model, recording, sensor)
        for k, arrival in enumerate(frames.t_s.tolist()):
            rows.append(_row_with_effects(tracker, arrival, readings(k), None if moved is None else moved[k]))
            if len(rows) % _REPORTED == 0:
                progress(len(rows) / whole, f"{recording.name}: {rows[-1].state}")
        number.append(np.full(len(frames.t_s), i, dtype=np.intp))
        times.append(frames.t_s)
    return Tracked(np.concatenate(number), np.concatenate(times), rows, tracker.changes, sensor)


def moved_by_effects(model: Model, recording: Recording, sensor: Sensor) -> Array | None:
    """(n, 3) By how much the model's effects move the angle c, deg, and the marker's u and v, px (NaN without a
    camera), in each frame; None where the model has no effects. They are taken at the motor's last sample before the
    frame's scene time (its time less the sensor's delay), or at the first sample: a row may know of no later one."""
    if not model.effects:
        return None
    motor = recording.motor
    scene = _frames(recording, sensor).t_s - model.delay_of(sensor)
    sample_s = motor.t_s[np.maximum(np.searchsorted(motor.t_s, scene, side="right") - 1, 0)]
    load = model.load_reference_mNm
    with_effects, without = (
        effects.simulate(model, motor, sample_s, values, load_reference=load)
        for values in (effects.of_model(model), {})
    )
    return np.column_stack([with_effects.c_deg - without.c_deg, with_effects.image_px - without.image_px])


def _row_with_effects(tracker: Tracker, arrival_s: float, seen: tuple[float, ...], moved: Array | None) -> Row:
    """Shows a frame to the tracker and returns its row. seen: as `_readings` gives it. moved (3,): by how much effects
    that the tracker does not know move c, deg, and u, v, px; it is taken from what is seen and added to what is
    predicted. None: there are no such effects."""
    if moved is None:
        return tracker.see(arrival_s, *seen)
    c, u, v = moved.tolist()
    own = (seen[0] - c,) if len(seen) == 1 else (seen[0] - u, seen[1] - v, *seen[2:]) if seen else ()
    row = tracker.see(arrival_s, *own)
    return replace(row, c_deg=row.c_deg + c, u_px=row.u_px + u, v_px=row.v_px + v)


def off_by(tracked: Tracked, recordings: Sequence[Recording]) -> Array:
    """(n,) Distance of each row's prediction from what was seen: px per coordinate of a marker (its length over
    sqrt(2)), deg of an angle; NaN where nothing was seen."""
    parts = []
    for i, recording in enumerate(recordings):
        frames = _frames(recording, tracked.sensor)
        rows = [tracked.rows[k] for k in np.flatnonzero(tracked.recording == i)]
        if isinstance(frames, Angle):
            off = np.abs(frames.c_deg - np.array([row.c_deg for row in rows]))
            parts.append(np.where(frames.seen, off, np.nan))
        else:
            away = np.hypot(
                frames.u_px - np.array([row.u_px for row in rows]), frames.v_px - np.array([row.v_px for row in rows])
            )
            parts.append(np.where(frames.valid, away / np.sqrt(2.0), np.nan))
    return np.concatenate(parts)


def residuals(tracked: Tracked, recordings: Sequence[Recording]) -> list[float | None]:
    """The rms of `off_by` (px or deg) for each recording; None where nothing was seen in it."""
    off = off_by(tracked, recordings)
    rms: list[float | None] = []
    for i in range(len(recordings)):
        mine = off[tracked.recording == i]
        mine = mine[np.isfinite(mine)]
        rms.append(float(np.sqrt(np.mean(mine**2))) if len(mine) else None)
    return rms


def _sensor(recordings: Sequence[Recording]) -> Sensor:
    """The sensor that all recordings have: MARKER, else ANGLE. TautError where they have neither in common, or there
    are no recordings."""
    if not recordings:
        raise TautError("track needs a recording of use, or several")
    for sensor, name in ((MARKER, "marker"), (ANGLE, "angle")):
        if all(getattr(recording, name) is not None for recording in recordings):
            return sensor
    raise TautError("track needs marker.csv (or a video) in all recordings, or angle.csv in all of them")


def _frames(recording: Recording, sensor: Sensor) -> Marker | Angle:
    """The recording's table of this sensor, which it must have."""
    frames = recording.marker if sensor == MARKER else recording.angle
    assert frames is not None
    return frames


def _readings(frames: Marker | Angle) -> Callable[[int], tuple[float, ...]]:
    """Returns a function that gives, for a row's index, what was seen as `Tracker.see` takes it: (c_deg,), (u, v) or
    (u, v, sigma); () where the tip was not seen."""
    if isinstance(frames, Angle):
        seen, c = frames.seen, frames.c_deg
        return lambda k: (float(c[k]),) if seen[k] else ()
    u, v, valid, sigma = frames.u_px, frames.v_px, frames.valid, frames.sigma_px
    if sigma is None:
        return lambda k: (float(u[k]), float(v[k])) if valid[k] else ()
    return lambda k: (float(u[k]), float(v[k]), float(sigma[k])) if valid[k] else ()


def write_csv(path: Path, tracked: Tracked) -> None:
    """Writes the rows to a CSV file with the columns COLUMNS, one row for each frame; u_px and v_px are empty without a
    camera."""
    out = io.StringIO()
    out.write(COLUMNS + "\n")
    writer = csv.writer(out, lineterminator="\n")
    for recording, t_s, row in zip(tracked.recording.tolist(), tracked.t_s.tolist(), tracked.rows, strict=True):
        image = [f"{value:.4f}" if np.isfinite(value) else "" for value in (row.u_px, row.v_px)]
        law = [f"{value:.7g}" for value in (row.offset, row.offset_sigma, row.scale, row.scale_sigma)]
        writer.writerow([recording, repr(t_s), row.state.value, f"{row.c_deg:.6f}", *image, *law, row.reason])
    write_file(path, out.getvalue())
