"""tautline: measure and undo what a tendon-driven instrument loses between motor and tip."""

from importlib.metadata import version

__version__ = version("tautline")
