"""A cause as the fourth family has it, with what this family's mechanisms are asked."""

from typing import Any

import numpy as np

from tools.family.view import View
from tools.family_four.causes import base as four
from tools.family_four.causes.base import Line, Part, axis, follow, gates, play, rising, side, swings, tested
from tools.family_six.mechanism import STEP, Ask, FloatArray, Mechanism, asked
from tools.family_three.camera import Scene

Picks = np.typing.NDArray[np.intp]


class Cause(four.Cause):
    """One thing that is wrong; `ask` is where it acts on the mechanism."""

    def act(self, line: Line, m: Any, d: Any) -> None:
        self.ask(line, m, asked(d))

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        """What the mechanism is asked."""

    def span(self, line: Line) -> tuple[float, float]:
        """s: from when on it is there, and the end of the tests."""
        return (0.0 if self.since == "start" else float(line.changed)), tested(line)[1]

    def gate(self, line: Line, times: FloatArray) -> FloatArray:
        """1 where it is there, at these times (n,) in s."""
        return line.at(self.on(line), times)

    def sign(self, k: int = 0) -> float:
        """-1 or 1, drawn once."""
        return float(np.random.default_rng([self.seed, 77, k]).choice([-1.0, 1.0]))


__all__ = [
    "STEP", "Ask", "Cause", "FloatArray", "Line", "Mechanism", "Part", "Picks", "Scene", "View", "axis", "follow",
    "gates", "play", "rising", "side", "swings", "tested",
]  # fmt: skip
