"""What a report shows of the recordings behind a model: what was seen in every frame, beside the predictions of three
models."""

from __future__ import annotations

import io
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Self

import numpy as np
import pandas as pd

from tautline.calibration.observations import observe
from tautline.columns import read_columns
from tautline.core.session import SessionClock
from tautline.errors import TautError
from tautline.folders import write_file
from tautline.geometry import pose
from tautline.model import Model
from tautline.prediction import predict, settled_from
from tautline.recording import Motor, Recording

Array = np.ndarray

FILE = "evidence.npz"
COMPENSATIONS = ("off", "backlash", "full")
STAGES = ("f_coarse", "f_coarse + B", "f_remain + B")  # the models of the paper's Table I


@dataclass(frozen=True)
class Evidence:
    """The data that a report is drawn from. It has n rows, one for each frame (or sensor sample) in which the tip was
    seen, recording after recording, with what was seen and the errors of three models."""

    recording: Array  # (n,) int: index of the recording
    t_s: Array  # (n,) scene times, s, on the recordings' common clock
    q: Array  # (n,) motor position at that time, the rig's unit
    path: Array  # (n,) distance that the motor had travelled in the recording by then, the rig's unit
    seen: Array  # (n, d) position in the image, px (d = 2), with a camera; else angle, deg (d = 1)
    c_deg: Array  # (n,) bending angle, deg, from the pose of each frame alone, or from the sensor
    error: Array  # (3, n, d) seen minus what each of STAGES predicts
    settled: Array  # (n,) bool: as `is_settled` says, so that errors count
    offset_s: Array  # (recordings,) added to a time of each recording's clock it gives the common clock's
    names: Array  # (recordings,) str: of the recordings

    @property
    def unit(self) -> str:
        """The unit of `seen` and `error`."""
        return "px" if self.seen.shape[1] == 2 else "deg"

    def index(self, name: str) -> int:
        """The index of the recording with this name; 0 where none has it."""
        return int(np.argmax(self.names == name))

    def rms(self) -> list[float]:
        """The rms of `error` per coordinate over the `settled` rows, for each of STAGES in turn; NaN where there are no
        such rows."""
        error = self.error[:, self.settled]
        if error.shape[1] == 0:
            return [float("nan")] * len(STAGES)
        return [float(np.sqrt(np.nanmean(stage**2))) for stage in error]

    def save(self, folder: Path) -> None:
        """Writes evidence.npz into a model's folder."""
        np.savez_compressed(folder / FILE, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, folder: Path) -> Self | None:
        """Reads evidence.npz from a model's folder; None where there is no such file. TautError where it cannot be read
        or its arrays' shapes do not fit each other."""
        path = folder / FILE
        if not path.exists():
            return None
        try:
            with np.load(io.BytesIO(path.read_bytes())) as data:
                evidence = cls(**{field.name: data[field.name] for field in fields(cls)})
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, zlib.error) as error:
            why = f"{error.strerror}" if isinstance(error, OSError) and error.strerror else "it is damaged"
            raise TautError(
                f"{path}: cannot be read, {why}: make it again with taut calibrate, or delete it for a report without "
                "the recording"
            ) from error
        n, d = evidence.seen.shape if evidence.seen.ndim == 2 else (-1, -1)
        columns = (getattr(evidence, name) for name in ("recording", "t_s", "q", "path", "c_deg", "settled"))
        if (
            n < 1
            or any(column.shape != (n,) for column in columns)
            or evidence.error.shape != (len(STAGES), n, d)
            or evidence.offset_s.shape != evidence.names.shape
            or evidence.names.ndim != 1
        ):
            raise TautError(f"{path}: its parts do not fit each other: make it again with taut calibrate")
        return evidence


def collect(model: Model, recordings: Sequence[Recording]) -> Evidence:
    """Collects the evidence for a model's report from the recordings that have a marker or an angle; TautError where
    none has. The evidence has no rows if the tip was never seen within the motor's times, as when the clocks of motor
    and sensor do not agree."""
    clock = SessionClock.of(recordings)
    parts = [
        _collect_one(model, recording, index, clock.offset_s[index])
        for index, recording in enumerate(recordings)
        if recording.marker is not None or recording.angle is not None
    ]
    if not parts:
        raise TautError("no recording has a marker or an angle: there is nothing to report")
    joined = {}
    for field in fields(Evidence):
        if field.name not in ("offset_s", "names"):
            axis = 1 if field.name == "error" else 0
            joined[field.name] = np.concatenate([getattr(part, field.name) for part in parts], axis=axis)
    names = np.array([recording.name for recording in recordings])
    return Evidence(**joined, offset_s=np.array(clock.offset_s), names=names)


