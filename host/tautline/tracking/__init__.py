"""A model that stays calibrated while the instrument is used."""

from tautline.tracking.replay import Tracked, off_by, replay, residuals, write_csv
from tautline.tracking.tracker import Change, Row, State, Tracker

__all__ = ["Change", "Row", "State", "Tracked", "Tracker", "off_by", "replay", "residuals", "write_csv"]
