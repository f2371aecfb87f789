"""Causes that no list holds, in the drive: what its fluid, friction, surroundings and log do."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tools.family_three import ranges
from tools.family_three.causes.base import Cause, follow, gates, swings
from tools.family_three.line import Line, Part
from tools.family_two.motion import STEP

if TYPE_CHECKING:
    from tools.family_three.camera import Scene
    from tools.family_three.mechanism import Demand, Mechanism

FloatArray = NDArray[np.float64]
Said = dict[str, float | str]
COARSE = 10  # of the grid's instants: slow states are stepped on fewer


def _slow(line: Line, values: FloatArray) -> FloatArray:
    """From every COARSE-th instant to all."""
    return np.interp(line.t, line.t[::COARSE], values)


class Hidden(Cause):
    unlisted = True


class LeakingLine(Hidden):
    id, says = "leaking_line", "what holds the tip out seeps away, and is filled up again near the middle"
    limits = ranges.LEAK

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        near, filling = 0.12 * line.reach, COARSE * STEP / 0.25
        rate = self.size * COARSE * STEP
        lost, out = 0.0, []
        for q, on in zip(line.q[::COARSE].tolist(), self.on(line)[::COARSE].tolist(), strict=True):
            lost += rate * on * (q - lost) if abs(q) > near else -filling * lost
            out.append(lost)
        d.q = d.q - _slow(line, np.array(out))


class QuadraticDrag(Hidden):
    id, says = "quadratic_drag", "the tip moves through liquid, whose drag goes with the square of speed"
    limits = ranges.SQUARE
    massless = True

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        usual = line.usual_speed * line.gain
        d.feel.square = self.size * m.width_deg / usual**2 * self.on(line)


class DrainedFilm(Hidden):
    id, says = "drained_film", "friction is higher at places that were not passed for a while"
    limits = ranges.DRAINED

    def _tau(self) -> float:
        return float(self.rng().uniform(6.0, 30.0))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        bins = 40
        at = np.clip((line.q[::COARSE] / line.reach + 1) * bins / 2, 0, bins - 1).astype(int)
        times, tau = line.t[::COARSE], self._tau()
        passed = [-3 * tau] * bins
        dry, before, out = 1.0, -1, []
        for b, t in zip(at.tolist(), times.tolist(), strict=True):
            if b != before:
                dry = 1 - float(np.exp((passed[b] - t) / tau))
                if before >= 0:
                    passed[before] = t
                before = b
            out.append(dry)
        d.rub = d.rub * (1 + self.size * self.on(line) * follow(_slow(line, np.array(out)), 0.08))

    def parameters(self, line: Line) -> Said:
        return {"time_s": self._tau()}


class PloughedTissue(Hidden):
    id, says = "ploughed_tissue", "tissue that gives way for good while pressed on, and comes back within a minute"
    limits = ranges.PLOUGHED

    def _how(self) -> tuple[float, float, float, float]:
        rng = self.rng()
        side = float(rng.choice([-1.0, 1.0]))
        return float(rng.uniform(-0.1, 0.3)), side, float(rng.uniform(0.5, 2.5)), float(rng.uniform(10, 50))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        home, way, yields, back = self._how()
        home *= m.limit
        reached = np.interp(line.q, m.need(m.xs, 0.0), m.xs) * way
        dt, place, out = COARSE * STEP, home, []
        for c, on in zip(reached[::COARSE].tolist(), self.on(line)[::COARSE].tolist(), strict=True):
            place += dt * ((home - place) / back + on * max(c - place, 0.0) / yields)
            out.append(place)
        d.wall_side, d.wall_at, d.wall = way, _slow(line, np.array(out)), self.size * self.on(line)

    def parameters(self, line: Line) -> Said:
        home, way, yields, back = self._how()
        return {"at": home, "side": way, "yields_s": yields, "back_s": back}


class UnloggedGrasp(Hidden):
    id, says = "unlogged_grasp", "something is held and let go again, and no column says so"
    limits = ranges.HELD_THING

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        rng = self.rng()
        held = follow(gates(rng, line.t, (1.5, 5.0), (1.5, 5.0)), 0.05) * self.on(line)
        d.load = d.load + float(rng.choice([-1.0, 1.0])) * self.size * held
        d.rub = d.rub * (1 + 0.2 * self.size * held)


class SidewaysSwing(Hidden):
    id, says = "sideways_swing", "a slender section swings out of its plane when the motor speeds up or brakes"
    limits = ranges.SIDEWAYS
    needs_camera = sections = True

    def _how(self) -> tuple[float, float]:
        rng = self.rng()
        return float(rng.uniform(1.5, 7.0)), float(rng.uniform(0.02, 0.1))

    def scene(self, line: Line, part: Part, times: FloatArray, scene: "Scene", c: FloatArray) -> None:
        rate, damping = self._how()
        speed = line.speed / line.usual_speed * self.on(line)
        leans = swings(speed, rate, damping) - speed
        sideways = np.zeros((times.size, 3))
        sideways[:, 0] = self.size * line.at(leans, times)
        scene.tilt = scene.tilt + sideways

    def parameters(self, line: Line) -> Said:
        return {"rate_hz": self._how()[0], "damping": self._how()[1]}


class ClippedLog(Hidden):
    id, says = "clipped_log", "the log saturates short of the range's ends while the motor goes on"
    limits = ranges.CLIPPED

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        most = (1 - self.size) * line.reach
        ways = str(self.rng().choice(["both", "up", "down"]))
        low, high = (-np.inf if ways == "up" else -most), (np.inf if ways == "down" else most)
        return np.asarray(np.where(self.on(line) > 0, np.clip(q, low, high), q))


class StuckBit(Hidden):
    id, says = "stuck_bit", "one bit of the encoder always reads 0"
    limits = ranges.STUCK

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        bit = self.size * line.width
        return np.asarray(q - bit * self.on(line) * (np.floor((q + line.reach) / bit) % 2))


class ChangeOnlyLog(Hidden):
    id, says = "change_only_log", "the log takes a new value only when the motor is a step away from the last"
    limits = ranges.DEADBAND

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        least, last, out = self.size * line.width, float(q[0]), []
        for value in q.tolist():
            if abs(value - last) >= least:
                last = value
            out.append(last)
        return np.asarray(np.where(self.on(line) > 0, np.array(out), q))


class LogStalls(Hidden):
    id, says = "log_stalls", "the log stops for a moment again and again; what is missing is filled in on a line"
    limits = ranges.STALLS

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        rng = self.rng()
        begins = np.cumsum(rng.uniform(1.2, 3.0, int(line.t[-1] / 1.2) + 2))
        gone = np.searchsorted(begins, line.t) != np.searchsorted(begins, line.t - self.size)
        known = ~gone | (self.on(line) == 0)
        return np.asarray(np.interp(line.t, line.t[known], q[known]))


DRIVE = (
    LeakingLine, QuadraticDrag, DrainedFilm, PloughedTissue, UnloggedGrasp, SidewaysSwing, ClippedLog, StuckBit,
    ChangeOnlyLog, LogStalls,
)  # fmt: skip
