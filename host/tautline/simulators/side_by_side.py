"""Runs of a simulator in processes side by side: the same numbers, sooner."""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Motor
from tautline.simulators.simulator import Simulator

_simulator: list[Simulator] = []  # of a worker: sent to it once


@contextmanager
def pool(simulator: Simulator, workers: int) -> Iterator[Executor | None]:
    """Processes that run the simulator; None for one worker. TautError where it cannot be sent to another process."""
    if workers < 2:
        yield None
        return
    try:
        sent = pickle.dumps(simulator)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TautError(
            f"the simulator cannot be sent to another process ({error}): use 1 worker, or a module's function"
        ) from error
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (sent,)) as executor:
        yield executor


def tip(motor: Motor, changes: Mapping[str, float]) -> npt.NDArray[np.float64]:
    """In a worker: `Simulator.tip` of the simulator that it was begun with, (n,) deg."""
    return _simulator[0].tip(motor, changes)


def _begin(sent: bytes) -> None:
    """Begins a worker with the pickled simulator."""
    _simulator.append(pickle.loads(sent))
