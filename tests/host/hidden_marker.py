"""Pictures of a marker on a tube, of which something in front hides a part: drawn by itself, truth known."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np

Array = np.ndarray
Cover = Callable[[Array, Array, float], Array]  # x, y px, share of the recording that is over: where it is opaque

WIDTH, HEIGHT = 360, 180
_FINE = 4  # samples a pixel and direction
_MARKER, _TUBE = np.array([62.0, 168.0, 48.0]), np.array([72.0, 75.0, 80.0])  # B, G, R levels
IN_FRONT = np.array([48.0, 52.0, 118.0])
_X, _Y = np.meshgrid(*[(np.arange(size * _FINE) + 0.5) / _FINE - 0.5 for size in (WIDTH, HEIGHT)])


def nothing(x: Array, y: Array, share: float) -> Array:
    return np.zeros(np.broadcast_shapes(x.shape, y.shape), dtype=bool)


def wire_that_stays(x: Array, y: Array, share: float) -> Array:
    return np.abs(x - 200.0 + 0.2 * (y - 90.0)) < 2.0


def wire_that_moves(x: Array, y: Array, share: float) -> Array:
    return np.abs(x - 60.0 - 240.0 * share - 0.3 * (y - 90.0)) < 2.0


def half_for_a_while(x: Array, y: Array, share: float) -> Array:
    return (y < 88.0) & (0.35 < share < 0.65) & (x < WIDTH)


def fold_at_one_end(x: Array, y: Array, share: float) -> Array:
    return x + 0.4 * (y - 90.0) > 246.0


@dataclass(frozen=True)
class Scene:
    """A marker of `diameter` px that goes to and fro over 190 px, and grows by a fifth and tilts (flat) on its way."""

    diameter: float
    flat: bool
    cover: Cover = nothing
    noise: float = 1.5  # levels, rms
    quality: int | None = 90  # of JPEG; None: as drawn
    light: float = 0.0  # share by which a ball is brighter from its middle to the side of the light
    frames: int = 200
    seed: int = 0

    def places(self) -> Array:
        """(frames, 2) px"""
        turn = 2.0 * np.pi * 1.5 * np.arange(self.frames) / self.frames
        return np.column_stack([170.0 - 95.0 * np.cos(turn), 92.0 + 9.0 * np.cos(1.3 * turn + 1.0)])

    def pictures(self) -> Iterator[Array]:
        rng = np.random.default_rng(self.seed)
        tissue = cv2.GaussianBlur(rng.normal(0.0, 1.0, (HEIGHT, WIDTH)), (0, 0), 9.0)
        tissue = np.array([85.0, 92.0, 165.0]) * (1.0 + 0.12 * tissue / tissue.std())[:, :, None]
        for k, place in enumerate(self.places()):
            picture = tissue.copy()
            cv2.line(picture, np.rint(place).astype(int).tolist(), (int(place[0]), HEIGHT), _TUBE.tolist(), 12)
            box = self._around(place)
            fine = tuple(slice(_FINE * s.start, _FINE * s.stop) for s in box)
            x, y = _X[fine], _Y[fine]
            along = (place[0] - 75.0) / 190.0
            half = 0.5 * self.diameter * (0.9 + 0.2 * along)
            squeezed = np.cos(0.25 + 0.6 * along) if self.flat else 1.0
            dx, dy = (x - place[0]) / (half * squeezed), (y - place[1]) / half
            own = (dx**2 + dy**2 < 1.0).astype(np.float32)
            lit = own * (1.0 + self.light * (0.6 * dx - 0.6 * dy)).astype(np.float32)
            own, lit = _coarse(own), _coarse(lit)
            patch = picture[box]
            patch[:] = patch * (1.0 - own) + lit * _MARKER
            over = _coarse(self.cover(_X, _Y, k / self.frames).astype(np.float32))
            picture = cv2.GaussianBlur(picture * (1.0 - over) + over * IN_FRONT, (0, 0), 0.7)
            picture = np.clip(np.rint(picture + rng.normal(0.0, self.noise, picture.shape)), 0, 255).astype(np.uint8)
            if self.quality is not None:
                coded = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, self.quality])[1]
                picture = cv2.imdecode(coded, cv2.IMREAD_COLOR)
            yield picture

    def _around(self, place: Array) -> tuple[slice, slice]:
        """Rows and columns that hold the marker."""
        reach = int(0.6 * self.diameter) + 3
        u, v = np.rint(place).astype(int)
        return slice(v - reach, v + reach + 1), slice(u - reach, u + reach + 1)


def _coarse(fine: Array) -> Array:
    """Means over a pixel (rows, columns, 1)."""
    size = (fine.shape[1] // _FINE, fine.shape[0] // _FINE)
    return cv2.resize(fine, size, interpolation=cv2.INTER_AREA)[:, :, None]
