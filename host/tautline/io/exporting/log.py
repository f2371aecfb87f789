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
from tautline.prediction import predict
from tautline.recording import Recording, Video
from tautline.reports.evidence import STAGES, Evidence
from tautline.rig import ANGLE, MARKER
from tautline.simulators.source import path_of

Array = npt.NDArray[np.float64]

_QUALITY = 90  # loss: of the frames' JPEG: next to no loss, a fifth of PNG's size


@dataclass(frozen=True)
class Series:
    """One topic. Each column has a row for each time; NaN where it has nothing. Its unit stands in its name."""

    name: str  # "motor", "prediction/nominal": parts are folders, or levels of a tree
    says: str
    t_s: Array  # (n,) rising or level
    columns: dict[str, Array]  # (n,) each


@dataclass(frozen=True)
class Curve:
    """Columns over q, the first one."""

    name: str
    says: str
    columns: dict[str, Array]


@dataclass(frozen=True)
class Log:
    series: tuple[Series, ...]
    curves: tuple[Curve, ...]
    facts: dict[str, Any]  # as JSON has them: name, units, verdicts
    video: Video | None = None

    @property
    def first_frame_s(self) -> float:
        """When the video's first frame arrived; infinity where there is none."""
        if self.video is None:
            return np.inf
        if self.video.arrival_s is None:
            return 0.0  # as containers count
        return float(np.min(self.video.arrival_s, initial=np.inf, where=np.isfinite(self.video.arrival_s)))

    def frames(self) -> Iterator[tuple[float, bytes]]:
        """Arrival time, s, and JPEG of each frame that has a time."""
        if self.video is None:
            return
        import cv2

        from tautline.vision.camera import VideoCamera

        arrival = self.video.arrival_s
        with VideoCamera(self.video.path) as camera:
            k = 0
            while (read := camera.read()) is not None:
                picture, own_s = read
                t_s = own_s if arrival is None else float(arrival[k]) if k < len(arrival) else np.nan
                k += 1
                if np.isfinite(t_s):
                    yield t_s, cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()


def of_source(source: Source) -> Log:
    """Everything that a source has to show, as series and curves. TautError where there is nothing."""
    unit = source.rig.actuator.unit
    facts: dict[str, Any] = {"name": source.name, "is": source.kind, "unit_of_q": unit, "seconds": "arrival times"}
    series: list[Series] = []
    if source.recording is not None:
        series += _recorded(source.recording, unit)
        for name, model in source.models:
            series += _foretold(source.recording, name, model, unit)
    if source.evidence is not None:
        series += _evidence(source.evidence, unit)
    curves: list[Curve] = []
    for name, model in source.models:
        curves += _curves(name, model, unit)
        facts[name] = {
            "delay_s": model.delay_s,
            "measured": list(model.measured),
            "verdict": model.quality.verdict.value,
            "effects": [{"id": effect.id, **effect.parameters} for effect in model.effects],
        }
    if source.models:
        onsets = _onsets(source, unit)
        series += [onsets] if onsets else []
    if source.document is not None:
        facts["diagnosis"] = source.document
    if not series and not curves:
        raise TautError(f"{source.name}: there is nothing in it to export")
    return Log(tuple(series), tuple(curves), facts, source.recording.video if source.recording else None)


def _recorded(recording: Recording, unit: str) -> list[Series]:
    """Series of what was recorded: motor, marker, angle. unit: of q."""
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


def _foretold(recording: Recording, name: str, model: Model, unit: str) -> list[Series]:
    """Series of a model's prediction at the sensor's arrival times, or at the motor's where there is no sensor, and of
    its residual at each of STAGES. name: the model's; unit: of q."""
    marker, angle, motor = recording.marker, recording.angle, recording.motor
    by_marker = marker is not None and (model.rig.has_camera or angle is None)
    rows = marker if by_marker else angle
    sensor = MARKER if by_marker or (rows is None and model.rig.has_camera) else ANGLE
    t_s = motor.t_s + model.delay_of(sensor) if rows is None else rows.t_s
    scene = t_s - model.delay_of(sensor)
    told = predict(model, motor, scene)
    lines = path_of(model, motor).lines
    columns = {
        f"q_{unit}": np.interp(scene, motor.t_s, motor.q),
        f"p_{unit}": play(lines.t_s, lines.q, scene, model.play, np.nan),
        "c_deg": told.c_deg,
    }
    if told.image_px is not None:
        columns |= {"u_px": told.image_px[:, 0], "v_px": told.image_px[:, 1]}
    says = f"what the {name} says of the scene that arrived then; p is the play's centre, effects apart"
    found = [Series(f"prediction/{name}", says, t_s, columns)]
    if rows is None:
        return found
    for stage, staged in _stages(model):
        off = told if stage == STAGES[-1] else predict(staged, motor, scene)
        if by_marker and marker is not None and off.image_px is not None:
            left = {"u_px": marker.u_px - off.image_px[:, 0], "v_px": marker.v_px - off.image_px[:, 1]}
        elif angle is not None and not by_marker:
            left = {"c_deg": angle.c_deg - off.c_deg}
        else:
            continue
        label = stage if stage != STAGES[-1] or not model.effects else f"{stage} + effects"
        says = f"seen less what the {name} says by {label}"
        found.append(Series(f"residual/{name}/{_word(label)}", says, t_s, left))
    return found


def _stages(model: Model) -> list[tuple[str, Model]]:
    """The model as each of STAGES has it: f_coarse without B, f_coarse with B, both without effects; and whole."""
    coarse = model.rig.coarse.gain * model.q + model.rig.coarse.offset
    bare = replace(model, c_deg=coarse, effects=())
    return list(zip(STAGES, (replace(bare, width=np.zeros_like(model.width)), bare, model), strict=True))


def _word(stage: str) -> str:
    """A stage's name as a part of a series' name: f_coarse_and_B."""
    return stage.replace(" + ", "_and_").replace(" ", "_")


def _evidence(evidence: Evidence, unit: str) -> list[Series]:
    """Series of the frames that a model was made from, in the order of scene times, and of the residual at each of
    STAGES. unit: of q."""
    seen = ("u_px", "v_px") if evidence.unit == "px" else ("c_deg",)
    order = np.argsort(evidence.t_s, kind="stable")
    t_s = evidence.t_s[order]
    columns = {f"q_{unit}": evidence.q, **dict(zip(seen, evidence.seen.T, strict=True))}
    columns["c_deg"] = evidence.c_deg
    columns["recording"] = evidence.recording.astype(float)
    columns["settled"] = evidence.settled.astype(float)
    found = [Series("frames", "what was seen while it was calibrated, scene times", t_s, _in(order, columns))]
    for stage, error in zip(STAGES, evidence.error, strict=True):
        left = _in(order, dict(zip(seen, error.T, strict=True)))
        found.append(Series(f"residual/model/{_word(stage)}", f"seen less what {stage} says", t_s, left))
    return found


def _in(order: npt.NDArray[np.int64], columns: dict[str, Array]) -> dict[str, Array]:
    """The columns' rows in this order, as floats."""
    return {name: np.asarray(values, dtype=float)[order] for name, values in columns.items()}


def _onsets(source: Source, unit: str) -> Series | None:
    """Series of the reversals that a calibration used. Their times are of their own recordings' clocks: they go with
    the model, and with a recording only if it is the one named in them."""
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


def _curves(name: str, model: Model, unit: str) -> list[Curve]:
    """B and f_remain over q, with their sigmas."""
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