def _collect_one(model: Model, recording: Recording, index: int, offset_s: float) -> Evidence:
    """The evidence of one recording: its frames within the motor's times. index: of the recording among all; offset_s:
    added to a time of its clock it gives the common clock's, s."""
    motor, rig = recording.motor, model.rig
    track = observe([recording], rig)[0]
    t_s, seen = track.scene_s(model.delay_of(track.sensor)), track.y
    inside = (t_s >= motor.t_s[0]) & (t_s <= motor.t_s[-1])
    t_s, seen = t_s[inside], seen[inside]
    q = np.interp(t_s, motor.t_s, motor.q)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motor.q)))])
    # Translation and rotation at the frames, 0 where they were not recorded: the pose depends on them.
    others = [
        np.zeros_like(t_s) if column is None else np.interp(t_s, motor.t_s, column)
        for column in (motor.translation_mm, motor.rotation_deg)
    ]
    coarse_deg = rig.coarse.gain * model.q + rig.coarse.offset
    models_by_stage = (  # in the order of STAGES
        replace(model, width=np.zeros_like(model.width), c_deg=coarse_deg),
        replace(model, c_deg=coarse_deg),
        model,
    )
    predictions = [predict(each, motor, t_s) for each in models_by_stage]
    if track.unit == "px":
        predicted = [prediction.image_px for prediction in predictions]
        c_deg = pose(rig, seen, *others)[0]
    else:
        predicted = [prediction.c_deg[:, None] for prediction in predictions]
        c_deg = seen[:, 0]
    return Evidence(
        recording=np.full(len(t_s), index),
        t_s=t_s + offset_s,
        q=q,
        path=np.interp(t_s, motor.t_s, travelled),
        seen=seen,
        c_deg=c_deg,
        error=np.array([seen - each for each in predicted]).reshape(len(STAGES), len(t_s), seen.shape[1]),
        settled=is_settled(model, motor, t_s),
        offset_s=np.array([offset_s]),
        names=np.array([recording.name]),
    )


def is_settled(model: Model, motor: Motor, t_s: Array) -> Array:
    """(n,) bool at scene times t_s (n,): whether the tip's position no longer depends on where within the backlash it
    started, which is unknown, so that errors can be scored. It is simulated from both ends of the backlash; the result
    is true after the last time at which the two angles differ. If the motor ever drove the tip through a full backlash
    in both directions (`settled_from`), the result is false before that too, as the model's B may be too narrow where
    it was not measured."""
    reach = 0.5 * float(model.width.max())  # half of the widest backlash, unit of q
    ends = [model.simulate(motor, t_s, float(model.remaining(motor.q[0] + side * reach))) for side in (-1.0, 1.0)]
    apart = np.abs(ends[0] - ends[1]) > 1e-9  # deg: more than rounding
    latest = t_s[apart].max() if apart.any() else -np.inf
    from_s = settled_from(model, motor)
    return np.asarray((t_s > latest) & ((t_s >= from_s) | np.isinf(from_s)))


@dataclass(frozen=True)
class Run:
    """A run in which the tip followed a trajectory open loop (`taut follow`), kept for the report."""

    t_s: Array  # (n,) board time, s
    goal_deg: Array  # (n,) bending angle as planned
    tip_deg: Array  # (n,) bending angle as it was
    counted: Array  # (n,) bool: whether the error counts

    @property
    def rms_deg(self) -> float:
        """The rms of tip minus goal, deg, over the samples that count; NaN where none does."""
        error = (self.tip_deg - self.goal_deg)[self.counted]
        return float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")

    def save(self, folder: Path, compensation: str) -> None:
        """Writes the run as follow-COMPENSATION.csv into a model's folder, for its report. Times have nine digits, as a
        board's clock may have counted for days."""
        columns = {"t_s": self.t_s, "goal_deg": self.goal_deg, "tip_deg": self.tip_deg, "counted": self.counted}
        table = pd.DataFrame({name: values.astype(float) for name, values in columns.items()})
        write_file(folder / f"follow-{compensation}.csv", table.to_csv(index=False, float_format="%.9g"))

    @classmethod
    def load_all(cls, folder: Path) -> dict[str, Self]:
        """Reads the runs in a model's folder, by compensation (one of COMPENSATIONS); a compensation without a file is
        left out. TautError where a file is damaged."""
        runs = {}
        for compensation in COMPENSATIONS:
            path = folder / f"follow-{compensation}.csv"
            if path.exists():
                names = ("t_s", "goal_deg", "tip_deg", "counted")
                columns = read_columns(path, names, ",".join(names))
                t_s, goal, tip = (columns.finite(name) for name in names[:3])
                runs[compensation] = cls(t_s, goal, tip, columns.flags("counted"))
        return runs
