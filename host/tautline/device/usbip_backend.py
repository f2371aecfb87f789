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
_GET_DESCRIPTOR, _SET_CONFIGURATION = 6, 9
_CLEAR_FEATURE, _SET_INTERFACE = 1, 11
_DEVICE_TYPE, _CONFIGURATION_TYPE, _INTERFACE_TYPE, _ENDPOINT_TYPE = 1, 2, 4, 5
_CONTROL_MS = 10_000  # a simulated board answers when this machine lets it


class _Descriptor:
    """A standard descriptor, as PyUSB wants it: an object with the fields under their names in the USB specification,
    and the descriptors within it as `children`."""

    def __init__(self, names: str, layout: str, raw: bytes) -> None:
        """names: the fields in order, apart by spaces; layout: their types as `struct` names them, little-endian; raw:
        the bytes. USBError where they are too few."""
        if len(raw) < struct.calcsize("<" + layout):
            raise usb.core.USBError("the device's descriptors are cut short", None, errno.EPROTO)
        for name, value in zip(names.split(), struct.unpack_from("<" + layout, raw), strict=True):
            setattr(self, name, value)
        self.extra_descriptors = b""
        self.children: list[_Descriptor] = []

    def __getattr__(self, name: str) -> Any:
        """Only for type checkers: fields are set by name in __init__, any other name is an error."""
        raise AttributeError(name)


def _device_descriptor(raw: bytes) -> _Descriptor:
    """Decodes a device descriptor, of 18 bytes."""
    names = (
        "bLength bDescriptorType bcdUSB bDeviceClass bDeviceSubClass bDeviceProtocol bMaxPacketSize0 "
        "idVendor idProduct bcdDevice iManufacturer iProduct iSerialNumber bNumConfigurations"
    )
    return _Descriptor(names, "BBHBBBBHHHBBBB", raw)


def _configuration_descriptor(raw: bytes) -> _Descriptor:
    """Decodes a configuration descriptor and all that follows it: its children are the interfaces, one for each
    alternate setting, whose children are their endpoints. Descriptors of other kinds (DFU's) are kept as
    `extra_descriptors` of the interface, or the configuration, that they follow."""
    names = (
        "bLength bDescriptorType wTotalLength bNumInterfaces bConfigurationValue iConfiguration bmAttributes bMaxPower"
    )
    root = _Descriptor(names, "BBHBBBBB", raw)
    owner = root
    at = raw[0]
    while at + 2 <= len(raw) and raw[at] >= 2:
        length, kind = raw[at], raw[at + 1]  # as every descriptor begins
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
    """A device that was found, as PyUSB hands it back to the backend (`dev`)."""

    exported: usbip.Exported
    descriptor: _Descriptor | None = None  # None until it was read
    configurations: dict[int, _Descriptor] = field(default_factory=dict)  # by index; empty until they were read


@dataclass
class _Handle:
    """A device that is open, as PyUSB hands it back to the backend (`dev_handle`)."""

    connection: usbip.Connection
    configuration: int = 0  # bConfigurationValue of the one that is set


