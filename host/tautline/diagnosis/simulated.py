"""The diagnosis of what a user's simulator lacks, with the simulator in the motor's place."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from tautline.diagnosis import decide, gap
from tautline.diagnosis.diagnose import Diagnosis, diagnose
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.joint import Joint, fit_held_or_loose
from tautline.diagnosis.joint_told import Answer, with_joint_answer
from tautline.diagnosis.recorded import with_markers
from tautline.diagnosis.segment import prepare
from tautline.diagnosis.stepping import without_step_error
from tautline.model import Model
from tautline.recording import Recording
from tautline.rig import Rig
from tautline.simulators.nominal import nominal
from tautline.simulators.side_by_side import pool
from tautline.simulators.simulator import Simulator

Progress = Callable[[float, str], None]

_SIMULATING, _DIAGNOSING, _FITTING = 0.05, 0.75, 0.15  # format: shares of the progress: runs, diagnosis, joint fit


def diagnose_simulator(
    simulator: Simulator,
    robots: Sequence[Recording],
    rig: Rig,
    progress: Progress = lambda fraction, text: None,
    workers: int = 1,
) -> Diagnosis:
    """Diagnoses what a simulator lacks: the gap between the robot's recordings and the simulator under the same
    motions. The simulator runs without the error of its steps, unless that is small beside the noise or unknown, or the
    robot's recordings are likelier with it (`without_step_error`). If the effects found leave the gap open, all of the
    simulator's parameters are fitted together (joint.py); that answer counts if it surely leaves less. progress: called
    with the share that is done, 0 to 1, and what is done now. workers: number of processes that simulate side by side;
    the result does not depend on it. TautError where nothing can be compared or scored, or the simulator fails."""
    progress(0.0, "simulating")
    seen = with_markers(robots, rig, lambda fraction, text: progress(_SIMULATING * fraction, text))
    simulator, step = without_step_error(simulator, seen, rig)
    with pool(simulator, workers) as processes:
        found = replace(nominal(simulator, seen, rig, processes), step=step)
        progress(_SIMULATING, "simulated")
        diagnosis = diagnose(
            found.model,
            found.calibration,
            found.tests,
            lambda fraction, text: progress(_SIMULATING + _DIAGNOSING * fraction, text),
            simulated=found,
        )
        diagnosis = replace(diagnosis, corrected=_corrected_with_noise(diagnosis))
        if not decide.is_open(diagnosis.evidence, gap.rms(diagnosis.after) ** 2):
            return diagnosis
        tests = prepare(found.model, found.calibration, found.tests, found.drives)[1:]
        joint = Joint(found.model, simulator.parameters, tests, diagnosis.document["noise_floor"])
        with threadpool_limits(1, "blas"):
            done = _SIMULATING + _DIAGNOSING
            told = fit_held_or_loose(
                joint, lambda share: progress(done + _FITTING * share, "fitting all parameters together")
            )
            answer = with_joint_answer(diagnosis, Answer.of(*told))
        if answer is diagnosis:  # the joint fit leaves no less
            return diagnosis
        of_simulator = found.to_json(answer.document["effects"])
        return replace(answer, document={**answer.document, "simulator": of_simulator})


def _corrected_with_noise(diagnosis: Diagnosis) -> Model:
    """The corrected model with its uncertainty's noise set, as no calibration has: one standard deviation of a reading
    about its prediction, px per coordinate or deg. It contains the sensor's noise and the misfit on held-out blocks,
    enlarged as it is on unseen motions (`gap.unseen`, learnt().elsewhere)."""
    model, floor = diagnosis.corrected, diagnosis.document["noise_floor"]
    noise = gap.unseen(gap.rms(diagnosis.before), gap.rms(diagnosis.after), floor, learnt().elsewhere)
    return replace(model, uncertainty=replace(model.uncertainty, noise=noise))
