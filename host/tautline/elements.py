"""Play as a list of elements on one backlash table: a single play, or several whose onsets together are gradual.

The equations are in host/native/elements.h: a warp x = G(q) makes every width one, and each element is a play of a
share of that width. Full strokes lie on p +- B(p)/2 = q whatever the elements are. A single element
needs no warp: it is the play on the table itself.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline, PchipInterpolator

from tautline import _native
from tautline.friction import Friction

Array = npt.NDArray[np.float64]

MOST: int = _native.ELEMENTS_MAX
_NARROW_COUNTS, _NARROW_SHARE = 4.0, 0.01  # tolerance: of an encoder's step, of the largest width: below, one will do
_PERIODS = 4000  # limit: of the warp, at most, over the table
_MESH = 32  # tolerance: nodes of a period on which the warp's smoothness is measured
_FINE = 64  # tolerance: and at least so many that it is sampled at
_AT_LEAST = 0.05  # tolerance: of the mean rise: the warp's least, between two nodes of the mesh
_PAST = 8  # tolerance: widths beyond the table's ends in which it is still exact
_BEYOND = 1e3  # tolerance: and to which it goes on
_RIDGE = 1e-15  # tolerance: of the normal matrix' trace
_SAME = 1e-12  # tolerance: of a period: knots that are nearer to each other are one
_STEEPEST = 1.95  # limit: |B'| of a table that was smoothed: T rises while it is below 2
_FINER = 8  # tolerance: nodes of the smoothed table for each of the table's


@dataclass(frozen=True)
class Elements:
    """`width[i]` is 2 r_i, the i-th element's share of B, and `weight[i]` its share of the motion."""

    width: tuple[float, ...]
    weight: tuple[float, ...]

    forgotten: ClassVar[float] = 1e-9  # tolerance: of the range, where it started shows by rounding only

    def __post_init__(self) -> None:
        """Raises ValueError unless there are 1 to MOST widths that rise from 0 or more, as many positive weights that
        sum to 1, and the weighted mean of the widths is 1."""
        width, weight = np.array(self.width, dtype=float), np.array(self.weight, dtype=float)
        if not 1 <= len(width) == len(weight) <= MOST:
            raise ValueError(f"elements: 1 to {MOST} widths and as many weights")
        if not (np.isfinite(width).all() and width[0] >= 0.0 and (np.diff(width) > 0.0).all()):
            raise ValueError("elements: widths must rise from 0 or more")
        if not (weight > 0.0).all() or abs(weight.sum() - 1.0) > 1e-9:
            raise ValueError("elements: weights must be positive and sum up to 1")
        if abs(weight @ width - 1.0) > 1e-9:
            raise ValueError("elements: the weighted mean of the widths must be 1: else they say another B")

    @property
    def single(self) -> bool:
        """Whether the elements are one play alone, whose width is B."""
        return len(self.width) == 1

    def to_json(self) -> dict[str, list[float]]:
        """Widths and weights as plain values, for model.json."""
        return {"width": list(self.width), "weight": list(self.weight)}

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Reads what `to_json` gave. KeyError, TypeError or ValueError where it is something else."""
        return cls(*(tuple(float(value) for value in document[name]) for name in ("width", "weight")))


SINGLE = Elements((1.0,), (1.0,))
Hysteresis = Elements | Friction  # what follows the motor between the envelopes


@dataclass(frozen=True)
class Play:
    """What the elements do on the backlash table `width` (n,) at `grid` (n,), linear between its nodes and held beyond
    its ends; `count` is the encoder's step, in the same unit."""

    grid: Array
    width: Array
    elements: Hysteresis = SINGLE
    count: float = 0.0

    def forward(self, q: npt.ArrayLike, p0: float = np.nan) -> Array:
        """The centre coordinate (n,), unit of q, after each of the motor positions q (n,), taken in their order. p0:
        the centre coordinate before them; NaN: q[0]."""
        return self.native.forward(np.asarray(q, dtype=float), p0)[0]  # type: ignore[no-any-return]

    def inverse(self, p: npt.ArrayLike, q0: float | None = None) -> Array:
        """Motor positions (n,), unit of q, that lead the centre coordinate along p (n,). The tip starts at p[0] and the
        motor at q0, by default p[0], the centre of the backlash. While p rests the motor rests."""
        p = np.asarray(p, dtype=float)
        start = float(p[0]) if q0 is None else q0
        return self.native.inverse(p, start, float(p[0]))  # type: ignore[no-any-return]

    @cached_property
    def native(self) -> Any:
        """The C object that runs the play, made once: friction's own; else a single play on the table; else several
        elements with their warp, where B is wider than `narrow`, and a single play where it is not."""
        if isinstance(self.elements, Friction):
            return self.elements.native(self.grid, self.width)
        if self.elements.single:
            return _native.Plays(self.grid, self.width)
        narrow = self.narrow
        warp = warp_of(self.grid, self.width, narrow)
        radii, weights = 0.5 * np.array(self.elements.width), np.array(self.elements.weight)
        single_below = narrow if (self.width < narrow).any() else 0.0
        return _native.Plays(self.grid, self.width, warp.q, warp.x, radii, weights, single_below)

    @property
    def narrow(self) -> float:
        """The width of B, unit of q, below which a single play replaces the elements: what they do within so little is
        not seen, while the warp, which rises by 1 over each width, would need ever more knots. It is the largest of
        _NARROW_COUNTS encoder counts, a share _NARROW_SHARE of the widest B, and the table's range over _PERIODS, so
        that the warp has at most _PERIODS periods."""
        widest = float(self.width.max())
        span = float(self.grid[-1] - self.grid[0])
        return max(_NARROW_COUNTS * self.count, _NARROW_SHARE * widest, span / _PERIODS)


