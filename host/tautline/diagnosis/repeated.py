"""Samples that a sensor's link sends twice (`acquisition.held_samples`). Where a continuous sensor shows the same value
again to the last digit that is certain, so no fit has to find it: such samples are no observations
(segment.are_repeats), and what they add to the gap is put into the finished diagnosis.json. No model knows which sample
of another motion will be a repeat: like every event they shrink nothing, and stay in the gap after the correction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import spread
from tautline.diagnosis import gap
from tautline.diagnosis.fitted import Scope
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.segment import Segment
from tautline.effects import BY_ID
from tautline.model import Model

Array = npt.NDArray[np.float64]

HELD = "acquisition.held_samples"
_SEEN = 0.1  # loss: share of the noise power by which repeats must raise the gap's to be reported
_SURE = 0.98  # format: the probability of what is certain
_AS_OFTEN = 0.5  # loss: of the largest share of repeats in a test: a calibration with more has had them too


def add_repeats(document: dict[str, Any], model: Model, segments: Sequence[Segment], load_reference: float) -> None:
    """Adds to a diagnosis.json's content, changing `document`, what repeated samples contribute to the gap of `model`.
    They are named as an effect if they are most of the gap, or beside other named effects. Does nothing if they surely
    add less than a share _SEEN of the noise power. segments: the calibration first. load_reference: mNm at which the
    model's tables hold."""
    power, fresh_power, surely_added = _powers(model, segments[1:], load_reference)
    floor2 = document["noise_floor"] ** 2
    if surely_added < _SEEN * floor2:
        return
    share_of_gap = (power - fresh_power) / max(power - floor2, 1e-300)  # by the best estimate
    alone = document["verdict"] == "none"
    probability = _add_candidate(document, _SURE if alone else min(share_of_gap, _SURE))
    leads = probability > 0.5
    named = leads or document["verdict"] == "effect"  # else most of the gap has another, unknown cause
    closed = document["gap"]["shrink"]
    _count_repeats_in_gap(document, power, power - fresh_power)
    if closed != 0.0:
        goes_with_time = document["verdict"] == "effect" and any(BY_ID[e["id"]].course for e in document["effects"])
        set_shrinkages(document["gap"], floor2, learnt().later if goes_with_time else learnt().elsewhere)
    document["count"] = _count_with_one_more(document["count"], _SURE if named else probability)
    if named:
        scale_shares(document["effects"], document["gap"]["shrink"], closed)
        _name_repeats(document, segments, float(np.sqrt(power - fresh_power)), leads)


def _powers(model: Model, tests: Sequence[Segment], load_reference: float) -> tuple[float, float, float]:
    """(Mean square of the residuals of all frames, that of the frames which repeat none, a lower bound of their
    difference), px^2 or deg^2 a coordinate. The number of stalls of the link is a Poisson number; for the bound the
    difference is scaled as if there had been fewer of them by NINE_OF_TEN standard deviations, so nothing is left of
    one or two."""
    squares, fresh, frames, stalls = 0.0, 0.0, 0, 0
    for segment in tests:
        power = np.mean(np.square(segment.observed - segment.predict(model, {}, load_reference)[1]), axis=1)
        squares += float(np.sum(power[segment.scored | segment.held]))
        fresh += float(np.sum(power[segment.scored]))
        frames += int(np.sum(segment.scored | segment.held))
        stalls += int(np.sum(np.diff(segment.held.astype(np.int8), prepend=0) > 0))
    without = fresh / max(sum(int(s.scored.sum()) for s in tests), 1)
    # What happened once or twice may be a coincidence: a Poisson number's standard deviation is its root. How large
    # stalls are says nothing of that: one in mid-stroke may hold nine tenths of what all add.
    surely = max(0.0, 1.0 - spread.NINE_OF_TEN / float(np.sqrt(max(stalls, 1))))
    return squares / frames, without, surely * (squares / frames - without)


def _add_candidate(document: dict[str, Any], probability: float) -> float:
    """Adds held samples to the candidates of `document`, or replaces them there, and returns their probability:
    `probability`, which all others give up in proportion, plus what is left of the one that they had as a
    candidate."""
    for candidate in document["candidates"]:
        candidate["probability"] *= 1.0 - probability
    document["probability_none"] *= 1.0 - probability
    document["probability_unknown"] *= 1.0 - probability
    probability += sum(candidate["probability"] for candidate in document["candidates"] if candidate["id"] == HELD)
    entry = {"id": HELD, "probability": probability, "shrink": 0.0, "identifiable": True}
    others = [candidate for candidate in document["candidates"] if candidate["id"] != HELD]
    document["candidates"] = sorted([entry, *others], key=lambda c: -c["probability"])
    return probability


