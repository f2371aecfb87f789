"""The effect library: absent means the nominal model, and each parameter does what its name says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tautline import _native, effects, geometry
from tautline.effects import BY_ID, LIBRARY, simulate
from tautline.effects.library.distortion import distorted
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulated.instrument import preset, reference_rig
from tautline.splines import Basis

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
    """The chain drives the same play as the forward simulation, for any table, motion and start."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 30))
    grid = np.cumsum(rng.uniform(0.05, 1.0, n))
    width = np.concatenate([[rng.uniform(0, 2)], rng.uniform(-1.9, 1.9, n - 1) * np.diff(grid)]).cumsum()
    width = np.maximum(width, 0.0)
    c = np.cumsum(rng.uniform(0.1, 3.0, n))
    q = rng.uniform(grid[0] - 2, grid[-1] + 2, 60)
    p0 = np.nan if rng.random() < 0.5 else float(rng.uniform(grid[0], grid[-1]))
    t = np.arange(60.0)
    plays = _native.Plays(grid, width)
    _, _, c_deg, p, tip, gain, way, lean, side = _native.simulate_effects({}, plays, c, t, q, t, p0=p0)
    expected, held = plays.forward(q, p0)
    np.testing.assert_allclose(p, expected, atol=1e-10)
    assert np.array_equal(side, held) and np.array_equal(way, held) and np.array_equal(lean, held)
    assert np.array_equal(tip, p) and np.all(gain == 1.0)
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


@pytest.mark.parametrize("spread", [0.2, 0.6, 0.95])
@pytest.mark.parametrize("tail", [0.0, 1.0])
def test_a_spread_onset_is_what_its_distribution_gives(spread, tail):
    """Travel x since the reversal, thresholds B (1 + spread u): the tip moves by the mean of max(x - threshold, 0)."""
    width = 0.6
    t = np.arange(12.0, 18.0, 0.05)
    p = simulate(made(width), STROKES, t, {"onset_spread": spread, "onset_tail": tail}).p
    x = np.interp(t, STROKES.t_s, STROKES.q) + 4.0
    if tail:
        scale = 0.5 * spread * width
        past = np.maximum(x - width + scale, 0.0)
        moved_by = past - scale * -np.expm1(-past / scale)
    else:
        low, high = width * (1.0 - spread), width * (1.0 + spread)
        moved_by = np.where(x > high, x - width, np.square(np.clip(x - low, 0.0, None)) / (2.0 * (high - low)))
    np.testing.assert_allclose(p, 0.5 * width - 4.0 + moved_by, atol=0.002 * spread * width)


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


def test_sticking_holds_back_in_the_mean_as_a_wider_play():
    t = np.arange(1.0, 18.0, 0.002)
    sticks, wider, plain = (simulate(MODEL, STROKES, t, v) for v in ({"stick": 0.2}, {"mean_stick_lag": 0.2}, {}))
    late = wider.side * np.gradient(wider.p, t) > 1e-3  # carried
    late &= (wider.side == plain.side) & (np.abs(wider.p - wider.tip) < 1e-9)
    lag = [float(np.mean((plain.tip - path.tip)[late] * plain.side[late])) for path in (sticks, wider)]
    assert lag[1] == pytest.approx(0.1, rel=0.1)  # half of it either way
    assert lag[0] == pytest.approx(lag[1], rel=0.15)


def test_encoder_error_is_periodic_in_q():
    t = np.arange(8.0, 12.0, 0.004)
    q = np.interp(t, STROKES.t_s, STROKES.q)
    error = (
        simulate(MODEL, STROKES, t, {"encoder_sin": 0.02, "encoder_period": 0.5}).p - simulate(MODEL, STROKES, t, {}).p
    )
    swing = error[q < 2] - np.mean(error[q < 2])
    seen = np.corrcoef(swing, np.sin(2 * np.pi * q[q < 2] / 0.5))[0, 1]
    assert seen > 0.95 and np.ptp(error) > 0.035


