"""A robot's motor log with a simulator behind it: the simulated tip takes the motor's place as the coordinate."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Executor, Future
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
    """Of one recording. The coordinate is f_coarse's inverse of the simulated angle: with no backlash and f_remain =
    f_coarse the chain shows the simulated angle itself, in the rig's own unit of q."""

    def __init__(self, simulator: Simulator, motor: Motor, rig: Rig, pool: Executor | None = None) -> None:
        """The log is the command where there is one, else the encoder's path. pool: of side_by_side."""
        self._simulator, self._rig, self._coarse, self._pool = simulator, rig, rig.coarse, pool
        self._asked: dict[tuple[float, ...], Future[Array]] = {}
        self._ids = {simulator_id(each.name): each.name for each in simulator.parameters}
        self.log = _log(motor, rig)  # at a fixed step: what the simulator is driven by
        self._known: OrderedDict[tuple[float, ...], Motor] = OrderedDict()

    def along(self, motor: Motor) -> Drive:
        """The same simulator behind another motor log."""
        return Drive(self._simulator, motor, self._rig, self._pool)

    def ask(self, parameters: Mapping[str, Any]) -> None:
        """Announces parameters for `motor`, so that processes, if there are any, can simulate them meanwhile."""
        changes, key = self._changes(parameters)
        if self._pool is not None and key not in self._known and key not in self._asked:
            self._asked[key] = self._pool.submit(side_by_side.tip, self.log, changes)

    def motor(self, parameters: Mapping[str, Any]) -> Motor:
        """The log with the simulated tip's coordinate (unit of q) as its q, straight lines between its knots; the last
        ones are kept. parameters: by effects' names, how far they are off the simulator's own."""
        changes, key = self._changes(parameters)
        if key not in self._known:
            asked = self._asked.pop(key, None)
            tip = self._simulator.tip(self.log, changes) if asked is None else asked.result()
            self._known[key] = _at_coordinate(self.log, (tip - self._coarse.offset) / self._coarse.gain)
            if len(self._known) > _KEPT:
                self._known.popitem(last=False)
        self._known.move_to_end(key)
        return self._known[key]

    def _changes(self, parameters: Mapping[str, Any]) -> tuple[dict[str, float], tuple[float, ...]]:
        """The simulator's parameters that are off, by their own names, and the same of all as a key to what is kept."""
        changes = {name: float(parameters[key]) for key, name in self._ids.items() if parameters.get(key)}
        return changes, tuple(changes.get(name, 0.0) for name in self._ids.values())


def _log(motor: Motor, rig: Rig) -> Motor:
    """The motor command (without one, the path) and the other columns at a fixed step, linear between samples."""
    path = MotorPath.of(motor, rig.actuator.encoder_resolution)
    steps = int(np.floor((motor.t_s[-1] - motor.t_s[0]) / STEP_S))
    t_s = motor.t_s[0] + STEP_S * np.arange(steps + 1)
    q = path.at(t_s) if motor.q_cmd is None else np.interp(t_s, motor.t_s, motor.q_cmd)

    def taken(values: Array | None) -> Array | None:
        return None if values is None else np.interp(t_s, motor.t_s, values)

    translation, rotation, load = map(taken, (motor.translation_mm, motor.rotation_deg, motor.load_mNm))
    joints = {name: np.interp(t_s, motor.t_s, values) for name, values in motor.joints.items()}
    return Motor(t_s, q, None, translation, rotation, load, joints)


def _at_coordinate(log: Motor, q: Array) -> Motor:
    """The log with q (n,), unit of q, in its motor's place."""
    return Motor(log.t_s, q, None, log.translation_mm, log.rotation_deg, log.load_mNm, log.extra)
