"""A prediction states how far off it may be: what is seen on motions that nobody calibrated with lies within."""

import json
from dataclasses import replace

import numpy as np
import pytest
from slices import some

import tautline as tl
from tautline import trajectory
from tautline.errors import TautError
from tautline.model import Model, Uncertainty
from tautline.prediction import COLUMNS, foretold, predict_with_sigma, score, settled_from
from tautline.recording import Angle, Motor, Recording, save
from tautline.rig import ANGLE, Actuator, Coarse, Rig
from tautline.simulated import simulate
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
INSTRUMENT = preset("reference", RIG)


def strokes(seed: int, speeds: tuple[float, float], count: int) -> Recording:
    shares = np.random.default_rng(seed).uniform(*speeds, 3)
    motion = trajectory.back_and_forth(RIG.actuator, list(shares), 2.0, count, 8.0, 0.3)
    return replace(simulate.simulate(RIG, INSTRUMENT, motion, seed=seed), rig=RIG)


@pytest.fixture(scope="module", params=some([1, 2, 3], 2))
def calibrated(request):
    return tl.calibrate(strokes(request.param, (0.6, 1.6), 14)).model, strokes(100 + request.param, (0.7, 1.9), 10)


def test_nine_of_ten_unseen_frames_lie_within_what_nine_of_ten_should(calibrated):
    model, unseen = calibrated
    assert model.quality.verdict == "good"
    found = score(model, unseen)
    print(found)
    assert 0.80 < found.within_90 < 0.97 and found.rows > 1000 and found.unit == "px"


def test_a_b_that_is_less_known_is_told_where_it_shows(calibrated):
    model, unseen = calibrated
    scene = unseen.marker.t_s - model.delay_s
    sharp, blurred = (
        predict_with_sigma(m, unseen.motor, scene) for m in (model, replace(model, width_sigma=model.width_sigma + 0.1))
    )
    gain = abs(RIG.coarse.gain)
    late = scene > settled_from(model, unseen.motor)
    moved = np.sqrt(np.median(blurred.c_sigma_deg[late] ** 2 - sharp.c_sigma_deg[late] ** 2))
    assert moved == pytest.approx(0.05 * gain, rel=0.3)  # half of 0.1 mm
    unknown = replace(model, c_sigma=np.where(model.q > 1.0, np.nan, model.c_sigma))
    told = predict_with_sigma(unknown, unseen.motor, scene)
    high = model.remaining_inverse(told.c_deg) > 1.1
    assert np.isnan(told.c_sigma_deg[high]).all() and np.isfinite(told.c_sigma_deg[~high]).mean() > 0.95
    assert np.isfinite(told.c_deg).all()


def test_a_late_image_and_a_wide_backlash_that_cancel_are_told_together():
    """At 2 mm/s a delay of 10 ms more is a width of 40 um more: what frames of one speed cannot tell apart does no harm
    to another motion at that speed, and at twice it as much as half of it alone."""
    q, late = np.linspace(-5.0, 5.0, 101), Uncertainty(delay_sigma_s=0.01)
    model = tl.Model(RIG, q, 0.4 + 0 * q, 0.04 + 0 * q, 12.0 * q, 0.08, (-4.5, 4.5), uncertainty=late)
    together = replace(model, uncertainty=replace(late, width_by_delay=-4.0 + 0 * q))

    def spread(of: tl.Model, speed: float) -> float:
        """deg, while the motor goes to and fro at a speed, mm/s."""
        t = np.linspace(0.0, 16.0, 16001)
        path = Motor(t, 4.0 * np.arcsin(np.sin(2.0 * np.pi * t * speed / 16.0)) / (np.pi / 2.0))
        at = np.arange(8.3, 15.0, 0.05)
        moving = np.abs(np.interp(at, t, path.q)) < 3.0
        known = replace(of, width_sigma=0 * q, uncertainty=Uncertainty())
        sigma, bare = (predict_with_sigma(each, path, at).c_sigma_deg[moving] for each in (of, known))
        return float(np.sqrt(np.median(sigma**2 - bare**2)))

    assert spread(model, 2.0) == pytest.approx(0.24 * np.sqrt(2.0), rel=0.03)
    assert spread(together, 2.0) < 0.02
    assert spread(together, 4.0) == pytest.approx(0.24, rel=0.03)


def test_where_the_tip_began_matters_until_it_is_driven_unless_it_is_told(calibrated):
    model, unseen = calibrated
    scene = unseen.marker.t_s - model.delay_s
    free, given = (predict_with_sigma(model, unseen.motor, scene, c) for c in (None, 1.0))
    first = scene < unseen.motor.t_s[0] + 0.5
    half = 0.5 * float(np.interp(0.0, model.q, model.width)) * abs(RIG.coarse.gain)
    assert free.c_sigma_deg[first].max() == pytest.approx(half / np.sqrt(3.0), rel=0.5)
    late = scene > settled_from(model, unseen.motor)
    np.testing.assert_allclose(free.c_sigma_deg[late], given.c_sigma_deg[late], rtol=1e-6)
    assert given.c_sigma_deg[first].max() < 0.3 * free.c_sigma_deg[first].max()


