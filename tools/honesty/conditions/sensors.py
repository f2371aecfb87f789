"""What the tracker or the angle sensor says is not where the tip is."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from tools.honesty.conditions.common import Array, Rng, angle_setup, camera_setup, motions
from tools.honesty.conditions.registry import condition
from tools.honesty.setup import ImageLog, Setup

PLACE = ("tracker", "noise", "residual", "camera", "registration.static", "camera.distortion")
STRAY = ("outliers", "noise", "held_samples", "acquisition.held_samples")


def _setup(rng: Rng, seconds: float = 100.0) -> tuple[Setup, ImageLog]:
    s = camera_setup(rng, seconds=seconds)
    assert s.image is not None
    return s, s.image


def _rough(rng: Rng, rms: float, cell: float) -> object:
    """A field of tracker error over the picture, correlated over `cell` px: the same place, the same error."""
    n = 400
    step = 5.0
    fields = [gaussian_filter(rng.normal(0, 1, (n, n)), cell / step, mode="wrap") for _ in range(2)]
    fields = [rms * f / f.std() for f in fields]

    def error(uv: Array) -> Array:
        x, y = np.mod(uv[:, 0] / step, n - 1), np.mod(uv[:, 1] / step, n - 1)
        i, j = x.astype(int), y.astype(int)
        a, b = x - i, y - j
        out = [
            f[i, j] * (1 - a) * (1 - b)
            + f[i + 1, j] * a * (1 - b)
            + f[i, j + 1] * (1 - a) * b
            + f[i + 1, j + 1] * a * b
            for f in fields
        ]
        return np.stack(out, axis=1)

    return error


@condition("tracker", *PLACE)
def error_that_goes_with_the_place(rng: Rng) -> Setup:
    s, image = _setup(rng)
    image.noise_px = 0.03
    image.place_error = _rough(rng, float(rng.uniform(0.06, 0.1)), float(rng.uniform(6.0, 14.0)))  # type: ignore[assignment]
    return s


@condition("tracker", *PLACE)
def strong_error_that_goes_with_the_place(rng: Rng) -> Setup:
    s, image = _setup(rng)
    image.place_error = _rough(rng, float(rng.uniform(0.3, 0.5)), float(rng.uniform(10.0, 40.0)))  # type: ignore[assignment]
    return s


@condition("tracker", *PLACE)
def pulled_to_the_middle_of_pixels(rng: Rng) -> Setup:
    s, image = _setup(rng)
    by = float(rng.uniform(0.05, 0.12))
    image.place_error = lambda uv: by * np.sin(2 * np.pi * uv)
    return s


@condition("tracker", *PLACE, "held_samples", "steps")
def places_in_half_pixels(rng: Rng) -> Setup:
    s, image = _setup(rng)
    image.spoil = lambda t, uv, _: np.round(uv * 2) / 2
    return s


@condition("strays", *STRAY)
def one_in_fifty_is_elsewhere(rng: Rng) -> Setup:
    s, image = _setup(rng)

    def spoil(t: Array, uv: Array, rng: Rng) -> Array:
        hit = rng.random(len(uv)) < 0.02
        return np.where(hit[:, None], rng.uniform(0, 600, uv.shape), uv)

    image.spoil = spoil
    return s


@condition("strays", *STRAY)
def heavy_tails(rng: Rng) -> Setup:
    s, image = _setup(rng)
    image.spoil = lambda t, uv, rng: uv + 0.05 * rng.standard_t(2.2, uv.shape)
    return s


@condition("strays", *STRAY)
def another_blob_for_a_while(rng: Rng) -> Setup:
    """The tracker jumps to a reflection that moves along at some distance, and back."""
    s, image = _setup(rng)

    def spoil(t: Array, uv: Array, rng: Rng) -> Array:
        out = uv.copy()
        for _ in range(int(rng.integers(3, 7))):
            at = int(rng.integers(0, len(t)))
            n = int(rng.integers(8, 60))
            out[at : at + n] = 0.6 * uv[at : at + n] + 0.4 * uv.mean(axis=0) + rng.uniform(-80, 80, 2)
        return out

    image.spoil = spoil
    return s


@condition("strays", *STRAY)
def held_while_covered(rng: Rng) -> Setup:
    """An occlusion that the tracker does not tell: its last place is repeated, and valid."""
    s, image = _setup(rng, 120.0)

    def spoil(t: Array, uv: Array, rng: Rng) -> Array:
        out = uv.copy()
        for _ in range(int(rng.integers(6, 12))):
            at = int(rng.integers(1, len(t) - 60))
            out[at : at + int(rng.integers(8, 50))] = out[at - 1]
        return out

    image.spoil = spoil
    return s


@condition("strays", "held_samples", "acquisition.held_samples", "rate", "steps")
def every_place_three_times(rng: Rng) -> Setup:
    s, image = _setup(rng)
    of = int(rng.integers(2, 4))
    image.spoil = lambda t, uv, _: uv[(np.arange(len(uv)) // of) * of]
    return s


@condition("strays", *STRAY)
def noise_ten_times_in_places(rng: Rng) -> Setup:
    """Glare: for seconds the tracker is far worse than else."""
    s, image = _setup(rng)
    phase = float(rng.uniform(0, 6.28))
    image.noise_wave = lambda t: np.where(np.sin(t / 4.0 + phase) > 0.75, 12.0, 1.0)
    return s


@condition("angle_sensor", "rate", "angle", "coverage", "noise")
def angle_at_10_hz(rng: Rng) -> Setup:
    return angle_setup(rng, rate_hz=10.0, seconds=160.0)


@condition("angle_sensor", "acquisition.delay", "angle", "clock.offset", "clock", "transmission.lag")
def angle_80_ms_late(rng: Rng) -> Setup:
    s = angle_setup(rng, seconds=110.0)
    assert s.angle is not None
    s.angle.delay_s = float(rng.uniform(0.06, 0.1))
    return s


@condition("angle_sensor", "held_samples", "acquisition.held_samples", "angle", "rate", "steps")
def angle_sampled_and_held(rng: Rng) -> Setup:
    s = angle_setup(rng)
    assert s.angle is not None
    s.angle.held = int(rng.integers(3, 6))
    return s


@condition("angle_sensor", "noise", "angle", "steps", "held_samples")
def angle_in_steps_of_a_third_of_a_degree(rng: Rng) -> Setup:
    s = angle_setup(rng)
    assert s.angle is not None
    s.angle.noise_deg, s.angle.resolution_deg = 0.01, 0.35
    return s


@condition("angle_sensor", "outliers", "angle", "noise")
def angle_with_flagged_and_unflagged_strays(rng: Rng) -> Setup:
    s = angle_setup(rng, seconds=100.0)
    assert s.angle is not None
    bad: list[Array] = []

    def spoil(t: Array, c: Array, rng: Rng) -> Array:
        hit = (rng.random(len(c)) < 0.01).astype(float)
        bad[:] = [hit * (rng.random(len(c)) < 0.7)]
        return np.where(hit > 0, 0.0, c)

    s.angle.spoil = spoil
    s.angle.valid = lambda t, _: 1.0 - bad[0]
    return s


@condition("angle_sensor", "angle", "residual", "noise")
def angle_sensor_off_centre(rng: Rng) -> Setup:
    """Once a turn of the sensor: it goes with the place and is part of f_remain."""
    s = angle_setup(rng)
    assert s.angle is not None
    by, phase = float(rng.uniform(0.3, 0.8)), float(rng.uniform(0, 6.28))
    s.angle.error = lambda c: by * np.sin(np.radians(c) * 2 + phase)
    return s


@condition("angle_sensor", "angle", "clock", "clock.offset", "acquisition.delay")
def angle_and_camera_disagree_in_time(rng: Rng) -> Setup:
    from tools.honesty.setup import AngleLog

    s = camera_setup(rng)
    s.recordings = [motions(rng, s.actuator, 100.0)]
    s.angle = AngleLog(rate_hz=50.0, noise_deg=0.03, delay_s=float(rng.uniform(0.1, 0.2)))
    return s
