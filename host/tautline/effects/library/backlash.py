"""A width that is not the model's: another tension, wear, another posture."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.effects.kind import Kind, Parameter
from tautline.effects.spline import RangeSpline
from tautline.model import Model, allowed_width

Array = npt.NDArray[np.float64]

_PIECES = 20  # prior: of a cubic spline over the motor's range: as fine as B itself is measured again
_SPLINE = RangeSpline("width", _PIECES)
_SCALE, _EVERYWHERE = "width_scale", "width_everywhere"
_AT_MOTOR = "width_at_motor"  # 1: the change goes with the motor, as a worn part does, and not with the play's centre
_STEPS = 6  # tolerance: of a fixed-point iteration, which contracts as |d added / dq| / 2 < 1


def _in_the_table(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with another B: times 1 + width_scale, plus width_everywhere, plus the spline with coefficients width_0
    .., unit of q, over the play's centre or, with width_at_motor, over the motor's position. session_s is not used."""
    added = _SPLINE.on_grid(model, values)
    width = model.width * max(0.0, 1.0 + values.get(_SCALE, 0.0)) + values.get(_EVERYWHERE, 0.0)
    if not values.get(_AT_MOTOR, 0.0):
        return replace(model, width=allowed_width(model.q, width + added))
    return _with_width_at_motor(model, width, added)


def _slopes(model: Model, values: Mapping[str, float], p: Array) -> Mapping[str, Array] | None:
    """By amplitude's name, (n,): the derivative by it of B at the play's centres p (n,), unit of q. None with
    width_at_motor: B over p then depends on the amplitudes through where each wall is reached, not linearly."""
    if values.get(_AT_MOTOR, 0.0):
        return None
    everywhere = {_SCALE: np.interp(p, model.q, model.width), _EVERYWHERE: np.ones_like(p)}
    return everywhere | _SPLINE.slopes(model, p)


def _with_width_at_motor(model: Model, width: np.ndarray, added: np.ndarray) -> Model:
    """The model with B(p) = width (grid,), to which `added` (grid,) of the motor's position q is added where either
    wall of the play is reached: each wall solves q = p + s (width(p) + added(q)) / 2, s = +-1. As both walls then move
    unlike, the play's centre shifts, and f_remain with it."""
    walls = []
    for side in (1.0, -1.0):
        wall = model.q + side * 0.5 * width
        for _ in range(_STEPS):
            wall = model.q + side * 0.5 * (width + np.interp(wall, model.q, added))
        walls.append(np.maximum.accumulate(wall))
    centre = 0.5 * (walls[0] + walls[1])
    new_width = np.interp(model.q, centre, walls[0] - walls[1])
    # Beyond the walls' ends the centre is as far from the old one as there: the law goes on, and stays monotone.
    before, after = np.minimum(model.q - centre[0], 0.0), np.maximum(model.q - centre[-1], 0.0)
    old_centre = np.interp(model.q, centre, model.q) + before + after
    return replace(model, width=allowed_width(model.q, new_width), c_deg=model.remaining(old_centre))


_KIND = Kind(
    "transmission.backlash",
    (Parameter(_SCALE, "", 0.1), *(Parameter(name, "unit", 5e-3) for name in _SPLINE.names)),
    (Parameter(_AT_MOTOR, "", 1.0, (0.0, 1.0), searched=True),),
    says="the backlash is not the model's",
    tell="Every reversal at one place is wider or narrower than the model's B there, by the same amount each time.",
    mend="Re-tension the tendon as it was, or calibrate again: that is all it takes.",
    holds=_in_the_table,
    in_tables="width",
    slopes=_slopes,
    nominal=True,
    posture=True,
    curve=_SPLINE.names,
)
EFFECTS = (
    replace(_KIND, simple=replace(_KIND, amplitudes=(Parameter(_EVERYWHERE, "unit", 5e-3),), shapes=(), curve=())),
)
