"""What a report shows of the recordings behind a model: every frame beside what three models say of it."""

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
    """What a report is drawn from: one row per frame (or sensor sample) in which the tip was seen, n in all recordings
    in turn, beside what three models say of it."""

    recording: Array  # (n,) int: which one
    t_s: Array  # (n,) scene times on the recordings' common clock
    q: Array  # (n,) motor position at that time, the rig's unit
    path: Array  # (n,) how far the motor had travelled by then, the rig's unit, rising
    seen: Array  # (n, d) px (d = 2) with a camera, else deg (d = 1)
    c_deg: Array  # (n,) from the pose of each frame alone, or from the sensor
    error: Array  # (3, n, d) seen minus what each of STAGES says
    settled: Array  # (n,) bool: the tip had been driven through a full backlash both ways
    offset_s: Array  # (recordings,) from each recording's clock to the common one
    names: Array  # (recordings,) str

    @property
    def unit(self) -> str:
        """The unit of `seen` and `error`."""
        return "px" if self.seen.shape[1] == 2 else "deg"

    def index(self, name: str) -> int:
        """The index of the recording with this name; 0 where none has it."""
        return int(np.argmax(self.names == name))

    def rms(self) -> list[float]:
        """Rms of `error` per coordinate for each of STAGES, over the `settled` rows; NaN where there are none."""
        error = self.error[:, self.settled]
        if error.shape[1] == 0:
            return [float("nan")] * len(STAGES)
        return [float(np.sqrt(np.nanmean(stage**2))) for stage in error]

    def save(self, folder: Path) -> None:
        """Writes evidence.npz into a model's folder."""
        np.savez_compressed(folder / FILE, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, folder: Path) -> Self | None:
        """Reads evidence.npz from a model's folder; None where there is none. TautError where it is damaged."""
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
    """Collects the evidence for a model's report from the recordings that have a marker or an angle. It has no row
    where the tip was never seen within the motor's times, as when their clocks do not agree. TautError where no
    recording has either."""
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
    from its clock to the common one, s."""
    motor, rig = recording.motor, model.rig
    track = observe([recording], rig)[0]
    t_s, seen = track.scene_s(model.delay_of(track.sensor)), track.y
    inside = (t_s >= motor.t_s[0]) & (t_s <= motor.t_s[-1])
    t_s, seen = t_s[inside], seen[inside]
    q = np.interp(t_s, motor.t_s, motor.q)
    travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(motor.q)))])
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
        settled=settled(model, motor, t_s),
        offset_s=np.array([offset_s]),
        names=np.array([recording.name]),
    )


def settled(model: Model, motor: Motor, t_s: Array) -> Array:
    """(n,) bool at scene times t_s (n,): whether the tip's place no longer depends on where within the backlash it
    began, which is not known; before that nothing can be scored. Two tips that begin at either end of the backlash are
    simulated: true once they stay together. If the motor ever drove the tip through the backlash both ways it is not
    true before that, as B may be narrower where nothing was measured."""
    reach = 0.5 * float(model.width.max())
    ends = [model.simulate(motor, t_s, float(model.remaining(motor.q[0] + side * reach))) for side in (-1.0, 1.0)]
    apart = np.abs(ends[0] - ends[1]) > 1e-9  # deg: more than rounding
    latest = t_s[apart].max() if apart.any() else -np.inf
    from_s = settled_from(model, motor)
    return np.asarray((t_s > latest) & ((t_s >= from_s) | np.isinf(from_s)))


@dataclass(frozen=True)
class Run:
    """A trajectory of the tip that was followed open loop (`taut follow`), kept for the report."""

    t_s: Array  # (n,) board time
    goal_deg: Array  # (n,) as planned
    tip_deg: Array  # (n,) as it was
    counted: Array  # (n,) bool: where it is scored

    @property
    def rms_deg(self) -> float:
        """Rms of the tip less its goal where it is scored, deg; NaN where it never is."""
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
        """Reads the runs in a model's folder, by compensation (of COMPENSATIONS); those that are not there are left
        out."""
        runs = {}
        for compensation in COMPENSATIONS:
            path = folder / f"follow-{compensation}.csv"
            if path.exists():
                names = ("t_s", "goal_deg", "tip_deg", "counted")
                columns = read_columns(path, names, ",".join(names))
                t_s, goal, tip = (columns.finite(name) for name in names[:3])
                runs[compensation] = cls(t_s, goal, tip, columns.flags("counted"))
        return runs
