"""Listed effects from the encoder to the bending angle."""

import numpy as np
from scipy.signal import fftconvolve

from tools.family import ranges as first
from tools.family_four.causes.drive import FULL_LOAD, STROKES
from tools.family_six.causes.base import STEP, Ask, Cause, FloatArray, Line, Mechanism, follow, play


class Encoder(Cause):
    id, limits = "actuator.encoder_periodic", first.ENCODER
    says = "a magnetic tape round the shaft is a little too long: errors add up over the turn, back over the seam"

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        rng = self.rng()
        seam, phase = float(rng.uniform(0.22, 0.45)), float(rng.random())  # the head averages over poles
        turned = np.mod(q / line.turn + phase, 1.0)
        saw = np.interp(turned, [0.0, 1 - seam, 1.0], [-1.0, 1.0, -1.0])
        saw = saw - np.interp(np.mod(phase, 1.0), [0.0, 1 - seam, 1.0], [-1.0, 1.0, -1.0])
        return np.asarray(q + self.on(line) * self.sign() * 2 * self.size * line.turn * saw)


class SmoothOnset(Cause):
    id, limits = "transmission.smooth_onset", first.ROUNDING
    says = "parts that rub in parallel let go at thresholds scattered by Weibull's law"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.spread = self.on(line) * 1.15 * self.size


class Asymmetric(Cause):
    id, limits = "transmission.asymmetric_backlash", first.BREAKAWAY
    says = "a wiper's lip has to turn over before the tip slides one way"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.lip, a.lip_way = self.on(line) * 1.3 * self.size * m.width_deg, self.sign()
        a.lip_travel = float(self.rng().uniform(0.6, 1.6)) * m.width_deg


class Rate(Cause):
    id, limits = "transmission.rate_dependent_backlash", first.RATE
    says = "rubber's friction: a bell over the logarithm of speed (Grosch), climbed at the speeds used"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        peak, broad = float(rng.uniform(2.0, 5.0)) * line.usual_speed, float(rng.uniform(1.2, 2.0))
        speed = follow(np.abs(line.speed), 0.02) + 1e-4 * line.usual_speed
        bell = np.exp(-0.5 * (np.log(speed / peak) / broad) ** 2)
        a.rub = a.rub * (1 + self.on(line) * 4 * self.size * bell)


class Lag(Cause):
    id, limits = "transmission.lag", first.LAG
    says = "a long hose or a soft coupling with a damper in the drive: first order before the friction"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.q = a.q + self.on(line) * (follow(a.q, self.size) - a.q)


class Creep(Cause):
    id, limits = "transmission.creep", first.CREEP
    says = "a plastic's retarded compliance: Kohlrausch's stretched exponential"

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        late, power = first.CREEP_TIME.draw(rng), float(rng.uniform(0.4, 0.75))
        kernel = 1 - np.exp(-((np.arange(c.size) * STEP / late) ** power))
        moved = np.diff(c, prepend=c[0]) * self.on(line)
        return c + self.size * fftconvolve(moved, kernel)[: c.size]


class StickSlip(Cause):
    id, limits = "transmission.stick_slip", first.JUMP
    says = "ridges of a moulded liner hold the tip, more at some than at others, unless it glides over them fast"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        a.ridges = self.on(line) * 1.5 * self.size * m.width_deg
        a.pitch = float(rng.uniform(2.0, 6.0)) * self.size * m.width_deg
        a.glides = float(rng.uniform(1.5, 4.0)) * line.usual_speed * line.gain


class Drift(Cause):
    id, limits = "transmission.drift", first.DRIFT
    says = "offset or friction moves along an S: heat or moisture arrives"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng, (begin, end) = self.rng(), self.span(line)
        middle, soft = begin + float(rng.uniform(0.3, 0.7)) * (end - begin), float(rng.uniform(0.06, 0.2))
        rise = 1 / (1 + np.exp(-(line.t - middle) / (soft * (end - begin))))
        amount = self.on(line) * self.size * (end - begin) / 100.0 * (rise - np.interp(begin, line.t, rise))
        if rng.random() < 0.6:
            a.q = a.q + self.sign() * amount * line.width
        else:
            a.rub = a.rub * (1 + 1.5 * amount if self.sign() > 0 else 1 / (1 + 1.5 * amount))


