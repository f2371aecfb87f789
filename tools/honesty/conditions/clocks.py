"""Motor and image do not share a clock, or frames do not come when they say."""

from __future__ import annotations

import numpy as np

from tools.honesty.conditions.common import Array, Rng, camera_setup, motions
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import ImageLog, Setup

RATE = ("clock.rate", "clock", "acquisition.clock_rate", "duration")
OFFSET = ("clock.offset", "clock", "acquisition.delay")
STAMPS = ("acquisition.jitter", "clock", "rate")


def _setup(rng: Rng, seconds: float = 120.0) -> tuple[Setup, ImageLog]:
    s = camera_setup(rng, seconds=seconds)
    assert s.image is not None
    return s, s.image


def _rate(rng: Rng, off: float) -> Setup:
    s, image = _setup(rng, 170.0)
    factor = 1.0 + float(rng.choice([-1.0, 1.0])) * off
    image.stamp = lambda t, _: t * factor
    return s


@condition("clock_rate", *RATE)
def clock_rate_off_by_1e_4(rng: Rng) -> Setup:
    return _rate(rng, 1e-4)


@condition("clock_rate", *RATE)
def clock_rate_off_by_1e_3(rng: Rng) -> Setup:
    return _rate(rng, 1e-3)


@condition("clock_rate", *RATE)
def clock_rate_off_by_a_percent(rng: Rng) -> Setup:
    return _rate(rng, float(rng.uniform(0.008, 0.02)))


@condition("clock_rate", *RATE, "clock.offset", "lost_frames", must_not_pass=True)
def sixty_one_seconds_beside_ninety(rng: Rng) -> Setup:
    """A container with another frame rate: all frames are there, their times are compressed."""
    s, image = _setup(rng, 90.0)
    share = float(rng.choice([61.0 / 90.0, 30.0 / 25.0, 25.0 / 30.0]))
    image.stamp = lambda t, _: t[0] + (t - t[0]) * share
    return s


@condition("clock_rate", *RATE, "acquisition.delay", "drift")
def exposure_drifts_by_20_ms(rng: Rng) -> Setup:
    s, image = _setup(rng)
    seconds, way = s.recordings[0].duration, float(rng.choice([-0.02, 0.02]))
    image.exposure = lambda t: way * np.clip(t / seconds, 0, 1)
    return s


def _offset(rng: Rng, by: float) -> Setup:
    s, image = _setup(rng)
    sign = float(rng.choice([-1.0, 1.0]))
    image.offset_s = sign * by
    return s


@condition("clock_offset", *OFFSET)
def image_clock_off_by_0_4_s(rng: Rng) -> Setup:
    return _offset(rng, float(rng.uniform(0.35, 0.45)))


@condition("clock_offset", *OFFSET)
def image_clock_off_by_2_s(rng: Rng) -> Setup:
    return _offset(rng, float(rng.uniform(1.5, 3.0)))


@condition("clock_offset", *OFFSET)
def image_clock_off_by_8_s(rng: Rng) -> Setup:
    return _offset(rng, float(rng.uniform(6.0, 9.0)))


@condition("clock_offset", *OFFSET)
def each_recording_its_own_offset(rng: Rng) -> Setup:
    """A camera whose offset changes at each start."""
    s = camera_setup(rng, seconds=60.0)
    s.recordings.append(motions(rng, s.actuator, 60.0))
    s.own_clocks = True
    assert s.image is not None
    offsets = iter(rng.uniform(0.1, 0.9, 2).tolist() + [0.0] * 8)
    s.image.stamp = lambda t, _: t + next(offsets)
    return s


@condition("clock_offset", "clock.offset", "clock", "acquisition.jitter", "lost_frames", "duration")
def image_clock_jumps(rng: Rng) -> Setup:
    s, image = _setup(rng)
    at, by = float(rng.uniform(0.3, 0.7)), float(rng.uniform(0.08, 0.2))
    image.stamp = lambda t, _: np.where(t > at * t[-1], t + by, t)
    return s


@condition("frame_times", *STAMPS)
def times_jitter_by_20_ms(rng: Rng) -> Setup:
    s, image = _setup(rng)

    def stamp(t: Array, rng: Rng) -> Array:
        late = t + np.abs(rng.normal(0, 0.02, len(t)))
        return np.maximum.accumulate(late) + 2e-6 * np.arange(len(t))

    image.stamp = stamp
    return s


@condition("frame_times", *STAMPS)
def frames_arrive_in_bunches(rng: Rng) -> Setup:
    s, image = _setup(rng)
    of = int(rng.integers(2, 5))

    def stamp(t: Array, rng: Rng) -> Array:
        last = np.minimum((np.arange(len(t)) // of + 1) * of - 1, len(t) - 1)
        return t[last] + 0.0008 * (np.arange(len(t)) % of)

    image.stamp = stamp
    return s


@condition(
    "frame_times", "lost_frames", "clock", "clock.rate", "acquisition.jitter", "acquisition.clock_rate", "duration"
)
def lost_frames_that_nobody_counted(rng: Rng) -> Setup:
    """Times are frame number / rate; some frames were dropped."""
    s, image = _setup(rng)
    assert s.camera is not None
    image.lost, rate = float(rng.uniform(0.004, 0.012)), s.camera.frame_rate
    image.stamp = lambda t, _: t[0] + np.arange(len(t)) / rate
    return s


@condition("frame_times", "lost_frames", "clock.rate", "clock", "rate", "acquisition.clock_rate", "duration")
def frame_rate_dips(rng: Rng) -> Setup:
    """A camera that makes fewer frames in the dark, with times that do not know."""
    s, image = _setup(rng)
    assert s.camera is not None
    rate = s.camera.frame_rate
    share, at = float(rng.uniform(0.02, 0.05)), float(rng.uniform(0.3, 0.6))

    def stamp(t: Array, rng: Rng) -> Array:
        k = np.arange(len(t)) / len(t)
        slow = np.clip((k - at) / 0.1, 0, 1) * 0.1 * share * len(t) / rate
        return t - slow

    image.stamp = stamp
    return s
