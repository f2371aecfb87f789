"""A model: what calibration found, and the simulation that it is. Saved as a folder."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tautline.rig import Rig

Array = np.ndarray


@dataclass(frozen=True)
class Effect:
    """One unmodelled effect that a diagnosis added; id as in `stage.name`, zero parameters meaning absent."""

    id: str
    parameters: Mapping[str, float]


@dataclass(frozen=True)
class Model:
    """c = f_remain(p), p the play's centre coordinate (brief: p_lo, p_hi), widths B(p).

    `q` is a grid over the actuator's range (rig.actuator.unit); width, width_sigma and c_deg are sampled on it and
    interpolated linearly between its points by everything that simulates (the board does the same with its tables).
    """

    rig: Rig
    q: Array  # (n,)
    width: Array  # (n,) B, >= 0, |B'| <= 1.8
    width_sigma: Array  # (n,) large where not measured
    c_deg: Array  # (n,) f_remain, strictly monotone
    delay_s: float
    measured: tuple[float, float]  # the q_mean that reversals reached
    effects: tuple[Effect, ...] = ()
    extra: Mapping[str, Any] = field(default_factory=dict)  # onsets, notes, figures' data: what the report shows
