"""Unmodified libusb, PyUSB, lsusb and dfu-util drive the board, through a mocked /dev/bus/usb (umockdev_bridge.py)."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import monocypher
import pytest
from test_board_tables import blob

from conftest import Bench, ClockOf
from tautline.device import wire
from tautline.simulated.simlink import DesktopBoard
from tools.signing import update_file

HERE = Path(__file__).parent
SYSTEM_PYTHON = "/usr/bin/python3"

pytestmark = pytest.mark.falls_to("emulated")


def on_the_bus(bench: Bench, *command: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """Runs a program that sees the board as a USB device."""
    for tool in ("umockdev-wrapper", command[0]):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: run 'tools/setup system'")
    bridge = ["umockdev-wrapper", SYSTEM_PYTHON, str(HERE / "umockdev_bridge.py"), bench.address(), "--", *command]
    done = subprocess.run(bridge, capture_output=True, text=True, timeout=60)
    print(done.stdout + done.stderr)
    if check:
        assert done.returncode == 0, done.stdout + done.stderr
    return done


def test_lsusb_reads_the_descriptors(bench: Bench) -> None:
    text = on_the_bus(bench, "lsusb", "-v").stdout
    assert f"ID {wire.wire.USB_VENDOR:04x}:{wire.wire.USB_PRODUCT:04x}" in text
    assert "bcdUSB               2.10" in text
    # Class names come from a database that a machine may lack; the DFU functional descriptor is 33.
    assert re.search(r"bInterfaceClass +254\b", text) and re.search(r"bDescriptorType +33\b", text)
    assert text.count("bAlternateSetting") >= 3
    assert "EP 1 OUT" in text and "EP 1 IN" in text


def test_dfu_util_lists_loads_and_reads_tables(bench: Bench, tmp_path: Path) -> None:
    listed = on_the_bus(bench, "dfu-util", "-l").stdout
    assert listed.count("Found DFU") >= 1 and 'name="axis 0 table"' in listed
    with bench.open() as board:
        serial = board.identity.serial
        board.load_table(0, blob(0, 0.3))
    assert f'serial="{serial}"' in listed

    (tmp_path / "table.bin").write_bytes(blob())
    on_the_bus(bench, "dfu-util", "-a", "0", "-D", str(tmp_path / "table.bin"))
    on_the_bus(bench, "dfu-util", "-a", "0", "-U", str(tmp_path / "back.bin"))
    assert (tmp_path / "back.bin").read_bytes() == blob()
    with bench.open() as board:
        assert board.read_table(0) == blob()  # the same through our own client

    bad = bytearray(blob(0, 0.6))
    bad[300] ^= 1
    (tmp_path / "bad.bin").write_bytes(bytes(bad))
    refused = on_the_bus(bench, "dfu-util", "-a", "0", "-D", str(tmp_path / "bad.bin"), check=False)
    assert "dfuERROR, status(2)" in refused.stdout + refused.stderr  # errFILE; dfu-util's exit status is 0 all the same
    with bench.open() as board:
        assert board.read_table(0) == blob()


def test_dfu_util_loads_firmware(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    if request.config.getoption("--board") != "desktop":
        pytest.skip("an image for the desktop board")
    secret, public = map(bytes, monocypher.generate_signing_key_pair())
    file = tmp_path / "new.update"
    file.write_bytes(update_file(secret, "desktop-1", [b"one", b"one"], (0, 9, 0)))  # for either slot
    with DesktopBoard(update_key=public) as process, contextlib.closing(process.link()) as link:
        bench = Bench(process.where, link, process)
        on_the_bus(bench, "dfu-util", "-a", "firmware", "-D", str(file))
        link.ask("reset")
        with bench.open() as board:
            assert tuple(board.ask("get_firmware").version) == (0, 9, 0)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 1.0])
def test_dfu_util_cut_short_leaves_a_whole_table(bench: Bench, tmp_path: Path, share: float) -> None:
    """The power goes in the first flash operation of a load, the last, or one between; the same command works then."""
    old, new = blob(0, 0.3), blob()
    with bench.open() as board:
        board.load_table(0, old)
        before = bench.sim.ask("state")["flash_operations"]
        board.load_table(0, old)
    operations = bench.sim.ask("state")["flash_operations"] - before
    (tmp_path / "table.bin").write_bytes(new)
    load = ("dfu-util", "-a", "0", "-D", str(tmp_path / "table.bin"))
    bench.sim.ask(f"cut {1 + round(share * (operations - 1))}")
    on_the_bus(bench, *load, check=False)
    assert not bench.sim.ask("state")["powered"]
    bench.sim.ask("reset")
    bench.run(0.1)
    with bench.open() as board:
        assert board.status(0).fault == 0 and board.read_table(0) in (old, new)
    on_the_bus(bench, *load)
    with bench.open() as board:
        assert board.read_table(0) == new


@pytest.mark.parametrize("library", ["system", "package"])
def test_our_host_code_on_libusb_is_our_host_code_on_usbip(bench: Bench, library: str) -> None:
    """The same calls on both buses, with the system's libusb and with the one that comes as a Python package."""
    script = f"""
import usb.backend.libusb1
import libusb_package
if {library!r} == "system":
    libusb_package.get_libusb1_backend = usb.backend.libusb1.get_backend
from tautline.device.board import find, open_board, BoardRefused
(found,) = find()
assert found.where.startswith("usb:") and not found.busy, found
with open_board() as board, board.reading():
    board.load_table(0, bytes.fromhex({blob().hex()!r}))
    try:
        board.ask("get_status", axis=9)
    except BoardRefused as refused:
        print("refused", refused.reason)
    for _ in range(50):
        board.sync()
    print("serial", board.identity.serial, "table", board.status(0).table)
"""
    environment = {key: value for key, value in os.environ.items() if key != "TAUTLINE_BOARD"}
    assert environment
    done = on_the_bus(bench, sys.executable, "-c", script)
    assert "refused AXIS" in done.stdout
    with bench.open() as board:
        assert f"serial {board.identity.serial}" in done.stdout
        assert board.read_table(0) == blob()


def test_the_device_is_lost_under_libusb(bench: Bench) -> None:
    """A pulled plug is BoardGone, as on USB/IP."""
    port = bench.process.ports["sim"] if bench.process else pytest.skip("needs a simulated board")
    script = f"""
from tautline.device.board import open_board, BoardGone
from tautline.simulated.simlink import SimLink
with open_board() as board:
    board.sync()
    link = SimLink({port})
    link.ask("unplug")
    try:
        for _ in range(100):
            board.sync()
    except BoardGone as gone:
        print("gone:", gone)
    link.ask("plug")
"""
    assert "gone:" in on_the_bus(bench, sys.executable, "-c", script).stdout


def test_the_c_example_streams(bench: Bench, wall_clock: ClockOf) -> None:
    """C, libusb and common/ alone: 250 set-points a second through the tables."""
    program = HERE.parents[1] / "build" / "gcc" / "tools" / "examples" / "example_stream"
    if not program.exists():
        pytest.skip("the C example is not built: libusb's header is missing (tools/setup system)")
    with bench.open() as board:
        board.load_table(0, blob())
    bench.sim.ask("realtime on")
    clock = wall_clock(bench.sim)
    text = on_the_bus(bench, str(program), "0", "1").stdout
    clock.need()
    sent, taken, dropped = (int(text.split(word)[0].split()[-1]) for word in (" set-points", " and dropped", "\n"))
    assert sent == 250 and taken == sent and dropped == 0
