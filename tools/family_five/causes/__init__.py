"""All causes by id: those that formats.md lists, those of them that only move, those that no list holds."""

from tools.family_five.causes import drive, hidden_drive, hidden_watch, watch
from tools.family_five.causes.base import Cause

LISTED: dict[str, type[Cause]] = {c.id: c for c in (*drive.DRIVE, *watch.WATCH)}
NOMINAL = ("transmission.backlash", "transmission.offset", "configuration.remaining")
UNLISTED: dict[str, type[Cause]] = {c.id: c for c in (*hidden_drive.DRIVE, *hidden_watch.WATCH)}

__all__ = ["LISTED", "NOMINAL", "UNLISTED", "Cause"]
