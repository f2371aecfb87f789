"""The user's simulator as the nominal: one fault in it, and a robot that has it."""

import json
import math
import os
import sys
from dataclasses import replace
from types import ModuleType

import arms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tautline as tl
from tautline import tables, trajectory
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.errors import TautError
from tautline.geometry import project
from tautline.io.exporting import export
from tautline.io.exporting.log import of_source
from tautline.io.exporting.source import of_model, of_recording
from tautline.model import Model
from tautline.prediction import foretold, predict
from tautline.recording import Angle, Marker, Motor, Recording, load
from tautline.rig import ANGLE
from tautline.simulated.instrument import reference_rig
from tautline.simulators import Declared, Simulator, mjcf, side_by_side, source
from tautline.simulators.drive import Drive
from tautline.simulators.nominal import nominal as simulated_nominal
from tautline.simulators.source import path_of
from tautline.tracking import LawTracker

pytest.importorskip("mujoco")

G_ARM = 0.15 * 9.81 * 0.1  # Nm: the arm's weight at its middle
SERVO_STEP_S = 0.004


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(scope="module")
def nominal(folder):
    return mjcf.simulator(arms.write(folder / "arm.xml", step_s=SERVO_STEP_S), "servo", "joint:elbow")


def still(q_deg, seconds=1.0):
    t_s = np.arange(0.0, seconds, 0.005)
    return Motor(t_s, np.full_like(t_s, q_deg))


@settings(max_examples=10, deadline=None)
@given(q_deg=st.floats(-50.0, 50.0), kp=st.floats(0.5, 5.0))
def test_at_rest_the_servo_carries_the_arms_weight(nominal, q_deg, kp):
    """kp (q - c) = m g l / 2 sin c without friction, from the log's first moment on."""
    tip = np.radians(nominal.tip(still(q_deg), {"servo.kp": kp - 3.0, "elbow.frictionloss": -0.01}))
    np.testing.assert_allclose(kp * (math.radians(q_deg) - tip), G_ARM * np.sin(tip), atol=1e-5)


def test_what_exists_is_declared_with_the_files_own_values(nominal):
    told = {each.name: each.nominal for each in nominal.parameters}
    assert told == pytest.approx(
        {"elbow.damping": 0.05, "elbow.frictionloss": 0.01, "elbow.armature": 0.002, "servo.kp": 3.0, "servo.kv": 0.02}
        | {"servo.timeconst": 0.0, "servo.delay": 0.0, "elbow.load": 0.15}
    )


def test_a_load_is_the_mass_of_all_that_the_joint_carries(folder):
    """Twice the mass of a weightless servo's arm of two links: twice the torque, k (q - c) = m g l sin c."""
    text = """<mujoco><option timestep="0.004"/><worldbody><body><joint name="a" axis="0 1 0" damping="0.5"/>
      <geom type="sphere" size="0.01" pos="0 0 -0.1" mass="0.2"/><body pos="0 0 -0.2">
        <geom type="sphere" size="0.01" mass="0.1"/></body></body></worldbody>
      <actuator><position name="servo" joint="a" kp="2"/></actuator></mujoco>"""
    (folder / "links.xml").write_text(text)
    arm = mjcf.simulator(folder / "links.xml", "servo", "joint:a")
    assert {p.name: p.nominal for p in arm.parameters}["a.load"] == pytest.approx(0.3)
    for mass in (0.3, 0.6):
        c = np.radians(arm.tip(still(40.0), {"a.load": mass - 0.3})[-1])
        torque = mass / 0.3 * 9.81 * (0.2 * 0.1 + 0.1 * 0.2) * math.sin(c)
        assert 2.0 * (math.radians(40.0) - c) == pytest.approx(torque, abs=1e-4)
    for where in ("gravity='0 0 0'", "gravity='0 9.81 0'"):  # along the axis
        (folder / "light.xml").write_text(text.replace("<option", f"<option {where}"))
        names = [p.name for p in mjcf.simulator(folder / "light.xml", "servo", "joint:a").parameters]
        assert "a.load" not in names


