"""How much the frames of the moment scatter by themselves, whatever the law leaves."""

from __future__ import annotations

from collections import deque

import numpy as np

from tautline.driven import white_noise

_FRAMES = 400  # tolerance: that tell it
_PRIOR_FRAMES = 20.0  # prior: so many frames say that the noise is the calibration's
_ANEW = 10  # tolerance: frames between two estimates


class Scatter:
    """The standard deviation of the frames' own noise over the stated one, 1 at least: by `white_noise` of their
    residuals, in which neither a law's misfit nor its jumps at turns show. O(1) a frame, O(_FRAMES) each _ANEW
    frames."""

    def __init__(self) -> None:
        self._z: deque[float] = deque(maxlen=_FRAMES + 3)
        self._new = 0
        self.times = 1.0

    def add(self, z: float) -> None:
        """Adds a frame's residual over its stated standard deviation."""
        self._z.append(z)
        self._new += 1
        if self._new == _ANEW:
            self._new = 0
            kept, count = np.array(self._z), len(self._z) - 3
            squares = count * white_noise(np.arange(len(kept), dtype=np.float64), kept) ** 2
            self.times = max(1.0, float(np.sqrt((_PRIOR_FRAMES + squares) / (_PRIOR_FRAMES + count))))
