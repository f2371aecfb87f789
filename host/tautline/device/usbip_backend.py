"""PyUSB over USB/IP: the calls are those of a board on a cable, with `backend=Backend(host, port)`."""

from __future__ import annotations

import array
import errno
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import usb.backend
import usb.core

from tautline.device import usbip

_DEVICE_TO_HOST = 0x80
_GET_DESCRIPTOR, _SET_CONFIGURATION, _GET_CONFIGURATION = 6, 9, 8
_CLEAR_FEATURE, _SET_INTERFACE = 1, 11
_DEVICE_TYPE, _CONFIGURATION_TYPE, _INTERFACE_TYPE, _ENDPOINT_TYPE = 1, 2, 4, 5
_CONTROL_MS = 10_000  # a simulated board answers when this machine lets it


class _Descriptor:
    """The fields of a standard descriptor under their names in the USB specification."""

    def __init__(self, names: str, layout: str, raw: bytes) -> None:
        """names: the fields in order; layout: their types as `struct` names them, little-endian. USBError where `raw`
        is shorter."""
        if len(raw) < struct.calcsize("<" + layout):
            raise usb.core.USBError("the device's descriptors are cut short", None, errno.EPROTO)
        for name, value in zip(names.split(), struct.unpack_from("<" + layout, raw), strict=True):
            setattr(self, name, value)
        self.extra_descriptors = b""
        self.children: list[_Descriptor] = []

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)


def _device(raw: bytes) -> _Descriptor:
    """A device descriptor, of 18 bytes."""
    names = (
        "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
        "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations"
    )
    return _Descriptor(names, "BBHBBBBHHHBBBB", raw)


def _configuration(raw: bytes) -> _Descriptor:
    """A configuration descriptor with its interfaces (one child for each alternate setting) and their endpoints, in
    order."""
    names = (
        "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes bMaxPower"
    )
    root = _Descriptor(names, "BBHBBBBB", raw)
    owner = root
    at = raw[0]
    while at + 2 <= len(raw) and raw[at] >= 2:
        length, kind = raw[at], raw[at + 1]
        part = raw[at : at + length]
        if kind == _INTERFACE_TYPE and length >= 9:
            names = (
                "bLength bDescriptorType bInterfaceNumber bAlternateSetting bNumEndpoints "
                "bInterfaceClass bInterfaceSubClass bInterfaceProtocol iInterface"
            )
            owner = _Descriptor(names, "9B", part)
            root.children.append(owner)
        elif kind == _ENDPOINT_TYPE and length >= 7:
            names = (
                "bLength bDescriptorType bEndpointAddress bmAttributes wMaxPacketSize bInterval bRefresh bSynchAddress"
            )
            endpoint = _Descriptor(names, "BBBBHBBB", part.ljust(9, b"\0"))  # the last two are of audio devices alone
            owner.children.append(endpoint)
        else:
            owner.extra_descriptors += part
        at += length
    return root


@dataclass
class _Device:
    """What PyUSB calls a device identification."""

    exported: usbip.Exported
    descriptor: _Descriptor | None = None
    configurations: dict[int, _Descriptor] = field(default_factory=dict)


@dataclass
class _Handle:
    connection: usbip.Connection
    configuration: int = 0