def test_the_same_motion_is_the_same_to_the_last_bit_and_a_delay_is_a_later_motion(nominal):
    t_s = np.arange(0.0, 4.0, 0.005)
    motor = Motor(t_s, 20.0 * np.sin(2.0 * t_s) * np.minimum(t_s, 1.0))
    once, again = nominal.tip(motor, {}), nominal.tip(motor, {})
    assert (once == again).all()
    late = nominal.tip(motor, {"servo.delay": 0.04})  # ten of its steps: no interpolation
    np.testing.assert_allclose(late[8:], once[:-8], atol=1e-6)


def filtered(folder, servo, step_s=SERVO_STEP_S):
    """The arm with this text in its servo's element."""
    arm = arms.write(folder / "filtered.xml", step_s=step_s)
    arm.write_text(arm.read_text().replace('name="servo"', f'name="servo" {servo}'))
    return mjcf.simulator(arm, "servo", "joint:elbow")


def test_a_servo_that_lags_is_one_whose_file_says_so(folder, nominal):
    """The time constant of 40 ms as the robot's, and as the file's own: MuJoCo's filter holds a control for a step."""
    t_s = np.arange(0.0, 4.0, 0.005)
    motor = Motor(t_s, 30.0 + 20.0 * np.sin(2.0 * t_s))
    usual, lags = filtered(folder, "", 2e-4), filtered(folder, 'timeconst="0.04"', 2e-4)
    declared = {each.name: each for each in lags.parameters}["servo.timeconst"]
    assert (declared.unit, declared.nominal, declared.low) == ("s", 0.04, 0.0)
    late = usual.tip(motor, {"servo.timeconst": 0.04})
    np.testing.assert_allclose(late, lags.tip(motor, {}), atol=0.01)
    np.testing.assert_allclose(
        lags.tip(motor, {"servo.timeconst": -0.02}), usual.tip(motor, {"servo.timeconst": 0.02}), atol=0.01
    )
    assert np.sqrt(np.mean((late - usual.tip(motor, {})) ** 2)) > 0.5


def test_a_lag_far_below_a_step_is_told_as_well(nominal):
    """Differences at a servo that has none are of a part of a spread: a steady ramp is late by each."""
    t_s = np.arange(0.0, 4.0, 0.005)
    motor = Motor(t_s, 10.0 * t_s)
    off = [(nominal.tip(motor, {}) - nominal.tip(motor, {"servo.timeconst": tau}))[-1] for tau in (1e-4, 1e-3, 1e-2)]
    np.testing.assert_allclose(off, [1e-3, 1e-2, 1e-1], rtol=0.05)


@pytest.mark.parametrize("kind", ["filter", "filterexact"])
def test_a_general_actuators_own_filter_is_its_time_constant(folder, kind):
    arm = arms.write(folder / "general.xml")
    position = '<position name="servo" joint="elbow" kp="3.0" kv="0.02"/>'
    general = '<general name="servo" joint="elbow" gainprm="3" biastype="affine" biasprm="0 -3 -.02" {}/>'
    text = arm.read_text().replace(position, general.format(f'dyntype="{kind}" dynprm="0.05"'))
    arm.write_text(text)
    own = mjcf.simulator(arm, "servo", "joint:elbow")
    told = {each.name: each for each in own.parameters}
    lag = told["servo.timeconst"]
    assert lag.nominal == pytest.approx(0.05) and told["servo.kp"].nominal == 3.0
    t_s = np.arange(0.0, 2.0, 0.005)
    motor = Motor(t_s, 20.0 * np.sin(3.0 * t_s))
    least, usual, slow = (own.tip(motor, {lag.name: tau - lag.nominal}) for tau in (lag.low, lag.nominal, 0.1))
    for one, other in ((least, usual), (usual, slow)):
        assert 0.5 < np.sqrt(np.mean((one - other) ** 2)) < 5.0