@dataclass(frozen=True)
class Warp:
    """x = G(q), straight between its knots: exactly G(p + B(p)/2) - G(p - B(p)/2) = 1."""

    q: Array
    x: Array


def warp_of(grid: Array, width: Array, narrow: float) -> Warp:
    """The warp x = G(q) of a backlash table, B width (n,) at grid (n,), unit of q; widths below `narrow` (> 0) count as
    `narrow`. With T the map from p - B/2 to p + B/2, G(T(u)) = G(u) + 1: one period, about the table's middle,
    determines all others. Within it G has the least integral of G'''^2 over the table. Its knots are those of the
    period, the table's corners among them, and their images under T. G(middle) = 0."""
    middle = 0.5 * (grid[0] + grid[-1])
    grid, width = _with_least_width(grid, width, narrow)
    table = _Periods(grid, width)
    first = float(table.lower_end(middle))
    last = float(table.next_period(first))
    base = _warp_in_one_period(grid, width, first, last)
    knots = _knots_in_one_period(table, first, last)
    phases = np.asarray(base(knots))
    q, x = _in_all_periods(table, knots, phases)
    apart = np.concatenate([[True], (np.diff(q) > 0.0) & (np.diff(x) > 0.0)])  # rounding may bring two together
    q, x = q[apart], x[apart]
    # Far beyond the table, where B is held, it goes on by 1 a width.
    q = np.concatenate([[q[0] - _BEYOND * width[0]], q, [q[-1] + _BEYOND * width[-1]]])
    x = np.concatenate([[x[0] - _BEYOND], x, [x[-1] + _BEYOND]])
    return Warp(q, x - np.interp(middle, q, x))


def _knots_in_one_period(table: _Periods, first: float, last: float) -> Array:
    """The knots (k,) of a warp in one period [first, last), unit of q, rising: _FINE even ones, and the table's
    corners, each moved into the period by T. Knots nearer to each other than a share _SAME of the period are one."""
    corners = table.into_period(table.left, first, last)
    knots = np.unique(np.concatenate([np.linspace(first, last, _FINE + 1)[:-1], corners[corners < last]]))
    knots = knots[np.concatenate([[True], np.diff(knots) > _SAME * (last - first)])]
    return np.asarray(knots[:-1] if last - knots[-1] < _SAME * (last - first) else knots)


def _with_least_width(grid: Array, width: Array, narrow: float) -> tuple[Array, Array]:
    """The table of grid and width (n,), unit of q, with widths of at least `narrow` and a further node wherever the
    width crosses it; a table of one node becomes one of two."""
    if len(grid) == 1:
        grid, width = np.array([grid[0], grid[0] + max(width[0], narrow)]), np.repeat(width, 2)
    above = width > narrow
    at = np.flatnonzero(above[1:] != above[:-1])
    share = (narrow - width[at]) / (width[at + 1] - width[at])
    crossings = grid[at] + share * (grid[at + 1] - grid[at])
    nodes = np.union1d(grid, crossings)
    return nodes, np.maximum(np.interp(nodes, grid, width), narrow)


