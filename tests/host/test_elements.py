"""Several play elements on one backlash table, against their defining equations and against other programs."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline
from test_play import solve

from tautline import _native, effects
from tautline.elements import SINGLE, Elements, Play, warp_of
from tautline.encoder import between_counts
from tautline.model import STEEPEST, Model, allowed_width
from tautline.prediction import predict
from tautline.recording import Motor
from tautline.rig import Actuator, Coarse, Rig

GRID = np.linspace(-5.0, 5.0, 401)
BUMP = 0.5 + 0.3 * np.exp(-(GRID**2) / 2)


@st.composite
def tables(draw):
    """Random walks, as steep as tables may be."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 40))
    grid = np.cumsum(rng.uniform(0.01, 1.0, n)) - rng.uniform(0, 10)
    return grid, allowed_width(grid, np.cumsum(rng.normal(0, 0.5, n)) + rng.uniform(0, 2), STEEPEST), rng


@st.composite
def several(draw):
    """Elements of any number, weights and widths."""
    n = draw(st.integers(2, 12))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    weight = rng.dirichlet(np.full(n, 2.0)) * (1 - 0.02 * n) + 0.02
    width = np.cumsum(rng.uniform(0.02, 1.0, n))
    width -= width[0] * rng.integers(0, 2)
    width /= weight @ width
    return Elements(tuple(width), tuple(weight))


def path(rng, low, high, turns=12, samples=200):
    return np.interp(np.linspace(0, turns - 1, samples), np.arange(turns), rng.uniform(low, high, turns))


def reach(grid, width):
    """As far beyond the ends as the warp is exact, and more."""
    return grid[0] - 2 * width[0], grid[-1] + 2 * width[-1]


def wide(table):
    """The table without places that are narrow."""
    grid, width, rng = table
    return grid, np.maximum(width, 0.05), rng


def brute(play, q, p0):
    """The equations of elements.h, one after the other; inverses by bisection."""
    warp = warp_of(play.grid, play.width, play.narrow)
    r, w = 0.5 * np.array(play.elements.width), np.array(play.elements.weight)

    def forth(u):
        return np.interp(u, warp.q, warp.x)

    def back(x):
        return np.interp(x, warp.x, warp.q)

    def position(y):
        return 0.5 * (back(y + 0.5) + back(y - 0.5))

    low, high = forth(p0) - 1.0, forth(p0) + 1.0
    for _ in range(60):
        y = 0.5 * (low + high)
        low, high = (y, high) if position(y) < p0 else (low, y)
    x = forth(q[0])
    low, high = x - r[-1], x + r[-1]
    for _ in range(60):
        common = 0.5 * (low + high)
        z = np.clip(common, x - r, x + r)
        low, high = (common, high) if w @ z < y else (low, common)
    p = np.empty(len(q))
    for k, x in enumerate(map(forth, q)):
        z = np.clip(z, x - r, x + r)
        p[k] = position(w @ z)
    return p


@given(tables(), several(), st.booleans())
@settings(max_examples=25)
def test_forward_is_what_the_equations_say(table, elements, from_centre):
    grid, width, rng = wide(table)
    q = rng.uniform(*reach(grid, width), 25)
    start = q[0] + (0.0 if from_centre else rng.uniform(-0.5, 0.5) * width.min())
    play = Play(grid, width, elements)
    assume(width.min() > play.narrow)
    expected = brute(play, q, start)
    assert play.forward(q, np.nan if from_centre else start) == pytest.approx(expected, abs=1e-9)


@given(tables(), several())
def test_full_strokes_lie_on_the_envelopes(table, elements):
    grid, width, _ = wide(table)
    play = Play(grid, width, elements)
    assume(width.min() > play.narrow)
    for side in (1, -1):
        low, high = reach(grid, width)
        q = np.linspace(low, high, 200)[::side]
        p = play.forward(q)
        reached = np.abs(q - q[0]) > width.max() * (elements.width[-1] + 1)  # each period is at most the widest B
        np.testing.assert_allclose(p[reached] + side * 0.5 * np.interp(p[reached], grid, width), q[reached], atol=1e-9)


