"""What a sensor's row says of the tip: its bending angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tautline import _native
from tautline.geometry import STRIDE_DEG, projection_rig
from tautline.model import Model
from tautline.rig import Sensor

_TURNS = 12  # tolerance: of Newton's steps
_CLOSE, _FARTHEST = 1e-8, 180.0  # tolerance: deg, of the last step; half a turn
_LEAST_SLOPE = 1e-12  # tolerance: (px/deg)^2, of a tip that the image shows moving


@dataclass(frozen=True)
class AngleEstimate:
    """The bending angle and its standard deviation, deg; `off`: how far the image is from where the marker can be at
    all, in standard deviations."""

    c_deg: float
    sigma: float
    off: float


@dataclass(frozen=True)
class Projection:
    """From the bending angle to the image and back."""

    model: Model
    sensor: Sensor

    @cached_property
    def noise(self) -> float:
        """One standard deviation of a row's noise: px per coordinate of a marker, deg of an angle sensor."""
        return self.model.noise_of(self.sensor)

    @cached_property
    def _rig(self) -> np.ndarray:
        """The rig's numbers as C takes them (`projection_rig`)."""
        return projection_rig(self.model.rig)

    def image(self, c_deg: float, translation: float, rotation: float) -> tuple[float, float]:
        """Marker's position, px, at a bending angle, with the other two axes at `translation` (mm) and `rotation`
        (deg)."""
        px = _native.see({}, self._rig, np.array([c_deg]), np.array([translation]), np.array([rotation]))
        return float(px[0, 0]), float(px[0, 1])

    def from_angle(self, c_deg: float) -> AngleEstimate:
        """An angle sensor's reading, deg, as an estimate, with the sensor's noise as its sigma."""
        return AngleEstimate(c_deg, self.noise, 0.0)

    def from_image(
        self, u: float, v: float, translation: float, rotation: float, near: float, sigma: float = 0.0
    ) -> AngleEstimate | None:
        """The angle whose image is nearest to (u, v), by Newton's method from the angle `near`, deg; sigma: of the
        marker, px, NaN where it is not known. None where the tip would be behind the camera or no angle is found."""
        sigma = max(self.noise, sigma)  # in this order: it is not NaN
        c, off_u, off_v, by_u, by_v, squares = near, 0.0, 0.0, 0.0, 0.0, 0.0
        moved, turned = np.array([translation]), np.array([rotation])
        for _ in range(_TURNS):
            px, by_c, _ = _native.see({}, self._rig, np.array([c]), moved, turned, slopes=True)
            by_u, by_v = float(by_c[0, 0]), float(by_c[0, 1])
            off_u, off_v = u - float(px[0, 0]), v - float(px[0, 1])
            squares = by_u * by_u + by_v * by_v
            if not squares > _LEAST_SLOPE:  # also where it is not in front of the camera
                return None
            step = (by_u * off_u + by_v * off_v) / squares
            c += min(max(step, -STRIDE_DEG), STRIDE_DEG)
            if abs(step) <= _CLOSE:
                break
        if abs(c - near) > _FARTHEST:
            return None
        length = float(np.sqrt(squares))
        return AngleEstimate(c, sigma / length, abs(off_u * by_v - off_v * by_u) / length / sigma)
