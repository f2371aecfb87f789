"""Runs a program with a USB/IP server's device in a /dev/bus/usb of its own: unmodified libusb and what uses it.

    umockdev-wrapper /usr/bin/python3 tests/board/umockdev_bridge.py HOST:PORT -- dfu-util -l

The program's usbfs ioctls arrive here and go on as USB/IP transfers. No root, no kernel support. Needs Debian's
gir1.2-umockdev-1.0 and python3-gi, hence the system's interpreter; of tautline it uses only the USB/IP protocol.
"""

import errno
import importlib.util
import struct
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import gi

gi.require_version("UMockdev", "1.0")
from gi.repository import GLib, UMockdev  # noqa: E402

_protocol = Path(__file__).resolve().parents[2] / "host" / "tautline" / "device" / "usbip.py"
_spec = importlib.util.spec_from_file_location("usbip", _protocol)
assert _spec is not None and _spec.loader is not None
usbip = importlib.util.module_from_spec(_spec)
sys.modules["usbip"] = usbip
_spec.loader.exec_module(usbip)

NODE = "/dev/bus/usb/001/002"
SYSFS = "/devices/platform/tautline/usb1/1-1"
SPEEDS = {1: "1.5", 2: "12", 3: "480"}

# linux/usbdevice_fs.h, 64-bit
CONTROL, BULK, SET_INTERFACE, SET_CONFIGURATION = 0xC0185500, 0xC0185502, 0x80085504, 0x80045505
GET_DRIVER, SUBMIT, DISCARD, REAP, REAP_NOW = 0x41045508, 0x8038550A, 0x550B, 0x4008550C, 0x4008550D
CLAIM, RELEASE, RESET, CLEAR_HALT = 0x8004550F, 0x80045510, 0x5514, 0x80045515
CAPABILITIES, DISCONNECT_CLAIM, SPEED = 0x8004551A, 0x8108551B, 0x551F
CAPABILITY_BITS = 0x01 | 0x04 | 0x10  # zero packets, no packet size limit, reap after disconnect
URB_BULK, URB_CONTROL = 3, 2
URB_BYTES = 56


class Program:
    """What one open file of the program has under way."""

    def __init__(self) -> None:
        self.pending: list[Any] = []
        self.done: list[Any] = []
        self.claimed: set[int] = set()


class Transfer:
    """A usbfs URB: where its structure is in the program's memory, and how long its buffer is."""

    def __init__(self, address: int, length: int, setup_bytes: int) -> None:
        self.address, self.length, self.setup_bytes = address, length, setup_bytes
        self.transfer: Any = None


