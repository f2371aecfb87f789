"""Times the noise: what is left of a test when the nominal model is fitted to it anew, roughly.

Nominal: a width of degree 6 of place, a static law of degree 7, a delay, the hand-eye transform. No noise is in
the data that it is fitted to, so the rest is the cause's alone; what the healthy mechanism leaves is taken off.
"""

from collections.abc import Sequence

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import least_squares
from tools.family import view as views
from tools.family.causes.base import Cause
from tools.family.line import Line
from tools.family.plant import Plant, Seen, stamps

DEGREE = 7
WIDTHS = 7  # coefficients of the width
FRAMES = 500  # of the tests, evenly picked: enough for an rms to a few per cent
HAND_EYE = np.array([5.0, 5.0, 5.0, 5.0, 5.0, 5.0])  # deg, mm: where the transform may go without being punished


def place(q: np.ndarray, width: np.ndarray, reach: float) -> tuple[np.ndarray, np.ndarray]:
    """The two envelopes' centre coordinates of motor positions: p + B(p)/2 = q and p - B(p)/2 = q."""
    grid = np.linspace(-1.3 * reach, 1.3 * reach, 400)
    s = np.clip(grid / reach, -1, 1)
    half = np.maximum(chebyshev.chebval(s, width), 0.0) / 2
    return (
        np.interp(q, np.maximum.accumulate(grid + half), grid),
        np.interp(q, np.maximum.accumulate(grid - half), grid),
    )


def driven(q: np.ndarray, reach: float) -> np.ndarray:
    """Where a recording's state no longer depends on how it began: after its first stroke up and then down."""
    up = np.maximum.accumulate(q) > 0.6 * reach
    return np.maximum.accumulate(up & (q < 0.0))


class Tests:
    """The tests of a line, as the refit sees them: logged motor positions on a fine grid, frames by their stamps."""

    def __init__(self, plant: Plant, line: Line, causes: Sequence[Cause]) -> None:
        self.plant, self.line = plant, line
        self.parts = [i for i, n in enumerate(line.names) if n.startswith("test")]
        picked = []
        self.grid_t, self.grid_q, self.frame_t = [], [], []
        total = sum(int(np.sum(line.frame & (line.part == i))) for i in self.parts)
        every = max(total // FRAMES, 1)
        for i in self.parts:
            here = line.part == i
            t, q = line.t[here], line.q[here]
            q = q + sum(np.asarray(cause.encoder(line, t, q, i)) for cause in causes)
            all_of = np.flatnonzero(here & line.frame)
            kept = np.arange(all_of.size)[driven(line.q[all_of], line.reach)][::every]
            picked.append(all_of[kept])
            self.grid_t.append(t)
            self.grid_q.append(q)
            self.frame_t.append(stamps(plant, line, causes, i)[kept])
        self.picked = np.concatenate(picked)
        zero = np.zeros(self.picked.size)
        self.translation = line.sides["translation_mm"][self.picked] if "translation_mm" in line.sides else zero
        self.rotation = line.sides["rotation_deg"][self.picked] if "rotation_deg" in line.sides else zero

    def centre(self, delay: float, width: np.ndarray) -> np.ndarray:
        """The play's centre coordinate at the picked frames."""
        out = []
        for t, q, frames in zip(self.grid_t, self.grid_q, self.frame_t, strict=True):
            low, high = place(q, width, self.line.reach)
            p, path = float(low[0] + high[0]) / 2, np.empty(q.size)
            for i, (lo, hi) in enumerate(zip(low.tolist(), high.tolist(), strict=True)):
                p = lo if p < lo else hi if p > hi else p
                path[i] = p
            seen = frames - delay
            before = np.clip(np.searchsorted(t, seen) - 1, 0, t.size - 1)
            lo, hi = place(np.interp(seen, t, q), width, self.line.reach)
            out.append(np.clip(path[before], lo, hi))
        return np.concatenate(out)


def left(plant: Plant, line: Line, causes: Sequence[Cause], seen: Seen) -> float:
    """rms per coordinate that the refitted nominal model leaves of the tests, px (deg with an angle sensor)."""
    tests = Tests(plant, line, causes)
    goal = seen.image[tests.picked]
    start_width = plant.width * np.eye(WIDTHS)[0]
    scale = 1.1 * line.reach

    def law(values: np.ndarray, p: np.ndarray) -> np.ndarray:
        return chebyshev.chebval(np.clip(p / scale, -1, 1), values) * line.reach * line.gain

    centre = tests.centre(plant.delay, start_width)
    first = chebyshev.chebfit(centre / scale, seen.c[tests.picked] / (line.reach * line.gain), DEGREE)

    def rest(values: np.ndarray) -> np.ndarray:
        delay, width = plant.delay + 0.01 * values[0], plant.width * values[1 : 1 + WIDTHS]
        c = law(values[1 + WIDTHS : 2 + WIDTHS + DEGREE], tests.centre(delay, width))
        if plant.view is None:
            return np.asarray((c - goal[:, 0]).ravel())
        hand = values[-6:]
        base = views.tip(plant.view, views.even(c), tests.translation, tests.rotation)
        moved = views.View(
            **{
                **plant.view.__dict__,
                "rotation_deg": tuple(np.asarray(plant.view.rotation_deg) + hand[:3]),
                "translation_mm": tuple(np.asarray(plant.view.translation_mm) + hand[3:]),
            }
        )
        return np.concatenate([(views.project(moved, base) - goal).ravel(), 1e-3 * hand / HAND_EYE])

    begin = np.concatenate([[0.0], np.eye(WIDTHS)[0], first, np.zeros(0 if plant.view is None else 6)])
    steps = np.concatenate(
        [[0.5], np.full(WIDTHS, 0.1), np.full(DEGREE + 1, 0.02), np.ones(begin.size - 2 - WIDTHS - DEGREE)]
    )
    fit = least_squares(rest, begin, x_scale=steps, diff_step=1e-4, max_nfev=6)
    final = rest(fit.x)[: goal.size]
    return float(np.sqrt(np.mean(final**2)))


def before(line: Line, seen: Seen, healthy: Seen, late: np.ndarray | float = 0.0) -> float:
    """rms per coordinate between tests with and without the causes: the gap of a calibration on the healthy one."""
    tests = line.frame & np.isin(line.part, [i for i, n in enumerate(line.names) if n.startswith("test")])
    speed = np.gradient(healthy.image, line.t, axis=0)[tests] * np.asarray(late)[..., None]
    return float(np.sqrt(np.mean((seen.image[tests] - healthy.image[tests] - speed) ** 2)))
