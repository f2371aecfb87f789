"""Drives on a bus that speak the real bytes, written from the makers' manuals, and the bench that moves them in virtual
time beside the simulated instrument.

A drive is a position loop in first order with limits on speed and acceleration behind whole counts of its encoder.
"""

from __future__ import annotations

import contextlib
import os
import pty
import select
import struct
import threading
import time
import tty
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tautline.motors.hosted import HostedLink

_STEP_US = 1000
_SUB = 4


@dataclass
class Motor:
    """What turns. Positions in counts of its encoder."""

    position: float = 0.0
    lag_s: float = 0.012
    speed_most: float = 12000.0
    acceleration_most: float = 400000.0
    goal: float = 0.0
    on: bool = False
    held: bool = False
    speed: float = 0.0
    silent_s: float = 0.0  # since its bus said anything
    watchdog_s: float = 0.0  # after which it stops; 0: none
    tripped: bool = False
    goals: list[float] = field(default_factory=list)

    def heard(self) -> None:
        self.silent_s = 0.0

    def aim(self, goal: float) -> None:
        self.goal = goal
        self.goals.append(goal)

    def step(self) -> float:
        """A millisecond on; where it is then."""
        self.silent_s += 1e-3
        if self.on and self.watchdog_s and self.silent_s > self.watchdog_s:
            self.tripped = True
        dt = 1e-3 / _SUB
        for _ in range(_SUB):
            wanted = (self.goal - self.position) / self.lag_s if self.on and not self.tripped else 0.0
            wanted = min(max(wanted, -self.speed_most), self.speed_most)
            most = self.acceleration_most * dt
            self.speed += min(max(wanted - self.speed, -most), most)
            self.position += 0.0 if self.held else self.speed * dt
        return self.position

    @property
    def counts(self) -> int:
        return int(np.floor(self.position))


