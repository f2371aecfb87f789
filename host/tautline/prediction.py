"""What a model says the tip does under a recorded motor motion. It never looks at marker positions or angles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.columns import read_times
from tautline.encoder import straight_lines
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.model import Model
from tautline.recording import Motor
from tautline.rig import ANGLE, MARKER

Array = npt.NDArray[np.float64]

MOST_ROWS = 10_000_000


@dataclass(frozen=True)
class Times:
    """When a prediction is asked for: arrival times, delay_s after the scene. `cells` is how the times are written."""

    cells: list[str]
    t_s: Array  # (n,)
    delay_s: float

    @property
    def scene_s(self) -> Array:
        return self.t_s - self.delay_s


@dataclass(frozen=True)
class Prediction:
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


def times_of(
    model: Model, folder: Path, motor: Motor, file: Path | None = None, warnings: list[str] | None = None
) -> Times:
    """`file`'s column t_s; else the recording's: the rows of marker.csv, else of angle.csv, else one per frame period
    from motor t[0] + delay on (one per motor sample where the model's rig has no camera)."""
    rig = model.rig
    for path, delay_s in (
        (file, model.delay_s),
        (folder / "marker.csv", model.delay_of(MARKER)),
        (folder / "angle.csv", model.delay_of(ANGLE)),
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
