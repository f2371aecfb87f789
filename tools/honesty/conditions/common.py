"""The instruments that conditions start from: drawn anew for each seed, nothing wrong with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tools.honesty import motion
from tools.honesty.motion import Motion
from tools.honesty.optics import Camera, drawn_camera
from tools.honesty.plant import Curve, Play
from tools.honesty.setup import Actuator, AngleLog, ImageLog, MotorLog, Setup

Array = NDArray[np.float64]
Rng = np.random.Generator

LENSES = (
    Camera(),
    Camera(
        width=640,
        height=480,
        fx=430.0,
        fy=432.0,
        cx=318.0,
        cy=243.0,
        frame_rate=30.0,
        delay=0.06,
        bending=22.0,
        tip=5.0,
    ),
    Camera(
        width=960, height=720, fx=700.0, fy=700.0, cx=470.0, cy=365.0, frame_rate=28.0, delay=0.1, bending=16.0, tip=8.0
    ),
)


def actuator(rng: Rng, unit: str = "mm") -> Actuator:
    resolution = float(rng.choice([0.0002, 0.0005, 0.001]))
    if unit == "mm":
        half = float(rng.choice([4.0, 5.0, 6.0]))
        middle = float(rng.choice([0.0, 0.0, half]))
        return Actuator("mm", middle - half, middle + half, resolution)
    half = float(rng.choice([60.0, 80.0]))
    return Actuator("deg", -half, half, 0.02, um_per_unit=float(rng.uniform(70.0, 90.0)))


def length(a: Actuator, mm: float) -> float:
    """mm of cable in the actuator's unit."""
    return mm * 1000.0 / a.um_per_unit


def width_curve(rng: Rng, a: Actuator, smallest: float = 0.25, largest: float = 0.6, bump: float = 0.4) -> Curve:
    """mm of cable: a level, a slope and a bump near the straight pose, gentle enough that B' stays far below 2."""
    span = a.high - a.low
    middle = (a.low + a.high) / 2
    level, lean = length(a, rng.uniform(smallest, largest)), float(rng.uniform(-0.25, 0.25))
    top, at = length(a, rng.uniform(0.2, 1.0) * bump), middle + float(rng.uniform(-0.12, 0.12)) * span
    broad = float(rng.uniform(0.1, 0.17)) * span

    def width(p: Array) -> Array:
        p = np.clip(p, a.low - 0.2 * span, a.high + 0.2 * span)
        return level * (1 + lean * (p - middle) / span) + top * np.exp(-(((p - at) / broad) ** 2) / 2)

    return width


def law_curve(rng: Rng, a: Actuator, bend: float, sign: float = 1.0, dead: float = 0.4) -> tuple[Curve, float, float]:
    """(f_remain, told gain, told offset): over the range by 2 * bend deg, flatter near the straight pose."""
    span, middle = a.high - a.low, (a.low + a.high) / 2
    flat, near = float(rng.uniform(0, dead)), float(rng.uniform(0.06, 0.12)) * span
    wave, phase = float(rng.uniform(0.0, 0.05)), float(rng.uniform(0, 6.28))
    gain = sign * 2 * bend / span
    lift = float(rng.uniform(-4.0, 4.0))

    def law(p: Array) -> Array:
        x = p - middle
        return (
            gain * (x - flat * near * np.tanh(x / near) + wave * span / 6.28 * np.sin(6.28 * x / span + phase)) + lift
        )

    told = gain * float(rng.uniform(0.9, 1.1))
    return law, told, lift + float(rng.uniform(-3.0, 3.0)) - told * middle


def motions(rng: Rng, a: Actuator, seconds: float = 100.0, edge: float = 0.0) -> Motion:
    """A calibration as people make it: strokes of several speeds over the whole range, in one of three styles."""
    low, high = a.low + edge, a.high - edge
    speeds = [length(a, v) for v in rng.uniform(0.8, 1.2) * np.array([0.7, 1.4, 2.8])]
    style, span = int(rng.integers(0, 3)), high - low
    stroke = float(rng.uniform(0.17, 0.26)) * span
    if style == 0:
        return motion.ramp_strokes(rng, low, high, stroke, _count(seconds, stroke, speeds, span), speeds)
    if style == 1:
        count = int(seconds / (0.35 * span / np.mean(speeds)))
        return motion.wander(rng, low, high, count, speeds, 0.16 * span, 0.45 * span)
    first = motion.sweeps(rng, low, high, speeds[1:])
    rest = seconds - first.duration
    return motion.joined(
        [first, motion.ramp_strokes(rng, low, high, stroke, _count(rest, stroke, speeds, span), speeds)]
    )


def _count(seconds: float, stroke: float, speeds: Sequence[float], span: float) -> int:
    """Strokes back and forth that fit: both ways, and the ramp itself."""
    each = 2 * stroke * float(np.mean(1 / np.asarray(speeds)))
    return max(10, int((seconds - 3 * span / float(np.mean(speeds))) / each))


def test_motion(rng: Rng, a: Actuator, edge: float = 0.0, speed: float = 1.6) -> Motion:
    inset = 0.04 * (a.high - a.low) + edge
    return motion.teleoperated(rng, a.low + inset, a.high - inset, 35.0, length(a, speed))


def camera_setup(
    rng: Rng, unit: str = "mm", sign: float = 1.0, lens: Camera | None = None, seconds: float = 100.0, **shape: float
) -> Setup:
    """An instrument under an endoscope. `shape` goes to its width curve."""
    a = actuator(rng, unit)
    width = width_curve(rng, a, **shape)
    bend = float(rng.uniform(38.0, 52.0))
    law, gain, offset = law_curve(rng, a, bend, sign)
    base = lens or LENSES[int(rng.integers(0, len(LENSES)))]
    camera = drawn_camera(rng, base, (-bend - 9.0, bend + 9.0))
    return Setup(
        rng=rng,
        actuator=a,
        width=width,
        hysteresis=Play(width),
        law=law,
        gain=gain,
        offset=offset,
        recordings=[motions(rng, a, seconds)],
        test=test_motion(rng, a),
        camera=camera,
        image=ImageLog(
            noise_px=float(rng.uniform(0.04, 0.08)), delay_s=camera.delay + float(rng.uniform(-0.008, 0.008))
        ),
        motor=MotorLog(rate_hz=float(rng.choice([200.0, 500.0, 1000.0]))),
    )


def angle_setup(rng: Rng, unit: str = "deg", sign: float = 1.0, seconds: float = 80.0, rate_hz: float = 100.0) -> Setup:
    """A joint with an external angle sensor and no camera."""
    setup = camera_setup(rng, unit, sign, seconds=seconds)
    setup.camera = setup.image = None
    setup.angle = AngleLog(rate_hz=rate_hz, noise_deg=float(rng.uniform(0.015, 0.03)))
    return setup


def slower(setup: Setup, factor: float) -> None:
    """All recorded motions at a fraction of their speed."""
    for k, m in enumerate(setup.recordings):
        t = np.arange(0, m.duration / factor, motion.STEP_S)
        setup.recordings[k] = Motion(t, np.interp(t * factor, m.t, m.q))
