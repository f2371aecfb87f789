"""Motors of other makers, each by an emulator that speaks its bus' real bytes, with the simulated instrument behind it.

In virtual time, as simulated boards are: what a driver leaves is compared with what the board leaves on the same
instrument, with the same counts, log rate and limits of the motor.
"""

from __future__ import annotations

import json
import struct
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any
from uuid import uuid4

import can
import numpy as np
import pytest
from cli_runner import Taut
from emulated_drives import EMULATORS, NO_ROS, RATE_HZ, driven, every_kind, model_of, settled, where
from motor_emulators import Cia402Emulator, DynamixelEmulator, FeetechEmulator, Motor
from ros_robot import Joint, RosRobot

from tautline.device.board import find
from tautline.device.link import BoardGone
from tautline.drivers import addresses, ros_joints
from tautline.drivers.drives import Goal, Measured, Missed, all_off
from tautline.drivers.feetech import Feetech
from tautline.drivers.hosted import HostedLink, flash_file
from tautline.errors import TautError
from tautline.live.following import follow_run
from tautline.live.session import MotionOptions, calibrate_live, driving, move_to
from tautline.live.setup import open_live
from tautline.model import Model
from tautline.simulated.instrument import Instrument, preset

pytestmark = pytest.mark.usefixtures("patient_buses", "own_state")

SHORT = MotionOptions(cycles=3, speeds=(1.4,))


def error_um(model: Model, instrument: Instrument) -> float:
    inside = (model.q > model.measured[0]) & (model.q < model.measured[1])
    return float(1e3 * np.sqrt(np.mean((model.width - instrument.backlash(model.q))[inside] ** 2)))


def a_trajectory(folder: Path) -> str:
    """Turns at six places in 8 s, at up to 24 deg/s."""
    t_s = np.linspace(0.0, 8.0, 401)
    c_deg = 25.0 * np.sin(2 * np.pi * t_s / 10.0) + 4.0 * np.sin(2 * np.pi * t_s / 3.0)
    np.savetxt(folder / "tip.csv", np.column_stack([t_s, c_deg]), delimiter=",", header="t_s,c_deg", comments="")
    return str(folder / "tip.csv")


