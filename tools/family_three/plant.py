"""A mechanism with its causes: what its sensor shows of each recording, without noise, and what its log says."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.family.view import View
from tools.family_three import camera
from tools.family_three.camera import Scene
from tools.family_three.causes.base import Cause
from tools.family_three.line import Line, Part
from tools.family_three.mechanism import Demand, Mechanism

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Plant:
    mechanism: Mechanism
    view: View | None  # none: an angle sensor alone
    delay: float  # s, nominal


@dataclass(frozen=True)
class Shown:
    part: Part
    arrival: FloatArray  # as stamped
    values: FloatArray  # (n, 2) px or (n, 1) deg, without noise
    pick: NDArray[np.intp]  # which frame each row is of


def logged(line: Line, causes: Sequence[Cause]) -> FloatArray:
    """The motor as its log has it, on the grid."""
    q = line.q
    for cause in causes:
        q = cause.log(line, q)
    return q


def tip(plant: Plant, line: Line, causes: Sequence[Cause], q: FloatArray | None = None) -> FloatArray:
    """The bending angle over time."""
    m = plant.mechanism
    demand = Demand(line.q if q is None else q)
    for cause in causes:
        cause.drive(line, m, demand)
    c = m.tip(m.run(demand))
    for cause in causes:
        c = cause.bend(line, c)
    return c


def show(plant: Plant, line: Line, causes: Sequence[Cause], parts: Sequence[Part] | None = None) -> list[Shown]:
    """Recordings as the sensor shows them."""
    c = tip(plant, line, causes)
    return [_shown(plant, line, causes, part, c) for part in (line.parts if parts is None else parts)]


def _shown(plant: Plant, line: Line, causes: Sequence[Cause], part: Part, c: FloatArray) -> Shown:
    times, arrival = part.exposed.copy(), part.exposed + plant.delay
    for cause in causes:
        times = times + cause.later(line, part, part.exposed, c)
        arrival = cause.stamps(line, part, arrival)
    values = see(plant, line, causes, part, times, c)
    pick = np.arange(times.size)
    for cause in causes:
        pick = cause.picks(line, part, pick, values)
    return Shown(part, arrival, values[pick], pick)


def see(plant: Plant, line: Line, causes: Sequence[Cause], part: Part, times: FloatArray, c: FloatArray) -> FloatArray:
    """What is seen at scene times."""
    at = line.at(c, times)
    if plant.view is None:
        return at[:, None]
    scene = Scene.still(times.size)
    if "translation_mm" in line.sides:
        scene.along = line.at(line.sides["translation_mm"], times)
    if "rotation_deg" in line.sides:
        scene.rotation = line.at(line.sides["rotation_deg"], times)
    for cause in causes:
        cause.scene(line, part, times, scene, at)
    seen = camera.picture(plant.view, at, scene)
    for cause in causes:
        seen = cause.picture(line, part, times, seen, plant.view)
    return seen


def gap(plant: Plant, line: Line, shown: Sequence[Shown], said: FloatArray) -> float:
    """rms per coordinate between recordings and what the healthy mechanism shows, given the log, at their stamps."""
    c = tip(plant, line, (), said)
    off = [s.values - see(plant, line, (), s.part, s.arrival - plant.delay, c) for s in shown]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2)))
