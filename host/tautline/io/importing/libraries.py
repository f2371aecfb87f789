"""The libraries that read other programs' files: an extra of the package, asked for only where a file needs one."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from tautline.errors import TautError

EXTRA = "pip install 'tautline-robotics[import]'"


def library(module: str, reads: str) -> Any:
    """Imports a module of a library that is optional. reads: what it is needed for, for the error. TautError, with the
    command that installs it, where it is missing."""
    try:
        return import_module(module)
    except ImportError as error:
        raise TautError(f"{reads} is read with {module.partition('.')[0]}, which is not installed: {EXTRA}") from error
