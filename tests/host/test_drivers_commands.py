"""The live commands that test_drivers.py does not walk through, on motors of other makers: watch, stream, commission,
home."""

from __future__ import annotations

import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runner import Finished, Taut
from emulated_drives import EMULATORS, driven, every_kind, model_of, some_kinds, where
from motor_emulators import Cia402Emulator, Motor

from tautline.device import wire
from tautline.errors import TautError
from tautline.live.commission import commission
from tautline.live.homing import home
from tautline.live.session import driving, move_to
from tautline.live.setup import Live
from tautline.live.tracking import watch
from tautline.model import Uncertainty
from tautline.simulated.instrument import preset

pytestmark = pytest.mark.usefixtures("patient_buses", "own_state")


def yes(question: str) -> bool:
    return True


def stored(live: Live) -> dict[str, Any]:
    return dict(live.board.ask("get_settings", axis=0).values)


@some_kinds("canopen")
@pytest.mark.parametrize("scale", [pytest.param(1.0, marks=pytest.mark.long), 0.7])
def test_watch_tells_whether_the_model_still_holds(kind: str, scale: float) -> None:
    """The instrument has `scale` times the model's backlash."""
    model = model_of(preset("reference"))
    with driven(kind) as setup:
        wrong = replace(model, width=model.width / scale, uncertainty=Uncertainty(noise=0.05))
        result = watch(setup.live, wrong, "smooth", speed=2.5, duration_s=30.0)
        assert kind == "ros" or not setup.motor.on
    assert result["frames"] > 500
    assert result["scale"] == pytest.approx(scale, abs=0.02) and abs(result["offset"]) < 0.01
    assert ("stale" in [change["state"] for change in result["changes"]]) == (scale != 1.0), result["changes"]
    if scale == 1.0:
        assert result["state"] == "trusted"


@every_kind
def test_commission_sees_that_a_drive_goes_where_it_is_told_and_keeps_the_rigs_range(kind: str) -> None:
    with driven(kind) as setup:
        live = setup.live
        said: list[str] = []
        own = stored(live)
        done = commission(live, yes, said.append, wanted={"instrument": "arm-7"})
        low, high = live.rig.actuator.range
        kept = stored(live)
        assert (kept["q_low"] * live.resolution, kept["q_high"] * live.resolution) == pytest.approx((low, high))
        assert kept["instrument"] == "arm-7" and kept["commissioned"] == 1
        changed = {name for name in kept if kept[name] != own[name]}
        assert changed == {"q_low", "q_high", "instrument"}
        # The gains are the drive's own; what is seen is how it follows.
        step = done.steps[1.0]
        assert step.overshoot < 5.0 and step.settling_s < 0.3
        lag_s = live.board.bus()["lag_s"]
        assert 0.5 * setup.motor.lag_s < lag_s < setup.motor.lag_s + 0.025 and f"{1e3 * lag_s:.1f} ms" in said[1]
        assert kind == "ros" or not setup.motor.on
        with driving(live):
            move_to(live, 1.0, 2.0)


def test_a_fault_while_a_drive_is_commissioned_stores_no_instrument() -> None:
    with driven("dynamixel") as setup:
        live = setup.live
        batches: list[wire.Message] = []

        def took(batch: wire.Message) -> None:
            batches.append(batch)
            if len(batches) == 100:
                setup.emulator.fail()

        live.board.listen("batch", took)
        with pytest.raises(TautError, match="the motor driver reports"):
            commission(live, yes, print, wanted={"instrument": "arm-7"})
        assert len(batches) >= 100 and stored(live)["instrument"] != "arm-7" and not setup.motor.on


def test_what_is_not_agreed_to_is_not_done() -> None:
    with driven("dynamixel") as setup, pytest.raises(TautError, match="stopped as you said"):
        commission(setup.live, lambda question: False, print)
    assert not setup.motor.goals


