"""CSV files of numbers: one header line, comma-separated, decimal points. Every error names file, line and column."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd

from tautline.errors import TautError

Array = np.ndarray

MAX_REPEATED_TIMES = 0.01  # tolerance: share of rows whose time repeats: beyond it the clock is too coarse


@dataclass
class Columns:
    """A CSV file's columns as text, turned into numbers where asked. `warnings` collects what was repaired."""

    path: Path
    names: list[str]
    cells: dict[str, Array]  # (n,) each: numbers or bool where all of a column's are, else object: str, NaN where empty
    index: Array  # (n,) int: of each row in the file, the first below the header line is 0; blank lines do not count
    terminated: bool  # the last line ends in a newline
    text: str
    warnings: list[str] = field(default_factory=list)

    def __len__(self) -> int:
        """The number of rows, n."""
        return len(self.index)

    def keep(self, rows: slice | Array) -> None:
        """Removes all rows but these, in place. rows: a slice, or a mask (n,) bool."""
        self.cells = {name: cells[rows] for name, cells in self.cells.items()}
        self.index = self.index[rows]

    def line(self, row: int) -> int:
        """The number, from 1, of the line in the file that holds row `row`, an index into the rows that are kept."""
        numbers = [number for number, line in enumerate(_lines(self.text), 1) if line.strip()]
        return numbers[min(int(self.index[row]) + 1, len(numbers) - 1)]  # the first of them is the header

    def missing(self, name: str, expected: str) -> TautError:
        """The error to raise where the file has no column `name`. expected: in words, what has to be there."""
        return TautError(f"{self.path}: column {name} is missing (found {', '.join(self.names)}): expected {expected}")

    def raw(self, name: str) -> Array:
        """Column `name` as (n,) float64, NaN where a cell is empty or NaN. TautError, with file and line, where a cell
        is no number."""
        column = self.cells[name]
        numbers = _numbers(column)
        for row in np.flatnonzero(np.isnan(numbers) & pd.notna(column)):
            if str(column[row]).strip().lower() not in ("", "nan"):
                raise TautError(
                    f"{self.path}, line {self.line(row)}: {name} is {_shown(column[row])}, expected a number"
                )
        return numbers

    def finite(self, name: str) -> Array:
        """Column `name` as (n,) float64. TautError, with file and line, where a cell is empty, NaN, infinite or no
        number."""
        values = self.raw(name)
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size:
            what = "empty or NaN" if np.isnan(values[bad[0]]) else "infinite"
            others = f" (and {bad.size - 1} more)" if bad.size > 1 else ""
            raise TautError(
                f"{self.path}, line {self.line(bad[0])}: {name} is {what}{others}, expected a finite number"
            )
        return values

    def flags(self, name: str) -> Array:
        """Column `name` as (n,) bool, of cells that are 0 or 1, true or false. TautError, with file and line, where one
        is anything else."""
        column = self.cells[name]
        if column.dtype == bool:
            return column
        values = _numbers(column, {"true": "1", "false": "0"})
        bad = np.flatnonzero(~np.isin(values, [0, 1]))
        if bad.size:
            cell = _shown(column[bad[0]])
            raise TautError(f"{self.path}, line {self.line(bad[0])}: {name} is {cell}, expected 0 or 1")
        return values.astype(bool)

    def drop_truncated(self, required: Sequence[str]) -> None:
        """Removes, with a warning, a last line that was cut while it was written. Does nothing where that line is ended
        or is the only one. A line counts as cut if it has fewer cells than there are columns, if its last cell has
        fewer decimals than those of up to ten lines before it where these agree, if its time is not later than the one
        before, or if one of its `required` cells is no finite number. The file must have a column t_s."""
        if self.terminated or len(self) < 2:
            return
        line_end = "\n" if "\n" in self.text else "\r"
        # 24: of the last lines every second one may be blank. The first of the twelve may be the header.
        *earlier, last = [line.split(",") for line in self.text.rsplit(line_end, 24) if line.strip()][-12:]
        decimals = {_decimals(cells[-1]) for cells in earlier[1:]}  # one number of them: a fixed format
        cut = len(last) < len(self.names) or (len(decimals) == 1 and _decimals(last[-1]) < min(decimals))
        if not cut:
            try:
                cells = [float(self.cells[name][-1]) for name in required if name in self.cells]
                times = self.cells["t_s"][-2:].astype(float)
                cut = not np.isfinite(cells).all() or not times[1] > times[0]
            except (ValueError, TypeError, KeyError):
                cut = True
        if cut:
            self.keep(slice(-1))
            self.warnings.append(f"{self.path}: the last line is cut short and was left out")

    def rising_times(self) -> Array:
        """(n,) t_s, s, made strictly rising: rows that repeat the time before them are removed from all columns, in
        place, with a warning. TautError where a time goes back, or where more than one row and more than a share
        MAX_REPEATED_TIMES of all repeat."""
        t_s = self.finite("t_s")
        step = np.diff(t_s)
        back = np.flatnonzero(step < 0)
        if back.size:
            row = int(back[0]) + 1
            raise TautError(
                f"{self.path}, line {self.line(row)}: t_s goes back from {t_s[row - 1]:.9g} to {t_s[row]:.9g}: "
                "times must rise, on one clock"
            )
        repeated = np.flatnonzero(step == 0) + 1
        if repeated.size == 0:
            return t_s
        if repeated.size > max(1.0, MAX_REPEATED_TIMES * len(t_s)):
            raise TautError(
                f"{self.path}, line {self.line(int(repeated[0]))}: t_s repeats in {repeated.size} of {len(t_s)} rows: "
                "write the times with more digits, or of each row when it was read where several arrive at once"
            )
        keep = np.ones(len(t_s), dtype=bool)
        keep[repeated] = False
        self.keep(keep)
        self.warnings.append(f"{self.path}: {repeated.size} rows that repeat the time before them were left out")
        kept: np.ndarray = t_s[keep]
        return kept


