"""python -m tools.so101 [DATA]: two joints of a low-cost arm, calibrated on one motion each, every other one predicted.

DATA holds recordings JOINT-MOTION (commanded angle in motor.csv, the joint's own sensor in angle.csv) and rig.toml.
Default: shared/data/so101 beside the repository. It is the public data set isaac-sim2real/sage (real SO-101 runs),
converted: one joint a folder, seconds and degrees.

Baselines, each fitted to the same motion by least squares with a delay of its own:
play         a play of constant width, then a polynomial of fifth order
prandtl      Prandtl-Ishlinskii: 30 plays with weights of at least 0, at the play's delay
polynomial   of fifth order, no hysteresis
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import numpy.typing as npt
from rich.console import Console
from rich.table import Table
from scipy.optimize import minimize, nnls

from tautline.calibration.calibrate import calibrate
from tautline.calibration.result import Calibration
from tautline.errors import TautError
from tautline.prediction import predict
from tautline.quality import Reason
from tautline.recording import Recording, load
from tautline.rig import Rig

Array = npt.NDArray[np.float64]
Law = Callable[[Recording], Array]  # c (n,) deg at the recording's angle.t_s

JOINTS = ("rotation", "elbow")
METHODS = ("tautline", "play", "prandtl", "polynomial")
ORDER, PLAYS = 5, 30
DELAYS_S = np.linspace(0.0, 0.25, 11)  # to start from
_REWEIGHTED = 6  # rounds, of the weights that a motion's error gives it
SLACK_DEG = 0.2  # a motion that reaches farther than the calibration's by less is still inside its range


def find() -> Path | None:
    for folder in Path(__file__).resolve().parents:
        recordings = folder / "shared" / "data" / "so101"
        if recordings.is_dir():
            return recordings
    return None


def play(q: Array, width: float) -> Array:
    """Centre coordinates of a play of constant width that starts centred on q[0]."""
    p = np.empty_like(q)
    state, half = q[0], 0.5 * width
    for k, value in enumerate(q):
        state = min(max(state, value - half), value + half)
        p[k] = state
    return p


def commanded(run: Recording, delay_s: float) -> Array:
    assert run.angle is not None
    return np.asarray(np.interp(run.angle.t_s - delay_s, run.motor.t_s, run.motor.q))


def measured(run: Recording) -> Array:
    assert run.angle is not None
    return run.angle.c_deg


def play_of_all(runs: Sequence[Recording], rows: Sequence[npt.NDArray[np.bool_]]) -> Law:
    """One play of constant width, a delay and a polynomial that leave the least of all these motions: the least sum of
    the logarithms of what each leaves in its rows, so that a motion of small errors counts as one of large ones."""
    low, high = min(float(run.motor.q.min()) for run in runs), max(float(run.motor.q.max()) for run in runs)
    seen = [measured(run)[chosen] for run, chosen in zip(runs, rows, strict=True)]

    def terms(run: Recording, delay_s: float, width: float) -> Array:
        p = (2.0 * play(commanded(run, delay_s), abs(width)) - low - high) / (high - low)
        return np.asarray(np.polynomial.chebyshev.chebvander(p, ORDER))

    def fitted(x: npt.NDArray[Any]) -> tuple[float, Array]:
        designs = [terms(run, *x)[chosen] for run, chosen in zip(runs, rows, strict=True)]
        weights = np.ones(len(runs))
        for _ in range(_REWEIGHTED):
            scale = [w / np.sqrt(len(c)) for w, c in zip(weights, seen, strict=True)]
            left = np.concatenate([s * design for s, design in zip(scale, designs, strict=True)])
            right = np.concatenate([s * c for s, c in zip(scale, seen, strict=True)])
            law = np.linalg.lstsq(left, right, rcond=None)[0]
            rms = np.array([np.sqrt(np.mean((c - d @ law) ** 2)) for c, d in zip(seen, designs, strict=True)])
            weights = 1.0 / rms
        return float(np.sum(np.log(rms))), law

    each = np.array([constant_play(run)[:2] for run in runs])
    best = minimize(
        lambda x: fitted(x)[0], np.median(each, axis=0), method="Nelder-Mead", options={"xatol": 1e-4, "fatol": 1e-6}
    ).x
    law = fitted(best)[1]
    return lambda other: np.asarray(terms(other, *best) @ law)


def constant_play(run: Recording, hysteresis: bool = True) -> tuple[float, float, Law]:
    """Delay, width and law of a constant play (or none) and a polynomial, by least squares."""
    c = measured(run)
    low, high = float(run.motor.q.min()), float(run.motor.q.max())

    def scaled(p: Array) -> Array:
        return (2.0 * p - low - high) / (high - low)

    def fitted(x: npt.NDArray[Any]) -> tuple[float, npt.NDArray[Any]]:
        p = scaled(play(commanded(run, float(x[0])), abs(float(x[1])) if hysteresis else 0.0))
        design = np.polynomial.chebyshev.chebvander(p, ORDER)
        coefficients = np.linalg.lstsq(design, c, rcond=None)[0]
        return float(np.mean((c - design @ coefficients) ** 2)), coefficients

    widths = (high - low) * np.array([0.0, 0.01, 0.03, 0.06, 0.12, 0.25] if hysteresis else [0.0])
    starts = [np.array([delay, width]) for delay in DELAYS_S for width in widths]
    start = min(starts, key=lambda x: fitted(x)[0])
    simplex = start + np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.01 * (high - low)]])
    options = {"initial_simplex": simplex, "xatol": 1e-5, "fatol": 1e-10}
    best = minimize(lambda x: fitted(x)[0], start, method="Nelder-Mead", options=options).x  # type: ignore[call-overload]
    delay, width = float(best[0]), abs(float(best[1])) if hysteresis else 0.0
    coefficients = fitted(best)[1]

    def law(other: Recording) -> Array:
        p = np.clip(scaled(play(commanded(other, delay), width)), -1.05, 1.05)
        return np.asarray(np.polynomial.chebyshev.chebval(p, coefficients))

    return delay, width, law


def prandtl(run: Recording, delay_s: float) -> Law:
    span = float(np.ptp(run.motor.q))
    widths = np.linspace(0.0, 0.5 * span, PLAYS)

    def design(other: Recording) -> Array:
        q = commanded(other, delay_s)
        columns = [play(q, width) for width in widths]
        return np.column_stack([*columns, np.ones_like(q), -np.ones_like(q)])

    weights = nnls(design(run), measured(run))[0]
    return lambda other: np.asarray(design(other) @ weights)


def settled(run: Recording, width: float, delay_s: float) -> npt.NDArray[np.bool_]:
    """Rows after the joint was driven through `width` both ways."""
    assert run.angle is not None
    q = run.motor.q
    up = np.flatnonzero(q - np.minimum.accumulate(q) > width)
    down = np.flatnonzero(np.maximum.accumulate(q) - q > width)
    if not len(up) or not len(down):
        return np.zeros(len(run.angle.t_s), dtype=bool)
    from_s = run.motor.t_s[max(up[0], down[0])] + delay_s
    return np.asarray(run.angle.t_s > from_s, dtype=bool)


@dataclass(frozen=True)
class Calibrated:
    """All methods on one motion; `refused`: why there is no model of ours to use."""

    run: Recording
    calibration: Calibration | None
    refused: str
    delay_s: float  # of the constant play, as its width
    width: float
    laws: dict[str, Law]

    @classmethod
    def on(cls, run: Recording, rig: Rig) -> Calibrated:
        delay, width, constant = constant_play(run)
        laws = {
            "play": constant,
            "prandtl": prandtl(run, delay),
            "polynomial": constant_play(run, hysteresis=False)[2],
        }
        calibration, refused = None, ""
        try:
            calibration = calibrate([run], rig)
            if not calibration.model.quality.usable:
                refused = f"{calibration.model.quality.reasons[0].code}: {calibration.model.quality.reasons[0]}"
        except TautError as error:
            refused = str(error)
        if calibration is not None and not refused:
            model = calibration.model

            def ours(other: Recording) -> Array:
                assert other.angle is not None
                return predict(model, other.motor, other.angle.t_s - model.delay_s).c_deg

            laws["tautline"] = ours
        return cls(run, calibration, refused, delay, width, laws)

    def rms(self, other: Recording) -> dict[str, float]:
        """deg, of each method, on another motion; empty where it is never driven both ways through the backlash."""
        late = settled(other, 1.2 * self.width, max(self.delay_s, 0.1))
        if not late.any():
            return {}
        return {m: float(np.sqrt(np.mean((measured(other) - law(other))[late] ** 2))) for m, law in self.laws.items()}


def inside(test: Recording, calibration: Recording) -> bool:
    low, high = calibration.motor.q.min() - SLACK_DEG, calibration.motor.q.max() + SLACK_DEG
    return bool(test.motor.q.min() >= low and test.motor.q.max() <= high)


def pairs(folder: Path, joints: Sequence[str] = JOINTS) -> Iterator[tuple[Calibrated, dict[str, dict[str, float]]]]:
    """Each motion's calibration, with the rms of every unseen motion of its joint inside its range."""
    rig = Rig.load(folder / "rig.toml")
    for joint in joints:
        runs = [load(path, rig) for path in sorted(folder.glob(f"{joint}-*"))]
        for run in runs:
            made = Calibrated.on(run, rig)
            others = {o.name: made.rms(o) for o in runs if o.name != run.name and inside(o, run)}
            yield made, {name: rms for name, rms in others.items() if rms}


