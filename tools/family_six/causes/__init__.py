"""Every cause by its id: those that formats.md lists and those that no list holds."""

from tools.family_six.causes import drive, seen, unlisted
from tools.family_six.causes.base import Cause

LISTED: dict[str, type[Cause]] = {c.id: c for c in (*drive.EVERY, *seen.EVERY)}
UNLISTED: dict[str, type[Cause]] = {c.id: c for c in unlisted.EVERY}
for _kind in UNLISTED.values():
    _kind.unlisted = True
NOMINAL = ("transmission.backlash", "transmission.offset", "configuration.remaining")  # only moved

__all__ = ["LISTED", "NOMINAL", "UNLISTED", "Cause"]
