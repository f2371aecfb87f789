"""All causes by id: those of formats.md, and those that no list holds."""

from tools.family_two.causes.base import Cause
from tools.family_two.causes.moving import MOVING
from tools.family_two.causes.seeing import SEEING
from tools.family_two.causes.transmission import TRANSMISSION
from tools.family_two.causes.watching import WATCHING

LISTED: dict[str, type[Cause]] = {c.id: c for c in (*TRANSMISSION, *SEEING)}
UNLISTED: dict[str, type[Cause]] = {c.id: c for c in (*MOVING, *WATCHING)}
NOMINAL = ("transmission.backlash", "transmission.offset", "configuration.remaining")

__all__ = ["LISTED", "NOMINAL", "UNLISTED", "Cause"]
