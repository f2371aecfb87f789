"""All parameters of a simulator at once: what is there, what cannot be told apart, and the corrected model."""

from dataclasses import replace

import arms
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal

from tautline.core.posterior import Posterior
from tautline.diagnosis import gap, heldout
from tautline.diagnosis.diagnose import diagnose
from tautline.diagnosis.folder import save
from tautline.diagnosis.joint import BENDS, LAW, SPEED, WIDTH, Fitted, Joint, Noise, Unknown, fit_held_or_loose
from tautline.diagnosis.joint_sets import Sets
from tautline.diagnosis.joint_told import Answer, answer_to_hand_out, held_out_residuals, with_joint_answer
from tautline.diagnosis.repeated import HELD
from tautline.diagnosis.segment import prepare
from tautline.diagnosis.simulated import diagnose_simulator
from tautline.effects import LIBRARY, simulator_id
from tautline.prediction import predict, predict_with_sigma
from tautline.recording import Angle, Motor, Recording
from tautline.rig import ANGLE
from tautline.simulators import Declared, Simulator
from tautline.simulators.drive import STEP_S
from tautline.simulators.nominal import nominal
from tautline.trajectory import random_smooth

NOISE_DEG = 0.03
THERE = 0.2  # the prior that joint_sets states
SLOW_DEG_S = 4.0  # a thirtieth of the arm's range a second, where half of what speed does and a little is there


def servo(motor, values):
    """A joint that follows its command in first order, and sags under its load by 1 / gain."""
    share = -np.expm1(-(motor.t_s[1] - motor.t_s[0]) / values["tau"])
    c, state = np.empty_like(motor.q), motor.q[0]
    for k, q in enumerate(motor.q):
        state += share * (q - state)
        c[k] = state
    return c - 30.0 * values["load"] / values["gain"] * np.sin(np.radians(c))


PARAMETERS = (
    Declared("tau", "s", 0.05, 0.02, low=0.005),
    Declared("gain", "Nm/rad", 10.0, 5.0, low=0.1),
    Declared("load", "Nm", 1.0, 0.5, low=0.01),
)
SERVO = Simulator(servo, PARAMETERS, {"kind": "python", "name": "test_joint:SERVO"})


def rubbing(c, t_s, rest_deg, moving_deg, bent):
    """A play whose width is another one at speed than at rest (Stribeck), and goes with the place."""
    speed = np.gradient(c, t_s)
    width = moving_deg + (rest_deg - moving_deg) * np.exp(-np.abs(speed) / SLOW_DEG_S) + bent * c
    held, seen = 0.0, np.empty_like(c)
    for k, value in enumerate(c):
        held = seen[k] = min(max(held, value - 0.5 * width[k]), value + 0.5 * width[k])
    return seen


def robot(folder, seed, play_deg=1.5, moving_deg=None, bent=0.0, behind=None, speed=60.0, seconds=12.0, **off):
    """The servo with other values, a play (or what else c, t_s goes through) behind it and a sensor's noise."""
    values = {p.name: p.nominal for p in PARAMETERS} | off
    course = random_smooth(arms.rig(folder).actuator, speed, seconds, seed)
    t_s = np.arange(0.0, course.duration_s, STEP_S)
    q = np.interp(t_s, course.t_s, course.q)
    motor = Motor(t_s, q, q)  # commands are not rounded
    driven = servo(motor, values)
    moving_deg = play_deg if moving_deg is None else moving_deg
    c = behind(driven, t_s) if behind else rubbing(driven, t_s, play_deg, moving_deg, bent)
    seen_s = t_s[20::4]
    noise = np.random.default_rng(seed).normal(0.0, NOISE_DEG, len(seen_s))
    return Recording(f"robot{seed}", motor, angle=Angle(seen_s, np.interp(seen_s, t_s, c) + noise))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("joint")


@pytest.fixture(scope="module")
def found(folder):
    return nominal(SERVO, [robot(folder, seed, tau=0.12, gain=4.0) for seed in (3, 5)], arms.rig(folder))


@pytest.fixture(scope="module")
def answer(found):
    segments = prepare(found.model, found.calibration, found.tests, found.drives)[1:]
    joint = Joint(found.model, PARAMETERS, segments, NOISE_DEG)
    return Answer.of(joint, joint.fit())