def test_a_filtered_servo_begins_at_rest_at_its_first_command(folder):
    """However slow it is: two seconds of settling do not carry it from 0 deg."""
    tip = filtered(folder, 'timeconst="2"').tip(still(40.0), {})
    assert np.ptp(tip) < 0.05 and tip[0] > 35.0  # it creeps within its friction


def test_an_actuator_that_integrates_its_command_has_no_time_constant(folder):
    arm = arms.write(folder / "speed.xml")
    arm.write_text(arm.read_text().replace("<position", '<intvelocity actrange="-3 3"'))
    names = [each.name for each in mjcf.simulator(arm, "servo", "joint:elbow").parameters]
    assert "servo.timeconst" not in names and "servo.delay" in names


def test_a_site_is_the_sum_of_the_free_hinges_above_it(folder):
    text = """<mujoco><worldbody><body><joint name="motor" axis="0 1 0"/><geom size="0.01"/>
      <body pos="0 0 -0.1"><joint name="a" axis="0 1 0" stiffness="1" damping="0.1"/><geom size="0.01" pos="0 0 -.05"/>
        <body pos="0 0 -0.1"><joint name="b" axis="0 -1 0" stiffness="1" damping="0.1"/><geom size="0.01"/>
          <site name="tip"/></body></body></body></worldbody>
      <equality><joint joint1="a" joint2="motor" polycoef="0 0.5 0 0 0"/>
        <joint joint1="b" joint2="motor" polycoef="0 -0.25 0 0 0"/></equality>
      <actuator><position name="A" joint="motor" kp="50" kv="2"/></actuator></mujoco>"""
    (folder / "two.xml").write_text(text.replace("<mujoco>", '<mujoco><option gravity="0 0 0"/>'))
    arm = mjcf.simulator(folder / "two.xml", "A", "site:tip")
    driven = mjcf.simulator(folder / "two.xml", "A", "joint:motor").tip(still(20.0), {})[-1]
    assert arm.tip(still(20.0), {})[-1] == pytest.approx(0.75 * driven, abs=0.3)  # equalities are soft


URDF = """<robot name="arm">
  <link name="base"><inertial><mass value="1"/>
    <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="fore"><inertial><origin xyz="0 0 -0.1"/><mass value="0.1"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="elbow" type="revolute"><parent link="base"/><child link="fore"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="10" velocity="10"/></joint>
</robot>
"""


def test_a_urdf_has_a_servo_on_the_joint_that_is_named(folder):
    """Critically damped at 10 Hz about 0.001 + 0.1 x 0.1^2 kg m^2: kp = 0.002 (20 pi)^2, sagging by its weight."""
    (folder / "arm.urdf").write_text(URDF)
    arm = mjcf.simulator(folder / "arm.urdf", "elbow", "joint:elbow")
    declared = {each.name: each.nominal for each in arm.parameters}
    kp = 0.002 * (20.0 * math.pi) ** 2
    assert declared["elbow.kp"] == pytest.approx(kp) and declared["elbow.kv"] == pytest.approx(kp / (10.0 * math.pi))
    c = np.radians(arm.tip(still(30.0), {})[-1])
    assert kp * (math.radians(30.0) - c) == pytest.approx(0.1 * 9.81 * 0.1 * math.sin(c), abs=1e-4)
    with pytest.raises(TautError, match="name a joint that a servo shall hold"):
        mjcf.simulator(folder / "arm.urdf", "servo", "joint:elbow")


