"""A model in three small MJCFs of its own: what MuJoCo then shows against the equations, and what the export says."""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import exported
import mujoco
import numpy as np
import pytest
from cli_runner import Taut
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.elements import SINGLE, Elements
from tautline.geometry import project
from tautline.io.exporting.export import Mount
from tautline.io.exporting.mjcf import chain, folder
from tautline.io.exporting.mjcf.nominal import Nominal, read_nominal
from tautline.io.exporting.mjcf.scene import Law, Scene
from tautline.io.exporting.mjcf.transmission import Transmission
from tautline.model import Effect, Model
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.trajectory import sines

GEARED = """<mujoco model="geared"><compiler angle="radian"/><option timestep="0.001"/>
<worldbody><body name="link" pos="0 0 0.5"><joint name="J" type="hinge" axis="0 1 0" damping="0.01" armature="0.002"/>
<geom type="capsule" size="0.01" fromto="0 0 0 0 0 0.3" mass="0.1"/></body></worldbody>
<actuator><position name="A" joint="J" kp="30" kv="0.5" delay="0.01" nsample="12"/></actuator></mujoco>"""
TENDON = """<mujoco model="tendon"><compiler angle="degree" /><option timestep="0.001"/>
<default><geom contype="0" conaffinity="0"/></default>
<worldbody><site name="anchor" pos="0.02 0 -0.1"/><site name="side" pos="0.05 0 0"/>
<geom name="pulley" type="cylinder" size="0.01" fromto="0 -0.02 0 0 0.02 0"/>
<body name="arm"><joint name="elbow" type="hinge" axis="0 1 0" damping="0.02" stiffness="0.3" armature="0.001"/>
<geom type="capsule" size="0.005" fromto="0 0 0 0 0 0.12" mass="0.05"/><site name="end" pos="0.01 0 0.08"/></body>
</worldbody>
<tendon><spatial name="cable"><site site="anchor"/><geom geom="pulley" sidesite="side"/><site site="end"/></spatial>
</tendon>
<actuator><position name="A" tendon="cable" kp="2000" kv="20" ctrlrange="-0.01 0.01" ctrllimited="true"/></actuator>
<keyframe><key name="home" qpos="0.1"/></keyframe></mujoco>"""
_LINK = """<body name="b{i}" pos="0 0 {z}"><joint name="h{i}" type="hinge" axis="0 {sign} 0" damping="0.005"
stiffness="0.05"/><geom type="capsule" size="0.004" fromto="0 0 0 0 0 0.02" mass="0.004"/>"""
ANTAGONISTS = (
    """<mujoco model="antagonists"><compiler angle="radian"/><option timestep="0.001" integrator="implicitfast"/>
<default><geom contype="0" conaffinity="0"/></default>
<worldbody><body pos="0 0 -0.05"><joint name="spindle" type="hinge" axis="0 1 0" damping="0.001" armature="1e-4"/>
<geom type="sphere" size="0.01" mass="0.02"/></body>"""
    + "".join(_LINK.format(i=i, z=0.02 if i else 0, sign=-1 if i == 2 else 1) for i in range(3))
    + """<site name="tip" pos="0 0 0.02"/></body></body></body></worldbody><tendon>"""
    + "".join(
        f'<fixed name="{name}" limited="true" range="{ends}"><joint joint="spindle" coef="0.01"/>'
        '<joint joint="h0" coef="-0.004"/><joint joint="h1" coef="-0.004"/><joint joint="h2" coef="0.004"/></fixed>'
        for name, ends in (("left", "-10 0"), ("right", "0 10"))
    )
    + """</tendon><actuator><position name="A" joint="spindle" kp="5" kv="0.05"/></actuator></mujoco>"""
)
KINDS = {
    "geared": (GEARED, "joint:J", {"J": 1.0}),
    "tendon": (TENDON, "joint:elbow", {"elbow": 1.0}),
    "antagonists": (ANTAGONISTS, "site:tip", {"h0": 1.0, "h1": 1.0, "h2": -1.0}),
}
SOLID = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.3\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
SECONDS = 12.0


