"""How much of the calibrated backlash may be taken up, place by place: what was not passed both ways gets no more."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.model import Model
from tautline.tracking.law import SCALE, SHAPE, Law, LawFamily

Array = npt.NDArray[np.float64]


class TakenUp:
    """`scale` is the least share of B that may be taken up between the reversals that measured it; `dialled` says why
    that is less than what the law in use has, or is "". model: as calibrated, on the grid of its family."""

    def __init__(self, model: Model) -> None:
        """All of the calibrated B may be taken up."""
        self._q = model.q
        self._measured = model.is_measured
        self._allowed = np.ones(len(model.q))  # (nodes,) share of B that may be taken up at each
        self.scale, self.dialled = 1.0, ""

    def as_law(self, family: LawFamily, law: Law, theta: Array, passed: tuple[float, float]) -> None:
        """The share is that of the law of theta, which is in use; of one with a shape no more than before at places
        that were not passed both ways (one without holds everywhere). passed: the lowest and highest centre coordinate
        that were, unit of q."""
        if np.any(theta[SHAPE]):
            share = family.width_ratio(law)
            seen = (self._q >= passed[0]) & (self._q <= passed[1])
            self._allowed = np.where(seen, share, np.minimum(share, self._allowed))
        else:
            self._allowed = np.full(len(self._allowed), theta[SCALE])
        self.take_up_all_allowed(theta)

    def no_more_than(self, theta: Array) -> None:
        """The share is at most the present scale, and that of theta."""
        self._allowed = np.minimum(self._allowed, np.minimum(self.scale, theta[SCALE]))
        self.take_up_all_allowed(theta)

    def take_up_all_allowed(self, theta: Array) -> None:
        """Sets the scale to the least allowed share of B where it was measured; nothing is dialled down any more."""
        self.dialled = ""
        self.scale = float(np.min(self._allowed[self._measured])) if self._measured.any() else float(theta[SCALE])

    def dial_down(self, share: float) -> None:
        """Takes up this share of B at once, as two passes show a narrower one."""
        self.scale = share
        self.dialled = (
            f"transmission.backlash: {100 * share:.0f} % of the calibrated width "
            f"where the tip passed both ways: no more is taken up"
        )
