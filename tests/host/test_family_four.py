"""The fourth sealed family: its mechanisms by their equations, causes by what they do, files by the formats."""

import json
import math
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tools.family import score, seal
from tools.family_four import cases, files, mechanisms, motion
from tools.family_four.causes import LISTED, NOMINAL, UNLISTED
from tools.family_four.causes.hidden_watch import uncovered
from tools.family_four.mechanism import Demand
from tools.family_four.plant import Plant, carried, logged, show
from tools.family_four.slide import Feel, free, heavy, iwan, slide
from tools.family_three import camera, nominal
from tools.family_three.line import lay
from tools.family_two.motion import STEP

FAMILY = Path(__file__).parents[2] / "tools" / "family_four"
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
    """A section at a rod's end under a camera with all else moving, on a line that every cause can act on."""
    rng = np.random.default_rng(8)
    m = mechanisms.Pushrod(rng)
    plant, paths = Plant(m, camera.draw(rng, False, m.farthest()), 0.08), []
    for name, make in (("calibration", LONG["calibration"]), ("test-1", LONG["rate_joystick"])):
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
        q, one = m.reach * np.sin(np.arange(0, 6, 0.02)), np.ones(300)
        for d in (
            Demand(q, rub=1.6 * one), Demand(q, load=-0.6 * one), Demand(q, law=0.15 * one), Demand(q, law=-0.1 * one),
            Demand(q, wall=0.6 * one, wall_at=0.4 * m.limit), Demand(q, wall=0.6 * one, wall_at=9.0, wall_side=-1.0),
        ):  # fmt: skip
            for found, s in zip(m.branches(d), (1.0, -1.0), strict=True):
                near = [
                    m.need(found + e, s, d.rub, d.load, d.law, d.wall, d.wall_at, d.wall_side) for e in (-0.01, 0.01)
                ]
                assert np.mean((near[0] <= q) & (near[1] >= q)) > 0.99


def test_equations_by_hand():
    rng, x, f = np.random.default_rng(6), np.array([-14.0, 3.0, 15.0]), 0.05
    m = mechanisms.McKibben(rng)
    y, (e1, e2) = m.raw(x, f, 0.1, 0.0), (m.e0 + m.k * x, m.e0 - m.k * x)
    pulls = (1 + y) * (m.g(e1) - f * (1 + m.contact * e1)) - (1 - y) * (m.g(e2) + f * (1 + m.contact * e2))
    assert pulls == pytest.approx(m.weight * np.sin(np.radians(x + m.lean)) + 0.1)
    n = mechanisms.Notched(rng)
    y = float(n.y0 + np.radians(15.0))
    held = y + float(n.closing(np.array(y)))
    pull = (n.raw(15.0, f, 0.0, 0.0) - 2 * n.notches * math.sin(y / 2 / n.notches)) / n.stretch - f * n.seal
    # along the bend the pull falls by f T dy and bends by T: dT = -f T^2 ds K'; its mean must hold the bend
    cable = solve_ivp(lambda s, v: -f * v**2 * y / held, (0, 1), [pull], rtol=1e-9, dense_output=True)
    assert np.mean(cable.sol(np.linspace(0, 1, 2001))) == pytest.approx(held, rel=1e-3)
    t = mechanisms.Toggle(rng)
    cos = 1 - 0.5 * (t.y0 + t.r * np.sin(np.radians(x)))
    a, thrust = np.arccos(cos), t.pre + t.spring * x / t.limit
    force = (t.raw(x, 0.0, 0.0, 0.0) - np.sin(a)) / t.stretch
    assert force * np.cos(a) == pytest.approx(thrust * 2 * np.sin(a))  # work: F d(sin a) = P d(2 (1 - cos a))
    p = mechanisms.Pushrod(rng)
    u = 15.0 / p.limit
    out = u + p.hard * u**3
    channel = solve_ivp(lambda s, v: 0.1 * np.hypot(v, p.pressed), (0, p.bend), [out], rtol=1e-9)  # dF = f N ds
    straight, force = (p.raw(15.0, 0.1, 0.0, 0.0) - u * (1 - 0.06 * u * u)) / p.stretch, channel.y[0, -1]
    assert straight == pytest.approx(force + p.snakes * 0.25 * (force + math.hypot(force, 0.5)) ** 2, rel=1e-6)
    c = mechanisms.Cycloid(rng)
    assert c.f > c.weight and 2 * c.winds[0] < c.width_deg  # one flank bears; the width holds both gaps
    b = mechanisms.Belt(rng)  # spans as stiff as their tension has them, to first order
    soft = b.stretch * (b.power * b.taut ** (b.power - 1) + 0.02)
    b.uneven = 0.0
    assert b.raw(0.0, 0.0, 0.01, 0.0) - b.raw(0.0, 0.0, -0.01, 0.0) == pytest.approx(0.02 * soft, rel=0.02)


def test_what_resists_the_sliding():
    up = np.minimum(np.arange(3000) * STEP, 3.0)
    far, one = np.full(up.size, 100.0), np.ones(up.size)
    late = up - 1 - slide(up - 1, far, -1.0, Feel(drag=0.2 * one), STEP)
    assert late[1400] == pytest.approx(0.2, abs=0.005)  # a ramp is followed by its time constant late
    jumps = np.diff(slide(up - 1, far, -1.0, Feel(stick=0.3 * one, age=0.05), STEP))
    assert 0.1 < np.max(jumps) < 0.46 and np.sum(jumps > 0.1) > 5
    assert np.max(np.diff(slide(up - 1, far, -1.0, Feel(stick=0.3 * one, age=0.9), STEP))) < 0.01  # it glides
    held = slide(up - 1, far, -1.0, Feel(nap=0.5 * one, worn=0.2), STEP)
    assert held[240] == -1.0 and (up - 1 - held)[1490] < 0.02  # later by the nap, then caught up
    assert slide(-far, 1 - up, 1.0, Feel(nap=0.5 * one, worn=0.2, way=-1.0), STEP) == pytest.approx(-held)
    shares = iwan(0.4, 0.6)
    assert sum(w for w, _ in shares) == pytest.approx(1) and sum(w * r for w, r in shares) == pytest.approx(1)


