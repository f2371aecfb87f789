"""Whether a law still foretells frames: the odds that it has not since some frame, kept up from frame to frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ONSET = 2.0  # limit: of B, the motor's way from a turn in which an onset, however gradual, is over
MEMORY_S = 4.0  # prior: of what moves the tip beside the motor: a breath, a hand, tissue that is met
_SHARE = 0.05  # prior: of strokes in which the tip is elsewhere
_FREEDOM = 2.0  # prior: numbers of any size that say where it is in one
_UNSURE = 1.8  # prior: of the calibration's squares, what the same law may leave of another motion
CAP = 36.0  # prior: of one frame's square: alone, as an outlier may be, it raises no doubt
JUMP = 4.0  # prior: log odds against something that begins in a stroke: in one of 50


@dataclass
class Doubt:
    """Page's cumulative sum of log odds that the law holds no more, over parts of the recording: strokes, or pieces of
    MEMORY_S of them. In each part either the residuals are noise, or the tip is elsewhere, by a distance of which every
    size is as likely."""

    since: int = 0  # the entry from which it is in doubt
    _odds: float = 0.0  # log odds by the parts before this one
    _part: tuple[int, int] = (-1, 0)  # the present part: its stroke, and its number in that
    _squares: float = 0.0  # sum of the squared residuals of the part's frames, in standard deviations
    _count: int = 0  # the part's frames

    def clear(self, entry: int) -> None:
        """Forgets all doubt: frames count from this entry of the window on."""
        self.since, self._odds = entry, 0.0
        self._part, self._squares, self._count = (-1, 0), 0.0, 0

    @property
    def odds_of_part(self) -> float:
        """Log odds, by the frames of the present part alone, that the law changed: (x - _FREEDOM log(1 + x)) / 2 +
        log(_SHARE / (1 - _SHARE)), with x = max(S / _UNSURE - n, 0). S: sum of the n frames' squared residuals, in
        standard deviations, each cut at CAP. The first logarithm is the price of _FREEDOM fitted numbers that say where
        the tip is instead; the second one is the prior. 0 without frames."""
        if not self._count:
            return 0.0
        beyond = max(self._squares / _UNSURE - self._count, 0.0)
        return 0.5 * (beyond - _FREEDOM * float(np.log1p(beyond))) + float(np.log(_SHARE / (1.0 - _SHARE)))

    @property
    def odds(self) -> float:
        """Log odds that the law has not held since entry `since`: the sum over the parts before, which never falls
        below 0, plus those of the present part, which may be negative."""
        return self._odds + self.odds_of_part

    def add(self, z: float, stroke: int, t_s: float, entry: int) -> None:
        """Adds a frame with residual z, standard deviations, in this stroke at t_s, s. entry: its number in the window.
        The first frame of a new part adds the odds of the part before to the sum; if the sum is 0 then, `since` becomes
        this entry."""
        part = stroke, int(t_s / MEMORY_S)
        if part != self._part:
            self._odds = max(self._odds + self.odds_of_part, 0.0)
            if self._odds == 0.0:
                self.since = entry
            self._part, self._squares, self._count = part, 0.0, 0
        self._squares += min(z * z, CAP)
        self._count += 1
