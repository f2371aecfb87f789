"""The fifth sealed family: its mechanisms by their equations, causes by what they do, files by the formats."""

import json
import math
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from tools.family import score, seal
from tools.family_five import cases, mechanisms, motion
from tools.family_five.causes import LISTED, NOMINAL, UNLISTED
from tools.family_five.mechanism import Ask, resisted
from tools.family_four import files
from tools.family_four.plant import Plant, carried, logged, show
from tools.family_three import camera, nominal
from tools.family_three.line import lay
from tools.family_two.motion import STEP

FAMILY = Path(__file__).parents[2] / "tools" / "family_five"
SEED = 3  # never a reserved one
LONG = {"calibration": motion.calibration, **motion.MOTIONS}


@pytest.fixture(scope="module", autouse=True)
def short():
    """Recordings of some 12 s, calibrations of 30."""
    cut = {n: (lambda rng, reach, width, _, make=make: make(rng, reach, width, 12.0)) for n, make in LONG.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "calibration", lambda rng, reach, width, _: LONG["calibration"](rng, reach, width, 30.0))
        patch.setattr(motion, "MOTIONS", {name: cut[name] for name in motion.MOTIONS})
        patch.setattr(nominal, "MOST_FRAMES", 600)
        yield


@pytest.fixture(scope="module")
def watched():
    """A section under a camera with all else moving, on a line that every cause can act on."""
    rng = np.random.default_rng(8)
    m = mechanisms.Drawer(rng)
    plant, paths = Plant(m, camera.draw(rng, False, m.farthest()), 0.08), []
    for name, make in (("calibration", LONG["calibration"]), ("test-1", LONG["pilgrim"])):
        q = make(rng, m.reach, m.width, 30.0)
        t = np.arange(q.size) * STEP
        others = {"translation_mm": 3 * np.sin(t / 2), "rotation_deg": 6 * np.sin(0.7 * t), "wrist_deg": 40 * np.sin(t)}
        paths.append((name, q, others | {"load_mNm": 25 - 25 * np.cos(t)}, np.arange(0.25, t[-1] - 0.2, 0.04)))
    return plant, lay(paths, m.reach, m.width, m.slope(), m.turn)


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_a_healthy_mechanism_is_a_plain_hysteresis(name, monkeypatch):
    """A width that depends on place alone and a smooth law, fitted to the noisy calibration, tell an unseen motion."""
    monkeypatch.setattr(cases, "MECHANISMS", {name: cases.MECHANISMS[name]})
    monkeypatch.setattr(motion, "calibration", lambda rng, r, w, _: LONG["calibration"](rng, r, w, 50.0))
    monkeypatch.setattr(nominal, "MOST_FRAMES", 2000)
    case = cases.draw(SEED, 20, "none", ())
    missed = carried(case.plant, case.line, case.noise)
    assert math.hypot(1, missed / case.noise) < 1.1 and cases.healthy_rest(case) < 0.3 * case.noise
    assert 0.005 < case.line.width / case.line.reach < 0.5  # and it is one


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_no_law_folds_back(name):
    """Healthy branches rise and lie apart; so do bent ones, and each place found is where the balance has it."""
    for seed in range(8):
        m = cases.MECHANISMS[name](np.random.default_rng(seed))
        up, down = m.need(m.xs, 1.0), m.need(m.xs, -1.0)
        assert np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0) and np.all(up > down)
        assert m.need(0.0, 1.0) - m.need(0.0, -1.0) == pytest.approx(m.width, rel=1e-6)
        q, one = 0.9 * m.reach * np.sin(np.arange(0, 6, 0.02)), np.ones(300)
        for a in (
            Ask(q, rub=1.4 * one), Ask(q, pull=-0.2 * one), Ask(q, law=0.1 * one), Ask(q, law=-0.1 * one),
            Ask(q, tissue=0.6 * one, tissue_at=0.4 * m.limit, tissue_hardens=1 / m.limit),
            Ask(q, tissue=0.6 * one, tissue_at=9.0, tissue_side=-1.0, tissue_hardens=1 / m.limit),
        ):  # fmt: skip
            for way in (1.0, -1.0):
                x = m.inverted(a, way)
                near = [m.need(x + e, way, a.rub, m.pressed(a, x + e), a.law) for e in (-0.01, 0.01)]
                assert np.mean((near[0] <= q) & (near[1] >= q)) > 0.99


