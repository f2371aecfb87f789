"""Files that are written whole or not at all, whatever a library does while it writes."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from tautline.errors import TautError
from tautline.folders import is_stream


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A path beside `path` to write to; it takes its place when the block ends without an error."""
    if path.is_dir():
        raise TautError(f"{path}: is a folder: name a file with --out")
    place = Path(os.path.realpath(path))  # where it is a link, what it leads to
    if is_stream(path):
        raise TautError(f"{path}: is a device or a pipe: name a file with --out")
    temporary = place.with_name(f".{os.getpid()}.{place.name}")
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(place)
    except OSError as error:
        raise TautError(f"{path}: cannot be written ({error.strerror or error}): name another --out") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
