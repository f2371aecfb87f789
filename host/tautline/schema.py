"""What a key of a file may hold: one definition, of which its parser, its errors and its page are made."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from sys import float_info
from typing import Any, Literal

from tautline.errors import TautError, nearest


@dataclass(frozen=True)
class Key:
    """One key of a section. If it is not `needed` and not there, the dataclass that is made of the section has its
    default."""

    name: str
    says: str  # what it is, with its unit
    example: Any
    kind: Literal["number", "whole", "numbers", "text"] = "number"
    count: int = 0  # of numbers
    needed: bool = True
    above: float | None = None
    at_least: float | None = None
    choices: tuple[str, ...] = ()
    pattern: str = ""  # of a text
    described: str = ""  # the pattern in words
    wrong: str = ""  # how a wrong value shows itself

    @property
    def expected(self) -> str:
        """In words, which values the key takes."""
        if self.choices:
            return " or ".join(f'"{choice}"' for choice in self.choices)
        if self.kind == "text":
            return self.described or "a text in quotes"
        if self.kind == "numbers":
            return f"a list of {self.count} numbers"
        what = "a whole number" if self.kind == "whole" else "a number"
        if self.above is not None:
            return f"{what} above {self.above:g}"
        return f"{self.at_least:g} or more" if self.at_least is not None else f"a finite {what.removeprefix('a ')}"

    def read(self, value: Any, name: str, where: str, file: str = "rig") -> Any:
        """Checks a value of the file and returns it as the section's dataclass has it: str, int, float or a tuple of
        floats. TautError for a value that the key does not take. name: section.key; where: the file's name; file: as in
        Section."""
        if self.kind == "text":
            good = isinstance(value, str) and (not self.choices or value in self.choices)
            if not good or (self.pattern and not re.fullmatch(self.pattern, value)):
                raise self.refuse(value, name, where, file)
            return value
        if self.kind == "numbers":
            if not isinstance(value, list) or len(value) != self.count:
                raise self.refuse(value, name, where, file)
            if not all(_is_number(item) for item in value):
                bad = next(item for item in value if not _is_number(item))
                raise _error(where, f"{name} holds {bad!r}, expected finite numbers", f"{file}.{name}")
            return tuple(float(item) for item in value)
        if not _is_number(value):
            raise _error(where, f"{name} is {value!r}, expected a finite number", f"{file}.{name}")
        too_low = (self.above is not None and not value > self.above) or (
            self.at_least is not None and not value >= self.at_least
        )
        if too_low or (self.kind == "whole" and value != int(value)):
            raise self.refuse(value, name, where, file)
        return int(value) if self.kind == "whole" else float(value)

    def refuse(self, value: Any, name: str, where: str, file: str) -> TautError:
        """The error to raise for a value that the key does not take; arguments as in `read`."""
        shown = f"{value:g}" if _is_number(value) else repr(value)
        return _error(where, f"{name} is {shown}, expected {self.expected}", f"{file}.{name}")


@dataclass(frozen=True)
class Section:
    """One section of a file, and its keys."""

    name: str
    says: str
    keys: tuple[Key, ...]
    file: str = "rig"  # of its topics: 'taut explain FILE.SECTION.KEY'

    def read(self, document: Mapping[str, Any], where: str) -> dict[str, Any]:
        """Checks the section of a file, `document`, and returns the keys that are there, by name. TautError for a
        missing section, a missing key that is needed, or a value that its key does not take. where: the file's name,
        for the error."""
        table = document.get(self.name)
        topic = f"{self.file}.{self.name}"
        if table is not None and not isinstance(table, Mapping):
            raise _error(where, f"{self.name} is no section: write [{self.name}] and its keys below it", topic)
        if table is None:
            names = ", ".join(key.name for key in self.keys)
            meant = next((name for name in document if nearest(name, [self.name])), None)
            hint = f"[{meant}] is there, did you mean it?" if meant else f"it holds {names}"
            raise _error(where, f"section [{self.name}] is missing: {hint}", topic)
        values = {}
        for key in self.keys:
            name = f"{self.name}.{key.name}"
            if key.name in table:
                values[key.name] = key.read(table[key.name], name, where, self.file)
            elif key.needed:
                meant = next((other for other, like in self.misspelt(table) if like == key.name), None)
                hint = f" ({meant} is there, did you mean it?)" if meant else ""
                raise _error(where, f"{name} is missing{hint}, expected {key.expected}", f"{self.file}.{name}")
        return values

    def misspelt(self, table: Mapping[str, Any]) -> list[tuple[str, str]]:
        """The unknown keys of the section's `table` that look like a known one: pairs (unknown, known)."""
        known = [key.name for key in self.keys]
        found = ((name, nearest(name, known)) for name in table if name not in known)
        return [(name, meant) for name, meant in found if meant is not None]


@dataclass(frozen=True)
class Column:
    """A column of a CSV. `name` may hold {unit}, which stands for the rig's unit of q."""

    name: str
    says: str
    needed: bool = False
    written: bool = False  # by tautline only; never looked for


@dataclass(frozen=True)
class Layout:
    """A CSV file's columns, in the order in which they are written."""

    file: str
    says: str
    columns: tuple[Column, ...]

    def required(self, unit: str = "") -> list[str]:
        """Names of the columns that have to be there. unit: of q, for the names that hold {unit}."""
        return [column.name.format(unit=unit) for column in self.columns if column.needed]

    def header(self, unit: str = "") -> str:
        """The shortest header line that the file may have, for errors. unit: as in `required`."""
        return ",".join(self.required(unit))

    def names(self, unit: str = "") -> list[str]:
        """Names of all columns that are known. unit: as in `required`."""
        return [column.name.format(unit=unit) for column in self.columns]


def _is_number(value: Any) -> bool:
    """Whether a value of TOML is a finite number that a float can hold; true and false are no numbers."""
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) <= float_info.max


def _error(where: str, says: str, topic: str) -> TautError:
    """The error to raise. where: the file; says: what is wrong in it; topic: of `taut explain`, which says more."""
    return TautError(f"{where}: {says} (taut explain {topic})")
