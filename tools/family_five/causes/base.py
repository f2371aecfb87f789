"""A cause as the fourth family has it, with what this family's mechanisms are asked."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.family.view import View
from tools.family_five.mechanism import Ask, Mechanism, asked
from tools.family_four.causes import base as four
from tools.family_four.causes.base import STEP, Line, Part, axis, follow, gates, play, rising, side, swings, tested
from tools.family_three.camera import Scene

FloatArray = NDArray[np.float64]
Picks = NDArray[np.intp]


class Cause(four.Cause):
    """One thing that is wrong; `ask` is where it acts on the mechanism."""

    def act(self, line: Line, m: Any, d: Any) -> None:
        self.ask(line, m, asked(d))

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        """What the mechanism is asked."""

    def clock(self, line: Line) -> FloatArray:
        """Seconds since it is there."""
        return np.asarray(np.maximum(line.t - (0.0 if self.since == "start" else line.changed), 0.0))


def events(rng: np.random.Generator, line: Line, on: FloatArray, apart: tuple[float, float]) -> list[float]:
    """Times within recordings, `apart` seconds from each other, while a cause is there."""
    every = np.cumsum(rng.uniform(*apart, round(line.t[-1] / apart[0]) + 1))
    return [t for t in every.tolist() if t < line.t[-1] and on[round(t / STEP) - 1] > 0]


def pulses(line: Line, times: list[float], sizes: FloatArray, shape: FloatArray) -> FloatArray:
    """A shape (on the grid's steps) that begins at each time."""
    out = np.zeros(line.t.size)
    for time, size in zip(times, sizes.tolist(), strict=False):
        first = min(round(time / STEP), out.size)
        piece = shape[: out.size - first]
        out[first : first + piece.size] += size * piece
    return out


def moving(line: Line) -> FloatArray:
    """0 at rest to 1 in motion."""
    return np.asarray(np.minimum(np.abs(line.speed) / (0.1 * line.usual_speed), 1.0))


__all__ = [
    "STEP", "Ask", "Cause", "FloatArray", "Line", "Mechanism", "Part", "Picks", "Scene", "View", "axis", "events",
    "follow", "gates", "moving", "play", "pulses", "rising", "side", "swings", "tested",
]  # fmt: skip
