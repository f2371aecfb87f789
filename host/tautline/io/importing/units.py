"""Units: what names say, what ratios give away, and what a channel is multiplied with."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import isfinite, log, pi

import numpy as np

from tautline.errors import TautError

Array = np.ndarray
DEG_PER_RAD = 180.0 / pi
TICKS_PER_TURN = 4096  # format: of Dynamixel X and Feetech STS servos
ANGLES = {"deg": 1.0, "rad": DEG_PER_RAD, "mrad": 1e-3 * DEG_PER_RAD, "turn": 360.0, "tick": 360.0 / TICKS_PER_TURN}
LENGTHS = {"mm": 1.0, "m": 1000.0, "cm": 10.0, "um": 1e-3, "in": 25.4}
TORQUES = {"mNm": 1.0, "Nm": 1000.0, "Ncm": 10.0}
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
UNITS: Mapping[str, Mapping[str, float]] = {"deg": ANGLES, "mm": LENGTHS, "mNm": TORQUES}  # by what a recording has

_SPELT = {
    "°": "deg", "grad": "deg", "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad", "rev": "turn",
    "turns": "turn", "ticks": "tick", "meter": "m", "metre": "m", "meters": "m", "metres": "m", "inch": "in",
    "µm": "um", "μm": "um", "µs": "us", "μs": "us", "sec": "s", "seconds": "s", "msec": "ms", "usec": "us",
    "nsec": "ns", "nanosec": "ns", "n·m": "Nm", "n*m": "Nm", "n.m": "Nm", "bogenmaß": "rad",
}  # fmt: skip
_BRACKETED = re.compile(r"[\[(]\s*([^\])]+?)\s*[\])]\s*$")
_SUFFIXED = re.compile(r"[_ .]([A-Za-zµμ°]+)$")
_MOST_RAD = 4.0 * pi  # prior: that a joint turns to
_MOST_M = 2.0  # prior: that a cable moves by
SPOKEN = {"rad": "radians", "m": "metres", "in": "inches", "tick": f"counts of {TICKS_PER_TURN} a turn"}


@dataclass(frozen=True)
class Named:
    """A channel as a user names it: NAME, or NAME:UNIT, or NAME:FACTOR."""

    name: str
    unit: str = ""  # "" where none was given
    factor: float | None = None  # given as a number

    @property
    def text(self) -> str:
        """The channel as a user writes it: NAME, NAME:UNIT or NAME:FACTOR."""
        if self.factor is not None:
            return f"{self.name}:{self.factor:g}"
        return f"{self.name}:{self.unit}" if self.unit else self.name


def known_unit(text: str, of: Iterable[str] | None = None) -> str:
    """The unit, as UNITS spells it, that a text means in any spelling known here; "" where it means none. of: the units
    to choose from, None: all in UNITS."""
    listed = list(of) if of is not None else [unit for units in UNITS.values() for unit in units]
    stripped = text.strip()
    if stripped in listed:
        return stripped
    spelt = _SPELT.get(stripped.lower(), "")
    if spelt in listed:
        return spelt
    lower = {unit.lower(): unit for unit in listed}
    return lower.get(stripped.lower(), "") if len(stripped) > 1 else ""


def unit_in(name: str, of: Iterable[str] | None = None) -> str:
    """The unit at the end of a column's name, as in `q_deg`, `Winkel [rad]`, `Zeit (ms)`; "" where there is none. of:
    as in `known_unit`."""
    for pattern in (_BRACKETED, _SUFFIXED):
        found = pattern.search(name)
        if found and (unit := known_unit(found[1], of)):
            return unit
    return ""


def split_unit(text: str, names: Iterable[str], of: Iterable[str] | None = None) -> tuple[str, str]:
    """Splits NAME:UNIT into (NAME, UNIT); UNIT is "" where the text has no colon or is as a whole one of `names`. of:
    as in `known_unit`. TautError where what follows the last colon is no unit."""
    if text in names or ":" not in text:
        return text, ""
    name, _, unit = text.rpartition(":")
    found = known_unit(unit, of)
    if not found:
        listed = list(of) if of is not None else [u for units in UNITS.values() for u in units]
        raise TautError(f"{text}: '{unit}' is no unit: one of {', '.join(listed)}")
    return name, found


def parse_channel(text: str, names: Iterable[str]) -> Named:
    """Parses a channel as a user writes it: NAME, NAME:UNIT or NAME:FACTOR; a text that is one of `names` is a NAME.
    TautError for an unknown unit, or for a factor that is 0 or not finite."""
    if text not in names and ":" in text:
        name, _, last = text.rpartition(":")
        try:
            times = float(last)
        except ValueError:
            return Named(*split_unit(text, names))
        if not isfinite(times) or times == 0.0:
            raise TautError(f"{text}: a factor is a finite number and not 0")
        return Named(name, factor=times)
    return Named(*split_unit(text, names))


def recorded_unit(unit: str) -> str:
    """The unit to which a recording converts this one: deg, mm or mNm; "" for a unit that is not in UNITS."""
    return next((target for target, units in UNITS.items() if unit in units), "")


def factor(channel: Named, stated: str, target: str) -> tuple[float, str]:
    """The factor that converts a channel's numbers to the unit `target` (deg, mm or mNm), and in words the unit that
    was assumed. The user's factor or unit of this channel comes first, then `stated`, the file's unit; without either
    ("") the factor is 1. TautError where the unit is of another kind than `target`."""
    if channel.factor is not None:
        return channel.factor, f"x{channel.factor:g}"
    unit = channel.unit or stated
    if not unit:
        return 1.0, ""
    if unit not in UNITS[target]:
        expected = ", ".join(UNITS[target])
        raise TautError(
            f"{channel.name}: is in {unit}, expected one of {expected}: say which, as in {channel.name}:{target}"
        )
    return UNITS[target][unit], unit


def suspected_unit(ratio: float, values: Array, target: str, off: float) -> str:
    """The unit in which values (n,), read as `target`, seem to be, where they move `ratio` times too little: 57.3 means
    radians, 1000 metres. "" where no unit of SPOKEN fits the ratio to within a share `off` of it, or the values are
    impossible in that unit."""
    for unit, times in UNITS[target].items():
        likely = unit in SPOKEN and abs(log(ratio / times)) < log(1.0 + off) if ratio > 0.0 else False
        if likely and _are_possible(unit, values):
            return unit
    return ""


def _are_possible(unit: str, values: Array) -> bool:
    """Whether values (n,) can be in this unit: ticks have to be whole numbers, radians and metres not larger than a
    joint turns or a cable moves."""
    most = float(np.max(np.abs(values)))
    if unit == "tick":
        return bool(np.all(values == np.rint(values)))
    return most <= {"rad": _MOST_RAD, "m": _MOST_M}.get(unit, np.inf)
