"""What a user has beside a diagnosis with a simulator: `mujoco.sysid`'s own optimiser and intervals on the same MJCF.

Needs what its extra `mujoco[sysid]` installs. Its residual is what the simulator shows less what the joint's sensor
read; every parameter of the MJCF that a diagnosis knows is free, within a factor of 100 or 20 of its spreads.
"""

from __future__ import annotations

import time
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO

import numpy as np

from tautline.core.chain import by_differences
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulators import Simulator
from tautline.simulators.drive import Drive
from tools.so101 import Array, measured

_FACTOR, _SPREADS = 100.0, 20.0
_MOST_STEPS = 60
_DIFFERENCE = 0.01  # of a parameter's range's logarithm, or of its spread


@dataclass(frozen=True)
class Identified:
    simulator: Simulator
    values: dict[str, float]
    covariance: Array  # of the values, by assuming that the fit is good
    residual_deg: float
    core_s: float

    def told(self, rig: Rig, run: Recording) -> Array:
        """(n,) deg at the sensor's times."""
        return _shown(self.simulator, rig, run, np.array(list(self.values.values())))

    def sigma(self, rig: Rig, run: Recording) -> Array:
        """(n,) deg, one standard deviation of a reading: of its parameters and of what its fit left."""
        at = np.array(list(self.values.values()))
        steps = _DIFFERENCE * np.array([p.spread for p in self.simulator.parameters])
        slopes = by_differences(lambda x: _shown(self.simulator, rig, run, x), at, steps)
        spread = np.einsum("ni,ij,nj->n", slopes, self.covariance, slopes)
        return np.sqrt(np.maximum(spread, 0.0) + self.residual_deg**2)


def available() -> bool:
    try:
        from mujoco.sysid import optimize
    except ImportError:
        return False
    return callable(optimize)


def identify(simulator: Simulator, rig: Rig, run: Recording) -> Identified:
    from mujoco import sysid

    parameters = sysid.ParameterDict()
    for p in simulator.parameters:
        factor = p.nominal > 0.0
        low = p.nominal / _FACTOR if factor else max(p.low, -_SPREADS * p.spread)
        high = p.nominal * _FACTOR if factor else min(p.high, _SPREADS * p.spread)
        start = p.nominal if factor else p.nominal + 0.1 * p.spread  # not at an end: its optimiser stalls there
        parameters.add(sysid.Parameter(p.name, start, low, high))

    def residual(x: Array, _: object) -> tuple[list[Array], None, None]:
        return [_shown(simulator, rig, run, np.asarray(x).ravel()) - measured(run)], None, None

    began = time.process_time()
    with redirect_stdout(StringIO()):  # it prints its steps
        _, result = sysid.optimize(
            parameters, residual, optimizer="scipy", verbose=False, max_iters=_MOST_STEPS, x_scale="jac", diff_step=1e-3
        )
    left = residual(result.x, None)[0]
    jacobian = np.asarray(result.jac)
    covariance, _ = sysid.calculate_intervals(left, jacobian)
    names = [p.name for p in simulator.parameters]
    values = dict(zip(names, np.asarray(result.x).ravel().tolist(), strict=True))
    rms = float(np.sqrt(np.mean(left[0] ** 2)))
    finite = np.nan_to_num(np.asarray(covariance), nan=0.0, posinf=0.0, neginf=0.0)
    return Identified(simulator, values, finite, rms, time.process_time() - began)


def _shown(simulator: Simulator, rig: Rig, run: Recording, values: Array) -> Array:
    assert run.angle is not None
    changes = {p.name: float(v) - p.nominal for p, v in zip(simulator.parameters, values, strict=True)}
    log = Drive(simulator, run.motor, rig).log
    return np.asarray(np.interp(run.angle.t_s, log.t_s, simulator.tip(log, changes)))
