"""Options that name what a command writes. Whether it can be written is found before the work is done for it."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from tautline.errors import TautError
from tautline.folders import check_replaceable, check_writable, is_stream
from tautline.model import MODEL_FILE
from tautline.recording import FILES

_READ = (*FILES, MODEL_FILE)  # what commands read of a folder


class Output(click.Path):
    """An option's path of a file or folder that will be written, checked before the work is done for it."""

    def __init__(self, key_file: str = "", file: bool = False) -> None:
        """key_file: a file that a folder must hold to be replaced, as an earlier result of the same kind has it; "":
        the path need only be writable. file: a folder is refused."""
        super().__init__(path_type=Path)
        self._key_file, self._file = key_file, file

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """The value as a Path. TautError where it could not be written."""
        path = super().convert(value, param, ctx)
        if isinstance(path, Path) and not (ctx is not None and ctx.resilient_parsing):  # the shell completes
            if self._file and path.is_dir():
                raise TautError(f"{path}: is a folder: name a file")
            check_replaceable(path, self._key_file) if self._key_file else check_writable(path)
        return path


def folder_option(name: str, help: str, required: bool = True, key_file: str = "") -> Callable[[Any], Any]:
    """An option that names an output folder, such as --out; key_file: as of Output."""
    return click.option(name, type=Output(key_file), required=required, help=help)


def check_no_input(out: Path | None, *inputs: Path | None) -> None:
    """TautError if writing the file `out` would overwrite an input: it is one of them, or a file of an input folder
    that the commands read. None stands for an input or output that was not named."""
    if out is None or is_stream(out) or out.is_dir():  # what cannot be taken for a file is told by who writes it
        return
    place = Path(os.path.realpath(out))
    for read in inputs:
        if read is None:
            continue
        known = Path(os.path.realpath(read))
        read_in_folder = place.parent == known and place.exists() and any(place.match(each) for each in _READ)
        if place == known or read_in_folder:
            raise TautError(f"{out}: would be overwritten, and is read here: name another file")
