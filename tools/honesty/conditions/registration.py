"""Camera and instrument move against each other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tools.honesty.conditions.common import Array, Rng, camera_setup
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import Setup

DRIFT = ("registration.shift", "drift", "registration.drift", "registration", "repeatability", "transmission.drift")


def _axis(rng: Rng) -> Array:
    """Mostly about y and x: what moves the marker along and across its way."""
    axis = rng.normal(0, 1, 3) * np.array([0.7, 1.0, 0.5])
    return np.asarray(axis / np.linalg.norm(axis))


def _tilted(rng: Rng, angle: Callable[[Array, Array], Array], seconds: float = 120.0) -> Setup:
    s = camera_setup(rng, seconds=seconds)
    axis = _axis(rng)
    s.tilt = lambda t, heading: angle(t, heading)[..., None] * axis
    return s


@condition("registration", *DRIFT)
def registration_drifts(rng: Rng) -> Setup:
    by, tau = float(rng.uniform(0.15, 0.25)), float(rng.uniform(40.0, 200.0))
    return _tilted(rng, lambda t, _: by * (1 - np.exp(-t / tau)) / (1 - np.exp(-120.0 / tau)))


@condition("registration", *DRIFT)
def registration_shifts(rng: Rng) -> Setup:
    by, at = float(rng.uniform(0.4, 0.6)), float(rng.uniform(35.0, 80.0))
    return _tilted(rng, lambda t, _: by * (t > at))


@condition("registration", *DRIFT)
def registration_shifts_a_little(rng: Rng) -> Setup:
    by, at = float(rng.uniform(0.06, 0.12)), float(rng.uniform(35.0, 80.0))
    return _tilted(rng, lambda t, _: by * (t > at))


@condition("registration", *DRIFT, "residual", "noise")
def it_breathes(rng: Rng) -> Setup:
    by, period = float(rng.uniform(0.15, 0.25)), float(rng.uniform(2.8, 5.0))
    return _tilted(rng, lambda t, _: by * np.sin(2 * np.pi * t / period))


@condition("registration_tilt", "registration.direction_dependent", "registration")
def tilts_with_the_direction(rng: Rng) -> Setup:
    by = float(rng.uniform(0.2, 0.5))
    return _tilted(rng, lambda _, heading: by * heading / 2)


@condition(
    "registration_tilt", "registration.static", "registration", "camera.distortion", "kinematics.nonconstant_curvature"
)
def hand_eye_was_never_right(rng: Rng) -> Setup:
    s = camera_setup(rng)
    k = s.camera
    assert k is not None
    turned = np.asarray(k.rotation) + rng.uniform(0.8, 2.0, 3) * rng.choice([-1, 1], 3)
    moved = np.asarray(k.translation) + rng.uniform(-0.6, 0.6, 3)
    s.seen_by = replace(k, rotation=tuple(turned.tolist()), translation=tuple(moved.tolist()))
    return s


@condition(
    "registration_tilt", "camera.distortion", "registration.static", "registration", "kinematics.nonconstant_curvature"
)
def lens_that_was_not_told(rng: Rng) -> Setup:
    s = camera_setup(rng)
    k = s.camera
    assert k is not None
    s.seen_by = replace(k, distortion=(float(rng.uniform(-0.15, -0.05)), 0.01, 0.0005, 0.0, 0.0))
    return s


@condition("registration_tilt", *DRIFT, "residual", "noise")
def camera_is_nudged_and_comes_back(rng: Rng) -> Setup:
    by, at, tau = float(rng.uniform(0.3, 0.6)), float(rng.uniform(30.0, 80.0)), float(rng.uniform(3.0, 10.0))
    return _tilted(rng, lambda t, _: by * np.exp(-np.maximum(t - at, 0) / tau) * (t > at))
