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
import uuid
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import can
import numpy as np

from tautline.drivers.hosted import HostedLink

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
    speed: float = 0.0
    ramp: float = 0.0  # of the goal, a millisecond, for so long
    ramp_ms: int = 0
    onwards: float = 0.0
    silent_s: float = 0.0  # since its bus said anything
    watchdog_s: float = 0.0  # after which it stops; 0: none
    tripped: bool = False
    tripped_ms: int = 0  # of its course, when it tripped last
    goals: list[float] = field(default_factory=list)
    course: list[float] = field(default_factory=list)  # each millisecond

    def heard(self) -> None:
        self.silent_s = 0.0

    def aim(self, goal: float, within_s: float = 0.0, onwards: float = 0.0) -> None:
        """`within_s`: in a straight line until then; `onwards`: and with that speed after it, counts/s."""
        self.ramp_ms = max(round(1e3 * within_s), 1)
        self.ramp, self.onwards = (goal - self.goal) / self.ramp_ms, onwards
        self.goals.append(goal)

    def rest(self) -> None:
        """The goal is where it is."""
        self.goal, self.ramp_ms, self.onwards = self.position, 0, 0.0

    def step(self) -> None:
        """A millisecond on."""
        self.silent_s += 1e-3
        if self.on and self.watchdog_s and self.silent_s > self.watchdog_s and not self.tripped:
            self.tripped, self.tripped_ms = True, len(self.course)
        self.goal += self.ramp if self.ramp_ms > 0 else 1e-3 * self.onwards
        self.ramp_ms -= 1
        dt = 1e-3 / _SUB
        for _ in range(_SUB):
            wanted = (self.goal - self.position) / self.lag_s if self.on and not self.tripped else 0.0
            wanted = min(max(wanted, -self.speed_most), self.speed_most)
            most = self.acceleration_most * dt
            self.speed += min(max(wanted - self.speed, -most), most)
            self.position += self.speed * dt
        self.course.append(self.position)

    @property
    def counts(self) -> int:
        return int(np.floor(self.position))


@dataclass
class Ills:
    """What is wrong with a bus: answers that are lost, late (they come with the next one) or damaged, and set-points
    that are lost on their way out."""

    drop: float = 0.0
    delay: float = 0.0
    damage: float = 0.0
    lose: float = 0.0
    pulled: bool = False
    lost: list[int] = field(default_factory=lambda: [0])  # set-points one after another, each time
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(4))
    waiting: deque[Any] = field(default_factory=deque)

    def through(self, answer: Any) -> list[Any]:
        """What arrives of it now, as long as nothing is damaged."""
        chance = self.rng.random()
        if self.pulled or chance < self.drop:
            return []
        if chance < self.drop + self.delay:
            self.waiting.append(answer)
            return []
        late = list(self.waiting)  # behind what was asked later
        self.waiting.clear()
        return [answer, *late]

    def loses(self) -> bool:
        """Whether a set-point does not arrive."""
        if not self.lose or self.rng.random() >= self.lose:
            self.lost.append(0)
            return False
        self.lost[-1] += 1
        return True

    def spoilt(self, answer: bytes) -> bytes:
        if self.rng.random() >= self.damage:
            return answer
        at = int(self.rng.integers(len(answer)))
        return answer[:at] + bytes([answer[at] ^ 0x10]) + answer[at + 1 :]


class SerialBus:
    """A pty with servos at its other end; `path` is what a driver opens."""

    def __init__(self, answer: Callable[[bytearray], Iterator[bytes]]) -> None:
        self._master, self._slave = pty.openpty()
        tty.setraw(self._slave)
        self.path, self.ills = os.ttyname(self._slave), Ills()
        self._answer, self._buffer, self._busy = answer, bytearray(), False
        self._ended, self._end = os.pipe()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError, ValueError):
            while True:
                if self._ended in select.select([self._master, self._ended], [], [])[0]:
                    return
                self._busy = True
                data = os.read(self._master, 4096)
                self._buffer += data if not self.ills.pulled else b""
                for answer in self._answer(self._buffer):
                    for piece in self.ills.through(answer):
                        os.write(self._master, self.ills.spoilt(piece))
                self._busy = False

    def settle(self) -> None:
        """Waits until all that was sent has been taken in: in virtual time a bus takes none."""
        while select.select([self._master], [], [], 0)[0] or self._busy:
            time.sleep(2e-5)

    def close(self) -> None:
        os.write(self._end, b"x")
        self._thread.join()  # else it would wait on a number that is another bus' by then, and take its bytes
        for end in (self._slave, self._master, self._ended, self._end):
            os.close(end)


