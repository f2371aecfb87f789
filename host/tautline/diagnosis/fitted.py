"""What is fitted: effects with the time since when they are there, their parameters, and a point of their space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis.segment import Segment
from tautline.effects import Kind, Parameter
from tautline.model import Model

Array = npt.NDArray[np.float64]

STATIC_NAMES = tuple(p.name for p in effects.BY_ID["registration.static"].amplitudes)


class Scope(IntEnum):
    """Since when an effect is there; what is false is there from the start."""

    START = 0
    TESTS = 1  # in all recordings after the calibration, the same
    EACH = 2  # in each of them another

    @property
    def since(self) -> str:
        """Its name in diagnosis.json."""
        return ("start", "calibration", "recording")[self]


@dataclass(frozen=True)
class Slot:
    """A number that is fitted."""

    parameter: Parameter
    key: str  # of State.values
    scope: Scope
    number: int = 0  # of the recording, where each has its own

    def holds_in(self, segment: Segment) -> bool:
        """Whether this number is a parameter of that recording."""
        if self.scope == Scope.EACH:
            return segment.number == self.number
        return not (self.scope and segment.calibration)


def key(name: str, number: int) -> str:
    """Under which `ParameterState.values` has the parameter `name` of the recording `number` alone."""
    return f"{name}@{number}"


@dataclass(frozen=True)
class Hypothesis:
    """Effects that are present, and since when."""

    kinds: tuple[Kind, ...] = ()
    scopes: tuple[Scope, ...] = ()
    tests: int = 1  # recordings after the calibration

    def plus(self, kind: Kind, scope: Scope) -> Hypothesis:
        return replace(self, kinds=(*self.kinds, kind), scopes=(*self.scopes, scope))

    def find(self, name: str) -> tuple[Kind, Scope] | None:
        """The effect with this id and since when it is there; None where this hypothesis is without it."""
        return next(((k, s) for k, s in zip(self.kinds, self.scopes, strict=True) if k.id == name), None)

    @property
    def slots(self) -> list[Slot]:
        """The numbers that are fitted: amplitudes and continuous shapes; one for each recording, if each has its
        own."""
        collected = []
        for kind, scope in zip(self.kinds, self.scopes, strict=True):
            for p in (p for p in kind.parameters if not p.searched):
                if scope == Scope.EACH:
                    collected += [Slot(p, key(p.name, i), scope, i) for i in range(1, self.tests + 1)]
                else:
                    collected.append(Slot(p, p.name, scope))
        return collected


@dataclass(frozen=True)
class ParameterState:
    """A point of the parameter space."""

    model: Model  # the nominal with its corrections
    static: Mapping[str, float]  # nominal registration, all recordings
    values: Mapping[str, float] = field(default_factory=dict)  # of the effects

    def at(self, segment: Segment, hypothesis: Hypothesis) -> dict[str, Any]:
        """The effects' and the registration's parameters by name that hold in one recording; a change of the
        registration by an effect is added to the nominal one."""
        chosen: dict[str, Any] = dict(self.static)
        for kind, scope in zip(hypothesis.kinds, hypothesis.scopes, strict=True):
            if scope and segment.calibration:
                continue
            if kind.column:
                chosen[effects.COLUMN] = kind.column
            for p in kind.parameters:
                own = scope == Scope.EACH and not p.searched
                value = self.values.get(key(p.name, segment.number) if own else p.name)
                if value is not None:
                    chosen[p.name] = chosen.get(p.name, 0.0) + value if p.name in STATIC_NAMES else value
        return chosen


@dataclass(frozen=True)
class Fit:
    hypothesis: Hypothesis
    state: ParameterState
    residuals: list[Array]  # of each segment, (scored, k)

    @property
    def finite(self) -> bool:
        """Whether all residuals are numbers: they are NaN where the marker would be behind the camera."""
        return all(bool(np.isfinite(r).all()) for r in self.residuals)

    @property
    def freedom(self) -> int:
        """How many parameters the effects have."""
        return len(self.hypothesis.slots)
