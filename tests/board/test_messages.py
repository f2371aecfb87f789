"""Finding, opening and asking a board; and what it does with messages that are none."""

from __future__ import annotations

import errno
from dataclasses import replace

import numpy as np
import pytest
import usb.core

from conftest import Bench
from tautline.device import wire
from tautline.device.board import Board, BoardGone, BoardRefused, check_protocol, find, open_board
from tautline.errors import TautError


def test_it_is_found_named_and_left_alone(bench: Bench) -> None:
    (found,) = find(bench.where)
    assert found.serial and not found.busy
    assert found.protocol == (wire.wire.MAJOR, wire.wire.MINOR)
    with bench.open() as board:
        identity = board.identity
        assert identity.serial == found.serial
        assert 1 <= identity.axes <= wire.wire.AXES_MAX
        assert 1000 <= identity.control_hz <= 10000
        (busy,) = find(bench.where)
        assert busy.busy
        assert board.status(0).fault == 0
    (free,) = find(bench.where)
    assert not free.busy


def test_another_protocol_generation_is_refused_with_the_command_that_mends_it(bench: Bench) -> None:
    (found,) = find(bench.where)

    with pytest.raises(TautError, match="pip install --upgrade tautline"):
        check_protocol(replace(found, protocol=(wire.wire.MAJOR + 1, 0)))
    with pytest.raises(TautError, match=r"run '(cmake|cp) "):
        check_protocol(replace(found, protocol=(wire.wire.MAJOR - 1, 0)))


def test_firmware_older_than_a_message_is_named_before_it_is_sent(board: Board) -> None:
    board.identity = replace(board.identity, values={**board.identity.values, "protocol_minor": 0})
    major = wire.wire.MAJOR
    for send in (board.ask, board.tell):
        for name, since in wire.wire.SINCE.items():
            with pytest.raises(
                TautError, match=rf"protocol {major}\.0, '{name}' came with {major}\.{since}: (run|hold)"
            ):
                send(name, axis=0)
    assert board.sync() >= 0  # it did not hear of it


def test_two_hosts(bench: Bench) -> None:
    with bench.open() as board:
        with pytest.raises(TautError, match="another program uses the board"):
            bench.open()
        assert board.sync() >= 0
    with bench.open() as board:
        assert board.sync() >= 0


def test_the_clock_is_aligned_with_a_known_error(board: Board, bench: Bench) -> None:
    bench.run(0.1)  # what an emulated board ran ahead while it was opened is taken from this
    before = board.sync()
    bench.run(0.1)
    assert 0.08e6 < board.sync() - before < 2e6
    assert board.align(8) < 0.02


@pytest.mark.parametrize("seed", range(6))
def test_garbage_loses_nothing_that_is_whole(board: Board, seed: int) -> None:
    """Random bytes, cut frames, frames of other versions between good requests: each good one is answered."""
    rng = np.random.default_rng(seed)
    whole = wire.encode("ping", 7, host_us=1)
    for _ in range(30):
        kind = rng.integers(6)
        if kind == 0:
            junk = rng.integers(0, 256, rng.integers(1, 700), dtype=np.uint8).tobytes()
        elif kind == 1:
            junk = whole[: rng.integers(1, len(whole))]
        elif kind == 2:
            flipped = bytearray(whole)
            flipped[rng.integers(len(whole))] ^= 1 << rng.integers(8)
            junk = bytes(flipped)
        elif kind == 3:
            junk = whole[:2] * int(rng.integers(1, 200))  # magic numbers that lead nowhere
        elif kind == 4:
            junk = whole[:8]  # a header whose payload never comes
        else:
            junk = b""
        if junk:
            board._link.write(junk)
        # What begins like a frame may swallow what follows, up to one frame's length; then all is well again.
        for _ in range(10):
            board.tell("marker", valid=0)
        assert board.ask("ping", host_us=99).host_us == 99
    assert board.status(0).fault == 0


def test_unknown_short_and_refused_requests_are_named(board: Board) -> None:
    with pytest.raises(BoardRefused) as refused:
        board.ask("get_status", axis=9)
    assert refused.value.reason == "AXIS"
    with pytest.raises(BoardRefused) as refused:
        board.ask("move", axis=0, q=0.0, speed_s=0.0)
    assert refused.value.reason == "OFF"
    with pytest.raises(BoardRefused) as refused:
        board.ask("reboot", key=1, bootloader=0)
    assert refused.value.reason == "KEY"
    board.tell("set_point", axis=0, value=0, at_us=0)
    board.sync()
    assert [error.reason for error in board.refused] == ["OFF"] or [e.reason for e in board.refused] == [
        "NOT_FOLLOWING"
    ]


@pytest.mark.falls_to("emulated")
def test_unplugged_at_any_moment(bench: Bench) -> None:
    for moment in ("idle", "moving", "reading"):
        with bench.open() as board:
            board.ask("clear_fault", axis=wire.wire.ALL_AXES)
            board.ask("telemetry", axis=0, divider=1)
            if moment == "moving":
                board.ask("enable", axis=0, on=1)
                board.ask("move", axis=0, q=300.0, speed_s=0.0)
            bench.run(0.05)
            if moment == "reading":
                with board.reading():
                    bench.sim.ask("unplug")
                    with pytest.raises(BoardGone):
                        for _ in range(1000):
                            board.sync()
            else:
                bench.sim.ask("unplug")
                with pytest.raises(BoardGone, match="check plug and power"):
                    board.sync()
        with pytest.raises(TautError):
            open_board(bench.where)
        bench.run(1.0)
        bench.sim.ask("plug")
        with bench.open() as board:
            assert board.status(0).mode in (wire.code("MODES", "HOLD"), wire.code("MODES", "OFF"))
            board.ask("enable", axis=0, on=0)
            bench.until(board, 0, "OFF")


