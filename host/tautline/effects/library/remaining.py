"""A static law f_remain that is not the model's."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model, monotone
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

_PIECES = 66  # prior: of a cubic spline over the motor's range: follows an obstacle's bend (docs/diagnosis.md)
_NAMES = tuple(f"remaining_{i}" for i in range(_PIECES + 3))


def _in_the_table(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with a spline over p, coefficients remaining_0 .. in deg, added to f_remain, which stays monotone.
    session_s is not used."""
    added = _basis(model).table(np.array([values.get(name, 0.0) for name in _NAMES]), model.q)
    return replace(model, c_deg=monotone(model.c_deg + added))


def _slopes(model: Model, values: Mapping[str, float], p: Array) -> Mapping[str, Array]:
    """d f_remain(p) / d amplitude (n,), by name."""
    return dict(zip(_NAMES, _basis(model).between(model.q, p).T, strict=True))


def _basis(model: Model) -> Basis:
    """Of the coefficients, over the motor's range."""
    return Basis(*model.rig.actuator.range, _PIECES)


EFFECTS = (
    Kind(
        "configuration.remaining",
        tuple(Parameter(name, "deg", 1.0) for name in _NAMES),
        says="the static law f_remain is not the model's",
        tell="The gap is a curve over q alone, the same both ways and at all speeds.",
        mend="Calibrate again over the whole range.",
        holds=_in_the_table,
        in_tables="remaining",
        slopes=_slopes,
        nominal=True,
        posture=True,
        curve=_NAMES,
        contains=("transmission.offset", "configuration.contact"),
    ),
)
