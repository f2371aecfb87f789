"""A board: found over USB or USB/IP, opened, asked, listened to. The calls are PyUSB's, whatever the bus."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import libusb_package
import usb.core
import usb.util

from tautline.device import usbip_backend, wire
from tautline.device.clock import Clock
from tautline.device.dfu import Dfu, DfuError
from tautline.errors import TautError

ENVIRONMENT = "TAUTLINE_BOARD"
_OUT, _IN = 0x01, 0x81
_CONTROL, _TABLES = 0, 1  # interfaces
_READ_BYTES = 4096
_ANSWER_S = 2.0
_WRITE_MS = 1000
_CHECK_S, _POLL_S = 3.0, 0.02  # of motor and encoder: what it takes at most
_UNASKED = ("batch", "onset", "progress", "event")

Listener = Callable[[wire.Message], None]


class BoardGone(TautError):
    """The board left the bus."""


class BoardRefused(TautError):
    """The board answered with a reason. `reason` is its name in tl_wire.h's TL_WIRE_REASONS."""

    def __init__(self, request: str, code: int) -> None:
        super().__init__(f"the board refused '{request}': {wire.text('REASONS', code)}")
        self.reason = next((name for name, (value, _) in wire.wire.REASONS.items() if value == code), str(code))


@dataclass(frozen=True)
class Found:
    """A board on a bus, not opened."""

    device: usb.core.Device
    where: str  # usb:SERIAL or usbip:HOST:PORT
    serial: str | None  # None: in use, or not allowed to ask
    busy: bool

    @property
    def protocol(self) -> tuple[int, int]:
        return self.device.bcdDevice >> 8, self.device.bcdDevice & 0xFF


def find(where: str | None = None) -> list[Found]:
    """`where`: usbip:HOST:PORT, a serial number, usb:SERIAL, or None for every board on USB and the one that the
    environment variable TAUTLINE_BOARD names."""
    if where is not None and where.startswith("usbip:"):
        return _find_usbip(where)
    found = _find_usb()
    if where is not None:
        serial = where.removeprefix("usb:")
        return [board for board in found if board.serial == serial]
    named = os.environ.get(ENVIRONMENT)
    if named and named.startswith("usbip:"):
        found += _find_usbip(named)
    return found


def _find_usb() -> list[Found]:
    backend = libusb_package.get_libusb1_backend()
    if backend is None:
        return []
    found = []
    for device in _ours(backend):
        try:
            serial, busy = device.serial_number, False
        except (usb.core.USBError, ValueError):  # not allowed to open it
            serial, busy = None, True
        finally:
            usb.util.dispose_resources(device)
        found.append(Found(device, f"usb:{serial or f'{device.bus}-{device.address}'}", serial, busy))
    return found


def _find_usbip(where: str) -> list[Found]:
    address = where.split(":")
    if len(address) != 3 or not address[2].isdigit():
        raise TautError(f"--board {where}: expected usbip:HOST:PORT, such as usbip:127.0.0.1:3240")
    try:
        devices = list(_ours(usbip_backend.Backend(address[1], int(address[2]))))
    except usb.core.USBError as error:
        raise TautError(f"{where}: {error.strerror}: start the board, or name another with --board") from error
    found = []
    for device in devices:
        busy = device.iSerialNumber == 0
        found.append(Found(device, where, None if busy else device.serial_number, busy))
        usb.util.dispose_resources(device)
    return found


def _ours(backend: Any) -> Iterator[usb.core.Device]:
    found = usb.core.find(
        find_all=True, backend=backend, idVendor=wire.wire.USB_VENDOR, idProduct=wire.wire.USB_PRODUCT
    )
    for device in found:
        with contextlib.suppress(usb.core.USBError, ValueError):  # the pair of numbers may be shared: ask for the name
            if device.iManufacturer and device.manufacturer != wire.wire.USB_MANUFACTURER:
                continue
        yield device


def open_board(where: str | None = None) -> Board:
    """The one board that `where` names (see `find`), checked to speak this protocol and to be free."""
    found = find(where)
    if not found:
        looked = f"no board '{where}' was found" if where else "no board was found"
        raise TautError(f"{looked}: plug it in, name one with --board usbip:HOST:PORT, or use --simulate")
    if len(found) > 1:
        choices = " or ".join(f"--board {board.where}" for board in found)
        raise TautError(f"{len(found)} boards were found: say which with {choices}")
    return Board(found[0])


def check_protocol(found: Found) -> None:
    """Before anything is opened: a board of another protocol generation is left alone."""
    ours, theirs = wire.wire.MAJOR, found.protocol[0]
    if theirs == ours:
        return
    speaks = f"{found.where} speaks protocol {theirs}, this tautline speaks {ours}"
    if theirs > ours:
        raise TautError(f"{speaks}: run 'pip install --upgrade tautline'")
    if found.where.startswith("usbip:"):
        raise TautError(f"{speaks}: run 'cmake --build --preset gcc' and start the board again")
    mend = "cp build/rp2040/tautline.uf2 /media/$USER/RPI-RP2/"
    raise TautError(f"{speaks}: hold BOOTSEL while plugging the board in, then run '{mend}'")


