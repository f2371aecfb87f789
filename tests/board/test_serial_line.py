"""A board on a real tty: the desktop board's line behind a pseudo-terminal, as much of a tty as a test can have."""

from __future__ import annotations

import contextlib
import os
import random
import select
import socket
import threading
import tty
from collections.abc import Iterator

import pytest
from test_board_tables import blob

from tautline.device import wire
from tautline.device.board import Board, BoardGone, BoardRefused, open_board
from tautline.errors import TautError
from tautline.simulated.simlink import LINE, DesktopBoard


class Cable:
    """Bytes between a pseudo-terminal and a board's line; `noise` spoils what goes to the board."""

    def __init__(self, port: int) -> None:
        self.master, self.slave = os.openpty()
        tty.setraw(self.slave)
        self.name = os.ttyname(self.slave)
        self.noise: random.Random | None = None
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._carry, daemon=True)
        self._thread.start()

    def _carry(self) -> None:
        while not self._done.is_set():
            ready, _, _ = select.select([self.master, self._socket], [], [], 0.05)
            for source in ready:
                with contextlib.suppress(OSError):
                    if source is self._socket:
                        os.write(self.master, self._socket.recv(4096))
                    else:
                        self._socket.sendall(self._spoil(os.read(self.master, 4096)))

    def _spoil(self, data: bytes) -> bytes:
        if self.noise is None:
            return data
        spoilt = bytearray(data)
        for index in range(len(spoilt)):
            if self.noise.random() < 0.01:
                spoilt[index] ^= 1 << self.noise.randrange(8)
        return bytes(byte for byte in spoilt if self.noise.random() >= 0.01)

    def close(self) -> None:
        self._done.set()
        self._thread.join()
        os.close(self.master)
        os.close(self.slave)
        self._socket.close()


@pytest.fixture
def desktop(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[DesktopBoard]:
    if request.config.getoption("--board") not in ("desktop", "serial"):
        pytest.skip("the desktop board's line")
    monkeypatch.setenv(LINE, "uart")
    with DesktopBoard(axes=2, realtime=True, serial="ON-A-LINE") as started:
        yield started


@pytest.fixture
def cable(desktop: DesktopBoard) -> Iterator[Cable]:
    cable = Cable(desktop.ports["uart"])
    yield cable
    cable.close()


def test_a_board_on_a_tty_is_named_asked_and_flashed(cable: Cable) -> None:
    with open_board(f"serial:{cable.name}") as board:
        assert board.identity.serial == "ON-A-LINE"
        board.load_table(1, blob(1))
        assert board.read_table(1) == blob(1)
        with pytest.raises(TautError, match="another program uses the board"):
            open_board(f"serial:{cable.name}")
        assert board.sync() > 0
    with open_board(f"serial:{cable.name}@115200") as board:
        assert board.status(1).table == wire.code("TABLES", "NEWEST")


def test_names_that_are_no_line() -> None:
    for name, says in {
        "serial:/dev/none": "no board answers there",
        "serial:": "expected serial:DEVICE",
        "serial:tcp:127.0.0.1:1": "no board answers there",
        "serial:tcp:192.0.2.1:5": "on this machine",
    }.items():
        with pytest.raises(TautError, match=says):
            open_board(name)


def _counted(board: Board, patience_s: float) -> int:
    answered = 0
    for number in range(40):
        with contextlib.suppress(TautError):
            answered += board.ask("ping", patience_s, host_us=number).host_us == number
    return answered


def test_a_noisy_line_loses_some_and_then_works_as_before(cable: Cable) -> None:
    with open_board(f"serial:{cable.name}") as board:
        cable.noise = random.Random(1)
        assert 5 <= _counted(board, 0.15) < 40
        cable.noise = None
        board.poll(0.1)
        assert _counted(board, 2.0) == 40
        assert board.counters().bytes_bad > 0
        assert board.status(0).fault == 0


def test_a_restart_is_noticed(desktop: DesktopBoard, cable: Cable) -> None:
    link = desktop.link()
    with open_board(f"serial:{cable.name}") as board:
        board.ask("telemetry", axis=0, divider=1)
        link.ask("reset")
        with pytest.raises(BoardGone, match="restarted"):
            board.sync()
    link.close()
    with open_board(f"serial:{cable.name}") as board:
        assert board.sync() >= 0


def test_a_new_host_ends_the_session_of_one_that_died(desktop: DesktopBoard, cable: Cable) -> None:
    first = open_board(f"serial:{cable.name}")
    first.ask("telemetry", axis=0, divider=1)
    first._link.write(wire.encode("motion_start", 9)[:40])
    first.close()
    with open_board(f"serial:{cable.name}") as board:
        before = board.sync()
        batches: list[wire.Message] = []
        board.listen("batch", batches.append)
        while board.sync() < before + 50_000:
            pass
        assert not batches
        with pytest.raises(BoardRefused):
            board.ask("get_status", axis=7)
