"""The evidence of a case: what each hypothesis leaves of each block of manoeuvres. A verdict is worked out from it
alone.

It is stored with blind cases and learnt from, so its fields' names are part of a format. A power is a mean square of
held-out residuals, px^2 or deg^2 a coordinate; blocks are in order, block after block and recording after recording.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Beyond:
    """The power of what is left that no law of the stages of a hypothesis' effects could leave (confined.py)."""

    power: Array  # (blocks,)
    count: Array  # (blocks,) how many independent numbers each is the mean of


@dataclass(frozen=True)
class Wander:
    """The evidence of how an effect's amplitude varies over place, speed, time, side and load (wander.py). The effect's
    signal is multiplied by m functions of these, each with a factor to estimate; here are the normal equations of the m
    factors, over the noise's power. A factor is a share of all that the hypothesis adds to the prediction."""

    id: str  # of the effect
    matrix: Array  # (m, m)
    gradient: Array  # (m,)
    ends: Mapping[str, Array]  # of each axis (2, m): what each factor adds to the amplitude at the low and the high end

    @property
    def between(self) -> tuple[str, float, float]:
        """(The axis along which the amplitude varies most, the amplitude at its low end, at its high end), as multiples
        of the fitted amplitude. The factors are taken as their posterior means, each with the prior N(0, 1/m)."""
        m = len(self.gradient)
        factors = np.linalg.solve(self.matrix + m * np.eye(m), self.gradient)
        amplitudes = {axis: 1.0 + ends @ factors for axis, ends in self.ends.items()}
        axis = max(amplitudes, key=lambda name: float(np.ptp(amplitudes[name])))
        low, high = amplitudes[axis]
        return axis, float(low), float(high)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Wander:
        """Reads an entry of `wanders` as CaseEvidence.to_json writes it."""
        ends = {axis: np.array(values) for axis, values in document["ends"].items()}
        return cls(document["id"], np.array(document["matrix"]), np.array(document["gradient"]), ends)


@dataclass(frozen=True)
class Weighed:
    """The evidence of one hypothesis, which is a set of effects on top of the recalibrated nominal model."""

    ids: tuple[str, ...]  # of its effects in the order they were added; () is the nominal model alone
    power: Array  # (blocks,) held-out power, with how much each recording contradicts the others
    scatter: Array  # (blocks,) logarithm of the factor on the power by which an event explains scatter; 0 without one
    rival: Array  # (blocks,) logarithm of the factor of the best explanation of the scatter that is no event
    parameters: int  # effective number of parameters, for the information criterion
    beyond: Beyond | None = None  # None: the effects' stages could leave anything
    chance: float = 1.0  # of a law: probability that noise alone makes another effect leave as much less (exact.py)
    wanders: tuple[Wander, ...] = ()  # of its effects that have a path
    each: bool = False  # whether an effect has amplitudes of its own in each recording
    from_start: bool = False  # whether an effect was there while calibrating

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Weighed:
        """Reads an entry of `hypotheses` as CaseEvidence.to_json writes it, or wrote it in older campaigns: unknown
        fields are ignored, missing ones have their default."""
        beyond = document["beyond"] and Beyond(**{name: np.array(v) for name, v in document["beyond"].items()})
        arrays = {name: np.array(document[name]) for name in ("power", "scatter", "rival")}
        wanders = tuple(Wander.from_json(of) for of in document.get("wanders", ()))
        known = {field.name: document[field.name] for field in fields(cls) if field.name in document}
        return cls(**{**known, **arrays, "ids": tuple(document["ids"]), "beyond": beyond, "wanders": wanders})


@dataclass(frozen=True)
class CaseEvidence:
    """The evidence of one case, from which `decide` works out the verdict."""

    floor: float  # one standard deviation of the noise of a coordinate, px or deg
    frozen: Array  # (blocks,) power that the calibrated model leaves as it is
    hypotheses: tuple[Weighed, ...]  # the first without any effect
    applicable: int  # how many effects of the library these recordings could show
    calibrated: float = 0.0  # power that the calibrated model leaves of its own calibration
    doubt: float = 0.0  # standard deviation of log(floor^2), where videos showed one
    unsteady: float = 0.0  # standard deviation between blocks of the logarithm of the noise's power

    def to_json(self) -> dict[str, Any]:
        """The evidence as nested dictionaries of arrays and numbers; tautline.plain.plain turns them into JSON's
        types."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> CaseEvidence:
        """The inverse of `to_json`."""
        hypotheses = tuple(Weighed.from_json(h) for h in document["hypotheses"])
        return cls(**{**document, "frozen": np.array(document["frozen"]), "hypotheses": hypotheses})