def test_several_parameters_and_a_play_are_told_at_once(answer):
    """Of gain and load only the ratio moves the tip: 1 / 4, which a law stands for where the play may bend as well. A
    lag is late by its time constant."""
    values = {p.name: p.nominal + answer.joint.changes(answer.fitted.u)[simulator_id(p.name)] for p in PARAMETERS}
    assert values["tau"] + answer.joint.model_at(answer.fitted.u).delay_s == pytest.approx(0.12, abs=0.005)
    known = answer.fitted.posterior.given({f"{BENDS}:0": 0.0, f"{BENDS}:1": 0.0})
    mean, covariance = known.mean[1:3], known.covariance[1:3, 1:3]  # logarithms, gain and load
    ratio = np.array([-1.0, 1.0])
    assert abs(ratio @ mean - np.log(2.5)) < 3.0 * np.sqrt(ratio @ covariance @ ratio) < 0.3
    width = answer.joint.model_at(answer.fitted.u).width
    np.testing.assert_allclose(width, 1.5, atol=0.15)


def test_at_the_best_the_data_pull_as_the_priors_do(answer):
    """The gradient of both together is nothing but for what the last step was allowed to leave."""
    fitted = answer.fitted
    pairs = zip(fitted.slopes, fitted.residuals, strict=True)
    pull = fitted.noise.weight * sum(slope[:, 0].T @ left[:, 0] for slope, left in pairs)
    off = fitted.posterior.covariance @ (pull - fitted.u)  # Newton's step
    np.testing.assert_array_less(np.abs(off), 0.3 * fitted.posterior.sigma)


def test_what_cannot_be_told_apart_is_one_group(answer):
    groups = [set(group) for group in answer.sets.groups]
    assert {simulator_id("gain"), simulator_id("load")} in groups
    assert {WIDTH} in groups and any(simulator_id("tau") in group for group in groups)
    assert not any(LAW in group for group in groups)


def test_the_fit_foretells_another_motion_and_says_how_well(answer, folder):
    other = nominal(SERVO, [robot(folder, 8, tau=0.12, gain=4.0)], arms.rig(folder))
    segment = prepare(other.model, other.calibration, other.tests, other.drives)[1]
    low, high = (f(f(each.motor.q) for each in answer.joint.segments) for f in (min, max))
    q = np.interp(segment.arrival_s, segment.motor.t_s, segment.motor.q)
    inside = segment.part((q > low) & (q < high))
    assert inside.scored.sum() > 300
    model = answer.corrected_model()
    told = segment.predict(model, answer.joint.changes(answer.fitted.u), 0.0)[1]
    assert gap.rms([(segment.observed - told)[inside.scored]]) < 1.2 * NOISE_DEG
    assert model.noise_of(ANGLE) == pytest.approx(NOISE_DEG, rel=0.1)
    assert 0.0 < np.median(model.c_sigma) < 3.0  # deg: each coefficient's prior is 3


def test_friction_that_falls_with_speed_and_goes_with_the_place_is_foretold(folder):
    """2 deg at rest, 1 at speed, and 0.5 more at one end than at the other."""
    friction = {"play_deg": 2.0, "moving_deg": 1.0, "bent": 0.01}
    seen = nominal(SERVO, [robot(folder, 3, **friction)], arms.rig(folder))
    joint = Joint(seen.model, PARAMETERS, prepare(seen.model, seen.calibration, seen.tests, seen.drives)[1:], NOISE_DEG)
    fitted = joint.fit()
    assert {SPEED} in [set(group) for group in Sets.of(joint.unknowns, fitted).groups]
    model = joint.model_at(fitted.u)
    per = model.effects[-1].parameters
    assert model.effects[-1].id == SPEED
    usual = 0.1 * model.rig.actuator.span
    at_speed = per["width_per_speed"] * usual / -np.expm1(-per["speed_saturation"])
    assert at_speed == pytest.approx(-1.0, abs=0.25)
    place = np.array([-20.0, 20.0])
    rest = np.interp(place, model.q, model.width)
    np.testing.assert_allclose(rest, 2.0 + 0.01 * place, atol=0.15)
    other = nominal(SERVO, [robot(folder, 8, **friction)], arms.rig(folder))
    segment = prepare(other.model, other.calibration, other.tests, other.drives)[1]
    told = segment.predict(model, joint.changes(fitted.u), 0.0)[1]
    assert gap.rms([(segment.observed - told)[segment.scored]]) < 1.5 * NOISE_DEG


