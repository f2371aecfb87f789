"""Boards on USB and USB/IP: found by their ids and names, opened, read and written by PyUSB."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from typing import Any

import libusb_package
import usb.core
import usb.util

from tautline.device import usbip_backend, wire
from tautline.device.dfu import Dfu
from tautline.device.holder import busy_in_words
from tautline.device.link import BoardAddress, board_gone, board_takes_no_data
from tautline.errors import TautError

ENVIRONMENT = "TAUTLINE_BOARD"
_OUT, _IN = 0x01, 0x81
_CONTROL, _TABLES = 0, 1  # interfaces
_READ_BYTES = 4096
_WRITE_MS = 3000  # a board takes data within milliseconds; a host that stands still for a second is no fault of it


class UsbLink:
    """A `Link` to a board on USB or USB/IP: the vendor interface carries messages, the DFU interface tables."""

    hello_tries = 1
    log_divider = 1

    def __init__(self, device: usb.core.Device, where: str) -> None:
        """Opens the device by claiming its vendor interface. where: the board's address, for errors. TautError, with a
        remedy, where that fails."""
        self.device, self._where = device, where
        with self._usb_errors_as_taut_errors():
            usb.util.claim_interface(device, _CONTROL)

    def write(self, data: bytes) -> None:
        """Sends all bytes. TautError where the board does not take them within _WRITE_MS."""
        with self._usb_errors_as_taut_errors():
            self.device.write(_OUT, data, timeout=_WRITE_MS)

    def read(self, timeout_s: float) -> bytes:
        """Returns the bytes that came, b"" where none did within timeout_s. BoardGone where the board is unplugged."""
        with self._usb_errors_as_taut_errors():
            try:
                # A time-out of 0 ms would wait for ever.
                return bytes(self.device.read(_IN, _READ_BYTES, timeout=max(round(timeout_s * 1000), 1)))
            except usb.core.USBTimeoutError:
                return b""

    @contextlib.contextmanager
    def tables(self, axis: int) -> Iterator[Dfu]:
        """A context that yields the DFU interface set to an axis' table; with the number of axes as `axis`, to the
        firmware."""
        with self._usb_errors_as_taut_errors(), Dfu(self.device, _TABLES, axis) as dfu:
            yield dfu

    def bus(self) -> dict[str, Any]:
        """Returns {}: this is a board, not motors on a bus of their own."""
        return {}

    def close(self) -> None:
        """Releases the device; errors are ignored, as of a device that is gone."""
        with contextlib.suppress(usb.core.USBError):
            usb.util.dispose_resources(self.device)

    @contextlib.contextmanager
    def _usb_errors_as_taut_errors(self) -> Iterator[None]:
        """A context within which a USB error becomes a TautError with its remedy."""
        try:
            yield
        except usb.core.USBError as error:
            raise self._error_with_remedy(error) from error

    def _error_with_remedy(self, error: usb.core.USBError) -> TautError:
        """Returns the TautError to raise for a USB error, with its remedy; BoardGone where the device is gone."""
        if error.errno in (errno.ENODEV, errno.EIO, errno.ESHUTDOWN, errno.ENOENT):
            return board_gone(self._where)
        if error.errno == errno.EBUSY:
            return TautError(busy_in_words(self._where))
        if error.errno == errno.EACCES:
            mend = "sudo cp tools/70-tautline.rules /etc/udev/rules.d/"
            return TautError(f"{self._where}: no permission: run '{mend}' and plug the board in again")
        if error.errno == errno.ETIMEDOUT:
            return board_takes_no_data(self._where)
        return TautError(f"{self._where}: USB failed ({error}): unplug the board and plug it in again")


def _board_address(device: usb.core.Device, where: str, serial: str | None) -> BoardAddress:
    """Returns the BoardAddress of a USB device that was found. where: its address; serial: its serial number, None
    marks it as busy. The device's bcdDevice is the version of the protocol that it speaks, major and minor."""
    protocol = (device.bcdDevice >> 8, device.bcdDevice & 0xFF)
    busy_or_forbidden = serial is None
    return BoardAddress(where, serial, busy=busy_or_forbidden, protocol=protocol, open=lambda: UsbLink(device, where))


def _serial_number(device: usb.core.Device) -> str | None:
    """Asks for a device's serial number; None where it is in use, may not be asked, or is gone. Leaves the device
    closed."""
    try:
        serial: str | None = device.serial_number
        return serial
    except (usb.core.USBError, ValueError):
        return None
    finally:
        usb.util.dispose_resources(device)


def find_usb() -> list[BoardAddress]:
    """Returns the boards on this machine's USB, those that cannot be opened marked busy; [] where libusb is missing."""
    backend = libusb_package.get_libusb1_backend()
    if backend is None:
        return []
    boards = []
    for device in _tautline_devices(backend):
        serial = _serial_number(device)
        boards.append(_board_address(device, f"usb:{serial or f'{device.bus}-{device.address}'}", serial))
    return boards


def find_usbip(where: str) -> list[BoardAddress]:
    """Returns the boards that the USB/IP server at usbip:HOST:PORT exports; those that another host uses are marked
    busy. TautError for another form of address, or where no server answers."""
    address = where.split(":")
    if len(address) != 3 or not address[2].isdigit():
        raise TautError(f"--board {where}: expected usbip:HOST:PORT, such as usbip:127.0.0.1:3240")
    try:
        devices = list(_tautline_devices(usbip_backend.Backend(address[1], int(address[2]))))
    except usb.core.USBError as error:
        raise TautError(f"{where}: {error.strerror}: start the board, or name another with --board") from error
    # One that is in use has no serial number, so it is marked busy: the server's list has none, and it is not asked.
    return [_board_address(device, where, _serial_number(device)) for device in devices]


def address_in_environment() -> str | None:
    """The value of the environment variable TAUTLINE_BOARD, a board's address, None where it is not set."""
    return os.environ.get(ENVIRONMENT)


def _tautline_devices(backend: Any) -> Iterator[usb.core.Device]:
    """Yields the USB devices of a PyUSB backend that are boards: by vendor and product number and, as others may share
    these, by the manufacturer's name where it can be asked for."""
    devices = usb.core.find(
        find_all=True, backend=backend, idVendor=wire.wire.USB_VENDOR, idProduct=wire.wire.USB_PRODUCT
    )
    for device in devices:
        with contextlib.suppress(usb.core.USBError, ValueError):  # the pair of numbers may be shared: ask for the name
            if device.iManufacturer and device.manufacturer != wire.wire.USB_MANUFACTURER:
                continue
        yield device
