"""The motor's motions: one for calibrating and six kinds for tests, inside +-0.97 of the reach."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from tools.family_three.motion import EDGE, Motion, jerk, load, other_joint, steady
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Move = tuple[float, float, float]  # to where, in how long, rest after it


def _run(start: float, moves: list[Move], seconds: float, smooth: bool) -> FloatArray:
    """Moves one after the other, their times stretched to fill `seconds`."""
    pace = seconds / sum(took + rest for _, took, rest in moves)
    out, here, shape = [np.array([start])], start, jerk if smooth else steady
    for end, took, rest in moves:
        out += [shape(here, end, took * pace), np.full(round(rest * pace / STEP), end)]
        here = end
    return np.concatenate(out)


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """First-order reversal curves: strokes from one end, turned round ever earlier, then the same from the other."""
    far, speed = EDGE * reach, 0.5 * reach
    side, here = float(rng.choice([-1.0, 1.0])), 0.0
    moves: list[Move] = []

    def go(to: float, pace: float, rest: float) -> None:
        nonlocal here
        moves.append((to, abs(to - here) / (speed * pace) + 0.02, rest))
        here = to

    go(side * far, 1.0, 0.3)
    go(-side * far, 0.7, 0.2)
    go(side * far, float(rng.uniform(1.4, 2.0)), 0.2)
    for end in (side, -side):
        go(end * far, 1.2, 0.2)
        for depth in np.sort(rng.uniform(-0.75, 0.75, 3)) * reach:
            go(-end * depth, float(rng.choice([0.7, 1.0, 1.6])), float(rng.uniform(0.1, 0.7)))
            back = min(2.0 * width, 0.8 * reach) * float(rng.uniform(0.8, 1.3))
            go(float(np.clip(here + end * back, -far, far)), 0.8, float(rng.uniform(0.1, 0.4)))
            if rng.random() < 0.6:
                go(end * far, 1.3, 0.1)
    go(-here, 1.0, 0.3)
    return _run(0.0, moves, seconds, False)


def rate_joystick(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A joystick that commands speed: deflections held for a while, let go between, turned at the range's ends."""
    moves: list[Move] = []
    here, way, spent = 0.0, float(rng.choice([-1.0, 1.0])), 0.0
    while spent < seconds:
        speed, took = float(rng.uniform(0.25, 0.8)) * reach, float(rng.uniform(0.8, 3.0))
        to = float(np.clip(here + way * speed * took, -EDGE * reach, EDGE * reach))
        moves.append((to, max(abs(to - here) / speed, 0.15), float(rng.choice([0.0, 0.2, 1.0], p=[0.4, 0.35, 0.25]))))
        spent += moves[-1][1] + moves[-1][2]
        here = to
        if rng.random() < 0.7 or way * here > 0.8 * reach:
            way = -way
    return _run(0.0, moves, seconds, False)


def raster_flyback(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Scan lines: slowly along, quickly back, each line's ends a bit further on."""
    lines = max(int(seconds / rng.uniform(3.5, 6.0)), 3)
    half = max(float(rng.uniform(0.35, 0.7)) * reach, min(0.8 * width, 0.9 * reach))
    room, way = EDGE * reach - half, float(rng.choice([-1.0, 1.0]))
    middles = room * np.sin(np.linspace(-1.4, 1.4, lines) * rng.uniform(0.8, 2.0))
    moves: list[Move] = []
    for middle in middles.tolist():
        moves += [(middle - way * half, 0.9, 0.05), (middle + way * half, 3.0, float(rng.choice([0.05, 0.5])))]
    return _run(0.0, moves, seconds, False)


def saccade_pursuit(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """As eyes move: quick jumps to a target, then following it at its even pace."""
    moves: list[Move] = []
    here, spent = 0.0, 0.0
    while spent < seconds:
        to = float(rng.uniform(-0.9, 0.9)) * reach
        if abs(to - here) < max(1.2 * width, 0.3 * reach):
            to = -np.sign(here or 1.0) * 0.85 * reach
        took = 0.35 + 0.35 * abs(to - here) / reach
        chased = float(np.clip(to + float(rng.uniform(-0.6, 0.6)) * reach, -EDGE * reach, EDGE * reach))
        chase = 0.3 + abs(chased - to) / (float(rng.uniform(0.15, 0.4)) * reach)
        moves += [(to, took, float(rng.uniform(0.05, 0.3))), (chased, chase, float(rng.choice([0.0, 0.4])))]
        here, spent = chased, spent + took + chase
    return _run(0.0, moves, seconds, True)


def wiper(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Sweeps to both sides of a place that get smaller by a part each, then anew about another."""
    moves: list[Move] = []
    spent = 0.0
    while spent < seconds:
        place = float(rng.uniform(-0.45, 0.45)) * reach
        size = EDGE * reach - abs(place)
        way, left = float(rng.choice([-1.0, 1.0])), float(rng.uniform(0.6, 0.8))
        while size > max(0.55 * width, 0.12 * reach):
            moves.append((place + way * size, 0.4 + 1.5 * size / reach, float(rng.uniform(0.0, 0.15))))
            spent += moves[-1][1] + moves[-1][2]
            way, size = -way, size * left
    return _run(0.0, moves, seconds, True)


def palpation(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Up to a place, two to four presses from it that grow, a halt in each, and away again."""
    moves: list[Move] = []
    spent, side = 0.0, float(rng.choice([-1.0, 1.0]))
    while spent < seconds:
        place = -side * float(rng.uniform(0.0, 0.6)) * reach
        moves.append((place, float(rng.uniform(1.0, 2.0)), 0.2))
        for depth in np.linspace(0.35, 1.0, int(rng.integers(2, 5))) * (EDGE * reach + side * -place) * 0.95:
            halt = float(rng.uniform(0.3, 1.0))
            moves += [(place + side * float(depth), float(rng.uniform(0.7, 1.2)), halt)]
            moves += [(place, float(rng.uniform(0.6, 1.0)), 0.1)]
        spent = sum(took + rest for _, took, rest in moves)
        side = -side
    return _run(0.0, moves, seconds, True)


def beating(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Two close rates that beat, about a random walk of the middle."""
    t = np.arange(round(seconds / STEP) + 1) * STEP
    slow = float(rng.uniform(0.03, 0.06))
    beat = np.sin(2 * np.pi * slow * t + rng.uniform(0, 6)) * np.sin(2 * np.pi * float(rng.uniform(0.2, 0.4)) * t)
    walk = sosfiltfilt(butter(2, 0.08, fs=1 / STEP, output="sos"), rng.normal(size=t.size + 8000))[4000:-4000]
    q = beat + 0.35 * walk / np.std(walk)
    size = max(float(rng.uniform(0.75, 0.95)) * reach, min(1.2 * width, 0.95 * reach))
    return np.asarray((q - 0.5 * (q.max() + q.min())) / (0.5 * np.ptp(q)) * size)


MOTIONS: dict[str, Motion] = {
    f.__name__: f for f in (rate_joystick, raster_flyback, saccade_pursuit, wiper, palpation, beating)
}

__all__ = ["MOTIONS", "calibration", "load", "other_joint"]
