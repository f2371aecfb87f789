"""The motion that would best discriminate between fitted effects: of several motions within the rig's limits, the one
for which their predictions differ most."""

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

_POINTS = 10  # format: a trajectory has 1000 points a second, next_motion.csv 100
_PERIOD_S = 0.04  # tolerance: s between predictions that are compared
_SLOWEST, _FASTEST = 0.02, 0.3  # limit: of what is proposed, in shares of the motor's range a second
_SHORTEST, _LONGEST, _WIDTHS = 0.2, 0.5, 2.5  # limit: strokes, in shares of the motor's range; at least, in widths B
_SLOW = 0.25  # prior: of the fastest speed: what depends on speed differs between both
_PER_SPEED = 10.0  # limit: acceleration over speed, 1/s
_STROKES = 6  # tolerance: there and back, of a motion
_SINES_S = 60.0  # tolerance: s, of a motion of two sines
_SWAY_MM, _SWAY_DEG, _SWAY_S = 2.0, 20.0, 17.0  # limit: amplitudes of the other axes, and their period in s


@dataclass(frozen=True)
class NextMotion:
    """A motion to be recorded next."""

    why: str  # what it is, in words
    motion: Trajectory
    separation: float  # rms difference of the two fits' predictions that differ least, px or deg


def best(fitter: Fitter, fits: Sequence[Fit]) -> NextMotion | None:
    """The motion for which the predictions of these fits differ most: for which the smallest rms difference of any two
    of them is largest. None for fewer than two fits."""
    if len(fits) < 2:
        return None
    chosen: NextMotion | None = None
    for why, motion in _motions(fitter):
        predictions = [_prediction(fitter, fit, motion) for fit in fits]
        least = min(_rms_difference(a, b) for a, b in itertools.combinations(predictions, 2))
        if chosen is None or least > chosen.separation:
            chosen = NextMotion(why, motion, least)
    return chosen


def _rms_difference(a: np.ndarray, b: np.ndarray) -> float:
    """rms of the difference of two predictions (n, k), px or deg, where both are finite; 0 where they never are."""
    difference = (a - b)[np.isfinite(a - b)]
    return float(np.sqrt(np.mean(difference**2))) if len(difference) else 0.0


def table(motion: Trajectory, unit: str) -> pd.DataFrame:
    """The content of next_motion.csv at 100 Hz: t_s, q in the actuator's `unit`, and the other axes that move."""
    columns = {"t_s": motion.t_s, f"q_{unit}": motion.q}
    if motion.translation_mm is not None:
        columns["translation_mm"] = motion.translation_mm
    if motion.rotation_deg is not None:
        columns["rotation_deg"] = motion.rotation_deg
    return pd.DataFrame(columns).iloc[::_POINTS]


def _prediction(fitter: Fitter, fit: Fit, motion: Trajectory) -> np.ndarray:
    """(n, k) px or deg that a fit predicts for a motion after the last test, every _PERIOD_S."""
    motor = Motor(motion.t_s, motion.q, None, motion.translation_mm, motion.rotation_deg)
    scene = np.arange(0.0, motion.duration_s, _PERIOD_S)
    test = fitter.segments[-1]
    values = fit.state.at(test, fit.hypothesis)
    if test.drive is not None:
        motor = test.drive.along(motor).motor(values)
    path = simulate(fit.state.model, motor, scene, values, clock_offset_s=test.end_s)
    return path.image_px if fitter.px else path.c_deg[:, None]


def _moves_other_axes(motor: Motor) -> bool:
    """Whether translation or rotation varies in a recording, so that the set-up can move these axes."""
    return any(x is not None and float(np.ptp(x)) > 0.0 for x in (motor.translation_mm, motor.rotation_deg))


def _motions(fitter: Fitter) -> list[tuple[str, Trajectory]]:
    """[(what it is in words, motion)] to choose from, within the rig's range and the speeds that were recorded."""
    actuator = fitter.model.rig.actuator
    span = actuator.span
    fastest = max(float(np.abs(np.gradient(s.motor.q, s.motor.t_s)).max()) for s in fitter.segments)
    speed = min(max(fastest, _SLOWEST * span), _FASTEST * span)
    # Strokes are longer than the backlash, where half the range allows it.
    stroke = min(_LONGEST * span, max(_SHORTEST * span, _WIDTHS * float(fitter.model.width.max())))
    acceleration = _PER_SPEED * speed

    def strokes(rate: float, rest_s: float) -> Trajectory:
        """Strokes there and back at `rate`, in the motor's unit/s, with rests of rest_s between them."""
        return trajectory.trapezoids(actuator, rate, stroke, _STROKES, acceleration, rest_s)

    motions = [
        ("slow strokes with rests", strokes(_SLOW * speed, 2.0)),
        ("fast strokes with rests", strokes(speed, 2.0)),
        ("fast strokes with long rests", strokes(speed, 8.0)),
        ("two sines over the whole range", trajectory.sines(actuator, speed, _SINES_S)),
    ]
    if fitter.px and any(_moves_other_axes(s.motor) for s in fitter.segments):
        motions += [
            (f"{why} while the other axes sway", motion.with_sway(_SWAY_MM, _SWAY_DEG, _SWAY_S))
            for why, motion in motions[1:]
        ]
    return motions
