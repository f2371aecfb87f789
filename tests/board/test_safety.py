"""What a board notices by itself, whatever a host does: the same on every simulated board."""

from __future__ import annotations

import pytest

from conftest import Bench
from tautline.device import wire
from tautline.device.board import Board, BoardRefused

pytestmark = pytest.mark.falls_to("emulated")  # the real board's image; QEMU's other core runs them all


def fault_after(bench: Bench, board: Board, seconds: float) -> str:
    """The fault that axis 0 has by then; the host is heard from meanwhile."""
    for _ in range(round(seconds / 0.02)):
        status = board.status(0)
        if status.fault:
            assert status.mode == wire.code("MODES", "OFF")
            return next(name for name, (code, _) in wire.wire.FAULTS.items() if code == status.fault)
        bench.run(0.02)
    return "NONE"


def flag(board: Board, name: str) -> bool:
    return bool(board.status(0).flags & wire.code("FLAGS", name))


def mend(bench: Bench, board: Board) -> None:
    bench.sim.ask("inject 0 well")
    bench.run(0.1)
    board.ask("clear_fault", axis=0)


def test_a_blocked_motor_near_its_target(board: Board, bench: Bench) -> None:
    board.switch_on(0, bench.run)
    bench.sim.ask("inject 0 blocked")
    board.ask("move", axis=0, q=150.0)
    assert fault_after(bench, board, 1.0) in ("STALL", "CURRENT")
    mend(bench, board)
    board.switch_on(0, bench.run)  # checks again: its wires may have been pulled
    assert flag(board, "CHECKED") and not flag(board, "REFERENCED")  # it cannot tell it from a lost encoder


@pytest.mark.parametrize(("ill", "fault"), [("driver", "DRIVER"), ("supply", "SUPPLY")])
def test_driver_and_supply(board: Board, bench: Bench, ill: str, fault: str) -> None:
    assert board.status(0).supply_mv == pytest.approx(6000, abs=60)
    board.switch_on(0, bench.run)
    bench.sim.ask(f"inject 0 {ill}")
    assert fault_after(bench, board, 0.5) == fault
    mend(bench, board)
    board.switch_on(0, bench.run)


def test_the_stop_input(board: Board, bench: Bench) -> None:
    board.switch_on(0, bench.run)
    bench.sim.ask("inject 0 estop")
    assert fault_after(bench, board, 0.1) == "ESTOP" and flag(board, "ESTOP")
    assert all(board.status(axis).fault == wire.code("FAULTS", "ESTOP") for axis in range(board.axes))
    with pytest.raises(BoardRefused, match="release the stop button"):
        board.ask("clear_fault", axis=0)
    mend(bench, board)
    board.switch_on(0, bench.run)
    # A contact that opens: nothing is wired, as where its wire is broken.
    board.ask("enable", axis=0, on=0)
    bench.run(0.1)
    for axis in range(1, board.axes):
        board.ask("clear_fault", axis=axis)
    kept = dict(board.ask("get_settings", axis=0).values)
    opens = {"key": wire.wire.KEY, "estop": wire.code("ESTOPS", "OPEN")}
    board.ask("settings", **(kept | opens), timeout_s=5.0)
    assert fault_after(bench, board, 0.1) == "ESTOP"
    board.ask("settings", **(kept | {"key": wire.wire.KEY}), timeout_s=5.0)
    mend(bench, board)
    board.switch_on(0, bench.run)


def test_a_group_goes_off_together(board: Board, bench: Bench) -> None:
    if board.axes < 2:
        pytest.skip("a board of one axis has no group")
    for axis in (0, 1):
        kept = dict(board.ask("get_settings", axis=axis).values)
        board.ask("settings", **(kept | {"key": wire.wire.KEY, "group": 1}), timeout_s=5.0)
    for axis in (0, 1):
        board.switch_on(axis, bench.run)
    board.ask("safe_stop", axis=1)
    assert fault_after(bench, board, 0.1) == "GROUP" and board.status(0).fault_value == 1
    mend(bench, board)
    with pytest.raises(BoardRefused, match="another axis of its group"):
        board.ask("enable", axis=0, on=1)


@pytest.mark.parametrize(
    ("ill", "fault"), [("well", "NONE"), ("reversed", "REVERSED"), ("unplugged", "UNMOVED"), ("coarse", "SCALE")]
)
def test_the_check_of_motor_and_encoder(board: Board, bench: Bench, ill: str, fault: str) -> None:
    bench.sim.ask(f"inject 0 {ill}")
    board.ask("check", axis=0)
    assert fault_after(bench, board, 1.5) == fault
    assert flag(board, "CHECKED") == flag(board, "REFERENCED") == (fault == "NONE")


