"""What carries frames to and from a board: the same few calls, whatever the wire."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from tautline.errors import TautError


class BoardGone(TautError):
    """The board is not there any more, or has restarted and knows nothing of us."""


def board_gone(where: str) -> BoardGone:
    """Returns the error to raise where the way to the board at the address `where` has failed."""
    return BoardGone(f"{where}: the board is gone: check plug and power, then run the command again")


def board_takes_no_data(where: str) -> TautError:
    """Returns the error to raise where the board at the address `where` is there, but takes no more bytes."""
    return TautError(f"{where}: the board does not take data: switch it off and on")


class Link(Protocol):
    """An open way to one board. Every failure is a TautError that says what to do."""

    hello_tries: int  # how often hello is said before a board is taken for dead
    log_divider: int  # ms from one sample of telemetry to the next; motors on a bus are measured no more often

    def write(self, data: bytes) -> None:
        """Sends whole frames to the board."""

    def read(self, timeout_s: float) -> bytes:
        """Returns the bytes that came, any number of them, b"" where none did within timeout_s."""

    def tables(self, axis: int) -> Any:
        """Returns a context with download() and upload() for an axis' table, where the link has a way of its own for
        tables (DFU); None where tables travel in messages."""

    def bus(self) -> Mapping[str, Any]:
        """Returns what HostedLink.bus says where the axes are motors on a bus of their own; {} for a board."""

    def close(self) -> None:
        """Closes the way to the board."""


@dataclass(frozen=True)
class BoardAddress:
    """A board that was found, not opened."""

    where: str  # usb:SERIAL, usbip:HOST:PORT, serial:DEVICE, or motors as in drivers/addresses
    serial: str | None  # serial number; None: in use, or not allowed to ask
    busy: bool  # another program has it
    protocol: tuple[int, int]  # version that it speaks, major and minor
    open: Callable[[], Link]  # opens it; TautError where that fails
