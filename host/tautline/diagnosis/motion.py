"""The motion that would best tell effects apart: of several kinds within the rig's limits, the one whose simulations
differ most between the candidates."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from tautline import trajectory
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit
from tautline.effects import simulate
from tautline.recording import Motor
from tautline.trajectory import Trajectory


@dataclass(frozen=True)
class NextMotion:
    why: str
    motion: Trajectory
    separation: float  # rms between the two candidates that differ least, px or deg


def best(fitter: Fitter, fits: Sequence[Fit]) -> NextMotion | None:
    """The motion for which the simulations of these fits differ most (the smallest rms between two of them is largest);
    None for fewer than two fits."""
    if len(fits) < 2:
        return None
    chosen: NextMotion | None = None
    for why, motion in _motions(fitter):
        images = [_prediction(fitter, fit, motion) for fit in fits]
        least = min(_apart(a, b) for a, b in itertools.combinations(images, 2))
        if chosen is None or least > chosen.separation:
            chosen = NextMotion(why, motion, least)
    return chosen


def _apart(one: np.ndarray, other: np.ndarray) -> float:
    """rms of the difference of two predictions (n, k); 0 where no instant has both: such a motion tells nothing."""
    off = (one - other)[np.isfinite(one - other)]
    return float(np.sqrt(np.mean(off**2))) if len(off) else 0.0


def table(motion: Trajectory, unit: str) -> pd.DataFrame:
    """next_motion.csv: t_s, q and the other degrees of freedom that move, at 100 Hz."""
    columns = {"t_s": motion.t_s, f"q_{unit}": motion.q}
    if motion.translation_mm is not None:
        columns["translation_mm"] = motion.translation_mm
    if motion.rotation_deg is not None:
        columns["rotation_deg"] = motion.rotation_deg
    return pd.DataFrame(columns).iloc[::10]  # a trajectory has 1000 points a second


def _prediction(fitter: Fitter, fit: Fit, motion: Trajectory) -> np.ndarray:
    """(n, k) px or deg that a fit predicts for a motion, every 40 ms, after the last test."""
    motor = Motor(motion.t_s, motion.q, None, motion.translation_mm, motion.rotation_deg)
    scene = np.arange(0.0, motion.duration_s, 0.04)
    test = fitter.segments[-1]
    values = fit.state.at(test, fit.hypothesis)
    if test.drive is not None:
        motor = test.drive.along(motor).motor(values)
    path = simulate(fit.state.model, motor, scene, values, clock_offset_s=test.end_s)
    return path.image_px if fitter.px else path.c_deg[:, None]


def _moves_other_axes(motor: Motor) -> bool:
    """Whether the set-up moves another axis: what it cannot do nobody should be asked for."""
    return any(x is not None and float(np.ptp(x)) > 0.0 for x in (motor.translation_mm, motor.rotation_deg))


def _motions(fitter: Fitter) -> list[tuple[str, Trajectory]]:
    """Motions to choose from, each with what it is in words, within the rig's range and the speeds that were
    recorded."""
    actuator = fitter.model.rig.actuator
    span = actuator.span
    fastest = max(float(np.abs(np.gradient(s.motor.q, s.motor.t_s)).max()) for s in fitter.segments)
    speed = min(max(fastest, 0.02 * span), 0.3 * span)
    # Strokes are longer than the backlash, where half the range allows it.
    stroke = min(0.5 * span, max(0.2 * span, 2.5 * float(fitter.model.width.max())))
    quick = 10.0 * speed  # acceleration, unit/s^2

    def steps(rate: float, dwell: float) -> Trajectory:
        """Six strokes there and back at `rate`, in the motor's unit/s, with rests of `dwell` s."""
        return trajectory.trapezoids(actuator, rate, stroke, 6, quick, dwell)

    motions = [
        ("slow strokes with rests", steps(0.25 * speed, 2.0)),
        ("fast strokes with rests", steps(speed, 2.0)),
        ("fast strokes with long rests", steps(speed, 8.0)),
        ("two sines over the whole range", trajectory.sines(actuator, speed, 60.0)),
    ]
    if fitter.px and any(_moves_other_axes(s.motor) for s in fitter.segments):
        # By 2 mm and 20 deg, with a period of 17 s.
        swaying = [(f"{why} while the other axes sway", m.with_sway(2.0, 20.0, 17.0)) for why, m in motions[1:]]
        motions += swaying
    return motions
