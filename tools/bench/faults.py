"""./run bench faults: what a diagnosis says of videos whose generator shares nothing with it.

An instrument is calibrated from a video, then used twice with a fault that came since; all three are pictures. Each
case goes through `taut diagnose CALIBRATION TEST TEST`, as anyone's would.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.cli._common import progress_bar
from tautline.plain import plain
from tools.bench import endoscopy
from tools.bench.videos import behind, said

CONDITIONS = ("MJPEG", "H.264", "glare")
TESTS = ((45.0, 1.6, False), (45.0, 1.2, True))  # s, mm/s at most, whether the user rests
PAUSE_S = 5.0
NOTHING = "none"


def _aside(rng: np.random.Generator, since_s: float) -> endoscopy.Fault:
    u, v, size = *rng.normal(size=2), rng.uniform(0.12, 0.25)
    x, y = size * np.array([u, v]) / np.hypot(u, v)
    return endoscopy.Fault(since_s + rng.uniform(10.0, 30.0), aside_mm=(float(x), float(y), 0.0))


FAULTS: dict[str, tuple[str, Callable[[np.random.Generator, float], endoscopy.Fault]]] = {
    "nothing": (NOTHING, lambda rng, since: endoscopy.Fault(since)),
    "lag of 30 ms": ("transmission.lag", lambda rng, since: endoscopy.Fault(since, lag_s=0.03)),
    "lag of 120 ms": ("transmission.lag", lambda rng, since: endoscopy.Fault(since, lag_s=0.12)),
    "creep": (
        "transmission.creep",
        lambda rng, since: endoscopy.Fault(since, late_share=rng.uniform(0.02, 0.06)),
    ),
    "width by speed": (
        "transmission.rate_dependent_backlash",
        lambda rng, since: endoscopy.Fault(since, wider=rng.uniform(0.15, 0.4)),
    ),
    "drift": (
        "transmission.drift",
        lambda rng, since: endoscopy.Fault(since, drift_mm_s=rng.choice([-1.0, 1.0]) * rng.uniform(8e-4, 2e-3)),
    ),
    "shift": ("registration.shift", _aside),
    "contact": ("configuration.contact", lambda rng, since: endoscopy.Fault(since, wall_deg=rng.uniform(24.0, 34.0))),
}


@dataclass(frozen=True)
class Outcome:
    condition: str
    fault: str
    seed: int
    expected: str
    verdict: str
    named: tuple[str, ...]  # the leading one first
    alike: tuple[str, ...]  # what cannot be told from it
    probability: float
    before_px: float
    after_px: float
    floor_px: float

    @property
    def right(self) -> bool:
        return self.expected == (self.named[0] if self.named else self.verdict)

    @classmethod
    def of(cls, condition: str, fault: str, seed: int, document: dict[str, Any]) -> Outcome:
        effects, gap = document["effects"], document["gap"]
        return cls(
            condition, fault, seed, FAULTS[fault][0], document["verdict"], tuple(e["id"] for e in effects),
            tuple(effects[0]["ambiguous_with"]) if effects else (), effects[0]["probability"] if effects else np.nan,
            gap["before"], gap["after"], document["noise_floor"],
        )  # fmt: skip


def make(room: Path, condition: endoscopy.Condition, fault: str, seed: int, say: Callable[[float], None]) -> list[Path]:
    """The recordings of a case, the calibration first."""
    folders = [room / "calibration", *(room / f"test-{k}" for k in range(1, len(TESTS) + 1))]
    calibrated = endoscopy.make(folders[0], condition, seed, behind(seed), lambda part: say(part / len(folders)))
    clock = since_s = float(calibrated.t[-1])
    drawn = FAULTS[fault][1](np.random.default_rng([seed, list(FAULTS).index(fault)]), since_s + PAUSE_S)
    for k, (lasts_s, mm_s, rests) in enumerate(TESTS, 1):
        use = endoscopy.Use(calibrated, 1000 * seed + k, clock + PAUSE_S, lasts_s, mm_s, rests, drawn)
        endoscopy.make(folders[k], condition, seed, None, lambda part, k=k: say((k + part) / len(folders)), use)
        clock = use.begins_s + lasts_s
    return folders


def run(
    conditions: Sequence[str], faults: Sequence[str], seeds: Sequence[int], say: Callable[[float, str], None]
) -> Iterator[Outcome]:
    known = {condition.name: condition for condition in endoscopy.CONDITIONS}
    cases = [(c, f, s) for s in seeds for f in faults for c in conditions]
    for i, (condition, fault, seed) in enumerate(cases):
        with tempfile.TemporaryDirectory() as room:
            folders = make(
                Path(room), known[condition], fault, seed, lambda part, i=i: say((i + part) / len(cases), "drawing")
            )
            say((i + 0.99) / len(cases), f"{fault}, {condition}")
            _, document = said("diagnose", *map(str, folders), "--out", str(Path(room) / "diagnosis"))
        yield Outcome.of(condition, fault, seed, document)


@click.command("faults")
@click.option("--seeds", type=click.IntRange(1, 100), default=1, show_default=True)
@click.option("--first-seed", type=int, default=1000, show_default=True, help="Seeds below 1000 were looked at.")
@click.option("--only", "faults", multiple=True, type=click.Choice(list(FAULTS)), help="Default: all.")
@click.option("--condition", "conditions", multiple=True, type=click.Choice(CONDITIONS), help="Default: all.")
@click.option("--json", "as_json", is_flag=True, help="Print each case as a line of JSON on stdout.")
def command(seeds: int, first_seed: int, faults: tuple[str, ...], conditions: tuple[str, ...], as_json: bool) -> None:
    """Diagnoses videos of an instrument with a fault that came after its calibration."""
    table = Table(title="Diagnosed from videos; px rms over both tests")
    for name in ("", "video", "seed", "said", "", "gap", "after", "floor", ""):
        table.add_column(name, justify="right" if name in ("seed", "gap", "after", "floor") else "left")
    outcomes = []
    with progress_bar("faults") as progress:
        every = run(conditions or CONDITIONS, faults or list(FAULTS), range(first_seed, first_seed + seeds), progress)
        for o in every:
            outcomes.append(o)
            answer = ", ".join(o.named) or o.verdict
            if as_json:
                print(json.dumps(plain(asdict(o) | {"right": o.right})), flush=True)
            table.add_row(
                o.fault, o.condition, str(o.seed), answer, f"{o.probability:.2f}" if o.named else "",
                f"{o.before_px:.2f}", f"{o.after_px:.2f}", f"{o.floor_px:.2f}", "" if o.right else "wrong",
            )  # fmt: skip
    if as_json:
        return
    Console(width=None if sys.stdout.isatty() else 160).print(table)
    for name in dict.fromkeys(o.fault for o in outcomes):
        of_it = [o for o in outcomes if o.fault == name]
        click.echo(f"{name}: right in {sum(o.right for o in of_it)} of {len(of_it)}")
