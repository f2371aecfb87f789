"""Hysteresis of presliding friction, Bouc-Wen's and Dahl's: one state instead of plays, between the envelopes of B.

The equations are in host/native/friction.h. After a reversal the tip starts with a share of its later slope and comes
nearer to the envelope of the other direction as it goes; loops within the backlash do not close.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt

from tautline import _native

Array = npt.NDArray[np.float64]

BOUC_WEN, DAHL = "bouc-wen", "dahl"
KINDS: dict[str, int] = {BOUC_WEN: _native.FRICTION_BOUC_WEN, DAHL: _native.FRICTION_DAHL}
VALUES = ("length", "share", "exponent", "beta")


@dataclass(frozen=True)
class Friction:
    """dz = dq R(z sgn dq) / (length + share B): R(u) = 1 - (beta sgn u + 1 - beta) |u|^exponent, or (1 - u)^exponent of
    Dahl's, which has no beta."""

    kind: str
    length: float  # of the motor's way, its unit
    share: float  # of B
    exponent: float
    beta: float = 1.0

    single: ClassVar[bool] = False  # as of plays: it is not one
    forgotten: ClassVar[float] = 3e-5  # tolerance: of the range, what a start shows by; it forgets by and by

    def __post_init__(self) -> None:
        """Raises ValueError for an unknown kind, numbers that are not finite, an exponent of 0 or less, or a beta
        outside 0 to 1."""
        values = np.array([getattr(self, name) for name in VALUES])
        if self.kind not in KINDS or not (np.isfinite(values).all() and self.exponent > 0.0 and 0 <= self.beta <= 1):
            raise ValueError("friction: Bouc-Wen's or Dahl's, finite, exponent > 0, beta from 0 to 1")

    def says(self, unit: str) -> str:
        """The law and its numbers in words, for a report. unit: of q."""
        name, beta = ("Bouc-Wen's", f", beta {self.beta:.2g}") if self.kind == BOUC_WEN else ("Dahl's", "")
        return f"{name} (exponent {self.exponent:.2g}{beta}, length {self.length:.3g} {unit} + {self.share:.2g} B)"

    @property
    def steepest(self) -> float:
        """R(-1): the rate at which z leaves an envelope after a full reversal, in units of 1 / (length + share B)."""
        return 2.0 * self.beta if self.kind == BOUC_WEN else float(2.0**self.exponent)

    def native(self, grid: Array, width: Array) -> Any:
        """The C object that runs this friction on a backlash table: B width (n,) at positions grid (n,), unit of q."""
        values = (self.length, self.share, self.exponent, self.beta)
        return _native.Plays(grid, width, KINDS[self.kind], *values)

    def to_json(self) -> dict[str, Any]:
        """The fields as plain values, for model.json; Dahl's has no beta."""
        beta = {"beta": self.beta} if self.kind == BOUC_WEN else {}
        return {"kind": self.kind, "length": self.length, "share": self.share, "exponent": self.exponent, **beta}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave. KeyError, TypeError or ValueError where it is something else."""
        values = [float(document[name]) for name in VALUES if name != "beta" or name in document]
        return cls(str(document["kind"]), *values)
