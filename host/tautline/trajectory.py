"""Motor trajectories: the paper's calibration and test motions, and others, sampled at 1 kHz."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tautline.errors import TautError
from tautline.rig import Actuator

# equation of all: shapes of motions, none of which decides

Array = np.ndarray

RATE_HZ = 1000.0
NEXT_FILE = "next_motion.csv"  # in the folder of a model or a diagnosis: the motion to record next
_APART = 1.618  # format: of two periods, by the golden ratio: the sines never repeat together
_SINES = 0.60, 0.35  # format: of half the range, their sizes
_LONGEST_S = 86_400.0  # limit: of one motion: all of its samples are in memory


@dataclass(frozen=True)
class Trajectory:
    """True positions of an instrument's motors. All arrays have one length; t_s starts at 0 and rises by 1 ms."""

    t_s: Array
    q: Array  # bending motor, the rig's unit
    translation_mm: Array | None = None  # None = 0
    rotation_deg: Array | None = None  # None = 0

    @property
    def duration_s(self) -> float:
        """How long the motion lasts, s, from 0 to its last sample."""
        return float(self.t_s[-1])

    def with_sway(self, translation_mm: float, rotation_deg: float, period_s: float) -> Trajectory:
        """The same bending while the instrument oscillates along and about the base z axis with these amplitudes.
        Translation has period_s, s; rotation is slower by the golden ratio, so that the two never repeat together. An
        amplitude of 0 leaves that axis out."""
        phase = 2 * np.pi * self.t_s / period_s
        return replace(
            self,
            translation_mm=translation_mm * np.sin(phase) if translation_mm else None,
            rotation_deg=rotation_deg * np.sin(phase / _APART) if rotation_deg else None,
        )


def _samples(duration_s: float) -> Array:
    """(n,) The times, s, of a motion's samples, from 0 to its end. TautError for a duration, s, below 0 or above
    _LONGEST_S."""
    if not 0.0 <= duration_s <= _LONGEST_S:
        raise TautError(f"a motion lasts {duration_s:.6g} s: expected {_LONGEST_S:.0f} s at most")
    return np.arange(int(duration_s * RATE_HZ) + 1) / RATE_HZ


def _check_speed(speed: float) -> None:
    """Raises TautError for a speed, unit/s, that is not above 0 and finite."""
    if not 0.0 < speed < np.inf:
        raise TautError(f"a motion's speed is {speed:g}: expected one above 0")


def through(
    points: Sequence[float] | Array, speed: float | Sequence[float], acceleration: float, dwell_s: float = 0.0
) -> Trajectory:
    """A motion through `points` (k,), unit of q, that rests for dwell_s, s, at each, with a trapezoidal profile of
    speed on each stroke. speed: unit/s, one for all, or one for each of the k - 1 strokes; acceleration: unit/s^2.
    TautError for fewer than two points and for values that no motion can have."""
    points = np.asarray(points, dtype=np.float64)
    moves = len(points) >= 2 and np.isfinite(points).all() and np.all(np.asarray(speed) > 0.0)
    if not (moves and 0.0 < acceleration < np.inf and dwell_s >= 0.0):
        raise TautError("a motion needs two points or more, speed and acceleration above 0 and a dwell of 0 or more")
    stroke = np.diff(points)
    reach = np.abs(stroke)
    top = np.minimum(speed, np.sqrt(acceleration * reach))  # short strokes never reach their speed
    ramp = top / acceleration
    cruise = np.divide(reach, top, out=np.zeros_like(reach), where=top > 0) - ramp
    # Each stroke: speed up, cruise, slow down, wait; how long, s, and at which acceleration, `pull`, unit/s^2.
    duration = np.column_stack([ramp, np.maximum(cruise, 0.0), ramp, np.full_like(ramp, dwell_s)]).ravel()
    pull = np.column_stack([np.sign(stroke), 0 * ramp, -np.sign(stroke), 0 * ramp]).ravel() * acceleration
    start = np.concatenate([[0.0], np.cumsum(duration)])
    velocity = np.concatenate([[0.0], np.cumsum(pull * duration)])[:-1]
    position = points[0] + np.concatenate([[0.0], np.cumsum((velocity + 0.5 * pull * duration) * duration)])[:-1]
    t = _samples(float(start[-1]))
    phase = np.clip(np.searchsorted(start, t, side="right") - 1, 0, len(duration) - 1)
    since = t - start[phase]
    return Trajectory(t, position[phase] + (velocity[phase] + 0.5 * pull[phase] * since) * since)


