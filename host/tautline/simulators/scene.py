"""Reading an MJCF or URDF file: its joints, what they carry, and the hinges that make the tip."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError

if TYPE_CHECKING:
    import mujoco

_SERVO_HZ = 10.0  # prior: of an arm's usual servo: what it has is told by the robot
_G = 9.81  # limit: m/s^2, gravity
_NO_LOAD = 1e-3  # tolerance: of the weight, at the model's size as its arm
_PARALLEL = 0.999  # tolerance: cosine between axes that count as one


def check_mujoco() -> None:
    """Raises TautError, which says how to install it, where MuJoCo is not installed; it is optional."""
    if find_spec("mujoco") is None:
        raise TautError(
            "--simulator needs the package mujoco: pip install 'tautline-robotics[simulator]', or pip install mujoco"
        )


def read_mujoco(path: Path) -> mujoco.MjModel:
    """The compiled model of an MJCF or URDF file. TautError where MuJoCo cannot read it."""
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        raise TautError(f"{path}: MuJoCo cannot read it ({' '.join(str(error).split())})") from error


def with_servo(path: Path, joint: str) -> mujoco.MjModel:
    """The compiled model of a file without actuators (as a URDF is) with a position servo added that drives `joint` and
    has its name. The servo is critically damped and has a natural frequency of _SERVO_HZ at the inertia that the joint
    carries in the file's own pose. TautError where there is no such hinge or slide."""
    import mujoco

    bare = read_mujoco(path)
    possible = [each for each in filter(None, joints_of(bare)) if _is_hinge_or_slide(bare, each)]
    if joint not in possible:
        names = ", ".join(possible) or "but it has no hinge or slide with a name"
        raise TautError(f"{path}: has no actuators: name a joint that a servo shall hold with --actuator, {names}")
    data = mujoco.MjData(bare)
    mujoco.mj_forward(bare, data)
    mass_matrix = np.zeros((bare.nv, bare.nv))
    mujoco.mj_fullM(bare, data, mass_matrix)
    dof = int(bare.joint(joint).dofadr[0])
    inertia, rate = float(mass_matrix[dof, dof]), 2.0 * math.pi * _SERVO_HZ
    kp, kv = inertia * rate**2, 2.0 * inertia * rate
    spec = mujoco.MjSpec.from_file(str(path))
    servo = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    servo.biastype = mujoco.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0], servo.biasprm[1], servo.biasprm[2] = kp, -kp, -kv
    return spec.compile()


def joints_of(model: mujoco.MjModel) -> list[str]:
    """The names of all joints in the model's order; "" for a joint without a name."""
    return [str(model.joint(i).name) for i in range(model.njnt)]


def _is_hinge_or_slide(model: mujoco.MjModel, joint: str) -> bool:
    """Whether a joint is a hinge or a slide, not a ball or a free joint."""
    import mujoco

    return int(model.joint(joint).type[0]) in (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def joints_above(model: mujoco.MjModel, site: str) -> list[int]:
    """The numbers of the joints that move a site, the one nearest to the world first."""
    above: list[int] = []
    body = int(model.site(site).bodyid[0])
    while body:
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        above[:0] = range(first, first + count)
        body = int(model.body_parentid[body])
    return above


def check_named(path: Path, kind: str, name: str, names: list[str]) -> None:
    """Raises TautError, which lists `names`, where `name` is not one of them. names: those in the file of this kind
    (such as "actuator")."""
    if name not in names:
        raise TautError(f"{path}: has no {kind} {name}, but {', '.join(filter(None, names)) or 'none at all'}")


def carried_by(model: mujoco.MjModel, joint: str) -> npt.NDArray[np.int64]:
    """The numbers of the bodies that move with a joint: the one that it belongs to first, then all below that in the
    tree."""
    own = int(model.joint(joint).bodyid[0])
    carried = [own]
    for body in range(own + 1, model.nbody):  # bodies are numbered after their parents
        if int(model.body_parentid[body]) in carried:
            carried.append(body)
    return np.array(carried, dtype=np.int64)


def carries_weight(model: mujoco.MjModel, data: mujoco.MjData, joint: str) -> bool:
    """Whether the weight of the bodies that a joint carries can load it, so that their mass shows in the motion. Slide:
    gravity along its axis is above _NO_LOAD of g. Hinge: the largest moment of the weight about its axis, over all
    angles of this joint, is above _NO_LOAD of m g times the model's extent, m being their mass. data: after mj_forward;
    axis and centre of mass are those of its pose."""
    import mujoco

    at, body = int(model.joint(joint).id), int(model.joint(joint).bodyid[0])
    axis, gravity = data.xaxis[at], np.array(model.opt.gravity)
    if model.jnt_type[at] == mujoco.mjtJoint.mjJNT_SLIDE:
        return bool(abs(axis @ gravity) > _NO_LOAD * _G)
    # Both parts across the axis: as the joint turns, their largest moment is across * arm (per unit of mass).
    across = np.linalg.norm(np.cross(axis, gravity))
    arm = np.linalg.norm(np.cross(axis, data.subtree_com[body] - data.xanchor[at]))
    return bool(across * arm > _NO_LOAD * _G * float(model.stat.extent))


def tip_of(model: mujoco.MjModel, path: Path, named: str) -> tuple[tuple[str, float], ...]:
    """The names of the hinges whose angles add up to the tip's, each with its sign, 1 or -1. named: joint:NAME for a
    single hinge, or site:NAME for all hinges above a site that have no actuator of their own. TautError where a name is
    not in the file, or such hinges do not turn about one axis. path: the file's, for messages."""
    import mujoco

    kind, _, name = named.partition(":")
    if kind not in ("joint", "site") or not name:
        raise TautError(f"--tip {named}: expected joint:NAME or site:NAME")
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    if kind == "joint":
        joints = [model.joint(i) for i in range(model.njnt)]
        check_named(path, "hinge", name, [str(joint.name) for joint in joints if joint.type[0] == hinge])
        return ((name, 1.0),)
    check_named(path, "site", name, [str(model.site(i).name) for i in range(model.nsite)])
    driven = {
        int(model.actuator_trnid[i, 0])
        for i in range(model.nu)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT
    }
    above = [i for i in joints_above(model, name) if model.jnt_type[i] == hinge and i not in driven]
    if not above:
        raise TautError(f"{path}: no free hinge is above the site {name}: name what bends with --tip joint:NAME")
    if unnamed := [i for i in above if not model.joint(i).name]:
        raise TautError(f"{path}: hinge {unnamed[0]} above the site {name} has no name: give it one")
    cosines = _cosines_to_first(model, above)
    if (np.abs(cosines) < _PARALLEL).any():
        other = model.joint(above[int(np.argmin(np.abs(cosines)))]).name
        raise TautError(
            f"{path}: {other} and {model.joint(above[0]).name} above the site {name} turn about different axes: "
            "name what bends with --tip joint:NAME"
        )
    return tuple((str(model.joint(i).name), float(np.sign(cosine))) for i, cosine in zip(above, cosines, strict=True))


def _cosines_to_first(model: mujoco.MjModel, joints: list[int]) -> npt.NDArray[np.float64]:
    """The cosines (n,) of the angles between each joint's axis and that of the first joint, in the model's zero pose: 1
    where both turn the same way, -1 where they turn against each other. joints: their numbers."""
    import mujoco

    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return np.asarray(data.xaxis[joints] @ data.xaxis[joints[0]])
