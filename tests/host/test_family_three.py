"""The third sealed family: its mechanisms by their equations, causes by what they do, files by the formats."""

import json
import math
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tools.family import score, seal
from tools.family.view import View
from tools.family_three import camera, cases, files, motion, nominal
from tools.family_three.causes import LISTED, NOMINAL, UNLISTED
from tools.family_three.causes.base import follow, side, swings
from tools.family_three.friction import Feel, heavy, project, walk
from tools.family_three.line import lay
from tools.family_three.mechanism import Demand
from tools.family_three.mechanisms import Fusee, Jaw, Piston, Worm, Wrist, mindlin
from tools.family_three.plant import Plant, logged, show
from tools.family_two.motion import STEP

FAMILY = Path(__file__).parents[2] / "tools" / "family_three"
SEED = 3  # never a reserved one
LONG = {"calibration": motion.calibration, **motion.MOTIONS}


@pytest.fixture(scope="module", autouse=True)
def short():
    """Recordings of some 12 s, calibrations of 30."""

    def cut(make, seconds):
        return lambda rng, reach, width, _: make(rng, reach, width, seconds)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "calibration", cut(motion.calibration, 30.0))
        patch.setattr(motion, "MOTIONS", {name: cut(make, 12.0) for name, make in motion.MOTIONS.items()})
        patch.setattr(nominal, "MOST_FRAMES", 600)
        yield


@pytest.fixture(scope="module")
def watched(short):
    """A piston's section under a camera with all else moving, on a line that every cause can act on."""
    rng = np.random.default_rng(8)
    m = Piston(rng)
    plant = Plant(m, camera.draw(rng, False, m.farthest()), 0.08)
    paths = []
    for name, make in (("calibration", LONG["calibration"]), ("test-1", LONG["minimum_jerk"])):
        q = make(rng, m.reach, m.width, 30.0)
        t = np.arange(q.size) * STEP
        others = {"translation_mm": 3 * np.sin(t / 2), "wrist_deg": 40 * np.sin(t), "load_mNm": 25 - 25 * np.cos(t)}
        paths.append((name, q, others, np.arange(0.25, t[-1] - 0.2, 0.04)))
    return plant, lay(paths, m.reach, m.width, m.slope(), m.turn)


# --- mechanisms


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_a_healthy_mechanism_is_a_plain_hysteresis(name, monkeypatch):
    """A width that depends on place alone and a smooth law, fitted to the noisy calibration, tell an unseen motion."""
    monkeypatch.setattr(cases, "MECHANISMS", {name: cases.MECHANISMS[name]})
    monkeypatch.setattr(motion, "calibration", lambda rng, r, w, _: LONG["calibration"](rng, r, w, 45.0))
    monkeypatch.setattr(nominal, "MOST_FRAMES", 2000)
    case = cases.draw(SEED, 20, "none", ())
    shown = show(case.plant, case.line, ())
    problem = nominal.of(case.plant, case.line, case.line.q, shown[:1])
    problem.seen = problem.seen + np.random.default_rng(1).normal(scale=case.noise, size=problem.seen.shape)
    found, left = problem.fit()
    assert left < 1.1 * case.noise
    unseen = nominal.of(case.plant, case.line, case.line.q, shown[-1:])
    miss = unseen.seen - unseen.predict(found, unseen.place(found[: nominal.WIDTH_DEGREE + 1]))
    after = miss[unseen.times > unseen.times[0] + 4]
    assert np.sqrt(1 + np.mean(after**2) / case.noise**2) < 1.1
    assert 0.005 < case.line.width / case.line.reach < 0.5  # and it is one


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_no_law_folds_back(name):
    """Healthy branches rise and lie apart; so do bent ones, and each place found is where the balance has it."""
    for seed in range(8):
        m = cases.MECHANISMS[name](np.random.default_rng(seed))
        up, down = m.need(m.xs, 1.0), m.need(m.xs, -1.0)
        assert np.all(np.diff(up) > 0) and np.all(np.diff(down) > 0) and np.all(up > down)
        q = m.reach * np.sin(np.arange(0, 6, 0.01))
        one = np.ones(q.size)
        for d in (
            Demand(q, rub=1.6 * one), Demand(q, load=-1.0 * one), Demand(q, law=0.15 * one), Demand(q, law=-0.08 * one),
            Demand(q, wall=0.6 * one, wall_at=0.4 * m.limit), Demand(q, wall=0.6 * one, wall_at=9.0, wall_side=-1.0),
        ):  # fmt: skip
            low, high = m.branches(d)
            assert np.all(low <= high + 1e-4) and np.max(np.abs([low, high])) < 1.399 * m.limit
            for found, s in ((low, 1.0), (high, -1.0)):
                asked = d.rub, d.load, d.law, d.wall, d.wall_at, d.wall_side
                near = [m.need(found + e, s, *asked) for e in (-0.02, 0.02)]
                assert np.mean((near[0] <= q) & (near[1] >= q)) > 0.995


