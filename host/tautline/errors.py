"""Errors that a user can act on: one line that says what is wrong, where, and what to do."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable

# format of all: of a message


class TautError(Exception):
    """Its text is printed as it is, without a traceback; the command then exits with `status`."""

    status = 1


class UnusableError(TautError):
    """A calibration that nothing should be driven with."""

    status = 3


_LONGEST_NAME = 120  # display: characters of a file's name that an error shows


def of_system(error: OSError) -> str:
    """The message, in one line, of what the operating system refused: a name that is too long, a full disk, a folder
    without permission. A long file name is shortened in it."""
    name = str(error.filename) if error.filename is not None else "a file"
    shown = name if len(name) <= _LONGEST_NAME else f"{name[:40]}...{name[-20:]} ({len(name)} characters)"
    return f"{shown}: {error.strerror or error}: name another file or folder, or make room and permission for this one"


_ALIKE = 0.75  # display: of two words: one may be the other, misspelt


def nearest(word: str, known: Iterable[str]) -> str | None:
    """The known word that is most like `word`, in case somebody misspelt it; None where none is alike enough. Upper
    case, - and _ do not count."""
    plain = {name.lower().replace("_", "").replace("-", ""): name for name in known}
    close = difflib.get_close_matches(word.lower().replace("_", "").replace("-", ""), plain, 1, _ALIKE)
    return plain[close[0]] if close else None


def check_start(start_deg: float | None) -> None:
    """Raises TautError where start_deg, the angle at which the tip starts, deg, is given and no finite number."""
    if start_deg is not None and not math.isfinite(start_deg):
        raise TautError("the tip starts at an angle that is no number: give it in deg")
