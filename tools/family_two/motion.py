"""Paths of the motor on a grid of STEP: one calibration, and six kinds of use that share none of its moves."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

FloatArray = NDArray[np.float64]
Maker = Callable[[np.random.Generator, float, float, float], FloatArray]

STEP = 0.002  # s
EDGE = 0.97  # of the reach: no motion goes beyond
LINEAR_SHARE = 0.12  # of a constant-speed leg in which it starts, and stops
Leg = tuple[float, float, float]  # to where, in how long, rest after it


def _shape(samples: int, jerk: bool) -> FloatArray:
    """From 0 to 1: minimum jerk, or constant speed with short starts and stops."""
    tau = np.arange(1, samples + 1) / samples
    if jerk:
        return tau**3 * (10 - 15 * tau + 6 * tau**2)
    e = LINEAR_SHARE
    peak = 1 / (1 - e)
    rise = peak * tau**2 / (2 * e)
    fall = 1 - peak * (1 - tau) ** 2 / (2 * e)
    return np.where(tau < e, rise, np.where(tau > 1 - e, fall, peak * (tau - e / 2)))


def travel(start: float, legs: list[Leg], jerk: bool, seconds: float | None = None) -> FloatArray:
    """Legs one after the other; with `seconds` all times are stretched to end then."""
    factor = 1.0 if seconds is None else seconds / sum(took + rest for _, took, rest in legs)
    pieces, here = [np.array([start])], start
    for to, took, rest in legs:
        samples = max(int(took * factor / STEP), 10)
        pieces.append(here + (to - here) * _shape(samples, jerk))
        pieces.append(np.full(int(rest * factor / STEP), to))
        here = to
    return np.concatenate(pieces)


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Full strokes, then a stair up and one down with reversals of several amplitudes and speeds, resting at turns."""
    top = EDGE * reach
    speed = 0.55 * reach
    least = min(1.3 * width, 0.5 * reach)
    places: list[tuple[float, float]] = []  # to where, relative speed
    places += [(-top, 1.0), (top, 0.8), (-top, 1.8)]
    steps = 4 if seconds < 55 else 6
    for way in (1.0, -1.0):
        for place in np.linspace(-0.62, 0.9, steps):
            place = place * top + float(rng.uniform(-0.05, 0.05)) * reach
            back = least + float(rng.uniform(0.0, 0.5)) * reach
            places.append((way * place, float(rng.choice([0.6, 1.0, 1.5]))))
            places.append((way * max(place - back, -top), float(rng.choice([0.6, 1.0, 1.5]))))
        places.append((way * top, 1.0))
    here, legs = 0.0, []
    for to, fast in places:
        legs.append((to, abs(to - here) / speed / fast + 0.05, float(rng.uniform(0.15, 0.6))))
        here = to
    return travel(0.0, legs, False, seconds)