def read_columns(path: Path, required: Iterable[str], expected: str, mend: bool = True) -> Columns:
    """Reads a CSV file. required: columns that it must have, besides one row at least; expected: the header line that
    errors show; mend: whether a last line that was cut is left out (`drop_truncated`). TautError, with file and line,
    where it is no such file."""
    text, terminated = _read_text(path)
    header = re.search(r"[^\r\n]*\S[^\r\n]*", text)
    if header is None:
        raise TautError(f"{path}: the file is empty: expected the header line {expected} and rows of numbers")
    header_line = len(_lines(text[: header.start()]))
    names = _header(path, header[0], header_line, expected)
    body = text[header.end() :]
    if not body.strip():
        raise TautError(f"{path}: has a header line but no rows")
    try:
        table = _table(_with_whole_first_row(body, len(names)))
    except (pd.errors.ParserError, pd.errors.EmptyDataError, ValueError, OverflowError, csv.Error) as error:
        raise _uneven_error(path, text, header_line, len(names)) from error
    if any(pd.notna(column).any() for column in table[len(names) :]):
        raise _uneven_error(path, text, header_line, len(names))
    rows = len(table[0])
    cells = dict(zip(names, table, strict=False)) | {name: np.full(rows, np.nan) for name in names[len(table) :]}
    columns = Columns(path, names, cells, index=np.arange(rows), terminated=terminated, text=text)
    for name in required:
        if name not in names:
            raise columns.missing(name, expected)
    if mend:
        columns.drop_truncated(list(required))
    return columns


def read_times(path: Path, warnings: list[str] | None = None) -> tuple[list[str], Array]:
    """Reads column t_s of any CSV file, in any order and beside any other columns: returns its n cells as text and as
    numbers (n,), s. A last line that is not ended is left out where its time may be cut; `warnings`, if given, then
    gets a line that says so."""
    columns = read_columns(path, ["t_s"], "a column t_s", mend=False)
    index = columns.names.index("t_s")
    try:
        rows = list(csv.reader(line for line in _lines(columns.text) if line.strip()))[1 : len(columns) + 1]
    except csv.Error as error:
        raise TautError(f"{path}: cannot be read as comma-separated numbers ({error})") from error
    # The last line's time may be cut, or is not there; where t_s is the last column a cut cannot be told.
    if not columns.terminated and len(rows) > 1 and len(rows[-1]) <= min(index + 1, len(columns.names) - 1):
        columns.keep(slice(-1))
        rows = rows[:-1]
        if warnings is not None:
            warnings.append(f"{path}: the last line is cut short and was left out")
    times = columns.finite("t_s")
    return [row[index].strip() for row in rows], times


