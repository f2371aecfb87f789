"""A transmission whose q counts from elsewhere: another posture, tension or homing."""

from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model


def _with_offset(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with its q lowered by `offset`, unit of q. With offset_at_tip q stays and f_remain is shifted instead,
    by offset times its mean slope, deg. session_s is not used."""
    low, high = model.measured
    offset = values["offset"]
    if values.get("offset_at_tip", 0.0):
        slope = (model.c_deg[-1] - model.c_deg[0]) / (model.q[-1] - model.q[0])
        return replace(model, c_deg=model.c_deg + slope * offset)
    return replace(model, q=model.q - offset, measured=(low - offset, high - offset))


EFFECTS = (
    Kind(
        "transmission.offset",
        (Parameter("offset", "unit", 2e-3),),
        (Parameter("offset_at_tip", "", 1.0, (0.0, 1.0), searched=True),),
        says="the transmission's offset is not the model's",
        tell="The whole characteristic lies shifted along q, both branches alike, since a posture, a re-tensioning or "
        "a homing.",
        mend="Home the axis again, or calibrate in this posture.",
        holds=_with_offset,
        nominal=True,
        posture=True,
        each=True,
    ),
)