def way_points(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Minimum-jerk moves between places, as a teleoperator makes them, with pauses."""
    here, legs, total = 0.0, [], 0.0
    for to in (0.6, -0.6):
        legs.append((to * reach, 2.0, 0.3))
        here, total = to * reach, total + 2.3
    while total < seconds:
        to = float(rng.uniform(-0.95, 0.95)) * reach
        took = 0.4 + abs(to - here) / reach * float(rng.uniform(0.9, 2.2))
        legs.append((to, took, float(rng.choice([0.0, 0.3, 1.2]))))
        here, total = to, total + took + legs[-1][2]
    return travel(0.0, legs, True, seconds)


def spiral(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Oscillation whose amplitude grows and shrinks about a mean that moves on."""
    t = np.arange(0.0, seconds, STEP)
    period = float(rng.uniform(2.5, 5.0))
    swell = 0.5 - 0.5 * np.cos(2 * np.pi * t / seconds * float(rng.choice([1.0, 2.0])))
    amplitude = 0.15 + 0.75 * swell
    mean = (0.95 - amplitude) * np.sin(2 * np.pi * t / seconds * float(rng.uniform(0.6, 1.4)) + rng.uniform(0, 6))
    path = reach * (mean + amplitude * np.sin(2 * np.pi * t / period))
    first = np.minimum(t / 1.5, 1.0)
    return np.asarray(path * first * first * (3 - 2 * first))


def triangles(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Constant speed between random turns, some with a dwell."""
    legs, here, total, side = [], 0.0, 0.0, float(rng.choice([-1.0, 1.0]))
    while total < seconds:
        to = side * float(rng.uniform(0.05, 0.95)) * reach if total > 5 else side * 0.7 * reach
        if abs(to - here) < 0.2 * reach:
            to = side * 0.9 * reach
        took = abs(to - here) / reach * float(rng.uniform(0.8, 2.4))
        rest = float(rng.choice([0.0, 0.0, 0.4, 2.0]))
        legs.append((to, took, rest))
        here, total, side = to, total + took + rest, -side if rng.random() < 0.8 else side
    return travel(0.0, legs, False, seconds)


def dithered_scan(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A slow scan there and back with a faster, smaller oscillation on top."""
    amplitude = min(max(0.9 * width, 0.08 * reach), 0.35 * reach)
    strokes = int(rng.choice([2, 3]))
    top = EDGE * reach - amplitude
    turns = [top * (1 if i % 2 == 0 else -1) for i in range(strokes)]
    scan = travel(0.0, [(to, 1.0 if i == 0 else 2.0, 0.05) for i, to in enumerate(turns)], False, seconds)
    t = np.arange(scan.size) * STEP
    return np.asarray(scan + amplitude * np.sin(2 * np.pi * t / float(rng.uniform(1.2, 2.5))))


def hand(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """An operator's hand: low-passed noise, held still at times."""
    count = int(seconds / STEP)
    low = butter(2, float(rng.uniform(0.15, 0.3)), fs=1 / STEP, output="sos")
    raw = sosfiltfilt(low, rng.normal(size=count + 10000))[5000 : 5000 + count]
    raw = raw / np.percentile(np.abs(raw), 95)
    path = 0.95 * np.tanh(0.8 * raw) / np.tanh(0.8) * 0.9
    pace = np.ones(count)
    for begin in rng.integers(count // 5, count, 3):
        pace[begin : begin + int(rng.uniform(0.8, 2.0) / STEP)] = 0.0
    pace = np.maximum(np.convolve(pace, np.ones(150) / 150, mode="same"), 0.0)
    clock = np.cumsum(pace)
    held = np.interp(clock * (count - 1) / clock[-1], np.arange(count), path)
    ease = np.minimum(np.arange(count) * STEP / 1.5, 1.0)
    return np.asarray(np.clip(held * ease * ease * (3 - 2 * ease), -0.96, 0.96) * reach)


def pecking(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Nearing a target in moves that each go back for a part, then on to the next target."""
    legs: list[Leg] = [(0.5 * reach, 1.2, 0.1), (-0.5 * reach, 1.8, 0.1)]
    here, total = -0.5 * reach, 3.2
    while total < seconds:
        target = float(rng.uniform(-0.9, 0.9)) * reach
        if abs(target - here) < 0.4 * reach:
            target = -np.sign(here) * 0.8 * reach
        for part, back in ((0.5, 0.3), (0.8, 0.25), (1.0, 0.0)):
            for to in (here + part * (target - here), here + (part - back) * (target - here)):
                last = legs[-1][0]
                took = 0.3 + abs(to - last) / reach * float(rng.uniform(1.3, 2.4))
                if abs(to - last) > 1e-6:
                    legs.append((to, took, float(rng.choice([0.1, 0.5]))))
                    total += took + legs[-1][2]
        here = target
    return travel(0.0, legs, True, seconds)


MOTIONS: dict[str, Maker] = {
    f.__name__: f for f in (way_points, spiral, triangles, dithered_scan, hand, pecking)
}  # fmt: skip


def other_joint(rng: np.random.Generator, count: int, stroke: float) -> FloatArray:
    """Another degree of freedom: slow minimum-jerk moves from and about zero."""
    legs: list[Leg] = []
    total = 0.0
    while total < count * STEP + 1.0:  # a leg loses less than two steps to rounding
        took, rest = float(rng.uniform(1.5, 4.0)), float(rng.uniform(0.5, 4.0))
        legs.append((float(rng.uniform(-stroke, stroke)), took, rest))
        total += took + rest
    return travel(0.0, legs, True)[:count]