FREE = """<mujoco><worldbody><body><joint name="base" type="free"/><geom size="0.1"/>
  <body><joint {named} axis="0 1 0"/><geom size="0.05" pos="0.1 0 0"/><site name="tip"/></body></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(("named", "actuator", "there"), [('name="elbow"', "base", "elbow"), ("", "", "no hinge or")])
def test_a_servo_holds_a_hinge_or_a_slide_that_has_a_name(folder, named, actuator, there):
    (folder / "free.xml").write_text(FREE.format(named=named))
    with pytest.raises(TautError, match=f"with --actuator, .*{there}"):
        mjcf.simulator(folder / "free.xml", actuator, "joint:elbow")


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        # The joint's damping and the servo's are one on one joint, a command's delay and a sensor's everywhere.
        pytest.param({"damping": 0.15}, {"simulator.elbow.damping", "simulator.servo.kv"}, marks=pytest.mark.long),
        ({"frictionloss": 0.05}, {"simulator.elbow.frictionloss"}),
        pytest.param({"kp": 1.5}, {"simulator.servo.kp"}, marks=pytest.mark.long),
        pytest.param({"delay_s": 0.03}, {"simulator.servo.delay", "acquisition.delay"}, marks=pytest.mark.long),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, dict) else "",
)
def test_a_fault_is_named_with_its_value_and_the_corrected_model_is_better_elsewhere(folder, nominal, fault, named):
    robots = [arms.robot(folder, seed, 8.0, **fault) for seed in (0, 3)]
    found = tl.diagnose_simulator(nominal, robots, arms.rig(folder))
    (first,) = found.document["effects"]
    leading = {first["id"], *first["ambiguous_with"]}
    assert first["id"] in named and leading <= named, leading
    for each in found.document["simulator"]["parameters"]:
        # kv: 0.1 more, as the joint's damping.
        value = {"kv": 0.12, "damping": 0.15, "delay": 0.03, **fault}[each["name"].split(".")[1]]
        assert each["value"] == pytest.approx(value, rel=0.02)
    # The simulator's own chain is known: nothing of it has moved beside what was named.
    assert np.max(found.corrected.width) < 1e-3
    np.testing.assert_allclose(found.corrected.c_deg, found.nominal.c_deg, atol=1e-3)
    # What is sure leaves little to ask.
    assert found.next_motion is not None and 0.0 <= found.next_motion.information <= found.next_motion.entropy < 0.5
    unseen = arms.robot(folder, 7, 8.0, **fault)
    corrected = foretold(found.corrected, unseen)
    assert corrected < 1.2 * arms.NOISE_DEG < 0.2 * foretold(found.nominal, unseen)


def test_an_arm_as_the_simulator_has_it_has_no_gap(folder, nominal):
    found = diagnose_simulator(nominal, [arms.robot(folder, seed, 8.0) for seed in (0, 3)], arms.rig(folder))
    assert found.document["verdict"] == "none"


def first_order(motor, parameters):
    """A joint that follows its command in first order."""
    share = -np.expm1(-(motor.t_s[1] - motor.t_s[0]) / parameters["tau"])
    c = np.empty_like(motor.q)
    state = motor.q[0]
    for k, q in enumerate(motor.q):
        state += share * (q - state)
        c[k] = state
    return c


FOLLOWER = Simulator(first_order, (Declared("tau", "s", 0.05, 0.02, low=0.01),), {"kind": "python", "name": "here:it"})


def followed(folder, tau, play_deg=0.0, seed=3):
    """A robot that is the follower with another time constant and a play behind it."""
    robot = arms.robot(folder, seed, 8.0)
    c, held = np.empty(len(robot.motor.q)), robot.motor.q[0]
    for k, value in enumerate(first_order(robot.motor, {"tau": tau})):
        held = c[k] = min(max(held, value - 0.5 * play_deg), value + 0.5 * play_deg)
    noise = np.random.default_rng(seed).normal(0.0, 0.03, len(robot.angle.t_s))
    return replace(robot, angle=Angle(robot.angle.t_s, np.interp(robot.angle.t_s, robot.motor.t_s, c) + noise))


def test_any_callable_is_a_simulator_and_its_parameter_an_answer(folder):
    robots = [followed(folder, 0.12, seed=seed) for seed in (0, 3)]
    found = diagnose_simulator(FOLLOWER, robots, arms.rig(folder)).document
    first = found["effects"][0]
    leading = {first["id"], *first["ambiguous_with"]}
    assert "simulator.tau" in leading and len(leading) <= 3
    told = {each["name"]: each["value"] for each in found["simulator"]["parameters"]}
    assert told.get("tau", 0.12) == pytest.approx(0.12, rel=0.02)


@pytest.mark.long
def test_with_a_camera_the_simulated_tip_is_seen_by_the_rigs_own():
    """The follower moves 12 deg per mm of cable; the marker is seen with 0.05 px of noise, 80 ms late."""
    rig, gain = reference_rig(), 12.0

    def bends(motor, parameters):
        return gain * first_order(motor, parameters)

    def seen(seed):
        course = trajectory.random_smooth(rig.actuator, 5.0, 16.0, seed)
        t_s, arrival_s = np.arange(0.0, 16.0, 0.005), np.arange(0.2, 16.0, 0.04)
        motor = Motor(t_s, np.interp(t_s, course.t_s, course.q))
        px = project(rig, np.interp(arrival_s - 0.08, t_s, bends(motor, {"tau": 0.12})))
        u, v = (px + np.random.default_rng(seed).normal(0.0, 0.05, px.shape)).T
        return Recording(f"robot{seed}", motor, marker=Marker(arrival_s, u, v, np.isfinite(u)))

    found = diagnose_simulator(Simulator(bends, FOLLOWER.parameters), [seen(1), seen(2)], rig).document
    first = found["effects"][0]
    assert found["unit"] == "px" and first["id"] == "simulator.tau" and len(first["ambiguous_with"]) <= 2
    assert found["simulator"]["parameters"][0]["value"] == pytest.approx(0.12, rel=0.01)
    assert found["gap"]["after"] < 1.1 * 0.05


def test_what_the_simulator_has_not_is_an_effect_of_the_library_around_it(folder):
    robots = [followed(folder, 0.05, play_deg=2.0, seed=seed) for seed in (0, 3)]
    found = diagnose_simulator(FOLLOWER, robots, arms.rig(folder))
    assert [effect["id"] for effect in found.document["effects"]] == ["transmission.backlash"]
    moved = np.abs(found.corrected.q) < 30.0
    assert np.mean(found.corrected.width[moved]) == pytest.approx(2.0, abs=0.1)


def test_a_diagnosis_by_command_predicts_with_the_simulator_and_its_new_value(folder, nominal, taut, tmp_path):
    for seed in (0, 3):
        save(arms.robot(folder, seed, 6.0, kp=1.5), tmp_path / f"robot{seed}")
    arm = arms.write(tmp_path / "arm.xml", step_s=SERVO_STEP_S)
    arms.rig(tmp_path)
    out = tmp_path / "out"
    words = ("diagnose", "--simulator", arm, "--actuator", "servo", "--tip", "joint:elbow", tmp_path / "robot0",
             tmp_path / "robot3", "--rig", tmp_path / "rig.toml", "--out", out)  # fmt: skip
    done = taut(*words, "--json")
    assert done.code == 0, done.err
    document = json.loads((out / "diagnosis.json").read_text())
    assert json.loads(done.out) == document
    assert document["effects"][0]["id"] == "simulator.servo.kp" and document["where"]["stage"] == "simulator"
    page = (out / "report.html").read_text()
    assert "in the simulator 3" in page and "Put into the simulator what the robot has: servo.kp 1.5" in page
    assert "taut flash" not in page
    told = taut("predict", out / "corrected", tmp_path / "robot3", "--csv", tmp_path / "c.csv")
    assert told.code == 0, told.err
    robot = arms.robot(folder, 3, 6.0, kp=1.5)
    rows = np.genfromtxt(tmp_path / "c.csv", delimiter=",", names=True)
    assert np.std(rows["c_deg"] - robot.angle.c_deg) < 1.2 * arms.NOISE_DEG
    assert np.median(rows["c_sigma_deg"]) == pytest.approx(arms.NOISE_DEG, rel=0.2)
    check_where_it_goes(Model.load(out / "corrected"), load(tmp_path / "robot3", arms.rig(tmp_path)), tmp_path)
    arm.write_text(arm.read_text().replace('kp="3.0"', 'kp="4.0"'))
    assert "is not the file that was diagnosed" in taut.refuses(
        "predict", out / "corrected", tmp_path / "robot3", "--csv", tmp_path / "c.csv"
    )
    assert taut("explain", "simulator.servo.kp").code == 0


def check_where_it_goes(corrected, robot, tmp_path):
    """What knows the motor alone refuses it, and a log's p is the simulated tip in its play, here of no width."""
    with pytest.raises(TautError, match="over its tip"):
        tables.encode(corrected)
    with pytest.raises(TautError, match="over its tip"):
        LawTracker(corrected, ANGLE)
    for name in ("linuxcnc", "marlin", "fluidnc", "klipper", "mjcf"):
        with pytest.raises(TautError, match="begins with a simulator"):
            export(of_model(corrected), name, tmp_path / "never")
    told = next(s for s in of_source(of_recording(robot, None, of_model(corrected))).series if "prediction" in s.name)
    lines = path_of(corrected, robot.motor).lines
    p = np.interp(told.t_s - corrected.delay_of(ANGLE), lines.t_s, lines.q)
    inside = np.isfinite(told.columns["p_deg"])
    assert (
        inside.any() and np.abs(told.columns["p_deg"] - p)[inside].max() < 0.01 < np.abs(robot.motor.q - lines.q).max()
    )


