"""Causes in the drive and between motor and tip that formats.md lists."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from tools.family_two import ranges
from tools.family_two.causes.base import Cause, follow
from tools.family_two.friction import project
from tools.family_two.mechanism import Demand, Mechanism
from tools.family_two.motion import STEP
from tools.family_two.timeline import Timeline

FloatArray = NDArray[np.float64]
STROKES = {"translation_mm": 5.0, "rotation_deg": 10.0, "wrist_deg": 40.0}
FULL_LOAD = 50.0  # mNm


class Encoder(Cause):
    id = "actuator.encoder_periodic"
    says = "the encoder's disc sits off its shaft: the log errs once per turn, and by a little twice"
    limits = ranges.ENCODER

    def turn(self, line: Timeline) -> float:
        """A turn in units of q: 360 deg where the motor makes a good part of one, else what gear and drum make."""
        return 360.0 if line.reach > 250 else line.reach * float(self.rng.uniform(0.25, 0.7))

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {"period": self.turn(line), "amplitude": self.size * self.turn(line)}

    def logged(self, line: Timeline, t: FloatArray, q: FloatArray) -> FloatArray:
        turn = self.turn(line)
        begin, double = self.rng.uniform(0, 2 * np.pi, 2)
        angle = 2 * np.pi * q / turn
        wave = np.sin(angle + begin) + 0.12 * np.sin(2 * angle + double)
        return np.asarray(self.size * turn * wave * line.at(self.on(line), t))


class SmoothOnset(Cause):
    id = "transmission.smooth_onset"
    says = (
        "friction lets go bit by bit: tubes curved along their length, unequal teeth, fibres, yarns, an elasto-plastic "
        "guide, soft bristles of LuGre's"
    )
    limits = ranges.ROUNDING

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        on = self.on(line)
        demand.spread = np.where(on > 0, self.size, demand.spread)


class Asymmetric(Cause):
    id = "transmission.asymmetric_backlash"
    says = "breakaway above kinetic friction one way only, which wears off as it slides"
    limits = ranges.BREAKAWAY

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        rng = self.rng
        return {"way": int(rng.choice([-1, 1])), "wears_off": 2 * ranges.CATCH_UP.draw(rng)}

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        values = self.parameters(line)
        demand.feel.extra = 2 * self.size * self.on(line)
        demand.feel.way, demand.feel.wears = int(values["way"]), float(values["wears_off"])


class RateDependent(Cause):
    id = "transmission.rate_dependent_backlash"
    says = "friction grows with the logarithm of speed"
    limits = ranges.RATE

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        knee = ranges.RATE_SPEED.draw(self.rng) * line.usual_speed
        demand.friction *= 1 + self.on(line) * self.size * np.log1p(np.abs(line.speed) / knee)


class Lag(Cause):
    id = "transmission.lag"
    says = "viscous drag against the transmission's stiffness, in the balance of forces itself"
    limits = ranges.LAG

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        demand.feel.drag = self.size * self.on(line)


class Creep(Cause):
    id = "transmission.creep"
    says = "the member behind the friction is viscoelastic: Kelvin-Voigt elements of one or two times"
    limits = ranges.CREEP

    def times(self) -> list[float]:
        rng = self.rng
        return [ranges.CREEP_TIME.draw(rng) for _ in range(int(rng.integers(1, 3)))]

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {f"tau_{i}": tau for i, tau in enumerate(self.times())}

    def bend(self, line: Timeline, c: FloatArray) -> FloatArray:
        late = sum(c - follow(c, STEP, tau) for tau in self.times()) / len(self.times())
        return np.asarray(c - self.on(line) * self.size * late)


class StickSlip(Cause):
    id = "transmission.stick_slip"
    says = "static above kinetic friction: scattered jumps, smaller when fast; LuGre with Stribeck where there is mass"
    limits = ranges.JUMP

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        on = self.on(line)
        rng = self.rng
        scatter = rng.uniform(0.6, 1.4, int(line.t[-1] / 0.2) + 2)
        each = scatter[(line.t / 0.2).astype(int)]
        slower = 1 / (1 + np.abs(line.speed) / (2 * line.usual_speed))
        if mechanism.massive:
            demand.stribeck = 1 + 2 * self.size * on * each
        else:
            demand.feel.stick = 2 * self.size * on * each * slower


class Drift(Cause):
    id = "transmission.drift"
    says = "the cable lengthens, or friction changes, evenly or ever more slowly"
    limits = ranges.DRIFT

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        rng = self.rng
        return {
            "of": str(rng.choice(["offset", "width"])),
            "law": str(rng.choice(["linear", "logarithm"])),
            "sign": float(rng.choice([-1.0, 1.0])),
        }

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        values = self.parameters(line)
        begin = 0.0 if self.since == "start" else line.changed
        t = np.maximum(line.t - begin, 0.0)
        course = t / 100.0 if values["law"] == "linear" else np.log1p(t / 10.0) / np.log(11.0)
        change = self.size * float(values["sign"]) * course
        if values["of"] == "offset":
            demand.q += change * line.width
        else:
            demand.friction *= np.maximum(1 + change, 0.15)


class Load(Cause):
    id = "transmission.load_dependence"
    says = "load stretches the drive and presses what rubs"
    limits = ranges.LOAD
    needs_column = "load_mNm"

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        presses = float(self.rng.uniform(0.0, 1.0))
        load = self.on(line) * line.sides["load_mNm"] / FULL_LOAD * self.size
        demand.torque += load
        demand.friction *= 1 + presses * load


class Slip(Cause):
    id = "transmission.slip"
    says = "a tooth, a winding or counts are lost: the offset jumps"
    limits = ranges.TOOTH

    def jumps(self, line: Timeline) -> list[tuple[float, float]]:
        """When, and by how many teeth; each while the motor moves in a test."""
        rng = self.rng
        tests = [p for p in line.parts if p.tested]
        moving = np.abs(line.speed) > 0.3 * line.usual_speed
        out = []
        for _ in range(int(rng.integers(1, 4))):
            part = tests[int(rng.integers(len(tests)))]
            inside = np.arange(part.first + part.count // 6, part.first + 5 * part.count // 6)
            inside = inside[moving[inside]]
            out.append((float(line.t[int(rng.choice(inside))]), float(rng.choice([-1.0, 1.0, 1.0]))))
        return sorted(out)

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        jump: dict[str, float | str] = {"jump": self.size * line.width}
        return jump | {f"at_{i}_s": when for i, (when, _) in enumerate(self.jumps(line))}

    may_start = False

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        for when, teeth in self.jumps(line):
            demand.q += self.size * line.width * teeth * (line.t >= when)


class Backlash(Cause):
    id = "transmission.backlash"
    says = "friction is another than when calibrated"
    limits = ranges.WIDTH_CHANGE
    may_start, moves = False, True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        sign = float(self.rng.choice([-1.0, 1.0]))
        demand.friction *= 1 + sign * self.size * self.on(line)


class Offset(Cause):
    id = "transmission.offset"
    says = "homed elsewhere, or another tension"
    limits = ranges.OFFSET_CHANGE
    may_start, moves = False, True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        demand.q += float(self.rng.choice([-1.0, 1.0])) * self.size * line.width * self.on(line)


class Remaining(Cause):
    id = "configuration.remaining"
    says = "the drive's geometry is another: a pulley's radius, a horn's angle"
    limits = ranges.LAW_CHANGE
    may_start, moves = False, True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        slope, curve = self.rng.uniform(-1, 1, 2) / 1.2
        share = demand.q / line.reach
        demand.q += self.size * line.reach * (slope * share + 0.6 * curve * share**2) * self.on(line)


class Coupling(Cause):
    id = "configuration.axis_coupling"
    says = "another joint lengthens the cable's path, some through their own gap"
    limits = ranges.COUPLING

    def column(self, line: Timeline) -> str:
        return str(self.rng.choice(sorted(c for c in line.sides if c in STROKES)))

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {"column": self.column(line)}

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        name = self.column(line)
        moved = line.sides[name] / STROKES[name]
        if self.rng.random() < 0.3:
            moved = project(moved - 0.15, moved + 0.15, 0.0)
        demand.q += 2 * self.size * line.width * moved * self.on(line)


class Contact(Cause):
    id = "configuration.contact"
    says = "something that yields holds the tip back beyond some angle, against the transmission's stiffness"
    limits = ranges.WALL
    may_start, moves = False, True

    def act(self, demand: Demand, line: Timeline, mechanism: Mechanism) -> None:
        rng = self.rng
        place = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.25, 0.6)) * mechanism.limit
        demand.wall = (place, self.size / (1 - min(self.size, 0.97)) * self.on(line))

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        rng = self.rng
        return {"place": float(rng.choice([-1.0, 1.0]) * rng.uniform(0.25, 0.6))}


class Swing(Cause):
    id = "configuration.swing"
    says = "a mass on a slender end rings"
    limits = ranges.SWING

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        rng = self.rng
        return {"rate_hz": ranges.SWING_RATE.draw(rng), "damping": ranges.SWING_DAMPING.draw(rng)}

    def bend(self, line: Timeline, c: FloatArray) -> FloatArray:
        values = self.parameters(line)
        w, z = 2 * np.pi * float(values["rate_hz"]), float(values["damping"])
        (num, den, _) = cont2discrete((np.array([w * w]), np.array([1.0, 2 * z * w, w * w])), STEP, method="foh")
        rung = lfilter(np.ravel(num), den, c - c[0]) + c[0]
        return np.asarray(c + self.size * self.on(line) * (rung - c))


TRANSMISSION: tuple[type[Cause], ...] = (
    Encoder, SmoothOnset, Asymmetric, RateDependent, Lag, Creep, StickSlip, Drift, Load, Slip, Backlash, Offset,
    Remaining, Coupling, Contact, Swing,
)  # fmt: skip
