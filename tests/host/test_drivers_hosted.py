"""What the application takes over from the drives behind it, and what it grants them: one, or several of a bus."""

from __future__ import annotations

from contextlib import closing
from dataclasses import replace
from typing import Any

import can
import pytest
from emulated_drives import RATE_HZ, Setup, driven, where
from motor_emulators import DynamixelEmulator, Motor

from tautline import _native
from tautline.device import wire
from tautline.device.board import Board
from tautline.device.link import BoardAddress
from tautline.drivers import addresses
from tautline.drivers.hosted import HostedLink
from tautline.errors import TautError
from tautline.live.session import driving, move_to

pytestmark = pytest.mark.usefixtures("patient_buses", "own_state")


@pytest.mark.parametrize(
    ("kind", "current_ma"),
    [
        ("dynamixel", 27),  # 10 of 2.69 mA: an XM430
        ("feetech", -130),  # -20 of 6.5 mA
        ("canopen", -250),  # -0.25 of 1 A
        ("moteus", 100),
    ],
)
def test_an_axis_has_its_drives_current(kind: str, current_ma: int) -> None:
    with driven(kind) as setup:
        setup.live.wait(0.05)
        assert setup.live.board.status(0).current_ma == current_ma


def test_a_canopen_drive_that_tells_no_current_or_speed_is_driven_by_its_position() -> None:
    with driven("canopen", lacks=(0x6078, 0x606C)) as setup, driving(setup.live):
        move_to(setup.live, 1.0, 2.0)
        assert setup.motor.position == pytest.approx(1000.0, abs=5.0)
        assert setup.live.board.status(0).current_ma == 0


def test_of_several_drives_the_one_with_the_least_current_limits_the_bus() -> None:
    with driven("canopen", beside=(Motor(),), currents=(1500, 800)) as setup:
        assert setup.live.board.identity.driver_ma == 800


def test_settings_that_were_stored_stay_in_place_of_the_drives_limits() -> None:
    with driven("dynamixel") as setup:
        settings = dict(setup.live.board.ask("get_settings", axis=0).values)
        settings.update(key=wire.wire.KEY, speed_s=500.0, q_low=-700.0)
        setup.live.board.ask("settings", **settings, timeout_s=5.0)
    with driven("dynamixel") as setup:
        limits = setup.live.board.ask("get_limits", axis=0)
        assert (limits.speed_s, limits.q_low) == (500.0, -700.0)


def test_a_drive_that_is_too_fast_to_be_counted_is_counted_in_eights() -> None:
    """65536 counts a turn at up to 180 rev/min: 196608 counts/s, of 30 000 that an axis plans."""
    with driven("canopen", turn=65536, at=4000.0) as setup, driving(setup.live):
        board, motor = setup.live.board, setup.motor
        limits, begun, at = board.ask("get_limits", axis=0), board.status(0).q, motor.position
        assert (limits.q_low, limits.q_high, limits.speed_s) == (-2500.0, 2500.0, 24576.0)
        assert "8192 counts a turn" in board.bus()["drives"][0]
        board.ask("move", axis=0, q=begun + 400.0, speed_s=1000.0)
        setup.live.wait(0.3)
        assert motor.course[-1] - motor.course[-101] == pytest.approx(800.0, rel=0.05)
        setup.live.wait(0.3)
        assert motor.position - at == pytest.approx(3200.0, abs=10.0)
        assert board.status(0).q - begun == pytest.approx(400.0, abs=1.0)


def test_the_lag_of_several_drives_is_the_longest() -> None:
    with driven("dynamixel", beside=(Motor(lag_s=0.004),)) as setup:
        board, live = setup.live.board, setup.live
        for axis in range(2):
            board.switch_on(axis, live.wait)
            board.ask("move", axis=axis, q=board.status(axis).q + 1000.0, speed_s=2000.0)
            live.wait(1.0)
        assert board.bus()["lag_s"] > setup.motor.lag_s


def test_the_lag_of_several_drives_is_that_of_now() -> None:
    with driven("dynamixel", beside=(Motor(lag_s=0.004),)) as setup:
        board, live = setup.live.board, setup.live
        for axis in range(2):
            board.switch_on(axis, live.wait)

        def there_and_back() -> float:
            for way in (1.0, -1.0):
                for axis in range(2):
                    board.ask("move", axis=axis, q=board.status(axis).q + way * 1000.0, speed_s=500.0)
                live.wait(3.0)
            return float(board.bus()["lag_s"])

        before = there_and_back()
        setup.motor.lag_s = 0.004  # as one whose gains were raised
        there_and_back()
        assert there_and_back() < before - 0.004


