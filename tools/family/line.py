"""The time line of a case: every recording and the gaps between them as one motion, on one grid of instants."""

from dataclasses import dataclass

import numpy as np
from tools.family.motion import STEP


@dataclass(frozen=True)
class Part:
    """One recording: its motions each millisecond from `begin` on the case's clock, and its frames' scene times."""

    name: str  # calibration, test-1 .. test-3, unseen
    begin: float
    q: np.ndarray
    sides: dict[str, np.ndarray]  # translation_mm, rotation_deg, load_mNm, wrist_deg
    frames: np.ndarray  # scene times on the case's clock

    @property
    def end(self) -> float:
        return self.begin + (self.q.size - 1) * STEP


@dataclass(frozen=True)
class Line:
    """Arrays over all instants at which the mechanism is solved, (n,): the frames, and enough between them."""

    t: np.ndarray  # s on the case's clock
    q: np.ndarray  # true motor position
    speed: np.ndarray  # of the motor, unit/s, over 40 ms
    sides: dict[str, np.ndarray]
    part: np.ndarray  # index of the recording an instant belongs to; a gap belongs to the recording after it
    frame: np.ndarray  # bool: this instant is a frame
    names: tuple[str, ...]
    begins: tuple[float, ...]
    reach: float
    width: float  # nominal, of the motor
    gain: float  # deg of the tip per unit of the motor
    joints: bool = False  # the bending section is a chain of joints of its own friction

    @property
    def tested(self) -> float:
        """Start of the first recording that is not the calibration."""
        return min(b for n, b in zip(self.names, self.begins, strict=True) if n != "calibration")

    @property
    def used(self) -> np.ndarray:
        """1 from the first test on, 0 during the calibration."""
        return np.array([n != "calibration" for n in self.names], dtype=float)[self.part]

    @property
    def past(self) -> np.ndarray:
        """Seconds since the first test began; 0 before."""
        return np.maximum(self.t - self.tested, 0.0)

    @property
    def usual(self) -> float:
        """Usual speed of the motor when it moves."""
        return float(np.median(np.abs(self.speed[np.abs(self.speed) > 0.02 * self.reach])))


def lay(parts: list[Part], reach: float, width: float, gain: float, joints: bool = False, rate: float = 30.0) -> Line:
    """Joins parts, with smooth moves over the gaps; `rate` instants per second between the frames, and every turn."""
    times, motors, owner, frames = [], [], [], []
    sides: dict[str, list[np.ndarray]] = {name: [] for name in parts[0].sides}
    last_q, last_end, last_sides = parts[0].q[0], parts[0].begin - 1.0, {k: v[0] for k, v in parts[0].sides.items()}
    for index, part in enumerate(parts):
        clock = part.begin + np.arange(part.q.size) * STEP
        turns = np.flatnonzero(np.diff(np.sign(np.diff(part.q))) != 0) + 1
        base = np.arange(part.begin, part.end, 1 / rate)
        inside = np.union1d(np.union1d(base, clock[turns]), part.frames)
        gap = np.linspace(last_end, part.begin, max(int((part.begin - last_end) * 4), 3))[1:-1]
        share = (gap - last_end) / (part.begin - last_end)
        smooth = share * share * (3 - 2 * share)
        times += [gap, inside]
        motors += [last_q + (part.q[0] - last_q) * smooth, np.interp(inside, clock, part.q)]
        for name, values in part.sides.items():
            sides[name] += [
                last_sides[name] + (values[0] - last_sides[name]) * smooth,
                np.interp(inside, clock, values),
            ]
        owner += [np.full(gap.size, index), np.full(inside.size, index)]
        frames += [np.zeros(gap.size, bool), np.isin(inside, part.frames)]
        last_q, last_end, last_sides = part.q[-1], part.end, {k: v[-1] for k, v in part.sides.items()}
    t, q = np.concatenate(times), np.concatenate(motors)
    ahead, behind = np.interp(t + 0.02, t, q), np.interp(t - 0.02, t, q)
    return Line(
        t, q, (ahead - behind) / 0.04, {k: np.concatenate(v) for k, v in sides.items()}, np.concatenate(owner),
        np.concatenate(frames), tuple(p.name for p in parts), tuple(p.begin for p in parts), reach, width, gain, joints,
    )  # fmt: skip