def hanging(c, t_s):
    """Slack of 2 deg in which a rod hangs: 64 / s^2 to 3 deg, a drag of 4 / s; ends that take its speed; 0.1 ms."""
    fine_s = np.arange(t_s[0], t_s[-1], 1e-4)
    wheel = np.interp(fine_s, t_s, c)
    p, speed, last, seen = float(wheel[0]), 0.0, float(wheel[0]), []
    for now in wheel.tolist():
        speed -= 1e-4 * (64.0 * (p - 3.0) + 4.0 * speed)
        p += 1e-4 * speed
        if abs(p - now) > 1.0:
            end = (now - last) / 1e-4
            speed = min(speed, end) if p > now else max(speed, end)
            p = now + np.copysign(1.0, p - now)
        seen.append(p)
        last = now
    return np.interp(t_s, fine_s, seen)


def test_slack_in_which_a_load_holds_the_joint_to_one_side_is_a_width_and_no_law(folder):
    seen = nominal(SERVO, [robot(folder, seed, behind=hanging) for seed in (3, 5)], arms.rig(folder))
    joint = Joint(seen.model, PARAMETERS, prepare(seen.model, seen.calibration, seen.tests, seen.drives)[1:], NOISE_DEG)
    told = Answer.of(*fit_held_or_loose(joint))
    assert told.joint.loose and {WIDTH} in [set(group) for group in told.sets.groups]
    assert not any(LAW in group for group in told.sets.groups)
    model = told.corrected_model()
    np.testing.assert_allclose(np.interp([-20.0, 0.0, 20.0], model.q, model.width), 2.0, atol=0.1)
    other = nominal(SERVO, [robot(folder, 8, behind=hanging)], arms.rig(folder))
    segment = prepare(other.model, other.calibration, other.tests, other.drives)[1]
    after = segment.observed - segment.predict(model, told.joint.changes(told.fitted.u), 0.0)[1]
    before = segment.observed - segment.predict(joint.model, {}, 0.0)[1]
    print(f"another motion: {gap.rms([before[segment.scored]]):.3f} -> {gap.rms([after[segment.scored]]):.3f} deg")
    assert gap.rms([after[segment.scored]]) < 1.5 * NOISE_DEG


def test_a_play_that_holds_is_not_loose(answer):
    assert not fit_held_or_loose(answer.joint)[0].loose


def test_friction_may_be_another_one_in_another_recording_and_slack_is_not(answer, folder):
    """Of the play of `answer`, nothing goes with speed or place."""
    seen = nominal(SERVO, [robot(folder, 3, play_deg=2.0, moving_deg=1.0, bent=0.01)], arms.rig(folder))
    joint = Joint(seen.model, PARAMETERS, prepare(seen.model, seen.calibration, seen.tests, seen.drives)[1:], NOISE_DEG)
    rubs, slack = Answer.of(joint, joint.fit()).corrected_model(), answer.corrected_model()
    np.testing.assert_allclose(rubs.width_sigma, 0.3 * rubs.width, rtol=1e-2)
    assert (slack.width_sigma < 0.2 * slack.width).all()


def told_beside(model, seen):
    """(Scene times, deg off, one standard deviation) of a robot's recording beside a model."""
    scene = seen.angle.t_s - model.delay_s
    told = predict_with_sigma(model, seen.motor, scene)
    return scene, seen.angle.c_deg - told.c_deg, told.c_sigma_deg