@given(tables(), several())
@settings(max_examples=60)
def test_the_inverse_leads_the_tip_along_any_path(table, elements):
    grid, width, rng = wide(table)
    play = Play(grid, width, elements)
    assume(width.min() > play.narrow)
    p = path(rng, *reach(grid, width))
    p[50:60] = p[50]  # at rest
    q0 = p[0] + rng.uniform(-0.49, 0.49) * width.min()
    q = play.inverse(p, q0)
    assert play.forward(np.concatenate([[q0], q]), p[0])[1:] == pytest.approx(p, abs=1e-9)
    assert np.ptp(q[50:60]) == 0.0


@given(tables(), several())
@settings(max_examples=30)
def test_the_inverse_goes_on_from_any_past(table, elements):
    """From states that no single start gives: the inner loops of a motion before."""
    grid, width, rng = wide(table)
    play = Play(grid, width, elements)
    assume(width.min() > play.narrow)
    first, second = path(rng, grid[0], grid[-1], 6, 80), path(rng, grid[0], grid[-1], 6, 80)
    whole = play.inverse(np.concatenate([first, second]))
    assert play.forward(whole, first[0]) == pytest.approx(np.concatenate([first, second]), abs=1e-9)


@given(several(), st.floats(0.05, 2.0), st.integers(0, 2**32 - 1))
def test_with_a_constant_width_it_is_prandtl_and_ishlinskiis_operator(elements, width, seed):
    q = path(np.random.default_rng(seed), -4, 4)
    play = Play(GRID, np.full(401, width), elements)
    assume(width > play.narrow)
    state, expected = np.full(len(elements.width), q[0]), np.empty(len(q))
    for k, position in enumerate(q):
        for i, share in enumerate(elements.width):
            half = 0.5 * share * width
            state[i] = max(position - half, min(position + half, state[i]))
        expected[k] = sum(weight * own for weight, own in zip(elements.weight, state, strict=True))
    assert play.forward(q) == pytest.approx(expected, abs=1e-9)


@given(tables(), st.booleans())
def test_one_element_in_the_warp_is_the_single_play(table, from_centre):
    grid, width, rng = wide(table)
    q = rng.uniform(*reach(grid, width), 60)
    p0 = np.nan if from_centre else q[0] + rng.uniform(-0.5, 0.5) * width.min()
    play = Play(grid, width)
    assume(width.min() > play.narrow)
    warp = warp_of(grid, width, play.narrow)
    one = _native.Plays(grid, width, warp.q, warp.x, np.array([0.5]), np.array([1.0]), 0.0)
    expected, held = _native.Plays(grid, width).forward(q, p0)
    p, side = one.forward(q, p0)
    assert p == pytest.approx(expected, abs=1e-9)
    assert np.array_equal(side, held)
    assert np.array_equal(play.forward(q, p0), expected)


@given(tables())
def test_the_warp_makes_every_width_one(table):
    grid, width, _ = table
    narrow = 0.02 * max(width.max(), 0.1)
    warp = warp_of(grid, width, narrow)
    assert (np.diff(warp.q) > 0).all() and (np.diff(warp.x) > 0).all()
    p = np.linspace(*reach(grid, np.maximum(width, narrow)), 999)
    half = 0.5 * np.maximum(np.interp(p, grid, width), narrow)
    above, below = (np.interp(p + side * half, warp.q, warp.x) for side in (1, -1))
    np.testing.assert_allclose(above - below, 1.0, atol=1e-9)
    assert np.interp(0.5 * (grid[0] + grid[-1]), warp.q, warp.x) == pytest.approx(0.0, abs=1e-12)


def least_bent(backlash, low, high, spans=240):
    """G by least squares among splines of 5th degree: Abel's equation first, then the integral of G'''^2."""
    first, last = low - backlash(low) / 2, high + backlash(high) / 2
    knots = first + (last - first) / spans * np.arange(-5, spans + 6)
    p = np.linspace(low, high, 3 * spans)
    inside = np.clip([p - backlash(p) / 2, p + backlash(p) / 2, 0 * p + (low + high) / 2], first, last - 1e-9)
    below, above, middle = (BSpline.design_matrix(u, knots, 5).toarray() for u in inside)
    u = np.linspace(first, last, 4 * spans, endpoint=False)
    bent = BSpline(knots, np.eye(spans + 5), 5).derivative(3)(u) * np.sqrt(u[1] - u[0])
    sure = 1e5
    left = np.vstack([sure * (above - below), sure * middle[:1], bent])
    right = np.concatenate([np.full(len(p), sure), np.zeros(1 + len(u))])
    return BSpline(knots, np.linalg.lstsq(left, right, rcond=1e-14)[0], 5)