def test_equations_by_hand():
    rng, x, f = np.random.default_rng(6), np.array([-14.0, 3.0, 15.0]), 0.05
    m = mechanisms.Magnet(rng)
    q, a, u = np.radians(m.raw(x, f, 0.1, 0.0)), np.radians(x), x / m.limit
    spring = (u + m.hardens * u**3) / (1 + m.hardens)
    held = m.soft * (spring + 0.1 + f * (1 + m.leans * u * u + m.tilt * u))
    assert np.sin(q) * np.cos(a) - 2 * np.cos(q) * np.sin(a) == pytest.approx(held)  # torque of the dipole's field
    d = mechanisms.Drawer(rng)
    grows = d.raw(0.0, f, 0.1, 0.0) - d.raw(0.0, f, 0.0, 0.0)
    assert grows == pytest.approx(d.stroke * d.gives * 0.1 / (1 - 2 * f * d.off))  # binds
    w = mechanisms.Meniscus(rng)
    w.air = 0.0
    angle, h = math.acos(w.wets - f), math.sin(math.radians(15.0)) / math.sin(math.radians(w.limit))
    column = quad(lambda z: (1 + w.cone * z + w.bulge * z * z) ** 2, 0, h)[0]
    r = w.bore * (1 + w.cone * h + w.bulge * h * h)  # of the lift; a cap of a ball that meets the wall at the angle
    ball = r / math.cos(angle)
    cap = quad(lambda p: 2 * p * (math.sqrt(ball**2 - p * p) - math.sqrt(ball**2 - r * r)), 0, r)[0]
    volume = w.raw(15.0, f, 0.0, 0.0) * w.plunger**2 / w.lift
    assert volume == pytest.approx(column - cap / w.bore**2, rel=1e-6)
    t = mechanisms.Tackle(rng)
    t.stretch = 0.0
    assert t.raw(1e-3, f, 0.0, 0.0) - t.raw(-1e-3, f, 0.0, 0.0) == pytest.approx(
        t.crank * t.parts * t.far * math.sin(math.radians(t.opens)) * math.radians(2e-3)
        / math.sqrt(1 + t.far**2 - 2 * t.far * math.cos(math.radians(t.opens))), rel=1e-5,
    )  # fmt: skip
    c = mechanisms.Cardan(rng)
    c.winds = 0.0
    turned = np.radians(c.raw(x, f, 0.0, 0.0) + c.phase)
    straight = np.tan(np.radians(x + c.phase)) * math.cos(math.radians(c.bent))
    assert np.tan(turned) == pytest.approx(straight)
    k = mechanisms.Coupling(rng)
    lag = np.radians(k.raw(0.0, f, 0.2, 0.0)) * k.pairs
    assert k.pulls * math.sin(lag) == pytest.approx(0.2 + f)


def test_a_mass_between_magnets_swings_and_is_held_by_friction():
    m = mechanisms.Coupling(np.random.default_rng(4))
    path = np.concatenate([np.linspace(0, 10, 1000), np.full(500, 10.0), np.linspace(10, 0, 1000)])
    x = m.run(SimpleNamespace(q=path))
    low, high = m.inverted(Ask(path), 1.0), m.inverted(Ask(path), -1.0)
    assert low[1490] - 0.02 < x[1490] < high[1490] and x[1490] == x[1400]
    assert x[-1] > high[-1] - 0.02 and abs(x[-1] - high[-1]) < 0.3  # a little late
    m.damping, m.f = 0.0, 0.0
    swung = m.run(SimpleNamespace(q=np.where(np.arange(200) < 5, 0.0, 5.0)))
    assert swung.max() > 1.02 * brentq(lambda v: m.need(v, 1.0) - 5.0, -20, 20)  # runs past


def test_what_resists_the_sliding():
    up = np.minimum(np.arange(3000) * STEP, 3.0)
    far, one = np.full(up.size, 100.0), np.ones(up.size)
    for index in (1.0, 0.8):
        late = up - 1 - resisted(up - 1, far, -1.0, Ask(up, drag=0.2 * one, drag_gap=0.2, drag_index=index))
        assert late[1400] == pytest.approx(0.2, abs=0.005)  # at this speed, whatever the fluid
    late = 0.5 * up - 1 - resisted(0.5 * up - 1, far, -1.0, Ask(up, drag=0.2 * one, drag_gap=0.2, drag_index=0.8))
    assert late[1400] == pytest.approx(0.2 * 0.5**0.8, abs=0.005)
    jumps = np.diff(resisted(up - 1, far, -1.0, Ask(up, pins=0.3 * one)))
    assert np.max(jumps) == pytest.approx(0.302, abs=0.003) and np.sum(jumps > 0.1) > 5
    held = resisted(up - 1, far, -1.0, Ask(up, ring=0.5 * one, ring_rolls=1.0))
    assert held[240] == -1.0 and (up - 1 - held)[1490] < 0.02  # later by the ring, then caught up
    back = resisted(-far, 1 - up, 1.0, Ask(up, ring=0.5 * one, ring_rolls=1.0, ring_way=-1.0))
    assert back == pytest.approx(-held)


