"""What carries frames to and from a board: the same few calls, whatever the wire."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from tautline.errors import TautError


class BoardGone(TautError):
    """The board is not there any more, or has restarted and knows nothing of us."""


class Link(Protocol):
    """An open way to one board. Every failure is a TautError that says what to do."""

    hello_tries: int  # how often hello is said before a board is taken for dead
    log_divider: int  # of the millisecond: what is logged more often is no measurement any more

    def write(self, data: bytes) -> None: ...

    def read(self, timeout_s: float) -> bytes:
        """What came, b"" where nothing did within the time."""

    def tables(self, axis: int) -> Any:
        """A context with download() and upload() for an axis' table; None: tables travel in messages."""

    def bus(self) -> Mapping[str, Any]:
        """Of motors on a bus of their own: how often and how late they are asked and follow. Empty for a board."""

    def close(self) -> None: ...


@dataclass(frozen=True)
class BoardAddress:
    """A board that was found, not opened."""

    where: str  # usb:SERIAL, usbip:HOST:PORT, serial:DEVICE, or motors as in drivers/addresses
    serial: str | None  # None: in use, or not allowed to ask
    busy: bool
    protocol: tuple[int, int]
    open: Callable[[], Link]
