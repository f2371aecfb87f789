"""The campaign of faults in a user's MJCF: what a case is, what is stored, what counts as right."""

from types import SimpleNamespace

import numpy as np
import pytest

from tautline.recording import Motor
from tautline.simulators import mjcf
from tools import simulator_faults
from tools.simulator_faults import (
    FAULTS,
    MECHANISMS,
    NAMED_ONLY,
    NOISE_DEG,
    ROBOT_STEP_S,
    STEP_S,
    Case,
    claim_error,
    right,
    stored,
)

pytest.importorskip("mujoco")


def test_a_case_follows_from_its_seed_and_every_kind_comes():
    assert Case.of(7) == Case.of(7)
    kinds = {(case.mechanism, case.fault) for case in map(Case.of, range(3_000_000, 3_000_032))}
    drawn = [fault for fault in FAULTS if fault not in NAMED_ONLY]
    assert kinds == {(m, f) for m in MECHANISMS for f in drawn if f != "bend" or MECHANISMS[m].bend}
    for fault in NAMED_ONLY:
        named = {(case.mechanism, case.fault) for case in (Case.of(seed, fault) for seed in range(3))}
        assert named == {(m, fault) for m in MECHANISMS}


def test_a_claim_is_off_by_what_is_left_of_an_unseen_motion():
    """Of a gap of 10 times the noise half of the power above it is said to be left, and half of 4 times is."""
    left = np.sqrt(0.5 * (100.0 - 1.0) + 1.0)
    case = {"named": [["x"]], "gap": 10.0, "left": left, "unseen": 4.0, "worse": np.sqrt(0.5 * 15.0 + 1.0) / 4.0}
    assert claim_error(case) == pytest.approx(0.0, abs=1e-9)
    assert claim_error({**case, "worse": case["worse"] + 0.07}) == pytest.approx(7.0)
    assert claim_error({**case, "unseen": 1.2}) is None and claim_error({**case, "named": []}) is None


@pytest.mark.parametrize("kind", MECHANISMS)
def test_each_fault_moves_the_tip_and_the_robot_without_one_is_the_simulator_but_for_its_steps(kind, tmp_path):
    one = MECHANISMS[kind]

    def arm(step_s, integrator, off):
        path = one.write(tmp_path / f"{step_s}-{len(off)}.xml", step_s, integrator, off)
        return mjcf.simulator(path, "servo", one.tip, one.rig.actuator.unit, one.scale)

    robot = Case(11, kind, "none", 1.0).robot(arm(ROBOT_STEP_S, "Euler", {}), 1)

    def apart(off):
        told = np.interp(robot.angle.t_s, robot.motor.t_s, arm(STEP_S, "implicitfast", off).tip(robot.motor, {}))
        return np.sqrt(np.mean((robot.angle.c_deg - told) ** 2))

    assert apart({}) < 1.3 * NOISE_DEG
    for fault in ("damping", "friction", "gain", "armature", "mass", "slack", "bend", "ratio", "lag"):
        if off := {name: value for name, value in Case(0, kind, fault, 1.0).off.items() if value}:
            assert apart(off) > 1.5 * NOISE_DEG, fault


def test_the_play_behind_the_gears_is_as_wide_as_it_is_told(tmp_path):
    """Strokes so slow that only play is left: rising and falling the tip is apart by its width."""
    one, width_deg = MECHANISMS["geared"], 2.0
    t_s = np.arange(0.0, 16.0, 0.005)
    motor = Motor(t_s, 20.0 * np.sin(2.0 * np.pi * t_s / 8.0))
    weightless = {"mass": 1e-3, "friction": 0.0}

    def tip(slack):
        path = one.write(tmp_path / "arm.xml", 0.002, "implicitfast", {**weightless, "slack": slack})
        path.write_text(path.read_text().replace("<option", '<option gravity="0 0 0"'))
        return mjcf.simulator(path, "servo", one.tip).tip(motor, {})

    apart = tip(0.0) - tip(np.radians(width_deg))
    passing = np.abs(motor.q) < 3.0
    rising = passing & (np.gradient(motor.q) > 0.0) & (t_s > 6.0)
    falling = passing & (np.gradient(motor.q) < 0.0) & (t_s > 6.0)
    assert np.median(apart[rising]) - np.median(apart[falling]) == pytest.approx(width_deg, abs=0.2)


def found(verdict, effects):
    return SimpleNamespace(document={"verdict": verdict, "effects": effects})


def effect(name, *others):
    return {"id": name, "ambiguous_with": list(others)}


def test_a_cause_is_right_where_it_leads_or_is_in_a_small_set():
    gain = Case(0, "geared", "gain", 1.0)
    assert right(gain, found("effect", [effect("simulator.servo.kp")]))
    assert right(gain, found("effect", [effect("transmission.backlash", "simulator.elbow.load")]))
    assert not right(gain, found("effect", [effect("transmission.backlash"), effect("simulator.servo.kp")]))
    assert not right(gain, found("effect", [effect("a.a", "b.b", "c.c", "simulator.servo.kp")]))
    assert not right(gain, found("unknown", []))
    for fault in ("none", "unknown"):
        assert right(Case(0, "geared", fault, 1.0), found(fault, []))
        assert not right(Case(0, "geared", fault, 1.0), found("effect", [effect("simulator.servo.kp")]))


def test_what_is_stored_is_not_run_again(tmp_path, monkeypatch):
    case, runs = Case.of(3), []
    monkeypatch.setattr(simulator_faults, "run", lambda case, folder: runs.append(case) or {"seed": 3, "right": True})
    assert stored(case, tmp_path, tmp_path) == stored(case, tmp_path, tmp_path) == {"seed": 3, "right": True}
    assert runs == [case]
