"""The motor's motions: one for calibrating and six kinds for tests. All start and end inside +-0.97 of the reach."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
Motion = Callable[[np.random.Generator, float, float, float], FloatArray]
EDGE = 0.97  # of the reach


def jerk(start: float, end: float, seconds: float) -> FloatArray:
    """A minimum-jerk move; the first instant is the one after the start."""
    n = max(round(seconds / STEP), 2)
    u = np.arange(1, n + 1) / n
    return np.asarray(start + (end - start) * u**3 * (10 + u * (6 * u - 15)))


def steady(start: float, end: float, seconds: float) -> FloatArray:
    """A move at constant speed but for its ends."""
    n = max(round(seconds / STEP), 2)
    u = np.arange(1, n + 1) / n
    soft = 0.1
    v = np.minimum(np.minimum(u, 1 - u + 1 / n) / soft, 1.0)
    return np.asarray(start + (end - start) * np.cumsum(v) / v.sum())


def _rest(place: float, seconds: float) -> FloatArray:
    return np.full(max(round(seconds / STEP), 1), place)


def _cut(parts: list[FloatArray], seconds: float) -> FloatArray:
    return np.concatenate(parts)[: round(seconds / STEP) + 1]


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Slow and fast full strokes, then small loops at places that climb and others that descend, a rest in each."""
    far = EDGE * reach
    sign = float(rng.choice([-1.0, 1.0]))
    places = rng.permutation(np.linspace(-0.72, 0.72, 7)) * reach
    places = np.concatenate([np.sort(places[:4]), np.sort(places[4:])[::-1]])
    fans = rng.uniform(1.6, 3.0, 7) * width
    slow, fast = 0.155, 0.075  # of the duration, for a full stroke
    moves: list[tuple[float, float, float]] = [
        (sign * far, 0.05, 0.01), (-sign * far, slow, 0.01), (sign * far, slow, 0.01), (-sign * far, fast, 0.006),
        (sign * far, fast, 0.006), (-far, 0.05, 0.004),
    ]  # fmt: skip
    each = (0.97 - sum(a + b for _, a, b in moves)) / 7
    for place, fan in zip(places, fans, strict=True):
        room = min(fan, 0.95 * (far - abs(place)))
        moves += [
            (place + 0.5 * room, 0.4 * each, 0.03 * each),
            (place - 0.5 * room, 0.25 * each, 0.03 * each),
            (place + 0.4 * room, 0.2 * each, 0.09 * each),
        ]
    here, out = 0.0, [np.zeros(1)]
    for end, share, rest in moves:
        out += [steady(here, end, share * seconds), _rest(end, rest * seconds)]
        here = end
    out.append(_rest(here, seconds))
    return _cut(out, seconds)


def am_chirp(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A sine whose rate climbs and falls again while its amplitude swells, about a middle that moves slowly."""
    t = np.arange(round(seconds / STEP) + 1) * STEP
    lo, hi = rng.uniform(0.07, 0.12), rng.uniform(0.25, 0.5)
    rate = lo * (hi / lo) ** np.sin(np.pi * t / seconds) ** 2
    size = 0.55 + 0.25 * np.cos(2 * np.pi * t / seconds * rng.choice([2, 3]) + rng.uniform(0, 6))
    middle = 0.2 * np.sin(2 * np.pi * t / seconds * rng.uniform(0.6, 1.2) + rng.uniform(0, 6))
    q = size * np.sin(2 * np.pi * np.cumsum(rate) * STEP) + middle
    return _fit(rng, q, reach, width)


def lissajous(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """A sum of sines whose rates have no common measure, in which time stands still now and then."""
    n = round(seconds / STEP) + 1
    pace = np.ones(n)
    for begin in np.cumsum(rng.uniform(4.0, 8.0, 8)):
        pace[round(begin / STEP) : round((begin + rng.uniform(0.6, 1.8)) / STEP)] = 0.0
    soft = np.convolve(np.pad(pace, 50, "edge"), np.ones(101) / 101, mode="valid")
    s = np.cumsum(soft) * STEP
    base = rng.uniform(0.1, 0.16)
    rates = base * np.array([1.0, np.sqrt(2.0) * 1.19, np.sqrt(7.0)])
    sizes = np.array([0.55, 0.35, 0.2]) * rng.uniform(0.8, 1.2, 3)
    phases = rng.uniform(0, 2 * np.pi, 3)
    q = np.sum([a * np.sin(2 * np.pi * f * s + p) for a, f, p in zip(sizes, rates, phases, strict=True)], axis=0)
    return _fit(rng, np.asarray(q), reach, width)


def minimum_jerk(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """From target to target, each reached by the smoothest move, with little rest."""
    here = float(rng.uniform(-0.5, 0.5)) * reach
    out, way, spent = [np.array([here])], float(rng.choice([-1, 1])), 0.0
    while spent < seconds:
        room = EDGE * reach - way * here
        far = float(np.clip(rng.uniform(0.2, 1.0) * room, min(1.3 * width, room), room))
        time, pause = float(rng.uniform(0.9, 2.6)), float(rng.choice([0.1, 0.3, 0.8]))
        out += [jerk(here, here + way * far, time), _rest(here + way * far, pause)]
        here, spent = here + way * far, spent + time + pause
        if rng.random() < 0.8 or EDGE * reach - way * here < 0.15 * reach:
            way = -way
    return _cut(out, seconds)


def suturing(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Stitches: a quick arc forth, a halt, a slower one back, a few times at a place; then on to the next."""
    out, here, spent = [np.zeros(1)], 0.0, 0.0
    places = np.tile(rng.permutation([-0.55, -0.1, 0.25, 0.6]), 12) * reach + rng.uniform(-0.08, 0.08, 48) * reach
    for place in places:
        arc = float(np.clip(rng.uniform(1.5, 3.5) * width, 0.2 * reach, 0.75 * (EDGE * reach - abs(place)) * 2))
        low, high = max(place - arc / 2, -EDGE * reach), min(place + arc / 2, EDGE * reach)
        for _ in range(int(rng.integers(2, 4))):
            forth, back = float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.9, 1.8))
            out += [jerk(here, high, forth), _rest(high, rng.uniform(0.15, 0.5))]
            out += [jerk(high, low, back), _rest(low, rng.uniform(0.1, 0.4))]
            here, spent = low, spent + forth + back
        if spent > seconds:
            break
    return _cut(out, seconds)


