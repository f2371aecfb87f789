"""Where many tasks are done: in this process, on all cores of this machine, or on a Dask cluster.

A worker that dies loses nothing: what it had is done again, and what kills its worker every time is told apart."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from types import FrameType
from typing import Any

from tautline.errors import TautError

Task = tuple[str, tuple[Any, ...]]  # its name, the function's arguments
Work = Iterator[Task]
Done = Iterator[tuple[str, Any]]
Pool = Callable[[Callable[..., Any], Work], Done]  # results in any order; arguments are made as they are needed
Died = Callable[[str], Any]  # from a task's name: what stands for its result where each worker that had it died

_AHEAD = 2  # tasks per core that wait with their arguments in memory
_TRIES = 2  # of a task alone, before it counts as what kills its worker: one may be killed from outside


@contextmanager
def pool(jobs: int | None, dask: str | None, died: Died | None = None) -> Iterator[Pool]:
    """Yields a function that runs tasks: in this process, in processes of this machine or on a cluster. jobs: processes
    on this machine, by default one a core; 1 means this process. dask: the address of a scheduler, used if given. died:
    gives the result of a task that kills its workers; without it such a task ends the work with a TautError."""
    died = died or _ended
    if dask is not None:
        with _dask(dask, died) as made:
            yield made
    elif jobs == 1:
        yield lambda function, work: ((name, function(*arguments)) for name, arguments in work)
    else:
        with _processes(jobs or os.cpu_count() or 1, died) as made:
            yield made


def _ended(name: str) -> Any:
    """The `died` of a caller that gives none: raises the TautError that ends the work. name: of the task that killed
    its workers."""
    raise TautError(f"{name}: every worker that had it died: look for too little memory, or use fewer --jobs")


@contextmanager
def _processes(jobs: int, died: Died) -> Iterator[Pool]:
    """Yields a pool of `jobs` processes on this machine, which end with the block. Meanwhile SIGTERM interrupts as
    Ctrl-C does. Sets the environment so that a worker's libraries use one thread each. died: as of `pool`."""
    # Each library reads its own variable when a worker starts: one core a case, and no two cases on one.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    workers = _Processes(jobs, died)
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield workers.run
    finally:
        workers.executor.shutdown(cancel_futures=True)
        signal.signal(signal.SIGTERM, before)


class _Processes:
    """Processes on this machine. Where one dies its pool is lost with all others: a new pool does again what they had,
    one task at a time, so that a task which kills its worker is known."""

    def __init__(self, jobs: int, died: Died) -> None:
        """Starts `jobs` processes. died: gives the result of a task whose worker died although it ran alone."""
        self.jobs, self.died = jobs, died
        self.executor = self._begun()

    def _begun(self) -> ProcessPoolExecutor:
        """A new pool of processes. Each is started afresh (spawn), as a fork would copy threads of libraries in the
        middle of their work."""
        return ProcessPoolExecutor(self.jobs, multiprocessing.get_context("spawn"), initializer=_ignore_interrupt)

    def run(self, function: Callable[..., Any], work: Work) -> Done:
        """Runs the tasks (name, arguments) of `work` and yields (name, result) as they are done, in any order. At most
        _AHEAD tasks per process are submitted at a time, so that arguments are made as they are needed."""
        waiting: dict[Future[Any], Task] = {}
        lost: list[Task] = []
        for task in work:
            self._submit(function, task, waiting, lost)
            if len(waiting) >= _AHEAD * self.jobs or lost:
                yield from self._collected(function, waiting, lost)
        while waiting or lost:
            yield from self._collected(function, waiting, lost)

    def _submit(
        self, function: Callable[..., Any], task: Task, waiting: dict[Future[Any], Task], lost: list[Task]
    ) -> None:
        """Submits a task and puts it into `waiting` by its future, or into `lost` if the pool is broken already,
        because a worker has died."""
        try:
            waiting[self.executor.submit(function, *task[1])] = task
        except BrokenProcessPool:
            lost.append(task)

    def _collected(self, function: Callable[..., Any], waiting: dict[Future[Any], Task], lost: list[Task]) -> Done:
        """Waits for tasks in `waiting`, yields (name, result) of those that are done and takes them out; those whose
        worker died are moved into `lost`. Once any is lost it waits for all the others, begins a new pool and runs the
        lost tasks again, one by one."""
        for future in wait(waiting, return_when=FIRST_COMPLETED).done if not lost else list(waiting):
            task = waiting.pop(future)
            try:
                result = future.result()
            except BrokenProcessPool:
                lost.append(task)
            else:
                yield task[0], result
        if lost and not waiting:
            again, lost[:] = list(lost), []
            self.executor.shutdown()
            self.executor = self._begun()
            for task in again:
                yield task[0], self._alone(function, task)

    def _alone(self, function: Callable[..., Any], task: Task) -> Any:
        """Runs one task while no other runs, and returns its result. Where its worker dies it is run again in a new
        pool; after _TRIES deaths the result is what `died` gives."""
        for _ in range(_TRIES):
            try:
                return self.executor.submit(function, *task[1]).result()
            except BrokenProcessPool:
                self.executor.shutdown()
                self.executor = self._begun()
        return self.died(task[0])


@contextmanager
def _dask(address: str, died: Died) -> Iterator[Pool]:
    """Yields a pool on a Dask cluster, `address` being its scheduler's. TautError where Dask is not installed, or the
    scheduler does not answer or has no workers. died: as of `pool`."""
    try:
        distributed: Any = importlib.import_module("dask.distributed")
    except ImportError as error:
        raise TautError("a cluster needs Dask: pip install distributed") from error
    try:
        client = distributed.Client(address, timeout="5s")
    except (OSError, ValueError) as error:
        raise TautError(f"no Dask scheduler answers at {address}: start one with 'dask scheduler'") from error
    with client:
        cores = sum(client.ncores().values())
        if cores == 0:
            raise TautError(f"the Dask scheduler at {address} has no workers: start one with 'dask worker {address}'")

        def run(function: Callable[..., Any], work: Work) -> Done:
            """As `_Processes.run`, on the cluster; its scheduler itself tries a task on several workers."""
            waiting: dict[Any, str] = {}

            def collected() -> Done:
                """Waits for one task at least, yields (name, result) of those that are done and takes them out of
                `waiting`."""
                for future in distributed.wait(list(waiting), return_when="FIRST_COMPLETED").done:
                    name = waiting.pop(future)
                    try:
                        result = future.result()
                    except distributed.KilledWorker:  # the scheduler has tried it on several
                        result = died(name)
                    yield name, result

            for name, arguments in work:
                waiting[client.submit(function, *arguments, pure=False)] = name
                if len(waiting) >= _AHEAD * cores:
                    yield from collected()
            while waiting:
                yield from collected()

        yield run


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Handles SIGTERM by a KeyboardInterrupt: `timeout` then stops a campaign as Ctrl-C does, and leaves no worker
    behind."""
    raise KeyboardInterrupt


def _ignore_interrupt() -> None:
    """Has a new worker ignore Ctrl-C, which the campaign's own process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
