"""The hypotheses that are weighed: every effect is screened on top of what is known, the leading ones are fitted, and
each fit is judged by what it leaves on blocks of manoeuvres that it did not see."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnose import gap, heldout
from tautline.diagnose.fit import Fit, Fitter, outlier_limit
from tautline.diagnose.screen import Screened, screen
from tautline.effects import EVENTS, Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[str], None]


_MARGIN_S = 1.0  # before and after a shift that a recording has to show


@dataclass(frozen=True)
class Found:
    """A hypothesis fitted to everything, and what it leaves of each block when it has not seen it."""

    fit: Fit
    left: list[Array]  # of each recording, (scored, k)
    power: Array  # (blocks,) mean squares of `left`, outliers pulled in

    @property
    def ids(self) -> tuple[str, ...]:
        return tuple(kind.id for kind in self.fit.hypothesis.kinds)

    @property
    def parameters(self) -> int:
        return sum(len(kind.amplitudes) + len(kind.shapes) for kind in self.fit.hypothesis.kinds)


class Search:
    """Hypotheses on top of others, all judged on the same blocks by the same measure."""

    def __init__(self, fitter: Fitter, base: Fit, kinds: Sequence[Kind], progress: Progress) -> None:
        self.fitter, self.kinds, self._progress = fitter, kinds, progress
        self._with_path = [kind for kind in kinds if kind.id not in EVENTS]
        self.labels = [np.unique(gap.blocks(s), return_inverse=True)[1] for s in fitter.segments]
        self.limits = outlier_limits(fitter, base)
        self.base = self.judged(base)

    def judged(self, fit: Fit) -> Found:
        left = heldout.residuals(self.fitter, fit, self.labels, self.limits)
        return Found(fit, left, self.power(left))

    def power(self, residuals: Sequence[Array]) -> Array:
        """(blocks,) mean squares, block after block and recording after recording."""
        parts = []
        for r, label, limit in zip(residuals, self.labels, self.limits, strict=True):
            squares = np.mean(np.minimum(np.abs(r), limit) ** 2, axis=1)
            parts.append(np.bincount(label, squares) / np.bincount(label))
        return np.concatenate(parts)

    def on_top_of(self, below: Found, refits: int, both_scopes: int) -> list[Found]:
        """The `refits` effects that screen best, each in the scope (all recordings, or those after the calibration)
        that screens better; the best `both_scopes` of them in the other scope too. Best first."""
        seen: dict[str, dict[bool, Screened]] = {}
        for entry in screen(self.fitter, below.fit, self._with_path, self.limits):
            seen.setdefault(entry.kind.id, {}).setdefault(entry.only_tests, entry)
        found: list[Found] = []

        def refit(entry: Screened) -> None:
            self._progress(f"fitting {' and '.join((*below.ids, entry.kind.id))}")
            start = {**below.fit.state.values, **entry.values}
            hypothesis = below.fit.hypothesis.plus(entry.kind, entry.only_tests)
            fit = self.fitter.fit(hypothesis, start, below.fit.state, entry.others)
            if not fit.finite:
                return
            if entry.kind.id != "registration.shift" or self._seen_to_happen(fit.state.values["shift_time"]):
                found.append(self.judged(fit))

        for scopes in list(seen.values())[:refits]:
            refit(next(iter(scopes.values())))
        found.sort(key=_loss)
        for best in found[:both_scopes]:
            other = seen[best.ids[-1]].get(not best.fit.hypothesis.only_tests[-1])
            if other is not None:
                refit(other)
        return sorted(found, key=_loss)

    def _seen_to_happen(self, shift_s: float) -> bool:
        """A shift between two recordings is a wrong registration of those after it."""
        for segment in self.fitter.segments:
            seen = segment.arrival_s[segment.scored] + segment.offset_s
            if seen[0] + _MARGIN_S < shift_s < seen[-1] - _MARGIN_S:
                return True
        return False


def _loss(found: Found) -> float:
    return float(np.mean(np.log(found.power)))


def applicable(fitter: Fitter, left_out: Collection[str] = ()) -> list[Kind]:
    """The effects that these recordings could show at all, but for those left out."""
    load = any(s.motor.load_mNm is not None for s in fitter.segments)
    freedom = any(
        values is not None and float(np.ptp(values)) > 0.0
        for s in fitter.segments
        for values in (s.motor.translation_mm, s.motor.rotation_deg)
    )
    has = {"": True, "camera": fitter.px, "load": load, "freedom": freedom}
    kinds = [kind for kind in effects.LIBRARY if has[kind.needs] and kind.id not in left_out]
    return [kind for kind in kinds if fitter.px or kind.id != "acquisition.delay"]


def outlier_limits(fitter: Fitter, base: Fit) -> list[float]:
    """Of each recording, one for all that are compared."""
    return [max(outlier_limit(r), 8.0 * fitter.floor) for r in base.residuals]
