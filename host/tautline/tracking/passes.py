"""B where the tip passed both ways: the distance between two passes of a place, whatever the offset, and B
elsewhere."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from tautline.model import Model
from tautline.tracking.fit import AHEAD, FOLLOWS, SURE
from tautline.tracking.law import OFFSET, Law

Array = npt.NDArray[np.float64]

_CELLS = 16  # tolerance: in a mean B
_MOST_CELLS = 4096  # tolerance: wider ones where B is narrow: a question is asked within a frame's time
_WINDOW = 12  # loss: cells that are judged together
_GAP = 1.0  # limit: of B: frames of a pass that are farther apart leave a hole
_OFF = 1.5  # prior: standard deviations off the marker's track (rms): then it is no motion of the play
_LEAST = 0.02  # loss: of B, that is worth a message
_LATE, _SIGMA, _OFF_SQUARE, _SPACING, _ENTRY = range(5)  # format: what is kept of a pass


@dataclass(frozen=True)
class Narrowing:
    """The least share of the calibrated B that two passes of one place leave, and its standard deviation."""

    share: float
    sigma: float


class _Frame(NamedTuple):
    """What `Passes.add` keeps of a frame for the next one."""

    q: float  # of the motor, unit of q
    y: float  # the tip by the calibrated f_remain, unit of q
    sigma: float  # of y
    off: float  # standard deviations off the marker's track
    stroke: int


class Passes:
    """For each place the last pass of the tip on its way up, and on its way down: by how much the motor was ahead. O(1)
    a frame, O(places) a question."""

    def __init__(self, model: Model, width: float) -> None:
        """Begins without passes. width: the mean B, unit of q; a cell is 1/_CELLS of it, or 1/_MOST_CELLS of the grid
        where that is more."""
        grid = model.q
        self._low = float(grid[0])
        self._model, self._cell = model, max(width / _CELLS, (float(grid[-1]) - self._low) / _MOST_CELLS)
        count = int((float(grid[-1]) - self._low) / self._cell) + 1
        # (places,) Centre coordinates of the cells by the calibrated f_remain: each is one place in the image.
        self.place = self._low + self._cell * np.arange(count)
        self._b = np.interp(self.place, grid, model.width)  # (places,) the calibrated B there
        # (way: rising q, falling; what is kept; place) of the last pass, NaN where there was none. A place lies between
        # two successive frames. Kept are: _LATE, way (q - place), unit of q, by which the motor is ahead of the tip;
        # _SIGMA, standard deviation of the tip's place, the larger one of the two frames; _OFF_SQUARE, the mean over
        # both of the square of how many standard deviations the marker is off its track; _SPACING, how far the tip
        # moved between both, unit of q; _ENTRY, the later frame's number.
        self._passes = np.full((2, _ENTRY + 1, count), np.nan)
        self._law: Law | None = None  # that `narrowing` was last asked about
        # (places,) The centre coordinates of the cells by that law, and half of its B there.
        self._by_law, self._half = np.empty(0), np.empty(0)
        self._last: _Frame | None = None  # None where the next frame continues no stroke
        self._moves = False  # whether the tip moved with the motor from the frame before it to the last one

    def clear(self) -> None:
        """Forgets all passes, and the last frame."""
        self._passes.fill(np.nan)
        self.cut()

    def cut(self) -> None:
        """Forgets the last frame: the next one does not continue its stroke, so that no cells are filled between
        them."""
        self._last, self._moves = None, False

    def add(self, q: float, y: float, sigma: float, off: float, stroke: int, travel: float, entry: int) -> None:
        """Adds a frame: the cells between the last frame and it are filled, if both are of one stroke and the tip moved
        with the motor to both of them, by no more than _GAP of B. q: of the motor; y: of the tip by the calibrated
        f_remain, sigma: its standard deviation; all in the unit of q. off: standard deviations off the marker's track;
        travel: the motor's way since it turned, over the widest element's share of B, unit of q: below B the play may
        not be on its envelope, and nothing is filled; entry: the frame's number."""
        last, self._last = self._last, _Frame(q, y, sigma, off, stroke)
        moved, self._moves = self._moves, False
        if last is None or last.stroke != stroke or travel < float(np.interp(y, self.place, self._b)):
            return
        by_q, by_y = q - last.q, y - last.y
        if not abs(by_q) > SURE * float(np.hypot(sigma, last.sigma)):
            return
        self._moves = FOLLOWS < by_y / by_q < AHEAD
        if not (self._moves and moved):  # the first one may hold an onset
            return
        way = 1.0 if by_q > 0.0 else -1.0
        first, end = (round((v - self._low) / self._cell) for v in (min(y, last.y), max(y, last.y)))
        cells = slice(max(first, 0), min(end + 1, len(self.place)))
        if abs(by_y) > _GAP * self._cell * _CELLS or cells.stop <= cells.start:
            return
        share = (self.place[cells] - last.y) / by_y  # of the way between both frames: the motor is interpolated
        kept = self._passes[0 if way > 0.0 else 1]
        kept[_LATE, cells] = way * (last.q + share * by_q - self.place[cells])
        kept[_SIGMA, cells] = max(sigma, last.sigma)
        kept[_OFF_SQUARE, cells] = 0.5 * (off**2 + last.off**2)
        kept[_SPACING, cells] = abs(by_y)
        kept[_ENTRY, cells] = entry

    def narrowing(self, law: Law, theta: Array, level: float, since: int) -> Narrowing | None:
        """The least share of the calibrated B at the places where the tip is clearly ahead of the law in use (theta) on
        its last passes both ways since the entry `since`; an offset would put it behind on one of them. Where B is no
        more than its passes' sigma, or 0, there is no share. level: rms of residuals over sigma that the law leaves.
        None where it is ahead nowhere, or by less than the share _LEAST of the law's B."""
        late = self._lateness(law, theta, since)
        sigma = level * self._passes[:, _SIGMA]
        first = self._windows_ahead(late, sigma, level)
        if len(first) == 0:
            return None
        inside = np.zeros(len(self._b), dtype=bool)  # whether a cell is in any of these windows
        for i in range(_WINDOW):
            inside[first + i] = True
        of_both = np.hypot(*sigma)
        cells = np.flatnonzero(inside & (self._b > of_both))
        if len(cells) == 0:
            return None
        b, half = self._b[cells], self._half[cells]
        share = 2.0 * (late.max(0)[cells] + half) / b  # of B, by the pass that is less ahead
        at = int(np.argmin(share))
        least = max(float(share[at]), 0.0)
        if least > (1.0 - _LEAST) * 2.0 * half[at] / b[at]:
            return None
        return Narrowing(least, float(of_both[cells[at]] / b[at]))

    def _lateness(self, law: Law, theta: Array, since: int) -> Array:
        """(2, places) By how much the motor was farther ahead of the tip than a law (theta) has it on its envelopes,
        unit of q, on the last pass of each place on either way: below 0 the tip is ahead of the law. NaN where it did
        not pass since the entry `since`. The places by the law are kept for the next question about it."""
        if law is not self._law:
            self._law = law
            self._by_law = law.place(self._model.remaining(self.place))
            self._half = 0.5 * np.interp(self._by_law, law.grid, law.width)
        # On the law's envelope way (q + offset - by_law) = B/2, so that _LATE = way (q - place) = B/2 + way shift.
        shift = self._by_law - self.place - theta[OFFSET]
        late: Array = self._passes[:, _LATE] - self._half
        late[0] -= shift
        late[1] += shift
        late[self._passes[:, _ENTRY] < since] = np.nan
        return late

    def _windows_ahead(self, late: Array, sigma: Array, level: float) -> npt.NDArray[np.intp]:
        """Indices of the windows, _WINDOW cells from that index on, over which the tip was clearly ahead of the law in
        the mean on both ways, and the marker on its track. late, sigma (2, places): from `_lateness`, and its standard
        deviation, unit of q; level: rms of residuals over sigma that the law leaves."""
        mean = _window_means(late)
        if not (mean < 0.0).all(0).any():
            return np.empty(0, dtype=np.intp)
        # Standard deviation of a window's mean, by as many frames as were on its cells.
        length = _WINDOW * self._cell
        off = _window_means(sigma) * np.minimum(np.sqrt(_window_means(self._passes[:, _SPACING]) / length), 1.0)
        on_track = _window_means(self._passes[:, _OFF_SQUARE]) < (_OFF * level) ** 2
        return np.flatnonzero((on_track & (mean < -SURE * off)).all(0))


def _window_means(rows: Array) -> Array:
    """(2, n - _WINDOW + 1) Means of rows (2, n) over each _WINDOW neighbouring cells; NaN where one of them was not
    passed."""
    count = rows.shape[1] - _WINDOW + 1
    total = rows[:, :count].copy()
    for i in range(1, _WINDOW):
        total += rows[:, i : i + count]
    return np.asarray(total / _WINDOW)
