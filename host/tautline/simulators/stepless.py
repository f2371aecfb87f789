"""The limit of a simulator for ever shorter steps of time, extrapolated from two runs (Richardson)."""

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
    """Richardson's extrapolation, 2 f(step / 2) - f(step), which has no error of first order in the step."""

    coarse: Simulate  # with the step
    fine: Simulate  # with half of it

    def __call__(self, motor: Motor, parameters: Mapping[str, float]) -> npt.NDArray[np.float64]:
        """The extrapolated angles (n,), deg, of the tip at motor.t_s (n,); arguments as of Simulator.simulate."""
        coarse, fine = (np.asarray(run(motor, parameters), dtype=float) for run in (self.coarse, self.fine))
        return np.asarray(2.0 * fine - coarse)


def stepless(simulator: Simulator, step_s: float) -> Simulator:
    """A simulator that gives the limit of `simulator` for short steps of time, extrapolated from two runs with the
    steps step_s and step_s / 2. Its source keeps step_s under STEP, for `source.open_simulator`. TautError where the
    step cannot be changed."""
    if simulator.at_step is None:
        raise TautError("the simulator's step of time cannot be changed: give its Simulator at_step")
    coarse, fine = simulator.at_step(step_s), simulator.at_step(0.5 * step_s)
    source = {**simulator.source, STEP: step_s}
    return Simulator(_Limit(coarse.simulate, fine.simulate), simulator.parameters, source)
