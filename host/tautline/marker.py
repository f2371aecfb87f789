"""The marker tracker: where a coloured marker is in each frame, to a few hundredths of a pixel, and how surely."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from tautline.colour import SMALLEST_PX, MarkerColour

Array = np.ndarray

_LOW, _HIGH = 0.25, 0.75  # relative memberships at which a pixel begins to count and counts in full
_FAINT = 0.3  # of the picked contrast: fainter is no marker
_SIGNAL = 6.0  # contrast to noise: below it no marker
_SHRUNK, _GROWN = 0.4, 2.2  # area against the running one that is still the same marker
_RAGGED = 1.35  # 4 pi sqrt(det covariance) / area: 1 for a filled ellipse, more with holes, notches and bits apart
_NOISE_EVERY = 8  # frames between measurements of the noise


@dataclass(frozen=True)
class Sighting:
    """u, v and sigma_px (per coordinate) are NaN where the marker is lost; `lost` then says why, else it is empty."""

    u_px: float
    v_px: float
    sigma_px: float
    diameter_px: float
    lost: str = ""

    @property
    def valid(self) -> bool:
        return not self.lost


def _lost(why: str) -> Sighting:
    return Sighting(np.nan, np.nan, np.nan, np.nan, why)


class Tracker:
    """Follows one marker from frame to frame. It looks around where the marker should be, and over the whole frame when
    it is not there.
    """

    def __init__(self, colour: MarkerColour) -> None:
        self.colour = colour
        self._row = np.array([[*colour.weights, colour.offset]], dtype=np.float32)
        self._quantum = float(np.linalg.norm(colour.weights)) / np.sqrt(12.0)
        self._last: Sighting | None = None
        self._step = (0.0, 0.0)  # px since the frame before
        self._levels = (0.0, 1.0)  # membership of what is around the marker, and of the marker
        self._noise = self._quantum
        self._age = 0

    def track(self, picture: Array) -> Sighting:
        """The marker in the next frame, BGR (height, width, 3) uint8."""
        last = self._last
        if last is not None:
            speed = max(abs(self._step[0]), abs(self._step[1]))
            found = self._measure(picture, last.u_px + self._step[0], last.v_px + self._step[1], last.diameter_px, speed)
            if found.valid:
                self._step = (found.u_px - last.u_px, found.v_px - last.v_px)
                self._last = found
                return found
        found = self._search(picture)
        self._step = (0.0, 0.0)
        self._last = found if found.valid else None
        return found

    def _measure(self, picture: Array, u: float, v: float, diameter: float, speed: float, fresh: bool = False) -> Sighting:
        height, width = picture.shape[:2]
        half = int(0.75 * diameter + 6.0 + speed)
        column, row = round(u), round(v)
        x0, x1 = max(0, column - half), min(width, column + half + 1)
        y0, y1 = max(0, row - half), min(height, row + half + 1)
        if x1 - x0 < 8 or y1 - y0 < 8:
            return _lost("out of the picture")
        y = cv2.transform(picture[y0:y1, x0:x1].astype(np.float32), self._row)
        if self._age % _NOISE_EVERY == 0 or fresh:
            self._noise = max(self._quantum, _noise(y))
        self._age += 1

        around = float(np.median(np.concatenate([y[0], y[-1], y[:, 0], y[:, -1]])))
        middle = 0.5 * (self._levels[0] + self._levels[1])
        _, inside = cv2.threshold(y, middle, 255, cv2.THRESH_BINARY)
        inside = inside.astype(np.uint8)
        within = cv2.mean(y, inside)[0]
        contrast = within - around
        if contrast < max(_FAINT, _SIGNAL * self._noise):
            return _lost("no marker of this colour")
        self._levels = (around, within)
        scale = 1.0 / ((_HIGH - _LOW) * contrast)
        share = (y - (around + _LOW * contrast)) * scale
        np.clip(share, 0.0, 1.0, out=share)
        m = cv2.moments(share)
        area = m["m00"]
        if area <= 0:
            return _lost("no marker of this colour")
        cx, cy = m["m10"] / area, m["m01"] / area
        soft = cv2.inRange(share, 1e-6, 1.0 - 1e-6)
        n = cv2.moments(soft, True)
        weight = (self._noise * scale / area) ** 2
        var_u = weight * (n["mu20"] + n["m00"] * (n["m10"] / max(n["m00"], 1) - cx) ** 2)
        var_v = weight * (n["mu02"] + n["m00"] * (n["m01"] / max(n["m00"], 1) - cy) ** 2)
        sigma = float(np.sqrt(0.5 * (var_u + var_v)))
        return Sighting(x0 + cx, y0 + cy, sigma, float(np.sqrt(4 * area / np.pi)))

    def _search(self, picture: Array) -> Sighting:
        y = self.colour.membership(picture)
        y = cv2.GaussianBlur(y, (0, 0), 2.0)
        _, top, _, at = cv2.minMaxLoc(y)
        if top < _FAINT:
            return _lost("no marker of this colour")
        return self._measure(picture, at[0], at[1], self.colour.diameter_px, 4.0, fresh=True)


def _noise(y: Array) -> float:
    """Rms noise of a pixel, from second differences in both directions (they see no slope and little texture)."""
    d = y[1:] - y[:-1]
    d = d[1:] - d[:-1]
    d = d[:, 1:] - d[:, :-1]
    d = d[:, 1:] - d[:, :-1]
    return float(1.4826 * np.median(np.abs(d)) / 6.0)
