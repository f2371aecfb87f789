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
    """What the operating system refused, in one line: a name that is too long, a full disk, a folder without
    permission."""
    name = str(error.filename) if error.filename is not None else "a file"
    shown = name if len(name) <= _LONGEST_NAME else f"{name[:40]}...{name[-20:]} ({len(name)} characters)"
    return f"{shown}: {error.strerror or error}: name another file or folder, or make room and permission for this one"


_ALIKE = 0.75  # display: of two words: one may be the other, misspelt


def nearest(word: str, known: Iterable[str]) -> str | None:
    """Which of the known words somebody may have meant, if any."""
    plain = {name.lower().replace("_", "").replace("-", ""): name for name in known}
    close = difflib.get_close_matches(word.lower().replace("_", "").replace("-", ""), plain, 1, _ALIKE)
    return plain[close[0]] if close else None


def check_start(start_deg: float | None) -> None:
    """TautError where an angle that the tip starts at was given, deg, and is no number."""
    if start_deg is not None and not math.isfinite(start_deg):
        raise TautError("the tip starts at an angle that is no number: give it in deg")