class Board:
    """An open board. Messages take and give physical values (wire.py): counts, counts/s, deg, px.

    One thread may use it alone (`poll` takes in what came); with `reading()` a thread of its own does, and listeners
    are then called on that thread.
    """

    def __init__(self, found: Found) -> None:
        check_protocol(found)
        self.where = found.where
        self.clock = Clock()
        self.missed = 0  # unasked messages that never came
        self.refused: list[BoardRefused] = []  # of messages that have no answer
        self._device = found.device
        self._listeners: dict[str, list[Listener]] = {name: [] for name in _UNASKED}
        self._decoder = wire.Decoder()
        self._arrived = threading.Condition()
        self._asking = threading.Lock()
        self._writing = threading.Lock()
        self._answers: dict[int, wire.Message] = {}
        self._told: dict[int, str] = {}
        self._sequence = 0
        self._unasked: int | None = None
        self._reader: threading.Thread | None = None
        self._lost: TautError | None = None
        self._stop = threading.Event()
        with self._errors():
            usb.util.claim_interface(self._device, _CONTROL)
        try:
            self.identity = self.ask("hello", protocol_major=wire.wire.MAJOR, protocol_minor=wire.wire.MINOR)
        except BaseException:
            self.close()
            raise

    # -- life ---------------------------------------------------------------------------------------------------

    def __enter__(self) -> Board:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        self._stop.set()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join()
        with contextlib.suppress(usb.core.USBError):
            usb.util.dispose_resources(self._device)

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """A thread takes in what the board sends, until the end of the block."""
        self._stop.clear()
        self._reader = threading.Thread(target=self._read, name="board reader", daemon=True)
        self._reader.start()
        try:
            yield
        finally:
            self._stop.set()
            self._reader.join()
            self._reader = None

    def _read(self) -> None:
        while not self._stop.is_set():
            try:
                self.poll(0.05)
            except TautError:
                return

    @contextlib.contextmanager
    def _errors(self) -> Iterator[None]:
        try:
            yield
        except usb.core.USBError as error:
            raise self._explain(error) from error

    def _explain(self, error: usb.core.USBError) -> TautError:
        if error.errno in (errno.ENODEV, errno.EIO, errno.ESHUTDOWN, errno.ENOENT):
            return BoardGone(f"{self.where}: the board is gone: check plug and power, then run the command again")
        if error.errno == errno.EBUSY:
            return TautError(f"{self.where}: another program uses the board: close that program first")
        if error.errno == errno.EACCES:
            mend = "sudo cp tools/70-tautline.rules /etc/udev/rules.d/"
            return TautError(f"{self.where}: no permission: run '{mend}' and plug the board in again")
        if error.errno == errno.ETIMEDOUT:
            return TautError(f"{self.where}: the board does not take data: switch it off and on")
        return TautError(f"{self.where}: USB failed ({error}): unplug the board and plug it in again")

    # -- messages -----------------------------------------------------------------------------------------------

    def listen(self, name: str, listener: Listener) -> None:
        """Calls `listener` with each unasked message of this name: batch, onset, progress, event."""
        self._listeners[name].append(listener)

    def tell(self, name: str, **values: Any) -> None:
        """Sends a message that has no answer; a refusal shows up in `refused`."""
        self.tell_all(name, [values])

    def tell_all(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Several such messages in one transfer."""
        frames = []
        for values in rows:
            sequence = self._next()
            self._told[sequence] = name
            self._told.pop((sequence - 1000) & 0xFFFF, None)
            frames.append(wire.encode(name, sequence, **values))
        if frames:
            self._write(b"".join(frames))

    def ask(self, name: str, timeout_s: float = _ANSWER_S, **values: Any) -> wire.Message:
        """Sends a request and gives its answer; BoardRefused where that is an error."""
        sequence = self._next()
        frame = wire.encode(name, sequence, **values)
        deadline = time.monotonic() + timeout_s
        self._answers.pop(sequence, None)  # a late one, from before the sequence wrapped
        self._write(frame)
        while (answer := self._answers.pop(sequence, None)) is None:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TautError(f"{self.where}: the board does not answer '{name}': switch it off and on")
            if self._reader is None or self._reader is threading.current_thread():
                self.poll(left)
                continue
            with self._arrived:
                self._arrived.wait_for(lambda: sequence in self._answers or self._lost is not None, left)
            if self._lost is not None and sequence not in self._answers:
                raise self._lost
        if answer.name == "error":
            raise BoardRefused(name, answer.reason)
        return answer

    def poll(self, timeout_s: float) -> int:
        """Takes in what the board sends next, waiting up to the time; the number of messages."""
        if self._lost is not None:
            raise self._lost
        try:
            with self._errors():
                data = self._device.read(_IN, _READ_BYTES, timeout=max(round(timeout_s * 1000), 1))
        except TautError as error:
            if isinstance(error.__cause__, usb.core.USBTimeoutError):
                return 0
            with self._arrived:
                self._lost = error
                self._arrived.notify_all()
            raise
        count = 0
        for message in self._decoder.feed(bytes(data)):
            count += 1
            self._take(message)
        return count

    def _take(self, message: wire.Message) -> None:
        if message.name in self._listeners:
            if self._unasked is not None:
                self.missed += (message.sequence - self._unasked - 1) & 0xFFFF
            self._unasked = message.sequence
            for listener in self._listeners[message.name]:
                listener(message)
        elif message.name == "error" and message.sequence in self._told:
            self.refused.append(BoardRefused(self._told.pop(message.sequence), message.reason))
        else:
            with self._arrived:
                self._answers[message.sequence] = message
                self._arrived.notify_all()

    def _next(self) -> int:
        with self._asking:
            self._sequence = self._sequence % 0xFFFF + 1
            return self._sequence

    def _write(self, frame: bytes) -> None:
        if self._lost is not None:
            raise self._lost
        with self._writing, self._errors():
            self._device.write(_OUT, frame, timeout=_WRITE_MS)

    # -- what takes more than one message -----------------------------------------------------------------------

    @property
    def axes(self) -> int:
        return int(self.identity.axes)

    def status(self, axis: int) -> wire.Message:
        return self.ask("get_status", axis=axis)

    def counters(self, clear: bool = False) -> wire.Message:
        return self.ask("get_counters", clear=int(clear))

    def sync(self) -> int:
        """Everything that the board sent before has been taken in; board time, us."""
        return int(self.ask("ping", host_us=0).t_us)

    def align(self, trips: int = 8) -> float:
        """Round trips for `clock` (against time.monotonic()); the error now, s."""
        for _ in range(trips):
            sent = time.monotonic()
            stamp = self.ask("ping", host_us=round(sent * 1e6)).t_us
            self.clock.add(sent, time.monotonic(), stamp)
        return self.clock.offset(time.monotonic())[1]

    def check_axis(self, axis: int) -> None:
        if not 0 <= axis < self.axes:
            raise TautError(f"{self.where}: no axis {axis}: its axes are 0 to {self.axes - 1}")

    def check_fault(self, axis: int) -> None:
        """TautError where the axis has a fault."""
        status = self.status(axis)
        if status.fault:
            raise TautError(f"axis {axis} has stopped: {wire.fault(status)}. Then run 'taut clear', and this again")

    def check_reference(self, axis: int) -> None:
        """TautError where the axis does not know its position."""
        if not self.status(axis).flags & wire.code("FLAGS", "REFERENCED"):
            raise TautError(
                f"axis {axis} does not know its position: run 'taut home', or say where it stands with --at"
            )

    def switch_on(self, axis: int, wait: Callable[[float], None] = time.sleep) -> None:
        """Motor on and holding. The first time, and after settings or wiring may have changed, the board turns it a
        little either way to check motor and encoder, half a second. `wait` lets board time pass."""
        self.check_fault(axis)
        self.ask("enable", axis=axis, on=1)
        for _ in range(round(_CHECK_S / _POLL_S)):
            status = self.status(axis)
            if status.mode == wire.code("MODES", "HOLD"):
                return
            self.check_fault(axis)
            wait(_POLL_S)
        raise TautError(f"axis {axis} is {wire.text('MODES', status.mode)}, not switched on: stop it, then run again")

    def load_table(self, axis: int, blob: bytes, progress: Callable[[float, str], None] | None = None) -> None:
        """Stores a table by DFU (motors off) and compares what the board then holds byte for byte."""
        self.check_axis(axis)
        try:
            with self._errors(), Dfu(self._device, _TABLES, axis) as dfu:
                dfu.download(blob, progress)
                stored = dfu.upload()
        except DfuError as error:
            raise self._refusal(axis, error) from error
        if stored != blob:
            raise TautError(f"axis {axis}: the board holds another table than was sent: flash it again")

    def read_table(self, axis: int) -> bytes:
        """The table in use, b"" where the axis has none."""
        self.check_axis(axis)
        with self._errors(), Dfu(self._device, _TABLES, axis) as dfu:
            return dfu.upload()

    def _refusal(self, axis: int, error: DfuError) -> TautError:
        """DFU has one byte for the reason; the status message has the table's own."""
        reason = self.status(axis).table_reason
        if error.status == 0x02 and reason:
            return TautError(f"the board refused the table of axis {axis}: {wire.table_reason(reason)}")
        return error
