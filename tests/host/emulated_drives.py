"""Motors of other makers for tests: each kind's emulator with the simulated instrument behind it, in virtual time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from typing import Any
from uuid import uuid4

import numpy as np
import pytest
from motor_emulators import Bench, Cia402Emulator, DynamixelEmulator, FeetechEmulator, MoteusEmulator, Motor
from ros_robot import Joint, RosRobot

from tautline.device import wire
from tautline.device.board import Board
from tautline.device.link import BoardAddress
from tautline.drivers import addresses
from tautline.drivers.hosted import HostedLink
from tautline.live.setup import Live, PointSource
from tautline.model import Model
from tautline.simulated.instrument import Instrument, preset
from tautline.simulated.simlink import SimulatedAxis

RATE_HZ = 100.0
EMULATORS: dict[str, tuple[Callable[..., Any], Motor]] = {
    "dynamixel": (DynamixelEmulator, Motor()),
    "feetech": (FeetechEmulator, Motor(speed_most=3400.0, acceleration_most=1e5, lag_s=0.02)),
    "canopen": (Cia402Emulator, Motor(lag_s=0.004)),
    "moteus": (MoteusEmulator, Motor(speed_most=2e4, acceleration_most=1e6, lag_s=0.005)),
    "ros": (lambda motors: RosRobot(motors, f"/n{uuid4().hex[:12]}"), Joint()),
}
HAS_ROS = find_spec("rclpy") is not None
NO_ROS = pytest.mark.skipif(not HAS_ROS, reason="the index has no ROS 2 for this Python or machine")
KINDS = [pytest.param(kind, marks=NO_ROS) if kind == "ros" else kind for kind in EMULATORS]
every_kind = pytest.mark.parametrize("kind", KINDS)


def some_kinds(*quick: str) -> pytest.MarkDecorator:
    """Every kind, those that are not among the quick ones in long runs alone."""
    marks = {kind: [pytest.mark.long] * (kind not in quick) + [NO_ROS] * (kind == "ros") for kind in EMULATORS}
    return pytest.mark.parametrize("kind", [pytest.param(kind, marks=marks[kind]) for kind in EMULATORS])


@dataclass
class Setup:
    live: Live
    link: HostedLink
    bench: Bench
    motor: Motor
    emulator: Any

    @property
    def speed_most(self) -> float:
        return self.link.drives.drives[0].limits.speed


def bus_of(kind: str, emulator: Any) -> str:
    return f"virtual/{emulator.bus.channel}" if kind in ("canopen", "moteus") else emulator.bus.path


def where(kind: str, emulator: Any, options: str, *numbers: int) -> str:
    """The address of emulated motors, of all unless these are named."""
    named = numbers or range(1, len(emulator.motors) + 1)
    ids = ",".join(f"joint_{k}" if kind == "ros" else str(k) for k in named)
    return f"{kind}:{bus_of(kind, emulator)}:{ids}?{options}" + ("" if kind == "ros" else "&baud=1000000")


def settled(kind: str, emulator: Any, drives: Any) -> None:
    """A topic has no answer to wait for: what was published is counted."""
    if kind != "ros":
        return
    publish, sent = drives._commands.publish, [emulator.bus.taken]

    def counted(message: Any) -> None:
        sent[0] += 1
        publish(message)

    drives._commands.publish = counted
    emulator.bus.sent = lambda: sent[0]


@contextmanager
def driven(
    kind: str, homed: bool = True, at: float = 0.0, beside: tuple[Motor, ...] = (), **emulated: Any
) -> Iterator[Setup]:
    """beside: further motors on the bus; emulated: how the emulator differs."""
    make, like = EMULATORS[kind]
    motor = replace(like, goals=[], course=[], position=at)
    instrument = preset("reference")
    with ExitStack() as stack:
        emulator = make([motor, *beside], **emulated)
        stack.callback(emulator.close)
        bench = Bench(emulator.motors, emulator.bus.settle)
        address = addresses.parse(where(kind, emulator, f"rate={RATE_HZ:g}"))
        drives = addresses.open_drives(address, clock=bench.clock)
        settled(kind, emulator, drives)
        link = HostedLink(drives, f"{kind}:emulated:1", RATE_HZ, clock=bench.clock, paced=False)
        bench.serve(link)
        board = stack.enter_context(Board(BoardAddress(link.where, None, False, (wire.wire.MAJOR, 0), lambda: link)))
        if homed and not drives.drives[0].referenced:
            board.ask("set_position", axis=0, q=0.0)
        plant = SimulatedAxis(bench, instrument)  # type: ignore[arg-type]
        yield Setup(Live(board, instrument.rig, 0, PointSource(plant), plant), link, bench, motor, emulator)


def model_of(instrument: Instrument) -> Model:
    q = np.linspace(*instrument.rig.actuator.range, 401)
    width, c = instrument.backlash(q), instrument.bend(q)
    return Model(instrument.rig, q, width, 0.001 + 0 * q, c, 0.08, instrument.rig.actuator.range)
