"""A diagnosis with a user's simulator in the motor's place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from tautline.diagnosis import decide, gap
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.joint import Joint
from tautline.diagnosis.joint_told import Answer, improved
from tautline.diagnosis.segment import prepare
from tautline.model import Model
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulators.nominal import nominal
from tautline.simulators.side_by_side import pool
from tautline.simulators.simulator import Simulator
from tautline.vision.marker import with_marker

Progress = Callable[[float, str], None]


def diagnose_simulator(
    simulator: Simulator,
    robots: Sequence[Recording],
    rig: Rig,
    progress: Progress = lambda fraction, text: None,
    workers: int = 1,
) -> Diagnosis:
    """Diagnoses what a simulator lacks: the difference between the robots' recordings and the simulator under the same
    motions. workers: processes for simulations side by side, with the same result. TautError where a recording has
    nothing to compare, nothing can be scored, or the simulator fails."""
    progress(0.0, "simulating")
    seen = [with_marker(robot, rig, progress) for robot in robots]
    with pool(simulator, workers) as processes:
        found = nominal(simulator, seen, rig, processes)
        progress(0.05, "simulated")
        told = diagnose(
            found.model,
            found.calibration,
            found.tests,
            lambda fraction, text: progress(0.05 + 0.75 * fraction, text),
            simulated=found,
        )
        told = replace(told, corrected=_with_noise(told))
        if not decide.is_open(told.evidence, gap.rms(told.after) ** 2):
            return told
        segments = prepare(found.model, found.calibration, found.tests, found.drives)[1:]
        joint = Joint(found.model, simulator.parameters, segments, told.document["noise_floor"])
        with threadpool_limits(1, "blas"):
            fitted = joint.fit(lambda share: progress(0.8 + 0.15 * share, "fitting all parameters together"))
            answer = improved(told, Answer.of(joint, fitted))
        if answer is told:
            return told
        carried = found.to_json(answer.document["effects"])
        return replace(answer, document={**answer.document, "simulator": carried})


def _with_noise(told: Diagnosis) -> Model:
    """The corrected model, which was not calibrated: its noise is by what it leaves of blocks that no fit has seen."""
    model, floor = told.corrected, told.document["noise_floor"]
    noise = gap.unseen(gap.rms(told.before), gap.rms(told.after), floor, learnt().elsewhere)
    return replace(model, extra={**model.extra, "evidence": {"residual": noise}})
