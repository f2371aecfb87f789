"""Corners of one picture found again in another, whatever the light does: what all trackers of a surface are built
on."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.floating[Any]]
Picture = npt.NDArray[np.uint8]

_WINDOW, _LEVELS = 15, 2  # of Lucas-Kanade: px, and pyramid levels above the picture
_AROUND_PX = 31  # two windows: over which light is alike
_MARGIN_PX = 2 * (_AROUND_PX // 2)  # equation: reach of a mean over the distances from a mean, one way
_CAMERA_NOISE = 3.0  # levels, which is not to be enlarged to structure
_MIDDLE, _CONTRAST = 128.0, 42.0  # levels: three times that is in 8 bits
_CORNER_QUALITY = 0.01  # tolerance: of the best corner's
_THERE_AND_BACK_PX = 0.5  # a corner that is not found again from where it was found was not found


def corners_in(grey: Picture, mask: Picture, most: int, apart_px: float) -> Array:
    """Finds corners that can be tracked, (n, 2) px, in a grey picture (height, width) where the mask of the same shape
    is not 0: at most `most`, at least apart_px from each other, best first (Shi-Tomasi)."""
    found = cv2.goodFeaturesToTrack(grey, most, _CORNER_QUALITY, apart_px, mask=mask)
    return np.empty((0, 2)) if found is None else found.reshape(-1, 2).astype(float)


def track_corners(one: Picture, other: Picture, start: Array, guess: Array) -> tuple[Array, npt.NDArray[np.intp]]:
    """Finds the corners `start` (n, 2) px of one grey picture again in the other, around `guess` (n, 2) px, by optical
    flow. Returns their places there (n, 2) px, and the indices (k,) of those to be trusted: the flow back to the first
    picture leads them to within _THERE_AND_BACK_PX of where they were."""
    there, found = _optical_flow(one, other, start, guess)
    back, found_back = _optical_flow(other, one, there, start)
    return there, np.flatnonzero(found & found_back & (np.hypot(*(back - start).T) < _THERE_AND_BACK_PX))


def _optical_flow(one: Picture, other: Picture, start: Array, guess: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Pyramidal Lucas-Kanade flow of the corners `start` (n, 2) px from one grey picture to the other, beginning at
    `guess` (n, 2) px. Returns their places there (n, 2) px, and whether each was found (n,)."""
    there, found, _ = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        start,
        guess.copy(),
        winSize=(_WINDOW, _WINDOW),
        maxLevel=_LEVELS,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    return np.asarray(there), found.ravel() > 0


def even_light(picture: Picture) -> Picture:
    """Returns a BGR picture in grey, (height, width) uint8, with the same brightness and contrast everywhere, so that
    smoke, shade and glow do not shift corners: each pixel less the mean around it, over the standard deviation around
    it (squares of _AROUND_PX)."""
    grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY).astype(np.float32)
    around = (_AROUND_PX, _AROUND_PX)
    detail = grey - cv2.blur(grey, around)
    contrast = np.sqrt(np.maximum(cv2.blur(detail * detail, around), 0.0)) + _CAMERA_NOISE
    return np.asarray(np.clip(_MIDDLE + _CONTRAST * detail / contrast, 0.0, 255.0), dtype=np.uint8)


class EvenLight:
    """A BGR picture as `even_light` makes it, computed only in the parts that are asked for, to save time."""

    def __init__(self, picture: Picture) -> None:
        """picture: BGR (height, width, 3) uint8; nothing is computed yet."""
        self._picture = picture
        self._parts: dict[tuple[int, int, int, int], Picture] = {}

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the picture, px."""
        height, width = self._picture.shape[:2]
        return height, width

    @cached_property
    def whole(self) -> Picture:
        """The whole picture in even light, for a search of a region that was lost."""
        return even_light(self._picture)

    def cut(self, u: float, v: float, size: tuple[int, int]) -> tuple[Picture, Array]:
        """Returns the part of `size` (height, width) px around (u, v) px in even light, the same as in `whole`, moved
        inwards at the picture's border; and the place (u, v) px of its first pixel, (2,)."""
        y0, x0 = (
            int(np.clip(at - 0.5 * long, 0, whole - long))
            for at, long, whole in zip((v, u), size, self.shape, strict=True)
        )
        key = (y0, x0, *size)
        if key not in self._parts:
            # Taken with a margin, so that the means around its pixels are those of the whole picture.
            top, left = max(y0 - _MARGIN_PX, 0), max(x0 - _MARGIN_PX, 0)
            around = self._picture[top : y0 + size[0] + _MARGIN_PX, left : x0 + size[1] + _MARGIN_PX]
            part = even_light(around)[y0 - top :, x0 - left :]
            self._parts[key] = np.ascontiguousarray(part[: size[0], : size[1]])
        return self._parts[key], np.array([x0, y0], dtype=float)
