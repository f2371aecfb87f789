"""The library: every module here offers `EFFECTS`, a tuple of descriptors, and other distributions may add to it
(tautline.effects.outside). Its parts in C, if it has any, are in host/native/effects/, where the parameters that move
the tip are explained, or in projection.h."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Iterator, Mapping

from tautline.effects.kind import COLUMN, SIMULATOR, STAGES, Kind, of_simulator
from tautline.effects.outside import installed_effects
from tautline.model import Effect


class _ById(Mapping[str, Kind]):
    """Effects by id: those of the library, and for every id "simulator.NAME" an effect made on the spot for that
    simulator's parameter. Iteration and length are of the library's effects alone; none of their ids begins with
    "simulator."."""

    def __init__(self, kinds: tuple[Kind, ...]) -> None:
        """kinds: the library's effects."""
        self._kinds = {kind.id: kind for kind in kinds}

    def __getitem__(self, name: str) -> Kind:
        """The descriptor with the id `name`; KeyError for an unknown id."""
        stage, _, parameter = name.partition(".")
        return of_simulator(parameter) if stage == SIMULATOR and parameter else self._kinds[name]

    def __iter__(self) -> Iterator[str]:
        """Iterates over the ids of the library's effects."""
        return iter(self._kinds)

    def __len__(self) -> int:
        """The number of the library's effects."""
        return len(self._kinds)


_FOUND: list[Kind] = [
    kind
    for module in pkgutil.iter_modules(__path__)
    for kind in importlib.import_module(f"{__name__}.{module.name}").EFFECTS
]
_FOUND += installed_effects(_FOUND)
LIBRARY: tuple[Kind, ...] = tuple(sorted(_FOUND, key=lambda kind: (STAGES.index(kind.stage), kind.id)))
BY_ID: Mapping[str, Kind] = _ById(LIBRARY)
OWNER: Mapping[str, Kind] = {
    parameter.name: kind for kind in LIBRARY for form in kind.forms for parameter in form.parameters
}
# Ids of effects without a path that repeats, of which at most the mean can be predicted, and names of their amounts.
EVENTS = frozenset(kind.id for kind in LIBRARY if kind.event)
SCATTERS = frozenset(kind.event.amount for kind in LIBRARY if kind.event)


def kind_of(effect: Effect) -> Kind:
    """The descriptor of a model's effect, with only the parameters that this effect has; where the effect follows a
    joint's column, the variant for that joint."""
    kind, column = BY_ID[effect.id], effect.parameters.get(COLUMN)
    return (kind.of_joint(column) if column and kind.of_joint else kind).only(effect.parameters)
