"""The reference instrument, a short recording of it and a model that knows its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tautline import trajectory
from tautline.model import Model
from tautline.recording import Recording, save
from tautline.simulated import instrument, simulate

RIG = instrument.reference_rig()
PLANT = instrument.preset("reference", RIG)


def moved(points: list[float], speed: float, **options: object) -> Recording:
    return simulate.simulate(RIG, PLANT, trajectory.through(points, speed, 20.0), **options)


def saved_recording(path: Path) -> Path:
    save(moved([-2.0, 1.0, -1.0, 2.0, -2.0], 2.0), path)
    return path


def saved_model(path: Path) -> Path:
    q = np.linspace(-5, 5, 101)
    Model(RIG, q, PLANT.backlash(q), 0.01 + 0 * q, PLANT.bend(q), 0.08, (-4.0, 4.0)).save(path)
    return path
