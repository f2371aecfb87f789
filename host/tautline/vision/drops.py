"""How many frames a camera took that never came: by the gaps between those that did."""

from __future__ import annotations

from collections import deque

import numpy as np

_INTERVALS, _FIRST = 51, 10  # tolerance: of which the camera's period is told, at most and at least
_PAUSE_S, _PAUSE = 0.4, 5.0  # tolerance: longer, and so many periods: nobody read; a camera loses single frames
_KEPT = 0.9  # tolerance: a frame, of its lateness: jitter is made up for, a period that is a little off is not


class Drops:
    """Counts the frames that a camera lost, from the arrival times of the others. The camera's rate may change, and its
    clock be any."""

    def __init__(self) -> None:
        """No frame has come yet."""
        self._last_s: float | None = None
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._behind = 0.0  # periods by which the last frame was late, beyond those counted as lost
        self._missing = 0

    def add(self, t_s: float) -> None:
        """Takes in a frame that arrived at t_s, after the last one. By how many of the camera's periods it is late, so
        many were lost; lateness is summed up, so that jitter cancels. A very long gap is a pause of the reader and
        counts as none."""
        before, self._last_s = self._last_s, t_s
        if before is None:
            return
        if self._is_pause(t_s - before):
            self._intervals.clear()
            self._behind = 0.0
            return
        self._intervals.append(t_s - before)
        intervals = np.array(self._intervals)
        usual = float(np.median(intervals))
        if len(intervals) < _FIRST or usual <= 0.0:
            return
        # Whole periods, 0 of a frame that came together with the one before; the median is one, so there is a sum.
        period = float(intervals.sum() / np.rint(intervals / usual).sum())
        self._behind = _KEPT * self._behind + (t_s - before) / period - 1.0
        missing = round(self._behind)
        self._behind -= missing
        self._missing += missing

    def _is_pause(self, gap_s: float) -> bool:
        """Whether a gap between two frames, s, is so long that nobody read meanwhile, instead of the camera losing
        frames. False while the camera's period is not known."""
        if len(self._intervals) < _FIRST:
            return False
        return gap_s > max(_PAUSE_S, _PAUSE * float(np.median(self._intervals)))

    @property
    def count(self) -> int:
        """Frames lost so far; never below 0, where jitter takes the sum."""
        return max(self._missing, 0)
