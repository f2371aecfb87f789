"""A width or an offset that changes with the session's time, evenly or ever more slowly."""

import math
from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model, allowed_width


def _effective_time(values: Mapping[str, float], session_s: float) -> float:
    """The time, s, in which a drift at its initial rate would have gone as far as it has at session_s. With T =
    session_s - drift_from it is T, or (1 - exp(-drift_decay T)) / drift_decay where the rate decays as exp(-drift_decay
    T); 0 before drift_from."""
    decay = values.get("drift_decay", 0.0)
    since = max(0.0, session_s - values.get("drift_from", 0.0))
    return -math.expm1(-decay * since) / decay if decay > 0.0 else since


def _with_drift(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model as it is at session_s, s: q lowered by offset_drift T and B multiplied by 1 + width_drift T (at least
    0), with T from `_effective_time`."""
    time_s = _effective_time(values, session_s)
    width = allowed_width(model.q, model.width * max(0.0, 1.0 + values["width_drift"] * time_s))
    offset, (low, high) = values["offset_drift"] * time_s, model.measured
    return replace(model, q=model.q - offset, measured=(low - offset, high - offset), width=width)


EFFECTS = (
    Kind(
        "transmission.drift",
        (Parameter("offset_drift", "unit/s", 5e-5), Parameter("width_drift", "1/s", 5e-4)),
        (
            Parameter("drift_decay", "1/s", 5e-3, (0.0, 0.01), low=0.0),
            Parameter("drift_from", "s", 20.0, (0.0,), low=0.0),
        ),
        says="width or offset changes with time",
        material=True,
        tell="The gap grows with time, whatever the motion is, also with the motor at one place again.",
        mend="Warm the instrument up, check the tendon's clamps, calibrate again; taut track follows it while in use.",
        holds=_with_drift,
        course=_effective_time,
    ),
)
