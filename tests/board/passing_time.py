"""Time for a simulated board while a program waits for it by the wall clock."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from tautline.simulated.simlink import SimLink


@contextlib.contextmanager
def time_passes(link: SimLink) -> Iterator[None]:
    """For the board, as fast as it can."""
    done = threading.Event()

    def advance() -> None:
        while not done.is_set():
            link.ask("advance 20000")

    thread = threading.Thread(target=advance, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
