"""The names of what a calibration's own recordings show beside its model: those that a diagnosis of them gives."""

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
# What is not weighed, and what effects that are may look like: they may as well stand in for it.
_OTHERS = frozenset(
    {
        *("transmission.offset", "transmission.backlash", "clock.drift"),
        *("registration.drift", "registration.breathing", "registration.repeatability"),
    }
)


def others(reasons: Sequence[Reason]) -> bool:
    """Whether one of the reasons is something that is not weighed against the library's effects: then an effect has its
    name only if the fit with it leaves as little of the frames as all that departs does."""
    return any(reason.code in _OTHERS for reason in reasons)


def asked(model: Model, recordings: Sequence[Recording], progress: start.Progress) -> start.Start | None:
    """All of the library's effects, weighed against each other; None where none is likelier than something unknown.
    recordings: on the motor's clock, the earliest first."""
    try:
        told = start.of_recordings(model, recordings, progress)
    except TautError:  # nothing that a diagnosis could score
        return None
    return told if told.named else None


def named(reasons: Sequence[Reason], model: Model, told: Sequence[str]) -> list[Reason]:
    """The reasons with what departs under these names. A name is as much of a doubt as what it stands for, and one
    where B itself holds a part of it."""
    stands_for = [reason for reason in reasons if reason.code in LOOKS]
    mild = all(reason.mild for reason in stands_for) and not start.in_the_width(model)
    seen = {reason.code: reason.says for reason in stands_for}
    names = [Reason(name, seen.get(name, BY_ID[name].says), DRIVE, mild=mild) for name in told]
    return [*names, *(reason for reason in reasons if reason.code not in LOOKS | set(told))]


def carried(before: Sequence[Reason], reasons: Sequence[Reason], model: Model, predicts: bool) -> list[Reason]:
    """The reasons of a model that carries effects, with their names. before: of the one that does not."""
    seen = {reason.code: reason.says for reason in before}
    ids = [effect.id for effect in model.effects]
    names = [
        Reason(name, seen.get(name, BY_ID[name].says), HOLDS if predicts else DRIVE, mild=predicts) for name in ids
    ]
    return [*names, *(reason for reason in reasons if reason.code not in ids)]
