"""Motions as a lab records them: way-points driven at trapezoidal speed, with rests, sampled each millisecond."""

import numpy as np

STEP = 0.001  # s, the grid that a motion is laid out on
RAMP = 0.12  # s, a way-point's speed changes over this time


def drive(points: list[tuple[float, float, float]], start: float) -> np.ndarray:
    """Positions each millisecond through (goal, speed, rest) in turn from `start`."""
    pieces, now = [np.full(int(0.6 / STEP), start)], start
    for goal, speed, rest in points:
        n = max(int(abs(goal - now) / speed / STEP), 1)
        pieces += [np.linspace(now, goal, n + 1)[1:], np.full(int(rest / STEP), goal)]
        now = goal
    line = np.concatenate(pieces)
    box = int(RAMP / STEP)
    padded = np.concatenate([np.full(box, line[0]), line, np.full(box, line[-1])])
    sums = np.cumsum(padded)
    return (sums[box:] - sums[:-box]) / box


def length(points: list[tuple[float, float, float]], start: float) -> float:
    ways = np.abs(np.diff([start, *(p[0] for p in points)]))
    return float(sum(w / p[1] + p[2] for w, p in zip(ways, points, strict=True)))


def calibration(rng: np.random.Generator, reach: float, width: float, seconds: float) -> np.ndarray:
    """Full strokes, then back-and-forth of several amplitudes on a ramp, at one to three speeds, with rests."""
    usual = reach * float(rng.uniform(0.25, 0.5))  # per second
    speeds = [usual * s for s in (1.0, 0.4, 2.0)[: rng.integers(1, 4)]]
    edge = 0.96 * reach
    points: list[tuple[float, float, float]] = [(edge, usual, 0.8), (-edge, usual, 0.8)]
    now, up = -edge, True
    while length(points, 0.0) < seconds - 2.5 * reach / usual:
        speed = float(rng.choice(speeds))
        size = width * float(rng.uniform(1.3, 2.2)) + reach * float(rng.choice([0.05, 0.12, 0.3]))
        goal = now + size if up else now - size
        if abs(goal) > edge:
            goal, up = float(np.clip(goal, -edge, edge)), not up
        points.append((goal, speed, float(rng.choice([0.0, 0.0, 0.3, 1.2]))))
        back = goal - np.sign(goal - now) * (width * 1.25 + float(rng.uniform(0.1, 0.6)) * size)
        now = float(np.clip(back, -edge, edge))
        points.append((now, speed, float(rng.choice([0.0, 0.2, 0.8]))))
    points += [(edge, usual, 0.5), (-edge, usual, 0.5), (0.0, usual, 0.5)]
    return drive(points, 0.0)


def way_points(rng: np.random.Generator, reach: float, width: float, seconds: float) -> np.ndarray:
    """A full stroke, then goals anywhere, at any of three speeds, with a few long rests."""
    usual = reach * float(rng.uniform(0.2, 0.6))
    points: list[tuple[float, float, float]] = [(0.9 * reach, usual, 0.3), (-0.9 * reach, usual, 0.3)]
    while length(points, 0.0) < seconds:
        rest = float(rng.choice([0.0, 0.1, 0.5, 3.0, 6.0], p=[0.4, 0.2, 0.2, 0.1, 0.1]))
        points.append((float(rng.uniform(-0.92, 0.92)) * reach, usual * float(rng.choice([0.3, 1.0, 1.8])), rest))
    return drive(points, 0.0)


def staircase(rng: np.random.Generator, reach: float, width: float, seconds: float) -> np.ndarray:
    """Steps up and down with a rest on each, a small step back now and then."""
    usual = reach * float(rng.uniform(0.3, 0.7))
    points: list[tuple[float, float, float]] = [(0.9 * reach, usual, 0.3), (-0.9 * reach, usual, 0.3)]
    now, up = -0.9 * reach, 1.0
    while length(points, 0.0) < seconds:
        now += up * reach * float(rng.uniform(0.15, 0.4))
        if abs(now) > 0.9 * reach:
            now, up = float(np.clip(now, -0.9 * reach, 0.9 * reach)), -up
        points.append((now, usual, float(rng.uniform(0.4, 2.5))))
        if rng.random() < 0.3:
            now = float(np.clip(now - up * width * float(rng.uniform(0.4, 1.8)), -0.92 * reach, 0.92 * reach))
            points.append((now, usual, float(rng.uniform(0.2, 1.0))))
    return drive(points, 0.0)


def wander(rng: np.random.Generator, reach: float, width: float, seconds: float) -> np.ndarray:
    """A full stroke, then a sum of three sines whose amplitudes swell and fade."""
    first = drive([(0.9 * reach, 0.5 * reach, 0.2), (-0.9 * reach, 0.5 * reach, 0.2), (0.0, 0.5 * reach, 0.4)], 0.0)
    t = np.arange(0.0, max(seconds - first.size * STEP, 10.0), STEP)
    total = np.zeros_like(t)
    for base in (0.07, 0.17, 0.31):
        rate = base * float(rng.uniform(0.8, 1.25))
        total += (
            (0.4 + 0.6 * np.sin(np.pi * rng.uniform(0.3, 1.0) * t / t[-1] + rng.uniform(0, 3)) ** 2)
            * np.sin(2 * np.pi * rate * t + rng.uniform(0, 6))
            / (1 + base * 4)
        )
    swell = 1 - np.exp(-t / 2.0)  # starts from rest at 0
    return np.concatenate([first, 0.85 * reach * swell * total / np.max(np.abs(total))])


def triangle(rng: np.random.Generator, reach: float, width: float, seconds: float) -> np.ndarray:
    """Periodic trapezoids on a mean that wanders from one end to the other, as the paper's test motion."""
    usual = reach * float(rng.uniform(0.25, 0.5))
    size = width + reach * float(rng.uniform(0.1, 0.3))
    points: list[tuple[float, float, float]] = [(0.9 * reach, usual, 0.3), (-0.9 * reach, usual, 0.3)]
    count = max(int((seconds - length(points, 0.0)) / (4 * size / usual + 0.6)), 3)
    ends = 0.9 * reach - min(size, 0.7 * reach)
    for mean in np.linspace(-ends, ends, count):
        points += [
            (min(float(mean + size), 0.92 * reach), usual, 0.3),
            (max(float(mean - size), -0.92 * reach), usual, 0.3),
        ]
    return drive(points, 0.0)


MOTIONS = {"way points": way_points, "staircase": staircase, "wander": wander, "triangle": triangle}


def side_motion(rng: np.random.Generator, seconds: float, stroke: float) -> np.ndarray:
    """Another joint: a few moves with long rests, each millisecond."""
    points = [
        (float(rng.uniform(-1, 1)) * stroke, stroke * float(rng.uniform(0.3, 0.8)), float(rng.uniform(1.0, 6.0)))
        for _ in range(int(seconds / 3) + 2)
    ]
    line = drive(points, 0.0)
    n = round(seconds / STEP) + 1
    return np.concatenate([line, np.full(max(n - line.size, 0), line[-1])])[:n]
