"""A table is moved while the tip is held: whatever happens in the middle of it, the motor does not jump by more than a
count, comes to rest, and what is in use afterwards is a whole table, as it was calibrated or flashed.

All times are the board's: they pass only where the test grants them, however slowly a board is emulated.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from test_board_tables import GRID, model

from conftest import SIMULATED, Bench, bench_of
from tautline import tables
from tautline.device import wire
from tautline.device.board import Board
from tautline.errors import TautError
from tautline.model import Model

OLD, NEW = model(), model(scale=0.7)
LIMITS = replace(tables.Limits.of(OLD.rig), adapt=(0.4, 0.5, 1.5))
TIP_DEG, TURN_DEG = 12.0, -4.0
OFFSET, SCALE = 150.0, 0.8  # counts; of B
WITHIN_MS = 400
SILENCE_S = 0.2
MOST = 1.0  # counts that the motor moves in a millisecond
STILL = 0.6  # counts within which a motor at rest stays: it is led by whole ones
NEAR = 2.0  # counts: the same place
DEG = 65536


def blob(of: Model = OLD) -> bytes:
    return tables.encode(of, limits=LIMITS, created_s=0)


@dataclass
class Holder:
    """Leads the tip to its place and holds it there; looks at the motor every millisecond."""

    bench: Bench
    board: Board
    path: list[float] = field(default_factory=list)  # of the motor, counts

    def begin(self) -> None:
        self.board.ask("enable", axis=0, on=1)
        self.bench.until(self.board, 0, "HOLD")
        self.board.ask("follow", axis=0, target=1, compensation=2, silence_us=round(SILENCE_S * 1e6))
        start = self.board.status(0).c_est
        for goal in (TURN_DEG, TIP_DEG):  # pushed from below at the end
            for share in np.linspace(0.0, 1.0, 41)[1:]:
                self._say(start + share * (goal - start))
                self.bench.sim.ask("advance 20000")
            start = goal
        self.hold(0.3)
        del self.path[:-1]

    def hold(self, seconds: float, says: bool = True) -> None:
        for _ in range(round(seconds * 50)):
            if says:
                self._say(TIP_DEG)
            self.path += [q / 256.0 for q in self.bench.sim.ask("advance 20000")["q"][0]]

    def _say(self, c_deg: float) -> None:
        self.board.tell("set_point", axis=0, value=round(c_deg * DEG), at_us=0)

    def adapt(self) -> None:
        self.board.ask("adapt", axis=0, offset=OFFSET, scale=SCALE, within_ms=WITHIN_MS)

    @property
    def jump(self) -> float:
        return float(np.abs(np.diff(self.path)).max())

    @property
    def rests(self) -> bool:
        return float(np.ptp(self.path[-200:])) <= STILL


def moved_by() -> float:
    """How far the motor goes while it is adapted: the tip stays, pushed from below."""
    counts = 1.0 / OLD.rig.actuator.encoder_resolution
    p = np.interp(TIP_DEG, OLD.c_deg, GRID)
    return -OFFSET - 0.5 * (1.0 - SCALE) * float(np.interp(p, GRID, OLD.width)) * counts


@contextmanager
def held(bench: Bench) -> Iterator[Holder]:
    """With the old table, at rest before anything is adapted."""
    with bench.open() as board:
        bench.ready(board)
        board.load_table(0, blob())
        holder = Holder(bench, board)
        holder.begin()
        yield holder


@pytest.fixture(name="bench")
def one_axis(request: pytest.FixtureRequest) -> Iterator[Bench]:
    if request.config.getoption("--board") not in SIMULATED:
        pytest.skip("cuts the power of a simulated board")
    with bench_of(request, axes=1) as bench:
        yield bench


def is_calibrated_again(bench: Bench, calibrated: float) -> None:
    """The whole old table, and nothing left of what moved it."""
    with bench.open() as board:
        assert board.read_table(0) == blob()
        status = board.status(0)
        assert status.mode in (wire.code("MODES", "OFF"), wire.code("MODES", "HOLD"))
        assert status.table == wire.code("TABLES", "NEWEST")
        if status.fault:
            board.ask("clear_fault", axis=0)
        if not status.flags & wire.code("FLAGS", "REFERENCED"):
            board.ask("set_position", axis=0, q=bench.sim.ask("state")["q"][0] / 256.0)
        holder = Holder(bench, board)
        holder.begin()
        assert holder.path[-1] == pytest.approx(calibrated, abs=NEAR)


def test_it_goes_all_the_way_and_stays(bench: Bench) -> None:
    with held(bench) as holder:
        before = holder.path[-1]
        holder.adapt()
        holder.hold(0.8)
        assert holder.jump <= MOST and holder.rests
        assert holder.path[-1] - before == pytest.approx(moved_by(), abs=NEAR)


LOST: dict[str, Callable[[Holder], object]] = {
    "silent": lambda holder: None,
    "killed": lambda holder: holder.board.close(),
    "unplugged": lambda holder: holder.bench.sim.ask("unplug"),
}


@pytest.mark.parametrize(("how", "share"), [("silent", 0.5), ("killed", 0.15), ("killed", 0.8), ("unplugged", 0.4)])
def test_a_host_that_is_lost_takes_it_along(bench: Bench, how: str, share: float) -> None:
    with held(bench) as holder:
        calibrated = holder.path[-1]
        holder.adapt()
        holder.hold(share * WITHIN_MS * 1e-3)
        assert abs(holder.path[-1] - calibrated) > 0.5 * share * abs(moved_by())  # in the middle of it
        LOST[how](holder)
        holder.hold(2.0, says=False)
        assert holder.jump <= MOST and holder.rests
        bench.sim.ask("plug")
    is_calibrated_again(bench, calibrated)


@pytest.mark.falls_to("emulated")
@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_power_cut_leaves_the_calibrated_table(bench: Bench, share: float) -> None:
    with held(bench) as holder:
        calibrated = holder.path[-1]
        holder.adapt()
        holder.hold(share * WITHIN_MS * 1e-3)
        assert holder.jump <= MOST
        bench.sim.ask("reset")
        holder.hold(0.4, says=False)  # it runs down by its friction
        assert holder.jump <= MOST and holder.rests
    is_calibrated_again(bench, calibrated)


LAST_CUT = 2 + -(-len(blob()) // 256)  # an erase, the pages, the header


@pytest.mark.parametrize("cut", [0, 1, 4, LAST_CUT])
def test_a_table_swapped_in_the_middle_is_whole(request: pytest.FixtureRequest, tmp_path: Path, cut: int) -> None:
    """`cut`: the flash operation at which the power goes; 0: none."""
    if request.config.getoption("--board") not in SIMULATED:
        pytest.skip("cuts the power of a simulated board")
    flash = tmp_path / "flash.bin"
    with bench_of(request, axes=1, flash=flash) as bench, held(bench) as holder:
        holder.adapt()
        holder.hold(0.5 * WITHIN_MS * 1e-3)
        with pytest.raises(TautError, match="motor is on"):  # first it has to rest
            holder.board.load_table(0, blob(NEW))
        holder.board.ask("enable", axis=0, on=0)
        holder.hold(0.3, says=False)
        assert holder.jump <= MOST and holder.rests
        if cut:
            bench.sim.ask(f"cut {cut}")
            with pytest.raises(TautError):
                holder.board.load_table(0, blob(NEW))
        else:
            holder.board.load_table(0, blob(NEW))
            assert holder.board.read_table(0) == blob(NEW)
            holder.board.ask("enable", axis=0, on=1)
            holder.hold(0.5, says=False)
            assert holder.jump <= MOST and holder.rests
            assert holder.board.status(0).fault == 0
    with bench_of(request, axes=1, flash=flash) as bench, bench.open() as board:
        may_be = (
            [blob(), blob(NEW)] if cut == LAST_CUT else [blob()] if cut else [blob(NEW)]
        )  # half a header may be whole
        assert board.read_table(0) in may_be
        assert board.status(0).fault == 0
