"""The sealed family: its mechanisms by their equations, its files by checks of its own."""

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

from tools.family import cases, motion, record, refit, seal, view
from tools.family.causes import LISTED, NOMINAL, UNLISTED
from tools.family.causes.base import follow, slider
from tools.family.causes.transmission import Rounded, StickSlip, Swing
from tools.family.line import Line
from tools.family.mechanisms import MECHANISMS, Backbone, Linkage, Pair, Pendulum, Sheath
from tools.family.plant import probe, run, stamps

FAMILY = Path(__file__).parents[2] / "tools" / "family"
SEED = 3  # never the sealed one
LONG = {**motion.MOTIONS, "calibration": motion.calibration}


def straight(mechanism, to, steps=400):
    """Drives to a place; the configuration at each step."""
    start = getattr(mechanism, "place", 0.0)
    path = np.linspace(start, to, steps + 1)[1:]
    mechanism.place = float(path[-1])
    return path, np.array([mechanism.step(float(q), 1.0, 1.0) for q in path])


def plain_line(t, c_speed=0.0):
    """A line of instants of one test with nothing in it but time."""
    n = t.size
    return Line(
        t, np.zeros(n), np.full(n, c_speed), {}, np.zeros(n, int), np.ones(n, bool), ("test-1",), (0.0,), 1.0, 1.0, 1.0
    )


@pytest.fixture(scope="module", autouse=True)
def short():
    """Recordings of some 20 s instead of a minute or two: the tests take seconds."""

    def cut(make):
        return lambda rng, reach, width, seconds: make(rng, reach, width, 15.0)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(motion, "calibration", cut(LONG["calibration"]))
        patch.setattr(motion, "MOTIONS", {name: cut(make) for name, make in LONG.items() if name != "calibration"})
        patch.setattr(refit, "FRAMES", 200)
        yield


@pytest.fixture(scope="module")
def healthy(short):
    """Some cases with nothing wrong: drawn once."""
    return [cases.draw(SEED, i, "none", ()) for i in range(4)]


@pytest.fixture(scope="module")
def ran(healthy):
    """A case with a camera, a line with all other joints and a load moving, and what is seen of it when healthy."""
    case = next(c for c in healthy if c.plant.view is not None)
    stroke = np.sin(case.line.t / 3.0)
    line = replace(case.line, sides=case.line.sides | {"load_mNm": 25 + 25 * stroke, "wrist_deg": 40 * stroke})
    return case, line, run(case.plant, line, [])


# --- mechanisms


