"""The effect library: absent means the nominal model, and each parameter does what its name says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tautline import _native, effects, geometry
from tautline.effects import LIBRARY, simulate
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig

RIG = reference_rig()
GRID = np.linspace(-5.0, 5.0, 201)


def made(width=None) -> Model:
    instrument = preset("reference", RIG)
    width = instrument.backlash(GRID) if width is None else np.full(len(GRID), float(width))
    return Model(RIG, GRID, width, np.full(len(GRID), 0.003), instrument.bend(GRID), 0.08, (-4.0, 4.0))


MODEL = made()


def moved(*corners: tuple[float, float], **others) -> Motor:
    """Straight lines through (t, q) corners, 500 Hz."""
    t = np.arange(0.0, corners[-1][0], 0.002)
    return Motor(t, np.interp(t, *np.array(corners).T), None, **others)


STROKES = moved((0, 0), (6, 4), (12, -4), (18, 4), (20, 4), (26, -4), (28, -4))


@given(st.integers(0, 2**32 - 1))
def test_absent_effects_leave_the_play_as_it_is(seed):
    """The two simulations in C are different programs: they agree for any table, motion and start."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 30))
    grid = np.cumsum(rng.uniform(0.05, 1.0, n))
    width = np.concatenate([[rng.uniform(0, 2)], rng.uniform(-1.9, 1.9, n - 1) * np.diff(grid)]).cumsum()
    width = np.maximum(width, 0.0)
    c = np.cumsum(rng.uniform(0.1, 3.0, n))
    q = rng.uniform(grid[0] - 2, grid[-1] + 2, 60)
    p0 = np.nan if rng.random() < 0.5 else float(rng.uniform(grid[0], grid[-1]))
    c_deg, p, side = _native.simulate_effects({}, grid, width, c, np.arange(60.0), q, p0=p0)
    expected, held, _ = _native.play_trace(q, grid, width, p0)
    np.testing.assert_allclose(p, expected, atol=1e-10)
    assert np.array_equal(side, held)
    inside = (p >= grid[0]) & (p <= grid[-1])
    np.testing.assert_allclose(c_deg[inside], np.interp(p[inside], grid, c), atol=1e-9)


@pytest.mark.parametrize("kind", LIBRARY, ids=lambda kind: kind.id)
def test_zero_amplitude_is_the_nominal_model(kind):
    motor = replace(
        STROKES,
        translation_mm=np.sin(STROKES.t_s),
        rotation_deg=30 * np.cos(STROKES.t_s),
        load_mNm=20 + 5 * np.sin(STROKES.t_s / 3),
    )
    scene = np.arange(0.1, 27.0, 0.037)
    zero = {p.name: 0.0 for p in kind.amplitudes}
    shapes = {p.name: p.shape[0] if p.shape else 3.0 for p in kind.shapes}
    path = simulate(MODEL, motor, scene, {**zero, **shapes}, load_reference=20.0)
    c = MODEL.simulate(motor, scene)
    np.testing.assert_allclose(path.c_deg, c, atol=1e-9)
    others = [np.interp(scene, motor.t_s, values) for values in (motor.translation_mm, motor.rotation_deg)]
    np.testing.assert_allclose(path.image_px, geometry.project(RIG, c, *others), atol=1e-7)


def width_seen(parameters, motor=STROKES, model=None, at=1.0, **options) -> float:
    """Distance along q between the falling and the rising pass at p = `at`."""
    t = np.arange(6.0, 26.0, 0.002)
    path = simulate(model or MODEL, motor, t, parameters, **options)
    q = np.interp(t, motor.t_s, motor.q)
    falling, rising = (t < 12), (t > 12) & (t < 18)
    return float(np.interp(at, path.p[rising], q[rising]) - np.interp(-at, -path.p[falling], q[falling]))


