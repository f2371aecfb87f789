from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model


def _in_the_grid(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    low, high = model.measured
    offset = values["offset"]
    return replace(model, q=model.q - offset, measured=(low - offset, high - offset))


EFFECTS = (
    Kind(
        "transmission.offset",
        (Parameter("offset", "unit", 2e-3),),
        says="the transmission's offset is not the model's",
        holds=_in_the_grid,
        nominal=True,
        each=True,
    ),
)