@pytest.mark.parametrize("name", MECHANISMS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_healthy_mechanism_is_a_plain_hysteresis(name, seed):
    """After a reversal nothing moves for a width that depends on the place, not on the side it is come to from."""
    m = MECHANISMS[name](np.random.default_rng(seed))
    straight(m, -m.reach)
    up_q, up = straight(m, 0.95 * m.reach)
    turned = up[-1]
    down_q, down = straight(m, -m.reach, 4000)
    still = np.abs(down - turned) < 1e-6
    lost = 0.95 * m.reach - down_q[~still][0]
    assert 0.003 * m.reach < lost < 0.8 * m.reach
    assert np.all(np.diff(down) < 1e-9)
    # the rising and the falling branch are B apart at equal x: a small loop inside shows the same B there
    x = np.interp(0.2 * m.reach, up_q, up)
    wide = 0.2 * m.reach - np.interp(-x, -down[~still], down_q[~still])
    straight(m, -m.reach)
    straight(m, 0.2 * m.reach)
    back_q, back = straight(m, 0.2 * m.reach - 1.5 * wide, 4000)
    first = back_q[np.abs(back - back[0]) > 1e-6][0]
    assert 0.2 * m.reach - first == pytest.approx(wide, rel=0.01)


@pytest.mark.parametrize("name", MECHANISMS)
def test_a_step_may_be_long_or_short(name):
    fine, coarse = (MECHANISMS[name](np.random.default_rng(4)) for _ in range(2))
    for goal in (0.8, -0.5, 0.1, -0.2, 0.6):
        straight(fine, goal * fine.reach, 200)
        straight(coarse, goal * coarse.reach, 3)
        assert fine.step(fine.place, 1, 1) == pytest.approx(coarse.step(coarse.place, 1, 1), abs=2e-5)


def test_capstan():
    m = Sheath(np.random.default_rng(5))
    straight(m, m.reach)
    assert m.tension[0] / m.tension[-1] == pytest.approx(math.exp(m.theta[-1]), rel=1e-6)
    straight(m, -m.reach)
    assert m.tension[0] / m.tension[-1] == pytest.approx(math.exp(-m.theta[-1]), rel=1e-6)


def test_widths_by_hand():
    pair = Pair(np.random.default_rng(6))
    pair.spring, pair.toe = 0.0, 1e-4 * pair.slack
    by_hand = 2 * pair.slack + 2 * pair.friction / pair.radius / pair.stiffness
    assert probe(pair)[0] == pytest.approx(by_hand, abs=2 * pair.reach / 4000)
    arm = Pendulum(np.random.default_rng(6))
    arm.gravity = arm.stiffening = 0.0
    assert probe(arm)[0] == pytest.approx(arm.ratio * (arm.gap + 2 * arm.friction), abs=2 * arm.reach / 4000)
    chain = Backbone(np.random.default_rng(6))
    chain.press = 0.0
    assert probe(chain)[0] == pytest.approx(2 * chain.friction * chain.yielding, abs=2 * chain.reach / 4000)
    lever = Linkage(np.random.default_rng(6))
    lever.rub = lever.skew = lever.c = 0.0
    half = lever.clearance + lever.friction  # at rest in the middle cos(c) is 1 to 1e-3
    assert probe(lever)[0] == pytest.approx(math.degrees(2 * half / lever.arm), rel=0.01)


def test_an_uneven_backbone_starts_one_joint_after_another():
    m = Backbone(np.random.default_rng(7))
    straight(m, m.reach)
    m.spread = 0.8
    straight(m, -m.reach)
    _, up = straight(m, m.reach, 2000)
    slopes = np.diff(up)
    assert np.unique(np.round(slopes[slopes > 1e-9] / slopes.max(), 1)).size >= 4


# --- causes


def test_a_lag_is_exact_on_a_ramp_however_far_apart_instants_are():
    t = np.sort(np.random.default_rng(1).uniform(0, 3, 40))
    t[0] = 0.0
    late = follow(plain_line(t), 2 * t, 0.3)
    assert late == pytest.approx(2 * (t - 0.3 + 0.3 * np.exp(-t / 0.3)), abs=1e-12)


def test_swing_rings_at_its_own_rate():
    t = np.arange(0.0, 6.0, 0.004)
    cause = Swing(1.0, "start", 11)
    line = plain_line(t)
    c = np.minimum(t, 1.0)  # a ramp that stops
    swung = cause.bend(line, c) - c
    rate = float(cause.parameters(line)["rate_hz"])
    after = swung[t > 1.02]
    crossings = t[t > 1.02][1:][np.diff(np.sign(after)) > 0]
    assert 1 / np.mean(np.diff(crossings)) == pytest.approx(rate, rel=0.02)
    # y'' + 2 z w y' + w^2 y = w^2 c by another integrator's residual, away from the stop
    y, h = swung + c, 0.004
    speed, bend = np.gradient(y, h), np.gradient(np.gradient(y, h), h)
    inside = (t > 1.1) & (t < 5.9)
    basis = np.stack([speed[inside], (y - c)[inside]], axis=1)
    found = np.linalg.lstsq(basis, -bend[inside], rcond=None)[0]
    assert found[1] == pytest.approx((2 * np.pi * rate) ** 2, rel=0.03)
    assert 0.005 < found[0] / 2 / (2 * np.pi * rate) < 0.09


def test_roundings_hold_at_a_reversal_and_lose_what_they_say():
    c = np.concatenate([np.linspace(0, 10, 500), np.linspace(10, -10, 1000)])
    for lost in (Rounded._dahl(c, 1.0), Rounded._bouc_wen(c, 1.0), Rounded._strands(c, 1.0)):
        tip = c - lost
        assert lost[499] == pytest.approx(0.5, abs=0.06) and lost[-1] == pytest.approx(-0.5, abs=0.06)
        slopes = np.diff(tip)[500:] / np.diff(c)[500:]
        assert slopes[0] < 0.1 and slopes[-1] == pytest.approx(1.0, abs=0.02) and np.all(slopes > -1e-9)


def test_stick_slip_jumps_by_its_size():
    t = np.arange(0, 20, 0.01)
    tip = StickSlip(0.5, "start", 2).bend(plain_line(t, 0.4), 0.4 * t)
    jumps = np.diff(tip)[np.diff(tip) != 0]
    jump = 0.5 / (1 + 1 / 3)  # at the usual speed
    assert np.all(jumps > 0.6 * jump) and np.all(jumps < 1.4 * jump + 0.004) and jumps.size > 5


def test_a_slider_touches_the_side_it_is_dragged_by():
    x = np.concatenate([np.linspace(0, 5, 50), np.linspace(5, 4.9, 5), np.linspace(4.9, 0, 50)])
    side = slider(x, 0.4)
    assert side[49] == 1.0 and side[54] == pytest.approx(1 - 0.1 / 0.2) and side[-1] == -1.0


def test_the_camera_is_opencvs():
    rng = np.random.default_rng(8)
    v = view.draw(rng, False, 50.0)
    c = rng.uniform(-50, 50, 20)
    base = view.tip(v, view.even(c), np.zeros(20), np.zeros(20))
    lens = np.array([-0.2, 0.05, 0.002, -0.001, 0.01])
    mine = view.project(v, base, lens=np.repeat(lens[None], 20, axis=0))
    rx, ry, rz = (view.turn(i, a) for i, a in enumerate(v.rotation_deg))
    matrix = np.array([[v.focal_px, 0, v.centre_px[0]], [0, v.focal_px, v.centre_px[1]], [0, 0, 1]])
    vector, _ = cv2.Rodrigues(rz @ ry @ rx)
    reference, _ = cv2.projectPoints(base, vector, np.array(v.translation_mm), matrix, lens)
    assert mine == pytest.approx(reference[:, 0], abs=1e-6)
    # constant curvature: at c the tip of a section of length L is at L (1 - cos c) / c, L sin c / c
    a = np.radians(c)
    assert base[:, 0] == pytest.approx(v.bending_mm * (1 - np.cos(a)) / a + v.tip_mm * np.sin(a), abs=1e-9)


@pytest.mark.parametrize("name", [*LISTED, *UNLISTED])
def test_every_cause_changes_something_only_when_it_is_there(name, ran):
    kind = LISTED.get(name) or UNLISTED[name]
    case, line, plain = ran
    cause = kind(kind.limits.hi, "test", 12)
    bent = run(case.plant, line, [cause])
    first = line.frame & (line.part == 0)
    tested = line.frame & (line.part > 0)
    assert bent.image[first] == pytest.approx(plain.image[first], abs=1e-9)
    changed = float(np.max(np.abs(bent.image[tested] - plain.image[tested])))
    late = np.max(np.abs(stamps(case.plant, line, [cause], 1) - stamps(case.plant, line, [], 1)))
    logged = np.max(np.abs(cause.encoder(line, line.t, line.q, 1)))
    assert changed > 2 * case.noise or late > 1e-3 or logged > 1e-3
    assert np.all(np.isfinite(bent.image)) and all(v == v for v in cause.parameters(line).values())


# --- cases and files


def test_the_plan_has_its_shares_and_every_id():
    plan = cases.plan(SEED, 300)
    assert Counter(kind for kind, _ in plan) == cases.SHARES
    singles = Counter(ids[0] for kind, ids in plan if kind == "single")
    assert set(singles) == set(LISTED) - set(NOMINAL) and min(singles.values()) >= 6
    assert {ids[0] for kind, ids in plan if kind == "unknown"} == set(UNLISTED) and len(UNLISTED) >= 10
    assert {ids[0] for kind, ids in plan if kind == "nominal"} == set(NOMINAL)
    assert all(len(set(ids)) == {"pair": 2, "triple": 3}.get(kind, len(ids)) for kind, ids in plan)
    assert plan == cases.plan(SEED, 300) != cases.plan(SEED + 1, 300)


def test_a_healthy_case_leaves_nothing_to_a_refit(healthy):
    case = healthy[1]
    assert refit.left(case.plant, case.line, [], run(case.plant, case.line, [])) < 0.3 * case.noise


def rows(path):
    return path.read_text().splitlines()[0].split(","), np.loadtxt(path, delimiter=",", skiprows=1, ndmin=2)


def hashes(folder):
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in folder.rglob("*.*")}


