"""A fleet's run: what is new is calibrated, wherever its workers are; what is done stays done."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from tautline import __version__
from tautline.errors import TautError
from tautline.fleet.changes import compared
from tautline.fleet.rows import DATA_SET, DataSet, Row
from tautline.fleet.sessions import Session, digest, sessions_in
from tautline.fleet.work import PLACES, calibrated
from tautline.folders import check_replaceable
from tautline.pool import Pool

Progress = Callable[[float, str], None]

_ROWS = 3  # format: of what a row holds
MADE_BY = f"{__version__} {PLACES} {_ROWS}"  # a row by another version is made anew
_KEPT, _KEPT_S = 64, 10.0  # tolerance: rows, and seconds, after which what is done is written


@dataclass(frozen=True)
class Done:
    """Of a run: all rows in the order of robots and sessions, and how many of them are new."""

    rows: tuple[Row, ...]
    new: int


def died(name: str) -> Row:
    """The row of a session whose workers all died (pool's `died`)."""
    robot, _, session = name.partition("/")
    error = "every worker that calibrated it died: look for too little memory, or use fewer --jobs"
    return Row(robot, session, inputs="", error=error)


def run(folder: Path, out: Path, workers: Pool, progress: Progress) -> Done:
    """Calibrates every session of FOLDER that `out`'s data set does not hold as it is now; sessions that are gone from
    FOLDER go from it. TautError where FOLDER holds none, or `out` something else."""
    check_replaceable(out, DATA_SET)
    sessions, kept = sessions_in(folder), DataSet(out)
    rows = kept.read()
    begun = {session.id: _begun(session) for session in sessions}
    total, known, done = len(sessions), 0, 0

    def todo() -> Iterator[tuple[str, tuple[Row, dict[str, bytes]]]]:
        """What is to be calibrated: session ids, and the arguments of `calibrated`. Sessions that are done count as
        known; one that cannot be read waits with its error instead."""
        nonlocal known
        for session in sessions:
            try:
                files = session.files()
            except TautError as error:  # of this session alone
                waiting.append(replace(begun[session.id], error=str(error)))
                continue
            inputs = digest(files, MADE_BY)
            if session.id in rows and rows[session.id].inputs == inputs:
                known += 1
            else:
                begun[session.id] = replace(begun[session.id], inputs=inputs)
                yield session.id, (begun[session.id], files)

    waiting: list[Row] = []
    written_s = time.monotonic()
    try:
        for name, row in workers(calibrated, todo()):
            done += 1
            waiting.append(replace(row, date=begun[name].date))
            progress((known + done) / total, f"{name}: {row.error or row.verdict}")
            if len(waiting) >= _KEPT or time.monotonic() - written_s > _KEPT_S:
                rows |= _taken(waiting, kept)
                written_s = time.monotonic()
    finally:
        rows |= _taken(waiting, kept)
    now = [replace(rows[session.id], batch=session.batch) for session in sessions]
    ended = compared(now)
    kept.rewrite(ended)
    return Done(tuple(ended), done)


def _begun(session: Session) -> Row:
    """The row of a session that is not calibrated yet: names, batch and date alone."""
    return Row(session.robot, session.name, inputs="", batch=session.batch, date=session.date)


def _taken(waiting: list[Row], kept: DataSet) -> dict[str, Row]:
    """Writes the waiting rows into the data set and empties the list. Returns them by robot/session."""
    kept.append(waiting)
    taken = {row.id: row for row in waiting}
    waiting.clear()
    return taken
