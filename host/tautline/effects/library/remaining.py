"""A static law f_remain that is not the model's."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.effects.kind import Kind, Parameter
from tautline.effects.spline import RangeSpline
from tautline.model import Model, monotone

Array = npt.NDArray[np.float64]

_PIECES = 66  # prior: of a cubic spline over the motor's range: follows an obstacle's bend (docs/diagnosis.md)
_SPLINE = RangeSpline("remaining", _PIECES)


def _with_remaining(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with a spline over p (coefficients remaining_0, remaining_1 and so on, deg) added to f_remain; the sum
    is made monotone. session_s is not used."""
    return replace(model, c_deg=monotone(model.c_deg + _SPLINE.on_grid(model, values)))


def _remaining_slopes(model: Model, values: Mapping[str, float], p: Array) -> Mapping[str, Array]:
    """{name of an amplitude: (n,) derivative of f_remain, deg, by it at the play's centres p (n,), unit of q}."""
    return _SPLINE.slopes(model, p)


EFFECTS = (
    Kind(
        "configuration.remaining",
        tuple(Parameter(name, "deg", 1.0) for name in _SPLINE.names),
        says="the static law f_remain is not the model's",
        tell="The gap is a curve over q alone, the same both ways and at all speeds.",
        mend="Calibrate again over the whole range.",
        holds=_with_remaining,
        in_tables="remaining",
        slopes=_remaining_slopes,
        nominal=True,
        posture=True,
        curve=_SPLINE.names,
        contains=("transmission.offset", "configuration.contact"),
    ),
)
