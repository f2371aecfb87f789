"""A board: found over USB, USB/IP or a serial line, opened, asked, listened to. The messages are the same on each."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from tautline import _native
from tautline.closable import Closable
from tautline.device import holder, wire
from tautline.device.clock import BoardClock
from tautline.device.dfu import DfuError
from tautline.device.link import BoardAddress, BoardGone, Link
from tautline.device.serial_link import find_serial
from tautline.device.usb_link import address_in_environment, find_usb, find_usbip
from tautline.drivers.addresses import find_motors, is_motor
from tautline.errors import TautError

__all__ = ["Board", "BoardAddress", "BoardGone", "BoardRefused", "check_protocol", "find", "open_board"]

_ANSWER_S, _SIMULATED_S = 2.0, 10.0  # a simulated board answers when this machine lets it
_STORE_S = 10.0  # a table: an erase and ten pages
_TABLE_REFUSED = {
    "TABLE_SIZE": "the table is longer than the board takes, or a part of it was lost: load it again",
    "NOT_OFF": "a motor is on: tables are loaded with every motor off",
    "FLASH": "the flash could not be written",
}
_CHECK_S, _POLL_S = 3.0, 0.02  # of motor and encoder: what it takes at most
_UNASKED = ("batch", "onset", "progress", "event")

Listener = Callable[[wire.Message], None]


class BoardRefused(TautError):
    """The board refused a request. `reason` is the name of the refusal's reason in tl_wire.h's TL_WIRE_REASONS."""

    def __init__(self, request: str, code: int, fault: str = "") -> None:
        """request: the message's name; code: the reason's number in tl_wire.h's TL_WIRE_REASONS; fault: the axis' fault
        in words where that is the reason: it is then the error's text, else ""."""
        super().__init__(fault or f"the board refused '{request}': {wire.text('REASONS', code)}")
        self.reason = next((name for name, (value, _) in wire.wire.REASONS.items() if value == code), str(code))


def find(where: str | None = None) -> list[BoardAddress]:
    """Returns the boards that are there, not opened. where: usbip:HOST:PORT, serial:DEVICE, motors as in
    drivers/addresses, or, for a board on USB, its serial number, usb:SERIAL or usb:BUS-DEVICE (if it cannot be asked
    for its number). None returns every board on USB, and the one that the environment variable TAUTLINE_BOARD names."""
    if where is not None and _is_address(where):
        return _find_named(where)
    boards = find_usb()
    if where is not None:
        return [board for board in boards if where in (board.where, board.serial)]
    other = address_in_environment()
    if other and _is_address(other):
        boards += _find_named(other)
    return boards


def _is_address(where: str) -> bool:
    """Whether `where` is an address (usbip:..., serial:..., or motors) and not the name of a board on USB."""
    return where.startswith(("usbip:", "serial:")) or is_motor(where)


def _find_named(where: str) -> list[BoardAddress]:
    """The boards at an address for which `_is_address` holds."""
    if is_motor(where):
        return find_motors(where)
    return find_usbip(where) if where.startswith("usbip:") else find_serial(where)


def open_board(where: str | None = None, otherwise: str = "") -> Board:
    """Opens the one board that `where` names (see `find`). otherwise: what else the user could give the command, for
    the error's text. TautError where there is no such board or several, where it is in use, or speaks another
    protocol."""
    boards = find(where)
    if not boards:
        looked = f"no board '{where}' was found" if where else "no board was found"
        raise TautError(
            f"{looked}: plug it in{',' if otherwise else ' or'} name one with --board usbip:HOST:PORT or serial:DEVICE"
            f"{f', or {otherwise}' if otherwise else ''}"
        )
    if len(boards) > 1:
        choices = " or ".join(f"--board {board.where}" for board in boards)
        raise TautError(f"{len(boards)} boards were found: say which with {choices}")
    return Board(boards[0])


def check_protocol(description: BoardAddress) -> None:
    """TautError, with how to get newer firmware or a newer tautline, where a board that was found speaks another major
    version of the protocol. It is called before the board is opened."""
    ours, theirs = wire.wire.MAJOR, description.protocol[0]
    if theirs == ours:
        return
    speaks = f"{description.where} speaks protocol {theirs}, this tautline speaks {ours}"
    if theirs > ours:
        raise TautError(f"{speaks}: run 'pip install --upgrade tautline'")
    raise TautError(f"{speaks}: {newer_firmware(description.where, description.protocol)}")


