"""python -m tools.davinci [DATA]: the diagnosis on a real cable-driven surgical tool whose load was changed.

DATA holds the runs as recordings, freqI-loadJ (sine at 0.1 (I + 1) Hz against about 12 (J + 1) mNm), and rig.toml.
Default: shared/data/davinci beside the repository. It is the public data set MRDLab/mis-tool-characterization (one jaw
of a Maryland tool), converted: encoder counts to degrees, torque to mNm.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Recording, load
from tautline.rig import Rig

RATES, LOADS = range(5), range(4)
Run = tuple[int, int]  # rate, load


def find() -> Path | None:
    for folder in Path(__file__).resolve().parents:
        recordings = folder / "shared" / "data" / "davinci"
        if recordings.is_dir():
            return recordings
    return None


@dataclass
class Tool:
    """The runs and the models calibrated on each, as they are asked for."""

    folder: Path

    def __post_init__(self) -> None:
        self._runs: dict[Run, Recording] = {}
        self._models: dict[Run, Model] = {}

    @cached_property
    def rig(self) -> Rig:
        return Rig.load(self.folder / "rig.toml")

    def run(self, run: Run) -> Recording:
        if run not in self._runs:
            self._runs[run] = load(self.folder / f"freq{run[0]}-load{run[1]}", self.rig)
        return self._runs[run]

    def model(self, run: Run) -> Model:
        if run not in self._models:
            self._models[run] = calibrate([self.run(run)], self.rig).model
        return self._models[run]

    def diagnose(self, calibration: Run, tests: Iterable[Run], with_load: bool = True) -> Diagnosis:
        recordings = [self.run(run) for run in (calibration, *tests)]
        if not with_load:
            recordings = [replace(r, motor=replace(r.motor, load_mNm=None)) for r in recordings]
        return diagnose(self.model(calibration), recordings[0], recordings[1:])

    def pairs(self, rates: Iterable[int] = RATES) -> Iterator[tuple[int, int, int, dict[str, Any]]]:
        """Rate, load of the calibration, load of the test, diagnosis: every other load at the same rate."""
        for rate in rates:
            for one in LOADS:
                for other in LOADS:
                    if one != other:
                        yield rate, one, other, self.diagnose((rate, one), [(rate, other)]).document


def times(document: dict[str, Any]) -> float:
    """How many times the gap shrinks."""
    return float(document["gap"]["before"] / document["gap"]["after"])


CASES: tuple[tuple[str, Run, tuple[Run, ...], bool], ...] = (
    ("three loads", (2, 0), ((2, 1), (2, 3)), True),
    ("four loads", (2, 0), ((2, 1), (2, 2), (2, 3)), True),
    ("four loads, four rates", (1, 2), ((3, 0), (4, 1), (2, 3)), True),
    ("two loads", (2, 0), ((2, 1),), True),
    ("two loads, back again", (2, 0), ((2, 2), (3, 0)), True),
    ("the same run", (2, 0), ((2, 0),), True),
    ("the same load, another rate", (2, 1), ((3, 1),), True),
    ("two loads, no load column", (2, 0), ((2, 1),), False),
    ("three loads, no load column", (2, 0), ((2, 1), (2, 3)), False),
    ("four loads, no load column", (2, 0), ((2, 2), (2, 1), (2, 3)), False),
)


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--rates", default="01234", show_default=True, help="Rates of the table of load pairs, 0 to 4.")
def main(data: Path | None, rates: str) -> None:
    """The diagnosis on the da Vinci tool: what is named, and how far the gap at another load shrinks. 4 minutes."""
    folder = data or find()
    if folder is None:
        raise click.ClickException("no da Vinci data beside the repository: name their folder")
    try:
        _show(Tool(folder), [int(rate) for rate in rates])
    except TautError as error:
        raise click.ClickException(str(error)) from error


def _show(tool: Tool, rates: list[int]) -> None:
    console = Console(width=170)
    table = _table("recordings", "verdict", "named", "cannot be told from", "gap (deg)", "noise", "looks like")
    for what, calibration, tests, with_load in CASES:
        document = tool.diagnose(calibration, tests, with_load).document
        named = ", ".join(f"{e['id']} ({e['probability']:.2f})" for e in document["effects"])
        unsure = ", ".join(e for effect in document["effects"] for e in effect["ambiguous_with"])
        gap = document["gap"]
        numbers = f"{gap['before']:.3f} to {gap['after']:.3f}", f"{document['noise_floor']:.3f}"
        table.add_row(what, document["verdict"], named, unsure, *numbers, document["signature"] or "")
    console.print(table, highlight=False)
    table = _table("times the gap shrinks", *(f"{one} to {other}" for one in LOADS for other in LOADS if one != other))
    every: list[float] = []
    unnamed = 0
    for rate in rates:
        row = []
        for _, _, _, document in tool.pairs([rate]):
            row.append(times(document))
            unnamed += [e["id"] for e in document["effects"]] != ["transmission.load_dependence"]
        table.add_row(f"{0.1 * (rate + 1):.1f} Hz", *(f"{value:.1f}" for value in row))
        every += row
    console.print(table, highlight=False)
    console.print(
        f"{len(every)} load pairs: at least {min(every):.1f} times, {np.median(every):.1f} in the median; "
        f"in {unnamed} something else than the load alone was named",
        highlight=False,
    )


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i and "to" in column else "left")
    return table


if __name__ == "__main__":
    main()
