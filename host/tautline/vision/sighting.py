"""What a tracker says of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sighting:
    """u, v and sigma_px (per coordinate) are NaN where the marker is lost; `lost` then says why, else it is empty.
    lit_px: of (u, v), by which they allow for light from one side, as this frame alone tells it."""

    u_px: float
    v_px: float
    sigma_px: float
    diameter_px: float
    lost: str = ""
    lit_px: tuple[float, float] = (0.0, 0.0)

    @property
    def valid(self) -> bool:
        return not self.lost


def lost(why: str) -> Sighting:
    return Sighting(np.nan, np.nan, np.nan, np.nan, why)