def test_a_range_beyond_the_drives_own_is_refused() -> None:
    with driven("canopen") as setup:
        actuator = replace(setup.live.rig.actuator, range=(-4.0, 21.0))  # its own end is 20 mm
        setup.live.rig = replace(setup.live.rig, actuator=actuator)
        with pytest.raises(TautError, match=r"\[-20, 20\] mm"):
            commission(setup.live, yes, print)
        assert not setup.motor.goals


@every_kind
def test_a_drive_is_not_driven_against_an_end(kind: str) -> None:
    with driven(kind) as setup:
        with pytest.raises(TautError, match=r"maker's tools.*--at"):
            home(setup.live)
        assert kind == "ros" or not setup.motor.on
        assert not setup.motor.goals


@contextmanager
def turning(kind: str) -> Iterator[tuple[str, Motor]]:
    """A motor by the wall clock, and its address."""
    make, like = EMULATORS[kind]
    motor = replace(like, goals=[], course=[])
    emulator = Cia402Emulator([motor], homed=True) if kind == "canopen" else make([motor])
    over = threading.Event()

    def turn() -> None:
        began, steps = time.monotonic(), 0
        while not over.wait(2e-3):
            while steps < 1e3 * (time.monotonic() - began):
                motor.step()
                steps += 1

    thread = threading.Thread(target=turn)
    thread.start()
    try:
        yield where(kind, emulator, "rate=100"), motor
    finally:
        over.set()
        thread.join()
        emulator.close()


def in_time(kind: str, told: Callable[[str, Motor], Finished], kept: Path) -> Finished:
    """What a command came to with a motor by the wall clock. Where this machine stood still for longer than a host may,
    it is tried anew, with another motor, of which nothing is `kept`."""
    for _ in range(10):
        shutil.rmtree(kept, ignore_errors=True)
        with turning(kind) as (address, motor):
            done = told(address, motor)
        if "control steps came late" not in done.err:
            break
    assert done.code == 0, done.err
    return done


@some_kinds("dynamixel", "moteus")
def test_stream_sends_set_points_by_the_wall_clock(kind: str, taut: Taut, tmp_path: Path, own_state: Path) -> None:
    model = model_of(preset("reference"))
    model.save(tmp_path / "model")
    motors: list[Motor] = []

    def streamed(address: str, motor: Motor) -> Finished:
        motors.append(motor)
        words = ("stream", tmp_path / "model", "--board", address, "--sine", "5", "3", "--duration", "6", "--json")
        return taut(*words)

    told = json.loads(in_time(kind, streamed, own_state).out)
    assert told["sent"] > 200 and told["refused"] == 0  # 250 a second, as far as this machine keeps up
    # Where the tip goes 5 deg either way the motor goes p, and half a width beyond it.
    way = np.ptp(motors[-1].course[len(motors[-1].course) // 3 :])
    p = np.interp([-5.0, 5.0], model.c_deg, model.q)
    asked = 1e3 * (p[1] - p[0] + np.mean(np.interp(p, model.q, model.width)))
    assert way == pytest.approx(asked, rel=0.03)
    assert kind == "ros" or not motors[-1].on


def test_commission_by_the_wall_clock_from_the_command_line(taut: Taut, tmp_path: Path, own_state: Path) -> None:
    rig = preset("reference").rig
    file = tmp_path / "rig.toml"

    def commissioned(address: str, motor: Motor) -> Finished:
        replace(rig, actuator=replace(rig.actuator, board=address)).save(file)
        done = taut("commission", "--rig", file, "--out", tmp_path / "steps.png", "--yes", "--json")
        assert "maker's tools" in taut.refuses("home", "--rig", file)
        assert "--estop" in taut.refuses("commission", "--rig", file, "--estop", "open", "--yes")
        return done

    told = json.loads(in_time("dynamixel", commissioned, own_state).out)
    assert told["changed"] == ["q_high", "q_low"] and told["bus"]["lag_s"] > 0.005
    assert (tmp_path / "steps.png").is_file()
