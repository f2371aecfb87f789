"""A case as files, laid out as the second family's: its writers, on what this family shows."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from tools.family_three.cases import Case
from tools.family_three.plant import logged, show
from tools.family_two import files as second

FloatArray = NDArray[np.float64]


def write(case: Case, seed: int, out: Path, truths: Path) -> dict[str, object]:
    """Writes out/cases/NAME, out/unseen/NAME and the truth; returns the truth."""
    alike: Any = case  # it has what the second family's writers read
    rng = np.random.default_rng([seed, 304, case.index])
    folder, unseen = out / "cases" / case.name, out / "unseen" / case.name
    for path in (folder, unseen, truths):
        path.mkdir(parents=True, exist_ok=True)
    known = tomli_w.dumps(second.rig(alike, rng))
    for path in (folder, unseen):
        (path / "rig.toml").write_text(known)
    seen = case.plant.view is not None
    names, digits = (("u_px", "v_px"), "%.4f") if seen else (("c_deg",), "%.5f")
    said = logged(case.line, case.causes)
    valid_from = 0.0
    for shown in show(case.plant, case.line, case.causes):
        part = shown.part
        zero = 0.0 if case.one_clock else part.begin
        where = unseen if part.name == "unseen" else folder / part.name
        where.mkdir(exist_ok=True)
        second._motor(alike, said, part.first, part.count, zero, where / "motor.csv")
        arrival = shown.arrival - zero
        noise = second.noise(rng, arrival.size, len(names), case.noise, case.memory, case.heavy)
        kept = rng.random(arrival.size) >= case.dropped
        values = shown.values + noise[shown.pick]
        times: dict[str, tuple[FloatArray, str]] = {"t_s": (arrival[kept], "%.6f")}
        columns = times | {n: (values[kept, i], digits) for i, n in enumerate(names)}
        if part.name == "unseen":
            second.table(where / "times.csv", times)
            second.table(truths / f"{case.name}-unseen.csv", columns)
            inside = slice(part.first, part.first + part.count)
            begins = part.begin + second.driven(case.line.q[inside], 1.5 * widest(case)) - zero
            valid_from = float(arrival[kept][arrival[kept] > begins + 0.2][0])
        else:
            second.table(where / ("marker.csv" if seen else "angle.csv"), columns)
    truth = second.describe(alike, valid_from)
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1, sort_keys=True) + "\n")
    return truth


def widest(case: Case) -> float:
    """The healthy gap where it is widest within the range."""
    m = case.plant.mechanism
    xs = np.linspace(-1, 1, 41) * m.limit
    return float(np.max(m.need(xs, 1.0) - m.need(xs, -1.0)))
