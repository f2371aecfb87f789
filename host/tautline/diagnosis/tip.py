"""The tip's error with a board's tables before and after a diagnosis, simulated."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import effects, trajectory
from tautline.compensation import compensate
from tautline.errors import TautError
from tautline.model import Model
from tautline.recording import Motor
from tautline.rig import Actuator

Array = npt.NDArray[np.float64]

_SPEED = 15.0  # format: deg/s of the trajectory, at most
_RANGES_PER_S = 0.15  # format: of the trajectory's range of angles, at most
_SECONDS = 30.0  # format: s of the trajectory
_FREE = 0.1  # format: share of the angles that the tables reach, left free at either end: effects need room
_RESOLUTION_DEG = 1e-3  # format: deg of the trajectory's steps
_SETTLED = 0.3  # format: share of the trajectory after which the tip has been driven through both ways


def simulated_error(nominal: Model, corrected: Model) -> dict[str, Any] | None:
    """The object `tip` of diagnosis.json: rms error of the tip's angle, deg, on a smooth trajectory over the reached
    angles, if the instrument is as `corrected` says. `before_deg` is with the tables of `nominal`, `after_deg` with
    those of `corrected`. Loads and other axes stay as calibrated. None where no table can be made of one of the
    models."""
    try:
        t_s, c_deg = _trajectory(corrected)
        before, after = (_rms_error(tables, corrected, t_s, c_deg) for tables in (nominal, corrected))
    except TautError:
        return None
    return {"before_deg": before, "after_deg": after}


def _trajectory(model: Model) -> tuple[Array, Array]:
    """(Times (n,), s; angles (n,), deg) of a smooth random trajectory (fixed seed) within the reached angles, but for a
    share _FREE at either end."""
    ends = np.sort(model.remaining(np.array(model.rig.actuator.range)))
    free = _FREE * (ends[1] - ends[0])
    tip = Actuator("deg", (float(ends[0] + free), float(ends[1] - free)), _RESOLUTION_DEG)  # planned as a motor's
    planned = trajectory.random_smooth(tip, min(_SPEED, _RANGES_PER_S * tip.span), _SECONDS, 1)
    return planned.t_s, planned.q


def _rms_error(tables: Model, instrument: Model, t_s: Array, c_deg: Array) -> float:
    """Rms difference, deg, between the wanted trajectory c_deg (n,) at t_s (n,) and the simulated angle of
    `instrument`, whose motor is driven by `tables`. The first share _SETTLED of the time does not count."""
    points = compensate(tables, t_s, c_deg)
    motor = Motor(points.t_s, points.q)
    parameters = effects.of_model(instrument, scatter=True)
    path = effects.follow(instrument, motor, points.t_s, parameters, float(c_deg[0]))
    error = path.c_deg - np.interp(points.t_s, t_s, c_deg)
    settled = points.t_s > t_s[0] + _SETTLED * (t_s[-1] - t_s[0])
    return float(np.sqrt(np.mean(error[settled] ** 2)))
