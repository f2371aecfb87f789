"""The second sealed family: its mechanisms by their equations, causes by their strength, files by the formats."""

import hashlib
import json
import math
import tomllib
from collections import Counter
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tools.family import score, seal
from tools.family_two import camera, cases, files, inertial, motion, nominal
from tools.family_two.causes import LISTED, NOMINAL, UNLISTED
from tools.family_two.causes.base import follow, side
from tools.family_two.friction import Feel, walk
from tools.family_two.inertial import Inertial
from tools.family_two.mechanism import Demand
from tools.family_two.mechanisms import Catenary, Harmonic, Screw, Tubes, Twisted, elastica
from tools.family_two.plant import Plant, show
from tools.family_two.timeline import lay

FAMILY = Path(__file__).parents[2] / "tools" / "family_two"
SEED = 3  # never a reserved one
LONG = {"calibration": motion.calibration, **motion.MOTIONS}


@pytest.fixture(scope="module", autouse=True)
def short():
    """Recordings of some 15 s."""

    def cut(make, seconds):
        return lambda rng, reach, width, _: make(rng, reach, width, seconds)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "calibration", cut(motion.calibration, 30.0))
        patch.setattr(motion, "MOTIONS", {name: cut(make, 12.0) for name, make in motion.MOTIONS.items()})
        patch.setattr(nominal, "MOST_FRAMES", 600)
        yield


@pytest.fixture(scope="module")
def healthy(short):
    return [cases.draw(SEED, i, "none", ()) for i in range(5)]


@pytest.fixture(scope="module")
def watched(short):
    """Tubes under a camera with everything else moving, on a line that all causes can act on."""
    rng = np.random.default_rng(8)
    m = Tubes(rng)
    reach_deg = float(m.tip(np.array([m.limit]))[0])
    plant = Plant(m, camera.draw(rng, False, reach_deg), 0.08)
    paths = []
    for name, make in (("calibration", LONG["calibration"]), ("test-1", LONG["triangles"])):
        q = make(rng, m.reach, m.width, 30.0)
        t = np.arange(q.size) * motion.STEP
        others = {"translation_mm": np.zeros(q.size), "wrist_deg": 40 * np.sin(t), "load_mNm": 25 - 25 * np.cos(t)}
        paths.append((name, q, others, np.arange(0.25, t[-1] - 0.2, 0.04)))
    return plant, lay(paths, m.reach, m.width, m.slope())


# --- mechanisms


@pytest.mark.parametrize("name", cases.MECHANISMS)
def test_a_healthy_mechanism_is_a_plain_hysteresis(name, monkeypatch):
    """A width that depends on place alone and a smooth law, fitted to the noisy calibration, tell an unseen motion."""
    monkeypatch.setattr(cases, "MECHANISMS", {name: cases.MECHANISMS[name]})
    monkeypatch.setattr(motion, "calibration", lambda rng, r, w, _: LONG["calibration"](rng, r, w, 45.0))
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
    # and it is one: the branches are its width apart, in the middle
    assert 0.01 < case.line.width / case.line.reach < 0.6


