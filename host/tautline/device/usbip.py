"""USB/IP client: the protocol alone, without any USB library (`usbip_backend` puts PyUSB's interface on it).

Only the standard library is used, so that a bridge run by another interpreter can use this file too.
Failures are OSError with the errno that libusb's callers know: EPIPE stall, ETIMEDOUT, ENODEV gone, EBUSY in use.
"""

from __future__ import annotations

import contextlib
import errno
import select
import socket
import struct
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field

VERSION = 0x0111
_OP_DEVLIST, _OP_IMPORT = 0x8005, 0x8003
_CMD_SUBMIT, _CMD_UNLINK, _RET_SUBMIT, _RET_UNLINK = 1, 2, 3, 4
_OP = struct.Struct(">HHI")  # version, code, status
_DEVICE = struct.Struct(">256s32sIIIHHHBBBBBB")  # path, busid, bus, device, speed, ids, bcdDevice, class, configuration
# Header: command, seqnum, devid, direction, endpoint; then of SUBMIT flags, length, start frame, packets, interval and
# set-up packet, of RET_SUBMIT status, actual length and more, of UNLINK the seqnum that it ends.
_URB = struct.Struct(">IIIIIiiiii8s")
_CONNECT_S = 3.0
_UNLINK_S = 1.0


@dataclass(frozen=True)
class Exported:
    """One entry of a server's device list."""

    host: str
    port: int
    busid: str
    bus: int
    device: int
    speed: int  # 1 low, 2 full, 3 high
    vendor: int
    product: int
    release: int  # bcdDevice
    device_class: tuple[int, int, int]
    configuration: int
    configurations: int

    @property
    def devid(self) -> int:
        """The device as requests name it: bus in the upper 16 bits, device number in the lower."""
        return self.bus << 16 | self.device

    @classmethod
    def unpack(cls, host: str, port: int, raw: bytes) -> tuple[Exported, int]:
        """Decodes a record of a device list (_DEVICE): returns the entry, and how many interface records follow it.
        host, port: of the server."""
        _, busid, bus, device, speed, vendor, product, release, *classes_and_counts = _DEVICE.unpack(raw)
        *device_class, configuration, configurations, interfaces = classes_and_counts
        entry = cls(
            host=host, port=port, busid=busid.split(b"\0", 1)[0].decode("ascii", "replace"), bus=bus, device=device,
            speed=speed, vendor=vendor, product=product, release=release, device_class=tuple(device_class),
            configuration=configuration, configurations=configurations,
        )  # fmt: skip
        return entry, interfaces


def _receive(sock: socket.socket, size: int) -> bytes:
    """Receives exactly `size` bytes. OSError ENODEV where the connection ends before."""
    data = bytearray()
    while len(data) < size:
        chunk = sock.recv(size - len(data))
        if not chunk:
            raise OSError(errno.ENODEV, "the USB/IP server closed the connection")
        data += chunk
    return bytes(data)


def _connect(host: str, port: int) -> socket.socket:
    """Connects to the server; the connection and each later call may take _CONNECT_S. Returns the socket. OSError
    ENODEV where no server answers."""
    try:
        sock = socket.create_connection((host, port), timeout=_CONNECT_S)
    except OSError as error:
        raise OSError(errno.ENODEV, f"no USB/IP server answers at {host}:{port}") from error
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return sock


def devices(host: str, port: int) -> list[Exported]:
    """Asks the server at host:port for the devices that it exports. OSError: ENODEV where no server answers, EPROTO
    where it does not speak USB/IP."""
    with _connect(host, port) as sock:
        try:
            sock.sendall(_OP.pack(VERSION, _OP_DEVLIST, 0))
            version, code, status = _OP.unpack(_receive(sock, _OP.size))
            # A reply has its request's code without the top bit.
            if code != _OP_DEVLIST & 0x7FFF or status != 0:
                raise OSError(errno.EPROTO, f"{host}:{port} does not speak USB/IP (version {version:#06x})")
            exported = []
            for _ in range(struct.unpack(">I", _receive(sock, 4))[0]):
                entry, interfaces = Exported.unpack(host, port, _receive(sock, _DEVICE.size))
                _receive(sock, 4 * interfaces)  # the classes of its interfaces, not needed
                exported.append(entry)
            return exported
        except TimeoutError as error:
            raise OSError(errno.EPROTO, f"{host}:{port} does not speak USB/IP") from error


_IMPORT_ERRNO = {1: errno.EBUSY, 2: errno.EBUSY, 4: errno.ENODEV}  # ST_NA, ST_DEV_BUSY, ST_NODEV
_URB_ERRNO = {
    -errno.EPIPE: errno.EPIPE,
    -errno.EOVERFLOW: errno.EOVERFLOW,
    -errno.ESHUTDOWN: errno.ENODEV,
    -errno.ENODEV: errno.ENODEV,
}


