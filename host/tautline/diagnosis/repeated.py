"""Samples that a sensor's link repeats: known for certain where a continuous sensor shows the same value twice, so no
fit has to find them. They are no observations; what they add to the gap is `acquisition.held_samples`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import spread
from tautline.diagnosis.fitted import Scope
from tautline.diagnosis.segment import Segment
from tautline.effects import BY_ID
from tautline.model import Model

Array = npt.NDArray[np.float64]

HELD = "acquisition.held_samples"
_SEEN = 0.1  # loss: of the floor's power, by which repeats raise the gap's
_SURE = 0.98


def add_repeats(document: dict[str, Any], model: Model, segments: Sequence[Segment], load_reference: float) -> None:
    """Writes into a diagnosis.json what repeated samples add to the gap of `model`, and names them where they are much
    of it. segments: the calibration first."""
    power, without, added = _powers(model, segments[1:], load_reference)
    floor2 = document["noise_floor"] ** 2
    if added < _SEEN * floor2:
        return
    share = (power - without) / max(power - floor2, 1e-300)  # of the gap
    closed = 1.0 - float(np.sqrt(without / power))
    alone = document["verdict"] == "none"
    probability = _weigh_repeats(document, _SURE if alone else min(share, _SURE), closed)
    leads = probability > 0.5
    told = leads or document["verdict"] == "effect"
    _count_repeats_in_gap(document["gap"], float(np.sqrt(power)), floor2, told)
    document["count"] = _with_one_more(document["count"], _SURE if told else probability)
    if told:  # else most of it has another, unknown cause
        _name_repeats(document, segments, closed, leads)


def _powers(model: Model, tests: Sequence[Segment], load_reference: float) -> tuple[float, float, float]:
    """Mean squares of what the model leaves of a coordinate, px^2 or deg^2: of all frames, of those that repeat none,
    and by how much the former is surely more for the repeated ones."""
    squares, fresh, frames = 0.0, 0.0, 0
    stalls: list[Array] = []  # a row each: its frames' squares, how many they are
    for segment in tests:
        left = np.mean(np.square(segment.observed - segment.predict(model, {}, load_reference)[1]), axis=1)
        squares += float(np.sum(left[segment.scored | segment.held]))
        fresh += float(np.sum(left[segment.scored]))
        frames += int(np.sum(segment.scored | segment.held))
        at = np.flatnonzero(segment.held)
        each = np.split(at, np.flatnonzero(np.diff(at) > 1) + 1) if len(at) else []
        stalls += [np.array([np.sum(left[stall]), len(stall)]) for stall in each]
    without = fresh / max(sum(int(s.scored.sum()) for s in tests), 1)
    added = np.array([total - count * without for total, count in stalls])
    # What happened once or twice by itself is a coincidence and no law: by a compound Poisson's standard error.
    surely = float(np.sum(added)) - spread.NINE_OF_TEN * float(np.linalg.norm(added))
    return squares / frames, without, surely / frames


def _weigh_repeats(document: dict[str, Any], probability: float, closed: float) -> float:
    """Puts held samples among the candidates with `probability`, which the others give up, beside what they had as a
    candidate already. closed: share of the gap's rms that they are. Returns their probability."""
    for candidate in document["candidates"]:
        candidate["probability"] *= 1.0 - probability
    document["probability_none"] *= 1.0 - probability
    document["probability_unknown"] *= 1.0 - probability
    probability += sum(candidate["probability"] for candidate in document["candidates"] if candidate["id"] == HELD)
    entry = {"id": HELD, "probability": probability, "shrink": closed, "identifiable": True}
    others = [candidate for candidate in document["candidates"] if candidate["id"] != HELD]
    document["candidates"] = sorted([entry, *others], key=lambda c: -c["probability"])
    return probability


def _name_repeats(document: dict[str, Any], segments: Sequence[Segment], closed: float, leads: bool) -> None:
    """Makes held samples a named effect, the first one if it leads; the shrinkages of the others are then shares of
    what they leave. closed: share of the gap's rms that they are."""
    repeats = [int(s.held.sum()) / max(int((s.scored | s.held).sum()), 1) for s in segments]
    if document["verdict"] == "unknown":
        document["effects"] = []
    for effect in document["effects"]:
        for part in (effect, *effect.get("brings", ())):
            part["shrink"] *= 1.0 - closed
    held = {
        "id": HELD,
        "probability": _SURE,
        "since": (Scope.START if repeats[0] > 0.5 * max(repeats[1:]) else Scope.TESTS).since,
        "parameters": {"held_share": sum(repeats[1:]) / len(repeats[1:])},
        "shrink": closed,
        "swallowed_by_recalibration": False,
        "loads_on_board": BY_ID[HELD].on_board,
        "ambiguous_with": [],
    }
    rest = [effect for effect in document["effects"] if effect["id"] != HELD]
    document["effects"] = [held, *rest] if leads else [*rest, held]
    document["verdict"] = "effect"
    if leads:
        document["where"]["stage"] = BY_ID[HELD].stage


def _with_one_more(count: Sequence[float], probability: float) -> list[float]:
    """The probabilities of 0, 1, 2 and 3 or more effects when with `probability` there is one more that was not
    counted."""
    none, one, two, more = count
    return [probability * w + (1.0 - probability) * o for w, o in zip((0.0, none, one, two + more), count, strict=True)]


def _count_repeats_in_gap(told: dict[str, Any], before: float, floor2: float, named: bool) -> None:
    """Changes a gap's figures so that `before` includes the repeated samples and `after` has each as far off as the
    sample that it repeats; intervals are combined at their worst ends. floor2: noise power."""
    wider = before / told["before"]
    told["before"], told["before_ci"] = before, [wider * end for end in told["before_ci"]]
    if named:
        (least, most), (low, high) = told["before_ci"], told["after_ci"]
        told["shrink"], told["shrink_ci"] = 1.0 - told["after"] / before, [1.0 - high / least, 1.0 - low / most]
        left = (told["after"] ** 2 - floor2) / max(before**2 - floor2, 1e-12)
        told["closable_shrink"] = float(np.clip(1.0 - left, 0.0, 1.0))
