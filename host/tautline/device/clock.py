"""The board's clock as the host's: from round trips, with an error that is a bound and not a hope."""

from __future__ import annotations

import threading
from collections import deque

import numpy as np

STEADY = 200e-6  # two quartz clocks differ by less than this ratio, whatever is known of them
_KEPT = 512
_TRIPS, _SHORT_TRIPS = 8, 4  # tolerance: round trips, and short ones among them, that a line is drawn through
_SHORT = 1.5  # tolerance: times the shortest: longer ones say less about the offset
_LINE_S = 5.0  # round trips over so long show the drift better than STEADY bounds it


class BoardClock:
    """board time = host time + offset(host time); in a round trip the board's stamp fell between its two ends."""

    def __init__(self) -> None:
        """No round trip yet."""
        self._trips: deque[tuple[float, float, float]] = deque(maxlen=_KEPT)  # middle, offset, half the round trip; s
        self._using = threading.Lock()  # a camera's thread and a sender's

    def add(self, sent_s: float, received_s: float, board_us: int) -> None:
        """One round trip: host times before and after, and the board's time in between."""
        middle = 0.5 * (sent_s + received_s)
        with self._using:
            self._trips.append((middle, board_us * 1e-6 - middle, 0.5 * (received_s - sent_s)))

    def _all(self) -> np.ndarray:
        """The round trips that are kept, the last _KEPT (n, 3): host time at the middle, board less host time there,
        half the round trip; s."""
        with self._using:
            return np.array(self._trips)

    def _line(self) -> tuple[float, float, float, np.ndarray, np.ndarray] | None:
        """A straight line of offset over host time through the shortest round trips, by least squares, which shows how
        fast the clocks drift apart. Returns its mean host time, s, the offset there, s, the drift, s/s, and the trips'
        host times (n,) and half lengths (n,), s. None where they are too few, or span less than _LINE_S."""
        trips = self._all()
        if len(trips) < _TRIPS:
            return None
        trips = trips[trips[:, 2] <= _SHORT * trips[:, 2].min()]
        t, offset, half = trips.T
        if len(t) < _SHORT_TRIPS or np.ptp(t) < _LINE_S:
            return None
        mean = t.mean()
        drift = float(((t - mean) * (offset - offset.mean())).sum() / ((t - mean) ** 2).sum())
        return float(mean), float(offset.mean()), drift, t, half

    def offset(self, host_s: float) -> tuple[float, float]:
        """Board time less host time at `host_s`, s, and the bound of its error while both clocks run evenly, s; 0 and
        inf before any round trip. Of two estimates the one with the smaller bound: a single round trip, whose bound is
        half its length and STEADY times its age, or the line through many."""
        if not self._trips:
            return 0.0, float("inf")
        trips = self._all()
        bounds = trips[:, 2] + STEADY * np.abs(host_s - trips[:, 0])
        best = int(np.argmin(bounds))
        offset, bound = float(trips[best, 1]), float(bounds[best])
        line = self._line()
        if line is not None:
            mean, level, drift, t, half = line
            weight = 1.0 / len(t) + (host_s - mean) * (t - mean) / ((t - mean) ** 2).sum()  # of each trip in the value
            line_bound = float(np.abs(weight) @ half)
            if line_bound < bound:
                offset, bound = level + drift * (host_s - mean), line_bound
        return offset, bound

    @property
    def drift(self) -> float:
        """Rate of the board's clock less 1; 0 until the round trips span 5 s."""
        line = self._line()
        return line[2] if line else 0.0

    def board_us(self, host_s: float) -> int:
        """Board time, us, at a host time, s; never below 0."""
        return max(round((host_s + self.offset(host_s)[0]) * 1e6), 0)