@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_every_cause_changes_something_only_when_it_is_there(name, watched):
    plant, line = watched
    kind = LISTED.get(name) or UNLISTED[name]
    assert not (kind.moves and kind.may_start)  # what recalibration closes would be a part of what is calibrated
    cause = kind(0.7 * kind.limits.hi, "test", 12)
    plain, bent = show(plant, line, ()), show(plant, line, (cause,))
    assert bent[0].values == pytest.approx(plain[0].values, abs=1e-4)
    assert bent[0].arrival == pytest.approx(plain[0].arrival, abs=1e-9)
    off = logged(line, (cause,)) - line.q
    assert np.all(off[: line.parts[0].count] == 0)
    changed, late = bent[1].values - plain[1].values, bent[1].arrival - plain[1].arrival
    assert np.max(np.abs(changed)) > 0.2 or np.max(np.abs(late)) > 1e-3 or np.max(np.abs(off)) > 1e-3
    assert np.all(np.diff(bent[1].arrival) > 0)
    assert np.all(np.isfinite(bent[1].values)) and all(v == v for v in cause.parameters(line).values())


def test_effects_act_together(watched):
    plant, line = watched
    kinds = [LISTED[f"transmission.{n}"] for n in ("smooth_onset", "lag", "load_dependence", "rate_dependent_backlash")]
    causes = [k(k.limits.hi, "test", 12) for k in kinds]
    both = show(plant, line, causes)[1].values
    for i in range(len(causes)):
        without = show(plant, line, causes[:i] + causes[i + 1 :])[1].values
        assert np.max(np.abs(both - without)) > 0.3


def test_what_logs_and_recorders_do(watched):
    plant, line = watched
    ahead = logged(line, (UNLISTED["planner_lead"](0.3, "start", 1),))
    lead = (ahead - line.q) * np.sign(line.speed)
    assert np.max(lead) < 0.3 * np.max(np.abs(line.speed))
    assert np.median(lead[np.abs(line.speed) > 0.5 * line.usual_speed]) > 0.15 * line.usual_speed
    wrong = logged(line, (UNLISTED["flipped_bits"](0.125, "start", 1),)) - line.q
    assert set(np.round(np.abs(wrong[wrong != 0]) / line.reach, 3)) <= {0.25}
    smooth = logged(line, (UNLISTED["zero_phase_log"](0.1, "start", 1),))
    assert np.std(smooth - line.q) < 0.05 * line.reach and np.max(smooth) < np.max(line.q)
    again = show(plant, line, (UNLISTED["replayed_segment"](0.4, "start", 1),))[1].pick
    assert Counter((again - np.arange(again.size)).tolist()).keys() == {0, -10}
    flow = show(plant, line, (UNLISTED["reanchored_flow"](0.1, "start", 1),))[1].values
    off = np.abs(flow - show(plant, line, ())[1].values).max(axis=1)
    assert np.sum(off < 1e-9) > 5 and off.max() > 1.0  # set right at each key frame


@pytest.mark.parametrize("name", ["transmission.slip", "registration.shift", "acquisition.delay", "echoing_shaper"])
def test_an_effect_has_its_strength(name):
    case = cases.draw(SEED, 9, "single" if name in LISTED else "unknown", (name,))
    (cause,), (stated,) = case.causes, case.strengths
    base = cases.healthy_rest(case)
    assert cases.measure(case, case.causes, base) == pytest.approx(stated, rel=1e-6)
    half = cases.measure(case, (replace(cause, size=cause.size / 2),), base)
    assert cases.strength(cause, stated) >= cases.FAINTEST
    assert 0.02 < cases.strength(cause, half) / cases.strength(cause, stated) < 0.9


