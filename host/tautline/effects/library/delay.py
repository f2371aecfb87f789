"""A sensor that is later, or earlier, than the model's delay says."""

from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model


def _with_later_sensor(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with `delay`, s, added to its sensor's delay. session_s is not used."""
    return replace(model, delay_s=model.delay_s + values["delay"])


EFFECTS = (
    Kind(
        "acquisition.delay",
        (Parameter("delay", "s", 0.01),),
        says="the sensor's delay is wrong",
        tell="The gap goes with the marker's speed in the image, both ways, and is gone at rest, whichever axis moves "
        "it.",
        mend="Put the measured delay into the rig: calibration does.",
        needs="sensor",
        holds=_with_later_sensor,
        law=True,
        nominal=True,
    ),
)
