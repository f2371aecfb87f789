"""python tools/examples/rigid_joint.py ROBOT OUT: what a simulator without play, lag or delay would have recorded.

ROBOT is a recording of a joint (motor.csv; its rig.toml or --rig). OUT is a recording of the same motion by a rigid
joint: its angle is the commanded one, at once, rounded to --step as a sensor does. With the package `mujoco` it is a
hinge of MuJoCo that a stiff drive holds, else the coarse law of the rig.
Then `taut diagnose OUT ROBOT --rig rig.toml --out DIR` says what the simulator lacks.
"""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
import numpy.typing as npt
import pandas as pd

from tautline.recording import Angle, Recording, load
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

HINGE = """
<mujoco>
  <option timestep="0.0005" integrator="implicitfast" gravity="0 0 0"/>
  <worldbody><body>
    <joint name="joint" type="hinge" axis="0 0 1"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0.1 0 0" mass="0.1"/>
  </body></worldbody>
  <actuator><position joint="joint" kp="1e4" dampratio="1"/></actuator>
</mujoco>
"""


@dataclass(frozen=True)
class Rigid:
    """How the simulated joint follows."""

    step_deg: float  # of its sensor, 0 for none
    mujoco: bool = False

    def of(self, robot: Recording, rig: Rig) -> Recording:
        """The same motion, seen at the motor's own times."""
        t, wanted = robot.motor.t_s, rig.coarse.gain * robot.motor.q + rig.coarse.offset
        c = hinge(t, wanted) if self.mujoco else wanted
        if self.step_deg > 0.0:
            c = np.round(c / self.step_deg) * self.step_deg
        return Recording("simulated", robot.motor, angle=Angle(t, c))


def hinge(t_s: Array, wanted_deg: Array) -> Array:
    """deg at t_s of a hinge whose drive is told where to be, linear between the times."""
    import mujoco  # type: ignore[import-not-found, unused-ignore]

    model = mujoco.MjModel.from_xml_string(HINGE)
    state = mujoco.MjData(model)
    state.qpos[0] = state.ctrl[0] = np.radians(wanted_deg[0])
    step = model.opt.timestep
    angle_deg = np.empty_like(wanted_deg)
    angle_deg[0] = wanted_deg[0]
    for i in range(1, len(t_s)):
        steps = round((t_s[i] - t_s[0]) / step) - round((t_s[i - 1] - t_s[0]) / step)
        for k in range(1, steps + 1):
            state.ctrl[0] = np.radians(wanted_deg[i - 1] + (wanted_deg[i] - wanted_deg[i - 1]) * k / steps)
            mujoco.mj_step(model, state)
        angle_deg[i] = np.degrees(state.qpos[0])
    return angle_deg


@click.command()
@click.argument("robot", type=click.Path(path_type=Path, exists=True, file_okay=False))
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--rig", "rig_path", type=click.Path(path_type=Path, exists=True), help="Default: ROBOT's rig.toml.")
@click.option("--step", "step_deg", type=float, default=0.088, show_default=True, help="deg, of the joint's sensor.")
@click.option("--mujoco", is_flag=True, help="A hinge of MuJoCo (the package 'mujoco') instead of the coarse law.")
def main(robot: Path, out: Path, rig_path: Path | None, step_deg: float, mujoco: bool) -> None:
    """What a simulator without play, lag or delay would have recorded of ROBOT's motion, for taut diagnose."""
    rig = Rig.load(rig_path or robot / "rig.toml")
    simulated = Rigid(step_deg, mujoco).of(load(robot, rig), rig)
    assert simulated.angle is not None
    out.mkdir(parents=True)
    shutil.copyfile(robot / "motor.csv", out / "motor.csv")
    shutil.copyfile(rig_path or robot / "rig.toml", out / "rig.toml")
    table = pd.DataFrame({"t_s": simulated.angle.t_s, "c_deg": simulated.angle.c_deg})
    table.to_csv(out / "angle.csv", index=False, float_format="%.6f")
    click.echo(f"{out}: {len(table)} rows; taut diagnose {out} {robot} --rig {out / 'rig.toml'} --out DIR")


if __name__ == "__main__":
    main()
