"""Dynamixel X series, protocol 2, by ROBOTIS' own SDK: one sync read and one sync write a cycle.

In position mode (3) or extended position mode (4); which of them, ID, baud rate and the limits are the servo's own, set
once with ROBOTIS' tools, and left as they are. A count is a position unit, 4096 of them a turn.
"""

from __future__ import annotations

import struct
import time
from collections.abc import Sequence

import dynamixel_sdk
import numpy as np

from tautline.drivers.drives import STARTS, Clock, Drive, DriveLimits, Measured
from tautline.drivers.serial_servos import SerialServos
from tautline.errors import TautError

BAUD, RATE_HZ = 57600, 50.0  # as they come; a cycle of one servo takes 12 ms then
_WATCHDOG_S = 0.1
_WATCHDOG = round(_WATCHDOG_S / 0.02)  # format: the register counts 20 ms
_COUNTS_PER_TURN = 4096
_COUNTS_PER_SPEED = 0.229 / 60.0 * _COUNTS_PER_TURN  # its unit is 0.229 rev/min
_COUNTS_PER_ACCELERATION = 214.577 / 3600.0 * _COUNTS_PER_TURN  # rev/min2
_MA = dict.fromkeys((1190, 1200, 1210, 1220, 1230, 1240), 1.0)  # format: mA of a unit, by model: X330
_MA_OTHERS = 2.69
_NO_CURRENT = (1060, 1070, 1080, 1090, 1160)  # XL430, XC430: they report a load, no current
_EXTENDED = (1 << 20) - 1  # extended position mode goes to +-256 turns

# The control table: address, size.
_MODEL, _FIRMWARE, _MODE = (0, 2), (6, 1), (11, 1)
_CURRENT_LIMIT, _ACCELERATION_LIMIT, _VELOCITY_LIMIT = (38, 2), (40, 4), (44, 4)
_HIGH, _LOW, _TORQUE, _BUS_WATCHDOG = (48, 4), (52, 4), (64, 1), (98, 1)
_PROFILE_ACCELERATION, _PROFILE_VELOCITY, _GOAL, _POSITION = (108, 4), (112, 4), (116, 4), (132, 4)
_ERRORS, _ASK_ERRORS = (70, 1), 25  # its hardware errors, asked for in each 25th cycle
_ERROR_BITS = {0: "voltage", 2: "heat", 3: "encoder", 4: "electrical shock", 5: "overload"}
_STATE = (126, 10)  # present current 2, velocity 4, position 4


class Dynamixel(SerialServos):
    """Dynamixel servos on one bus."""

    kind = "dynamixel"
    watchdog = "the servos' own bus watchdog"
    rest_s = _WATCHDOG_S
    refusal = 0x7F  # its top bit says that there is a hardware error to be asked for
    state, goal = _STATE, _GOAL

    def __init__(
        self, bus: str, numbers: Sequence[int], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """bus: the serial device; numbers: the servos' IDs; baud: bit/s; rate_hz: as every driver takes it, unused."""
        self._unit_ma: dict[int, float] = {}  # by ID: mA of a unit of the current register, 0 without one
        self._hardware_errors = dict.fromkeys(numbers, "")  # by ID: in words, as they were read last
        self._cycles = 0
        super().__init__(dynamixel_sdk, protocol=2.0, bus=bus, numbers=numbers, baud=baud, clock=clock)

    def describe(self, number: int) -> Drive:
        """Reads a servo's limits (counts, counts/s, counts/s2, mA), model and firmware from its registers. In extended
        position mode, 4, its position limits are those of the mode; current_ma is 0 for a model that measures none.
        TautError where it is not in a position mode."""
        mode, model = self.read(number, _MODE), self.read(number, _MODEL)
        if mode not in (3, 4):
            raise TautError(
                f"dynamixel {number}: operating mode {mode}: set 3 (position) or 4 (extended position, many turns) "
                "with DYNAMIXEL Wizard"
            )
        low, high = (self.read(number, _LOW), self.read(number, _HIGH)) if mode == 3 else (-_EXTENDED, _EXTENDED)
        speed = self.read(number, _VELOCITY_LIMIT) * _COUNTS_PER_SPEED
        acceleration = self.read(number, _ACCELERATION_LIMIT) * _COUNTS_PER_ACCELERATION
        unit_ma = self._unit_ma[number] = 0.0 if model in _NO_CURRENT else _MA.get(model, _MA_OTHERS)
        current_ma = self.read(number, _CURRENT_LIMIT) * unit_ma if unit_ma else 0.0
        acceleration = min(acceleration or np.inf, STARTS * speed)  # 0: the servo limits none
        limits = DriveLimits(low, high, speed, acceleration, current_ma)
        firmware = str(self.read(number, _FIRMWARE))
        return Drive(number, f"model {model}", firmware, _COUNTS_PER_TURN, limits, referenced=True)

    def measure(self) -> list[Measured]:
        """Measures all servos by one sync read. Every _ASK_ERRORS cycles one servo, the next one each time, is also
        asked for its hardware errors, which the sync read does not contain."""
        measured = super().measure()
        self._cycles += 1
        if self._cycles % _ASK_ERRORS == 0:
            number = self.numbers[self._cycles // _ASK_ERRORS % len(self.numbers)]
            bits = self.glance(number, _ERRORS)
            if bits is not None:
                self._hardware_errors[number] = ", ".join(name for bit, name in _ERROR_BITS.items() if bits >> bit & 1)
        return measured

    def measured(self, axis: int, t_s: float, state: bytes) -> Measured:
        """Converts a servo's answer to the sync read, _STATE, to counts, counts/s and mA. t_s: the middle of the round
        trip, s."""
        current, velocity, position = struct.unpack("<hii", state)
        number = self.numbers[axis]
        return Measured(
            t_s,
            q=float(position),
            velocity=velocity * _COUNTS_PER_SPEED,
            current_ma=current * self._unit_ma[number],
            fault=self._hardware_errors[number],
        )

    def encoded(self, goal: int) -> bytes:
        """Encodes a goal, counts, as the goal register's 4 bytes."""
        return struct.pack("<i", goal)

    def enable(self, axis: int, on: bool) -> None:
        """Switches a servo's torque on, with its position as its goal and under the bus watchdog, or off."""
        number = self.numbers[axis]
        if not on:
            self.write(number, _TORQUE, 0)
            self.write(number, _BUS_WATCHDOG, 0)
            return
        self.write(number, _BUS_WATCHDOG, 0)  # clears one that has tripped
        self.write(number, _PROFILE_ACCELERATION, 0)  # the application plans; the servo's own profile would lag
        self.write(number, _PROFILE_VELOCITY, round(self.drives[axis].limits.speed / _COUNTS_PER_SPEED))
        self.write(number, _TORQUE, 1)
        self.write(number, _GOAL, self.read(number, _POSITION))
        self.write(number, _BUS_WATCHDOG, _WATCHDOG)
