"""Motor motions: paths of a motor with limited acceleration, as people and scripts drive it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
STEP_S = 0.0005  # of every simulation


@dataclass(frozen=True)
class Motion:
    t: Array  # s, from 0 in steps of STEP_S
    q: Array

    @property
    def duration(self) -> float:
        return float(self.t[-1])


def visit(
    targets: Sequence[float], speeds: Sequence[float] | float, dwell: float | Sequence[float], accel: float
) -> Motion:
    """Stops at each target; trapezoids of speed between them. It rests 0.5 s at the start and the end."""
    speed = np.broadcast_to(np.asarray(speeds, float), (len(targets) - 1,))
    rest = np.broadcast_to(np.asarray(dwell, float), (len(targets) - 1,))
    pieces = [np.full(int(0.5 / STEP_S), float(targets[0]))]
    for a, b, v, pause in zip(targets[:-1], targets[1:], speed, rest, strict=True):
        pieces += [_trapezoid(a, b, float(v), accel), np.full(round(float(pause) / STEP_S), float(b))]
    pieces.append(np.full(int(0.5 / STEP_S), float(targets[-1])))
    q = np.concatenate(pieces)
    return Motion(np.arange(len(q)) * STEP_S, q)


def _trapezoid(a: float, b: float, v: float, accel: float) -> Array:
    way = abs(b - a)
    if way == 0.0:
        return np.empty(0)
    v = min(v, np.sqrt(accel * way))
    ramp = v / accel
    whole = way / v + ramp
    t = np.arange(1, int(np.ceil(whole / STEP_S)) + 1) * STEP_S
    t = np.minimum(t, whole)
    s = np.where(
        t < ramp, accel * t**2 / 2, np.where(t < whole - ramp, v * (t - ramp / 2), way - accel * (whole - t) ** 2 / 2)
    )
    return np.asarray(a + np.sign(b - a) * s)


def ramp_strokes(
    rng: np.random.Generator, low: float, high: float, stroke: float, count: int, speeds: Sequence[float]
) -> Motion:
    """The paper's: small strokes back and forth over a ramp through the whole range, then back in one pass."""
    middle = np.linspace(low + stroke / 2, high - stroke / 2, count // 2)
    back = middle[::-1] + rng.uniform(-0.1, 0.1, len(middle)) * stroke
    targets = [low]
    for m in np.concatenate([middle, back]):
        targets += [m + stroke / 2, m - stroke / 2]
    targets += [low, high, low]
    clipped = np.clip(targets, low, high)
    return visit(
        clipped.tolist(), rng.choice(np.asarray(speeds), len(clipped) - 1), rng.uniform(0.0, 0.15), 20 * max(speeds)
    )


def sweeps(rng: np.random.Generator, low: float, high: float, speeds: Sequence[float]) -> Motion:
    """Full strokes, one speed after another."""
    targets, at = [low], []
    for v in speeds:
        targets += [high, low]
        at += [v, v]
    return visit(targets, at, float(rng.uniform(0.1, 0.6)), 20 * max(speeds))


def wander(
    rng: np.random.Generator,
    low: float,
    high: float,
    count: int,
    speeds: Sequence[float],
    shortest: float,
    longest: float,
) -> Motion:
    """Strokes of random length and speed that turn anywhere, with a full stroke at the start and the end."""
    targets = [(low + high) / 2, low, high]
    heading = -1.0
    for _ in range(count):
        way = float(rng.uniform(shortest, longest))
        room = targets[-1] - low if heading < 0 else high - targets[-1]
        targets.append(targets[-1] + heading * min(way, max(room, 0.0)))
        heading = -heading
        if room < shortest:
            targets.append(float(rng.uniform(low + 0.3 * (high - low), low + 0.7 * (high - low))))
            heading = float(rng.choice([-1.0, 1.0]))
    targets += [high, low]
    kept = [targets[0]] + [b for a, b in pairwise(targets) if abs(b - a) > 1e-3 * (high - low)]
    steps = len(kept) - 1
    return visit(kept, rng.choice(np.asarray(speeds), steps), rng.uniform(0.0, 0.3, steps), 20 * max(speeds))


def sines(
    rng: np.random.Generator, low: float, high: float, seconds: float, fast_hz: float, slow_hz: float, share: float
) -> Motion:
    """A slow sine through the range with a faster one of `share` of it on top; eased in and out of rest."""
    t = np.arange(int(seconds / STEP_S)) * STEP_S
    middle, half = (low + high) / 2, (high - low) / 2
    ease = np.clip(np.minimum(t, t[-1] - t) / 1.5, 0, 1)
    ease = ease**2 * (3 - 2 * ease)
    a, b = rng.uniform(0, 2 * np.pi, 2)
    wave = (1 - share) * np.sin(2 * np.pi * slow_hz * t + a) + share * np.sin(2 * np.pi * fast_hz * t + b)
    return Motion(t, middle + half * wave * ease)


def teleoperated(rng: np.random.Generator, low: float, high: float, seconds: float, speed: float) -> Motion:
    """A hand: smoothed jumps between places that it likes, with pauses and small corrections."""
    targets, speeds, pauses = [(low + high) / 2, low, high], [speed, speed], [0.2, 0.3]
    spent = 0.0
    while spent < seconds:
        if rng.random() < 0.45:
            step = float(np.clip(targets[-1] + rng.normal(0, 0.12) * (high - low), low, high))
        else:
            step = float(rng.uniform(low, high))
        v = speed * float(rng.uniform(0.4, 1.0))
        pause = float(rng.exponential(0.25)) if rng.random() < 0.6 else 0.0
        spent += abs(step - targets[-1]) / v + pause + 0.1
        targets.append(step)
        speeds.append(v)
        pauses.append(pause)
    rough = visit(targets, speeds, pauses, 15 * speed)
    width = int(0.12 / STEP_S)
    kernel = np.hanning(width + 2)[1:-1]
    padded = np.concatenate([np.full(width, rough.q[0]), rough.q, np.full(width, rough.q[-1])])
    smooth = np.convolve(padded, kernel / kernel.sum(), mode="same")[width:-width]
    return Motion(rough.t, smooth)


def fan(low: float, high: float, count: int, speed: float, dwell: float = 0.1) -> Motion:
    """First-order reversal curves: from the low end up to ever lower turning points."""
    targets = [low]
    for top in np.linspace(high, low + 0.15 * (high - low), count):
        targets += [float(top), low]
    return visit(targets, speed, dwell, 20 * speed)


def quick(rng: np.random.Generator, low: float, high: float, turns: int, speed: float) -> Motion:
    """A few strokes at speed that tile the range: what is done when there are only some seconds."""
    edges = np.linspace(low, high, turns // 2 + 2)
    targets = [low, high]
    for a, b in zip(edges[:-2][::-1], edges[2:][::-1], strict=True):
        targets += [float(a), float(b)]
    targets += [low]
    return visit(targets, speed * rng.uniform(0.9, 1.0), 0.08, 25 * speed)


def one_way_middle(rng: np.random.Generator, low: float, high: float, speed: float) -> Motion:
    """Turns near both ends only; the middle is crossed upwards once and downwards never from a turn."""
    span = high - low
    targets = [low]
    for _ in range(4):
        targets += [low + span * float(rng.uniform(0.22, 0.3)), low + span * float(rng.uniform(0.0, 0.05))]
    targets.append(high)
    for _ in range(4):
        targets += [high - span * float(rng.uniform(0.22, 0.3)), high - span * float(rng.uniform(0.0, 0.05))]
    return visit(targets, speed, 0.1, 20 * speed)


def stepped(rng: np.random.Generator, low: float, high: float, count: int, pause: float) -> Motion:
    """A motor that is told to jump: each move takes a few milliseconds."""
    places = rng.uniform(low, high, count)
    return visit([low, *places.tolist(), low, high, low], 250 * (high - low), pause, 1e5 * (high - low))


def joined(motions: Sequence[Motion]) -> Motion:
    q = np.concatenate([m.q for m in motions])
    return Motion(np.arange(len(q)) * STEP_S, q)
