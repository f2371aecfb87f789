"""A case as files: recordings in the fixed formats, the unseen motion without what was seen, and the truth apart."""

import json
from pathlib import Path

import numpy as np
import tomli_w
from numpy.typing import NDArray
from scipy.signal import lfilter

from tools.family_two import motion, ranges
from tools.family_two.cases import Case, strength
from tools.family_two.plant import logged, show

FloatArray = NDArray[np.float64]
FORMAT = "family/1"  # what tools.family.score reads


def noise(rng: np.random.Generator, count: int, channels: int, std: float, memory: float, heavy: bool) -> FloatArray:
    """First-order noise of standard deviation `std`; heavy tails are Student's."""
    tail = ranges.TAIL
    fresh = (
        rng.standard_t(tail, (count, channels)) * np.sqrt((tail - 2) / tail)
        if heavy
        else rng.normal(size=(count, channels))
    )
    fresh[1:] *= np.sqrt(1 - memory**2)
    return np.asarray(std * lfilter([1.0], [1.0, -memory], fresh, axis=0))


def table(path: Path, columns: dict[str, tuple[FloatArray, str]]) -> None:
    """CSV with one header line; each column with its format."""
    line = ",".join(f for _, f in columns.values()) + "\n"
    rows = zip(*(v.tolist() for v, _ in columns.values()), strict=True)
    path.write_text(",".join(columns) + "\n" + "".join([line % row for row in rows]))


def rig(case: Case, rng: np.random.Generator) -> dict[str, object]:
    plant, m = case.plant, case.plant.mechanism
    reach = float(f"{m.reach:.5g}")
    out: dict[str, object] = {
        "format": "rig/1",
        "actuator": {"unit": m.unit, "range": [-reach, reach], "encoder_resolution": case.resolution},
        "coarse": {"gain": float(f"{case.line.gain * float(rng.uniform(0.92, 1.1)):.4g}"), "offset": 0.0},
    }
    v = plant.view
    if v is None:
        return out | {"angle": {"delay_s": plant.delay}}
    return out | {
        "kinematics": {"bending_length_mm": v.bending_mm, "tip_length_mm": v.tip_mm},
        "camera": {
            "width_px": v.width_px, "height_px": v.height_px, "fx_px": v.focal_px, "fy_px": v.focal_px,
            "cx_px": v.centre_px[0], "cy_px": v.centre_px[1], "distortion": list(v.distortion),
            "frame_rate_hz": case.frame_rate, "delay_s": plant.delay,
        },
        "hand_eye": {"rotation_deg": list(v.rotation_deg), "translation_mm": list(v.translation_mm)},
    }  # fmt: skip


def write(case: Case, seed: int, out: Path, truths: Path) -> dict[str, object]:
    """Writes out/cases/NAME, out/unseen/NAME and the truth; returns the truth."""
    rng = np.random.default_rng([seed, 104, case.index])
    folder, unseen = out / "cases" / case.name, out / "unseen" / case.name
    for path in (folder, unseen, truths):
        path.mkdir(parents=True, exist_ok=True)
    known = tomli_w.dumps(rig(case, rng))
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
        _motor(case, said, part.first, part.count, zero, where / "motor.csv")
        arrival = shown.arrival - zero
        added = noise(rng, arrival.size, len(names), case.noise, case.memory, case.heavy)[shown.pick]
        kept = rng.random(arrival.size) >= case.dropped
        if case.plant.view is not None:  # what leaves the image is not found
            edge = np.array([case.plant.view.width_px, case.plant.view.height_px]) - 3.0
            kept &= np.all((shown.values > 3.0) & (shown.values < edge), axis=1)
        times: dict[str, tuple[FloatArray, str]] = {"t_s": (arrival[kept], "%.6f")}
        values = shown.values + added
        columns = times | {n: (values[kept, i], digits) for i, n in enumerate(names)}
        if part.name == "unseen":
            table(where / "times.csv", times)
            table(truths / f"{case.name}-unseen.csv", columns)
            inside = slice(part.first, part.first + part.count)
            begins = part.begin + driven(case.line.q[inside], 1.5 * _widest(case)) - zero
            valid_from = float(arrival[kept][arrival[kept] > begins + 0.2][0])
        else:
            table(where / ("marker.csv" if seen else "angle.csv"), columns)
    truth = describe(case, valid_from)
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1, sort_keys=True) + "\n")
    return truth


def _widest(case: Case) -> float:
    m = case.plant.mechanism
    xs = np.linspace(-1, 1, 41) * m.limit
    return float(np.max(m.need(xs, 1.0) - m.need(xs, -1.0)))


def driven(q: FloatArray, far: float) -> float:
    """When the motor has gone both up and down by `far` since it started, s."""
    up = q - np.minimum.accumulate(q) > far
    down = np.maximum.accumulate(q) - q > far
    both = np.logical_or.accumulate(up) & np.logical_or.accumulate(down)
    return float(np.argmax(both)) * motion.STEP if both.any() else 0.5 * q.size * motion.STEP


def _motor(case: Case, said: FloatArray, first: int, count: int, zero: float, path: Path) -> None:
    line, unit = case.line, case.plant.mechanism.unit
    begin, end = line.t[first], line.t[first + count - 1]
    t = np.arange(begin, end + 1e-9, 1 / case.log_rate)
    q = np.round(np.interp(t, line.t, said) / case.resolution) * case.resolution
    columns = {"t_s": (t - zero, "%.6f"), f"q_{unit}": (q, "%.6f")}
    for name, values in line.sides.items():
        columns[name] = (np.interp(t, line.t, values), "%.4f")
    table(path, columns)


def describe(case: Case, valid_from: float) -> dict[str, object]:
    """The truth of a case. Numbers are rounded to four digits: they are estimates, and the seal hashes them."""

    def short(value: float | str) -> float | str:
        return value if isinstance(value, str) else float(f"{value:.4g}")

    return {
        "format": FORMAT,
        "case": case.name,
        "kind": case.kind,
        "mechanism": case.mechanism,
        "unit": "deg" if case.plant.view is None else "px",
        "noise": short(case.noise),
        "heavy_tails": case.heavy,
        "width": short(case.line.width),
        "gain": short(case.line.gain),
        "motions": case.motions,
        "tests": [p.name for p in case.line.parts if p.tested],
        "verdict": "none" if not case.causes else "unknown" if all(c.unlisted for c in case.causes) else "effect",
        "causes": [
            {
                "id": cause.id, "listed": not cause.unlisted, "since": cause.since, "size": short(cause.size),
                "of": cause.limits.unit, "source": cause.limits.source, "says": cause.says, "moves": cause.moves,
                "parameters": {k: short(v) for k, v in cause.parameters(case.line).items()},
                "times_noise": short(measured["times_noise"]), "times_before": short(measured["times_before"]),
                "strength": short(strength(cause, measured)),
            }
            for cause, measured in zip(case.causes, case.strengths, strict=True)
        ],
        "unseen_valid_from_s": round(valid_from + 0.001, 3),
    }  # fmt: skip
