"""This family's yardstick: play of a width that depends on the place, a smooth law, delay and pose, fitted anew.

Width of degree 5, law of degree 7 in the place. It says what a cause leaves to a recalibration, and whether a healthy
mechanism is a plain hysteresis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from tools.family_three import camera
from tools.family_three.friction import project
from tools.family_three.line import Line, Part
from tools.family_three.plant import Plant, Shown
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]
WIDTH_DEGREE, LAW_DEGREE = 5, 7
EVERY = 2  # of the grid's instants
MOST_FRAMES = 1000
ROUNDS = 6
LEAD = 15.0  # s of motion before the first frame
PLACES = np.linspace(-1.3, 1.3, 521)


@dataclass
class Nominal:
    plant: Plant
    line: Line
    q: FloatArray  # share of the reach, thinned
    t: FloatArray
    times: FloatArray  # stamps less the nominal delay
    seen: FloatArray

    def __post_init__(self) -> None:
        self.along = self._side("translation_mm")
        self.rotation = self._side("rotation_deg")

    def _side(self, name: str) -> FloatArray:
        column = self.line.sides.get(name)
        return np.zeros(self.times.size) if column is None else self.line.at(column, self.times)

    @property
    def count(self) -> int:
        return WIDTH_DEGREE + LAW_DEGREE + 3 + (0 if self.plant.view is None else 6)

    def first(self) -> FloatArray:
        """The healthy width and law."""
        m, out = self.plant.mechanism, np.zeros(self.count)
        up, down = m.need(m.xs, 1.0) / m.reach, m.need(m.xs, -1.0) / m.reach
        mean = 0.5 * (up + down)
        inside = np.abs(mean) <= 1.05
        out[: WIDTH_DEGREE + 1] = chebyshev.chebfit(mean[inside], (up - down)[inside], WIDTH_DEGREE)
        out[WIDTH_DEGREE + 1 : -1 if self.plant.view is None else -7] = chebyshev.chebfit(
            mean[inside], m.tip(m.xs)[inside], LAW_DEGREE
        )
        return out

    def place(self, width: FloatArray) -> FloatArray:
        """x (of the reach) with q - b(x) / 2 <= x <= q + b(x) / 2."""
        half = 0.5 * chebyshev.chebval(np.clip(PLACES, -1.1, 1.1), width)
        low = np.interp(self.q, np.maximum.accumulate(PLACES + half), PLACES)
        high = np.interp(self.q, np.maximum.accumulate(PLACES - half), PLACES)
        return project(low, np.maximum(low, high), float(self.q[0]))

    def predict(self, p: FloatArray, x: FloatArray) -> FloatArray:
        law, late = p[WIDTH_DEGREE + 1 : WIDTH_DEGREE + LAW_DEGREE + 2], p[WIDTH_DEGREE + LAW_DEGREE + 2]
        at = np.interp(self.times - late, self.t, x)
        c: FloatArray = chebyshev.chebval(np.clip(at, -1.2, 1.2), law)
        if self.plant.view is None:
            return c[:, None]
        return camera.reference(self.plant.view, c, p[-6:], self.along, self.rotation)

    def scales(self) -> FloatArray:
        deg = self.line.gain * self.line.reach
        own = [1e-3] * (WIDTH_DEGREE + 1) + [1e-3 * deg] * (LAW_DEGREE + 1) + [1e-3]
        return np.array(own + ([] if self.plant.view is None else [0.02] * 3 + [0.01] * 3))

    def fit(self) -> tuple[FloatArray, float]:
        """Levenberg and Marquardt; parameters and the rms per coordinate that is left."""
        p, scales = self.first(), self.scales()
        wide = WIDTH_DEGREE + 1
        x = self.place(p[:wide])
        miss = (self.seen - self.predict(p, x)).ravel()
        damping = 1e-4
        for _ in range(ROUNDS):
            slopes = np.empty((miss.size, p.size))
            for i, scale in enumerate(scales):
                other = p.copy()
                other[i] += scale
                moved = self.place(other[:wide]) if i < wide else x
                slopes[:, i] = (self.seen - self.predict(other, moved)).ravel() - miss
            normal, right, before = slopes.T @ slopes, -slopes.T @ miss, float(miss @ miss)
            for _ in range(4):
                weighted = normal + damping * np.diag(np.diag(normal) + 1e-12)
                new = p + np.linalg.lstsq(weighted, right, rcond=1e-13)[0] * scales
                there = self.place(new[:wide])
                left = (self.seen - self.predict(new, there)).ravel()
                if left @ left < before:
                    p, x, miss, damping = new, there, left, damping / 10
                    break
                damping *= 20
            else:
                break
            if float(miss @ miss) > 0.995 * before:
                break
        return p, float(np.sqrt(np.mean(miss**2)))


def of(plant: Plant, line: Line, q: FloatArray, shown: Sequence[Shown]) -> Nominal:
    """The fit's problem: the motor as logged and some recordings."""
    times = np.concatenate([s.arrival for s in shown]) - plant.delay
    seen = np.concatenate([s.values for s in shown])
    thin = -(-times.size // MOST_FRAMES)
    parts: list[Part] = [s.part for s in shown]
    begin = max(parts[0].first - round(LEAD / STEP), 0)
    inside = slice(begin, parts[-1].first + parts[-1].count, EVERY)
    return Nominal(plant, line, q[inside] / line.reach, line.t[inside], times[::thin], seen[::thin])
