"""Dynamixel X series, protocol 2, by ROBOTIS' own SDK: one sync read and one sync write a cycle.

In position mode (3) or extended position mode (4); which of them, ID, baud rate and the limits are the servo's own, set
once with ROBOTIS' tools, and left as they are. A count is a position unit, 4096 of them a turn.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

import serial
from dynamixel_sdk import COMM_SUCCESS, GroupSyncRead, GroupSyncWrite, PacketHandler, PortHandler

from tautline.errors import TautError
from tautline.motors.drives import Clock, Drive, DriveLimits, Measured, Missed

BAUD, RATE_HZ = 57600, 100.0  # as they come; a cycle of one servo takes 8 ms then
_ANSWER_MS = 15.0  # a USB adapter's latency timer may be 16 ms: lower it to 1 (docs/drivers.md)
_SETUP_TRIES = 5
_WATCHDOG, _WATCHDOG_S = 5, 0.1  # the register counts 20 ms
_COUNTS_PER_TURN = 4096
_RPM = 0.229  # of a unit of speed
_RPM2 = 214.577  # rev/min2 of a unit of acceleration
_ACCELERATION = 20.0  # where the servo limits none: from rest to its top speed in so much of a second, inverse
_MA = {1190: 1.0, 1200: 1.0, 1210: 1.0, 1220: 1.0, 1230: 1.0, 1240: 1.0}  # X330
_MA_OTHERS = 2.69
_NO_CURRENT = (1060, 1070, 1080, 1090, 1160)  # XL430, XC430: they report a load, no current
_EXTENDED = (1 << 20) - 1  # extended position mode goes to +-256 turns

# Control table: address, size.
_MODEL, _FIRMWARE, _MODE = (0, 2), (6, 1), (11, 1)
_CURRENT_LIMIT, _ACCELERATION_LIMIT, _VELOCITY_LIMIT = (38, 2), (40, 4), (44, 4)
_HIGH, _LOW, _TORQUE, _ERRORS, _BUS_WATCHDOG = (48, 4), (52, 4), (64, 1), (70, 1), (98, 1)
_PROFILE_ACCELERATION, _PROFILE_VELOCITY, _GOAL = (108, 4), (112, 4), (116, 4)
_STATE, _STATE_SIZE = 126, 10  # present current 2, velocity 4, position 4
_ERROR_BITS = {0: "voltage", 2: "heat", 3: "encoder", 4: "electrical shock", 5: "overload"}


class _Port(PortHandler):  # type: ignore[misc]
    """The SDK's port, which waits for bytes instead of asking for them all the time, and answers when told to."""

    def setupPort(self, baud: int) -> bool:
        if not super().setupPort(baud):
            return False
        self.ser.timeout, self.ser.exclusive = 2e-3, True
        return True

    def setPacketTimeout(self, length: int) -> None:
        self.setPacketTimeoutMillis(self.tx_time_per_byte * length + _ANSWER_MS)


