"""The sixth sealed family: its mechanisms by their equations, causes by what they do, files by the formats."""

import math
import tomllib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from tools.family import seal
from tools.family_four import files
from tools.family_four.plant import Plant, carried, logged, show
from tools.family_six import cases, mechanisms, motion
from tools.family_six.causes import LISTED, NOMINAL, UNLISTED
from tools.family_six.mechanism import Ask, held, parted
from tools.family_three import camera, nominal
from tools.family_three.line import lay
from tools.family_two.motion import STEP

FAMILY = Path(__file__).parents[2] / "tools" / "family_six"
SEED = 3  # never a reserved one
LONG = {"calibration": motion.calibration, **motion.MOTIONS}


@pytest.fixture(scope="module", autouse=True)
def short():
    with pytest.MonkeyPatch.context() as patch:
        lengths = dict.fromkeys(("test-1", "test-2", "test-3", "unseen"), (12.0, 12.0))
        patch.setattr(cases, "SECONDS", lengths | {"calibration": (45.0, 45.0)})
        patch.setattr(nominal, "MOST_FRAMES", 500)
        yield


@pytest.fixture(scope="module")
def watched():
    """A section under a camera with all else moving, on a line that every cause can act on."""
    m, paths = mechanisms.Sleeve(np.random.default_rng(8)), []
    for name, make in (("calibration", "calibration"), ("test-1", "trills")):
        q = LONG[make](np.random.default_rng(8), m.reach, m.width, 15.0)
        t = np.arange(q.size) * STEP
        others = {"translation_mm": 3 * np.sin(t / 2), "rotation_deg": 6 * np.sin(0.7 * t), "wrist_deg": 40 * np.sin(t)}
        paths.append((name, q, others | {"load_mNm": 25 - 25 * np.cos(t)}, np.arange(0.25, t[-1] - 0.2, 0.04)))
    plant = Plant(m, camera.draw(np.random.default_rng(8), False, m.farthest()), 0.08)
    line = lay(paths, m.reach, m.width, m.slope(), m.turn)
    return plant, line, show(plant, line, ())


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_a_healthy_mechanism_is_a_plain_hysteresis(name, monkeypatch):
    monkeypatch.setattr(cases, "MECHANISMS", {name: cases.MECHANISMS[name]})
    case = cases.draw(SEED, 20, "none", ())
    missed = math.hypot(1, carried(case.plant, case.line, case.noise) / case.noise)
    assert missed < 1.1 and cases.healthy_rest(case) < 0.3 * case.noise


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_no_law_folds_back(name):
    """Branches rise and lie apart; each place found, pushed, bent or held back, is where the balance has it."""
    for seed in range(2):
        m = cases.MECHANISMS[name](np.random.default_rng(seed))
        up, down = m.need(m.xs, 1.0), m.need(m.xs, -1.0)
        assert np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0) and np.all(up > down)
        assert m.width == pytest.approx(m.width_deg / m.slope(), rel=0.25) and m.farthest() <= 1.001 * m.limit
        q, one = 0.9 * m.reach * np.sin(np.arange(0, 6, 0.02)), np.ones(300)
        for a in (Ask(q, rub=1.4 * one), Ask(q, push=-0.2 * one), Ask(q, law=0.1 * one), Ask(q, law=-0.1 * one)):
            for way in (1.0, -1.0):
                low, high = (m.need(m.inverted(a, way) + e, way, a.rub, a.push, a.law) for e in (-0.01, 0.01))
                assert np.mean((low <= q) & (high >= q)) > 0.99
        walled, free = (m.inverted(Ask(q, wall=w * one, wall_at=0.4 * m.limit), 1.0) for w in (9.0, 0.0))
        assert np.allclose(walled[free < 0.4 * m.limit], free[free < 0.4 * m.limit]) and np.max(free - walled) > 0.5


