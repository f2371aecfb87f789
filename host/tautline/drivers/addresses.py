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

    module: str
    driver: str
    package: str  # what is imported of the extra
    says: str
    example: str
    ids: range | None  # of a motor on the bus; None where it has a name
    extra: str = "drivers"

    @property
    def installed(self) -> bool:
        """Whether its library can be imported."""
        return find_spec(self.package) is not None

    @property
    def remedy(self) -> str:
        """The command that installs its library."""
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
    kind: str
    bus: str
    numbers: tuple[int | str, ...]
    rate_hz: float
    baud: int

    @property
    def where(self) -> str:
        """The address without its options, KIND:BUS:ID,..."""
        return f"{self.kind}:{self.bus}:{','.join(map(str, self.numbers))}"


def is_motor(where: str) -> bool:
    """Whether an address begins with a kind of motors that is known."""
    return where.partition(":")[0] in KINDS


def parse(where: str) -> Address:
    """An address KIND:BUS[:ID,...][?rate=HZ&baud=BAUD], ID 1 and its driver's rate and baud unless it says others.
    TautError where it is none."""
    name, _, options = where.partition("?")
    kind, _, rest = name.partition(":")
    module = _module(kind)
    ids = KINDS[kind].ids
    one = r"[^:,?]+" if ids is None else r"\d+"
    match = re.fullmatch(rf"(.+?)(?::({one}(?:,{one})*))?", rest)
    if not match:
        raise _wrong(where, kind, "names no bus")
    named = (match[2] or "1").split(",")
    numbers: tuple[int | str, ...] = tuple(named) if ids is None else tuple(map(int, named))
    if ids is not None and (other := next((n for n in numbers if n not in ids), None)) is not None:
        raise _wrong(where, kind, f"names motor {other}, and {ids[0]} to {ids[-1]} may be")
    if len(set(numbers)) != len(numbers) or not 1 <= len(numbers) <= wire.wire.AXES_MAX:
        raise _wrong(where, kind, f"names {len(numbers)} motors, and 1 to {wire.wire.AXES_MAX} different ones may be")
    values: dict[str, float] = {"rate": module.RATE_HZ} | ({"baud": module.BAUD} if module.BAUD else {})
    for part in filter(None, options.split("&")):
        key, _, value = part.partition("=")
        if key not in values or not re.fullmatch(r"\d+(\.\d+)?", value):
            takes = " and ".join(f"{name}={name.upper().replace('RATE', 'HZ')}" for name in values)
            raise _wrong(where, kind, f"has '{part}', and takes {takes}")
        values[key] = float(value)
    low, high = _RATES_HZ
    if not low <= values["rate"] <= high:
        raise _wrong(where, kind, f"asks for {values['rate']:g} Hz, and {low:g} to {high:g} may be")
    return Address(kind, match[1], numbers, values["rate"], round(values.get("baud", 0)))


def _wrong(where: str, kind: str, says: str) -> TautError:
    """The error for an address, with an example of its kind."""
    return TautError(f"--board {where}: {says}, such as in {KINDS[kind].example}")


def _module(kind: str) -> Any:
    """The driver's module. TautError where its library is not installed."""
    try:
        return importlib.import_module(f"tautline.drivers.{KINDS[kind].module}")
    except ModuleNotFoundError as error:
        raise TautError(
            f"{kind}: its library ({KINDS[kind].package}) is not installed: run '{KINDS[kind].remedy}'"
        ) from error


def open_drives(address: Address, **options: Any) -> Drives:
    """The driver of an address, opened. options: further arguments of its class."""
    make: Callable[..., Drives] = getattr(_module(address.kind), KINDS[address.kind].driver)
    return make(address.bus, address.numbers, address.baud, address.rate_hz, **options)


def find_motors(where: str) -> list[BoardAddress]:
    """The motors of an address as a board that can be opened."""
    address = parse(where)

    def opened() -> Link:
        drives = open_drives(address)
        try:
            return HostedLink(drives, address.where, address.rate_hz)
        except BaseException:
            drives.close()
            raise

    return [BoardAddress(address.where, None, False, (wire.wire.MAJOR, wire.wire.MINOR), opened)]