@pytest.fixture(scope="module")
def the_boards_error(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Of B, um, by the same motion with the same counts and the drivers' log rate."""
    with open_live(simulate="reference", pictures=False) as live:
        live.board._link.log_divider = round(1000 / RATE_HZ)
        assert live.plant is not None
        found, _ = calibrate_live(live, tmp_path_factory.mktemp("board") / "rec", SHORT)
        return error_um(found.model, live.plant.instrument)


def the_boards_tip(speed_most: float, acceleration_most: float, trajectory: str) -> float:
    """deg rms of the tip, with true tables and a motor no faster than that."""
    with open_live(simulate="reference", pictures=False) as live:
        assert live.plant is not None
        limits = dict(live.board.ask("get_limits", axis=0).values)
        limits.update(
            speed_s=min(speed_most, limits["speed_s"]),
            acceleration_s2=min(acceleration_most, limits["acceleration_s2"]),
        )
        live.board.ask("limits", **limits)
        return follow_run(live, trajectory, model=model_of(live.plant.instrument)).rms_deg


def behind_s(kind: str, motor: Motor) -> float:
    """By how much a drive in first order is behind its set-points where it is asked, while they go on evenly."""
    if kind == "moteus":  # told the speed too
        return motor.lag_s
    if kind == "canopen":  # takes a set-point at the next SYNC, and goes to it in a straight line until the one after
        return 2.0 / RATE_HZ + motor.lag_s
    return float(1.0 / RATE_HZ / -np.expm1(-1.0 / RATE_HZ / motor.lag_s))


@every_kind
def test_the_main_job_is_done_as_well_as_on_a_board(kind: str, the_boards_error: float, tmp_path: Path) -> None:
    trajectory = a_trajectory(tmp_path)
    with driven(kind) as setup:
        found, motion = calibrate_live(setup.live, tmp_path / "rec", SHORT)
        off = follow_run(setup.live, trajectory, compensation="off", model=found.model)
        full = follow_run(setup.live, trajectory, model=model_of(preset("reference")))
        limits = setup.link.drives.drives[0].limits
        steps = np.abs(np.diff(setup.motor.goals))
        timing, lag_s = setup.link.timing, full.bus["lag_s"]
    error = error_um(found.model, preset("reference"))
    board_deg = the_boards_tip(limits.speed, limits.acceleration, trajectory)
    print(
        f"{kind:>9}: B {error:.2f} um, the board's {the_boards_error:.2f} ({error / the_boards_error:.2f} times); tip "
        f"{off.rms_deg:.2f} to {full.rms_deg:.3f} deg, the board's {board_deg:.3f}; {1e3 * lag_s:.1f} ms behind, "
        f"steps of {steps.max():.0f} counts at most, {timing.missed} of {timing.cycles} cycles missed"
    )
    assert motion.reversals >= 12 and found.model.quality.usable
    assert error <= 1.5 * the_boards_error
    assert full.rms_deg <= 1.5 * board_deg and full.rms_deg < 0.2 * off.rms_deg
    assert lag_s == pytest.approx(behind_s(kind, setup.motor), abs=1.5e-3)
    assert full.counters["set_points_dropped"] == 0 and full.counters["telemetry_dropped"] == 0
    # Two cycles' worth: one after a missed one.
    assert steps.max() <= 2.0 * limits.speed / RATE_HZ + 1.0


@every_kind
def test_a_bus_that_drops_delays_reorders_and_spoils_is_survived(kind: str) -> None:
    with driven(kind) as setup, driving(setup.live):
        ills = setup.emulator.bus.ills
        ills.drop, ills.delay, ills.damage = 0.03, 0.03, 0.03
        setup.motor.goals.clear()
        for q in (1.0, -1.0, 0.5):
            move_to(setup.live, q, 2.0)
            assert setup.motor.position == pytest.approx(1e3 * q, abs=5.0)
        ills.drop = ills.delay = ills.damage = 0.0
        steps = np.abs(np.diff(setup.motor.goals))
        assert setup.link.timing.missed >= 5
        assert steps.max() <= 2000.0 / RATE_HZ * 6 + 1.0  # of a path at 2 mm/s, five answers lost in a row


@every_kind
def test_set_points_that_are_lost_on_their_way_out_are_made_up_for(kind: str) -> None:
    with driven(kind) as setup, driving(setup.live):
        ills = setup.emulator.bus.ills
        ills.lose = 0.05
        setup.motor.goals.clear()
        for q in (1.0, -1.0, 0.5):
            move_to(setup.live, q, 2.0)
            assert setup.motor.position == pytest.approx(1e3 * q, abs=5.0)
        ills.lose = 0.0
        assert sum(ills.lost) >= 5
        # Of a path at 2 mm/s; an answer may have been missed as well.
        assert np.abs(np.diff(setup.motor.goals)).max() <= 2000.0 / RATE_HZ * (2 + max(ills.lost)) + 1.0


@every_kind
def test_the_last_set_point_of_a_motion_may_be_lost(kind: str) -> None:
    """It is told again while the axis holds."""
    with driven(kind) as setup, driving(setup.live):
        begun = setup.live.board.status(0).q
        setup.live.board.ask("move", axis=0, q=begun + 1000.0, speed_s=2000.0)
        setup.live.wait(0.44)
        told = len(setup.motor.goals)
        setup.emulator.bus.ills.lose = 1.0
        setup.live.wait(0.09)
        assert len(setup.motor.goals) <= told + 1
        setup.emulator.bus.ills.lose = 0.0
        setup.live.wait(0.4)
        assert setup.motor.position == pytest.approx(begun + 1000.0, abs=5.0)


def test_a_position_is_told_of_the_time_at_which_it_was_measured() -> None:
    """Not of when its answer came, 4 ms later: at 2 counts a millisecond."""
    off: list[float] = []
    with driven("feetech") as setup, driving(setup.live):
        measure, bench = setup.link.drives.measure, setup.bench

        def measured() -> list[Measured]:
            now = measure()
            bench.us += 4000
            move(setup.emulator, 4)
            return now

        def told(batch: Any) -> None:
            for i in range(batch.count):
                at = round(1e-3 * (batch.t_us + i * batch.period_us)) - 1
                if 0 <= at < len(setup.motor.course):
                    off.append(batch.q[i] - setup.motor.course[at])

        setup.link.drives.measure = measured
        setup.live.board.ask("telemetry", axis=0, divider=10)
        with setup.live.board.listening(batch=told):
            setup.live.board.ask("move", axis=0, q=3000.0, speed_s=2000.0)
            setup.live.wait(0.3)
            off.clear()
            setup.live.wait(0.8)
    assert len(off) > 50 and abs(float(np.median(off))) < 4.0, np.median(off)


@every_kind
def test_a_set_point_that_the_bus_does_not_take_counts_as_missed(kind: str) -> None:
    with driven(kind) as setup, driving(setup.live):
        setup.live.wait(0.1)
        set_positions, refused = setup.link.drives.set_positions, [3]

        def full(goals: Any) -> None:
            if refused[0]:
                refused[0] -= 1
                raise Missed("the bus takes nothing")
            set_positions(goals)

        setup.link.drives.set_positions = full
        missed = setup.link.timing.missed
        setup.live.wait(0.1)
        assert setup.link.timing.missed >= missed + 3


@every_kind
def test_where_no_set_point_arrives_any_more_the_axis_faults(kind: str) -> None:
    with driven(kind) as setup, pytest.raises(TautError, match="did not follow"), driving(setup.live):
        setup.live.board.ask("move", axis=0, q=4000.0, speed_s=2000.0)
        setup.live.wait(0.3)
        setup.emulator.bus.ills.lose = 1.0
        told = setup.motor.goals[-1]
        setup.live.wait(1.5)
        setup.live.rest()
    assert setup.motor.position == pytest.approx(told, abs=2000.0 * setup.link.drives.rest_s + 1.0)


@every_kind
def test_jitter_and_round_trip_are_stated_as_they_are(kind: str) -> None:
    """Cycles 0 to 5 ms late, whole ms; answers after 2 ms, one after 6."""
    rng = np.random.default_rng(6)
    with driven(kind) as setup:
        measure, bench, slow = setup.link.drives.measure, setup.bench, [6]

        def measured() -> list[Measured]:
            for _ in range(slow.pop() if slow else 2):
                bench.us += 1000
                setup.motor.step()
            return measure()

        setup.link.drives.measure = measured
        bench.late_us = lambda: 1e3 * float(rng.integers(6))
        with driving(setup.live):
            for q in (1.0, -1.0):
                move_to(setup.live, q, 2.0)
                assert setup.motor.position == pytest.approx(1e3 * q, abs=5.0)
        timing = setup.link.timing
    # Each end of a period is off by what has a variance of 35 / 12 ms2.
    assert timing.jitter_s == pytest.approx(1e-3 * np.sqrt(2.0 * 35.0 / 12.0), rel=0.15)
    assert timing.round_trip_s == pytest.approx(2e-3, abs=1e-4)
    assert timing.round_trip_most_s == pytest.approx(6e-3, abs=1e-4)


@every_kind
def test_a_pulled_cable_leaves_the_motor_at_rest_within_the_stated_time(kind: str) -> None:
    with driven(kind) as setup:
        live, motor = setup.live, setup.motor
        with pytest.raises(BoardGone, match=r"come to rest by themselves"), driving(live):
            live.board.ask("move", axis=0, q=4000.0, speed_s=2000.0)
            live.wait(0.5)
            assert motor.course[-1] - motor.course[-101] == pytest.approx(200.0, rel=0.1)
            setup.emulator.bus.ills.pulled = True
            pulled = len(motor.course)
            live.wait(1.0)
        for _ in range(1000):
            motor.step()
        away = np.flatnonzero(np.abs(np.array(motor.course[pulled:]) - motor.position) > 1.0)
        rests_s, braking_s = 1e-3 * (away[-1] + 1), 8.0 * motor.lag_s
        print(f"{kind:>9}: at rest {rests_s:.3f} s after the cable was pulled")
        assert 0.0 < rests_s <= setup.link.drives.rest_s + 1.0 / RATE_HZ + braking_s
        # By the watchdog of those that have one: most come to rest without, where they were told last.
        assert motor.tripped == (setup.link.drives.rest_s > 0.0) and setup.link.drives.rest_s <= 0.1
        assert 1e-3 * (motor.tripped_ms - pulled) <= setup.link.drives.rest_s + 1e-3


@contextmanager
def opened(kind: str, motors: list[Motor], late_s: float = 0.0, **emulated: Any) -> Iterator[tuple[Any, Any]]:
    """An emulator and the drives of all its motors, by a clock of the motors' milliseconds and of `late_s` that each
    answer takes."""
    make, _ = EMULATORS[kind]
    emulator, late = make(motors, **emulated), [0.0]
    through = emulator.bus.ills.through

    def taking(answer: Any) -> list[Any]:
        late[0] += late_s
        return list(through(answer))

    emulator.bus.ills.through = taking
    address = addresses.parse(where(kind, emulator, "rate=100"))
    drives = None
    try:
        drives = addresses.open_drives(address, clock=lambda: 1e-3 * len(motors[0].course) + late[0])
        settled(kind, emulator, drives)
        yield emulator, drives
    finally:
        if drives is not None:
            drives.close()
        emulator.close()


def motors_of(kind: str, *places: float) -> list[Motor]:
    return [replace(EMULATORS[kind][1], goals=[], course=[], position=place) for place in places]


def cycles(emulator: Any, drives: Any, goals: list[Goal | None], count: int) -> None:
    """So many, 10 ms each: measured, told, moved."""
    for _ in range(count):
        patiently(drives.measure)
        if any(goal is not None for goal in goals):
            drives.set_positions(goals)
        emulator.bus.settle()
        move(emulator, 10)


def patiently(ask: Callable[..., Any], *what: Any) -> Any:
    """What a link's next cycle is for: this machine may have been held up."""
    for _ in range(4):
        with suppress(Missed):
            return ask(*what)
    return ask(*what)


def move(emulator: Any, steps: int) -> None:
    for motor in emulator.motors:
        for _ in range(steps):
            motor.step()


@every_kind
def test_what_its_watchdog_stopped_is_driven_again(kind: str) -> None:
    """By whom did not switch it off: that program has ended."""
    [motor] = motors_of(kind, 0.0)
    with opened(kind, [motor]) as (emulator, drives):
        for goal in (20.0, -30.0):
            patiently(drives.enable, 0, True)
            cycles(emulator, drives, [Goal(goal, 0.0)], 30)
            assert motor.position == pytest.approx(goal, abs=1.5) and not motor.tripped
            if kind != "ros":  # it says where it is, and is asked nothing
                move(emulator, 300)
            assert motor.tripped == (drives.rest_s > 0.0)


@pytest.mark.parametrize("kind", [kind for kind in EMULATORS if kind != "ros"])
def test_a_bus_that_drops_answers_is_opened_and_switched_on(kind: str) -> None:
    """Each fifth, from the first on. A topic has no answers, and a moteus is told again in the next cycle."""
    emulator = EMULATORS[kind][0](motors_of(kind, 0.0))
    count = [-1]

    def through(answer: Any) -> list[Any]:
        count[0] += 1
        return [answer] if count[0] % 5 else []

    emulator.bus.ills.through = through
    try:
        drives = addresses.open_drives(addresses.parse(where(kind, emulator, "rate=100")))
        for _ in range(3 if kind != "moteus" else 0):
            drives.enable(0, True)
            drives.enable(0, False)
        drives.close()
        assert len(drives.drives) == 1
    finally:
        emulator.close()


@every_kind
def test_a_drive_that_is_switched_on_stays_where_it_is(kind: str) -> None:
    """Also where its first set-points are lost."""
    [motor] = motors_of(kind, 700.0)
    with opened(kind, [motor]) as (emulator, drives):
        cycles(emulator, drives, [None], 1)
        patiently(drives.enable, 0, True)
        cycles(emulator, drives, [None], 5)
        assert np.abs(np.array(motor.course) - 700.0).max() <= 1.5


@every_kind
def test_each_of_two_motors_has_its_own(kind: str) -> None:
    """The answers of a CAN bus may come in any order."""
    motors = motors_of(kind, 100.0, -300.0)
    for motor in motors:
        motor.rest()
    with opened(kind, motors) as (emulator, drives):
        cycles(emulator, drives, [None, None], 1)
        if kind in ("canopen", "moteus"):
            held: list[Any] = []
            through = emulator.bus.ills.through

            def turned(answer: Any) -> list[Any]:
                """The first motor's answer after the second's."""
                number = answer.arbitration_id - 0x180 if kind == "canopen" else answer.arbitration_id >> 8
                if number == 1:
                    held.append(answer)
                    return []
                late, held[:] = list(held) if number == 2 else [], [] if number == 2 else held
                return [*through(answer), *late]

            emulator.bus.ills.through = turned
        assert [m.q for m in drives.measure()] == pytest.approx([100.0, -300.0], abs=1e-6)
        emulator.bus.ills.through = lambda answer: [answer]
        move(emulator, 10)
        for axis in range(2):
            patiently(drives.enable, axis, True)
        cycles(emulator, drives, [Goal(140.0, 0.0), Goal(-350.0, 0.0)], 30)
        assert [m.position for m in motors] == pytest.approx([140.0, -350.0], abs=1.5)
        patiently(drives.enable, 0, False)
        cycles(emulator, drives, [None, Goal(-320.0, 0.0)], 30)
        assert [m.position for m in motors] == pytest.approx([140.0, -320.0], abs=1.5)
        patiently(drives.enable, 1, False)
        assert kind == "ros" or not any(m.on for m in motors)


@pytest.mark.parametrize("kind", [kind for kind in EMULATORS if kind != "ros"])
@pytest.mark.parametrize("silent", [1, 2])
def test_where_one_of_two_does_not_answer_its_last_place_is_not_taken_again(kind: str, silent: int) -> None:
    motors = motors_of(kind, 100.0, -300.0)
    with opened(kind, motors) as (emulator, drives):
        patiently(drives.measure)
        move(emulator, 10)
        for motor in motors:
            motor.position += 50.0
        through, count = emulator.bus.ills.through, [0]

        def dumb(answer: Any) -> list[Any]:
            """Without what one of them says: answers come in turn, a CANopen drive's two at a time."""
            count[0] += 1
            number = (count[0] + 1) // 2 if kind == "canopen" else count[0]
            return [] if number == silent else list(through(answer))

        emulator.bus.ills.through = dumb
        with pytest.raises(Missed):
            drives.measure()
        emulator.bus.settle()
        emulator.bus.ills.through = through
        assert [m.q for m in patiently(drives.measure)] == [150.0, -250.0]


@pytest.mark.parametrize("kind", [kind for kind in EMULATORS if kind != "ros"])
def test_a_position_has_the_time_at_which_the_drive_was_there(kind: str) -> None:
    """An answer takes 8 ms. Servos and controllers sample somewhere on the way, CANopen drives at the SYNC."""
    with opened(kind, motors_of(kind, 100.0), late_s=8e-3) as (emulator, drives):
        emulator.bus.settle()
        asked = drives._clock()
        measured = drives.measure()[0]
        assert measured.t_s - asked == pytest.approx(0.0 if kind == "canopen" else 4e-3, abs=1e-6)
        assert drives._clock() - asked > 7e-3


@NO_ROS
@pytest.mark.parametrize(("stamped_s", "taken_s"), [(0.06, 0.06), (-0.06, 0.0), (9.0, 0.0), (None, 0.0)])
def test_a_joint_state_is_as_old_as_its_stamp_says(
    stamped_s: float | None, taken_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Unless it is of another machine's clock, ahead of this one or far behind it."""
    monkeypatch.setattr(ros_joints, "_OLDEST_S", 5.0)
    robot = RosRobot([Motor(position=100.0)], f"/n{uuid4().hex[:12]}")  # that speaks when it is asked to
    speaking = threading.Event()

    def says() -> None:
        while not speaking.wait(0.01):
            robot.say()

    voice = threading.Thread(target=says)
    voice.start()
    drives = None
    try:
        drives = addresses.open_drives(addresses.parse(f"ros:{robot.bus.path}:joint_1"))
        robot.stamped_s = stamped_s
        ages = []
        for _ in range(22):
            t_s = drives.measure()[0].t_s
            ages.append(time.monotonic() - t_s)
        # What it took on its way comes on top, and this machine may have been held up. The first are older.
        assert taken_s - 2e-3 <= min(ages[2:]) <= taken_s + 0.03
    finally:
        speaking.set()
        voice.join()
        if drives is not None:
            drives.close()
        robot.close()


@pytest.mark.parametrize(
    ("kind", "emulated", "expected"),
    [
        # 1023 of 0.229 rev/min; 20 times a second
        ("dynamixel", {}, (-1048575.0, 1048575.0, 15993.0, 319850.0, 3209.0)),
        (
            "dynamixel",
            {"told": {11: b"\x03", 48: struct.pack("<II", 3500, 600)}},
            (600, 3500, 15993.0, 319850.0, 3209.0),
        ),
        ("feetech", {}, (-30719.0, 30719.0, 3000.0, 60000.0, 0.0)),
        ("feetech", {"told": {9: struct.pack("<HH", 600, 3500)}}, (600.0, 3500.0, 3000.0, 60000.0, 0.0)),
        ("canopen", {}, (-20000.0, 20000.0, 12288.0, 300000.0, 1500.0)),  # 180 rev/min; 1.5 of the rated current
        ("moteus", {}, (-3.9e6, 3.9e6, 16384.0, 327680.0, 0.0)),
    ],
)
def test_an_axis_has_the_limits_that_its_drive_is_configured_for(
    kind: str, emulated: dict[str, Any], expected: tuple[float, ...]
) -> None:
    with driven(kind, **emulated) as setup:
        of = setup.link.drives.drives[0].limits
        axis = setup.live.board.ask("get_limits", axis=0)
    assert (of.q_low, of.q_high, of.speed, of.acceleration, of.current_ma) == pytest.approx(expected, rel=1e-4)
    assert (axis.q_low, axis.q_high, axis.speed_s, axis.acceleration_s2) == pytest.approx(expected[:4], rel=1e-4)


@pytest.mark.parametrize(
    ("kind", "emulated", "rate", "says"),
    [
        ("dynamixel", {"told": {11: b"\x01"}}, 100, r"mode 1: set 3 \(position\)"),
        ("dynamixel", {"told": {44: bytes(4)}}, 100, "motor 1 has a speed limit of 0"),
        ("dynamixel", {"told": {11: b"\x03", 48: struct.pack("<II", 600, 3500)}}, 100, "limits of its drive cannot be"),
        ("feetech", {"told": {33: b"\x01"}}, 100, r"mode 1: set 0 \(position\)"),
        ("canopen", {}, 300, r"whole 0\.1 ms"),
    ],
)
def test_a_drive_that_cannot_be_driven_says_why(kind: str, emulated: dict[str, Any], rate: int, says: str) -> None:
    with closing(EMULATORS[kind][0]([Motor()], **emulated)) as emulator, pytest.raises(TautError, match=says):
        find(where(kind, emulator, f"rate={rate}"))[0].open()


@pytest.mark.parametrize(
    ("kind", "emulated", "referenced"),
    [
        ("moteus", {"home_state": 0}, False),
        ("moteus", {"home_state": 1}, False),  # its rotor alone
        ("moteus", {"home_state": 2}, True),
        ("canopen", {"homed": True}, True),
        ("canopen", {"homed": False}, False),  # though the bit of the mode before says that the command is followed
        ("canopen", {"homed": True, "modes": (8,)}, False),
    ],
)
def test_a_drive_is_referenced_where_it_says_so(kind: str, emulated: dict[str, Any], referenced: bool) -> None:
    with opened(kind, motors_of(kind, 0.0), **emulated) as (_, drives):
        assert drives.drives[0].referenced is referenced


def test_a_register_that_a_servo_refuses_is_one_line() -> None:
    """Its bus watchdog trips between two of them: what it was told is not taken."""
    [motor] = motors_of("dynamixel", 0.0)
    with opened("dynamixel", [motor]) as (emulator, drives):
        obey = emulator._write

        def tripping(index: int, address: int, data: bytes) -> int:
            motor.tripped = motor.tripped or address == 64
            return int(obey(index, address, data))

        emulator._write = tripping
        with pytest.raises(TautError, match="register 116 refused 0"):
            drives.enable(0, True)


def test_a_register_that_a_servo_does_not_tell_has_no_number() -> None:
    with opened("dynamixel", motors_of("dynamixel", 0.0)) as (emulator, drives):
        status = emulator._status
        emulator._status = lambda number, data: status(number, b"", 7)
        with pytest.raises(TautError, match=r"dynamixel 1: register 44 cannot be read: .*not available"):
            drives.read(1, (44, 4))
        assert drives.glance(1, (70, 2)) is None  # of two bytes, as its checksum


@pytest.mark.parametrize("kind", ["dynamixel", "feetech"])
def test_a_damaged_answer_is_asked_for_again(kind: str) -> None:
    with opened(kind, motors_of(kind, 0.0)) as (_, drives):
        read, damaged = drives._packets.readTxRx, iter([True])

        def once_damaged(*asked: Any) -> Any:
            if next(damaged, False):
                raise IndexError("as the SDK does on a packet that is too short")
            return read(*asked)

        drives._packets.readTxRx = once_damaged
        assert drives.glance(1, (6, 1)) is None
        assert drives.glance(1, (6, 1)) is not None
        damaged = iter([True])
        assert drives.read(1, (6, 1)) == drives.glance(1, (6, 1))


def test_a_port_that_another_program_holds_is_left_alone() -> None:
    def open_files() -> int:
        return len(list(Path("/dev/fd").iterdir()))

    with opened("dynamixel", motors_of("dynamixel", 0.0)) as (emulator, _):
        address, before = addresses.parse(where("dynamixel", emulator, "rate=100")), open_files()
        with pytest.raises(TautError) as refused:
            addresses.open_drives(address)
        assert "who uses it" in str(refused.value) and open_files() == before  # though the error is kept


@every_kind
def test_a_drive_with_a_fault_stops_its_axis(kind: str) -> None:
    with driven(kind) as setup, pytest.raises(TautError, match="the motor driver reports"), driving(setup.live):
        setup.emulator.fail()
        setup.live.wait(0.4)
        assert setup.live.board.bus()["fault"]
        setup.live.rest()


def test_a_moteus_goes_on_at_the_speed_that_it_was_told() -> None:
    [motor] = motors_of("moteus", 0.0)
    with opened("moteus", [motor]) as (emulator, drives):
        drives.enable(0, True)
        drives.set_positions([Goal(0.0, -400.0)])
        emulator.bus.settle()
        move(emulator, 50)
        assert motor.position == pytest.approx(-400.0 * (0.05 - motor.lag_s), abs=1.0)


@pytest.mark.parametrize("lost", [0x000, 0x002, 0x004, 0x00C])  # mode, velocity, current, home state
def test_an_answer_of_a_moteus_without_a_register_is_none(lost: int) -> None:
    with opened("moteus", motors_of("moteus", 0.0)) as (_, drives):
        cycle = drives._transport.cycle

        async def shortened(commands: list[Any]) -> list[Any]:
            answers = list(await cycle(commands))
            for answer in answers:
                answer.values.pop(lost, None)
            return answers

        drives._transport.cycle = shortened
        with pytest.raises(Missed, match="missing, or damaged"):
            drives.measure()


def test_a_moteus_that_does_not_see_its_encoder_gives_no_position() -> None:
    with opened("moteus", motors_of("moteus", 700.0)) as (emulator, drives):
        emulator.sees = False
        with pytest.raises(Missed, match="does not know its position"):
            drives.measure()
        emulator.sees = True
        assert patiently(drives.measure)[0].q == 700.0


def test_a_host_that_stalls_finds_its_motor_stopped(tmp_path: Path) -> None:
    """Its set-points would jump: the board's own rule for control steps that come late holds."""
    with driven("dynamixel") as setup, pytest.raises(TautError, match="control steps came late"), driving(setup.live):
        setup.live.board.ask("move", axis=0, q=4000.0, speed_s=2000.0)
        setup.live.wait(0.5)
        sent, at = len(setup.motor.goals), setup.motor.position
        for _ in range(150):
            setup.bench.us += 1000
            setup.motor.step()
        setup.live.wait(0.1)
        assert len(setup.motor.goals) <= sent + 1 and not setup.motor.on
        assert setup.motor.position - at < 200.0
        setup.live.rest()


def test_a_drive_that_was_not_homed_is_not_driven_by_position() -> None:
    with driven("canopen", homed=False) as setup, pytest.raises(TautError, match=r"maker's tools.*--at"):
        follow_run(setup.live, "trapezoids", compensation="off")


def test_tables_stay_with_the_motors(tmp_path: Path, own_state: Path) -> None:
    with driven("dynamixel") as setup:
        follow_run(setup.live, a_trajectory(tmp_path), model=model_of(preset("reference")))
        blob = setup.live.board.read_table(0)
    assert blob and len(list(own_state.rglob("*.bin"))) == 1
    with driven("dynamixel") as setup:
        assert setup.live.board.read_table(0) == blob


def test_motors_at_other_places_than_zero_keep_their_counts() -> None:
    with driven("feetech", at=1234.0) as setup, driving(setup.live):
        assert setup.live.board.status(0).q == pytest.approx(1234.0, abs=150.0)  # its check moves a little
        setup.live.wait(0.1)
        assert min(setup.motor.goals) > 1000.0


def test_by_the_wall_clock_from_the_command_line(tmp_path: Path, taut: Taut) -> None:
    motor = Motor()
    emulator = DynamixelEmulator([motor, Motor(position=70.0)])
    where = f"dynamixel:{emulator.bus.path}:1,2?rate=50&baud=1000000"
    rig = replace(preset("reference").rig, actuator=replace(preset("reference").rig.actuator, board=where))
    rig.save(tmp_path / "rig.toml")
    replace(model_of(preset("reference")), rig=rig).save(tmp_path / "model")
    try:
        listed = json.loads(taut("boards", "--board", where, "--json").out)
        assert [axis["mode"] for axis in listed["boards"][0]["axes"]] == ["motor off", "motor off"]
        assert listed["boards"][0]["bus"]["rate_hz"] == 50.0 and len(listed["boards"][0]["bus"]["drives"]) == 2
        assert {driver["kind"] for driver in listed["drivers"]} == set(EMULATORS)
        assert taut("flash", tmp_path / "model", "--json").code == 0
        done = taut("record", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "rec", "--duration", "0.5", "--json")
        recorded = json.loads(done.out)
        assert recorded["motor_samples"] > 5 and recorded["bus"]["cycles"] > 5
    finally:
        emulator.close()


@pytest.mark.parametrize(
    ("where", "says"),
    [
        ("dynamixel:", "names no bus"),
        ("dynamixel:/dev/ttyUSB0:1,1", "different ones"),
        ("feetech:/dev/ttyUSB0:1,2,3,4,5", "1 to 4"),
        ("canopen:socketcan/can0:1?rate=5", "20 to 1000"),
        ("moteus:socketcan/can0:1?speed=5", "rate=HZ and baud=BAUD"),
        ("ros:/joint_states,/commands:elbow?baud=5", "takes rate=HZ,"),
        ("ros:/joint_states,/commands:a,b,c,d,e", "1 to 4"),
        ("dynamixel:/dev/ttyUSB0:1,254", "names motor 254, and 0 to 252 may be"),
        ("canopen:socketcan/can0:0", "names motor 0, and 1 to 126 may be"),
        ("canopen:socketcan/can0:1,2000", "names motor 2000"),
    ],
)
def test_an_address_that_is_none_says_so(where: str, says: str) -> None:
    with pytest.raises(TautError, match=says):
        find(where)


@NO_ROS
def test_a_joint_is_called_as_it_is_written() -> None:
    assert addresses.parse("ros:/joint_states,/commands:01,1").numbers == ("01", "1")


def test_drives_whose_bus_is_gone_are_closed_all_the_same() -> None:
    def gone(*_: Any) -> None:
        raise can.CanOperationError("the adapter was pulled out")

    with opened("canopen", motors_of("canopen", 0.0)) as (_, drives):
        link = HostedLink(drives, "canopen:emulated:1", RATE_HZ, paced=False)
        drives._network.bus.send = gone
        with pytest.raises(TautError, match="pulled out"):
            drives.stop()
        link.close()
    with (
        closing(Cia402Emulator([Motor()])) as emulator,
        pytest.MonkeyPatch.context() as patch,
        pytest.raises(TautError, match="pulled out"),
    ):
        patch.setattr(can.interfaces.virtual.VirtualBus, "send", gone)
        addresses.open_drives(addresses.parse(where("canopen", emulator, "rate=100")))


def test_a_library_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(addresses.KINDS, "dynamixel", replace(addresses.KINDS["dynamixel"], module="nothing"))
    with pytest.raises(TautError, match=r"pip install 'tautline-robotics\[drivers\]'"):
        find("dynamixel:/dev/ttyUSB0:1")


@every_kind
def test_nobody_there_is_one_line(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_joints, "_FIRST_S", 1.0)
    make, like = EMULATORS[kind]
    emulator = make([replace(like, goals=[], course=[])])
    try:
        with pytest.raises(TautError, match=r"check power|no joint joint_9 in .*, which names gripper, joint_1, wheel"):
            addresses.open_drives(addresses.parse(where(kind, emulator, "rate=100", 9)))
    finally:
        emulator.close()


def test_all_go_off_though_one_does_not_answer() -> None:
    asked: list[int] = []

    def enable(axis: int, on: bool) -> None:
        asked.append(axis)
        if axis == 0:
            raise TautError("motor 1 does not answer")

    with pytest.raises(TautError, match="motor 1"):
        all_off(3, enable)
    assert asked == [0, 1, 2]


def test_a_thread_that_ends_switches_off_and_is_told_of() -> None:
    emulator = DynamixelEmulator([Motor()])
    try:
        address = addresses.parse(f"dynamixel:{emulator.bus.path}:1?rate=50&baud=1000000")
        drives = addresses.open_drives(address)
        link = HostedLink(drives, address.where, address.rate_hz)
        off: list[bool] = []
        drives.stop = lambda: off.append(True)  # type: ignore[method-assign]
        drives.measure = lambda: [][0]  # type: ignore[method-assign]
        with pytest.raises(TautError, match="IndexError"):
            while True:
                link.read(5.0)
        assert off
        link.close()
    finally:
        emulator.close()


@pytest.mark.parametrize("kind", [kind for kind in EMULATORS if kind != "ros"])
def test_what_is_closed_while_it_is_on_is_switched_off(kind: str) -> None:
    """A topic switches no torque."""
    with driven(kind) as setup:
        setup.live.board.switch_on(0, setup.live.wait)
        setup.live.wait(0.05)
        assert setup.motor.on
    assert not setup.motor.on


def test_cycles_that_come_late_are_counted_and_not_made_up_for() -> None:
    emulator = DynamixelEmulator([Motor()])
    try:
        address = addresses.parse(f"dynamixel:{emulator.bus.path}:1?rate=50&baud=1000000")
        drives = addresses.open_drives(address)
        link = HostedLink(drives, address.where, address.rate_hz)
        measure, began_s = drives.measure, list[float]()

        def measured() -> list[Measured]:
            began_s.append(time.monotonic())
            if len(began_s) <= 5:
                time.sleep(0.06)  # three periods
            return measure()

        before = link.timing.late
        drives.measure = measured  # type: ignore[method-assign]
        end = time.monotonic() + 20.0
        while len(began_s) < 12 and time.monotonic() < end:
            time.sleep(0.01)
        link.close()
        assert link.timing.late >= before + 4
        assert began_s[11] - began_s[6] > 5 * 0.5 / 50.0
    finally:
        emulator.close()


def test_what_cannot_be_used_gives_its_bus_back(monkeypatch: pytest.MonkeyPatch) -> None:
    emulator = DynamixelEmulator([Motor()])
    closed: list[bool] = []
    try:
        where = f"dynamixel:{emulator.bus.path}:1?baud=1000000"
        file = flash_file(addresses.parse(where).where)
        file.parent.mkdir(parents=True)
        file.write_bytes(b"what somebody else left")
        make = addresses.open_drives

        def opened(address: addresses.Address) -> Any:
            drives = make(address)
            close = drives.close
            monkeypatch.setattr(drives, "close", lambda: (closed.append(True), close()))
            return drives

        monkeypatch.setattr(addresses, "open_drives", opened)
        with pytest.raises(TautError, match="remove it"):
            find(where)[0].open()
        assert closed
    finally:
        emulator.close()


def test_a_feetech_goal_beyond_what_it_can_be_told_is_its_last() -> None:
    encoded = Feetech.encoded
    assert [encoded(None, q) for q in (5, -5, 40_000, -70_000)] == [  # type: ignore[arg-type]
        b"\x05\x00",
        b"\x05\x80",
        b"\xff\x7f",
        b"\xff\xff",
    ]


def test_a_servo_in_overload_is_switched_off() -> None:
    """The byte of a Feetech's answer is its state, and refuses nothing."""
    emulator = FeetechEmulator([Motor()])
    try:
        drives = addresses.open_drives(addresses.parse(f"feetech:{emulator.bus.path}:1?baud=1000000"))
        drives.enable(0, True)
        emulator.fail()
        drives.enable(0, False)
        drives.close()
    finally:
        emulator.close()


@contextmanager
def joints(motors: list[Motor], **options: Any) -> Iterator[tuple[RosRobot, Any]]:
    robot = RosRobot(motors, f"/n{uuid4().hex[:12]}", **options)
    drives = None
    try:
        names = ",".join(robot.names)
        drives = addresses.open_drives(addresses.parse(f"ros:{robot.bus.path}:{names}"))
        settled("ros", robot, drives)
        yield robot, drives
    finally:
        if drives is not None:
            drives.close()
        robot.close()


@NO_ROS
@pytest.mark.parametrize(
    ("like", "described", "counts", "per", "speed", "low"),
    [
        ("revolute", True, 4096, "turn", 12000.0, -20000.0),  # as the robot has them, in counts
        ("prismatic", True, 1_000_000, "m", 12000.0, -20000.0),
        ("continuous", True, 4096, "turn", 12000.0, -3.9e6),  # whatever it says of ends
        ("revolute", False, 4096, "turn", 4096.0, -3.9e6),
    ],
)
def test_a_joints_kind_and_limits_are_its_descriptions(
    like: str, described: bool, counts: int, per: str, speed: float, low: float
) -> None:
    with joints([Joint(position=500.0)], kind=like, described=described) as (_, drives):
        drive = drives.drives[0]
        assert (drive.counts_per_turn, drive.per, drive.referenced) == (counts, per, True)
        assert drive.limits.speed == pytest.approx(speed)
        assert (drive.limits.q_low, drive.limits.q_high) == (pytest.approx(low), pytest.approx(-low))
        assert drives.measure()[0].q == pytest.approx(500.0, abs=1e-6)


@NO_ROS
def test_a_limit_that_is_no_number_is_one_line() -> None:
    from tautline.drivers.ros_joints import _drive_of_joint

    with pytest.raises(TautError, match=r"joint elbow: its description's limit upper is '\$\{pi\}', expected a number"):
        _drive_of_joint("elbow", {"type": "revolute", "lower": "0", "upper": "${pi}"})
    for none in ("nan", "-inf"):
        with pytest.raises(TautError, match=f"limit lower is '{none}', expected a number"):
            _drive_of_joint("elbow", {"type": "revolute", "lower": none, "upper": "1"})


@NO_ROS
def test_a_limit_farther_than_can_be_counted_is_as_far_as_can() -> None:
    from tautline.drivers.ros_joints import _drive_of_joint

    limits = _drive_of_joint("elbow", {"type": "revolute", "lower": "-1e16", "upper": "1"}).limits
    assert limits.q_low == -3.9e6 and limits.q_high == pytest.approx(4096 / 6.2832, rel=1e-4)


@NO_ROS
def test_a_sliding_joint_whose_description_has_no_speed_is_a_slow_one() -> None:
    with joints([Joint(speed_most=0.0)], kind="prismatic") as (_, drives):
        assert drives.drives[0].limits.speed == pytest.approx(100_000.0)  # a tenth of a metre


@NO_ROS
@pytest.mark.parametrize("by_name", [False, True])
def test_a_joint_that_is_off_is_left_where_it_is(by_name: bool) -> None:
    motors: list[Motor] = [Joint(position=100.0), Joint(position=-300.0)]
    with joints(motors, by_name=by_name) as (robot, drives):
        drives.enable(0, True)
        drives.set_positions([Goal(150.0, 0.0), None])
        robot.bus.settle()
        assert motors[0].goals == pytest.approx([100.0, 150.0], abs=1e-6)
        assert motors[1].goals == ([] if by_name else pytest.approx([-300.0, -300.0], abs=1e-6))
        drives.enable(0, False)  # no force that grew: where it is
        robot.bus.settle()
        assert motors[0].goals[-1] == pytest.approx(100.0, abs=1e-6)
        told = len(motors[0].goals)
        drives.enable(1, True)
        drives.set_positions([None, Goal(-310.0, 0.0)])
        robot.bus.settle()
        assert motors[1].goals[-1] == pytest.approx(-310.0, abs=1e-6)
        assert motors[0].goals[told:] == ([] if by_name else pytest.approx([100.0, 100.0], abs=1e-6))
        drives.enable(0, True)
        drives.set_positions([Goal(120.0, 0.0), Goal(-320.0, 0.0)])
        robot.bus.settle()
        assert [motor.goals[-1] for motor in motors] == pytest.approx([120.0, -320.0], abs=1e-6)


@NO_ROS
def test_a_joint_that_is_off_does_not_give_way_to_its_load() -> None:
    motors: list[Motor] = [Joint(), Joint(position=-300.0)]
    with joints(motors) as (robot, drives):
        drives.stop()  # none was on: nothing is said
        drives.enable(0, True)
        for sag in range(1, 6):
            motors[1].position = -300.0 - sag
            until_measured(drives, 1, -300.0 - sag)
            drives.set_positions([Goal(10.0 * sag, 0.0), None])
        robot.bus.settle()
        assert len(motors[0].goals) == 6 and motors[1].goals == pytest.approx([-300.0] * 6, abs=1e-6)


def until_measured(drives: Any, axis: int, q: float) -> None:
    end = time.monotonic() + 5.0
    while abs(drives.measure()[axis].q - q) > 1e-3:
        assert time.monotonic() < end


@NO_ROS
def test_a_description_that_is_found_late_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_joints, "_DESCRIBED_S", 10.0)
    robot = RosRobot([Joint()], f"/n{uuid4().hex[:12]}", kind="prismatic", described=False)
    later = threading.Timer(1.0, robot.describe, [robot.names])
    later.start()
    try:
        drives = addresses.open_drives(addresses.parse(f"ros:{robot.bus.path}:joint_1"))
        assert drives.drives[0].per == "m"
        drives.close()
    finally:
        later.join()
        robot.close()


@NO_ROS
@pytest.mark.parametrize(("names", "says"), [([], "published but did not come"), (["elbow"], "has no joint joint_1")])
def test_a_description_that_does_not_say_it_is_no_joint_without_an_end(
    names: list[str], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ros_joints, "_DESCRIBED_S", 0.5 if not names else 10.0)
    robot = RosRobot([Joint()], f"/n{uuid4().hex[:12]}", described=False)
    robot.describe(names)
    try:
        with pytest.raises(TautError, match=says):
            addresses.open_drives(addresses.parse(f"ros:{robot.bus.path}:joint_1"))
    finally:
        robot.close()


@NO_ROS
def test_a_joint_whose_hardware_is_not_active_is_not_used() -> None:
    with closing(EMULATORS["ros"][0]([Joint()])) as robot:
        robot.fail()
        with pytest.raises(TautError, match="has no position of joint_1"):
            addresses.open_drives(addresses.parse(where("ros", robot, "rate=100")))


@NO_ROS
def test_joints_whose_states_come_apart_are_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_joints, "_FIRST_S", 1.0)
    says = "no message .* has positions of joint_1, gripper: name joints of one"
    with closing(EMULATORS["ros"][0]([Joint()])) as robot, pytest.raises(TautError, match=says):
        addresses.open_drives(addresses.parse(f"ros:{robot.bus.path}:joint_1,gripper"))


