"""The USB/IP client against a small server with known misbehaviour: PyUSB sees what it would see from libusb."""

from __future__ import annotations

import errno
import socket
import struct
import threading
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest
import usb.core
import usb.util

from tautline.device import usb_link, usbip
from tautline.device.usbip_backend import Backend
from tautline.errors import TautError

DEVICE = struct.pack("<BBHBBBBHHHBBBB", 18, 1, 0x0210, 0, 0, 0, 64, 0xCAFE, 0x4011, 0x0107, 0, 0, 3, 1)
ENDPOINTS = [0x01, 0x81, 0x02, 0x82, 0x83]
CONFIGURATION = struct.pack("<BBHBBBBB", 9, 2, 18 + 7 * len(ENDPOINTS) + 9 * 2, 2, 1, 0, 0x80, 50)
CONFIGURATION += struct.pack("<9B", 9, 4, 0, 0, len(ENDPOINTS), 255, 0, 0, 0)
for number in ENDPOINTS:
    CONFIGURATION += struct.pack("<BBBBHB", 7, 5, number, 2, 64, 0)
CONFIGURATION += struct.pack("<9B", 9, 4, 1, 0, 0, 254, 1, 2, 0) + struct.pack("<BBBHHH", 9, 0x21, 7, 1, 64, 0x0110)
SERIAL = "echo-1"


class Server:
    """EP1 echoes; EP2 stalls until its halt is cleared; EP 0x83 is silent. One host at a time."""

    def __init__(self) -> None:
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.host: socket.socket | None = None
        self.halted = True
        self.unlinked = 0
        self.partial = b""
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self.listener.accept()
            except OSError:
                return
            threading.Thread(target=self._client, args=(client,), daemon=True).start()

    def unplug(self) -> None:
        assert self.host is not None
        self.host.shutdown(socket.SHUT_RDWR)

    def _client(self, client: socket.socket) -> None:
        with client:
            _, code, _ = struct.unpack(">HHI", client.recv(8, socket.MSG_WAITALL))
            entry = struct.pack(
                *(">256s32sIIIHHHBBBBBB", b"/echo", b"1-1", 1, 2, 2),
                *(0xCAFE, 0x4011, 0x0107, 0, 0, 0, 1, 1, 2),
            )
            if code == 0x8005:
                client.sendall(struct.pack(">HHII", 0x0111, 5, 0, 1) + entry + bytes(8))
                return
            client.recv(32, socket.MSG_WAITALL)
            if self.host is not None:
                client.sendall(struct.pack(">HHI", 0x0111, 3, 2))
                return
            self.host = client
            try:
                client.sendall(struct.pack(">HHI", 0x0111, 3, 0) + entry)
                self._transfers(client)
            except OSError:
                pass
            finally:
                self.host = None

    def _transfers(self, client: socket.socket) -> None:
        echo = bytearray()
        waiting: dict[int, int] = {}
        while len(header := client.recv(48, socket.MSG_WAITALL)) == 48:
            command, seqnum, _, reading, endpoint, target, length = struct.unpack(">7I", header[:28])
            if command == 2:
                self.unlinked += 1
                pending = waiting.pop(target, None) is not None
                if pending and self.partial:  # what had arrived goes out before the answer to the UNLINK
                    client.sendall(struct.pack(">10I", 3, target, 0, 0, 0, 0, len(self.partial), 0, 0, 0) + bytes(8))
                    client.sendall(self.partial)
                    pending = False
                status = -errno.ECONNRESET if pending else 0
                client.sendall(struct.pack(">5Ii", 4, seqnum, 0, 0, 0, status) + bytes(24))
                continue
            data = client.recv(length, socket.MSG_WAITALL) if length and not reading else b""
            status, actual, answer = 0, len(data), b""
            if endpoint == 0:
                status, answer = self._control(header[40:48])
                actual = len(answer) if reading else actual
            elif endpoint == 1 and reading:
                answer = bytes(echo[:length])
                del echo[:length]
                actual = len(answer)
            elif endpoint == 1:
                echo += data
            elif endpoint == 2 and self.halted:
                status = -errno.EPIPE
            elif endpoint == 3:
                waiting[seqnum] = length
                continue
            client.sendall(struct.pack(">5IiI", 3, seqnum, 0, 0, 0, status, actual) + bytes(20) + answer)

    def _control(self, setup: bytes) -> tuple[int, bytes]:
        kind, request, value, _, length = struct.unpack("<BBHHH", setup)
        if (kind, request) == (0x80, 6):
            text = SERIAL.encode("utf-16-le")
            answers = {0x100: DEVICE, 0x200: CONFIGURATION, 0x300: struct.pack("<BBH", 4, 3, 0x0409)}
            answers[0x303] = struct.pack("BB", 2 + len(text), 3) + text
            return (0, answers[value][:length]) if value in answers else (-errno.EPIPE, b"")
        if request == 9 and kind == 0:
            return 0, b""
        if (kind, request) == (0x02, 1):
            self.halted = False
            return 0, b""
        return -errno.EPIPE, b""


@pytest.fixture
def server() -> Iterator[Server]:
    server = Server()
    yield server
    server.listener.close()


def open_device(server: Server) -> usb.core.Device:
    device = usb.core.find(idVendor=0xCAFE, backend=Backend("127.0.0.1", server.port))
    assert device is not None
    return device


