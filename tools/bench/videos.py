"""./run bench videos: what a calibration makes of videos whose generator shares nothing with it.

Each recording goes through `taut calibrate FOLDER`, as anyone's would. z is sqrt(mean((error of B / its sigma)^2)) over
the grid within `measured`.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import click
import cv2
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import json_option, log, progress_bar
from tautline.plain import plain
from tools.bench import endoscopy

Array = np.ndarray


@dataclass(frozen=True)
class Outcome:
    condition: str
    seed: int
    error_um: float  # of B, rms within `measured`
    sigma_um: float  # stated, rms
    z: float
    status: int  # exit status of taut calibrate
    verdict: str
    reasons: tuple[str, ...]

    @classmethod
    def of(cls, condition: str, seed: int, status: int, document: dict[str, Any], truth: dict[str, Any]) -> Outcome:
        q, width, sigma = (np.array(document["backlash"][key], dtype=float) for key in ("q", "width", "sigma"))
        low, high = document["backlash"]["measured"]
        inside = (q >= low) & (q <= high)
        error = (width - np.interp(q, truth["backlash"]["q"], truth["backlash"]["width"]))[inside]
        return cls(
            condition, seed, 1e3 * _rms(error), 1e3 * _rms(sigma[inside]), _rms(error / sigma[inside]), status,
            document["quality"]["verdict"], tuple(r["code"] for r in document["quality"]["reasons"]),
        )  # fmt: skip


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(np.square(x)))) if len(x) else float("nan")


def bends(document: dict[str, Any], truth: dict[str, Any]) -> tuple[float, float]:
    """Error of f_remain and its stated sigma, deg rms within `measured`."""
    q, c_deg, sigma = (np.array(document["remaining"][key], dtype=float) for key in ("q", "c_deg", "sigma_deg"))
    low, high = document["backlash"]["measured"]
    inside = (q >= low) & (q <= high)
    error = (c_deg - np.interp(q, truth["remaining"]["q"], truth["remaining"]["c_deg"]))[inside]
    return _rms(error), _rms(sigma[inside])


def said(*words: str) -> tuple[int, dict[str, Any]]:
    """Exit status and result of a `taut` command, in a process of its own."""
    command = [sys.executable, "-m", "tautline", *words, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode not in (0, 3):
        raise RuntimeError(f"taut {' '.join(words)}: {done.stderr.strip().splitlines()[-1]}")
    return done.returncode, json.loads(done.stdout)


@cache
def backgrounds() -> list[Array]:
    """Real endoscopy frames, where they lie beside the repository; each third seed is drawn over tissue of our own."""
    for folder in Path(__file__).resolve().parents:
        if (shared := folder / "shared" / "data" / "backgrounds").is_dir():
            pictures = sorted(path for path in shared.iterdir() if path.suffix in (".jpg", ".png"))
            return [np.asarray(cv2.imread(str(path))) for path in pictures]
    return []


def behind(seed: int) -> Array | None:
    """A seed's background; None: tissue of our own."""
    real = backgrounds()
    return real[seed % len(real)] if real and seed % 3 else None


def run(
    conditions: Sequence[endoscopy.Condition], seeds: Sequence[int], say: Callable[[float, str], None]
) -> list[Outcome]:
    outcomes = []
    total = len(conditions) * len(seeds)
    for condition in conditions:
        for seed in seeds:
            share = len(outcomes) / total
            with tempfile.TemporaryDirectory() as room:
                folder = Path(room) / "recording"
                endoscopy.make(
                    folder, condition, seed, behind(seed), lambda part, at=share: say(at + part / total, "drawing")
                )
                say(share, condition.name)
                status, document = said("calibrate", str(folder), "--out", str(Path(room) / "model"))
                truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
            outcomes.append(Outcome.of(condition.name, seed, status, document, truth))
    return outcomes


@click.command("videos")
@click.option("--seeds", type=click.IntRange(1, 100), default=3, show_default=True)
@click.option("--only", multiple=True, help="A condition's name; may be given several times.")
@json_option
def command(seeds: int, only: tuple[str, ...], as_json: bool) -> None:
    """Calibrates from videos that codecs, glare, other instruments and uneven clocks have been through."""
    named = {condition.name: condition for condition in endoscopy.CONDITIONS}
    if unknown := [name for name in only if name not in named]:
        raise click.UsageError(f"{unknown[0]}: no such condition: {', '.join(named)}")
    chosen = [named[name] for name in only] or list(endoscopy.CONDITIONS)
    if not backgrounds():
        log("no folder shared/data/backgrounds above the repository: all seeds are drawn over tissue made here")
    with progress_bar("videos") as progress:
        outcomes = run(chosen, range(seeds), progress)
    if as_json:
        click.echo(json.dumps(plain([asdict(outcome) for outcome in outcomes]), allow_nan=False))
        return
    table = Table(title="B(q) from videos: error and stated sigma, rms within `measured`; z = rms(error / sigma)")
    for name in ("", "seed", "error, um", "sigma, um", "z", "exit", "verdict", "reasons"):
        table.add_column(name, justify="left" if name in ("", "verdict", "reasons") else "right")
    for o in outcomes:
        table.add_row(
            o.condition, str(o.seed), f"{o.error_um:.2f}", f"{o.sigma_um:.2f}", f"{o.z:.2f}",
            str(o.status), o.verdict, ", ".join(o.reasons),
        )  # fmt: skip
    Console(width=None if sys.stdout.isatty() else 140).print(table)
    measured = [o for o in outcomes if not named[o.condition].refused]
    if measured:
        click.echo(f"z at most 2 in {sum(o.z <= 2 for o in measured)} of {len(measured)} videos")
