"""CANopen drives of profile CiA 402 in cyclic synchronous position mode, on any bus that python-can knows.

A cycle is a SYNC, which the drives answer with where they are, and a set-point for each, which they take at the next
SYNC and go to within a cycle. A count is the drive's own position unit, an increment of its encoder.
"""

from __future__ import annotations

import contextlib
import struct
import threading
import time
from collections.abc import Callable, Sequence

import can
import canopen
from canopen.sdo.exceptions import SdoAbortedError, SdoError

from tautline.drivers.drives import RANGE, STARTS, Clock, Drive, DriveLimits, Goal, Measured, Missed, all_off
from tautline.errors import TautError

BAUD, RATE_HZ = 1_000_000, 250.0
_ANSWER_S = 0.01  # tolerance: of all drives to a SYNC
_SDO_S = 0.3  # tolerance: of a drive, about an object
_STATE_S = 1.0  # tolerance: of a drive, to change its state or mode
_HOST, _HEARTBEAT_S, _LOST_MS = 0x7F, 0.02, 100  # the host's node id; its heartbeat's period; when it is missed
_PRE_OPERATIONAL, _START = 0x80, 0x01  # of network management
_CSP, _HOMING = 8, 6
_QUICK_STOP = 3  # of the option for a lost connection
_FAULT, _VOLTAGE_OFF, _SHUT_DOWN, _SWITCH_ON, _OPERATE = 0x80, 0x00, 0x06, 0x07, 0x0F
_READY, _ON, _OPERATIONAL = 0x21, 0x23, 0x27
_PERIOD_MOST = 255  # format: of a cycle, ms or 0.1 ms: in one byte
_STARTS_MOST = 40.0  # tolerance: 1/s, acceleration over top speed: none is used that takes less than 25 ms to it

# Objects of CiA 301 and 402.
_DEVICE, _HARDWARE, _SOFTWARE = (0x1008, 0), (0x1009, 0), (0x100A, 0)
_CONSUMER, _ON_LOSS = (0x1016, 1), (0x6007, 0)
_CONTROL, _STATUS, _POSITION = (0x6040, 0), (0x6041, 0), (0x6064, 0)
_MODE, _MODE_NOW = (0x6060, 0), (0x6061, 0)
_TARGET, _VELOCITY, _CURRENT = (0x607A, 0), (0x606C, 0), (0x6078, 0)
_LOW, _HIGH, _MOTOR_RPM = (0x607D, 1), (0x607D, 2), (0x6080, 0)
_ACCELERATION_MOST, _RATED_MA, _CURRENT_MOST = (0x60C5, 0), (0x6075, 0), (0x6073, 0)
_INCREMENTS, _REVOLUTIONS, _PERIOD, _PERIOD_POWER = (0x608F, 1), (0x608F, 2), (0x60C2, 1), (0x60C2, 2)