def test_widths():
    model = made(1.0)
    assert width_seen({}, model=model) == pytest.approx(1.0, abs=1e-3)
    assert width_seen({"width_per_speed": 0.3}, model=model) == pytest.approx(1.0 + 0.3 * 8 / 6, abs=2e-2)
    loaded = replace(STROKES, load_mNm=np.full(len(STROKES.t_s), 30.0))
    assert width_seen({"width_per_load": 0.02}, loaded, model, load_reference=20.0) == pytest.approx(1.2, abs=1e-3)
    drifted = width_seen({"width_drift": 0.01}, model=model)
    late = width_seen({"width_drift": 0.01}, model=model, clock_offset_s=10.0)
    assert late - drifted == pytest.approx(0.1, abs=1e-2)
    assert 1.1 < drifted < 1.2


@pytest.mark.parametrize("held", [0.0, 1.0])
def test_the_width_that_speed_added_closes_or_stays_at_rest(held):
    t = np.array([17.99, 19.9])
    moving, resting = simulate(made(1.0), STROKES, t, {"width_per_speed": 0.3, "width_held": held}).p
    assert resting - moving == pytest.approx(0.01 * 8 / 6 if held else 0.15 * 8 / 6 + 0.01 * 8 / 6, abs=5e-3)


def test_a_smooth_onset_starts_early_and_ends_late():
    model = made(1.0)
    t = np.arange(12.0, 18.0, 0.01)
    sharp, smooth = (simulate(model, STROKES, t, {"onset_spread": s}).p for s in (0.0, 0.5))
    q = np.interp(t, STROKES.t_s, STROKES.q)
    travel = q + 4
    assert np.all(smooth[(travel > 0.6) & (travel < 0.95)] > sharp[(travel > 0.6) & (travel < 0.95)] + 1e-3)
    assert np.allclose(smooth[(travel > 1.6) & (q < 4)], sharp[(travel > 1.6) & (q < 4)], atol=1e-9)


def test_asymmetry_delays_one_direction_and_is_caught_up():
    model = made(1.0)
    t = np.arange(6.0, 18.0, 0.01)
    q = np.interp(t, STROKES.t_s, STROKES.q)
    plain = simulate(model, STROKES, t, {}).p
    late = simulate(model, STROKES, t, {"asymmetry": 0.3, "asymmetry_travel": 0.4}).p
    falling = t < 12
    assert np.allclose(late[falling], plain[falling], atol=1e-3)  # only after turning up
    just_after = (~falling) & (q > -2.9) & (q < -2.6)
    assert np.all(plain[just_after] - late[just_after] > 0.05)
    assert np.allclose(late[(~falling) & (q > 2)], plain[(~falling) & (q > 2)], atol=1e-3)
    other = simulate(model, STROKES, t, {"asymmetry": -0.3, "asymmetry_travel": 0.4}).p
    assert np.all(other[falling & (q < 2.9) & (q > 2.6)] > plain[falling & (q < 2.9) & (q > 2.6)] + 0.05)


def test_lag_follows_a_ramp_behind_by_its_time_constant():
    t = np.arange(2.0, 5.5, 0.05)
    plain = simulate(MODEL, STROKES, t - 0.2, {})
    lagging = simulate(MODEL, STROKES, t, {"lag": 0.2})
    np.testing.assert_allclose(lagging.c_deg, plain.c_deg, atol=0.15)


def test_creep_goes_on_while_the_motor_rests():
    rest = moved((0, 0), (2, 3), (12, 3))
    t = np.array([2.0, 11.9])
    path = simulate(MODEL, rest, t, {"creep_share": 0.2, "creep_time": 1.0})
    plain = simulate(MODEL, rest, t, {})
    assert path.c_deg[0] < plain.c_deg[0] - 0.5
    assert path.c_deg[1] == pytest.approx(plain.c_deg[1], abs=1e-2)


def test_stick_slip_moves_in_jumps_of_its_size():
    t = np.arange(13.5, 17.5, 0.002)
    path = simulate(MODEL, STROKES, t, {"stick": 0.2})
    steps = np.diff(MODEL.remaining_inverse(path.c_deg))
    jumps = steps[np.abs(steps) > 1e-6]
    assert np.all(np.abs(jumps - 0.2) < 0.02) and len(jumps) > 10