def test_all_that_is_unknown_is_in_a_predictions_sigma(answer, folder):
    """As draws from the posterior of all unknowns are spread, each simulated; noise and friction's share apart. They
    are drawn a tenth as far, where the simulation is linear: the posterior of gain and law is a bent ridge."""
    seen = robot(folder, 8, tau=0.12, gain=4.0)
    model = answer.corrected_model()
    scene, _, sigma = told_beside(replace(model, width_sigma=np.zeros_like(model.q)), seen)
    later = scene > 3.0  # the start within the play is uncertain before
    fitted, rng = answer.fitted, np.random.default_rng(4)
    draws = []
    for u in rng.multivariate_normal(fitted.u, 0.01 * fitted.posterior.covariance, 200):
        drawn = answer.joint.model_at(answer.joint.within_ranges(u))
        draws.append(predict(drawn, seen.motor, seen.angle.t_s - drawn.delay_s).c_deg)
    expected = 10.0 * np.std(draws, axis=0)
    told = np.sqrt(sigma**2 - model.noise_of(ANGLE) ** 2)
    ratio = np.sqrt(np.mean(told[later] ** 2) / np.mean(expected[later] ** 2))
    assert ratio == pytest.approx(1.0, abs=0.15)  # 5 % by 200 draws, the rest by the ridge


def ratcheting(c, t_s):
    """Teeth that six degrees of the tip pass, and what is lost at speed; behind both a play of 1.5 deg."""
    speed = np.gradient(c, t_s)
    return rubbing(c + 1.2 * np.sin(c / 6.0) + 1.5 * np.tanh(speed / 60.0) ** 3, t_s, 1.5, 1.5, 0.0)


def test_detail_that_slow_motions_showed_is_sure_of_no_quick_one(folder):
    """Teeth want the detailed law, and one slow motion tells it: nine of ten readings of six quick ones, whose loss at
    speed no part of the fit has, are in its 90 % interval."""
    robots = {"tau": 0.08, "gain": 4.0, "behind": ratcheting}
    seen = nominal(SERVO, [robot(folder, 3, speed=15.0, seconds=40.0, **robots)], arms.rig(folder))
    joint = Joint(seen.model, PARAMETERS, prepare(seen.model, seen.calibration, seen.tests, seen.drives)[1:], NOISE_DEG)
    best = answer_to_hand_out(Answer.of(joint, joint.fit()))
    assert best.plainer is not None
    model = best.corrected_model()
    covered = []
    for seed in range(8, 14):
        scene, off, sigma = told_beside(model, robot(folder, seed, **robots))
        covered.append(np.mean(np.abs(off[scene > 2.0]) < 1.645 * sigma[scene > 2.0]))
    scene, _, sigma = told_beside(model, robot(folder, 3, speed=15.0, seconds=40.0, **robots))
    quiet = np.median(sigma[scene > 2.0])
    assert min(covered) > 0.8 and 0.85 < np.mean(covered) < 0.97
    assert quiet < 0.5 * np.median(told_beside(model, robot(folder, 8, **robots))[2])


def test_what_another_motion_leaves_is_noise_and_as_much_more_as_others_left():
    """What is beside the noise is a normal share more, with the stated quantiles, the less the less was closed."""
    apart, before, floor = (-0.2, 1.2), 2.0, 0.3
    drawn = np.random.default_rng(1).normal(0.5, 0.7 / 1.645, 200_000)
    beside = 0.5
    more = 1.0 + drawn * (1.0 - beside / before)
    expected = np.sqrt(floor**2 + np.mean((beside * more) ** 2))
    assert gap.unseen(before, np.hypot(floor, beside), floor, apart) == pytest.approx(expected, rel=5e-3)
    assert gap.unseen(before, floor, floor, apart) == pytest.approx(floor)


def test_of_a_robot_that_is_as_the_simulator_nothing_is_there(folder):
    """Of three noises none: each is named by chance in less than one of ten."""
    for seed in (4, 5, 6):
        found = nominal(SERVO, [robot(folder, seed, play_deg=0.0)], arms.rig(folder))
        segments = prepare(found.model, found.calibration, found.tests, found.drives)[1:]
        joint = Joint(found.model, PARAMETERS, segments, NOISE_DEG)
        assert Sets.of(joint.unknowns, joint.fit()).groups == []


