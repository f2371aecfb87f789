"""What an exported scene leaves against the model's own prediction, in the unit of a diagnosis' gaps."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import trajectory
from tautline.errors import TautError
from tautline.geometry import project
from tautline.io.exporting.mjcf.nominal import Nominal
from tautline.model import Model
from tautline.prediction import predict, settled_from
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

MOTION_S = 20.0  # tolerance: ten ranges at that speed
_SPEED = 0.5  # prior: of the range, 1/s: faster than a motion in use, whose largest error is then within what is said
_SEED = 24  # tolerance: of the motion: any will do


def motion(model: Model, step_s: float) -> Motor:
    """A smooth wander over the motor's range, whose reversals fall anywhere."""
    actuator = model.rig.actuator
    course = trajectory.random_smooth(actuator, _SPEED * actuator.span, MOTION_S, _SEED)
    t_s = np.arange(int(course.duration_s / step_s)) * step_s
    return Motor(t_s, np.interp(t_s, course.t_s, course.q))


def simulate(
    path: Path,
    nominal: Nominal,
    motor: Motor,
    start: Callable[[Any, Any], None],
    lead: Callable[[Any, Any], None] | None,
) -> Array:
    """The tip's angle (n,) deg at the motor's times, which are the scene's steps. `start(model, data)` brings the scene
    to rest; `lead(model, data)`, if any, is called before each step."""
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    start(model, data)
    control = int(model.actuator(nominal.mount.actuator).id)
    places = [(int(model.joint(name).qposadr[0]), sign) for name, sign in nominal.tip]
    angle = np.empty(len(motor.q))
    for k, q in enumerate(motor.q):
        if k:
            data.ctrl[control] = nominal.scale * q
            if lead is not None:
                lead(model, data)
            mujoco.mj_step(model, data)
        angle[k] = sum(sign * data.qpos[place] for place, sign in places)
    if not np.isfinite(angle).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
        raise TautError(f"{path.name}: the simulation does not hold: make the MJCF's timestep shorter")
    return np.degrees(angle)


def error(model: Model, motor: Motor, c_deg: Array, told: Array | None = None) -> tuple[float, float]:
    """rms and largest difference of two angles (n,), once the start no longer matters: px per coordinate with a camera,
    else deg. told: to compare with, by default the model's prediction."""
    told = predict(model, motor, motor.t_s).c_deg if told is None else told
    counted = motor.t_s >= settled_from(model, motor)
    if model.rig.has_camera:
        apart = project(model.rig, c_deg[counted]) - project(model.rig, told[counted])
        off = np.sqrt(np.mean(apart**2, axis=1))
    else:
        off = np.abs(c_deg[counted] - told[counted])
    return math.sqrt(float(np.mean(off**2))), float(off.max())