def test_widths_by_hand():
    rng = np.random.default_rng(6)
    fusee = Fusee(rng)  # in the middle the drum is round: half the difference of exp(+-mu w), and the rope's bending
    by_hand = fusee.giving * (math.sinh(fusee.rubs) + fusee.bending)
    assert fusee.width == pytest.approx(by_hand, rel=0.02)
    jaw = Jaw(rng)
    p, phi = math.atan(jaw.rise), math.radians(jaw.phi)
    assert jaw.width == pytest.approx(jaw.giving * (math.tan(p + phi) - math.tan(p - phi)), rel=1e-9)
    worm = Worm(rng)
    gap = worm.gap * (1 - worm.wear * worm.worn_at**2) * worm.teeth
    assert worm.width == pytest.approx(gap + worm.teeth * worm.hertz, rel=0.01)
    wrist = Wrist(rng)
    assert wrist.width == pytest.approx(2 * wrist.resists / (2 * wrist.stiff * wrist.side), rel=1e-9)
    piston = Piston(rng)
    p = [(1 + s * piston.seal) / (1 - s * piston.pressed) for s in (1, -1)]
    given = [piston.giving * (a + piston.air * a / (a + 0.3)) for a in p]
    assert piston.width == pytest.approx(given[0] - given[1], rel=1e-9)


def test_a_rolling_joints_cables_are_as_long_as_drawn():
    """Two circles in contact, anchors mirrored in the tangent: lengths by coordinates, and equilibrium by energy."""
    m = Wrist(np.random.default_rng(2))

    def lengths(deg):
        half, radius = np.radians(deg) / 2, 4.0
        anchors = np.array([[m.side, m.height], [-m.side, m.height]])
        turn = np.array([[np.cos(half), np.sin(half)], [-np.sin(half), np.cos(half)]])
        above = [turn @ a + [0, radius] for a in anchors]
        return np.array([2 * a[1] for a in above])  # their mirrors lie as far below

    q, x, eps = m.need(np.array([20.0]), 0.0)[0] + m.home, 20.0, 1e-4

    def energy(deg):
        pulled = lengths(deg) - lengths(0.0) + np.array([q, -q])
        spring = m.flexure / m.limit * deg**2 / 2 * np.pi / 180
        return np.sum(pulled + 0.5 * m.stiff * pulled**2) + spring

    slope = (energy(x + eps) - energy(x - eps)) / (2 * eps)
    assert slope == pytest.approx(0.0, abs=1e-6)


def test_a_mass_swings_and_stays_where_friction_holds_it():
    t = np.arange(0, 2, STEP)
    free = heavy(np.ones(t.size), np.ones(t.size), 0.0, 2.0, np.full(t.size, 0.1), STEP)  # no friction: a step
    w, z = 4 * np.pi, 0.1
    d = w * math.sqrt(1 - z**2)
    by_hand = 1 - np.exp(-z * w * (t + STEP)) * (np.cos(d * (t + STEP)) + z * w / d * np.sin(d * (t + STEP)))
    assert free == pytest.approx(by_hand, abs=1e-9)
    path = np.concatenate([np.linspace(0, 3, 1000), np.full(300, 3.0), np.linspace(3, 0, 1000)])
    x = heavy(path - 0.5, path + 0.5, 0.0, 60.0, np.full(path.size, 0.5), STEP)
    assert x[1250] == pytest.approx(2.5, abs=0.02) and x[1400] == x[1350] and x[-1] == pytest.approx(0.5, abs=0.02)


def test_clips_in_blocks_are_clips_in_a_row():
    rng = np.random.default_rng(4)
    middle = np.cumsum(rng.normal(size=3001)) * 0.1
    low, high = middle - rng.uniform(0, 1, 3001), middle + rng.uniform(0, 1, 3001)
    x, by_hand = 0.3, []
    for a, b in zip(low, high, strict=True):
        x = min(max(x, a), b)
        by_hand.append(x)
    assert project(low, high, 0.3) == pytest.approx(by_hand, abs=0)


