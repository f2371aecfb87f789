"""What a tracker says of one frame: where it found the marker, or why it did not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tautline.errors import TautError

SURE_PX = 1e-3  # tolerance: no place is said to be known better


@dataclass(frozen=True)
class Sighting:
    """Where a tracker found the marker, or the place that it follows, in one frame. If it did not, u, v, sigma and
    diameter are NaN and `lost` says why."""

    u_px: float
    v_px: float
    sigma_px: float  # standard deviation of u and v, per coordinate
    diameter_px: float
    lost: str = ""  # why it was not found; "" where it was
    lit_px: tuple[float, float] = (0.0, 0.0)  # part of u, v that corrects for light from one side, by this frame alone

    @property
    def valid(self) -> bool:
        """Whether the marker, or the place, was found."""
        return not self.lost


def check_in_picture(at: tuple[float, float], width: int, height: int) -> None:
    """Raises TautError if a place (u, v), px, that somebody showed is not in a picture of this width and height, px."""
    if not (0 <= at[0] < width and 0 <= at[1] < height):
        raise TautError(f"({at[0]:g}, {at[1]:g}) is outside of the picture of {width} x {height} px")


def lost_sighting(why: str) -> Sighting:
    """Returns the sighting of a frame in which the marker was not found: u, v, sigma and diameter are NaN. why: the
    reason in words."""
    return Sighting(u_px=np.nan, v_px=np.nan, sigma_px=np.nan, diameter_px=np.nan, lost=why)
