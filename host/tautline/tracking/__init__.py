"""A model that stays calibrated while the instrument is used."""

from tautline.tracking.loop import Tracker
from tautline.tracking.replay import Tracked, off_by, replay, residuals, write_csv
from tautline.tracking.tracker import Change, LawTracker, Row, State

__all__ = ["Change", "LawTracker", "Row", "State", "Tracked", "Tracker", "off_by", "replay", "residuals", "write_csv"]
