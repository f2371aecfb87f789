"""A mechanism with its causes over time; what a sensor makes of it is the third family's."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.family.view import View
from tools.family_four.causes.base import Cause
from tools.family_four.mechanism import Demand, Mechanism
from tools.family_three import nominal
from tools.family_three import plant as third
from tools.family_three.line import Line, Part
from tools.family_three.plant import Shown, logged

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Plant:
    mechanism: Mechanism
    view: View | None  # none: an angle sensor alone
    delay: float  # s, nominal

    @property
    def alike(self) -> Any:
        """To the third family's functions: it has what they read."""
        return self


def tip(plant: Plant, line: Line, causes: Sequence[Cause], q: FloatArray | None = None) -> FloatArray:
    """The bending angle over time."""
    demand = Demand(line.q if q is None else q)
    for cause in causes:
        cause.act(line, plant.mechanism, demand)
    c = plant.mechanism.run(demand)
    for cause in causes:
        c = cause.bend(line, c)
    return c


def show(plant: Plant, line: Line, causes: Sequence[Cause], parts: Sequence[Part] | None = None) -> list[Shown]:
    """Recordings as the sensor shows them, without noise."""
    c = tip(plant, line, causes)
    return [third._shown(plant.alike, line, causes, part, c) for part in (line.parts if parts is None else parts)]


def rest(plant: Plant, line: Line, shown: Sequence[Shown], said: FloatArray) -> float:
    """rms per coordinate that the third family's refit leaves: play of degree 5, law of degree 7, delay, pose."""
    return nominal.of(plant.alike, line, said, shown).fit()[1]


def carried(plant: Plant, line: Line, noise: float = 0.0) -> float:
    """rms per coordinate by which the refit to the healthy calibration misses the unseen motion, from 4 s on."""
    shown = show(plant, line, ())
    calibration = nominal.of(plant.alike, line, line.q, shown[:1])
    calibration.seen = calibration.seen + np.random.default_rng(1).normal(size=calibration.seen.shape) * noise
    found = calibration.fit()[0]
    unseen = nominal.of(plant.alike, line, line.q, shown[-1:])
    miss = unseen.seen - unseen.predict(found, unseen.place(found[: nominal.WIDTH_DEGREE + 1]))
    return float(np.sqrt(np.mean(miss[unseen.times > unseen.times[0] + 4.0] ** 2)))


def gap(plant: Plant, line: Line, shown: Sequence[Shown], said: FloatArray) -> float:
    """rms per coordinate between recordings and what the healthy mechanism shows, given the log, at their stamps."""
    c = tip(plant, line, (), said)
    seen = [third.see(plant.alike, line, (), s.part, s.arrival - plant.delay, c) for s in shown]
    return float(np.sqrt(np.mean(np.concatenate([s.values - v for s, v in zip(shown, seen, strict=True)]) ** 2)))


__all__ = ["Line", "Part", "Plant", "Shown", "carried", "gap", "logged", "rest", "show", "tip"]
