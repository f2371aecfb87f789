"""The results of a fleet's sessions: a row for each, kept in one Parquet data set, in parts while it grows."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from tautline.errors import TautError, of_system

DATA_SET = "sessions"  # a folder of Parquet files in the output folder
FAILED = "failed"  # a verdict of a row, beside those of a calibration: there is no calibration
_DIGITS = 6  # format: digits of a part's number
_EXTRA = "pip install 'tautline-robotics[fleet]'"


@dataclass(frozen=True)
class Row:
    """The results of one session. Its curves are sampled at the places `q`, which divide the rig's range evenly, both
    ends among them. Columns are None or empty where there is no calibration."""

    robot: str
    session: str
    inputs: str  # hash of the files and the version that it was calibrated from and by; "": calibrate it again
    batch: str | None = None
    date: str | None = None  # YYYY-MM-DD
    verdict: str = FAILED
    reasons: tuple[str, ...] = ()  # codes of the verdict's reasons, likeliest first
    error: str | None = None  # why there is no calibration
    unit: str | None = None  # of q
    q: tuple[float, ...] = ()
    width: tuple[float, ...] = ()  # backlash width B, unit of q
    width_sigma: tuple[float, ...] = ()
    width_by_delay: tuple[float, ...] = ()  # unit of q: signed part of width_sigma, correlated over q
    c_deg: tuple[float, ...] = ()  # bending angle f_remain(q)
    c_sigma_deg: tuple[float, ...] = ()  # NaN where unknown
    path: tuple[float, ...] = ()  # of the tip as its sensor sees it: all u, then all v, px; or all angles, deg
    path_sigma: tuple[float, ...] = ()
    measured_low: float | None = None  # unit of q: from here
    measured_high: float | None = None  # to here reversals measured B
    delay_s: float | None = None
    delay_sigma_s: float | None = None
    residual: float | None = None  # rms of what the model leaves, px a coordinate or deg
    motion_s: float | None = None  # length of the recordings
    seconds: float | None = None  # processor time of its calibration
    since: str | None = None  # the robot's first usable session, from which the next three are changes
    width_change: float | None = None  # of the mean B, as a share of it
    width_change_sigma: float | None = None
    offset_change: float | None = None  # of f_remain along q, unit of q
    wear: float | None = None  # of the robot: growth of B from one session to the next, as a share
    wear_sigma: float | None = None

    @property
    def id(self) -> str:
        """ROBOT/SESSION, unique in a fleet."""
        return f"{self.robot}/{self.session}"

    @property
    def usable(self) -> bool:
        """Whether there is a calibration whose verdict is no worse than doubtful."""
        return self.verdict in ("good", "doubtful")


_LISTS = frozenset(field.name for field in fields(Row) if field.type == "tuple[float, ...]")
_NUMBERS = frozenset(field.name for field in fields(Row) if field.type == "float | None")


class DataSet:
    """The rows of one output folder as a Parquet data set: numbered files (parts), one more with each `append`. Where
    two parts have a row of the same session, the row of the later part counts."""

    def __init__(self, out: Path) -> None:
        """The data set in the output folder `out`. Nothing is written yet: its own folder is made with the first part.
        TautError where pyarrow is not installed."""
        try:
            self._arrow, self._parquet = import_module("pyarrow"), import_module("pyarrow.parquet")
        except ImportError as error:
            raise TautError(f"a fleet's results are written with pyarrow, which is not installed: {_EXTRA}") from error
        self.folder = out / DATA_SET
        self._next = 1 + max((int(path.stem.split("-")[1]) for path in self._parts()), default=-1)

    def read(self) -> dict[str, Row]:
        """All rows by ROBOT/SESSION. TautError where a part cannot be read."""
        found: dict[str, Row] = {}
        for path in self._parts():
            try:
                lines = self._parquet.read_table(path, schema=self._schema()).to_pylist()
                rows = [_row_of_line(line) for line in lines]
            except (OSError, KeyError, TypeError, ValueError, self._arrow.ArrowException) as error:
                raise TautError(f"{path}: no part of a fleet's results ({error}): delete it, and run again") from error
            found |= {row.id: row for row in rows}
        return found

    def append(self, rows: Iterable[Row]) -> None:
        """Writes the rows as one more part; writes nothing where there are none."""
        if rows := list(rows):
            self._write(rows)

    def rewrite(self, rows: Iterable[Row]) -> None:
        """Makes the data set hold these rows alone: writes them as one new part, then deletes all earlier parts."""
        earlier = self._parts()
        self.append(rows)
        for path in earlier:
            path.unlink()

    def _parts(self) -> list[Path]:
        """The data set's files in the order in which they were written."""
        return sorted(self.folder.glob(f"part-{'[0-9]' * _DIGITS}.parquet"))

    def _write(self, rows: list[Row]) -> None:
        """Writes the rows as the next part, whole or not at all: into a temporary file that is then renamed. TautError
        where it cannot be written."""
        table = self._arrow.Table.from_pylist([asdict(row) for row in rows], schema=self._schema())
        path = self.folder / f"part-{self._next:0{_DIGITS}d}.parquet"
        temporary = self.folder / f".{path.name}.{os.getpid()}"
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._parquet.write_table(table, temporary)
            temporary.replace(path)
        except OSError as error:
            with suppress(OSError):  # the folder may not exist
                temporary.unlink()
            raise TautError(of_system(error)) from error
        self._next += 1

    def _schema(self) -> Any:
        """The Parquet (Arrow) schema of a Row: numbers as float64, tuples as lists of float64 or, for `reasons`, of
        text, all other fields as text."""
        arrow = self._arrow

        def kind(name: str) -> Any:
            """The Arrow type of one of Row's fields."""
            if name in _LISTS:
                return arrow.list_(arrow.float64())
            if name == "reasons":
                return arrow.list_(arrow.string())
            return arrow.float64() if name in _NUMBERS else arrow.string()

        return arrow.schema([(field.name, kind(field.name)) for field in fields(Row)])


def _row_of_line(line: Mapping[str, Any]) -> Row:
    """A Row from a line of the data set (values by column): lists become tuples, a missing list an empty tuple.
    KeyError or TypeError where the line is damaged."""
    values: dict[str, Any] = {k: tuple(value or ()) if k in _LISTS else value for k, value in line.items()}
    return Row(**values | {"reasons": tuple(line["reasons"])})
