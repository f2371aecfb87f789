"""Which part of the nominal model had to move where a recalibration closes a gap: the parts are freed in turn."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.diagnosis import gap
from tautline.diagnosis.fit import DELAY, PARTS, REMAINING, STATIC, WIDTH, Fit, Fitter
from tautline.diagnosis.shapley import shares

Array = npt.NDArray[np.float64]

CLOSES = 0.1  # loss: of a gap's power above the floor: what leaves less has closed it
_COUNTS = 0.05  # format: a smaller share is not told


@dataclass(frozen=True)
class Moved:
    id: str  # of PARTS
    share: float  # of what the recalibration closes


def closes(before: float, after: float, floor: float, most: float = CLOSES) -> bool:
    """rms; whether there is a gap and what is left of its power is little: at most so much."""
    open_before = before**2 - floor**2
    return open_before > 0.0 and after**2 - floor**2 < most * open_before


def is_all(before: float, after: float, floor: float, still_open: bool, by_law: float) -> bool:
    """rms; whether what a recalibration moved is all there is to a gap: it leaves little, and if that is more than
    noise (`still_open`), then no larger a share than what has the same equations everywhere leaves."""
    return closes(before, after, floor) and (not still_open or closes(before, after, floor, by_law))


def from_the_start(fitter: Fitter, frozen: Sequence[Array], base: Fit) -> list[Moved]:
    """The parts that moved in all recordings at once, the largest share first: `base` closes the gap that the
    calibrated model leaves (`frozen`, of each recording). A registration that was wrong while calibrating has bent
    f_remain: where nothing closes the gap without it, f_remain follows it and is no cause of its own."""
    coarse, floor = fitter.coarse, fitter.floor
    before = gap.rms(frozen[1:])
    excess = max(before**2 - floor**2, 1e-300)

    def left(fit: Fit) -> float:
        return gap.rms(fit.residuals[1:])

    def closed(free: Collection[str]) -> float:
        if not free:
            return 0.0
        after = left(base) if set(free) == set(PARTS) else left(coarse.nominal(free))
        return float(np.clip((before**2 - after**2) / excess, 0.0, 1.0))

    others = (WIDTH, REMAINING, DELAY) if fitter.delayed else (WIDTH, REMAINING)
    if fitter.px and not closes(before, left(coarse.nominal(others)), floor):
        return _shares((STATIC, REMAINING), lambda parts: closed({*parts, REMAINING} if STATIC in parts else parts))
    return _shares(others, closed)


def of_named(shrinks: Sequence[tuple[str, float]]) -> list[Moved]:
    """Of effects that are parts of the nominal, each constant from the calibration or in each recording, with what
    each shrinks."""
    total = sum(max(share, 0.0) for _, share in shrinks)
    return [Moved(name, max(share, 0.0) / total) for name, share in shrinks] if total > 0.0 else []


def _shares(parts: Sequence[str], worth: Callable[[frozenset[str]], float]) -> list[Moved]:
    """Shapley's, of those that count."""
    added = [max(share, 0.0) for share in shares(parts, worth)]
    counting = [(part, share) for part, share in zip(parts, added, strict=True) if share > _COUNTS * max(added)]
    return sorted(of_named(counting), key=lambda m: -m.share)
