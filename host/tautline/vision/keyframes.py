"""Keyframes of a picture that moves: the nearest ones together tell how it has moved, and in the end all are made to
agree, so that errors do not add up along a motion that comes back.

What a keyframe shows, and what a motion is, is defined by the tracker: a region's shift in `patch`, the world's turn in
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
    """The keyframes of one tracker, which adds to `keys`; motions are told from the first one on. Distances between
    keyframes, which the tracker defines, have no unit: from 1 on a new keyframe is worth taking."""

    def __init__(self, first: Key, most: int, reach: float) -> None:
        """most: how many keyframes are kept; reach: the distance up to which a keyframe is used."""
        self.keys, self._most, self._reach = [first], most, reach
        self.learns = True  # until `settle`: keyframes are added and their differences noted
        self._differences: list[
            tuple[int, int, Array]
        ] = []  # numbers of two keyframes, and by how much they differ (k,)

    @property
    def has_room(self) -> bool:
        """Whether a new keyframe may be added."""
        return self.learns and len(self.keys) < self._most

    def nearest(
        self, away: Sequence[float], see: Callable[[Key], Seen | None], beyond: bool = False
    ) -> list[tuple[float, int, Seen]]:
        """Returns what the nearest keyframes see, two at most, as (weight, the keyframe's number, what `see` gave for
        it); keyframes for which `see` gives None are left out. away: (n,) distances of all keyframes. Weights fall to 0
        at the reach, so that nothing jumps as a keyframe comes within it. beyond: if none within the reach sees
        anything, the nearest one beyond it that does is returned, alone. Where a third keyframe takes the second one's
        place there is a small jump; weights that fall to 0 there, too, would make more noise than they save."""
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
        """Notes for `settle` that two keyframes, given by their numbers, have seen the same picture, and that the
        motion by the first is greater by `off` (k,). Does nothing after `settle`."""
        if self.learns:
            self._differences.append((one, other, off))

    def settle(self) -> tuple[Array, Array] | None:
        """Ends learning and adjusts the n keyframes to each other by least squares, so that they differ least in the
        pictures that two of them saw. Returns by how much each is to be shifted (n, k), about 0 for the first one, and
        the rms (n,), per coordinate, by which each still differs from the others then. None where no picture was seen
        by two."""
        self.learns = False
        if not self._differences:
            return None
        one, other = np.array([(i, j) for i, j, _ in self._differences]).T
        off = np.array([by for _, _, by in self._differences])
        n, m = len(self.keys), len(off)
        ones, rows = np.ones(m), np.arange(m)
        # Row by row: shift of one less shift of the other, which is to cancel `off`.
        design = coo_array((ones, (rows, one)), (m, n)) - coo_array((ones, (rows, other)), (m, n))
        normal = (design.T @ design).toarray() + _HELD * np.eye(n)
        normal[0, 0] += m  # holds the first one where it was taken
        shift = -np.linalg.solve(normal, design.T @ off)
        left2 = np.mean((off + design @ shift) ** 2, axis=1) / 2.0  # shared between both keyframes
        seen = np.bincount(one, minlength=n) + np.bincount(other, minlength=n)
        total = np.bincount(one, left2, n) + np.bincount(other, left2, n)
        return shift, np.sqrt(total / np.maximum(seen, 1))
