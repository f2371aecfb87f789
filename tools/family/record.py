"""A case as files: recordings in the fixed formats, the unseen motion without what was seen, and the truth apart."""

import json
from pathlib import Path

import numpy as np
import tomli_w
from tools.family import motion, ranges
from tools.family.cases import Case, strength
from tools.family.plant import run, stamps
from tools.family.refit import driven

FORMAT = "family/1"


def wander(rng: np.random.Generator, count: int, channels: int, std: float, memory: float) -> np.ndarray:
    """Noise of standard deviation `std` whose neighbours correlate by `memory`, (count, channels)."""
    fresh = rng.normal(size=(count, channels))
    out = np.empty_like(fresh)
    state = fresh[0] if count else np.zeros(channels)
    keep = np.sqrt(1 - memory**2)
    for i, x in enumerate(fresh):
        state = memory * state + keep * x if i else x
        out[i] = state
    return std * out


def table(path: Path, columns: dict[str, tuple[np.ndarray, str]]) -> None:
    """CSV with one header line; each column with its format."""
    np.savetxt(
        path, np.column_stack([v for v, _ in columns.values()]), fmt=[f for _, f in columns.values()], delimiter=",",
        header=",".join(columns), comments="",
    )  # fmt: skip


def rig(case: Case, rng: np.random.Generator) -> dict[str, object]:
    plant, unit = case.plant, case.plant.mechanism.unit
    reach = round(plant.mechanism.reach, 4)
    out: dict[str, object] = {
        "format": "rig/1",
        "actuator": {"unit": unit, "range": [-reach, reach], "encoder_resolution": case.resolution},
        "coarse": {"gain": round(plant.gain * float(rng.uniform(0.93, 1.12)), 4), "offset": 0.0},
    }
    if plant.view is None:
        return out | {"angle": {"delay_s": plant.delay}}
    v = plant.view
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
    rng = np.random.default_rng([seed, 4, case.seed])
    folder, unseen = out / "cases" / case.name, out / "unseen" / case.name
    for path in (folder, unseen, truths):
        path.mkdir(parents=True, exist_ok=True)
    known = rig(case, rng)
    for path in (folder, unseen):
        (path / "rig.toml").write_text(tomli_w.dumps(known))
    seen = run(case.plant, case.line, case.causes)
    camera = case.plant.view is not None
    names = ("u_px", "v_px") if camera else ("c_deg",)
    digits = "%.4f" if camera else "%.5f"
    valid_from = 0.0
    for index, part in enumerate(case.parts):
        zero = 0.0 if case.one_clock else part.begin
        where = unseen if part.name == "unseen" else folder / part.name
        where.mkdir(exist_ok=True)
        _motor(case, index, zero, where / "motor.csv")
        frames = case.line.frame & (case.line.part == index)
        arrival = stamps(case.plant, case.line, case.causes, index) - zero
        clean = seen.image[frames]
        noisy = clean + wander(rng, len(clean), len(names), case.noise, case.memory)
        _repeat_held(case, index, clean, noisy)
        kept = rng.random(arrival.size) >= case.dropped
        shown: dict[str, tuple[np.ndarray, str]] = {"t_s": (arrival[kept], "%.6f")}
        values: dict[str, tuple[np.ndarray, str]] = {n: (noisy[kept, i], digits) for i, n in enumerate(names)}
        if part.name == "unseen":
            table(where / "times.csv", shown)
            table(truths / f"{case.name}-unseen.csv", shown | values)
            own = driven(case.line.q[frames], case.line.reach)[kept]
            valid_from = float(arrival[kept][own][0])
        else:
            table(where / ("marker.csv" if camera else "angle.csv"), shown | values)
    truth = describe(case, valid_from)
    (truths / f"{case.name}.json").write_text(json.dumps(truth, indent=1, sort_keys=True) + "\n")
    return truth


def _motor(case: Case, index: int, zero: float, path: Path) -> None:
    part, unit = case.parts[index], case.plant.mechanism.unit
    inside = np.arange(part.q.size) * motion.STEP
    t = np.arange(0.0, inside[-1] + 1e-9, 1 / case.log_rate)
    q = np.interp(t, inside, part.q)
    q = q + sum(np.asarray(cause.encoder(case.line, t + part.begin, q, index)) for cause in case.causes)
    logged = np.round(q / case.resolution) * case.resolution
    columns = {"t_s": (t + part.begin - zero, "%.6f"), f"q_{unit}": (logged, "%.5f")}
    for name, values in part.sides.items():
        columns[name] = (np.interp(t, inside, values), "%.4f")
    table(path, columns)


def _repeat_held(case: Case, index: int, clean: np.ndarray, noisy: np.ndarray) -> None:
    """A repeated value repeats its noise as well. In place."""
    if any(c.id == "acquisition.held_samples" for c in case.causes):
        for i in range(1, len(clean)):
            if np.array_equal(clean[i], clean[i - 1]):
                noisy[i] = noisy[i - 1]


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
        "width": short(case.plant.width),
        "gain": short(case.plant.gain),
        "motions": case.motions,
        "tests": [p.name for p in case.parts if p.name.startswith("test")],
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


def ranges_table() -> list[tuple[str, ranges.Range]]:
    return [(name, value) for name, value in vars(ranges).items() if isinstance(value, ranges.Range)]
