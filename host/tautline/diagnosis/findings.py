"""What a diagnosis found, as typed objects: the same facts as in diagnosis.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

from tautline import effects
from tautline.value import Value

Interval = tuple[float, float]


@dataclass(frozen=True, eq=False, repr=False)
class Finding(Value):
    """An effect that a diagnosis names."""

    id: str
    probability: float  # that it is there, given those named before it
    since: str  # "start", "calibration" or "recording"
    parameters: Mapping[str, Any]  # by name, in the units of `taut explain ID`; `column` is the name of one
    shrink: float  # its Shapley share of the gap's shrinkage
    swallowed_by_recalibration: bool
    loads_on_board: bool
    ambiguous_with: tuple[str, ...]  # what these recordings cannot tell from it

    @property
    def stage(self) -> str:
        """The stage of the chain from motor to image at which the effect acts: one of effects.STAGES, or
        "simulator"."""
        return effects.BY_ID[self.id].stage

    @classmethod
    def of(cls, entry: Mapping[str, Any]) -> Self:
        """Makes a finding from an entry of the list `effects` of a diagnosis.json."""
        known = {name: entry[name] for name in cls.__dataclass_fields__}
        return cls(**{**known, "ambiguous_with": tuple(entry["ambiguous_with"])})


@dataclass(frozen=True, eq=False, repr=False)
class Gap(Value):
    """The sizes of a gap: root mean squares on data that no fit saw, px per coordinate or deg."""

    unit: str
    floor: float  # the noise
    before: float  # the calibrated model as it is
    after: float  # with what is named
    recalibrated: float  # with B, f_remain and static registration fitted anew
    before_ci: Interval  # 95 %
    after_ci: Interval
    shrink: float  # 1 - after / before
    shrink_ci: Interval  # 90 %, of a motion that was not recorded
    closable_shrink: float  # of the power above the floor

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """Makes the gap's sizes from the content of a diagnosis.json (its `gap`, `gap_recalibrated`, `unit` and
        `noise_floor`)."""
        gap: dict[str, Any] = {name: tuple(v) if name.endswith("_ci") else v for name, v in document["gap"].items()}
        again = document["gap_recalibrated"]["before"]
        return cls(unit=document["unit"], floor=document["noise_floor"], recalibrated=again, **gap)
