"""A cause as the third family has it, with this family's mechanisms, and what several share."""

from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray

from tools.family_four.slide import play
from tools.family_three.causes import base as third
from tools.family_three.causes.base import axis, follow, gates, rising, swings, tested
from tools.family_three.line import Line, Part
from tools.family_two.motion import STEP

if TYPE_CHECKING:
    from tools.family_four.mechanism import Demand, Mechanism

FloatArray = NDArray[np.float64]


class Cause(third.Cause):
    """One thing that is wrong; `act` is where it acts on the mechanism."""

    strongest: ClassVar[float] = 90.0  # times the noise that it is set to

    def act(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        """What the mechanism is asked."""


def side(x: FloatArray, travel: float) -> FloatArray:
    """-1 to 1: which way x last moved, turned over within `travel`."""
    half = 0.5 * travel
    return np.asarray((x - play(x - half, x + half, float(x[0]))) / half)


__all__ = ["STEP", "Cause", "Line", "Part", "axis", "follow", "gates", "play", "rising", "side", "swings", "tested"]