@pytest.mark.parametrize(
    "backlash",
    [
        lambda p: 0.5 + 0.3 * np.exp(-np.square(p) / 2),
        lambda p: 0.4 + 0.15 * np.sin(1.3 * np.asarray(p)),
        lambda p: 0.8 + 0.02 * np.asarray(p),
    ],
)
def test_the_warp_is_the_least_bent_one(backlash):
    warp = warp_of(GRID, backlash(GRID), 0.01)
    q = np.linspace(-4.5, 4.5, 999)
    difference = np.interp(q, warp.q, warp.x) - least_bent(backlash, -5.0, 5.0)(q)
    assert np.abs(difference).max() < 1e-3  # of a period


@given(tables(), several())
def test_both_sides_together_make_the_start_forgotten(table, elements):
    grid, width, rng = wide(table)
    play = Play(grid, width, elements)
    assume(width.min() > play.narrow)
    q = rng.uniform(grid[0], grid[-1]) + np.cumsum(rng.normal(0, 0.2 * width.mean(), 200))
    shift = 0.45 * width.min()
    (one, side), (other, _) = (play.native.forward(q, q[0] + s * shift) for s in (1, -1))
    both = np.maximum.accumulate(side > 0) & np.maximum.accumulate(side < 0)
    np.testing.assert_allclose(one[both], other[both], atol=1e-9)
    far = width.max() * (elements.width[-1] + 2)
    there_and_back = np.concatenate(
        [q, np.linspace(0, 1, 50) * far + q[-1], q[-1] + far - np.linspace(0, 1, 50) * 2 * far]
    )
    assert set(play.native.forward(there_and_back, np.nan)[1][-60:]) == {1, -1}


def test_where_nothing_is_lost_it_is_the_single_play():
    width = np.clip(0.2 * GRID, 0.0, None)
    elements = Elements((0.5, 1.5), (0.5, 0.5))
    play = Play(GRID, width, elements, 0.001)
    rng = np.random.default_rng(3)
    q = path(rng, -4.9, 4.9, 60, 20000)
    p = play.forward(q)
    single = _native.Plays(GRID, width).forward(q, np.nan)[0]
    clearly = q < -0.1
    assert np.array_equal(p[clearly], single[clearly])
    assert np.abs(np.diff(p)).max() < np.abs(np.diff(q)).max() + play.narrow
    goal = path(rng, -4.5, 4.5, 60, 20000)
    reached = play.forward(play.inverse(goal), goal[0])
    error = np.abs(reached - goal)
    assert error.max() <= play.narrow
    assert error[goal < -0.1].max() < 1e-9
    none = Play(GRID, 0.0 * GRID, elements, 0.001)
    assert none.forward(q) == pytest.approx(q, abs=1e-12)


@given(tables(), several())
@settings(max_examples=15)
def test_narrow_places_stay_within_the_envelopes(table, elements):
    grid, width, rng = table
    play = Play(grid, width, elements, 0.01)
    q = rng.uniform(*reach(grid, width), 40)
    p = play.forward(q)
    low, high = (np.array([solve(x, side, grid, width) for x in q]) for side in (1, -1))
    assert (p >= low - play.narrow).all() and (p <= high + play.narrow).all()


@pytest.mark.parametrize(
    ("width", "weight", "says"),
    [
        ((), (), "1 to 12"),
        (tuple(0.1 * i for i in range(13)), (1 / 13,) * 13, "1 to 12"),
        ((0.5, 1.5), (1.0,), "as many"),
        ((1.5, 0.5), (0.5, 0.5), "rise"),
        ((-0.5, 2.5), (0.5, 0.5), "from 0"),
        ((0.5, 0.5), (0.5, 0.5), "rise"),
        ((0.0, 1.0), (0.0, 1.0), "positive"),
        ((0.5, 1.5), (0.6, 0.6), "sum"),
        ((0.5, 1.6), (0.5, 0.5), "another B"),
        ((float("nan"), 1.0), (0.5, 0.5), "rise"),
    ],
)
def test_elements_that_are_none_are_refused(width, weight, says):
    with pytest.raises(ValueError, match=says):
        Elements(width, weight)


