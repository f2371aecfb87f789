"""Bouc-Wen's and Dahl's friction: the equations of friction.h, what a calibration makes of them, and a board."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import tautline as tl
from tautline import _native, tables
from tautline.elements import MOST, Elements, Play
from tautline.friction import BOUC_WEN, DAHL, VALUES, Friction
from tautline.model import Model
from tautline.nearest import nearest_plays
from tautline.recording import Angle, Motor
from tautline.rig import Actuator, AngleSensor, Coarse, Rig
from tautline.undone import stands_in
from tools.undone import hysteresis

GRID = np.linspace(-5.0, 5.0, 401)
BUMP = 0.5 + 0.3 * np.exp(-(GRID**2) / 2)
RIG = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(12.0, 0.0), angle=AngleSensor(0.0))


@st.composite
def frictions(draw):
    """Of either kind; none drives the tip against its motor on widths up to 0.8."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    kind = draw(st.sampled_from([BOUC_WEN, DAHL]))
    exponent = float(np.exp(rng.uniform(-0.3, 1.8 if kind == BOUC_WEN else 0.7)))
    beta = float(rng.uniform(0.3, 0.9)) if kind == BOUC_WEN else 1.0
    least = 0.5 * Friction(kind, 1.0, 0.0, exponent, beta).steepest
    share = float(rng.uniform(0.0, 1.5)) * least
    return Friction(kind, max(0.8 * (least - share), 0.0) + float(rng.uniform(0.02, 0.3)), share, exponent, beta)


def way(seed, turns=12, samples=400):
    rng = np.random.default_rng(seed)
    return np.interp(np.linspace(0, turns - 1, samples), np.arange(turns), rng.uniform(-4.0, 4.0, turns))


def rate(friction, u):
    if friction.kind == DAHL:
        return max(1.0 - u, 0.0) ** friction.exponent
    return 1.0 - (friction.beta * np.sign(u) + 1.0 - friction.beta) * abs(u) ** friction.exponent


def brute(friction, q):
    """The equations in tiny steps, from the centre."""
    fine = np.interp(np.arange((len(q) - 1) * 100 + 1) / 100.0, np.arange(len(q)), q)
    low, high = np.interp(fine, GRID + 0.5 * BUMP, GRID), np.interp(fine, GRID - 0.5 * BUMP, GRID)
    length = friction.length + friction.share * np.interp(fine, GRID, BUMP)
    z, path = (low[0] + high[0] - 2 * q[0]) / (high[0] - low[0]), np.empty_like(fine)
    for k, dq in enumerate(np.diff(fine, prepend=fine[0]).tolist()):
        if dq:
            s = np.sign(dq)
            half = z + 0.5 * dq * rate(friction, s * z) / length[k]
            z = min(max(z + dq * rate(friction, s * half) / length[k], -1.0), 1.0)
        path[k] = 0.5 * ((1.0 + z) * low[k] + (1.0 - z) * high[k])
    return path[::100]


@given(frictions(), st.integers(0, 2**32 - 1))
@settings(max_examples=5)
def test_forward_is_what_the_equations_say(friction, seed):
    q = way(seed, samples=150)
    assert Play(GRID, BUMP, friction).forward(q) == pytest.approx(brute(friction, q), abs=2e-4)


@given(frictions(), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_the_tip_stays_between_the_envelopes_goes_with_its_motor_and_ends_on_them(friction, seed):
    q, play = way(seed), Play(GRID, BUMP, friction)
    p = play.forward(q)
    low, high = np.interp(q, GRID + 0.5 * BUMP, GRID), np.interp(q, GRID - 0.5 * BUMP, GRID)
    assert (p > low - 1e-9).all() and (p < high + 1e-9).all()
    assert (np.diff(p) * np.sign(np.diff(q)) > -1e-9).all()
    if friction.exponent < 1.2:  # of Dahl's with more the last of it takes any length of way
        far = play.forward(np.array([-5.0, 5.0]))
        assert far[1] + 0.5 * np.interp(far[1], GRID, BUMP) == pytest.approx(5.0, abs=5e-3)


@given(frictions(), st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_only_turns_matter_not_how_often_the_motor_was_read(friction, seed):
    q, play = way(seed), Play(GRID, BUMP, friction)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(q)), prepend=0, append=0))
    some = np.union1d(np.union1d(turns, [0, len(q) - 1]), np.arange(0, len(q), 37))
    np.testing.assert_allclose(
        play.forward(q[some], q[0]), play.forward(q, q[0])[some], atol=1e-8 if friction.exponent >= 1.0 else 1e-5
    )


