"""Finds out which shape of a library the shaft has, by a short motion through the backlash in both directions."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline import trajectory
from tautline.errors import TautError
from tautline.live.following import follow
from tautline.live.setup import Live, Recorder
from tautline.model import Model
from tautline.shapes import Library, Shape, recalled

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None] | None

_STROKE = 3.0  # length of the first stroke in times the widest backlash
_LEAST_STROKE, _MOST_STROKE = 0.15, 0.8  # its limits: share of the range; share of the way to the farther end
_SHORTER = 0.7  # of the first stroke: length of the strokes back and out again
_SPEED_DEG_S = 15.0


def recall(live: Live, library: Library, progress: Progress = None) -> tuple[Shape, dict[str, float]]:
    """Finds out which shape of the library the shaft has now: moves the motor out and back twice from where it is, and
    compares what the camera sees with each shape's model. Returns the shape whose model predicts it best, and the rms
    error of each by name, px. TautError where there is no camera, or two shapes are equally good."""
    if live.marker_source is None:
        raise TautError("no camera: a shape is told by what it sees; name one with --camera, or use --simulate")
    t_s, q = _test_motion(live, [library.model(shape.name) for shape in library.shapes])
    with tempfile.TemporaryDirectory() as folder, Recorder(live, Path(folder) / "recall") as recorder:
        follow(live, t_s, q, tip=False, seen=recorder.add, progress=progress)
        recording = recorder.recording_so_far()
    return recalled(library, recording)


def _test_motion(live: Live, models: Sequence[Model]) -> tuple[Array, Array]:
    """Plans the test motion from where the motor is: a stroke out, towards the farther end of the range, _SHORTER of it
    back, out again, and back to the start. The stroke is _STROKE times the models' widest B, within its limits. Returns
    times, s, and motor positions, the rig's unit, both (n,)."""
    actuator = live.rig.actuator
    low, high = actuator.range
    start = float(np.clip(live.motor_position(), low, high))
    widest = max((float(model.width.max()) for model in models), default=0.0)
    stroke = min(max(_STROKE * widest, _LEAST_STROKE * actuator.span), _MOST_STROKE * max(high - start, start - low))
    stroke *= 1.0 if high - start > start - low else -1.0
    points = [start, start + stroke, start + (1.0 - _SHORTER) * stroke, start + stroke, start]
    speed = min(_SPEED_DEG_S / abs(live.rig.coarse.gain), 0.5 * live.top_speed)
    planned = trajectory.through(points, speed, 8.0 * speed)  # 1/8 s to full speed
    return planned.t_s, planned.q