class Backend(usb.backend.IBackend):  # type: ignore[misc]
    """PyUSB's backend (usb.backend.IBackend, whose methods these are) for the devices of one USB/IP server. Errors are
    USBError with the errno that libusb's backend gives."""

    def __init__(self, host: str, port: int) -> None:
        """host, port: of the server; it is not connected to yet."""
        self._address = host, port

    def enumerate_devices(self) -> Iterator[_Device]:
        """The devices that the server exports. USBError where none answers."""
        with _usb_errors():
            return iter([_Device(exported) for exported in usbip.devices(*self._address)])

    def get_parent(self, dev: _Device) -> None:
        """Returns None: the server does not say on which hub a device is."""
        return None

    def get_device_descriptor(self, dev: _Device) -> _Descriptor:
        """Returns the device descriptor; reads it if it has not been read yet."""
        if dev.descriptor is None:
            self._read_descriptors(dev)
        assert dev.descriptor is not None
        return dev.descriptor

    def get_configuration_descriptor(self, dev: _Device, config: int) -> _Descriptor:
        """Returns the configuration of this index, with its interfaces; reads it if it has not been read yet.
        IndexError where there is none."""
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
        """The descriptor of an endpoint of an interface's alternate setting, all by their indices."""
        return self.get_interface_descriptor(dev, intf, alt, config).children[ep]

    def _read_descriptors(self, dev: _Device) -> None:
        """Fills `dev` with the device's descriptors. A free device is imported to read them. A busy one cannot be: its
        device descriptor is made from what the server's list says, and it has no configurations."""
        exported = dev.exported
        try:
            with _usb_errors():
                connection = usbip.Connection(exported)
        except usb.core.USBError as error:
            if error.errno != errno.EBUSY:
                raise
            raw = struct.pack("<BBHBBBBHHHBBBB", 18, _DEVICE_TYPE, 0x0200, *exported.device_class, 64, exported.vendor,
                              exported.product, exported.release, 0, 0, 0, exported.configurations)  # fmt: skip
            dev.descriptor = self._with_location(_device_descriptor(raw), exported)
            return
        try:
            self._read_open_descriptors(dev, _Handle(connection))
        finally:
            connection.close()

    def _read_open_descriptors(self, dev: _Device, handle: _Handle) -> None:
        """Fills `dev` with the descriptors of the device that is open as `handle`, by control transfers."""

        def read_descriptor(kind: int, index: int, length: int) -> bytes:
            """Reads the bytes of a descriptor of this type and index, `length` at most."""
            return self._control_in(handle, _DEVICE_TO_HOST, _GET_DESCRIPTOR, kind << 8 | index, 0, length)

        dev.descriptor = self._with_location(_device_descriptor(read_descriptor(_DEVICE_TYPE, 0, 18)), dev.exported)
        for index in range(dev.descriptor.bNumConfigurations):
            total = _configuration_descriptor(read_descriptor(_CONFIGURATION_TYPE, index, 9)).wTotalLength
            dev.configurations[index] = _configuration_descriptor(read_descriptor(_CONFIGURATION_TYPE, index, total))
        if not dev.configurations:
            raise usb.core.USBError("the device has no configuration", None, errno.EPROTO)

    @staticmethod
    def _with_location(descriptor: _Descriptor, exported: usbip.Exported) -> _Descriptor:
        """Sets on the device descriptor what PyUSB expects beside its fields: bus, address and speed from the server's
        list, and no port numbers. Returns the descriptor."""
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
        """Imports the device and sets its first configuration, as an operating system does with one that is plugged in.
        USBError EBUSY while another host has it."""
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
        """Gives the device back to the server."""
        dev_handle.connection.close()

    def set_configuration(self, dev_handle: _Handle, config_value: int) -> None:
        """Sets the configuration with this bConfigurationValue."""
        self._control_out(dev_handle, 0x00, _SET_CONFIGURATION, config_value, 0)
        dev_handle.configuration = config_value

    def get_configuration(self, dev_handle: _Handle) -> int:
        """bConfigurationValue of the configuration that is set."""
        return dev_handle.configuration

    def set_interface_altsetting(self, dev_handle: _Handle, intf: int, altsetting: int) -> None:
        """Selects an alternate setting of an interface, both by their numbers."""
        self._control_out(dev_handle, 0x01, _SET_INTERFACE, altsetting, intf)  # 0x01: to an interface

    def claim_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Claims nothing, as an imported device belongs to this process alone; USBError ENODEV where it is gone."""
        if dev_handle.connection.lost:
            raise usb.core.USBError("the device is gone", None, errno.ENODEV)

    def release_interface(self, dev_handle: _Handle, intf: int) -> None:
        """Releases nothing; USBError ENODEV where the device is gone, as `claim_interface`."""
        self.claim_interface(dev_handle, intf)

    def bulk_write(self, dev_handle: _Handle, ep: int, intf: int, data: array.array[int], timeout: int) -> int:
        """Sends data to an endpoint; returns the number of bytes. timeout: ms, 0 waits for ever."""
        with _usb_errors():
            urb = dev_handle.connection.transfer(ep, data.tobytes(), length=0, setup=b"", timeout_ms=timeout)
            return urb.actual

    def bulk_read(self, dev_handle: _Handle, ep: int, intf: int, buff: array.array[int], timeout: int) -> int:
        """Receives into `buff` from an endpoint; returns the number of bytes. timeout: ms, 0 waits for ever."""
        with _usb_errors():
            size = len(buff) * buff.itemsize
            urb = dev_handle.connection.transfer(ep, None, length=size, setup=b"", timeout_ms=timeout)
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
        """Makes a control transfer with these fields of its set-up packet. data: is sent, or filled if bmRequestType
        says device to host; timeout: ms. Returns the number of bytes."""
        size = len(data) * data.itemsize
        setup = struct.pack("<BBHHH", bmRequestType, bRequest, wValue, wIndex, size)
        payload = None if bmRequestType & _DEVICE_TO_HOST else data.tobytes()
        with _usb_errors():
            urb = dev_handle.connection.transfer(0, payload, length=size, setup=setup, timeout_ms=timeout)
        if payload is None:
            memoryview(data).cast("B")[: len(urb.data)] = urb.data
            return len(urb.data)
        return urb.actual

    def _control_in(
        self, handle: _Handle, request_type: int, request: int, value: int, index: int, length: int
    ) -> bytes:
        """Makes a control transfer that reads, and returns the bytes, `length` at most. The other arguments are the
        fields of its set-up packet."""
        data = array.array("B", bytes(length))
        return data[: self.ctrl_transfer(handle, request_type, request, value, index, data, _CONTROL_MS)].tobytes()

    def _control_out(self, handle: _Handle, request_type: int, request: int, value: int, index: int) -> None:
        """Makes a control transfer without data; the arguments are the fields of its set-up packet."""
        self.ctrl_transfer(handle, request_type, request, value, index, array.array("B"), _CONTROL_MS)

    def clear_halt(self, dev_handle: _Handle, ep: int) -> None:
        """Clears the halt of an endpoint, by its address, after a stall."""
        self._control_out(dev_handle, 0x02, _CLEAR_FEATURE, 0, ep)  # 0x02: to an endpoint; 0: its halt

    def reset_device(self, dev_handle: _Handle) -> None:
        """Releases the device and imports it again, which resets it: USB/IP has no port reset."""
        exported = dev_handle.connection.device
        dev_handle.connection.close()
        with _usb_errors():
            dev_handle.connection = usbip.Connection(exported)
        self.set_configuration(dev_handle, dev_handle.configuration)

    def is_kernel_driver_active(self, dev_handle: _Handle, intf: int) -> bool:
        """Returns False: an imported device is this process' own, no driver of the system has it."""
        return False


class _usb_errors:
    """A context within which an OSError of the USB/IP client becomes PyUSB's USBError with the same errno."""

    def __enter__(self) -> None:
        """Nothing to prepare."""
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Raises the USBError, or USBTimeoutError, that belongs to an OSError; other exceptions pass."""
        if isinstance(error, OSError) and not isinstance(error, usb.core.USBError):
            text = error.strerror or str(error)
            if error.errno == errno.ETIMEDOUT:
                raise usb.core.USBTimeoutError(text, None, errno.ETIMEDOUT) from error
            raise usb.core.USBError(text, None, error.errno) from error