@pytest.fixture(scope="module", params=list(KINDS))
def out(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An export into each kind, by the command."""
    text, tip, _ = KINDS[request.param]
    root = tmp_path_factory.mktemp(request.param)
    if request.param == "tendon":  # with a file beside it
        (root / "parts").mkdir()
        (root / "parts" / "cover.obj").write_text(SOLID)
        text = text.replace("<compiler ", '<compiler meshdir="parts" ').replace(
            '<site name="end"', '<geom type="mesh" mesh="cover" mass="0"/><site name="end"'
        )
        text = text.replace("<worldbody>", '<asset><mesh name="cover" file="cover.obj"/></asset><worldbody>')
    (root / "own.xml").write_text(text)
    exported.model().save(root / "model")
    patch, words = pytest.MonkeyPatch(), ["--into", root / "own.xml", "--actuator", "A", "--tip", tip]
    patch.setattr(
        "sys.argv",
        ["taut", "export", str(root / "model"), "--to", "mjcf", *map(str, words), "--out", str(root / "out")],
    )
    from tautline.cli import main

    main()
    patch.undo()
    return root / "out"


def unseen(step_s: float = 1e-3) -> Motor:
    """Two sines that never repeat together: no motion that the export looked at."""
    motion = sines(exported.model().rig.actuator, 4.0, SECONDS)
    return Motor(motion.t_s, motion.q)


def truth_px(q) -> Any:
    return project(exported.model().rig, exported.law(exported.play(q)))


def simulated(out: Path, scene: str, motor: Motor) -> Any:
    """The tip's angle, deg, with the exported code alone: another process, in which there is no tautline."""
    np.save(out / "motor.npy", motor.q)
    code = f"""
import sys; sys.modules["tautline"] = None; sys.path.insert(0, {str(out)!r})
import json, mujoco, numpy as np, transmission
model = mujoco.MjModel.from_xml_path({str(out / scene)!r}); data = mujoco.MjData(model)
q = np.load({str(out / "motor.npy")!r})
about = json.load(open({str(out / "transmission.json")!r}))
control = transmission.Control(model) if "callback" in {scene!r} else None
control.start(data, q[0]) if control else transmission.rest(model, data, q[0])
read, c = model.sensor("taut_tip").adr[0], []
for position in q:
    data.ctrl[model.actuator("A").id] = position * about["scale"]
    if control: control(model, data)
    mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data) if not control else mujoco.mj_fwdPosition(model, data)
    c.append(np.degrees(sum(sign * data.joint(name).qpos[0] for name, sign in about["tip"])))
np.save({str(out / "tip.npy")!r}, c)
"""
    subprocess.run([sys.executable, "-c", code], check=True, cwd=out.parent, timeout=300)
    return np.load(out / "tip.npy")


def settled(motor: Motor) -> Any:
    """From when the motor went further than B either way."""
    return motor.t_s > motor.t_s[-1] / 4


def test_the_callback_holds_the_noise_on_a_motion_that_nobody_saw(out: Path) -> None:
    motor = unseen()
    told = project(exported.model().rig, simulated(out, "scene_callback.xml", motor))
    seen = truth_px(motor.q) + np.random.default_rng(3).normal(0.0, exported.NOISE_PX, told.shape)
    left = np.sqrt(np.mean((seen - told)[settled(motor)] ** 2))
    assert left < 1.1 * exported.NOISE_PX


def test_the_xml_alone_is_within_what_it_says_of_itself(out: Path) -> None:
    said = json.loads((out / "export.json").read_text())
    assert said["unit"] == "px"
    motor = unseen()
    told = project(exported.model().rig, simulated(out, "scene.xml", motor))
    off = np.sqrt(np.mean((told - truth_px(motor.q)) ** 2, axis=1))[settled(motor)]
    stated = said["error"]["xml"]
    # Another motion is at other places of the same polynomials: by a third more in the mean, by half at the worst.
    assert np.sqrt(np.mean(off**2)) < 1.33 * stated["rms"] + 0.01
    assert off.max() < 1.5 * stated["largest"] + 0.01
    # and much nearer than what one polynomial of fourth order leaves of this B and this law
    q = exported.GRID
    one = [np.polyval(np.polyfit(q, f(q), 4), q) - f(q) for f in (exported.width, exported.law)]
    assert said["error"]["xml"]["rms"] < 0.5 * 1.5 * np.hypot(np.std(one[1]), 5.0 * np.std(one[0]))


def test_the_report_says_where_everything_went(out: Path) -> None:
    said = json.loads((out / "export.json").read_text())
    assert said["format"] == "mjcf-export/1" and said["refused"] == []
    assert {(part["what"], part["in"]) for part in said["exported"]} == {
        (what, where) for what in ("transmission.backlash", "configuration.remaining") for where in ("xml", "callback")
    }
    assert said["error"]["callback"]["rms"] < 0.45 * exported.NOISE_PX  # beside the noise that makes 1.1 times it
    assert {path.name for path in out.iterdir()} >= {"scene.xml", "scene_callback.xml", "transmission.py", "tables.csv"}


def test_what_was_in_the_file_is_there_still(out: Path) -> None:
    kind = out.parent.name.rstrip("0123456789")
    own = mujoco.MjModel.from_xml_string(KINDS[kind][0])
    for scene in ("scene.xml", "scene_callback.xml"):
        model = mujoco.MjModel.from_xml_path(str(out / scene))
        assert [model.joint(i).name for i in range(own.njnt)] == [own.joint(i).name for i in range(own.njnt)]
        assert model.nu == own.nu and model.opt.timestep == own.opt.timestep
        np.testing.assert_allclose(model.jnt_stiffness[: own.njnt], own.jnt_stiffness)
        np.testing.assert_allclose(model.body_mass[: own.nbody], own.body_mass)
        assert model.nkey == own.nkey
        if own.nkey:
            np.testing.assert_allclose(model.key_qpos[0, : own.nq], own.key_qpos[0])


def test_as_mujocos_own_callback_it_does_the_same(out: Path) -> None:
    """mjcb_control is called within a step, after positions are known: a step's lag of the constraint is left."""
    spec = importlib.util.spec_from_file_location("transmission_of_export", out / "transmission.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    model = mujoco.MjModel.from_xml_path(str(out / "scene_callback.xml"))
    data = mujoco.MjData(model)
    motor = unseen()
    control = module.Control(model)
    control.start(data, motor.q[0])
    mujoco.set_mjcb_control(control)
    tip = KINDS[out.parent.name.rstrip("0123456789")][2]
    told = []
    try:
        for q in motor.q[:6000]:
            data.ctrl[control.actuator] = q * control.scale
            mujoco.mj_step(model, data)
            told.append(np.degrees(sum(sign * data.joint(name).qpos[0] for name, sign in tip.items())))
    finally:
        mujoco.set_mjcb_control(None)
    off = np.array(told) - exported.law(exported.play(motor.q))[:6000]
    assert np.sqrt(np.mean(off[3000:] ** 2)) < 0.03  # deg: less than the camera's noise


def test_meshes_are_found_from_the_new_folder(tmp_path: Path) -> None:
    (tmp_path / "robot" / "parts").mkdir(parents=True)
    (tmp_path / "robot" / "parts" / "link.obj").write_text(SOLID)
    text = GEARED.replace('angle="radian"', 'angle="radian" meshdir="parts"').replace(
        "<worldbody>", '<asset><mesh name="link" file="link.obj"/></asset><worldbody>'
    )
    text = text.replace('type="capsule" size="0.01" fromto="0 0 0 0 0 0.3"', 'type="mesh" mesh="link"')
    own = tmp_path / "robot" / "own.xml"
    own.write_text(text)
    x = np.linspace(-5.0, 5.0, 11)
    straight, wide = chain.fit(x, 0.2 * x, 1e-9), chain.fit(x, 0.3 + 0.0 * x, 1e-9)
    law = Law(0.0, 10.0, 0.2, wide, chain.Sum((straight,)), 0.0, 0.08)
    nominal = read_nominal(Mount(own, "A", "joint:J"), "mm", (-5.0, 5.0), 0.2 * x)
    out = tmp_path / "elsewhere" / "out"
    out.mkdir(parents=True)
    for name, scene in folder.scenes(nominal, law, out).items():
        (out / name).write_text(scene)
        assert mujoco.MjModel.from_xml_path(str(out / name)).nmesh == 1


def test_a_scene_is_written_twice_and_after_each_part(tmp_path: Path) -> None:
    """Key frames have the user's coordinates, and of each slide the reference."""
    own = tmp_path / "own.xml"
    own.write_text(TENDON.replace('qpos="0.1"', 'qpos="0.1" qvel="0.3"'))
    x = np.linspace(-5.0, 5.0, 11)
    straight, wide = chain.fit(x, 0.2 * x, 1e-9), chain.fit(x, 0.3 + 0.0 * x, 1e-9)
    law = Law(2.0, 10.0, 0.2, wide, chain.Sum((straight,)), 0.0, 0.08)
    scene = Scene(read_nominal(Mount(own, "A", "joint:elbow"), "mm", (-5.0, 5.0), 0.2 * x), law)
    for part in (scene.add_motor, scene.add_play, scene.add_law):
        part()
        text = scene.text(tmp_path)
        assert scene.text(tmp_path) == text
        model = mujoco.MjModel.from_xml_string(text)
        np.testing.assert_allclose(model.key_qpos[0], [0.1, *model.qpos0[1:]])
        np.testing.assert_allclose(model.key_qvel[0], [0.3, *np.zeros(model.nv - 1)])


# -- without MuJoCo -----------------------------------------------------------------------------------------------

NOWHERE = Nominal(Path("own.xml"), Mount(Path("own.xml"), "A", "joint:J"), 1e-3, (("J", 1.0),), 0.0, 1e-3, 0.1, 1e-3)
EFFECTS = {
    "nothing": (),
    "lag": (Effect("transmission.lag", {"lag": 0.05, "lag_second": 0.3}),),
    "creep": (Effect("transmission.creep", {"creep_share": 0.1, "creep_time": 0.8, "creep_slow": 0.4}),),
    "contact": (
        Effect(
            "configuration.contact",
            {"contact_hold": 0.6, "contact_c": 15.0, "contact_side": 1.0, "contact_soft": 3.0},
        ),
    ),
    "encoder": (
        Effect(
            "actuator.encoder_periodic",
            {
                "encoder_sin": 0.02,
                "encoder_cos": -0.01,
                "encoder_sin2": 0.005,
                "encoder_cos2": 0.0,
                "encoder_period": 0.9,
            },
        ),
    ),
}
GRADUAL = Elements((0.1, 0.7, 1.0, 1.3, 1.9), (0.2, 0.2, 0.2, 0.2, 0.2))


def stepped(model: Model, motor: Motor, path: Path) -> Any:
    for name, text in folder.callback_files(model, NOWHERE).items():
        (path / name).write_text(text)
    course = Transmission(path)
    first = course.start(float(motor.q[0]))
    return np.array([first] + [course.step(float(q), 1e-3) for q in motor.q[1:]])


@pytest.mark.parametrize("elements", [SINGLE, GRADUAL], ids=["one play", "several"])
@pytest.mark.parametrize("name", list(EFFECTS))
def test_the_callbacks_equations_are_the_predictions(tmp_path: Path, name: str, elements: Elements) -> None:
    model = exported.model(elements, EFFECTS[name])
    motor = unseen()
    told = predict(model, motor, motor.t_s).c_deg
    np.testing.assert_allclose(stepped(model, motor, tmp_path), told, atol=2e-3)  # half a count of 1 um is 5e-3 deg


def test_an_effect_that_is_not_there_is_refused_with_what_it_leaves(tmp_path: Path, taut: Taut) -> None:
    onset = Effect("transmission.smooth_onset", {"onset_spread": 0.5, "onset_tail": 0.0})
    side = Effect(
        "transmission.asymmetric_backlash", {"asymmetry": 0.1, "asymmetry_travel": 0.3, "asymmetry_form": 1.0}
    )
    model = exported.model(effects=(onset, side))
    (tmp_path / "own.xml").write_text(GEARED)
    model.save(tmp_path / "model")
    words = ("--to", "mjcf", "--into", tmp_path / "own.xml", "--actuator", "A", "--tip", "joint:J")
    done = taut("export", tmp_path / "model", *words, "--out", tmp_path / "out", "--json")
    report = json.loads(done.out)["report"]
    refused = {(part["what"], part["in"]): part["error"] for part in report["refused"]}
    assert refused.keys() == {
        ("transmission.smooth_onset", "xml"),
        ("transmission.asymmetric_backlash", "xml"),
        ("transmission.asymmetric_backlash", "callback"),
    }
    # What the callback leaves is what it refuses, and not much more; it is said on the terminal too.
    lone = refused["transmission.asymmetric_backlash", "callback"]
    assert lone > exported.NOISE_PX and report["error"]["callback"]["rms"] == pytest.approx(lone, rel=0.15)
    assert "transmission.asymmetric_backlash is not in callback" in done.err


def test_a_lag_is_in_the_xml_too(tmp_path: Path) -> None:
    model = exported.model(effects=(Effect("transmission.lag", {"lag": 0.05, "lag_second": 0.0}),))
    (tmp_path / "own.xml").write_text(GEARED)
    from tautline.io.exporting import export
    from tautline.io.exporting.source import of_model

    done = export(of_model(model), "mjcf", tmp_path / "out", mount=Mount(tmp_path / "own.xml", "A", "joint:J"))
    motor = unseen()
    told = predict(model, motor, motor.t_s).c_deg
    late = simulated(tmp_path / "out", "scene.xml", motor) - told
    without = predict(exported.model(), motor, motor.t_s).c_deg - told
    rms = [float(np.sqrt(np.mean(off[settled(motor)] ** 2))) for off in (late, without)]
    assert rms[0] < 0.2 * rms[1] and done.report["report"]["refused"] == []


# -- chains of polynomials ----------------------------------------------------------------------------------------


def test_a_chain_holds_a_bump_that_one_polynomial_does_not() -> None:
    x, y = exported.GRID, exported.width(exported.GRID)
    one = np.std(np.polyval(np.polyfit(x, y, 4), x) - y)
    found = chain.fit(x, y, 1e-3)
    assert len(found.links) <= chain.MOST_LINKS
    assert np.std(found(x) - y) == pytest.approx(found.rms, rel=1e-3) and found.rms < 0.1 * one


def test_chains_side_by_side_leave_less_than_the_first_alone() -> None:
    x = exported.GRID
    y = exported.law(x) + 3.0 * np.sin(1.7 * x)
    found = chain.fit_sum(x, y, 0.0)
    assert len(found.chains) == chain.MOST_CHAINS
    assert np.std(found(x) - y) < 0.7 * found.chains[0].rms


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-3.0, 3.0), min_size=5, max_size=5), st.floats(-100.0, 100.0), st.floats(0.1, 50.0))
def test_a_polynomial_of_fourth_order_is_its_own_chain(coefficients: list[float], middle: float, span: float) -> None:
    x = middle + span * np.linspace(-1.0, 1.0, 101)
    y = np.polyval(coefficients, (x - middle) / span)
    found = chain.fit(x - middle, y, 1e-9)
    assert len(found.links) == 1
    np.testing.assert_allclose(found(x - middle), y, atol=1e-9)