class Backend(usb.backend.IBackend):  # type: ignore[misc]
    """Devices of the USB/IP server at host:port. Errors are USBError with the errno that libusb's backend gives."""

    def __init__(self, host: str, port: int) -> None:
        self._address = host, port

    def enumerate_devices(self) -> Iterator[_Device]:
        with _usb_errors():
            return iter([_Device(exported) for exported in usbip.devices(*self._address)])

    def get_parent(self, dev: _Device) -> None:
        return None

    def get_device_descriptor(self, dev: _Device) -> _Descriptor:
        if dev.descriptor is None:
            self._read_descriptors(dev)
        assert dev.descriptor is not None
        return dev.descriptor

    def get_configuration_descriptor(self, dev: _Device, config: int) -> _Descriptor:
        """The configuration of this index; IndexError where there is none."""
        if config not in dev.configurations:
            self._read_descriptors(dev)
        try:
            return dev.configurations[config]
        except KeyError:
            raise IndexError(f"no configuration {config}") from None

    def get_interface_descriptor(self, dev: _Device, intf: int, alt: int, config: int) -> _Descriptor:
        """The descriptor of an interface's alternate setting, by their indices."""
        settings: dict[int, list[_Descriptor]] = {}
        for interface in self.get_configuration_descriptor(dev, config).children:
            settings.setdefault(interface.bInterfaceNumber, []).append(interface)
        return list(settings.values())[intf][alt]

    def get_endpoint_descriptor(self, dev: _Device, ep: int, intf: int, alt: int, config: int) -> _Descriptor:
        return self.get_interface_descriptor(dev, intf, alt, config).children[ep]

    def _read_descriptors(self, dev: _Device) -> None:
        """Reads a free device's descriptors from it; of a busy one, which is not disturbed, only what the server's list
        says."""
        exported = dev.exported
        try:
            with _usb_errors():
                connection = usbip.Connection(exported)
        except usb.core.USBError as error:
            if error.errno != errno.EBUSY:
                raise
            raw = struct.pack("<BBHBBBBHHHBBBB", 18, _DEVICE_TYPE, 0x0200, *exported.device_class, 64, exported.vendor,
                              exported.product, exported.release, 0, 0, 0, exported.configurations)  # fmt: skip
            dev.descriptor = self._located(_device(raw), exported)
            return
        try:
            self._read_open_descriptors(dev, _Handle(connection))
        finally:
            connection.close()

    def _read_open_descriptors(self, dev: _Device, handle: _Handle) -> None:
        """Reads an open device's descriptors by control transfers."""

        def descriptor(kind: int, index: int, length: int) -> bytes:
            return self._control_in(handle, _DEVICE_TO_HOST, _GET_DESCRIPTOR, kind << 8 | index, 0, length)

        dev.descriptor = self._located(_device(descriptor(_DEVICE_TYPE, 0, 18)), dev.exported)
        for index in range(dev.descriptor.bNumConfigurations):
            total = _configuration(descriptor(_CONFIGURATION_TYPE, index, 9)).wTotalLength
            dev.configurations[index] = _configuration(descriptor(_CONFIGURATION_TYPE, index, total))
        if not dev.configurations:
            raise usb.core.USBError("the device has no configuration", None, errno.EPROTO)

    @staticmethod
    def _located(descriptor: _Descriptor, exported: usbip.Exported) -> _Descriptor:
        """The descriptor with bus, address and speed from the server's list."""
        for name, value in (
            ("bus", exported.bus),
            ("address", exported.device),
            ("speed", exported.speed),
            ("port_number", None),
            ("port_numbers", None),
        ):
            setattr(descriptor, name, value)
        return descriptor

    def open_device(self, dev: _Device) -> _Handle:
        """Imports the device and sets its first configuration, as an operating system does. EBUSY while another host
        has it."""
        with _usb_errors():
            handle = _Handle(usbip.Connection(dev.exported))
        try:
            if not dev.configurations:
                self._read_open_descriptors(dev, handle)
            self.set_configuration(handle, dev.configurations[0].bConfigurationValue)
        except BaseException:
            handle.connection.close()
            raise
        return handle

    def close_device(self, dev_handle: _Handle) -> None:
        dev_handle.connection.close()

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        self._control_out(dev_handle, 0x00, _SET_CONFIGURATION, config_value, 0)
        dev_handle.configuration = config_value

    def get_configuration(self, dev_handle: _Handle) -> int:
        return dev_handle.configuration

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        self._control_out(dev_handle, 0x01, _SET_INTERFACE, altsetting, intf)  # 0x01: to an interface

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Nothing to claim, as an imported device has one host; fails where it is gone."""
        if dev_handle.connection.lost:
            raise usb.core.USBError("the device is gone", None, errno.ENODEV)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        self.claim_interface(dev_handle, intf)

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: array.array[int], timeout: int) -> int:
        """Sends data to an endpoint; returns the number of bytes. timeout: ms, 0 waits for ever."""
        with _usb_errors():
            return dev_handle.connection.transfer(ep, data.tobytes(), 0, b"", timeout).actual

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: array.array[int], timeout: int) -> int:
        """Receives into `buff` from an endpoint; returns the number of bytes. timeout: ms, 0 waits for ever."""
        with _usb_errors():
            urb = dev_handle.connection.transfer(ep, None, len(buff) * buff.itemsize, b"", timeout)
        memoryview(buff).cast("B")[: len(urb.data)] = urb.data
        return len(urb.data)

    intr_write, intr_read = bulk_write, bulk_read

    def ctrl_transfer(
        self,
        dev_handle: _Handle,
        bmRequestType: int,
        bRequest: int,
        wValue: int,
        wIndex: int,
        data: array.array[int],
        timeout: int,
    ) -> int:
        """A control transfer as PyUSB asks for it; returns the number of bytes."""
        size = len(data) * data.itemsize
        setup = struct.pack("<BBHHH", bmRequestType, bRequest, wValue, wIndex, size)
        payload = None if bmRequestType & _DEVICE_TO_HOST else data.tobytes()
        with _usb_errors():
            urb = dev_handle.connection.transfer(0, payload, size, setup, timeout)
        if payload is None:
            memoryview(data).cast("B")[: len(urb.data)] = urb.data
            return len(urb.data)
        return urb.actual

    def _control_in(self, handle: _Handle, kind: int, request: int, value: int, index: int, length: int) -> bytes:
        """What a control transfer reads, `length` bytes at most. kind: bmRequestType."""
        data = array.array("B", bytes(length))
        return data[: self.ctrl_transfer(handle, kind, request, value, index, data, _CONTROL_MS)].tobytes()

    def _control_out(self, handle: _Handle, kind: int, request: int, value: int, index: int) -> None:
        """A control transfer without data. kind: bmRequestType."""
        self.ctrl_transfer(handle, kind, request, value, index, array.array("B"), _CONTROL_MS)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        self._control_out(dev_handle, 0x02, _CLEAR_FEATURE, 0, ep)  # 0x02: to an endpoint; 0: its halt

    def reset_device(self, dev_handle: _Handle) -> None:
        """Releases the device and imports it again, which resets it: USB/IP has no port reset."""
        exported = dev_handle.connection.device
        dev_handle.connection.close()
        with _usb_errors():
            dev_handle.connection = usbip.Connection(exported)
        self.set_configuration(dev_handle, dev_handle.configuration)

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """False: an imported device is this process' own, no driver of the system has it."""
        return False


class _usb_errors:
    """OSError of the protocol becomes PyUSB's, with the same errno."""

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError) and not isinstance(error, usb.core.USBError):
            text = error.strerror or str(error)
            if error.errno == errno.ETIMEDOUT:
                raise usb.core.USBTimeoutError(text, None, errno.ETIMEDOUT) from error
            raise usb.core.USBError(text, None, error.errno) from error
