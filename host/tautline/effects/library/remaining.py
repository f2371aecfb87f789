"""A static law that is not the model's."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model, monotone

# Chebyshev's polynomials over the motor's range; the constant one is an offset.
_NAMES = tuple(f"remaining_{i}" for i in range(1, 5))


def _in_the_table(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    low, high = model.rig.actuator.range
    x = np.clip(2.0 * (model.q - low) / (high - low) - 1.0, -1.0, 1.0)
    added = np.polynomial.chebyshev.chebval(x, [0.0, *(values.get(name, 0.0) for name in _NAMES)])
    return replace(model, c_deg=monotone(model.c_deg + added))


EFFECTS = (
    Kind(
        "configuration.remaining",
        tuple(Parameter(name, "deg", 1.0) for name in _NAMES),
        says="the static law f_remain is not the model's",
        holds=_in_the_table,
        in_tables=True,
        nominal=True,
        posture=True,
    ),
)