class Cia402:
    """CiA 402 drives on one CAN bus, as `Drives` (drives.py). node: a drive's id on the bus, 1 to 126."""

    watchdog = "the drives' own: the host's heartbeat is missed, then a quick stop"
    rest_s = _LOST_MS * 1e-3
    enable_s = 3.0 * _STATE_S  # for three states: ready, on, and operational, in which a brake is released

    def __init__(
        self, bus: str, numbers: Sequence[int], baud: int, rate_hz: float, clock: Clock = time.monotonic
    ) -> None:
        """Opens the bus and configures every drive for cyclic positions. bus: python-can's INTERFACE/CHANNEL; numbers:
        node ids; baud: bit/s; rate_hz: of the SYNCs. TautError where the bus cannot be opened, or a drive does not
        answer."""
        self._clock, self._numbers = clock, list(numbers)
        interface, _, channel = bus.partition("/")
        self._network = canopen.Network()
        self._answered = threading.Condition()
        self._positions: dict[int, tuple[int, int]] = {}  # by node id: status word, counts
        self._unanswered = dict.fromkeys(self._numbers, 0)  # SYNCs so far whose answer has not come
        self._speeds: dict[int, tuple[int, int]] = {}  # by node id: counts/s, share of the rated current in 1/1000
        self._rated_ma: dict[int, float] = {}  # by node id: its rated current
        self._beat_s = float("-inf")  # when the last heartbeat was sent, s of the clock
        try:
            self._network.connect(interface=interface, channel=channel, bitrate=baud)
        except (can.CanError, OSError, ValueError, NotImplementedError) as error:
            raise TautError(
                f"canopen:{bus}: cannot be opened ({error}): check adapter, channel and bit rate"
            ) from error
        try:
            objects = canopen.ObjectDictionary()  # type: ignore[no-untyped-call]
            self._nodes = {n: self._network.add_node(n, objects) for n in self._numbers}
            self.drives = [self._configure(node, 1.0 / rate_hz) for node in self._numbers]
        except BaseException:
            self._network.disconnect()
            raise

    # -- objects, while nothing moves -----------------------------------------------------------------------------

    def _read(self, node: int, index: tuple[int, int]) -> bytes:
        """Reads a drive's object (index, subindex) by SDO: its bytes, little-endian."""
        return self._retry(node, index, lambda: self._nodes[node].sdo.upload(*index))

    def _write(self, node: int, index: tuple[int, int], value: int, size: int) -> None:
        """Writes a number as `size` bytes to a drive's object (index, subindex)."""
        data = value.to_bytes(size, "little", signed=value < 0)
        self._retry(node, index, lambda: self._nodes[node].sdo.download(*index, data))

    def _retry(self, node: int, index: tuple[int, int], ask: Callable[[], bytes]) -> bytes:
        """Calls `ask`, an SDO transfer of the object `index` with the node of this id, with canopen's own time-out and
        retries set for it. _Refused where the drive refuses it, TautError where it does not answer."""
        self._nodes[node].sdo.RESPONSE_TIMEOUT, self._nodes[node].sdo.MAX_RETRIES = _SDO_S, 3
        try:
            return ask()
        except SdoAbortedError as error:
            raise _Refused(f"canopen {node}: object {index[0]:04X}h:{index[1]} is refused ({error})") from error
        except (SdoError, can.CanError) as error:
            raise TautError(f"canopen {node} does not answer ({error}): check power, node id and bit rate") from error

    def _read_number(self, node: int, index: tuple[int, int], otherwise: float | None = None) -> float:
        """Reads a number, unsigned but for the position limits, from the drive's object dictionary. Where the drive has
        no such object: returns `otherwise`, or raises _Refused if that is None."""
        try:
            data = self._read(node, index)
        except _Refused:
            if otherwise is None:
                raise
            return otherwise
        return int.from_bytes(data, "little", signed=index in (_LOW, _HIGH))

    def _read_text(self, node: int, index: tuple[int, int]) -> str:
        """Reads a text from the drive's object dictionary; "" where it has no such object."""
        try:
            return self._read(node, index).decode("ascii", "replace").strip("\0 ")
        except _Refused:
            return ""

    def _configure(self, node: int, period_s: float) -> Drive:
        """Configures a drive for cyclic synchronous positions with this period, starts its node, and returns its
        description. TautError where it cannot have this period, or lacks an object that is needed."""
        self._set_network_state(node, _PRE_OPERATIONAL)  # the state in which process data can be mapped
        counts_per_turn, limits = self._read_limits(node)
        answer, rest = [(*_STATUS, 16), (*_POSITION, 32)], [(*_VELOCITY, 32), (*_CURRENT, 16)]
        told = [(*_CONTROL, 16), (*_TARGET, 32)]
        self._map_process_data(node, mapping=0x1A00, parameters=0x1800, cob=0x180, objects=answer)  # TPDO 1
        with contextlib.suppress(_Refused):  # a drive that lacks speed or current sends neither
            self._map_process_data(node, mapping=0x1A01, parameters=0x1801, cob=0x280, objects=rest)  # TPDO 2
        self._map_process_data(node, mapping=0x1600, parameters=0x1400, cob=0x200, objects=told)  # RPDO 1
        self._set_period(node, period_s)
        self._write(node, _CONSUMER, _HOST << 16 | _LOST_MS, 4)  # watches the host's heartbeat
        self._write(node, _ON_LOSS, _QUICK_STOP, 2)
        homed = self._is_homed(node)
        self._write(node, _MODE, _CSP, 1)  # after `_is_homed`, which leaves another mode
        self._network.subscribe(0x180 + node, self._on_position)
        self._network.subscribe(0x280 + node, self._on_speed)
        self._set_network_state(node, _START)
        model = self._read_text(node, _DEVICE) or "CiA 402"
        versions = " ".join(filter(None, (self._read_text(node, _HARDWARE), self._read_text(node, _SOFTWARE))))
        return Drive(node, model, versions or "-", round(counts_per_turn), limits, referenced=homed)

    def _read_limits(self, node: int) -> tuple[float, DriveLimits]:
        """Reads a drive's counts per turn and its limits: counts, counts/s, counts/s2, mA. Without position limits they
        are +-RANGE; acceleration is at most _STARTS_MOST times the speed a second, and STARTS times it where the drive
        limits none. Keeps the rated current, mA, for `measure`."""
        counts_per_turn = self._read_number(node, _INCREMENTS) / max(self._read_number(node, _REVOLUTIONS, 1.0), 1.0)
        speed = self._read_number(node, _MOTOR_RPM) / 60.0 * counts_per_turn
        acceleration = self._read_number(node, _ACCELERATION_MOST, 0.0) or STARTS * speed
        acceleration = min(acceleration, _STARTS_MOST * speed)
        low, high = self._read_number(node, _LOW, 0.0), self._read_number(node, _HIGH, 0.0)
        if low >= high:
            low, high = -RANGE, RANGE
        self._rated_ma[node] = self._read_number(node, _RATED_MA, 0.0)
        current_ma = self._rated_ma[node] * self._read_number(node, _CURRENT_MOST, 0.0) / 1000.0
        return counts_per_turn, DriveLimits(max(low, -RANGE), min(high, RANGE), speed, acceleration, current_ma)

    def _set_period(self, node: int, period_s: float) -> None:
        """Tells a drive the time between SYNCs as a whole number of ms, else of 0.1 ms, in one byte. TautError where
        that cannot hold this period."""
        power = -3 if abs(period_s * 1e3 - round(period_s * 1e3)) < 1e-6 else -4  # whole ms, else 0.1 ms
        units = round(period_s * 10**-power)
        if abs(period_s * 10**-power - units) > 1e-6 or units > _PERIOD_MOST:
            says = f"canopen: a cycle of {1e3 * period_s:.4g} ms cannot be told: name a rate of whole ms up to "
            raise TautError(f"{says}{_PERIOD_MOST}, or of whole 0.1 ms up to {0.1 * _PERIOD_MOST:g}")
        self._write(node, _PERIOD, units, 1)
        self._write(node, _PERIOD_POWER, power, 1)

    def _is_homed(self, node: int) -> bool:
        """Whether the drive has been homed: bit 12 of the status in homing mode (in other modes it means something
        else). False for a drive that does not enter this mode within _STATE_S. The drive is left in homing mode: the
        caller sets _CSP, in which it is used, afterwards."""
        try:
            self._write(node, _MODE, _HOMING, 1)
            deadline = time.monotonic() + _STATE_S
            while int(self._read_number(node, _MODE_NOW)) != _HOMING:
                if time.monotonic() > deadline:
                    return False
        except _Refused:
            return False
        return bool(int.from_bytes(self._read(node, _STATUS), "little") & 0x1000)

    def _map_process_data(
        self, node: int, mapping: int, parameters: int, cob: int, objects: list[tuple[int, int, int]]
    ) -> None:
        """Configures one process data object (PDO) of a drive: it holds these objects (index, subindex, bits) and goes
        over the bus at every SYNC. mapping, parameters: the indices of CiA 301's records of this PDO; cob: its CAN id
        less the node's. A mapping can be written only while the PDO is not valid and its count of objects is 0."""
        self._write(node, (parameters, 1), 1 << 31 | cob + node, 4)  # bit 31: not valid
        self._write(node, (mapping, 0), 0, 1)
        for i, (index, sub, bits) in enumerate(objects):
            self._write(node, (mapping, i + 1), index << 16 | sub << 8 | bits, 4)
        self._write(node, (mapping, 0), len(objects), 1)
        self._write(node, (parameters, 2), 1, 1)  # type of transmission: at every SYNC
        self._write(node, (parameters, 1), cob + node, 4)

    # -- cycles ---------------------------------------------------------------------------------------------------

    def _on_position(self, cob: int, data: bytearray, stamp: float) -> None:
        """Callback of canopen's thread: keeps a drive's answer to a SYNC, status word and counts, and wakes `measure`.
        cob: 180h plus the node id; stamp: canopen's, unused."""
        if len(data) == 6:
            with self._answered:
                self._positions[cob - 0x180] = struct.unpack("<Hi", data)
                self._unanswered[cob - 0x180] = max(self._unanswered[cob - 0x180] - 1, 0)
                self._answered.notify_all()

    def _on_speed(self, cob: int, data: bytearray, stamp: float) -> None:
        """Callback of canopen's thread: keeps a drive's speed, counts/s, and current, 1/1000 of its rated one. cob:
        280h plus the node id; stamp: canopen's, unused."""
        if len(data) == 6:
            self._speeds[cob - 0x280] = struct.unpack("<ih", data)

    def _send(self, cob: int, data: bytes) -> None:
        """Sends one CAN frame; cob: its id. Missed where the bus takes none."""
        try:
            self._network.send_message(cob, data)
        except (can.CanError, OSError) as error:
            raise Missed(f"the bus takes nothing ({error})") from error

    def _set_network_state(self, node: int, state: int) -> None:
        """Sends a command of CANopen's network management, such as _START, to a node, which changes its state."""
        self._send(0x000, bytes((state, node)))

    def _send_heartbeat(self) -> None:
        """Sends the host's heartbeat if one is due, every _HEARTBEAT_S: drives that miss it for _LOST_MS stop."""
        if self._clock() - self._beat_s >= _HEARTBEAT_S:
            self._send(0x700 + _HOST, b"\x05")
            self._beat_s = self._clock()

    def measure(self) -> list[Measured]:
        """Sends a SYNC and returns each drive's position, speed, current and fault at it, in the order of `drives`.
        Missed where one does not answer within _ANSWER_S. An answer to an earlier SYNC that comes late is told apart by
        counting answers."""
        self._send_heartbeat()
        with self._answered:
            self._positions.clear()
            for node in self._numbers:
                self._unanswered[node] += 1
        sent_s = self._clock()
        self._send(0x80, b"")
        with self._answered:
            self._answered.wait_for(lambda: not any(self._unanswered.values()), _ANSWER_S)
            heard = dict(self._positions)
            # A drive answers SYNCs in their order. If it answered and still owes answers, an earlier one was lost.
            self._unanswered |= dict.fromkeys(heard, 0)
        if len(heard) < len(self._numbers):
            raise Missed("no answer to a SYNC")
        return [self._measured(node, sent_s, *heard[node]) for node in self._numbers]

    def _measured(self, node: int, t_s: float, status: int, counts: int) -> Measured:
        """Converts a drive's answer to the SYNC that was sent at t_s, s, when drives sample. status: its status word,
        whose bit 3 is a fault; counts: its position; its speed and current are the last that came."""
        speed, share = self._speeds.get(node, (0, 0))
        fault = f"drive {node} has a fault" if status & 0x08 else ""
        current_ma = share * self._rated_ma[node] / 1000.0
        return Measured(t_s, q=float(counts), velocity=float(speed), current_ma=current_ma, fault=fault)

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Sends each drive the position, counts, that it goes to at the next SYNC; for None it sends nothing."""
        for node, goal in zip(self._numbers, goals, strict=True):
            if goal is not None:
                self._send(0x200 + node, struct.pack("<Hi", _OPERATE, round(goal.q)))

    def enable(self, axis: int, on: bool) -> None:
        """Switches a drive off, or on, through the states of CiA 402; switched on it holds where it is. A fault is
        cleared first. TautError where it does not reach a state."""
        node = self._numbers[axis]
        if not on:
            # In place of a set-point that still waits for its SYNC.
            self._send(0x200 + node, struct.pack("<Hi", _VOLTAGE_OFF, 0))
            self._write(node, _CONTROL, _VOLTAGE_OFF, 2)
            return
        position = int.from_bytes(self._read(node, _POSITION), "little", signed=True)
        self._write(node, _TARGET, position, 4)
        self._write(node, _CONTROL, _FAULT, 2)  # clears it
        for control, state in ((_SHUT_DOWN, _READY), (_SWITCH_ON, _ON), (_OPERATE, _OPERATIONAL)):
            self._write(node, _CONTROL, control, 2)
            self._wait_for_state(node, state)

    def _wait_for_state(self, node: int, state: int) -> None:
        """Waits until the drive's status word, in the bits 6Fh that CiA 402 has for the state, is `state`; sends
        heartbeats meanwhile. TautError after _STATE_S."""
        deadline = time.monotonic() + _STATE_S
        while (status := int.from_bytes(self._read(node, _STATUS), "little")) & 0x6F != state:
            self._send_heartbeat()  # a brake takes longer than the drive waits for it
            if time.monotonic() > deadline:
                raise TautError(
                    f"canopen {node} is not switched on (status word {status:04X}h): see its fault with its own tools"
                )

    def stop(self) -> None:
        """Switches all drives off and takes their nodes back to pre-operational."""
        try:
            all_off(len(self._numbers), self.enable)
        finally:
            for node in self._numbers:
                with contextlib.suppress(Missed):
                    self._set_network_state(node, _PRE_OPERATIONAL)

    def close(self) -> None:
        """Leaves the bus; drives stop as they miss the host's heartbeat."""
        self._network.disconnect()


class _Refused(TautError):
    """The drive has no such object, or does not take this value of it."""
