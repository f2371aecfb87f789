"""How many frames a camera took that never came, told by the gaps between those that did."""

from __future__ import annotations

from collections import deque

import numpy as np

_INTERVALS, _FIRST = 51, 10  # tolerance: of which the camera's period is told, at most and at least
_PAUSE_S, _PAUSE = 0.4, 5.0  # tolerance: longer, and so many periods: nobody read; a camera loses single frames
_KEPT = 0.9  # tolerance: a frame, of its lateness: jitter is made up for, a period that is a little off is not


class Drops:
    """Counts the frames that a camera lost, from the arrival times of the others. The camera's rate may change, and the
    times may be of any clock."""

    def __init__(self) -> None:
        """Begins without frames."""
        self._last_s: float | None = None
        self._intervals: deque[float] = deque(maxlen=_INTERVALS)
        self._behind = 0.0  # periods by which the last frame was late, beyond those counted as lost
        self._missing = 0

    def add(self, t_s: float) -> None:
        """Counts the frames lost before one that arrived at t_s, s, after the last one: by as many of the camera's
        periods as it is late, rounded. Lateness is summed up over frames, so that jitter cancels. A very long gap is a
        pause of the reader, and counts as none."""
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
        # The mean period: each interval is a whole number of periods (0 where two frames came together). The median
        # interval is one period, so that the sum is not 0.
        period = float(intervals.sum() / np.rint(intervals / usual).sum())
        self._behind = _KEPT * self._behind + (t_s - before) / period - 1.0
        missing = round(self._behind)
        self._behind -= missing
        self._missing += missing

    def _is_pause(self, gap_s: float) -> bool:
        """Whether a gap between two frames, s, is so long that nobody read the camera meanwhile, rather than that it
        lost frames. False while the camera's period is not known."""
        if len(self._intervals) < _FIRST:
            return False
        return gap_s > max(_PAUSE_S, _PAUSE * float(np.median(self._intervals)))

    @property
    def count(self) -> int:
        """Frames lost so far; 0 where jitter has made the sum negative."""
        return max(self._missing, 0)
