"""The mechanisms without mass, each by its own balance of forces; the one with mass is in inertial.py."""

import numpy as np
from numpy.typing import NDArray

from tools.family_two import ranges
from tools.family_two.mechanism import Mechanism, Number

FloatArray = NDArray[np.float64]


class Tubes(Mechanism):
    """Two precurved tubes turned against each other: torsion of a rod that rubs along its whole length.

    In plane the pair bends by bend sin(x) of the angle x turned at its tip. GJ x'' = friction per length, so from base
    to tip f L^2 / 2 GJ is lost each way, and the curvatures' own torque sin 2x twists the shafts besides. Beyond a
    slip front the shaft still rests: a place at depth z starts to turn only when the base has come back by f z^2 / GJ.
    A pair that is curved along part of its length starts gradually.
    """

    unit, arm = "deg", False

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(45.0, 60.0))
        self.bend = float(rng.uniform(35.0, 65.0))
        self.twist = float(rng.uniform(0.08, 0.3))  # M L / GJ, below 1/2: no snap
        self.press = float(rng.uniform(-0.25, 0.4))
        self.uneven = float(rng.uniform(-0.2, 0.2))
        self.finish(ranges.TUBE_WIDTH.draw(rng))

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        a = np.radians(x)
        rub = self.friction * (1 + self.press * np.sin(a) ** 2 + self.uneven * np.sin(a))
        pull = self.twist * (np.degrees(np.sin(2 * a)) / 2) + self.unit_torque * torque
        return np.asarray(x + (pull + s * rub))

    def tip(self, x: FloatArray) -> FloatArray:
        return np.asarray(self.bend * np.sin(np.radians(x)))

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        """Places along the curved part, from the tip back by `spread`: each is a sum of plays by the rod's equation.

        A place at z (of the length) answers a reversal by (sqrt(d) - z)^2, d the base's way back over f L^2 / GJ, until
        the front has reached the tip: density z / (2 d^1.5) between z^2 and 1, and z at the tip's own threshold.
        """
        if spread <= 0:
            return [(1.0, 1.0)]
        places = 1 - spread * (np.arange(5) + 0.5) / 5
        edges = np.linspace(max(1 - spread, 0.02) ** 2, 1.0, 9)
        density = np.zeros(8)
        for z in places:
            reached = z / np.sqrt(np.clip(edges, z**2, 1.0))  # 1 at z^2, z at 1
            density += -np.diff(reached) / places.size
        middles = 0.5 * (edges[1:] + edges[:-1])
        pairs = [(float(w), float(m)) for w, m in zip(density, middles, strict=True)]
        return [*pairs, (float(places.mean()), 1.0)]


class Harmonic(Mechanism):
    """Harmonic drive and flexible arm: tooth pairs, each with friction and its own lost motion, carry the flexspline.

    The cup follows the mean of its engaged tooth pairs: a Prandtl-Ishlinskii sum of plays. Its torsion stiffens with
    torque; the arm sags as an elastica under its weight.
    """

    unit = "deg"
    teeth = 7

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 40.0))
        self.ratio = float(rng.choice([30.0, 50.0, 80.0, 100.0]))
        self.tilt = float(rng.uniform(-60.0, 60.0))  # of the arm in the middle, from upright
        self.wind = float(rng.uniform(0.3, 2.0))  # deg by the arm's weight when level
        self.hard = float(rng.uniform(0.0, 0.3))
        self.press = float(rng.uniform(0.1, 0.8))  # friction by torque
        self.weight = float(rng.uniform(0.1, 0.8))  # w L^3 / EI of the arm
        self.unequal = float(rng.uniform(0.01, 0.04))
        self.finish(ranges.GEAR_WIDTH.draw(rng))
        self.arm_x = np.linspace(-1.4, 1.4, 141) * self.limit
        self.arm_c = elastica(self.arm_x + self.tilt, self.weight) - self.tilt
        self.arm_c -= np.interp(0.0, self.arm_x, self.arm_c)

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        load = np.sin(np.radians(x + self.tilt)) - np.sin(np.radians(self.tilt))
        whole = self.wind * load + self.unit_torque * torque
        stiffer = 1 / (1 + self.hard * np.tanh(whole / self.wind) ** 2)
        rub = self.friction * (1 + self.press * np.sin(np.radians(x + self.tilt)) ** 2)
        return np.asarray(self.ratio * (x + (whole * stiffer + s * rub)))

    def tip(self, x: FloatArray) -> FloatArray:
        return np.interp(x, self.arm_x, self.arm_c) if hasattr(self, "arm_c") else x

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        wide = spread if spread > 0 else self.unequal
        return [(1 / self.teeth, 1 + wide * float(u)) for u in np.linspace(-1, 1, self.teeth)]


