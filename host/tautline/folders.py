"""Output folders: written beside their place and renamed into it, so that a failure leaves what was there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from tautline.errors import TautError


def check_replaceable(folder: Path, key_file: str) -> None:
    """TautError unless the folder is new, empty, or an earlier result (it holds `key_file`)."""
    if folder.is_dir():
        if (folder / key_file).exists() or not any(folder.iterdir()):
            return
        raise TautError(f"{folder}: holds other files and no {key_file}: name a new folder")
    if folder.exists():
        raise TautError(f"{folder}: is a file: name a folder")


@contextmanager
def replaced(folder: Path, key_file: str, stale: Sequence[str] = ()) -> Iterator[Path]:
    """A temporary folder to write into, which takes `folder`'s place when the block ends without error. Other files in
    it are kept, except those that match `stale`, which belong to the earlier result."""
    folder = Path(os.path.realpath(folder))  # where it is a link, what it leads to is replaced
    check_replaceable(folder, key_file)
    beside = folder.with_name(f".{folder.name}.{os.getpid()}.new")
    temporary, retired = beside / folder.name, beside.with_suffix(".old")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        beside.mkdir()
        temporary.mkdir()
        yield temporary
        if folder.exists():
            for old in folder.iterdir():
                if not (temporary / old.name).exists() and not any(old.match(each) for each in stale):
                    (shutil.copytree if old.is_dir() else shutil.copy2)(old, temporary / old.name)
            folder.rename(retired)
        try:
            temporary.rename(folder)
        except OSError:
            if retired.exists():
                retired.rename(folder)
            raise
    except OSError as error:
        raise TautError(f"{folder}: cannot be written ({error.strerror or error}): name another folder") from error
    finally:
        for leftover in (beside, retired):
            shutil.rmtree(leftover, ignore_errors=True)


def write_file(path: Path, text: str) -> None:
    """Writes text into a file, whole or not at all."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="")
        temporary.replace(path)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise TautError(f"{path}: cannot be written ({error.strerror or error})") from error


@contextmanager
def unpacked(files: Mapping[str, bytes]) -> Iterator[Path]:
    """A temporary folder with these files, by their paths in it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        yield folder
