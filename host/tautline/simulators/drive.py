"""A robot's motor log with a simulator behind it: the simulated tip takes the motor's place as the coordinate."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Executor, Future
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.core.motor import MotorPath
from tautline.effects import simulator_id
from tautline.recording import Motor
from tautline.rig import Rig
from tautline.simulators import side_by_side
from tautline.simulators.simulator import Simulator

Array = npt.NDArray[np.float64]

STEP_S = 5e-3  # tolerance: between the simulated tip's knots: at 1000 deg/s^2 straight lines are 3 mdeg off
_KEPT = 64  # limit: simulations that are not run twice


class Drive:
    """One recording's motor log, run through the simulator. The coordinate is f_coarse's inverse of the simulated
    angle: with no backlash and f_remain = f_coarse the chain shows the simulated angle itself, in the rig's unit of q.
    """

    def __init__(self, simulator: Simulator, motor: Motor, rig: Rig, pool: Executor | None = None) -> None:
        """motor: the recording's; its command drives the simulator, or without one the encoder's path. pool: processes
        of side_by_side.pool; None simulates in this one."""
        self._simulator, self._rig, self._coarse, self._pool = simulator, rig, rig.coarse, pool
        self._asked: dict[tuple[float, ...], Future[Array]] = {}  # simulations under way in the pool
        self._ids = {simulator_id(each.name): each.name for each in simulator.parameters}  # names by effects' ids
        self.log = _resampled_log(motor, rig)  # at a fixed step: what the simulator is driven by
        self._known: OrderedDict[tuple[float, ...], Motor] = OrderedDict()  # results, the last used at the end

    def along(self, motor: Motor) -> Drive:
        """A Drive with the same simulator, rig and pool, driven by another motor log."""
        return Drive(self._simulator, motor, self._rig, self._pool)

    def ask(self, parameters: Mapping[str, Any]) -> None:
        """Starts a simulation in the pool's processes, so that several run at once; `motor` with the same parameters
        then waits for its result. Does nothing without a pool, or for a simulation that was started or whose result is
        kept."""
        changes, key = self._nonzero_changes(parameters)
        if self._pool is not None and key not in self._known and key not in self._asked:
            self._asked[key] = self._pool.submit(side_by_side.tip, self.log, changes)

    def motor(self, parameters: Mapping[str, Any]) -> Motor:
        """Runs the simulator and returns the motor's log with the simulated tip's coordinate, unit of q, as its q.
        parameters: by the effects' names, how far the simulator's parameters are off their nominal values; other
        effects' are ignored. The last _KEPT results are kept and not simulated again."""
        changes, key = self._nonzero_changes(parameters)
        if key not in self._known:
            running = self._asked.pop(key, None)
            tip_deg = self._simulator.tip(self.log, changes) if running is None else running.result()
            self._known[key] = _with_coordinate(self.log, (tip_deg - self._coarse.offset) / self._coarse.gain)
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key]

    def _nonzero_changes(self, parameters: Mapping[str, Any]) -> tuple[dict[str, float], tuple[float, ...]]:
        """The simulator's parameters in an effects' dictionary, in two forms: those that are not 0, by the simulator's
        own names; and the values of all, as a key for the kept results."""
        changes = {name: float(parameters[key]) for key, name in self._ids.items() if parameters.get(key)}
        return changes, tuple(changes.get(name, 0.0) for name in self._ids.values())


def _resampled_log(motor: Motor, rig: Rig) -> Motor:
    """The motor's log at a fixed step, STEP_S, with linear interpolation of all columns. Its q is the command, or
    without one the encoder's path."""
    path = MotorPath.of(motor, rig.actuator.encoder_resolution)
    steps = int(np.floor((motor.t_s[-1] - motor.t_s[0]) / STEP_S))
    t_s = motor.t_s[0] + STEP_S * np.arange(steps + 1)
    q = path.at(t_s) if motor.q_cmd is None else np.interp(t_s, motor.t_s, motor.q_cmd)
    return motor.resampled(t_s, q, motor.joints)


def _with_coordinate(log: Motor, q: Array) -> Motor:
    """The log with the coordinate q (n,), unit of q, instead of the motor's, and without a command."""
    return replace(log, q=q, q_cmd=None)
