"""The names of the effects that a calibration's own recordings show, which a diagnosis of these recordings gives; and
the reasons of the verdict with these names."""

from __future__ import annotations

from collections.abc import Sequence

from tautline.calibration.doubts import DRIVE
from tautline.diagnosis import start
from tautline.effects import BY_ID
from tautline.errors import TautError
from tautline.model import Model
from tautline.quality import Reason
from tautline.recording import Recording

HOLDS = "the model holds it, and predicts with it: what a board's tables undo of it taut export says"
LOOKS = start.NAMES | {"residual", "repeatability"}  # what departs, by how it looks
# Departures that a diagnosis does not weigh. An effect may look like one of them, and be named in its place.
_UNWEIGHED = frozenset(
    {
        "transmission.offset",
        "transmission.backlash",
        "clock.drift",
        "registration.drift",
        "registration.breathing",
        "registration.repeatability",
    }
)


def has_unweighed(reasons: Sequence[Reason]) -> bool:
    """Whether one of the reasons is a departure that a diagnosis does not weigh against the library's effects. An
    effect that is named may then only be standing in for it."""
    return any(reason.code in _UNWEIGHED for reason in reasons)


def effects_of_diagnosis(model: Model, recordings: Sequence[Recording], progress: start.Progress) -> start.Start | None:
    """The diagnosis of which effects were in these recordings from the start, all effects of the library weighed
    against each other; None if it names none or has nothing to score. recordings: on the motor's clock, the earliest
    first."""
    try:
        told = start.of_recordings(model, recordings, progress)
    except TautError:  # nothing that a diagnosis could score
        return None
    return told if told.named else None


def reasons_with_names(reasons: Sequence[Reason], model: Model, names: Sequence[str]) -> list[Reason]:
    """The reasons, with a reason for each named effect (`names`, ids) in place of those that only say how a departure
    looks (LOOKS). A named one is mild if all that were replaced are, unless B itself holds a part of the effect."""
    replaced = [reason for reason in reasons if reason.code in LOOKS]
    mild = all(reason.mild for reason in replaced) and not start.in_the_width(model)
    seen = {reason.code: reason.says for reason in replaced}
    named = [Reason(name, seen.get(name, BY_ID[name].says), DRIVE, mild=mild) for name in names]
    return [*named, *(reason for reason in reasons if reason.code not in LOOKS | set(names))]


def reasons_with_carried(
    before: Sequence[Reason], reasons: Sequence[Reason], model: Model, predicts: bool
) -> list[Reason]:
    """The reasons of a model that carries effects, with a reason for each effect put first, mild if the model predicts.
    before: reasons of the model without effects; if one has an effect's code, its words are kept."""
    seen = {reason.code: reason.says for reason in before}
    ids = [effect.id for effect in model.effects]
    names = [
        Reason(name, seen.get(name, BY_ID[name].says), HOLDS if predicts else DRIVE, mild=predicts) for name in ids
    ]
    return [*names, *(reason for reason in reasons if reason.code not in ids)]
