"""Robots of one make: B spread by 30 % between them, wear by use, and a batch that wears sooner."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from tautline.recording import Recording, save
from tautline.rig import Rig
from tautline.simulated.instrument import Instrument, reference_rig
from tautline.simulated.simulate import simulate
from tautline.trajectory import Trajectory, back_and_forth
from tautline.vision.timing import FrameTiming

Array = npt.NDArray[np.float64]

WORN = "worn"  # a batch's name
_LEVEL, _SHAPE, _PLACES = 0.27, 0.08, (-0.7, -0.2, 0.3, 0.8)  # of log B: one of all q, and at each of four places
_LAW = 0.04  # of f_remain's slope, at the same places
_WEAR, _SOONER = 0.006, 0.05  # growth of B a session, usual and of a worn batch
_USE = 0.4  # spread of the use between two sessions
_TURNS = 20  # that find the speed of a motion
_EVERY = 4  # of the simulation's samples at 1 kHz


def _bump(x: Array, at: float, spread: float) -> Array:
    return np.asarray(np.exp(-0.5 * ((x - at) / spread) ** 2))


@dataclass(frozen=True)
class Robot:
    """One robot, by its number in a fleet of this seed."""

    seed: int
    number: int
    worn: bool = False
    late_s: float = 0.0  # by which its camera's delay is more than the rig says
    bent: float = 0.0  # of f_remain's slope, at a place and as narrow as in no fleet

    def instrument(self, session: int, rig: Rig) -> Instrument:
        """As it is at a session, counted from 0."""
        rng = np.random.default_rng([self.seed, self.number, 0xF1])
        level, shape, law = rng.normal(0.0, _LEVEL), rng.normal(0.0, _SHAPE, 4), rng.normal(0.0, _LAW, 4)
        works_at = rng.uniform(-0.6, 0.6)
        use = float(np.sum(rng.lognormal(0.0, _USE, 64)[:session]))
        wear = (_SOONER if self.worn else _WEAR) * use
        low, high = rig.actuator.range
        middle, half = 0.5 * (low + high), 0.5 * (high - low)

        def backlash(p: Array) -> Array:
            x = (p - middle) / half
            usual = 0.07 + 0.01 * x + 0.05 * _bump(x, 0.06, 0.25)
            log = level + sum(size * _bump(x, at, 0.35) for size, at in zip(shape, _PLACES, strict=True))
            return np.asarray(half * usual * np.exp(log) * (1.0 + wear * (0.6 + 0.8 * _bump(x, works_at, 0.3))))

        def remaining(p: Array) -> Array:
            x = (p - middle) / half
            bent = sum(size * _bump(x, at, 0.35) for size, at in zip(law, _PLACES, strict=True))
            bent += self.bent * _bump(x, 0.05, 0.12)
            return np.asarray(rig.coarse.gain * (0.9 * (p - middle) + 0.35 * half * bent))

        return Instrument.of(rig, backlash, remaining, f"robot-{self.number}")

    def recording(self, session: int, seconds: float, rig: Rig) -> Recording:
        """A calibration's motion of about so many seconds."""
        seed = self.number * 101 + session
        made = simulate(
            rig,
            self.instrument(session, rig),
            motion(rig, seconds),
            timing=FrameTiming.of(rig, delay_s=rig.delay_s + self.late_s, seed=seed),
            seed=seed,
            name=str(session),
        )
        motor = made.motor
        every = slice(None, None, _EVERY)
        return replace(made, motor=replace(motor, t_s=motor.t_s[every], q=motor.q[every], q_cmd=None))


def motion(rig: Rig, seconds: float) -> Trajectory:
    """Once up the range and down again, back a little four times each way, in so many seconds to 1 %."""
    span = rig.actuator.span
    speed = 4.0 * span / seconds
    for _ in range(_TURNS):
        made = back_and_forth(rig.actuator, (speed,), 0.3 * span, 8, 16.0 * span, 0.02)
        if abs(made.duration_s / seconds - 1.0) < 0.01:
            break
        speed *= made.duration_s / seconds
    return made


def write(folder: Path, robots: int, sessions: int, worn: int, seed: int, seconds: float) -> list[str]:
    """FOLDER/ROBOT/SESSION, robots.csv with their batches. The names of the robots of the worn batch, which are spread
    over the fleet."""
    rig = reference_rig()
    folder.mkdir(parents=True, exist_ok=True)
    rig.save(folder / "rig.toml")
    chosen = set(np.random.default_rng([seed, 0xBA]).permutation(robots)[:worn].tolist())
    lines = ["robot,batch"]
    for number in range(robots):
        name = f"r{number:04d}"
        lines.append(f"{name},{WORN if number in chosen else f'b{number % 12:02d}'}")
        robot = Robot(seed, number, number in chosen)
        for session in range(sessions):
            at = folder / name / f"{session:02d}"
            if not at.exists():
                begun = at.with_name(f".{at.name}")  # whole or not at all, if this is interrupted
                save(robot.recording(session, seconds, rig), begun)
                begun.rename(at)
    (folder / "robots.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [f"r{number:04d}" for number in sorted(chosen)]