def _tell(table: bytearray, told: dict[int, bytes] | None) -> None:
    for address, data in (told or {}).items():
        table[address : address + len(data)] = data


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
    """X series servos: a control table each, PING, READ, WRITE, SYNC READ and SYNC WRITE. Another program has left them
    a slow profile. `told`: what stands in the first one's table, from these addresses on."""

    def __init__(self, motors: list[Motor], told: dict[int, bytes] | None = None) -> None:
        self.motors, self._most = motors, [(motor.speed_most, motor.acceleration_most) for motor in motors]
        self.tables = [self._fresh(i) for i in range(len(motors))]
        _tell(self.tables[0], told)
        self.bus = SerialBus(self._take)

    def _fresh(self, index: int) -> bytearray:
        table = bytearray(256)
        struct.pack_into("<H", table, 0, 1020)  # XM430-W350
        table[6], table[7], table[11] = 45, index + 1, 4
        struct.pack_into("<HII", table, 38, 1193, 0x7FFF, 1023)  # limits of current, acceleration, velocity
        struct.pack_into("<II", table, 48, 4095, 0)
        struct.pack_into("<II", table, 108, 5, 20)  # profiles of acceleration and velocity
        return table

    def fail(self) -> None:
        self.tables[0][70] = 0x20  # overload

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
        if address == 116 and self.bus.ills.loses():
            return 0
        if address == 116 and motor.tripped:
            return 0x04  # data range: the bus watchdog has tripped
        if address < 64 and table[64]:
            return 0x07  # access: the EEPROM while torque is on
        table[address : address + len(data)] = data
        motor.on = bool(table[64])
        acceleration, speed = struct.unpack_from("<II", table, 108)  # 0: no profile
        motor.speed_most = min(self._most[index][0], speed * 0.229 / 60.0 * 4096 or np.inf)
        motor.acceleration_most = min(self._most[index][1], acceleration * 214.577 / 3600.0 * 4096 or np.inf)
        if address == 98:
            motor.watchdog_s, motor.tripped = 0.02 * data[0], False
        if address == 116 and motor.on:
            motor.aim(float(struct.unpack("<i", data)[0]))
        if address == 64 and motor.on:
            motor.rest()
        return 0

    def close(self) -> None:
        self.bus.close()


# -- Feetech STS ------------------------------------------------------------------------------------------------------


