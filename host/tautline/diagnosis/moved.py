"""Which parts of the nominal model (B, f_remain, registration, delay) a recalibration had to change to close a gap:
they are freed in turn, and each has its Shapley share. Sizes of a gap are rms, px or deg."""

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

CLOSES = 0.1  # loss: share of a gap's power above the noise: what leaves less has closed it
_LEAST_SHARE = 0.05  # format: of the largest share: a part with less is not listed


@dataclass(frozen=True)
class Moved:
    """A part of the nominal model that a recalibration had to change."""

    id: str  # one of fit.PARTS
    share: float  # of what the recalibration closes, 0 to 1


def closes(before: float, after: float, floor: float, most: float = CLOSES) -> bool:
    """Whether there is a gap, and the power that is left of it above the noise is below a share `most`: after^2 -
    floor^2 < most (before^2 - floor^2) and before > floor. before, after, floor: rms, px or deg."""
    open_before = before**2 - floor**2
    return open_before > 0.0 and after**2 - floor**2 < most * open_before


def closes_all(before: float, after: float, floor: float, still_open: bool, unexplained_by_law: float) -> bool:
    """Whether a recalibration closes the whole gap: it leaves less than a share CLOSES of the gap's power above the
    noise, and if that is more than noise (`still_open`), less than the share that a law may leave,
    `unexplained_by_law`. before, after, floor: rms, px or deg."""
    return closes(before, after, floor) and (not still_open or closes(before, after, floor, unexplained_by_law))


def by_freeing(fitter: Fitter, frozen: Sequence[Array], base: Fit) -> list[Moved]:
    """The parts of the nominal model that moved, the largest share first, if the recalibration `base` closes the gap:
    Shapley shares of what fits close with each set of parts free. If the gap stays open unless the registration is
    free, the registration was wrong from the start; f_remain, which had been bent by it, is then freed with it, and
    only these two share. frozen: residuals (scored, k) of each recording by the calibrated model."""
    coarse, floor = fitter.coarse, fitter.floor
    before = gap.rms(frozen[1:])
    excess = max(before**2 - floor**2, 1e-300)

    def after(fit: Fit) -> float:
        """Rms of a fit's residuals over the tests, px or deg."""
        return gap.rms(fit.residuals[1:])

    def closed(free: Collection[str]) -> float:
        """Share, 0 to 1, of the gap's power above the noise that is closed by freeing these parts. It fits them, except
        for all of PARTS, which `base` has fitted."""
        if not free:
            return 0.0
        left = after(base) if set(free) == set(PARTS) else after(coarse.nominal(free))
        return float(np.clip((before**2 - left**2) / excess, 0.0, 1.0))

    others = (WIDTH, REMAINING, DELAY) if fitter.delayed else (WIDTH, REMAINING)
    if fitter.px and not closes(before, after(coarse.nominal(others)), floor):
        return _shapley_shares(
            (STATIC, REMAINING), lambda parts: closed({*parts, REMAINING} if STATIC in parts else parts)
        )
    return _shapley_shares(others, closed)


def of_named(shrinks: Sequence[tuple[str, float]]) -> list[Moved]:
    """Makes parts that moved of named effects, all of which are parts of the nominal model; their shares sum to 1, and
    negative ones count as 0. [] where nothing shrinks. shrinks: (id, by how much it shrinks the gap)."""
    total = sum(max(share, 0.0) for _, share in shrinks)
    return [Moved(name, max(share, 0.0) / total) for name, share in shrinks] if total > 0.0 else []


def _shapley_shares(parts: Sequence[str], worth: Callable[[frozenset[str]], float]) -> list[Moved]:
    """The parts with their Shapley shares of the gap, the largest first; parts below _LEAST_SHARE of the largest are
    left out, and the shares of the others sum to 1. worth: maps a set of parts to the share of the gap that it
    closes."""
    added = [max(share, 0.0) for share in shares(parts, worth)]
    listed = [(part, share) for part, share in zip(parts, added, strict=True) if share > _LEAST_SHARE * max(added)]
    return sorted(of_named(listed), key=lambda m: -m.share)
