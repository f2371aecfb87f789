"""Load dependence and drift where the design of the experiment confounds them, whatever a fit says.

A load that is constant within each recording and changed once between two of them is a function of time as well: any
step between the recordings, of whatever cause, is then a slope over the load. A third load refutes that, and so does a
return to the first one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from tautline.diagnosis.segment import Segment
from tautline.effects import Kind

LOAD, DRIFT = "transmission.load_dependence", "transmission.drift"

_SAME_LEVEL = 0.15  # tolerance: share of the loads' span: closer levels are one, a load that varies less is constant
_UNRECORDED_SHARE = 0.2  # prior: of two confounded effects' probability, that it is the one whose cause is not recorded
_DISTINCT = 1.5  # tolerance: standard deviations of the load within a recording, beyond which two levels differ
_PLACES = 12  # tolerance: bins of the motor's position in which the load that a motion causes by itself is averaged
_SLOW_S = 0.5  # tolerance: s over which the load is averaged: faster changes are no change of load


def drift_hidden_by_load(kinds: Sequence[Kind], segments: Sequence[Segment]) -> dict[str, str]:
    """{drift's id: load dependence's id} where both are to be tried and the recorded load changes just once: the two
    are then confounded, drift is not fitted, and it is reported with a share of load dependence's probability
    (`add_hidden`). Otherwise {}."""
    both = {LOAD, DRIFT} <= {kind.id for kind in kinds}
    return {DRIFT: LOAD} if both and load_goes_with_time(segments) else {}


def load_tells_apart(segments: Sequence[Segment]) -> bool:
    """Whether the recordings' median loads, mNm, differ by more than _DISTINCT times the load's standard deviation
    within a recording. An offset, width or f_remain of its own for each recording could then imitate any effect of the
    load. False where a recording has no load."""
    loads = [segment.motor.load_mNm for segment in segments]
    if any(load is None for load in loads):
        return False
    levels = [float(np.median(load)) for load in loads if load is not None]
    within = float(np.median([np.std(load) for load in loads if load is not None]))
    return max(levels) - min(levels) > _DISTINCT * within


def add_hidden(document: dict[str, Any], hidden: Mapping[str, str]) -> None:
    """Adds the effects that were not fitted to a diagnosis.json's content, changing `document`: each is listed as
    ambiguous with the fitted effect that it is confounded with, and takes a share _UNRECORDED_SHARE of its probability.
    hidden: {id of the effect that was not fitted: id of the fitted one}."""
    for name, fitted in hidden.items():
        for effect in document["effects"]:
            if effect["id"] == fitted:
                effect["ambiguous_with"] = sorted({*effect["ambiguous_with"], name})
        for candidate in list(document["candidates"]):
            if candidate["id"] == fitted:
                share = _UNRECORDED_SHARE * candidate["probability"]
                candidate |= {"probability": candidate["probability"] - share, "identifiable": False}
                document["candidates"].append({**candidate, "id": name, "probability": share})
        document["candidates"].sort(key=lambda c: -c["probability"])


def load_goes_with_time(segments: Sequence[Segment]) -> bool:
    """Whether load and time are confounded: each recording has one of two constant loads, mNm, and over the session the
    load changes between them once. A load that varies only in step with the motor's motion counts as constant. False
    where a recording has no load."""
    levels, variation = [], []
    for segment in sorted(segments, key=lambda recording: recording.end_s):
        load = segment.motor.load_mNm
        if load is None:
            return False
        seen = np.interp(segment.arrival_s, segment.motor.t_s, load)[segment.scored]
        levels.append(float(np.median(seen)))
        variation.append(_load_variation_beside_motion(segment, seen))
    lowest, highest = min(levels), max(levels)
    span = highest - lowest
    if span <= 0.0 or max(variation) > _SAME_LEVEL * span:
        return False
    is_high = [level > lowest + 0.5 * span for level in levels]
    off_either_level = [min(level - lowest, highest - level) for level in levels]
    changes = sum(before != after for before, after in pairwise(is_high))
    return max(off_either_level) < _SAME_LEVEL * span and changes == 1


def _load_variation_beside_motion(segment: Segment, load: np.ndarray) -> float:
    """Standard deviation, mNm, of the part of the load that the motor's motion does not explain: the load minus its
    mean at each place and direction of the motor, averaged over _SLOW_S. load: (scored,), mNm."""
    t = segment.arrival_s[segment.scored]
    q = np.interp(t, segment.motor.t_s, segment.motor.q)
    direction = np.sign(np.gradient(q)) if len(q) > 1 else np.zeros_like(q)
    inner_edges = np.linspace(q.min(), q.max(), _PLACES + 1)[1:-1]
    # A number for each of _PLACES places and three directions: -1, 0, 1.
    cell = np.searchsorted(inner_edges, q, side="right") * 3 + direction.astype(int) + 1
    mean = np.bincount(cell, load) / np.maximum(np.bincount(cell), 1)
    unexplained = load - mean[cell]
    frames = max(1, int(_SLOW_S / float(np.median(np.diff(t))))) if len(t) > 1 else 1  # in _SLOW_S
    return float(np.std(np.convolve(unexplained, np.ones(frames) / frames, mode="same")))
