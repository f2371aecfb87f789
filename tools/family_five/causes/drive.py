"""What formats.md lists of motor, drive and tip."""

import numpy as np

from tools.family import ranges as first
from tools.family_five.causes.base import Ask, Cause, FloatArray, Line, Mechanism, follow, play, swings, tested
from tools.family_four.causes.drive import FULL_LOAD, STROKES


class EncoderPeriodic(Cause):
    id = "actuator.encoder_periodic"
    says = "a ring off its shaft, read by one head: the angle of a circle about another centre"
    limits = first.ENCODER

    def log(self, line: Line, q: FloatArray) -> FloatArray:
        a = 2 * np.pi * q / line.turn + self.rng().uniform(0, 6)
        off = 2 * np.pi * self.size
        seen = np.arctan2(off * np.sin(a), 1 + off * np.cos(a))
        return np.asarray(q + self.on(line) * line.turn / (2 * np.pi) * seen)


class SmoothOnset(Cause):
    id = "transmission.smooth_onset"
    says = "asperities of exponentially scattered load slip one after the other (Greenwood and Williamson)"
    limits = first.ROUNDING
    massless = True

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.spread = np.minimum(self.size * self.on(line), 1.0)


class AsymmetricBacklash(Cause):
    id = "transmission.asymmetric_backlash"
    says = "a sealing ring rolls before it slides one way, and is rolled back by sliding the other"
    limits = first.BREAKAWAY
    massless = True

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        held = self.size * m.width_deg
        a.ring, a.ring_way = held * self.on(line), float(rng.choice([-1.0, 1.0]))
        a.ring_rolls = held * float(rng.uniform(1.6, 4.0))


class RateDependentBacklash(Cause):
    id = "transmission.rate_dependent_backlash"
    says = "grease with a yield stress (Herschel and Bulkley): friction grows by a power of speed"
    limits = first.RATE

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        power = float(self.rng().uniform(0.3, 0.6))
        speed = np.abs(follow(line.speed, 0.02)) / line.usual_speed
        a.rub = a.rub * (1 + 3 * self.size * self.on(line) * np.minimum(speed, 4.0) ** power)


class Lag(Cause):
    id = "transmission.lag"
    says = "a shear-thinning fluid between what slides"
    limits = first.LAG

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.drag, a.drag_index = self.size * self.on(line), float(self.rng().uniform(0.8, 1.0))
        a.drag_gap = max(self.size, 0.02) * line.usual_speed * line.gain


class Creep(Cause):
    id = "transmission.creep"
    says = "a polymer cable creeps by Andrade's power of time over three decades"
    limits = first.CREEP

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        times = np.array([0.3, 1.0, 3.0, 10.0, 30.0, 90.0])
        shares = times ** float(self.rng().uniform(0.15, 0.4))
        late = sum(s * follow(c, float(t)) for s, t in zip(shares / shares.sum(), times, strict=True))
        return np.asarray(c + self.size * self.on(line) * (late - c))


class StickSlip(Cause):
    id = "transmission.stick_slip"
    says = "the tip hangs in pinning sites of scattered strength and jumps; fast, it runs over them"
    limits = first.JUMP
    massless = True

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        sites = rng.gamma(4.0, 0.25, 4000)
        met = np.abs(np.cumsum(np.abs(np.gradient(line.q)))) * line.gain / (0.3 * self.size * m.width_deg)
        fast = np.exp(-np.abs(follow(line.speed, 0.05)) / (float(rng.uniform(0.8, 2.0)) * line.usual_speed))
        a.pins = 2 * self.size * m.width_deg * sites[met.astype(int) % sites.size] * fast * self.on(line)


class Drift(Cause):
    id = "transmission.drift"
    says = "moisture swells a cable by the root of time, or friction wears in"
    limits = first.DRIFT

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        gone = np.sqrt(self.clock(line) / 100.0) if rng.random() < 0.5 else np.expm1(-self.clock(line) / 150.0) / -0.487
        if rng.random() < 0.65:
            a.q = a.q + float(rng.choice([-1, 1])) * self.size * line.width * gone
        else:
            a.rub = a.rub * np.maximum(1 + float(rng.choice([-0.5, 1])) * 1.6 * self.size * gone, 0.05)


