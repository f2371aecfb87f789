"""Which part of the nominal model had to move where a recalibration closes a gap: the parts are freed in turn."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.diagnosis import gap
from tautline.diagnosis.fit import DELAY, PARTS, REMAINING, STATIC, WIDTH, Fitter
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.shapley import shares

Array = npt.NDArray[np.float64]

CLOSES = 0.1  # loss: of a gap's power above the floor: what leaves less has closed it
_COUNTS = 0.05  # format: a smaller share is not told


@dataclass(frozen=True)
class Moved:
    id: str  # of PARTS
    share: float  # of what the recalibration closes


def closes(before: float, after: float, floor: float, most: float = CLOSES) -> bool:
    """Whether there is a gap and at most a share `most` of its power above the noise floor is left. before, after,
    floor: rms."""
    open_before = before**2 - floor**2
    return open_before > 0.0 and after**2 - floor**2 < most * open_before


def is_all(before: float, after: float, floor: float, still_open: bool, by_law: float) -> bool:
    """Whether a recalibration closes the whole gap: it leaves little, and, where that is more than noise
    (`still_open`), no larger a share than a law leaves (`by_law`). before, after, floor: rms."""
    return closes(before, after, floor) and (not still_open or closes(before, after, floor, by_law))


def from_the_start(fitter: Fitter, frozen: Sequence[Array], base: Fit) -> list[Moved]:
    """The parts of the nominal model that moved in all recordings, the largest share first, where `base` closes the gap
    of the calibrated model (`frozen`: residuals of each recording). If only the registration closes it, f_remain had
    followed the wrong registration and is counted with it."""
    coarse, floor = fitter.coarse, fitter.floor
    before = gap.rms(frozen[1:])
    excess = max(before**2 - floor**2, 1e-300)

    def left(fit: Fit) -> float:
        return gap.rms(fit.residuals[1:])

    def closed(free: Collection[str]) -> float:
        """Share of the gap's power above the noise that freeing these parts closes, 0 to 1."""
        if not free:
            return 0.0
        after = left(base) if set(free) == set(PARTS) else left(coarse.nominal(free))
        return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0))

    others = (WIDTH, REMAINING, DELAY) if fitter.delayed else (WIDTH, REMAINING)
    if fitter.px and not closes(before, left(coarse.nominal(others)), floor):
        return _shapley_shares(
            (STATIC, REMAINING), lambda parts: closed({*parts, REMAINING} if STATIC in parts else parts)
        )
    return _shapley_shares(others, closed)


def of_named(shrinks: Sequence[tuple[str, float]]) -> list[Moved]:
    """Shares, summing to 1, of named effects that are parts of the nominal model, by what each shrinks."""
    total = sum(max(share, 0.0) for _, share in shrinks)
    return [Moved(name, max(share, 0.0) / total) for name, share in shrinks] if total > 0.0 else []


def _shapley_shares(parts: Sequence[str], worth: Callable[[frozenset[str]], float]) -> list[Moved]:
    """Shapley shares of the parts, without those below a share _COUNTS of the largest. worth: of a set of parts."""
    added = [max(share, 0.0) for share in shares(parts, worth)]
    counting = [(part, share) for part, share in zip(parts, added, strict=True) if share > _COUNTS * max(added)]
    return sorted(of_named(counting), key=lambda m: -m.share)
