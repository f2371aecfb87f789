"""The offset between the board's clock and the host's, from round trips, with a bound of its error."""

from __future__ import annotations

import threading
from collections import deque
from typing import NamedTuple

import numpy as np

STEADY = 200e-6  # two quartz clocks differ by less than this ratio, whatever is known of them
_KEPT = 512  # round trips
_TRIPS, _SHORT_TRIPS = 8, 4  # tolerance: round trips, and short ones among them, that a line is drawn through
_SHORT = 1.5  # tolerance: times the shortest round trip: longer ones say less about the offset
_LINE_S = 5.0  # round trips over so long a time show the drift better than STEADY bounds it


class _Line(NamedTuple):
    """A straight line of the clocks' offset over host time, through n round trips."""

    mean_s: float  # the trips' mean host time
    offset_s: float  # board less host time, there
    drift: float  # s/s
    t_s: np.ndarray  # (n,) host time of each trip
    half_s: np.ndarray  # (n,) half the length of each


class BoardClock:
    """board time = host time + offset(host time); in a round trip the board's stamp fell between its two ends."""

    def __init__(self) -> None:
        """Begins without a round trip."""
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)  # middle, offset, half the round trip; s
        self._using = threading.Lock()  # a camera's thread and a sender's

    def add(self, sent_s: float, received_s: float, board_us: int) -> None:
        """Takes in a round trip: the host's times before and after it, s, and the board's in between, us."""
        middle = 0.5 * (sent_s + received_s)
        with self._using:
            self._trips.append((middle, board_us * 1e-6 - middle, 0.5 * (received_s - sent_s)))

    def _kept_trips(self) -> np.ndarray:
        """Returns the last _KEPT round trips (n, 3): host time at the middle, board time less host time there, half the
        round trip; s."""
        with self._using:
            return np.array(self._trips)

    def _fit_line(self) -> _Line | None:
        """Fits a line by least squares through the shortest round trips: its slope is how fast the clocks drift apart.
        None where these are too few, or span less than _LINE_S."""
        trips = self._kept_trips()
        if len(trips) < _TRIPS:
            return None
        trips = trips[trips[:, 2] <= _SHORT * trips[:, 2].min()]
        t_s, offset_s, half_s = trips.T
        if len(t_s) < _SHORT_TRIPS or np.ptp(t_s) < _LINE_S:
            return None
        mean_s = t_s.mean()
        drift = float(((t_s - mean_s) * (offset_s - offset_s.mean())).sum() / ((t_s - mean_s) ** 2).sum())
        return _Line(float(mean_s), float(offset_s.mean()), drift, t_s, half_s)

    def offset(self, host_s: float) -> tuple[float, float]:
        """Returns board time less host time at `host_s`, s, and the bound of its error while both clocks run evenly, s;
        0 and inf before any round trip. Of two estimates it takes the one with the smaller bound: a single round trip,
        whose bound is half its length plus STEADY times its age, or the line through many."""
        if not self._trips:
            return 0.0, float("inf")
        trips = self._kept_trips()
        bounds = trips[:, 2] + STEADY * np.abs(host_s - trips[:, 0])
        best = int(np.argmin(bounds))
        offset, bound = float(trips[best, 1]), float(bounds[best])
        line = self._fit_line()
        if line is not None:
            away, ahead = line.t_s - line.mean_s, host_s - line.mean_s
            weight = (
                1.0 / len(away) + ahead * away / (away**2).sum()
            )  # of each trip's offset in the line's value at host_s
            line_bound = float(np.abs(weight) @ line.half_s)  # as if every trip erred by all of its bound
            if line_bound < bound:
                offset, bound = line.offset_s + line.drift * ahead, line_bound
        return offset, bound

    @property
    def drift(self) -> float:
        """How much faster the board's clock runs than the host's, s/s; 0 until the round trips span _LINE_S."""
        line = self._fit_line()
        return line.drift if line else 0.0

    def board_us(self, host_s: float) -> int:
        """Board time, us, at a host time, s; never below 0."""
        return max(round((host_s + self.offset(host_s)[0]) * 1e6), 0)
