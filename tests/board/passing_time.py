"""Time for a simulated board while a program waits for it by the wall clock."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from tautline.simulated.simlink import SimLink

STEP_US = 20_000
FASTEST = 20  # times the wall clock: a minute of the board's is three seconds, in which a program looks thirty times


@contextlib.contextmanager
def time_passes(link: SimLink) -> Iterator[None]:
    """For the board, no faster than FASTEST: it has patience of its own with who is waiting."""
    done = threading.Event()

    def advance() -> None:
        while not done.wait(1e-6 * STEP_US / FASTEST):
            link.ask(f"advance {STEP_US}")

    thread = threading.Thread(target=advance, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()
