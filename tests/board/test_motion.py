"""Moving an axis: limits, following, silence, safe stop. Positions are counts."""

from __future__ import annotations

import numpy as np
import pytest
from test_board_tables import blob

from conftest import Bench
from tautline.device import wire
from tautline.device.board import Board, BoardGone, BoardRefused
from tautline.errors import TautError


def telemetry(board: Board) -> list[wire.Message]:
    batches: list[wire.Message] = []
    board.listen("batch", batches.append)
    board.ask("telemetry", axis=0, divider=1)
    return batches


def column(batches: list[wire.Message], name: str) -> np.ndarray:
    return np.concatenate([batch.values[name][: batch.count] for batch in batches])


def times(batches: list[wire.Message]) -> np.ndarray:
    return np.concatenate([batch.t_us + batch.period_us * np.arange(batch.count) for batch in batches])


def test_who_listens_for_a_while_hears_nothing_after_it(board: Board, bench: Bench) -> None:
    heard: list[wire.Message] = []
    with pytest.raises(TautError), board.listening(batch=heard.append, event=heard.append):
        board.ask("telemetry", axis=0, divider=1)
        bench.run(0.1)
        board.status(0)
        raise TautError("what ran inside failed")
    so_far = len(heard)
    bench.run(0.1)
    board.status(0)
    assert so_far and len(heard) == so_far


def test_a_move_arrives_within_limits(board: Board, bench: Bench) -> None:
    batches = telemetry(board)
    arrived: list[wire.Message] = []
    board.listen("event", arrived.append)
    limits = dict(board.ask("get_limits", axis=0).values)
    limits.update(speed_s=2000.0, acceleration_s2=20000.0)
    board.ask("limits", **limits)
    board.ask("enable", axis=0, on=1)
    board.ask("move", axis=0, q=900.0, speed_s=0.0)
    bench.until(board, 0, "HOLD")
    bench.run(0.3)
    status = board.status(0)
    assert abs(status.q - 900.0) <= 2.0
    assert [message.event for message in arrived] == [wire.code("EVENTS", "ARRIVED")]
    t, reference = times(batches) * 1e-6, column(batches, "q_ref")
    assert np.all(np.diff(t) > 0) and board.missed == 0
    speed = np.diff(reference) / np.diff(t)
    assert np.abs(speed).max() <= 2000.0 * 1.01
    assert board.counters().telemetry_dropped == 0
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")


@pytest.mark.falls_to("emulated")
def test_every_move_arrives(board: Board, bench: Bench) -> None:
    board.ask("enable", axis=0, on=1)
    for target in (300.0, 301.0, 900.0, -20.0, 17.0, 17.5, 5000.0, 4999.5, 0.0):
        board.ask("move", axis=0, q=target, speed_s=0.0)
        status = bench.until(board, 0, "HOLD")
        assert status.q_ref == target
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")


def test_telemetry_comes_at_1_khz_with_device_time(board: Board, bench: Bench) -> None:
    batches = telemetry(board)
    bench.run(1.0)
    board.sync()
    t = times(batches)
    assert len(t) >= 900
    assert np.all(np.diff(t) == 1000)


def test_a_silent_sender_brings_the_axis_to_rest(board: Board, bench: Bench) -> None:
    events: list[wire.Message] = []
    board.listen("event", events.append)
    board.ask("enable", axis=0, on=1)
    board.ask("follow", axis=0, target=0, silence_us=60_000)
    start = board.status(0).q
    for i in range(20):
        board.tell("set_point", axis=0, value=round((start + 10.0 * i) * 256), at_us=0)
        bench.run(0.02)
    assert board.status(0).mode == wire.code("MODES", "FOLLOW_MOTOR")
    moving = board.status(0).q
    assert moving > start + 100.0
    bench.run(0.5)
    status = board.status(0)
    assert status.flags & wire.code("FLAGS", "AT_REST")
    assert wire.code("EVENTS", "SILENT") in [event.event for event in events]
    assert board.counters().silences == 1
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")


