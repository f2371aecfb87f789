"""What a calibration notices on its way: reasons for its verdict, notes and figures."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from tautline.quality import Reason


@dataclass
class Findings:
    reasons: list[Reason] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    evidence: dict[str, float] = field(default_factory=dict)
    looks: list[Reason] = field(default_factory=list)  # doubts where the calibration is not good, and no more

    def doubt(self, code: str, says: str, remedy: str, *, fatal: bool = False, mild: bool = False) -> None:
        """Adds a reason to doubt the calibration. fatal: nothing can be used; mild: worth knowing only."""
        self.reasons.append(Reason(code, says, remedy, fatal, mild))

    def notice(self, code: str, says: str, remedy: str) -> None:
        """Adds what is a doubt only if the calibration turns out not to be good; `judge` decides."""
        self.looks.append(Reason(code, says, remedy))

    def judge(self, good: bool) -> None:
        """Makes the looks reasons, each code once: the first that was noticed. good: the calibration is; they are mild
        then."""
        first: dict[str, Reason] = {}
        for look in self.looks:
            first.setdefault(look.code, replace(look, mild=good))
        self.reasons += first.values()
