"""The motion to record next: phases of strokes of any amplitude, place, speed and rest within the rig's limits, each
the one that adds most to the expected information (information.py) for the time that it takes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pandas as pd
from scipy.stats import qmc

from tautline import trajectory
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.information import Outlook, Rivals
from tautline.diagnosis.segment import Segment
from tautline.recording import Motor
from tautline.trajectory import Trajectory

_POINTS = 10  # format: a trajectory has 1000 points a second, next_motion.csv 100
_KNOTS = 20  # tolerance: points of a trajectory from one knot of a planned motor to the next
_PERIOD_S = 0.08  # tolerance: s between observations that are planned
_SLOWEST, _FASTEST = 0.02, 0.3  # limit: of what is proposed, in shares of the motor's range a second
_SHORTEST = 0.05  # limit: strokes, in shares of the motor's range: shorter than most backlashes
_STROKE_S, _REST_S, _PHASE_S = 15.0, 8.0, 8.0  # limit: of a stroke and of a rest, at most; of a phase, about
_PER_SPEED = 10.0  # limit: acceleration over speed, 1/s
_WIDTHS = 1.2  # limit: of the stroke in widths B that takes the tip to both envelopes
_PHASES, _OF_SIMULATOR = 32, 8  # tolerance: phases to choose from, powers of 2; where a user's simulator runs each
_LONGEST_S, _SHORTEST_S = 60.0, 20.0  # limit: of a motion; a recording needs some blocks (gap.blocks)
_NO_MORE = 1e-3  # tolerance: nats: a phase that adds less ends a motion
_SWAY_MM, _SWAY_DEG, _SWAY_S = 2.0, 20.0, 17.0  # limit: amplitudes of the other axes, and their period in s


@dataclass(frozen=True)
class NextMotion:
    """A motion to be recorded next."""

    why: str  # what it is, in words
    motion: Trajectory
    information: float  # nats that it is expected to tell about which hypothesis is right
    entropy: float  # nats that are open


@dataclass(frozen=True)
class _Phase:
    """Strokes there and back between two positions of the motor, in its unit, with a rest at either end."""

    low: float
    high: float
    speed: float  # unit/s
    rest_s: float

    @property
    def cycles(self) -> int:
        """The number of strokes there and back, at least 1, that together take about _PHASE_S."""
        return max(1, round(_PHASE_S / (2 * ((self.high - self.low) / self.speed + self.rest_s))))

    @cached_property
    def strokes(self) -> Trajectory:
        """The motion from `low` to `high` and back, `cycles` times."""
        return self._strokes_through([self.low, *[self.high, self.low] * self.cycles], self.rest_s)

    def approach(self, width: float, range_: tuple[float, float]) -> Trajectory:
        """The motion from `low` to a point at least _WIDTHS `width` away and back, so that a backlash of `width`, unit
        of q, is driven through in both directions. range_: of the motor, which it does not leave."""
        far_end = self.low + _WIDTHS * width
        far_end = far_end if far_end <= range_[1] else max(range_[0], self.low - _WIDTHS * width)
        return self._strokes_through([self.low, far_end, self.low], rest_s=0.0)

    def move_from(self, q: float) -> Trajectory:
        """The motion from the position q, the rig's unit, to `low` at the phase's speed, without a rest; empty where q
        is `low`."""
        return self._strokes_through([q, self.low], rest_s=0.0)

    def _strokes_through(self, points: Sequence[float], rest_s: float) -> Trajectory:
        """The motion through these positions, the rig's unit, in their order, at the phase's speed, with a rest of
        rest_s at each."""
        return trajectory.through(points, self.speed, _PER_SPEED * self.speed, rest_s)


def plan_best_motion(fitter: Fitter, rivals: Rivals) -> NextMotion:
    """Plans the motion that is expected to tell most about which of the rivals is right; it lasts _LONGEST_S at most,
    unless its first phase alone takes longer. If the recordings moved other axes of a camera's instrument, a motion
    during which these sway is compared too."""
    axes = fitter.px and any(_moves_other_axes(s.motor) for s in fitter.segments)
    plans = [_plan(fitter, rivals, sway) for sway in ((False, True) if axes else (False,))]
    return max(plans, key=lambda plan: plan.information)


def table(motion: Trajectory, unit: str) -> pd.DataFrame:
    """The content of next_motion.csv at 100 Hz: t_s, q in the actuator's `unit`, and the other axes if they move."""
    columns = {"t_s": motion.t_s, f"q_{unit}": motion.q}
    if motion.translation_mm is not None:
        columns["translation_mm"] = motion.translation_mm
    if motion.rotation_deg is not None:
        columns["rotation_deg"] = motion.rotation_deg
    return pd.DataFrame(columns).iloc[::_POINTS]


