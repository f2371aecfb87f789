"""The da Vinci tools: calibrated on one run, tracked through the others in order."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tautline.calibration.calibrate import calibrate
from tautline.prediction import predict
from tautline.recording import Recording, load
from tautline.rig import Rig
from tautline.tracking import off_by, replay

FROM_S = 5.0  # the first seconds hold the approach to the start
POSTURES = ("roll", "pitch")


def find() -> Path | None:
    for folder in Path(__file__).resolve().parents:
        recordings = folder / "shared" / "data"
        if (recordings / "davinci").is_dir():
            return recordings
    return None


def sets(data: Path) -> dict[str, tuple[Path, list[Path]]]:
    """Name: rig, and the runs in their order."""
    tool, posture = data / "davinci", data / "davinci-posture"
    recordings = {
        f"load {j}, other rates": (tool / "rig.toml", [tool / f"freq{i}-load{j}" for i in range(5)]) for j in range(4)
    }
    recordings |= {
        f"{0.1 * (i + 1):.1f} Hz, other loads": (tool / "rig.toml", [tool / f"freq{i}-load{j}" for j in range(4)])
        for i in (0, 2, 4)
    }
    recordings |= {
        f"{name}, other postures": (posture / f"rig-{name}.toml", [posture / f"{name}-{i}" for i in range(1, 6)])
        for name in POSTURES
    }
    return {name: value for name, value in recordings.items() if all(path.is_dir() for path in value[1])}


def table(data: Path, names: tuple[str, ...] = ()) -> list[dict[str, Any]]:
    """A row for each set: deg rms from FROM_S on in each run."""
    rows = []
    for name, (rig_file, paths) in sets(data).items():
        if names and name not in names:
            continue
        rig = Rig.load(rig_file)
        rows.append({"set": name, **tracked_through([load(path, rig) for path in paths], rig)})
    return rows


def tracked_through(runs: list[Recording], rig: Rig) -> dict[str, Any]:
    model = calibrate(runs[:1], rig).model
    result = replay(model, runs[1:])
    off = off_by(result, runs[1:])
    tracked, untracked, own = [], [], []
    for i, run in enumerate(runs[1:]):
        assert run.angle is not None
        late = run.angle.seen & (run.angle.t_s >= FROM_S)
        mine = off[result.recording == i]
        away = predict(model, run.motor, run.angle.t_s - model.delay_s).c_deg - run.angle.c_deg
        tracked.append(float(np.sqrt(np.mean(mine[late] ** 2))))
        untracked.append(float(np.sqrt(np.mean(away[late] ** 2))))
        own.append(float(np.std(away[late])))
    return {
        "runs": len(tracked),
        "tracked": float(np.sqrt(np.mean(np.square(tracked)))),
        "worst run": max(tracked),
        "untracked": float(np.sqrt(np.mean(np.square(untracked)))),
        "less its mean in each run": float(np.sqrt(np.mean(np.square(own)))),
        "worst of tracked over untracked": max(a / b for a, b in zip(tracked, untracked, strict=True)),
    }