class Dynamixel:
    watchdog = "the servos' own bus watchdog"
    rest_s = _WATCHDOG_S

    def __init__(self, bus: str, numbers: Sequence[int], baud: int, clock: Clock = time.monotonic) -> None:
        self._clock, self._numbers = clock, list(numbers)
        self._port, self._packets = _Port(bus), PacketHandler(2.0)
        self._errors = [0 for _ in numbers]
        self._asked = 0
        try:
            if not self._port.setBaudRate(baud):
                raise TautError(f"dynamixel:{bus}: no such baud rate, {baud}: the servos' own is 57600 as they come")
        except (serial.SerialException, OSError) as error:
            raise TautError(f"dynamixel:{bus}: cannot be opened ({error}): check the plug, and who uses it") from error
        try:
            self.drives = [self._describe(number) for number in self._numbers]
        except BaseException:
            self._port.closePort()
            raise
        self._reading = GroupSyncRead(self._port, self._packets, _STATE, _STATE_SIZE)
        self._writing = GroupSyncWrite(self._port, self._packets, *_GOAL)
        for number in self._numbers:
            self._reading.addParam(number)

    def _describe(self, number: int) -> Drive:
        mode, model = self._read(number, _MODE), self._read(number, _MODEL)
        if mode not in (3, 4):
            raise TautError(
                f"dynamixel {number}: operating mode {mode}: set 3 (position) or 4 (extended position, many turns) "
                "with DYNAMIXEL Wizard"
            )
        low, high = (self._read(number, _LOW), self._read(number, _HIGH)) if mode == 3 else (-_EXTENDED, _EXTENDED)
        speed = self._read(number, _VELOCITY_LIMIT) * _RPM / 60.0 * _COUNTS_PER_TURN
        acceleration = self._read(number, _ACCELERATION_LIMIT) * _RPM2 / 3600.0 * _COUNTS_PER_TURN
        self._unit_ma = 0.0 if model in _NO_CURRENT else _MA.get(model, _MA_OTHERS)
        current = self._read(number, _CURRENT_LIMIT) * self._unit_ma if self._unit_ma else 0.0
        limits = DriveLimits(low, high, speed, min(acceleration, _ACCELERATION * speed), current)
        firmware = str(self._read(number, _FIRMWARE))
        return Drive(number, f"model {model}", firmware, _COUNTS_PER_TURN, limits, True)

    # -- registers, while nothing moves ---------------------------------------------------------------------------

    def _read(self, number: int, register: tuple[int, int]) -> int:
        address, size = register
        data: list[int] = self._insist(number, lambda: self._packets.readTxRx(self._port, number, address, size))[0]
        return int.from_bytes(bytes(data), "little")

    def _write(self, number: int, register: tuple[int, int], value: int) -> None:
        address, size = register
        data = list(value.to_bytes(size, "little", signed=value < 0))
        answer = self._insist(number, lambda: self._packets.writeTxRx(self._port, number, address, size, data))
        if answer[-1] & 0x7F:
            why = self._packets.getRxPacketError(answer[-1] & 0x7F)
            raise TautError(f"dynamixel {number}: register {address} refused {value}: {why}")

    def _insist(self, number: int, ask: Any) -> Any:
        for left in reversed(range(_SETUP_TRIES)):
            try:
                answer = ask()
            except (serial.SerialException, OSError, TypeError) as error:
                raise TautError("the serial port is gone") from error
            if answer[-2] == COMM_SUCCESS:
                return answer
            if left == 0:
                why = self._packets.getTxRxResult(answer[-2])
                raise TautError(f"dynamixel {number} does not answer ({why}): check power, ID, baud rate and the plug")
        raise AssertionError

    # -- cycles ---------------------------------------------------------------------------------------------------

    def measure(self) -> list[Measured]:
        sent = self._clock()
        try:
            result = self._reading.txRxPacket()
        except (serial.SerialException, OSError, TypeError) as error:
            raise TautError("the serial port is gone") from error
        if result != COMM_SUCCESS:
            raise Missed(f"no answer ({self._packets.getTxRxResult(result)})")
        t_s = 0.5 * (sent + self._clock())
        self._look_for_errors()
        return [self._measured(number, i, t_s) for i, number in enumerate(self._numbers)]

    def _measured(self, number: int, axis: int, t_s: float) -> Measured:
        def value(offset: int, size: int) -> int:
            raw = int(self._reading.getData(number, _STATE + offset, size))
            return raw - (1 << 8 * size) if raw >> (8 * size - 1) else raw

        said = ", ".join(name for bit, name in _ERROR_BITS.items() if self._errors[axis] >> bit & 1)
        return Measured(
            t_s, float(value(6, 4)), value(2, 4) * _RPM / 60.0 * _COUNTS_PER_TURN, value(0, 2) * self._unit_ma, said
        )

    def _look_for_errors(self) -> None:
        """The hardware errors of one servo after the other, one each hundredth cycle."""
        self._asked += 1
        if self._asked % 100:
            return
        axis = self._asked // 100 % len(self._numbers)
        value, result, _ = self._packets.read1ByteTxRx(self._port, self._numbers[axis], _ERRORS[0])
        if result == COMM_SUCCESS:
            self._errors[axis] = value

    def set_positions(self, goals: Sequence[float | None]) -> None:
        self._writing.clearParam()
        for number, goal in zip(self._numbers, goals, strict=True):
            if goal is not None:
                self._writing.addParam(number, list(round(goal).to_bytes(4, "little", signed=True)))
        try:
            self._writing.txPacket()
        except (serial.SerialException, OSError, TypeError) as error:
            raise TautError("the serial port is gone") from error

    def enable(self, axis: int, on: bool) -> None:
        number = self._numbers[axis]
        if not on:
            self._write(number, _TORQUE, 0)
            self._write(number, _BUS_WATCHDOG, 0)
            return
        drive = self.drives[axis]
        here = self._insist(number, lambda: self._packets.read4ByteTxRx(self._port, number, 132))[0]
        self._write(number, _BUS_WATCHDOG, 0)  # clears one that has tripped
        self._write(number, _PROFILE_ACCELERATION, 0)  # the application plans; the servo's own profile would lag
        self._write(number, _PROFILE_VELOCITY, round(drive.limits.speed / _COUNTS_PER_TURN * 60.0 / _RPM))
        self._write(number, _TORQUE, 1)
        self._write(number, _GOAL, here - (1 << 32) if here >> 31 else here)
        self._write(number, _BUS_WATCHDOG, _WATCHDOG)

    def stop(self) -> None:
        for axis in range(len(self._numbers)):
            self.enable(axis, False)

    def close(self) -> None:
        self._port.closePort()