@given(frictions(), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_its_derivatives_are_its_differences(friction, seed):
    q = way(seed)
    by = Play(GRID, BUMP, friction).native.slopes(q, q[0]).reshape(-1, len(VALUES))
    for i, name in enumerate(VALUES if friction.kind == BOUC_WEN else VALUES[:3]):
        ends = [
            Play(GRID, BUMP, replace(friction, **{name: getattr(friction, name) + side * 1e-5})).forward(q, q[0])
            for side in (1, -1)
        ]
        # where z passes 0 the slope has a corner, and by exponents below 1 none
        off = np.abs((ends[0] - ends[1]) / 2e-5 - by[:, i])
        assert np.quantile(off, 0.95) < 2e-3 * (1.0 + np.abs(by[:, i]).max()), name


@given(frictions(), st.integers(0, 2**32 - 1), st.floats(0.5, 1.5))
@settings(max_examples=15)
def test_lean_is_the_derivative_by_a_width_that_is_the_same_everywhere(friction, seed, width):
    q = way(seed)
    assume(friction.exponent >= 1.0)
    level = np.full(len(GRID), 0.5 * width)
    lean = Play(GRID, level, friction).native.trace(q, q[0] - 9.0)[2]
    ends = [Play(GRID, level + side * 1e-5, friction).forward(q, q[0] - 9.0) for side in (1, -1)]
    assert np.quantile(np.abs((ends[0] - ends[1]) / 2e-5 + 0.5 * lean), 0.95) < 2e-3


@given(frictions(), st.integers(0, 2**32 - 1))
@settings(max_examples=15)
def test_the_inverse_leads_the_tip_along_any_path(friction, seed):
    p, play = 0.8 * way(seed, samples=120), Play(GRID, BUMP, friction)
    q = play.inverse(p)
    np.testing.assert_allclose(play.forward(q, p[0])[2:], p[2:], atol=1e-7)
    assert (np.diff(q) * np.diff(p) >= 0.0).all()


def test_bouc_wens_of_a_high_exponent_is_the_play():
    q = way(3)
    sharp = Friction(BOUC_WEN, 0.0, 0.5, 400.0, 0.5)
    assert Play(GRID, np.full(401, 0.5), sharp).forward(q) == pytest.approx(
        Play(GRID, np.full(401, 0.5)).forward(q), abs=2e-3
    )


def model(friction=None):
    return Model(
        RIG, GRID, BUMP, 0.01 + 0 * GRID, 12.0 * GRID + 3 * np.sin(GRID), 0.0, (-4.0, 4.0), sensor="angle",
        friction=friction, elements=Elements((0.4, 0.8, 1.2, 1.6), (0.25,) * 4),
    )  # fmt: skip


def test_a_model_keeps_it_and_an_older_one_has_none(tmp_path):
    for friction in (Friction(BOUC_WEN, 0.1, 0.6, 1.5, 0.6), Friction(DAHL, 0.6, 0.0, 1.0), None):
        own = model(friction)
        own.save(tmp_path)
        assert Model.load(tmp_path) == own
    document = (tmp_path / "model.json").read_text()
    (tmp_path / "model.json").write_text(document.replace('"friction": null, ', ""))
    assert Model.load(tmp_path) == model()
    (tmp_path / "model.json").write_text(document.replace('"friction": null', '"friction": {"kind": "coulomb"}'))
    with pytest.raises(tl.TautError, match="damaged"):
        Model.load(tmp_path)


def test_a_board_has_the_nearest_plays_and_their_error_is_what_they_leave():
    own = model(Friction(DAHL, 0.0, 1.05, 1.0))
    near = stands_in(own)
    assert near is not None and len(near.elements.width) <= 7
    np.testing.assert_allclose(tables.decode(tables.encode(own)).elements.width, near.elements.width, atol=2e-4)
    q = np.interp(np.arange(20000) / 100.0, np.arange(201), np.random.default_rng(9).uniform(-5.0, 5.0, 201))
    p = own.play.forward(q)

    def left(elements):
        off = Play(GRID, BUMP, elements).forward(q) - p
        return float(np.sqrt(np.mean(off[1000:] ** 2) / np.mean((q - p) ** 2)))

    assert 0.5 < left(near.elements) / near.share < 2.0
    assert 3.0 * left(near.elements) < left(own.elements)  # of no more than twice B
    assert near.share < 0.1
    assert stands_in(model()) is None


def test_of_plays_the_nearest_are_themselves():
    elements = Elements((0.3, 0.7, 1.2, 1.8), (0.25,) * 4)
    near = nearest_plays(GRID, BUMP, elements, (-5.0, 5.0))
    assert near.share < 0.004


def test_a_tracker_takes_as_many_plays_as_a_model_may_have():
    share, weight = np.linspace(0.1, 1.9, MOST), np.full(MOST, 1.0 / MOST)
    none = np.empty((0, len(GRID))), np.empty((0, MOST))
    _native.TrackModel(GRID, BUMP, share, weight, *none)
    with pytest.raises(ValueError, match=f"1 to {MOST}"):
        _native.TrackModel(GRID, BUMP, np.append(share, 2.0), np.append(weight, 0.1), none[0], np.empty((0, MOST + 1)))


def test_a_calibration_finds_dahls_predicts_with_it_and_knows_how_well():
    plant = hysteresis.PLANTS["dahl"]
    whole = hysteresis.recorded(plant, RIG)
    motor, angle = whole.motor, whole.angle
    assert angle is not None
    some = replace(whole, motor=Motor(motor.t_s[::4], motor.q[::4]), angle=Angle(angle.t_s[::5], angle.c_deg[::5]))
    calibration = tl.calibrate(some)
    own = calibration.model
    assert own.friction is not None and own.quality.usable
    assert any("a board's tables" in note for note in calibration.notes)
    q = way(8, turns=20, samples=8000)
    told = own.remaining(own.play.forward(q))
    plays = replace(own, friction=None)
    off, without = (
        np.sqrt(np.mean((c - plant(q))[2000:] ** 2)) for c in (told, plays.remaining(plays.play.forward(q)))
    )
    assert off < 0.02 and 3.0 * off < without  # deg; the sensor's noise is 0.02
    # B as a slow full stroke shows it, within what is said of it: hundreds of micrometres for several plays.
    inside = (own.q > -3.5) & (own.q < 3.5)
    stroke = np.linspace(-7.0, 7.0, 60001)
    c = plant(np.concatenate([stroke[::-1], stroke, stroke[::-1]]))
    up, down = c[60001:120002], c[120002:][::-1]
    at = own.c_deg[inside]
    width = np.interp(at, up, stroke) - np.interp(at, down, stroke)
    error, sigma = width - own.width[inside], own.width_sigma[inside]
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.5
    assert np.sqrt(np.mean(sigma**2)) < 0.01


def test_a_board_has_plays_for_a_model_without_backlash_and_for_whole_numbers():
    own = model()
    free = replace(own, friction=Friction("dahl", 0.1, 0.1, 1.0), width=np.zeros_like(own.width))
    assert stands_in(free).share == 0.0 and tables.decode(tables.encode(free)).elements.single
    q = np.arange(-5, 6)
    whole = replace(free, q=q, width=np.full(11, 0.3), width_sigma=np.full(11, 0.01), c_deg=12.0 * q)
    assert stands_in(whole).elements == stands_in(replace(whole, q=q.astype(float))).elements


def test_a_law_without_its_share_is_damaged():
    document = Friction("bouc-wen", 0.1, 0.5, 2.0, 0.5).to_json()
    assert Friction.from_json(document).beta == 0.5
    del document["share"]
    with pytest.raises(KeyError, match="share"):
        Friction.from_json(document)
