"""The motor's log is not what the motor did."""

from __future__ import annotations

from tools.honesty.conditions.common import Rng, angle_setup, camera_setup, length
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import Setup

COARSE = ("encoder", "noise")


def _counts(rng: Rng, um: float) -> Setup:
    s = camera_setup(rng)
    s.actuator.resolution = length(s.actuator, um / 1000.0)
    return s


@condition("encoder_counts", *COARSE)
def counts_of_5_um(rng: Rng) -> Setup:
    return _counts(rng, 5.0)


@condition("encoder_counts", *COARSE)
def counts_of_20_um(rng: Rng) -> Setup:
    return _counts(rng, 20.0)


@condition("encoder_counts", *COARSE)
def counts_of_100_um(rng: Rng) -> Setup:
    return _counts(rng, 100.0)


@condition("encoder_counts", *COARSE)
def counts_coarser_than_told(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.resolution = length(s.actuator, 0.03)
    return s


@condition("motor_noise", "encoder", "noise")
def reading_noise_of_5_um(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.noise = length(s.actuator, 0.005)
    return s


@condition("motor_noise", "encoder", "noise")
def reading_noise_of_20_um(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.noise = length(s.actuator, 0.02)
    return s


@condition("motor_noise", "encoder", "noise")
def motor_that_trembles(rng: Rng) -> Setup:
    """The motor really moves; a log at 100 Hz sees some of it only."""
    s = camera_setup(rng)
    s.motor.vibration = length(s.actuator, 0.01)
    s.motor.vibration_hz = float(rng.uniform(25.0, 70.0))
    s.motor.rate_hz = 100.0
    return s


@condition("motor_noise", "actuator.encoder_periodic", "encoder")
def once_a_turn(rng: Rng) -> Setup:
    s = camera_setup(rng, seconds=120.0)
    s.motor.periodic = length(s.actuator, float(rng.uniform(0.02, 0.05)))
    s.motor.period = length(s.actuator, float(rng.uniform(0.8, 1.6)))
    return s


@condition("motor_logs", "rate", "encoder", "steps")
def motor_logged_at_10_hz(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.rate_hz = 10.0
    return s


@condition("motor_logs", "rate", "encoder", "steps")
def motor_logged_at_25_hz(rng: Rng) -> Setup:
    s = camera_setup(rng)
    s.motor.rate_hz = 25.0
    return s


@condition("motor_logs", "acquisition.delay", "clock.offset", "clock", "transmission.lag")
def commands_instead_of_positions(rng: Rng) -> Setup:
    """What is logged is ahead of the motor, beyond what a camera's nominal delay lets one expect."""
    s = camera_setup(rng)
    s.motor.lead_s = float(rng.uniform(0.06, 0.1))
    return s


@condition("motor_logs", "acquisition.delay", "clock.offset", "clock", "transmission.lag", "angle")
def commands_beside_an_angle_sensor(rng: Rng) -> Setup:
    """A servo's commands, and the joint that follows: all at 50 Hz."""
    s = angle_setup(rng, rate_hz=50.0, seconds=100.0)
    assert s.angle is not None
    s.motor.rate_hz, s.motor.lead_s = 50.0, float(rng.uniform(0.06, 0.1))
    s.angle.resolution_deg = 0.088
    return s