def test_configuration_effects_act_on_the_angle():
    motor = replace(STROKES, translation_mm=np.sin(STROKES.t_s), rotation_deg=20 * np.cos(STROKES.t_s))
    t = np.arange(1.0, 27.0, 0.1)
    plain = simulate(MODEL, motor, t, {}).c_deg
    coupled = simulate(MODEL, motor, t, {"c_per_translation": 0.5, "c_per_rotation": 0.1}).c_deg
    expected = 0.5 * np.interp(t, motor.t_s, motor.translation_mm) + 0.1 * np.interp(t, motor.t_s, motor.rotation_deg)
    np.testing.assert_allclose(coupled - plain, expected, atol=1e-9)
    held = simulate(MODEL, motor, t, {"contact_hold": 0.75, "contact_c": 10.0, "contact_side": 1.0}).c_deg
    np.testing.assert_allclose(held, np.minimum(plain, 10 + 0.25 * (plain - 10)), atol=1e-9)


@pytest.mark.parametrize("frame_s", (0.04, 3.0))
def test_a_slip_is_a_motor_that_is_elsewhere_from_then_on(frame_s):
    """As a motor that is moved by as much within a microsecond, at whatever times one looks and however few corners its
    path has: the tip was carried on until then. Counts that are found again are another slip, back."""
    t = np.arange(3.0, 27.0, frame_s)
    corners_s = np.array([0.0, 6.0, 12.0, 18.0, 20.0, 26.0, 28.0])
    motor = Motor(corners_s, np.array([0.0, 4.0, -4.0, 4.0, 4.0, -4.0, -4.0]))
    slips = {"slip_1": 0.4, "slip_time_1": 35.01, "slip_2": -0.7, "slip_time_2": 37.9}
    moved_s = np.array([15.01, 15.01 + 1e-6, 17.9, 17.9 + 1e-6])
    every = np.union1d(corners_s, moved_s)
    elsewhere = np.interp(every, moved_s, [0.0, 0.4, 0.4, -0.3], left=0.0, right=-0.3)
    slipped = Motor(every, np.interp(every, corners_s, motor.q) + elsewhere)
    told = simulate(MODEL, motor, t, slips, clock_offset_s=20.0)
    expected = simulate(MODEL, slipped, t, {})
    np.testing.assert_allclose(told.p, expected.p, atol=1e-5)
    plain = simulate(MODEL, motor, t, {})
    assert np.abs(told.p - plain.p).max() > 0.2
    back = simulate(MODEL, motor, t, {**slips, "slip_3": 0.3, "slip_time_3": -1e3}, clock_offset_s=20.0)
    np.testing.assert_allclose(back.p[t > 24.0], plain.p[t > 24.0], atol=1e-9)


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
    assert distorted(RIG.camera, {"k1": 0.1}).distortion[0] == RIG.camera.distortion[0] + 0.1
    assert np.abs(simulate(MODEL, STROKES, t, {"k1": 0.1}).image_px - plain).max() > 0.5


@given(st.floats(-60, 60), st.floats(-0.9, 0.9), st.floats(-0.5, 0.5))
@example(57.0, 0.8, 0.4)  # at its limit
def test_curvature_against_a_fine_chain(c, gradient, by_bend):
    """Ten thousand straight pieces instead of quadrature."""
    kinematics = RIG.kinematics
    n = 10_000
    s = (np.arange(n) + 0.5) / n
    uneven = np.clip(gradient + by_bend * abs(np.radians(c)), -0.95, 0.95)
    angle = np.radians(c) * (s + uneven * (s * s - s))
    x = kinematics.bending_length_mm * np.mean(np.sin(angle)) + kinematics.tip_length_mm * np.sin(np.radians(c))
    z = kinematics.bending_length_mm * np.mean(np.cos(angle)) + kinematics.tip_length_mm * np.cos(np.radians(c))
    expected = geometry.to_image(RIG.camera, geometry.to_camera(RIG.hand_eye, np.array([[x, 0.0, z]])))
    values = {"curvature_gradient": gradient, "curvature_by_bend": by_bend}
    seen = _native.see(values, geometry.projection_rig(RIG), np.array([c]))
    np.testing.assert_allclose(seen, expected, atol=1e-4)


def registered(base, way, shifted, values):
    """The registration's effects, by scipy's rotations."""

    def turned(points, prefix, factor, pivot=0.0):
        centre = np.array([0.0, 0.0, pivot])
        vectors = np.outer(factor, [values[f"{prefix}{axis}"] for axis in "xyz"])
        return Rotation.from_rotvec(vectors, degrees=True).apply(points - centre) + centre

    base = turned(base, "tilt_", way, values["tilt_pivot"])
    for prefix, factor in (("static", np.ones(len(way))), ("shift", shifted.astype(float))):
        base = turned(base, f"{prefix}_r", factor)
        base = base + np.outer(factor, [values[f"{prefix}_{axis}"] for axis in "xyz"])
    return base


