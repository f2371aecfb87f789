"""CSV of any separator, decimal sign and column names, by pandas, a part at a time."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from tautline.errors import TautError
from tautline.io.importing.layout import Layout, is_date
from tautline.io.importing.source import EPOCH_S, Array, Batch, Clip, Fact
from tautline.io.importing.units import TIMES, split_unit, unit_in

_CHUNK_ROWS = 65536  # limit: of memory: rows that are held at once
_RISES = 0.99  # tolerance: share of a column of times' steps that may not go back: what is left is mended or refused
_TIME_WORDS = re.compile(r"(t|time|zeit\w*|timestamp|stamp|uhrzeit|temps|tiempo|epoch|date|datum|datetime)([^a-z]|$)")
SLOWEST_S, FASTEST_S = 0.2, 5e-5  # prior: between a motor's rows (10 Hz to 10 kHz), and as much again to either side


class Delimited:
    """A CSV as a Source: one episode, one group "" whose channels are the columns."""

    kind = "CSV"
    numbers = "column"

    def __init__(self, path: Path, time: str = "") -> None:
        """Reads the first rows, and finds out how the file is written, which column is the time, and its unit. time:
        that column's name, or with its unit NAME:ms; "" finds it. TautError where the file is no table of numbers, or
        has no column of times."""
        self.path = path
        self.notes: list[str] = []
        self.videos: list[str] = []
        self._layout = Layout.of(path)
        first = next(self._frames(_CHUNK_ROWS), None)
        if first is None or len(first) < 2:
            raise TautError(f"{path}: holds no rows of numbers: expected a line of names and rows")
        names = self._layout.names
        name, unit = split_unit(time, names, TIMES)
        if time and name not in names:
            raise TautError(f"{path}: has no column {name}: it has {', '.join(names)}")
        self._time = name or self._time_column(first)
        begins = _first_text(first[self._time])
        self._dated = bool(begins) and (is_date(begins) or not self._holds_numbers(first[self._time]))
        self._day_first = not re.match(r"\d{4}", begins)
        self._unit, self._origin = self._unit_and_origin(first[self._time], unit)
        self.origin_s = self._origin * TIMES[self._unit]
        others = [each for each in zip(names, self._layout.units, strict=True) if each[0] != self._time]
        self.facts = {name: Fact("number", unit=unit) for name, unit in others}

    def episodes(self) -> Sequence[int]:
        """(0,): the table is one recording."""
        return (0,)

    def batches(self, episode: int, groups: Collection[str] | None = None) -> Iterator[Batch]:
        """Yields all rows as batches of the one group "", a part of the file at a time. episode, groups: as every
        Source takes them, unused."""
        for frame in self._frames():
            values = {name: self._numbers(frame[name]) for name in self.facts}
            yield Batch("", self._seconds(frame[self._time]), None, values)

    def pictures(self, episode: int, video: str) -> Clip:
        """The video file of this name in the table's folder, whole, as a clip. episode: unused. Whether there is such a
        file is not checked."""
        return Clip(self.path.parent / video)

    def _frames(self, rows: int | None = None) -> Iterator[pd.DataFrame]:
        """Yields the table's rows as data frames of at most _CHUNK_ROWS rows each. rows: how many from the start; None:
        all. TautError where the file cannot be read to its end."""
        how = self._layout
        try:
            with pd.read_csv(
                self.path,
                sep=r"\s+" if how.separator == " " else how.separator,
                decimal=how.decimal,
                thousands=how.thousands,
                encoding=how.encoding,
                header=None,
                names=how.names,
                usecols=range(len(how.names)),
                skiprows=how.first,
                skipinitialspace=True,
                chunksize=_CHUNK_ROWS,
                nrows=rows,
                low_memory=False,
            ) as reader:
                yield from reader
        except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError) as error:
            what = " ".join(str(error).split())
            raise TautError(f"{self.path}: cannot be read to its end ({what}): mend that line") from error

    def _numbers(self, column: pd.Series) -> Array:
        """A column as float64 (n,), NaN where a cell holds no number; thousands and decimal signs as the file has
        them."""
        if not pd.api.types.is_numeric_dtype(column):
            text = column.astype("string").str.strip()
            if self._layout.thousands:
                text = text.str.replace(self._layout.thousands, "", regex=False)
            column = pd.to_numeric(text.str.replace(self._layout.decimal, ".", regex=False), errors="coerce")
        return column.to_numpy(dtype=np.float64, na_value=np.nan)

    def _holds_numbers(self, column: pd.Series) -> bool:
        """Whether at least half of a column's cells are numbers; the others may be a recorder's remarks."""
        return bool(np.mean(np.isfinite(self._numbers(column))) >= 0.5)

    def _moments(self, column: pd.Series) -> Array:
        """A column of dates as int64 (n,), ns since 1970; the least int64 (NaT) for a cell that is no date. Dates are
        such as 2026-11-23 15:13:47.5; if the file's first one does not begin with a year, the day comes first and the
        year last."""
        text = column.astype("string").str.replace(",", ".", regex=False)
        moments = pd.to_datetime(text, errors="coerce", dayfirst=self._day_first, format="mixed")
        return moments.to_numpy("datetime64[ns]").astype(np.int64)

    def _seconds(self, column: pd.Series) -> Array:
        """The column of times in s since the origin (n,), NaN where a cell holds no time."""
        if self._dated:
            moments = self._moments(column)
            since = (moments - self._origin) * 1e-9
            return np.where(moments == np.iinfo(np.int64).min, np.nan, since)  # NaT is the least int64
        if pd.api.types.is_integer_dtype(column):  # an epoch's nanoseconds are more than a float holds
            whole: Array = (column.to_numpy(np.int64) - int(self._origin)) * TIMES[self._unit]
            return whole
        return (self._numbers(column) - self._origin) * TIMES[self._unit]

    def _first_moment(self, column: pd.Series) -> int:
        """The first date in a column, ns since 1970. TautError where one of its first few filled cells is no date."""
        head = column.dropna().head()
        moments = self._moments(head)
        if moments.min() == np.iinfo(np.int64).min:
            cell = str(head.iloc[moments.argmin()])[:24]
            raise TautError(f"{self.path}: column {self._time} holds {cell!r}, expected times")
        return int(moments[0])

    def _unit_and_origin(self, column: pd.Series, unit: str) -> tuple[str, float | int]:
        """The unit of the times, of units.TIMES, and the origin, in that unit, that is subtracted from them: the first
        time if they count from an epoch, else 0. unit: the user's, "" without. Without it the unit is the one in the
        column's name or in the line of units, or else guessed from the rows' step, which is added to `notes`. column:
        the first rows. TautError where they hold no times."""
        if self._dated:
            return "ns", self._first_moment(column)
        numbers = self._numbers(column)
        filled = np.flatnonzero(np.isfinite(numbers))
        if not len(filled):
            raise TautError(f"{self.path}: column {self._time} holds no times: name another with --time NAME")
        step = float(np.median(np.diff(numbers[filled]))) if len(filled) > 1 else 0.0
        stated = self._layout.units[self._layout.names.index(self._time)]
        unit = unit or unit_in(self._time, TIMES) or (stated if stated in TIMES else "")
        if not unit:
            if not step > 0.0:
                raise TautError(
                    f"{self.path}: {self._time} is the same in most neighbouring rows: these are no times of rows, "
                    f"name others with --time NAME, or their unit with --time '{self._time}:UNIT'"
                )
            unit = _unit_by_step(step)
            self.notes.append(
                f"{self.path}: {self._time} has no unit: its steps of {step:.6g} are taken as {unit}, "
                f"{1.0 / (step * TIMES[unit]):.4g} rows/s; --time '{self._time}:UNIT' says another"
            )
        whole = pd.api.types.is_integer_dtype(column)  # an epoch's nanoseconds are more than a float holds
        start = column.iloc[filled[0]].item() if whole else float(numbers[filled[0]])
        return unit, start if abs(start) * TIMES[unit] > EPOCH_S else 0

    def _time_column(self, first: pd.DataFrame) -> str:
        """The name of the column of times, from the first rows: the first one that rises as times do and has a time's
        name; else the first with such a name, else the first that rises. A column that holds one day in all rows does
        not count as named so. TautError where there is none."""
        rising = [name for name in self._layout.names if _may_be_times(first[name])]
        called = [name for name in self._layout.names if _TIME_WORDS.match(name.strip().lower())]
        # A text that is the same in all rows is the day on which they were recorded, and no time.
        days = {name for name in called if _first_text(first[name]) and first[name].nunique() == 1}
        called = [name for name in called if name not in days]
        found = [name for name in called if name in rising] or called or rising
        if not found:
            raise TautError(
                f"{self.path}: no column rises as times do (found {', '.join(self._layout.names)}): "
                "name it with --time NAME"
            )
        return found[0]


def _may_be_times(column: pd.Series) -> bool:
    """Whether a column may hold times: dates that differ in more than half of all neighbouring rows, or numbers that
    rise, where at most 1 - _RISES of the steps go back."""
    if begins := _first_text(column):
        return is_date(begins) and bool(np.mean(column.iloc[1:].to_numpy() != column.iloc[:-1].to_numpy()) > 0.5)
    step = np.diff(column.to_numpy(dtype=np.float64, na_value=np.nan))
    return bool(np.mean(step >= 0) > _RISES and np.nanmedian(step) > 0)


def _first_text(column: pd.Series) -> str:
    """The first cell of a column of texts that is not empty; "" for a column of numbers."""
    filled = column.dropna()
    return "" if pd.api.types.is_numeric_dtype(column) or not len(filled) else str(filled.iloc[0])


def _unit_by_step(step: float) -> str:
    """Guesses the unit, of units.TIMES, of times that go on by `step` from row to row: the longest one in which that is
    a motor's usual step (FASTEST_S to SLOWEST_S); "s" where there is none."""
    return next((u for u, times in TIMES.items() if FASTEST_S <= abs(step) * times <= SLOWEST_S), "s")
