"""What a cause is, and what several share."""

import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tools.family.ranges import Range
from tools.family_three.line import Line, Part
from tools.family_two.motion import STEP

if TYPE_CHECKING:
    from tools.family.view import View
    from tools.family_three.camera import Scene
    from tools.family_three.mechanism import Demand, Mechanism

FloatArray = NDArray[np.float64]
Picks = NDArray[np.intp]


@dataclass(frozen=True)
class Cause:
    """One thing that is wrong. Each method is a place of the chain where it may act; by default it does nothing."""

    size: float  # in the unit of `limits`
    since: str  # "start" or "test"
    seed: int

    id: ClassVar[str]
    says: ClassVar[str]
    limits: ClassVar[Range]
    unlisted: ClassVar[bool] = False
    may_start: ClassVar[bool] = True  # it can have been there while calibrating
    moves: ClassVar[bool] = False  # recalibration closes it
    needs_camera: ClassVar[bool] = False
    needs_column: ClassVar[str] = ""
    sections: ClassVar[bool] = False  # bending sections only
    massless: ClassVar[bool] = False  # not where the tip's mass is in the balance

    def rng(self) -> np.random.Generator:
        return np.random.default_rng([self.seed, zlib.crc32(self.id.encode())])

    def there(self, line: Line, part: Part) -> bool:
        return self.since == "start" or part.begin >= line.changed

    def on(self, line: Line) -> FloatArray:
        return line.since(self.since)

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        """What the motor's log says."""
        return q

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        """What the mechanism is asked."""

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        """The bending angle behind the friction."""
        return c

    def later(self, line: Line, part: Part, times: FloatArray, c: FloatArray) -> FloatArray:
        """By how much later than its stamp says a frame was exposed, s."""
        return np.zeros(times.size)

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        """Where things are when the frame is exposed."""

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        """Where in the picture the marker is found."""
        return seen

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        return arrival

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        """Which frame each row is of."""
        return pick

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {}


def follow(x: FloatArray, tau: float, step: float = STEP) -> FloatArray:
    """First-order low-pass that begins at rest."""
    a = float(np.exp(-step / tau))
    return np.asarray(lfilter([1 - a], [1, -a], x - x[0]) + x[0])


def swings(x: FloatArray, rate: float, damping: float, step: float = STEP) -> FloatArray:
    """A lightly damped mass on what moves by x, exactly for inputs held over a step."""
    w = 2 * np.pi * rate
    d = w * np.sqrt(1 - damping**2)
    e, cos, sin = np.exp(-damping * w * step), np.cos(d * step), np.sin(d * step)
    k = damping * w / d
    b = [0.0, 1 - e * (cos + k * sin), e * e + e * (k * sin - cos)]
    return np.asarray(lfilter(b, [1, -2 * e * cos, e * e], x - x[0]) + x[0])


def side(c: FloatArray, travel: float) -> FloatArray:
    """-1 to 1: which way the tip last moved, turned over within `travel`."""
    from tools.family_three.friction import project

    half = travel / 2
    return np.asarray((c - project(c - half, c + half, float(c[0]))) / half)


def rising(arrival: FloatArray, least: float = 2e-4) -> FloatArray:
    """Stamps in order."""
    ramp = least * np.arange(arrival.size)
    return np.asarray(np.maximum.accumulate(arrival - ramp) + ramp)


def axis(rng: np.random.Generator) -> FloatArray:
    """A direction."""
    v = rng.normal(size=3)
    return np.asarray(v / np.linalg.norm(v))


def tested(line: Line) -> tuple[float, float]:
    """When tests begin and end."""
    tests = [p for p in line.parts if p.tested]
    return tests[0].begin, tests[-1].begin + tests[-1].count * STEP


def gates(rng: np.random.Generator, t: FloatArray, on: tuple[float, float], off: tuple[float, float]) -> FloatArray:
    """1 and 0 in turn, for drawn times."""
    n = int(t[-1] / (on[0] + off[0])) + 2
    spans = np.stack([rng.uniform(*off, n), rng.uniform(*on, n)], axis=1).ravel()
    return np.asarray(np.searchsorted(np.cumsum(spans), t) % 2, dtype=float)
