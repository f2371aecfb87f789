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


def _with_width(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with another B, unit of q: times 1 + width_scale, plus width_everywhere, plus a spline with the
    coefficients width_0, width_1 and so on. The spline is a function of the play's centre or, with width_at_motor, of
    the motor's position. session_s is not used."""
    added = _SPLINE.on_grid(model, values)
    width = model.width * max(0.0, 1.0 + values.get(_SCALE, 0.0)) + values.get(_EVERYWHERE, 0.0)
    if not values.get(_AT_MOTOR, 0.0):
        return replace(model, width=allowed_width(model.q, width + added))
    return _with_width_at_motor(model, width, added)


def _width_slopes(model: Model, values: Mapping[str, float], p: Array) -> Mapping[str, Array] | None:
    """{name of an amplitude: (n,) derivative of B, unit of q, by it at the play's centres p (n,), unit of q}. None with
    width_at_motor: B as a function of p is then not linear in the amplitudes."""
    if values.get(_AT_MOTOR, 0.0):
        return None
    everywhere = {_SCALE: np.interp(p, model.q, model.width), _EVERYWHERE: np.ones_like(p)}
    return everywhere | _SPLINE.slopes(model, p)


def _with_width_at_motor(model: Model, width: np.ndarray, added: np.ndarray) -> Model:
    """The model with a B that depends on the motor's position q as well: each wall of the play is at q = p + s
    (width(p) + added(q)) / 2, s = +1 or -1, solved by fixed-point iteration. The two walls then move by different
    amounts, so the play's centre shifts, and f_remain is shifted with it. width, added: (grid,), unit of q."""
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
    holds=_with_width,
    in_tables="width",
    slopes=_width_slopes,
    nominal=True,
    posture=True,
    curve=_SPLINE.names,
)
EFFECTS = (
    replace(_KIND, simple=replace(_KIND, amplitudes=(Parameter(_EVERYWHERE, "unit", 5e-3),), shapes=(), curve=())),
)
