"""What a model says the tip does under a recorded motor motion. It never looks at marker positions or angles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.columns import read_columns, read_times
from tautline.encoder import between_counts, straight_lines
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.model import Model
from tautline.recording import Motor, Recording
from tautline.rig import ANGLE, MARKER
from tautline.value import Value

Array = npt.NDArray[np.float64]

MOST_ROWS = 10_000_000
TRUTH_FILE = "truth.csv"  # beside a simulated recording


@dataclass(frozen=True)
class Times:
    """When a prediction is asked for: arrival times, delay_s after the scene. `cells` is how the times are written."""

    cells: list[str]
    t_s: Array  # (n,)
    delay_s: float

    @property
    def scene_s(self) -> Array:
        return self.t_s - self.delay_s


@dataclass(frozen=True, eq=False, repr=False)
class Prediction(Value):
    c_deg: Array  # (n,)
    image_px: Array | None  # (n, 2); None without a camera


def predict(model: Model, motor: Motor, scene_s: npt.ArrayLike, start_deg: float | None = None) -> Prediction:
    """At scene times (n,) on the motor's clock, in any order. The tip starts on the centre line, c = f_remain(q[0]), or
    at start_deg; q is held before the first and after the last motor sample."""
    scene = np.asarray(scene_s, dtype=float)
    reference = float(model.extra.get("load_reference_mNm", 0.0))
    lines = straight_lines(motor, model.rig.actuator.encoder_resolution)
    path = effects.simulate(model, lines, scene, effects.of_model(model), start_deg, reference)
    return Prediction(path.c_deg, path.image_px if model.rig.has_camera else None)


def settled_from(model: Model, motor: Motor) -> float:
    """The scene time from which the start inside the backlash no longer matters: both envelopes were reached."""
    widest = 1.1 * float(model.width.max()) + 2 * model.rig.actuator.encoder_resolution
    motor = between_counts(motor, model.rig.actuator.encoder_resolution)  # at every sample
    return driven_both_ways_from(motor.t_s, motor.q, widest)


def driven_both_ways_from(t_s: Array, q: Array, width: float) -> float:
    """The time from which q has gone further than `width` either way, infinite where it never has."""
    up = np.flatnonzero(q - np.minimum.accumulate(q) > width)
    down = np.flatnonzero(np.maximum.accumulate(q) - q > width)
    if len(up) == 0 or len(down) == 0:
        return float("inf")
    return float(t_s[max(up[0], down[0])])


def misses(model: Model, motor: Motor, scene_s: npt.ArrayLike, seen: Array) -> Array:
    """What was seen at scene times less what the model says: seen is (n, 2) px, or (n,) or (n, 1) deg; so is that."""
    told = predict(model, motor, scene_s)
    if seen.ndim == 2 and seen.shape[1] == 2:
        assert told.image_px is not None  # the model has a camera
        return np.asarray(seen - told.image_px)
    return np.asarray(seen - told.c_deg.reshape(seen.shape))


def foretold(model: Model, recording: Recording, settled_by: Model | None = None) -> float:
    """rms of what the model says of a recording, px a coordinate, deg without a marker or a camera, from when the tip
    was driven through the backlash (of settled_by, if given) both ways. TautError where it was not."""
    usual, motor = settled_by or model, recording.motor
    begin_s = settled_from(usual, motor)
    if not np.isfinite(begin_s):
        raise TautError(
            f"{recording.name}: the motor does not go through the backlash both ways: record a longer motion"
        )
    marker, angle = recording.marker, recording.angle
    if marker is not None and model.rig.has_camera:
        sensor, arrival_s, valid = MARKER, marker.t_s, marker.valid
        seen = np.column_stack([marker.u_px, marker.v_px])
    elif angle is not None:
        sensor, arrival_s, valid, seen = ANGLE, angle.t_s, angle.seen, angle.c_deg
    else:
        raise TautError(f"{recording.name}: has neither marker.csv (or a video) nor angle.csv")
    counted = valid & (arrival_s - usual.delay_of(sensor) >= begin_s)
    if not counted.any():
        raise TautError(f"{recording.name}: nothing was seen after the tip was driven both ways")
    return rms([misses(model, motor, (arrival_s - model.delay_of(sensor))[counted], seen[counted])])


def rms(off: Sequence[Array]) -> float:
    """Of all together; infinite where a place cannot be in the image at all."""
    value = float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
    return value if np.isfinite(value) else float("inf")


def times_of(
    model: Model, folder: Path, motor: Motor, file: Path | None = None, warnings: list[str] | None = None
) -> Times:
    """`file`'s column t_s; else the recording's: the rows of marker.csv, else of angle.csv, else of a video's
    frames.csv, else one per frame period from motor t[0] + delay on (one per motor sample where the model's rig has no
    camera)."""
    rig = model.rig
    for path, delay_s in (
        (file, model.delay_s),
        (folder / "marker.csv", model.delay_of(MARKER)),
        (folder / "angle.csv", model.delay_of(ANGLE)),
        (folder / "frames.csv", model.delay_of(MARKER)),
    ):
        if path is not None and (path == file or path.exists()):
            return Times(*read_times(path, warnings), delay_s)
    if rig.camera is None:
        t_s = motor.t_s + model.delay_s
    else:
        frames = (motor.t_s[-1] - motor.t_s[0]) * rig.camera.frame_rate_hz * (1 + 1e-12)
        if frames > MOST_ROWS:
            raise TautError(f"{folder}: lasts for more than {MOST_ROWS} frames: name the times with --times")
        t_s = motor.t_s[0] + model.delay_s + np.arange(int(frames) + 1) / rig.camera.frame_rate_hz
    return Times([f"{t:.6f}" for t in t_s], t_s, model.delay_s)


def off_the_truth(model: Model, folder: Path, motor: Motor, times: Times, prediction: Prediction) -> float | None:
    """rms of the bending angle less truth.csv's (t_s, c_deg at scene times), deg, from when the tip was driven through
    the backlash both ways; None where the folder has no truth, or none of then."""
    if not (folder / TRUTH_FILE).exists():
        return None
    truth = read_columns(folder / TRUTH_FILE, ["t_s", "c_deg"], "t_s,c_deg")
    t_s, c_deg = truth.rising_times(), truth.finite("c_deg")
    scene_s = times.scene_s
    counted = (scene_s >= max(settled_from(model, motor), t_s[0])) & (scene_s <= t_s[-1])
    if not counted.any():
        return None
    return rms([prediction.c_deg[counted] - np.interp(scene_s[counted], t_s, c_deg)])


def write_csv(path: Path, times: Times, prediction: Prediction) -> None:
    """t_s,c_deg,u_px,v_px; t_s as it was written, the last two empty without a camera or where the marker cannot be."""
    lines = ["t_s,c_deg,u_px,v_px"]
    image = [("", "")] * len(times.cells)
    if prediction.image_px is not None:
        image = [(_text(u), _text(v)) for u, v in prediction.image_px.tolist()]
    for cell, c, (u, v) in zip(times.cells, prediction.c_deg.tolist(), image, strict=True):
        lines.append(f"{cell},{c:.6f},{u},{v}")
    write_file(path, "\n".join(lines) + "\n")


def _text(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ""