def test_a_drive_that_may_speed_up_faster_than_is_planned_is_driven_all_the_same() -> None:
    with closing(DynamixelEmulator([Motor(position=700.0)])) as emulator:
        address = addresses.parse(where("dynamixel", emulator, "rate=100"))
        drives = addresses.open_drives(address)
        (drive,) = drives.drives
        drives.drives = [replace(drive, limits=replace(drive.limits, acceleration=1e9))]
        with closing(HostedLink(drives, address.where, address.rate_hz, paced=False)) as link:
            assert link._ask_application("get_limits", axis=0).acceleration_s2 == _native.HOSTED_ACCELERATION_MAX


@pytest.mark.parametrize("at", [1e7, -1e9])
def test_a_drive_too_far_from_its_zero_to_be_counted_says_so(at: float) -> None:
    with pytest.raises(TautError, match=r"motor 1 is at -?1\d+ counts.*set its zero nearer"), driven("canopen", at=at):
        pass


def test_a_drive_that_goes_too_far_to_be_counted_says_so() -> None:
    with driven("canopen") as setup:
        setup.motor.position = 1e7
        with pytest.raises(TautError, match="set its zero nearer"):
            setup.link.cycle()


def test_a_serial_number_is_whole_whatever_a_joint_is_called() -> None:
    with closing(DynamixelEmulator([Motor()])) as emulator:
        drives = addresses.open_drives(addresses.parse(where("dynamixel", emulator, f"rate={RATE_HZ:g}")))
        link = HostedLink(drives, "ros:/a,/b:" + 40 * "\N{LATIN SMALL LETTER E WITH ACUTE}", RATE_HZ, paced=False)
        with Board(BoardAddress(link.where, None, False, (wire.wire.MAJOR, 0), lambda: link)) as board:
            assert str(board.identity.serial).isascii()


def test_a_first_answer_may_be_lost() -> None:
    with closing(DynamixelEmulator([Motor(position=700.0)])) as emulator:
        address = addresses.parse(where("dynamixel", emulator, "rate=100"))
        drives = addresses.open_drives(address)
        through, lost = emulator.bus.ills.through, [2]

        def losing(answer: Any) -> list[Any]:
            lost[0] -= 1
            return [] if lost[0] >= 0 else through(answer)

        emulator.bus.ills.through = losing  # type: ignore[method-assign]
        with closing(HostedLink(drives, address.where, address.rate_hz, paced=False)):
            assert lost[0] < 0


# -- patience ---------------------------------------------------------------------------------------------------------


def brake(setup: Setup, seconds: float) -> list[int]:
    """The drives' brakes take so long, in virtual time. Returns when they are released, us, once that has begun."""
    bench, released_us = setup.bench, list[int]()

    def holds() -> bool:
        released_us[:] = released_us or [bench.us + round(1e6 * seconds)]
        for _ in range(10 if bench.us < released_us[0] else 0):
            bench.us += 1000
            for motor in setup.emulator.motors:
                motor.step()
        return bench.us < released_us[0]

    setup.emulator.brakes = holds
    return released_us


def test_a_brake_is_given_its_time() -> None:
    """0.3 s, three times what a motor may be without a look at it, and what the drive waits for the host. The first
    answer after it may be lost."""
    with driven("canopen") as setup:
        released_us, lost = brake(setup, 0.3), list[can.Message]()
        through = setup.emulator.bus.ills.through

        def losing(answer: can.Message) -> list[can.Message]:
            if lost or answer.arbitration_id != 0x181 or not released_us or setup.bench.us < released_us[0]:
                return list(through(answer))
            lost.append(answer)
            return []

        setup.emulator.bus.ills.through = losing
        with driving(setup.live):
            move_to(setup.live, 1.0, 2.0)
            assert setup.motor.position == pytest.approx(1000.0, abs=5.0)
        timing = setup.link.timing
        assert lost and timing.jitter_s < 5e-3 and timing.round_trip_most_s < 5e-3


def test_a_brake_that_takes_longer_than_its_driver_grants_is_a_fault() -> None:
    with driven("canopen") as setup:
        brake(setup, setup.link.drives.enable_s + 0.2)
        with pytest.raises(TautError, match="control steps came late"):
            setup.live.board.switch_on(0, setup.live.wait)
        setup.live.wait(0.1)
        assert not setup.motor.on


def test_no_axis_is_driven_blindly_while_a_brake_of_another_is_released() -> None:
    with driven("canopen", beside=(Motor(),)) as setup:
        live, board = setup.live, setup.live.board
        board.switch_on(0, live.wait)
        board.ask("move", axis=0, q=4000.0, speed_s=2000.0)
        live.wait(0.3)
        brake(setup, 0.3)
        board.ask("enable", axis=1, on=1)
        live.wait(0.1)
        with pytest.raises(TautError, match="control steps came late"):
            board.check_fault(0)
        assert not setup.motor.on
