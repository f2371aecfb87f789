"""A source as named series over time and curves over q: what a log viewer shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.io.exporting.source import MODEL, Source
from tautline.model import Model
from tautline.model import play_at as play
from tautline.prediction import Prediction, predict
from tautline.recording import Angle, Marker, Recording, Video
from tautline.reports.evidence import STAGES, Evidence
from tautline.rig import ANGLE, MARKER
from tautline.simulators.source import path_of

Array = npt.NDArray[np.float64]

_QUALITY = 90  # loss: of the frames' JPEG: next to no loss, a fifth of PNG's size


@dataclass(frozen=True)
class Series:
    """Columns over time. Each has a row for each time, NaN where it has nothing; its unit stands in its name."""

    name: str  # such as "motor" or "prediction/nominal": parts are folders, or levels of a tree
    says: str  # what it is, in words
    t_s: Array  # (n,) rising or level
    columns: dict[str, Array]  # (n,) each


@dataclass(frozen=True)
class Curve:
    """Columns over q."""

    name: str  # as of Series
    says: str
    columns: dict[str, Array]  # (n,) each, q first; the unit stands in the name


@dataclass(frozen=True)
class Log:
    """All that a source has to show."""

    series: tuple[Series, ...]
    curves: tuple[Curve, ...]
    facts: dict[str, Any]  # as JSON has them: name, units, verdicts
    video: Video | None = None

    def last_s(self, default: float) -> float:
        """The latest time of any series, s; `default` where all are empty."""
        return max((float(series.t_s[-1]) for series in self.series if len(series.t_s)), default=default)

    @property
    def first_frame_s(self) -> float:
        """Arrival time of the video's first frame, s; 0 where its frames have only the container's times, infinity
        without a video or a frame with a time."""
        if self.video is None:
            return np.inf
        if self.video.arrival_s is None:
            return 0.0  # as containers count
        return float(np.min(self.video.arrival_s, initial=np.inf, where=np.isfinite(self.video.arrival_s)))

    def frames(self) -> Iterator[tuple[float, bytes]]:
        """Yields the arrival time, s, and the JPEG of each frame of the video that has a time; nothing without a video.
        Without a list of arrival times they are the container's."""
        if self.video is None:
            return
        import cv2

        from tautline.vision.camera import VideoCamera

        arrival = self.video.arrival_s
        with VideoCamera(self.video.path) as camera:
            k = 0
            while (read := camera.read()) is not None:
                picture, container_s = read
                listed_s = float(arrival[k]) if arrival is not None and k < len(arrival) else np.nan
                t_s = container_s if arrival is None else listed_s
                k += 1
                if np.isfinite(t_s):
                    yield t_s, cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def of_source(source: Source) -> Log:
    """The log of a source: a recording's series and its models' predictions; a model's evidence; B and f_remain of all
    models; a diagnosis' document among the facts. TautError where this gives neither a series nor a curve."""
    unit = source.rig.actuator.unit
    facts: dict[str, Any] = {"name": source.name, "is": source.kind, "unit_of_q": unit, "seconds": "arrival times"}
    series: list[Series] = []
    if source.recording is not None:
        series += _recorded_series(source.recording, unit)
        for name, model in source.models:
            series += _predicted_series(source.recording, name, model, unit)
    if source.evidence is not None:
        series += _evidence_series(source.evidence, unit)
    curves: list[Curve] = []
    for name, model in source.models:
        curves += _model_curves(name, model, unit)
        facts[name] = {
            "delay_s": model.delay_s,
            "measured": list(model.measured),
            "verdict": model.quality.verdict.value,
            "effects": [{"id": effect.id, **effect.parameters} for effect in model.effects],
        }
    if source.models:
        onsets = _onset_series(source, unit)
        series += [onsets] if onsets else []
    if source.document is not None:
        facts["diagnosis"] = source.document
    if not series and not curves:
        raise TautError(f"{source.name}: there is nothing in it to export")
    return Log(tuple(series), tuple(curves), facts, source.recording.video if source.recording else None)


def _recorded_series(recording: Recording, unit: str) -> list[Series]:
    """Series of what was recorded: the motor, and the marker or the angle. unit: of q."""
    motor = recording.motor
    columns = {f"q_{unit}": motor.q}
    for name, values in (
        (f"q_cmd_{unit}", motor.q_cmd),
        ("translation_mm", motor.translation_mm),
        ("rotation_deg", motor.rotation_deg),
        ("load_mNm", motor.load_mNm),
    ):
        if values is not None:
            columns[name] = values
    found = [Series("motor", "the motor's encoder", motor.t_s, {**columns, **motor.joints})]
    if (marker := recording.marker) is not None:
        columns = {"u_px": marker.u_px, "v_px": marker.v_px, "valid": marker.valid.astype(float)}
        found.append(Series("marker", "where the marker was seen, at the frame's arrival", marker.t_s, columns))
    if (angle := recording.angle) is not None:
        found.append(Series("angle", "what the angle sensor said, at its arrival", angle.t_s, {"c_deg": angle.c_deg}))
    return found