def test_what_resists_the_sliding():
    up = np.minimum(np.arange(3000) * STEP, 3.0)
    far, one = np.full(up.size, 100.0), np.ones(up.size)
    assert walk(up - 1, far, 0.0, Feel(), STEP)[-1] == pytest.approx(2.0)
    late = walk(up - 1, far, -1.0, Feel(drag=0.2 * one), STEP)
    assert (up - 1 - late)[1400] == pytest.approx(0.2, abs=0.005)  # a ramp is followed by its time constant late
    square = walk(up - 1, far, -1.0, Feel(square=0.3 * one), STEP)
    assert (up - 1 - square)[1400] == pytest.approx(0.3, abs=0.005)
    jumps = np.diff(walk(up - 1, far, -1.0, Feel(stick=0.3 * one, hold=10.0), STEP))
    assert np.max(jumps) == pytest.approx(0.3, abs=0.005) and np.sum(jumps > 0.1) == 9
    assert np.max(np.diff(walk(up - 1, far, -1.0, Feel(stick=0.3 * one, hold=0.1), STEP)[800:])) < 0.01  # it glides
    worn = walk(up - 1, far, -1.0, Feel(extra=0.5 * one, wears=0.2), STEP)
    assert worn[240] == -1.0 and (up - 1 - worn)[1490] < 0.02  # later by the extra, then caught up
    assert walk(-far, 1 - up, 1.0, Feel(extra=0.5 * one, wears=0.2, way=-1), STEP) == pytest.approx(-worn)


def test_elements_are_mindlins_contact():
    elements = mindlin(200)
    assert sum(w for w, _ in elements) == pytest.approx(1)
    force = 0.7  # what slips so far carries its threshold, the others their share
    given = np.cumsum([0.0, *(w for w, _ in elements)])
    slid = np.interp(force, np.linspace(0, 1, 201), given)
    slope = (2 / 3) * (1 - force) ** (-1 / 3)
    last = 200 * (1 - (1 - 199 / 200) ** (2 / 3) - 1)  # compliance of the last piece, as the weights are scaled
    assert slid == pytest.approx(slope / abs(last), rel=0.02)


def test_filters_and_sides():
    t = np.arange(0, 4, STEP)
    assert follow(2 * t, 0.3) == pytest.approx(2 * (t - 0.3 + 0.3 * np.exp(-t / 0.3)), abs=0.01)
    still = np.concatenate([np.zeros(10), np.ones(9000)])
    rung = swings(still, 2.0, 0.05)
    assert rung.max() == pytest.approx(1 + math.exp(-math.pi * 0.05 / math.sqrt(1 - 0.05**2)), abs=1e-3)
    assert rung[-1] == pytest.approx(1, abs=1e-3)
    leans = side(np.concatenate([np.linspace(0, 5, 500), np.linspace(5, 0, 500)]), 0.4)
    assert leans[499] == pytest.approx(1) and leans[-1] == pytest.approx(-1)


# --- causes


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
    changed = np.max(np.abs(bent[1].values - plain[1].values))
    late = np.max(np.abs(bent[1].arrival - plain[1].arrival))
    assert changed > 0.2 or late > 1e-3 or np.max(np.abs(off)) > 1e-3
    assert np.all(np.diff(bent[1].arrival) > 0)
    assert np.all(np.isfinite(bent[1].values)) and all(v == v for v in cause.parameters(line).values())


def test_what_logs_do(watched):
    _, line = watched
    far = logged(line, (UNLISTED["clipped_log"](0.4, "start", 1),))
    assert np.max(far) == pytest.approx(0.6 * line.reach) or np.min(far) == pytest.approx(-0.6 * line.reach)
    held = logged(line, (UNLISTED["change_only_log"](0.5, "start", 1),))
    steps = np.abs(np.diff(held))
    assert np.max(np.abs(held - line.q)) < 0.5 * line.width and steps[steps > 0].min() >= 0.5 * line.width
    bit = logged(line, (UNLISTED["stuck_bit"](0.5, "start", 1),)) - line.q
    assert sorted({round(v, 9) for v in (bit / line.width).tolist()}) == [-0.5, 0.0]
    off = logged(line, (UNLISTED["log_stalls"](0.5, "start", 1),)) - line.q
    assert 0.05 < np.mean(np.abs(off) > 1e-12) < 0.5


@pytest.mark.parametrize("name", ["transmission.slip", "registration.shift", "acquisition.delay", "leaking_line"])
def test_an_effect_has_its_strength(name):
    case = cases.draw(SEED, 9, "single" if name in LISTED else "unknown", (name,))
    (cause,), (stated,) = case.causes, case.strengths
    assert cases.strength(cause, stated) >= cases.FAINTEST and cases.in_picture(case)
    again = cases.measure(case, case.causes, cases.healthy_rest(case))
    assert again == pytest.approx(stated, rel=1e-6)
    half = cases.measure(case, (replace(cause, size=cause.size / 2),), cases.healthy_rest(case))
    assert 0.25 < cases.strength(cause, half) / cases.strength(cause, stated) < 0.9


