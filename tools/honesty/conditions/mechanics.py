"""The transmission has a memory of time, speed or wear."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from tools.honesty.conditions.common import Array, Rng, angle_setup, camera_setup, length, motions
from tools.honesty.conditions.registry import condition
from tools.honesty.motion import STEP_S
from tools.honesty.setup import Setup


def low_pass(x: Array, tau: float) -> Array:
    keep = np.exp(-STEP_S / tau)
    return np.asarray(lfilter([1 - keep], [1, -keep], x - x[0])) + x[0]


def _lagging(setup: Setup, tau: float) -> Setup:
    setup.tendon.append(lambda t, p: low_pass(p, tau))
    return setup


LAG = ("transmission.lag", "acquisition.delay", "transmission.rate_dependent_backlash", "configuration.swing")


@condition("lagging", *LAG)
def lag_of_30_ms(rng: Rng) -> Setup:
    return _lagging(camera_setup(rng), 0.03)


@condition("lagging", *LAG)
def lag_of_100_ms(rng: Rng) -> Setup:
    return _lagging(camera_setup(rng), float(rng.uniform(0.08, 0.12)))


@condition("lagging", *LAG)
def lag_seen_by_an_angle_sensor(rng: Rng) -> Setup:
    return _lagging(angle_setup(rng), float(rng.uniform(0.06, 0.1)))


@condition("lagging", "transmission.creep", "transmission.lag", "drift", "repeatability")
def creep(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    share, tau = float(rng.uniform(0.02, 0.05)), float(rng.uniform(2.0, 5.0))
    s.tendon.append(lambda t, p: (1 - share) * p + share * low_pass(p, tau))
    return s


@condition("lagging", "configuration.swing", "transmission.lag")
def swing(rng: Rng) -> Setup:
    s = camera_setup(rng)
    w, zeta = 2 * np.pi * float(rng.uniform(3.0, 6.0)), float(rng.uniform(0.05, 0.15))
    root = np.exp((-zeta + 1j * np.sqrt(1 - zeta**2)) * w * STEP_S)
    poles = [1.0, -2 * root.real, abs(root) ** 2]

    def swung(t: Array, c: Array, _: dict[str, Array]) -> Array:
        return np.asarray(lfilter([sum(poles)], poles, c - c[0])) + c[0]

    s.bend.append(swung)
    return s


@condition("speed", "transmission.rate_dependent_backlash", "transmission.lag", "acquisition.delay")
def width_grows_with_speed(rng: Rng) -> Setup:
    s = camera_setup(rng)
    k = float(rng.uniform(0.04, 0.08)) / length(s.actuator, 1.0)
    s.scale = lambda t, q: 1 + k * low_pass(np.abs(np.gradient(q, STEP_S)), 0.05)
    return s


@condition("speed", "transmission.rate_dependent_backlash", "transmission.lag", "acquisition.delay")
def width_saturates_with_speed(rng: Rng) -> Setup:
    """Stribeck's other way round: wider when slow, narrower when fast."""
    s = camera_setup(rng)
    k, v0 = float(rng.uniform(0.06, 0.12)), length(s.actuator, 0.8)
    s.scale = lambda t, q: 1 - k * (1 - np.exp(-low_pass(np.abs(np.gradient(q, STEP_S)), 0.05) / v0))
    return s


def stuck(p: Array, jump: float) -> Array:
    """The tip holds until it is `jump` behind, then goes all the way."""
    out, at = np.empty(len(p)), float(p[0])
    for k, x in enumerate(p.tolist()):
        if abs(x - at) >= jump:
            at = x
        out[k] = at
    return out


def _sticking(rng: Rng, mm: float) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    jump = length(s.actuator, mm)
    s.tendon.append(lambda t, p: low_pass(stuck(p, jump), 0.006))
    s.wider = jump  # the tip is half a jump behind in the mean, either way
    return s


STICK = ("transmission.stick_slip", "repeatability", "residual")


@condition("sticking", *STICK)
def jumps_of_20_um(rng: Rng) -> Setup:
    return _sticking(rng, 0.02)


@condition("sticking", *STICK)
def jumps_of_50_um(rng: Rng) -> Setup:
    return _sticking(rng, 0.05)


@condition("sticking", *STICK, "transmission.drift")
def width_differs_from_stroke_to_stroke(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    knots = rng.normal(0, float(rng.uniform(0.02, 0.04)), 400)
    times = np.arange(400) * float(rng.uniform(2.0, 4.0))
    s.scale = lambda t, q: 1 + np.interp(t, times, knots)
    s.comes_and_goes = True
    return s


WEAR = ("transmission.drift", "drift", "repeatability", "transmission.backlash", "transmission.offset")


@condition("wear", *WEAR)
def width_grows_by_5_percent(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=150.0)
    seconds = s.recordings[0].duration
    s.scale = lambda t, q: 1 + 0.05 * np.clip(t / seconds, 0, 1)
    return s


@condition("wear", *WEAR)
def width_grows_by_15_percent(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=150.0)
    seconds = s.recordings[0].duration
    s.scale = lambda t, q: 1 + 0.15 * np.clip(t / seconds, 0, 1) ** 1.5
    return s


@condition("wear", *WEAR)
def offset_drifts(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=150.0)
    seconds, by = s.recordings[0].duration, length(s.actuator, float(rng.uniform(0.03, 0.08)))
    s.shift = lambda t, q: by * np.clip(t / seconds, 0, 1)
    return s


@condition("wear", *WEAR)
def retensioned_between_recordings(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=70.0)
    s.recordings.append(motions(rng, s.actuator, 70.0))
    change = s.recordings[0].duration + s.gap_s / 2
    by, wider = length(s.actuator, float(rng.uniform(0.05, 0.1))), float(rng.uniform(-0.08, 0.08))
    s.shift = lambda t, q: by * (t > change)
    s.scale = lambda t, q: 1 + wider * (t > change)
    return s
