"""One-joint arms for MuJoCo: a simulator's, and a robot's that MuJoCo steps otherwise."""

import os
from pathlib import Path

import numpy as np

from tautline import trajectory
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Rig
from tautline.simulators import mjcf

ARM = """<mujoco>
  <option timestep="{step_s}" integrator="{integrator}"/>
  <worldbody><body>
    <joint name="elbow" axis="0 1 0" damping="{damping}" frictionloss="{frictionloss}" armature="0.002"/>
    <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.01" mass="0.15"/>
    <site name="tip" pos="0 0 -0.2"/>
  </body></worldbody>
  <actuator><position name="servo" joint="elbow" kp="{kp}" kv="0.02"/></actuator>
</mujoco>
"""
RIG = """format = "rig/1"
[actuator]
unit = "deg"
range = [-60.0, 60.0]
encoder_resolution = 0.02
[coarse]
gain = 1.0
offset = 0.0
"""
NOISE_DEG = 0.03


def write(
    path: Path,
    step_s: float = 0.002,
    integrator: str = "Euler",
    damping: float = 0.05,
    frictionloss: float = 0.01,
    kp: float = 3.0,
) -> Path:
    path.write_text(ARM.format(step_s=step_s, integrator=integrator, damping=damping, frictionloss=frictionloss, kp=kp))
    return path


def rig(folder: Path) -> Rig:
    (folder / "rig.toml").write_text(RIG)
    return Rig.load(folder / "rig.toml")


def process(motor, parameters):  # type: ignore[no-untyped-def]
    """A simulator that says in which process it is run."""
    return np.full(len(motor.t_s), float(os.getpid()))


def ends(motor, parameters):  # type: ignore[no-untyped-def]
    """A simulator that ends the process in which it is run."""
    os._exit(1)


def robot(folder: Path, seed: int, seconds: float, delay_s: float = 0.0, **fault: float) -> Recording:
    """The arm with a fault, stepped eight times as finely by another integrator, seen with noise. Seed 0 is strokes
    with rests, others wander smoothly."""
    path = write(folder / f"robot{seed}.xml", 0.0005, "implicitfast", **fault)  # type: ignore[arg-type]
    arm = mjcf.simulator(path, "servo", "joint:elbow")
    own = rig(folder)
    course = (
        trajectory.random_smooth(own.actuator, 90.0, seconds, seed)
        if seed
        else trajectory.trapezoids(own.actuator, 120.0, 40.0, 6, 600.0, 0.4)
    )
    t_s = np.arange(0.0, course.duration_s, 0.005)
    motor = Motor(t_s, np.interp(t_s, course.t_s, course.q))
    c_deg = arm.tip(motor, {"servo.delay": delay_s})
    seen_s = np.arange(0.1, t_s[-1], 0.02)
    noise = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(seen_s))
    return Recording(f"robot{seed}", motor, angle=Angle(seen_s, np.interp(seen_s, t_s, c_deg) + noise))
