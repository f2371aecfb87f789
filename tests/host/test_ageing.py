"""Static friction that grows with the rest before, against the same equations stepped finely in numpy."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tautline.diagnosis.diagnose import diagnose
from tautline.effects import follow
from tautline.model import Model
from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, Coarse, Rig

RIG = Rig(Actuator("mm", (-5.0, 5.0), 0.001), Coarse(1.0, 0.0))
GRID = np.linspace(-5.0, 5.0, 257)
STEP_S = 0.005
B = 0.8


def model(width: float = B) -> Model:
    return Model(RIG, GRID, 0.0 * GRID + width, 0.0 * GRID, GRID, 0.0, RIG.actuator.range, sensor="angle")


def path(*corners: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """The motor each STEP_S on straight lines between (s, mm)."""
    times, places = np.array(corners, dtype=float).T
    t_s = np.arange(0.0, times[-1], STEP_S)
    return t_s, np.interp(t_s, times, places)


def motion(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Moves at some speeds with rests of some seconds between, and small ones back now and then."""
    rng = np.random.default_rng(seed)
    corners, t, q = [(0.0, 0.0)], 0.0, 0.0
    for _ in range(14):
        goal = float(np.clip(q + rng.choice([-1, 1]) * rng.uniform(0.5, 4.0), -4.0, 4.0))
        t += abs(goal - q) / rng.uniform(0.5, 4.0) + 1e-3
        corners.append((t, goal))
        t += rng.choice([0.0, 0.3, 3.0])
        corners.append((t + 1e-6, goal))
        q = goal
    return path(*corners)


def aged(t_s: np.ndarray, q: np.ndarray, width: float, time: float, travel: float) -> np.ndarray:
    """Where the tip is: a play of B and of width growth / growth(1 s), in twenty steps of each
    STEP_S: growth is log(1 + age / time) of what rests, and falls as exp(-slid / travel)."""
    p, grown, fine = float(q[0]), 0.0, 20
    out = np.empty_like(q)
    last, dt = float(q[0]), STEP_S / fine
    for i, motor in enumerate(q.tolist()):
        for k in range(1, fine + 1 if i else 1):
            now = last + (motor - last) * k / fine
            late = width * grown / math.log1p(1.0 / time)
            if abs(now - p) > 0.5 * B + late + 1e-9:
                grown *= math.exp(-abs(motor - last) / fine / travel)
                late = width * grown / math.log1p(1.0 / time)
                p = now - math.copysign(0.5 * B + late, now - p)
            else:
                grown = math.log(math.exp(grown) + dt / time)
        out[i], last = p, motor
    return out


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.05, 0.4), st.floats(0.1, 5.0), st.floats(0.2, 1.0))
def test_it_ages_at_rest_and_wears_off(seed, width, time, travel):
    t_s, q = motion(seed)
    law = {"rest_width": width, "rest_time": time, "rest_travel": travel}
    off = follow(model(), Motor(t_s, q), t_s, law).c_deg - aged(t_s, q, width, time, travel)
    assert np.sqrt(np.mean(off**2)) < 0.03 * width


def set_by(t_s: np.ndarray, q: np.ndarray, size: float, time: float, travel: float) -> np.ndarray:
    """Where the tip is in grease that sets while it rests, `size` at most, and is broken up along `travel`: a law that
    the library does not have."""
    p, is_set, out = float(q[0]), 0.0, np.empty_like(q)
    for i, motor in enumerate(q.tolist()):
        if abs(motor - p) > 0.5 * B + size * is_set + 1e-9:
            is_set = max(is_set - abs(motor - q[i - 1]) / travel, 0.0)
            p = motor - math.copysign(0.5 * B + size * is_set, motor - p)
        else:
            is_set += (1.0 - is_set) * STEP_S / time
        out[i] = p
    return out


def test_grease_that_sets_is_named():
    recordings = []
    for number, seed in enumerate((1, 2, 3)):
        t_s, q = motion(seed)
        tip = set_by(t_s, q, 0.3 if number else 0.0, 1.5, 0.6)
        noise = np.random.default_rng(seed).normal(0.0, 0.01, len(t_s[::8]))
        seen = Angle(t_s[::8], tip[::8] + noise)
        recordings.append(Recording(f"recording-{number}", Motor(t_s, q), angle=seen, rig=RIG))
    found = diagnose(model(), recordings[0], recordings[1:])
    assert [finding.id for finding in found.findings] == ["transmission.rest_dependent_backlash"]
    assert found.gap.closable_shrink > 0.9


def onset(t_s: np.ndarray, q: np.ndarray, law: dict[str, float], after_s: float) -> float:
    """By how much the motor has moved since after_s when the tip does."""
    c = follow(model(), Motor(t_s, q), t_s, law).c_deg
    i = int(np.searchsorted(t_s, after_s))
    moved = np.flatnonzero(np.abs(c[i:] - c[i]) > 1e-4)[0]
    return float(abs(q[i + moved] - q[i]))


@pytest.mark.parametrize("rest_s", [0.5, 4.0, 40.0])
def test_the_reversal_after_a_rest_is_wider_by_its_logarithm(rest_s):
    law = {"rest_width": 0.2, "rest_time": 1.0, "rest_travel": 0.3}
    t_s, q = path((0, 0), (4, 4), (4 + rest_s, 4), (8 + rest_s, 0))
    wider = onset(t_s, q, law, 4.0 + rest_s) - onset(t_s, q, {}, 4.0 + rest_s)
    # The motor crosses B at 1 mm/s, and meanwhile it ages.
    assert wider == pytest.approx(0.2 * math.log1p(rest_s + B + wider) / math.log(2.0), abs=0.01)


def test_a_start_the_same_way_waits_after_a_rest_and_catches_up():
    law = {"rest_width": 0.2, "rest_time": 1.0, "rest_travel": 0.3}
    t_s, q = path((0, -4), (4, 0), (8, 0), (10, 4))
    plain, held = (follow(model(), Motor(t_s, q), t_s, each).c_deg for each in ({}, law))
    behind = plain - held
    assert onset(t_s, q, law, 8.0) > 0.3 > 0.02 > onset(t_s, q, {}, 8.0)
    assert behind[int(8.2 / STEP_S)] > 0.35
    assert behind[-1] < 0.1


def test_one_way_friction_is_there_again_after_a_rest_where_the_effect_says_so():
    t_s, q = path((0, -4), (4, 0), (6, 0), (8, 4))
    after_turn = {"asymmetry": 0.3, "asymmetry_travel": 0.4}
    assert onset(t_s, q, after_turn, 6.0) < 0.02
    assert onset(t_s, q, after_turn | {"asymmetry_renewed": 1.0}, 6.0) == pytest.approx(0.3, abs=0.02)
    # A pause of two hundredths of a second is none.
    t_s, q = path((0, -4), (4, 0), (4.02, 0), (6, 4))
    assert onset(t_s, q, after_turn | {"asymmetry_renewed": 1.0}, 4.02) < 0.02
