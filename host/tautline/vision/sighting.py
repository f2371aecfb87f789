"""What a tracker says of one frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SURE_PX = 1e-3  # tolerance: no place is said to be known better


@dataclass(frozen=True)
class Sighting:
    """All but lit_px are NaN where the marker is lost; `lost` then says why, else it is empty. sigma_px is one standard
    deviation per coordinate. lit_px: how much of (u, v) is the correction for light from one side, px, as this frame
    alone tells it; (0, 0) without."""

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
    """A frame without the marker: every number NaN. why: in words."""
    return Sighting(np.nan, np.nan, np.nan, np.nan, why)
