"""Keyframes of a picture that moves: the nearest of them say together how it has moved, and in the end all agree, so
that errors do not add up along a motion that comes back.

What a keyframe shows, and what a motion is, is the tracker's own: a region's shift in `patch`, the world's turn in
`scene`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array

Array = npt.NDArray[np.floating[Any]]
Key = TypeVar("Key")
Seen = TypeVar("Seen")

_NEAREST = 2  # tolerance: keyframes that say together
_ASKED = 4  # tolerance: as a near one may see nothing
_LEAST_WEIGHT = 1e-6  # tolerance: of the only one that sees something
_HELD = 1e-3  # prior: pictures' worth that a keyframe is where it was taken


class Keyframes(Generic[Key]):
    """Of one tracker, the first one where motions begin. Distances between them have no unit: from 1 on a new one is
    worth taking."""

    def __init__(self, first: Key, most: int, reach: float) -> None:
        """most: that are kept. reach: the distance within which a keyframe says something."""
        self.keys, self._most, self._reach = [first], most, reach
        self.learns = True
        self._differ: list[tuple[int, int, Array]] = []  # two keyframes, and by how much they differ (k,)

    @property
    def has_room(self) -> bool:
        """Whether a new one may be taken."""
        return self.learns and len(self.keys) < self._most

    def nearest(
        self, away: Sequence[float], see: Callable[[Key], Seen | None], beyond: bool = False
    ) -> list[tuple[float, int, Seen]]:
        """What the nearest keyframes see, two at most: (weight, the keyframe's number, what `see` makes of it). Weights
        fall to 0 at the reach: one that comes within it or leaves it changes nothing at once. Where a third one takes
        the second one's place, what they say jumps by a part of what they differ by; weights that fall to 0 there make
        more noise than they save. away: (n,) distances of all of them. beyond: where none within the reach sees
        anything, the nearest one beyond it that does, alone."""
        found: list[tuple[float, int, Seen]] = []
        for k in np.argsort(away, kind="stable")[:_ASKED].tolist():
            weight = max(self._reach - float(away[k]), 0.0) ** 2
            if len(found) == _NEAREST or (not weight and (found or not beyond)):
                break
            seen = see(self.keys[k])
            if seen is not None:
                found.append((max(weight, _LEAST_WEIGHT), k, seen))
        return found

    def note(self, one: int, other: int, off: Array) -> None:
        """Two keyframes have seen one picture, and the first says `off` (k,) more than the other; kept while
        learning."""
        if self.learns:
            self._differ.append((one, other, off))

    def settle(self) -> tuple[Array, Array] | None:
        """Ends learning. By how much each keyframe is to be shifted (n, k), the first one fixed, so that they differ
        least in the pictures that two of them saw (least squares); and the scatter (n,), a coordinate, of each about
        the others then. None where no picture was seen by two."""
        self.learns = False
        if not self._differ:
            return None
        one, other = np.array([(i, j) for i, j, _ in self._differ]).T
        off = np.array([by for _, _, by in self._differ])
        n, m = len(self.keys), len(off)
        ones, rows = np.ones(m), np.arange(m)
        told = coo_array((ones, (rows, one)), (m, n)) - coo_array((ones, (rows, other)), (m, n))
        normal = (told.T @ told).toarray() + _HELD * np.eye(n)
        normal[0, 0] += m  # the first one is where it was taken
        by = -np.linalg.solve(normal, told.T @ off)
        left2 = np.mean((off + told @ by) ** 2, axis=1) / 2.0  # of both keyframes
        seen = np.bincount(one, minlength=n) + np.bincount(other, minlength=n)
        total = np.bincount(one, left2, n) + np.bincount(other, left2, n)
        return by, np.sqrt(total / np.maximum(seen, 1))
