"""Plans the motion that measures the backlash B where recordings of use did not: short strokes up and down through each
gap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path

import numpy as np

from tautline import trajectory
from tautline.calibration.coverage import Gap
from tautline.diagnosis.motion import table
from tautline.folders import write_file
from tautline.live.rounds import BESIDE, Means
from tautline.model import Model
from tautline.recording import Motor, Recording
from tautline.rig import Actuator
from tautline.trajectory import NEXT_FILE, Trajectory

SECONDS = 20.0  # the motion lasts no longer than this if the gaps allow it
_STROKES = (
    3.0,
    5.0,
    8.0,
)  # length of a stroke in times the widest B, as tried in turn: shorter strokes have more turns
_BACK = 1.4  # length of the stroke back in times the widest B: above 1, so that it crosses the backlash
_LEAST_STROKE, _MOST_STROKE = 0.05, 0.8  # limits of a stroke: share of the range; share of the way through a gap
_QUICK = 8.0  # acceleration over speed, 1/s
_DWELL_S = 0.1
_WITHIN_S = 0.05  # window over which a motor's speed in use is averaged: single encoder counts give no speed


def closing(model: Model, gaps: Sequence[Gap], recordings: Sequence[Recording]) -> Trajectory | None:
    """Plans a motion that measures B in the gaps where a calibration of recordings of use could not: short strokes
    through all gaps, from the lowest up, within the range and no faster than the motor went in `recordings` (which have
    a marker or an angle). Plans are made for each stroke of _STROKES at two speeds, then at one; returns the first that
    lasts at most SECONDS, else the shortest. None where there are no gaps."""
    if not gaps:
        return None
    actuator = model.rig.actuator
    # The speeds of a live calibration's rounds here, without the motor's limits, which are not known: inf.
    usual_speeds = Means.of(*actuator.range, _frame_rate(recordings), math.inf, math.inf).speeds
    top_speed = max(_top_speed(each.motor) for each in recordings)
    speeds = [speed * min(top_speed / usual_speeds[0], 1.0) for speed in usual_speeds]
    widest = float(model.width[model.is_measured].max(initial=0.0))
    plans = [
        _join_with_moves(
            [_strokes_through(actuator, gap, widest, stroke_in_widths, speeds[:passes]) for gap in gaps], speeds[0]
        )
        for stroke_in_widths, passes in product(_STROKES, (2, 1))
    ]
    return next((plan for plan in plans if plan.duration_s <= SECONDS), min(plans, key=lambda plan: plan.duration_s))


def write(model: Model, gaps: Sequence[Gap], recordings: Sequence[Recording], folder: Path) -> float | None:
    """Writes the motion of `closing`, for 'taut record --motion', into a MODEL folder (NEXT_FILE). Returns how long it
    lasts, s; None where there are no gaps, or the model is unusable: nothing is written then."""
    motion = closing(model, gaps, recordings) if model.quality.usable else None
    if motion is None:
        return None
    write_file(folder / NEXT_FILE, table(motion, model.rig.actuator.unit).to_csv(index=False, float_format="%.6f"))
    return motion.duration_s


def _strokes_through(
    actuator: Actuator, gap: Gap, widest: float, stroke_in_widths: float, speeds: Sequence[float]
) -> Trajectory:
    """Plans the motion through one gap: up by strokes of `stroke_in_widths` times the widest B, each followed by a
    stroke back that is a little longer than the widest B; down again the same way; and a turn at the low end. widest:
    the widest B, unit of q; speeds: unit/s, once up and down at each."""
    reach = widest + BESIDE * actuator.span  # how far the strokes go on beyond the gap, within the range
    low, high = max(gap.low - reach, actuator.range[0]), min(gap.high + reach, actuator.range[1])
    way = high - low
    stroke = min(max(stroke_in_widths * widest, _LEAST_STROKE * actuator.span), _MOST_STROKE * way)
    advance = max(stroke - _BACK * widest, (1.0 - _MOST_STROKE) * stroke)  # by one stroke and the one back
    pairs = math.ceil((way - stroke) / advance)  # of a stroke and one back, before the last stroke reaches the end
    within_gap = replace(actuator, range=(low, high))
    acceleration = _QUICK * speeds[0]
    passes = trajectory.back_and_forth(within_gap, speeds, stroke, 2 * pairs, acceleration, _DWELL_S)
    return trajectory.in_turn(passes, trajectory.through([low, low + stroke], speeds[0], acceleration))


def _join_with_moves(parts: Sequence[Trajectory], speed: float) -> Trajectory:
    """Returns one trajectory of all parts in turn, with a move at `speed`, unit/s, from the end of each part to the
    beginning of the next."""
    ways = [(before.q[-1], after.q[0]) for before, after in pairwise(parts)]
    moves = [trajectory.through(way, speed, _QUICK * speed) for way in ways]
    return trajectory.in_turn(parts[0], *(each for pair in zip(moves, parts[1:], strict=True) for each in pair))


def _frame_rate(recordings: Sequence[Recording]) -> float:
    """Returns the rate, Hz, at which the recordings saw the tip: 1 over the median time between two samples of the
    marker, or of the angle where a recording has no marker."""
    sensors = [each.marker or each.angle for each in recordings]
    return 1.0 / float(np.median(np.concatenate([np.diff(sensor.t_s) for sensor in sensors if sensor is not None])))


def _top_speed(motor: Motor) -> float:
    """Returns the top speed in a motor's log, unit of q per s: the largest mean over a window of _WITHIN_S; 0 for a log
    that is shorter."""
    t_s = np.arange(motor.t_s[0], motor.t_s[-1], _WITHIN_S)
    moved = np.abs(np.diff(np.interp(t_s, motor.t_s, motor.q)))
    return float(moved.max(initial=0.0)) / _WITHIN_S