def test_what_is_asked_for_is_simulated_elsewhere_and_the_same(folder, nominal):
    log, rig = still(10.0), arms.rig(folder)
    told = Simulator(arms.process, (Declared("p", "", 0.0, 1.0),))
    with side_by_side.pool(told, 2) as processes:
        drive = Drive(told, log, rig, processes)
        drive.ask({"simulator.p": 1.0})
        assert drive.motor({"simulator.p": 1.0}).q[0] != os.getpid() == drive.motor({}).q[0]
    moved = {"simulator.servo.kp": -1.0}
    with side_by_side.pool(nominal, 2) as processes:
        drive = Drive(nominal, log, rig, processes)
        drive.ask(moved)
        assert (drive.motor(moved).q == Drive(nominal, log, rig).motor(moved).q).all()
    with pytest.raises(TautError, match="use 1 worker"), side_by_side.pool(Simulator(lambda motor, p: motor.q, ()), 2):
        pass


def test_a_simulator_that_another_process_cannot_run_is_one_line(folder, monkeypatch):
    notebook = ModuleType("of_a_notebook")
    exec("def simulate(motor, parameters): return motor.q", notebook.__dict__)
    monkeypatch.setitem(sys.modules, "of_a_notebook", notebook)
    for simulate, says in ((notebook.simulate, "is not there for another process"), (arms.ends, "has ended")):
        told = Simulator(simulate, ())
        with pytest.raises(TautError, match=f"{says}.*use 1 worker"), side_by_side.pool(told, 2) as processes:
            drive = Drive(told, still(1.0), arms.rig(folder), processes)
            drive.ask({})
            drive.motor({})


