"""What a cause is: a strength, since when, and the places in which it acts."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tools.family_two.camera import Scene, View
from tools.family_two.friction import project
from tools.family_two.mechanism import Demand, Mechanism
from tools.family_two.ranges import Range
from tools.family_two.timeline import Part, Timeline

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]


@dataclass(frozen=True)
class Cause:
    size: float
    since: str  # "start": there while calibrating; "test": from then on
    seed: int

    id: ClassVar[str]
    says: ClassVar[str]
    limits: ClassVar[Range]
    unlisted: ClassVar[bool] = False
    may_start: ClassVar[bool] = True
    moves: ClassVar[bool] = False  # recalibration closes it
    needs_camera: ClassVar[bool] = False
    needs_column: ClassVar[str] = ""
    massless: ClassVar[bool] = False  # of mechanisms without mass alone
    sections: ClassVar[bool] = False  # of bending sections alone

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(self.seed)

    def on(self, line: Timeline) -> FloatArray:
        return line.since(self.since)

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {}

    # --- where it acts; what does nothing is as it stands here

    def logged(self, line: Timeline, t: FloatArray, q: FloatArray) -> FloatArray:
        """What the motor's log shows too much."""
        return np.zeros(t.size)

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        """On the mechanism, in place."""

    def bend(self, line: Timeline, c: FloatArray) -> FloatArray:
        """On the tip behind the friction."""
        return c

    def early(self, line: Timeline, t: FloatArray) -> FloatArray:
        """By how much earlier than it should a frame was exposed, s."""
        return np.zeros(t.size)

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        """On what the camera sees, in place; c on the grid, t of the frames."""

    def image(self, line: Timeline, part: Part, seen: FloatArray, view: View | None) -> FloatArray:
        """On what the tracker says, a part at a time."""
        return seen

    def late(self, line: Timeline, t: FloatArray, arrival: FloatArray) -> FloatArray:
        """By how much later stamps are, s."""
        return np.zeros(t.size)

    def pick(self, line: Timeline, part: Part, count: int) -> IntArray:
        """Which frame's value each row shows."""
        return np.arange(count)


def side(c: FloatArray, width: float) -> FloatArray:
    """-1 to 1: which side of a gap `width` wide the drag has something lean on."""
    half = 0.5 * width
    return np.asarray((c - project(c - half, c + half, float(c[0]))) / half)


def follow(values: FloatArray, step: float, tau: float) -> FloatArray:
    """First-order low pass, exact for values that are linear between samples."""
    from scipy.signal import lfilter

    a = float(np.exp(-step / tau))
    r = tau / step
    b0, b1 = 1 - r * (1 - a), r * (1 - a) - a
    out, _ = lfilter([b0, b1], [1.0, -a], values[1:] - values[0], zi=np.zeros(1))
    return np.concatenate([values[:1], out + values[0]])
