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
    """The motor's log on which an export is measured: a smooth random motion over the motor's range, of MOTION_S s,
    with reversals anywhere in it, sampled every step_s s. It is the same at each call."""
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
    """Simulates the MJCF at `path` with the motor following a log whose times are the scene's steps. Returns the tip's
    angle (n,), deg, at each of them; the first one is that after start(model, data), which brings the scene to rest.
    lead(model, data): the callback that is called before each step, None without one. TautError where the simulation is
    unstable."""
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


def error(model: Model, motor: Motor, c_deg: Array, expected_deg: Array | None = None) -> tuple[float, float]:
    """The rms and the largest difference between angles c_deg (n,) at the motor's times and expected_deg (n,), by
    default the model's prediction: px per coordinate if the rig has a camera, else deg. The first part, in which the
    unknown start still matters (`settled_from`), is not counted."""
    expected_deg = predict(model, motor, motor.t_s).c_deg if expected_deg is None else expected_deg
    counted = motor.t_s >= settled_from(model, motor)
    if model.rig.has_camera:
        apart = project(model.rig, c_deg[counted]) - project(model.rig, expected_deg[counted])
        off = np.sqrt(np.mean(apart**2, axis=1))
    else:
        off = np.abs(c_deg[counted] - expected_deg[counted])
    return math.sqrt(float(np.mean(off**2))), float(off.max())
