"""From the session's thread to any number of pages: the latest of each topic."""

from __future__ import annotations

import threading
from typing import Any


class Stream:
    """The latest document of each topic, for readers in other threads. Nothing queues up: a reader that is slow gets
    the newest of each topic, and misses what came between."""

    def __init__(self) -> None:
        """Nothing is published yet."""
        self._changed = threading.Condition()
        self._count = 0
        self._latest: dict[str, tuple[int, Any]] = {}
        self._closed = False

    def publish(self, topic: str, what: Any) -> None:
        """Makes `what` the latest document of a topic. Other threads read it from now on: it must not be changed."""
        with self._changed:
            self._count += 1
            self._latest[topic] = (self._count, what)
            self._changed.notify_all()

    def newer(self, after: int, timeout_s: float) -> tuple[int, dict[str, Any]]:
        """Waits until something is newer than number `after` (0: from the beginning). Returns the newest number, and by
        topic the latest document of each that was published since, oldest first; `after` and no documents when
        timeout_s is over or the stream is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._count > after or self._closed, timeout_s)
            fresh = sorted((number, topic, what) for topic, (number, what) in self._latest.items() if number > after)
        return (fresh[-1][0] if fresh else after), {topic: what for _, topic, what in fresh}

    def close(self) -> None:
        """Ends the stream and wakes whoever waits."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    @property
    def closed(self) -> bool:
        """Whether `close` was called."""
        return self._closed
