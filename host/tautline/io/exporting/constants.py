"""The one number for a backlash that printers and mills take: Marlin, FluidNC's draft, Klipper's draft."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.special import ndtr

from tautline.errors import TautError
from tautline.folders import whole_file
from tautline.model import Model

_QUANTILE = 1.0 / 11.0  # loss: too much is ten times as bad as too little: the least expected loss is at this one
_BISECTIONS = 60  # tolerance: to the last bit of a width
_AXES = "xyzabc"
_SMOOTH_S = 0.005  # format: Klipper's own example of smooth_time


@dataclass(frozen=True)
class Constant:
    """One number in place of B(q), in the unit of q."""

    width: float  # the number
    least: float  # the smallest, largest and mean B where it was measured
    most: float
    mean: float
    left_rms: float  # of B less the number, where B was measured


def constant(model: Model) -> Constant:
    """The constant that stands best for B(q) over the places where B was measured: that of least expected loss, where
    too much costs ten times as much as too little and B has its own standard deviation. This is the quantile _QUANTILE
    of B over these places, found by bisection. TautError where B was measured nowhere."""
    low, high = model.measured
    inside = (model.q >= low) & (model.q <= high)
    if not inside.any():
        raise TautError("the model's B was measured nowhere: calibrate with reversals, then export")
    width, sigma = model.width[inside], np.maximum(model.width_sigma[inside], 1e-12)
    below, above = 0.0, float(width.max() + 6.0 * sigma.max())  # 6 sigma: as good as certain
    for _ in range(_BISECTIONS):
        middle = 0.5 * (below + above)
        # Expected share of the places with B below `middle`; ndtr is the normal distribution function.
        share = float(np.mean(ndtr((middle - width) / sigma)))
        below, above = (middle, above) if share < _QUANTILE else (below, middle)
    number = round(below, 6)
    left = width - number
    rms = float(np.sqrt(np.mean(left**2)))
    return Constant(number, float(width.min()), float(width.max()), float(width.mean()), rms)


def loses(model: Model) -> list[str]:
    """What one number does not hold of a model, a line each, for file and terminal. TautError as of `constant`."""
    number, unit = constant(model), model.rig.actuator.unit
    lost = [
        f"B(q) goes from {number.least:.4g} to {number.most:.4g} {unit}, {number.mean:.4g} in the mean: one "
        f"number leaves {number.left_rms:.3g} {unit} rms; it is chosen low, because too much is worse than too little",
        "f_remain, the law behind the backlash: the axis keeps its own steps per unit",
    ]
    if not model.elements.single:
        lost.append("the onset is gradual: one play stands for several")
    return lost + [f"{effect.id} is not undone" for effect in model.effects]


def write_marlin(model: Model, out: Path, axis: str) -> list[Path]:
    """Writes to `out` the lines for Marlin's Configuration_adv.h, and as a comment the command that sets the same at
    run time. axis: x, y or z, else a TautError. Returns the files written."""
    letter = _axis_letter(axis)
    if letter not in "xyz":
        raise TautError(f"--axis {axis}: Marlin takes backlash up on x, y and z")
    width = constant(model).width
    numbers = ", ".join(f"{width:.6g}" if each == letter else "0" for each in "xyz")
    _write_file(
        out,
        "//",
        model,
        [
            "#define BACKLASH_COMPENSATION",
            f"#define BACKLASH_DISTANCE_MM {{ {numbers} }}",
            "#define BACKLASH_CORRECTION 1.0",
            "#define BACKLASH_GCODE",
            f"// At run time: M425 F1 {letter.upper()}{width:.6g}",
        ],
    )
    return [out]


def write_fluidnc(model: Model, out: Path, axis: str) -> list[Path]:
    """Writes to `out` a part of FluidNC's config.yaml, in the form of its proposal for backlash. axis: a letter of
    _AXES, else a TautError. Returns the files written."""
    width = constant(model).width
    _write_file(
        out,
        "#",
        model,
        [
            "# For a FluidNC that was built with its backlash proposal (pull request 24); others refuse the key.",
            "axes:",
            f"  {_axis_letter(axis)}:",
            f"    backlash: {width:.6g}",
        ],
    )
    return [out]


def write_klipper(model: Model, out: Path, axis: str) -> list[Path]:
    """Writes to `out` a part of Klipper's printer.cfg, in the form of its draft of backlash compensation. axis: x, y or
    z, else a TautError. Returns the files written."""
    letter = _axis_letter(axis)
    if letter not in "xyz":
        raise TautError(f"--axis {axis}: Klipper's draft takes backlash up on x, y and z")
    width = constant(model).width
    _write_file(
        out,
        "#",
        model,
        [
            "# For a Klipper that was built with its draft of backlash compensation (pull request 7259).",
            "[backlash_compensation]",
            f"smooth_time: {_SMOOTH_S:g}",
            f"{letter}_backlash: {width:.6g}",
            f"# At run time: SET_BACKLASH_COMPENSATION {letter.upper()}_BACKLASH={width:.6g}",
        ],
    )
    return [out]


def _axis_letter(name: str) -> str:
    """The axis of --axis as a lower-case letter of _AXES. TautError where it is another text."""
    letter = name.lower()
    if letter not in [*_AXES]:
        raise TautError(f"--axis {name}: name one of {', '.join(_AXES)}")
    return letter


def _write_file(out: Path, mark: str, model: Model, lines: list[str]) -> None:
    """Writes `lines` to `out`, whole or not at all, below comments that say what the number is and what it loses of the
    model. mark: begins a comment in this file."""
    low, high = model.measured
    unit = model.rig.actuator.unit
    header = [
        f"{mark} The full backlash of a reversal, {unit}, from B(q) measured over {low:.4g} to {high:.4g} {unit}.",
        *(f"{mark} Lost: {what}" for what in loses(model)),
    ]
    with whole_file(out) as file:
        file.write_text("\n".join([*header, *lines]) + "\n", encoding="ascii")
