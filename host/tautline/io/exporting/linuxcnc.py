"""LinuxCNC's table of compensation, both directions, and the lines of its INI file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.folders import whole_file
from tautline.model import Model

Array = npt.NDArray[np.float64]

MOST = 256  # format: triplets that LinuxCNC takes for a joint
_DIGITS = 6  # format: after the point: a millionth of the unit


def write(model: Model, out: Path, joint: str) -> list[Path]:
    """Writes the compensation table to `out`, and the lines for the INI section of `joint` (a number as text) to
    OUT.ini; returns both paths. LinuxCNC moves the motor to nominal + (nominal - forward) while the joint rises, and to
    nominal + (nominal - reverse) while it falls. The nominal position is where f_coarse has the motor for an angle, so
    that the columns hold f_remain and B at once. TautError where `joint` is no number."""
    if not (joint.isascii() and joint.isdigit()):
        raise TautError(f"--axis {joint}: LinuxCNC numbers its joints: name 0, 1, 2, ...")
    nominal, rising, falling = targets(model)
    lines = [  # nominal, forward, reverse
        f"{x:.{_DIGITS}f} {2 * x - up:.{_DIGITS}f} {2 * x - down:.{_DIGITS}f}"
        for x, up, down in zip(nominal, rising, falling, strict=True)
    ]
    unit = model.rig.actuator.unit
    # Comments come last: LinuxCNC stops reading at the first line that is no triplet.
    says = [
        "",
        f"; nominal, forward and reverse, {unit}: COMP_FILE_TYPE = 0. Nominal is the bending angle as f_coarse has it,",
        f"; (c - {model.rig.coarse.offset:.9g}) / {model.rig.coarse.gain:.9g} for c in deg.",
        *(f"; Lost: {what}" for what in loses(model)),
    ]
    ini = [
        f"[JOINT_{joint}]",
        "# Lines for this joint's section; BACKLASH is not used where there is a COMP_FILE.",
        f"COMP_FILE = {out.name}",
        "COMP_FILE_TYPE = 0",
        *(f"# Lost: {what}" for what in loses(model)),
    ]
    beside = out.with_name(out.name + ".ini")
    with whole_file(out) as file, whole_file(beside) as section:
        file.write_text("\n".join([*lines, *says]) + "\n", encoding="ascii")
        section.write_text("\n".join(ini) + "\n", encoding="utf-8")  # a file's name may be of any letters
    return [out, beside]


def targets(model: Model) -> tuple[Array, Array, Array]:
    """The columns of the table, unit of q, (n,) each with n at most MOST: nominal joint positions, rising, and the
    motor positions that reach them while the joint rises and while it falls. It ends where the motor would leave its
    range. TautError where no such table is possible."""
    coarse, (low, high) = model.rig.coarse, model.rig.actuator.range
    if not coarse.gain:
        raise TautError("the rig's coarse.gain is 0: LinuxCNC's table needs a nominal position for each angle")
    half = 0.5 * model.width
    inside = (model.q - half >= low - 1e-9) & (model.q + half <= high + 1e-9)
    if inside.sum() < 2:
        raise TautError("the model's backlash is wider than the motor's range: no table comes of it")
    ends = (model.c_deg[inside][[0, -1]] - coarse.offset) / coarse.gain
    nominal = np.linspace(float(ends.min()), float(ends.max()), min(MOST, max(2, int(inside.sum()))))
    p = model.remaining_inverse(coarse.gain * nominal + coarse.offset)
    width = np.interp(p, model.q, model.width)
    sign = 1.0 if (model.c_deg[-1] - model.c_deg[0]) * coarse.gain > 0 else -1.0  # the motor's way as nominal rises
    return nominal, p + sign * 0.5 * width, p - sign * 0.5 * width


def loses(model: Model) -> list[str]:
    """What the table does not hold of a model, a line each, for file and terminal."""
    lost = [
        "LinuxCNC may exceed the joint's speed and acceleration by half of them while it takes the backlash up",
        f"{len(targets(model)[0])} points stand for {len(model.q)}, straight between them",
    ]
    if not model.elements.single:
        lost.append("the onset is gradual: one play stands for several")
    lost += [f"{effect.id} is not undone" for effect in model.effects if not _in_tables(effect.id)]
    return lost


def _in_tables(effect: str) -> bool:
    """Whether a corrected model holds the effect with this id in its own tables, rig or delay, so that an export does
    not lose it; False for an unknown id."""
    from tautline.effects import BY_ID

    kind = BY_ID.get(effect)
    return kind is not None and kind.holds is not None
