"""Other hystereses than one play: all rate independent, all with well-defined full-stroke envelopes."""

from __future__ import annotations

import numpy as np

from tools.honesty.conditions.common import Rng, camera_setup, length, slower, width_curve
from tools.honesty.conditions.registry import condition
from tools.honesty.plant import Asymmetric, BoucWen, Dahl, OwnStatePlays, Plays, WarpedPlays
from tools.honesty.setup import Setup

SMOOTH = ("hysteresis", "transmission.smooth_onset")


def _spread(rng: Rng, level: float, n: int, narrow: float, uneven: float = 0.0) -> Plays:
    """Radii from `narrow` of the outermost to it; the weighted mean radius is level / 2."""
    share = np.linspace(narrow, 1.0, n)
    weight = 1 + uneven * rng.uniform(-1, 1, n)
    weight = weight / weight.sum()
    return Plays(share * level / 2 / float(share @ weight), weight)


def _level(s: Setup, rng: Rng, low: float = 0.4, high: float = 0.9) -> float:
    return length(s.actuator, float(rng.uniform(low, high)))


def _constant(s: Setup, level: float) -> None:
    s.width = lambda p: np.full(np.shape(p), level)


def _warped(s: Setup, rng: Rng, plays: Plays) -> WarpedPlays:
    """A warp of slope 1 / B-like: its own curve, so that the truth's B comes from the stroke alone."""
    a, span = s.actuator, s.actuator.high - s.actuator.low
    grid = np.linspace(a.low - 0.6 * span, a.high + 0.6 * span, 60001)
    local = width_curve(rng, a)(grid)
    slope = 1 / local
    warped = np.concatenate([[0.0], np.cumsum((slope[1:] + slope[:-1]) / 2 * np.diff(grid))])
    s.width = lambda p: np.interp(p, grid, local)
    return WarpedPlays(plays, grid, warped)


@condition("plays", *SMOOTH)
def ten_plays(rng: Rng) -> Setup:
    s = camera_setup(rng)
    level = _level(s, rng)
    _constant(s, level)
    s.hysteresis = _spread(rng, level, 10, 0.1, 0.6)
    return s


@condition("plays", *SMOOTH)
def four_plays_on_one_width(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.hysteresis = _warped(s, rng, _spread(rng, 1.0, 4, float(rng.uniform(0.3, 0.6))))
    return s


@condition("plays", *SMOOTH)
def eight_plays_on_one_width(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.hysteresis = _warped(s, rng, _spread(rng, 1.0, 8, float(rng.uniform(0.1, 0.3)), 0.5))
    return s


@condition("plays", *SMOOTH)
def plays_at_their_own_states(rng: Rng) -> Setup:
    s = camera_setup(rng)
    share = np.linspace(float(rng.uniform(0.3, 0.6)), 1.0, 5)
    weight = np.full(5, 0.2)
    s.hysteresis = OwnStatePlays(s.width, share / float(share @ weight), weight)
    return s


def _gradual(rng: Rng, over: float, plays: int = 14) -> Setup:
    """The tip starts at (1 - over) of the widest and is on the envelope at all of it."""
    s = camera_setup(rng)
    s.hysteresis = _warped(s, rng, _spread(rng, 1.0, plays, 1.0 - over))
    return s


@condition("gradual", *SMOOTH)
def gradual_over_5_percent(rng: Rng) -> Setup:
    return _gradual(rng, 0.05, 5)


@condition("gradual", *SMOOTH)
def gradual_over_15_percent(rng: Rng) -> Setup:
    return _gradual(rng, 0.15, 8)


@condition("gradual", *SMOOTH)
def gradual_over_30_percent(rng: Rng) -> Setup:
    return _gradual(rng, 0.3)


@condition("gradual", *SMOOTH)
def gradual_over_60_percent(rng: Rng) -> Setup:
    return _gradual(rng, 0.6)


@condition("gradual", *SMOOTH)
def gradual_over_half_slowly(rng: Rng) -> Setup:
    s = _gradual(rng, 0.5)
    slower(s, float(rng.uniform(0.5, 0.8)))
    return s


def _bouc_wen(rng: Rng, n: float) -> Setup:
    s = camera_setup(rng)
    widest = float(np.max(s.width(np.linspace(s.actuator.low, s.actuator.high, 201))))
    beta = float(rng.uniform(0.5, 0.6))
    # Just after a turn dp/dq = 1 - B beta / length: the tip never moves backwards.
    s.hysteresis = BoucWen(s.width, beta * widest * float(rng.uniform(1.02, 1.3)), n, beta)
    return s


@condition("bouc_wen", *SMOOTH)
def bouc_wen_1(rng: Rng) -> Setup:
    return _bouc_wen(rng, 1.0)


@condition("bouc_wen", *SMOOTH)
def bouc_wen_2(rng: Rng) -> Setup:
    return _bouc_wen(rng, 2.0)


@condition("bouc_wen", *SMOOTH)
def bouc_wen_5(rng: Rng) -> Setup:
    return _bouc_wen(rng, 5.0)


@condition("dahl", *SMOOTH)
def dahl(rng: Rng) -> Setup:
    s = camera_setup(rng)
    level = _level(s, rng, 0.3, 0.6)
    _constant(s, level)
    s.hysteresis = Dahl(s.width, level * float(rng.uniform(1.02, 1.3)))
    return s


@condition("dahl", *SMOOTH)
def dahl_with_a_width(rng: Rng) -> Setup:
    s = camera_setup(rng, smallest=0.25, largest=0.4, bump=0.2)
    widest = float(np.max(s.width(np.linspace(s.actuator.low, s.actuator.high, 201))))
    s.hysteresis = Dahl(s.width, widest * float(rng.uniform(1.1, 1.4)))
    return s


ASYMMETRY = (
    "transmission.asymmetric_backlash",
    "hysteresis",
    "registration.direction_dependent",
    "transmission.smooth_onset",
)


def _asymmetric(rng: Rng, late: float) -> Setup:
    s = camera_setup(rng)
    s.hysteresis = Asymmetric(s.width, late)
    return s


@condition("asymmetry", *ASYMMETRY)
def late_one_way_by_a_twentieth(rng: Rng) -> Setup:
    return _asymmetric(rng, 0.05)


@condition("asymmetry", *ASYMMETRY)
def late_one_way_by_a_fifth(rng: Rng) -> Setup:
    return _asymmetric(rng, 0.2)
