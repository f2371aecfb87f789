"""Output folders: written beside their place and renamed into it, so that a failure leaves what was there."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from tautline.errors import TautError, of_system


def check_replaceable(folder: Path, key_file: str) -> None:
    """Raises TautError unless the folder can be written, and is new, empty, or an earlier result, which holds
    `key_file`."""
    check_writable(folder)
    if folder.is_dir():
        if (folder / key_file).exists() or not any(folder.iterdir()):
            return
        raise TautError(f"{folder}: holds other files and no {key_file}: name a new folder")
    if folder.exists():
        raise TautError(f"{folder}: is a file: name a folder")


def check_writable(path: Path) -> None:
    """Raises TautError where no file or folder can be written at `path`, or where its links lead. Tries it: makes a
    temporary folder beside it and removes it. Passes for a device or a pipe."""
    try:
        if is_stream(path):
            return
        place = Path(os.path.realpath(path))
        if os.path.ismount(place):
            raise TautError(f"{path}: is a mount point, whose place nothing can take: name a folder in it")
        there = next(each for each in place.parents if each.exists())
        # The temporary folder's name is as long as those that will be written.
        with tempfile.TemporaryDirectory(".old", f".{place.name}.", there):
            pass
    except OSError as error:
        raise TautError(f"{path}: cannot be written ({error.strerror or error}): name another place") from error


@contextmanager
def replaced_folder(folder: Path, key_file: str, stale: Sequence[str] = ()) -> Iterator[Path]:
    """Yields a temporary folder to write into, which takes `folder`'s place when the block ends without an error. Other
    files in `folder` are kept, except those that match `stale` (patterns), which belong to the earlier result. After an
    error `folder` is as it was; TautError where the system refuses to write. key_file: as in `check_replaceable`."""
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
        try:
            if folder.exists():
                folder.rename(retired)
            temporary.rename(folder)
        except BaseException:  # Ctrl-C too
            if retired.exists() and not folder.exists():
                retired.rename(folder)
            raise
    except OSError as error:
        raise _not_written(folder, "folder", error, beside, retired) from error
    finally:
        for leftover in (beside, retired):
            shutil.rmtree(leftover, ignore_errors=True)


def is_stream(path: Path) -> bool:
    """Whether there is a device, a pipe or a socket at `path`, or where its links lead: no file may take its place."""
    return path.exists() and not (path.is_file() or path.is_dir())


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yields a temporary path to write a file to, which takes the place of `path`, or of the file that `path` links to,
    when the block ends without an error; after one `path` is as it was. TautError where `path` is a folder, a device or
    a pipe, or cannot be written."""
    if path.is_dir():
        raise TautError(f"{path}: is a folder: name a file")
    if is_stream(path):
        raise TautError(f"{path}: is a device or a pipe: name a file")
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{os.getpid()}.{place.name}")  # with its ending, by which some know what to write
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(place)
    except OSError as error:
        raise _not_written(path, "file", error, place, temporary) from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_file(path: Path, text: str) -> None:
    """Writes text into a file, whole or not at all; into a device or a pipe as it is. TautError where it cannot be
    written."""
    if not is_stream(path):
        with whole_file(path) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="")
        return
    try:
        path.write_text(text, encoding="utf-8", newline="")
    except OSError as error:
        raise _not_written(path, "file", error) from error


def _not_written(place: Path, kind: str, error: OSError, *others: Path) -> TautError:
    """The error to raise where the system refused something while `place` was written. It names `place` if the path
    that was refused lies in it, above it or in one of `others`, the temporary paths; else it has the system's message,
    as for a file that could not be read to be copied. kind: "file" or "folder", which `place` is."""
    refused = Path(error.filename).resolve() if isinstance(error.filename, str) else None
    own = [each.resolve() for each in (place, *others)]
    if refused is None or any(refused.is_relative_to(each) or each.is_relative_to(refused) for each in own):
        return TautError(f"{place}: cannot be written ({error.strerror or error}): name another {kind}")
    return TautError(of_system(error))


@contextmanager
def unpacked_folder(files: Mapping[str, bytes]) -> Iterator[Path]:
    """Yields a temporary folder that holds these files, each content by its path in the folder."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        yield folder
