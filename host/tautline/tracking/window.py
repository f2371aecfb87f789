"""The latest frames as evidence: bounded in number, and thinned where nothing moves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.tracking.path import knots

Array = npt.NDArray[np.float64]

CAPACITY = 6000  # tolerance: entries that are kept
LONGEST = 1500  # tolerance: entries that one fit looks at
STROKES = 24  # tolerance: and strokes
_LONG = 64  # tolerance: positions of a path that are entered even without a frame
_REST_S = 0.2  # prior: between two frames that are kept while the motor rests
_Q, _C, _SIGMA, _T, _STROKE, _OFF = range(6)  # format: of a row


@dataclass(frozen=True)
class WindowKnots:
    """Knots of the motor's path in order, and the frames that saw the tip at some of them. Arrays are (n,) of knots (q)
    or (seen,) of frames (all others)."""

    q: Array
    seen: npt.NDArray[np.intp]
    c_deg: Array
    sigma: Array  # of c_deg, the sensor's
    t_s: Array  # scene times
    stroke: npt.NDArray[np.intp]
    off: Array  # standard deviations off the marker's track
    noise: float = 1.0  # times the stated sigma that frames scatter by themselves

    @property
    def strokes(self) -> npt.NDArray[np.intp]:
        """(k,) The numbers of the strokes that the frames are of, rising, each once."""
        return np.unique(self.stroke)

    def after(self, first: int) -> WindowKnots:
        """Returns the evidence from the frame with index `first` among those seen on."""
        begin = int(self.seen[first])
        c_deg, sigma, t_s = self.c_deg[first:], self.sigma[first:], self.t_s[first:]
        seen, stroke, off = self.seen[first:] - begin, self.stroke[first:], self.off[first:]
        return WindowKnots(self.q[begin:], seen, c_deg, sigma, t_s, stroke, off, self.noise)


class Window:
    """The last CAPACITY entries, or half of them at least: knots of the motor's path, some with a frame. Their numbers
    count from the start of use and never change."""

    def __init__(self, apart: float) -> None:
        """Begins without entries. apart: how far the motor must move between two frames that are kept, unit of q."""
        self._apart = apart
        self._rows = np.empty((CAPACITY, _OFF + 1))
        self._first = 0  # number of row 0
        self._count = 0
        self._kept_q, self._kept_t = np.inf, -np.inf  # motor and time of the last frame that was kept
        self._entered_q = np.nan  # where the path that was entered ends
        self._path_since_entry: list[float] = []
        self.last_q = np.nan  # where the motor's path ends

    @property
    def end(self) -> int:
        """The number of the next entry."""
        return self._first + self._count

    @property
    def path_since_entry(self) -> Array:
        """(n,) The motor's positions since the last entry, unit of q."""
        return np.array(self._path_since_entry)

    def entry_number_at(self, t_s: float, since: int) -> int:
        """The number of the first frame at t_s, s, or later among the entries from `since` on. If there is none,
        `since`, or the number of the oldest entry that is kept where that is later."""
        first = min(max(since - self._first, 0), self._count)
        late = np.flatnonzero(self._rows[first : self._count, _T] >= t_s)
        return self._first + first + (int(late[0]) if len(late) else 0)

    def cut(self) -> None:
        """Ends the motor's path: what comes does not continue it. Positions that were not entered yet are dropped."""
        self._path_since_entry.clear()
        self._kept_q, self._kept_t = np.inf, -np.inf
        self._entered_q = self.last_q = np.nan

    def add_path(self, path: Array, stroke: int) -> None:
        """Adds a piece of the motor's path in this stroke: positions path (n,), n at least 1, unit of q. It is entered
        with the next frame, or once it is long."""
        self._path_since_entry += path.tolist()
        self.last_q = self._path_since_entry[-1]
        if len(self._path_since_entry) > _LONG:
            self._enter_path(stroke)

    def add_frame(self, t_s: float, c_deg: float, sigma: float, off: float, stroke: int) -> bool:
        """Adds a frame at the end of the path, where the motor is: scene time, s; angle and sigma, deg; off: standard
        deviations off the marker's track. Returns whether the frame was kept: it is not if both the motor and the time
        are near those of the last one that was."""
        q = self.last_q
        if abs(q - self._kept_q) < self._apart and t_s - self._kept_t < _REST_S:
            return False
        if self._path_since_entry:
            self._enter_path(stroke)
        row = (q, c_deg, sigma, t_s, stroke, off)
        self._rows[self._count - 1] = row  # the last knot of the path is where the frame is
        self._kept_q, self._kept_t = q, t_s
        return True

    def _enter_path(self, stroke: int) -> None:
        """Enters the path since the last entry, reduced to the points that a play depends on (`knots`)."""
        path = np.array(self._path_since_entry)
        before = self._entered_q if np.isfinite(self._entered_q) else float(path[0])
        for q in knots(before, path[:-1], float(path[-1])).tolist():
            self._enter((q, np.nan, np.nan, np.nan, stroke, np.nan))
        self._entered_q = float(path[-1])
        self._path_since_entry.clear()

    def _enter(self, row: tuple[float, ...]) -> None:
        """Appends a row (q, c_deg, sigma, t_s, stroke, off), NaN where no frame saw the tip. If the window is full, its
        older half is dropped first."""
        if self._count == CAPACITY:
            half = CAPACITY // 2
            self._rows[:half] = self._rows[half:]
            self._first += half
            self._count -= half
        self._rows[self._count] = row
        self._count += 1

    def evidence_since(self, number: int) -> WindowKnots | None:
        """The evidence from the entry with this number on, but at most the last LONGEST entries, and those of the
        present stroke and STROKES before it; it begins with a frame. None for fewer than three frames."""
        first = max(number - self._first, 0, self._count - LONGEST)
        rows = self._rows[first : self._count]
        if len(rows) and rows[0, _STROKE] < rows[-1, _STROKE] - STROKES:
            rows = rows[int(np.searchsorted(rows[:, _STROKE], rows[-1, _STROKE] - STROKES)) :]
        seen = np.flatnonzero(np.isfinite(rows[:, _C]))
        if len(seen) < 3:
            return None
        rows, seen = rows[seen[0] :].copy(), seen - seen[0]
        at = rows[seen]
        return WindowKnots(
            rows[:, _Q], seen, at[:, _C], at[:, _SIGMA], at[:, _T], at[:, _STROKE].astype(np.intp), at[:, _OFF]
        )
