"""A tip that is late, behind what friction holds or by drag beside friction."""

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from tautline.effects.kind import Kind, Parameter

Array = npt.NDArray[np.float64]


def width_by_drag(values: Mapping[str, float], speed: Array) -> Array:
    """(n,) The width, unit of q, that viscous drag beside friction (lag_held) seems to add at speeds (n,), unit of q
    per s: 2 lag (1 - lag_second) speed, as the tip trails by half of it in either direction."""
    return np.asarray(2.0 * values["lag"] * (1.0 - values.get("lag_second", 0.0)) * speed)


EFFECTS = (
    Kind(
        "transmission.lag",
        (Parameter("lag", "s", 0.02, low=0.0, high=5.0),),  # prior: longer is creep
        (
            Parameter("lag_second", "", 0.2, (0.0, 0.5), low=0.0, high=0.5),
            Parameter("lag_held", "", 1.0, (0.0, 1.0), searched=True),
        ),
        says="the tip lags, viscous, first order",
        material=True,
        undone=True,
        tell="The gap goes with speed, has its sign, and is gone when the motor rests; a wrong delay does that too, "
        "but also moves the images of other axes.",
        mend="Drive more slowly, or feed the lag forward in the controller.",
    ),
)