def model(elements):
    rig = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0))
    c_deg = 12.0 * GRID + 3 * np.sin(GRID)
    return Model(rig, GRID, BUMP, 0.01 + 0 * GRID, c_deg, 0.08, (-4.0, 4.0), elements=elements)


GRADUAL = Elements((0.4, 0.8, 1.2, 1.6), (0.25, 0.25, 0.25, 0.25))


@given(several(), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
@settings(max_examples=20)
def test_one_model_gives_one_prediction(elements, seed, started, narrow):
    own = model(elements)
    if narrow:
        own = replace(own, width=np.clip(0.2 * GRID, 0.0, None))
    rng = np.random.default_rng(seed)
    motor = Motor(
        np.arange(0.0, 60.0, 0.1), np.interp(np.arange(0.0, 60.0, 0.1), np.arange(61), rng.uniform(-5, 5, 61))
    )
    at = np.sort(rng.uniform(-1, 61, 200))
    start = float(12.0 * motor.q[0] + rng.uniform(-1, 1)) if started else None
    expected = own.simulate(motor, at, start)
    path_ = effects.follow(own, between_counts(motor, 0.001), at, {}, start)
    np.testing.assert_allclose(path_.c_deg, expected, atol=1e-9)
    np.testing.assert_allclose(predict(own, motor, at, start).c_deg, expected, atol=1e-9)


def test_a_gradual_onset_is_the_mean_of_plays_of_scaled_width():
    """As the effect with spread thresholds has it: where B is constant, the two are the same."""
    flat = replace(model(GRADUAL), width=np.full(401, 0.6))
    motor = Motor(np.arange(40.0), np.random.default_rng(1).uniform(-4, 4, 40))
    at = np.linspace(0, 39, 2000)
    scaled = [
        effects.follow(replace(flat, elements=SINGLE, width=np.full(401, 0.6 * share)), motor, at, {}).p
        for share in GRADUAL.width
    ]
    np.testing.assert_allclose(effects.follow(flat, motor, at, {}).p, np.mean(scaled, axis=0), atol=1e-9)


@pytest.mark.parametrize(
    "parameters",
    [
        {"width_per_load": 0.1},
        {"mean_stick_lag": 0.05},
        {"onset_spread": 0.5},
        {"asymmetry": 0.05, "asymmetry_travel": 0.3},
        {"width_per_speed": 0.02},
        {"lag": 0.05},
        {"offset_drift": 0.01, "width_drift": 0.01},
    ],
)
def test_effects_act_on_elements_as_on_a_single_play(parameters):
    """With one element in the warp every effect does what it does to the single play, but for second orders of B'."""
    own = model(SINGLE)
    motor = Motor(np.arange(0, 40, 0.02), 4 * np.sin(np.arange(0, 40, 0.02)), None, None, None, np.full(2000, 2.0))
    at = np.linspace(0, 39, 900)
    expected = effects.follow(own, motor, at, parameters).tip
    warp = warp_of(GRID, BUMP, 0.008)
    one = _native.Plays(GRID, BUMP, warp.q, warp.x, np.array([0.5]), np.array([1.0]), 0.0)
    found = _native.simulate_effects(parameters, one, own.c_deg, motor.t_s, motor.q, at, load=motor.load_mNm)[4]
    plain = effects.follow(own, motor, at, {}).tip
    assert np.abs(expected - plain).max() > 5e-3  # it does something
    assert np.abs(found - expected).max() < 0.1 * np.abs(expected - plain).max()


def test_elements_are_saved_and_a_model_without_them_has_one(tmp_path):
    import json

    model(GRADUAL).save(tmp_path)
    assert Model.load(tmp_path).elements == GRADUAL
    document = json.loads((tmp_path / "model.json").read_text())
    del document["elements"]
    (tmp_path / "model.json").write_text(json.dumps(document))
    assert Model.load(tmp_path).elements == SINGLE