def test_equations_by_hand_and_what_holds_the_sliding():
    rng, f = np.random.default_rng(6), 0.05
    b, s, v, y, w, c = (kind(rng) for kind in cases.MECHANISMS.values())
    p = (b.spring(20.0) + f * b.pressed(20.0)) / (1 - b.area * 20 / b.limit)
    gas = b.raw(20.0, f, 0.0, 0.0) / b.stroke - 20 / b.limit - b.swell * (20 / b.limit) ** 2 - b.bulges * p
    assert b.outside * b.dead == pytest.approx((b.outside + p) * (b.dead - gas))  # Boyle
    u, v.gives, a, y.winds = 30.0 / s.limit, 0.0, math.radians(30.0), 0.0
    end = s.spring(30.0) / (1 - s.closes * u * u)
    along = solve_ivp(lambda _, y: f * (s.clings * s.pressed(30.0) + s.wraps * u * y), (0, 1), [end], rtol=1e-9)
    travel = u - s.closes * u**3 / 3 + s.gives * (end + along.y[0, -1]) / 2
    assert s.raw(30.0, f, 0.0, 0.0) == pytest.approx(s.stroke * travel, rel=1e-6)
    chord = 2 * (v.slender / a - 1) * v.off * math.sin(a / 2)  # of an arc, nearer its centre by the wire's distance
    assert v.raw(30.0, 0, 0, 0) == pytest.approx(v.slender * v.off - chord)
    crank = np.sin(np.radians(y.raw(np.array([y.limit, 10.0]), f, 0.0, 0.0)))
    assert crank[1] / crank[0] == pytest.approx(math.tan(math.radians(10.0)) / math.tan(math.radians(y.limit)))
    flank = w.lever * math.sin(math.radians(w.limit)) * quad(lambda z: 1 / (w.steep * (1 + w.ground * z)), 0, 1)[0]
    force = (w.weight + 1) / math.cos(math.radians(w.limit)) * w.steep * (1 + w.ground)
    assert w.raw(w.limit, 0.0, 0.0, 0.0) == pytest.approx(flank + w.gives * force)
    c.stretches, z = 0.0, (c.hangs + f) / c.tight
    strain = sum(quad(lambda r, way=way: r / (1 + way * r), 0, z)[0] for way in (1, -1))  # taut and slack side, Euler
    assert c.raw(0.0, f, 0.0, 0.0) == pytest.approx(0.3 * c.ratio * c.creeps * c.limit * strain)
    up, one = np.minimum(np.arange(3000) * STEP, 3.0), np.ones(3000)
    late = held(up - 1, up + 1, Ask(up, lip=0.5 * one))
    assert late[600] < up[600] - 1 and late[1490] == pytest.approx(up[1490] - 1)  # later, then caught up
    assert held(-up - 1, 1 - up, Ask(up, lip=0.5 * one, lip_way=-1.0)) == pytest.approx(-late)
    jumps = np.diff(held(up - 1, up + 1, Ask(up, ridges=0.3 * one, pitch=0.7, glides=100.0)))
    soft = parted(up - 1, up + 1, 0.8 * one)
    assert 0.1 < np.max(jumps) < 0.31 and np.sum(jumps > 0.05) > 5
    assert soft[300] > 0.001 and abs(soft[-1] - 2.0) < 0.02  # begins sooner, ends on the same branch


@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_every_cause_changes_something_only_when_it_is_there(name, watched):
    plant, line, plain = watched
    kind = LISTED.get(name) or UNLISTED[name]
    assert not (kind.moves and kind.may_start)  # what recalibration closes would be a part of what is calibrated
    cause = kind(0.7 * kind.limits.hi, "test", 12)
    bent, off = (show(plant, line, (c,)) for c in (cause, kind(1e-9, "test", 12)))
    for a, b, within in ((bent[0], plain[0], 1e-3), (off[1], plain[1], 2e-2)):
        assert a.values == pytest.approx(b.values, abs=within) and a.arrival == pytest.approx(b.arrival, abs=1e-6)
    off, late = logged(line, (cause,)) - line.q, bent[1].arrival - plain[1].arrival
    assert np.all(off[: line.parts[0].count] == 0) and np.all(np.isfinite(bent[1].values))
    changed = np.max(np.abs(bent[1].values - plain[1].values)) > 0.2
    assert (changed or np.max(np.abs(late)) > 1e-3 or np.max(np.abs(off)) > 1e-3) and np.all(np.diff(late) > -0.04)


def test_the_plan_has_every_id_and_motions_stay_inside():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES and len(LISTED) == 25 and len(UNLISTED) >= 16
    assert {i[0] for k, i in plan if k in ("single", "unknown", "nominal")} == {*LISTED, *UNLISTED, *NOMINAL}
    text = "".join(p.read_text() for p in FAMILY.parent.glob("family*/BRIEF.md") if p.parent != FAMILY)
    assert not [w for w in (*UNLISTED, *motion.MOTIONS, *cases.MECHANISMS) if f"| {w} |" in text or f"{w} (" in text]
    for make in LONG.values():
        q = make(np.random.default_rng(4), 5.0, 1.0, 40.0)
        assert np.max(np.abs(q)) <= 5.0 and 39.0 < q.size * STEP < 41.0 and np.max(np.abs(np.diff(q))) < 0.06
        assert np.sum(np.diff(np.sign(np.diff(q)[np.abs(np.diff(q)) > 1e-9])) != 0) >= 4


def test_recordings_are_as_the_formats_say_and_the_same_each_time(tmp_path):
    for where in (tmp_path / "a", tmp_path / "b"):
        truth = files.write(cases.draw(SEED, 1, "unknown", ("stroke_ratchet",)), SEED, where, where / "truth")
    rig = tomllib.loads((where / "cases/case-001/rig.toml").read_text())["actuator"]
    assert len(list(where.rglob("motor.csv"))) == len(truth["tests"]) + 2 and truth["causes"][0]["strength"] >= 2
    for path in where.rglob("motor.csv"):
        motor = np.loadtxt(path, delimiter=",", skiprows=1)
        assert path.read_text().startswith(f"t_s,q_{rig['unit']}") and np.all(np.diff(motor[:, 0]) > 0)
        assert np.max(np.abs(motor[:, 1])) <= rig["range"][1]
    assert all(p.read_bytes() == (tmp_path / "a" / p.relative_to(where)).read_bytes() for p in where.rglob("*.*"))


def test_the_seal_holds():
    every = "".join(path.read_text() for path in FAMILY.rglob("*.py"))
    assert "import tautline" not in every and "from tautline" not in every
    sealed = dict(line.split(None, 1) for line in (FAMILY / "SEAL.txt").read_text().splitlines() if line.strip())
    assert sealed["sources"] == seal.sources(FAMILY)
    assert sealed["plan"] == seal.planned(int(sealed["seed"]), int(sealed["cases"]), cases.plan)
