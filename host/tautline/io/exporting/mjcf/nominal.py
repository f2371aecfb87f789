"""The user's MJCF as it is: what bends in it, and what that weighs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.simulators.mjcf import scale_of
from tautline.simulators.scene import joints_of, read_mujoco, tip_of

if TYPE_CHECKING:
    from tautline.io.exporting.export import Mount

Array = npt.NDArray[np.float64]

OWN = "taut_"  # how the names of what is added begin
_POSES = 9  # tolerance: of the tip, over its range, in which its inertia and load are looked at


@dataclass(frozen=True)
class Nominal:
    """What has to be known of the user's MJCF to put a transmission into it."""

    path: Path
    mount: Mount
    scale: float  # of the control, per unit of q
    tip: tuple[tuple[str, float], ...]  # hinges, each with the sign with which it counts
    rest: float  # rad: the tip in the file's own first pose
    inertia: float  # kg m^2: of the tip's hinges together, largest over its range
    load: float  # N m: that acts on them, largest over its range
    timestep: float  # s


def read_nominal(mount: Mount, unit: str, motor: tuple[float, float], tip_rad: Array) -> Nominal:
    """Reads the user's MJCF and finds the actuator and the tip in it. unit: of q; motor: the motor's range, in that
    unit; tip_rad: angles (n,), rad, that the tip takes. TautError where the file, the actuator or the tip is missing,
    an export is in the file already, or the actuator's control range is too small."""
    import mujoco

    if not mount.into.is_file():
        raise TautError(f"{mount.into}: there is no such file: name your MJCF with --into")
    scale = scale_of(mount.scale, unit)
    model = read_mujoco(mount.into)
    if taken := [name for name in joints_of(model) if name.startswith(OWN)]:
        raise TautError(f"{mount.into}: {taken[0]} is in it already: export into the MJCF as it was before")
    _check_actuator(model, mount, scale, unit, motor)
    tip = tip_of(model, mount.into, mount.tip)
    data = mujoco.MjData(model)
    rest = sum(sign * float(data.qpos[model.joint(name).qposadr[0]]) for name, sign in tip)
    inertia, load = _largest_inertia_and_load(model, tip, tip_rad)
    return Nominal(mount.into, mount, scale, tip, rest, inertia, load, float(model.opt.timestep))


def _check_actuator(model: Any, mount: Mount, scale: float, unit: str, motor: tuple[float, float]) -> None:
    """Raises TautError where the actuator is not in the model, or where its control range does not contain the motor's
    range (unit of q) times `scale`."""
    names = [model.actuator(i).name for i in range(model.nu)]
    if mount.actuator not in names:
        raise TautError(f"{mount.into}: has no actuator {mount.actuator}, but {', '.join(names) or 'none at all'}")
    actuator = model.actuator(mount.actuator)
    low, high = sorted(scale * end for end in motor)
    if actuator.ctrllimited[0] and not actuator.ctrlrange[0] - 1e-9 <= low <= high <= actuator.ctrlrange[1] + 1e-9:
        raise TautError(
            f"{mount.into}: {mount.actuator} takes {actuator.ctrlrange[0]:g} to {actuator.ctrlrange[1]:g}, but the "
            f"motor's range is {low:g} to {high:g} there: give --scale, what the control is per {unit} of q"
        )


def _largest_inertia_and_load(model: Any, tip: tuple[tuple[str, float], ...], tip_rad: Array) -> tuple[float, float]:
    """The inertia, kg m^2, and the load, N m, that the transmission carries about the tip's angle: the largest of each
    over the range of tip_rad (n,), rad. Each of the tip's hinges takes an equal share of the angle."""
    import mujoco

    data = mujoco.MjData(model)
    inertia = load = 0.0
    mass_matrix = np.zeros((model.nv, model.nv))
    share = np.zeros(model.nv)  # how much each degree of freedom turns as the tip's angle goes by 1
    for name, sign in tip:
        share[model.joint(name).dofadr[0]] = sign / len(tip)
    for angle in np.linspace(float(tip_rad.min()), float(tip_rad.max()), _POSES):
        for name, sign in tip:
            data.qpos[model.joint(name).qposadr[0]] = sign * angle / len(tip)
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, mass_matrix)
        # By virtual work: inertia share' M share, load share' (bias - passive forces)
        inertia = max(inertia, float(share @ mass_matrix @ share))
        load = max(load, abs(float(share @ (data.qfrc_bias - data.qfrc_passive))))
    return inertia, load
