"""A simulator that goes in steps of time beside a robot that does not."""

from dataclasses import replace
from functools import partial

import arms
import numpy as np
import pytest

from tautline.diagnosis import narration
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.diagnosis.stepping import without_step_error
from tautline.errors import TautError
from tautline.recording import Angle, Motor, Recording
from tautline.simulators import Declared, Simulator, mjcf, source
from tautline.simulators.nominal import nominal
from tautline.simulators.stepless import stepless
from tautline.trajectory import random_smooth

NOISE_DEG, LAG_S, COARSE_S = 0.03, 0.08, 0.004


def in_steps(step_s, motor, values):
    """c' = (q - c) / lag by backward Euler, q held at its value of the step's beginning."""
    t_s = np.arange(motor.t_s[0], motor.t_s[-1] + step_s, step_s)
    q = np.interp(t_s, motor.t_s, motor.q).tolist()
    c, share = [q[0]], step_s / (values["lag"] + step_s)
    for held in q[:-1]:
        c.append(c[-1] + share * (held - c[-1]))
    return np.interp(motor.t_s, t_s, c)


def follower(step_s):
    declared = (Declared("lag", "s", LAG_S, 0.02, low=0.005),)
    known = {"kind": "python", "name": "test_stepping:COARSE"}
    return Simulator(partial(in_steps, step_s), declared, known, step_s, follower)


COARSE = follower(COARSE_S)


def exact(motor, lag_s):
    """By straight lines between samples: of q = q0 + r t, c = q - r lag + (c0 - q0 + r lag) exp(-t / lag)."""
    c, step_s = np.empty_like(motor.q), float(motor.t_s[1] - motor.t_s[0])
    c[0] = motor.q[0]
    for k in range(1, len(c)):
        slope = (motor.q[k] - motor.q[k - 1]) / step_s * lag_s
        c[k] = motor.q[k] - slope + (c[k - 1] - motor.q[k - 1] + slope) * np.exp(-step_s / lag_s)
    return c


def robot(folder, seed, behind, noise=NOISE_DEG):
    course = random_smooth(arms.rig(folder).actuator, 60.0, 8.0, seed)
    t_s = np.arange(0.0, course.duration_s, 0.005)
    q = np.interp(t_s, course.t_s, course.q)
    motor = Motor(t_s, q, q)  # commands are not rounded
    seen_s = t_s[20::4]
    shown = np.interp(seen_s, t_s, behind(motor))
    return Recording(
        f"robot{seed}", motor, angle=Angle(seen_s, shown + np.random.default_rng(seed).normal(0.0, noise, len(seen_s)))
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stepping")


def test_a_simulators_own_step_is_told_and_is_no_fault_of_the_robot(folder):
    robots = [robot(folder, seed, lambda motor: exact(motor, LAG_S)) for seed in (3, 5)]
    errors = [np.sqrt(np.mean((COARSE.tip(r.motor, {}) - exact(r.motor, LAG_S))[100:] ** 2)) for r in robots]
    found = diagnose_simulator(COARSE, robots, arms.rig(folder))
    assert found.document["verdict"] == "none"
    told = found.document["simulator"]["step"]
    assert told["own_s"] == COARSE_S
    assert told["error"] == pytest.approx(max(errors), rel=0.15) and told["error"] > 3.0 * NOISE_DEG
    said = narration.text(found.document, "out")
    assert "At its own step of 4 ms the simulator errs by" in said and "- Step the simulator at" in said
    enough = follower(told["enough_s"])
    left = max(np.sqrt(np.mean((enough.tip(r.motor, {}) - exact(r.motor, LAG_S))[100:] ** 2)) for r in robots)
    assert 0.2 * NOISE_DEG < left < 0.5 * NOISE_DEG  # a tenth of the noise's power


def test_the_limit_of_short_steps_is_the_exact_response(folder):
    motor = robot(folder, 3, lambda motor: motor.q).motor
    off = [np.abs(it.tip(motor, {}) - exact(motor, LAG_S)).max() for it in (COARSE, stepless(COARSE, COARSE_S))]
    assert off[1] < 0.01 * off[0]
    with pytest.raises(TautError, match="at_step"):
        stepless(replace(COARSE, at_step=None), COARSE_S)


def test_a_fault_beside_a_coarse_step_has_its_own_value(folder):
    """120 ms of lag, of which the coarse steps' own 2 to 4 are no part."""
    robots = [robot(folder, seed, lambda motor: exact(motor, 0.12)) for seed in (3, 5)]
    document = diagnose_simulator(COARSE, robots, arms.rig(folder)).document
    assert document["simulator"]["step"]["own_s"] == COARSE_S
    values = {each["name"]: each["value"] for each in document["simulator"]["parameters"]}
    assert values["lag"] == pytest.approx(0.12, abs=0.001)


def test_values_that_were_fitted_at_a_step_hold_there(folder):
    robots = [robot(folder, seed, lambda motor: COARSE.tip(motor, {})) for seed in (3, 5)]
    simulator, error = without_step_error(COARSE, robots, arms.rig(folder))
    assert simulator is COARSE and error is None


def test_a_step_that_errs_by_less_than_the_noise_stays(folder):
    fine, unknown = follower(1e-4), replace(COARSE, step_s=None, at_step=None)
    robots = [robot(folder, 3, lambda motor: exact(motor, LAG_S))]
    assert without_step_error(fine, robots, arms.rig(folder)) == (fine, None)
    assert without_step_error(unknown, robots, arms.rig(folder)) == (unknown, None)


def test_an_mjcf_at_another_step_is_found_again(folder):
    pytest.importorskip("mujoco")
    own = mjcf.simulator(arms.write(folder / "arm.xml", step_s=0.004), "servo", "joint:elbow")
    assert own.step_s == pytest.approx(0.004)
    finer = own.at_step(0.001)
    written = mjcf.simulator(arms.write(folder / "fine.xml", step_s=0.001), "servo", "joint:elbow")
    run = arms.robot(folder, 3, 4.0)
    told = finer.tip(run.motor, {})
    np.testing.assert_array_equal(told, written.tip(run.motor, {}))
    assert np.abs(told - own.tip(run.motor, {})).max() > 0.0
    limit = stepless(own, 0.004)
    again = source.open_simulator(nominal(limit, [run], arms.rig(folder)).model)
    np.testing.assert_array_equal(again.tip(run.motor, {}), limit.tip(run.motor, {}))
    half = own.at_step(0.002).tip(run.motor, {})
    np.testing.assert_array_equal(again.tip(run.motor, {}), 2.0 * half - own.tip(run.motor, {}))