class Load(Cause):
    id, limits, needs_column = "transmission.load_dependence", first.LOAD, "load_mNm"
    says = "a load turns the tip until a stop's spring takes it up, and presses by its square on what rubs"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        share = line.sides["load_mNm"] / FULL_LOAD * self.on(line)
        a.push = a.push + self.sign() * self.size * 2 * m.f * share / (0.5 + 0.5 * np.abs(share))
        a.rub = a.rub * (1 + 0.6 * self.size * share**2)


class Slip(Cause):
    id, limits, may_start = "transmission.slip", first.TOOTH, False
    says = "a hub slips on its shaft as the motor turns round, two to four times"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng, (begin, end) = self.rng(), self.span(line)
        way = np.sign(line.speed)
        turns = np.flatnonzero((way[1:] != way[:-1]) & (way[1:] != 0)) + 1
        turns = turns[(line.t[turns] > begin + 6.0) & (line.t[turns] < end - 3.0)]
        for k in rng.choice(turns, min(int(rng.integers(2, 5)), turns.size), replace=False).tolist():
            a.q = a.q + self.sign() * self.size * line.width * float(rng.uniform(0.5, 1.0)) * (line.t >= line.t[k])


class Backlash(Cause):
    id, limits, moves, may_start = "transmission.backlash", first.WIDTH_CHANGE, True, False
    says = "more or less friction in the tests"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        by = 1 + self.on(line) * self.size
        a.rub = a.rub * (by if self.sign() > 0 else 1 / by)


class Offset(Cause):
    id, limits, moves, may_start = "transmission.offset", first.OFFSET_CHANGE, True, False
    says = "another homing in the tests"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.q = a.q + self.on(line) * self.sign() * self.size * line.width


class Remaining(Cause):
    id, limits, moves, may_start = "configuration.remaining", first.LAW_CHANGE, True, False
    says = "a dimension of the drive is another in the tests"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.law = a.law + self.on(line) * self.sign() * self.size


class Swing(Cause):
    id, limits = "configuration.swing", first.SWING
    says = "the tip swings, the slower the farther it is bent"

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        rate, damping = first.SWING_RATE.draw(rng), first.SWING_DAMPING.draw(rng)
        slower = float(rng.uniform(0.0, 0.3))
        w = 2 * np.pi * rate * np.sqrt(1 - slower * np.minimum((c / max(np.abs(c).max(), 1e-9)) ** 2, 1.0))
        y, v, out = float(c[0]), 0.0, np.empty(c.size)
        for k, (to, wk) in enumerate(zip(c.tolist(), w.tolist(), strict=True)):
            v = (v + STEP * wk * wk * (to - y)) / (1 + 2 * damping * wk * STEP)
            y += STEP * v
            out[k] = y
        return c + self.on(line) * self.size * (out - c)


class Coupling(Cause):
    id, limits = "configuration.axis_coupling", first.COUPLING
    says = "another joint moves an eyelet past which the cable runs: a hypotenuse's length, half of them through a gap"

    def parameters(self, line: Line) -> dict[str, float | str]:
        return super().parameters(line) | {"column": self.column(line)}

    def column(self, line: Line) -> str:
        return str(self.rng().choice(sorted(set(line.sides) & set(STROKES))))

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        name, rng = self.column(line), np.random.default_rng([self.seed, 5])
        y = line.sides[name] / STROKES[name]
        if rng.random() < 0.5:
            gap = float(rng.uniform(0.1, 0.3))
            y = play(y - gap, y + gap, float(y[0]))
        far, off = float(rng.uniform(0.5, 1.5)), float(rng.uniform(0.3, 1.2))
        longer = np.hypot(far, off + y) - np.hypot(far, off)
        a.q = a.q - self.on(line) * self.sign() * self.size * 3 * line.width * longer


class Contact(Cause):
    id, limits, strongest = "configuration.contact", first.WALL, 20.0
    says = "a ball of tissue is pressed in beyond some angle (Hertz's power of 3/2)"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.wall = self.on(line) * 12 * self.size / (1.02 - self.size)
        a.wall_at, a.wall_side = float(self.rng().uniform(0.25, 0.65)) * m.limit, self.sign()


EVERY = (
    Encoder, SmoothOnset, Asymmetric, Rate, Lag, Creep, StickSlip, Drift, Load, Slip, Backlash, Offset, Remaining,
    Swing, Coupling, Contact,
)  # fmt: skip
