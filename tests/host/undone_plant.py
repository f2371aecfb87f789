"""A small instrument with one effect at a time, in float64, a sample after the other: none of the package's code."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

GAIN = 12.0  # deg per mm
WAVE = 5.0  # mm


@dataclass
class Plant:
    """The motor's reading (mm) to the tip's angle (deg): a play of mean width `width`, f = GAIN p, and one effect."""

    width: float
    wave: float = 0.0  # by this share of it the width varies over WAVE mm
    rate_hz: float = 1000.0
    encoder: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 1.0)  # sin, cos, sin2, cos2, turn
    side: int = 0  # that has to move on by `late` more, caught up exponentially within `travel` of the motor's way
    late: float = 0.0
    travel: float = 1.0
    pressed: float = 0.0  # share of `late` and of `per_speed` that goes with the place as the width does
    renewed: float = math.inf  # s: after longer rests it has to again
    per_speed: float = 0.0  # s: width for each mm/s
    per_speed_time: float = 0.02
    per_speed_end: float = math.inf  # mm/s, at which the width has grown by 63 % of all that speed can add
    lag: tuple[float, ...] = ()  # s, of each stage
    creep: tuple[tuple[float, float], ...] = ()  # share and time of each element
    offset: float = 0.0
    scale: float = 1.0
    gain: float = 1.0  # of the angle
    beside: float = 0.0  # deg that something else adds
    before: float = 0.0  # mm by which something else moves the motor
    p: float = math.nan
    _x: float = 0.0
    _carried: int = 0
    _rested: float = 0.0
    _speed: float = 0.0
    _before: float = math.nan
    _stages: list[float] = field(default_factory=list)
    _elements: list[float] = field(default_factory=list)

    def wide(self, p: float) -> float:
        """The width there over its mean."""
        return 1.0 + self.wave * math.sin(2 * math.pi * p / WAVE)

    def press(self, p: float) -> float:
        return max(1.0 + self.pressed * (self.wide(p) - 1.0), 0.0)

    def error(self, x: float) -> float:
        a, b, a2, b2, turn = self.encoder
        t = 2 * math.pi * x / turn
        return a * math.sin(t) + b * math.cos(t) + a2 * math.sin(2 * t) + b2 * math.cos(2 * t)

    def shaft(self, reading: float) -> float:
        reach = sum(map(abs, self.encoder[:4]))
        low, high = reading - reach, reading + reach
        for _ in range(25 if reach else 0):
            middle = 0.5 * (low + high)
            if middle - self.error(middle) < reading:
                low = middle
            else:
                high = middle
        return 0.5 * (low + high)

    def step(self, reading: float) -> float:
        q = self.shaft(reading) + self.offset + self.before
        if math.isnan(self.p):
            self.p, self._before = q, q
            self._stages, self._elements = [q] * len(self.lag), [q] * len(self.creep)
        dt = 1.0 / self.rate_hz
        moved = q - self._before
        self._before = q
        if moved:
            self._speed += (moved / dt - self._speed) * -math.expm1(-dt / self.per_speed_time)
        speed, end = abs(self._speed), self.per_speed_end
        added = self.per_speed * (speed if math.isinf(end) else end * (1.0 - math.exp(-speed / end)))
        pushed = moved != 0.0 and self._push(q, 1 if moved > 0.0 else -1, added)
        self._rested = 0.0 if pushed else self._rested + dt
        return self._angle(dt)

    def _reach(self, p: float, added: float, held: float) -> float:
        """How far the motor is beyond p when its end carries there."""
        return 0.5 * (self.scale * self.width * self.wide(p) + added * self.press(p)) + held * self.press(p)

    def _push(self, q: float, s: int, added: float) -> bool:
        """The end on side s, from which it has been carried by _x of the motor's way; whether it carries."""
        x = self._x if self._carried == s and not self._rested > self.renewed + 1e-9 else 0.0
        late = self.late if s == self.side else 0.0
        beyond = s * (q - self.p) - self._reach(self.p, added, late * math.exp(-x / self.travel))
        if beyond > 0.0:
            self._x, self._carried = x + beyond, s
            held = late * math.exp(-self._x / self.travel)
            for _ in range(25 if self.wave else 1):  # the reach changes by less than the place
                self.p = q - s * self._reach(self.p, added, held)
        return beyond > 0.0

    def _angle(self, dt: float) -> float:
        tip = self.p
        for i, time in enumerate(self.lag):
            before = self._stages[i]
            self._stages[i] += (tip - before) * -math.expm1(-dt / time)
            tip = self._stages[i]
        late = 0.0
        for i, (share, time) in enumerate(self.creep):
            self._elements[i] += (tip - self._elements[i]) * -math.expm1(-dt / time)
            late += share * (tip - self._elements[i])
        return GAIN * (tip - late) * self.gain + self.beside

    def run(self, readings: np.ndarray) -> np.ndarray:
        return np.array([self.step(float(q)) for q in readings])
