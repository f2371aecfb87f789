"""Effects of formats.md from the encoder to the section."""

from dataclasses import replace

import numpy as np

from tools.family import ranges
from tools.family.ranges import CATCH_UP, CREEP_TIME, RATE_SPEED, SWING_DAMPING, SWING_RATE
from tools.family_four.causes.base import STEP, Cause, FloatArray, Line, follow, play, swings, tested
from tools.family_four.mechanism import Demand, Mechanism
from tools.family_four.slide import Feel, iwan

FULL_LOAD = 60.0  # mNm
STROKES = {"translation_mm": 5.0, "rotation_deg": 10.0, "wrist_deg": 45.0}


def feel(d: Demand) -> Feel:
    return d.feel or Feel()


class EncoderPeriodic(Cause):
    id = "actuator.encoder_periodic"
    says = "a magnet off the shaft's axis: once per turn, a tenth of it twice"
    limits = ranges.ENCODER

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        first, second = self.rng().uniform(0, 2 * np.pi, 2)
        a = 2 * np.pi * line.q / line.turn
        return np.asarray(
            q + self.on(line) * self.size * line.turn * (np.sin(a + first) + 0.1 * np.sin(2 * a + second))
        )


class SmoothOnset(Cause):
    id = "transmission.smooth_onset"
    says = "contacts slip one after the other, their thresholds by a power law (Segalman's Iwan joint)"
    limits = ranges.ROUNDING

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        d.elements, d.rounded = iwan(float(self.rng().uniform(-0.3, 0.6)), self.size), self.on(line)


class AsymmetricBacklash(Cause):
    id = "transmission.asymmetric_backlash"
    says = "a nap that stands up when it is stroked one way, holds the tip the other way and lies down as it slides"
    limits = ranges.BREAKAWAY
    massless = True

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        rng = self.rng()
        worn, way = CATCH_UP.draw(rng) * m.width_deg, float(rng.choice([-1.0, 1.0]))
        d.feel = replace(feel(d), nap=self.on(line) * self.size * 0.5 * m.width_deg, worn=worn, way=way)


class RateDependentBacklash(Cause):
    id = "transmission.rate_dependent_backlash"
    says = "thermally activated friction (Eyring): grows with arsinh of speed"
    limits = ranges.RATE

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        pace = np.abs(follow(np.gradient(d.q, STEP), 0.02)) / (RATE_SPEED.draw(self.rng()) * line.usual_speed)
        d.rub = d.rub * (1 + self.on(line) * self.size * np.arcsinh(pace))


class Lag(Cause):
    id = "transmission.lag"
    says = "viscous drag against the section's spring; with a mass, more damping"
    limits = ranges.LAG

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        d.feel = replace(feel(d), drag=self.on(line) * self.size)


class Creep(Cause):
    id = "transmission.creep"
    says = "behind the friction three Kelvin-Voigt elements over a decade of time: nearly a power law"
    limits = ranges.CREEP

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        tau = CREEP_TIME.draw(self.rng())
        late = np.mean([follow(c, tau * k) for k in (0.3, 1.0, 3.0)], axis=0)
        return np.asarray(c + self.on(line) * self.size * (late - c))


class StickSlip(Cause):
    id = "transmission.stick_slip"
    says = "contacts gain strength while at rest: jumps of scattered size when slow, none when fast"
    limits = ranges.JUMP
    massless = True

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        glides = float(self.rng().uniform(1.5, 5.0)) * line.usual_speed * line.gain  # deg/s
        stick = self.size * m.width_deg
        d.feel = replace(feel(d), stick=self.on(line) * stick, age=stick / glides, seed=self.seed)


class Drift(Cause):
    id = "transmission.drift"
    says = "offset or friction moves evenly, or as something warms up"
    limits = ranges.DRIFT

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        rng = self.rng()
        begin = 0.0 if self.since == "start" else line.changed
        t = np.maximum(line.t - begin, 0.0) / 100.0
        warm = float(rng.uniform(0.5, 2.0))
        gone = t if rng.random() < 0.5 else warm * (1 - np.exp(-t / warm))
        gone = float(rng.choice([-1.0, 1.0])) * self.size * gone
        if rng.random() < 0.6:
            d.q = d.q + gone * m.width
        else:
            d.rub = d.rub * np.exp(gone)


