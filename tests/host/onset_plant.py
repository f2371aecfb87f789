"""A motor, a play of constant width and a noisy image of it, for the tests of the board's onset detector."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from tautline import _native

REASON = dict(_native.ONSET_REASONS)
UNKNOWN = _native.ONSET_UNKNOWN


@dataclass
class Plant:
    """Lengths in encoder counts, times in s, images in px."""

    width: float = 600.0
    slope: float = 0.06  # px for a count
    noise: float = 0.05  # px, each coordinate
    blur: float = 1.0  # times that noise in every other frame, on average
    stated: bool = False  # each frame comes with its sigma
    speed: float = 350.0  # counts/s
    acceleration: float = 5000.0
    rate_hz: float = 25.0
    delay: float = 0.08  # true
    nominal_delay: float = 0.08
    quantised: bool = False  # encoder positions are whole counts
    lost: float = 0.0  # share of frames that never come
    blind: float = 0.0  # share of frames without a marker
    outliers: float = 0.0  # share of frames with the marker 20 px off; never two in a row
    jitter: float = 0.0  # of frame times, +- s
    curvature: float = 0.0  # relative change of slope, 1/count
    jump: float = 0.0  # px, of the image when the tip's direction changes
    angle: float = 0.7  # of the motion in the image, rad
    seed: int = 0
    config: dict = field(default_factory=dict)

    def path(self, turns):
        """Motor position each millisecond through turning points, trapezoidal speed."""
        parts = [np.array([turns[0]])]
        for a, b in pairwise(turns):
            distance, sign = abs(b - a), np.sign(b - a)
            speed = min(self.speed, np.sqrt(self.acceleration * distance))
            up = speed / self.acceleration
            cruise = distance / speed - up
            t = np.arange(1, int(np.ceil((2 * up + cruise) * 1000)) + 1) * 1e-3
            way = np.where(
                t < up,
                self.acceleration * t**2 / 2,
                np.where(
                    t < up + cruise,
                    speed * (t - up / 2),
                    distance - self.acceleration * np.clip(2 * up + cruise - t, 0, None) ** 2 / 2,
                ),
            )
            parts.append(a + sign * way)
        return np.concatenate(parts)

    def run(self, turns):
        """The detector's reversals (dict of columns) for a motor that goes through `turns`, and what it saw."""
        rng = np.random.default_rng(self.seed)
        q = self.path(np.asarray(turns, dtype=float))
        t = np.arange(len(q)) * 1e-3
        reach = abs(q).max() + self.width
        p = _native.Plays(np.array([-reach, reach]), np.full(2, self.width)).forward(q, float(q[0]))[0]
        arrival = np.arange(self.delay + 0.02 * rng.random(), t[-1] - 2e-3, 1 / self.rate_hz)
        arrival = arrival + rng.uniform(-self.jitter, self.jitter, len(arrival))
        arrival = arrival[(rng.random(len(arrival)) >= self.lost) & (arrival > self.delay)]
        arrival_us = np.round(arrival * 1e6).astype(np.uint64)
        scene = arrival_us * 1e-6 - self.delay
        tip = np.interp(scene, t, p)
        moved = np.concatenate([[0.0], np.diff(p)])
        last = np.maximum.accumulate(np.where(moved != 0, np.arange(len(p)), 0))
        side = np.sign(moved[last])[np.clip(np.searchsorted(t, scene) - 1, 0, None)]
        image = self.slope * (tip + self.curvature * tip**2 / 2) + side * self.jump / 2
        blurred = np.random.default_rng((self.seed, 3)).random(len(arrival)) < 0.5
        sigma = self.noise * np.where(blurred, self.blur, 1.0)
        u = 360 + image * np.cos(self.angle) + sigma * rng.normal(0, 1, len(arrival))
        v = 288 + image * np.sin(self.angle) + sigma * rng.normal(0, 1, len(arrival))
        wrong = np.random.default_rng((self.seed, 2)).random(len(arrival)) < self.outliers
        wrong[1:] &= ~wrong[:-1]
        u, v = u + 20 * wrong, v - 15 * wrong
        config = _native.OnsetConfig()
        config.delay_us = round(self.nominal_delay * 1e6)
        for name, value in self.config.items():
            setattr(config, name, value)
        detector = _native.OnsetDetector(config)
        reversals = detector.run(
            np.round(t * 1e6).astype(np.uint64),
            (np.floor(q) * 256 if self.quantised else np.round(q * 256)).astype(np.int32),
            arrival_us,
            np.round(u * 4096).astype(np.int32),
            np.round(v * 4096).astype(np.int32),
            np.round(sigma * self.stated * 4096).astype(np.int32),
            rng.random(len(arrival)) >= self.blind,
            np.zeros(len(arrival), bool),
        )
        seen_scene = arrival_us * 1e-6 - self.nominal_delay
        return reversals, detector, (seen_scene, np.interp(seen_scene, t, q))

    def turns(self, n, over=(250.0, 400.0), start=1.0):
        """Turning points of n reversals whose strokes are longer than the width by `over`."""
        rng = np.random.default_rng((self.seed, 1))
        steps = (self.width + rng.uniform(*over, n + 1)) * start * (-1.0) ** np.arange(n + 1)
        return np.concatenate([[0.0], np.cumsum(steps)])


def bound(plant, reversals, k, frames):
    """Cramer-Rao bound of the k-th reversal's knot, counts: unknown level (2), slope (2) and knot, true noise.

    From the frames that the detector had: those after its guard time, as many as it says.
    """
    scene, q = frames
    first = np.searchsorted(scene, int(reversals["turn_us"][k]) * 1e-6 + 0.020)
    x = reversals["direction"][k] * (q[first : first + reversals["frames"][k]] - reversals["q1"][k] / 256)
    beyond = x > plant.width
    jacobian = np.stack([np.ones(len(x)), np.where(beyond, x - plant.width, 0), np.where(beyond, -plant.slope, 0)])
    # Level and slope across the motion are nuisances of their own and tell nothing of the knot.
    return np.sqrt(np.linalg.inv(jacobian @ jacobian.T / plant.noise**2)[2, 2])


def measured(reversals):
    """Indices of reversals that carry a width with a sigma."""
    return np.flatnonzero((reversals["width"] != UNKNOWN) & (reversals["sigma"] != UNKNOWN))
