"""How a CSV is written: its separator, decimal sign, header line and units, told from its first lines."""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from tautline.errors import TautError
from tautline.io.importing.units import TIMES, known_unit, unit_in

_LOOKED_AT = 200  # tolerance: lines from which the layout is told
_LOOKED_AT_BYTES = 1 << 18  # tolerance: that hold so many lines of 1 kB
_SEPARATORS = (";", "\t", "|", ",", " ")  # in the order in which they are believed where several fit
_NUMBER = re.compile(r"[+-]?(\d[\d.]*([.,]\d*)?|[.,]\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.IGNORECASE)
_DATE = re.compile(r"\d{4}[-/.]\d\d?[-/.]\d\d?(?!\d)|\d\d?[-/.]\d\d?[-/.]\d{4}(?!\d)|\d\d?:\d\d:\d\d")
_DECIMAL_COMMA = re.compile(r"[+-]?[\d.]*\d,\d+([eE][+-]?\d+)?")
_GROUPED = re.compile(r"[+-]?\d{1,3}(\.\d{3})+,\d+")  # 1.234,5
_ENCODINGS = ("utf-8-sig", "cp1252")  # cp1252: what a spreadsheet on Windows writes


@dataclass(frozen=True)
class Layout:
    """How a CSV is written."""

    encoding: str  # Python's name
    separator: str  # " ": any blanks
    decimal: str  # "." or ","
    thousands: str | None  # None: digits are not grouped
    names: list[str]  # of the columns
    units: list[str]  # of units.py, "" where none is told
    first: int  # lines before the first row of numbers

    @classmethod
    def of(cls, path: Path) -> Layout:
        """Finds out the layout of a file from its first lines. Most of them are to be rows of numbers; the line of
        names is above them, perhaps with a line of units between. TautError where there is no such table, or two
        columns have one name."""
        lines, encoding = _first_lines(path)
        separator, rows = _split_by_best_separator(path, lines)
        numeric = [k for k, row in enumerate(rows) if _is_numeric(row)]
        lengths = [len(rows[k]) for k in numeric]
        count = max(sorted(set(lengths), reverse=True), key=lengths.count)  # a stray separator makes one row longer
        # first row of numbers; the lines above it that are filled enough to be names or units
        first = next(k for k in numeric if len(rows[k]) == count)
        above = [k for k in range(first) if sum(bool(cell) for cell in rows[k]) >= max(2, count - 1)]
        if not above:
            raise TautError(f"{path}, line {first + 1}: holds numbers and no line of names is above it: put one there")
        unit_row = rows[above[-1]] if len(above) > 1 and _is_units(rows[above[-1]]) else None
        header = above[-1] if unit_row is None else above[-2]
        names = [name or f"column {k + 1}" for k, name in enumerate((rows[header] + [""] * count)[:count])]
        if (twice := next((name for name in names if names.count(name) > 1), None)) is not None:
            raise TautError(f"{path}, line {header + 1}: column {twice[:24]} is there twice: give each its own name")
        below = (unit_row or []) + [""] * count
        units = [_column_unit(below[k], name) for k, name in enumerate(names)]
        cells = [cell for row in rows[first:] if len(row) == count for cell in row]
        commas = separator != "," and any(_DECIMAL_COMMA.fullmatch(cell) for cell in cells)
        grouped = commas and any(_GROUPED.fullmatch(cell) for cell in cells)
        return cls(encoding, separator, "," if commas else ".", "." if grouped else None, names, units, first)


def _column_unit(below: str, name: str) -> str:
    """A column's unit: the cell below its name in a line of units, else the one at the name's end; "" where neither is
    a unit."""
    cell = below.strip("[]() ")
    return known_unit(cell) or known_unit(cell, TIMES) or unit_in(name) or unit_in(name, TIMES)


def is_date(cell: str) -> bool:
    """Whether a cell begins with a date or a time of day."""
    return bool(_DATE.match(cell))


def _first_lines(path: Path) -> tuple[list[str], str]:
    """The first whole lines of a file, at most _LOOKED_AT, and the encoding that they are read in. TautError where the
    file is empty or no text."""
    with path.open("rb") as stream:
        data = stream.read(_LOOKED_AT_BYTES)
    if not data.strip():
        raise TautError(f"{path}: the file is empty: expected a line of names and rows of numbers")
    encodings: Sequence[str] = _ENCODINGS
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        encodings = ("utf-16",)
    elif b"\0" in data:
        raise TautError(
            f"{path}: is not a text file (byte 0 at {data.index(0)}): expected a CSV, an MCAP file or a bag"
        )
    for encoding in encodings:
        try:
            text = codecs.getincrementaldecoder(encoding)().decode(data)  # a letter may be cut at the end
        except UnicodeDecodeError:
            continue
        lines = re.split(r"\r\n|\n|\r", text)
        whole = lines[:-1] if len(data) == _LOOKED_AT_BYTES else lines
        return whole[:_LOOKED_AT], encoding
    raise TautError(f"{path}: is no text in UTF-8, UTF-16 or Windows-1252: save it as UTF-8")


def _split_by_best_separator(path: Path, lines: Sequence[str]) -> tuple[str, list[list[str]]]:
    """The separator that splits most lines into rows of numbers of one length, and the cells of all lines by it.
    TautError where no separator gives rows of numbers."""
    best: tuple[int, str, list[list[str]]] = (0, "", [])
    for separator in _SEPARATORS:
        rows = [_cells(line, separator) for line in lines]
        counts = [len(row) for row in rows if _is_numeric(row)]
        fitting = max((counts.count(count) for count in set(counts)), default=0)
        if fitting > best[0]:
            best = (fitting, separator, rows)
    if not best[0]:
        raise TautError(f"{path}: holds no table of numbers with a separator ; , tab | or blank: is it a CSV?")
    return best[1], best[2]


def _cells(line: str, separator: str) -> list[str]:
    """A line's cells, without blanks around them; [] for a line that csv cannot split."""
    if separator == " ":
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def _is_numeric(row: Sequence[str]) -> bool:
    """Whether a row is one of numbers: it has two cells or more, at least one of them a number, and less than half are
    texts. Dates and empty cells count as neither."""
    numbers = sum(bool(_NUMBER.fullmatch(cell)) for cell in row)
    texts = sum(bool(cell) and not is_date(cell) for cell in row) - numbers
    return len(row) > 1 and numbers > 0 and texts < 0.5 * len(row)


def _is_units(row: Sequence[str]) -> bool:
    """Whether a row is one of units: more than half of its non-empty cells are units."""
    cells = [cell.strip("[]() ") for cell in row if cell]
    return sum(bool(known_unit(cell) or known_unit(cell, TIMES)) for cell in cells) > 0.5 * len(cells)
