"""A mechanism, its sensor, and what the sensor shows with some causes present."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tools.family_two import camera
from tools.family_two.camera import Scene, View
from tools.family_two.causes.base import Cause, IntArray
from tools.family_two.mechanism import Demand, Mechanism
from tools.family_two.timeline import Part, Timeline

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Plant:
    mechanism: Mechanism
    view: View | None
    delay: float  # s, as the rig says it
    healthy: dict[int, FloatArray] = field(default_factory=dict)  # the tip of a motion without causes, once computed


@dataclass(frozen=True)
class Shown:
    """One recording's rows without noise."""

    part: Part
    arrival: FloatArray
    values: FloatArray  # (n, 2) px or (n, 1) deg
    pick: IntArray  # of which frame each row is


def angle(plant: Plant, line: Timeline, causes: Sequence[Cause]) -> FloatArray:
    """The tip on the grid."""
    mine = [c for c in causes if type(c).act is not Cause.act]
    if not mine and id(line) in plant.healthy:
        c = plant.healthy[id(line)]
    else:
        demand = Demand.healthy(line.q)
        for cause in mine:
            cause.act(demand, line, plant.mechanism)
        c = plant.mechanism.run(demand)
        if not mine:
            plant.healthy[id(line)] = c
    for cause in causes:
        c = cause.bend(line, c)
    return c


def look(plant: Plant, line: Timeline, causes: Sequence[Cause], c: FloatArray, times: FloatArray) -> FloatArray:
    """What the sensor shows of the scene at `times`."""
    at = line.at(c, times)
    if plant.view is None:
        return at[:, None]
    scene = Scene.still(times.size)
    if "translation_mm" in line.sides:
        scene.translation = line.at(line.sides["translation_mm"], times)
    if "rotation_deg" in line.sides:
        scene.rotation = line.at(line.sides["rotation_deg"], times)
    for cause in causes:
        cause.pose(scene, line, c, times)
    return camera.project(plant.view, at, scene)


def show(plant: Plant, line: Timeline, causes: Sequence[Cause], parts: Sequence[Part] | None = None) -> list[Shown]:
    c = angle(plant, line, causes)
    out = []
    for part in line.parts if parts is None else parts:
        t = part.exposed
        early = sum((cause.early(line, t) for cause in causes), np.zeros(t.size))
        values = look(plant, line, causes, c, t - early)
        arrival = t + plant.delay
        pick = np.arange(t.size)
        for cause in causes:
            values = cause.image(line, part, values, plant.view)
            arrival = arrival + cause.late(line, t, arrival)
            pick = pick[cause.pick(line, part, t.size)]
        out.append(Shown(part, arrival, values[pick], pick))
    return out


def logged(line: Timeline, causes: Sequence[Cause]) -> FloatArray:
    """The motor's log on the grid, before it is rounded."""
    return line.q + sum((cause.logged(line, line.t, line.q) for cause in causes), np.zeros(line.t.size))


def gap(plant: Plant, line: Timeline, causes: Sequence[Cause]) -> float:
    """rms per coordinate between what the tests show and what the healthy mechanism's model says at their stamps."""
    healthy = angle(plant, line, [])
    wrong = logged(line, causes) - line.q
    total, count = 0.0, 0
    for shown in show(plant, line, causes, [p for p in line.parts if p.tested]):
        times = shown.arrival - plant.delay
        at = healthy + wrong * line.gain  # what is logged wrongly is predicted wrongly
        miss = shown.values - look(plant, line, [], at, times)
        total, count = total + float(np.sum(miss**2)), count + miss.size
    return float(np.sqrt(total / count))
