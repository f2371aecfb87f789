"""Addresses of motors on other makers' buses, KIND:BUS[:ID,...][?rate=HZ&baud=BAUD], and the driver of each kind."""

from __future__ import annotations

import importlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

from tautline.device import wire
from tautline.device.link import BoardAddress, Link
from tautline.drivers.drives import Drives
from tautline.drivers.hosted import HostedLink
from tautline.errors import TautError


@dataclass(frozen=True)
class Kind:
    """A kind of motors: its driver's module and class, which are imported where one is opened."""

    module: str  # in tautline.drivers
    driver: str  # the class in it, a `Drives`
    package: str  # the module of the maker's library, which the driver imports
    says: str  # a description for lists
    example: str  # an address
    ids: range | None  # allowed ids of a motor on the bus; None where motors have names
    extra: str = "drivers"  # of tautline's package, which brings the library

    @property
    def installed(self) -> bool:
        """Whether the library of this kind can be imported."""
        return find_spec(self.package) is not None

    @property
    def remedy(self) -> str:
        """The command that installs the library of this kind."""
        return f"pip install 'tautline-robotics[{self.extra}]'"


KINDS = {
    "dynamixel": Kind(
        "dynamixel",
        "Dynamixel",
        "dynamixel_sdk",
        "Dynamixel X series, protocol 2",
        "dynamixel:/dev/ttyUSB0:1",
        range(253),
    ),
    "feetech": Kind("feetech", "Feetech", "scservo_sdk", "Feetech STS and SMS", "feetech:/dev/ttyUSB0:1", range(254)),
    "canopen": Kind(
        "cia402",
        "Cia402",
        "canopen",
        "CANopen drives, CiA 402 cyclic synchronous position",
        "canopen:socketcan/can0:1",
        range(1, 127),  # 0 is all of them, 127 the host
    ),
    "moteus": Kind("moteus_drives", "Moteus", "moteus", "moteus controllers", "moteus:socketcan/can0:1", range(127)),
    "ros": Kind(
        "ros_joints",
        "RosJoints",
        "rclpy",
        "joints of a ROS 2 robot, by topics",
        "ros:/joint_states,/position_controller/commands:elbow",
        None,
        "ros",
    ),
}
_RATES_HZ = (20.0, 1000.0)  # limit: a drive is lost after 0.1 s; no bus here has shorter cycles


@dataclass(frozen=True)
class Address:
    """An address of motors, taken apart by `parse`."""

    kind: str  # a key of KINDS
    bus: str  # as the driver names it: a serial device, python-can's INTERFACE/CHANNEL, two topics
    numbers: tuple[int | str, ...]  # ids of the motors on the bus, or their names; axis i is number i
    rate_hz: float  # control cycles
    baud: int  # bit/s; 0 where the kind has none

    @property
    def where(self) -> str:
        """The address without its options, KIND:BUS:ID,..."""
        return f"{self.kind}:{self.bus}:{','.join(map(str, self.numbers))}"


def is_motor(where: str) -> bool:
    """Whether an address names motors of another maker (KIND:..., KIND a key of KINDS) instead of a board."""
    return where.partition(":")[0] in KINDS


def parse(where: str) -> Address:
    """Takes an address KIND:BUS[:ID,...][?rate=HZ&baud=BAUD] apart; ID is 1, rate and baud those of the kind's driver
    where they are left out. KIND is a key of KINDS (see `is_motor`). TautError where the address is malformed or out of
    range, or the kind's library is not installed."""
    name, _, options_text = where.partition("?")
    kind, _, rest = name.partition(":")
    module = _driver_module(kind)
    id_pattern = r"[^:,?]+" if KINDS[kind].ids is None else r"\d+"
    match = re.fullmatch(rf"(.+?)(?::({id_pattern}(?:,{id_pattern})*))?", rest)
    if not match:
        raise _address_error(where, kind, "names no bus")
    numbers = _checked_numbers(where, kind, (match[2] or "1").split(","))
    defaults: dict[str, float] = {"rate": module.RATE_HZ} | ({"baud": module.BAUD} if module.BAUD else {})
    options = _checked_options(where, kind, options_text, defaults)
    baud = round(options.get("baud", 0))
    return Address(kind=kind, bus=match[1], numbers=numbers, rate_hz=options["rate"], baud=baud)


