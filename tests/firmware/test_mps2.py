"""The port in QEMU, on the core that --board names: what it is, and that its time is one that repeats exactly."""

from __future__ import annotations

import hashlib
import signal
import time
from pathlib import Path

import pytest

from tautline.device import wire
from tautline.device.board import open_board
from tautline.simulated.simlink import LINE, PROGRAM, DesktopBoard

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def core(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    board = str(request.config.getoption("--board", default="m4"))
    name = board if board in ("m4", "m33") else "m4"
    if not (ROOT / "build" / name / "tautline.elf").is_file():
        pytest.skip(f"the image is not built: run './run {name}'")
    monkeypatch.setenv(PROGRAM, str(ROOT / "tools" / "qemu" / "board.py"))
    monkeypatch.setenv("TAUTLINE_QEMU_CORE", name)
    monkeypatch.setenv(LINE, "uart")
    return name


def _motion() -> tuple[bytes, str]:
    """What a moving axis told, byte for byte, and where its motor truly was."""
    heard = bytearray()
    truth = hashlib.sha256()
    with DesktopBoard(axes=2, serial="AGAIN") as process, open_board(process.where) as board:
        link = process.link()
        read = board._link.read

        def listen(timeout_s: float) -> bytes:
            data = read(timeout_s)
            heard.extend(data)
            return data

        board._link.read = listen  # type: ignore[method-assign]

        def wait(seconds: float) -> None:
            truth.update(str(link.ask(f"advance {round(seconds * 1e6)}")["q"]).encode())

        board.ask("telemetry", axis=0, divider=1)
        board.ask("set_position", axis=0, q=0.0)
        board.switch_on(0, wait)
        board.ask("follow", axis=0, target=0, silence_us=60_000)
        for step in range(20):
            board.tell("set_point", axis=0, value=step * 20 * 256, at_us=0)
            board.sync()  # it has no answer: two sockets have no order but this
            wait(0.02)
        wait(0.3)
        board.sync()
        assert board.status(0).q > 300.0
        link.close()
    return bytes(heard), truth.hexdigest()


@pytest.mark.usefixtures("core")
def test_two_runs_are_the_same_to_the_byte() -> None:
    (heard, truth), (again, truth_again) = _motion(), _motion()
    assert truth == truth_again
    assert heard == again


def test_its_control_step_interrupts_its_task_at_the_stated_rate(core: str) -> None:
    for rate in (1000, 10000):
        with DesktopBoard(axes=4, rate_hz=rate) as process, open_board(process.where) as board:
            link = process.link()
            assert board.identity.port == core and board.identity.control_hz == rate and board.axes == 4
            before = board.sync()
            link.ask("advance 100000")
            assert abs(board.sync() - before - 100_000) <= 1_000_000 // rate
            assert board.counters().overruns == 0
            link.close()


@pytest.mark.usefixtures("core")
def test_what_the_line_has_no_room_for_is_sent_as_soon_as_it_has() -> None:
    """The board does not sleep over it, though nobody asks for anything more."""
    with DesktopBoard(serial="SLOW") as process, open_board(process.where) as board:
        for _ in range(3):
            asked = [board._next_sequence() for _ in range(30)]
            board._write(b"".join(wire.encode("get_status", number, axis=0) for number in asked))
            time.sleep(0.002)
            process.process.send_signal(signal.SIGSTOP)  # nobody empties the line
            time.sleep(0.1)
            process.process.send_signal(signal.SIGCONT)
            deadline = time.monotonic() + 5.0
            while asked[-1] not in board._answers and time.monotonic() < deadline:
                board.poll(0.2)
            assert board._answers.keys() >= set(asked)
