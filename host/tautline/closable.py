"""What holds something open, as a context that closes it."""

from __future__ import annotations

from typing import Self


class Closable:
    """Its `close` is called when the block of a `with` ends, however it ends."""

    def close(self) -> None:
        """Gives up what is held."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Itself, open as it is."""
        return self

    def __exit__(self, *_: object) -> None:
        """Closes it, also after an error, which goes on."""
        self.close()