@given(st.integers(0, 2**32 - 1))
def test_the_image_and_its_slopes(seed):
    rng = np.random.default_rng(seed)
    n = 20
    names = [name for name, *_ in _native.projection_parameters]
    values = dict(zip(names, rng.normal(0, 1, len(names)) * 0.3, strict=True))
    values |= {name: 0.1 * values[name] for name in ("k1", "k2", "p1", "p2", "k3")}
    for name in ("curvature_gradient", "curvature_by_bend"):
        values[name] = 0.0 if seed % 2 else float(np.clip(values[name], -0.9, 0.9))
    c, way = rng.uniform(-50, 50, n), rng.choice([-1.0, -0.3, 0.0, 0.6, 1.0], n)
    c[0] = 1e-3
    translation, turn, shifted = rng.normal(0, 2, n), rng.normal(0, 30, n), rng.random(n) < 0.5

    def see(c_deg, changed=values):
        return _native.see(
            changed, geometry.projection_rig(RIG), c_deg, translation, turn, way, shifted.view(np.uint8), slopes=True
        )

    image, by_c, _ = see(c)
    if seed % 2:
        bend = geometry.tip_bend(RIG.kinematics, c) + np.outer(translation, [0, 0, 1])
        base = registered(geometry.about_base_z(turn, bend), way, shifted, values)
        camera = distorted(RIG.camera, values)
        expected = geometry.to_image(camera, geometry.to_camera(RIG.hand_eye, base))
        np.testing.assert_allclose(image, expected, atol=1e-8)
    step = 1e-4
    np.testing.assert_allclose(by_c, (see(c + step)[0] - see(c - step)[0]) / (2 * step), atol=1e-4, rtol=1e-5)
    # A further static registration: its moves, and its turns where the static one has not turned yet.
    for i, name in enumerate(["static_rx", "static_ry", "static_rz", "static_x", "static_y", "static_z"]):
        free = {**values, "static_rx": 0.0, "static_ry": 0.0, "static_rz": 0.0} if i < 3 else values
        high, low = (see(c, {**free, name: free[name] + s})[0] for s in (step, -step))
        expected = (high - low) / (2 * step)
        np.testing.assert_allclose(see(c, free)[2][:, :, i], expected, atol=1e-4, rtol=1e-5)


@given(st.integers(0, 2**32 - 1))
def test_a_thinned_motion_stays_within_tolerance(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.001, 0.02, 400))
    walk = np.cumsum(np.where(rng.random(400) < 0.3, 0.0, rng.normal(0, 0.01, 400)))
    walk[100:160] = walk[100]
    other = np.sin(t * rng.uniform(0.1, 5))
    other[100:160] = other[100]
    tolerance = rng.uniform(1e-3, 0.1, 2)
    keep = _native.thin(t, np.concatenate([walk, other]), tolerance, 0.1).astype(bool)
    for values, most in zip((walk, other), tolerance, strict=True):
        assert np.abs(np.interp(t, t[keep], values[keep]) - values).max() <= most * (1 + 1e-9)
    assert keep[[0, 100, 159, 399]].all()


def dense(basis, x):
    return basis.design(x).toarray()


@given(st.integers(0, 2**32 - 1))
def test_normal_equations_are_those_of_the_dense_jacobian(seed):
    rng = np.random.default_rng(seed)
    n, seen, count, first = 30, int(rng.integers(1, 3)), int(rng.choice([5, 300])), int(rng.integers(1, 5))
    width, follow = Basis(-2.0, 3.0, 4), Basis(-2.0, 3.0, 7)
    p, tip = rng.uniform(-2.5, 3.5, (2, n))
    by_width, by_follow = rng.normal(size=(2, n))
    by_c, residual, weight = rng.normal(size=(3, n, seen))
    weight = weight**2
    columns = rng.normal(size=(n, seen, count)) * (rng.random(count) < 0.8)  # some are another recording's own
    curves = np.hstack([by_width[:, None] * dense(width, p), by_follow[:, None] * dense(follow, tip)])
    jacobian = np.concatenate([by_c[:, :, None] * curves[:, None, :], columns], axis=2).reshape(n * seen, -1)
    weighted = jacobian * weight.reshape(-1, 1)
    m = jacobian.shape[1]

    def added(columns, matrix, gradient, first=0):
        _native.normal_add(
            p, tip, by_width, by_follow, by_c, columns, residual, weight, width.native, follow.native, matrix, gradient,
            first=first,
        )  # fmt: skip
        return matrix, gradient

    expected = weighted.T @ jacobian, weighted.T @ residual.ravel()
    found = added(columns, np.zeros((m, m)), np.zeros(m))
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)  # the reference stops short of the last knot
    # The same in two steps: the first columns, then the others on top.
    cut = m - count + first
    part = added(np.ascontiguousarray(columns[:, :, :first]), np.zeros((cut, cut)), np.zeros(cut))
    matrix, gradient = np.zeros((m, m)), np.zeros(m)
    matrix[:cut, :cut], gradient[:cut] = part
    for a, b in zip(added(columns, matrix, gradient, first), expected, strict=True):
        np.testing.assert_allclose(a, b, atol=1e-6)  # the reference stops short of the last knot


