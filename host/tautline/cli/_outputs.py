"""Options that name what a command writes. That it can be written is checked before the command does its work."""

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

_READ = (*FILES, MODEL_FILE)  # files that commands read from an input folder


class Output(click.Path):
    """A type of options: the path of a file or folder that will be written, which is checked when the command line is
    read, so before the command does its work."""

    def __init__(self, key_file: str = "", file: bool = False) -> None:
        """key_file: name of a file that earlier results of the same kind hold: a folder that is not empty and does not
        hold it is refused; "": the path need only be writable. file: whether a folder is refused."""
        super().__init__(path_type=Path)
        self._key_file, self._file = key_file, file

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Converts the option's value to a Path. TautError where it could not be written, or is refused (see __init__).
        While the shell completes a command line nothing is checked."""
        path = super().convert(value, param, ctx)
        if isinstance(path, Path) and not (ctx is not None and ctx.resilient_parsing):  # no completion by the shell
            if self._file and path.is_dir():
                raise TautError(f"{path}: is a folder: name a file")
            check_replaceable(path, self._key_file) if self._key_file else check_writable(path)
        return path


def folder_option(name: str, help: str, required: bool = True, key_file: str = "") -> Callable[[Any], Any]:
    """A decorator that gives a command an option for an output folder, such as --out. help: its help text; key_file: as
    in `Output`."""
    return click.option(name, type=Output(key_file), required=required, help=help)


def check_no_input(out: Path | None, *inputs: Path | None) -> None:
    """Raises a TautError if writing the file `out` would overwrite an input: if it is one of `inputs`, or an existing
    file in an input folder that commands read. None stands for an input or output that was not named."""
    if out is None or is_stream(out) or out.is_dir():  # a folder is refused later, by the function that writes
        return
    place = Path(os.path.realpath(out))
    for read in inputs:
        if read is None:
            continue
        known = Path(os.path.realpath(read))
        read_in_folder = place.parent == known and place.exists() and any(place.match(each) for each in _READ)
        if place == known or read_in_folder:
            raise TautError(f"{out}: would be overwritten, and is read here: name another file")
