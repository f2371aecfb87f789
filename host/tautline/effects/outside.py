"""Effects of other installed distributions: entry points of the group `tautline.effects`, each a tuple of descriptors
whose laws are in Python.

    [project.entry-points."tautline.effects"]
    breath = "my_effects:EFFECTS"
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from importlib.metadata import EntryPoint, entry_points

from tautline.effects.kind import STAGES, THROUGH_ANGLE, Kind
from tautline.errors import TautError

GROUP = "tautline.effects"


def installed_effects(known: Sequence[Kind]) -> list[Kind]:
    """Loads the effects of all installed distributions, in the order of their entry points' names. known: the library's
    effects. TautError where an entry point cannot be loaded, or an effect is incomplete or shares an id or a
    parameter's name with another one."""
    found: list[Kind] = []
    for entry in sorted(entry_points(group=GROUP), key=lambda entry: entry.name):
        for kind in _loaded(entry):
            _check(entry, kind, [*known, *found])
            found.append(kind)
    return found


def _loaded(entry: EntryPoint) -> Sequence[Kind]:
    """Imports an entry point and returns its descriptors. TautError where the import fails, or where it gives no tuple
    of descriptors."""
    try:
        kinds = entry.load()
    except Exception as error:  # of somebody else's module: anything
        if _is_being_imported(entry):
            raise TautError(
                f"{_entry_in_words(entry)} cannot be taken while it is being imported: put "
                "'import tautline.effects' before it"
            ) from error
        raise TautError(f"{_entry_in_words(entry)} cannot be imported ({error}): mend or uninstall it") from error
    if not isinstance(kinds, tuple) or not all(isinstance(kind, Kind) for kind in kinds):
        raise TautError(f"{_entry_in_words(entry)} is no tuple of tautline.effects.Kind: mend or uninstall it")
    return kinds


def _is_being_imported(entry: EntryPoint) -> bool:
    """Whether Python is still executing the entry point's module: that module imported tautline, which now asks for
    it."""
    return bool(getattr(getattr(sys.modules.get(entry.module), "__spec__", None), "_initializing", False))


def _check(entry: EntryPoint, kind: Kind, known: Sequence[Kind]) -> None:
    """Raises TautError where an effect of another distribution is incomplete, claims what only the library can do
    (events, tables), or has the id or a parameter's name of one of the effects in `known`."""

    def refuse(why: str) -> TautError:
        """Makes (does not raise) the error, with the reason `why` in words."""
        return TautError(f"{_entry_in_words(entry)}: {kind.id} {why}: mend or uninstall it")

    if kind.stage not in THROUGH_ANGLE or kind.id.count(".") != 1:
        raise refuse(f"is no STAGE.NAME of {', '.join(STAGES[:3])}")
    if kind.transform is None or not kind.amplitudes:
        raise refuse("needs a transform and at least one amplitude")
    if kind.holds is not None or kind.event is not None or kind.in_tables or kind.undone:
        raise refuse("can be no event, and in no table of a model or a board")
    if not (kind.says and kind.tell.endswith(".") and kind.mend.endswith(".")):
        raise refuse("needs says, and tell and mend in sentences: 'taut explain' prints them")
    if any(kind.id == other.id for other in known):
        raise refuse("is there already")
    names = {parameter.name for other in known for form in other.forms for parameter in form.parameters}
    if in_common := sorted(names & {parameter.name for parameter in kind.parameters}):
        raise refuse(f"has a parameter {in_common[0]} that another effect has")


def _entry_in_words(entry: EntryPoint) -> str:
    """Names an entry point and its distribution, for an error message."""
    distribution = entry.dist.name if entry.dist else "an unknown distribution"
    return f"the effects {entry.name} ({entry.value}) of {distribution}"