def test_files_are_valid_and_the_same_each_time(healthy, tmp_path):
    case = healthy[0]
    record.write(case, SEED, tmp_path / "a", tmp_path / "a" / "truth")
    record.write(cases.draw(SEED, 0, "none", ()), SEED, tmp_path / "b", tmp_path / "b" / "truth")
    assert hashes(tmp_path / "a") == hashes(tmp_path / "b")
    record.write(cases.draw(SEED + 1, 0, "none", ()), SEED + 1, tmp_path / "c", tmp_path / "c" / "truth")
    assert hashes(tmp_path / "a") != hashes(tmp_path / "c")


def test_recordings_are_as_the_formats_say(healthy, tmp_path):
    for case in healthy:
        truth = record.write(case, SEED, tmp_path, tmp_path / "truth")
        folder = tmp_path / "cases" / case.name
        rig = tomllib.loads((folder / "rig.toml").read_text())
        unit = rig["actuator"]["unit"]
        assert rig["format"] == "rig/1" and rig["actuator"]["range"][0] < 0 < rig["actuator"]["range"][1]
        recordings = sorted(p for p in folder.iterdir() if p.is_dir())
        assert [p.name for p in recordings] == ["calibration", *truth["tests"]]
        for where in (*recordings, tmp_path / "unseen" / case.name):
            names, motor = rows(where / "motor.csv")
            assert names[:2] == ["t_s", f"q_{unit}"] and np.all(np.isfinite(motor)) and np.all(np.diff(motor[:, 0]) > 0)
            counts = motor[:, 1] / case.resolution
            assert np.max(np.abs(counts - np.round(counts))) < 0.02
            assert np.max(np.abs(motor[:, 1])) <= rig["actuator"]["range"][1]
            assert 49 < 1 / np.median(np.diff(motor[:, 0])) < 1001
            if where.parent.name == "unseen":
                assert sorted(p.name for p in where.iterdir()) == ["motor.csv", "rig.toml", "times.csv"]
                seen_names, seen = rows(where / "times.csv")
                assert seen_names == ["t_s"]
                assert seen[0, 0] < truth["unseen_valid_from_s"] < seen[-1, 0] - 3
            else:
                camera = truth["unit"] == "px"
                seen_names, seen = rows(where / ("marker.csv" if camera else "angle.csv"))
                assert seen_names == (["t_s", "u_px", "v_px"] if camera else ["t_s", "c_deg"])
                if camera:
                    assert np.all(seen[:, 1:] > 0) and np.all(seen[:, 1] < rig["camera"]["width_px"])
                    assert np.all(seen[:, 2] < rig["camera"]["height_px"])
            assert np.all(np.diff(seen[:, 0]) > 0) and motor[0, 0] < seen[0, 0] and seen[-1, 0] < motor[-1, 0] + 0.1


