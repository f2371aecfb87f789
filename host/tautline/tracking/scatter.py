"""How much the last frames scatter by themselves, whatever the law leaves; and the error that they have in common."""

from __future__ import annotations

from collections import deque

import numpy as np

from tautline import spread

_FRAMES = 400  # tolerance: that tell it
_PRIOR_FRAMES = 20.0  # prior: so many frames say that the noise is the calibration's
_ANEW = 10  # tolerance: frames between two estimates
_LEAN_PACE, _LEANS = 0.1, 0.5  # prior: of a running mean; its share of squares from which it goes on


class Scatter:
    """Estimates `ratio`, the standard deviation of the frames' own noise over the stated one: by the median square of
    third differences of their residuals, in which neither a law's misfit nor its jumps at turns show. O(1) a frame,
    O(_FRAMES) each _ANEW frames."""

    def __init__(self) -> None:
        """Begins without frames: the noise is the stated one."""
        self._last: deque[float] = deque(maxlen=4)  # residuals over sigma, as many as a third difference takes
        self._squares: deque[float] = deque(maxlen=_FRAMES)  # of third differences, each over its variance
        self._new = 0  # frames since the last estimate
        self.ratio = 1.0  # of the noise to the stated one, 1 at least

    def add(self, z: float) -> None:
        """Adds a frame's residual over its stated standard deviation; every _ANEW frames `ratio` is estimated anew."""
        self._last.append(z)
        if len(self._last) == self._last.maxlen:
            first, second, third, fourth = self._last
            third_difference = fourth - first + 3.0 * (second - third)  # equation: 1, -3, 3, -1
            self._squares.append(third_difference**2 / spread.THIRD)
        self._new += 1
        if self._new == _ANEW:
            self._new = 0
            count = len(self._squares)
            squares = count * spread.deviation_of_squares(np.array(self._squares)) ** 2 if count else 0.0
            # The mean square, with the prior's frames at 1.
            self.ratio = max(1.0, float(np.sqrt((_PRIOR_FRAMES + squares) / (_PRIOR_FRAMES + count))))


class CommonError:
    """The error, deg, that the last frames have in common: running means of the residual and of its square."""

    def __init__(self) -> None:
        """Begins without frames."""
        self._mean, self._square = 0.0, 0.0  # deg, deg^2

    def add(self, off_deg: float) -> None:
        """Adds a frame's residual, deg."""
        self._mean += _LEAN_PACE * (off_deg - self._mean)
        self._square += _LEAN_PACE * (off_deg**2 - self._square)

    @property
    def common_deg(self) -> float:
        """The mean residual, deg, if its square is more than the share _LEANS of the mean square; else 0."""
        return self._mean if self._mean**2 > _LEANS * self._square else 0.0