def test_the_refits_camera_is_the_scenes():
    rng = np.random.default_rng(8)
    v: View = camera.draw(rng, False, 50.0)
    c = rng.uniform(-50, 50, 20)
    scene = camera.Scene.still(20)
    scene.along, scene.rotation = rng.uniform(-5, 5, 20), rng.uniform(-10, 10, 20)
    pose = np.array([0.5, -0.2, 0.3, 0.1, 0.2, -0.3])
    by_refit = camera.reference(v, c, pose, scene.along, scene.rotation)
    scene.tilt, scene.shift = np.tile(pose[:3], (20, 1)), np.tile(pose[3:], (20, 1))
    assert camera.picture(v, c, scene) == pytest.approx(by_refit, abs=1e-6)


# --- cases and files


def test_the_plan_has_its_shares_and_every_id():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES
    singles = Counter(ids[0] for kind, ids in plan if kind == "single")
    assert set(singles) == set(LISTED) - set(NOMINAL) and min(singles.values()) >= 6
    assert {ids[0] for kind, ids in plan if kind == "unknown"} == set(UNLISTED) and len(UNLISTED) >= 14
    assert {ids[0] for kind, ids in plan if kind == "nominal"} == set(NOMINAL)
    assert all(len(set(ids)) == {"pair": 2, "triple": 3}.get(kind, len(ids)) for kind, ids in plan)
    assert plan == cases.plan(SEED, 300) != cases.plan(SEED + 1, 300)


def test_nothing_of_the_first_families_comes_again():
    listings = [(FAMILY.parent / f / "BRIEF.md").read_text() for f in ("family", "family_two")]
    for word in (*UNLISTED, *motion.MOTIONS):
        assert not any(word in listing for listing in listings), word


def rows(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def test_recordings_are_as_the_formats_say(tmp_path):
    for i in range(5):
        case = cases.draw(SEED, i, "none", ())
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
            if where.parent.name == "unseen":
                assert sorted(p.name for p in where.iterdir()) == ["motor.csv", "rig.toml", "times.csv"]
                names, seen = rows(where / "times.csv")
                assert names == ["t_s"] and seen[0, 0] < truth["unseen_valid_from_s"] < seen[-1, 0] - 2
            else:
                shot = truth["unit"] == "px"
                names, seen = rows(where / ("marker.csv" if shot else "angle.csv"))
                assert names == (["t_s", "u_px", "v_px"] if shot else ["t_s", "c_deg"])
                if shot:
                    size = rig["camera"]["width_px"], rig["camera"]["height_px"]
                    assert np.all(seen[:, 1:] > 0) and np.all(seen[:, 1:] < size)
            assert np.all(np.diff(seen[:, 0]) > 0) and motor[0, 0] < seen[0, 0] and seen[-1, 0] < motor[-1, 0] + 0.1


def test_the_first_familys_score_reads_a_truth_and_files_are_the_same_each_time(tmp_path):
    case = cases.draw(SEED, 4, "single", ("transmission.drift",))
    truth = files.write(case, SEED, tmp_path, tmp_path / "truth")
    assert truth == json.loads((tmp_path / "truth" / "case-004.json").read_text())
    assert truth["verdict"] == "effect" and truth["causes"][0]["strength"] == truth["causes"][0]["times_noise"]
    (tmp_path / "case-004").mkdir()
    said = {"verdict": "effect", "effects": [{"id": "transmission.drift"}], "probability_none": 0.1}
    (tmp_path / "case-004" / "diagnosis.json").write_text(json.dumps(said))
    assert score.collect(tmp_path, tmp_path / "truth", None)["single leads"]["right"] == 1
    again = cases.draw(SEED, 4, "single", ("transmission.drift",))
    files.write(again, SEED, tmp_path / "b", tmp_path / "b" / "truth")
    for path in (tmp_path / "b").rglob("*.*"):
        assert path.read_bytes() == (tmp_path / path.relative_to(tmp_path / "b")).read_bytes()


@pytest.mark.parametrize("name", LONG)
def test_motions_turn_round_often_and_stay_inside(name):
    for i in range(6):
        q = LONG[name](np.random.default_rng(i), 5.0, 0.2 + 0.35 * i, 40.0)
        assert np.max(np.abs(q)) <= 5.0 and 39.0 < q.size * STEP < 41.0
        assert np.max(np.abs(np.diff(q))) < 0.06
        moves = np.sign(np.diff(q))[np.abs(np.diff(q)) > 1e-9]
        assert np.sum(np.diff(moves) != 0) >= 4


def test_it_imports_nothing_of_the_package():
    for path in FAMILY.rglob("*.py"):
        text = path.read_text()
        assert "import tautline" not in text and "from tautline" not in text and "import cv2" not in text, path


def test_the_seal_holds():
    """The generator is what it was when it was sealed; a change needs new seeds and a new family."""
    sealed = dict(line.split(None, 1) for line in (FAMILY / "SEAL.txt").read_text().splitlines() if line.strip())
    assert sealed["sources"] == seal.sources(FAMILY)
    assert sealed["plan"] == seal.planned(int(sealed["seed"]), int(sealed["cases"]), cases.plan)