REMEMBERING = [
    {"lag": 0.08},
    {"lag": 0.08, "lag_second": 0.4},
    {"creep_share": 0.2, "creep_time": 0.5, "creep_slow": 0.5},
    {"lag": 0.05, "creep_share": 0.2, "creep_time": 0.5},
    {"asymmetry": 0.3, "asymmetry_travel": 0.6, "asymmetry_form": 2.0},
    {"asymmetry": 0.3, "asymmetry_travel": 0.6, "asymmetry_renewed": 1.0},
    {"rest_width": 0.3, "rest_time": 0.5, "rest_travel": 0.4},
    {"asymmetry": 0.2, "asymmetry_travel": 0.6, "rest_width": 0.3, "rest_time": 0.5, "rest_travel": 0.4},
    {"width_per_speed": 0.1},
    {"onset_spread": 0.6, "onset_tail": 1.0},
    {"stick": 0.0937},
]


@pytest.mark.parametrize("parameters", REMEMBERING, ids=lambda p: "+".join(p))
def test_few_knots_say_the_same_as_many_samples(parameters):
    """Straight lines between corners, asked for at 25 Hz, against ten thousand samples per second."""
    corners = np.array([(0, 0), (2, 4), (2.5, 4), (4.5, -4), (5, -4), (6, 1), (7, -2), (8, -2)], dtype=float)
    t = np.arange(0.0, 8.0, 1e-4)
    fine = Motor(t, np.interp(t, *corners.T), None)
    coarse = Motor(np.ascontiguousarray(corners[:, 0]), np.ascontiguousarray(corners[:, 1]), None)
    scene = np.arange(0.3, 7.9, 0.04)
    model = made(1.0)
    many, few = (simulate(model, motor, scene, parameters).tip for motor in (fine, coarse))
    np.testing.assert_allclose(few, many, atol=0.0937 + 1e-9 if "stick" in parameters else 4e-3)
    assert np.sqrt(np.mean((few - many) ** 2)) < (0.02 if "stick" in parameters else 1e-3)


def test_late_catching_up_has_the_form_that_is_asked_for():
    model = made(1.0)
    t = np.arange(12.0, 18.0, 0.01)
    plain = simulate(model, STROKES, t, {}).p
    q = np.interp(t, STROKES.t_s, STROKES.q)
    travel = q + 4 - 1.0  # since an unhindered tip would move
    for form in (1.0, 2.0):
        values = {"asymmetry": 0.3, "asymmetry_travel": 0.5, "asymmetry_form": form}
        behind = plain - simulate(model, STROKES, t, values).p
        late = travel - 0.3 > 0.02
        expected = 0.3 * np.exp(-(((travel[late] - 0.3) / 0.5) ** form))
        # The travel counts from where the tip is caught: 0.3 later, less what it has caught up meanwhile.
        np.testing.assert_allclose(behind[late], expected, atol=2e-2)