class FeetechEmulator:
    """STS servos: a memory table each, READ, WRITE, SYNC READ and SYNC WRITE. Signs are in bit 15. Another program has
    left them a slow way to go. `told`: as of a Dynamixel."""

    def __init__(self, motors: list[Motor], told: dict[int, bytes] | None = None) -> None:
        self.motors, self._most = motors, [(motor.speed_most, motor.acceleration_most) for motor in motors]
        self.tables = [self._fresh(i) for i in range(len(motors))]
        _tell(self.tables[0], told)
        self.bus = SerialBus(self._take)

    def _fresh(self, index: int) -> bytearray:
        table = bytearray(96)
        table[0:2], table[3:5], table[5] = b"\x03\x09", struct.pack("<H", 777), index + 1
        struct.pack_into("<BHHH", table, 41, 10, 0, 800, 300)  # its own acceleration, goal, time and speed
        struct.pack_into("<H", table, 69, self._with_sign(-20))  # current
        return table

    def fail(self) -> None:
        self.tables[0][65] = 0x20  # overload

    def _take(self, buffer: bytearray) -> Iterator[bytes]:
        while (start := buffer.find(b"\xff\xff")) >= 0:
            del buffer[:start]
            if len(buffer) < 4 or len(buffer) < 4 + buffer[3]:
                return
            packet = bytes(buffer[: 4 + buffer[3]])
            del buffer[: len(packet)]
            if ~sum(packet[2:-1]) & 0xFF == packet[-1]:
                yield from self._obey(packet[2], packet[4], packet[5:-1])

    def _obey(self, number: int, instruction: int, given: bytes) -> Iterator[bytes]:
        if instruction == 0x82:
            for one in given[2:]:
                if one <= len(self.motors):
                    yield self._status(one, self._read(one - 1, given[0], given[1]))
        elif instruction == 0x83:
            for at in range(2, len(given), 1 + given[1]):
                self._write(given[at] - 1, given[0], given[at + 1 : at + 1 + given[1]])
        elif number <= len(self.motors):
            if instruction == 0x02:
                yield self._status(number, self._read(number - 1, given[0], given[1]))
            elif instruction == 0x03:
                self._write(number - 1, given[0], given[1:])
                yield self._status(number, b"")

    def _status(self, number: int, data: bytes) -> bytes:
        """Each answer begins with the servo's state."""
        inside = bytes([number, len(data) + 2, self.tables[number - 1][65]]) + data
        return b"\xff\xff" + inside + bytes([~sum(inside) & 0xFF])

    @staticmethod
    def _with_sign(value: int) -> int:
        return -value | 0x8000 if value < 0 else value

    def _read(self, index: int, address: int, size: int) -> bytes:
        motor, table = self.motors[index], self.tables[index]
        struct.pack_into("<HH", table, 56, self._with_sign(motor.counts), self._with_sign(round(motor.speed)))
        return bytes(table[address : address + size])

    def _write(self, index: int, address: int, data: bytes) -> None:
        motor, table = self.motors[index], self.tables[index]
        was = motor.on
        if address == 42 and was and self.bus.ills.loses():
            return
        table[address : address + len(data)] = data
        motor.on = bool(table[40])
        acceleration, raw, time_ms, speed = struct.unpack_from("<BHHH", table, 41)  # 0: as it can
        motor.speed_most = min(self._most[index][0], speed or np.inf)
        motor.acceleration_most = min(self._most[index][1], 100.0 * acceleration or np.inf)
        if address == 42:
            goal = float(-(raw & 0x7FFF) if raw & 0x8000 else raw)
            motor.aim(goal, 1e-3 * time_ms) if motor.on else setattr(motor, "goal", goal)
        assert was or not motor.on or abs(motor.goal - motor.position) < 4.0, "torque on far from the goal"

    def close(self) -> None:
        self.bus.close()


# -- CANopen, CiA 402 -------------------------------------------------------------------------------------------------


class CanBus:
    """A virtual CAN bus with a thread that answers; what it was asked is answered in turn."""

    _MARK = 0x7FE

    def __init__(self, answer: Callable[[can.Message], Iterator[can.Message]], fd: bool = False) -> None:
        self.channel, self.ills = f"bench-{uuid.uuid4().hex[:8]}", Ills()
        self._answer, self._marked, self._done = answer, threading.Semaphore(0), False
        self._bus = can.Bus(interface="virtual", channel=self.channel, fd=fd)
        self._marker = can.Bus(interface="virtual", channel=self.channel, fd=fd)
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while not self._done:
            message = self._bus.recv(0.2)
            if message is None:
                continue
            if message.arbitration_id == self._MARK:
                self._marked.release()
            elif not self.ills.pulled:
                for answer in self._answer(message):
                    for piece in self.ills.through(answer):  # none is damaged: CAN has a check of its own
                        self._bus.send(piece)

    def settle(self) -> None:
        """Waits until all that was sent has been taken in."""
        self._marker.send(can.Message(arbitration_id=self._MARK, is_extended_id=False))
        assert self._marked.acquire(timeout=5.0)

    def close(self) -> None:
        self._done = True
        self._thread.join()
        self._bus.shutdown()
        self._marker.shutdown()