def _plan(fitter: Fitter, rivals: Rivals, sway: bool) -> NextMotion:
    """As `plan_best_motion`, with the other axes at rest or swaying. Phases are added one after the other, each time
    the one that tells most per second, until nothing more is told or the time is up."""
    actuator, last = fitter.model.rig.actuator, _latest_recording(fitter)
    phases, width = _phases(fitter), float(fitter.model.width.max())
    segments = [_planned_segment(fitter, phase, width, sway) for phase in phases]
    # As many of the sensor's observations as one that is planned stands for.
    weight = _PERIOD_S * (len(last.arrival_s) - 1) / float(np.ptp(last.arrival_s))
    outlook = Outlook(fitter, rivals, segments, weight)
    chosen: list[int] = []
    information, seconds = 0.0, 0.0
    parts: list[Trajectory] = []
    while True:
        # Of each phase that is left: the motion to it, how long both last, and how many nats it would add.
        others = [i for i in range(len(phases)) if i not in chosen]
        position = phases[chosen[-1]].low if chosen else None
        transfers = {
            i: phases[i].move_from(position) if position is not None else phases[i].approach(width, actuator.range)
            for i in others
        }
        durations_s = {i: transfers[i].duration_s + phases[i].strokes.duration_s for i in others}
        gains = {
            i: outlook.expected([*chosen, i], seconds + duration_s) - information
            for i, duration_s in durations_s.items()
            if not chosen or seconds + duration_s <= _LONGEST_S
        }
        i = max(gains, key=lambda i: gains[i] / durations_s[i], default=None)
        if i is None or (seconds >= _SHORTEST_S and gains[i] < _NO_MORE):
            break
        chosen.append(i)
        parts += [transfers[i], phases[i].strokes]
        information, seconds = information + gains[i], seconds + durations_s[i]
    motion = trajectory.in_turn(*parts)
    if sway:
        motion = motion.with_sway(_SWAY_MM, _SWAY_DEG, _SWAY_S)
    why = _phases_in_words([phases[i] for i in chosen], actuator.unit) + (" while the other axes sway" if sway else "")
    return NextMotion(why, motion, information, rivals.entropy)


def _phases_in_words(phases: Sequence[_Phase], unit: str) -> str:
    """Describes a motion of these phases: its strokes, speeds and longest rest. unit: of q."""
    strokes = [phase.high - phase.low for phase in phases]
    speeds, rest = [phase.speed for phase in phases], max(phase.rest_s for phase in phases)
    of_strokes = f"strokes of {min(strokes):.2g} to {max(strokes):.2g} {unit}"
    return f"{of_strokes} at {min(speeds):.2g} to {max(speeds):.2g} {unit}/s with rests of up to {rest:.1f} s"


def _latest_recording(fitter: Fitter) -> Segment:
    """The recording that ends last, whatever the order in which they were given."""
    return max(fitter.segments, key=lambda segment: segment.end_s)


def _moves_other_axes(motor: Motor) -> bool:
    """Whether translation or rotation varies in a recording, so that the set-up is able to move these axes."""
    return any(x is not None and float(np.ptp(x)) > 0.0 for x in (motor.translation_mm, motor.rotation_deg))


def _phases(fitter: Fitter) -> list[_Phase]:
    """Phases to choose from. They are spread evenly over place, the logs of amplitude and speed, and the root of the
    rest; within the rig's range where the recordings have been, and no faster than they were. They are the second
    `count` points of Sobol's sequence: as even as the first, but without its origin, which is the shortest and slowest
    phase."""
    actuator = fitter.model.rig.actuator
    span = actuator.span
    low = max(actuator.range[0], min(float(s.motor.q.min()) for s in fitter.segments))
    high = min(actuator.range[1], max(float(s.motor.q.max()) for s in fitter.segments))
    fastest = max(_fastest(s.motor) for s in fitter.segments)
    fastest = min(max(fastest, _SLOWEST * span), _FASTEST * span)
    shortest = min(_SHORTEST * span, high - low)
    count = _PHASES if all(s.drive is None for s in fitter.segments) else _OF_SIMULATOR
    phases = []
    for of_stroke, of_place, of_speed, of_rest in qmc.Sobol(4, scramble=False).random(2 * count)[count:]:
        # Each number of the sequence, 0 to 1, places one property between its limits; stroke and speed geometrically.
        stroke = min(shortest * ((high - low) / shortest) ** of_stroke, _STROKE_S * fastest)
        speed = _SLOWEST * span * (fastest / (_SLOWEST * span)) ** of_speed
        from_ = low + of_place * (high - low - stroke)
        phases.append(_Phase(from_, from_ + stroke, max(speed, stroke / _STROKE_S), _REST_S * of_rest**2))
    return phases


def _fastest(motor: Motor) -> float:
    """The largest speed of a motor, the rig's unit per second. Samples of one and the same time tell none."""
    step_s, step = np.diff(motor.t_s), np.abs(np.diff(motor.q))
    later = step_s > 0.0
    return float(np.max(step[later] / step_s[later], initial=0.0))


def _planned_segment(fitter: Fitter, phase: _Phase, width: float, sway: bool) -> Segment:
    """A phase as a recording made after the last one. It has an observation every _PERIOD_S once the tip has been taken
    to both envelopes; only their times are meant, the observed values are 0. width: the widest B, unit of q; sway:
    whether the other axes sway."""
    last, actuator = _latest_recording(fitter), fitter.model.rig.actuator
    approach = phase.approach(width, actuator.range)
    motion = trajectory.in_turn(approach, phase.strokes)
    if sway:
        motion = motion.with_sway(_SWAY_MM, _SWAY_DEG, _SWAY_S)
    # The last point as well: a motor rests there.
    knots = np.union1d(np.arange(0, len(motion.t_s), _KNOTS), len(motion.t_s) - 1)
    translation, rotation = (None if x is None else x[knots] for x in (motion.translation_mm, motion.rotation_deg))
    motor = Motor(motion.t_s[knots], motion.q[knots], None, translation, rotation)
    scene = np.arange(approach.duration_s, motion.duration_s, _PERIOD_S)
    return replace(
        last,
        name="next motion",
        motor=motor,
        arrival_s=np.asarray(scene + fitter.model.delay_of(last.sensor), dtype=np.float64),
        observed=np.zeros((len(scene), last.observed.shape[1])),
        scored=np.ones(len(scene), dtype=bool),
        offset_s=last.end_s,
        repeats=None,
        drive=None if last.drive is None else last.drive.along(motor),
    )
