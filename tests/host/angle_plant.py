"""A joint with an angle sensor, in plain numpy: a play whose width depends on the place, a bent characteristic, and a
sensor that may be late, slow, sampled and held, or quantised."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tautline.recording import Angle, Motor, Recording
from tautline.rig import Actuator, AngleSensor, Coarse, Rig

RIG = Rig(Actuator("deg", (-40.0, 40.0), 0.01), Coarse(1.0, 0.0))
TURNS = (-35, 35, -30, 25, -35, -5, -25, 10, -10, 35, 0, 20, -35, 35, -35)
_GRID = np.linspace(-60.0, 60.0, 24001)


def width(p: np.ndarray) -> np.ndarray:
    return 2.0 + 0.5 * np.sin(p / 15.0)


def bend(p: np.ndarray) -> np.ndarray:
    return 0.95 * p + 2.0 * np.sin(p / 20.0)


def tip(q: np.ndarray) -> np.ndarray:
    low = np.interp(q, _GRID + 0.5 * width(_GRID), _GRID).tolist()
    high = np.interp(q, _GRID - 0.5 * width(_GRID), _GRID).tolist()
    state, path = float(q[0]), []
    for least, most in zip(low, high, strict=True):
        state = min(max(state, least), most)
        path.append(state)
    return bend(np.array(path))


@dataclass(frozen=True)
class Motion:
    t_s: np.ndarray  # 1 kHz
    q: np.ndarray

    @classmethod
    def through(cls, turns=TURNS, speed: float = 8.0) -> "Motion":
        parts = [np.full(500, float(turns[0]))]
        for a, b in pairwise(turns):
            parts.append(np.linspace(a, b, max(1, int(abs(b - a) / speed * 1000)), endpoint=False))
        q = np.concatenate([*parts, np.full(500, float(turns[-1]))])
        return cls(np.arange(len(q)) / 1000.0, q)

    @classmethod
    def steps(cls, levels, dwell_s: float) -> "Motion":
        t_s = np.arange(0.0, dwell_s * len(levels), 1e-3)
        return cls(t_s, np.asarray(levels, dtype=float)[(t_s / dwell_s).astype(int)])

    def then(self, other: "Motion") -> "Motion":
        return Motion(np.concatenate([self.t_s, other.t_s + self.t_s[-1] + 1e-3]), np.concatenate([self.q, other.q]))


def record(
    motion: Motion,
    *,
    sensor_hz: float = 100.0,
    delay_s: float = 0.0,
    noise: float = 0.01,
    hold_hz: float | None = None,
    quantum: float = 0.0,
    motor_hz: float = 1000.0,
    rig: Rig = RIG,
    seed: int = 0,
) -> Recording:
    rng = np.random.default_rng(seed)
    arrival = np.arange(motion.t_s[0] + 0.013, motion.t_s[-1] + delay_s - 0.01, 1.0 / sensor_hz)
    sampled = arrival if hold_hz is None else np.floor(arrival * hold_hz + 1e-9) / hold_hz
    unique, of = np.unique(sampled, return_inverse=True)
    c = np.interp(unique - delay_s, motion.t_s, tip(motion.q)) + noise * rng.normal(size=len(unique))
    if quantum:
        c = np.round(c / quantum) * quantum
    stride = round(1000.0 / motor_hz)
    resolution = rig.actuator.encoder_resolution
    motor = Motor(motion.t_s[::stride], np.round(motion.q[::stride] / resolution) * resolution)
    return Recording("joint", motor, angle=Angle(arrival, c[of]), rig=rig)


def stated(delay_s: float) -> Rig:
    return Rig(RIG.actuator, RIG.coarse, angle=AngleSensor(delay_s))