def settling(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Set-points that a slack position loop runs past and settles on."""
    out, here, spent = [np.zeros(1)], 0.0, 0.0
    way = float(rng.choice([-1, 1]))
    while spent < seconds:
        damping, time = float(rng.uniform(0.25, 0.6)), float(rng.uniform(1.6, 3.2))
        over = float(np.exp(-np.pi * damping / np.sqrt(1 - damping**2)))
        room = (EDGE * reach - way * here) / (1 + over)
        far = float(rng.uniform(0.45, 1.0)) * room
        rate = 2 * np.pi * float(rng.uniform(0.35, 0.9))
        t = np.arange(1, round(time / STEP) + 1) * STEP
        w = rate * np.sqrt(1 - damping**2)
        gone = 1 - np.exp(-damping * rate * t) * (np.cos(w * t) + damping * rate / w * np.sin(w * t))
        out.append(here + way * far * gone)
        here, spent = float(out[-1][-1]), spent + time
        if rng.random() < 0.75 or EDGE * reach - way * here < 0.3 * reach:
            way = -way
    return _cut(out, seconds)


def acceleration_walk(rng: np.random.Generator, reach: float, width: float, seconds: float) -> FloatArray:
    """Accelerations drawn anew every so often, held in by a soft spring and a drag: a hand without a plan."""
    n = round(seconds / STEP) + 1
    raw = rng.normal(size=n + 4000)
    lo, hi = rng.uniform(0.06, 0.1), rng.uniform(0.35, 0.6)
    q = sosfiltfilt(butter(2, [lo, hi], "bandpass", fs=1 / STEP, output="sos"), raw)[2000 : 2000 + n]
    return _fit(rng, np.asarray(np.tanh(q / (1.3 * np.std(q)))), reach, width)


def _fit(rng: np.random.Generator, q: FloatArray, reach: float, width: float) -> FloatArray:
    """Over most of the range and well beyond the gap."""
    middle = 0.5 * (q.max() + q.min())
    half = 0.5 * np.ptp(q)
    size = max(float(rng.uniform(0.7, 0.95)) * reach, min(1.2 * width, 0.95 * reach))
    return np.asarray((q - middle) / half * size)


MOTIONS: dict[str, Motion] = {
    "am_chirp": am_chirp,
    "lissajous": lissajous,
    "minimum_jerk": minimum_jerk,
    "suturing": suturing,
    "settling": settling,
    "acceleration_walk": acceleration_walk,
}


def other_joint(rng: np.random.Generator, count: int, stroke: float) -> FloatArray:
    """Another joint's moves between places, with rests; from 0."""
    out, here = [np.zeros(1 + round(float(rng.uniform(0.5, 2.0)) / STEP))], 0.0
    while sum(p.size for p in out) < count:
        there = float(rng.uniform(-1, 1)) * stroke
        out += [jerk(here, there, float(rng.uniform(1.0, 3.0))), _rest(there, rng.uniform(0.2, 2.5))]
        here = there
    return np.concatenate(out)[:count]


def load(rng: np.random.Generator, count: int, full: float) -> FloatArray:
    """Weights hung on and taken off within a tenth of a second."""
    out = [np.zeros(round(float(rng.uniform(2.0, 5.0)) / STEP))]
    here = 0.0
    while sum(p.size for p in out) < count:
        there = float(rng.choice([0.0, 0.25, 0.5, 0.75, 1.0])) * full
        out += [steady(here, there, 0.1), _rest(there, rng.uniform(3.0, 8.0))]
        here = there
    return np.concatenate(out)[:count]
