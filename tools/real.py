"""python -m tools.real [DATA]: the diagnosis on real recordings, in one table with what is expected and why.

DATA holds davinci-posture, davinci and so101 (see tools/davinci.py and tools/so101.py for what they are). Default:
shared/data beside the repository. `--only WORD` runs the rows whose group or name holds it; a row takes about 10 s of a
core. The loads have a table of their own in tools/davinci.py.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.console import Console
from rich.table import Table

from tautline.calibration.calibrate import calibrate
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.errors import TautError
from tautline.recording import Angle, Recording, load
from tautline.rig import Rig
from tools.so101 import constant_play

LAG, DELAY, OFFSET = "transmission.lag", "acquisition.delay", "transmission.offset"
LOAD, COUPLING, STICKS = "transmission.load_dependence", "configuration.axis_coupling", "transmission.stick_slip"
POSTURE = frozenset({OFFSET, "transmission.backlash", "configuration.remaining", "configuration.axis_coupling"})
CLOSES = 0.97  # of a posture's gap above the noise
HELD = 3  # samples for which a sensor's value is repeated
TOTAL_S = (0.06, 0.16)  # of a servo's lag and delay
OWN_S = 0.01  # within which what is named is a recording's own best value
_STEP_DEG = 0.088  # of the simulated joint's sensor
JOINT = ("rotation-single-joint-rotation", "rotation-symmetric-motion", "rotation-oscillation-med-freq")


@dataclass(frozen=True)
class Row:
    """A diagnosis that is expected to come out so."""

    group: str
    name: str
    expected: str
    why: str
    made: Callable[[Path], tuple[list[Recording], Rig]]  # the calibration first
    holds: Callable[[Diagnosis], bool]


def find() -> Path | None:
    for folder in Path(__file__).resolve().parents:
        recordings = folder / "shared" / "data"
        if recordings.is_dir():
            return recordings
    return None


def named(document: dict[str, Any]) -> list[str]:
    return [effect["id"] for effect in document["effects"]]


def leading(document: dict[str, Any]) -> set[str]:
    """The effects that cannot be told from the leading one, and itself; empty where none is named."""
    if not document["effects"]:
        return set()
    first = document["effects"][0]
    return {first["id"], *first["ambiguous_with"]}


def late_s(document: dict[str, Any]) -> float:
    """Lag and delay that are named, together, s."""
    values = [effect["parameters"] for effect in document["effects"]]
    return float(sum(v.get("lag", 0.0) + v.get("delay", 0.0) for v in values))


def run(row: Row, data: Path) -> Diagnosis:
    recordings, rig = row.made(data)
    return diagnose(calibrate(recordings[:1], rig).model, recordings[0], recordings[1:])


# -- another posture of the da Vinci tool's wrist


def _postures(axis: str, order: Sequence[int], with_load: bool) -> Callable[[Path], tuple[list[Recording], Rig]]:
    def made(data: Path) -> tuple[list[Recording], Rig]:
        folder = data / "davinci-posture"
        rig = Rig.load(folder / f"rig-{axis}.toml")
        runs = [load(folder / f"{axis}-{i}", rig) for i in order]
        return [r if with_load else _without_load(r) for r in runs], rig

    return made


def _without_load(run: Recording) -> Recording:
    return replace(run, motor=replace(run.motor, load_mNm=None))


def _another_posture(diagnosis: Diagnosis) -> bool:
    return set(named(diagnosis.document)) & POSTURE != set() and diagnosis.document["gap"]["closable_shrink"] >= CLOSES


def postures() -> Iterator[Row]:
    orders = [[a, b] for a in range(1, 6) for b in range(1, 6) if a != b]
    for axis in ("roll", "pitch"):
        for order in [[1, 2, 3, 4, 5], *orders]:
            for with_load in (True, False):
                what = f"{axis} {order[0]} to {', '.join(map(str, order[1:]))}{'' if with_load else ', no load column'}"
                yield Row(
                    "postures",
                    what,
                    f"offset, width or law; {100 * CLOSES:.0f} % closed",
                    "the cables' way through the wrist changes",
                    _postures(axis, order, with_load),
                    _another_posture,
                )


# -- a sensor that repeats its values


def repeated(run: Recording, times: int = HELD) -> Recording:
    assert run.angle is not None
    at = np.arange(len(run.angle.t_s)) // times * times
    return replace(run, angle=replace(run.angle, c_deg=run.angle.c_deg[at]))


def held() -> Iterator[Row]:
    def made(data: Path) -> tuple[list[Recording], Rig]:
        rig = Rig.load(data / "davinci" / "rig.toml")
        one, other = (load(data / "davinci" / f"freq{i}-load0", rig) for i in (2, 3))
        return [one, repeated(other)], rig

    yield Row(
        "held samples",
        f"each value {HELD} times",
        "no stick-slip",
        "it repeats whatever the motor does",
        made,
        lambda found: STICKS not in named(found.document),
    )


# -- joints of an SO-101


def _so101(*names: str) -> Callable[[Path], tuple[list[Recording], Rig]]:
    def made(data: Path) -> tuple[list[Recording], Rig]:
        rig = Rig.load(data / "so101" / "rig.toml")
        return [load(data / "so101" / name, rig) for name in names], rig

    return made


def joints() -> Iterator[Row]:
    yield Row(
        "elbow with load",
        "elbow, gravity",
        f"{LOAD} or unknown, no stick-slip",
        "the servo's torque goes with the angle and the way",
        _so101("elbow-single-joint-elbow", "elbow-friction-gravity"),
        lambda found: (
            STICKS not in named(found.document) and (not named(found.document) or LOAD in leading(found.document))
        ),
    )
    yield Row(
        "two joints",
        "rotation, pitch moves too",
        f"none, small, or {COUPLING}",
        "a vertical axis: the other joint's weight does not turn it",
        _so101("rotation-single-joint-rotation", "rotation-dual-joint-rotation-pitch"),
        lambda found: set(named(found.document)) <= {COUPLING, LOAD, "transmission.backlash"},
    )


# -- a robot against a simulator


def rigid(run: Recording, rig: Rig) -> Recording:
    """The same motion of a joint that is where it is told to be, read by a sensor with steps."""
    c = rig.coarse.gain * run.motor.q + rig.coarse.offset
    return Recording("simulated", run.motor, angle=Angle(run.motor.t_s, np.round(c / _STEP_DEG) * _STEP_DEG))


def _from_simulator(*names: str) -> Callable[[Path], tuple[list[Recording], Rig]]:
    def made(data: Path) -> tuple[list[Recording], Rig]:
        runs, rig = _so101(*names)(data)
        return [rigid(runs[0], rig), *runs], rig

    return made


def lags(diagnosis: Diagnosis) -> bool:
    document = diagnosis.document
    return (
        bool(leading(document)) and leading(document) <= {LAG, DELAY} and TOTAL_S[0] <= late_s(document) <= TOTAL_S[1]
    )


def lags_as_its_own(diagnosis: Diagnosis) -> bool:
    """Within OWN_S of the delay that fits the recording best beside a play of its own."""
    robot = diagnosis.segments[-1]
    run = Recording(robot.name, robot.motor, angle=Angle(robot.arrival_s, robot.observed[:, 0]))
    return lags(diagnosis) and abs(late_s(diagnosis.document) - constant_play(run)[0]) <= OWN_S


def simulators() -> Iterator[Row]:
    for names in ((JOINT[0],), (JOINT[1],), (JOINT[2],), JOINT):
        yield Row(
            "simulator",
            f"rigid, delay 0, to {', '.join(name.removeprefix('rotation-') for name in names)}",
            "lag or delay, 60 to 160 ms in all, as each fits best",
            "a servo follows its command",
            _from_simulator(*names),
            lags_as_its_own if len(names) == 1 else lags,
        )


def rows() -> list[Row]:
    return [*simulators(), *held(), *joints(), *postures()]


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--only", default="", help="The rows whose group or name holds this.")
def main(data: Path | None, only: str) -> None:
    """The diagnosis on real recordings: what was expected and why, what was named and how far the gap closes."""
    folder = data or find()
    if folder is None:
        raise click.ClickException("no recordings beside the repository: name their folder")
    console = Console(width=190, highlight=False)
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for column in ("recordings", "expected", "why", "named", "", "gap (deg)", "noise", "closed", "lag and delay", ""):
        table.add_column(column)
    good = 0
    chosen = [row for row in rows() if only in row.group or only in row.name]
    for i, row in enumerate(chosen, 1):
        try:
            outcome = run(row, folder)
        except TautError as error:
            table.add_row(f"{row.group}: {row.name}", row.expected, row.why, str(error), *[""] * 5, "no")
            continue
        holds, document = row.holds(outcome), outcome.document
        good += holds
        gap, late = document["gap"], late_s(document)
        table.add_row(
            f"{row.group}: {row.name}",
            row.expected,
            row.why,
            ", ".join(f"{e['id']} ({e['probability']:.2f})" for e in document["effects"]) or document["verdict"],
            "or " + ", ".join(sorted(leading(document) - {named(document)[0]})) if len(leading(document)) > 1 else "",
            f"{gap['before']:.3f} to {gap['after']:.3f}",
            f"{document['noise_floor']:.3f}",
            f"{100 * gap['closable_shrink']:.1f} %",
            f"{1e3 * late:.0f} ms" if late else "",
            "yes" if holds else "no",
        )
        print(f"{i} of {len(chosen)}: {row.group}, {row.name}", flush=True)
    console.print(table)
    console.print(f"{good} of {len(chosen)} as expected; closed: of the gap's power above the noise")


if __name__ == "__main__":
    main()