class Bridge:
    def __init__(self, host: str, port: int) -> None:
        self.connection = usbip.Connection(usbip.devices(host, port)[0])
        self.programs: dict[Any, Program] = {}
        self.lock = threading.Lock()  # umockdev answers ioctls on a thread of its own
        device = self._get_descriptor(1, 0, 18)
        configuration = self._get_descriptor(2, 0, 9)
        configuration = self._get_descriptor(2, 0, struct.unpack_from("<H", configuration, 2)[0])
        self._control(struct.pack("<BBHHH", 0, 9, configuration[5], 0, 0))
        self.testbed = UMockdev.Testbed.new()
        self.ioctls = UMockdev.IoctlBase.new()
        self.ioctls.connect("handle-ioctl", self._ioctl)
        self.ioctls.connect("client-connected", lambda _, client: self.programs.setdefault(client, Program()))
        self.ioctls.connect("client-vanished", self._vanished)
        self.testbed.attach_ioctl(NODE, self.ioctls)
        self.testbed.add_from_string(
            f"P: {SYSFS}\nN: bus/usb/001/002\n"
            f"E: SUBSYSTEM=usb\nE: DEVTYPE=usb_device\nE: DEVNAME={NODE}\nE: BUSNUM=001\nE: DEVNUM=002\n"
            "E: MAJOR=189\nE: MINOR=1\n"
            f"A: busnum=1\\n\nA: devnum=2\\n\nA: speed={SPEEDS[self.connection.device.speed]}\\n\n"
            f"A: bConfigurationValue={configuration[5]}\\n\nA: bNumConfigurations=1\\n\n"
            f"A: idVendor={device[9]:02x}{device[8]:02x}\\n\nA: idProduct={device[11]:02x}{device[10]:02x}\\n\n"
            f"H: descriptors={(device + configuration).hex()}\n"
        )
        GLib.io_add_watch(
            GLib.IOChannel.unix_new(self.connection.fileno()),
            GLib.PRIORITY_HIGH,
            GLib.IO_IN | GLib.IO_HUP,
            self._readable,
        )

    def _control(self, setup: bytes, data: bytes | None = b"") -> Any:
        length = struct.unpack_from("<H", setup, 6)[0]
        return self.connection.transfer(0, data, length, setup, 1000)

    def _get_descriptor(self, kind: int, index: int, length: int) -> bytes:
        found: bytes = self._control(struct.pack("<BBHHH", 0x80, 6, kind << 8 | index, 0, length), None).data
        return found

    def _vanished(self, _: Any, client: Any) -> None:
        for transfer in self.programs.pop(client, Program()).pending:
            if not self.connection.lost:
                self.connection.unlink(transfer.transfer)

    def _readable(self, *_: Any) -> bool:
        with self.lock:
            self._deliver(self.connection.receive(0.0))
        if self.connection.lost:  # as the kernel does when a plug is pulled
            self.testbed.uevent("/sys" + SYSFS, "remove")
            self.testbed.remove_device("/sys" + SYSFS)
        return not self.connection.lost

    def _deliver(self, ended: list[Any]) -> None:
        for finished in ended:
            program, transfer = finished.context or (None, None)
            if transfer is None or transfer not in program.pending:
                continue
            program.pending.remove(transfer)
            program.done.append(transfer)

    def _ioctl(self, _: Any, client: Any) -> bool:
        with self.lock:
            try:
                client.complete(self._answer(client, client.get_request() & 0xFFFFFFFF), 0)
            except OSError as error:
                client.complete(-1, error.errno)
        return True

    def _answer(self, client: Any, request: int) -> int:
        program = self.programs.setdefault(client, Program())
        arg = client.get_arg()
        if request in (REAP, REAP_NOW):
            return self._reap(program, arg)
        if self.connection.lost:
            raise OSError(errno.ENODEV, "gone")
        if request == SPEED:
            return int(self.connection.device.speed)
        if request == SUBMIT:
            self._submit(program, arg)
        elif request == DISCARD:
            self._discard(program, _pointer(arg))
        elif request == CAPABILITIES:
            arg.resolve(0, 4).update(0, struct.pack("<I", CAPABILITY_BITS))
        elif request == GET_DRIVER:
            raise OSError(errno.ENODATA, "no kernel driver")
        elif request in (CLAIM, DISCONNECT_CLAIM):
            self._claim(program, _number(arg))
        elif request == RELEASE:
            program.claimed.discard(_number(arg))
        elif request != RESET:
            self._control(_standard_request(request, arg))
        return 0

    def _discard(self, program: Program, address: int) -> None:
        for transfer in program.pending:
            if transfer.address == address:
                return self.connection.unlink(transfer.transfer)
        raise OSError(errno.EINVAL, "not under way")

    def _claim(self, program: Program, number: int) -> None:
        if any(number in other.claimed for other in self.programs.values() if other is not program):
            raise OSError(errno.EBUSY, "claimed")
        program.claimed.add(number)

    def _submit(self, program: Program, arg: Any) -> None:
        address = _pointer(arg)
        urb = arg.resolve(0, URB_BYTES)
        fields = urb.retrieve()
        kind, endpoint = fields[0], fields[1]
        length = struct.unpack_from("<i", fields, 24)[0]
        content = bytes(urb.resolve(16, length).retrieve()) if length else b""
        if kind == URB_CONTROL:
            setup, content = content[:8], content[8:]
            data = None if setup[0] & 0x80 else content
            transfer = Transfer(address, length, 8)
            transfer.transfer = self.connection.submit(0, data, struct.unpack_from("<H", setup, 6)[0], setup)
        elif kind == URB_BULK:
            transfer = Transfer(address, length, 0)
            transfer.transfer = self.connection.submit(endpoint, None if endpoint & 0x80 else content, length)
        else:
            raise OSError(errno.EINVAL, "neither control nor bulk")
        transfer.transfer.context = (program, transfer)
        program.pending.append(transfer)

    def _reap(self, program: Program, arg: Any) -> int:
        if not program.done:
            self._deliver(
                self.connection.receive(0.0005)
            )  # the node always polls as ready: without a pause libusb would spin
        if not program.done:
            raise OSError(errno.ENODEV if self.connection.lost else errno.EAGAIN, "nothing to reap")
        transfer = program.done.pop(0)
        finished = transfer.transfer
        slot = arg.resolve(0, 8)
        slot.update(0, struct.pack("<Q", transfer.address))
        urb = slot.resolve(0, URB_BYTES)  # what is updated on this path from `arg` is written when the ioctl completes
        status = -errno.ENOENT if finished.status == -errno.ECONNRESET else finished.status
        urb.update(4, struct.pack("<i", status))
        urb.update(28, struct.pack("<i", finished.actual))
        if finished.data:
            urb.resolve(16, transfer.length).update(transfer.setup_bytes, finished.data)
        return 0


def _pointer(arg: Any) -> int:
    """The address that the program passed; resolve() would replace it."""
    address: int = struct.unpack("<Q", bytes(arg.retrieve()))[0]
    return address


def _number(arg: Any) -> int:
    """The 32-bit number that the program passed by its address."""
    number: int = struct.unpack("<I", arg.resolve(0, 4).retrieve())[0]
    return number


def _standard_request(request: int, arg: Any) -> bytes:
    """The set-up packet (USB 2.0, table 9-3) that a kernel sends for this call."""
    if request == SET_INTERFACE:
        interface, setting = struct.unpack("<II", arg.resolve(0, 8).retrieve())
        return struct.pack("<BBHHH", 0x01, 11, setting, interface, 0)
    if request == SET_CONFIGURATION:
        return struct.pack("<BBHHH", 0x00, 9, _number(arg), 0, 0)
    if request == CLEAR_HALT:
        return struct.pack("<BBHHH", 0x02, 1, 0, _number(arg), 0)
    raise OSError(errno.ENOTTY, f"ioctl {request:#x}")


def main() -> int:
    separator = sys.argv.index("--")
    host, port = sys.argv[1].rsplit(":", 1)
    bridge = Bridge(host, int(port))
    loop = GLib.MainLoop()
    program = subprocess.Popen(sys.argv[separator + 1 :])
    GLib.child_watch_add(GLib.PRIORITY_DEFAULT, program.pid, lambda *_: loop.quit())
    loop.run()
    bridge.connection.close()
    return program.wait()


if __name__ == "__main__":
    sys.exit(main())
