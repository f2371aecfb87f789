"""What a tracker says of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tautline.errors import TautError

SURE_PX = 1e-3  # tolerance: no place is said to be known better


@dataclass(frozen=True)
class Sighting:
    """Where a tracker found the marker, or the place that it follows, in one frame. Where it did not, the numbers (but
    lit_px) are NaN and `lost` says why."""

    u_px: float
    v_px: float
    sigma_px: float  # standard deviation of u and v, per coordinate
    diameter_px: float
    lost: str = ""
    lit_px: tuple[float, float] = (0.0, 0.0)  # share of u, v that corrects for light from one side, by this frame alone

    @property
    def valid(self) -> bool:
        """Whether the marker was found."""
        return not self.lost


def check_in_picture(at: tuple[float, float], width: int, height: int) -> None:
    """TautError where a place (u, v), px, that somebody showed is not in a picture of this size, px."""
    if not (0 <= at[0] < width and 0 <= at[1] < height):
        raise TautError(f"({at[0]:g}, {at[1]:g}) is outside of the picture of {width} x {height} px")


def lost_sighting(why: str) -> Sighting:
    """The sighting of a frame in which the marker was not found: every number NaN. why: the reason in words."""
    return Sighting(u_px=np.nan, v_px=np.nan, sigma_px=np.nan, diameter_px=np.nan, lost=why)
