"""USB DFU 1.1 over PyUSB: what dfu-util does, for the tables of a board. Interface 1, alternate setting = axis."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable
from typing import Any

import usb.core
import usb.util

from tautline import _native
from tautline.errors import TautError

_OUT, _IN = 0x21, 0xA1  # class requests to an interface
_DNLOAD, _UPLOAD, _GETSTATUS, _CLRSTATUS, _ABORT = 1, 2, 3, 4, 6
_IDLE, _DNLOAD_SYNC, _DNBUSY, _DNLOAD_IDLE, _MANIFEST_SYNC, _MANIFEST, _WAIT_RESET, _UPLOAD_IDLE, _ERROR = range(2, 11)
_FUNCTIONAL = 0x21
_TIMEOUT_MS = 2000
_BUSY_S = 10.0  # tolerance: for an answer that is to come next
_ASKED_S = 45.0  # tolerance: that a board may have us wait in all; a table or an image has one wait, of a second
_STATUS = {  # DFU 1.1, table in 6.1.2, as a board uses them for tables
    0x01: "the board has no such axis",
    0x02: "the table does not fit this board or axis",
    0x03: "the flash could not be written",
    0x04: "the flash could not be erased",
    0x05: "the flash is not blank after erasing",
    0x06: "the flash could not be programmed",
    0x07: "the flash does not hold what was written",
    0x08: "the table is longer than the board takes",
    0x09: "the download ended early",
    0x0A: "the table is damaged",
    0x0B: "a motor is on: tables are loaded with every motor off",
    0x0E: "the board met an unknown error",
    0x0F: "the board stalled an unexpected request",
}


class DfuError(TautError):
    """The board refused a download or upload. `status` is DFU's bStatus."""

    def __init__(self, text: str, status: int = 0) -> None:
        """status: DFU's bStatus, 0 where the device gave none."""
        super().__init__(text)
        self.status = status


