"""Where a campaign's work is done: in this process, on all cores of this machine, or on a Dask cluster."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from contextlib import contextmanager
from types import FrameType
from typing import Any

from tautline.errors import TautError

Work = Iterator[tuple[str, tuple[Any, ...]]]  # name of the task, the function's arguments
Done = Iterator[tuple[str, Any]]
Pool = Callable[[Callable[..., Any], Work], Done]  # results in any order; arguments are made as they are needed

_AHEAD = 2  # tasks per core that wait with their arguments in memory


@contextmanager
def pool(jobs: int | None, dask: str | None) -> Iterator[Pool]:
    """`jobs`: processes on this machine, default all cores; 1: this process. `dask`: a scheduler's address."""
    if dask is not None:
        with _dask(dask) as made:
            yield made
    elif jobs == 1:
        yield lambda function, work: ((name, function(*arguments)) for name, arguments in work)
    else:
        with _processes(jobs or os.cpu_count() or 1) as made:
            yield made


@contextmanager
def _processes(jobs: int) -> Iterator[Pool]:
    # Each library reads its own variable when a worker starts: one core a case, and no two cases on one.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    executor = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), initializer=_ignore_interrupt)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield lambda function, work: _windowed(
            work,
            _AHEAD * jobs,
            lambda arguments: executor.submit(function, *arguments),
            lambda waiting: wait(waiting, return_when=FIRST_COMPLETED).done,
        )
    finally:
        executor.shutdown(cancel_futures=True)
        signal.signal(signal.SIGTERM, before)


@contextmanager
def _dask(address: str) -> Iterator[Pool]:
    try:
        distributed: Any = importlib.import_module("dask.distributed")
    except ImportError as error:
        raise TautError("--dask needs Dask: pip install 'tautline[campaign]'") from error
    try:
        client = distributed.Client(address, timeout="5s")
    except OSError as error:
        raise TautError(f"no Dask scheduler answers at {address}: start one with 'dask scheduler'") from error
    with client:
        cores = sum(client.ncores().values())
        if cores == 0:
            raise TautError(f"the Dask scheduler at {address} has no workers: start one with 'dask worker {address}'")
        yield lambda function, work: _windowed(
            work,
            _AHEAD * cores,
            lambda arguments: client.submit(function, *arguments, pure=False),
            lambda waiting: distributed.wait(waiting, return_when="FIRST_COMPLETED").done,
        )


def _windowed(
    work: Work, ahead: int, submit: Callable[[tuple[Any, ...]], Any], first_done: Callable[[list[Any]], Any]
) -> Done:
    waiting: dict[Any, str] = {}
    for name, arguments in work:
        waiting[submit(arguments)] = name
        if len(waiting) >= ahead:
            for future in first_done(list(waiting)):
                yield waiting.pop(future), future.result()
    while waiting:
        for future in first_done(list(waiting)):
            yield waiting.pop(future), future.result()


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise KeyboardInterrupt  # `timeout` stops a campaign as Ctrl-C does, and leaves no worker behind


def _ignore_interrupt() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the campaign's to handle
