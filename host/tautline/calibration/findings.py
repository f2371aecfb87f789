"""What a calibration notices on its way: reasons for its verdict, notes and figures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tautline.quality import Reason


@dataclass
class Findings:
    """What a calibration has found out beside its results, collected as its steps go on."""

    reasons: list[Reason] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    evidence: dict[str, float] = field(default_factory=dict)
    noticed: list[Reason] = field(default_factory=list)  # doubts where the calibration is not good, and no more

    def doubt(self, code: str, says: str, remedy: str, *, fatal: bool = False, mild: bool = False) -> None:
        """Adds a reason to doubt the calibration. says: what is wrong; remedy: what to do. fatal: nothing can be used;
        mild: worth knowing only."""
        self.reasons.append(Reason(code, says, remedy, fatal, mild))

    def notice(self, code: str, says: str, remedy: str) -> None:
        """Adds a reason whose weight is not known yet: `judge` makes it a doubt if the calibration is not good, else
        mild."""
        self.noticed.append(Reason(code, says, remedy))

    def judge(self, good: bool) -> None:
        """Adds the noticed reasons, the first of each code, to the reasons: as mild ones if the calibration is
        `good`."""
        first: dict[str, Reason] = {}
        for reason in self.noticed:
            first.setdefault(reason.code, replace(reason, mild=good))
        self.reasons += first.values()