def test_what_is_better_on_blocks_that_were_not_seen_answers(found, answer):
    """Beside a diagnosis that knows the simulator's parameters alone, none of which is a play."""
    left_out = [kind.id for kind in LIBRARY]
    told = diagnose(found.model, found.calibration, found.tests, left_out=left_out, simulated=found)
    instead_of = with_joint_answer(told, answer)
    document = instead_of.document
    assert document["verdict"] == "effect" and gap.rms(instead_of.after) < gap.rms(told.after)
    leads = {effect["id"]: effect for effect in document["effects"]}
    assert WIDTH in leads and leads[WIDTH]["parameters"]["width_everywhere"] == pytest.approx(1.5, abs=0.1)
    total = document["probability_none"] + document["probability_unknown"]
    total += sum(candidate["probability"] for candidate in document["candidates"])
    assert total == pytest.approx(1.0)
    assert sum(effect["shrink"] for effect in document["effects"]) == pytest.approx(document["gap"]["shrink"])
    worse = Answer(answer.joint, answer.fitted, answer.sets, [2.0 * left for left in told.after])
    assert with_joint_answer(told, worse) is told


def linear(slopes, y, noise):
    """A fit of y = slopes u + noise, u a standard normal."""
    matrix = np.eye(slopes.shape[1]) + slopes.T @ slopes / noise**2
    u = np.linalg.solve(matrix, slopes.T @ y / noise**2)
    names = tuple(f"x{i}:0" for i in range(len(u)))
    residual = (y - slopes @ u)[:, None]
    posterior = Posterior(names, u, np.linalg.inv(matrix))
    return Fitted(posterior, Noise(noise, 1.0), [residual], [slopes[:, None, :]], np.arange(len(u)))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), there=st.lists(st.booleans(), min_size=3, max_size=3))
def test_a_sets_probability_is_that_of_its_own_evidence(seed, there):
    """Of a linear model: y is normal, with the covariance noise^2 1 + slopes slopes' of what is in the set."""
    rng = np.random.default_rng(seed)
    slopes, noise = rng.normal(size=(8, 3)), 0.8
    y = slopes @ (np.array(there) * rng.normal(size=3)) + noise * rng.normal(size=8)
    sets = Sets.of(tuple(Unknown(f"x{i}", np.array([i])) for i in range(3)), linear(slopes, y, noise))
    columns = [int(name[1]) for name in sets.ids]
    log = []
    for present in sets.present:
        own = slopes[:, [c for c, p in zip(columns, present, strict=True) if p]]
        density = multivariate_normal(np.zeros(8), noise**2 * np.eye(8) + own @ own.T).logpdf(y)
        log.append(density + present.sum() * np.log(THERE) + (~present).sum() * np.log(1.0 - THERE))
    expected = np.exp(log - np.logaddexp.reduce(log))
    np.testing.assert_allclose(sets.probability, expected, rtol=1e-6)


def test_what_is_surely_there_is_named_however_many_may_be():
    rng = np.random.default_rng(3)
    slopes, noise = rng.normal(size=(60, 15)), 0.8
    u = np.zeros(15)
    u[[4, 9]] = 2.0, -1.5
    sets = Sets.of(
        tuple(Unknown(f"x{i}", np.array([i])) for i in range(15)),
        linear(slopes, slopes @ u + noise * rng.normal(size=60), noise),
    )
    assert sorted(sets.ids) == sorted(f"x{i}" for i in range(15))
    assert set(sets.groups[:2]) == {("x4",), ("x9",)} and sets.count[2] + sets.count[3] > 0.99


def test_a_simulator_that_is_the_robot_to_the_last_digit_lacks_nothing(folder, tmp_path):
    course = random_smooth(arms.rig(folder).actuator, 60.0, 12.0, 3)
    t_s = np.arange(0.0, course.duration_s, STEP_S)
    q = np.interp(t_s, course.t_s, course.q)
    motor = Motor(t_s, q, q)
    own = Recording("own", motor, angle=Angle(t_s[20::4], SERVO.tip(motor, {})[20::4]))
    found = diagnose_simulator(SERVO, [own], arms.rig(folder))
    assert found.verdict == "none" and found.gap.before == found.gap.after == found.gap.shrink == 0.0
    assert sum(found.probabilities.values()) == pytest.approx(1.0)
    save(found, tmp_path / "told")


