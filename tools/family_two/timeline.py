"""One continuous motion: calibration, pause, tests, pause, unseen, on one uniform grid."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.family_two.motion import STEP, travel

FloatArray = NDArray[np.float64]
PAUSE = 8.0  # s between recordings, in which the motor goes to where the next one starts


@dataclass(frozen=True)
class Part:
    """One recording: where it lies on the grid and when its frames were exposed."""

    name: str
    first: int
    count: int
    exposed: FloatArray  # s, scene times

    @property
    def begin(self) -> float:
        return self.first * STEP

    @property
    def tested(self) -> bool:
        return self.name.startswith("test")


@dataclass(frozen=True)
class Timeline:
    t: FloatArray
    q: FloatArray  # as the motor's log would say it without error
    sides: dict[str, FloatArray]
    parts: tuple[Part, ...]
    reach: float
    width: float  # of the healthy mechanism in the middle, in units of q
    gain: float  # deg of the tip for a unit of q

    @property
    def speed(self) -> FloatArray:
        """Motor speed, units of q per second."""
        return np.asarray(np.gradient(self.q, STEP))

    @property
    def usual_speed(self) -> float:
        moving = np.abs(self.speed)
        return float(np.median(moving[moving > 1e-3 * self.reach]))

    @property
    def changed(self) -> float:
        """When what happened between calibration and tests has happened."""
        return (self.parts[0].first + self.parts[0].count) * STEP + PAUSE / 2

    def since(self, since: str) -> FloatArray:
        """1 where a cause is there, 0 where it is not yet."""
        return np.ones(self.t.size) if since == "start" else (self.t >= self.changed).astype(float)

    def at(self, values: FloatArray, times: FloatArray) -> FloatArray:
        """Values of the grid at other times."""
        return np.interp(times, self.t, values)


def lay(
    paths: list[tuple[str, FloatArray, dict[str, FloatArray], FloatArray]], reach: float, width: float, gain: float
) -> Timeline:
    """Recordings (name, motor, other joints, exposure times from their begin) one after the other."""
    q: list[FloatArray] = []
    sides: dict[str, list[FloatArray]] = {k: [] for k in paths[0][2]}
    parts: list[Part] = []
    first, here, last = 0, 0.0, dict.fromkeys(sides, 0.0)
    for name, path, others, exposed in paths:
        if parts:
            between = travel(here, [(float(path[0]), 2.0, PAUSE - 2.0)], True)[1:]
            q.append(between)
            for k, v in others.items():
                sides[k].append(last[k] + (v[0] - last[k]) * np.linspace(0, 1, between.size))
            first += between.size
        parts.append(Part(name, first, path.size, exposed + first * STEP))
        q.append(path)
        for k, v in others.items():
            sides[k].append(v)
            last[k] = float(v[-1])
        first += path.size
        here = float(path[-1])
    every = np.concatenate(q)
    joined = {k: np.concatenate(v) for k, v in sides.items()}
    t = np.arange(every.size, dtype=np.float64) * STEP
    return Timeline(t, every, joined, tuple(parts), reach, width, gain)