def _with_whole_first_row(body: str, count: int) -> str:
    """The rows `body`, the first of them filled up with empty cells to `count`: pandas refuses a later row that is
    longer than the first one. Unchanged where the first row is as long."""
    first = re.search(r"[^\r\n]*\S[^\r\n]*", body)
    missing = 0 if first is None else count - 1 - first[0].count(",")
    return body if first is None or missing <= 0 else body[: first.end()] + "," * missing + body[first.end() :]


def _table(body: str) -> list[Array]:
    """Parses rows that have no header line above them into columns, (n,) each. Where rows are not alike pandas raises
    an error of its own."""
    frame = pd.read_csv(io.BytesIO(body.encode()), header=None, low_memory=False, skipinitialspace=True)
    return [column.to_numpy() for _, column in frame.items()]


def _read_text(path: Path) -> tuple[str, bool]:
    """A CSV file's text, and whether its last line is ended. TautError where it cannot be read or is no UTF-8 text."""
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise TautError(f"{path}: there is no such file") from error
    except OSError as error:
        raise TautError(f"{path}: cannot be read ({error.strerror})") from error
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        raise TautError(f"{path}: is UTF-16 text: save it as UTF-8")
    if b"\0" in data:
        raise TautError(f"{path}: is not a text file (byte 0 at {data.index(0)}): expected comma-separated numbers")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise TautError(
            f"{path}: is not a UTF-8 text file (byte {error.start}): expected comma-separated numbers"
        ) from error
    return text, data.endswith((b"\n", b"\r"))


def _lines(text: str) -> list[str]:
    """The lines of a text, split at any of the three line ends: CR LF, LF or CR."""
    return re.split(r"\r\n|\n|\r", text)


def _numbers(column: Array, words: Mapping[str, str] = MappingProxyType({})) -> Array:
    """(n,) float64 of (n,) cells, NaN where a cell is empty or no number. words: the numbers, as text, that some cells
    stand for, by the cell in lower case."""
    if column.dtype.kind in "iuf":
        return column.astype(np.float64, copy=False)
    filled = pd.notna(column)
    text = [str(cell).strip() for cell in column[filled]]
    numbers = np.full(len(column), np.nan)
    numbers[filled] = pd.to_numeric(np.array([words.get(t.lower(), t) for t in text], dtype=object), errors="coerce")
    return numbers


def _shown(cell: Any) -> str:
    """A cell as an error message shows it: "empty", or its first 24 characters in quotes."""
    return "empty" if pd.isna(cell) else repr(str(cell)[:24])


def _decimals(cell: str) -> int:
    """How many characters stand behind the decimal point of a cell; 0 without one."""
    return len(cell.strip().partition(".")[2])


def _is_number(cell: str) -> bool:
    """Whether a text is a number, with a decimal point or a decimal comma."""
    try:
        float(cell.replace(",", "."))
    except ValueError:
        return False
    return True


def _header(path: Path, line: str, number: int, expected: str) -> list[str]:
    """The names in the header line `line`, which is line `number` of the file; empty ones at its end are left out.
    TautError for other separators than commas, for a line of numbers alone, and for a name that occurs twice. expected:
    the header line that the error shows."""
    for separator, word in ((";", "semicolons"), ("\t", "tabs")):
        if separator in line and "," not in line:
            raise TautError(
                f"{path}, line {number}: columns are separated by {word}: expected commas and decimal points"
            )
    names = [name.strip().strip('"') for name in line.split(",")]
    if all(_is_number(name) for name in names):
        raise TautError(f"{path}, line {number}: holds numbers where the header line {expected} is expected")
    while names and not names[-1]:
        names.pop()
    for name in names:
        if name and names.count(name) > 1:
            raise TautError(f"{path}, line {number}: column {name[:24]} is there twice")
    return names


def _uneven_error(path: Path, text: str, header_line: int, count: int) -> TautError:
    """The error to raise where rows do not fit the header. It names the first line with more cells than the header has
    columns, `count`, the header being line header_line (from 1); where no line has more, it says that the file is no
    table. Empty cells at a line's end do not count."""
    for number, line in enumerate(_lines(text)[header_line:], header_line + 1):
        cells = line.rstrip(", \t").split(",")
        if len(cells) > count:
            hint = " (decimal commas?)" if len(cells) == 2 * count else ""
            return TautError(
                f"{path}, line {number}: has {len(cells)} cells, the header line has {count} columns{hint}"
            )
    hint = " (an unclosed quotation mark?)" if text.count('"') % 2 else ""
    return TautError(f"{path}: cannot be read as comma-separated numbers{hint}")
