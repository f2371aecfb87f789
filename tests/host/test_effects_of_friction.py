"""Effects that go with friction where the tip is, against small steps in float64: extra width where B is wide, drag
beside friction, a channel that the motor turns over, an axis that couples in through a gap or before the play."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline import _native
from tautline.effects import BY_ID, simulate
from tautline.effects.library.rate_dependent_backlash import added_width
from tautline.model import Model
from tautline.recording import Motor
from tautline.simulated.instrument import reference_rig

GRID = np.linspace(-5.0, 5.0, 201)
SLOPE = 9.0
MODEL = Model(
    reference_rig(), GRID, 0.6 + 0.4 * np.sin(GRID), 0.0 * GRID, SLOPE * GRID, 0.08, (-4.0, 4.0)
)  # fmt: skip
MEAN = float(np.trapezoid(MODEL.width, GRID)) / 10.0


def wandering(seed: int, seconds: float = 12.0) -> Motor:
    """Sums of sines within the range, 50 Hz."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.02)
    q = sum(rng.uniform(0.3, 1.2) * np.sin(2 * np.pi * rng.uniform(0.05, 0.4) * t + rng.uniform(0, 6)) for _ in "abc")
    return Motor(t, np.asarray(q), None)


def ends(q):
    """Where a motor at q carries the tip at least, and at most: p + B(p)/2 = q and p - B(p)/2 = q."""
    return np.interp(q, GRID + MODEL.width / 2, GRID), np.interp(q, GRID - MODEL.width / 2, GRID)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_drag_beside_friction_is_its_differential_equation(seed):
    """T p' = end - p while an end is beyond the tip, and p' = 0 while friction holds it."""
    motor, time, h = wandering(seed, 6.0), 0.05 + seed % 100 / 300.0, 1e-4
    t = np.arange(0.0, 5.9, h)
    low, high = ends(np.interp(t, motor.t_s, motor.q))
    p, share = [motor.q[0]], -np.expm1(-h / time)
    for a, b in zip(low[1:].tolist(), high[1:].tolist(), strict=True):
        p.append(p[-1] + share * (max(a - p[-1], 0.0) + min(b - p[-1], 0.0)))
    at = np.arange(0.1, 5.8, 0.033)
    path = simulate(MODEL, motor, at, {"lag": time, "lag_held": 1.0})
    np.testing.assert_allclose(path.tip, np.interp(at, t, p), atol=3e-3)


def test_friction_holds_a_tip_that_lags_and_not_one_that_lags_behind_it():
    """A motor that turns while the tip is late: the one stays, the other still comes to where the play was."""
    t = np.arange(0.0, 3.0, 0.002)
    motor = Motor(t, np.interp(t, [0, 1, 1.05, 3], [-2, 2, 0.8, 0.8]), None)
    late = np.array([1.3, 2.8])
    held, behind = (simulate(MODEL, motor, late, {"lag": 0.3, "lag_held": way}).tip for way in (1.0, 0.0))
    assert held[1] - held[0] < 0.02 and behind[1] - behind[0] > 0.1


@pytest.mark.parametrize("share", [0.0, 0.5, 1.0, 2.0])
def test_added_width_goes_with_the_place_as_b_does(share):
    """At the same speed and at rest it is wider where B is, by that share, and the same in the mean of the range."""
    t = np.arange(0.0, 20.0, 0.01)
    motor = Motor(t, np.interp(t, [0, 8, 10, 18, 20], [-4, 4, 4, -4, -4]), None)
    up, down = np.arange(2.5, 7.5, 0.1), np.arange(12.5, 17.5, 0.1)
    values = {"width_per_speed": 0.1, "speed_pressed": share, "width_held": 1.0}
    plain, wider = (simulate(MODEL, motor, np.r_[up, down], v).p for v in ({}, values))
    expected = 0.05 * np.maximum(1.0 + share * (np.interp(wider, GRID, MODEL.width) / MEAN - 1.0), 0.0)
    steep = 1.0 + 0.5 * np.r_[np.ones(len(up)), -np.ones(len(down))] * np.interp(wider, GRID, 0.4 * np.cos(GRID))
    np.testing.assert_allclose(np.abs(plain - wider) * steep, expected, atol=4e-3)


