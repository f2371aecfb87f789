"""Causes that no list holds, in what moves."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from tools.family_two import ranges
from tools.family_two.causes.base import Cause, follow
from tools.family_two.mechanism import Demand, Mechanism
from tools.family_two.motion import STEP
from tools.family_two.timeline import Timeline

FloatArray = NDArray[np.float64]


class Coasting(Cause):
    id = "coasting"
    says = "a heavy tip runs on through the gap when the motor brakes: what is lost depends on how it was stopped"
    limits = ranges.COAST
    unlisted = massless = True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        # reach / s^2: usual stops brake by some reaches a second; friction brakes a light tip faster than that
        demand.feel.braking = np.where(self.on(line) > 0, 60.0 / self.size, np.inf)


class SlowReturn(Cause):
    id = "slow_return"
    says = "one way a spring returns the tip, and no faster than it can: the cable goes slack"
    limits = ranges.RETURN
    unlisted = massless = True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        demand.feel.fastest = np.where(self.on(line) > 0, 1 / self.size, np.inf)


class Snag(Cause):
    id = "snag"
    says = "a broken strand catches at one place on the way up and lets go with a jump"
    limits = ranges.SNAG
    unlisted = massless = True

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {"place": float(self.rng.uniform(-0.4, 0.4))}

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        demand.feel.catch = 2 * self.size * self.on(line)
        demand.feel.caught_at = float(self.parameters(line)["place"])


class FlangeClimb(Cause):
    id = "flange_climb"
    says = "driven fast far out, the cable climbs its pulley's flange and stays until it passes the middle slowly"
    limits = ranges.CLIMB
    unlisted = True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        speed, share = np.abs(line.speed) / line.usual_speed, line.q / line.reach
        climbs = (speed > 0.9) & (np.abs(share) > 0.3)
        falls = (speed < 0.7) & (np.abs(share) < 0.12)
        event = np.where(climbs, 1.0, np.where(falls, -1.0, 0.0))
        last = np.maximum.accumulate(np.where(event != 0, np.arange(event.size), 0))
        up = follow((event[last] > 0).astype(float), STEP, 0.05)
        demand.q *= 1 + self.size * up * self.on(line)


class IdleCurrent(Cause):
    id = "idle_current"
    says = "soon after the motor stops its driver saves current, and the rotor sags to one side until the next step"
    limits = ranges.SAG
    unlisted = True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        rng = self.rng
        waits, sign = float(rng.uniform(0.3, 0.8)), float(rng.choice([-1.0, 1.0]))
        still = np.abs(line.speed) < 1e-4 * line.reach
        begun = np.maximum.accumulate(np.where(~still, np.arange(still.size), 0))
        idle = (np.arange(still.size) - begun) * STEP > waits
        demand.q += sign * self.size * line.width * follow(idle.astype(float), STEP, 0.03) * self.on(line)


class WanderingLog(Cause):
    id = "wandering_log"
    says = "the motor's values come over a bus whose load changes: rows are older than they say, by more or less"
    limits = ranges.STALE
    unlisted = True

    def logged(self, line: Timeline, t: FloatArray, q: FloatArray) -> FloatArray:
        rng = self.rng
        low = butter(1, float(rng.uniform(0.05, 0.25)), fs=1 / STEP, output="sos")
        wave = sosfiltfilt(low, rng.normal(size=line.t.size))
        older = self.size * (0.5 + 0.5 * np.tanh(2 * wave / wave.std())) * self.on(line)
        return line.at(line.q, t - line.at(older, t)) - q


class SleepyBrake(Cause):
    id = "sleepy_brake"
    says = "after each rest the output's holding brake lets go late: the tip stays, then catches up with a jerk"
    limits = ranges.BRAKE
    unlisted = True

    def bend(self, line: Timeline, c: FloatArray) -> FloatArray:
        moving = np.abs(line.speed) > 1e-3 * line.reach
        count = int(0.25 / STEP)
        # at rest for a quarter of a second: the brake falls in; it lets go `size` after the motor starts
        rested = np.convolve(moving, np.ones(count), mode="full")[: moving.size] < 0.5
        rested[:count] = False
        hold = int(self.size / STEP)
        starts = np.flatnonzero(rested[:-1] & ~rested[1:]) + 1
        out = c.copy()
        on = self.on(line)
        for i in starts:
            end = min(i + hold, c.size)
            if on[i] and hold:
                out[i:end] = c[i - 1]
        caught = follow(out, STEP, 0.01)
        return np.asarray(np.where(on > 0, caught, c))


MOVING: tuple[type[Cause], ...] = (
    Coasting, SlowReturn, Snag, FlangeClimb, IdleCurrent, WanderingLog, SleepyBrake,
)  # fmt: skip