def test_what_is_there_from_the_start_shows_in_the_calibration():
    early = 0
    for i, name in enumerate(("transmission.creep", "payne_softening", "acquisition.held_samples", "planner_lead")):
        case = cases.draw(SEED, 30 + i, "single" if name in LISTED else "unknown", (name,))
        if case.causes[0].since == "start":
            early += 1
            assert cases.early_rest(case, case.causes[0]) >= 2 * case.noise
    assert early


def test_the_plan_has_its_shares_and_every_id():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES
    singles = Counter(ids[0] for kind, ids in plan if kind == "single")
    assert set(singles) == set(LISTED) - set(NOMINAL) and min(singles.values()) >= 6 and len(LISTED) == 25
    assert {ids[0] for kind, ids in plan if kind in ("unknown", "nominal")} == {*UNLISTED, *NOMINAL}
    text = "".join((FAMILY.parent / f"family{n}" / "BRIEF.md").read_text() for n in ("", "_two", "_three", "_four"))
    assert not [w for w in (*UNLISTED, *motion.MOTIONS, *cases.MECHANISMS) if f"| {w} |" in text or f"{w} (" in text]


def rows(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def test_recordings_are_as_the_formats_say_and_the_same_each_time(tmp_path):
    for i, (kind, ids) in enumerate([("none", ()), ("single", ("transmission.drift",)), ("unknown", ("coughs",))]):
        case = cases.draw(SEED, i, kind, ids)
        truth = files.write(case, SEED, tmp_path, tmp_path / "truth")
        folder = tmp_path / "cases" / case.name
        rig = tomllib.loads((folder / "rig.toml").read_text())
        unit, reach = rig["actuator"]["unit"], rig["actuator"]["range"][1]
        recordings = sorted(p for p in folder.iterdir() if p.is_dir())
        assert [p.name for p in recordings] == ["calibration", *truth["tests"]]
        for where in (*recordings, tmp_path / "unseen" / case.name):
            names, motor = rows(where / "motor.csv")
            assert names[:2] == ["t_s", f"q_{unit}"] and np.all(np.isfinite(motor)) and np.all(np.diff(motor[:, 0]) > 0)
            assert np.max(np.abs(motor[:, 1])) <= reach
            seen_in = "times" if where.parent.name == "unseen" else "marker" if truth["unit"] == "px" else "angle"
            names, seen = rows(where / f"{seen_in}.csv")
            assert names == ["t_s", *{"times": (), "marker": ("u_px", "v_px"), "angle": ("c_deg",)}[seen_in]]
            assert np.all(np.diff(seen[:, 0]) > 0) and motor[0, 0] < seen[0, 0] and seen[-1, 0] < motor[-1, 0] + 0.1
        assert seen[0, 0] < truth["unseen_valid_from_s"] < seen[-1, 0] - 2
        said = {"verdict": truth["verdict"], "effects": [{"id": c["id"]} for c in truth["causes"] if c["listed"]]}
        (tmp_path / f"{case.name}.json").write_text(json.dumps(said))
    result = score.collect(tmp_path, tmp_path / "truth", None)
    assert all(result[k]["right"] == 1 for k in ("single leads", "none called none", "unknown called unknown"))
    files.write(cases.draw(SEED, i, kind, ids), SEED, tmp_path / "b", tmp_path / "b" / "truth")
    for path in (tmp_path / "b").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / path.relative_to(tmp_path / "b")).read_bytes()


@pytest.mark.parametrize("name", LONG)
def test_motions_turn_round_often_and_stay_inside(name):
    for i in range(6):
        q = LONG[name](np.random.default_rng(i), 5.0, 0.2 + 0.35 * i, 40.0)
        assert np.max(np.abs(q)) <= 5.0 and 39.0 < q.size * STEP < 41.0
        assert np.max(np.abs(np.diff(q))) < 0.06
        assert np.sum(np.diff(np.sign(np.diff(q)[np.abs(np.diff(q)) > 1e-9])) != 0) >= 4


def test_the_seal_holds():
    """The generator is what it was when it was sealed; a change needs new seeds and a new family."""
    every = "".join(path.read_text() for path in FAMILY.rglob("*.py"))
    assert "import tautline" not in every and "from tautline" not in every
    sealed = dict(line.split(None, 1) for line in (FAMILY / "SEAL.txt").read_text().splitlines() if line.strip())
    assert sealed["sources"] == seal.sources(FAMILY)
    assert sealed["plan"] == seal.planned(int(sealed["seed"]), int(sealed["cases"]), cases.plan)
