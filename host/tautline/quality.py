"""How far a calibration may be trusted: a verdict, and for each doubt a reason with its remedy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from typing import Any, Self


class Verdict(StrEnum):
    """good: the stated sigmas cover the errors, and predictions are within 1.3 times the noise. doubtful: the
    instrument does something that the model does not hold. unusable: the model predicts worse than f_coarse or a
    constant, or clocks, sizes or units contradict each other."""

    GOOD = "good"
    DOUBTFUL = "doubtful"
    UNUSABLE = "unusable"


@dataclass(frozen=True)
class Reason:
    """`code` is an effect's id (stage.name) or a code of the calibration's own; `remedy` says what to do."""

    code: str
    says: str
    remedy: str
    fatal: bool = False  # nothing that was measured can be used
    mild: bool = False  # worth knowing; sigma and predictions hold all the same

    def __str__(self) -> str:
        """What is wrong, and what to do, in one sentence."""
        return f"{self.says}: {self.remedy}"


@dataclass(frozen=True)
class Quality:
    """Reasons come likeliest first, mild ones last; a good verdict has no others."""

    reasons: tuple[Reason, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """UNUSABLE with a fatal reason; else GOOD if all reasons are mild or there are none, DOUBTFUL otherwise."""
        if any(reason.fatal for reason in self.reasons):
            return Verdict.UNUSABLE
        return Verdict.GOOD if all(reason.mild for reason in self.reasons) else Verdict.DOUBTFUL

    @property
    def usable(self) -> bool:
        """Whether no reason is fatal."""
        return self.verdict is not Verdict.UNUSABLE

    @classmethod
    def of(cls, reasons: Sequence[Reason]) -> Self:
        """The quality by these reasons, repeated ones once: fatal ones first, mild ones last, otherwise in the order
        given."""
        return cls(tuple(sorted(dict.fromkeys(reasons), key=lambda reason: reason.mild - reason.fatal)))

    def to_json(self) -> dict[str, Any]:
        """Verdict and reasons as plain values, for model.json."""
        return {"verdict": self.verdict.value, "reasons": [asdict(reason) for reason in self.reasons]}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave; the verdict is made anew of the reasons. KeyError or TypeError where it is
        something else."""
        return cls(
            tuple(
                Reason(
                    code=str(r["code"]),
                    says=str(r["says"]),
                    remedy=str(r["remedy"]),
                    fatal=bool(r.get("fatal", False)),
                    mild=bool(r.get("mild", False)),
                )
                for r in document["reasons"]
            )
        )
