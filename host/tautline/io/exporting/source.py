"""What is exported: a recording, a model or a diagnosis, read by the package's own loaders."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tautline.errors import TautError
from tautline.model import MODEL_FILE, Model
from tautline.recording import Recording
from tautline.recording import load as load_recording
from tautline.reports.evidence import Evidence
from tautline.rig import Rig

if TYPE_CHECKING:
    from tautline.diagnosis.diagnose import Diagnosis

RECORDING, MODEL, DIAGNOSIS = "a recording", "a model", "a diagnosis"
DIAGNOSIS_FILE, MOTOR_FILE = "diagnosis.json", "motor.csv"
NOMINAL, CORRECTED = "nominal", "corrected"


@dataclass(frozen=True)
class Source:
    """What is exported."""

    kind: str  # RECORDING, MODEL or DIAGNOSIS
    name: str
    rig: Rig
    recording: Recording | None = None
    models: tuple[tuple[str, Model], ...] = ()  # with names: "model", or "nominal" and "corrected" of a diagnosis
    evidence: Evidence | None = None  # of a model: the frames that it was made from
    document: dict[str, Any] | None = None  # diagnosis.json

    @property
    def model(self) -> Model:
        """The model that a format exports if it takes one: of a diagnosis the corrected one. The source needs to have a
        model."""
        return self.models[-1][1]


def read(path: Path, rig: Rig | None = None, beside: Path | None = None) -> Source:
    """Reads the recording, model or diagnosis in a folder as a source, by what files the folder holds. For a recording
    alone: `rig` is taken instead of its own, `beside` is the folder of a model or a diagnosis whose predictions are
    exported with it. TautError where the folder is none of the three, or `rig` or `beside` go with another than a
    recording."""
    if not path.exists():
        raise TautError(f"{path}: there is no such folder: name a recording, a model or a diagnosis")
    if not path.is_dir():
        raise TautError(f"{path}: is a file: name the folder of a recording, a model or a diagnosis")
    if (path / MOTOR_FILE).exists():
        return of_recording(load_recording(path, rig), rig, read(beside) if beside else None)
    for option, given in (("--model", beside), ("--rig", rig)):
        if given is not None:
            raise TautError(f"{path}: is no recording (it has no {MOTOR_FILE}): {option} goes with a recording only")
    if (path / DIAGNOSIS_FILE).exists():
        return _read_diagnosis(path)
    if (path / MODEL_FILE).exists():
        return of_model(Model.load(path), path.resolve().name, Evidence.load(path))
    raise TautError(
        f"{path}: holds no {MOTOR_FILE} (a recording), {MODEL_FILE} (a model) or {DIAGNOSIS_FILE} (a diagnosis)"
    )


def of(what: Recording | Model | Diagnosis, beside: Model | None = None) -> Source:
    """The source for an object in memory. beside: for a recording, the model whose predictions are exported with it;
    unused for others."""
    if isinstance(what, Recording):
        return of_recording(what, None, of_model(beside) if beside is not None else None)
    if isinstance(what, Model):
        return of_model(what)
    return of_diagnosis(what.nominal, what.corrected, what.document)


def of_recording(recording: Recording, rig: Rig | None = None, beside: Source | None = None) -> Source:
    """A recording as a source, with the models of `beside`, if any, whose predictions are exported with it. rig: None
    takes the recording's, or else that of `beside`. TautError where there is no rig, their units of q differ, or
    `beside` has no model."""
    if beside is not None and not beside.models:
        raise TautError("what goes with a recording is a model or a diagnosis, not another recording")
    used = rig or recording.rig or (beside.rig if beside else None)
    if used is None:
        raise TautError(f"{recording.name}: no rig.toml is in it: name one with --rig")
    if beside is not None and beside.rig.actuator.unit != used.actuator.unit:
        raise TautError(
            f"{recording.name}: its motor is in {used.actuator.unit}, the model's in {beside.rig.actuator.unit}: "
            "they are not of one rig"
        )
    document = beside.document if beside else None
    recording = replace(recording, rig=used)
    return Source(RECORDING, recording.name, used, recording, beside.models if beside else (), document=document)


def of_model(model: Model, name: str = "model", evidence: Evidence | None = None) -> Source:
    """A model as a source, with the evidence that it was calibrated from, if there is any."""
    return Source(MODEL, name, model.rig, models=(("model", model),), evidence=evidence)


def of_diagnosis(nominal: Model, corrected: Model, document: dict[str, Any], name: str = "diagnosis") -> Source:
    """A diagnosis as a source: its two models and diagnosis.json's document."""
    return Source(
        DIAGNOSIS, name, corrected.rig, models=((NOMINAL, nominal), (CORRECTED, corrected)), document=document
    )


def _read_diagnosis(path: Path) -> Source:
    """Reads a diagnosis' folder as a source: both models and diagnosis.json. TautError where that file is damaged or of
    another format."""
    file = path / DIAGNOSIS_FILE
    try:
        document = json.loads(file.read_text(encoding="utf-8"))
        if not isinstance(document, dict) or document.get("format") != "diagnosis/1":
            raise ValueError
    except ValueError as error:  # of JSON and of text
        raise TautError(f"{file}: is damaged or of another format: make it again with taut diagnose") from error
    return of_diagnosis(Model.load(path / NOMINAL), Model.load(path / CORRECTED), document, path.resolve().name)