def test_a_mass_swings_and_stays_where_friction_holds_it():
    w, z, n = 4 * math.pi, 0.1, 500
    steps = np.linalg.matrix_power(np.reshape(free(w, z, STEP), (2, 2)), n)
    d = w * math.sqrt(1 - z * z)
    assert steps[0, 0] == pytest.approx(math.exp(-z * w) * (math.cos(d) + z * w / d * math.sin(d)), abs=1e-6)
    path = np.concatenate([np.linspace(0, 3, 1000), np.full(300, 3.0), np.linspace(3, 0, 1000)])
    x = heavy(path - 0.5, path + 0.5, 0.0, 60.0, np.full(path.size, 0.5), STEP)
    assert x[1250] == pytest.approx(2.5, abs=0.02) and x[1400] == x[1350] and x[-1] == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_every_cause_changes_something_only_when_it_is_there(name, watched):
    plant, line = watched
    kind = LISTED.get(name) or UNLISTED[name]
    cause = kind(kind.limits.hi, "test", 12)
    plain, bent = show(plant, line, ()), show(plant, line, (cause,))
    assert bent[0].values == pytest.approx(plain[0].values, abs=1e-4)
    assert bent[0].arrival == pytest.approx(plain[0].arrival, abs=1e-9)
    off = logged(line, (cause,)) - line.q
    assert np.all(off[: line.parts[0].count] == 0)
    changed, late = bent[1].values - plain[1].values, bent[1].arrival - plain[1].arrival
    assert np.max(np.abs(changed)) > 0.2 or np.max(np.abs(late)) > 1e-3 or np.max(np.abs(off)) > 1e-3
    assert np.all(np.diff(bent[1].arrival) > 0)
    assert np.all(np.isfinite(bent[1].values)) and all(v == v for v in cause.parameters(line).values())


def test_what_logs_and_stamps_do(watched):
    plant, line = watched
    assert logged(line, (UNLISTED["averaged_log"](0.4, "start", 1),))[5000] == pytest.approx(line.q[4801:5001].mean())
    ticks = logged(line, (UNLISTED["coarse_ticks"](0.1, "start", 1),))
    assert np.sum(np.diff(ticks) != 0) <= line.t[-1] / 0.1 and np.isin(ticks, line.q).all()
    dropped = show(plant, line, (UNLISTED["silent_drops"](0.05, "start", 1),))[1]
    ahead = dropped.pick - np.arange(dropped.pick.size)
    assert np.all(np.diff(dropped.pick) >= 0) and ahead.max() > 2 and np.sum(ahead[:-20] == 0) > 20  # set right again
    filled = show(plant, line, (UNLISTED["filling_buffer"](0.2, "start", 1),))[1]
    waits = filled.arrival - filled.part.exposed - plant.delay
    assert -1e-9 < waits.min() < 0.05 and 0.15 < waits.max() < 0.21


def test_a_bar_moves_the_centroid_of_what_it_leaves():
    disc = (points := np.random.default_rng(1).uniform(-3, 3, (400_000, 2)))[np.hypot(*points.T) < 3]
    for d in (-2.0, 0.0, 1.0, 3.5, 6.0):
        left = np.mean(disc[np.abs(disc[:, 0] + d) > 1.2, 0])
        assert uncovered(np.array([d]), 3.0, 1.2)[0] == pytest.approx(left, abs=0.02)


@pytest.mark.parametrize("name", ["transmission.slip", "registration.shift", "acquisition.delay", "vibration_bursts"])
def test_an_effect_has_its_strength(name):
    case = cases.draw(SEED, 9, "single" if name in LISTED else "unknown", (name,))
    (cause,), (stated,) = case.causes, case.strengths
    base = cases.healthy_rest(case)
    assert cases.measure(case, case.causes, base) == pytest.approx(stated, rel=1e-6)
    half = cases.measure(case, (replace(cause, size=cause.size / 2),), base)
    assert cases.strength(cause, stated) >= cases.FAINTEST
    assert 0.02 < cases.strength(cause, half) / cases.strength(cause, stated) < 0.9


def test_the_plan_has_its_shares_and_every_id():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES
    singles = Counter(ids[0] for kind, ids in plan if kind == "single")
    assert set(singles) == set(LISTED) - set(NOMINAL) and min(singles.values()) >= 6
    assert {ids[0] for kind, ids in plan if kind in ("unknown", "nominal")} == {*UNLISTED, *NOMINAL}
    text = "".join((FAMILY.parent / f / "BRIEF.md").read_text() for f in ("family", "family_two", "family_three"))
    assert not [w for w in (*UNLISTED, *motion.MOTIONS, *cases.MECHANISMS) if f"| {w} |" in text or f"{w} (" in text]


def rows(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def test_recordings_are_as_the_formats_say_and_the_same_each_time(tmp_path):
    for i, (kind, ids) in enumerate([("none", ()), ("single", ("transmission.drift",)), ("unknown", ("heart_beat",))]):
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
