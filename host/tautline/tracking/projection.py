"""What a sensor's reading says of the tip: its bending angle."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tautline import _native
from tautline.core.samples import least_noise
from tautline.geometry import STRIDE_DEG, projection_rig
from tautline.model import Model
from tautline.rig import MARKER, Sensor

_TURNS = 12  # tolerance: of Newton's steps
_CLOSE, _FARTHEST = 1e-8, 180.0  # tolerance: deg, of the last step; half a turn
_LEAST_SLOPE = 1e-12  # tolerance: (px/deg)^2, of a tip that the image shows moving


@dataclass(frozen=True)
class AngleEstimate:
    """The bending angle that a reading shows, and its standard deviation `sigma`, deg. `off`: how far the marker is
    from its track in the image, the places at which any angle would put it, in standard deviations."""

    c_deg: float
    sigma: float
    off: float


@dataclass(frozen=True)
class Projection:
    """Turns a bending angle into the marker's place in the image, and readings into angles."""

    model: Model
    sensor: Sensor

    @cached_property
    def noise(self) -> float:
        """Standard deviation of a reading by the calibration: px per coordinate of a marker, deg of an angle sensor. At
        least what a sensor is taken to have, so above 0."""
        return max(self.model.noise_of(self.sensor), least_noise("px" if self.sensor == MARKER else "deg"))

    @cached_property
    def _rig(self) -> np.ndarray:
        """The rig's numbers in the order in which C takes them (`projection_rig`)."""
        return projection_rig(self.model.rig)

    def image(self, c_deg: float, translation: float, rotation: float) -> tuple[float, float]:
        """The marker's place (u, v), px, at the bending angle c_deg, with the other two axes at `translation` (mm) and
        `rotation` (deg)."""
        # {}: no effects.
        px = _native.see({}, self._rig, np.array([c_deg]), np.array([translation]), np.array([rotation]))
        return float(px[0, 0]), float(px[0, 1])

    def from_angle(self, c_deg: float) -> AngleEstimate:
        """An angle sensor's reading, deg, as an estimate, with the sensor's noise as its sigma."""
        return AngleEstimate(c_deg, self.noise, 0.0)

    def from_image(
        self, u: float, v: float, translation: float, rotation: float, near: float, sigma: float = 0.0
    ) -> AngleEstimate | None:
        """The angle whose image is nearest to the marker's place (u, v), px, by Gauss-Newton steps from the angle
        `near`, deg. translation (mm), rotation (deg): of the other axes. sigma: of the place, px per coordinate, NaN
        where it is not known; the calibration's noise counts where that is larger. None where the tip is not in front
        of the camera, the image does not show it move, or the angle found is more than half a turn away."""
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
            step = (by_u * off_u + by_v * off_v) / squares  # least squares of one unknown
            c += min(max(step, -STRIDE_DEG), STRIDE_DEG)
            if abs(step) <= _CLOSE:
                break
        if abs(c - near) > _FARTHEST:
            return None
        px_per_deg = float(np.sqrt(squares))
        off_px = abs(off_u * by_v - off_v * by_u) / px_per_deg  # across the track
        return AngleEstimate(c, sigma / px_per_deg, off_px / sigma)
