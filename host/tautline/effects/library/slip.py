"""An offset that jumps at moments: a tooth or a winding slipped, or the encoder lost counts."""

from collections.abc import Mapping
from dataclasses import replace

from tautline.effects.kind import Kind, Parameter
from tautline.model import Model

_TIMES = range(1, 5)  # format: of the parameters' names, as in slip.c: it may slip four times


def _with_slips(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model as it is at session_s, s: q lowered by the sum, unit of q, of all slips whose time is not after
    session_s."""
    slipped = sum(values.get(f"slip_{i}", 0.0) for i in _TIMES if values.get(f"slip_time_{i}", 0.0) <= session_s)
    low, high = model.measured
    return replace(model, q=model.q - slipped, measured=(low - slipped, high - slipped))


EFFECTS = (
    Kind(
        "transmission.slip",
        tuple(Parameter(f"slip_{i}", "unit", 2e-3) for i in _TIMES),
        tuple(Parameter(f"slip_time_{i}", "s", 1.0, searched=True) for i in _TIMES),
        says="the offset jumps: a tooth or a winding slipped, or the encoder lost counts",
        tell="From one moment on both branches lie shifted along q by the same amount, and the marker stays on its "
        "track.",
        mend="Tighten what slipped or find out why counts are lost, and home the axis again.",
        holds=_with_slips,
        scan="moment",
        law=True,
        brings=("transmission.offset",),  # it may slip between recordings as well
    ),
)