def _predicted_series(recording: Recording, name: str, model: Model, unit: str) -> list[Series]:
    """Series of a model's prediction for a recording, and, where that has a marker or an angle, of the residual of each
    of STAGES. Their times are the sensor's arrival times; without a sensor those at which the motor's times would
    arrive, the model's delay later. name: the model's; unit: of q."""
    marker, angle, motor = recording.marker, recording.angle, recording.motor
    by_marker = marker is not None and (model.rig.has_camera or angle is None)
    rows = marker if by_marker else angle
    sensor = MARKER if by_marker or (rows is None and model.rig.has_camera) else ANGLE
    t_s = motor.t_s + model.delay_of(sensor) if rows is None else rows.t_s
    scene = t_s - model.delay_of(sensor)
    prediction = predict(model, motor, scene)
    lines = path_of(model, motor).lines
    columns = {
        f"q_{unit}": np.interp(scene, motor.t_s, motor.q),
        f"p_{unit}": play(lines.t_s, lines.q, scene, model.play, np.nan),
        "c_deg": prediction.c_deg,
    }
    if prediction.image_px is not None:
        columns |= {"u_px": prediction.image_px[:, 0], "v_px": prediction.image_px[:, 1]}
    says = f"what the {name} says of the scene that arrived then; p is the play's centre, effects apart"
    found = [Series(f"prediction/{name}", says, t_s, columns)]
    if rows is None:
        return found
    for stage, staged in _stages(model):
        residual = _residual(rows, prediction if stage == STAGES[-1] else predict(staged, motor, scene))
        if not residual:
            continue
        label = stage if stage != STAGES[-1] or not model.effects else f"{stage} + effects"
        says = f"seen less what the {name} says by {label}"
        found.append(Series(f"residual/{name}/{_stage_as_name(label)}", says, t_s, residual))
    return found


def _residual(seen: Marker | Angle, predicted: Prediction) -> dict[str, Array]:
    """What a sensor saw less what was predicted at the same times, as columns by name, px or deg; {} for a marker where
    the prediction has no image positions."""
    if isinstance(seen, Angle):
        return {"c_deg": seen.c_deg - predicted.c_deg}
    if predicted.image_px is None:
        return {}
    return {"u_px": seen.u_px - predicted.image_px[:, 0], "v_px": seen.v_px - predicted.image_px[:, 1]}


def _stages(model: Model) -> list[tuple[str, Model]]:
    """(name, model) for each of STAGES: f_coarse without B, f_coarse with B (both without effects), and the whole
    model."""
    coarse = model.rig.coarse.gain * model.q + model.rig.coarse.offset
    bare = replace(model, c_deg=coarse, effects=())
    return list(zip(STAGES, (replace(bare, width=np.zeros_like(model.width)), bare, model), strict=True))


def _stage_as_name(stage: str) -> str:
    """A stage's name as a part of a series' name: "f_coarse + B" becomes "f_coarse_and_B"."""
    return stage.replace(" + ", "_and_").replace(" ", "_")


def _evidence_series(evidence: Evidence, unit: str) -> list[Series]:
    """Series of the frames that a model was calibrated from, in the order of scene times, and of the residual of each
    of STAGES. unit: of q."""
    seen = ("u_px", "v_px") if evidence.unit == "px" else ("c_deg",)
    order = np.argsort(evidence.t_s, kind="stable")
    t_s = evidence.t_s[order]
    columns = {f"q_{unit}": evidence.q, **dict(zip(seen, evidence.seen.T, strict=True))}
    columns["c_deg"] = evidence.c_deg
    columns["recording"] = evidence.recording.astype(float)
    columns["settled"] = evidence.settled.astype(float)
    found = [
        Series("frames", "what was seen while it was calibrated, scene times", t_s, _rows_in_order(order, columns))
    ]
    for stage, error in zip(STAGES, evidence.error, strict=True):
        left = _rows_in_order(order, dict(zip(seen, error.T, strict=True)))
        found.append(Series(f"residual/model/{_stage_as_name(stage)}", f"seen less what {stage} says", t_s, left))
    return found


def _rows_in_order(order: npt.NDArray[np.int64], columns: dict[str, Array]) -> dict[str, Array]:
    """The columns with their rows in this order (indices), as floats."""
    return {name: np.asarray(values, dtype=float)[order] for name, values in columns.items()}


def _onset_series(source: Source, unit: str) -> Series | None:
    """A series of the onsets that the calibration of a source's first model found; None without any. Their times are on
    their own recordings' clocks, so a source that is no model gets only those of its own recording. unit: of q."""
    model = source.models[0][1]
    listed = [onset for onset in model.extra.get("onsets", []) if onset.get("t_s") is not None]
    if source.kind != MODEL:
        listed = [onset for onset in listed if onset.get("recording") == source.name]
    if not listed:
        return None
    listed.sort(key=lambda onset: float(onset["t_s"]))
    names = {"direction": "direction", "q1": f"q1_{unit}", "q2": f"q2_{unit}", "width": f"width_{unit}"}
    names |= {"sigma": f"sigma_{unit}", "used": "used"}
    columns = {
        to: np.array([np.nan if onset.get(name) is None else float(onset[name]) for onset in listed])
        for name, to in names.items()
    }
    t_s = np.array([float(onset["t_s"]) for onset in listed])
    return Series("onsets", "where the image began to move after a reversal, scene times", t_s, columns)


def _model_curves(name: str, model: Model, unit: str) -> list[Curve]:
    """The two curves of a model: B and f_remain over q, each with its sigma, NaN where that is not known. name: the
    model's; unit: of q."""
    sigma = np.full_like(model.q, np.nan) if model.c_sigma is None else model.c_sigma
    q = {f"q_{unit}": model.q}
    return [
        Curve(
            f"backlash/{name}",
            "B(q), the backlash's width, and its standard deviation",
            {**q, f"width_{unit}": model.width, f"sigma_{unit}": model.width_sigma},
        ),
        Curve(
            f"f_remain/{name}",
            "c = f_remain(q), and its standard deviation",
            q | {"c_deg": model.c_deg, "sigma_deg": sigma},
        ),
    ]
