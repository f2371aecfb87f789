"""A board that is damaged, or none of ours: what it answers ends in words, and never keeps the host for long."""

from __future__ import annotations

import os
import random
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from tautline.device import board as boards
from tautline.device import dfu, wire
from tautline.device.board import Board, BoardAddress, BoardRefused, open_board
from tautline.device.serial_link import find_serial
from tautline.errors import TautError

sys.path.insert(0, str(Path(__file__).parents[1] / "fuzz"))
import readers


class Answers(readers.Link):
    """hello as it should be, then one kind of answer for ever."""

    def __init__(self, name: str, **values: Any) -> None:
        super().__init__(random.Random(1))
        self.name, self.values = name, values

    def read(self, _: float) -> bytes:
        asked, self.asked = self.asked, b""
        said = b""
        for name, _type, sequence, _fields in wire.wire.Parser().feed(asked):
            if name == "hello":
                said += wire.encode("identity", sequence, protocol_major=wire.wire.MAJOR, axes=1)
            else:
                said += wire.encode(self.name, sequence, **self.values)
        return said


def opened(link: readers.Link) -> Board:
    return Board(BoardAddress("usb:X", "X", False, (wire.wire.MAJOR, wire.wire.MINOR), lambda: link))


def test_an_answer_to_something_else_is_no_answer() -> None:
    with opened(Answers("ack")) as board, pytest.raises(TautError, match="answers 'get_status' by 'ack'"):
        board.status(0)


def test_a_table_without_end_is_given_up() -> None:
    link = Answers("table_part", count=wire.wire.PART)
    with opened(link) as board, pytest.raises(TautError, match="does not end"):
        board.read_table(0)


class Refuses(readers.Link):
    """An ack for every request but get_limits, and a progress message at every reading."""

    def __init__(self) -> None:
        super().__init__(random.Random(1))

    def read(self, timeout_s: float) -> bytes:
        time.sleep(min(timeout_s, 0.005))
        asked, self.asked = self.asked, b""
        said = wire.encode("progress", 1)
        for name, _type, sequence, _fields in wire.wire.Parser().feed(asked):
            if name == "hello":
                said += wire.encode("identity", sequence, protocol_major=wire.wire.MAJOR, axes=1)
            elif name == "get_limits":
                said += wire.encode("error", sequence, reason=wire.code("REASONS", "AXIS"))
            elif name != "set_point":
                said += wire.encode("ack", sequence)
        return said


def test_a_refusal_is_of_who_asked_though_the_number_was_once_told() -> None:
    with opened(Refuses()) as board:
        board.tell("set_point", axis=0)
        told = board._sequence
        board.ask("home", axis=0)
        board._sequence = told - 1  # as 65535 messages later
        with pytest.raises(BoardRefused, match="get_limits"):
            board.ask("get_limits", 0.2, axis=0)
        assert not board.refused


def test_what_a_listener_raises_reaches_who_asks_and_the_motor_can_still_be_stopped() -> None:
    calls: list[str] = []

    def full(message: wire.Message) -> None:
        calls.append(message.name)
        raise OSError(28, "No space left on device", "motor.csv")

    with opened(Refuses()) as board:
        board.listen("progress", full)
        with board.reading():
            with pytest.raises(OSError, match="No space left"):
                board.ask("home", 2.0, axis=0)
            board.ask("home", 2.0, axis=0)
        board.listen("progress", full)
        with pytest.raises(OSError, match="No space left"):  # without a reader too
            board.ask("home", 2.0, axis=0)
        board.ask("home", 2.0, axis=0)
    assert calls == ["progress"] * 2


def test_a_board_that_cannot_be_asked_for_its_name_opens_by_what_is_shown_of_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    protocol = (wire.wire.MAJOR, wire.wire.MINOR)
    found = [BoardAddress(f"usb:1-{k}", None, True, protocol, lambda: Answers("ack")) for k in (5, 6)]
    monkeypatch.setattr(boards, "find_usb", lambda: list(found))
    monkeypatch.delenv("TAUTLINE_BOARD", raising=False)
    with pytest.raises(TautError, match="say which with --board usb:1-5"):
        open_board()
    with open_board("usb:1-5") as board:
        assert board.where == "usb:1-5"


@pytest.mark.parametrize("where", ["serial:{}@99999999999", "serial:tcp:host", "serial:tcp:", "serial:", "serial:a@b"])
def test_what_is_no_line_is_told_how_one_is_named(where: str) -> None:
    ours, theirs = os.openpty()
    with pytest.raises(TautError, match="expected serial:DEVICE"):
        find_serial(where.format(os.ttyname(theirs)))
    os.close(ours)
    os.close(theirs)


class Device:
    """Every status is this one, and an upload is always a whole block."""

    def __init__(self, state: int, pause_ms: int) -> None:
        self.state, self.pause_ms = state, pause_ms

    def ctrl_transfer(self, kind: int, request: int, value: int, index: int, what: bytes | int, _: int) -> bytes | int:
        if isinstance(what, bytes):
            return len(what)
        return bytes((0, *self.pause_ms.to_bytes(3, "little"), self.state, 0)) if request == 3 else bytes(what)


@pytest.fixture
def slept(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    found: list[float] = []
    monkeypatch.setattr(dfu.time, "sleep", found.append)
    monkeypatch.setattr(dfu.time, "monotonic", lambda: sum(found))
    return found


def route(device: Device) -> dfu.Dfu:
    made = object.__new__(dfu.Dfu)
    made._device, made._interface, made._answer_ms, made._block = device, 1, 1000, 256
    made._asked_s = 0.0
    return made


def test_a_board_that_wants_hours_has_ten_seconds(slept: list[float]) -> None:
    with pytest.raises(TautError, match="stays in DFU state 4"):
        route(Device(4, 0xFFFFFF)).download(b"x" * 300)
    assert sum(slept) == pytest.approx(10.0)
    slept.clear()
    with pytest.raises(TautError, match="does not come to rest"):
        route(Device(7, 0xFFFFFF))._bring_to_idle()
    assert sum(slept) <= 40.0


@pytest.mark.parametrize(("why", "said"), [("the flash failed", "the flash failed"), ("", "does not come to rest")])
def test_why_a_table_was_refused_is_told_though_the_board_does_not_come_to_rest_either(
    why: str, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dfu.usb.util, "release_interface", lambda *_: None)
    made = route(Device(2, 0))  # at rest
    with pytest.raises(dfu.DfuError, match=said), made:
        made._device = Device(10, 0)
        if why:
            raise dfu.DfuError(why)


class Waiting(Device):
    """It asks for ten seconds after every answer, and then has done what it was asked for."""

    asked = 0

    def ctrl_transfer(self, kind: int, request: int, value: int, index: int, what: bytes | int, _: int) -> bytes | int:
        self.asked += request == 3
        self.state = 4 if self.asked % 2 else 5
        return super().ctrl_transfer(kind, request, value, index, what, _)


def test_a_board_that_wants_ten_seconds_for_each_block_is_given_up(slept: list[float]) -> None:
    with pytest.raises(TautError, match="wait without end"):
        route(Waiting(4, 10_000)).download(b"x" * 256 * 20)
    assert sum(slept) <= 45.0


def test_an_upload_without_end_is_given_up() -> None:
    with pytest.raises(TautError, match="does not end"):
        route(Device(2, 0)).upload()
