"""Messages between host and board as physical values. Layouts, scales and codes come from tl_wire.h alone.

A field such as `speed_q8_s` is a fixed-point number: here it is `speed_s`, a float (counts/s), converted on the way.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tautline import _native
from tautline.errors import TautError

wire = _native.wire
_SCALE = re.compile(r"_q(\d+)(?=_|$)")
_MEASURED = re.compile(r"\((by |at (?:duty )?)?(?:1(/))?([^)]+)\)")  # "(mA)", "(by counts)", "(at duty 1/32768)"


@dataclass(frozen=True)
class _Field:
    """One field of a message."""

    raw: str  # its name in tl_wire.h
    name: str  # here: without the suffix of a fixed-point number
    scale: int  # 2**Q, 0 for an integer as it is
    zero: Any  # its value where none is given

    @classmethod
    def of(cls, raw: str, kind: str, count: int) -> _Field:
        """Makes a field from its entry in tl_wire.h. raw: its name there, in which _qN means a fixed-point number with
        N binary places; kind: its type, "text" or a number's; count: length of an array, else 1."""
        match = _SCALE.search(raw)
        zero: Any = "" if kind == "text" else 0 if count == 1 else (0,) * count
        return cls(raw, _SCALE.sub("", raw), 1 << int(match[1]) if match else 0, zero)


_FIELDS = {name: tuple(_Field.of(*field[:3]) for field in message["fields"]) for name, message in wire.MESSAGES.items()}
DEG, COUNT = float(_native.DEG_ONE), float(_native.COUNT_ONE)  # of set_point's value: in 1 deg of the tip, in 1 count
# By what a request is answered, as tl_wire.h says: "-> status".
ANSWERS = {name: found[1] for name, m in wire.MESSAGES.items() if (found := re.match(r"-> (\w+)", m["doc"]))}


@dataclass(frozen=True)
class Message:
    """A message that came from a board. Fixed-point arrays are float arrays."""

    name: str
    sequence: int
    values: Mapping[str, Any]

    def __getattr__(self, name: str) -> Any:
        """A field of the message as an attribute."""
        try:
            return self.values[name]
        except KeyError:
            raise AttributeError(f"{self.name} has no field {name}") from None


def encode(name: str, sequence: int, **values: Any) -> bytes:
    """Returns the bytes (frame) of a message. values: fields by name, physical values; those not given are 0 or empty,
    fixed-point ones are rounded and clipped to 32 bits. TypeError for a field that the message does not have."""
    fields = {}
    for field in _FIELDS[name]:
        value = values.pop(field.name, field.zero)
        if field.scale:
            scaled = np.clip(np.rint(np.asarray(value, dtype=np.float64) * field.scale), -(2**31), 2**31 - 1)
            value = tuple(int(v) for v in scaled) if scaled.ndim else int(scaled)
        fields[field.raw] = value
    if values:
        raise TypeError(f"{name} has no field {', '.join(values)}")
    frame: bytes = wire.encode(name, sequence, fields)
    return frame


class Decoder:
    """Decodes messages from a stream of bytes. What is no message, or of a newer version, is skipped."""

    def __init__(self) -> None:
        """No byte has come yet."""
        self._parser = wire.Parser()

    def feed(self, data: bytes) -> Iterator[Message]:
        """Yields the messages that these bytes complete, together with those fed before; an incomplete frame is
        kept."""
        for name, _, sequence, fields in self._parser.feed(data):
            if name is not None and fields is not None:
                yield Message(name, sequence, {f.name: self._value(fields[f.raw], f.scale) for f in _FIELDS[name]})

    @staticmethod
    def _value(raw: Any, scale: int) -> Any:
        """Returns a field's physical value, raw / scale, a float; with scale 0 the integer as it is. A tuple of numbers
        becomes an array (n,)."""
        if not scale:
            return np.array(raw) if isinstance(raw, tuple) else raw
        return np.array(raw) / scale if isinstance(raw, tuple) else raw / scale


def set_point_values(positions: Any, scale: float) -> np.ndarray:
    """Converts positions, a number or any array, to integers for the field `value` of the message set_point: position
    times scale, rounded. scale: DEG for angles of the tip in deg, COUNT for motor positions in counts. TautError where
    a position is not a number or needs more than 32 bits."""
    values: np.ndarray = np.rint(np.asarray(positions, dtype=np.float64) * scale)
    most = 2**31 - 1
    if not (worst := float(np.max(np.abs(values), initial=0.0))) <= most:
        raise TautError(
            f"a set-point is {worst / scale:g} in size, and {most / scale:g} is the most that a board can be told: "
            "check its unit"
        )
    return values


def code(list_name: str, name: str) -> int:
    """The number of a name in one of tl_wire.h's lists, such as code("MODES", "HOLD")."""
    return int(getattr(wire, list_name)[name][0])


def name(list_name: str, number: int) -> str:
    """Returns the name of a number in one of tl_wire.h's lists; the number as text where this version does not know
    it."""
    return next((each for each, (value, _) in getattr(wire, list_name).items() if value == number), str(number))


def text(list_name: str, number: int) -> str:
    """Returns the text of a number in one of tl_wire.h's lists, such as text("REASONS", 3); "code N, unknown to this
    version of tautline" for a number N that is not in the list."""
    for value, says in getattr(wire, list_name).values():
        if value == number:
            return str(says)
    return f"code {number}, unknown to this version of tautline"


def fault(status: Message) -> str:
    """The fault in a status as a text with the measured value in it (see `fault_text`), "" where there is none."""
    return fault_text(status.fault, status.fault_value) if status.fault else ""


def fault_meaning(status: Message) -> str | None:
    """The text in TL_WIRE_FAULTS of the fault in a status, without the measured value; None where there is none."""
    return text("FAULTS", status.fault) if status.fault else None


def fault_text(number: int, value: int) -> str:
    """Returns the text of a fault, by its number in TL_WIRE_FAULTS, with the measured value put before the unit in the
    first brackets: "(mA)" becomes "(350 mA)"."""
    says = text("FAULTS", number)
    return _MEASURED.sub(lambda found: f"({found[1] or ''}{value}{found[2] or ' '}{found[3]})", says, 1)


def flags(number: int) -> list[str]:
    """The names, in lower case, of the flags (TL_WIRE_FLAGS) that are set in a number."""
    return [each.lower() for each, (bit, _) in wire.FLAGS.items() if number & bit]


def table_reason(number: int) -> str:
    """Returns the text of why a board refused a table (tl_table.h). number: the reason in the axis' status, from 1
    on."""
    reasons = list(_native.TABLE_REASONS.values())
    return str(reasons[number - 1]) if 0 < number <= len(reasons) else f"reason {number}"
