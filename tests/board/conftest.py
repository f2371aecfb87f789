"""One suite for every board: `--board desktop` (default), `serial`, `emulated`, `m4` or `m33`, started for each
test that needs one, or as `taut` takes it.

Tests that need the simulation (virtual time, power cuts, unplugging) skip on a board without a sim link.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tautline.device import wire
from tautline.device.board import Board, find, open_board
from tautline.errors import TautError
from tautline.simulated.simlink import LINE, PROGRAM, DesktopBoard, SimLink

IN_QEMU = ("m4", "m33")  # cores of one port
SIMULATED = ("desktop", "serial", "emulated", *IN_QEMU)  # boards that are started for each test
_HERE = Path(__file__).resolve().parent
_TOOLS = _HERE.parents[1] / "tools"
_EMULATED = _TOOLS / "emulator" / "board.js"
_QEMU = _TOOLS / "qemu" / "board.py"


def pytest_addoption(parser: pytest.Parser) -> None:
    where = "desktop, serial (the desktop board on a serial line), emulated, m4, m33, "
    where += "usbip:HOST:PORT, serial:DEVICE or a number"
    parser.addoption("--board", default="desktop", help=where)
    parser.addoption("--sim", type=int, help="port of the sim link of a --board usbip:... (an emulated board)")
    parser.addoption("--share", action="store_true", help="of these tests what falls to an emulated or m4 board alone")


def pytest_configure(config: pytest.Config) -> None:
    board = config.getoption("--board")
    if board == "emulated":  # the real image, behind the desktop board's options and ports
        os.environ[PROGRAM] = str(_EMULATED)
    elif board == "serial" or board in IN_QEMU:
        os.environ[LINE] = "uart"
    if board in IN_QEMU:
        os.environ[PROGRAM], os.environ["TAUTLINE_QEMU_CORE"] = str(_QEMU), board


@dataclass
class Bench:
    """The board under test."""

    where: str
    link: SimLink | None
    process: DesktopBoard | None = None
    axes: int | None = None  # that a test is about: a board may have more; None: all of them
    shared: bool = False  # with another board: what this one cannot, nobody runs

    def open(self) -> Board:
        return open_board(self.where)

    def address(self) -> str:
        """HOST:PORT of its USB/IP server."""
        if not self.where.startswith("usbip:"):
            self._skip("needs a board on USB/IP")
        return self.where.removeprefix("usbip:")

    @property
    def leaves_its_bus(self) -> bool:
        """Whether a host is told that the board has gone or restarted; on a serial line it only stops to answer."""
        return not self.where.startswith("serial:")

    def usb(self, board: Board) -> Any:
        """PyUSB's device of an open board."""
        device = getattr(board._link, "device", None)
        return device if device is not None else self._skip("needs a board on USB")

    def _skip(self, why: str) -> Any:
        return pytest.fail(f"{why}: it falls_to that one") if self.shared else pytest.skip(why)

    @property
    def sim(self) -> SimLink:
        if self.link is None:
            pytest.skip("needs a simulated board: no sim link here")
        return self.link

    def run(self, seconds: float) -> None:
        """Lets board time pass."""
        if self.link is None:
            time.sleep(seconds)
            return
        for _ in range(max(round(seconds / 0.02), 1)):
            self.link.ask("advance 20000")

    def ready(self, board: Board) -> None:
        """Every axis commissioned, checked and referenced, at position 0 and off."""
        axes = range(min(board.axes, self.axes or board.axes))
        for axis in axes:
            board.trust_motor(axis)
        for axis in axes:
            board.ask("enable", axis=axis, on=1)  # all at the same time
        for axis in axes:
            self.until(board, axis, "HOLD")
        board.ask("enable", axis=wire.wire.ALL_AXES, on=0)
        for axis in axes:
            self.until(board, axis, "OFF")
            if self.link is not None:
                self.link.ask(f"place {axis} 0")
            board.ask("set_position", axis=axis, q=0.0)

    def until(self, board: Board, axis: int, mode: str, seconds: float = 5.0) -> wire.Message:
        """Runs until the axis is in `mode`."""
        for _ in range(round(seconds / 0.02)):
            status = board.status(axis)
            if status.mode == wire.code("MODES", mode):
                return status
            self.run(0.02)
        raise AssertionError(f"axis {axis} is {wire.text('MODES', status.mode)}, not {mode}: {status}")


class Stalled(Exception):
    """This machine did not run what a test by the wall clock is about: the test is run again."""


def waited_for_a_processor_s() -> float:
    """How long some process of this machine has, since it began; 0 where its kernel does not tell."""
    with contextlib.suppress(OSError):
        for line in Path("/proc/pressure/cpu").read_text().splitlines():
            if line.startswith("some"):
                return 1e-6 * float(line.rpartition("total=")[2])
    return 0.0


