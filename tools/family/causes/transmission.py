"""Causes between motor and tip that formats.md lists."""

import math

import numpy as np
from tools.family import ranges
from tools.family.causes.base import Cause, follow
from tools.family.line import Line


class Eccentric(Cause):
    id = "actuator.encoder_periodic"
    limits = ranges.ENCODER
    says = "the encoder's disc or magnet sits off the shaft: once per turn, with a little of the second harmonic"

    def _turn(self, line: Line) -> float:
        return line.reach * float(self.rng().uniform(0.25, 1.1))

    def encoder(self, line: Line, t: np.ndarray, q: np.ndarray, part: int) -> np.ndarray | float:
        if self.since == "test" and line.names[part] == "calibration":
            return 0.0
        angle = 2 * np.pi * q / self._turn(line) + float(self.rng().uniform(0, 6.28))
        return self.size * self._turn(line) * (np.sin(angle) + 0.1 * np.sin(2 * angle + 1.0))

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"amplitude": self.size * self._turn(line), "period": self._turn(line)}


class Rounded(Cause):
    id = "transmission.smooth_onset"
    limits = ranges.ROUNDING
    says = (
        "presliding friction of the outer cover behind an elastic end: Dahl's, Bouc-Wen's or strands that slip in turn"
    )

    def kind(self) -> str:
        return str(self.rng().choice(["dahl", "bouc-wen", "strands"]))

    def _jointed(self, line: Line) -> bool:
        return line.joints and self.kind() == "strands"

    def spread(self, line: Line) -> np.ndarray | None:
        """Joints of a backbone that rub unequally start one after another."""
        return self.on(line) * min(1.2 * self.size, 0.95) if self._jointed(line) else None

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        if self._jointed(line):
            return c
        reach = self.size * line.width * line.gain  # deg of the tip over which the onset rounds off
        lost = {"dahl": self._dahl, "bouc-wen": self._bouc_wen, "strands": self._strands}[self.kind()](c, abs(reach))
        return c - self.on(line) * lost

    @staticmethod
    def _dahl(c: np.ndarray, reach: float) -> np.ndarray:
        """dz = (1 - z sgn(dc) / z_max) dc / 2, exact for a monotone step: dz = dc at a reversal, z_max is l."""
        most, z, out = reach / 2, 0.0, np.empty_like(c)
        last = float(c[0])
        for i, x in enumerate(c.tolist()):
            if x != last:
                side = most if x > last else -most
                z = side + (z - side) * math.exp(-abs(x - last) / (2 * most))
                last = x
            out[i] = z
        return out

    @staticmethod
    def _bouc_wen(c: np.ndarray, reach: float) -> np.ndarray:
        """dz = (1 - |z / z_max|^2 (1 + sgn(z dc)) / 2) dc, in sub-steps of a tenth of z_max."""
        most, z, out = reach / 2, 0.0, np.empty_like(c)
        last = float(c[0])
        for i, x in enumerate(c.tolist()):
            if x != last:
                n = min(int(abs(x - last) / (0.1 * most)) + 1, 60)
                d = (x - last) / n
                for _ in range(n):
                    z += d * (1 - (z / most) ** 2) if z * d > 0 else d
                    z = min(max(z, -most), most)
                last = x
            out[i] = z
        return out

    @staticmethod
    def _strands(c: np.ndarray, reach: float) -> np.ndarray:
        """Five strands in parallel, each elastic up to its own slip."""
        limits = reach / 2 * np.array([0.2, 0.5, 0.9, 1.4, 2.0])
        out, z, last = np.empty_like(c), np.zeros(5), float(c[0])
        for i, x in enumerate(c.tolist()):
            if x != last:
                z = np.minimum(np.maximum(z + (x - last), -limits), limits)
                last = x
            out[i] = z.mean()
        return out

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"travel_deg": self.size * line.width * line.gain, "kind": self.kind()}


