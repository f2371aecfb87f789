"""The commands that put a board into service, and what is said where something goes wrong meanwhile."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest
from test_calibration import SHORT, live_on, off
from test_commands import run

from conftest import Bench
from tautline.device import wire
from tautline.device.board import Board
from tautline.errors import TautError
from tautline.live.homing import Homing, home
from tautline.live.session import record_calibration
from tautline.simulated.instrument import preset


def test_home_finds_the_end_and_the_board_knows_its_position(bench: Bench) -> None:
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-2.0, 2.5)  # true positions, not the board's
        for direction, end, true in ((-1, -4.0, -2.0), (1, 3.0, 2.5)):
            q = home(live, Homing(direction, end=end, retreat=0.25))
            assert off(live.board) and live.board.status(0).flags & wire.code("FLAGS", "REFERENCED")
            assert q == pytest.approx(end - 0.25 * direction, abs=0.005)
            assert live.plant.truth()[1][-1] == pytest.approx(true - 0.25 * direction, abs=0.02)


def test_home_gives_up_where_no_end_comes(bench: Bench) -> None:
    with live_on(bench, preset("reference")) as live:
        with pytest.raises(TautError, match=r"no end was found within the reach \(\d+ counts gone\).*taut clear"):
            home(live, Homing(reach=0.5))
        assert off(live.board)
        with pytest.raises(TautError, match="taut clear"):
            home(live)
        live.board.ask("clear_fault", axis=0)
        with pytest.raises(TautError, match="choose another --end"):
            home(live, Homing(end=-1e6))


def test_home_as_a_user_calls_it() -> None:
    done = run("home", "--simulate", "--to", "high", "--retreat", "0.2")
    assert done["referenced"] and done["q"] == pytest.approx(done["end"] - 0.2, abs=0.005)


def test_clear_names_the_fault_and_its_remedy(board: Board, bench: Bench) -> None:
    board.ask("safe_stop", axis=0)
    board.switch_on(1, bench.run)
    bench.sim.ask("inject 1 supply")
    bench.run(0.1)
    board.close()
    done = run("clear", board=bench.where)
    assert done["axes"][0]["fault"] == wire.text("FAULTS", wire.code("FAULTS", "STOPPED"))
    assert re.search(r"\(2\d\d\d mV\): check power supply", done["axes"][1]["fault"])
    assert [row["left"] for row in done["axes"]] == [None, None]
    bench.sim.ask("inject 1 well")
    again = run("clear", "--axis", "1", board=bench.where)
    assert [(row["axis"], row["fault"]) for row in again["axes"]] == [(1, None)]
    with pytest.raises(TautError, match="no axis 3"):
        run("clear", "--axis", "3", board=bench.where)