class LoadDependence(Cause):
    id = "transmission.load_dependence"
    says = "a torque at the tip in the balance, which presses on what rubs as well"
    limits = ranges.LOAD
    needs_column = "load_mNm"

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        share = self.on(line) * self.size * line.sides["load_mNm"] / FULL_LOAD
        d.load = d.load + float(self.rng().choice([-1.0, 1.0])) * share
        d.rub = d.rub * (1 + 0.5 * share)


class Slip(Cause):
    id = "transmission.slip"
    says = "one to three jumps of the offset, of one sign, while it moves"
    limits = ranges.TOOTH
    may_start = False

    def times(self, line: Line) -> FloatArray:
        begin, end = tested(line)
        ready = np.flatnonzero((np.abs(line.speed) > 0.5 * line.usual_speed) & (line.t > begin) & (line.t < end))
        rng = self.rng()
        shares = np.sort(rng.uniform(0.15, 0.85, int(rng.integers(1, 4))))
        return np.asarray(line.t[ready[(shares * ready.size).astype(int)]])

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        sign = 1.0 if self.seed % 2 else -1.0
        d.q = d.q + sign * self.size * m.width * np.sum([line.t >= at for at in self.times(line)], axis=0)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {f"t_{i + 1}_s": float(at) for i, at in enumerate(self.times(line))}


class Moved(Cause):
    """What recalibration has to move."""

    may_start, moves = False, True

    def signed(self, line: Line) -> FloatArray:
        return self.on(line) * self.size * (1.0 if self.seed % 2 else -1.0)


class Backlash(Moved):
    id = "transmission.backlash"
    says = "other friction in the tests"
    limits = ranges.WIDTH_CHANGE

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        d.rub = d.rub * (1 + self.signed(line))


class Offset(Moved):
    id = "transmission.offset"
    says = "another homing in the tests"
    limits = ranges.OFFSET_CHANGE

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        d.q = d.q + self.signed(line) * m.width


class Remaining(Moved):
    id = "configuration.remaining"
    says = "another length in the drive's geometry in the tests"
    limits = ranges.LAW_CHANGE

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        d.law = d.law + self.signed(line)


class Contact(Cause):
    id = "configuration.contact"
    says = "a spring beyond some angle, in the balance: a corner in the law, which is what it is binned by"
    limits = ranges.WALL
    may_start = False
    strongest = 8.0  # more would mostly be rigid walls

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        rng = self.rng()
        d.wall_side = float(rng.choice([-1.0, 1.0]))
        d.wall_at = d.wall_side * float(rng.uniform(0.1, 0.6)) * m.limit
        d.wall = self.on(line) * min(self.size, 0.95)


class Swing(Cause):
    id = "configuration.swing"
    says = "a part of the tip swings on a slender end"
    limits = ranges.SWING

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        swung = swings(c, SWING_RATE.draw(rng), SWING_DAMPING.draw(rng))
        return np.asarray(c + self.on(line) * self.size * (swung - c))


class AxisCoupling(Cause):
    id = "configuration.axis_coupling"
    says = "another joint takes some of the drive's travel, half of them through a gap"
    limits = ranges.COUPLING

    def column(self, line: Line) -> str:
        return next(name for name in sorted(line.sides) if name in STROKES)

    def act(self, line: Line, m: Mechanism, d: Demand) -> None:
        rng = self.rng()
        other = line.sides[self.column(line)] / STROKES[self.column(line)]
        if rng.random() < 0.5:
            half = 0.5 * float(rng.uniform(0.1, 0.4))
            other = play(other - half, other + half, float(other[0]))
        d.q = d.q + self.on(line) * float(rng.choice([-1.0, 1.0])) * self.size * m.width * other

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"column": self.column(line)}
