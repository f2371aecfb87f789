"""python -m tools.so101_simulator [DATA]: a one-joint MJCF of a low-cost arm as the nominal of a diagnosis, and what
the corrected model leaves of motions that it did not see.

DATA as in tools/so101.py: the commands drive the MJCF, its joint is compared with the joint's own sensor. Each joint is
diagnosed on one motion; every other one inside its range is predicted by the simulator as it is, by the corrected one,
and by what a user writes in an afternoon: a delay, a play of constant width and a polynomial of fifth order, fitted to
the same motion. All in deg rms.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.table import Table
from tools.so101 import Array, constant_play, find, inside, measured, settled

from tautline.diagnosis.diagnose import Diagnosis
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.model import Model
from tautline.prediction import predict
from tautline.recording import Recording, load
from tautline.rig import Rig
from tautline.simulators import Simulator, mjcf

MOTIONS = {"rotation": "rotation-single-joint-rotation", "elbow": "elbow-single-joint-elbow"}  # diagnosed on
METHODS = ("as it is", "corrected", "play")
# Damping, armature, friction and gain are those that public models of this arm's servos have, to a digit.
ARM = """<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"{gravity}/>
  <worldbody><body>
    <joint name="joint" axis="0 1 0" damping="0.6" frictionloss="0.05" armature="0.03"/>
    <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02" mass="0.2"/>
  </body></worldbody>
  <actuator><position name="servo" joint="joint" kp="18"/></actuator>
</mujoco>
"""
NO_GRAVITY = ' gravity="0 0 0"'  # the rotation's axis is upright


@dataclass(frozen=True)
class Result:
    joint: str
    found: Diagnosis
    core_s: float
    unseen: dict[str, dict[str, float]]  # of each motion, deg rms by method

    def medians(self) -> dict[str, float]:
        return {m: float(np.median([rms[m] for rms in self.unseen.values()])) for m in METHODS}


def simulator(folder: Path, joint: str) -> Simulator:
    path = folder / f"{joint}.xml"
    path.write_text(ARM.format(gravity=NO_GRAVITY if joint == "rotation" else ""))
    return mjcf.simulator(path, "servo", "joint:joint")


def told(model: Model, run: Recording) -> Array:
    assert run.angle is not None
    return predict(model, run.motor, run.angle.t_s - model.delay_s).c_deg


def on(joint: str, data: Path, folder: Path) -> Result:
    rig = Rig.load(data / "rig.toml")
    runs = {path.name: load(path, rig) for path in sorted(data.glob(f"{joint}-*"))}
    run = runs.pop(MOTIONS[joint])
    began = time.process_time()
    found = diagnose_simulator(simulator(folder, joint), [run], rig)
    core_s = time.process_time() - began
    delay_s, width, play = constant_play(run)
    unseen = {}
    for name, other in runs.items():
        rows = settled(other, 1.2 * width, max(delay_s, 0.1))
        if inside(other, run) and rows.any():
            said = {
                "as it is": told(found.nominal, other),
                "corrected": told(found.corrected, other),
                "play": play(other),
            }
            unseen[name] = {m: float(np.sqrt(np.mean((measured(other) - c)[rows] ** 2))) for m, c in said.items()}
    return Result(joint, found, core_s, unseen)


def shown(results: Sequence[Result]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for name in ("joint", "unseen", *METHODS, "core-s", "verdict", "named"):
        table.add_column(name, justify="left" if name in ("joint", "verdict", "named") else "right")
    for result in results:
        document = result.found.document
        values = {
            each["name"]: f"{each['nominal']:.3g} -> {each['value']:.3g}"
            for each in document["simulator"]["parameters"]
        }
        named = ", ".join(
            f"{effect['id']} ({effect['probability']:.2f}{', ' + values[name] if name in values else ''})"
            for effect in document["effects"]
            for name in [effect["id"].removeprefix("simulator.")]
        )
        medians = [f"{value:.3f}" for value in result.medians().values()]
        table.add_row(
            result.joint, str(len(result.unseen)), *medians, f"{result.core_s:.0f}", document["verdict"], named
        )
    return table


@click.command()
@click.argument("data", required=False, type=click.Path(path_type=Path, exists=True))
@click.option("--every", is_flag=True, help="List every motion too.")
def main(data: Path | None, every: bool) -> None:
    """What a diagnosis makes of a user's simulator, on real joints, in deg rms on motions that it did not see."""
    console = Console(width=190, highlight=False)
    data = data or find()
    if data is None:
        console.print("no SO-101 data beside the repository: name their folder")
        return
    with tempfile.TemporaryDirectory() as folder:
        results = [on(joint, data, Path(folder)) for joint in MOTIONS]
    console.print(shown(results))
    both = {name: rms for result in results for name, rms in result.unseen.items()}
    for name, rms in both.items() if every else ():
        console.print(f"{name}: " + "  ".join(f"{m} {value:.3f}" for m, value in rms.items()))
    medians = ", ".join(f"{m} {np.median([rms[m] for rms in both.values()]):.3f}" for m in METHODS)
    ratios = [rms["corrected"] / rms["play"] for rms in both.values()]
    console.print(
        f"{len(both)} unseen motions, medians in deg: {medians}; corrected to play {np.median(ratios):.2f} in the "
        f"median, {max(ratios):.2f} at worst"
    )


if __name__ == "__main__":
    main()
