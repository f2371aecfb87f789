"""What is loose within a play, against the same equations stepped a hundred times as finely in numpy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.effects import follow
from tautline.model import Model
from tautline.recording import Motor
from tautline.rig import Actuator, Coarse, Rig

RIG = Rig(Actuator("deg", (-60.0, 60.0), 0.01), Coarse(1.0, 0.0))
GRID = np.linspace(-60.0, 60.0, 257)
STEP_S = 0.005


def model(width: float) -> Model:
    return Model(RIG, GRID, 0.0 * GRID + width, 0.0 * GRID, GRID, 0.0, RIG.actuator.range, sensor="angle")


def motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 6.0, STEP_S)
    return t_s, sum(rng.uniform(5.0, 20.0) * np.sin(rng.uniform(0.5, 2.0) * t_s + rng.uniform(0.0, 6.0)) for _ in "ab")


def fallen(q: np.ndarray, width: float, pull: float, place: float, drag: float) -> np.ndarray:
    """Where a joint is whose wheel is at q: inelastic ends, semi-implicit steps of 50 us."""
    p, speed, last, fine = float(q[0]), 0.0, float(q[0]), 100
    out, dt = np.empty_like(q), STEP_S / fine
    for i, wheel in enumerate(q.tolist()):
        for k in range(1, fine + 1):
            speed -= dt * (pull * (p - place) + drag * speed)
            p += dt * speed
            now = last + (wheel - last) * k / fine
            if abs(p - now) > 0.5 * width:
                p = now + np.copysign(0.5 * width, p - now)
                end = (wheel - last) / STEP_S
                speed = min(speed, end) if p > now else max(speed, end)
        out[i], last = p, wheel
    return out


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.5, 4.0), st.floats(20, 200), st.floats(-10, 10), st.floats(0.5, 20))
def test_it_falls_to_its_loads_side(seed, width, pull, place, drag):
    t_s, q = motion(seed)
    loose = {"loose_pull": pull, "loose_place": place, "loose_drag": drag}
    off = follow(model(width), Motor(t_s, q), t_s, loose).c_deg - fallen(q, width, pull, place, drag)
    assert np.sqrt(np.mean(off**2)) < 0.02 * width


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.0, 4.0))
def test_without_a_pull_it_is_the_play(seed, width):
    t_s, q = motion(seed)
    held, loose = (follow(model(width), Motor(t_s, q), t_s, each) for each in ({}, {"loose_pull": 0.0}))
    np.testing.assert_array_equal(held.c_deg, loose.c_deg)


def test_a_strong_pull_leaves_a_step_at_its_place_alone():
    """It is at the end that is nearer to the place, whichever way the motor goes."""
    t_s, q = motion(3)
    pulled = follow(model(2.0), Motor(t_s, q), t_s, {"loose_pull": 1e5, "loose_place": 4.0, "loose_drag": 600.0}).c_deg
    far = (np.abs(q - 4.0) > 2.0) & (t_s > 0.1)  # it begins in the middle
    np.testing.assert_allclose(pulled[far], (q - np.sign(q - 4.0))[far], atol=0.05)
