"""Recordings of a simulated instrument, with the truth beside them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tautline.errors import TautError
from tautline.geometry import project
from tautline.instrument import Instrument
from tautline.recording import Angle, Marker, Motor, Recording
from tautline.rig import Rig
from tautline.timing import FrameTiming
from tautline.trajectory import Trajectory

Array = np.ndarray


@dataclass(frozen=True)
class Simulation:
    """A recording and what was true: p and c of the instrument at the motor's times, and where each frame was taken."""

    recording: Recording
    instrument: Instrument
    t_s: Array  # (n,) the motor's times
    p: Array  # (n,) play's centre, unit of q
    c_deg: Array  # (n,)
    scene_s: Array  # (m,) when each frame of marker.csv showed the scene
    delay_s: float

    def save_truth(self, folder: str | Path) -> None:
        """truth.csv: t_s, c_deg, p at the motor's times. truth.json: B and f_remain on a grid, the delay."""
        folder = Path(folder)
        table = pd.DataFrame({"t_s": self.t_s, "c_deg": self.c_deg, "p": self.p})
        table.to_csv(folder / "truth.csv", index=False, float_format="%.6f")
        low, high = self.instrument.rig.actuator.range
        grid = np.linspace(low, high, 401)
        document = {
            "instrument": self.instrument.name,
            "unit": self.instrument.rig.actuator.unit,
            "delay_s": self.delay_s,
            "backlash": {"q": grid.tolist(), "width": self.instrument.backlash(grid).tolist()},
            "remaining": {"q": grid.tolist(), "c_deg": self.instrument.bend(grid).tolist()},
        }
        (folder / "truth.json").write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def run(
    rig: Rig,
    instrument: Instrument,
    trajectory: Trajectory,
    *,
    noise_px: float = 0.05,
    timing: FrameTiming | None = None,
    angle_noise_deg: float | None = None,
    start_p: float = float("nan"),
    seed: int = 0,
    name: str = "simulated",
) -> Simulation:
    """Drives `instrument` along `trajectory` and records it as `rig` would: encoder counts at 1 kHz and marker
    positions with white noise of `noise_px` per coordinate, without images.

    timing: of the frames; default the rig's nominal rate and delay with a phase from the seed. angle_noise_deg: an
    external sensor at 250 Hz is recorded too (always on a rig without a camera). start_p: where the play starts; NaN is
    the centre. The rig may differ from the instrument's own: then the marker moves as the instrument's rig says.
    """
    if not trajectory.duration_s > 0:
        raise TautError("a simulation needs a motion that lasts: give it a longer duration")
    rng = np.random.default_rng([seed, 0x51A])
    timing = timing or FrameTiming.of(rig, seed=seed)
    t = trajectory.t_s
    others = (trajectory.translation_mm, trajectory.rotation_deg)

    end = trajectory.duration_s
    frames = np.array(list(takewhile(lambda frame: frame[0] <= end, timing.frames()))).reshape(-1, 2)
    scene, arrival = frames.T
    angle_t = np.arange(0.0, end, 1 / 250.0)

    # Over all the times that anyone looks at: what a frame shows between two encoder samples is exact too.
    every = np.unique(np.concatenate([t, scene, angle_t]))
    instrument.reset(start_p)
    p = instrument.centre(every, np.interp(every, t, trajectory.q))
    c = instrument.bend(p)

    marker = angle = None
    if rig.has_camera:
        at = np.searchsorted(every, scene)
        translation, rotation = (0.0 if x is None else np.interp(scene, t, x) for x in others)
        image = project(instrument.rig, c[at], translation, rotation) + rng.normal(0.0, noise_px, (len(at), 2))
        camera = rig.camera
        assert camera is not None  # has_camera
        inside = np.all((image >= 0) & (image <= [camera.width_px - 1, camera.height_px - 1]), axis=1)
        seen = np.where(inside[:, None], image, np.nan)
        marker = Marker(arrival, seen[:, 0], seen[:, 1], inside, np.full(len(at), noise_px))
    if angle_noise_deg is not None or not rig.has_camera:
        at = np.searchsorted(every, angle_t)
        angle = Angle(angle_t, c[at] + rng.normal(0.0, angle_noise_deg or 0.0, len(at)))

    resolution = rig.actuator.encoder_resolution
    motor = Motor(t, np.round(trajectory.q / resolution) * resolution, trajectory.q, *others)
    at = np.searchsorted(every, t)
    recording = Recording(name, motor, marker, angle, rig=rig)
    return Simulation(recording, instrument, t, p[at], c[at], scene, timing.delay_s)


def simulate(rig: Rig, instrument: Instrument, trajectory: Trajectory, **options: Any) -> Recording:
    """`run`'s recording alone; options as there."""
    return run(rig, instrument, trajectory, **options).recording