@pytest.mark.parametrize(
    ("effect", "amplitude"), [("asymmetric_backlash", "asymmetry"), ("rest_dependent_backlash", "rest_width")]
)
def test_what_is_late_on_a_side_goes_with_the_place_as_b_does(effect, amplitude):
    """After a rest where B is three times as wide as elsewhere the tip starts later by as much."""
    shapes = {p.name: p.shape[-1] * p.share(10.0) for p in BY_ID[f"transmission.{effect}"].shapes}
    pressed = next(name for name in shapes if name.endswith("_pressed"))
    late, wide = [], []
    for place in (-np.pi / 2, np.pi / 2):
        t = np.arange(0.0, 25.0, 0.002)
        motor = Motor(t, place + np.interp(t, [0, 1, 22, 25], [0, -1.2, -1.2, 1.8]), None)
        values = [{}, {**shapes, amplitude: 0.05, pressed: 1.0}]
        starts = [simulate(MODEL, motor, t, v).p for v in values]
        when = [t[np.flatnonzero((t > 22.0) & (p > p[10990] + 1e-4))[0]] for p in starts]
        late.append(when[1] - when[0])
        wide.append(np.interp(starts[0][10990], GRID, MODEL.width) / MEAN)
    assert late[1] / late[0] == pytest.approx(wide[1] / wide[0], rel=0.08)
    assert late[1] > 2 * late[0]


def test_a_width_may_grow_with_the_logarithm_of_speed():
    speed = np.array([0.0, 0.01, 0.1, 1.0, 3.0])
    added = added_width({"width_per_speed": 0.2, "speed_saturation": -5.0}, 10.0, speed)
    np.testing.assert_allclose(added, 0.2 * np.log1p(np.expm1(5.0) * speed) / 5.0, atol=1e-12)
    t = np.arange(0.0, 9.0, 0.005)
    motor = Motor(t, np.interp(t, [0, 8, 9], [-4, 4, 4]), None)
    flat = replace(MODEL, width=np.full(len(GRID), 0.5))
    by_speed = {"width_per_speed": 0.2, "speed_saturation": -5.0}
    plain, wider = (simulate(flat, motor, np.array([6.0]), v).p for v in ({}, by_speed))
    assert 2 * float(plain[0] - wider[0]) == pytest.approx(0.2, abs=1e-3)  # a tenth of the grid a second
    near = [added_width({"width_per_speed": 0.2, "speed_saturation": k}, 10.0, speed) for k in (-1e-4, 0.0, 1e-4)]
    np.testing.assert_allclose(near[0], near[1], atol=1e-4)
    np.testing.assert_allclose(near[2], near[1], atol=1e-4)


@given(st.integers(0, 2**32 - 1), st.floats(0.05, 2.0))
@settings(max_examples=20, deadline=None)
def test_the_motor_or_the_tip_turns_a_channel_over_within_its_travel(seed, travel):
    motor = wandering(seed)
    slope = float(MODEL.c_deg[-1] - MODEL.c_deg[0]) / float(GRID[-1] - GRID[0])
    late = {"lag": 0.2, "creep_share": 0.3, "creep_time": 2.0}  # a tip that goes on while the motor turns
    for driven, others in ((0.0, {}), (0.0, late), (1.0, late)):
        tilt = {"tilt_x": 0.2, "tilt_travel": travel, "tilt_driven": driven}
        path = simulate(MODEL, motor, motor.t_s, tilt | others)
        moves = np.diff(motor.q if driven else path.c_deg / slope)
        lies = [float(path.way[0])]
        for step in moves.tolist():
            lies.append(min(max(lies[-1] + 2 * step / travel, -1.0), 1.0))
        np.testing.assert_allclose(path.way, lies, atol=1e-9)
        assert driven == 0.0 or lies[0] == 0.0


def test_axes_couple_through_gaps_of_their_own():
    t = np.arange(0.0, 12.0, 0.01)
    other = {"translation_mm": 8.0 * np.sin(t / 2), "rotation_deg": 60.0 * np.cos(t / 3)}
    motor = replace(wandering(3), t_s=t, q=np.sin(t), **other)
    gaps = {"translation_play": 3.0, "rotation_play": 20.0}
    values = {"c_per_translation": 0.3, "c_per_rotation": -0.05, **gaps}
    added = simulate(MODEL, motor, t, values).c_deg - simulate(MODEL, motor, t, {}).c_deg
    expected = 0.0
    for moves, gap, slope in zip(other.values(), gaps.values(), (0.3, -0.05), strict=True):
        wide = np.array([-1e3, 1e3])
        expected = expected + slope * _native.Plays(wide, np.full(2, gap)).forward(moves, moves[0])[0]
    np.testing.assert_allclose(added, expected, atol=1e-9)


def test_an_axis_that_moves_the_tendon_is_a_motor_that_is_elsewhere():
    """Before the play it is taken up by the backlash as the motor's own motion is."""
    t = np.arange(0.0, 12.0, 0.01)
    shift = 5.0 * np.sin(t / 2)
    motor = Motor(t, np.sin(t), None, translation_mm=shift)
    values = {"c_per_translation": 0.4, "coupled_before": 1.0}
    path = simulate(MODEL, motor, t, values)
    there = simulate(MODEL, Motor(t, motor.q + 0.4 * shift / SLOPE, None), t, {})
    np.testing.assert_allclose(path.c_deg, there.c_deg, atol=1e-9)