@NO_ROS
@pytest.mark.parametrize(
    ("bus", "says"), [("/joint_states", "name two topics"), ("/nobody_is_here,/commands", "no joint states came")]
)
def test_topics_that_cannot_be_used_are_one_line(bus: str, says: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_joints, "_FIRST_S", 0.3)
    with pytest.raises(TautError, match=says):
        addresses.open_drives(addresses.parse(f"ros:{bus}:joint_1"))


@pytest.mark.parametrize(("rate", "told"), [(250.0, (4, -3)), (400.0, (25, -4))])
def test_a_canopen_cycle_is_told_as_it_is(rate: float, told: tuple[int, int]) -> None:
    with closing(Cia402Emulator([Motor()])) as emulator:
        addresses.open_drives(addresses.parse(where("canopen", emulator, f"rate={rate:g}"))).close()
        objects = emulator.nodes[0]["objects"]
        assert (objects[0x60C2, 1][1], objects[0x60C2, 2][1]) == told


@pytest.mark.parametrize("comes", [True, False])
def test_a_canopen_answer_belongs_to_its_sync(comes: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """One comes after the next SYNC, or never: what is taken then is where the drive is at that SYNC."""
    emulator = Cia402Emulator([Motor()])
    late: list[can.Message] = []

    def through(answer: can.Message) -> Iterator[can.Message]:
        if answer.arbitration_id == 0x181 and not late:
            late.append(answer)
            return
        if answer.arbitration_id == 0x181 and comes and len(late) == 1:
            late.append(answer)
            yield late[0]
            time.sleep(0.02)  # the newer one is still on its way
        yield answer

    try:
        drives = addresses.open_drives(addresses.parse(f"canopen:virtual/{emulator.bus.channel}:1?baud=1000000"))
        monkeypatch.setattr(emulator.bus.ills, "through", through)
        with pytest.raises(Missed):
            drives.measure()
        for position in (700.0, 900.0):
            emulator.motors[0].position = position
            assert drives.measure()[0].q == position
        drives.close()
    finally:
        emulator.close()
