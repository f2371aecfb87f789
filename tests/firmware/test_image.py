"""The real board's image: two builds are the same, its UF2 holds it, one of fewer axes copes with erratum E5."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest

from tautline.device import wire
from tautline.device.board import open_board
from tautline.errors import TautError
from tautline.simulated.simlink import PROGRAM, DesktopBoard
from tools.budget import sizes
from tools.uf2 import to_uf2

ROOT = Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "rp2040"
KEY = ROOT / "build" / "keys" / "development.pub"


@pytest.fixture(scope="module")
def image() -> bytes:
    if not (BUILD / "tautline.bin").is_file():
        pytest.skip("the image is not built: run './run firmware'")
    return (BUILD / "tautline.bin").read_bytes()


def test_two_builds_are_byte_identical(image: bytes, tmp_path: Path) -> None:
    # Elsewhere, from a copy of the sources: no path and no time of the build is in the image.
    sources = tmp_path / "a-longer-path-than-the-first"
    for part in ("common", "firmware", "tools"):
        shutil.copytree(ROOT / part, sources / part, ignore=shutil.ignore_patterns("node_modules", "__pycache__"))
    build, key = tmp_path / "build", KEY.read_text("ascii").strip()
    for command in (
        [
            "cmake",
            "-S",
            sources / "firmware/port/rp2040",
            "-B",
            build,
            "-G",
            "Ninja",
            f"-DTAUTLINE_UPDATE_KEY={key}",
        ],
        ["cmake", "--build", build, "--parallel", str(os.cpu_count() or 1), "--target", "flash"],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    assert (build / "tautline.bin").read_bytes() == image
    assert (build / "tautline-1.bin").read_bytes() == (BUILD / "tautline-1.bin").read_bytes()
    assert (build / "tautline.uf2").read_bytes() == (BUILD / "tautline.uf2").read_bytes()


def test_the_uf2_holds_the_image_and_blanks_the_other_slot(image: bytes) -> None:
    other = 0x10000000 + 0x80000
    assert (BUILD / "tautline.uf2").read_bytes() == to_uf2({0x10000000: image, other: bytes(256)})


def test_loader_and_firmware_are_where_slots_say(image: bytes) -> None:
    firmware = (BUILD / "tautline-0.bin").read_bytes()
    assert image[0x3000:] == firmware and len(image[:0x2000].rstrip(b"\xff")) < 2048
    size, crc = struct.unpack_from("<2I", image, 0x2000 + 8)
    assert size == len(firmware) and crc == zlib.crc32(firmware)
    for slot, begin in (("0", 0x10003000), ("1", 0x10081000)):  # both run where they are linked for
        linked = (BUILD / f"tautline-{slot}.bin").read_bytes()
        reset = struct.unpack_from("<I", linked, 0x104)[0]
        assert begin < reset < begin + len(linked)


def ram(build: Path) -> int:
    """Bytes of RAM but for the stack."""
    found = sizes(build / "tautline.elf")
    return found[".data"] + found[".bss"]


@pytest.fixture
def early_chip(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], None]:
    """Boards are emulated chips of revision B1 on a busy hub (erratum RP2040-E5), with the image of a build folder."""

    def use(build: Path) -> None:
        program = tmp_path / "board"
        emulator = ROOT / "tools" / "emulator" / "board.js"
        program.write_text(f'#!/bin/sh\nexec node "{emulator}" --build "{build}" --revision B1 "$@"\n')
        program.chmod(0o755)
        monkeypatch.setenv(PROGRAM, str(program))

    return use


@pytest.mark.usefixtures("image")
@pytest.mark.parametrize("axes", [pytest.param(1, marks=pytest.mark.long), 3])
def test_an_image_of_fewer_axes_comes_up_on_an_early_chip(axes: int, early_chip: Callable[[Path], None]) -> None:
    build = ROOT / "build" / f"rp2040-{axes}"
    for command in (
        ["cmake", "-S", ROOT / "firmware/port/rp2040", "-B", build, "-G", "Ninja", f"-DTAUTLINE_AXES={axes}"],
        ["cmake", "--build", build, "--parallel", str(os.cpu_count() or 1), "--target", "flash"],
    ):
        subprocess.run(command, check=True, capture_output=True, text=True)
    assert ram(BUILD) - ram(build) > (4 - axes) * 6000  # bytes
    early_chip(build)
    with DesktopBoard() as process, open_board(process.where) as board:
        link = process.link()
        assert board.axes == axes
        last = axes - 1
        board.switch_on(last, lambda seconds: link.ask(f"advance {round(seconds * 1e6)}"))
        board.ask("jog", axis=last, way=40.0)
        for _ in range(50):
            link.ask("advance 20000")
        status = board.status(last)
        assert status.fault == 0 and status.mode == wire.code("MODES", "HOLD")
        assert link.ask("state")["q"][last] / 256.0 == pytest.approx(40.0, abs=6.0)
        with pytest.raises(TautError, match=f"no axis {axes}"):
            board.check_axis(axes)
        link.close()


@pytest.mark.usefixtures("image")
def test_the_image_of_four_axes_does_not_come_up_there(
    early_chip: Callable[[Path], None], capfd: pytest.CaptureFixture[str]
) -> None:
    early_chip(BUILD)
    with pytest.raises(TautError, match="did not start"), DesktopBoard():
        pass
    assert "does not come up on USB" in capfd.readouterr().err
