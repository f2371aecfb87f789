"""What the model that a calibration hands out is worth on a motion that it has not seen, with and without the effect
that was there from the first recording on."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.prediction import foretold
from tools.naming.cases import Case, make

WITHOUT, WITH = "without", "with"
Row = Mapping[str, Any]


def run(generator: str, effect: str, seed: int) -> dict[str, Any]:
    """Plain: what a calibration on two recordings errs by, without a name and with one; the third is foretold.
    Whether both are the same in every digit, and how long each took, s of one core."""
    with threadpool_limits(1):
        case = make(generator, effect, seed)
        began = time.process_time()
        alone = calibrate(case.recordings[:2], case.rig, naming=False)
        calibrated = time.process_time()
        carries = calibrate(case.recordings[:2], case.rig)
        again = time.process_time()
    return {
        "generator": generator,
        "effect": effect,
        "seed": seed,
        WITHOUT: _errs(case, alone),
        WITH: _errs(case, carries),
        "same": alone == carries,
        "core_s": [calibrated - began, again - calibrated],
    }


def _errs(case: Case, calibration: Calibration) -> dict[str, Any]:
    model, truth = calibration.model, case.truth
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    width = np.interp(model.q[inside], truth.q, truth.width)
    off, sigma = model.width[inside] - width, model.width_sigma[inside]
    late, known = model.delay_s - truth.delay_s, max(calibration.delay.sigma_s, 1e-9)
    return {
        "verdict": model.quality.verdict.value,
        "ids": [reason.code for reason in model.quality.reasons],
        "carries": [effect.id for effect in model.effects],
        "foretold": foretold(model, case.recordings[2], settled_by=truth) / case.noise_px,
        "width_off": float(np.sqrt(np.mean(off**2)) / np.median(width)),
        "width_z": float(np.sqrt(np.mean((off / sigma) ** 2))),
        "delay_off_s": late,
        "delay_z": late / known,
    }


def table(rows: Sequence[Row]) -> str:
    """Case by case, as markdown: a third recording in times the noise, B's error and z, the delay's, the verdict; each
    without the effect and with it."""
    head = "| effect | generator | seed | carries | foretold | B off, % | B z | delay off, ms | delay z | verdict |"
    lines = [head, "| --- " * 10 + "|"]
    for row in sorted(rows, key=lambda row: (row["effect"], row["generator"], row["seed"])):
        old, new = row[WITHOUT], row[WITH]

        def both(name: str, digits: int, times: float = 1.0, old: Row = old, new: Row = new) -> str:
            return f"{times * old[name]:.{digits}f} -> {times * new[name]:.{digits}f}"

        cells = [
            *(row["effect"] or "nothing", row["generator"], row["seed"]),
            "the same in every digit" if row["same"] else ", ".join(new["carries"]) or "nothing",
            *(both("foretold", 2), both("width_off", 2, 100.0), both("width_z", 2)),
            *(both("delay_off_s", 2, 1e3), both("delay_z", 2), f"{old['verdict']} -> {new['verdict']}"),
        ]
        lines.append(f"| {' | '.join(str(cell) for cell in cells)} |")
    return "\n".join(lines)