def elastica(base: FloatArray, weight: float) -> FloatArray:
    """End slope (deg from upright) of a heavy cantilever clamped at `base`: EI a'' = -w (L - s) sin a, by shooting."""
    n = 60
    h = 1.0 / n

    def from_tip(tip: FloatArray) -> FloatArray:
        a, k = tip.copy(), np.zeros_like(tip)  # no curvature at the free end
        for i in range(n):  # inwards from it, midpoint rule
            r = i * h
            half_a, half_k = a - 0.5 * h * k, k + 0.5 * h * weight * r * np.sin(a)
            a, k = a - h * half_k, k + h * weight * (r + 0.5 * h) * np.sin(half_a)
        return a

    want = np.radians(base)
    tip = want.copy()
    for _ in range(12):
        miss = from_tip(tip) - want
        tip = tip - miss / ((from_tip(tip + 1e-6) - want - miss) / 1e-6)
    return np.asarray(np.degrees(tip))


class Catenary(Mechanism):
    """A winch pulls a spring-held arm over a free span of heavy cable: the span sags less the harder it is pulled.

    Span: arc 2 T/w sinh(w L / 2 T) and stretch T L / EA; the bearing's friction grows with the pull.
    """

    unit = "mm"

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 40.0))
        self.radius = float(rng.uniform(10.0, 18.0))
        self.span = float(rng.uniform(800.0, 1800.0))
        self.heavy = float(rng.uniform(1.5e-4, 3.5e-4))  # N/mm
        self.least = float(rng.uniform(8.0, 14.0))  # N in the middle
        self.spring = self.least * self.radius * float(rng.uniform(0.12, 0.3)) / self.limit  # N mm / deg
        self.journal = float(rng.uniform(0.2, 0.8))  # mm, friction coefficient times journal radius
        self.friction = self.least * self.radius * float(rng.uniform(0.05, 0.15))
        self.give = 0.0  # mm/N, L / EA: what the width asks for beyond the sag's own share
        wanted, sag = ranges.SPAN_WIDTH.draw(rng), self.lost()
        self.give = 0.1
        self.give = max(0.1 * (wanted - sag) / (self.lost() - sag), 0.01)
        self.finish(self.lost())

    def lost(self) -> float:
        """Healthy width in the middle, deg."""
        middle = np.zeros(1)
        wide = self.need(middle, 1.0) - self.need(middle, -1.0)
        return float(np.degrees(wide[0] / self.radius))

    def arc(self, pull: FloatArray) -> FloatArray:
        u = self.heavy * self.span / (2 * pull)
        return np.asarray(self.span * (np.sinh(u) / u - 1))

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        moment = self.least * self.radius + self.spring * x + self.unit_torque * torque
        pull = np.maximum((moment + s * self.friction) / (self.radius - s * self.journal), 0.3 * self.least)
        middle = np.array([self.least])
        stretch = self.give * (pull - self.least) + self.arc(middle) - self.arc(pull)
        return np.asarray(self.radius * np.radians(x) + stretch)

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        """Fibres of the rope over the pulley slip in turn."""
        return super().contacts(0.0) if spread <= 0 else [(0.2, 1 + spread * u) for u in (-1.0, -0.5, 0.0, 0.5, 1.0)]


