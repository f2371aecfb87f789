"""A case as files, laid out as the second family's: its writers, on what this family shows."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from tools.family_four.cases import Case
from tools.family_four.plant import Shown, logged, show
from tools.family_three.files import widest
from tools.family_two import files as second

Columns = dict[str, tuple[Any, str]]


def write(case: Case, seed: int, out: Path, truths: Path) -> dict[str, object]:
    """Writes out/cases/NAME, out/unseen/NAME and the truth; returns the truth."""
    alike: Any = case  # it has what the other families' writers read
    rng = np.random.default_rng([seed, 404, case.index])
    folder, unseen = out / "cases" / case.name, out / "unseen" / case.name
    truths.mkdir(parents=True, exist_ok=True)
    rig = tomli_w.dumps(second.rig(alike, rng))
    for path in (folder, unseen):
        path.mkdir(parents=True, exist_ok=True)
        (path / "rig.toml").write_text(rig)
    said, valid_from = logged(case.line, case.causes), 0.0
    for shown in show(case.plant, case.line, case.causes):
        part, zero = shown.part, 0.0 if case.one_clock else shown.part.begin
        where = unseen if part.name == "unseen" else folder / part.name
        where.mkdir(exist_ok=True)
        second._motor(alike, said, part.first, part.count, zero, where / "motor.csv")
        columns = _sensed(case, shown, zero, rng)
        if part.name != "unseen":
            second.table(where / ("angle.csv" if case.plant.view is None else "marker.csv"), columns)
            continue
        second.table(where / "times.csv", {"t_s": columns["t_s"]})
        second.table(truths / f"{case.name}-unseen.csv", columns)
        moved = second.driven(case.line.q[part.first : part.first + part.count], 1.5 * widest(alike))
        arrival = columns["t_s"][0]
        valid_from = float(arrival[arrival > part.begin + moved - zero + 0.2][0])
    truth = second.describe(alike, valid_from)
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1, sort_keys=True) + "\n")
    return truth


def _sensed(case: Case, shown: Shown, zero: float, rng: np.random.Generator) -> Columns:
    """What arrives: stamps and values with noise, without the frames that are lost."""
    names, digits = (("c_deg",), "%.5f") if case.plant.view is None else (("u_px", "v_px"), "%.4f")
    noise = second.noise(rng, shown.arrival.size, len(names), case.noise, case.memory, case.heavy)
    kept = rng.random(shown.arrival.size) >= case.dropped
    values = (shown.values + noise[shown.pick])[kept]
    times: Columns = {"t_s": (shown.arrival[kept] - zero, "%.6f")}
    return times | {name: (values[:, i], digits) for i, name in enumerate(names)}
