"""./run bench bare: what a calibration makes of an instrument without a marker, beside what a marker gives.

Each world is drawn twice: bare, followed by a square that is shown in its first picture, and with a marker.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import json_option, progress_bar
from tautline.plain import plain
from tools.bench import endoscopy, tube
from tools.bench.videos import Outcome, behind, said

SIDE_PX = 36.0  # of the square


@dataclass(frozen=True)
class Pair:
    """bare: None where the calibration refuses, which `refused` then says. onsets: reversals after which the tip is
    said to have been seen to begin to move. bends_deg, bends_sigma_deg: error of f_remain and its stated sigma, rms
    within `measured`."""

    scene: str
    seed: int
    bare: Outcome | None
    marked: Outcome | None
    onsets: int = 0
    bends_deg: float = float("nan")
    bends_sigma_deg: float = float("nan")
    refused: str = ""


def run(scenes: Sequence[tube.Scene], seeds: Sequence[int], say: Callable[[float, str], None]) -> list[Pair]:
    pairs: list[Pair] = []
    for scene in scenes:
        for seed in seeds:
            say(len(pairs) / (len(scenes) * len(seeds)), f"{scene.name}, seed {seed}")
            with tempfile.TemporaryDirectory() as room:
                pairs.append(_pair(Path(room), scene, seed))
    return pairs


def _pair(room: Path, scene: tube.Scene, seed: int) -> Pair:
    folder, marked = room / "bare", None
    world = tube.BareWorld(scene, seed, behind(seed))
    endoscopy.write(folder, world)
    u, v = world.patch(world.t[:1])[0]
    said("marker", str(next(folder.glob("video.*"))), "--region", f"{u:.1f},{v:.1f},{SIDE_PX:g}")
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    if not scene.still:
        endoscopy.make(room / "marked", scene.condition, seed, behind(seed))
        status, document = said("calibrate", str(room / "marked"), "--out", str(room / "marked-model"))
        marked = Outcome.of(scene.name, seed, status, document, truth)
    try:
        status, document = said("calibrate", str(folder), "--out", str(room / "model"))
    except RuntimeError as error:
        return Pair(scene.name, seed, None, marked, refused=str(error))
    onsets = sum(bool(onset["used"]) for onset in document["onsets"])
    outcome = Outcome.of(scene.name, seed, status, document, truth)
    return Pair(scene.name, seed, outcome, marked, onsets, *_bends(document, truth))


def _bends(document: dict[str, Any], truth: dict[str, Any]) -> tuple[float, float]:
    """Error of f_remain and its stated sigma, deg rms within `measured`."""
    q, c_deg, sigma = (np.array(document["remaining"][key], dtype=float) for key in ("q", "c_deg", "sigma_deg"))
    low, high = document["backlash"]["measured"]
    inside = (q >= low) & (q <= high)
    error = (c_deg - np.interp(q, truth["remaining"]["q"], truth["remaining"]["c_deg"]))[inside]
    return float(np.sqrt(np.mean(error**2))), float(np.sqrt(np.mean(sigma[inside] ** 2)))


@click.command("bare")
@click.option("--seeds", type=click.IntRange(1, 100), default=2, show_default=True)
@click.option("--first-seed", type=click.IntRange(0), default=0, show_default=True)
@click.option("--only", multiple=True, help="A scene's name; may be given several times.")
@click.option("--still", is_flag=True, help="Torn tendons alone: the motor moves, and what is behind, not the tip.")
@json_option
def command(seeds: int, first_seed: int, only: tuple[str, ...], still: bool, as_json: bool) -> None:
    """Calibrates from videos of an instrument without a marker; of torn tendons too, which move nothing."""
    named = {scene.name: scene for scene in (*(() if still else tube.SCENES), *tube.STILL)}
    if unknown := [name for name in only if name not in named]:
        raise click.UsageError(f"{unknown[0]}: no such scene: {', '.join(named)}")
    with progress_bar("bare") as progress:
        pairs = run(
            [named[name] for name in only] or list(named.values()), range(first_seed, first_seed + seeds), progress
        )
    if as_json:
        click.echo(json.dumps(plain([asdict(pair) for pair in pairs]), allow_nan=False))
        return
    table = Table(title="B(q) without a marker, and with one: error and stated sigma, rms within `measured`")
    for name in (
        "",
        "seed",
        "error, um",
        "sigma, um",
        "z",
        "f, deg",
        "sigma, deg",
        "onsets",
        "verdict",
        "reasons",
        "with a marker, um",
    ):
        table.add_column(name, justify="left" if name in ("", "verdict", "reasons") else "right")
    for pair in pairs:
        marked = f"{pair.marked.error_um:.2f}" if pair.marked else "-"
        if (o := pair.bare) is None:
            table.add_row(pair.scene, str(pair.seed), "-", "-", "-", "-", "-", "0", "refused", pair.refused, marked)
            continue
        table.add_row(
            o.condition, str(o.seed), f"{o.error_um:.2f}", f"{o.sigma_um:.2f}", f"{o.z:.2f}", f"{pair.bends_deg:.2f}",
            f"{pair.bends_sigma_deg:.2f}", str(pair.onsets), o.verdict, ", ".join(o.reasons), marked,
        )  # fmt: skip
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    both = [(pair.bare, pair.marked) for pair in pairs if pair.bare and pair.marked]
    if both:
        near = sum(bare.error_um <= 2.0 * marked.error_um for bare, marked in both)
        click.echo(
            f"within twice the marker's error, or not called good: "
            f"{sum(b.error_um <= 2.0 * m.error_um or b.verdict != 'good' for b, m in both)} of {len(both)}; "
            f"within twice: {near}; good: {sum(b.verdict == 'good' for b, _ in both)}"
        )
    torn = [pair for pair in pairs if named[pair.scene].still]
    if torn:
        invented = sum(pair.onsets > 0 for pair in torn)
        believed = sum(pair.bare is not None and pair.bare.verdict != "unusable" for pair in torn)
        click.echo(
            f"the tip does not move in {len(torn)} recordings: onsets invented in {invented}, not called unusable "
            f"{believed}"
        )
