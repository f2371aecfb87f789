"""What a simulator that goes in steps of time tends to as they get shorter, by two runs (Richardson)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Motor
from tautline.simulators.simulator import Simulate, Simulator

STEP = "stepless_from_s"  # format: of a simulator's source: the longer of the two steps, s


@dataclass(frozen=True)
class _Limit:
    """2 f(step / 2) - f(step): without the error of first order."""

    coarse: Simulate
    fine: Simulate

    def __call__(self, motor: Motor, parameters: Mapping[str, float]) -> npt.NDArray[np.float64]:
        """(n,) deg at motor.t_s."""
        coarse, fine = (np.asarray(run(motor, parameters), dtype=float) for run in (self.coarse, self.fine))
        return np.asarray(2.0 * fine - coarse)


def stepless(simulator: Simulator, step_s: float) -> Simulator:
    """The simulator's limit by its runs at step_s and at half of it; its source says so. TautError where its step
    cannot be changed."""
    if simulator.at_step is None:
        raise TautError("the simulator's step of time cannot be changed: give its Simulator at_step")
    coarse, fine = simulator.at_step(step_s), simulator.at_step(0.5 * step_s)
    source = {**simulator.source, STEP: step_s}
    return Simulator(_Limit(coarse.simulate, fine.simulate), simulator.parameters, source)