def _in_all_periods(table: _Periods, knots: Array, phases: Array) -> tuple[Array, Array]:
    """A warp's knots q, unit of q, and their values x, over a table's whole range and _PAST widths beyond, made of
    those of one period, knots and phases (n,): the knots are mapped by T again and again, where the warp is 1 more each
    time, and by its inverse, where it is 1 less."""
    columns = [(knots, phases)]
    q, period = knots, 0
    while q[0] <= table.grid[-1] + _PAST * table.width[-1]:
        q, period = table.next_period(q), period + 1
        columns.append((q, phases + period))
    q, period = knots, 0
    while q[-1] >= table.grid[0] - _PAST * table.width[0]:
        q, period = table.previous_period(q), period - 1
        columns.insert(0, (q, phases + period))
    return np.concatenate([q for q, _ in columns]), np.concatenate([x for _, x in columns])


class _Periods:
    """The map T from p - B/2 to p + B/2, and its inverse: a warp is 1 more after each T. grid (n,) p, rising, and width
    (n,) B there, both in the unit of q; left and right are the motor's places at which an element at p is pushed."""

    def __init__(self, grid: Array, width: Array) -> None:
        """Keeps the table, grid and width (n,) as the class says, and the two ends p -+ B/2 at its nodes."""
        self.left, self.right = grid - 0.5 * width, grid + 0.5 * width
        self.grid, self.width = grid, width

    def lower_end(self, p: npt.ArrayLike) -> Array:
        """p - B(p)/2 at centre coordinates p, unit of q, of any shape."""
        p = np.asarray(p, dtype=float)
        return np.asarray(p - 0.5 * np.interp(p, self.grid, self.width))

    def next_period(self, u: npt.ArrayLike) -> Array:
        """Maps u = p - B(p)/2 to p + B(p)/2, unit of q, of any shape: the map T, one period further."""
        return _interpolated(u, self.left, self.right)

    def previous_period(self, u: npt.ArrayLike) -> Array:
        """Maps u = p + B(p)/2 to p - B(p)/2, unit of q: the inverse of T, one period back."""
        return _interpolated(u, self.right, self.left)

    def into_period(self, u: Array, first: float, last: float) -> Array:
        """(n,) Each of u (n,), unit of q, moved by whole periods, with T or its inverse, into the period [first, last),
        where last = T(first)."""
        u = u.copy()
        while (above := u >= last).any():
            u[above] = self.previous_period(u[above])
        while (below := u < first).any():
            u[below] = self.next_period(u[below])
        return u


def _interpolated(x: npt.ArrayLike, from_: Array, to: Array) -> Array:
    """Linear interpolation at x, of any shape, of the values `to` (n,) at the rising nodes `from_` (n,); beyond the
    ends x is shifted by as much as the end node is."""
    x = np.asarray(x, dtype=float)
    beyond = np.minimum(x - from_[0], 0.0) + np.maximum(x - from_[-1], 0.0)
    return np.asarray(np.interp(x, from_, to) + beyond)


def _warp_in_one_period(grid: Array, width: Array, first: float, last: float) -> PchipInterpolator:
    """The warp G, G(p + B/2) - G(p - B/2) = 1, less G(first), over one period [first, last), unit of q, in which it
    rises from 0 to 1. Of all such curves it is the one whose continuation over the whole table has the least integral
    of G'''^2."""
    # A mesh of _MESH nodes in the period, and their images in all periods that the table has, each one of `columns`.
    smooth = _Periods(*_without_corners(grid, width))
    nodes = first + (float(smooth.next_period(first)) - first) * np.arange(_MESH) / _MESH
    columns = [nodes]
    while columns[-1][-1] < grid[-1] + 0.5 * width[-1]:
        columns.append(smooth.next_period(columns[-1]))
    ahead = len(columns)  # periods from the first one on; those inserted below come before
    while columns[0][0] > grid[0] - 0.5 * width[0]:
        columns.insert(0, smooth.previous_period(columns[0]))
    period = np.repeat(np.arange(ahead - len(columns), ahead, dtype=float), _MESH)
    values = np.linspace(0.0, 1.0, _MESH, endpoint=False)  # a table within one period: a straight line
    q = np.concatenate(columns)
    inside = (q >= grid[0] - 0.5 * width[0]) & (q <= grid[-1] + 0.5 * width[-1])  # beyond, B is held: a corner
    if len(columns) > 1:
        values = _least_third_derivative(q, period, inside)
    # The period before and after are added for the slopes at its ends. The table without corners has a slightly other
    # period than the table itself, to which the nodes are stretched.
    around = np.concatenate([smooth.previous_period(nodes), nodes, smooth.next_period(nodes)])
    scale = (last - first) / (float(smooth.next_period(first)) - first)
    return PchipInterpolator(first + scale * (around - first), np.concatenate([values - 1, values, values + 1]))


