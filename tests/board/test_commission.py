"""The commands that put a board into service, and what is said where something goes wrong meanwhile."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_calibration import live_on, off
from test_commands import run

from conftest import Bench, bench_of
from tautline.cli.clear import log_text
from tautline.device import wire
from tautline.device.board import Board
from tautline.errors import TautError
from tautline.live import faults
from tautline.live.commission import commission
from tautline.live.homing import Homing, home
from tautline.live.setup import Live
from tautline.simulated.instrument import preset
from tautline.simulated.simlink import LINE

pytestmark = pytest.mark.minutes


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


def after_batches(live: Live, count: int, what: Callable[[], object]) -> None:
    """Calls `what` once, in the middle of whatever runs when so many telemetry messages have come."""
    seen: list[wire.Message] = []

    def took(batch: wire.Message) -> None:
        seen.append(batch)
        if len(seen) == count:
            what()

    live.board.listen("batch", took)
    live.board.ask("telemetry", axis=0, divider=1)


def test_ctrl_c_during_homing_leaves_the_motor_at_rest_and_no_position(bench: Bench) -> None:
    with live_on(bench, preset("reference")) as live:
        pressed: list[float] = []

        def press() -> None:
            assert live.plant is not None
            pressed.append(live.plant.now_s)
            signal.raise_signal(signal.SIGINT)

        after_batches(live, 100, press)
        with pytest.raises(KeyboardInterrupt):
            home(live)
        assert off(live.board) and not live.board.status(0).flags & wire.code("FLAGS", "REFERENCED")
        assert rested(live, pressed[0]) < 0.1


def forget(board: Board) -> None:
    """Axis 0 as on a board that nobody has commissioned."""
    own = dict(board.ask("get_settings", axis=0).values)
    board.ask("settings", **(own | {"commissioned": 0, "key": wire.wire.KEY}), timeout_s=5.0)


def is_commissioned(board: Board) -> bool:
    """As the status has it, and the settings; the drive that is allowed has to go with it."""
    told = bool(board.status(0).flags & wire.code("FLAGS", "COMMISSIONED"))
    own, limits = board.ask("get_settings", axis=0), board.ask("get_limits", axis=0)
    assert bool(own.commissioned) == told
    assert limits.duty == (own.duty if told else own.low_duty) and own.low_duty <= 0.25 < own.duty
    return told


def test_a_board_that_nobody_commissioned_says_so_and_is_weak(request: pytest.FixtureRequest) -> None:
    with bench_of(request) as fresh:
        with fresh.open() as board:
            if fresh.link is None and is_commissioned(board):
                pytest.skip("this board is commissioned")
            assert not is_commissioned(board)
            board.ask("set_position", axis=0, q=0.0)
            board.switch_on(0, fresh.run)
            board.ask("move", axis=0, q=2000.0)
            assert fresh.until(board, 0, "HOLD").q == pytest.approx(2000.0, abs=5.0)
            board.ask("enable", axis=0, on=0)
        row = run("boards", board=fresh.where)["boards"][0]["axes"][0]
        assert row["commissioned"] is False


@pytest.mark.parametrize(("count", "before"), [(40, True), (150, False), (400, True), (1250, False), (1250, True)])
def test_a_fault_while_commissioning_stores_nothing(bench: Bench, count: int, before: bool) -> None:
    """`before`: it was commissioned once."""
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-3.0, 9.0)
        if not before:
            forget(live.board)
        gains = dict(live.board.ask("get_servo", axis=0).values)
        after_batches(live, count, lambda: live.board.tell("safe_stop", axis=0))
        with pytest.raises(TautError, match=r"^axis 0 has stopped: stopped by safe_stop.*taut clear"):
            commission(live, lambda question: True, lambda text: None)
        assert off(live.board) and live.board.ask("get_servo", axis=0).values == gains
        assert live.board.ask("get_settings", axis=0).proportional == gains["proportional"]
        assert is_commissioned(live.board) == before


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
    assert not any(row["left"] for row in done["axes"])
    bench.sim.ask("inject 1 well")
    again = run("clear", "--axis", "1", board=bench.where)
    assert [(row["axis"], row["fault"]) for row in again["axes"]] == [(1, None)]
    if len(done["axes"]) > 3:
        return
    with pytest.raises(TautError, match="no axis 3"):
        run("clear", "--axis", "3", board=bench.where)


@pytest.fixture
def can_happen(request: pytest.FixtureRequest, ill: str) -> None:
    if ill == "jump" and request.config.getoption("--board") == "emulated":
        pytest.skip("an emulated encoder does not jump")


def rested(live: Live, since_s: float) -> float:
    """How long after `since_s` the motor moved last, s."""
    assert live.plant is not None
    live.wait(0.5)
    t, q, _, _ = live.plant.truth()
    moving = t[np.abs(q - q[-1]) > live.resolution]
    return float(max(moving[-1] - since_s, 0.0))


INJECTED = {
    "blocked": ("STALL", 0.35),
    "unplugged": ("UNMOVED", 1.2),
    "reversed": ("REVERSED", 0.2),
    "coarse": ("SCALE", 0.6),
    "jump": ("ENCODER", 0.05),
    "driver": ("DRIVER", 0.05),
    "supply": ("SUPPLY", 0.08),
    "estop": ("ESTOP", 0.1),
    "silence": ("HOST_LOST", 1.1),
    "cable": (None, 0.1),
}


@pytest.mark.usefixtures("can_happen")
@pytest.mark.parametrize("ill", INJECTED)
def test_each_fault_can_be_seen_by_a_user(ill: str) -> None:
    assert INJECTED.keys() == run("inject")["faults"].keys()
    done = run("inject", ill)
    fault, within_s = INJECTED[ill]
    if ill == "cable" and os.environ.get(LINE) == "uart":
        within_s = INJECTED["silence"][1]  # nobody tells a board on a serial line that its host has gone
    assert done["fault"] == fault and done["rest_s"] <= within_s
    if fault is None:
        assert "the board is gone" in done["says"]
    else:
        assert 0.0 <= done["noticed_s"] <= within_s and "Then run 'taut clear'" in done["says"]


def test_faults_go_to_simulated_boards_alone(bench: Bench) -> None:
    with pytest.raises(TautError, match="simulated boards alone"):
        run("inject", "blocked", "--board", bench.where)
    if bench.process is None:
        return
    run("inject", "supply", "--axis", "1", "--sim", str(bench.process.ports["sim"]))
    with bench.open() as board:
        bench.run(0.1)
        assert board.status(1).supply_mv < 3000
        run("inject", "blocked", "--axis", "0", "--sim", str(bench.process.ports["sim"]))
        bench.run(0.1)
        assert board.status(1).supply_mv < 3000  # what is wrong with another axis does not mend it
        run("inject", "well", "--axis", "1", "--sim", str(bench.process.ports["sim"]))
        bench.run(0.1)
        assert board.status(1).supply_mv > 5000


def test_what_is_injected_is_acknowledged(bench: Bench) -> None:
    answer = bench.sim.ask("inject 1 supply")
    axes = len(bench.sim.ask("state")["q"])
    assert answer["ills"] == ["well", "supply"] + ["well"] * (axes - 2)
    for refused in ("0 fire", f"{axes} blocked", "blocked", "0"):
        with pytest.raises(TautError, match="inject takes an axis"):
            bench.sim.ask(f"inject {refused}")
    assert bench.sim.ask("inject 1 well")["ills"] == ["well"] * axes


def test_a_fault_that_no_board_acknowledges_is_told(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench.sim, "ask", lambda _: {"t_us": 0, "ills": ["well", "well"]})
    with pytest.raises(TautError, match="did not acknowledge 'blocked' of axis 0"):
        faults.inject(bench.sim, 0, "blocked")


def test_commission_measures_the_motor_and_stores_what_it_found(bench: Bench) -> None:
    said: list[str] = []
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-3.0, 9.0)
        before = dict(live.board.ask("get_settings", axis=0).values)
        lazy = before | {"proportional": 300, "derivative": 200, "feed_forward": 1200, "friction": 0.03}
        lazy["commissioned"] = 0
        live.board.ask("settings", **(lazy | {"key": wire.wire.KEY}), timeout_s=5.0)
        found = commission(
            live, lambda question: True, said.append, Homing(), {"current_ma": 350, "instrument": "SN-7"}
        )
        assert off(live.board) and live.board.status(0).fault == 0
        # The motor's own (motor.c), though by these gains it swings at 12 Hz around its path, and to rest: free speed,
        # sliding friction. A count of the encoder is 6 % of the slower way in 10 ms.
        assert found.speed_s == pytest.approx(20000.0, rel=0.02) and found.friction == pytest.approx(0.035, abs=0.002)
        assert found.q == pytest.approx(-4.8, abs=0.02)  # 2 % of the range from its low end, by lazy gains
        assert found.settings["feed_forward"] == pytest.approx(32768.0 / 20.0, rel=0.02)
        assert 2 * found.factor in found.steps and found.steps[found.factor].rms < 3.0
    assert len(said) == 5 + len(found.steps)  # one of them, how far gains are tried
    bench.sim.ask("reset")
    bench.run(0.1)
    with bench.open() as again:
        kept = again.ask("get_settings", axis=0)
        assert (kept.q_low, kept.q_high, kept.current_ma, kept.instrument) == (-5000.0, 5000.0, 350, "SN-7")
        assert kept.friction == pytest.approx(found.friction, abs=1e-4)
        assert kept.proportional == round(300 * found.factor)
        assert is_commissioned(again)
        again.switch_on(0, bench.run)
        again.ask("enable", axis=0, on=0)


def test_gains_are_tried_as_far_as_the_board_takes_all_of_them(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A new board's integral times four is beyond its end: a margin of two would have been said of one that is 1.4."""
    names, said, set_to = ("proportional", "integral", "derivative"), [], []
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-3.0, 9.0)
        own, ask = dict(live.board.ask("get_settings", axis=0).values), live.board.ask
        assert 4 * own["integral"] > wire.wire.GAIN_MAX

        def listened(name: str, **fields: Any) -> wire.Message:
            if name == "servo":
                set_to.append([fields[gain] for gain in names])
            return ask(name, **fields)

        monkeypatch.setattr(live.board, "ask", listened)
        found = commission(live, lambda question: True, said.append)
    for gains, factor in zip(set_to, found.steps, strict=False):  # then they are taken back
        np.testing.assert_allclose(gains, [own[name] * factor for name in names], atol=0.5)
    factors = list(found.steps)
    assert factors[-1] * own["integral"] == pytest.approx(wire.wire.GAIN_MAX) and 2 * found.factor in factors
    assert any(f"up to x {factors[-1]:.3g}, not 4: the integral gain is {own['integral']}" in text for text in said)