def test_noise_is_as_stated(healthy, tmp_path):
    noise = record.wander(np.random.default_rng(2), 40000, 2, 0.05, 0.3)
    assert noise.std(axis=0) == pytest.approx([0.05, 0.05], rel=0.03)
    assert np.mean(noise[1:] * noise[:-1]) / 0.05**2 == pytest.approx(0.3, abs=0.03)
    case = replace(next(c for c in healthy if c.plant.view is not None), dropped=0.0)
    record.write(case, SEED, tmp_path, tmp_path / "truth")
    _, seen = rows(tmp_path / "cases" / case.name / "test-1" / "marker.csv")
    clean = run(case.plant, case.line, []).image[case.line.frame & (case.line.part == 1)]
    assert (seen[:, 1:] - clean).std() == pytest.approx(case.noise, rel=0.08)


def test_a_truth_says_what_was_done(tmp_path):
    case = cases.draw(SEED, 9, "single", ("transmission.slip",))
    truth = record.write(case, SEED, tmp_path, tmp_path)
    assert truth == json.loads((tmp_path / "case-009.json").read_text())
    (cause,) = truth["causes"]
    assert truth["verdict"] == "effect" and cause["listed"] and cause["id"] == "transmission.slip"
    assert cause["strength"] == cause["times_noise"] >= cases.FAINTEST
    # twice the jump leaves about twice as much: the stored strength is that of the case's own size
    plain = run(case.plant, case.line, [])
    base = refit.left(case.plant, case.line, [], plain)
    again = cases.measure(case, case.causes, plain, base)
    assert again["times_noise"] == pytest.approx(cause["times_noise"], rel=1e-3)
    line, (slip,) = case.line, case.causes
    jump = slip.drive(line)
    assert np.unique(np.round(jump, 9)).size == len(slip.jumps(line)) + 1
    assert np.max(np.abs(np.diff(jump))) == pytest.approx(cause["parameters"]["jump"], rel=1e-3)


def test_motions_turn_round_often_and_stay_inside():
    for name, make in LONG.items():
        q = make(np.random.default_rng(3), 5.0, 0.6, 60.0)
        assert np.max(np.abs(q)) <= 5.0 and 35.0 < q.size * motion.STEP < 90.0, name
        assert all(np.max(np.abs(make(np.random.default_rng(i), 5.0, 2.0, 40.0))) <= 5.0 for i in range(5)), name
        assert np.max(np.abs(np.diff(q))) < 0.02
        moves = np.sign(np.diff(q))[np.abs(np.diff(q)) > 1e-9]
        assert np.sum(np.diff(moves) != 0) >= 4, name


def test_it_imports_nothing_of_the_package():
    for path in FAMILY.rglob("*.py"):
        text = path.read_text()
        assert "import tautline" not in text and "from tautline" not in text and "import cv2" not in text, path


def test_the_seal_holds():
    """The generator is what it was when it was sealed; a change needs new seeds and a new family."""
    sealed = dict(line.split(None, 1) for line in (FAMILY / "SEAL.txt").read_text().splitlines() if line.strip())
    assert sealed["sources"] == seal.sources()
    assert sealed["plan"] == seal.planned(int(sealed["seed"]), int(sealed["cases"]))


@pytest.mark.parametrize("size", [20001, 28322, 57001, 59999])
def test_another_joint_moves_as_long_as_the_motor(size):
    for n in range(size, size + 200, 7):
        side = motion.side_motion(np.random.default_rng(n), (n - 1) * motion.STEP, 5.0)
        assert side.size == n and np.max(np.abs(side)) <= 5.0
