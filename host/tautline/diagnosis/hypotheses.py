"""What fits leave of each block of manoeuvres under each hypothesis: all that a verdict is worked out from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Beyond:
    """What no law of a hypothesis' stages could leave (confined.py)."""

    power: Array  # (blocks,) mean squares
    count: Array  # (blocks,) of how many independent numbers


@dataclass(frozen=True)
class Wander:
    """By what share of all that a hypothesis adds an effect's amplitude is another elsewhere (wander.py): normal
    equations of m factors, over the noise's power."""

    id: str
    matrix: Array  # (m, m)
    gradient: Array  # (m,)
    ends: Mapping[str, Array]  # of each axis (2, m): what each factor adds at its low and at its high end

    @property
    def between(self) -> tuple[str, float, float]:
        """The axis along which the amplitude varies most, and the amplitude at its low and at its high end, as
        multiples of the fitted one. The factors are posterior means under a normal prior whose variances sum to 1."""
        size = len(self.gradient)
        factors = np.linalg.solve(self.matrix + size * np.eye(size), self.gradient)
        at = {axis: 1.0 + ends @ factors for axis, ends in self.ends.items()}
        most = max(at, key=lambda axis: float(np.ptp(at[axis])))
        return most, float(at[most][0]), float(at[most][1])

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Wander:
        ends = {axis: np.array(values) for axis, values in document["ends"].items()}
        return cls(document["id"], np.array(document["matrix"]), np.array(document["gradient"]), ends)


@dataclass(frozen=True)
class Weighed:
    """One hypothesis: effects on top of the recalibrated nominal, in the order they were added; none is the nominal
    alone."""

    ids: tuple[str, ...]
    power: Array  # (blocks,) mean squares that a fit leaves of a block it did not see (Candidate.unseen)
    scatter: Array  # (blocks,) logarithm of what an effect without a path takes off as a factor on the power; 0: none
    rival: Array  # (blocks,) the same of the best scatter of another origin
    parameters: int
    white: float = 0.0  # 1: the scatter forgets from frame to frame, 0: it goes on
    beyond: Beyond | None = None  # None: the effects' stages could leave anything
    chance: float = 1.0  # of a law: of another effect to leave so much less though the law is right (exact.py)
    wanders: tuple[Wander, ...] = ()  # of its effects that have a path
    each: bool = False  # an effect is another in each recording

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Weighed:
        beyond = document["beyond"] and Beyond(**{name: np.array(v) for name, v in document["beyond"].items()})
        arrays = {name: np.array(document[name]) for name in ("power", "scatter", "rival")}
        wanders = tuple(Wander.from_json(of) for of in document.get("wanders", ()))
        return cls(**{**document, **arrays, "ids": tuple(document["ids"]), "beyond": beyond, "wanders": wanders})


@dataclass(frozen=True)
class CaseEvidence:
    floor: float  # px or deg
    frozen: Array  # (blocks,) mean squares that the calibrated model leaves as it is
    hypotheses: tuple[Weighed, ...]  # the first without any effect
    applicable: int  # effects of the library that these recordings could show
    calibrated: float = 0.0  # mean square that the calibrated model leaves of its own calibration
    doubt: float = 0.0  # of the noise power's logarithm: how far it may be off, where that was seen
    unsteady: float = 0.0  # its standard deviation between blocks

    def to_json(self) -> dict[str, Any]:
        """All that `decide` is told: plain, once tautline.plain.plain was applied."""
        return asdict(self)

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> CaseEvidence:
        """The inverse of `to_json`."""
        hypotheses = tuple(Weighed.from_json(h) for h in document["hypotheses"])
        return cls(**{**document, "frozen": np.array(document["frozen"]), "hypotheses": hypotheses})
