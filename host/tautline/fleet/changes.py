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
    """The level of B in each of a robot's n usable sessions: the logarithm of B's mean over the range of q that all of
    these sessions measured."""

    indices: list[int]  # (n,) places of these among all sessions of the robot; they stand for its use
    level: Array  # (n,) natural logarithm of the mean B
    sigma: Array  # (n,) standard deviation of `level`

    def line(self, scatter: float) -> tuple[Array, Array, Array]:
        """Fits a straight line of `level` over the sessions' `indices` by weighted least squares. scatter: a
        standard deviation of log B that is added to every sigma in quadrature. Returns the line's two parameters (2,),
        which are the level at the weighted mean index and the growth a session; their covariance (2, 2); and the
        residuals (n,), each divided by its sigma."""
        use = np.array(self.indices, dtype=float)
        weight = 1.0 / (self.sigma**2 + scatter**2)
        columns = np.column_stack([np.ones(len(use)), use - np.average(use, weights=weight)])
        covariance = np.linalg.inv(columns.T @ (weight[:, None] * columns))
        values = covariance @ (columns.T @ (weight * self.level))
        return values, covariance, (self.level - columns @ values) * np.sqrt(weight)


def with_changes(rows: Sequence[Row]) -> list[Row]:
    """Returns the rows, in the order given, with the columns filled that compare a robot's sessions with each other:
    `since`, `width_change`, `offset_change`, `wear`, and the sigmas of `width_change` and `wear`. In `rows` each
    robot's sessions must stand together and in the order of time."""
    robots = [list(each) for _, each in groupby(rows, key=lambda row: row.robot)]
    levels = [_levels(robot) for robot in robots]
    scatter = common_scatter(each for each in levels if each is not None)
    changed_rows = []
    for robot, robot_levels in zip(robots, levels, strict=True):
        changed_rows += (
            _without_changes(robot) if robot_levels is None else _with_robot_changes(robot, robot_levels, scatter)
        )
    return changed_rows


def common_scatter(levels: Iterable[_Levels]) -> float:
    """The standard deviation of log B, common to all robots, by which sessions scatter about their robot's straight
    line beyond the sigmas that they state: with it chi square equals its degrees of freedom. Only robots with more than
    two sessions tell; 0 where there is none, or where the stated sigmas explain all of the scatter."""
    long = [each for each in levels if len(each.indices) > 2]
    freedom = sum(len(each.indices) - 2 for each in long)  # a line has two parameters

    def surplus(scatter: float) -> float:
        """The sum of squared normalised residuals (chi square) about all robots' lines, with this scatter of log B,
        minus the degrees of freedom; it falls as the scatter grows."""
        return sum(float(np.sum(each.line(scatter)[2] ** 2)) for each in long) - freedom

    if not long or surplus(0.0) <= 0.0:
        return 0.0
    return float(brentq(surplus, 0.0, 10.0))


def _levels(robot: Sequence[Row]) -> _Levels | None:
    """The logarithm of the mean B in each of a robot's usable sessions, taken over the range of q that all of them
    measured, so that they can be compared. Sessions on another grid of q than the first usable one are left out. None
    where no session is usable, no grid point was measured by all, or a mean B is 0."""
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
    # Errors of one session are correlated over q: averaging does not reduce them. d(log B) = dB / B.
    return _Levels([k for k, _ in usable], np.log(mean), sigma[:, inside].mean(axis=1) / mean)


def _first_usable(robot: Sequence[Row]) -> Row:
    """The robot's first usable session; there must be one."""
    return next(row for row in robot if row.usable)


def _without_changes(robot: Sequence[Row]) -> list[Row]:
    """The robot's rows with all columns that compare sessions set to None, as an earlier run may have filled them."""
    return [
        replace(
            row, since=None, width_change=None, width_change_sigma=None, offset_change=None, wear=None, wear_sigma=None
        )
        for row in robot
    ]


def _with_robot_changes(robot: Sequence[Row], robot_levels: _Levels, scatter: float) -> list[Row]:
    """The robot's rows with the columns that compare sessions. Every row gets `wear`, the slope of log B a session
    (None with a single usable session). Each usable row after the first also gets the change since the first usable
    one: `width_change`, a share of B, and `offset_change`, unit of q. robot_levels: its levels of B; scatter: as in
    `_Levels.line`."""
    first = robot[robot_levels.indices[0]]
    wear = wear_sigma = None
    if len(robot_levels.indices) > 1:
        values, covariance, _ = robot_levels.line(scatter)
        wear, wear_sigma = float(values[1]), float(np.sqrt(covariance[1, 1]))
    changed_rows = [replace(row, wear=wear, wear_sigma=wear_sigma) for row in _without_changes(robot)]
    for k, level, sigma in zip(robot_levels.indices[1:], robot_levels.level[1:], robot_levels.sigma[1:], strict=True):
        ratio = float(np.exp(level - robot_levels.level[0]))  # of mean B to the first one's
        log_sigma = float(np.hypot(sigma, robot_levels.sigma[0]))
        changed_rows[k] = replace(
            changed_rows[k],
            since=first.session,
            width_change=ratio - 1.0,
            width_change_sigma=ratio * log_sigma,
            offset_change=_offset_change(first, robot[k]),
        )
    return changed_rows


def _offset_change(first: Row, later: Row) -> float | None:
    """By how much f_remain, the angle c_deg over q, has shifted along q from the session `first` to `later`, unit of q.
    For each angle of `later` at q it is the first session's q with the same angle, minus q; the median of these is
    returned. None where the two sessions have no angle in common."""
    first_deg, later_deg = np.array(first.c_deg), np.array(later.c_deg)
    inside = (later_deg >= first_deg.min()) & (later_deg <= first_deg.max())
    if not inside.any():
        return None
    order = np.argsort(first_deg)
    q = np.array(first.q)
    q_at_first = np.interp(later_deg[inside], first_deg[order], q[order])  # of the later's angles, by interpolation
    return float(np.median(q_at_first - q[inside]))
