"""A simulated board's sockets and USB stack under whatever a client can send; the desktop's with sanitizers if built.

Transfers of every kind with any set-up packet, on any endpoint, taken back or left alone, clients that vanish, bytes
that are no protocol at all: the board goes on, and the next client finds a device that enumerates.
"""

from __future__ import annotations

import contextlib
import random
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tautline.device.usbip import devices
from tautline.simulated.simlink import PROGRAM, DesktopBoard

_SANITIZED = Path(__file__).resolve().parents[2] / "build/clang-san/firmware/port/desktop/tautline-board"
_SUBMIT = struct.Struct(">IIIIIiiiii8s")
_UNLINK = struct.Struct(">IIIIII24x")
_SIM = (
    b"\n\n", b"advance\n", b"advance -1\n",
    b"advance 99999999999999999999\n", b"x" * 5000, b"place 0\n", b"place 9 9\n",
    b"\0\0\n", b"cut x\nstate\nadvance 100", b"advance 500\nadvance 500\nstate\n", b"realtime on\nrealtime off\n",
    b"unplug\nplug\n", b"reset\n", b"hang\nadvance 2000000\n", b"cut 3\ncut 0\n", b"place 0 100000\n", b"state\r\n",
)  # fmt: skip


pytestmark = pytest.mark.falls_to("emulated")


@pytest.fixture
def board(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[DesktopBoard]:
    where = request.config.getoption("--board")
    if where not in ("desktop", "emulated"):  # on USB
        pytest.skip("for simulated boards: a real one has no such sockets")
    if where == "desktop" and _SANITIZED.is_file():
        monkeypatch.setenv(PROGRAM, str(_SANITIZED))
    with DesktopBoard(axes=2) as started:
        yield started


def _connect(board: DesktopBoard, which: str) -> socket.socket:
    client = socket.create_connection(("127.0.0.1", board.ports[which]), timeout=5.0)
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return client


def _import(board: DesktopBoard) -> socket.socket | None:
    """The device, or None while the server still believes that it is in use."""
    with contextlib.ExitStack() as unless_imported:
        client = unless_imported.enter_context(_connect(board, "usbip"))
        client.sendall(struct.pack(">HHI", 0x0111, 0x8003, 0) + b"1-1".ljust(32, b"\0"))
        answer = client.recv(8, socket.MSG_WAITALL)
        if len(answer) < 8 or struct.unpack(">HHI", answer)[2] != 0:
            return None
        client.recv(312, socket.MSG_WAITALL)
        unless_imported.pop_all()
        return client


def _submit(
    sequence: int, endpoint: int, reads: bool, length: int, setup: bytes = bytes(8), data: bytes = b""
) -> bytes:
    return _SUBMIT.pack(1, sequence, 0x10002, int(reads), endpoint, 0, length, 0, 0, 0, setup) + data


def _any_transfer(draw: random.Random) -> bytes:
    sequence, kind = draw.randrange(1, 50), draw.random()
    if kind < 0.4:
        length = draw.randrange(0, 800) if draw.random() < 0.8 else 0
        asked = length if draw.random() < 0.8 else draw.randrange(0, 1000)
        setup = bytes([draw.choice([0, 0x80, 0x21, 0xA1, 0xC0, 0x81, 1, 2, 0x82, 0xFF]), draw.randrange(14)])
        setup += bytes([draw.randrange(8), draw.randrange(16), draw.choice([0, 0, 1, 7, 0x81]), 0])
        reads = bool(setup[0] & 0x80)
        data = b"" if reads else draw.randbytes(asked)
        return _submit(sequence, 0, reads, asked, setup + length.to_bytes(2, "little"), data)
    if kind < 0.5:
        configuration = draw.choice([1, 1, 1, 0, 2])
        return _submit(sequence, 0, False, 0, bytes([0, 9, configuration, 0, 0, 0, 0, 0]))
    if kind < 0.7:
        length = draw.choice([0, 1, 64, 65, 128, 300, 4096, 70000])
        return _submit(sequence, draw.choice([1, 1, 1, 2, 15, 99]), False, length, data=draw.randbytes(length))
    if kind < 0.85:
        return _submit(sequence, draw.choice([1, 1, 5]), True, draw.choice([0, 1, 63, 64, 512, 16384, 1 << 30]))
    if kind < 0.97:
        return _UNLINK.pack(2, sequence, 0, 0, 0, draw.randrange(1, 50))
    return draw.randbytes(draw.randrange(100))


def _disturb(board: DesktopBoard, draw: random.Random) -> None:
    kind = draw.random()
    if kind < 0.2:
        with _connect(board, "usbip") as client:
            client.sendall(draw.randbytes(draw.randrange(1, 300)))
    elif kind < 0.4:
        with _connect(board, "sim") as client:
            client.sendall(draw.choice(_SIM))
            if draw.random() < 0.5:
                client.settimeout(0.05)
                client.recv(1000)
    elif client := _import(board):
        with client:
            for _ in range(draw.randrange(1, 60)):
                client.sendall(_any_transfer(draw))
            if draw.random() < 0.5:
                client.settimeout(0.01)
                client.recv(10000)


def _enumerates(board: DesktopBoard) -> bool:
    for _ in range(100):
        if client := _import(board):
            break
        time.sleep(0.02)
    else:
        return False
    with client:
        client.sendall(_submit(1, 0, True, 18, bytes([0x80, 6, 0, 1, 0, 0, 18, 0])))
        answer = client.recv(48 + 18, socket.MSG_WAITALL)
    return len(answer) == 66 and answer[48:50] == b"\x12\x01"


@pytest.mark.parametrize("seed", range(4))
def test_nothing_on_its_sockets_stops_it(request: pytest.FixtureRequest, board: DesktopBoard, seed: int) -> None:
    draw = random.Random(seed)
    for _ in range(60 if request.config.getoption("--board") == "desktop" else 15):  # the emulated one takes its time
        with contextlib.suppress(OSError):
            _disturb(board, draw)
        assert board.process.poll() is None, "the board has died: see its report above"
    link = board.link()
    link.ask("reset")
    link.close()
    assert _enumerates(board)
    assert len(devices("127.0.0.1", board.ports["usbip"])) == 1


def test_a_direction_that_contradicts_the_request_is_stalled(board: DesktopBoard) -> None:
    """TinyUSB alone would write the host's bytes into a descriptor, or into a stack frame that is gone."""
    for setup in (
        [0x00, 6, 0, 1, 0, 0, 18, 0],  # GET_DESCRIPTOR sent as OUT
        [0x00, 0, 0, 0, 0, 0, 2, 0],  # GET_STATUS
        [0x02, 0, 0, 0, 0x81, 0, 2, 0],  # GET_STATUS of an endpoint
        [0x00, 8, 0, 0, 0, 0, 1, 0],  # GET_CONFIGURATION
        [0x21, 3, 0, 0, 1, 0, 6, 0],  # DFU_GETSTATUS
    ):
        client = _import(board)
        assert client is not None
        with client:
            client.sendall(_submit(1, 0, False, 0, bytes([0, 9, 1, 0, 0, 0, 0, 0])))
            client.recv(48, socket.MSG_WAITALL)
            client.sendall(_submit(2, 0, False, setup[6], bytes(setup), b"\xaa" * setup[6]))
            status = _SUBMIT.unpack(client.recv(48, socket.MSG_WAITALL))[5]
            assert status == -32, f"{setup}: {status}"
        time.sleep(0.05)
    assert _enumerates(board)