def test_descriptors_are_those_of_the_device(server: Server) -> None:
    device = open_device(server)
    assert (device.idProduct, device.bcdDevice, device.bcdUSB, device.serial_number) == (0x4011, 0x0107, 0x0210, SERIAL)
    configuration = device.get_active_configuration()
    assert [i.bInterfaceClass for i in configuration] == [255, 254]
    assert [e.bEndpointAddress for e in configuration[(0, 0)]] == ENDPOINTS
    assert bytes(configuration[(1, 0)].extra_descriptors)[:3] == bytes([9, 0x21, 7])
    usb.util.dispose_resources(device)


def test_bulk_echo_of_any_length(server: Server) -> None:
    device = open_device(server)
    for length in (1, 63, 64, 65, 512, 100_000):
        data = bytes(i * 7 & 0xFF for i in range(length))
        assert device.write(0x01, data) == length
        assert bytes(device.read(0x81, length)) == data
    usb.util.dispose_resources(device)


def test_a_stall_is_epipe_until_it_is_cleared(server: Server) -> None:
    device = open_device(server)
    with pytest.raises(usb.core.USBError) as stalled:
        device.write(0x02, b"x")
    assert stalled.value.errno == errno.EPIPE
    device.clear_halt(0x02)
    assert device.write(0x02, b"x") == 1
    with pytest.raises(usb.core.USBError) as refused:
        device.ctrl_transfer(0x40, 0x77, 0, 0, b"")
    assert refused.value.errno == errno.EPIPE
    usb.util.dispose_resources(device)


def test_a_time_out_unlinks_and_the_device_goes_on(server: Server) -> None:
    device = open_device(server)
    start = time.monotonic()
    with pytest.raises(usb.core.USBTimeoutError) as late:
        device.read(0x83, 64, timeout=30)
    assert late.value.errno == errno.ETIMEDOUT
    assert 0.02 < time.monotonic() - start < 5.0
    assert server.unlinked == 1
    device.write(0x01, b"still there")
    assert bytes(device.read(0x81, 64)) == b"still there"
    server.partial = b"half"
    assert bytes(device.read(0x83, 64, timeout=30)) == b"half"  # as with libusb, what had arrived counts
    usb.util.dispose_resources(device)


def test_one_thread_reads_while_another_writes(server: Server) -> None:
    device = open_device(server)
    outcome: list[int | None] = []

    def wait() -> None:
        try:
            device.read(0x83, 64, timeout=5000)
        except usb.core.USBError as error:
            outcome.append(error.errno)

    device.write(0x01, b"claims")
    reader = threading.Thread(target=wait)
    reader.start()
    for i in range(200):
        device.write(0x01, bytes([i]))
    assert len(device.read(0x81, 300)) == 206
    server.unplug()
    reader.join(2.0)
    assert outcome == [errno.ENODEV]
    with pytest.raises(usb.core.USBError) as gone:
        device.write(0x01, b"x")
    assert gone.value.errno == errno.ENODEV
    usb.util.dispose_resources(device)


def test_a_second_host_is_refused_and_the_next_one_is_not(server: Server) -> None:
    device = open_device(server)
    device.write(0x01, b"mine")
    other = open_device(server)  # listed, not disturbed
    assert (other.idProduct, other.bcdDevice) == (0x4011, 0x0107)
    with pytest.raises(usb.core.USBError) as busy:
        other.write(0x01, b"x")
    assert busy.value.errno == errno.EBUSY
    assert bytes(device.read(0x81, 64)) == b"mine"
    usb.util.dispose_resources(device)
    assert other.write(0x01, b"x") == 1
    usb.util.dispose_resources(other)


def test_no_server_and_a_server_of_something_else() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(OSError) as absent:
        usbip.devices("127.0.0.1", port)
    assert absent.value.errno == errno.ENODEV
    with socket.create_server(("127.0.0.1", 0)) as other:

        def answer() -> None:
            client, _ = other.accept()
            client.sendall(b"SSH-2.0-whatever\r\n")
            client.recv(100)
            client.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(OSError) as foreign:
            usbip.devices("127.0.0.1", other.getsockname()[1])
        assert foreign.value.errno == errno.EPROTO
        thread.join()


class Damaged(Server):
    """Its control transfers are damaged in one way, or it is unplugged when it is asked for its name."""

    def __init__(self, damage: str) -> None:
        super().__init__()
        self.damage = damage

    def _control(self, setup: bytes) -> tuple[int, bytes]:
        if self.damage == "gone" and setup[3] == 3:  # a string
            self.unplug()
        status, answer = super()._control(setup)
        if self.damage == "short":
            answer = answer[:5]
        elif self.damage == "long" and answer:
            answer += bytes(100)
        elif self.damage == "bare" and answer[:2] == DEVICE[:2]:
            answer = answer[:-1] + bytes(1)
        return status, answer


@pytest.mark.parametrize("damage", ["gone", "short", "long", "bare"])
def test_a_board_that_goes_or_is_damaged_while_it_is_looked_for_is_no_traceback(
    damage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    ids = SimpleNamespace(USB_VENDOR=0xCAFE, USB_PRODUCT=0x4011, USB_MANUFACTURER="")
    monkeypatch.setattr(usb_link, "wire", SimpleNamespace(wire=ids))
    server = Damaged(damage)
    where = f"usbip:127.0.0.1:{server.port}"
    if damage == "gone":
        (board,) = usb_link.find_usbip(where)
        assert board.serial is None and board.busy
    else:
        with pytest.raises(TautError, match=where):
            usb_link.find_usbip(where)
    server.listener.close()