def test_encoder_error_is_periodic_in_q():
    t = np.arange(8.0, 12.0, 0.004)
    q = np.interp(t, STROKES.t_s, STROKES.q)
    error = (
        simulate(MODEL, STROKES, t, {"encoder_sin": 0.05, "encoder_period": 0.5}).p - simulate(MODEL, STROKES, t, {}).p
    )
    swing = error[q < 2] - np.mean(error[q < 2])
    seen = np.corrcoef(swing, np.sin(2 * np.pi * q[q < 2] / 0.5))[0, 1]
    assert seen > 0.95 and np.ptp(error) > 0.08


def test_configuration_effects_act_on_the_angle():
    motor = replace(STROKES, translation_mm=np.sin(STROKES.t_s), rotation_deg=20 * np.cos(STROKES.t_s))
    t = np.arange(1.0, 27.0, 0.1)
    plain = simulate(MODEL, motor, t, {}).c_deg
    coupled = simulate(MODEL, motor, t, {"c_per_translation": 0.5, "c_per_rotation": 0.1}).c_deg
    expected = 0.5 * np.interp(t, motor.t_s, motor.translation_mm) + 0.1 * np.interp(t, motor.t_s, motor.rotation_deg)
    np.testing.assert_allclose(coupled - plain, expected, atol=1e-9)
    held = simulate(MODEL, motor, t, {"contact_hold": 0.75, "contact_c": 10.0, "contact_side": 1.0}).c_deg
    np.testing.assert_allclose(held, np.minimum(plain, 10 + 0.25 * (plain - 10)), atol=1e-9)


def test_registration_and_camera():
    t = np.arange(7.0, 17.0, 0.05)
    plain = simulate(MODEL, STROKES, t, {}).image_px
    tilted = simulate(MODEL, STROKES, t, {"tilt_x": 0.5}).image_px - plain
    falling = (t > 7.5) & (t < 12)
    assert np.sign(tilted[falling, 1].mean()) == -np.sign(tilted[t > 14.5, 1].mean()) != 0
    moves = {"shift_x": 0.3, "shift_ry": 0.5, "shift_time": 30.0}
    shifted = simulate(MODEL, STROKES, t, moves, clock_offset_s=20.0).image_px
    static = simulate(MODEL, STROKES, t, {"static_x": 0.3, "static_ry": 0.5}).image_px
    np.testing.assert_allclose(shifted[t < 9.99], plain[t < 9.99], atol=1e-9)
    np.testing.assert_allclose(shifted[t > 10.01], static[t > 10.01], atol=1e-9)
    late = simulate(MODEL, STROKES, t, {"delay": 0.1}).image_px
    np.testing.assert_allclose(late, simulate(MODEL, STROKES, t - 0.1, {}).image_px, atol=1e-9)
    assert effects.distorted(RIG.camera, {"k1": 0.1}).distortion[0] == RIG.camera.distortion[0] + 0.1
    assert np.abs(simulate(MODEL, STROKES, t, {"k1": 0.1}).image_px - plain).max() > 0.5


@given(st.floats(-60, 60), st.floats(-0.9, 0.9))
def test_curvature_against_a_fine_chain(c, gradient):
    """Ten thousand straight pieces instead of quadrature."""
    kinematics = RIG.kinematics
    n = 10_000
    s = (np.arange(n) + 0.5) / n
    angle = np.radians(c) * (s + gradient * (s * s - s))
    x = kinematics.bending_length_mm * np.mean(np.sin(angle)) + kinematics.tip_length_mm * np.sin(np.radians(c))
    z = kinematics.bending_length_mm * np.mean(np.cos(angle)) + kinematics.tip_length_mm * np.cos(np.radians(c))
    np.testing.assert_allclose(effects.tip_bend(kinematics, np.array([c]), gradient)[0], [x, 0, z], atol=1e-6)


def test_a_parameter_that_no_effect_has_is_refused():
    with pytest.raises(ValueError, match="no effect has a parameter 'nonsense'"):
        _native.simulate_effects({"nonsense": 1.0}, GRID, MODEL.width, MODEL.c_deg, np.arange(3.0), np.zeros(3))