def test_speed_drift_contact_and_rocking_have_their_shapes():
    model = made(1.0)
    # A tenth of the grid's span is 1 mm/s.
    ended = width_seen({"width_per_speed": 0.3, "speed_saturation": 4.0}, model=model) - 1.0
    assert ended == pytest.approx(0.3 * (1 - np.exp(-4 * 8 / 6)) / (1 - np.exp(-4)), abs=2e-3)
    t = np.array([4.0])
    away = (
        simulate(model, STROKES, t, {"offset_drift": 0.1, "drift_decay": 0.5}, clock_offset_s=10.0).p
        - simulate(model, STROKES, t, {}).p
    )
    assert away == pytest.approx(0.1 * (1 - np.exp(-0.5 * 14.0)) / 0.5, abs=1e-6)
    t = np.arange(1.0, 27.0, 0.1)
    plain = simulate(MODEL, STROKES, t, {}).c_deg
    held = {"contact_hold": 0.75, "contact_c": 10.0, "contact_side": 1.0, "contact_soft": 4.0}
    beyond = np.maximum(plain - 10.0, 0.0)
    expected = plain - 0.75 * (beyond - 4.0 * (1 - np.exp(-beyond / 4.0)))
    np.testing.assert_allclose(simulate(MODEL, STROKES, t, held).c_deg, expected, atol=1e-9)
    rocked = simulate(model, STROKES, np.array([11.9, 13.0, 17.9]), {"tilt_travel": 0.5}).way
    assert rocked[0] < -0.99 and -1 < rocked[1] < 0.9 and rocked[2] > 0.99


def test_a_parameter_that_no_effect_has_is_refused():
    with pytest.raises(ValueError, match="no effect has a parameter 'nonsense'"):
        _native.simulate_effects(
            {"nonsense": 1.0}, MODEL.play.native, MODEL.c_deg, np.arange(3.0), np.zeros(3), np.arange(3.0)
        )


def swung(t, u, share, period, damping, carried):
    """By small steps of the differential equation, straight between them."""
    w, y, rate, out = 2 * np.pi / period, u[0], 0.0, []
    for i in range(len(t)):
        if i:
            dt = (t[i] - t[i - 1]) / 40
            for k in range(40):
                slope = (u[i] - u[i - 1]) / (t[i] - t[i - 1])
                drive = u[i - 1] + (u[i] - u[i - 1]) * (k + 0.5) / 40
                rate += dt * (w * w * (drive - y) - 2 * damping * w * (rate - carried * slope))
                y += dt * rate
        out.append(u[i] + share * (y - u[i]))
    return np.array(out)


@pytest.mark.parametrize(
    ("period", "damping", "carried"), [(0.5, 0.1, 0.0), (1.3, 0.05, 1.0), (0.8, 0.9, 0.5), (0.5, 0.2, 2.0)]
)
def test_a_swing_is_its_differential_equation(period, damping, carried):
    t = np.arange(0.0, 27.0, 0.002)
    values = {"swing_share": 0.4, "swing_period": period, "swing_damping": damping, "swing_carried": carried}
    plain, path = simulate(MODEL, STROKES, t, {}), simulate(MODEL, STROKES, t, values)
    np.testing.assert_allclose(path.tip, swung(t, plain.p, 0.4, period, damping, carried), atol=5e-4)
    assert np.ptp(path.tip - plain.p) > 0.05
    sparse = simulate(MODEL, STROKES, t[::20], values)  # exact for any times that are asked for
    np.testing.assert_allclose(sparse.tip, path.tip[::20], atol=2e-4)


def test_another_joint_moves_c_through_its_own_play():
    t = STROKES.t_s
    wrist = 30.0 * np.sin(t / 3.0)
    motor = replace(STROKES, extra={"wrist_deg": wrist})
    values = {"c_per_joint": 0.2, "joint_play": 6.0, "column": "wrist_deg"}
    added = simulate(MODEL, motor, t, values).c_deg - simulate(MODEL, motor, t, {}).c_deg
    carried = _native.Plays(np.array([-99.0, 99.0]), np.array([6.0, 6.0])).forward(wrist, wrist[0])[0]
    np.testing.assert_allclose(added, 0.2 * carried, atol=1e-9)
    rests = simulate(MODEL, STROKES, t, values).c_deg
    np.testing.assert_allclose(rests, simulate(MODEL, STROKES, t, {}).c_deg, atol=1e-9)


@pytest.mark.parametrize("at_tip", [0.0, 1.0])
@pytest.mark.parametrize("name", ["offset", "width_scale", "width_everywhere", "remaining_3"])
def test_a_nominal_part_is_simulated_as_the_model_that_holds_it(name, at_tip):
    """As far as the tables of both reach."""
    values = {name: 0.3, "offset_at_tip": at_tip} if name == "offset" else {name: 0.3}
    kind = effects.OWNER[name]
    t = np.arange(6.0, 26.0, 0.01)
    held = simulate(kind.holds(MODEL, values, 0.0), STROKES, t, {}, start_deg=3.0)
    told = simulate(MODEL, STROKES, t, values, start_deg=3.0)
    np.testing.assert_allclose(told.c_deg, held.c_deg, atol=1e-6)
    assert np.ptp(told.c_deg - simulate(MODEL, STROKES, t, {}).c_deg) + abs(told.c_deg[0]) > 0.05


