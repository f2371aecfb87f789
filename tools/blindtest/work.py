"""What a campaign's workers do: each a function from files to files, so that a case can be made, diagnosed and scored
anywhere, and a diagnosis sees nothing but what it was sent."""

from __future__ import annotations

import json
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import diagnose
from tautline.errors import TautError
from tautline.folders import unpacked_folder
from tautline.model import Model
from tautline.plain import plain
from tautline.prediction import foretold
from tautline.recording import Recording, load, save
from tautline.rig import Rig
from tools.blindtest import baselines, scores, sealed
from tools.blindtest.cases import Label, make
from tools.blindtest.generators import GENERATORS, SECOND
from tools.blindtest.scores import FAILED, Answer

Files = Mapping[str, bytes]

DOCUMENT = "diagnosis.json"
EVIDENCE = "evidence.json"  # what the verdict was worked out from: what constants are learnt on
COST = "cost.json"
_VISIBLE = ("calibration", "test-1", "test-2")  # of a case that is made here; other families have up to nine tests


def make_case(
    seed: int, kind: str, effects: tuple[str, ...], salt: str, generator: str = SECOND
) -> tuple[Files, Files]:
    """What may be seen of a case, and what is sealed."""
    case = GENERATORS[generator].make(seed, kind, effects)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        recordings = zip((*_VISIBLE, sealed.FURTHER), (case.calibration, *case.tests, case.further), strict=True)
        for what, recording in recordings:
            save(recording, folder / what)
            (folder / what / "rig.toml").unlink()  # one for all
        case.rig.save(folder / "rig.toml")
        files = sealed.read(folder)
    hidden = {path: content for path, content in files.items() if path.startswith(sealed.FURTHER)}
    visible = {path: content for path, content in files.items() if path not in hidden}
    label = sealed.canonical({"salt": salt, "label": plain(case.label.to_json())})
    return visible, {sealed.LABEL: label, **hidden}


def diagnose_case(files: Files, left_out: Collection[str] = ()) -> Files:
    """What `taut diagnose` says of a case's files: `diagnose_folder` of them."""
    with unpacked_folder(files) as folder:
        return diagnose_folder(folder, left_out)


def diagnose_folder(folder: Path, left_out: Collection[str] = ()) -> Files:
    """What `taut diagnose` says of a folder's case: diagnosis.json, nominal/, corrected/, its evidence and cost."""
    with threadpool_limits(1), tempfile.TemporaryDirectory() as name:
        out = Path(name)
        began = time.process_time()
        try:
            rig, recordings = recordings_of(folder)
            model = calibrate(recordings[:1], rig).model
            calibrated = time.process_time() - began
            diagnosis = diagnose(model, recordings[0], recordings[1:], left_out=left_out)
            diagnosis.nominal.save(out / "nominal")
            diagnosis.corrected.save(out / "corrected")
            document: Any = plain(diagnosis.document)
            results = {**sealed.read(out), EVIDENCE: sealed.canonical(plain(diagnosis.evidence.to_json()))}
        except Exception as error:  # a verdict like any other, and a wrong one: the campaign goes on
            calibrated, document, results = 0.0, {"verdict": FAILED, "error": _told(error)}, {}
        cost = {"core_s": time.process_time() - began, "calibration_core_s": calibrated}
    return {**results, DOCUMENT: sealed.canonical(document), COST: sealed.canonical(cost)}


