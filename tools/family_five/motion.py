"""The motor's motions: one for calibrating and six kinds for tests, inside +-0.97 of the reach."""

import numpy as np

from tools.family_four.motion import FloatArray, Move, _run
from tools.family_three.motion import EDGE, Motion, _fit, jerk, load, other_joint
from tools.family_two.motion import STEP


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """As magnets are wiped: full strokes that shrink about the middle, full ones again, then about two other places."""
    far, speed = EDGE * reach, 0.5 * reach
    way, here = float(rng.choice([-1.0, 1.0])), 0.0
    moves: list[Move] = []

    def go(to: float, pace: float, rest: float) -> None:
        nonlocal here
        moves.append((to, abs(to - here) / (speed * pace) + 0.02, rest))
        here = to

    def wipe(place: float, strokes: int) -> None:
        nonlocal way
        least = max(1.3 * width, 0.2 * reach)
        for size in np.geomspace(far - abs(place), min(0.5 * least, far - abs(place)), strokes).tolist():
            go(place + way * size, float(rng.choice([0.7, 1.0, 1.5])), float(rng.uniform(0.1, 0.6)))
            way = -way

    go(way * far, 1.0, 0.3)
    go(-way * far, 0.6, 0.2)
    wipe(0.0, 6)
    for side in (way, -way):
        go(side * far, float(rng.uniform(1.3, 1.9)), 0.3)
        go(-side * far, 1.0, 0.2)
        wipe(side * float(rng.uniform(0.35, 0.6)) * reach, 4)
    go(0.0, 1.0, 0.3)
    return _run(0.0, moves, seconds, False)


def aprbs(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """An amplitude-modulated pseudo-random sequence, as for identifying non-linear systems, through a ramp."""
    count = int(rng.integers(9, 15))
    levels = rng.permutation(np.linspace(-0.92, 0.92, count)) * reach
    moves: list[Move] = []
    here = 0.0
    for level in levels.tolist():
        moves.append((level, 0.15 + abs(level - here) / (0.9 * reach), float(rng.choice([0.3, 0.6, 0.9, 1.8, 2.4]))))
        here = level
    return _run(0.0, moves, seconds, False)


def sine_bursts(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Bursts of a few whole periods of a sine, each of another rate, size and middle, as on a shaker."""
    out, here, spent = [np.zeros(1)], 0.0, 0.0
    while spent < seconds:
        size = float(np.clip(rng.uniform(0.25, 0.9) * reach, min(0.7 * width, 0.9 * reach), EDGE * reach))
        middle = float(rng.uniform(-1, 1)) * (EDGE * reach - size)
        rate = float(rng.uniform(0.12, 0.5)) * min(1.0, 0.6 * reach / size)
        periods = int(rng.integers(2, 4))
        t = np.arange(1, round(periods / rate / STEP) + 1) * STEP
        burst = middle + float(rng.choice([-1, 1])) * size * np.sin(2 * np.pi * rate * t)
        out += [jerk(here, middle, 1.0), burst, np.full(round(rng.uniform(0.1, 0.6) / STEP), burst[-1])]
        here, spent = float(burst[-1]), spent + 1.4 + float(t[-1])
    return np.concatenate(out)[: round(seconds / STEP) + 1]


def pilgrim(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Pilgrims' steps: a long one on and a shorter one back, to the end of the range; then the other way."""
    moves: list[Move] = []
    here, way, spent = 0.0, float(rng.choice([-1.0, 1.0])), 0.0
    while spent < seconds:
        on, pace = float(rng.uniform(0.5, 1.0)) * max(reach, 1.2 * width), float(rng.uniform(0.6, 1.1)) * reach
        to = float(np.clip(here + way * on, -EDGE * reach, EDGE * reach))
        back = to - way * float(rng.uniform(0.45, 0.75)) * on
        moves += [
            (to, abs(to - here) / pace + 0.1, 0.1),
            (back, abs(back - to) / pace + 0.1, float(rng.uniform(0, 0.5))),
        ]
        here, spent = back, spent + moves[-2][1] + moves[-1][1] + 0.4
        if way * to > 0.9 * reach:
            way = -way
    return _run(0.0, moves, seconds, False)


def handwriting(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Strokes of log-normal speed that begin before the last has ended (Plamondon 1995)."""
    n = round(seconds / STEP) + 1
    t, speed = np.arange(n) * STEP, np.zeros(n)
    begin, place = 0.2, 0.0
    while begin < seconds:
        to = float(np.clip(-np.sign(place or 1.0) * rng.uniform(-0.3, 1.0), -1, 1))
        since = np.maximum(t - begin, 1e-6)
        spread, late = float(rng.uniform(0.25, 0.45)), float(rng.uniform(-0.6, 0.1))
        bell = np.exp(-0.5 * ((np.log(since) - late) / spread) ** 2) / (since * spread * np.sqrt(2 * np.pi))
        speed += (to - place) * bell
        begin, place = begin + float(rng.uniform(0.8, 2.2)), to
    return _fit(rng, np.cumsum(speed) * STEP, reach, width)


def gating(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Follows breathing: cos^2n with unequal breaths (Lujan 1999) over a baseline that moves through the range."""
    n = round(seconds / STEP) + 1
    t, q, begin = np.arange(n) * STEP, np.zeros(n), 0.0
    power = int(rng.integers(1, 4))
    while begin < seconds:
        period, deep = float(rng.uniform(2.5, 5.0)), float(rng.uniform(0.7, 1.3))
        u = np.clip((t - begin) / period, 0.0, 1.0)
        q += deep * np.sin(np.pi * u) ** (2 * power)
        begin += period * float(rng.choice([1.0, 1.0, 1.15]))
    base = 0.45 * np.sin(2 * np.pi * t / seconds * float(rng.uniform(0.8, 1.6)) + float(rng.uniform(0, 6)))
    return _fit(rng, float(rng.choice([-1, 1])) * q + base, reach, width)


def levy_flight(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Search: many short moves about a place, then a long one, by a power law of lengths."""
    moves: list[Move] = []
    here, spent = 0.0, 0.0
    while spent < seconds:
        far = min(0.12 * float(rng.uniform(0.01, 1.0)) ** (-1 / 1.2), 1.7) * reach
        to = here + float(rng.choice([-1.0, 1.0])) * far
        if abs(to) > EDGE * reach:
            to = float(np.clip(here - np.sign(to) * far, -EDGE * reach, EDGE * reach))
        moves.append((to, 0.25 + 1.2 * abs(to - here) / reach, float(rng.choice([0.0, 0.15, 0.5]))))
        here, spent = to, spent + moves[-1][1] + moves[-1][2]
    return _run(0.0, moves, seconds, True)


MOTIONS: dict[str, Motion] = {f.__name__: f for f in (aprbs, sine_bursts, pilgrim, handwriting, gating, levy_flight)}

__all__ = ["MOTIONS", "calibration", "load", "other_joint"]
