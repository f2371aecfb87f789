"""The files contradict each other, or say something else than they mean."""

from __future__ import annotations

from typing import Any

import numpy as np

from tools.honesty import motion
from tools.honesty.conditions.common import Array, Rng, angle_setup, camera_setup, length
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import ImageLog, Setup

UNITS = ("range", "units", "coarse")


def _image(s: Setup) -> ImageLog:
    assert s.image is not None
    return s.image


@condition("units", *UNITS, must_not_pass=True)
def range_in_um(rng: Rng) -> Setup:
    s = camera_setup(rng)

    def file(rig: dict[str, Any]) -> dict[str, Any]:
        rig["actuator"]["range"] = [1000.0 * x for x in rig["actuator"]["range"]]
        return rig

    s.rig_file = file
    return s


@condition("units", *UNITS, "duration", must_not_pass=True)
def motor_in_um(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.change = lambda t, q: (t, 1000.0 * q)
    return s


@condition("units", *UNITS, "angle", must_not_pass=True)
def angle_in_radians(rng: Rng) -> Setup:
    s = angle_setup(rng)
    assert s.angle is not None
    s.angle.noise_deg = 0.0003
    s.angle.error = lambda c: np.radians(c) - c
    return s


@condition("units", *UNITS)
def gain_in_radians(rng: Rng) -> Setup:
    s = camera_setup(rng)

    def file(rig: dict[str, Any]) -> dict[str, Any]:
        rig["coarse"]["gain"] = float(np.radians(rig["coarse"]["gain"]))
        return rig

    s.rig_file = file
    return s


PICTURE = ("frame_size", "camera", "registration.static", "registration")


@condition("pictures_of_another_size", *PICTURE, must_not_pass=True)
def half_the_size(rng: Rng) -> Setup:
    s = camera_setup(rng)
    _image(s).extra = lambda table, _: {**table, "u_px": table["u_px"] / 2, "v_px": table["v_px"] / 2}
    return s


@condition("pictures_of_another_size", *PICTURE, must_not_pass=True)
def twice_the_size(rng: Rng) -> Setup:
    s = camera_setup(rng)
    _image(s).extra = lambda table, _: {**table, "u_px": table["u_px"] * 2, "v_px": table["v_px"] * 2}
    return s


@condition("pictures_of_another_size", *PICTURE, "coordinates", must_not_pass=True)
def u_and_v_swapped(rng: Rng) -> Setup:
    s = camera_setup(rng)
    _image(s).extra = lambda table, _: {**table, "u_px": table["v_px"], "v_px": table["u_px"]}
    return s


@condition("pictures_of_another_size", *PICTURE, "coordinates")
def origin_at_the_lower_left(rng: Rng) -> Setup:
    s = camera_setup(rng)
    assert s.camera is not None
    height = s.camera.height
    _image(s).extra = lambda table, _: {**table, "v_px": height - 1 - table["v_px"]}
    return s


@condition("steps", "steps", "rate", "coverage", "encoder")
def motor_in_steps(rng: Rng) -> Setup:
    """Each move is over within one sample of the log."""
    s = camera_setup(rng)
    a = s.actuator
    s.motor.rate_hz = 50.0
    s.recordings = [motion.stepped(rng, a.low, a.high, 90, 0.7)]
    return s


@condition("steps", "steps", "rate", "coverage", "encoder")
def staircase(rng: Rng) -> Setup:
    s = camera_setup(rng)
    a = s.actuator
    up = np.linspace(a.low, a.high, 25)
    ways = [motion.visit([*up.tolist(), *up[::-1].tolist()], length(a, 800.0), 0.6, length(a, 4e5)) for _ in range(2)]
    s.recordings = [motion.joined(ways)]
    s.motor.rate_hz = 100.0
    return s


@condition("steps", "steps", "rate", "coverage", "encoder", "angle")
def motor_in_steps_with_an_angle_sensor(rng: Rng) -> Setup:
    s = angle_setup(rng, rate_hz=50.0)
    a = s.actuator
    s.motor.rate_hz = 50.0
    s.recordings = [motion.stepped(rng, a.low, a.high, 90, 0.7)]
    return s


@condition("wrong_partner", "clock.offset", "clock", "duration", "residual", "range", must_not_pass=True)
def the_motor_of_another_recording(rng: Rng) -> Setup:
    """motor.csv and marker.csv of two different runs."""
    s = camera_setup(rng)
    a = s.actuator
    speeds = [length(a, v) for v in (0.8, 1.7)]
    other = motion.wander(rng, a.low, a.high, 50, speeds, length(a, 1.5), length(a, 4.0))

    def change(t: Array, q: Array) -> tuple[Array, Array]:
        return t, np.interp(t, other.t, other.q)

    s.motor.change = change
    return s


@condition("wrong_partner", "clock", "clock.offset", "range", "coarse", "residual", must_not_pass=True)
def another_axis_was_logged(rng: Rng) -> Setup:
    """The log holds a joint that has nothing to do with what is seen."""
    s = camera_setup(rng)
    a = s.actuator
    other = motion.sines(rng, a.low, a.high, s.recordings[0].duration, 0.21, 0.013, 0.3)
    s.motor.change = lambda t, q: (t, np.interp(t, other.t, other.q))
    return s
