"""A stay of the tip beyond the range that the calibration measured, while the law in use holds elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.tracking.law import OFFSET, LawFamily

Array = npt.NDArray[np.float64]

_FRAMES, _KNOTS = 64, 512  # tolerance: that are looked at together: what one more costs stays below a frame's time


@dataclass
class Visit:
    """The motor's path and the frames of one stay. With each new frame all of them are used again: where the tip was
    carried to depends on the law that they tell."""

    family_before: LawFamily  # what was known of the law when the stay began
    play_before: Any  # native state of the play when it began
    _path: list[float] = field(default_factory=list)  # the motor's positions since it began, unit of q
    _frames: list[tuple[int, float, float]] = field(default_factory=list)  # index in the path; c, deg; its sigma, deg

    @property
    def full(self) -> bool:
        """Whether the visit takes no more frames and knots: looking at all of them with each new frame would exceed a
        frame's time."""
        return len(self._frames) >= _FRAMES or len(self._path) >= _KNOTS

    def move(self, path: Array) -> None:
        """Adds where the motor went since the last frame: positions path (m,), unit of q, in order. Does nothing once
        the visit is `full`."""
        if not self.full:
            self._path += path.tolist()

    def see(self, family: LawFamily, theta: Array, c_deg: float, sigma: float) -> tuple[LawFamily, Any]:
        """Adds a frame at the end of the path: the angle seen and its sigma, deg. Returns the family with what all
        frames of the stay tell, and the state of the play at the end of the path by it. family, theta: of the law in
        use."""
        self._frames.append((len(self._path) - 1, c_deg, sigma))
        at, seen, sigmas = (np.array(column) for column in zip(*self._frames, strict=True))
        q, law = np.array(self._path) + theta[OFFSET], family.law(theta)
        p, _, by = law.followed.run(self.play_before.copy(), q, True)  # by: derivatives, the first one by the offset
        family = self.family_before.with_frames(family, law, p[at], by[at, 1:], seen, sigmas)
        play = self.play_before.copy()
        family.law(theta).followed.run(play, q, True)
        return family, play
