"""The motor's strokes: where it turned, and at which frame each stroke began."""

from __future__ import annotations

from collections import deque

import numpy as np

_KEPT = 64  # tolerance: strokes whose begin is known


class Strokes:
    """Follows the motor and numbers its strokes from the start of use. It has turned once it has gone back from its
    extreme by more than `least`, unit of q. Entries are numbers of frames in the window."""

    def __init__(self, least: float) -> None:
        """Begins stroke 0, whose direction is not known yet. least: how far back is a turn, unit of q."""
        self._least = least
        self.number = 0  # of the present one
        self.turned_at = np.inf  # motor position at which it began
        self._way = 0  # 1 rising q, -1 falling, 0 not known
        self._far = np.nan  # the extreme of the present stroke, or its first position while the direction is not known
        self._begins: deque[tuple[int, int]] = deque(maxlen=_KEPT)  # stroke, its first entry

    def begin_recording(self, entry: int) -> None:
        """Begins a new stroke, as the motor may be elsewhere; its direction is not known. A stroke without frames comes
        before it, so that no two strokes in a row are of two recordings. entry: the next one."""
        self._way, self._far, self.turned_at = 0, np.nan, np.inf
        self._begin_stroke(entry)
        self._begin_stroke(entry)

    def follow(self, q: float, entry: int) -> bool:
        """Follows the motor to q, unit of q; returns whether that shows that it has turned, and begins a stroke then.
        entry: the next one."""
        if self._way == 0:
            if np.isnan(self._far):
                self._far = q
            elif abs(q - self._far) > self._least:
                self._way, self._far = (1 if q > self._far else -1), q
        elif self._way * (q - self._far) > 0.0:
            self._far = q
        elif self._way * (self._far - q) > self._least:
            self.turned_at = self._far
            self._way, self._far = -self._way, q
            self._begin_stroke(entry)
            return True
        return False

    def first_entry_of(self, stroke: int, otherwise: int) -> int:
        """The first entry of a stroke, or of the first kept one after it; `otherwise` where there is none."""
        return next((entry for number, entry in self._begins if number >= stroke), otherwise)

    def _begin_stroke(self, entry: int) -> None:
        """Begins the next stroke with this entry."""
        self.number += 1
        self._begins.append((self.number, entry))
