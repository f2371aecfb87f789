"""What a calibration is told beside recordings and rig."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args, get_origin, get_type_hints

import numpy as np

from tautline.calibration.beforehand import Beforehand
from tautline.errors import TautError


@dataclass(frozen=True)
class Options:
    """What a calibration is told beside recordings and rig."""

    delay_s: float | None = None  # given, not estimated
    knots: Literal["smooth", "paper"] = "smooth"  # paper: 14 knots through the onsets alone
    remaining: Literal["direct", "morphological"] = "direct"
    elements: Literal["auto", "one"] = "auto"  # of the play: several where the data ask for them
    beforehand: Beforehand | None = None  # what is known without these recordings

    def __post_init__(self) -> None:
        """Raises TautError if an option is not one of its choices, or the delay is not finite."""
        for name, choices in get_type_hints(Options).items():
            value, allowed = getattr(self, name), get_args(choices)
            if get_origin(choices) is Literal and value not in allowed:
                raise TautError(f"{name} {value!r} is not there: choose one of {', '.join(allowed)}")
        if self.delay_s is not None and not np.isfinite(self.delay_s):
            raise TautError(f"delay_s {self.delay_s} is no time: give seconds, or None to estimate it")
