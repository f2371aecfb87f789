"""What a user's simulator errs by because it goes in steps of time, where that shows beside the sensor's noise.

Half the step halves the error of an integrator of first order, as MuJoCo's are: between a run and one at half of its
step lies half of its error, and twice the finer less the coarser is without it (Richardson).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.diagnosis import gap
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.joint import Noise
from tautline.diagnosis.segment import Segment, prepare
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulators.nominal import StepError, nominal
from tautline.simulators.simulator import Simulator
from tautline.simulators.stepless import stepless

Array = npt.NDArray[np.float64]

_HALVINGS = 4  # tolerance: of the step: the last run costs 32 times the simulator's own
_SECOND = 3.0  # equation: 2^2 - 1: what lies between two of second order, the finer at half of the other's step
_FITTED = 0.2  # prior: probability that a file's values were fitted at its own step, whose error is then in them


def without_step_error(
    simulator: Simulator, robots: Sequence[Recording], rig: Rig
) -> tuple[Simulator, StepError | None]:
    """(The simulator without the error of its steps, that error at its own step). The simulator itself and None are
    returned where its step is not known, where the error is no larger than what a sound calibration leaves, and where
    the robot's recordings are likelier with the error: the simulator's values were then fitted at that step, and hold
    there. TautError where nothing can be compared, or the simulator fails."""
    if simulator.at_step is None or simulator.step_s is None:
        return simulator, None
    own = _Shown.by(simulator, robots, rig)
    floor = gap.noise_floor(own.segments, own.left)
    least = float(np.sqrt(learnt().center.calibration_excess)) * floor
    half = _Shown.by(simulator.at_step(0.5 * simulator.step_s), robots, rig)
    if 2.0 * own.apart(half) <= least:  # half of the error lies between both: it is of first order in the step
        return simulator, None
    limit = _without_steps(simulator, simulator.step_s, robots, rig, least)
    if not _finer_is_likelier(limit.left, own.left, floor):
        return simulator, None
    error = own.apart(limit)
    return limit.simulator, StepError(
        simulator.step_s, simulator.step_s * least / error, error, floor, own.segments[0].unit
    )


def _without_steps(simulator: Simulator, own_s: float, robots: Sequence[Recording], rig: Rig, least: float) -> _Shown:
    """What the simulator shows without its steps, by `stepless`, of second order in the step. The step is halved, from
    own_s (its own, s), and the longest one is used at which the error is at most `least`, px or deg; the shortest of
    _HALVINGS if none is. The error at the finer of two steps is a third of the difference between both, that at the
    coarser four thirds."""
    coarser = _Shown.by(stepless(simulator, own_s), robots, rig)
    for halving in range(1, _HALVINGS + 1):
        finer = _Shown.by(stepless(simulator, 0.5**halving * own_s), robots, rig)
        finer_off = coarser.apart(finer) / _SECOND
        if 4.0 * finer_off <= least:  # equation: twice the step is off by four times as much
            return coarser
        if finer_off <= least:
            break
        coarser = finer
    return finer


@dataclass(frozen=True)
class _Shown:
    """What a simulator shows of the robot's recordings, n observations each, of which the scored ones count. k: 2 px of
    a marker, or 1 deg of an angle."""

    simulator: Simulator
    segments: list[Segment]
    seen: list[Array]  # (n, k) of each recording

    @classmethod
    def by(cls, simulator: Simulator, robots: Sequence[Recording], rig: Rig) -> _Shown:
        """Runs the simulator under the motions of these recordings of the robot."""
        found = nominal(simulator, robots, rig)
        segments = prepare(found.model, found.calibration, found.tests, found.drives)[1:]
        return cls(simulator, segments, [segment.predict(found.model, {}, 0.0)[1] for segment in segments])

    @property
    def left(self) -> list[Array]:
        """(scored, k) of each recording, px or deg: the residual, what the robot's sensor observed minus `seen`."""
        return [(s.observed - seen)[s.scored] for s, seen in zip(self.segments, self.seen, strict=True)]

    def apart(self, other: _Shown) -> float:
        """The rms difference to what `other` shows, px or deg, in the recording in which it is largest."""
        pairs = zip(self.segments, self.seen, other.seen, strict=True)
        return max(gap.rms([(mine - theirs)[s.scored]]) for s, mine, theirs in pairs)


def _finer_is_likelier(after: Sequence[Array], before: Sequence[Array], floor: float) -> bool:
    """Whether the finer simulator, which leaves `after`, is likelier than the one at its own step, which leaves
    `before`. The noise is that of the better one, and the prior says that a share _FITTED of files is fitted at its own
    step. after, before: residuals (scored, k) of each recording; floor: of the sensor's noise, px or deg."""
    noise = min(Noise.of(after, floor), Noise.of(before, floor), key=lambda noise: noise.sigma)
    squares = [sum(float(np.sum(left**2)) for left in residuals) for residuals in (before, after)]
    log_odds = float(np.log((1.0 - _FITTED) / _FITTED)) + 0.5 * noise.weight * (squares[0] - squares[1])
    return log_odds > 0.0