def in_turn(*parts: Trajectory) -> Trajectory:
    """One motion of several bending motions one after the other, without translation and rotation. Each has to begin
    where the one before it ends."""
    q = np.concatenate([part.q for part in parts])
    return Trajectory(np.arange(len(q)) / RATE_HZ, q)


def back_and_forth(
    actuator: Actuator,
    speeds: Sequence[float],
    stroke: float,
    reversals: int,
    acceleration: float,
    dwell_s: float = 0.0,
) -> Trajectory:
    """The paper's calibration motion: short strokes on a ramp over the whole range, up and down again at each speed.

    stroke: the longer, ramp-wise one, in the rig's unit; it must be longer than the backlash and a slow start.
    reversals: on one way up or down. speeds: unit/s; acceleration: unit/s^2; dwell_s: the rest at each reversal.
    """
    low, high = actuator.range
    pairs = max(1, reversals // 2)
    advance = (high - low - stroke) / pairs
    if not 0 < advance <= stroke:
        raise TautError(
            f"strokes of {stroke:g} {actuator.unit} with {reversals} reversals do not make a ramp over the range: "
            f"choose a stroke from {(high - low) / (pairs + 1):.3g} to below {high - low:g} {actuator.unit}"
        )
    forward = low + advance * np.arange(pairs + 1) + stroke
    back = low + advance * np.arange(1, pairs + 1)
    up = np.empty(2 * pairs + 2)
    up[0], up[1::2], up[2::2] = low, forward, back
    down = low + high - up
    points, stroke_speeds = [up[:1]], []
    for speed in speeds:
        for way in (up, down):
            points.append(way[1:])
            stroke_speeds += [speed] * (len(way) - 1)
    return through(np.concatenate(points), stroke_speeds, acceleration, dwell_s)


def trapezoids(
    actuator: Actuator, speed: float, amplitude: float, cycles: int, acceleration: float, dwell_s: float
) -> Trajectory:
    """The paper's test motion (Fig. 10): `cycles` trapezoids of `amplitude` (peak to peak, unit of q) about a mean that
    rises over the range. speed: unit/s; acceleration: unit/s^2; dwell_s: the rest at each turn, s. TautError where the
    amplitude does not fit the range."""
    low, high = actuator.range
    if not 0 < amplitude < high - low:
        raise TautError(f"an amplitude of {amplitude:g} {actuator.unit} does not fit the range [{low:g}, {high:g}]")
    mean = np.linspace(low + amplitude / 2, high - amplitude / 2, 2 * cycles)
    points = mean + amplitude / 2 * np.where(np.arange(2 * cycles) % 2, 1.0, -1.0)
    return through(points, speed, acceleration, dwell_s)


def sines(actuator: Actuator, speed: float, duration_s: float) -> Trajectory:
    """A sum of two sines about the middle of the range, of 60 and 35 % of half the range, whose periods differ by the
    golden ratio, so that they never repeat together. At its fastest it goes at `speed`, unit/s. TautError for a speed
    or a duration that no motion can have."""
    _check_speed(speed)
    low, high = actuator.range
    half = 0.5 * (high - low)
    first, second = _SINES
    rate = speed / (half * (first + second / _APART))  # equation: both are fastest at t = 0
    t = _samples(duration_s)
    return Trajectory(t, 0.5 * (low + high) + half * (first * np.sin(rate * t) + second * np.sin(rate * t / _APART)))


def random_smooth(actuator: Actuator, speed: float, duration_s: float, seed: int) -> Trajectory:
    """A smooth random motion over the range with reversals anywhere. speed: its greatest, unit/s, within some 20 %;
    seed: of the random numbers. TautError for a speed or a duration that no motion can have."""
    _check_speed(speed)
    low, high = actuator.range
    rng = np.random.default_rng([seed, 0x7247])
    rates = np.exp(rng.uniform(np.log(0.4), np.log(2.5), 9))  # rad per unit of the wander's own time
    sizes = rng.uniform(0.5, 1.0, 9) / rates
    sizes /= np.sqrt(0.5 * np.sum(sizes**2))  # rms 1
    phases = rng.uniform(0.0, 2 * np.pi, 9)

    def wander(own: Array) -> Array:
        """Positions (n,) at the wander's own times (n,): a sum of sines, kept within 97 % of the range by a tanh."""
        wave = np.sum([a * np.sin(w * own + f) for a, w, f in zip(sizes, rates, phases, strict=True)], axis=0)
        q: Array = 0.5 * (low + high) + 0.97 * 0.5 * (high - low) * np.tanh(0.75 * wave)
        return q

    sample = np.linspace(0.0, 200.0, 20001)
    fastest = np.abs(np.gradient(wander(sample), sample)).max()
    t = _samples(duration_s)
    return Trajectory(t, wander(t * speed / fastest))