# -- bad input ----------------------------------------------------------------------------------------------------


def test_bad_input_names_what_is_wrong_and_writes_nothing(tmp_path: Path, taut: Taut) -> None:
    model, own, out = tmp_path / "model", tmp_path / "own.xml", tmp_path / "out"
    exported.model().save(model)
    limited = TENDON.replace('"-0.01 0.01"', '"-0.001 0.001"')
    bent = ANTAGONISTS.replace('name="h1" type="hinge" axis="0 1 0"', 'name="h1" type="hinge" axis="1 0 0"')
    taken = GEARED.replace('"J"', '"taut_q"')
    for text, actuator, tip, said in (
        (GEARED, "B", "joint:J", "has no actuator B, but A"),
        (GEARED, "A", "joint:K", "has no hinge K, but J"),
        (GEARED, "A", "J", "expected joint:NAME or site:NAME"),
        (GEARED, "A", "site:end", "has no site end, but none at all"),
        (TENDON, "A", "site:anchor", "no free hinge is above the site anchor"),
        (limited, "A", "joint:elbow", "give --scale"),
        (bent, "A", "site:tip", "turn about different axes"),
        (taken, "A", "joint:taut_q", "is in it already"),
        ("<mujoco>", "A", "joint:J", "MuJoCo cannot read it"),
    ):
        own.write_text(text)
        words = ("--to", "mjcf", "--into", own, "--actuator", actuator, "--tip", tip, "--out", out)
        assert said in taut.refuses("export", model, *words)
        assert not out.exists()
    nowhere = ("--to", "mjcf", "--into", tmp_path / "no.xml", "--actuator", "A", "--tip", "joint:J", "--out", out)
    assert "there is no such file" in taut.refuses("export", model, *nowhere)
    own.write_text(GEARED)
    zero = ("--to", "mjcf", "--into", own, "--actuator", "A", "--tip", "joint:J", "--scale", 0, "--out", out)
    assert "not 0" in taut.refuses("export", model, *zero)