def newer_firmware(where: str, protocol: tuple[int, int]) -> str:
    """Says how to get newer firmware onto the board at `where`, which speaks this protocol (major, minor): the end of
    an error's text."""
    if where.startswith(("usbip:", "serial:tcp:")):
        return "run 'cmake --build --preset gcc' and start the board again"
    if protocol >= (wire.wire.MAJOR, wire.wire.SINCE["get_firmware"]):
        return "run 'taut update build/rp2040/tautline.update', or with a release's file"
    return "hold BOOTSEL while plugging the board in, then run 'cp build/rp2040/tautline.uf2 /media/$USER/RPI-RP2/'"


class Board(Closable):
    """An open board. Messages take and give physical values (wire.py): counts, counts/s, deg, px.

    One thread may use it alone (`poll` takes in what came); with `reading()` a thread of its own does, and listeners
    are then called on that thread. What a listener raises ends its listening, and whoever asks next gets it.
    """

    def __init__(self, description: BoardAddress) -> None:
        """Opens the board and asks who it is. TautError where it speaks another protocol or does not answer."""
        check_protocol(description)
        self.where = description.where
        self.clock = BoardClock()
        self.missed = 0  # unasked messages that never came
        self.refused: list[BoardRefused] = []  # of messages that have no answer
        simulated = description.where.startswith(("usbip:", "serial:tcp:"))
        self._answer_s = _SIMULATED_S if simulated else _ANSWER_S
        self._link: Link = description.open()
        self._listeners: dict[str, list[Listener]] = {name: [] for name in _UNASKED}
        self._decoder = wire.Decoder()
        self._arrived = threading.Condition()
        self._asking = threading.Lock()
        self._writing = threading.Lock()
        self._answers: dict[int, wire.Message] = {}  # by the request's sequence number
        self._request_names: dict[int, str] = {}  # of requests without an answer, by sequence number
        self._sequence = 0  # of the last request
        self._last_unasked: int | None = None  # sequence number of the last message that the board sent by itself
        self._reader: threading.Thread | None = None
        self._link_error: TautError | None = None
        self._listener_error: Exception | None = None  # of a listener, in the reading thread
        self._stop = threading.Event()
        try:
            self.identity = self._hello()
            holder.take(self.where)
        except BaseException:
            self.close()
            raise

    def _hello(self) -> wire.Message:
        """Says hello and returns the board's identity. It tries as often as the link says (`hello_tries`), all together
        for no longer than one answer may take. TautError where the board does not answer."""
        tries = self._link.hello_tries
        for left in reversed(range(tries)):
            try:
                return self.ask(
                    "hello", self._answer_s / tries, protocol_major=wire.wire.MAJOR, protocol_minor=wire.wire.MINOR
                )
            except (BoardGone, BoardRefused):
                raise
            except TautError:
                if left == 0:
                    raise
        raise AssertionError("a link allows one try at least")

    # -- life ---------------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Ends the reading thread, if any, removes the note that this process holds the board, and closes the link."""
        self._stop.set()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join()
        holder.leave(self.where)
        self._link.close()

    @contextlib.contextmanager
    def reading(self) -> Iterator[None]:
        """A context within which a thread of its own takes in what the board sends, and calls the listeners."""
        self._stop.clear()
        self._reader = threading.Thread(target=self._poll_until_stopped, name="board reader", daemon=True)
        self._reader.start()
        try:
            yield
        finally:
            self._stop.set()
            self._reader.join()
            self._reader = None

    def _poll_until_stopped(self) -> None:
        """Body of the reading thread: takes in what comes until it is stopped, or the link fails (`_link_error`)."""
        while not self._stop.is_set():
            try:
                self.poll(0.05)
            except TautError:
                return

    # -- messages -----------------------------------------------------------------------------------------------

    def listen(self, name: str, listener: Listener) -> None:
        """Calls `listener`, from now on, with each message of this name that the board sends unasked: batch, onset,
        progress or event."""
        self._listeners[name].append(listener)

    def forget(self, name: str, listener: Listener) -> None:
        """Ends what `listen` began; does nothing for a listener that is not registered."""
        self._listeners[name] = [other for other in self._listeners[name] if other != listener]

    @contextlib.contextmanager
    def listening(self, **listeners: Listener) -> Iterator[None]:
        """A context within which these listeners, by name of message (see `listen`), are called."""
        try:
            for name, listener in listeners.items():
                self.listen(name, listener)
            yield
        finally:
            for name, listener in listeners.items():
                self.forget(name, listener)

    def tell(self, name: str, **values: Any) -> None:
        """Sends a message that has no answer; a refusal shows up in `refused`."""
        self.tell_all(name, [values])

    def tell_all(self, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
        """Sends several messages of one kind, each row its fields by name, in one transfer. None is answered; refusals
        show up in `refused`."""
        self._check_known(name)
        frames = []
        for values in rows:
            sequence = self._next_sequence()
            self._request_names[sequence] = name
            frames.append(wire.encode(name, sequence, **values))
        if frames:
            self._write(b"".join(frames))

    def ask(self, name: str, timeout_s: float | None = None, **values: Any) -> wire.Message:
        """Sends a request and returns its answer. timeout_s: None takes the link's own. BoardRefused where the answer
        is an error, BoardGone where the board has restarted, TautError without an answer in time."""
        self._check_known(name)
        timeout_s = self._answer_s if timeout_s is None else timeout_s
        sequence = self._next_sequence()
        frame = wire.encode(name, sequence, **values)
        deadline = time.monotonic() + timeout_s
        self._write(frame)
        answer = self._answer_to(name, sequence, deadline)
        if answer.name == "error":
            if answer.reason == wire.code("REASONS", "SESSION"):
                raise BoardGone(f"{self.where}: the board has restarted: run the command again")
            fault = ""
            if answer.reason == wire.code("REASONS", "FAULT") and "axis" in values:
                fault = self._fault_in_words(values["axis"])
            raise BoardRefused(name, answer.reason, fault)
        if answer.name != wire.ANSWERS[name]:
            raise TautError(f"{self.where}: the board answers '{name}' by '{answer.name}': switch it off and on")
        return answer

    def _answer_to(self, name: str, sequence: int, deadline: float) -> wire.Message:
        """Waits for the answer to the request `name` of this sequence number, until `deadline` (time.monotonic). Reads
        the link itself where no thread does. TautError without an answer by then, or where the link is gone; also the
        error of a listener that failed meanwhile."""
        while (answer := self._answers.pop(sequence, None)) is None:
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise TautError(f"{self.where}: the board does not answer '{name}': switch it off and on")
            if self._reader is None or self._reader is threading.current_thread():
                self.poll(left)
                continue
            with self._arrived:
                self._arrived.wait_for(
                    lambda: sequence in self._answers or self._link_error or self._listener_error, left
                )
                failed, self._listener_error = self._listener_error, None
            if failed is not None:
                raise failed
            if self._link_error is not None and sequence not in self._answers:
                raise self._link_error
        return answer

    def _check_known(self, name: str) -> None:
        """TautError, with how to get newer firmware, where the board's firmware is older than the message `name`."""
        since = wire.wire.SINCE.get(name, 0)
        if since and self.identity.protocol_minor < since:
            major, minor = self.identity.protocol_major, self.identity.protocol_minor
            raise TautError(
                f"{self.where} speaks protocol {major}.{minor}, '{name}' came with {major}.{since}: "
                f"{newer_firmware(self.where, (major, minor))}"
            )

    def poll(self, timeout_s: float) -> int:
        """Takes in what the board sends, waiting for at most timeout_s; calls the listeners. Returns the number of
        messages. TautError where the link fails or has failed before, or from a listener."""
        if self._link_error is not None:
            raise self._link_error
        try:
            data = self._link.read(timeout_s)
        except TautError as error:
            with self._arrived:
                self._link_error = error
                self._arrived.notify_all()
            raise
        count = 0
        for message in self._decoder.feed(data):
            count += 1
            self._dispatch(message)
        return count

    def _dispatch(self, message: wire.Message) -> None:
        """Hands a message that came to the listeners of its name, to the waiting `ask`, or, if it refuses a message
        without an answer, to the list `refused`. Gaps in the sequence numbers of unasked messages add to `missed`."""
        if message.name in self._listeners:
            if self._last_unasked is not None:
                self.missed += (message.sequence - self._last_unasked - 1) & 0xFFFF
            self._last_unasked = message.sequence
            for listener in self._listeners[message.name]:
                self._call_listener(message, listener)
        elif message.name == "error" and message.sequence in self._request_names:
            self.refused.append(BoardRefused(self._request_names.pop(message.sequence), message.reason))
        else:
            with self._arrived:
                self._answers[message.sequence] = message
                self._arrived.notify_all()

    def _call_listener(self, message: wire.Message, listener: Listener) -> None:
        """Calls a listener with a message. One that fails (a full disk) is not called again; its error is raised here,
        or by the next `ask` if this is the reading thread, which goes on: the motor must still be told to rest."""
        try:
            listener(message)
        except Exception as error:
            self.forget(message.name, listener)
            if self._reader is not threading.current_thread():
                raise
            with self._arrived:
                self._listener_error = error
                self._arrived.notify_all()

    def _next_sequence(self) -> int:
        """Returns the sequence number of the next message: 1 to 65535, then 1 again. What is kept from the last use of
        this number, such as an answer that came too late, is dropped."""
        with self._asking:
            self._sequence = self._sequence % 0xFFFF + 1
            self._request_names.pop(self._sequence, None)
            self._answers.pop(self._sequence, None)
            return self._sequence

    def _write(self, frame: bytes) -> None:
        """Sends whole frames. TautError where the link fails, or has failed before."""
        if self._link_error is not None:
            raise self._link_error
        with self._writing:
            self._link.write(frame)

    # -- what takes more than one message -----------------------------------------------------------------------

    @property
    def axes(self) -> int:
        """How many axes (motors) the board has."""
        return int(self.identity.axes)

    @property
    def log_divider(self) -> int:
        """Milliseconds from one sample of telemetry to the next in a recording: 1 for a board, more for motors on a bus
        that are asked less often than that."""
        return self._link.log_divider

    def bus(self) -> dict[str, Any]:
        """Returns what HostedLink.bus says (drives, limits, timing) where the axes are motors on a bus of their own; {}
        for a real board."""
        return dict(self._link.bus())

    def status(self, axis: int) -> wire.Message:
        """Asks for the axis' status: tl_wire.h's message `status`."""
        return self.ask("get_status", axis=axis)

    def counters(self, clear: bool = False) -> wire.Message:
        """Asks for the board's counters of errors and lost messages: tl_wire.h's message `counters`. clear: whether
        they are set to 0 afterwards."""
        return self.ask("get_counters", clear=int(clear))

    def sync(self) -> int:
        """Waits for a round trip, after which all that the board had sent before it has been taken in. Returns the
        board's time, us."""
        return int(self.ask("ping", host_us=0).t_us)

    def align(self, trips: int = 8) -> float:
        """Measures the board's clock against time.monotonic() by this many round trips, which are added to `clock`;
        returns the bound of the clock's error now, s."""
        for _ in range(trips):
            sent = time.monotonic()
            stamp = self.ask("ping", host_us=round(sent * 1e6)).t_us
            self.clock.add(sent, time.monotonic(), stamp)
        return self.clock.offset(time.monotonic())[1]

    def check_axis(self, axis: int) -> None:
        """TautError where the board has no such axis."""
        if not 0 <= axis < self.axes:
            raise TautError(f"{self.where}: no axis {axis}: its axes are 0 to {self.axes - 1}")

    def check_fault(self, axis: int) -> None:
        """TautError, with the remedy, where the axis has a fault."""
        if fault := self._fault_in_words(axis):
            raise TautError(fault)

    def _fault_in_words(self, axis: int) -> str:
        """Asks for the axis' status; returns its fault with the remedy as an error's text, "" where it has none."""
        status = self.status(axis)
        if not status.fault:
            return ""
        more = f"'taut explain {wire.name('FAULTS', status.fault)}' says more"
        return f"axis {axis} has stopped: {wire.fault(status)}. Then run 'taut clear', and this again ({more})"

    def check_reference(self, axis: int) -> None:
        """TautError, with the remedy, where the axis does not know its absolute position."""
        if not self.status(axis).flags & wire.code("FLAGS", "REFERENCED"):
            how = "home its drive with its maker's tools" if self.bus() else "run 'taut home'"
            raise TautError(f"axis {axis} does not know its position: {how}, or say where it stands with --at")

    def trust_motor(self, axis: int) -> None:
        """Marks the axis' settings as commissioned without a measurement: for a simulated motor, which the defaults
        fit."""
        own = dict(self.ask("get_settings", axis=axis).values)
        self.ask("settings", **(own | {"commissioned": 1, "key": wire.wire.KEY}), timeout_s=5.0)

    def switch_on(self, axis: int, wait: Callable[[float], None] = time.sleep) -> None:
        """Switches the motor on, holding, and waits until it is. The first time, and after settings or wiring may have
        changed, the board turns it a little in both directions to check motor and encoder, half a second. wait: lets so
        many seconds of board time pass. TautError for a fault, or where it is not on after _CHECK_S."""
        self.check_fault(axis)
        self.ask("enable", axis=axis, on=1)
        for _ in range(round(_CHECK_S / _POLL_S)):
            status = self.status(axis)
            if status.mode == wire.code("MODES", "HOLD"):
                return
            self.check_fault(axis)
            wait(_POLL_S)
        raise TautError(f"axis {axis} is {wire.text('MODES', status.mode)}, not switched on: stop it, then run again")

    def load_table(
        self,
        axis: int,
        blob: bytes,
        progress: Callable[[float, str], None] | None = None,
        any_instrument: bool = False,
    ) -> None:
        """Stores a table for an axis on the board, reads it back and compares. By DFU on USB, else in messages; motors
        have to be off. blob: as of tl_table.h; progress: gets the share sent, 0 to 1, and a word; any_instrument: takes
        a table of another instrument than the axis' settings name. TautError where the board refuses or holds another
        one."""
        self.check_axis(axis)
        if any_instrument:
            self.ask("any_table", axis=axis)
        dfu = self._link.tables(axis)
        if dfu is None:
            self.load_table_by_messages(axis, blob, progress)
            stored = self.read_table_by_messages(axis)
        else:
            try:
                with dfu as route:
                    route.download(blob, progress)
                    stored = route.upload()
            except DfuError as error:
                raise self._refusal(axis, error) from error
        if stored != blob:
            raise TautError(f"axis {axis}: the board holds another table than was sent: flash it again")

    def read_table(self, axis: int) -> bytes:
        """Reads the table in use from the board: the blob of tl_table.h; b"" where the axis has none."""
        self.check_axis(axis)
        dfu = self._link.tables(axis)
        if dfu is None:
            return self.read_table_by_messages(axis)
        with dfu as route:
            return bytes(route.upload())

    def firmware_route(self) -> Any:
        """Returns a context (see Link.tables) with download() for new firmware; None where the link has no DFU
        interface. On DFU the firmware is the alternate setting after those of the axes' tables."""
        return self._link.tables(self.axes)

    def load_table_by_messages(
        self, axis: int, blob: bytes, progress: Callable[[float, str], None] | None = None
    ) -> None:
        """Stores a table by messages, which any link carries; `load_table` uses this where there is no DFU. progress:
        gets the share sent, 0 to 1, and a word. TautError with the board's reason where it refuses."""
        part = wire.wire.PART
        try:
            for offset in range(0, len(blob), part):
                piece = blob[offset : offset + part]
                values = tuple(piece) + (0,) * (part - len(piece))
                self.ask("table_write", axis=axis, count=len(piece), offset=offset, bytes=values)
                if progress:
                    progress(min((offset + part) / len(blob), 1.0), "loading")
            self.ask("table_store", _STORE_S, axis=axis, size=len(blob))
        except BoardRefused as error:
            status = self.status(axis)
            if error.reason == "TABLE_REFUSED" and status.table_reason:
                says = f"the board refused the table of axis {axis}: {wire.table_reason(status.table_reason)}"
            else:
                says = f"the board refused the table: {_TABLE_REFUSED.get(error.reason, str(error))}"
            raise TautError(says + _table_lost(status)) from error

    def read_table_by_messages(self, axis: int) -> bytes:
        """The table in use, read by messages, which any link carries; b"" where the axis has none. TautError where it
        is longer than a table can be."""
        blob = bytearray()
        while len(blob) <= _native.TABLE_SIZE_MAX:
            part = self.ask("table_read", axis=axis, offset=len(blob))
            blob += bytes(part.bytes[: part.count].tolist())
            if part.count < wire.wire.PART:
                return bytes(blob)
        raise TautError(f"{self.where}: the table of axis {axis} does not end: switch it off and on")

    def _refusal(self, axis: int, error: DfuError) -> TautError:
        """The error to raise for a table that was refused over DFU: DFU has a single byte for the reason, so the axis'
        status is asked for more."""
        status = self.status(axis)
        if error.status == 0x02 and status.table_reason:  # DFU's errFILE: the table does not fit
            says = f"the board refused the table of axis {axis}: {wire.table_reason(status.table_reason)}"
            return TautError(says + _table_lost(status))
        return TautError(f"{error}{_table_lost(status)}") if _table_lost(status) else error


def _table_lost(status: wire.Message) -> str:
    """Returns the end of the error for a refused table, which says that the table in use before is damaged, too; ""
    where it is not."""
    if status.table != wire.code("TABLES", "BAD"):
        return ""
    return "; the one that was in use is damaged in flash: flash a table that is whole"
