"""A cause: what differs from the healthy mechanism, at the places of the chain where physics lets it act."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from tools.family.line import Line
from tools.family.ranges import Range


@dataclass
class Cause:
    """`size` is its strength in the unit of `limits`; `since` is "test" (not while calibrating) or "start".

    Each method says where it acts; what a cause leaves alone it does not define. Random draws come from `seed`
    only, so a cause of another size is the same cause, weaker or stronger.
    """

    size: float
    since: str
    seed: int

    id: ClassVar[str]
    limits: ClassVar[Range]
    says: ClassVar[str]  # the physics, in a sentence
    needs_camera: ClassVar[bool] = False
    needs_angle: ClassVar[bool] = False
    needs_column: ClassVar[str] = ""
    may_start: ClassVar[bool] = True  # whether it may be there while calibrating
    moves: ClassVar[bool] = False  # recalibration would close it: strength is the gap before
    unlisted: ClassVar[bool] = False

    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, 77])

    def on(self, line: Line) -> np.ndarray:
        return line.used if self.since == "test" else np.ones_like(line.t)

    def parameters(self, line: Line) -> dict[str, float | str]:
        """What it is, in numbers a person can read."""
        return {}

    # what the motor's position adds before the mechanism, unit of q, (n,)
    def drive(self, line: Line) -> np.ndarray | float:
        return 0.0

    # the friction bounds' factors, rising and falling, each (n,)
    def friction(self, line: Line) -> tuple[np.ndarray | float, np.ndarray | float]:
        return 1.0, 1.0

    # breakaway beyond the kinetic bound: (rising, falling, ageing) shares (n,) and the tip's travel that ends it, deg
    def breakaway(self, line: Line) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
        return None

    # unevenness of a backbone's joints, (n,)
    def spread(self, line: Line) -> np.ndarray | None:
        return None

    # what the configuration becomes, deg, (n,) -> (n,)
    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        return c

    # what the arcs' angles become, (n, ARCS) -> (n, ARCS)
    def shape(self, line: Line, pieces: np.ndarray) -> np.ndarray:
        return pieces

    # hand-eye angles (n, 3) deg and translation (n, 3) mm that are added
    def hand_eye(self, line: Line, c: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
        return None

    # distortion that is added, (n, 5)
    def lens(self, line: Line) -> np.ndarray | None:
        return None

    # what the image (or the angle) becomes, (n, 1 or 2)
    def sight(self, line: Line, image: np.ndarray) -> np.ndarray:
        return image

    # seconds that the scene is seen late beyond the healthy delay at frames, without the stamps knowing, (n frames,)
    def late(self, line: Line, scene: np.ndarray, part: int) -> np.ndarray | float:
        return 0.0

    # the measured motor position's error at times t (case clock), unit of q
    def encoder(self, line: Line, t: np.ndarray, q: np.ndarray, part: int) -> np.ndarray | float:
        return 0.0


def follow(line: Line, values: np.ndarray, tau: np.ndarray | float) -> np.ndarray:
    """First-order lag with time constant tau, exact for values that are straight between instants."""
    step = np.diff(line.t)
    taus = np.broadcast_to(np.asarray(tau, dtype=float), line.t.shape)[1:]
    decay = np.exp(-step / taus)
    blend = (1 - decay) * taus / step  # of a ramp's slope
    out = np.empty_like(values)
    y = out[0] = values[0]
    for i, (x0, x1, a, b) in enumerate(
        zip(values[:-1].tolist(), values[1:].tolist(), decay.tolist(), blend.tolist(), strict=True), 1
    ):
        y = x1 - (x1 - x0) * b + (y - x0) * a
        out[i] = y
    return out


def slider(values: np.ndarray, play: float) -> np.ndarray:
    """Where a body rests that a gap of `play` drags along, from -1 to 1: which side of the gap touches."""
    out = np.empty_like(values)
    s, half, last = 0.0, play / 2, float(values[0])
    for i, x in enumerate(values.tolist()):
        s = min(max(s + (x - last) / half, -1.0), 1.0)
        last = x
        out[i] = s
    return out