class Cia402Emulator:
    """Drives with an object dictionary, expedited SDOs, two PDOs each way, NMT, SYNC and a heartbeat consumer."""

    _SWITCHES = 3  # objects that are read before another mode is the drive's

    def __init__(
        self,
        motors: list[Motor],
        turn: int = 4096,
        homed: bool = False,
        modes: tuple[int, ...] = (6, 8),
        currents: tuple[int, ...] = (1500, 1500),
        lacks: tuple[int, ...] = (),
    ) -> None:
        """currents: the most of each, in 1/1000 of what it is rated for; lacks: objects that it has not."""
        self.motors, self._homed, self._modes = motors, homed, modes
        self.nodes = [self._fresh(turn, current) for _, current in zip(motors, currents, strict=False)]
        for node in self.nodes:
            for index in lacks:
                del node["objects"][index, 0]
        self.brakes: Callable[[], bool] = lambda: False  # whether a brake is not released yet, at each look at a status
        self.bus = CanBus(self._take)

    def _fresh(self, turn: int, current: int) -> dict[str, Any]:
        objects = {
            (0x1008, 0): (4, b"EMUL"), (0x608F, 1): (4, turn), (0x608F, 2): (4, 1), (0x6080, 0): (4, 180),
            (0x60C5, 0): (4, 300000), (0x607D, 1): (4, -20000), (0x607D, 2): (4, 20000), (0x6075, 0): (4, 1000),
            (0x6073, 0): (2, current), (0x6040, 0): (2, 0), (0x6041, 0): (2, 0x40), (0x6060, 0): (1, 8),
            (0x6061, 0): (1, 8),
            (0x6064, 0): (4, 0), (0x607A, 0): (4, 0), (0x606C, 0): (4, 0), (0x6078, 0): (2, -250), (0x60C2, 1): (1, 1),
            (0x60C2, 2): (1, -3), (0x1016, 1): (4, 0), (0x6007, 0): (2, 0),
        }  # fmt: skip
        for mapping, parameters in ((0x1A00, 0x1800), (0x1A01, 0x1801), (0x1600, 0x1400)):
            objects |= {(mapping, i): (1 if i == 0 else 4, 0) for i in range(4)}
            objects |= {(parameters, 1): (4, 0), (parameters, 2): (1, 0)}
        return {"objects": objects, "operational": False, "target": None, "switches": 0}

    def fail(self) -> None:
        self.nodes[0]["objects"][0x6041, 0], self.motors[0].on = (2, 0x08), False

    def _take(self, message: can.Message) -> Iterator[can.Message]:
        cob, data = message.arbitration_id, bytes(message.data)
        for i, (motor, node) in enumerate(zip(self.motors, self.nodes, strict=True)):
            number, objects = i + 1, node["objects"]
            watched = objects[0x1016, 1][1]
            if cob == 0x700 + (watched >> 16 & 0x7F) and watched:
                motor.watchdog_s = (watched & 0xFFFF) * 1e-3 if objects[0x6007, 0][1] == 3 else 0.0  # a quick stop
                motor.heard()
            if cob == 0 and data[1] in (0, number):
                node["operational"] = data[0] == 0x01
            elif cob == 0x600 + number:
                yield self._message(0x580 + number, self._sdo(motor, node, data))
            elif cob == 0x80 and node["operational"]:
                if node["target"] is not None:
                    control, target = node["target"]
                    self._control(motor, node, control)
                    if motor.on and objects[0x6060, 0][1] == 8:
                        motor.aim(float(target), objects[0x60C2, 1][1] * 10.0 ** objects[0x60C2, 2][1])
                    node["target"] = None
                yield from self._process_data(motor, node, number)
            elif cob == objects[0x1400, 1][1] and node["operational"] and not self.bus.ills.loses():
                assert [objects[0x1600, k][1] for k in range(3)] == [2, 0x60400010, 0x607A0020]
                assert objects[0x1400, 2][1] == 1  # taken at the next SYNC
                node["target"] = struct.unpack("<Hi", data)

    @staticmethod
    def _message(cob: int, data: bytes) -> can.Message:
        return can.Message(arbitration_id=cob, data=data, is_extended_id=False)

    def _process_data(self, motor: Motor, node: dict[str, Any], number: int) -> Iterator[can.Message]:
        objects = node["objects"]
        self._measure(motor, objects)
        for mapping, parameters in ((0x1A01, 0x1801), (0x1A00, 0x1800)):
            data = b""
            for k in range(objects[mapping, 0][1]):
                entry = objects[mapping, k + 1][1]
                size, value = objects[entry >> 16, entry >> 8 & 0xFF]
                data += value.to_bytes(size, "little", signed=value < 0)
            if data and objects[parameters, 2][1] == 1:
                yield self._message(objects[parameters, 1][1] & 0x7FF, data)

    def _measure(self, motor: Motor, objects: dict[tuple[int, int], tuple[int, Any]]) -> None:
        objects[0x6064, 0] = 4, motor.counts
        if (0x606C, 0) in objects:
            objects[0x606C, 0] = 4, round(motor.speed)

    def _control(self, motor: Motor, node: dict[str, Any], control: int) -> None:
        """The states of CiA 402 as far as a host sees them."""
        objects = node["objects"]
        state = objects[0x6041, 0][1]
        if motor.tripped and control & 0x80:
            motor.tripped, state = False, 0x40
        elif control & 0x0F == 0x06 and state in (0x40, 0x23, 0x27):
            state = 0x21
        elif control & 0x0F == 0x07 and state in (0x21, 0x27):
            state = 0x23
        elif control & 0x0F == 0x0F and state == 0x23:
            state = 0x27
            motor.rest()
            node["target"] = control, objects[0x607A, 0][1]  # until a set-point comes
        elif control & 0x02 == 0:
            state = 0x40
        objects[0x6041, 0] = 2, state
        motor.on = state == 0x27

    def _sdo(self, motor: Motor, node: dict[str, Any], data: bytes) -> bytes:
        command, index, sub = struct.unpack_from("<BHB", data)
        objects = node["objects"]
        if (index, sub) not in objects:
            return struct.pack("<BHBI", 0x80, index, sub, 0x06020000)
        self._measure(motor, objects)
        node["switches"] -= 1
        if node["switches"] <= 0:
            objects[0x6061, 0] = 1, objects[0x6060, 0][1]
        size, value = objects[index, sub]
        if (index, sub) == (0x6041, 0) and value == 0x27 and self.brakes():
            value = 0x23
        if (index, sub) == (0x6041, 0):  # bit 12: homing attained, or that the command is followed
            value |= 0x1000 if objects[0x6061, 0][1] != 6 or self._homed else 0
        if command == 0x40:
            raw = value if isinstance(value, bytes) else value.to_bytes(size, "little", signed=value < 0)
            return struct.pack("<BHB", 0x43 | (4 - len(raw)) << 2, index, sub) + raw.ljust(4, b"\0")
        signed = index in (0x607A, 0x607D, 0x60C2)
        given = int.from_bytes(data[4 : 4 + size], "little", signed=signed)
        if index in (0x1600, 0x1A00, 0x1A01) and sub and (given >> 16, given >> 8 & 0xFF) not in objects:
            return struct.pack("<BHBI", 0x80, index, sub, 0x06020000)
        if (index, sub) == (0x6040, 0):
            self._control(motor, node, given)
        if (index, sub) == (0x6060, 0):
            if given not in self._modes:
                return struct.pack("<BHBI", 0x80, index, sub, 0x06090030)
            node["switches"] = self._SWITCHES
        objects[index, sub] = size, given
        return struct.pack("<BHBI", 0x60, index, sub, 0)

    def close(self) -> None:
        self.bus.close()


