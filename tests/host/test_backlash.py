"""B(q) from widths: smooth where the truth is, sharp where it is, lawful, and honest where nothing was measured."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import logsumexp

from tautline.calibration.backlash import _interval_terms, fit_paper, fit_widths, paper_knots
from tautline.calibration.onset import BOUND, BRACKET, HINGE, Onset

GRID = np.linspace(-5.0, 5.0, 1025)


def widths(law, p, sigma, rng):
    """Onsets that a play with width law(p) would show, alternately in both directions."""
    made = []
    for k, centre in enumerate(p):
        direction = 1 if k % 2 else -1
        truth = float(law(centre))
        q1 = centre - direction * truth / 2
        width = truth + rng.normal(0, sigma)
        made.append(Onset(0, float(k), k + 0.5, direction, q1, q1 + direction * width, sigma, 0.0, np.inf, HINGE, True))
    return made


def bump(height, fwhm):
    return lambda p: 0.4 + height * np.exp(-0.5 * (np.asarray(p) / (fwhm / 2.355)) ** 2)


@pytest.mark.parametrize("fwhm", [0.6, 1.0])
def test_a_narrow_bump_that_the_papers_knots_cannot_follow(fwhm):
    law, rng = bump(0.25, fwhm), np.random.default_rng(int(10 * fwhm))
    onsets = widths(law, np.linspace(-4.7, 4.7, 80), 0.001, rng)
    inside = np.abs(GRID) < 4.6
    smooth, paper = fit_widths(onsets, GRID), fit_paper(onsets, GRID)
    error = [1e3 * np.sqrt(np.mean((c.width - law(GRID))[inside] ** 2)) for c in (smooth, paper)]
    print(f"bump of {fwhm} mm: {error[0]:.1f} um rms, with the paper's 14 knots {error[1]:.1f} um")
    assert error[0] < 3.0 and error[1] > 10.0


def test_the_papers_knots():
    knots = paper_knots(-5.0, 5.0)
    assert len(knots) == 14 and len(np.unique(knots)) == 8
    assert (knots[:4] == -5).all() and (knots[-4:] == 5).all()


def test_a_constant_stays_constant_and_its_uncertainty_is_honest():
    z = []
    for seed in range(30):
        rng = np.random.default_rng(seed + 70)
        onsets = widths(lambda p: 0.5 + 0 * p, rng.uniform(-4, 4, 25), 0.004, rng)
        curve = fit_widths(onsets, GRID)
        inside = np.abs(GRID) < 3.5
        z.append((curve.width - 0.5)[inside] / curve.sigma[inside])
        assert np.abs(curve.width - 0.5)[inside].max() < 0.012
    assert np.sqrt(np.mean(np.square(z))) < 1.3


def test_beyond_what_reversals_reached_the_width_is_held_and_its_sigma_grows():
    rng = np.random.default_rng(1)
    curve = fit_widths(widths(lambda p: 0.4 + 0.05 * p, np.linspace(-2, 2, 30), 0.001, rng), GRID)
    assert curve.measured == pytest.approx((-2, 2), abs=0.01)
    assert curve.width[-1] == pytest.approx(curve.at(np.array([2.0]))[0], abs=1e-3)
    assert curve.sigma[-1] > 100 * np.interp(0.0, GRID, curve.sigma)


def test_each_width_counts_by_its_uncertainty():
    rng = np.random.default_rng(2)
    good = widths(lambda p: 0.5 + 0 * p, np.linspace(-4, 4, 20), 0.001, rng)
    poor = widths(lambda p: 0.5 + 0 * p, np.linspace(-4, 4, 20) + 0.05, 0.2, rng)
    curve = fit_widths(good + poor, GRID)
    assert np.abs(curve.width - 0.5).max() < 0.003


def test_a_stroke_that_moved_nothing_lifts_the_curve():
    rng = np.random.default_rng(3)
    onsets = widths(lambda p: 0.4 + 0 * p, np.concatenate([np.linspace(-4, -1, 12), np.linspace(1, 4, 12)]), 0.001, rng)
    stuck = Onset(0, 0.0, np.nan, 1, -0.4, 0.4, np.inf, 0.8, np.inf, BOUND, True)
    curve = fit_widths([*onsets, stuck], GRID)
    assert curve.at(np.array([0.0]))[0] > 0.75
    assert any("moved nothing" in note for note in curve.notes)
    assert curve.at(np.array([-3.0, 3.0])) == pytest.approx(0.4, abs=0.03)


def test_what_no_play_can_have_is_limited_and_said():
    rng = np.random.default_rng(4)
    step = widths(lambda p: 0.2 + 2.0 * (p > 0), np.linspace(-4, 4, 60), 0.001, rng)
    curve = fit_widths(step, GRID)
    assert np.abs(np.diff(curve.width) / np.diff(GRID)).max() <= 1.8 + 1e-9
    assert curve.notes


def test_brackets_intersect():
    errors = []
    for seed in range(12):
        rng = np.random.default_rng(seed + 300)
        frame, truth, onsets = 0.6, 15.0, []
        for k, p in enumerate(np.linspace(-50, 50, 75)):
            direction, low = (1 if k % 2 else -1), truth - frame * rng.uniform()
            q1, middle = p - direction * truth / 2, low + frame / 2
            onsets.append(
                Onset(0, k, k, direction, q1, q1 + direction * middle, frame / 12**0.5, low, low + frame, BRACKET, True)
            )
        curve = fit_widths(onsets, np.linspace(-60, 60, 1025))
        inside = np.abs(curve.q) < 49
        errors.append((curve.width - truth)[inside])
    print(f"75 brackets of 0.6 deg: {np.sqrt(np.mean(np.square(errors))):.4f} deg rms")
    assert np.sqrt(np.mean(np.square(errors))) < 0.02


def brackets(law, p, frame, rng):
    """Widths law(p) that frames `frame` of travel apart (p's length, or one number) bound on either side."""
    made = []
    for k, (centre, step) in enumerate(zip(p, np.broadcast_to(frame, len(p)), strict=True)):
        direction = 1 if k % 2 else -1
        truth = float(law(centre))
        low = truth - step * rng.uniform()
        q1, sigma = centre - direction * truth / 2, step / 12**0.5
        q2 = q1 + direction * (low + step / 2)
        made.append(Onset(0, k, k + 0.5, direction, q1, q2, sigma, low, low + step, BRACKET, True))
    return made


@pytest.mark.parametrize("alone", [False, True])
def test_brackets_of_several_speeds_follow_a_bump(alone):
    """Three speeds, as calibrations have them; or but one of them far away from all others, of which nothing tells."""
    law, errors, z = bump(0.3, 2.8), [], []
    for seed in range(8):
        rng = np.random.default_rng(seed + 900)
        p = np.append(rng.uniform(0.0 if alone else -4.5, 4.5, 50), -4.5)
        curve = fit_widths(brackets(law, p, rng.choice([0.03, 0.06, 0.12], len(p)), rng), GRID)
        inside = np.abs(GRID - (2.25 if alone else 0.0)) < (1.75 if alone else 4.0)
        errors.append((curve.width - law(GRID))[inside])
        z.append(errors[-1] / curve.sigma[inside])
    rms = [float(np.sqrt(np.mean(np.square(each)))) for each in (errors, z)]
    print(f"50 brackets of 30 to 120 um on a bump of 0.3 mm: {1e3 * rms[0]:.1f} um rms, z {rms[1]:.2f}")
    assert rms[0] < 0.012  # a tenth of the widest; a line through the bump is 60 to 100 um off
    assert 0.4 < rms[1] < 1.5


def test_a_bracket_of_no_width_is_one_measurement_among_others():
    """A motor that steps and does not move otherwise brackets an onset at its own start."""
    seen = (
        *((-24.02, 1, 1.98), (-35.42, -1, 9.86), (46.08, -1, 102.85), (64.2, -1, 31.73), (-41.68, 1, 13.86)),
        *((73.78, -1, 77.25), (75.84, -1, 105.11), (78.34, -1, 132.94), (31.82, -1, 38.95), (3.1, -1, 21.38)),
        *((68.68, -1, 36.57), (-51.24, 1, 38.02), (-28.3, 1, 1.98), (68.28, -1, 5.22e-11)),
    )  # q1, direction, travel to the first frame that moves: an angle sensor's, with counts of 7 deg between frames
    onsets = [
        Onset(0, k, k, way, q1, q1 + way * high / 2, max(high / 12**0.5, 7.1 * (high < 1)), 0.0, high, BRACKET, True)
        for k, (q1, way, high) in enumerate(seen)
    ]
    curve = fit_widths(onsets, np.linspace(-80.0, 80.0, 1025))
    assert np.isfinite(curve.width).all() and (curve.width >= 0.0).all() and (curve.sigma > 0.0).all()


def test_without_widths_there_is_no_curve():
    stuck = Onset(0, 0.0, np.nan, 1, -0.4, 0.4, np.inf, 0.8, np.inf, BOUND, True)
    assert fit_widths([stuck], GRID) is None and fit_paper([stuck], GRID) is None


def test_brackets_that_contradict_each_other_give_their_middle_and_a_large_sigma():
    rng = np.random.default_rng(4)
    truth = rng.uniform(0.0, 0.5, 60)  # as if the image moved by itself
    centre = np.linspace(-4, 4, 60)
    onsets = [
        Onset(0, k, k + 0.5, 1, p - w / 2, p + w / 2, 1e-3, w - half, w + half, BRACKET, True)
        for k, (p, w, half) in enumerate(zip(centre, truth, np.where(np.arange(60) % 3, 2e-3, 1e-6), strict=True))
    ]
    curve = fit_widths(onsets, GRID)
    inside = np.abs(GRID) < 3.5
    assert np.abs(curve.width[inside] - 0.25).max() < 0.15
    assert curve.sigma[inside].min() > 0.01


@pytest.mark.filterwarnings("error")
def test_brackets_and_onsets_that_no_frame_bounds_agree():
    rng = np.random.default_rng(6)
    onsets = []
    for k, p in enumerate(np.linspace(-4, 4, 40)):
        low, kind = (0.5 - 0.02 * rng.uniform(), BRACKET) if k % 2 else (0.0, HINGE)
        high, width = (low + 0.02, low + 0.01) if k % 2 else (np.inf, 0.5 + rng.normal(0, 0.005))
        onsets.append(Onset(0, k, k + 0.5, 1, p - width / 2, p + width / 2, 0.005, low, high, kind, True))
    curve = fit_widths(onsets, GRID)
    assert np.abs(curve.width[np.abs(GRID) < 3.5] - 0.5).max() < 0.005


@given(st.floats(-25.0, 25.0), st.floats(1e-3, 10.0))
def test_a_bracket_costs_the_mass_that_is_left_to_it(middle: float, half: float) -> None:
    a, b = np.array([middle + half]), np.array([middle - half])
    cost, first, second = (float(x[0]) for x in _interval_terms(a, b))
    inside = middle + half * (np.arange(-9999.0, 10000.0, 2.0) / 10000.0)
    mass = logsumexp(-0.5 * inside**2) + np.log(2 * half / len(inside) / np.sqrt(2 * np.pi))
    assert cost == pytest.approx(-mass, abs=2e-3)
    step = 1e-3
    ahead, behind = (_interval_terms(a + way * step, b + way * step) for way in (1, -1))
    assert first == pytest.approx(float((ahead[0] - behind[0])[0]) / (2 * step), rel=1e-3, abs=1e-6)
    assert second == pytest.approx(float((ahead[1] - behind[1])[0]) / (2 * step), rel=1e-2, abs=1e-5)


@given(st.floats(30.0, 1e15), st.floats(0.0, 1e3), st.sampled_from([-1, 1]))
def test_a_bracket_pulls_from_however_far_away(beyond: float, half: float, side: int) -> None:
    middle = side * (beyond + half)
    cost, first, second = (float(x[0]) for x in _interval_terms(np.array([middle + half]), np.array([middle - half])))
    assert cost == pytest.approx(0.5 * beyond**2, rel=0.02)
    assert first == pytest.approx(side * beyond, rel=0.02)
    assert second == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("count", [1, 2, 4])
def test_few_widths_are_their_mean_and_are_not_pulled_to_nothing(count):
    onsets = widths(lambda p: 0.5 + 0 * p, np.linspace(-4, 4, count), 0.0, np.random.default_rng(0))
    curve = fit_widths([replace(o, sigma=0.01) for o in onsets], GRID)
    inside = np.linspace(*curve.measured, 9)
    np.testing.assert_allclose(curve.at(inside), 0.5, atol=0.002)
    assert np.median(np.interp(inside, GRID, curve.sigma)) > 0.9 * 0.01 / np.sqrt(count)
    assert curve.places == count
