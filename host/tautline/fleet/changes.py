"""How each robot changed: its sessions beside its first one, and how fast its B grows from session to session."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
import numpy.typing as npt
from scipy.optimize import brentq

from tautline.fleet.rows import Row

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class _Levels:
    """A robot's usable sessions: log of the mean B over what all of them measured, and its sigma. (n,) each."""

    at: list[int]  # places among the robot's sessions: its use is counted in them
    level: Array
    sigma: Array

    def line(self, scatter: float) -> tuple[Array, Array, Array]:
        """A straight line of level over sessions, with `scatter` (of log B) added to every sigma: values (2,) and
        covariance (2, 2) of level at the middle and growth a session, and the residuals (n,) over their sigma."""
        use = np.array(self.at, dtype=float)
        weight = 1.0 / (self.sigma**2 + scatter**2)
        columns = np.column_stack([np.ones(len(use)), use - np.average(use, weights=weight)])
        covariance = np.linalg.inv(columns.T @ (weight[:, None] * columns))
        values = covariance @ (columns.T @ (weight * self.level))
        return values, covariance, (self.level - columns @ values) * np.sqrt(weight)


def compared(rows: Sequence[Row]) -> list[Row]:
    """The rows, a robot's together and in its order, with what has changed since its first usable session."""
    robots = [list(each) for _, each in groupby(rows, key=lambda row: row.robot)]
    levels = [_levels(robot) for robot in robots]
    scatter = scatter_of(each for each in levels if each is not None)
    ended = []
    for robot, known in zip(robots, levels, strict=True):
        ended += _unknown(robot) if known is None else _changed(robot, known, scatter)
    return ended


def scatter_of(levels: Iterable[_Levels]) -> float:
    """Standard deviation of log B about a robot's own line beyond the stated sigmas, common to all robots: with it chi
    square equals its degrees of freedom."""
    long = [each for each in levels if len(each.at) > 2]
    freedom = sum(len(each.at) - 2 for each in long)

    def surplus(scatter: float) -> float:
        """Chi square about all lines with this scatter of log B, less its degrees of freedom."""
        return sum(float(np.sum(each.line(scatter)[2] ** 2)) for each in long) - freedom

    if not long or surplus(0.0) <= 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, 10.0))


def _levels(robot: Sequence[Row]) -> _Levels | None:
    """The logarithm of the mean B of a robot's usable sessions, over the range that all have measured, with sigmas;
    sessions on another grid than the first one's are left out. None where there is no usable session, no range in
    common, or a B of 0."""
    usable = [(k, row) for k, row in enumerate(robot) if row.usable and row.q == _first(robot).q]
    if not usable:
        return None
    low = max(row.measured_low or 0.0 for _, row in usable)
    high = min(row.measured_high or 0.0 for _, row in usable)
    q = np.array(usable[0][1].q)
    inside = (q >= low) & (q <= high)
    width, sigma = (np.array([getattr(row, name) for _, row in usable]) for name in ("width", "width_sigma"))
    mean = width[:, inside].mean(axis=1) if inside.any() else np.zeros(len(usable))
    if not (mean > 0.0).all():
        return None
    # Errors of one session go together over q: their mean is no smaller.
    return _Levels([k for k, _ in usable], np.log(mean), sigma[:, inside].mean(axis=1) / mean)


def _first(robot: Sequence[Row]) -> Row:
    """The robot's first usable session."""
    return next(row for row in robot if row.usable)


def _unknown(robot: Sequence[Row]) -> list[Row]:
    """The robot's rows with nothing said of changes."""
    return [
        replace(
            row, since=None, width_change=None, width_change_sigma=None, offset_change=None, wear=None, wear_sigma=None
        )
        for row in robot
    ]


def _changed(robot: Sequence[Row], known: _Levels, scatter: float) -> list[Row]:
    """The robot's rows with their changes of B and offset since its first usable session, and its growth a session."""
    first = robot[known.at[0]]
    wear = wear_sigma = None
    if len(known.at) > 1:
        values, covariance, _ = known.line(scatter)
        wear, wear_sigma = float(values[1]), float(np.sqrt(covariance[1, 1]))
    ended = [replace(row, wear=wear, wear_sigma=wear_sigma) for row in _unknown(robot)]
    for k, level, sigma in zip(known.at[1:], known.level[1:], known.sigma[1:], strict=True):
        grown = float(np.exp(level - known.level[0]))
        both = float(np.hypot(sigma, known.sigma[0]))
        ended[k] = replace(
            ended[k],
            since=first.session,
            width_change=grown - 1.0,
            width_change_sigma=grown * both,
            offset_change=_offset(first, robot[k]),
        )
    return ended


def _offset(first: Row, later: Row) -> float | None:
    """How far f_remain has moved along q, unit of q: the tip is where it was at q + offset. None where the two have no
    angle in common."""
    was, now = np.array(first.c_deg), np.array(later.c_deg)
    inside = (now >= was.min()) & (now <= was.max())
    if not inside.any():
        return None
    order = np.argsort(was)
    q = np.array(first.q)
    return float(np.median(np.interp(now[inside], was[order], q[order]) - q[inside]))