class Dfu:
    """The DFU interface of an open device, on one alternate setting. Leaves the board idle, also after a failure."""

    def __init__(self, device: usb.core.Device, interface: int, alternate: int) -> None:
        """Claims an alternate setting of a device's DFU interface: the axis' number for its table, the number of axes
        for the firmware. DfuError where there is none."""
        self._device, self._interface, self._answer_ms, self._asked_s = device, interface, _TIMEOUT_MS, 0.0
        settings = [i for i in device.get_active_configuration() if i.bInterfaceNumber == interface]
        if alternate not in [i.bAlternateSetting for i in settings]:
            raise DfuError(f"the board has no axis {alternate}: its axes are 0 to {len(settings) - 1}")
        extra = next((bytes(i.extra_descriptors) for i in settings if i.extra_descriptors), b"")
        if len(extra) < 9 or extra[1] != _FUNCTIONAL:
            raise DfuError("the board has no DFU interface: its firmware is not tautline's")
        self._block = struct.unpack_from("<H", extra, 5)[0]  # wTransferSize, bytes
        if self._block == 0:
            raise DfuError("the board takes no bytes by DFU: its firmware is not tautline's")
        usb.util.claim_interface(device, interface)
        device.set_interface_altsetting(interface, alternate)

    def __enter__(self) -> Dfu:
        """Brings the device to dfuIDLE, from which downloads and uploads begin."""
        self._bring_to_idle()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Brings the device back to dfuIDLE, as far as it is still there, and releases the interface."""
        try:
            self._bring_to_idle()
        except usb.core.USBError:
            pass  # gone: nothing to leave in order
        except DfuError:
            if kind is None:  # else the reason is what failed before
                raise
        finally:
            usb.util.release_interface(self._device, self._interface)

    def download(
        self,
        blob: bytes,
        progress: Callable[[float, str], None] | None = None,
        answer_ms: int = _TIMEOUT_MS,
    ) -> None:
        """Writes `blob` and waits until the board has checked and stored it. progress: gets the share written, 0 to 1,
        and a word; answer_ms: longest wait for each answer, ms. DfuError where the board refuses it."""
        self._answer_ms = answer_ms
        for number, start in enumerate(range(0, len(blob), self._block)):
            self._send(_DNLOAD, number, blob[start : start + self._block])
            self._wait_for_state(_DNLOAD_IDLE)
            if progress:
                progress(min((start + self._block) / len(blob), 1.0), "loading")
        self._send(_DNLOAD, -(-len(blob) // self._block), b"")  # an empty block ends the download
        self._wait_for_state(_IDLE)

    def upload(self) -> bytes:
        """Reads what the board has stored, block after block until one is not full. DfuError where no such block comes
        within the size of the largest table."""
        blob = bytearray()
        number = 0
        while len(blob) <= _native.TABLE_SIZE_MAX:
            part = bytes(self._receive(_UPLOAD, number, self._block))
            blob += part
            number += 1
            if len(part) < self._block:
                return bytes(blob)
        raise DfuError("the board's table does not end: its firmware is not tautline's")

    def _send(self, request: int, value: int, data: bytes) -> None:
        """Makes a DFU request with data to the device; value: the number of the block, else 0."""
        self._control(_OUT, request, value, data)

    def _receive(self, request: int, value: int, length: int) -> Any:
        """Makes a DFU request that reads `length` bytes at most; value: the number of the block, else 0."""
        return self._control(_IN, request, value, length)

    def _control(self, request_type: int, request: int, value: int, data_or_length: bytes | int) -> Any:
        """Makes one control transfer of DFU. request_type: _OUT with bytes to send, or _IN with the length to read. If
        the device stalls a download or upload, raises the DfuError that its status gives; other USB errors pass."""
        try:
            return self._device.ctrl_transfer(
                request_type, request, value, self._interface, data_or_length, self._answer_ms
            )
        except usb.core.USBError as error:
            if error.errno == 32 and request in (_DNLOAD, _UPLOAD):  # a stall: the status says why
                status, _, _ = self._read_status()
                raise self._refusal(status) from error
            raise

    def _read_status(self) -> tuple[int, float, int]:
        """Asks for the device's DFU status: returns bStatus (0 is OK), bwPollTimeout in s, bState. DfuError where the
        answer is too short."""
        answer = bytes(self._receive(_GETSTATUS, 0, 6))
        if len(answer) != 6:
            raise DfuError("the board's DFU status is too short: its firmware is not tautline's")
        return answer[0], int.from_bytes(answer[1:4], "little") / 1000.0, answer[4]

    def _wait_for_state(self, wanted: int) -> None:
        """Asks for the status until the state is `wanted`. DfuError with the device's reason, or after _BUSY_S."""
        deadline = time.monotonic() + _BUSY_S
        while True:
            status, pause, state = self._read_status()
            if status or state == _ERROR:
                raise self._refusal(status)
            if state == wanted:
                return
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise DfuError(f"the board stays in DFU state {state}: switch it off and on, then load again")
            self._sleep_as_asked(min(pause, left))

    def _bring_to_idle(self) -> None:
        """Brings the device to dfuIDLE, whatever state it is in. DfuError where four attempts do not."""
        for _ in range(4):
            _, pause, state = self._read_status()
            if state == _IDLE:
                return
            if state == _ERROR:
                self._send(_CLRSTATUS, 0, b"")
            elif state in (_DNBUSY, _MANIFEST, _MANIFEST_SYNC):
                self._sleep_as_asked(min(pause, _BUSY_S))
            else:
                self._send(_ABORT, 0, b"")
        raise DfuError("the board's DFU interface does not come to rest: switch the board off and on")

    def _sleep_as_asked(self, pause_s: float) -> None:
        """Sleeps for the seconds that the device asked for. DfuError where they add up to more than _ASKED_S since the
        interface was opened."""
        self._asked_s += pause_s
        if self._asked_s > _ASKED_S:
            raise DfuError("the board has us wait without end: switch it off and on, then load again")
        time.sleep(pause_s)

    @staticmethod
    def _refusal(status: int) -> DfuError:
        """The error to raise for DFU's bStatus, with its meaning in words."""
        return DfuError(f"the board refused the table: {_STATUS.get(status, f'DFU status {status:#04x}')}", status)