@pytest.mark.long
def test_workers_change_nothing(folder, nominal):
    robots = [arms.robot(folder, seed, 6.0, kp=1.5) for seed in (0, 3)]
    alone, together = (tl.diagnose_simulator(nominal, robots, arms.rig(folder), workers=n) for n in (1, 2))
    assert alone.document == together.document


def save(robot: Recording, into):
    into.mkdir()
    for name, columns, values in (
        ("motor.csv", "t_s,q_deg", (robot.motor.t_s, robot.motor.q)),
        ("angle.csv", "t_s,c_deg", (robot.angle.t_s, robot.angle.c_deg)),
    ):
        np.savetxt(into / name, np.column_stack(values), delimiter=",", header=columns, comments="", fmt="%.9f")


def test_a_module_of_a_package_in_the_working_directory_is_no_file(folder, taut, tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each])
    monkeypatch.chdir(tmp_path)
    save(arms.robot(folder, 0, 6.0), tmp_path / "robot")
    arms.rig(tmp_path)
    package = tmp_path / "pkg_of_arms"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "sims.py").write_text(
        "from tautline.simulators import Declared, Simulator\n"
        "ARM = Simulator(lambda motor, values: motor.q, (Declared('tau', 's', 0.05, 0.02),))\n"
    )
    (package / "broken.py").write_text("raise ValueError('of\\nits own')\n")
    assert source.is_python("pkg_of_arms.sims:ARM") and not source.is_python("arm.xml")
    assert [each.name for each in source.of_python("pkg_of_arms.sims:ARM").parameters] == ["tau"]
    words = ("robot", "--rig", "rig.toml", "--out", "out")
    assert "is no tautline.simulators.Simulator" in taut.refuses(
        "diagnose", "--simulator", "pkg_of_arms.sims:Declared", *words
    )
    assert "ValueError: of its own" in taut.refuses("diagnose", "--simulator", "pkg_of_arms.broken:ARM", *words)


