"""moteus controllers by mjbots' own library: a query and a position command a cycle, on CAN-FD.

The bus is python-can's (socketcan/can0), or the serial device of a fdcanusb. A count is 1/4096 turn of the output, as
the controller's own configuration has it. Its position bounds and limits stay in force beside those of the axis.
"""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Sequence
from typing import Any

import can
import moteus

from tautline.drivers.drives import RANGE, STARTS, Clock, Drive, DriveLimits, Goal, Measured, Missed, all_off
from tautline.errors import TautError

BAUD, RATE_HZ = 1_000_000, 250.0
_COUNTS_PER_TURN = 4096
_SPEED = 4.0 * _COUNTS_PER_TURN  # prior: counts/s: no register says a controller's own
_ANSWER_S, _FIRST_S, _TRIES = 0.015, 0.2, 5  # tolerance: of a cycle; of each try before the first
_WATCHDOG_S = 0.1
_FAULT_MODE, _OUTPUT_IS_KNOWN = 1, 2  # format: of the registers mode and home state
_Register = moteus.Register
_ASKED = {  # by every query
    _Register.MODE, _Register.POSITION, _Register.VELOCITY, _Register.Q_CURRENT, _Register.HOME_STATE, _Register.FAULT
}  # fmt: skip


class Moteus:
    """moteus controllers on one bus, as `Drives` (drives.py)."""

    watchdog = "the controllers' own: without a command they stop as servo.timeout_mode says"
    rest_s = _WATCHDOG_S
    enable_s = _FIRST_S

    def __init__(
        self, bus: str, numbers: Sequence[int], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """Opens the bus and asks every controller whether it knows its position. bus: python-can's INTERFACE/CHANNEL,
        or the serial device of a fdcanusb; numbers: the controllers' ids; baud: bit/s; rate_hz: as every driver takes
        it, unused. TautError where the bus cannot be opened or a controller does not answer."""
        self._clock, self._numbers, self._bus = clock, list(numbers), bus
        self._loop = asyncio.new_event_loop()
        resolution = moteus.QueryResolution()
        resolution.q_current, resolution.torque, resolution.temperature = moteus.F32, moteus.IGNORE, moteus.IGNORE
        resolution.home_state = moteus.INT8
        try:
            self._transport = _open_transport(bus, baud)
        except (can.CanError, OSError, ValueError, NotImplementedError) as error:
            self._loop.close()
            raise TautError(f"moteus:{bus}: cannot be opened ({error}): check adapter and channel") from error
        self._controllers = [
            moteus.Controller(id=number, query_resolution=resolution, transport=self._transport) for number in numbers
        ]
        try:
            known = self._all_referenced()
        except BaseException:
            self.close()
            raise
        limits = DriveLimits(-RANGE, RANGE, _SPEED, STARTS * _SPEED)
        self.drives = [
            Drive(
                number,
                model="moteus",
                firmware="-",
                counts_per_turn=_COUNTS_PER_TURN,
                limits=limits,
                referenced=referenced,
            )
            for number, referenced in zip(numbers, known, strict=True)
        ]

    def _all_referenced(self) -> list[bool]:
        """Asks each controller whether it knows where its output is (its register HOME_STATE); returns the answers in
        the order of the ids. TautError where one does not answer in _TRIES tries."""
        for left in reversed(range(_TRIES)):
            try:
                answers = self._query_all(_FIRST_S)
                return [int(values[_Register.HOME_STATE]) >= _OUTPUT_IS_KNOWN for values in answers]
            except Missed as missed:
                if left == 0:
                    raise TautError(f"moteus:{self._bus}: {missed}: check power, ids and the bus") from missed
        raise AssertionError("one try at least")

    def _exchange(self, commands: list[Any], within_s: float) -> list[Any]:
        """Sends the commands and returns the controllers' answers, moteus.Result each; within_s: how long all may take.
        Missed where they take longer or the bus takes no frame, TautError where the adapter is gone."""

        async def cycle() -> list[Any]:
            """One cycle of moteus' transport with its time limit."""
            return list(await asyncio.wait_for(self._transport.cycle(commands), within_s))

        try:
            return self._loop.run_until_complete(cycle())
        except TimeoutError as error:
            raise Missed("no answer") from error
        except can.CanError as error:
            raise Missed(f"the bus takes nothing ({error})") from error
        except OSError as error:
            raise TautError("the adapter is gone") from error

    def _query_all(self, within_s: float) -> list[dict[int, float]]:
        """Queries every controller for the registers _ASKED within within_s; returns its values by register, in the
        order of the ids. Missed where an answer or a register is missing."""
        answers = self._exchange([controller.make_query() for controller in self._controllers], within_s)
        values = {answer.id: answer.values for answer in answers}
        if any(_ASKED - values.get(number, {}).keys() for number in self._numbers):
            raise Missed("an answer is missing, or damaged")
        return [values[number] for number in self._numbers]

    def measure(self) -> list[Measured]:
        """Measures every controller by one query of all, in the order of the ids. Missed where an answer does not
        come."""
        sent = self._clock()
        answers = self._query_all(_ANSWER_S)
        t_s = 0.5 * (sent + self._clock())
        return [self._measured(t_s, values) for values in answers]

    def _measured(self, t_s: float, values: dict[int, float]) -> Measured:
        """Converts a controller's answer to a query (turns, turns/s, A by register) to counts, counts/s and mA. t_s:
        the middle of the round trip, s. Missed where the controller does not know its position."""
        fault = f"fault {int(values[_Register.FAULT])}" if int(values[_Register.MODE]) == _FAULT_MODE else ""
        position, speed = values[_Register.POSITION], values[_Register.VELOCITY]
        if not math.isfinite(position):
            raise Missed("the controller does not know its position")
        return Measured(
            t_s,
            q=position * _COUNTS_PER_TURN,
            velocity=speed * _COUNTS_PER_TURN,
            current_ma=1e3 * values[_Register.Q_CURRENT],
            fault=fault,
        )

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Sends the controllers that have a goal its position and speed; at this speed they go on until the next one
        comes."""
        self._exchange(
            [
                controller.make_position(
                    position=goal.q / _COUNTS_PER_TURN,
                    velocity=goal.speed / _COUNTS_PER_TURN,
                    watchdog_timeout=_WATCHDOG_S,
                )
                for controller, goal in zip(self._controllers, goals, strict=True)
                if goal is not None
            ],
            _ANSWER_S,
        )

    def enable(self, axis: int, on: bool) -> None:
        """Sends the controller a stop, whether `on` or not: off, it has no torque then; on, the stop clears a fault and
        a tripped watchdog, and the set-point of the same cycle makes it hold."""
        self._exchange([self._controllers[axis].make_stop(query=True)], _FIRST_S)

    def stop(self) -> None:
        """Switches all controllers off. Missed or TautError where one could not be told."""
        all_off(len(self._numbers), self.enable)

    def close(self) -> None:
        """Closes the bus; controllers stop by their watchdog."""
        self._transport.close()
        self._loop.run_until_complete(asyncio.sleep(0))  # lets what close() has scheduled happen
        self._loop.close()


def _open_transport(bus: str, baud: int) -> Any:
    """Opens moteus' transport on python-can's INTERFACE/CHANNEL, or on a fdcanusb where the bus is the path of a
    device. baud: bit/s, of python-can only."""
    interface, _, channel = bus.partition("/")
    if not interface:  # /dev/...
        return moteus.Fdcanusb(bus)
    return moteus.PythonCan(interface=interface, channel=channel, bitrate=baud, fd=True)