class OneWayBreakaway(Cause):
    id = "transmission.asymmetric_backlash"
    limits = ranges.BREAKAWAY
    says = "a braided sheath's lay: one way it breaks away late, and the excess force wears off as it slides"

    def breakaway(self, line: Line) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
        share, none = self.size * self.on(line), np.zeros_like(line.t)
        travel = line.width * line.gain * ranges.CATCH_UP.draw(self.rng())
        return (share, none, none, travel) if self.seed % 2 else (none, share, none, travel)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"excess": self.size, "direction": 1.0 if self.seed % 2 else -1.0}


class SpeedFriction(Cause):
    id = "transmission.rate_dependent_backlash"
    limits = ranges.RATE
    says = "a polymer liner: friction grows with the logarithm of the cable's speed"

    def friction(self, line: Line) -> tuple[np.ndarray | float, np.ndarray | float]:
        slow = line.usual * ranges.RATE_SPEED.draw(self.rng())
        factor = 1 + self.size * self.on(line) * np.log1p(np.abs(line.speed) / slow)
        return factor, factor


class Viscous(Cause):
    id = "transmission.lag"
    limits = ranges.LAG
    says = "a wet channel: viscous drag against the section's spring, first order"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        late = follow(line, c, max(abs(self.size), 1e-4))
        return np.where(self.on(line) > 0, late, c)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"tau_s": self.size}


class Creep(Cause):
    id = "transmission.creep"
    limits = ranges.CREEP
    says = "a standard linear solid behind the friction: part of the motion arrives late, one or two time constants"

    def _times(self) -> list[float]:
        r = self.rng()
        first = ranges.CREEP_TIME.draw(r)
        return [first] if r.random() < 0.6 else [first, first * 4]

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        late = np.mean([follow(line, c, tau) for tau in self._times()], axis=0)
        return c - self.on(line) * self.size * (c - late)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"share": self.size, "tau_s": self._times()[0]}


class StickSlip(Cause):
    id = "transmission.stick_slip"
    limits = ranges.JUMP
    says = "static above kinetic friction at a soft tip: it holds and jumps, less when fast, each jump of another size"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        base = abs(self.size) * line.width * line.gain
        jump = base / (1 + np.abs(line.speed) / (3 * line.usual))
        dice = r.uniform(0.6, 1.4, 4096).tolist()
        out, held, k = np.empty_like(c), float(c[0]), 0
        for i, (x, j) in enumerate(zip(c.tolist(), jump.tolist(), strict=True)):
            if abs(x - held) > j * dice[k % 4096]:
                held, k = x, k + 1
            out[i] = held
        return np.where(self.on(line) > 0, out, c)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"jump_deg": self.size * line.width * line.gain}


class Drift(Cause):
    id = "transmission.drift"
    limits = ranges.DRIFT
    says = "the cable settles or the sheath warms: offset or friction moves, evenly or ever more slowly"
    may_start = False

    def _course(self, line: Line) -> np.ndarray:
        if self.seed % 3:
            return line.past / 100
        return 1.6 * (1 - np.exp(-line.past / 60))

    def _offset(self) -> bool:
        return bool(self.rng().random() < 0.6)

    def drive(self, line: Line) -> np.ndarray | float:
        return (1 if self.seed % 2 else -1) * self.size * line.width * self._course(line) if self._offset() else 0.0

    def friction(self, line: Line) -> tuple[np.ndarray | float, np.ndarray | float]:
        if self._offset():
            return 1.0, 1.0
        factor = np.maximum(1 + (1 if self.seed % 2 else -0.6) * self.size * self._course(line), 0.2)
        return factor, factor

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"of": "offset" if self._offset() else "width", "share_per_100_s": self.size}