@pytest.mark.falls_to("emulated")
def test_answers_that_fill_their_packets_exactly_are_not_lost(board: Board, bench: Bench) -> None:
    """16 pongs are 7 full packets and no short one: the read ends by its time-out, and gives what came."""
    device = bench.usb(board)
    device.write(0x01, b"".join(wire.encode("ping", 100 + i, host_us=i) for i in range(16)))
    data = b""
    with pytest.raises(usb.core.USBTimeoutError):
        while True:
            data += bytes(device.read(0x81, 4096, timeout=50))
    pongs = list(wire.Decoder().feed(data))
    assert [pong.host_us for pong in pongs] == list(range(16)) and len(data) == 7 * 64


def test_a_host_that_leaves_without_a_word(bench: Bench) -> None:
    """The device handle is dropped in the middle of a transfer: the next host finds the board in order."""
    (found,) = find(bench.where)
    link = found.open()
    link.write(wire.encode("hello", 1, protocol_major=1, protocol_minor=0)[:5])
    assert link.read(0.02) == b""
    link.close()
    bench.run(0.2)
    with bench.open() as board:
        assert board.sync() >= 0
        assert board.counters().bytes_bad <= 5


@pytest.mark.parametrize("share", [0.05, 0.3, 0.99])
def test_a_half_frame_costs_no_later_request(board: Board, bench: Bench, share: float) -> None:
    """As a host leaves it that dies while it writes; the next one gets its first answer."""
    whole = wire.encode("motion_start", 7)
    board._link.write(whole[: round(share * len(whole))])
    bench.run(0.2)
    assert board.ask("ping", 0.5, host_us=1).host_us == 1


@pytest.mark.falls_to("emulated")
@pytest.mark.parametrize("seed", range(4))
def test_well_formed_nonsense(bench: Bench, seed: int) -> None:
    """Every request, with values from all over their ranges: refused or done, and the board stays in order."""
    rng = np.random.default_rng(seed)
    bits = {"u8": 8, "u16": 16, "u32": 32, "u64": 64, "i8": 8, "i16": 16, "i32": 32}
    requests = [name for name, message in wire.wire.MESSAGES.items() if message["type"] < 0x80 and name != "reboot"]

    def value(kind: str) -> int:
        low, high = (
            (-(1 << bits[kind] - 1), (1 << bits[kind] - 1) - 1) if kind[0] == "i" else (0, (1 << bits[kind]) - 1)
        )
        choice = int(rng.integers(5))
        if choice == 0:
            return (low, high, 0)[int(rng.integers(3))]
        if choice == 1:
            return low + int.from_bytes(rng.bytes(8), "little") % (high - low + 1)
        near = int(rng.integers(-3, 4)) if choice == 2 else round(float(rng.normal(0.0, 3e4)))
        return min(max(near, low), high)

    with bench.open() as board:
        for round_number in range(60):
            for _ in range(12):
                name = str(rng.choice(requests))
                fields: dict[str, object] = {}
                for field, kind, count, _doc in wire.wire.MESSAGES[name]["fields"]:
                    if kind == "text":
                        fields[field] = "".join(chr(c) for c in rng.integers(1, 128, rng.integers(count + 1)))
                        continue
                    plausible = field == "axis" and rng.integers(4)
                    one = [int(rng.integers(2)) if plausible else value(kind) for _ in range(count)]
                    fields[field] = one[0] if count == 1 else tuple(one)
                board._link.write(wire.wire.encode(name, 60_000 + round_number, fields))
                board.sync()
            bench.run(float(rng.choice([0.02, 0.1])))
            if round_number % 10 == 9:
                board.ask("safe_stop", axis=wire.wire.ALL_AXES)
                bench.run(0.2)
                assert board.status(0).mode == wire.code("MODES", "OFF") and board.status(0).duty == 0.0
                board.ask("clear_fault", axis=wire.wire.ALL_AXES)
                board.ask("enable", axis=0, on=1)
        board.ask("safe_stop", axis=wire.wire.ALL_AXES)
        bench.run(0.5)
        board.ask("clear_fault", axis=wire.wire.ALL_AXES)
        assert board.ask("hello", protocol_major=wire.wire.MAJOR).axes == board.axes


@pytest.mark.falls_to("emulated")
@pytest.mark.parametrize("endpoint", [0x01, 0x81])
def test_a_halted_endpoint_answers_stall_until_it_is_cleared(board: Board, bench: Bench, endpoint: int) -> None:
    """SET_FEATURE(ENDPOINT_HALT) and CLEAR_FEATURE as any host may send them; nothing that is whole is lost later."""
    board.sync()
    device = bench.usb(board)
    device.ctrl_transfer(0x02, 3, 0, endpoint, None)
    assert bytes(device.ctrl_transfer(0x82, 0, 0, endpoint, 2)) == b"\1\0"
    with pytest.raises(usb.core.USBError) as stalled:
        if endpoint & 0x80:
            device.read(endpoint, 64, 500)
        else:
            device.write(endpoint, bytes(64), 500)
    assert stalled.value.errno == errno.EPIPE
    for _ in range(2):  # once more than is needed
        device.clear_halt(endpoint)
    assert bytes(device.ctrl_transfer(0x82, 0, 0, endpoint, 2)) == b"\0\0"
    for _ in range(5):
        assert board.sync() >= 0