def test_repeated_samples_are_of_the_gap_and_the_others_shrink_the_rest(folder):
    """A fifth of the readings repeats one."""
    robots = []
    for seed in (3, 5):
        seen = robot(folder, seed, tau=0.12, gain=4.0)
        at = np.arange(len(seen.angle.t_s))
        at -= np.where(at % 75 < 15, at % 75, 0)
        robots.append(replace(seen, angle=Angle(seen.angle.t_s, seen.angle.c_deg[at])))
    found = diagnose_simulator(SERVO, robots, arms.rig(folder))
    shrinks = {finding.id: finding.shrink for finding in found.findings}
    assert HELD in shrinks and simulator_id("tau") in shrinks
    assert sum(shrinks.values()) == pytest.approx(found.gap.shrink)
    assert found.gap.shrink == pytest.approx(1.0 - found.gap.after / found.gap.before)


def test_a_block_that_is_left_out_is_foretold_by_a_fit_without_it(answer, monkeypatch):
    """Of a linear model the step to it is exact."""
    monkeypatch.setattr(heldout, "STAYS", 0.0)
    rng = np.random.default_rng(2)
    joint = Joint(answer.joint.model, PARAMETERS, answer.joint.segments[:1], NOISE_DEG)
    segment = joint.segments[0]
    count = int(segment.scored.sum())
    slopes, noise = rng.normal(size=(count, 3)), 0.5
    y = slopes @ np.array([1.0, 0.0, -0.5]) + noise * rng.normal(size=count)
    joint.within_ranges, joint.residuals = lambda u: u, lambda u: [(y - slopes @ u)[:, None]]
    left = held_out_residuals(joint, linear(slopes, y, noise))[0][:, 0]
    label = gap.blocks(segment)
    assert label.max() > 0
    for number in np.unique(label):
        rest = label != number
        u = linear(slopes[rest], y[rest], noise).u
        np.testing.assert_allclose(left[~rest], (y - slopes @ u)[~rest], atol=1e-9)


def test_where_a_linear_step_fails_the_rest_is_fitted_without_the_block(answer):
    """Curves exp(2 x u): from u = 0 the straight line leads far beyond what the rest alone says, 0.5."""
    joint = Joint(answer.joint.model, PARAMETERS, answer.joint.segments[:1], NOISE_DEG)
    x = np.linspace(1.0, 2.0, 40)[:, None]
    rest = (np.arange(40) < 30).astype(float)
    y = np.where(rest[:, None] > 0.0, np.exp(x), 1.0)
    joint.within_ranges = lambda u: u
    joint.residuals = lambda u: [y - np.exp(2.0 * x * u[0])]
    joint.slopes = lambda u, residuals: [(2.0 * x * np.exp(2.0 * x * u[0]))[:, :, None]]
    here = np.zeros(1)
    posterior = Posterior(("u:0",), here, np.eye(1))
    fitted = Fitted(posterior, Noise(0.01, 1.0), joint.residuals(here), joint.slopes(here, None), np.arange(1))
    for step in (1.5, 0.5):  # it leads nowhere, and there
        refitted = joint.residuals_with_weights(fitted, [rest], np.array([step]))
        np.testing.assert_allclose(refitted[0][rest == 0.0], (y - np.exp(x))[rest == 0.0], rtol=0.02)


def test_a_fit_without_a_block_stays_within_the_unknowns_ranges(answer):
    """Lines u x of a width, which is 0 at least: where the rest says -1 it is 0."""
    joint = Joint(answer.joint.model, PARAMETERS, answer.joint.segments[:1], NOISE_DEG)
    x = np.linspace(1.0, 2.0, 40)[:, None]
    rest = (np.arange(40) < 30).astype(float)
    y = np.where(rest[:, None] > 0.0, -x, x)
    joint.within_ranges = lambda u: np.maximum(u, 0.0)
    joint.residuals = lambda u: [y - x * u[0]]
    here = np.full(1, 0.1)
    posterior = Posterior(("u:0",), here, np.eye(1))
    fitted = Fitted(posterior, Noise(0.01, 1.0), joint.residuals(here), [x[:, :, None]], np.arange(1))
    np.testing.assert_allclose(joint.residuals_with_weights(fitted, [rest], np.array([-1.1]))[0], y)
