"""A fleet's run: sessions that are new or have changed are calibrated, on workers here or elsewhere; the results of all
others are kept."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from tautline import __version__
from tautline.errors import TautError
from tautline.fleet.changes import with_changes
from tautline.fleet.rows import DATA_SET, DataSet, Row
from tautline.fleet.sessions import Session, digest, sessions_in
from tautline.fleet.work import PLACES, calibrate_session
from tautline.folders import check_replaceable
from tautline.pool import Pool

Progress = Callable[[float, str], None]

_ROWS = 3  # format: version of what a row holds
MADE_BY = f"{__version__} {PLACES} {_ROWS}"  # a row by another version is made anew
_KEPT, _KEPT_S = 64, 10.0  # tolerance: rows, and seconds, after which finished rows are stored


@dataclass(frozen=True)
class Done:
    """The result of a run."""

    rows: tuple[Row, ...]  # of all sessions, in the order of robots and sessions
    new: int  # how many sessions this run gave to workers, those that failed included


def row_of_lost_worker(name: str) -> Row:
    """The row of the session `name`, ROBOT/SESSION, whose calibration killed every worker that tried it. The pool calls
    this for a row in place of the result."""
    robot, _, session = name.partition("/")
    error = "every worker that calibrated it died: look for too little memory, or use fewer --jobs"
    return Row(robot, session, inputs="", error=error)


def run(folder: Path, out: Path, workers: Pool, progress: Progress) -> Done:
    """Brings the data set in `out` up to date with the sessions in `folder` (FOLDER/ROBOT/SESSION). A session is
    calibrated unless the data set has a row of the same files and version (Row.inputs); rows of sessions that are gone
    are deleted; the columns that compare sessions are filled anew. Finished rows are stored every few seconds, so that
    a run that was broken off can be continued. workers: the pool that calibrates; progress: gets the share done, 0 to
    1, and a line for each calibrated session. TautError where `folder` has no session, or `out` holds something
    else."""
    check_replaceable(out, DATA_SET)
    sessions, data_set = sessions_in(folder), DataSet(out)
    rows = data_set.read()
    empty = {session.id: _empty_row(session) for session in sessions}
    total, known, done = len(sessions), 0, 0
    waiting: list[Row] = []  # finished, but not stored yet

    def pending() -> Iterator[tuple[str, tuple[Row, dict[str, bytes]]]]:
        """Yields each session to calibrate: its id, and the arguments of `calibrate_session`. A session whose row is up
        to date is only counted in `known`, as is one that cannot be read, whose row with the error is appended to
        `waiting`."""
        nonlocal known
        for session in sessions:
            try:
                files = session.files()
            except TautError as error:  # concerns this session alone: the run goes on
                waiting.append(replace(empty[session.id], error=str(error)))
                known += 1
                progress((known + done) / total, f"{session.id}: {error}")
                continue
            inputs = digest(files, MADE_BY)
            if session.id in rows and rows[session.id].inputs == inputs:
                known += 1
            else:
                yield session.id, (replace(empty[session.id], inputs=inputs), files)

    written_s = time.monotonic()
    try:
        for name, row in workers(calibrate_session, pending()):
            done += 1
            waiting.append(replace(row, date=empty[name].date))
            progress((known + done) / total, f"{name}: {row.error or row.verdict}")
            if len(waiting) >= _KEPT or time.monotonic() - written_s > _KEPT_S:
                rows |= _store_waiting(waiting, data_set)
                written_s = time.monotonic()
    finally:
        rows |= _store_waiting(waiting, data_set)
    current = [replace(rows[session.id], batch=session.batch) for session in sessions]
    changed = with_changes(current)
    data_set.rewrite(changed)
    return Done(tuple(changed), done)


def _empty_row(session: Session) -> Row:
    """The row of a session that has not been calibrated: names, batch and date alone."""
    return Row(session.robot, session.name, inputs="", batch=session.batch, date=session.date)


def _store_waiting(waiting: list[Row], data_set: DataSet) -> dict[str, Row]:
    """Appends the waiting rows to the data set and empties the list. Returns them by ROBOT/SESSION."""
    data_set.append(waiting)
    stored = {row.id: row for row in waiting}
    waiting.clear()
    return stored
