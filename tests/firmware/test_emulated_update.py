"""The real image's loader and updates, in the emulator: the image that is built, signed with the build's own key."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest

from tautline.device import updating, wire
from tautline.device.board import open_board
from tautline.device.firmware import PAGE, text_of, version_of
from tautline.errors import TautError
from tautline.simulated.simlink import PROGRAM, DesktopBoard, SimLink
from tests.board.passing_time import time_passes
from tools.signing import secret_key, update_file

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "rp2040"
KEY = ROOT / "build" / "keys" / "development"
VECTORS = 0x100  # of an image, behind the second stage
BASE = 0x10000000 + 0x80000 + 0x1000  # of the image in slot 1
STACK = 0x20042000
HANGS = bytes.fromhex("72b6 30bf fde7 0000")  # cpsid i; wfi; b back to it


@pytest.fixture
def board(monkeypatch: pytest.MonkeyPatch) -> Iterator[DesktopBoard]:
    if not (BUILD / "tautline-1.bin").is_file() or not KEY.is_file():
        pytest.skip("the image is not built: run './run firmware'")
    monkeypatch.setenv(PROGRAM, str(ROOT / "tools" / "emulator" / "board.js"))
    with DesktopBoard() as process:
        yield process


def image() -> bytes:
    return (BUILD / "tautline-1.bin").read_bytes()


def hanging() -> bytes:
    """As short as an image can be: its reset handler stands still with interrupts off."""
    vectors = struct.pack("<2I", STACK, BASE + VECTORS + 8 | 1)
    return (b"\xff" * VECTORS + vectors + HANGS).ljust(2 * PAGE, b"\xff")


def file_of(folder: Path, content: bytes, version: tuple[int, int, int]) -> Path:
    path = folder / f"{text_of(version)}.update"
    path.write_bytes(update_file(secret_key(KEY), "rp2040", [b"not for this slot", content], version))
    return path


def told(where: str) -> tuple[str, int, str]:
    with open_board(where) as opened:
        says = opened.ask("get_firmware")
        return text_of(version_of(says.version)), int(says.slot), wire.name("FIRMWARES", says.other_state)


def give_up(link: SimLink) -> None:
    """Time for an image that hangs to be given up, and for the other one to come up."""
    for _ in range(4):
        link.ask("advance 800000")


def test_an_update_runs_from_the_other_slot(board: DesktopBoard, tmp_path: Path) -> None:
    with contextlib.closing(board.link()) as link:
        sent = updating.send(board.where, file_of(tmp_path, image(), (0, 9, 0)))
        with time_passes(link):
            done = updating.finish(sent)
        assert done.version == (0, 9, 0) and done.slot == 1
        link.ask("hang")  # once it is confirmed a hang is no trial
        link.ask("advance 600000")
        assert told(board.where) == ("0.9.0", 1, "CONFIRMED")


def test_an_image_that_hangs_gives_way_to_the_old_one(board: DesktopBoard, tmp_path: Path) -> None:
    with contextlib.closing(board.link()) as link:
        version, slot, _ = told(board.where)
        sent = updating.send(board.where, file_of(tmp_path, hanging(), (0, 9, 0)))
        give_up(link)
        with pytest.raises(TautError, match="did not come up"):
            updating.finish(sent)
        assert told(board.where) == (version, slot, "FAILED") and slot == 0
        link.ask("reset")
        link.ask("advance 100000")
        assert told(board.where) == (version, 0, "FAILED")


def test_a_power_cut_leaves_one_that_runs(board: DesktopBoard, tmp_path: Path) -> None:
    file, last = file_of(tmp_path, hanging(), (0, 9, 0)), 2 + 2 + 1 + 1  # sectors, pages, head, record
    with contextlib.closing(board.link()) as link:
        for cut in (1, 2, 4, last - 1, last):
            link.ask(f"cut {cut}")
            with contextlib.suppress(TautError), open_board(board.where) as opened, opened.firmware_route() as route:
                route.download(file.read_bytes()[2 * PAGE :], None, updating.ANSWER_MS)
            assert not link.ask("state")["powered"]
            link.ask("reset")
            if cut == last:  # half of a record is the whole of it
                give_up(link)
            else:
                link.ask("advance 100000")
            assert told(board.where)[1:] == (0, "FAILED" if cut == last else "NONE")


def test_a_signature_is_checked_within_the_time_that_the_host_is_told(board: DesktopBoard, tmp_path: Path) -> None:
    file = file_of(tmp_path, hanging(), (0, 9, 0)).read_bytes()[2 * PAGE :]
    with open_board(board.where) as opened:
        before = opened.sync()
        with opened.firmware_route() as route:
            route.download(file, None, updating.ANSWER_MS)
        took_us = opened.sync() - before
        print(f"an update of two pages took {took_us / 1e6:.3f} s of board time")
        assert took_us < 0.5e6 + 3 * 45e3 + 10e3  # CHECK_MS of main.c, and what its flash takes
