"""The second instrument (tautline.blindtest.reality) under a motor that is driven: readings in, angles out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from tautline.blindtest.reality import Plant, Truth, driven
from tautline.simulated.instrument import preset
from tautline.trajectory import Trajectory

Array = npt.NDArray[np.float64]

ENCODER = "actuator.encoder_periodic"
# Effect -> how the second instrument does it, at three strengths. Lengths in mm of its 10 mm of range.
STRENGTHS: Mapping[str, tuple[Mapping[str, float], ...]] = {
    ENCODER: tuple({"encoder_period": 0.8, "encoder_error": e, "encoder_phase": 0.7} for e in (0.0075, 0.015, 0.03)),
    "transmission.smooth_onset": tuple({"softness": s} for s in (0.3, 0.6, 0.9)),
    "transmission.asymmetric_backlash": tuple({"latch": v, "latch_travel": 0.6} for v in (0.08, -0.15, 0.3)),
    "transmission.rate_dependent_backlash": tuple({"viscosity": v, "speed_scale": 6.0} for v in (0.03, 0.06, 0.12)),
    "transmission.lag": tuple({"dashpot": v} for v in (0.03, 0.07, 0.15)),
    "transmission.creep": tuple({"creep_share": s, "creep_time": 1.3} for s in (0.05, 0.1, 0.2)),
    "transmission.load_dependence": tuple(
        {"stretch_per_load": k * 2e-3, "capstan_per_load": k * 1e-3, "soften_per_load": k * 3e-4}
        for k in (1.0, 2.0, 4.0)
    ),
    "configuration.axis_coupling": tuple({"pull_by_translation": v} for v in (0.1, 0.25, 0.6)),
    "transmission.offset": tuple({"homing": v} for v in (0.05, -0.12, 0.3)),
}


def instrument() -> Plant:
    made = preset("reference")
    return Plant(made.rig, made.grid, made.width, made.c_deg, 0.0)


def shaft(truth: Truth, reading: Array) -> Array:
    """Where the motor is whose encoder reads that."""
    q = reading.copy()
    if period := truth("encoder_period"):
        for _ in range(30):
            angle = 2 * np.pi * q / period + truth("encoder_phase")
            q = reading - truth("encoder_error") * (np.sin(angle) + 0.15 * np.sin(2 * angle + 1.0))
    return q


def moved(
    plant: Plant, values: Mapping[str, float], t: Array, reading: Array, load: Array, translation: Array
) -> Array:
    """The tip's angle, deg."""
    truth = Truth(values)
    motion = Trajectory(t, shaft(truth, reading), translation_mm=translation)
    return driven(plant, truth, motion, 0.0, 1, load, np.random.default_rng(1)).c_deg