def told(reason: Reason) -> str:
    """Its code; in brackets where it is no doubt."""
    return f"({reason.code})" if reason.mild else reason.code


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--every", is_flag=True, help="List every pair of motions too.")
def main(data: Path | None, every: bool) -> None:
    """A play of ours beside others' hysteresis on real joints, in deg rms on motions that were not calibrated on."""
    console = Console(width=190, highlight=False)
    folder = data or find()
    if folder is None:
        console.print("no SO-101 data beside the repository: name their folder")
        return
    columns = ("calibrated on", "verdict", "delay", "play's", "tests", *METHODS, "ours / play", "worst", "reasons")
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in columns:
        table.add_column(name, justify="left" if name in ("calibrated on", "verdict", "reasons") else "right")
    listed: list[str] = []
    ratios: list[float] = []
    for made, tests in pairs(folder):
        times = [rms["tautline"] / rms["play"] for rms in tests.values() if "tautline" in rms]
        ratios += times
        medians = (np.median([r[m] for r in tests.values()]) if tests and m in made.laws else np.nan for m in METHODS)
        quality = made.calibration.model.quality if made.calibration else None
        table.add_row(
            made.run.name,
            quality.verdict.value if quality else "refused",
            f"{1e3 * made.calibration.model.delay_s:.0f} ms" if made.calibration else "",
            f"{1e3 * made.delay_s:.0f} ms",
            str(len(tests)),
            *(f"{value:.3f}" if np.isfinite(value) else "" for value in medians),
            f"{np.median(times):.2f}" if times else "",
            f"{max(times):.2f}" if times else "",
            made.refused or ", ".join(told(reason) for reason in (quality.reasons if quality else ())),
        )
        for name, rms in tests.items():
            ratio = f"{rms['tautline'] / rms['play']:6.2f}" if "tautline" in rms else "refused"
            figures = "  ".join(f"{m} {rms[m]:.3f}" for m in METHODS if m in rms)
            listed.append(f"{made.run.name} -> {name}: {ratio}   {figures}")
    console.print(table)
    if every:
        console.print("\n".join(listed))
    if ratios:
        console.print(
            f"{len(ratios)} unseen motions inside the range: {np.median(ratios):.2f} times the constant play's error "
            f"in the median, {max(ratios):.2f} at worst; above 1.5 in {sum(r > 1.5 for r in ratios)}"
        )


if __name__ == "__main__":
    main()