@dataclass
class Ills:
    """What is wrong with a bus: answers that are lost, late (they come with the next one) or damaged."""

    drop: float = 0.0
    delay: float = 0.0
    damage: float = 0.0
    pulled: bool = False
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))
    waiting: deque[bytes] = field(default_factory=deque)

    def through(self, answer: bytes) -> list[bytes]:
        """What arrives of it now."""
        if self.pulled:
            return []
        chance = self.rng.random()
        if chance < self.drop:
            return []
        if chance < self.drop + self.delay:
            self.waiting.append(answer)
            return []
        if chance < self.drop + self.delay + self.damage:
            spoilt = bytearray(answer)
            spoilt[len(spoilt) // 2] ^= 0x10
            answer = bytes(spoilt)
        late = list(self.waiting)  # behind what was asked later
        self.waiting.clear()
        return [answer, *late]


class SerialBus:
    """A pty with servos at its other end; `path` is what a driver opens."""

    def __init__(self, answer: Callable[[bytearray], Iterator[bytes]]) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path, self.ills = os.ttyname(self._slave), Ills()
        self._answer, self._buffer, self._busy = answer, bytearray(), False
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            while True:
                select.select([self._master], [], [])
                self._busy = True
                data = os.read(self._master, 4096)
                self._buffer += data if not self.ills.pulled else b""
                for answer in self._answer(self._buffer):
                    for piece in self.ills.through(answer):
                        os.write(self._master, piece)
                self._busy = False

    def settle(self) -> None:
        """Waits until all that was sent has been taken in: in virtual time a bus takes none."""
        while select.select([self._master], [], [], 0)[0] or self._busy:
            time.sleep(2e-5)

    def close(self) -> None:
        os.close(self._slave)  # what serves sees it, and ends
        with contextlib.suppress(OSError):
            os.close(self._master)


# -- Dynamixel, protocol 2 --------------------------------------------------------------------------------------------


def crc16(data: bytes) -> int:
    """CRC-16 of the manual: polynomial 0x8005, most significant bit first, from 0."""
    crc = 0
    for byte in data:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return crc


class DynamixelEmulator:
    """X series servos: a control table each, PING, READ, WRITE, SYNC READ and SYNC WRITE."""

    def __init__(self, motors: list[Motor]) -> None:
        self.motors = motors
        self.tables = [self._fresh(i) for i in range(len(motors))]
        self.bus = SerialBus(self._take)

    def _fresh(self, index: int) -> bytearray:
        table = bytearray(256)
        struct.pack_into("<H", table, 0, 1020)  # XM430-W350
        table[6], table[7], table[11] = 45, index + 1, 4
        struct.pack_into("<HII", table, 38, 1193, 0x7FFF, 1023)  # limits of current, acceleration, velocity
        struct.pack_into("<II", table, 48, 4095, 0)
        return table

    def _take(self, buffer: bytearray) -> Iterator[bytes]:
        while (start := buffer.find(b"\xff\xff\xfd\x00")) >= 0:
            del buffer[:start]
            if len(buffer) < 7 or len(buffer) < 7 + struct.unpack_from("<H", buffer, 5)[0]:
                return
            size = 7 + struct.unpack_from("<H", buffer, 5)[0]
            packet = bytes(buffer[:size])
            del buffer[:size]
            if crc16(packet[:-2]) == struct.unpack("<H", packet[-2:])[0]:
                yield from self._obey(packet[4], packet[7], packet[8:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd"))

    def _obey(self, number: int, instruction: int, given: bytes) -> Iterator[bytes]:
        for motor in self.motors:
            motor.heard()
        if instruction == 0x82:  # sync read
            address, size = struct.unpack_from("<HH", given)
            for one in given[4:]:
                if one <= len(self.motors):
                    yield self._status(one, self._read(one - 1, address, size))
        elif instruction == 0x83:  # sync write
            address, size = struct.unpack_from("<HH", given)
            for at in range(4, len(given), 1 + size):
                self._write(given[at] - 1, address, given[at + 1 : at + 1 + size])
        elif number <= len(self.motors):
            if instruction == 0x01:
                yield self._status(number, bytes(self.tables[number - 1][0:2]) + bytes([45]))
            elif instruction == 0x02:
                yield self._status(number, self._read(number - 1, *struct.unpack_from("<HH", given)))
            elif instruction == 0x03:
                yield self._status(number, b"", self._write(number - 1, struct.unpack_from("<H", given)[0], given[2:]))

    def _status(self, number: int, data: bytes, error: int = 0) -> bytes:
        inside = bytes([0x55, error]) + data
        inside = inside.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
        packet = b"\xff\xff\xfd\x00" + bytes([number]) + struct.pack("<H", len(inside) + 2) + inside
        return packet + struct.pack("<H", crc16(packet))

    def _read(self, index: int, address: int, size: int) -> bytes:
        motor, table = self.motors[index], self.tables[index]
        unit = 60.0 / 4096 / 0.229
        struct.pack_into("<hii", table, 126, 10, round(motor.speed * unit), motor.counts)
        return bytes(table[address : address + size])

    def _write(self, index: int, address: int, data: bytes) -> int:
        motor, table = self.motors[index], self.tables[index]
        if address == 116 and motor.tripped:
            return 0x04  # data range: the bus watchdog has tripped
        if address < 64 and table[64]:
            return 0x07  # access: the EEPROM while torque is on
        table[address : address + len(data)] = data
        motor.on = bool(table[64])
        if address == 98:
            motor.watchdog_s, motor.tripped = 0.02 * data[0], False
        if address == 116 and motor.on:
            motor.aim(float(struct.unpack("<i", data)[0]))
        if address == 64 and motor.on:
            motor.goal = motor.position
        return 0

    def close(self) -> None:
        self.bus.close()


# -- the bench --------------------------------------------------------------------------------------------------------


class Bench:
    """Drives in virtual time. It answers as a sim link does, so that the package's simulated axis stands behind it."""

    def __init__(self, motors: list[Motor], settle: Callable[[], None]) -> None:
        self.motors, self.us, self._settle = motors, 0, settle
        self.link: HostedLink | None = None
        self._due_us = 0.0

    def clock(self) -> float:
        return self.us * 1e-6

    def serve(self, link: HostedLink) -> None:
        self.link, self._due_us = link, self.us + 1e6 * link.period_s

    def ask(self, request: str) -> dict[str, Any]:
        if request == "state":
            return {"t_us": self.us, "board_us": self.us, "q": [round(m.position * 256) for m in self.motors]}
        verb, amount = request.split()
        assert verb == "advance" and self.link is not None
        log: list[list[float]] = [[] for _ in self.motors]
        for _ in range(int(amount) // _STEP_US):
            self.us += _STEP_US
            for motor, places in zip(self.motors, log, strict=True):
                places.append(motor.step() * 256.0)
            if self.us >= self._due_us:
                self._due_us += 1e6 * self.link.period_s
                self.link.cycle()
                self._settle()
        return {"t_us": self.us, "dt_us": _STEP_US, "q": log}

    def close(self) -> None:
        """Nothing is held."""
