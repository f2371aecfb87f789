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

    at: list[int]  # their indices among all of the robot's sessions, by which its use is counted
    level: Array  # log of the mean B
    sigma: Array  # of `level`

    def line(self, scatter: float) -> tuple[Array, Array, Array]:
        """Fits a straight line of `level` over the sessions' indices by weighted least squares; scatter: a standard
        deviation of log B that is added to every sigma in quadrature. Returns values (2,), level at the weighted middle
        and growth a session, their covariance (2, 2), and the residuals (n,) over their sigma."""
        use = np.array(self.at, dtype=float)
        weight = 1.0 / (self.sigma**2 + scatter**2)
        columns = np.column_stack([np.ones(len(use)), use - np.average(use, weights=weight)])
        covariance = np.linalg.inv(columns.T @ (weight[:, None] * columns))
        values = covariance @ (columns.T @ (weight * self.level))
        return values, covariance, (self.level - columns @ values) * np.sqrt(weight)


def with_changes(rows: Sequence[Row]) -> list[Row]:
    """The rows with the columns filled that compare a robot's sessions: since, width_change, offset_change, wear and
    their sigmas. rows: a robot's together and in their order, as they are returned."""
    robots = [list(each) for _, each in groupby(rows, key=lambda row: row.robot)]
    levels = [_levels(robot) for robot in robots]
    scatter = common_scatter(each for each in levels if each is not None)
    changed_rows = []
    for robot, known in zip(robots, levels, strict=True):
        changed_rows += _without_changes(robot) if known is None else _with_robot_changes(robot, known, scatter)
    return changed_rows


def common_scatter(levels: Iterable[_Levels]) -> float:
    """By how much log B scatters about a robot's own line beyond the sigmas that sessions state: one standard deviation
    for all robots, with which chi square equals its degrees of freedom; 0 where the sigmas explain all."""
    long = [each for each in levels if len(each.at) > 2]
    freedom = sum(len(each.at) - 2 for each in long)

    def surplus(scatter: float) -> float:
        """Chi square about all lines with this scatter of log B, less its degrees of freedom."""
        return sum(float(np.sum(each.line(scatter)[2] ** 2)) for each in long) - freedom

    if not long or surplus(0.0) <= 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, 10.0))


def _levels(robot: Sequence[Row]) -> _Levels | None:
    """The logarithm of the mean B of a robot's usable sessions (on the first one's grid), each over the range that all
    of them have measured, so that they can be compared. None where there is no usable session, no range in common, or a
    B of 0."""
    usable = [(k, row) for k, row in enumerate(robot) if row.usable and row.q == _first_usable(robot).q]
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


def _first_usable(robot: Sequence[Row]) -> Row:
    """The robot's first usable session."""
    return next(row for row in robot if row.usable)


def _without_changes(robot: Sequence[Row]) -> list[Row]:
    """The robot's rows with all columns of changes empty, also those that an earlier run has filled."""
    return [
        replace(
            row, since=None, width_change=None, width_change_sigma=None, offset_change=None, wear=None, wear_sigma=None
        )
        for row in robot
    ]


def _with_robot_changes(robot: Sequence[Row], known: _Levels, scatter: float) -> list[Row]:
    """The robot's rows with the growth of its B a session in each (wear, of log B: a share), and in the usable ones
    after the first the change since that: width_change, a share of B, and offset_change, unit of q. scatter: as in
    `_Levels.line`."""
    first = robot[known.at[0]]
    wear = wear_sigma = None
    if len(known.at) > 1:
        values, covariance, _ = known.line(scatter)
        wear, wear_sigma = float(values[1]), float(np.sqrt(covariance[1, 1]))
    changed_rows = [replace(row, wear=wear, wear_sigma=wear_sigma) for row in _without_changes(robot)]
    for k, level, sigma in zip(known.at[1:], known.level[1:], known.sigma[1:], strict=True):
        ratio = float(np.exp(level - known.level[0]))  # of mean B to the first one's
        log_sigma = float(np.hypot(sigma, known.sigma[0]))
        changed_rows[k] = replace(
            changed_rows[k],
            since=first.session,
            width_change=ratio - 1.0,
            width_change_sigma=ratio * log_sigma,
            offset_change=_offset_change(first, robot[k]),
        )
    return changed_rows


def _offset_change(first: Row, later: Row) -> float | None:
    """How far f_remain (c_deg over q) has moved along q between two sessions, unit of q, the median over q: the tip is
    at q where it was at q + offset. None where the two have no angle in common."""
    first_deg, later_deg = np.array(first.c_deg), np.array(later.c_deg)
    inside = (later_deg >= first_deg.min()) & (later_deg <= first_deg.max())
    if not inside.any():
        return None
    order = np.argsort(first_deg)
    q = np.array(first.q)
    q_at_first = np.interp(later_deg[inside], first_deg[order], q[order])  # where the first had the later's angles
    return float(np.median(q_at_first - q[inside]))
