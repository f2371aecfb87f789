"""The motion that measures B where recordings of use did not: short strokes up and down through each gap."""

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

SECONDS = 20.0  # it lasts no longer, where the gaps let it
_STROKES = (3.0, 5.0, 8.0)  # of the widest B: the shorter, the more turns
_BACK = 1.4  # of the widest B: a stroke back, which gets through it
_LEAST_STROKE, _MOST_STROKE = 0.05, 0.8  # of the range; of the way through a gap
_QUICK = 8.0  # acceleration over speed, 1/s
_DWELL_S = 0.1
_WITHIN_S = 0.05  # over which a motor's speed in use is taken: its counts are no speed


def closing(model: Model, gaps: Sequence[Gap], recordings: Sequence[Recording]) -> Trajectory | None:
    """Plans a motion that measures B in the gaps where a calibration of recordings of use could not: short strokes
    through all gaps, from the lowest up, within the range and no faster than the motor went in `recordings` (which have
    a marker or an angle). None where there are no gaps. Of the plans that last at most SECONDS it is the one with most
    turns, then with most speeds; else the shortest."""
    if not gaps:
        return None
    actuator = model.rig.actuator
    usual_speeds = Means.of(*actuator.range, _frame_rate(recordings), math.inf, math.inf).speeds
    top = max(_top_speed(each.motor) for each in recordings)
    speeds = [speed * min(top / usual_speeds[0], 1.0) for speed in usual_speeds]
    widest = float(model.width[model.is_measured].max(initial=0.0))
    plans = [
        _join_with_moves([_strokes_through(actuator, gap, widest, times, speeds[:passes]) for gap in gaps], speeds[0])
        for times, passes in product(_STROKES, (2, 1))
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


def _strokes_through(actuator: Actuator, gap: Gap, widest: float, times: float, speeds: Sequence[float]) -> Trajectory:
    """The motion through one gap: up by strokes of `times` the widest B, each followed by a stroke back that is a
    little longer than the widest B; down again the same way; and a turn at the low end. widest: unit of q; speeds:
    unit/s, once up and down at each."""
    reach = widest + BESIDE * actuator.span
    low, high = max(gap.low - reach, actuator.range[0]), min(gap.high + reach, actuator.range[1])
    way = high - low
    stroke = min(max(times * widest, _LEAST_STROKE * actuator.span), _MOST_STROKE * way)
    advance = max(stroke - _BACK * widest, (1.0 - _MOST_STROKE) * stroke)
    pairs = math.ceil((way - stroke) / advance)
    within_gap = replace(actuator, range=(low, high))
    acceleration = _QUICK * speeds[0]
    passes = trajectory.back_and_forth(within_gap, speeds, stroke, 2 * pairs, acceleration, _DWELL_S)
    return trajectory.in_turn(passes, trajectory.through([low, low + stroke], speeds[0], acceleration))


def _join_with_moves(parts: Sequence[Trajectory], speed: float) -> Trajectory:
    """One trajectory of all parts in turn, with a move at `speed`, unit/s, from where each ends to where the next
    begins."""
    ways = [(before.q[-1], after.q[0]) for before, after in pairwise(parts)]
    moves = [trajectory.through(way, speed, _QUICK * speed) for way in ways]
    return trajectory.in_turn(parts[0], *(each for pair in zip(moves, parts[1:], strict=True) for each in pair))


def _frame_rate(recordings: Sequence[Recording]) -> float:
    """The median rate, Hz, at which the recordings' sensor (marker or angle) saw the tip."""
    shown = [each.marker or each.angle for each in recordings]
    return 1.0 / float(np.median(np.concatenate([np.diff(seen.t_s) for seen in shown if seen is not None])))


def _top_speed(motor: Motor) -> float:
    """The top speed of a motor in its log, unit of q per s, averaged over _WITHIN_S."""
    t_s = np.arange(motor.t_s[0], motor.t_s[-1], _WITHIN_S)
    moved = np.abs(np.diff(np.interp(t_s, motor.t_s, motor.q)))
    return float(moved.max(initial=0.0)) / _WITHIN_S