def test_a_feed_forward_that_the_board_does_not_take_is_said(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr("tautline.live.commission._fit_drive_law", lambda stretches: (0.03, 1.0 / 500.0))  # counts/s
    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-3.0, 9.0)
        with pytest.raises(TautError, match="another speed than the gains say"):  # it is not as slow
            commission(live, lambda question: True, said.append)
    assert any(f"{wire.wire.GAIN_MAX} at most, and this motor asks for 65536" in text for text in said)


@pytest.mark.parametrize("agreed", [0, 1, 2, 3])
def test_commission_does_nothing_that_was_not_agreed_to(bench: Bench, agreed: int) -> None:
    asked: list[str] = []

    def agree(question: str) -> bool:
        asked.append(question)
        return len(asked) <= agreed

    with live_on(bench, preset("reference")) as live:
        assert live.plant is not None
        live.plant.end_at(-3.0, 9.0)
        forget(live.board)
        gains = live.board.ask("get_servo", axis=0).values
        with pytest.raises(TautError, match="stopped as you said"):
            commission(live, agree, lambda text: None)
        assert len(asked) == agreed + 1 and off(live.board)
        assert live.board.ask("get_servo", axis=0).values == gains
        kept = live.board.ask("get_settings", axis=0).values
        assert all(kept[name] == gains[name] for name in gains) and not is_commissioned(live.board)
        q = live.plant.truth()[1]
        if agreed == 0:
            assert np.ptp(q) == 0.0
        if agreed == 1:
            assert 0.01 < np.ptp(q) < 0.5


