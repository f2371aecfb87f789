"""What a sensor's row says of the tip: the centre coordinate at which the model would show it there."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tautline import _native
from tautline.effects.simulation import sight_rig
from tautline.model import Model, interpolate
from tautline.rig import MARKER, Sensor

_TURNS = 12
_CLOSE = 1e-9  # of the range
_LEAST_SLOPE = 1e-6
_NOTHING = {"px": 0.05, "deg": 0.02}  # noise of a model that was not calibrated


@dataclass(frozen=True)
class Seen:
    """The tip's centre coordinate y and its standard deviation, the rig's unit; `off`: how far the image is from where
    the marker can be at all, in standard deviations."""

    y: float
    sigma: float
    off: float


@dataclass(frozen=True)
class Sight:
    """From the centre coordinate to the image (or the angle) and back."""

    model: Model
    sensor: Sensor

    @cached_property
    def noise(self) -> float:
        """Of one row, px or deg: what the calibration left, its sensor's noise."""
        evidence = self.model.extra.get("evidence", {})
        known = [evidence.get(name) for name in ("residual", "error")]
        found = [float(value) for value in known if value is not None and np.isfinite(value) and value > 0.0]
        if found and self.sensor == self.model.sensor:
            return max(found)
        return _NOTHING["px" if self.sensor == MARKER else "deg"]

    @cached_property
    def _rig(self) -> np.ndarray:
        return sight_rig(self.model.rig)

    def angle(self, p: float) -> float:
        return float(interpolate(p, self.model.q, self.model.c_deg))

    def slope(self, p: float) -> float:
        """df_remain/dp, deg per unit, where p is."""
        grid, c = self.model.q, self.model.c_deg
        i = min(max(int(np.searchsorted(grid, p, side="right")) - 1, 0), len(grid) - 2)
        return float((c[i + 1] - c[i]) / (grid[i + 1] - grid[i]))

    def image(self, c_deg: float, translation: float, rotation: float) -> tuple[float, float]:
        px = _native.see({}, self._rig, np.array([c_deg]), np.array([translation]), np.array([rotation]))
        return float(px[0, 0]), float(px[0, 1])

    def from_angle(self, c_deg: float, sigma: float | None = None) -> Seen:
        y = float(self.model.remaining_inverse(c_deg))
        return Seen(y, (sigma or self.noise) / max(abs(self.slope(y)), _LEAST_SLOPE), 0.0)

    def from_image(
        self, u: float, v: float, translation: float, rotation: float, near: float, sigma: float | None = None
    ) -> Seen | None:
        """Looked for from `near` on. None where no tip is seen there."""
        sigma = max(sigma or 0.0, self.noise)
        span = self.model.rig.actuator.span
        y, off_u, off_v, by_u, by_v, squares = near, 0.0, 0.0, 0.0, 0.0, 0.0
        for _ in range(_TURNS):
            px, by_c, _ = _native.see(
                {},
                self._rig,
                np.array([self.angle(y)]),
                np.array([translation]),
                np.array([rotation]),
                slopes=True,
            )
            slope = self.slope(y)
            by_u, by_v = float(by_c[0, 0]) * slope, float(by_c[0, 1]) * slope
            off_u, off_v = u - float(px[0, 0]), v - float(px[0, 1])
            squares = by_u * by_u + by_v * by_v
            if not squares > 0.0:  # also where it is not in front of the camera
                return None
            step = (by_u * off_u + by_v * off_v) / squares
            y += min(max(step, -0.2 * span), 0.2 * span)
            if abs(step) <= _CLOSE * span:
                break
        if abs(y - near) > 2.0 * span:
            return None
        length = float(np.sqrt(squares))
        return Seen(y, sigma / length, abs(off_u * by_v - off_v * by_u) / length / sigma)