class Load(Cause):
    id = "transmission.load_dependence"
    limits = ranges.LOAD
    says = "a load at the tip stretches the cable (offset) and presses it on the sheath (friction)"
    needs_column = "load_mNm"

    def _loaded(self, line: Line) -> np.ndarray:
        load = line.sides["load_mNm"]
        return self.on(line) * load / max(float(np.max(np.abs(load))), 1e-9)

    def _part(self) -> float:
        return float(self.rng().choice([0.0, 0.5, 1.0]))  # of the offset in the whole

    def drive(self, line: Line) -> np.ndarray | float:
        return -self.size * self._part() * line.width * self._loaded(line)

    def friction(self, line: Line) -> tuple[np.ndarray | float, np.ndarray | float]:
        factor = np.maximum(1 + self.size * (1 - self._part()) * self._loaded(line), 0.1)
        return factor, factor

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"offset_share": self.size * self._part(), "width_share": self.size * (1 - self._part())}


class Slip(Cause):
    id = "transmission.slip"
    limits = ranges.TOOTH
    says = "a belt jumps a tooth, a winding falls or counts are lost: once, or a few times the same way"
    may_start = False

    def jumps(self, line: Line) -> list[float]:
        """Instants, s: inside the tests, away from their ends."""
        r = self.rng()
        tests = [i for i, n in enumerate(line.names) if n.startswith("test")]
        spans = []
        for i in tests:
            t = line.t[(line.part == i) & line.frame]
            spans.append((float(t[0]), float(t[-1])))
        count = 1 if r.random() < 0.5 else int(r.integers(2, 5))
        picked = [spans[r.integers(len(spans))] for _ in range(count)]
        return sorted(a + (b - a) * float(r.uniform(0.25, 0.75)) for a, b in picked)

    def drive(self, line: Line) -> np.ndarray | float:
        side = 1 if self.seed % 2 else -1
        return side * self.size * line.width * np.sum([line.t >= j for j in self.jumps(line)], axis=0)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"jump": self.size * line.width, "count": float(len(self.jumps(line)))}


class Width(Cause):
    id = "transmission.backlash"
    limits = ranges.WIDTH_CHANGE
    says = "the same instrument in another posture or more worn: all friction is another"
    may_start = False
    moves = True

    def friction(self, line: Line) -> tuple[np.ndarray | float, np.ndarray | float]:
        factor = 1 + (self.size if self.seed % 3 else -self.size) * self.on(line)
        return factor, factor


class Offset(Cause):
    id = "transmission.offset"
    limits = ranges.OFFSET_CHANGE
    says = "homed or tensioned anew between the recordings"
    may_start = False
    moves = True

    def drive(self, line: Line) -> np.ndarray | float:
        return (1 if self.seed % 2 else -1) * self.size * line.width * self.on(line)

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"offset": (1 if self.seed % 2 else -1) * self.size * line.width}


class Swing(Cause):
    id = "configuration.swing"
    limits = ranges.SWING
    says = "a slender section with a heavy tip swings, lightly damped"

    def bend(self, line: Line, c: np.ndarray) -> np.ndarray:
        r = self.rng()
        omega, zeta = 2 * math.pi * ranges.SWING_RATE.draw(r), ranges.SWING_DAMPING.draw(r)
        # y'' + 2 zeta w y' + w^2 y = w^2 c, exact for c straight between instants, as one complex pole
        pole = complex(-zeta * omega, omega * math.sqrt(1 - zeta * zeta))
        step = np.diff(line.t)
        slope = np.diff(c) / step
        decay = np.exp(pole * step)
        # e = y - c obeys the same equation driven by the change of slope; between instants it is free
        out, y, v = np.zeros_like(c), 0.0, 0.0
        last = 0.0
        im = pole.imag
        for i, (m, d) in enumerate(zip(slope.tolist(), decay.tolist(), strict=True), 1):
            target = -2 * zeta / omega * m  # where y - c settles on a ramp
            v += last - m  # the slope of y stays, that of c changes
            last = m
            a = y - target
            b = (v - pole.real * a) / im
            y = target + d.real * a + d.imag * b
            v = pole.real * (y - target) + im * (-d.imag * a + d.real * b)
            out[i] = y
        return c + self.on(line) * self.size * out

    def parameters(self, line: Line) -> dict[str, float | str]:
        return {"share": self.size, "rate_hz": ranges.SWING_RATE.draw(self.rng())}