def score_case(visible: Files, opened: Files, diagnosis: Files) -> dict[str, Any]:
    """What a diagnosis is scored by: label, document, cost, the gap on the further motion (px rms per coordinate). What
    calibration swallowed of an effect, so that its model shows no gap on the tests, is not left in the label either."""
    label = Label.from_json(json.loads(opened[sealed.LABEL])["label"])
    document = json.loads(diagnosis[DOCUMENT])
    cost = json.loads(diagnosis[COST])
    realised = None
    if document["verdict"] != FAILED:
        with unpacked_folder({**visible, **opened, **diagnosis}) as folder:
            nominal = Model.load(folder / "nominal")
            tests = recordings_of(folder)[1][1:]
            gap = float(np.sqrt(np.mean([foretold(nominal, test, nominal) ** 2 for test in tests])))
            visible_px = float(np.sqrt(max(gap**2 - label.noise_px**2, 0.0)))
            label = replace(label, left=tuple(min(left, visible_px) for left in label.left))
            further = load(folder / sealed.FURTHER, nominal.rig)
            try:
                after = foretold(Model.load(folder / "corrected"), further, nominal)
                realised = {"before": foretold(nominal, further, nominal), "after": after, "floor": label.noise_px}
                if not np.isfinite(after):
                    raise TautError("the corrected model predicts no place in the image")
            except Exception as error:  # a corrected model that cannot be used
                document = {"verdict": FAILED, "error": _told(error)}
    return {"label": label.to_json(), "document": document, "realised": realised, **cost}


def learn_case(seed: int, kind: str, effects: tuple[str, ...]) -> dict[str, Any]:
    """Features and right verdict of a case to train on, and what it cost; no features where it cannot be scored."""
    began = time.process_time()
    with threadpool_limits(1):
        case = make(seed, kind, effects)
        recordings = [case.calibration, *case.tests]
        features = None
        if scores.counts(case.label):
            with suppress(Exception):
                evidence = baselines.Comparison(calibrate(recordings[:1], case.rig).model, recordings)
                features = baselines.features(evidence).tolist()
        return {"features": features, "verdict": scores.truth(case.label), "core_s": time.process_time() - began}


def baseline_case(visible: Files, opened: Files, diagnosis: Files, methods: Sequence[str]) -> dict[str, Any]:
    """The answers of baselines by name, `features` for a forest, and `errors` of those that failed. They start from the
    model that the diagnosis started from, and pay for it too."""
    label = Label.from_json(json.loads(opened[sealed.LABEL])["label"])
    calibrated = json.loads(diagnosis[COST])["calibration_core_s"]
    answers: dict[str, Any] = {}
    errors: dict[str, str] = {}

    def failed(method: str, error: Exception) -> Answer:  # a wrong one, like a diagnosis that fails
        errors[method] = _told(error)
        return Answer((), FAILED, 0.0, names=method not in baselines.SHRINKING)

    with threadpool_limits(1), unpacked_folder({**visible, **opened, **diagnosis}) as folder:
        began = time.process_time()
        try:
            rig, recordings = recordings_of(folder)
            further = load(folder / sealed.FURTHER, rig)
            evidence = baselines.Comparison(Model.load(folder / "nominal"), recordings, further)
            answers["features"] = baselines.features(evidence).tolist()
        except Exception as error:
            refused = {method: scores.to_json(replace(failed(method, error), core_s=calibrated)) for method in methods}
            return {**refused, "features": None, "features_core_s": calibrated, "errors": errors}
        common = calibrated + time.process_time() - began
        answers["features_core_s"] = common
        for method in methods:
            began = time.process_time()
            try:
                answer = baselines.ON_CASES[method](evidence)
                if not np.isfinite([answer.claimed or 0.0, *(answer.realised or {}).values()]).all():
                    raise TautError("what it fitted predicts no place in the image")
            except Exception as error:
                answer = failed(method, error)
            spent = time.process_time() - began + (common if answer.names else calibrated)
            realised = None if answer.realised is None else {**answer.realised, "floor": label.noise_px}
            answers[method] = scores.to_json(replace(answer, core_s=spent, realised=realised))
    return {**answers, "errors": errors}


def _told(error: Exception) -> str:
    return str(error) if isinstance(error, TautError) else f"{type(error).__name__}: {error}"


def recordings_of(folder: Path) -> tuple[Rig, list[Recording]]:
    """A case's rig; its calibration and, in order, its tests."""
    rig = Rig.load(folder / "rig.toml")
    return rig, [load(part, rig) for part in (folder / "calibration", *sorted(folder.glob("test-?")))]
