"""Runs of a simulator in processes side by side: the same numbers, sooner."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from functools import cache
from multiprocessing import get_context

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Motor
from tautline.simulators.simulator import Simulator

_ELSE = "use 1 worker, or a module's function"
_sent: list[bytes] = []  # of a worker: the pickled simulator


@contextmanager
def pool(simulator: Simulator, workers: int) -> Iterator[Executor | None]:
    """Processes that run the simulator; None for one worker. TautError where it cannot be sent to another process, or
    one ends."""
    if workers < 2:
        yield None
        return
    try:
        sent = pickle.dumps(simulator)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TautError(f"the simulator cannot be sent to another process ({error}): {_ELSE}") from error
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (sent,)) as executor:
        try:
            yield executor
        except BrokenProcessPool as error:
            raise TautError(f"a process that the simulator runs in has ended ({error}): {_ELSE}") from error


def tip(motor: Motor, changes: Mapping[str, float]) -> npt.NDArray[np.float64]:
    """In a worker: `Simulator.tip` of the simulator that it was begun with, (n,) deg. TautError where it is not there
    for this process, as a notebook's function is not."""
    return _simulator().tip(motor, changes)


def _begin(sent: bytes) -> None:
    """Begins a worker with the pickled simulator."""
    _sent.append(sent)


@cache
def _simulator() -> Simulator:
    """The worker's simulator, out of what it was begun with."""
    try:
        made: Simulator = pickle.loads(_sent[0])
    except Exception as error:  # of somebody else's module: anything
        raise TautError(f"the simulator is not there for another process ({error}): {_ELSE}") from error
    return made
