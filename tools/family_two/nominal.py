"""The nominal model, fitted anew: play of a width that depends on the place, a smooth law, delay, the camera's pose.

width: polynomial of degree 5 in the place; law: polynomial of degree 7. It is this family's own yardstick for what a
cause leaves to a recalibration, and for whether a healthy mechanism is a plain hysteresis.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from tools.family_two import camera
from tools.family_two.camera import Scene
from tools.family_two.causes.base import Cause
from tools.family_two.friction import project
from tools.family_two.plant import Plant, Shown, logged
from tools.family_two.timeline import Timeline

FloatArray = NDArray[np.float64]
WIDTH_DEGREE, LAW_DEGREE = 5, 7
EVERY = 2  # of the grid's instants: the play is stepped on fewer
MOST_FRAMES = 1500
ROUNDS = 7


@dataclass
class Nominal:
    plant: Plant
    line: Timeline
    q: FloatArray  # motor on the thinned grid
    t: FloatArray
    times: FloatArray  # arrival less the nominal delay
    seen: FloatArray
    scene: Scene

    @property
    def count(self) -> int:
        return WIDTH_DEGREE + LAW_DEGREE + 3 + (0 if self.plant.view is None else 6)

    def first(self) -> FloatArray:
        """Healthy numbers where one is as good as known, zeros elsewhere."""
        m, out = self.plant.mechanism, np.zeros(self.count)
        xs = np.linspace(-1, 1, 41) * m.limit
        up, down = m.need(xs, 1.0), m.need(xs, -1.0)
        mean = 0.5 * (up + down) / self.line.reach
        inside = np.abs(mean) <= 1.05
        width = chebyshev.chebfit(mean[inside], ((up - down) / self.line.reach)[inside], WIDTH_DEGREE)
        law = chebyshev.chebfit(mean[inside], m.tip(xs)[inside], LAW_DEGREE)
        out[: WIDTH_DEGREE + 1] = width
        out[WIDTH_DEGREE + 1 : WIDTH_DEGREE + LAW_DEGREE + 2] = law
        return out

    def place(self, width: FloatArray) -> FloatArray:
        """Play: place x (of the reach) with q - b(x) / 2 <= x <= q + b(x) / 2."""
        q = self.q / self.line.reach
        low, high = q.copy(), q.copy()
        for _ in range(4):
            low = q - 0.5 * chebyshev.chebval(np.clip(low, -1.1, 1.1), width)
            high = q + 0.5 * chebyshev.chebval(np.clip(high, -1.1, 1.1), width)
        return project(low, np.maximum(low, high), float(q[0]))

    def predict(self, p: FloatArray, x: FloatArray) -> FloatArray:
        law, late = p[WIDTH_DEGREE + 1 : WIDTH_DEGREE + LAW_DEGREE + 2], p[WIDTH_DEGREE + LAW_DEGREE + 2]
        at = np.interp(self.times - late, self.t, x)
        c: FloatArray = chebyshev.chebval(np.clip(at, -1.2, 1.2), law)
        view = self.plant.view
        if view is None:
            return c[:, None]
        moved = p[-6:]
        pose = replace(
            view,
            rotation_deg=tuple(a + b for a, b in zip(view.rotation_deg, moved[:3], strict=True)),
            translation_mm=tuple(a + b for a, b in zip(view.translation_mm, moved[3:], strict=True)),
        )
        return camera.project(pose, c, self.scene)

    def scales(self) -> FloatArray:
        deg = self.line.gain * self.line.reach
        own = [1e-3] * (WIDTH_DEGREE + 1) + [1e-3 * deg] * (LAW_DEGREE + 1) + [1e-3]
        return np.array(own + ([] if self.plant.view is None else [0.02] * 3 + [0.01] * 3))

    def fit(self) -> tuple[FloatArray, float]:
        """Gauss-Newton with a damping that follows success; parameters and the rms per coordinate that is left."""
        p, scales = self.first(), self.scales()
        width = slice(0, WIDTH_DEGREE + 1)
        x = self.place(p[width])
        miss = (self.seen - self.predict(p, x)).ravel()
        damping = 1e-4
        for _ in range(ROUNDS):
            slopes = np.empty((miss.size, p.size))
            for i, scale in enumerate(scales):
                other = p.copy()
                other[i] += scale
                moved = self.place(other[width]) if i <= WIDTH_DEGREE else x
                slopes[:, i] = (self.seen - self.predict(other, moved)).ravel() - miss
            normal, right = slopes.T @ slopes, -slopes.T @ miss
            before = float(miss @ miss)
            for _ in range(4):
                step = np.linalg.lstsq(normal + damping * np.diag(np.diag(normal) + 1e-12), right, rcond=1e-13)[0]
                new = p + step * scales
                there = self.place(new[width])
                left = (self.seen - self.predict(new, there)).ravel()
                if left @ left < before:
                    p, x, miss, damping = new, there, left, damping / 10
                    break
                damping *= 20
            else:
                break
            if float(miss @ miss) > 0.998 * before:
                break
        return p, float(np.sqrt(np.mean(miss**2)))


def of(plant: Plant, line: Timeline, q: FloatArray, shown: Sequence[Shown]) -> Nominal:
    """The fit's problem: the motor as logged (on the grid) and recordings without noise, or with it."""
    times = np.concatenate([s.arrival for s in shown]) - plant.delay
    seen = np.concatenate([s.values for s in shown])
    thin = max(len(times) // MOST_FRAMES, 1)
    times, seen = times[::thin], seen[::thin]
    scene = Scene.still(times.size)
    if "translation_mm" in line.sides:
        scene.translation = line.at(line.sides["translation_mm"], times)
    if "rotation_deg" in line.sides:
        scene.rotation = line.at(line.sides["rotation_deg"], times)
    return Nominal(plant, line, q[::EVERY], line.t[::EVERY], times, seen, scene)


def left(plant: Plant, line: Timeline, causes: Sequence[Cause], shown: Sequence[Shown]) -> float:
    """rms per coordinate that the nominal model leaves of recordings that it was fitted to."""
    return of(plant, line, logged(line, causes), shown).fit()[1]
