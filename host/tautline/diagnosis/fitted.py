"""Hypotheses (effects, each with the time since when it is there), their parameters, and points of that space."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import IntEnum
from functools import cached_property
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
    """Since when an effect is there, and with which parameters. bool(scope): whether the calibration is without the
    effect."""

    START = 0  # in all, the calibration included
    TESTS = 1  # in all after the calibration, with the same parameters
    EACH = 2  # in all after the calibration, with parameters of its own in each

    @property
    def since(self) -> str:
        """The name of this scope in diagnosis.json ("start", "calibration" or "recording")."""
        return ("start", "calibration", "recording")[self]


@dataclass(frozen=True)
class Slot:
    """One fitted number: a parameter of an effect, for all recordings with this effect or for one of them."""

    parameter: Parameter
    key: str  # under which ParameterState.values has it
    scope: Scope
    number: int = 0  # index of the recording it belongs to, where each has its own; else 0

    def holds_in(self, segment: Segment) -> bool:
        """Whether the recording `segment` is simulated with this number."""
        if self.scope == Scope.EACH:
            return segment.number == self.number
        return not (self.scope and segment.calibration)


def key(name: str, number: int) -> str:
    """The key in `ParameterState.values` of a parameter that each recording has for itself: NAME@NUMBER, by the
    recording's index `number`."""
    return f"{name}@{number}"


@dataclass(frozen=True)
class Hypothesis:
    """The effects that are present, in the order in which they were added, and since when each of them is there."""

    kinds: tuple[Kind, ...] = ()
    scopes: tuple[Scope, ...] = ()  # of each of `kinds`
    tests: int = 1  # number of recordings after the calibration

    def plus(self, kind: Kind, scope: Scope) -> Hypothesis:
        """A new hypothesis with one more effect, added last."""
        return replace(self, kinds=(*self.kinds, kind), scopes=(*self.scopes, scope))

    def find(self, name: str) -> tuple[Kind, Scope] | None:
        """(The effect with the id `name`, since when it is there); None where this hypothesis is without it."""
        return next(((k, s) for k, s in zip(self.kinds, self.scopes, strict=True) if k.id == name), None)

    @cached_property
    def slots(self) -> list[Slot]:
        """The fitted numbers in the order of the parameter vector: of each effect the amplitudes and shapes that are
        not `searched`, once for each test where the effect has its own in each (Scope.EACH)."""
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
    """A point of the parameter space: the nominal model's unknowns and the effects' parameters."""

    model: Model  # the nominal model with B, f_remain and delay as fitted
    static: Mapping[str, float]  # its registration, deg and mm by STATIC_NAMES, of all recordings; {} without a camera
    values: Mapping[str, float] = field(default_factory=dict)  # of the effects' parameters, by `Slot.key`

    def at(self, segment: Segment, hypothesis: Hypothesis) -> dict[str, Any]:
        """The parameters, by name, with which this recording is simulated: the registration, and those of the effects
        that are there in it. Where an effect has the registration's own parameters they are added to the nominal
        ones."""
        parameters: dict[str, Any] = dict(self.static)
        for kind, scope in zip(hypothesis.kinds, hypothesis.scopes, strict=True):
            if scope and segment.calibration:
                continue
            if kind.column:
                parameters[effects.COLUMN] = kind.column
            for p in kind.parameters:
                by_recording = scope == Scope.EACH and not p.searched
                value = self.values.get(key(p.name, segment.number) if by_recording else p.name)
                if value is not None:
                    parameters[p.name] = parameters.get(p.name, 0.0) + value if p.name in STATIC_NAMES else value
        return parameters


@dataclass(frozen=True)
class Fit:
    """A hypothesis at the best point of its parameter space that was found."""

    hypothesis: Hypothesis
    state: ParameterState
    residuals: list[Array]  # (scored, k) of each recording, px or deg

    @property
    def finite(self) -> bool:
        """Whether all residuals are finite. They are NaN where the marker would be behind the camera."""
        return all(bool(np.isfinite(r).all()) for r in self.residuals)

    @property
    def freedom(self) -> int:
        """The number of fitted parameters of the effects."""
        return len(self.hypothesis.slots)
