"""A static law f_remain that is not the model's."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model, monotone
from tautline.splines import Basis

_PIECES = 22  # prior: of a cubic spline over the motor's range: as fine as the law itself is measured again
_NAMES = tuple(f"remaining_{i}" for i in range(_PIECES + 3))


def _in_the_table(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with a spline over p, coefficients remaining_0 .. in deg, added to f_remain, which stays monotone.
    session_s is not used."""
    basis = Basis(*model.rig.actuator.range, _PIECES)
    added = basis.table(np.array([values.get(name, 0.0) for name in _NAMES]), model.q)
    return replace(model, c_deg=monotone(model.c_deg + added))


EFFECTS = (
    Kind(
        "configuration.remaining",
        tuple(Parameter(name, "deg", 1.0) for name in _NAMES),
        says="the static law f_remain is not the model's",
        tell="The gap is a curve over q alone, the same both ways and at all speeds.",
        mend="Calibrate again over the whole range.",
        holds=_in_the_table,
        in_tables=True,
        nominal=True,
        posture=True,
        curve=_NAMES,
        contains=("transmission.offset", "configuration.contact"),
    ),
)
