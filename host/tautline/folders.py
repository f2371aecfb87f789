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


# format: of a recording's and a model's folder
_READ = (
    *("motor.csv", "marker.csv", "angle.csv", "frames.csv", "truth.csv"),
    *("rig.toml", "model.json", "truth.json", "marker.toml", "region.toml"),
    *("video.mkv", "video.mp4"),
)


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


def is_stream(path: Path) -> bool:
    """Whether there is a device, a pipe or a socket at `path`, or where its links lead: nothing takes its place."""
    return path.exists() and not (path.is_file() or path.is_dir())


def write_file(path: Path, text: str) -> None:
    """Writes text into a file, whole or not at all; where it is a link, into what that leads to. A device or a pipe is
    written into as it is."""
    place = Path(os.path.realpath(path))
    temporary = place.with_name(f".{place.name}.{os.getpid()}")
    try:
        if is_stream(path):
            path.write_text(text, encoding="utf-8", newline="")
            return
        place.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_text(text, encoding="utf-8", newline="")
        temporary.replace(place)
    except OSError as error:
        with suppress(OSError):
            temporary.unlink()
        raise TautError(f"{path}: cannot be written ({error.strerror or error})") from error


def check_no_input(out: Path | None, *inputs: Path | None) -> None:
    """TautError if the file `out` is one of the inputs, or takes the place of a file that an input folder already
    holds and the commands read."""
    if out is None or is_stream(out) or out.is_dir():  # what cannot be taken for a file is told by who writes it
        return
    place = Path(os.path.realpath(out))
    for read in inputs:
        if read is None:
            continue
        known = Path(os.path.realpath(read))
        own = place.parent == known and place.name in _READ and place.exists()
        if place == known or own:
            raise TautError(f"{out}: would be overwritten, and is read here: name another file")


@contextmanager
def unpacked(files: Mapping[str, bytes]) -> Iterator[Path]:
    """A temporary folder with these files, by their paths in it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for path, content in files.items():
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (folder / path).write_bytes(content)
        yield folder
