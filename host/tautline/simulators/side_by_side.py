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
    """A context with `workers` processes that have the simulator, to which `tip` can be submitted; None for fewer than
    two: then this process simulates itself. TautError where the simulator cannot be sent to another process, or a
    process ends."""
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
    """What is submitted to `pool`: in a worker, Simulator.tip of the simulator that it got, (n,) deg. TautError where a
    worker cannot load it, such as a notebook's function."""
    return _simulator().tip(motor, changes)


def _receive_simulator(sent: bytes) -> None:
    """Initialiser of a worker: keeps the pickled simulator, which `_simulator` loads, so that its errors are raised
    where it is used."""
    _pickled.append(sent)


@cache
def _simulator() -> Simulator:
    """The worker's simulator, loaded once. TautError where it cannot be loaded."""
    try:
        made: Simulator = pickle.loads(_pickled[0])
    except Exception as error:  # of somebody else's module: anything
        raise TautError(f"the simulator is not there for another process ({error}): {_ELSE}") from error
    return made
