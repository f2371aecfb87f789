"""One case: what a calibration and a diagnosis of the same recordings say of it."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.diagnosis.diagnose import diagnose
from tools.naming.cases import Case, make


def run(generator: str, effect: str, seed: int) -> dict[str, Any]:
    """Plain: what is there, said and known, and how long that took, s of one core."""
    with threadpool_limits(1):
        case = make(generator, effect, seed)
        began = time.process_time()
        alone = calibrate(case.recordings[:1], case.rig)
        calibrated = time.process_time()
        session = calibrate(case.recordings, case.rig)
        again = time.process_time()
        document = diagnose(alone.model, case.recordings[0], case.recordings[1:]).document
        diagnosed = time.process_time()
    return {
        "generator": generator,
        "effect": effect,
        "seed": seed,
        "over_noise": case.left_px / case.noise_px,
        "recalibrated": document["gap_recalibrated"]["before"] / case.noise_px,
        "calibration": _calibrated(case, alone),
        "session": _calibrated(case, session),
        "diagnosis": {
            "verdict": document["verdict"],
            "ids": [effect["id"] for effect in document["effects"]],
            "probability": [effect["probability"] for effect in document["effects"]],
            "moved": [part["id"] for part in document["moved"]],
            "gap": [document["gap"][when] / case.noise_px for when in ("before", "after")],
            "best": [one["id"] for one in document["candidates"][:3]],
        },
        "core_s": [calibrated - began, again - calibrated, diagnosed - again],
    }


def _calibrated(case: Case, calibration: Calibration) -> dict[str, Any]:
    model, truth = calibration.model, case.truth
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    q = model.q[inside]
    width = np.interp(q, truth.q, truth.width)
    z = (model.width[inside] - width) / model.width_sigma[inside]
    return {
        "verdict": model.quality.verdict.value,
        "ids": [reason.code for reason in model.quality.reasons],
        "elements": len(model.elements.width),
        "width_off": float(np.sqrt(np.mean((model.width[inside] - width) ** 2)) / np.median(width)),
        "width_z": float(np.sqrt(np.mean(z**2))),
        "delay_z": float((model.delay_s - truth.delay_s) / max(calibration.delay.sigma_s, 1e-9)),
    }
