"""Makes a case, calibrates it, predicts the unseen motion, scores, deletes.

The only module of this package that imports the library, and only its command line."""

from __future__ import annotations

import contextlib
import csv
import importlib
import io
import json
import signal
import sys
import tempfile
import time
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from tools.honesty import score
from tools.honesty.conditions import CONDITIONS, build
from tools.honesty.record import Made, make

LIMIT_S = 300  # of one command


class _TooLong(Exception):
    pass


def _stop(signum: int, frame: FrameType | None) -> None:
    raise _TooLong


def warm() -> None:
    """The library's imports take a second: once a worker, not once a run."""
    importlib.import_module("tautline.cli.calibrate")
    importlib.import_module("tautline.cli.predict")


def taut(*words: str | Path) -> tuple[int, str, str]:
    """Exit status, stdout, stderr of the command, in this process."""
    from tautline.cli import main

    out, err = io.StringIO(), io.StringIO()
    kept = sys.argv
    sys.argv = ["taut", *map(str, words)]
    signal.signal(signal.SIGALRM, _stop)
    signal.alarm(LIMIT_S)
    status = 0
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 1
    except _TooLong:
        status = -1
    finally:
        signal.alarm(0)
        sys.argv = kept
    return status, out.getvalue(), err.getvalue()


def run(name: str, seed: int, which: str, keep: Path | None = None) -> dict[str, Any]:
    """One scored case. `keep` is a folder in which the case stays, to be looked at."""
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="honesty-"))) if keep is None else keep
        made = make(build(name, seed), folder)
        if keep is not None:
            plain = {key: x.tolist() if isinstance(x, np.ndarray) else x for key, x in made.truth.items()}
            keep.with_name(f"{keep.name}.truth.json").write_text(json.dumps(plain))
        row = {"name": name, "family": CONDITIONS[name].family, "set": which, "seed": seed}
        return {**row, **_calibrated(made, folder)}


def _calibrated(made: Made, folder: Path) -> dict[str, Any]:
    model = folder / "model"
    start = time.process_time()
    status, out, err = taut("calibrate", *made.recordings, "--rig", made.rig, "--out", model, "--json")
    seconds = time.process_time() - start
    truth = made.truth
    row: dict[str, Any] = {
        **{key: truth[key] for key in ("benign", "must_not_pass", "codes", "unit", "noise")},
        **dict.fromkeys(("z", "error_um", "sigma_um", "percent", "prediction")),
        **dict.fromkeys(("delay_error_ms", "clock_error_ms", "offset_s", "remaining_deg")),
        "clock_off_s": truth["offset_s"],
        "share": 0.0,
        "coarse": _error(truth, "coarse"),
        "constant": score.best_constant(_true(truth)),
        "exit": status,
        "exit_fits": True,
        "seconds": seconds,
        "verdict": "refused",
        "reasons": [],
        "said": err.strip().splitlines()[-1][:300] if status not in (0, 3) and err.strip() else "",
    }
    if status == -1:
        return {**row, "verdict": "timeout"}
    if status not in (0, 3):
        return {**row, "verdict": "crash" if "internal error" in err else "refused"}
    document = json.loads(out)
    quality = document.get("quality") or {"verdict": "good" if status == 0 else "unusable", "reasons": []}
    row |= score.backlash(document["backlash"], truth["q"], truth["width"], truth["um_per_unit"])
    row |= {
        "verdict": quality["verdict"],
        "reasons": [reason["code"] for reason in quality["reasons"]],
        "evidence": {key: value for key, value in document.get("evidence", {}).items() if value is not None},
        "delay_error_ms": 1000.0 * ((document.get("delay_s") or 0.0) - truth["delay_s"]),
        "offset_s": document.get("offset_s"),
        "clock_error_ms": _clock_error(document, truth),
        "exit_fits": (status == 3) == (quality["verdict"] == "unusable"),
        "remaining_deg": _remaining(document, truth),
    }
    return row | _predicted(made, model, folder / "predicted.csv")


def _clock_error(document: dict[str, Any], truth: dict[str, Any]) -> float | None:
    """Of delay and offset together, where the image's clock is off by a constant."""
    if not truth["offset_s"]:
        return None
    offset_s = (document.get("delay_s") or 0.0) + (document.get("offset_s") or 0.0)
    return float(1000.0 * (offset_s - truth["delay_s"] - truth["offset_s"]))


def _remaining(document: dict[str, Any], truth: dict[str, Any]) -> float | None:
    at, c = score.numbers(document["remaining"]["q"]), score.numbers(document["remaining"]["c_deg"])
    low, high = document["backlash"].get("measured") or (np.nan, np.nan)
    error = c - np.interp(at, truth["q"], truth["remaining_deg"], left=np.nan, right=np.nan)
    error = error[(at >= low) & (at <= high) & np.isfinite(error)]
    return score.rms(error) if len(error) else None


def _true(truth: dict[str, Any]) -> Any:
    return (truth["uv"] if "uv" in truth else truth["c_deg"][:, None])[truth["counted"]]


def _error(truth: dict[str, Any], key: str) -> float:
    true = truth[f"{key}_uv"] if "uv" in truth else truth[f"{key}_deg"][:, None]
    return score.image_rms(true[truth["counted"]] - _true(truth))


def _predicted(made: Made, model: Path, path: Path) -> dict[str, Any]:
    status, _, err = taut("predict", model, made.test, "--times", made.times, "--csv", path)
    if status != 0:
        return {"said": err.strip().splitlines()[-1][:300] if err.strip() else f"predict: exit {status}"}
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    names = ("u_px", "v_px") if "uv" in made.truth else ("c_deg",)
    predicted = np.array([[float(row[name] or "nan") for name in names] for row in rows])
    return {"prediction": score.image_rms(predicted[made.truth["counted"]] - _true(made.truth))}