def test_an_angle_sensor_has_its_own_noise(calibrated):
    model, unseen = calibrated
    blind = replace(model.rig, camera=None, hand_eye=None, kinematics=None)
    own = replace(model, rig=blind, sensor=ANGLE, uncertainty=Uncertainty(noise=0.3))
    scene = unseen.marker.t_s - own.delay_s
    told = tl.predict(own, unseen.motor, scene)
    assert told.image_sigma_px is None and 0.3 <= told.c_sigma_deg[-100:].min() < 0.32
    noise = np.random.default_rng(1).normal(0.0, 0.3, len(scene))
    seen = replace(unseen, marker=None, angle=Angle(unseen.marker.t_s, told.c_deg + noise))
    found = score(own, seen)
    assert found.unit == "deg" and found.over_sigma == pytest.approx(1.0, abs=0.05)


def test_a_calibration_says_what_it_predicts_of_its_own_frames():
    early, late = strokes(1, (0.6, 1.6), 14), strokes(2, (0.7, 1.4), 10)
    marker = late.marker
    by_s = 500.0
    late = replace(late, name="late", motor=replace(late.motor, t_s=late.motor.t_s + by_s))
    late = replace(late, marker=replace(marker, t_s=marker.t_s + by_s))
    found = tl.calibrate([late, early])
    assert [each.name for each in found.predicted] == list(found.names) == [early.name, "late"]
    for each, recording in zip(found.predicted, (early, late), strict=True):
        told = tl.predict(found.model, recording.motor, each.scene_s)
        assert np.array_equal(each.predicted, told.image_px)
        at = np.searchsorted(recording.marker.t_s, each.scene_s + found.model.delay_s - 1e-9)
        assert np.array_equal(each.seen[:, 0], recording.marker.u_px[at])
        settled = each.scene_s > settled_from(found.model, recording.motor)
        assert np.sqrt(np.mean(each.residual[settled] ** 2)) < 0.06  # px: the marker's noise is 0.05


def test_the_command_writes_the_sigmas_and_the_score(calibrated, tmp_path, taut):
    model, unseen = calibrated
    model.save(tmp_path / "model")
    save(unseen, tmp_path / "unseen")
    words = ("predict", tmp_path / "model", tmp_path / "unseen", "--csv", tmp_path / "out.csv")
    plain = json.loads(taut(*words, "--json").out)
    told = tl.predict(model, unseen.motor, unseen.marker.t_s - model.delay_s)
    table = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True)
    assert ",".join(table.dtype.names) == COLUMNS and "score" not in plain
    np.testing.assert_allclose(table["c_sigma_deg"], told.c_sigma_deg, rtol=1e-3)
    np.testing.assert_allclose(table["v_sigma_px"], told.image_sigma_px[:, 1], rtol=1e-3)
    found = json.loads(taut(*words, "--json", "--score").out)["score"]
    assert found["within_90"] == pytest.approx(score(model, unseen).within_90, abs=0.01)
    done = taut(*words, "--score")
    assert "% within what 90 % should be" in done.out
    (tmp_path / "unseen" / "marker.csv").unlink()
    assert taut(*words, "--score").code == 1


def test_what_is_seen_after_the_motors_log_ends_counts_nowhere():
    t_s = np.arange(0.0, 10.0, 0.005)
    motor = Motor(t_s, np.round(3.0 * np.sin(2.0 * t_s), 3))
    q = np.linspace(-5.0, 5.0, 41)
    model = Model(
        Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0)), q, 0.3 + 0 * q, 0.01 + 0 * q, 12 * q, 0.05, (-4, 4)
    )
    angle = Angle(t_s[::8] + 0.05, model.simulate(motor, t_s[::8]) + 0.01)
    model = replace(model, sensor=ANGLE)
    ended = Recording("ended", Motor(t_s[:1400], motor.q[:1400]), angle=angle, rig=model.rig)
    assert foretold(model, ended) == pytest.approx(0.01, rel=0.1)
    assert foretold(model, ended) == score(model, ended).rms


@pytest.mark.parametrize("scene_s", [0.5, [0.1, np.nan], [[0.1], [0.2]]])
def test_times_that_are_no_row_of_finite_ones_are_refused(scene_s):
    q = np.linspace(-5.0, 5.0, 41)
    rig = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0))
    model = Model(rig, q, 0.3 + 0 * q, 0.01 + 0 * q, 12 * q, 0.05, (-4, 4))
    with pytest.raises(TautError, match="no row of finite times"):
        tl.predict(model, Motor(np.arange(0.0, 1.0, 0.01), np.arange(0.0, 1.0, 0.01)), scene_s)