class WallClock:
    """Whether this machine keeps up with the wall clock: one that is busy cannot, and then neither a paced board's
    answers nor its rates by that clock say anything about the board, nor about a program in another process that had no
    processor to run on."""

    _BEAT_S, _LATE_S, _BEATS = 0.005, 0.03, 0.85  # idle: 0.008, 0.96
    _WAITED = 0.2  # of the time something waited for a processor; idle: 0.1, beside one busy process on two cores 0.25

    def __init__(self, link: SimLink, last: bool) -> None:
        """`last`: this test will not be run again."""
        self._link, self._last = link, last
        self._board, self._wall = link.ask("state")["t_us"] * 1e-6, time.monotonic()
        self._late_s, self._beats, self._done = 0.0, 0, threading.Event()
        self._waited_s = waited_for_a_processor_s()
        self._thread = threading.Thread(target=self._beat, daemon=True)
        self._thread.start()

    def _beat(self) -> None:
        before = time.monotonic()
        while not self._done.wait(self._BEAT_S):
            now = time.monotonic()
            self._late_s, before = max(self._late_s, now - before - self._BEAT_S), now
            self._beats += 1

    def need(self) -> None:
        """Ends the test, to be run again, where the board has fallen behind or this machine has stood still since this
        object was made."""
        board, wall = self._link.ask("state")["t_us"] * 1e-6 - self._board, time.monotonic() - self._wall
        beats = (self._beats * self._BEAT_S + 0.05) / wall
        waited = (waited_for_a_processor_s() - self._waited_s) / wall
        in_time = board >= 0.95 * wall - 0.05 and self._late_s < self._LATE_S and beats > self._BEATS
        if in_time and waited < self._WAITED + 0.05 / wall:
            return
        why = f"this machine is too slow: {board:.1f} s of the board took {wall:.1f} s, "
        why += f"once {self._late_s:.3f} s late, {beats:.0%} of the beats, {waited:.0%} of it waiting for a processor"
        if self._last:
            pytest.skip(why)
        raise Stalled(why)

    def close(self) -> None:
        self._done.set()
        self._thread.join()
        self._link.close()


ClockOf = Callable[[SimLink], WallClock]


@pytest.fixture
def wall_clock(request: pytest.FixtureRequest) -> Iterator[ClockOf]:
    """The clock of a board from now on."""
    more = getattr(request.config.option, "reruns", None) or 0
    made: list[WallClock] = []

    def begin(link: SimLink) -> WallClock:
        made.append(WallClock(link, last=getattr(request.node, "execution_count", 1) > more))
        return made[-1]

    try:
        yield begin
    finally:
        for clock in made:
            clock.close()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        if "wall_clock" in getattr(item, "fixturenames", ()):
            item.add_marker("wall_clock")
    if config.getoption("--share"):
        board = config.getoption("--board")
        others = [item for item in items if item.path.parent == _HERE and shared_out_to(item) != board]
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item not in others]


def shared_out_to(item: pytest.Item) -> str:
    """Which of the two emulated boards runs a test where each has a share of them: always the same."""
    marked = item.get_closest_marker("falls_to")
    return str(marked.args[0]) if marked else ("emulated", "m4")[zlib.crc32(item.name.encode()) % 2]


@contextmanager
def bench_of(request: pytest.FixtureRequest, axes: int = 2, flash: Path | None = None) -> Iterator[Bench]:
    where = request.config.getoption("--board")
    if where in SIMULATED:
        with DesktopBoard(axes=axes, flash=flash, serial="TEST-1") as desktop:
            link = desktop.link()
            with contextlib.closing(link):
                yield Bench(desktop.where, link, desktop, axes, request.config.getoption("--share"))
        return
    if not find(where):
        pytest.skip(f"no board {where}")
    port = request.config.getoption("--sim")
    link_there = SimLink(port) if port else None
    make_fresh(where, link_there)
    with contextlib.closing(link_there) if link_there is not None else contextlib.nullcontext():
        yield Bench(where, link_there)


def make_fresh(where: str, link: SimLink | None) -> None:
    """A board that earlier tests have used, as it is when it is switched on: no tables, default settings."""
    if link is not None:
        link.ask("plug")
    with open_board(where) as board:
        board.ask("safe_stop", axis=wire.wire.ALL_AXES)
        board.ask("clear_fault", axis=wire.wire.ALL_AXES)
        for axis in range(board.axes):
            board.ask("clear_table", axis=axis, timeout_s=5.0)
        axes = board.axes
        if link is None:
            board.ask("reboot", key=wire.wire.KEY, bootloader=0)
    if link is not None:
        link.ask("advance 500000")
        link.ask("reset")
        for axis in range(axes):
            link.ask(f"place {axis} 0")
    for _ in range(100):  # until it is on the bus again
        with contextlib.suppress(TautError):
            if find(where):
                return
        time.sleep(0.05)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    """Its axes are commissioned, checked and referenced."""
    with bench_of(request) as bench:
        with bench.open() as board:
            bench.ready(board)
        yield bench


@pytest.fixture
def board(bench: Bench) -> Iterator[Board]:
    with bench.open() as board:
        yield board