def test_safe_stop_from_motion_and_clearing(board: Board, bench: Bench) -> None:
    board.ask("enable", axis=0, on=1)
    board.ask("move", axis=0, q=2000.0, speed_s=500.0)
    bench.run(0.5)
    board.ask("safe_stop", axis=wire.wire.ALL_AXES)
    bench.run(0.1)
    status = board.status(0)
    assert status.mode == wire.code("MODES", "OFF") and status.fault == wire.code("FAULTS", "STOPPED")
    with pytest.raises(BoardRefused) as refused:
        board.ask("enable", axis=0, on=1)
    assert refused.value.reason == "FAULT"
    board.ask("clear_fault", axis=0)
    board.ask("enable", axis=0, on=1)
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")


def test_enabling_disabling_and_new_tables_never_make_the_axis_jump(board: Board, bench: Bench) -> None:
    batches = telemetry(board)
    start = board.status(0).q
    for scale in (1.0, 0.5):
        board.load_table(0, blob(0, scale))
        for target in (0, 1):
            board.ask("enable", axis=0, on=1)
            bench.run(0.1)
            board.ask("follow", axis=0, target=target, silence_us=0)
            bench.run(0.1)
            board.ask("enable", axis=0, on=0)
            bench.until(board, 0, "OFF")
    board.sync()
    assert np.abs(column(batches, "q") - start).max() <= 2.0


def test_position_limits_hold_the_axis(board: Board, bench: Bench) -> None:
    limits = dict(board.ask("get_limits", axis=0).values)
    limits.update(q_low=-400.0, q_high=400.0)
    board.ask("limits", **limits)
    assert board.ask("get_limits", axis=0).q_high == 400.0
    board.ask("enable", axis=0, on=1)
    try:
        board.ask("move", axis=0, q=3000.0, speed_s=0.0)
    except BoardRefused as refused:
        assert refused.reason == "RANGE"
    bench.run(2.0)
    assert board.status(0).q <= 402.0
    board.ask("enable", axis=0, on=0)
    bench.until(board, 0, "OFF")


def test_a_hung_main_loop_is_restarted_into_the_safe_state(bench: Bench) -> None:
    with bench.open() as board:
        board.ask("enable", axis=0, on=1)
        board.ask("move", axis=0, q=3000.0, speed_s=500.0)
        bench.run(0.1)
        bench.sim.ask("hang")
        bench.run(2.0)
        with pytest.raises(BoardGone):  # it left the bus when it restarted
            board.sync()
    with bench.open() as board:
        assert board.identity.boot == wire.code("BOOTS", "WATCHDOG")
        status = board.status(0)
        assert status.fault == wire.code("FAULTS", "WATCHDOG")
        assert status.mode == wire.code("MODES", "OFF")
        before = bench.sim.ask("state")["q"][0]
        bench.run(0.2)
        assert bench.sim.ask("state")["q"][0] == before
        with pytest.raises(BoardRefused) as refused:
            board.ask("enable", axis=0, on=1)
        assert refused.value.reason == "FAULT"
        board.ask("clear_fault", axis=0)
        board.ask("enable", axis=0, on=1)


def test_a_restart_on_request_and_into_the_boot_loader(bench: Bench) -> None:
    for bootloader in (0, 1):
        with bench.open() as board:
            board.ask("enable", axis=0, on=1)
            board.ask("reboot", key=wire.wire.KEY, bootloader=bootloader)
            bench.run(0.5)
            with pytest.raises(BoardGone if bench.leaves_its_bus or not bootloader else TautError):
                board.sync()
        if bootloader:
            assert bench.sim.ask("state")["bootloader"]
            bench.sim.ask("reset")
        with bench.open() as board:
            assert board.status(0).mode == wire.code("MODES", "OFF")
            expected = "POWER" if bootloader else "REQUEST"
            assert board.identity.boot == wire.code("BOOTS", expected)