def test_what_is_wrong_is_said_with_what_to_do(folder, nominal, taut, tmp_path):
    arm = folder / "arm.xml"
    with pytest.raises(TautError, match="has no actuator motor, but servo"):
        mjcf.simulator(arm, "motor", "joint:elbow")
    with pytest.raises(TautError, match="has no hinge wrist, but elbow"):
        mjcf.simulator(arm, "servo", "joint:wrist")
    with pytest.raises(TautError, match="name your MJCF"):
        mjcf.simulator(folder / "none.xml", "servo", "joint:elbow")
    with pytest.raises(TautError, match="not 0"):
        mjcf.simulator(arm, "servo", "joint:elbow", scale=0.0)
    with pytest.raises(TautError, match="spread above 0"):
        Declared("tau", "s", 0.05, 0.0)
    with pytest.raises(TautError, match="outside of its own range"):
        Declared("tau", "s", 0.05, 0.1, low=0.1)
    with pytest.raises(TautError, match="declared twice"):
        Simulator(first_order, (Declared("tau", "s", 0.05, 0.1), Declared("tau", "s", 0.05, 0.1)))
    with pytest.raises(TautError, match="for 200 times"):
        Simulator(lambda motor, values: motor.q[1:], ()).tip(still(1.0), {})
    with pytest.raises(TautError, match="no numbers with tau"):
        broken = Simulator(lambda motor, values: motor.q * np.nan, FOLLOWER.parameters)
        broken.tip(still(1.0), {"tau": 0.01})
    with pytest.raises(TautError, match="at least one recording"):
        diagnose_simulator(FOLLOWER, [], arms.rig(folder))
    assert taut("diagnose", "--simulator", arm, tmp_path, "--out", tmp_path / "out").code in (1, 2)
    assert taut("diagnose", tmp_path, tmp_path, "--tip", "joint:a", "--out", tmp_path / "out").code == 2


def test_a_model_whose_simulator_was_a_function_of_the_session_says_so(folder):
    anonymous = Simulator(first_order, FOLLOWER.parameters)
    model = simulated_nominal(anonymous, [followed(folder, 0.05)], arms.rig(folder)).model
    with pytest.raises(TautError, match="function of a session"):
        predict(model, still(1.0), np.array([0.5]))


@pytest.mark.parametrize(
    ("damaged", "says"),
    [
        ({"path": None}, "its path is None, expected a text"),
        ({"kind": "python", "name": 5}, "its name is 5, expected a text"),
        ({"scale": "x"}, "its scale is 'x', expected a number"),
        ({"stepless_from_s": 0}, "its stepless_from_s is 0, expected a number"),
    ],
)
def test_a_model_whose_simulator_is_damaged_says_so(folder, nominal, damaged, says):
    model = simulated_nominal(nominal, [arms.robot(folder, 0, 2.0)], arms.rig(folder)).model
    with pytest.raises(TautError, match=says):
        source.open_simulator(replace(model, simulator={**model.simulator, **damaged}))


def test_an_unstable_trial_writes_nothing_where_the_user_works(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    arm = mjcf.simulator(arms.write(folder / "stiff.xml", step_s=0.02), "servo", "joint:elbow")
    t = np.linspace(0.0, 2.0, 200)
    arm.tip(Motor(t, 30.0 * np.sin(9.0 * t)), {"servo.kp": 3e5})
    assert not list(tmp_path.iterdir())
