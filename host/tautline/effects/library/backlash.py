"""A width that is not the model's: another tension, wear, another posture."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model, allowed_width

_NAMES = tuple(f"width_{i}" for i in range(4))  # Chebyshev's polynomials over the motor's range


def _in_the_table(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    low, high = model.rig.actuator.range
    x = np.clip(2.0 * (model.q - low) / (high - low) - 1.0, -1.0, 1.0)
    added = np.polynomial.chebyshev.chebval(x, [values.get(name, 0.0) for name in _NAMES])
    width = model.width * max(0.0, 1.0 + values.get("width_scale", 0.0)) + added
    return replace(model, width=allowed_width(model.q, width))


EFFECTS = (
    Kind(
        "transmission.backlash",
        (Parameter("width_scale", "", 0.1), *(Parameter(name, "unit", 5e-3) for name in _NAMES)),
        says="the backlash is not the model's",
        holds=_in_the_table,
        in_tables=True,
        nominal=True,
        posture=True,
    ),
)