def _checked_numbers(where: str, kind: str, named: list[str]) -> tuple[int | str, ...]:
    """Returns the motors' ids as integers, or their names where the kind has names. TautError where one is out of range
    or is named twice, or where there are more of them than a board has axes."""
    ids = KINDS[kind].ids
    numbers: tuple[int | str, ...] = tuple(named) if ids is None else tuple(map(int, named))
    if ids is not None and (other := next((n for n in numbers if n not in ids), None)) is not None:
        raise _address_error(where, kind, f"names motor {other}, and {ids[0]} to {ids[-1]} may be")
    if len(set(numbers)) != len(numbers) or not 1 <= len(numbers) <= wire.wire.AXES_MAX:
        raise _address_error(
            where, kind, f"names {len(numbers)} motors, and 1 to {wire.wire.AXES_MAX} different ones may be"
        )
    return numbers


def _checked_options(where: str, kind: str, text: str, defaults: dict[str, float]) -> dict[str, float]:
    """Returns `defaults` (rate, Hz; baud, bit/s, where the kind has one), replaced by what the address says in `text`,
    KEY=NUMBER&... TautError for another key, for what is no number, or for a rate out of _RATES_HZ."""
    values = dict(defaults)
    for part in filter(None, text.split("&")):
        key, _, value = part.partition("=")
        if key not in values or not re.fullmatch(r"\d+(\.\d+)?", value):
            # rate=HZ, baud=BAUD
            takes = " and ".join(f"{name}={name.upper().replace('RATE', 'HZ')}" for name in values)
            raise _address_error(where, kind, f"has '{part}', and takes {takes}")
        values[key] = float(value)
    low, high = _RATES_HZ
    if not low <= values["rate"] <= high:
        raise _address_error(where, kind, f"asks for {values['rate']:g} Hz, and {low:g} to {high:g} may be")
    return values


def _address_error(where: str, kind: str, says: str) -> TautError:
    """Returns the error to raise for an address of --board: what is wrong with it (`says`), and a right one of its
    kind."""
    return TautError(f"--board {where}: {says}, such as in {KINDS[kind].example}")


def _driver_module(kind: str) -> Any:
    """Imports the module of the kind's driver, which has RATE_HZ (Hz) and BAUD (bit/s, 0 for none) as defaults.
    TautError where the library that it needs is not installed."""
    try:
        return importlib.import_module(f"tautline.drivers.{KINDS[kind].module}")
    except ModuleNotFoundError as error:
        raise TautError(
            f"{kind}: its library ({KINDS[kind].package}) is not installed: run '{KINDS[kind].remedy}'"
        ) from error


def open_drives(address: Address, **options: Any) -> Drives:
    """Opens the bus of an address and returns its driver. options: further arguments of the driver's class, such as
    clock. TautError where the bus cannot be opened or a motor does not answer."""
    make: Callable[..., Drives] = getattr(_driver_module(address.kind), KINDS[address.kind].driver)
    return make(address.bus, address.numbers, address.baud, address.rate_hz, **options)


def find_motors(where: str) -> list[BoardAddress]:
    """Returns the motors of an address, not opened yet, as a list of one board, as `device.board.find` does: once they
    are open, the board's application runs on the host (HostedLink). TautError where the address is malformed."""
    address = parse(where)

    def open_link() -> Link:
        """Opens the drives, and the application over them; closes the drives if that fails."""
        drives = open_drives(address)
        try:
            return HostedLink(drives, address.where, address.rate_hz)
        except BaseException:
            drives.close()
            raise

    protocol = (wire.wire.MAJOR, wire.wire.MINOR)  # the application's, which is of this version
    return [BoardAddress(where=address.where, serial=None, busy=False, protocol=protocol, open=open_link)]