def scale_shares(named: Sequence[dict[str, Any]], shrink: float, before: float) -> None:
    """Scales the shares of the `named` effects, changed in place, so that they sum to the gap's shrinkage `shrink`, and
    no more to the one of the gap without held samples, `before`."""
    for effect in named:
        for part in (effect, *effect.get("brings", ())):
            part["shrink"] *= shrink / before if before else 0.0


def _name_repeats(document: dict[str, Any], segments: Sequence[Segment], adds: float, leads: bool) -> None:
    """Makes held samples a named effect of `document`, the first one if it `leads`, else the last; they count as there
    from the start if the calibration has about as many. adds: rms, px or deg, that they add to the gap (root of the
    difference of the mean squares)."""
    held_shares = [int(s.held.sum()) / max(int((s.scored | s.held).sum()), 1) for s in segments]
    if document["verdict"] == "unknown":
        document["effects"] = []
    held = {
        "id": HELD,
        "probability": _SURE,
        "since": (Scope.START if held_shares[0] > _AS_OFTEN * max(held_shares[1:]) else Scope.TESTS).since,
        "parameters": {"held_share": sum(held_shares[1:]) / len(held_shares[1:])},
        "shrink": 0.0,
        "adds": adds,
        "swallowed_by_recalibration": False,
        "loads_on_board": BY_ID[HELD].on_board,
        "ambiguous_with": [],
    }
    rest = [effect for effect in document["effects"] if effect["id"] != HELD]
    document["effects"] = [held, *rest] if leads else [*rest, held]
    document["verdict"] = "effect"
    if leads:
        document["where"]["stage"] = BY_ID[HELD].stage


def _count_with_one_more(count: Sequence[float], probability: float) -> list[float]:
    """The probabilities of 0, 1, 2 and 3 or more effects after an effect is added with this probability to those of
    `count`."""
    none, one, two, more = count
    shifted = (0.0, none, one, two + more)
    return [probability * new + (1.0 - probability) * old for new, old in zip(shifted, count, strict=True)]


def _count_repeats_in_gap(document: dict[str, Any], power: float, added: float) -> None:
    """Changes the sizes of the gap in `document` so that its mean square before is `power`, of which repeated samples
    contribute `added` (px^2 or deg^2). A recalibration, or any other effect, alone or named, leaves `added` as it
    is."""
    recalibrated, fresh, before = document["gap_recalibrated"], document["gap"]["before"], float(np.sqrt(power))
    set_size(document["gap"], "before", before)
    set_size(document["gap"], "after", float(np.sqrt(document["gap"]["after"] ** 2 + added)))
    recalibrated["before"] = float(np.sqrt(recalibrated["before"] ** 2 + added))
    for candidate in document["candidates"]:
        if candidate["id"] != HELD:
            left = (1.0 - candidate["shrink"]) * fresh
            candidate["shrink"] = 1.0 - float(np.sqrt(left**2 + added)) / before


def set_size(sizes: dict[str, Any], which: str, rms: float) -> None:
    """Sets the rms "before" or "after" (`which`) of `sizes` (diagnosis.json's `gap`, changed in place) to `rms`, px or
    deg, which includes repeated samples; its interval is scaled alike."""
    fresh = sizes[which]
    sizes[which], sizes[f"{which}_ci"] = rms, [rms / fresh * end for end in sizes[f"{which}_ci"]]


def set_shrinkages(sizes: dict[str, Any], floor2: float, excess: tuple[float, float]) -> None:
    """Computes anew the shrinkages of `sizes` (diagnosis.json's `gap`, changed in place) from its rms before and after,
    as repeated samples are named too. The interval covers other blocks, by the worst ends of both rms intervals, and
    other motions. floor2: noise power; excess: as in `gap.shrink_interval_elsewhere`."""
    (before_low, before_high), (after_low, after_high) = sizes["before_ci"], sizes["after_ci"]
    ratio = sizes["after"] / sizes["before"]
    low, high = gap.shrink_interval_elsewhere(ratio, excess)
    sizes["shrink"] = 1.0 - ratio
    sizes["shrink_ci"] = [min(1.0 - after_high / before_low, low), max(1.0 - after_low / before_high, high)]
    left = (sizes["after"] ** 2 - floor2) / max(sizes["before"] ** 2 - floor2, 1e-12)
    sizes["closable_shrink"] = float(np.clip(1.0 - left, 0.0, 1.0))
