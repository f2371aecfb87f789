"""Real videos, short: codecs, glare, cover, a twin, another size, no times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tools.honesty import motion
from tools.honesty.conditions.common import LENSES, Rng, camera_setup, length
from tools.honesty.conditions.registry import condition
from tools.honesty.optics import Camera
from tools.honesty.render import Film
from tools.honesty.setup import Setup

SEEN = ("tracker", "noise", "residual", "camera", "repeatability")


SMALL = replace(LENSES[1], width=480, height=360, fx=330.0, fy=330.0, cx=239.0, cy=181.0, frame_rate=25.0, delay=0.08)


def _filmed(rng: Rng, film: Film, seconds: int = 32, lens: Camera = SMALL) -> Setup:
    s = camera_setup(rng, lens=lens)
    a = s.actuator
    speeds = [length(a, v) for v in (2.2, 3.4)]
    s.recordings = [
        motion.ramp_strokes(rng, a.low, a.high, 0.3 * (a.high - a.low), max(6, int(seconds / 2.6)), speeds),
    ]
    s.test = motion.teleoperated(rng, a.low + 0.3, a.high - 0.3, 20.0, length(a, 1.6))
    assert s.image is not None
    s.image.noise_px = 0.06  # what predictions are compared with
    s.image.delay_s = lens.delay + float(rng.uniform(-0.006, 0.006))
    s.video = film
    return s


@condition("video", *SEEN)
def mjpeg(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv"))


@condition("video", *SEEN)
def mjpeg_on_a_plain_wall(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv", textured=False))


@condition("video", *SEEN)
def mpeg4(rng: Rng) -> Setup:
    return _filmed(rng, Film("mp4v", "mp4"))


@condition("video", *SEEN, needs="av")
def h264(rng: Rng) -> Setup:
    return _filmed(rng, Film("h264", "mp4"))


@condition("video", *SEEN, needs="av")
def h264_of_few_bits(rng: Rng) -> Setup:
    return _filmed(rng, Film("h264", "mkv", crf=33))


@condition("video", *SEEN)
def mjpeg_full_hd(rng: Rng) -> Setup:
    lens = Camera(1920, 1080, 1150.0, 1150.0, 962.0, 537.0, frame_rate=30.0, delay=0.09)
    return _filmed(rng, Film("MJPG", "mkv", radius_px=20.0), 20, lens)


@condition("video", *SEEN, "outliers")
def glare(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv", glare=True))


@condition("video_trouble", *SEEN, "outliers", "coverage")
def covered_now_and_then(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv", covered=0.12), 40)


@condition("video_trouble", *SEEN, "outliers", "two_markers")
def a_twin_lies_still(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv", twin=True))


@condition("video_trouble", "frame_size", "camera", "registration.static", "registration", must_not_pass=True)
def frames_of_half_the_size(rng: Rng) -> Setup:
    return _filmed(rng, Film("MJPG", "mkv", scale=0.5, radius_px=14.0))


@condition("video_trouble", "clock.offset", "clock", "acquisition.delay", "duration")
def no_times_beside_the_video(rng: Rng) -> Setup:
    """The container's clock starts at 0; the motor's log began some seconds before the camera."""
    before = float(rng.uniform(0.4, 2.5))
    s = _filmed(rng, Film("MJPG", "mkv", times=False, motor_first_s=before))
    s.motor.change = lambda t, q: (t + before, q)
    return s


@condition("video_trouble", "acquisition.jitter", "clock", "rate")
def variable_rate(rng: Rng) -> Setup:
    """Times are the arrivals at a computer that is busy now and then."""
    s = _filmed(rng, Film("MJPG", "mkv"))
    assert s.image is not None
    s.image.lost = 0.08
    s.image.stamp = lambda t, rng: np.maximum.accumulate(t + rng.exponential(0.004, len(t))) + 2e-6 * np.arange(len(t))
    return s
