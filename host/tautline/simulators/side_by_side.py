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
_pickled: list[bytes] = []  # of a worker: the pickled simulator


@contextmanager
def pool(simulator: Simulator, workers: int) -> Iterator[Executor | None]:
    """A context with `workers` processes that have the simulator; `tip` can be submitted to them. With fewer than two
    workers it gives None: then this process simulates itself. TautError where the simulator cannot be sent to another
    process, or a process ends."""
    if workers < 2:
        yield None
        return
    try:
        sent = pickle.dumps(simulator)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TautError(f"the simulator cannot be sent to another process ({error}): {_ELSE}") from error
    with ProcessPoolExecutor(workers, get_context("spawn"), _receive_simulator, (sent,)) as executor:
        try:
            yield executor
        except BrokenProcessPool as error:
            raise TautError(f"a process that the simulator runs in has ended ({error}): {_ELSE}") from error


def tip(motor: Motor, changes: Mapping[str, float]) -> npt.NDArray[np.float64]:
    """Runs Simulator.tip of the worker's simulator: the tip's angles (n,), deg. It is submitted to `pool` and called in
    a worker. TautError where the worker cannot load the simulator, such as a notebook's function."""
    return _simulator().tip(motor, changes)


def _receive_simulator(sent: bytes) -> None:
    """Keeps the pickled simulator in a worker, whose initialiser this is. `_simulator` loads it later, so that an error
    of loading is raised where the simulator is used."""
    _pickled.append(sent)


@cache
def _simulator() -> Simulator:
    """The worker's simulator, loaded at the first call. TautError where it cannot be loaded."""
    try:
        made: Simulator = pickle.loads(_pickled[0])
    except Exception as error:  # of somebody else's module: anything
        raise TautError(f"the simulator is not there for another process ({error}): {_ELSE}") from error
    return made