@dataclass
class Urb:
    """One transfer. `status` is None while it is under way, then 0 or a negative errno as Linux gives it."""

    seqnum: int
    endpoint: int  # without direction
    reading: bool
    length: int
    status: int | None = None
    actual: int = 0
    data: bytes = b""
    unlink: int = 0  # seqnum of the UNLINK that was sent for it
    context: object = field(default=None, repr=False)  # the caller's

    def result(self) -> int:
        """Returns the number of bytes that a finished transfer has moved; OSError where it failed."""
        if self.status:
            code = _URB_ERRNO.get(self.status, errno.EIO)
            raise OSError(code, f"endpoint {self.endpoint} {'in' if self.reading else 'out'}: {errno.errorcode[code]}")
        return self.actual


class Connection:
    """An imported device. Any thread may transfer. Of the threads that wait for a transfer one receives for all of
    them, so that no thread for receiving is needed."""

    def __init__(self, device: Exported) -> None:
        """Imports the device from its server. OSError: EBUSY while another host has it, ENODEV where it is gone."""
        self.device = device
        self._changed = threading.Condition()
        self._sending = threading.Lock()
        self._receiving = False  # whether a thread reads the socket, for all that wait
        self._seqnum = 0  # of the last request
        self._pending: dict[int, Urb] = {}  # transfers without an answer, by seqnum
        self._unlinks: dict[int, Urb] = {}  # those that are being ended, by the seqnum of that request
        self._input = bytearray()  # what has come of the next answer
        self.lost = False
        self._socket = _connect(device.host, device.port)
        try:
            self._socket.sendall(_OP.pack(VERSION, _OP_IMPORT, 0) + device.busid.encode().ljust(32, b"\0"))
            _, code, status = _OP.unpack(_receive(self._socket, _OP.size))
            if code != _OP_IMPORT & 0x7FFF or status != 0:
                number = _IMPORT_ERRNO.get(status, errno.EIO)
                raise OSError(number, f"USB/IP import of {device.busid} was refused: {errno.errorcode[number]}")
            _receive(self._socket, _DEVICE.size)  # the device once more
        except BaseException as error:
            self._socket.close()
            if isinstance(error, TimeoutError):
                raise OSError(errno.ENODEV, "the USB/IP server does not answer") from error
            raise
        self._socket.setblocking(False)

    def fileno(self) -> int:
        """The socket's file descriptor, for select; readable when `receive` has something to take in."""
        return self._socket.fileno()

    def close(self) -> None:
        """Closes the connection and waits until the server has released the device, so that the next import finds it
        free."""
        self._abort()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
            self._socket.settimeout(_UNLINK_S)
            while self._socket.recv(1 << 16):
                pass
        self._socket.close()

    def submit(self, endpoint: int, data: bytes | None, length: int = 0, setup: bytes = b"") -> Urb:
        """Starts a transfer and returns it: sends `data`, or receives up to `length` bytes if `data` is None. setup:
        the 8-byte set-up packet of a control transfer, on endpoint 0. OSError ENODEV where the device is gone."""
        reading = data is None
        size = length if data is None else len(data)
        with self._changed:
            if self.lost:
                raise OSError(errno.ENODEV, "the device is gone")
            self._seqnum += 1
            urb = Urb(self._seqnum, endpoint & 0x0F, reading, size)
            self._pending[urb.seqnum] = urb
        header = _URB.pack(
            *(_CMD_SUBMIT, urb.seqnum, self.device.devid, int(reading), urb.endpoint),
            *(0, size, 0, 0, 0),  # no flags; the last three are of isochronous and interrupt transfers alone
            setup,
        )
        self._send(header + (data or b""))
        return urb

    def unlink(self, urb: Urb) -> None:
        """Asks the server to cancel a transfer, which then ends normally or with status -ECONNRESET. Does nothing for
        one that is done or is being cancelled already."""
        with self._changed:
            if urb.status is not None or urb.unlink or self.lost:
                return
            self._seqnum += 1
            urb.unlink = self._seqnum
            self._unlinks[urb.unlink] = urb
        self._send(
            _URB.pack(
                _CMD_UNLINK, urb.unlink, self.device.devid, int(urb.reading), urb.endpoint, urb.seqnum, *4 * [0], b""
            )
        )

    def wait(self, urb: Urb, timeout_s: float | None) -> bool:
        """Waits until the transfer is done; returns False where that takes longer than timeout_s (None waits for ever).
        Receives what the server sends, unless another thread does so already."""
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with self._changed:
            while urb.status is None:
                left = None if deadline is None else deadline - time.monotonic()
                if left is not None and left <= 0.0:
                    return False
                if self._receiving:
                    self._changed.wait(left)
                    continue
                self._receiving = True  # this thread receives for all, without holding the lock
                self._changed.release()
                try:
                    self.receive(left)
                finally:
                    self._changed.acquire()
                    self._receiving = False
                    self._changed.notify_all()
        return True

    def transfer(self, endpoint: int, data: bytes | None, length: int, setup: bytes, timeout_ms: int) -> Urb:
        """Makes one whole transfer and returns it: sends `data`, or receives up to `length` bytes if `data` is None.
        setup: as in `submit`; timeout_ms: 0 waits for ever. At its time-out a transfer is cancelled; one that has moved
        bytes by then counts as done. OSError where it fails, ETIMEDOUT where it moved none."""
        urb = self.submit(endpoint, data, length, setup)
        try:
            done = self.wait(urb, timeout_ms / 1000.0 if timeout_ms > 0 else None)
        except BaseException:  # Ctrl-C: left behind, it would take the next transfer's data
            self.unlink(urb)
            raise
        if not done:
            self.unlink(urb)
            self.wait(urb, _UNLINK_S)
            if urb.status in (None, -errno.ECONNRESET):  # no answer to the unlink, or that it ended the transfer
                if not urb.actual:
                    raise OSError(errno.ETIMEDOUT, f"endpoint {endpoint:#04x}: timed out after {timeout_ms} ms")
                urb.status = 0
        urb.result()
        return urb

    def receive(self, timeout_s: float | None) -> list[Urb]:
        """Takes in what the server sends within timeout_s (None waits for ever); returns the transfers that ended by
        it. Where the connection has failed, all that were under way end."""
        poll = select.poll()
        try:
            poll.register(self._socket, select.POLLIN)
            if not poll.poll(None if timeout_s is None else max(timeout_s, 0.0) * 1000.0):
                return []
            chunk = self._socket.recv(1 << 18)
        except BlockingIOError:  # nothing there after all
            return []
        except (OSError, ValueError):
            chunk = b""
        if not chunk:
            return self._abort()
        with self._changed:
            self._input += chunk
            return list(self._completed_transfers())

    def _completed_transfers(self) -> Iterator[Urb]:
        """Decodes the replies in the receive buffer and yields the transfers that they end; an incomplete reply stays
        in the buffer. A reply of unknown kind, or with more bytes than were asked for, ends the connection."""
        while len(self._input) >= _URB.size:
            command, seqnum, _, _, _, status, actual, _, _, _, _ = _URB.unpack_from(self._input)
            if command == _RET_SUBMIT:
                urb = self._pending.get(seqnum)
                if urb is not None and not 0 <= actual <= urb.length:
                    yield from self._abort()
                    return
                size = actual if urb is not None and urb.reading else 0
                if len(self._input) < _URB.size + size:
                    return
                data = bytes(self._input[_URB.size : _URB.size + size])
                del self._input[: _URB.size + size]
                if urb is not None:
                    urb.actual, urb.data = actual, data
                    yield self._finish(urb, status)
            elif command == _RET_UNLINK:
                del self._input[: _URB.size]
                urb = self._unlinks.pop(seqnum, None)
                if urb is not None and urb.status is None:
                    yield self._finish(urb, -errno.ECONNRESET)
            else:  # the stream has lost its frame: nothing after this can be trusted
                yield from self._abort()
                return

    def _finish(self, urb: Urb, status: int) -> Urb:
        """Marks a transfer that was under way as done, with its status: 0, or a negative errno as Linux gives it."""
        urb.status = status
        self._pending.pop(urb.seqnum, None)
        return urb

    def _abort(self) -> list[Urb]:
        """Marks the connection as lost; returns the transfers that were under way, which end with -ESHUTDOWN."""
        with self._changed:
            self.lost = True
            ended = [self._finish(urb, -errno.ESHUTDOWN) for urb in list(self._pending.values())]
            self._input.clear()
            self._changed.notify_all()
            return ended

    def _send(self, message: bytes) -> None:
        """Sends a whole message, waiting where the socket takes no more. ENODEV where it fails, which ends the
        connection."""
        view = memoryview(message)
        with self._sending:
            while view:
                try:
                    view = view[self._socket.send(view) :]
                except BlockingIOError:
                    select.select([], [self._socket], [], _UNLINK_S)
                except OSError as error:
                    self._abort()
                    raise OSError(errno.ENODEV, "the device is gone") from error
