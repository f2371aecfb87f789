"""What a model says the tip does under a recorded motor motion. It never looks at marker positions or angles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline.geometry import project
from tautline.model import Model
from tautline.recording import Recording

Array = npt.NDArray[np.float64]

_PERIOD_S = 0.04  # of rows where neither frames nor a camera's rate say when


@dataclass(frozen=True)
class Prediction:
    t_s: Array  # (n,) as asked for
    c_deg: Array  # (n,)
    image_px: Array | None  # (n, 2); None without a camera

    def save(self, path: str | Path) -> None:
        """t_s,c_deg,u_px,v_px; the last two are empty without a camera."""
        image = self.image_px
        lines = ["t_s,c_deg,u_px,v_px"]
        for i, (t, c) in enumerate(zip(self.t_s.tolist(), self.c_deg.tolist(), strict=True)):
            seen = "," if image is None else f"{_text(image[i, 0])},{_text(image[i, 1])}"
            lines.append(f"{t!r},{c:.6f},{seen}")
        Path(path).write_text("\n".join(lines) + "\n", encoding="utf-8")


def _text(value: float) -> str:
    return f"{value:.4f}" if np.isfinite(value) else ""


def row_times(model: Model, recording: Recording) -> tuple[Array, bool]:
    """Times of a prediction's rows, and whether they are arrival times (delayed): those of marker.csv, else of
    angle.csv, else one per frame period from motor t[0] + delay on."""
    rig = model.rig
    if recording.marker is not None:
        return recording.marker.t_s, rig.has_camera
    if recording.angle is not None:
        return recording.angle.t_s, False
    period = 1.0 / rig.camera.frame_rate_hz if rig.camera else _PERIOD_S
    delay = model.delay_s if rig.has_camera else 0.0
    first, last = recording.motor.t_s[0], recording.motor.t_s[-1]
    count = int(np.floor((last - first) / period * (1 + 1e-12))) + 1
    return first + delay + period * np.arange(count), rig.has_camera


def predict(
    model: Model, recording: Recording, times_s: npt.ArrayLike | None = None, start_deg: float | None = None
) -> Prediction:
    """One row per time. times_s: instead of the recording's own; arrival times where the model's rig has a camera. The
    tip starts on the centre line, c = f_remain(q[0]), or at start_deg."""
    if times_s is None:
        times, delayed = row_times(model, recording)
    else:
        times, delayed = np.asarray(times_s, dtype=float), model.rig.has_camera
    scene = times - model.delay_s if delayed else times
    motor = recording.motor
    c = model.simulate(motor, scene, start_deg)
    if not model.rig.has_camera:
        return Prediction(times, c, None)
    others = (
        0.0 if values is None else np.interp(scene, motor.t_s, values)
        for values in (motor.translation_mm, motor.rotation_deg)
    )
    return Prediction(times, c, project(model.rig, c, *others))
