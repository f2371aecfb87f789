"""Load, gravity, other joints, obstacles."""

from __future__ import annotations

import numpy as np

from tools.honesty import motion
from tools.honesty.conditions.common import Array, Rng, angle_setup, camera_setup, length
from tools.honesty.conditions.registry import condition
from tools.honesty.motion import Motion
from tools.honesty.setup import Setup

LOAD = ("transmission.load_dependence", "load")
COUPLING = ("configuration.axis_coupling", "coupling")


def _levels(m: Motion, rng: Rng, low: float, high: float, every: float) -> Array:
    """Held for a while each, changed within half a second."""
    n = int(m.duration / every) + 2
    path = motion.visit(rng.uniform(low, high, n).tolist(), (high - low) * 2, every, (high - low) * 20)
    return np.interp(m.t, path.t, path.q)


def _loaded(s: Setup, wider: float, pull: float) -> Setup:
    """Widths grow by `wider` and the offset moves by `pull` (unit of q) at full load, 50 mNm."""
    s.columns = lambda m, rng: {"load_mNm": _levels(m, rng, 0.0, 50.0, m.duration / 5.5)}
    s.load_scale = lambda columns: (1 + wider * columns["load_mNm"] / 50.0, pull * columns["load_mNm"] / 50.0)
    return s


@condition("load", *LOAD)
def load_that_is_logged(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=130.0)
    return _loaded(s, float(rng.uniform(0.08, 0.15)), length(s.actuator, float(rng.uniform(0.05, 0.12))))


@condition("load", *LOAD, "drift", "repeatability", "transmission.drift")
def load_that_nobody_logged(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=130.0)
    s.logged = frozenset()
    return _loaded(s, float(rng.uniform(0.08, 0.15)), length(s.actuator, float(rng.uniform(0.05, 0.12))))


@condition("load", *LOAD, "angle")
def load_on_a_spindle(rng: Rng) -> Setup:
    s = angle_setup(rng, seconds=120.0)
    return _loaded(s, float(rng.uniform(0.1, 0.2)), length(s.actuator, float(rng.uniform(0.03, 0.08))))


@condition("coupling", *COUPLING)
def translation_bends_it(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=130.0)
    k = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 0.8))
    s.columns = lambda m, rng: {"translation_mm": _levels(m, rng, -2.0, 2.0, m.duration / 8)}
    s.bend.append(lambda t, c, columns: c + k * columns["translation_mm"])
    return s


@condition("coupling", *COUPLING)
def a_wrist_bends_it(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=130.0)
    k = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.08))
    s.columns = lambda m, rng: {"wrist_deg": _levels(m, rng, -40.0, 40.0, m.duration / 8)}
    s.bend.append(lambda t, c, columns: c + k * columns["wrist_deg"])
    return s


@condition("coupling", *COUPLING, "drift", "repeatability", "registration.shift", "transmission.drift")
def a_wrist_that_nobody_logged(rng: Rng) -> Setup:
    s = a_wrist_bends_it(rng)
    s.logged = frozenset()
    return s


CONTACT = ("configuration.contact", "contact")


@condition("contact", *CONTACT)
def an_obstacle_at_one_end(rng: Rng) -> Setup:
    s = camera_setup(rng)
    at, give = float(rng.uniform(15.0, 25.0)), float(rng.uniform(0.1, 0.3))
    s.bend.append(lambda t, c, _: np.where(c > at, at + give * (c - at), c))
    return s


@condition("contact", *CONTACT, "repeatability", "drift", "transmission.drift", "registration.shift")
def an_obstacle_for_a_while(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    at, begin, long = float(rng.uniform(8.0, 18.0)), float(rng.uniform(30.0, 50.0)), float(rng.uniform(20.0, 40.0))
    met = lambda t, c: (c > at) & (t > begin) & (t < begin + long)  # noqa: E731
    s.bend.append(lambda t, c, _: np.where(met(t, c), at + 0.3 * (c - at), c))
    s.test = motion.teleoperated(rng, s.actuator.low, s.actuator.high, 18.0, length(s.actuator, 2.0))
    return s
