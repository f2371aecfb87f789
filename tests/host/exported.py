"""A small instrument and its recording, which the tests of exports write and read back."""

from __future__ import annotations

import numpy as np

from tautline.elements import SINGLE, Elements
from tautline.model import Effect, Model
from tautline.rig import Actuator, Coarse, Rig
from tautline.simulated import instrument

GRID = np.linspace(-5.0, 5.0, 401)
NOISE_PX = 0.05


def width(q):
    """mm: a slope and a bump."""
    return 0.4 + 0.02 * q + 0.25 * np.exp(-(((q - 1.0) / 1.5) ** 2))


def law(q):
    """deg."""
    return 10.0 * q + 4.0 * np.sin(0.4 * q)


def model(
    elements: Elements = SINGLE, effects: tuple[Effect, ...] = (), falling: bool = False, camera: bool = True
) -> Model:
    sign = -1.0 if falling else 1.0
    plain = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(sign * 11.0, 0.5))
    rig = instrument.reference_rig() if camera else plain
    return Model(
        rig,
        GRID,
        width(GRID),
        0.004 + 0 * GRID,
        sign * law(GRID),
        0.08,
        (-4.0, 4.0),
        effects=effects,
        elements=elements,
    )


_FINE = np.linspace(-8.0, 8.0, 160_001)
_HALF = 0.5 * width(np.clip(_FINE, -5.0, 5.0))  # beyond the table the width is held


def play(q):
    """p[k] = min(max(p[k-1], p_lo), p_hi) with p_lo + B/2 = q = p_hi - B/2, from a table of 0.1 um: none of the
    package's code."""
    low, high = np.interp(q, _FINE + _HALF, _FINE), np.interp(q, _FINE - _HALF, _FINE)
    p, path = q[0], np.empty(len(q))
    for k in range(len(q)):
        p = path[k] = min(max(p, low[k]), high[k])
    return path