def test_gains_that_swing_the_drive(board: Board, bench: Bench) -> None:
    gains = dict(board.ask("get_servo", axis=0).values)
    board.ask("servo", **(gains | {"proportional": 32767, "derivative": 32767}))
    board.switch_on(0, bench.run)
    board.ask("move", axis=0, q=100.0)
    assert fault_after(bench, board, 2.0) == "OSCILLATION"


def test_a_current_is_seen_after_flash_was_written(board: Board, bench: Bench) -> None:
    """Where the bridge drives in a quarter of its period, a sample at another time shows none."""

    def pushed_ma() -> float:
        board.switch_on(0, bench.run)
        bench.sim.ask("inject 0 blocked")
        board.ask("jog", axis=0, way=100.0)
        bench.run(0.1)
        current = board.status(0).current_ma
        bench.sim.ask("inject 0 well")
        board.ask("safe_stop", axis=0)
        bench.run(0.1)
        board.ask("clear_fault", axis=0)
        return current

    before = pushed_ma()
    settings = dict(board.ask("get_settings", axis=0).values)
    board.ask("settings", **(settings | {"key": wire.wire.KEY}), timeout_s=5.0)
    assert before > 50.0
    assert pushed_ma() == pytest.approx(before, rel=0.1)


def test_homing_finds_an_end_and_references(board: Board, bench: Bench) -> None:
    board.switch_on(0, bench.run)
    board.ask("home", axis=0, direction=-1, reach=5000.0, end=-800.0, retreat=100.0)
    bench.run(0.4)
    before = bench.sim.ask("state")["q"][0] / 256.0
    assert before < -50.0
    bench.sim.ask("inject 0 blocked")
    for _ in range(100):
        bench.run(0.02)
        if flag(board, "REFERENCED"):
            break
    bench.sim.ask("inject 0 well")
    bench.until(board, 0, "HOLD")
    end = bench.sim.ask("state")["q"][0] / 256.0 - 100.0
    assert board.status(0).q == pytest.approx(-700.0, abs=4.0) and end < before + 5.0
    board.ask("move", axis=0, q=-500.0)
    bench.until(board, 0, "HOLD")


def test_a_move_ends_with_its_host(board: Board, bench: Bench) -> None:
    board.switch_on(0, bench.run)
    board.ask("move", axis=0, q=100_000.0, speed_s=4000.0, silence_us=200_000)
    bench.run(1.0)  # without a word
    assert board.status(0).q < 2000.0
    assert fault_after(bench, board, 0.1) == "HOST_LOST" and flag(board, "REFERENCED")


def test_settings_stay_and_no_host_widens_them(board: Board, bench: Bench) -> None:
    before = dict(board.ask("get_settings", axis=0).values)
    own = dict(before)
    own.update(key=wire.wire.KEY, q_low=-900.0, q_high=900.0, instrument="SN-7", stall_ms=200)
    with pytest.raises(BoardRefused) as refused:
        board.ask("settings", **(own | {"key": 0}), timeout_s=5.0)
    assert refused.value.reason == "KEY"
    board.ask("settings", **own, timeout_s=5.0)
    board.close()
    bench.sim.ask("reset")
    bench.run(0.1)
    with bench.open() as again:
        kept = again.ask("get_settings", axis=0)
        assert (kept.q_high, kept.instrument, kept.stall_ms) == (900.0, "SN-7", 200)
        assert again.status(0).settings == wire.code("STORES", "NEWEST")
        limits = dict(again.ask("get_limits", axis=0).values)
        with pytest.raises(BoardRefused) as refused:
            again.ask("limits", **(limits | {"q_high": 901.0}))
        assert refused.value.reason == "BEYOND_SETTINGS"
        # After power-on nobody knows where it is.
        again.switch_on(0, bench.run)
        with pytest.raises(BoardRefused) as refused:
            again.ask("move", axis=0, q=10.0)
        assert refused.value.reason == "NOT_REFERENCED"
        again.ask("jog", axis=0, way=40.0)
        bench.until(again, 0, "HOLD")
        again.ask("enable", axis=0, on=0)
        bench.until(again, 0, "OFF")
        again.ask("settings", **(before | {"key": wire.wire.KEY}), timeout_s=5.0)
