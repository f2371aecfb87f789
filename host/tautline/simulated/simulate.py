"""Recordings of a simulated instrument, with the truth beside them."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import takewhile
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from tautline import recording as recordings
from tautline.errors import TautError
from tautline.folders import replaced_folder, write_file
from tautline.prediction import TRUTH_FILE
from tautline.recording import COLOUR_FILE, Angle, Marker, Motor, Recording
from tautline.rig import Rig
from tautline.simulated.endoscope import Endoscope
from tautline.simulated.instrument import Instrument
from tautline.trajectory import Trajectory
from tautline.vision.camera import SimulatedCamera, VideoFile
from tautline.vision.colour import pick
from tautline.vision.timing import FrameTiming

Array = np.ndarray
Progress = Callable[[float, str], None]

TRUTH = "truth.json"  # beside a simulated recording, by which it is known as one


@dataclass(frozen=True)
class Simulation:
    """A recording and the truth behind it: the instrument, its p and c at the motor's times, and when each frame showed
    the scene."""

    recording: Recording
    instrument: Instrument
    t_s: Array  # (n,) the motor's times
    p: Array  # (n,) play's centre, unit of q
    c_deg: Array  # (n,)
    scene_s: Array  # (m,) when each frame of marker.csv showed the scene
    timing: FrameTiming

    def save(
        self,
        folder: str | Path,
        endoscope: Endoscope | None = None,
        lossless: bool = False,
        progress: Progress | None = None,
    ) -> None:
        """Saves the recording as a folder, with the truth: truth.csv (t_s, c_deg, p at the motor's times) and
        truth.json (B and f_remain on a grid, the delay). With an endoscope, its frames as a video and the marker's
        colour as marker.toml replace marker.csv. A simulation that was in the folder is replaced, whole or not at all.

        lossless: a frame takes 0.6 MB instead of 0.03, and the tracker's noise is 0.01 px instead of 0.04. progress:
        gets the share of the video done, 0 to 1, and a word. TautError where there is no frame to draw."""
        with replaced_folder(Path(folder), TRUTH, stale=recordings.FILES) as target:
            self._save(target, endoscope, lossless, progress)

    def _save(self, folder: Path, endoscope: Endoscope | None, lossless: bool, progress: Progress | None) -> None:
        """Writes the files of `save` into an empty folder. TautError where an endoscope has no frame to draw."""
        if endoscope is not None and not len(self.scene_s):
            raise TautError("no frame of this motion arrives: let it last longer, or lose fewer frames")
        recording = self.recording if endoscope is None else replace(self.recording, marker=None)
        recordings.save(recording, folder)
        table = pd.DataFrame({"t_s": self.t_s, "c_deg": self.c_deg, "p": self.p})
        table.to_csv(folder / TRUTH_FILE, index=False, float_format="%.6f")
        low, high = self.instrument.rig.actuator.range
        grid = np.linspace(low, high, 401)
        document = {
            "instrument": self.instrument.name,
            "unit": self.instrument.rig.actuator.unit,
            "delay_s": self.timing.delay_s,
            "backlash": {"q": grid.tolist(), "width": self.instrument.backlash(grid).tolist()},
            "remaining": {"q": grid.tolist(), "c_deg": self.instrument.bend(grid).tolist()},
        }
        write_file(folder / TRUTH, json.dumps(document, indent=1) + "\n")
        if endoscope is not None:
            self._save_video(folder, endoscope, lossless, progress)

    def scene(self, t_s: Array) -> tuple[Array | float, Array | float, Array | float]:
        """The instrument's state at times t_s (n,), s: c (n,), deg, translation, mm, and rotation, deg, each (n,), or 0
        where the recording has none."""
        motor = self.recording.motor
        others = (
            0.0 if x is None else np.interp(t_s, motor.t_s, x) for x in (motor.translation_mm, motor.rotation_deg)
        )
        return np.interp(t_s, self.t_s, self.c_deg), *others

    def _save_video(self, folder: Path, endoscope: Endoscope, lossless: bool, progress: Progress | None) -> None:
        """Draws each frame at its scene time; writes video.mkv, frames.csv with the arrival times, and the marker's
        colour, picked in the first frame where the marker truly is."""
        camera = SimulatedCamera(endoscope, self.scene, self.timing)
        total = len(self.scene_s)
        place = endoscope.position(*self.scene(self.scene_s[:1]))[0]
        arrivals_s = []
        with VideoFile(folder / "video.mkv", self.timing.rate_hz, lossless) as video:
            for k in range(total):
                picture, arrival_s = camera.read()
                if k == 0:
                    pick(picture, (float(place[0]), float(place[1]))).save(folder / COLOUR_FILE)
                video.write(picture)
                arrivals_s.append(arrival_s)
                if progress and k % 25 == 0:
                    progress(k / total, "drawing the video")
        frames = pd.DataFrame({"frame": np.arange(total), "t_s": arrivals_s})
        frames.to_csv(folder / "frames.csv", index=False, float_format="%.6f")


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
    """Drives `instrument` along `trajectory` and records it as `rig` would: encoder counts at the trajectory's times,
    and marker positions with white noise of `noise_px` per coordinate, without drawing images.

    timing: of the frames; default the rig's nominal rate and delay with a phase from the seed. angle_noise_deg: rms
    noise of an angle sensor at 250 Hz, which is recorded too (on a rig without a camera always; None is then no noise).
    start_p: p at the start, unit of q; NaN: the play is centred. The rig may differ from the instrument's own: the
    marker moves as the instrument's rig says. TautError where the trajectory takes no time."""
    if not trajectory.duration_s > 0:
        raise TautError("a simulation needs a motion that lasts: give it a longer duration")
    rng = np.random.default_rng([seed, 0x51A])  # any number: other draws of this seed are independent
    timing = timing or FrameTiming.of(rig, jitter_s=instrument.jitter_s, seed=seed)
    t = trajectory.t_s
    others = (trajectory.translation_mm, trajectory.rotation_deg)

    end = trajectory.duration_s
    frames = np.array(list(takewhile(lambda frame: frame[0] <= end, timing.frames()))).reshape(-1, 2)
    scene, arrival = frames.T
    angle_t = np.arange(0.0, end, 1 / 250.0)

    # The instrument moves over the times of motor, frames and angle sensor together, so that a frame between two
    # encoder samples is exact too.
    every = np.unique(np.concatenate([t, scene, angle_t]))  # s; p and c below are at these times
    instrument.reset(start_p)
    at_every = (None if x is None else np.interp(every, t, x) for x in others)
    course = instrument.course(every, np.interp(every, t, trajectory.q), *at_every)
    p, c = course.p, course.c_deg

    marker = angle = None
    if rig.has_camera:
        at_frames = np.searchsorted(every, scene)
        translation, rotation = (0.0 if x is None else np.interp(scene, t, x) for x in others)
        image = instrument.see(c[at_frames], course.way[at_frames], translation, rotation)
        marker = _marker_in_frame(image + rng.normal(0.0, noise_px, image.shape), arrival, rig, noise_px)
    if angle_noise_deg is not None or not rig.has_camera:
        at_angles = np.searchsorted(every, angle_t)
        angle = Angle(angle_t, c[at_angles] + rng.normal(0.0, angle_noise_deg or 0.0, len(at_angles)))

    at_motor = np.searchsorted(every, t)
    recording = Recording(name, _encoder_counts(trajectory, rig), marker, angle, rig=rig)
    return Simulation(
        recording, instrument, t_s=t, p=p[at_motor], c_deg=c[at_motor], scene_s=scene, timing=timing
    )  # fmt: skip


def _marker_in_frame(image_px: Array, arrival_s: Array, rig: Rig, noise_px: float) -> Marker:
    """The marker seen at places (n, 2), px, in frames that arrive at arrival_s (n,), s. Outside of the frame it is NaN
    and not valid. noise_px: the sigma that the marker states. The rig has a camera."""
    assert rig.camera is not None
    inside = np.all((image_px >= 0) & (image_px <= [rig.camera.width_px - 1, rig.camera.height_px - 1]), axis=1)
    u, v = np.where(inside[:, None], image_px, np.nan).T
    return Marker(arrival_s, u, v, valid=inside, sigma_px=np.full(len(u), noise_px))


def _encoder_counts(trajectory: Trajectory, rig: Rig) -> Motor:
    """A trajectory as a motor's log: q is rounded to whole counts of the rig's encoder, the command is the exact
    position."""
    resolution = rig.actuator.encoder_resolution
    return Motor(
        trajectory.t_s,
        np.round(trajectory.q / resolution) * resolution,
        q_cmd=trajectory.q,
        translation_mm=trajectory.translation_mm,
        rotation_deg=trajectory.rotation_deg,
    )


def simulate(rig: Rig, instrument: Instrument, trajectory: Trajectory, **options: Any) -> Recording:
    """The recording of `run` without the truth; options as there."""
    return run(rig, instrument, trajectory, **options).recording