def test_a_stop_button_that_opens_is_wired_for_every_axis(bench: Bench) -> None:
    """Released it is closed, which the settings of a new board take for pressed."""
    opens, estop = wire.code("ESTOPS", "OPEN"), wire.code("FAULTS", "ESTOP")
    bench.sim.ask("inject 0 estop")
    bench.run(0.1)
    asked: list[str] = []

    def agree(question: str) -> bool:
        asked.append(question)
        return len(asked) <= agreed

    with live_on(bench, preset("reference")) as live:
        axes = range(live.board.axes)
        for agreed in (0, 2):  # the wiring, the check
            assert all(live.board.status(axis).fault == estop for axis in axes)
            asked.clear()
            with pytest.raises(TautError, match="stopped as you said"):
                commission(live, agree, lambda text: None, wanted={"estop": opens})
            assert len(asked) == agreed + 1
        assert all(live.board.ask("get_settings", axis=axis).estop == opens for axis in axes)
        assert not any(live.board.status(axis).fault for axis in axes)
        bench.sim.ask("inject 0 well")  # pressed
        bench.run(0.1)
        assert all(live.board.status(axis).fault == estop for axis in axes)
        with pytest.raises(TautError, match=r"axis 0 has stopped.*taut clear"):
            commission(live, lambda question: True, lambda text: None, wanted={"estop": opens})


