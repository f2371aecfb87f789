"""What holds something open, as a context that closes it."""

from __future__ import annotations

from typing import Self


class Closable:
    """Its `close` is called when the block of a `with` ends, however it ends."""

    def close(self) -> None:
        """Releases what the object holds. Each subclass says how."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Returns the object itself, which is open already."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes the object, also after an error, which is then raised further."""
        self.close()
