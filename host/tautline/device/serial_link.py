"""A board on a serial line: the same frames over a UART, with pyserial.

serial:/dev/ttyUSB0, serial:COM3, either with @BAUD behind it; and for simulated boards serial:tcp:HOST:PORT, where a
socket of this machine is the line.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import re
import select
import socket
import time
from typing import Any

import serial

from tautline.device import wire
from tautline.device.holder import busy_in_words
from tautline.device.link import BoardAddress, BoardGone, board_gone, board_takes_no_data
from tautline.errors import TautError

_WRITE_S = 1.0  # longest time to connect, or to send
_READ_BYTES = 4096
_ASK_S = 0.5  # wait for an answer to hello
_EXPECTED = "expected serial:DEVICE, serial:DEVICE@BAUD or serial:tcp:HOST:PORT, such as serial:/dev/ttyUSB0"


class _Socket:
    """A socket with those few calls of pyserial's ports that a link needs. pyserial's own sockets hold small writes
    back."""

    def __init__(self, host: str, port: int) -> None:
        """Connects to the host's port within _WRITE_S; OSError where that fails."""
        self._socket = socket.create_connection((host, port), timeout=_WRITE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.timeout: float | None = 0.0

    def read(self, size: int) -> bytes:
        """Returns up to `size` bytes, waiting for the first as long as `timeout` says, s; b"" where none come."""
        ready, _, _ = select.select([self._socket], [], [], self.timeout)
        if not ready:
            return b""
        data = self._socket.recv(size)
        if not data:
            raise ConnectionResetError("the other end has closed")
        return data

    def write(self, data: bytes) -> None:
        """Sends all bytes. TimeoutError where the other end does not take them within _WRITE_S."""
        self._socket.sendall(data)

    def close(self) -> None:
        """Closes the connection."""
        self._socket.close()


class SerialLink:
    """An open serial line to a board. A board cannot see a host come or go on such a line, so a session begins with
    hello."""

    hello_tries = 4  # a line may have lost the first, or the board still waits for the rest of a frame
    log_divider = 1

    def __init__(self, where: str) -> None:
        """Opens serial:DEVICE[@BAUD] or serial:tcp:HOST:PORT. TautError, with a remedy, where that fails."""
        self._where = where
        self._port = _open_line(where)

    def write(self, data: bytes) -> None:
        """Sends all bytes. TautError where the board takes none, BoardGone where the line is gone."""
        try:
            self._port.write(data)
        except (serial.SerialTimeoutException, TimeoutError) as error:
            raise board_takes_no_data(self._where) from error
        except (serial.SerialException, OSError) as error:
            raise board_gone(self._where) from error

    def read(self, timeout_s: float) -> bytes:
        """Returns the bytes that come, waiting for the first at most timeout_s; b"" where none does. BoardGone where
        the line is gone."""
        try:
            self._port.timeout = max(timeout_s, 0.0)
            first = self._port.read(1)
            if not first:
                return b""
            self._port.timeout = 0.0
            return bytes(first + self._port.read(_READ_BYTES))
        except (serial.SerialException, OSError, TypeError) as error:  # TypeError: closed by another thread
            raise board_gone(self._where) from error

    def tables(self, axis: int) -> None:
        """Returns None: tables travel in messages."""
        return None

    def bus(self) -> dict[str, Any]:
        """Returns {}: this is a board, not motors on a bus of their own."""
        return {}

    def close(self) -> None:
        """Closes the line; errors are ignored, as of a line that is gone."""
        with contextlib.suppress(serial.SerialException, OSError):
            self._port.close()


class _Busy(TautError):
    """Another program has the line."""


def _open_line(where: str) -> Any:
    """Opens serial:DEVICE[@BAUD] or serial:tcp:HOST:PORT: returns a port of pyserial, or a _Socket. TautError with a
    remedy, _Busy where another program has the line."""
    name = where.removeprefix("serial:")
    if name.startswith("tcp:"):
        return _open_socket(where, name)
    match = re.fullmatch(r"([^@]+)(?:@(\d+))?", name)
    if not match:
        raise TautError(f"--board {where}: {_EXPECTED}")
    baud = int(match[2] or wire.wire.SERIAL_BAUD)
    try:
        return serial.Serial(match[1], baud, timeout=0.0, write_timeout=_WRITE_S, exclusive=True)
    except (ValueError, OverflowError) as error:  # a baud rate that no line has
        raise TautError(f"--board {where}: {error}: {_EXPECTED}") from error
    except OSError as error:  # pyserial's own is one
        if error.errno in (errno.EBUSY, errno.EAGAIN) or "exclusively lock" in str(error):
            raise _Busy(busy_in_words(where)) from error
        if error.errno == errno.EACCES:
            mend = "sudo usermod -a -G dialout $USER"
            raise TautError(f"{where}: no permission: run '{mend}' and log in again") from error
        raise TautError(f"{where}: no board answers there: plug it in, or name another with --board") from error


def _open_socket(where: str, name: str) -> _Socket:
    """Opens the line of a simulated board on this machine; name: tcp:HOST:PORT; where: the whole address, for errors.
    TautError with a remedy."""
    match = re.fullmatch(r"tcp:(.+):(\d+)", name)
    if not match:
        raise TautError(f"--board {where}: {_EXPECTED}")
    if not _is_this_machine(match[1]):
        raise TautError(f"--board {where}: a line over a socket is for simulated boards on this machine: 127.0.0.1")
    try:
        return _Socket(match[1], int(match[2]))
    except (OSError, OverflowError) as error:
        raise TautError(f"{where}: no board answers there: start it, or name another with --board") from error


def _is_this_machine(host: str) -> bool:
    """Whether a host, a name or an address, is this machine: localhost or a loopback address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def find_serial(where: str) -> list[BoardAddress]:
    """The board on a serial line, as a list of one, marked busy where another program has the line. Says hello to learn
    who it is and closes the line again. TautError where the line cannot be opened, or nothing on it answers."""
    ours = (wire.wire.MAJOR, wire.wire.MINOR)  # a busy board's own is not known
    busy_board = BoardAddress(where, serial=None, busy=True, protocol=ours, open=lambda: _raise_busy(where))
    try:
        link = SerialLink(where)
    except _Busy:
        return [busy_board]
    with contextlib.closing(link):
        try:
            for _ in range(link.hello_tries):
                link.write(wire.encode("hello", 0, protocol_major=wire.wire.MAJOR, protocol_minor=wire.wire.MINOR))
                if identity := _wait_for_identity(link):
                    protocol = (identity.protocol_major, identity.protocol_minor)
                    return [
                        BoardAddress(
                            where, identity.serial, busy=False, protocol=protocol, open=lambda: SerialLink(where)
                        )
                    ]
        except BoardGone:
            if where.startswith("serial:tcp:"):  # a simulated board closes a second connection at once
                return [busy_board]
            raise
    raise TautError(f"{where}: nothing that answers is a tautline board: check plug, power and baud rate")


def _raise_busy(where: str) -> SerialLink:
    """Raises the error that another program has the line: BoardAddress.open of a board that is in use."""
    raise _Busy(busy_in_words(where))


def _wait_for_identity(link: SerialLink) -> wire.Message | None:
    """Waits up to _ASK_S for the message `identity` of a board that was sent a hello; None where it does not come."""
    decoder = wire.Decoder()
    deadline = time.monotonic() + _ASK_S
    while (left := deadline - time.monotonic()) > 0.0:
        for message in decoder.feed(link.read(left)):
            if message.name == "identity":
                return message
    return None