def test_a_width_in_its_simple_form_is_wider_everywhere_by_as_much():
    simple = effects.BY_ID["transmission.backlash"].simple
    assert simple is not None and simple.id == "transmission.backlash"
    (parameter,) = simple.parameters
    held = simple.holds(MODEL, {parameter.name: 0.25}, 0.0)
    np.testing.assert_allclose(held.width, MODEL.width + 0.25, atol=1e-12)


def test_a_width_by_parameters_of_both_its_forms_is_changed_once():
    both = effects.tabled(MODEL, {"width_scale": 0.1, "width_everywhere": 0.25})
    np.testing.assert_allclose(both.width, 1.1 * MODEL.width + 0.25, atol=1e-12)


def test_a_clock_of_another_rate_is_late_the_longer_it_runs():
    t = np.array([5.0, 15.0, 25.0])
    late = simulate(MODEL, STROKES, t, {"clock_rate": 1e-3}).c_deg
    np.testing.assert_allclose(late, simulate(MODEL, STROKES, t * (1 - 1e-3), {}).c_deg, atol=1e-12)


def test_dahl_s_friction_is_a_spread_of_two_with_a_tail():
    """Travel x since a reversal from the envelope: the tip lags by B exp(-x / B), as in Dahl's first-order model."""
    width = 0.5
    t = np.arange(12.05, 18.0, 0.05)
    p = simulate(made(width), STROKES, t, {"onset_spread": 2.0, "onset_tail": 1.0}).p
    x = np.interp(t, STROKES.t_s, STROKES.q) + 4.0
    np.testing.assert_allclose(p, -4.0 + 0.5 * width + x - width * -np.expm1(-x / width), atol=0.01 * width)


def test_every_parameter_has_one_owner_and_every_native_one_a_descriptor():
    names = [parameter.name for kind in LIBRARY for parameter in kind.parameters]
    assert len(names) == len(set(names))
    told = {name for name, *_ in (*_native.effect_parameters, *_native.projection_parameters)}
    assert told - set(names) == {"c_per_joint", "joint_play"}  # a descriptor for each joint's column has them
    for name, _, _, meaning in _native.effect_parameters:
        if name in names:
            assert meaning.split(":")[0] == effects.OWNER[name].id


def test_a_width_that_is_worn_at_the_motor_s_place_is_reached_there():
    """Either wall stands where the motor is half the width away, B of the centre and what is worn of the motor's."""
    kind = BY_ID["transmission.backlash"]
    values = {p.name: 0.0 for p in kind.amplitudes} | {"width_10": 0.5, "width_11": 0.4, "width_at_motor": 1.0}
    assert kind.holds is not None
    at_centre, at_motor = (kind.holds(MODEL, values | {"width_at_motor": at}, 0.0) for at in (0.0, 1.0))
    q = MODEL.q
    worn = at_centre.width - MODEL.width
    assert worn.max() > 0.4 and np.abs(at_motor.c_deg - MODEL.c_deg).max() > 0.5
    inside = np.abs(q) < 3.5
    p = np.interp(at_motor.c_deg[inside], MODEL.c_deg, q)  # the centre that has this angle
    for side in (1.0, -1.0):
        wall = q[inside] + side * 0.5 * at_motor.width[inside]
        width = np.interp(p, q, MODEL.width) + np.interp(wall, q, worn)
        np.testing.assert_allclose(wall - p, side * 0.5 * width, atol=2e-3)


@given(added=st.lists(st.floats(-2.0, 2.0), min_size=23, max_size=23))
def test_a_width_by_the_motor_s_place_leaves_a_model(added):
    kind = BY_ID["transmission.backlash"]
    assert kind.holds is not None
    values = dict(zip((p.name for p in kind.amplitudes if p.name != "width_scale"), added, strict=True))
    made = kind.holds(MODEL, values | {"width_at_motor": 1.0}, 0.0)
    assert np.all(np.diff(made.c_deg) * np.sign(MODEL.c_deg[-1] - MODEL.c_deg[0]) > 0.0)
    assert (
        np.all(np.isfinite(made.c_deg)) and np.all(made.width >= 0.0) and np.abs(made.c_deg - MODEL.c_deg).max() < 30.0
    )