@pytest.mark.parametrize(("ill", "remedy"), [("reversed", "swap the motor's two wires"), ("unplugged", "plugs")])
def test_commission_says_what_is_wired_wrongly(bench: Bench, ill: str, remedy: str) -> None:
    bench.sim.ask(f"inject 0 {ill}")
    with live_on(bench, preset("reference")) as live:
        with pytest.raises(TautError, match=f"{remedy}.*taut clear"):
            commission(live, lambda question: True, lambda text: None)
        assert off(live.board)


def test_commission_as_a_user_calls_it(tmp_path: Path) -> None:
    done = run("commission", "--simulate", "--yes", "--out", str(tmp_path / "steps.png"))
    assert 1.0 <= done["factor"] <= 2.0 and done["settings"]["q_low"] == -5000.0 and done["error_rms"] < 2.0
    assert (tmp_path / "steps.png").read_bytes().startswith(b"\x89PNG")


def test_a_simulated_board_listens_on_this_machine_alone(bench: Bench) -> None:
    if bench.process is None:
        pytest.skip("needs a board of our own")
    ports = {int(bench.process.ports[name]) for name in ("usbip", "uart", "sim") if name in bench.process.ports}
    listening = []
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:] if Path(table).exists() else []:
            local, state = line.split()[1], line.split()[3]
            address, port = local.split(":")
            if state == "0A" and int(port, 16) in ports:
                listening.append(address)
    assert listening == ["0100007F"] * 2  # 127.0.0.1


def test_clear_shows_the_faults_of_before(request: pytest.FixtureRequest, tmp_path: Path) -> None:
    if request.config.getoption("--board") != "desktop":
        pytest.skip("flash in a file that outlives its board")
    flash = tmp_path / "flash.bin"
    for start in range(2):
        with bench_of(request, flash=flash) as bench:
            with bench.open() as board:
                board.ask("safe_stop", axis=start)
                bench.run(1.2)
            log = run("clear", board=bench.where)["log"]
    assert [(row["axis"], row["code"], row["starts_ago"]) for row in log] == [(1, "STOPPED", 0), (0, "STOPPED", 1)]
    said = "\n".join(log_text(log))
    assert re.search(r"after this start, axis 1: stopped by safe_stop\n.*after the start before, axis 0: stopped", said)
    assert "'taut update'" in log_text(None)[0]