def _without_corners(grid: Array, width: Array) -> tuple[Array, Array]:
    """The table of grid and width (n,), unit of q, on a grid _FINER times as fine, as a cubic spline through it.
    Unchanged for fewer than four nodes, and where the spline is no backlash table: below half the least width, or |B'|
    not below _STEEPEST."""
    if len(grid) < 4:
        return grid, width
    fine = np.linspace(grid[0], grid[-1], _FINER * len(grid))
    curve = CubicSpline(grid, width)(fine)
    lawful = curve.min() > 0.5 * width.min() and (np.abs(np.diff(curve)) < _STEEPEST * np.diff(fine)).all()
    return (fine, curve) if lawful else (grid, width)


def _least_third_derivative(q: Array, period: Array, inside: npt.NDArray[np.bool_]) -> Array:
    """(_MESH,) A warp's values v at the nodes of one period, with v[0] = 0, for which the curve v[k mod _MESH] +
    period[k] at q[k] has the least integral of its squared third derivative where `inside`. q, period, inside: (n,).
    Even steps are mixed in, by as little as keeps each step above _AT_LEAST of the mean one."""
    design, right = _third_derivative_rows(q, period, inside)
    even = np.arange(1, _MESH) / _MESH
    # Least squares for the deviations of v from even steps: normal matrix and right side in one product.
    system = np.column_stack([design[:, 1:], right - design[:, 1:] @ even])
    squares = np.einsum("ij,ik->jk", system, system)
    normal, slope = squares[:-1, :-1], squares[:-1, -1]
    ridge = _RIDGE * max(np.trace(normal), 1e-300)  # without it the matrix may be singular, or 0
    normal = normal + ridge * np.eye(_MESH - 1)
    smoothest = even + np.linalg.solve(normal, slope)
    rises = np.diff(np.concatenate([[0.0], smoothest, [1.0]]))
    mean, least = 1.0 / _MESH, float(rises.min())
    # The largest share of the smoothest with which every step is _AT_LEAST of the mean one.
    share = 1.0 if least >= _AT_LEAST * mean else (1.0 - _AT_LEAST) * mean / (mean - least)
    return np.concatenate([[0.0], share * smoothest + (1.0 - share) * even])


def _third_derivative_rows(q: Array, period: Array, inside: npt.NDArray[np.bool_]) -> tuple[Array, Array]:
    """The rows whose squares (design v - right)^2 sum to the integral of the squared third derivative that
    `_least_third_derivative` makes small: design (n - 3, _MESH), right (n - 3,). Arguments as there."""
    weights = np.zeros((len(q) - 3, 4))
    for i in range(4):
        others = [q[i : len(q) - 3 + i] - q[j : len(q) - 3 + j] for j in range(4) if j != i]
        weights[:, i] = 6.0 / np.prod(others, axis=0)  # equation: 6 f[q0, q1, q2, q3] is the third derivative
    # equation: the integral of f'''^2 as a sum, each term weighed by the mean of its three steps
    weights *= (np.sqrt((q[3:] - q[:-3]) / 3.0) * (inside[3:] & inside[:-3]))[:, None]
    design = np.zeros((len(q) - 3, _MESH))
    rows = np.arange(len(q) - 3)
    right = np.zeros(len(q) - 3)
    for i in range(4):
        design[rows, (rows + i) % _MESH] += weights[:, i]
        right -= weights[:, i] * period[i : len(q) - 3 + i]
    return design, right