# -- moteus -----------------------------------------------------------------------------------------------------------


class MoteusEmulator:
    """Controllers with registers behind the multiplex protocol, and the position watchdog."""

    _SIZES, _POSITION = (1, 2, 4, 4), b"\x01\x00\x0a"  # begins with mode 10
    _SCALES: ClassVar = {0x001: (0.01, 1e-4, 1e-5), 0x002: (0.1, 2.5e-4, 1e-5), 0x004: (1.0, 0.1, 1e-3)}

    def __init__(self, motors: list[Motor], turn: int = 4096, home_state: int = 2) -> None:
        """home_state: 0 relative, 1 the rotor is known, 2 the output."""
        self.motors, self._turn, self._home_state = motors, turn, home_state
        self.modes = [0 for _ in motors]
        self.sees = True  # its encoder
        self.bus = CanBus(self._take, fd=True)

    def fail(self) -> None:
        self.modes[0], self.motors[0].on = 1, False

    def _take(self, message: can.Message) -> Iterator[can.Message]:
        index = (message.arbitration_id & 0x7F) - 1
        if not 0 <= index < len(self.motors):
            return
        if bytes(message.data[:3]) == self._POSITION and self.bus.ills.loses():
            return
        reply = self._obey(index, bytes(message.data))
        if message.arbitration_id & 0x8000:
            length = next(n for n in (*range(9), 12, 16, 20, 24, 32, 48, 64) if n >= len(reply))
            cob = (index + 1) << 8 | message.arbitration_id >> 8 & 0x7F
            data = reply.ljust(length, b"\x50")
            yield can.Message(arbitration_id=cob, data=data, is_fd=True, is_extended_id=cob > 0x7FF)

    def _obey(self, index: int, data: bytes) -> bytes:
        reply, at, written = b"", 0, {}
        while at < len(data) and data[at] != 0x50:
            command, kind, count = data[at] & 0xF0, data[at] >> 2 & 3, data[at] & 3
            at += 1
            if count == 0:
                count, at = data[at], at + 1
            register, at = data[at], at + 1
            size = self._SIZES[kind]
            if command == 0x00:
                for k in range(count):
                    written[register + k] = struct.unpack_from("<" + "bhif"[kind], data, at)[0]
                    at += size
            elif command == 0x10:
                reply += bytes([0x20 | kind << 2 | (count if count < 4 else 0)])
                reply += (bytes([count]) if count >= 4 else b"") + bytes([register])
                for k in range(count):
                    reply += self._value(index, register + k, kind)
        self._written(index, written)
        return reply

    def _value(self, index: int, register: int, kind: int) -> bytes:
        motor = self.motors[index]
        self.modes[index] = 11 if motor.tripped else self.modes[index]
        value = {
            0x000: self.modes[index], 0x001: motor.counts / self._turn if self.sees else np.nan,
            0x002: motor.speed / self._turn, 0x004: 0.1, 0x00C: self._home_state, 0x00D: 24,
        }.get(register, 0)  # fmt: skip
        if kind == 3:
            return struct.pack("<f", value)
        return struct.pack("<" + "bhi"[kind], round(value / self._SCALES.get(register, (1.0, 1.0, 1.0))[kind]))

    def _written(self, index: int, written: dict[int, float]) -> None:
        motor = self.motors[index]
        mode = written.get(0x000)
        assert written.keys() <= {0x000, 0x020, 0x021, 0x027}, "its own limits and gains give way to what it is told"
        if mode == 0:
            self.modes[index], motor.on, motor.tripped = 0, False, False
        elif mode == 10 and self.modes[index] in (0, 10) and not motor.tripped:
            if self.modes[index] == 0:
                motor.rest()
            self.modes[index], motor.on, motor.watchdog_s = 10, True, written[0x027]
            motor.heard()
            motor.aim(written[0x020] * self._turn, onwards=written[0x021] * self._turn)

    def close(self) -> None:
        self.bus.close()


# -- the bench --------------------------------------------------------------------------------------------------------


class Bench:
    """Drives in virtual time. It answers as a sim link does, so that the package's simulated axis stands behind it."""

    def __init__(self, motors: list[Motor], settle: Callable[[], None]) -> None:
        self.motors, self.us, self._settle = motors, 0, settle
        self.link: HostedLink | None = None
        self.late_us: Callable[[], float] = lambda: 0.0  # by which a cycle comes too late
        self._due_us = self._late_us = 0.0

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
                motor.step()
                places.append(motor.position * 256.0)
            if self.us >= self._due_us + self._late_us:
                self._due_us += 1e6 * self.link.period_s
                self._late_us = self.late_us()
                self.link.cycle()
                self._settle()
        return {"t_us": self.us, "dt_us": _STEP_US, "q": log}

    def close(self) -> None:
        """Nothing is held."""
