"""Effects of formats.md that act in the drive: actuator, transmission, configuration."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tools.family import ranges
from tools.family_three.causes.base import Cause, follow, swings, tested
from tools.family_three.friction import project
from tools.family_three.line import Line

if TYPE_CHECKING:
    from tools.family_three.mechanism import Demand, Mechanism

FloatArray = NDArray[np.float64]
Said = dict[str, float | str]
FULL_LOAD = 50.0  # mNm
STROKES = {"translation_mm": 5.0, "rotation_deg": 10.0, "wrist_deg": 40.0}


class EncoderPeriodic(Cause):
    id, says = "actuator.encoder_periodic", "encoder's disc off its shaft: once per turn, a seventh of it twice"
    limits = ranges.ENCODER

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        phases = self.rng().uniform(0, 2 * np.pi, 2)
        angle = 2 * np.pi * line.q / line.turn
        wrong = np.sin(angle + phases[0]) + np.sin(2 * angle + phases[1]) / 7
        return np.asarray(q + self.on(line) * self.size * line.turn * wrong)

    def parameters(self, line: Line) -> Said:
        return {"period": line.turn}


class SmoothOnset(Cause):
    id, says = "transmission.smooth_onset", "contacts and lips let go one after the other before all slides"
    limits = ranges.ROUNDING

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        elements = m.presliding()
        mean = sum(w * r for w, r in elements)
        d.shares = tuple((w, 1 + 2 * self.size * (r - mean)) for w, r in elements)
        d.shares = tuple((w, max(r, 0.02)) for w, r in d.shares)
        d.shares_from = 0 if self.since == "start" else int(np.argmax(self.on(line)))


class AsymmetricBacklash(Cause):
    id, says = "transmission.asymmetric_backlash", "breakaway above kinetic friction one way, gone after some sliding"
    limits = ranges.BREAKAWAY
    massless = True

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        rng = self.rng()
        d.feel.way = int(rng.choice([-1, 1]))
        d.feel.wears = ranges.CATCH_UP.draw(rng) * m.width_deg
        d.feel.extra = 0.5 * self.size * m.width_deg * self.on(line)


class RateDependentBacklash(Cause):
    id, says = "transmission.rate_dependent_backlash", "friction grows with the logarithm of speed"
    limits = ranges.RATE

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        slow = ranges.RATE_SPEED.draw(self.rng()) * line.usual_speed
        d.rub = d.rub * (1 + self.on(line) * self.size * np.log1p(follow(np.abs(line.speed), 0.02) / slow))


class Lag(Cause):
    id, says = "transmission.lag", "viscous drag against what is elastic, first order"
    limits = ranges.LAG

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        d.feel.drag = self.size * self.on(line)


class Creep(Cause):
    id, says = "transmission.creep", "a Kelvin-Voigt element behind the friction"
    limits = ranges.CREEP

    def _tau(self) -> float:
        return ranges.CREEP_TIME.draw(self.rng())

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        return c + self.on(line) * self.size * (follow(c, self._tau()) - c)

    def parameters(self, line: Line) -> Said:
        return {"time_s": self._tau()}


class StickSlip(Cause):
    id, says = "transmission.stick_slip", "breakaway above kinetic friction wherever it comes to rest: jumps"
    limits = ranges.JUMP
    massless = True

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        rng = self.rng()
        d.feel.stick = self.size * m.width_deg * self.on(line)
        d.feel.scatter = rng.uniform(0.6, 1.4, 997)
        d.feel.hold = float(rng.uniform(0.8, 3.0)) * line.usual_speed * line.gain


class Drift(Cause):
    id, says = "transmission.drift", "offset or friction moves with time, evenly or ever more slowly"
    limits = ranges.DRIFT

    def _how(self) -> tuple[bool, bool, float]:
        rng = self.rng()
        return bool(rng.random() < 0.6), bool(rng.random() < 0.5), float(rng.choice([-1.0, 1.0]))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        offset, even, sign = self._how()
        since = np.maximum(line.t - (0.0 if self.since == "start" else line.changed), 0.0)
        ramp = sign * self.size * (since / 100 if even else np.log1p(since / 20) / np.log(6))
        if offset:
            d.q = d.q + ramp * line.width
        else:
            d.rub = d.rub * np.clip(1 + ramp, 0.1, 3.0)

    def parameters(self, line: Line) -> Said:
        offset, even, sign = self._how()
        return {"of": "offset" if offset else "width", "law": "even" if even else "logarithmic", "sign": sign}


class LoadDependence(Cause):
    id, says = "transmission.load_dependence", "a load pulls in the balance and presses on what rubs"
    limits = ranges.LOAD
    needs_column = "load_mNm"

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        sign = float(self.rng().choice([-1.0, 1.0]))
        share = line.sides["load_mNm"] / FULL_LOAD * self.on(line)
        d.load = d.load + sign * self.size * share
        d.rub = d.rub * (1 + 0.3 * self.size * share)


class Slip(Cause):
    id, says = "transmission.slip", "a tooth, a winding or counts lost: jumps while it moves"
    limits = ranges.TOOTH
    may_start = False

    def _when(self, line: Line) -> tuple[FloatArray, FloatArray]:
        rng = self.rng()
        begin, end = tested(line)
        number = int(rng.integers(1, 4))
        moving = np.flatnonzero((np.abs(line.speed) > 0.5 * line.usual_speed) & (line.t > begin) & (line.t < end))
        shares = (np.arange(number) + rng.uniform(0.25, 0.75, number)) / number
        times = line.t[moving[(shares * (moving.size - 1)).astype(int)]]
        return times, np.full(number, float(rng.choice([-1.0, 1.0])))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        for time, sign in zip(*self._when(line), strict=True):
            d.q = d.q + self.size * line.width * sign * (line.t >= time)

    def parameters(self, line: Line) -> Said:
        return {"jumps": float(len(self._when(line)[0])), "first_s": float(self._when(line)[0][0])}


class _Signed(Cause):
    may_start, moves = False, True

    def _sign(self) -> float:
        return float(self.rng().choice([-1.0, 1.0]))

    def parameters(self, line: Line) -> Said:
        return {"sign": self._sign()}


class Backlash(_Signed):
    id, says = "transmission.backlash", "other friction than while calibrating"
    limits = ranges.WIDTH_CHANGE

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        d.rub = d.rub * (1 + self._sign() * self.size * self.on(line))


class Offset(_Signed):
    id, says = "transmission.offset", "homed elsewhere than while calibrating"
    limits = ranges.OFFSET_CHANGE

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        d.q = d.q + self._sign() * self.size * line.width * self.on(line)


class Remaining(_Signed):
    id, says = "configuration.remaining", "another geometry of the drive than while calibrating"
    limits = ranges.LAW_CHANGE

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        d.law = d.law + self._sign() * self.size * self.on(line)


class Swing(Cause):
    id, says = "configuration.swing", "a part of the tip swings, lightly damped"
    limits = ranges.SWING

    def _how(self) -> tuple[float, float]:
        rng = self.rng()
        return ranges.SWING_RATE.draw(rng), ranges.SWING_DAMPING.draw(rng)

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        return c + self.on(line) * self.size * (swings(c, *self._how()) - c)

    def parameters(self, line: Line) -> Said:
        rate, damping = self._how()
        return {"rate_hz": rate, "damping": damping}


class AxisCoupling(Cause):
    id, says = "configuration.axis_coupling", "another joint takes cable, fluid or tooth with it; some through a gap"
    limits = ranges.COUPLING

    def _how(self, line: Line) -> tuple[str, float, float]:
        rng = self.rng()
        column = str(rng.choice(sorted(set(line.sides) & set(STROKES))))
        return column, float(rng.choice([-1.0, 1.0])), float(rng.choice([0.0, rng.uniform(0.1, 0.35)]))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        column, sign, play = self._how(line)
        other = line.sides[column] / STROKES[column]
        if play:
            other = project(other - play, other + play, 0.0)
        d.q = d.q + sign * self.size * line.width * other * self.on(line)

    def parameters(self, line: Line) -> Said:
        column, sign, play = self._how(line)
        return {"column": column, "sign": sign, "play": play}


class Contact(Cause):
    id, says = "configuration.contact", "something springy is in the way beyond an angle"
    limits = ranges.WALL
    may_start, moves = False, True

    def _how(self) -> tuple[float, float]:
        rng = self.rng()
        return float(rng.uniform(0.25, 0.6)), float(rng.choice([-1.0, 1.0]))

    def drive(self, line: Line, m: "Mechanism", d: "Demand") -> None:
        place, d.wall_side = self._how()
        d.wall_at = place * m.limit
        d.wall = self.size * self.on(line)

    def parameters(self, line: Line) -> Said:
        return {"at": self._how()[0], "side": self._how()[1]}
