"""A mechanism with its causes, run along a time line: configuration and what the sensor would show without noise."""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from tools.family import view as views
from tools.family.causes.base import Cause
from tools.family.line import Line
from tools.family.mechanisms import Backbone, Mechanism
from tools.family.view import View

STAGES = ("actuator", "transmission", "configuration", "kinematics", "registration", "camera", "acquisition")
LEAST_APART = 1e-4  # s between two frames: one waits for the other


@dataclass(frozen=True)
class Plant:
    mechanism: Mechanism
    view: View | None  # None: an angle sensor only
    law: tuple[float, float]  # square and cube of the static law, shares at the end of the range
    width: float  # of the motor, at the middle
    gain: float  # deg per unit of the motor over the full stroke
    delay: float  # s, the sensor's, as the rig says


@dataclass(frozen=True)
class Seen:
    c: np.ndarray  # deg, (n,)
    image: np.ndarray  # px (n, 2), or the angle, deg (n, 1)


def probe(mechanism: Mechanism) -> tuple[float, float]:
    """Width at the middle of the range and gain over a full stroke, by driving a copy of it."""
    m = copy.deepcopy(mechanism)
    for q in np.linspace(0, -m.reach, 100):
        m.step(float(q), 1.0, 1.0)
    low = m.step(-m.reach, 1.0, 1.0)
    middle = 0.0
    for q in np.linspace(-m.reach, 0.0, 200):
        middle = m.step(float(q), 1.0, 1.0)
    back = copy.deepcopy(m)
    width = next(
        (-float(q) for q in np.linspace(0, -m.reach, 4000) if abs(back.step(float(q), 1.0, 1.0) - middle) > 1e-6),
        m.reach,
    )
    high = middle
    for q in np.linspace(0, m.reach, 200):
        high = m.step(float(q), 1.0, 1.0)
    return width, (high - low) / (2 * m.reach - width)


def ordered(causes: Sequence[Cause]) -> list[Cause]:
    def place(cause: Cause) -> int:
        return STAGES.index(cause.id.split(".")[0]) if "." in cause.id else 2

    return sorted(causes, key=place)


def run(plant: Plant, line: Line, causes: Sequence[Cause]) -> Seen:
    causes = ordered(causes)
    mechanism = copy.deepcopy(plant.mechanism)
    n = line.t.size
    q, rising, falling = line.q.copy(), np.ones(n), np.ones(n)
    for cause in causes:
        q = q + cause.drive(line)
        up, down = cause.friction(line)
        rising, falling = rising * up, falling * down
    breakaways = [b for b in (cause.breakaway(line) for cause in causes) if b is not None]
    spreads = [s for s in (cause.spread(line) for cause in causes) if s is not None]
    for way in (np.linspace(0, -mechanism.reach, 60), np.linspace(-mechanism.reach, float(q[0]), 60)):
        for place in way:  # it was used before
            mechanism.step(float(place), float(rising[0]), float(falling[0]))
    x, off = _solve(mechanism, line, q, rising, falling, breakaways, spreads)
    span = line.reach * line.gain
    s = x / span
    c = span * (s + plant.law[0] * (s * s - 0.25) + plant.law[1] * s * (s * s - 0.25))
    for cause in causes:
        c = cause.bend(line, c)
    image = c[:, None] if plant.view is None else _look(plant.view, line, causes, c, off)
    for cause in causes:
        image = cause.sight(line, image)
    return Seen(c, image)


def _solve(
    mechanism: Mechanism,
    line: Line,
    q: np.ndarray,
    rising: np.ndarray,
    falling: np.ndarray,
    breakaways: list[tuple[np.ndarray, np.ndarray, np.ndarray, float]],
    spreads: list[np.ndarray],
) -> tuple[np.ndarray, np.ndarray | None]:
    """x, and how far each joint of a backbone is from an equal share, deg (n, joints)."""
    out = np.empty_like(q)
    ups, downs = rising.tolist(), falling.tolist()
    chain = mechanism if spreads and isinstance(mechanism, Backbone) else None
    uneven = np.sum(spreads, axis=0).tolist() if chain else []
    off = np.zeros((q.size, Backbone.joints)) if chain else None
    if not breakaways and chain is None:
        for i, place in enumerate(q.tolist()):
            out[i] = mechanism.step(place, ups[i], downs[i])
        return out, None
    # slid: the tip's travel since it last moved the other way; rest: how long the motor stood before this move
    slid, rest, still, last = {1: 0.0, -1: 0.0}, 0.0, 0.0, mechanism.step(float(q[0]), ups[0], downs[0])
    steps = np.diff(line.t, prepend=line.t[0]).tolist()
    moving = (np.abs(line.speed) > 0.01 * line.usual).tolist()
    for i, place in enumerate(q.tolist()):
        if moving[i]:
            if still > 0:
                rest, still = still, 0.0
                slid = {1: 0.0, -1: 0.0}
        else:
            still += steps[i]
        up, down = ups[i], downs[i]
        for one, other, aged, travel in breakaways:
            old = aged[i] * math.log1p(rest / 0.2)
            up *= 1 + (one[i] + old) * math.exp(-slid[1] / travel)
            down *= 1 + (other[i] + old) * math.exp(-slid[-1] / travel)
        if chain is not None and off is not None:
            chain.spread = uneven[i]
        x = mechanism.step(place, up, down)
        if chain is not None and off is not None:
            off[i] = chain.unevenness()
        if x != last:
            side = 1 if x > last else -1
            slid[side] += abs(x - last)
            slid[-side] = 0.0
            last = x
        out[i] = x
    return out, off


def _look(view: View, line: Line, causes: list[Cause], c: np.ndarray, off: np.ndarray | None) -> np.ndarray:
    pieces = views.even(c) if off is None else views.even(c) + off
    tilt, shift, lens = np.zeros((c.size, 3)), np.zeros((c.size, 3)), None
    moved = False
    for cause in causes:
        pieces = cause.shape(line, pieces)
        change = cause.hand_eye(line, c)
        if change is not None:
            tilt, shift, moved = tilt + change[0], shift + change[1], True
        glass = cause.lens(line)
        if glass is not None:
            lens = glass if lens is None else lens + glass
    zero = np.zeros(c.size)
    base = views.tip(view, pieces, line.sides.get("translation_mm", zero), line.sides.get("rotation_deg", zero))
    return views.project(view, base, tilt if moved else None, shift if moved else None, lens)


def stamps(plant: Plant, line: Line, causes: Sequence[Cause], part: int) -> np.ndarray:
    """When a recording's frames arrive, on the case's clock: rising."""
    scene = line.t[line.frame & (line.part == part)]
    arrival = scene + plant.delay + sum(np.asarray(cause.late(line, scene, part)) for cause in causes)
    apart = LEAST_APART * np.arange(scene.size)
    return np.asarray(np.maximum.accumulate(arrival - apart) + apart)
