"""What lies between motor and tip: rate-independent hystereses, the static law, and their truth.

A hysteresis maps the motor's path q to the centre coordinate p; the tip is c = law(p). Its truth is always read off
a slow full stroke (`envelopes`), never off its parameters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Curve = Callable[[Array], Array]


class Hysteresis(Protocol):
    """`scale` multiplies the width at every sample; None is 1 throughout."""

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array: ...


def crossing(width: Curve, q: Array, side: float, scale: Array | None = None) -> Array:
    """The p that solves p + side * width(p) / 2 = q: the rising (+1) or falling (-1) envelope at motor position q."""
    grid = np.linspace(float(q.min()) - 4.0 * _widest(width, q), float(q.max()) + 4.0 * _widest(width, q), 40001)
    if scale is None:
        return np.interp(q, grid + side * width(grid) / 2, grid)
    p = q - side * scale * width(q) / 2
    for _ in range(30):  # a contraction while |scale * B'| < 2
        p = q - side * scale * width(p) / 2
    return p


def _widest(width: Curve, q: Array) -> float:
    return float(np.max(width(np.linspace(float(q.min()), float(q.max()), 2001))))


def _clamped(low: Array, high: Array, start: float) -> Array:
    """p[k] = min(max(p[k-1], low[k]), high[k])."""
    out = np.empty(len(low))
    p = min(max(start, float(low[0])), float(high[0]))
    for k, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
        if p < a:
            p = a
        elif p > b:
            p = b
        out[k] = p
    return out


def _between(low: Array, high: Array, start: float) -> float:
    """start: -1 on the lower, +1 on the upper limit."""
    return float(low[0] + (high[0] - low[0]) * (start + 1) / 2)


@dataclass(frozen=True)
class Play:
    """One play whose width is a function of the centre coordinate."""

    width: Curve

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        low, high = crossing(self.width, q, 1.0, scale), crossing(self.width, q, -1.0, scale)
        return _clamped(low, high, _between(low, high, start))


@dataclass(frozen=True)
class Asymmetric:
    """A play whose tip starts `late` of a width late after a turn to rising and catches up over as much again."""

    width: Curve
    late: float

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        low, high = crossing(self.width, q, 1.0, scale), crossing(self.width, q, -1.0, scale)
        d = self.late * float(np.mean(self.width(q[:: max(1, len(q) // 2000)])))
        p = base = _between(low, high, start)
        out = np.empty(len(q))
        for k, (a, b) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
            if p > b:
                p = base = b
            else:
                past = a - base - d
                if past > 0.0:
                    p = max(p, min(base + 2 * past, a))
            out[k] = p
        return out


@dataclass(frozen=True)
class Plays:
    """Prandtl-Ishlinskii: play elements of radius r_i (in q) and weight w_i; the weights sum to 1."""

    radius: Array
    weight: Array

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        total = np.zeros(len(q))
        for r, w in zip(self.radius, self.weight, strict=True):
            reach = r if scale is None else r * scale
            total += w * _clamped(q - reach, q + reach, float(q[0] + start * r))
        return total


@dataclass(frozen=True)
class WarpedPlays:
    """The same on a warped coordinate x = warp(q), a rising curve whose slope is 1 / B: radii in shares of B."""

    plays: Plays
    grid: Array
    warped: Array

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        y = self.plays.respond(np.interp(q, self.grid, self.warped), scale, start)
        reach = float(np.sum(self.plays.radius * self.plays.weight))
        up, down = (np.interp(y + side * reach, self.warped, self.grid) for side in (1.0, -1.0))
        return (up + down) / 2


@dataclass(frozen=True)
class OwnStatePlays:
    """Plays whose widths are B at each element's own state."""

    width: Curve
    share: Array
    weight: Array

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        total = np.zeros(len(q))
        for share, weight in zip(self.share, self.weight, strict=True):
            own = Play(lambda p, share=share: share * self.width(p))
            total += weight * own.respond(q, scale, start)
        return total


@dataclass(frozen=True)
class BoucWen:
    """p = q - B(q) z / 2 with dz/dq = (1 - |z|^n (beta sgn(z dq) + gamma)) / length, beta + gamma = 1, |z| <= 1."""

    width: Curve
    length: float  # in units of q
    n: float
    beta: float

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        half = self.width(q) / 2 if scale is None else scale * self.width(q) / 2
        step = np.diff(q, prepend=q[0]) / self.length
        z, n, beta, gamma = -start, self.n, self.beta, 1.0 - self.beta
        out = np.empty(len(q))
        for k, dx in enumerate(step.tolist()):
            if dx:
                # Midpoint rule; a step is a small part of the length.
                middle = z + 0.5 * dx * (1.0 - abs(z) ** n * (beta * (1.0 if z * dx > 0 else -1.0) + gamma))
                z += dx * (1.0 - abs(middle) ** n * (beta * (1.0 if middle * dx > 0 else -1.0) + gamma))
                z = min(max(z, -1.0), 1.0)
            out[k] = z
        return q - half * out


@dataclass(frozen=True)
class Dahl:
    """p = q - B(q) z / 2 with dz/dq = (1 - z sgn(dq))^i / length."""

    width: Curve
    length: float
    exponent: float = 1.0

    def respond(self, q: Array, scale: Array | None = None, start: float = 0.0) -> Array:
        half = self.width(q) / 2 if scale is None else scale * self.width(q) / 2
        z, out = -start, np.empty(len(q))
        for k, dx in enumerate((np.diff(q, prepend=q[0]) / self.length).tolist()):
            if dx:
                sign = 1.0 if dx > 0 else -1.0
                middle = z + 0.5 * dx * max(1.0 - z * sign, 0.0) ** self.exponent
                z += dx * max(1.0 - middle * sign, 0.0) ** self.exponent
                z = min(max(z, -1.0), 1.0)
            out[k] = z
        return q - half * out


@dataclass(frozen=True)
class Envelope:
    """At each centre the envelopes are `width` apart."""

    centre: Array
    width: Array
    state: Array  # the operator's output at which that holds: c = law(state)


def envelopes(hysteresis: Hysteresis, low: float, high: float, margin: float, n: int = 4001) -> Envelope:
    """A slow stroke from low - margin to high + margin and back."""
    up = np.linspace(low - margin, high + margin, 12 * n)
    path = np.concatenate([up[::-1], up, up[::-1]])
    state = hysteresis.respond(path)
    rising, falling = state[len(up) : 2 * len(up)], state[2 * len(up) :][::-1]
    level = np.linspace(max(rising[0], falling[0]) + 1e-9, min(rising[-1], falling[-1]) - 1e-9, 3 * n)
    right, left = _first(rising, level, up), _last(falling, level, up)
    centre, width = (right + left) / 2, right - left
    keep = (centre >= low) & (centre <= high)
    return Envelope(centre[keep], width[keep], level[keep])


def _first(state: Array, level: Array, q: Array) -> Array:
    """Where a rising stroke reaches a level; flat parts (the stroke's start inside the play) count from their end."""
    rising = np.concatenate([np.diff(state) > 1e-12, [True]])
    return np.interp(level, state[rising], q[rising])


def _last(state: Array, level: Array, q: Array) -> Array:
    rising = np.concatenate([[True], np.diff(state) > 1e-12])
    return np.interp(level, state[rising], q[rising])
