"""What the next motion is expected to tell, beside what it tells."""

from dataclasses import replace

import numpy as np
import pytest

from tautline import trajectory
from tautline.diagnosis import motion
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Scope
from tautline.diagnosis.information import Outlook, Rivals
from tautline.diagnosis.segment import Segment
from tautline.effects import BY_ID, simulate
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(*RIG.actuator.range, 401)
INSTRUMENT = preset("reference")
MODEL = Model(
    RIG, GRID, INSTRUMENT.backlash(GRID), np.full(401, 0.003), INSTRUMENT.bend(GRID), 0.08, RIG.actuator.range
)
NOISE = 0.05  # px
LAG = {"lag": 0.1}


def strokes(speed: float) -> Motor:
    moved = trajectory.trapezoids(RIG.actuator, speed, 4.0, 5, 10 * speed, 0.5)
    return Motor(moved.t_s[::20], moved.q[::20], None, None, None)


def segment(number: int, motor: Motor, parameters: dict[str, float], noise: float = NOISE) -> Segment:
    rng = np.random.default_rng(number)
    scene = np.arange(8.0, motor.t_s[-1], 0.04)
    seen = simulate(MODEL, motor, scene, parameters).image_px
    seen = seen + rng.normal(0.0, noise, seen.shape)
    scored = np.ones(len(scene), dtype=bool)
    return Segment(f"test-{number}", motor, scene + 0.08, seen, scored, 100.0 * number, number == 0, number)


def fitted(fitter: Fitter, name: str, values: dict[str, float]) -> Fit:
    hypothesis = fitter.no_effect.plus(BY_ID[name], Scope.TESTS)
    return fitter.fit(hypothesis, dict.fromkeys((slot.key for slot in hypothesis.slots), 0.0) | values, fitter.start())


def squares(residual: np.ndarray) -> float:
    return float(np.sum(residual**2))


@pytest.fixture(scope="module")
def at_one_speed():
    """A fitter of a calibration and a test at one speed, where the tip lags; fits of none, the lag and a delay."""
    fitter = Fitter(MODEL, [segment(0, strokes(1.0), {}), segment(1, strokes(1.0), LAG)])
    fitter.floor = NOISE
    base = fitter.recalibrated()
    lag = fitted(fitter, "transmission.lag", LAG)
    delay = fitted(fitter, "acquisition.delay", {"delay": 0.1})
    return fitter, base, lag, delay


def test_what_a_refit_leaves_is_what_is_foretold(at_one_speed):
    fitter, base, lag, delay = at_one_speed
    following = replace(segment(2, strokes(1.8), LAG), number=1, offset_s=200.0)
    outlook = Outlook(fitter, Rivals.of([base, lag, delay], [0.1, 0.5, 0.3, 0.1]), [following], 1.0)
    foretold = outlook.power_left([0])
    assert np.diag(foretold) == pytest.approx(0.0, abs=1e-12)
    # The truth, without noise, and each rival fitted anew to everything.
    silent = replace(
        following, observed=following.predict(lag.state.model, lag.state.at(following, lag.hypothesis), 0)[1]
    )
    everything = Fitter(MODEL, [*fitter.segments, silent])
    everything.floor = NOISE
    for i, rival in ((0, base), (2, delay)):
        again = everything.descend(rival.hypothesis, rival.state, 16)
        more = sum(map(squares, again.residuals)) - sum(map(squares, rival.residuals))
        left = more / silent.observed.size
        assert left > 4 * NOISE**2  # it can be told
        assert foretold[1, i] == pytest.approx(left, rel=0.3)


def test_nothing_is_expected_where_both_say_the_same_and_no_more_than_is_open(at_one_speed):
    fitter, base, lag, _ = at_one_speed
    same = motion.plan_best_motion(fitter, Rivals.of([base, lag, lag], [0.0, 0.49, 0.49, 0.02]))
    other = motion.plan_best_motion(fitter, Rivals.of([base, lag, lag], [0.49, 0.49, 0.0, 0.02]))
    assert same.information < 0.3 < 0.6 < other.information <= other.entropy


def test_what_one_speed_leaves_open_is_asked_at_another_speed():
    wider = {"width_per_speed": 0.1, "speed_saturation": 0.0, "speed_time": 0.02, "width_held": 1.0}
    noise = 0.4  # a wider backlash leaves 0.1
    fitter = Fitter(MODEL, [segment(0, strokes(1.0), {}, noise), segment(1, strokes(1.0), wider, noise)])
    fitter.floor = noise
    base = fitter.recalibrated()
    by_speed = fitted(fitter, "transmission.rate_dependent_backlash", wider)
    rivals = Rivals.of([base, by_speed, fitted(fitter, "transmission.backlash", {})], [0.0, 0.5, 0.5, 0.0])
    again = fitter.segments[1]
    repeated = Outlook(fitter, rivals, [again], 1.0).expected([0], float(again.motor.t_s[-1]))
    asked = motion.plan_best_motion(fitter, rivals)
    assert asked.entropy - asked.information < 0.5 * (asked.entropy - repeated)
    speeds = np.abs(np.diff(asked.motion.q)) * trajectory.RATE_HZ
    assert np.median(speeds[speeds > 0.1]) < 0.7


def test_what_imitates_everywhere_is_not_open(at_one_speed):
    fitter, base, lag, _ = at_one_speed
    # As sure as a verdict gets of a part of the nominal model: what is left to unknown is what imitates it everywhere.
    assert motion.plan_best_motion(fitter, Rivals.of([base, lag], [0.0, 0.95, 0.05])).information < 0.25
    assert motion.plan_best_motion(fitter, Rivals.of([base, lag], [0.0, 0.5, 0.5])).information > 0.5


def test_samples_of_one_time_tell_no_speed(at_one_speed):
    """As of a log that writes a row twice: neither the motion nor what it may be is lost."""
    fitter, base, lag, _ = at_one_speed
    twice = []
    for segment in fitter.segments:
        of_row = np.sort(np.append(np.arange(len(segment.motor.t_s)), [3, 40, 40]))
        twice.append(replace(segment, motor=Motor(segment.motor.t_s[of_row], segment.motor.q[of_row], None)))
    rivals = Rivals.of([base, lag], [0.0, 0.5, 0.5])
    once, again = (motion.plan_best_motion(of, rivals) for of in (fitter, fitter.on_recordings(twice)))
    np.testing.assert_allclose(again.motion.q, once.motion.q, atol=1e-9)
