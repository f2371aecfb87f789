"""Where in the range B was measured, which is where the tip passed both ways and turned; and where in the rest it could
be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.calibration.playfit import Fitted
from tautline.model import Model

Array = npt.NDArray[np.float64]
Span = tuple[float, float]

HOLE = 0.03  # tolerance: of the range, without a frame one way: passed for all that
_LEANS = 0.3  # tolerance: share of the elements that are at their ends, from which a place is passed one way
_EDGE = 0.05  # tolerance: of the range: so much of what can be seen may be missing at either end


@dataclass(frozen=True)
class Gap:
    """Positions at which B is not measured, unit of q, and why."""

    low: float
    high: float
    why: str

    def says(self, unit: str) -> str:
        """The gap in words. unit: of q."""
        return f"{not_measured([(self.low, self.high)], unit)}: {self.why}"


def not_measured(spans: Sequence[Span], unit: str) -> str:
    """The words that B is not known in these spans, each from its lowest to its highest position in q's unit, as
    reports and live calibrations have them."""
    return f"B is not measured {' and '.join(f'from {low:.3g} to {high:.3g} {unit}' for low, high in spans)}"


def seeable(model: Model, low: float, high: float) -> Span:
    """The lowest and highest position at which B has to be measured for a motor that goes from `low` to `high`. It
    leaves out B/2 at either end, where B cannot be seen, and _EDGE of the range, which may be missing."""
    free = _EDGE * (high - low)
    return low + 0.5 * float(model.width[0]) + free, high - 0.5 * float(model.width[-1]) - free


def distance_to_both_ways(joint_fit: Fitted, grid: Array) -> Array:
    """(grid,) distance, unit of q, from each position to the nearest counted frame of a rising tip or to that of a
    falling one, whichever is farther: 0 where the tip passed both ways. inf everywhere if one way has no frame. The
    fit's last simulation must be that of its own curves."""
    seen = [(s.p[mask], s.lean[mask]) for s, mask in zip(joint_fit.fit.simulated, joint_fit.masks, strict=True)]
    by_direction = [np.unique(np.concatenate([p[way * lean > _LEANS] for p, lean in seen])) for way in (-1, 1)]
    if not all(len(p) for p in by_direction):
        return np.full(len(grid), np.inf)
    return np.asarray(
        np.max([np.min(np.abs(grid[:, None] - _neighbours(p, grid)), axis=1) for p in by_direction], axis=0)
    )


def gaps(model: Model, apart: Array | None) -> tuple[Gap, ...]:
    """The stretches, the lowest first, in which B can be seen (`seeable`) but is not measured: not passed both ways
    within HOLE of the range, or beyond all turns. apart (grid,): `distance_to_both_ways` on the model's grid; None if
    that is not known, and passes are not asked for."""
    low, high = float(model.q[0]), float(model.q[-1])
    first, last = seeable(model, low, high)
    passed = np.ones(len(model.q), dtype=bool) if apart is None else apart <= HOLE * (high - low)
    from_turn, to_turn = model.measured  # equal if no range of turns was measured
    turned = (model.q >= from_turn) & (model.q <= to_turn) & (from_turn < to_turn)
    seen = np.flatnonzero((model.q >= first) & (model.q <= last))
    missing = seen[~(passed & turned)[seen]]
    runs = np.split(missing, np.flatnonzero(np.diff(missing) > 1) + 1) if len(missing) else []
    unturned = "no turn there gave a width" if apart is None else "passed both ways, but no turn there gave a width"
    why = ["never passed both ways" if not passed[run].all() else unturned for run in runs]
    return tuple(Gap(*_to_the_ends(model.q, run, seen), each) for run, each in zip(runs, why, strict=True))


def _to_the_ends(q: Array, run: npt.NDArray[np.intp], seen: npt.NDArray[np.intp]) -> Span:
    """Lowest and highest position of a run of indices of the grid q (grid,). A run that reaches the first or the last
    index of `seen`, the nodes where B can be seen, is extended to that end of the grid."""
    return float(q[0 if run[0] == seen[0] else run[0]]), float(q[-1 if run[-1] == seen[-1] else run[-1]])


def _neighbours(p: Array, at: Array) -> Array:
    """(places, 2) for each place `at` (places,) the nearest of the sorted positions p (n,) below it and above it; for a
    place outside of all p its nearest one, twice."""
    k = np.searchsorted(p, at)
    return np.column_stack([p[np.clip(k - 1, 0, len(p) - 1)], p[np.clip(k, 0, len(p) - 1)]])


def to_json(missing: Sequence[Gap], unit: str) -> dict[str, object]:
    """`coverage` of what `taut calibrate --json` prints: the gaps, from and to in the unit of q (`unit`)."""
    return {"missing": [{"from": gap.low, "to": gap.high, "says": gap.says(unit)} for gap in missing]}