class LoadDependence(Cause):
    id = "transmission.load_dependence"
    says = "a weight pulls at the tip and presses, by Hertz's power, on what rubs"
    limits = first.LOAD
    needs_column = "load_mNm"

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        share = self.size * self.on(line) * line.sides["load_mNm"] / FULL_LOAD
        a.pull = a.pull + float(self.rng().choice([-0.35, 0.35])) * share
        a.rub = a.rub * (1 + 0.8 * np.abs(share) ** (2 / 3) * self.size ** (1 / 3))


class Slip(Cause):
    id = "transmission.slip"
    says = "a cable skids on its drum, one to four times, where it pulls hardest"
    limits = first.TOOTH

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        way = float(rng.choice([-1.0, 1.0]))
        begin, end = (line.t[0] + 8.0, line.t[-1]) if self.since == "start" else tested(line)
        driven = (line.t > begin + 2) & (line.t < end - 2) & (way * line.speed > 0.3 * line.usual_speed)
        places = np.flatnonzero(driven & (way * line.q > 0.3 * line.reach))
        for k in rng.choice(places, int(rng.integers(1, 5))).tolist():
            gone = np.clip((line.t - line.t[k]) / float(rng.uniform(0.03, 0.12)), 0.0, 1.0)
            a.q = a.q - way * self.size * line.width * float(rng.uniform(0.6, 1.4)) * gone


class Backlash(Cause):
    id = "transmission.backlash"
    says = "friction is not what it was"
    limits = first.WIDTH_CHANGE
    moves, may_start = True, False

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.rub = a.rub * (1 + float(self.rng().choice([-1.0, 1.5])) * self.size * self.on(line))


class Offset(Cause):
    id = "transmission.offset"
    says = "homed elsewhere"
    limits = first.OFFSET_CHANGE
    moves, may_start = True, False

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.q = a.q + float(self.rng().choice([-1, 1])) * self.size * line.width * self.on(line)


class Remaining(Cause):
    id = "configuration.remaining"
    says = "another dimension in the drive's geometry"
    limits = first.LAW_CHANGE
    moves, may_start = True, False

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        a.law = a.law + float(self.rng().choice([-1, 1])) * self.size * self.on(line)


class Contact(Cause):
    id = "configuration.contact"
    says = "tissue that stiffens exponentially (Fung) beyond some angle"
    limits = first.WALL
    strongest = 20.0

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        up, out = m.need(m.xs, 1.0), m.need(m.xs, 1.0, 1.0, 0.1)
        gives = np.interp(0.0, m.xs, out - up) / 0.1 / m.limit  # of the drive by the spring's stiffness
        a.tissue = self.size / (1.0 - self.size) / (line.gain * gives) * self.on(line)
        a.tissue_at, a.tissue_side = float(rng.uniform(0.1, 0.55)) * m.limit, float(rng.choice([-1, 1]))
        a.tissue_hardens = float(rng.uniform(0.3, 1.5)) / m.limit


class Swing(Cause):
    id = "configuration.swing"
    says = "the tip swings on its slender end, in two modes of a cantilever with a mass"
    limits = first.SWING

    def bend(self, line: Line, c: FloatArray) -> FloatArray:
        rng = self.rng()
        rate, damping = first.SWING_RATE.draw(rng), first.SWING_DAMPING.draw(rng)
        both = 0.85 * swings(c, rate, damping) + 0.15 * swings(c, 3.2 * rate, damping)
        return np.asarray(c + self.size * self.on(line) * (both - c))


class AxisCoupling(Cause):
    id = "configuration.axis_coupling"
    says = "another joint bends the cable's path over a pulley, half of them through a gap"
    limits = first.COUPLING

    def ask(self, line: Line, m: Mechanism, a: Ask) -> None:
        rng = self.rng()
        name = str(rng.choice([c for c in line.sides if c in STROKES]))
        stroke = STROKES[name]
        moved = line.sides[name]
        if rng.random() < 0.5:
            half = 0.5 * float(rng.uniform(0.05, 0.3)) * stroke
            moved = play(moved - half, moved + half, float(moved[0]))
        lead = float(rng.uniform(0.3, 1.0))
        path = (np.sin(lead + moved / stroke) - np.sin(lead)) / np.cos(lead)
        a.q = a.q + float(rng.choice([-2, 2])) * self.size * line.width * self.on(line) * path

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"column": str(self.rng().choice([c for c in line.sides if c in STROKES]))}


DRIVE = (
    EncoderPeriodic, SmoothOnset, AsymmetricBacklash, RateDependentBacklash, Lag, Creep, StickSlip, Drift,
    LoadDependence, Slip, Backlash, Offset, Remaining, Contact, Swing, AxisCoupling,
)  # fmt: skip