class Screw(Mechanism):
    """A lead screw's nut with play pushes a wire through a guide to a crank; the wire gives by its free length."""

    unit = "deg"

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 45.0))
        self.lead = float(rng.choice([0.7, 1.0, 2.0, 4.0]))  # mm a turn
        self.crank = float(rng.uniform(5.0, 12.0))  # mm
        self.rod = self.crank * float(rng.uniform(2.5, 6.0))
        self.free = float(rng.uniform(2.5, 6.0)) * self.crank  # mm of wire between screw and guide
        self.bent = float(rng.uniform(0.0, 0.3))
        self.pressed = float(rng.uniform(-0.15, 0.15))
        self.spring = float(rng.uniform(-0.3, 0.3))  # of the guide's friction, at the limit
        self.nut = float(rng.uniform(0.15, 0.5))  # of the healthy width
        self.gap = 0.0
        width = ranges.NUT_WIDTH.draw(rng)
        self.finish(width * (1 - self.nut))
        self.gap = self.nut * width / self.slope() / 2
        self.finish(width)

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        a, share = np.radians(x), x / self.limit
        slide = self.crank * np.sin(a) + self.rod * (1 - np.sqrt(1 - (self.crank * (1 - np.cos(a)) / self.rod) ** 2))
        guide = self.friction * (1 + self.bent * share**2 + self.pressed * share)
        back = self.friction * self.spring * share / np.cos(a) + self.unit_torque * torque / np.cos(a)
        wire = (self.free + slide) / self.free
        flank = np.tanh(20 * (s * guide + back) / self.friction) if self.friction > 0 else 0.0
        return np.asarray(360 / self.lead * (slide + wire * (s * guide + back)) + self.gap * flank)

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        """Elasto-plastic: part of the wire's push reaches the crank before the guide lets go."""
        return super().contacts(0.0) if spread <= 0 else [(0.35 * spread, 0.02), (1 - 0.35 * spread, 1.0)]


class Twisted(Mechanism):
    """Two strings twisted by a motor shorten and pull a spring-held lever: their rubbing grows with the helix angle.

    (L + stretch)^2 = (r turn)^2 + (L - x)^2; tension is the spring's times 1 +- mu tan(helix).
    """

    unit = "deg"

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(22.0, 32.0))
        self.lever = float(rng.uniform(8.0, 14.0))
        self.string = float(rng.uniform(180.0, 400.0))
        self.thick = float(rng.uniform(0.4, 0.9))
        most = self.lever * np.radians(self.limit)
        self.middle = most * float(rng.uniform(2.4, 4.0))  # contraction in the middle, mm
        self.give = float(rng.uniform(0.02, 0.06))  # mm/N
        self.pull = float(rng.uniform(8.0, 20.0))
        self.spring = float(rng.uniform(0.1, 0.4))
        self.finish(ranges.STRING_WIDTH.draw(rng))

    def turned(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        left = self.string - self.middle - self.lever * np.sin(np.radians(x))
        helix = np.sqrt(np.maximum((self.string / left) ** 2 - 1, 0.0))
        force = self.pull * (1 + self.spring * x / self.limit) + self.unit_torque * torque
        long = self.string + self.give * force * (1 + s * self.friction * helix)
        return np.asarray(np.degrees(np.sqrt(long**2 - left**2) / self.thick))

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        return self.turned(x, s, torque) - float(self.turned(np.zeros(1), 0.0)[0])

    def contacts(self, spread: float) -> list[tuple[float, float]]:
        """Yarns of the strings slip in turn."""
        yarns = ((0.1, -1.0), (0.2, -0.5), (0.4, 0.0), (0.2, 0.5), (0.1, 1.0))
        return super().contacts(0.0) if spread <= 0 else [(w, 1 + spread * u) for w, u in yarns]
