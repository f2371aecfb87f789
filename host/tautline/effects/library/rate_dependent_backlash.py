"""A width that grows with the speed at which the motor goes."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from tautline.effects.kind import Kind, Parameter

Array = npt.NDArray[np.float64]

_USUAL = 0.1  # format: of the tables' grid, a second
# limits of speed_saturation: below it grows by as much with each of three decades of speed; above it is as wide at any
_LEAST, _MOST = -7.0, 3.0
_FOLLOWS_S = 0.02  # format: what speed_time is where a model has none, as in the C


def follows_s(values: Mapping[str, float]) -> float:
    """The time constant, s, with which the width follows the speed: the effect's parameter speed_time, or _FOLLOWS_S
    where `values` has none."""
    return values.get("speed_time", _FOLLOWS_S)


def added_width(values: Mapping[str, float], grid: float, speed: Array) -> Array:
    """(n,) unit of q: what speeds (n,), unit of q per s, add to the width once it has followed them. It is
    width_per_speed u g(speed / u), at least 0, with u = _USUAL grid per s and, for k = speed_saturation, g(x) = x (k =
    0), (1 - exp(-k x)) / (1 - exp(-k)) (k > 0) or log(1 + (exp(-k) - 1) x) / -k (k < 0); as
    host/native/effects/rate_dependent_backlash.c does. grid: length of the model's grid, unit of q."""
    usual = _USUAL * grid
    relative, k = speed / usual, values.get("speed_saturation", 0.0)
    if k == 0.0:
        share = relative
    else:
        share = np.expm1(-k * relative) / np.expm1(-k) if k > 0.0 else np.log1p(np.expm1(-k) * relative) / -k
    return np.maximum(values["width_per_speed"] * usual * share, 0.0)


EFFECTS = (
    Kind(
        "transmission.rate_dependent_backlash",
        (Parameter("width_per_speed", "s", 0.02, low=0.0),),
        (
            Parameter("speed_saturation", "", 0.5, (0.0, 2.0, -4.0), low=_LEAST, high=_MOST),
            Parameter("speed_time", "s", _FOLLOWS_S, (_FOLLOWS_S, 0.2), low=2e-3, high=1.0),
            Parameter("width_held", "", 1.0, (0.0, 1.0), searched=True),
            Parameter("speed_pressed", "", 0.5, (0.5,), low=0.0, high=2.0),
        ),
        says="the width grows with speed",
        material=True,
        undone=True,
        tell="The same reversal is wider when it is driven faster.",
        mend="Calibrate at the speed of use, or drive more slowly through reversals.",
    ),
)
