"""How much of the calibrated backlash may be taken up, place by place: what was not passed both ways gets no more."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.model import Model
from tautline.tracking.law import SCALE, SHAPE, Law, LawFamily

Array = npt.NDArray[np.float64]


class TakenUp:
    """`scale` is the least share of B that may be taken up between the reversals that measured it; `why_dialled` says
    why that is less than what the law in use has, or is ""."""

    def __init__(self, model: Model) -> None:
        """Begins with all of the calibrated B allowed. model: as calibrated, on the grid of its family."""
        self._q = model.q
        self._measured = model.is_measured
        self._allowed = np.ones(len(model.q))  # (nodes,) share of B that may be taken up at each
        self.scale, self.why_dialled = 1.0, ""

    def follow_law(self, family: LawFamily, law: Law, theta: Array, passed: tuple[float, float]) -> None:
        """Sets the allowed share of B at each node to what the law in use has there, and takes all of it up. Where that
        law changes B by a curve over q (theta[SHAPE] is not 0), the share grows only at places that were passed both
        ways. law: that of `theta` (PARAMETERS,), as law.py has it, in `family`; passed: the lowest and the highest
        centre coordinate that were passed both ways, unit of q."""
        if np.any(theta[SHAPE]):
            share = family.width_ratio(law)
            seen = (self._q >= passed[0]) & (self._q <= passed[1])
            self._allowed = np.where(seen, share, np.minimum(share, self._allowed))
        else:
            self._allowed = np.full(len(self._allowed), theta[SCALE])
        self.take_up_all_allowed(theta)

    def limit_to(self, theta: Array) -> None:
        """Lowers the allowed share of B, where it is above the present scale or that of theta (PARAMETERS,), to the
        lesser of the two, and takes all of it up."""
        self._allowed = np.minimum(self._allowed, np.minimum(self.scale, theta[SCALE]))
        self.take_up_all_allowed(theta)

    def take_up_all_allowed(self, theta: Array) -> None:
        """Sets the scale to the least allowed share of B where B was measured, or to that of theta (PARAMETERS,) if it
        was measured nowhere; ends a dialling down."""
        self.why_dialled = ""
        self.scale = float(np.min(self._allowed[self._measured])) if self._measured.any() else float(theta[SCALE])

    def dial_down(self, share: float) -> None:
        """Sets the scale to this share of B, as two passes of one place show a narrower B, until a law is adopted or
        trusted again; sets `why_dialled`."""
        self.scale = share
        self.why_dialled = (
            f"transmission.backlash: {100 * share:.0f} % of the calibrated width "
            f"where the tip passed both ways: no more is taken up"
        )
