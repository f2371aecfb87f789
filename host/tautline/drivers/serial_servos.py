"""What servos on a half-duplex serial bus have in common: registers, a sync read, a sync write.

The SDKs of ROBOTIS and Feetech are of one family and have the same calls: a port, packets, two groups.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from types import ModuleType
from typing import Any

import serial

from tautline.drivers.drives import Clock, Drive, Goal, Measured, Missed, all_off
from tautline.errors import TautError

Register = tuple[int, int]  # address, size

_ANSWER_MS = 15.0  # limit: a USB adapter's latency timer may be 16 ms: lower it to 1 (docs/drivers.md)
_WAIT_S = 2e-3  # tolerance: of one wait for bytes; an answer may take several
_SETUP_TRIES = 5  # tolerance: tries of one register before its servo counts as absent


class SerialServos:
    """The servos on one bus, as `Drives` (drives.py). A subclass says what their registers are."""

    kind: str  # of the address, for messages
    watchdog: str
    rest_s: float
    enable_s = 8 * _SETUP_TRIES * _ANSWER_MS * 1e-3  # for up to 8 registers
    refusal: int  # bits of an answer's error byte that refuse what was asked
    state: Register  # all that a sync read asks for
    goal: Register

    def __init__(
        self,
        sdk: ModuleType,
        protocol: float,
        bus: str,
        numbers: Sequence[int],
        baud: int,
        clock: Clock = time.monotonic,
    ) -> None:
        """Opens the bus and reads what its servos are. sdk: the maker's module; protocol: the argument of its
        PacketHandler; bus: the serial device; numbers: the servos' IDs; baud: bit/s. TautError where the port cannot be
        opened or a servo does not answer."""
        self.numbers, self._clock, self._sdk = list(numbers), clock, sdk
        self._port, self._packets = _make_port(sdk, bus), sdk.PacketHandler(protocol)
        try:
            if not self._port.setBaudRate(baud):
                raise TautError(f"{self.kind}:{bus}: no such baud rate, {baud}")
        except (serial.SerialException, OSError) as error:
            raise TautError(
                f"{self.kind}:{bus}: cannot be opened ({error}): check the plug, and who uses it"
            ) from error
        self._reading = sdk.GroupSyncRead(self._port, self._packets, *self.state)
        self._writing = sdk.GroupSyncWrite(self._port, self._packets, *self.goal)
        for number in self.numbers:
            self._reading.addParam(number)
        try:
            self.drives = [self.describe(number) for number in self.numbers]
        except BaseException:
            self._port.closePort()
            raise

    # -- what differs ---------------------------------------------------------------------------------------------

    def describe(self, number: int) -> Drive:
        """Reads a servo's limits, model and firmware from its registers."""
        raise NotImplementedError

    def measured(self, axis: int, t_s: float, state: bytes) -> Measured:
        """Converts a servo's answer to the sync read, the bytes of the register `state`, to counts, counts/s and mA.
        t_s: the middle of the round trip, s."""
        raise NotImplementedError

    def encoded(self, goal: int) -> bytes:
        """Encodes a position, counts, as the bytes of the register `goal`."""
        raise NotImplementedError

    def enable(self, axis: int, on: bool) -> None:
        """Switches a servo's torque on, so that it holds where it is, or off."""
        raise NotImplementedError

    # -- registers, while nothing moves ---------------------------------------------------------------------------

    def read(self, number: int, register: Register) -> int:
        """Reads a register as an unsigned number, with retries. TautError where the servo refuses or is silent."""
        answer = self._retry(number, lambda: self._packets.readTxRx(self._port, number, *register))
        value = self._register_number(register, answer)
        if value is None:
            why = self._packets.getRxPacketError(answer[-1] & self.refusal) or "its answer is too short"
            raise TautError(f"{self.kind} {number}: register {register[0]} cannot be read: {why}")
        return value

    def glance(self, number: int, register: Register) -> int | None:
        """Reads a register as `read` does, but with one try only, as it happens between two control cycles; None where
        no whole answer came."""
        try:
            return self._register_number(
                register, self._sdk_answer(lambda: self._packets.readTxRx(self._port, number, *register))
            )
        except Missed:
            return None

    def _register_number(self, register: Register, answer: tuple[list[int], int, int]) -> int | None:
        """Returns the register's unsigned number in the SDK's answer (data, result, error). None where the exchange
        failed, the data have another length, or the servo refused: the SDK then hands out a checksum as data."""
        data, result, error = answer
        whole = result == self._sdk.COMM_SUCCESS and len(data) == register[1] and not error & self.refusal
        return int.from_bytes(bytes(data), "little") if whole else None

    def write(self, number: int, register: Register, value: int) -> None:
        """Writes a register, a negative number as its two's complement, with retries. TautError where the servo refuses
        it, or does not answer."""
        address, size = register
        data = list((value & ((1 << 8 * size) - 1)).to_bytes(size, "little"))
        error = self._retry(number, lambda: self._packets.writeTxRx(self._port, number, address, size, data))[-1]
        if error & self.refusal:
            why = self._packets.getRxPacketError(error & self.refusal)
            raise TautError(f"{self.kind} {number}: register {address} refused {value}: {why}")

    def _retry(self, number: int, ask: Callable[[], Any]) -> Any:
        """Calls `ask`, one exchange with the servo `number`, until the SDK's answer (..., communication result, error)
        says success, and returns that answer; TautError after _SETUP_TRIES times."""
        why = ""
        for _ in range(_SETUP_TRIES):
            try:
                answer = self._sdk_answer(ask)
            except Missed as missed:
                why = str(missed)
                continue
            if answer[-2] == self._sdk.COMM_SUCCESS:
                return answer
            why = self._packets.getTxRxResult(answer[-2])
        raise TautError(f"{self.kind} {number} does not answer ({why}): check power, ID, baud rate and the plug")

    def _sdk_answer(self, ask: Callable[[], Any]) -> Any:
        """Calls `ask`, a function of the SDK, and returns its answer. The SDK's exceptions become TautError where the
        port is lost, and Missed where a damaged packet makes it fail."""
        try:
            return ask()
        except (serial.SerialException, OSError) as error:
            raise TautError("the serial port is gone") from error
        except (IndexError, TypeError) as error:
            self._port.is_using = False
            raise Missed("an answer was damaged") from error

    # -- cycles ---------------------------------------------------------------------------------------------------

    def measure(self) -> list[Measured]:
        """Position, speed, current and fault of each servo, in the order of `numbers`, by one sync read. Missed where
        an answer is missing or too short."""
        sent = self._clock()
        result = self._sdk_answer(self._reading.txRxPacket)
        if result != self._sdk.COMM_SUCCESS:
            raise Missed(f"no answer ({self._packets.getTxRxResult(result)})")
        t_s = 0.5 * (sent + self._clock())
        states = [bytes(self._reading.data_dict[number]) for number in self.numbers]
        if any(len(state) != self.state[1] for state in states):
            raise Missed("an answer is too short")
        return [self.measured(axis, t_s, state) for axis, state in enumerate(states)]

    def set_positions(self, goals: Sequence[Goal | None]) -> None:
        """Sends the servos their goals in one sync write; for None it sends nothing."""
        self._writing.clearParam()
        for number, goal in zip(self.numbers, goals, strict=True):
            if goal is not None:
                self._writing.addParam(number, list(self.encoded(round(goal.q))))
        self._sdk_answer(self._writing.txPacket)

    def stop(self) -> None:
        """Switches the torque of all servos off. TautError where one does not answer."""
        all_off(len(self.numbers), self.enable)

    def close(self) -> None:
        """Closes the serial port; servos are left as they are."""
        self._port.closePort()


def _make_port(sdk: ModuleType, bus: str) -> Any:
    """Makes the SDK's port on the serial device `bus`, not opened yet. Its reads wait for bytes instead of polling, its
    packets have _ANSWER_MS to come, and it locks the line for itself."""

    class Port(sdk.PortHandler):  # type: ignore[misc, name-defined]
        def setupPort(self, baud: int) -> bool:
            """Opens the port at this rate, bit/s, with waiting reads and a lock; False where it has no such rate."""
            if not super().setupPort(baud):
                return False
            try:
                self.ser.timeout, self.ser.exclusive = _WAIT_S, True
            except serial.SerialException:
                self.closePort()
                raise
            return True

        def setPacketTimeout(self, length: int) -> None:
            """Sets how long an answer of so many bytes may take: its time on the line and _ANSWER_MS."""
            self.setPacketTimeoutMillis(self.tx_time_per_byte * length + _ANSWER_MS)

        def clearPort(self) -> None:
            """Drops bytes that came too late for their question."""
            self.ser.reset_input_buffer()

    return Port(bus)
