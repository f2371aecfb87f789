"""Feetech STS and SMS servos by Feetech's own SDK: one sync read and one sync write a cycle.

In position mode (0). ID, baud rate and angle limits are the servo's own and left as they are: limits of 0 and 0 let it
turn many times. A count is a position unit, 4096 of them a turn.
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import scservo_sdk

from tautline.drivers.drives import STARTS, Clock, Drive, DriveLimits, Measured
from tautline.drivers.serial_servos import SerialServos
from tautline.errors import TautError

BAUD, RATE_HZ = 1_000_000, 100.0
_COUNTS_PER_TURN = 4096
_SPEED = 3000.0  # prior: counts/s: no register says a servo's own; what an STS3215 reaches at 7.4 V
_OWN = 1.2  # tolerance: factor of the planned top speed up to which a servo may catch up with its set-points
_MA = 6.5  # format: of a unit of current
_MANY_TURNS = 30719  # format: counts either way, of a servo without angle limits
_ERRORS = {0: "voltage", 1: "encoder", 2: "heat", 3: "current", 5: "overload"}

# The memory table: address, size.
_MODEL, _FIRMWARE, _LOW, _HIGH, _MODE = (3, 2), (0, 2), (9, 2), (11, 2), (33, 1)
_TORQUE, _OWN_ACCELERATION, _GOAL, _TIME, _OWN_SPEED = (40, 1), (41, 1), (42, 2), (44, 2), (46, 2)
_POSITION = (56, 2)
_STATE = (56, 15)  # position 2, speed 2, load 2, voltage, temperature, -, status, moving, -, -, current 2


class Feetech(SerialServos):
    """Feetech servos on one bus."""

    kind = "feetech"
    watchdog = "they have none: each goes to its last set-point and holds it"
    rest_s = 0.0
    refusal = 0  # the byte of an answer is the servo's state, which `measured` reads
    state, goal = _STATE, _GOAL

    def __init__(
        self, bus: str, numbers: Sequence[int], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """bus: the serial device; numbers: the servos' IDs; baud: bit/s; rate_hz: as every driver takes it, unused."""
        super().__init__(scservo_sdk, protocol=0, bus=bus, numbers=numbers, baud=baud, clock=clock)

    def describe(self, number: int) -> Drive:
        """Reads a servo's limits (counts, counts/s, counts/s2), model and firmware from its registers; its speed is a
        prior, as no register says it. TautError where the servo is not in position mode."""
        mode = self.read(number, _MODE)
        if mode != 0:
            raise TautError(f"feetech {number}: mode {mode}: set 0 (position) with Feetech's tools")
        low, high = self.read(number, _LOW), self.read(number, _HIGH)
        if low == high == 0:
            low, high = -_MANY_TURNS, _MANY_TURNS
        firmware = self.read(number, _FIRMWARE)
        limits = DriveLimits(low, high, _SPEED, STARTS * _SPEED)
        version = f"{firmware & 0xFF}.{firmware >> 8}"  # the first byte is the major one
        return Drive(number, f"model {self.read(number, _MODEL)}", version, _COUNTS_PER_TURN, limits, referenced=True)

    def measured(self, axis: int, t_s: float, state: bytes) -> Measured:
        """Converts a servo's answer to the sync read, _STATE, to counts, counts/s and mA. t_s: the middle of the round
        trip, s."""
        position, speed, current_ma = _signed(state[0:2]), _signed(state[2:4]), _signed(state[13:15]) * _MA
        fault = ", ".join(name for bit, name in _ERRORS.items() if state[9] >> bit & 1)
        return Measured(t_s, position, speed, current_ma, fault)

    def encoded(self, goal: int) -> bytes:
        """Encodes a goal, counts, as the goal register's 2 bytes, in which bit 15 is the sign. Beyond +-32767 it is
        clipped: the axis then sees that the servo stays behind."""
        goal = max(-0x7FFF, min(goal, 0x7FFF))
        return (abs(goal) | (0x8000 if goal < 0 else 0)).to_bytes(2, "little")

    def enable(self, axis: int, on: bool) -> None:
        """Switches a servo's torque on, with its position as its goal, or off."""
        number = self.numbers[axis]
        if on:
            self.write(number, _OWN_ACCELERATION, 0)  # the application plans; the servo's own profile would lag
            self.write(number, _TIME, 0)
            self.write(number, _OWN_SPEED, round(_OWN * _SPEED))
            self.write(number, _GOAL, self.read(number, _POSITION))
        self.write(number, _TORQUE, int(on))


def _signed(data: bytes) -> float:
    """Decodes a register's 2 bytes, little-endian, in which bit 15 is the sign and the rest the magnitude."""
    raw = int.from_bytes(data, "little")
    return float(-(raw & 0x7FFF) if raw & 0x8000 else raw)
