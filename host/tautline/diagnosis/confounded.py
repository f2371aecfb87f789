"""Effects that recordings cannot tell apart because of how they were made, whatever a fit says.

A load that is held through a recording and changed between two of them changes with time as well: every step between
the recordings, of whatever cause, follows it as closely as a slope. A third load refutes that, and so does a return.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tautline.diagnosis.segment import Segment
from tautline.effects import Kind

LOAD, DRIFT = "transmission.load_dependence", "transmission.drift"

_LEVEL = 0.15  # tolerance: of the loads' span: what lies nearer together is one level, a load that varies less is held
_HIDDEN = 0.2  # prior: of a probability that two effects share: that it is the one of which nothing is recorded
_TOLD = 1.5  # tolerance: of the loads' scatter within a recording: levels that are farther apart are others
_PLACES = 12  # tolerance: over which what a motion does to its own load is averaged


def hidden(kinds: Sequence[Kind], segments: Sequence[Segment]) -> dict[str, str]:
    """{id of an effect that need not be tried: id of the one that stands for it}: drift by load dependence, where the
    load, which is recorded, changes once as time does; else {}."""
    both = {LOAD, DRIFT} <= {kind.id for kind in kinds}
    return {DRIFT: LOAD} if both and load_goes_with_time(segments) else {}


def load_tells_apart(segments: Sequence[Segment]) -> bool:
    """Whether the recordings' median loads differ by clearly more than the load scatters within one: then an offset,
    width or law of each recording could follow all that the load does. False where one has no load."""
    loads = [segment.motor.load_mNm for segment in segments]
    if any(load is None for load in loads):
        return False
    levels = [float(np.median(load)) for load in loads if load is not None]
    within = float(np.median([np.std(load) for load in loads if load is not None]))
    return max(levels) - min(levels) > _TOLD * within


def add_hidden(document: dict[str, Any], hidden: Mapping[str, str]) -> None:
    """Writes the hidden effects into a diagnosis.json, as ambiguous with those that stand for them, which give them a
    share _HIDDEN of their probability. hidden: as `hidden` gives it."""
    for name, shown in hidden.items():
        for effect in document["effects"]:
            if effect["id"] == shown:
                effect["ambiguous_with"] = sorted({*effect["ambiguous_with"], name})
        for candidate in list(document["candidates"]):
            if candidate["id"] == shown:
                share = _HIDDEN * candidate["probability"]
                candidate |= {"probability": candidate["probability"] - share, "identifiable": False}
                document["candidates"].append({**candidate, "id": name, "probability": share})
        document["candidates"].sort(key=lambda c: -c["probability"])


def load_goes_with_time(segments: Sequence[Segment]) -> bool:
    """Whether every recording has one of two load levels and the load changes once between them: then load and time
    cannot be told apart. What the load does in step with the motor's motion is not counted as a change. False where
    a recording has no load."""
    levels, within = [], []
    for segment in segments:
        load = segment.motor.load_mNm
        if load is None:
            return False
        seen = np.interp(segment.arrival_s, segment.motor.t_s, load)[segment.scored]
        levels.append(float(np.median(seen)))
        within.append(_load_spread_beside_motion(segment, seen))
    span = max(levels) - min(levels)
    if span <= 0.0 or max(within) > _LEVEL * span:
        return False
    high = [level > min(levels) + 0.5 * span for level in levels]
    nearest = [min(level - min(levels), max(levels) - level) for level in levels]
    changes = sum(a != b for a, b in pairwise(high))
    return max(nearest) < _LEVEL * span and changes == 1


def _load_spread_beside_motion(segment: Segment, load: np.ndarray) -> float:
    """Standard deviation of the slow part of the load about its mean at each place and direction of the motor, mNm.
    load: at the scored observations."""
    t = segment.arrival_s[segment.scored]
    q = np.interp(t, segment.motor.t_s, segment.motor.q)
    way = np.sign(np.gradient(q)) if len(q) > 1 else np.zeros_like(q)
    edges = np.linspace(q.min(), q.max() + 1e-12, _PLACES + 1)
    # A number for each of _PLACES places and three directions: -1, 0, 1.
    cell = (np.searchsorted(edges, q, side="right") - 1) * 3 + way.astype(int) + 1
    mean = np.bincount(cell, load) / np.maximum(np.bincount(cell), 1)
    left = load - mean[cell]
    slow = max(1, int(0.5 / max(float(np.median(np.diff(t))), 1e-3))) if len(t) > 2 else 1  # frames in 0.5 s
    return float(np.std(np.convolve(left, np.ones(slow) / slow, mode="same")))
