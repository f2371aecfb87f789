"""Tables by DFU: stored, read back, refused with a reason, broken off, cut at every flash operation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import usb.core

from conftest import SIMULATED, Bench, bench_of
from tautline import tables
from tautline.device import wire
from tautline.device.board import Board, BoardGone, BoardRefused
from tautline.device.dfu import Dfu
from tautline.errors import TautError
from tautline.model import Model
from tautline.simulated.instrument import preset, reference_rig

DNLOAD_IDLE = 5  # DFU 1.1, bState
GRID = np.linspace(-5.0, 5.0, 257)


def model(name: str = "reference", seed: int = 0, scale: float = 1.0) -> Model:
    """What a calibration without any error would give."""
    instrument = preset(name, reference_rig(), seed)
    width = instrument.backlash(GRID) * scale
    return Model(instrument.rig, GRID, width, 0.001 + 0 * GRID, instrument.bend(GRID), 0.08, (-4.5, 4.5))


def blob(axis: int = 0, scale: float = 1.0) -> bytes:
    return tables.encode(model(scale=scale), axis=axis, created_s=0)


def test_a_table_is_stored_read_back_and_survives_a_restart(bench: Bench) -> None:
    with bench.open() as board:
        assert board.read_table(0) == b"" or bench.link is None
        board.load_table(0, blob())
        assert board.read_table(0) == blob()
        status = board.status(0)
        assert status.table == wire.code("TABLES", "NEWEST") and status.table_reason == 0
        board.load_table(1, blob(1, 0.5))
        board.load_table(0, blob(0, 0.7))
        assert (board.read_table(0), board.read_table(1)) == (blob(0, 0.7), blob(1, 0.5))
    if bench.link is not None:
        bench.link.ask("reset")
    with bench.open() as board:
        assert (board.read_table(0), board.read_table(1)) == (blob(0, 0.7), blob(1, 0.5))


def test_bad_tables_are_refused_with_a_reason_and_the_old_one_stays(board: Board) -> None:
    board.load_table(0, blob())
    good = bytearray(blob(0, 0.5))
    damaged = bytes(good[:200]) + bytes([good[200] ^ 4]) + bytes(good[201:])
    cases = {
        "CRC-32": damaged,
        "magic": b"\0\0\0\0" + bytes(good[4:]),
        "another axis": blob(1),
        "shorter": bytes(good[:60]),
        "size in the header": bytes(good) + bytes(4),
        "longer": bytes(good) + bytes(8000),
    }
    for says, bad in cases.items():
        with pytest.raises(TautError) as refused:
            board.load_table(0, bad)
        assert says in str(refused.value), (says, str(refused.value))
        assert board.read_table(0) == blob()
    board.load_table(0, bytes(good))
    assert board.read_table(0) == bytes(good)


def test_tables_by_message_and_by_dfu_are_the_same(board: Board) -> None:
    board.load_table_by_messages(0, blob())
    assert board.read_table(0) == board.read_table_by_messages(0) == blob()
    board.load_table(0, blob(0, 0.5))
    assert board.read_table_by_messages(0) == blob(0, 0.5)
    with pytest.raises(TautError, match="another axis"):
        board.load_table_by_messages(0, blob(1))
    with pytest.raises(TautError, match="longer"):
        board.load_table_by_messages(0, blob() + bytes(8000))
    assert board.read_table(0) == blob(0, 0.5)


def test_a_part_that_comes_twice_or_is_lost_ends_the_upload(board: Board) -> None:
    board.load_table(0, blob())
    part = wire.wire.PART
    new = blob(0, 0.5)

    def send(index: int) -> None:
        piece = new[index * part : (index + 1) * part]
        values = tuple(piece) + (0,) * (part - len(piece))
        board.ask("table_write", axis=0, count=len(piece), offset=index * part, bytes=values)

    for wrong in (1, 3):  # again the same; not the next
        for index in range(2):
            send(index)
        with pytest.raises(BoardRefused) as refused:
            send(wrong)
        assert refused.value.reason == "TABLE_SIZE"
    for index in range(3):
        send(index)
    with pytest.raises(BoardRefused) as refused:  # the end of it never came
        board.ask("table_store", axis=0, size=len(new))
    assert refused.value.reason == "TABLE_SIZE"
    assert board.read_table(0) == blob()


def test_a_table_is_refused_while_a_motor_is_on(board: Board, bench: Bench) -> None:
    board.load_table(0, blob())
    board.ask("enable", axis=0, on=1)
    with pytest.raises(TautError, match="motor is on"):
        board.load_table(0, blob(0, 0.5))
    assert board.read_table(0) == blob()
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")
    board.load_table(0, blob(0, 0.5))


@pytest.mark.falls_to("emulated")
def test_a_download_broken_off_leaves_the_old_table(bench: Bench) -> None:
    with bench.open() as board:
        board.load_table(0, blob())
    for blocks in (1, 3, 5):
        with bench.open() as board:
            device = bench.usb(board)
            board_interface = 1
            device.set_interface_altsetting(board_interface, 0)
            for number in range(blocks):
                part = blob(0, 0.5)[256 * number : 256 * (number + 1)]
                device.ctrl_transfer(0x21, 1, number, board_interface, part)
                answer = bytes(6)
                while answer[4] != DNLOAD_IDLE:
                    answer = bytes(device.ctrl_transfer(0xA1, 3, 0, board_interface, 6))
                    assert answer[0] == 0
        # the host is gone in the middle; the next one finds the board idle and the old table
        with bench.open() as board:
            assert board.read_table(0) == blob()
            board.load_table(0, blob(0, 0.9))
            board.load_table(0, blob())


def test_a_board_that_holds_something_else_is_noticed(board: Board, monkeypatch: pytest.MonkeyPatch) -> None:
    upload, read = Dfu.upload, Board.read_table_by_messages
    monkeypatch.setattr(Dfu, "upload", lambda self: upload(self)[:-1] + b"?")
    monkeypatch.setattr(Board, "read_table_by_messages", lambda self, axis: read(self, axis)[:-1] + b"?")
    with pytest.raises(TautError, match="another table than was sent"):
        board.load_table(0, blob())


def test_unplugged_during_a_download(bench: Bench) -> None:
    with bench.open() as board:
        board.load_table(0, blob())

        def pull(share: float, what: str) -> None:
            if share > 0.5 and bench.sim.ask("state")["attached"]:
                bench.sim.ask("unplug")

        with pytest.raises(BoardGone):
            board.load_table(0, blob(0, 0.5), pull)
    bench.sim.ask("plug")
    with bench.open() as board:
        assert board.read_table(0) == blob()


@pytest.mark.falls_to("emulated")
def test_a_power_cut_at_any_write_leaves_the_old_or_the_new_table(
    request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    """Counted from the flash operation at which the power goes; every one of a download until it completes."""
    if request.config.getoption("--board") not in SIMULATED:
        pytest.skip("cuts the power of a simulated board")
    outcomes = []
    for cut in range(1, 40):
        flash = tmp_path / f"flash-{cut}.bin"
        with bench_of(request, flash=flash) as bench:
            with bench.open() as board:
                board.load_table(0, blob())
            bench.sim.ask(f"cut {cut}")
            with bench.open() as board:
                try:
                    board.load_table(0, blob(0, 0.5))
                    outcomes.append("whole")
                except (TautError, usb.core.USBError):
                    outcomes.append("cut")
        with bench_of(request, flash=flash) as bench, bench.open() as board:
            assert board.read_table(0) in (blob(), blob(0, 0.5)), f"cut at operation {cut}"
            assert board.status(0).table in (wire.code("TABLES", "NEWEST"), wire.code("TABLES", "OLDER"))
            board.load_table(0, blob(0, 0.8))  # and it goes on working
            assert board.read_table(0) == blob(0, 0.8)
        if outcomes[-1] == "whole":
            break
    assert outcomes[-1] == "whole" and outcomes.count("cut") >= 3
