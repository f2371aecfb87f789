"""The motor's motions: one for calibrating and six kinds for tests, inside +-0.97 of the reach."""

import numpy as np

from tools.family_four.motion import FloatArray, Move, _run
from tools.family_three.motion import EDGE, Motion, _fit, jerk, load, other_joint
from tools.family_two.motion import STEP


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Full strokes, then two sizes of smaller ones at five places in a drawn order, full ones again at the end."""
    far, speed = EDGE * reach, 0.5 * reach
    way, here = float(rng.choice([-1.0, 1.0])), 0.0
    moves: list[Move] = []

    def go(to: float, pace: float, rest: float) -> None:
        nonlocal here
        moves.append((to, abs(to - here) / (speed * pace) + 0.02, rest))
        here = to

    for to, pace in ((way, 1.0), (-way, 0.7), (way, 1.6), (-way, 1.1)):
        go(to * far, pace, 0.3)
    for place in (rng.permutation([-0.62, -0.31, 0.0, 0.31, 0.62]) * reach).tolist():
        most = far - abs(place)
        small = min(max(0.75 * width, 0.09 * reach), most)
        large = min(max(1.6 * width, 0.26 * reach), most)
        for size in (large, small) if rng.random() < 0.5 else (small, large):
            for _ in range(2):
                go(place + size, float(rng.choice([0.7, 1.0, 1.4])), float(rng.uniform(0.1, 0.4)))
                go(place - size, float(rng.choice([0.7, 1.0, 1.4])), float(rng.uniform(0.1, 0.4)))
    go(way * far, 1.2, 0.3)
    go(-way * far, 0.9, 0.3)
    go(0.0, 1.0, 0.3)
    return _run(0.0, moves, seconds, False)


def morse(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Keyed: short and long presses from one level to another, word after word at other levels."""
    moves: list[Move] = []
    here, spent, unit = 0.0, 0.0, float(rng.uniform(0.2, 0.35))
    while spent < seconds:
        deep = float(rng.uniform(0.5, 1.5)) * reach
        deep = min(max(deep, 1.5 * width), 1.8 * reach)
        base = float(rng.uniform(-1, 1)) * max(0.95 * reach - 0.5 * deep, 0.0)
        up, down = np.clip([base + 0.5 * deep, base - 0.5 * deep], -EDGE * reach, EDGE * reach)
        for _ in range(int(rng.integers(2, 5))):
            for to, hold in ((up, unit * float(rng.choice([1, 3]))), (down, unit)):
                moves.append((float(to), 0.15 + 0.8 * abs(float(to) - here) / reach, hold))
                here, spent = float(to), spent + moves[-1][1] + hold
        spent += unit
    return _run(0.0, moves, seconds, True)


def bouncing(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A ball dropped on a floor, parabola after parabola, each lower; dropped again, at times from the ceiling."""
    out: list[FloatArray] = [np.zeros(1)]
    here, spent = 0.0, 0.0
    while spent < seconds:
        side, floor = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.3, 0.95)) * reach
        high, keeps = float(rng.uniform(1.0, 1.8)) * reach, float(rng.uniform(0.5, 0.75))
        pull = 2.2 * reach / float(rng.uniform(0.7, 1.4)) ** 2
        ground = side * floor
        out.append(jerk(here, ground, 0.3 + abs(here - ground) / reach))
        spent += out[-1].size * STEP
        while high > max(0.6 * width, 0.05 * reach):
            flight = np.sqrt(8 * high / pull)
            t = np.arange(1, max(round(flight / STEP), 8) + 1) * STEP
            arc = np.clip(0.5 * pull * t * (flight - t), 0.0, None)
            out.append(np.asarray(ground - side * np.minimum(arc, (1.0 + floor / reach) * EDGE * reach)))
            high, spent = high * keeps, spent + float(t[-1])
        here = float(out[-1][-1])
        out.append(np.full(round(rng.uniform(0.2, 1.0) / STEP), here))
        spent += out[-1].size * STEP
    return np.clip(np.concatenate(out), -EDGE * reach, EDGE * reach)[: round(seconds / STEP) + 1]


def duffing(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A chaotic oscillator between two wells, played slowly."""
    n = round(seconds / STEP) + 1
    pace, force = float(rng.uniform(2.0, 3.0)), float(rng.uniform(0.32, 0.5))
    x, v, out = float(rng.uniform(-1, 1)), 0.0, np.empty(n)
    for k in range(n):
        v += STEP * pace * (x - x**3 - 0.25 * v + force * np.cos(1.1 * pace * k * STEP))
        x += STEP * pace * v
        out[k] = x
    return _fit(rng, out - out[0], reach, width)


def bisection(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A place is looked for by halves: too far, too short, each miss about half the last; then another place."""
    moves: list[Move] = []
    here, spent = 0.0, 0.0
    while spent < seconds:
        goal, miss = float(rng.uniform(-0.8, 0.8)) * reach, float(rng.uniform(0.7, 1.2)) * reach
        way = float(rng.choice([-1.0, 1.0]))
        while miss > max(0.3 * width, 0.03 * reach):
            to = float(np.clip(goal + way * miss, -EDGE * reach, EDGE * reach))
            moves.append((to, 0.2 + abs(to - here) / (1.1 * reach), float(rng.uniform(0.05, 0.5))))
            here, spent = to, spent + moves[-1][1] + moves[-1][2]
            way, miss = -way, miss * float(rng.uniform(0.4, 0.65))
    return _run(0.0, moves, seconds, True)


def trills(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Notes of a scale, some held and some trilled with their neighbour."""
    scale = np.linspace(-0.9, 0.9, int(rng.integers(4, 7))) * reach
    moves: list[Move] = []
    note, here, spent = scale.size // 2, 0.0, 0.0
    while spent < seconds:
        note = int(np.clip(note + rng.choice([-3, -2, -1, 1, 2, 3]), 0, scale.size - 1))
        other = note + 1 if note + 1 < scale.size else note - 1
        line = [note, other] * int(rng.integers(2, 4)) if rng.random() < 0.5 else [note]
        for k in line:
            to = float(scale[k])
            moves.append((to, 0.12 + abs(to - here) / (1.2 * reach), 0.05 if len(line) > 1 else 0.8))
            here, spent = to, spent + moves[-1][1] + moves[-1][2]
    return _run(0.0, moves, seconds, False)


def relaxation(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Van der Pol's oscillations: slow going on, then over at once, about a middle that wanders."""
    n = round(seconds / STEP) + 1
    t, stiff = np.arange(n) * STEP, float(rng.uniform(1.5, 4.0))
    pace = float(rng.uniform(1.6, 2.6))
    x, v, out = 0.5, 0.0, np.empty(n)
    for k in range(n):
        v += STEP * pace * (stiff * (1 - x * x) * v - x)
        x += STEP * pace * v
        out[k] = x
    swell = 1 + 0.4 * np.sin(2 * np.pi * t / seconds * float(rng.uniform(0.7, 1.6)) + float(rng.uniform(0, 6)))
    wander = 0.9 * np.sin(2 * np.pi * t / seconds * float(rng.uniform(0.6, 1.3)))
    return _fit(rng, out * swell + wander - out[0] * swell[0], reach, width)


MOTIONS: dict[str, Motion] = {f.__name__: f for f in (morse, bouncing, duffing, bisection, trills, relaxation)}

__all__ = ["MOTIONS", "calibration", "load", "other_joint"]
