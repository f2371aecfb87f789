"""The library: every module here offers `EFFECTS`, a tuple of descriptors. Its parts in C, if it has any, are in
host/native/effects/, where the parameters that move the tip are explained, or in projection.h."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping

from tautline.effects.kind import STAGES, Kind

_FOUND: list[Kind] = [
    kind
    for module in pkgutil.iter_modules(__path__)
    for kind in importlib.import_module(f"{__name__}.{module.name}").EFFECTS
]
LIBRARY: tuple[Kind, ...] = tuple(sorted(_FOUND, key=lambda kind: (STAGES.index(kind.stage), kind.id)))
BY_ID: Mapping[str, Kind] = {kind.id: kind for kind in LIBRARY}
OWNER: Mapping[str, Kind] = {
    parameter.name: kind for kind in LIBRARY for form in kind.forms for parameter in form.parameters
}
# Told by their scatter: at most what it is in the mean can be predicted.
EVENTS = frozenset(kind.id for kind in LIBRARY if kind.event)
SCATTERS = frozenset(kind.event.amount for kind in LIBRARY if kind.event)