def test_the_rod_by_another_solver():
    """A chain that rubs at each link, solved by soft thresholds: tip and curved part follow as the plays say."""
    n, friction, stiff = 24, 1.0, 24.0  # of f L = 24, GJ / L = 1: f L^2 / GJ = 24 by the links' middles
    m = Tubes(np.random.default_rng(1))
    full = friction * n * (n + 1) / 2 / stiff * 2  # the base's way back until the tip starts
    x = np.array([full / 2 - friction * (i * n - i * (i - 1) / 2) / stiff for i in range(1, n + 1)])  # driven up
    base, start = full / 2, x.copy()
    for far in (0.3, 0.7, 1.4):
        while base > full / 2 - far * full:
            base -= full / 50
            old = x.copy()
            for _ in range(400):
                before = x.copy()
                for i in range(n):
                    up = base if i == 0 else x[i - 1]
                    k = stiff if i == n - 1 else 2 * stiff
                    free = (stiff * up + (0 if i == n - 1 else stiff * x[i + 1])) / k - old[i]
                    x[i] = old[i] + math.copysign(max(abs(free) - friction / k, 0.0), free)
                if np.max(np.abs(x - before)) < 1e-5:
                    break
        back = (full / 2 - base) / full
        assert (start - x)[-1] / full == pytest.approx(max(back - 1, 0.0), abs=0.02)
        part = (start - x)[n // 2 :].mean() / full  # a pair curved along its outer half
        plays = sum(w * max(back - share, 0.0) for w, share in m.contacts(0.5))
        assert part == pytest.approx(plays, abs=0.02)


def test_widths_by_hand():
    screw = Screw(np.random.default_rng(6))
    assert screw.width == pytest.approx(2 * screw.gap + 360 / screw.lead * 2 * screw.friction, rel=1e-6)
    screw.spring, a = 0.0, np.radians(25.0)  # the crank's geometry: between the branches there is no force
    high, low = (screw.need(np.array([25.0]), s)[0] for s in (1.0, -1.0))
    pin = screw.crank * np.array([math.sin(a), 1 - math.cos(a)])  # from the middle, along and across the wire
    slid = pin[0] + screw.rod - math.sqrt(screw.rod**2 - pin[1] ** 2)
    assert 0.5 * (high + low) == pytest.approx(360 / screw.lead * slid, rel=1e-6)
    span = Catenary(np.random.default_rng(6))
    pulls = [
        (span.least * span.radius + s * span.friction) / (span.radius - s * span.journal) for s in (1, -1)
    ]  # fmt: skip
    sags = [span.heavy**2 * span.span**3 / 24 / p**2 for p in pulls]  # the parabola's
    by_hand = span.give * (pulls[0] - pulls[1]) + sags[1] - sags[0]
    assert span.width == pytest.approx(by_hand, rel=0.01)
    strings = Twisted(np.random.default_rng(6))
    turns = [np.radians(strings.turned(np.zeros(1), s)[0]) for s in (1.0, -1.0)]
    left = strings.string - strings.middle
    for turned, s in zip(turns, (1, -1), strict=True):  # Pythagoras on one string
        helix = math.sqrt((strings.string / left) ** 2 - 1)
        stretched = strings.string + strings.give * strings.pull * (1 + s * strings.friction * helix)
        assert (strings.thick * turned) ** 2 + left**2 == pytest.approx(stretched**2, rel=1e-9)
    gear = Harmonic(np.random.default_rng(6))
    shares = np.array(gear.contacts(0.0))
    assert shares[:, 0].sum() == pytest.approx(1) and shares[:, 1].mean() == pytest.approx(1) and len(shares) == 7


def test_a_heavy_cantilever_sags_as_beams_do():
    base = np.array([5.0, 40.0, 90.0])
    sag = elastica(base, 0.02) - base
    assert sag == pytest.approx(np.degrees(0.02 / 6 * np.sin(np.radians(base))), rel=0.02)


def test_mass_and_bristles(monkeypatch):
    m = Inertial(np.random.default_rng(2))
    path = motion.travel(0, [(0.8 * m.reach, 1.5, 1.0), (-0.8 * m.reach, 2.0, 1.0), (0.1 * m.reach, 1.0, 1.0)], False)
    x = m.run(Demand.healthy(path))
    # at rest after each move up it is where cable and friction balance
    ups = [int(t / motion.STEP) for t in (2.4, 7.4)]
    edges = np.interp(path, m.need(m.xs, 1.0), m.xs)
    assert x[ups] == pytest.approx(edges[ups], abs=0.02 * m.half)
    # and while it moves it is late by its damping over the cable's stiffness, 2 z / w
    mid = int(0.75 / motion.STEP)
    lag = (edges[mid] - x[mid]) / np.gradient(edges, motion.STEP)[mid]
    assert lag == pytest.approx(2 * m.damping / m.rate, rel=0.35)
    fine = np.interp(np.arange(2 * path.size - 1) / 2, np.arange(path.size), path)
    monkeypatch.setattr(inertial, "STEP", motion.STEP / 2)
    assert x == pytest.approx(m.run(Demand.healthy(fine))[::2], abs=0.03 * m.half)


def test_what_acts_on_the_friction():
    step = 0.002
    up = np.minimum(np.arange(3000) * step, 3.0)
    far = np.full(up.size, 100.0)
    one = np.ones(up.size)
    assert walk(up - 1, far, 0.0, Feel(), step)[-1] == pytest.approx(2.0)
    late = walk(up - 1, far, -1.0, Feel(drag=0.2 * one), step)
    assert (up - 1 - late)[1400] == pytest.approx(0.2, abs=0.005)  # a ramp is followed by its time constant late
    jumps = np.diff(walk(up - 1, far, -1.0, Feel(stick=0.3 * one), step))
    assert np.max(jumps) == pytest.approx(0.3, abs=0.005) and np.sum(jumps > 0.1) == 9
    worn = walk(up - 1, far, -1.0, Feel(extra=0.5 * one, wears=0.2), step)
    assert worn[240] == -1.0 and (up - 1 - worn)[1490] < 0.01  # later by the extra, then caught up
    mirrored = walk(-far, 1 - up, 1.0, Feel(extra=0.5 * one, wears=0.2, way=-1), step)
    assert mirrored == pytest.approx(-worn)
    run_on = walk(np.maximum.accumulate(up), up + 5, 0.0, Feel(braking=2.0 * one), step)
    assert run_on[-1] == pytest.approx(3.0 + 1 / 2 / 2.0, abs=0.01)  # v^2 / 2 a
    down = walk(-far, 3 - up, 3.0, Feel(fastest=0.5 * one), step)
    assert down[1500] == pytest.approx(3.0 - 0.5 * 3.0, abs=0.01)
    caught = walk(up - 1, far, -1.0, Feel(catch=0.4 * one, caught_at=0.5), step)
    assert np.max(np.diff(caught)) == pytest.approx(0.4, abs=0.005) and np.sum(caught == 0.5) > 150


def test_filters_and_sides():
    t = np.arange(0, 4, 0.002)
    assert follow(2 * t, 0.002, 0.3) == pytest.approx(2 * (t - 0.3 + 0.3 * np.exp(-t / 0.3)), abs=1e-9)
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
    logged = cause.logged(line, line.t, line.q)
    assert np.all(logged[: line.parts[0].count] == 0)
    changed = np.max(np.abs(bent[1].values - plain[1].values))
    late = np.max(np.abs(bent[1].arrival - plain[1].arrival))
    assert changed > 0.2 or late > 1e-3 or np.max(np.abs(logged)) > 1e-3
    assert np.all(np.diff(bent[1].arrival) > 0)
    assert np.all(np.isfinite(bent[1].values)) and all(v == v for v in cause.parameters(line).values())


@pytest.mark.parametrize(
    "name", ["transmission.slip", "transmission.creep", "registration.shift", "acquisition.delay", "unlogged_insertion"]
)
def test_an_effect_has_its_strength(name):
    case = cases.draw(SEED, 9, "single" if name in LISTED else "unknown", (name,))
    (cause,), (stated,) = case.causes, case.strengths
    assert cases.strength(cause, stated) >= cases.FAINTEST
    again = cases.measure(case, case.causes, cases.healthy_rest(case))
    assert again == pytest.approx(stated, rel=1e-6)
    # and it is in the pictures: with noise, the healthy model's tests are off by the gap before
    tests = [p for p in case.line.parts if p.tested]
    off = []
    for shown in show(case.plant, case.line, case.causes, tests):
        plain = show(case.plant, case.line, (), [shown.part])[0]
        late = shown.arrival - plain.arrival
        moved = np.gradient(plain.values, plain.arrival, axis=0) * late[:, None]
        off.append(shown.values - plain.values - moved)
    before = np.sqrt(np.mean(np.concatenate(off) ** 2)) / case.noise
    assert before == pytest.approx(stated["times_before"], rel=0.15)
    # half of it is about half as strong
    half = cases.measure(case, (replace(cause, size=cause.size / 2),), cases.healthy_rest(case))
    assert 0.3 < cases.strength(cause, half) / cases.strength(cause, stated) < 0.8


def test_the_camera_is_opencvs():
    rng = np.random.default_rng(8)
    v = replace(camera.draw(rng, False, 50.0), distortion=(-0.2, 0.05, 0.002, -0.001, 0.01))
    c = rng.uniform(-50, 50, 20)
    scene = camera.Scene.still(20)
    base = camera.tip(v, c, scene)
    a = np.radians(c)
    assert base[:, 0] == pytest.approx(v.bending_mm * (1 - np.cos(a)) / a + v.tip_mm * np.sin(a), abs=1e-9)
    assert base[:, 2] == pytest.approx(v.bending_mm * np.sin(a) / a + v.tip_mm * np.cos(a), abs=1e-9)
    pose = np.eye(3)
    for axis, angle in enumerate(np.radians(v.rotation_deg)):  # Rx first
        pose = cv2.Rodrigues(np.eye(3)[axis] * angle)[0] @ pose
    matrix = np.array([[v.focal_px, 0, v.centre_px[0]], [0, v.focal_px, v.centre_px[1]], [0, 0, 1]])
    seen, _ = cv2.projectPoints(
        base, cv2.Rodrigues(pose)[0], np.array(v.translation_mm), matrix, np.array(v.distortion)
    )  # fmt: skip
    assert camera.project(v, c, scene) == pytest.approx(seen[:, 0], abs=1e-6)


# --- cases and files


def test_the_plan_has_its_shares_and_every_id():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES
    singles = Counter(ids[0] for kind, ids in plan if kind == "single")
    assert set(singles) == set(LISTED) - set(NOMINAL) and min(singles.values()) >= 6
    assert {ids[0] for kind, ids in plan if kind == "unknown"} == set(UNLISTED) and len(UNLISTED) >= 12
    assert {ids[0] for kind, ids in plan if kind == "nominal"} == set(NOMINAL)
    assert all(len(set(ids)) == {"pair": 2, "triple": 3}.get(kind, len(ids)) for kind, ids in plan)
    assert plan == cases.plan(SEED, 300) != cases.plan(SEED + 1, 300)


def test_nothing_of_the_first_family_comes_again():
    listing = (FAMILY.parent / "family" / "BRIEF.md").read_text()
    assert not any(f" {i}," in listing or f"{i}\n" in listing for i in UNLISTED)


def rows(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def hashes(folder):
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*.*")}


def test_files_are_the_same_each_time(tmp_path):
    for name, seed in (("a", SEED), ("b", SEED), ("c", SEED + 1)):
        case = cases.draw(seed, 0, "single", ("acquisition.held_samples",))
        files.write(case, seed, tmp_path / name, tmp_path / name / "truth")
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b") != hashes(tmp_path / "c")


def test_recordings_are_as_the_formats_say(healthy, tmp_path):
    for case in healthy:
        truth = files.write(case, SEED, tmp_path, tmp_path / "truth")
        folder = tmp_path / "cases" / case.name
        rig = tomllib.loads((folder / "rig.toml").read_text())
        unit, reach = rig["actuator"]["unit"], rig["actuator"]["range"][1]
        assert rig["format"] == "rig/1" and rig["actuator"]["range"][0] == -reach
        recordings = sorted(p for p in folder.iterdir() if p.is_dir())
        assert [p.name for p in recordings] == ["calibration", *truth["tests"]]
        for where in (*recordings, tmp_path / "unseen" / case.name):
            names, motor = rows(where / "motor.csv")
            assert names[:2] == ["t_s", f"q_{unit}"] and np.all(np.isfinite(motor)) and np.all(np.diff(motor[:, 0]) > 0)
            counts = motor[:, 1] / case.resolution
            assert np.max(np.abs(counts - np.round(counts))) < 0.02 and np.max(np.abs(motor[:, 1])) <= reach
            assert 49 < 1 / np.median(np.diff(motor[:, 0])) < 1001
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


def test_noise_is_as_stated():
    for heavy in (False, True):
        noise = files.noise(np.random.default_rng(2), 60000, 2, 0.05, 0.3, heavy)
        assert noise.std(axis=0) == pytest.approx([0.05, 0.05], rel=0.05)
        assert np.mean(noise[1:] * noise[:-1]) / 0.05**2 == pytest.approx(0.3, abs=0.03)
        assert (np.mean(np.abs(noise) > 0.2) > 2e-3) == heavy


def test_the_first_familys_score_reads_a_truth(tmp_path):
    case = cases.draw(SEED, 4, "single", ("transmission.drift",))
    truth = files.write(case, SEED, tmp_path, tmp_path / "truth")
    assert truth == json.loads((tmp_path / "truth" / "case-004.json").read_text())
    assert truth["verdict"] == "effect" and truth["causes"][0]["strength"] == truth["causes"][0]["times_noise"]
    said = {"verdict": "effect", "effects": [{"id": "transmission.drift"}], "probability_none": 0.1}
    (tmp_path / "case-004").mkdir()
    (tmp_path / "case-004" / "diagnosis.json").write_text(json.dumps(said))
    seen = (tmp_path / "truth" / "case-004-unseen.csv").read_text()
    for name in ("nominal", "corrected"):
        (tmp_path / "case-004" / f"{name}.csv").write_text(seen)
    said["gap"] = {"shrink": 0.5}
    found = score.rms(
        tmp_path / "case-004" / "nominal.csv", tmp_path / "truth" / "case-004-unseen.csv", truth["unseen_valid_from_s"]
    )
    assert found == 0.0
    assert score.collect(tmp_path, tmp_path / "truth", None)["single leads"]["right"] == 1


@pytest.mark.parametrize("name", LONG)
def test_motions_turn_round_often_and_stay_inside(name):
    for i in range(6):
        q = LONG[name](np.random.default_rng(i), 5.0, 0.4 + 0.3 * i, 40.0)
        assert np.max(np.abs(q)) <= 5.0 and 39.0 < q.size * motion.STEP < 41.0
        assert np.max(np.abs(np.diff(q))) < 0.05
        moves = np.sign(np.diff(q))[np.abs(np.diff(q)) > 1e-9]
        assert np.sum(np.diff(moves) != 0) >= 4


def test_another_joint_moves_as_long_as_the_motor():
    for size in (20001, 20913, 21425, 60000):
        other = motion.other_joint(np.random.default_rng(size), size, 5.0)
        assert other.size == size and np.max(np.abs(other)) <= 5.0


def test_it_imports_nothing_of_the_package():
    for path in FAMILY.rglob("*.py"):
        text = path.read_text()
        assert "import tautline" not in text and "from tautline" not in text and "import cv2" not in text, path


def test_the_seal_holds():
    """The generator is what it was when it was sealed; a change needs new seeds and a new family."""
    sealed = dict(line.split(None, 1) for line in (FAMILY / "SEAL.txt").read_text().splitlines() if line.strip())
    assert sealed["sources"] == seal.sources(FAMILY)
    assert sealed["plan"] == seal.planned(int(sealed["seed"]), int(sealed["cases"]), cases.plan)
