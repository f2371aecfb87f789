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

LOOKS = start.NAMES | {"residual", "repeatability"}  # what departs, by how it looks
# What no effect that was there from the start looks like: weighed without it, others would stand in for it.
_OTHERS = frozenset(
    {
        *("transmission.offset", "transmission.backlash", "clock.drift"),
        *("registration.drift", "registration.breathing", "registration.repeatability"),
    }
)


def named(
    reasons: Sequence[Reason], model: Model, recordings: Sequence[Recording], progress: start.Progress
) -> list[Reason]:
    """The reasons with what departs under the name that all of the library's effects, weighed against each other, give
    it; as they are where none of them is likelier than something unknown. A name is as much of a doubt as what it
    stands for, and one where B itself holds a part of it. recordings: on the motor's clock, the earliest first."""
    if any(reason.code in _OTHERS for reason in reasons):
        return list(reasons)
    try:
        told = start.of_recordings(model, recordings, progress).named
    except TautError:  # nothing that a diagnosis could score
        return list(reasons)
    if not told:
        return list(reasons)
    stands_for = [reason for reason in reasons if reason.code in LOOKS]
    mild = all(reason.mild for reason in stands_for) and not start.in_the_width(model)
    seen = {reason.code: reason.says for reason in stands_for}
    names = [Reason(name, seen.get(name, BY_ID[name].says), DRIVE, mild=mild) for name in told]
    return [*names, *(reason for reason in reasons if reason.code not in LOOKS | set(told))]
