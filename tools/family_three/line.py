"""The one motion that a case runs through: the second family's timeline, with what its encoder's turn is."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.family_two import timeline
from tools.family_two.timeline import Part, Timeline

FloatArray = NDArray[np.float64]
Path = tuple[str, FloatArray, dict[str, FloatArray], FloatArray]  # name, motor, other joints, exposures from its begin


@dataclass(frozen=True)
class Line(Timeline):
    turn: float = 1.0  # units of q for a turn of the encoder's shaft


def lay(paths: list[Path], reach: float, width: float, gain: float, turn: float) -> Line:
    """Recordings one after the other, the motor led from each to the next."""
    return Line(**vars(timeline.lay(paths, reach, width, gain)), turn=turn)


__all__ = ["Line", "Part", "lay"]
