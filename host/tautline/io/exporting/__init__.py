"""Recordings, models and diagnoses as files of other programs: log viewers, simulators, motor controllers."""

from tautline.io.exporting.export import Exported, Mount, export
from tautline.io.exporting.formats import FORMATS, Format

__all__ = ["FORMATS", "Exported", "Format", "Mount", "export"]