def test_what_needs_an_input_that_the_scene_has_not_is_refused_without_a_figure(tmp_path: Path) -> None:
    load = Effect(
        "transmission.load_dependence", {"width_per_load": 0.01, "gain_per_load": 0.0, "offset_per_load": 0.0}
    )
    model, motor = exported.model(effects=(load,)), unseen()
    x = exported.GRID
    law = Law(0.0, 10.0, 0.2, chain.fit(x, 0.2 + 0.0 * x, 1e-9), chain.fit_sum(x, 0.2 * x, 1e-9), 0.0, 0.08)
    _, refused = folder.parts(model, law, motor, predict(model, motor, motor.t_s).c_deg)
    (part,) = refused
    assert part["what"] == load.id and part["in"] == "both" and part["error"] is None


def test_the_sensor_is_as_late_as_the_camera(out: Path) -> None:
    """Which interpolates linearly between steps of 1 ms: 80 ms are 80 of them."""
    model = mujoco.MjModel.from_xml_path(str(out / "scene_callback.xml"))
    data = mujoco.MjData(model)
    told = {name: np.empty(600) for name in ("taut_tip", "taut_tip_seen")}
    lead = model.joint("taut_c")
    for k in range(600):
        data.qvel[lead.dofadr[0]] = 0.5 * np.cos(0.01 * k)
        mujoco.mj_step(model, data)
        for name, column in told.items():
            column[k] = data.sensor(name).data[0]
    late = np.interp(np.arange(200, 600) - 80.0, np.arange(600), told["taut_tip"])
    np.testing.assert_allclose(told["taut_tip_seen"][200:], late, atol=2e-4)
    assert np.ptp(told["taut_tip"]) > 0.05
