"""Six mechanisms, each by the balance that gives the drive's travel for an angle and a friction to one side."""

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from tools.family_four import ranges
from tools.family_four.mechanism import Mechanism, Value

FloatArray = NDArray[np.float64]


class McKibben(Mechanism):
    """Two pneumatic muscles against each other on a pulley, fed by a spool that shifts pressure between them.

    Chou and Hannaford: F = p g(e), g(e) = 3 (1 - e)^2 / tan^2 a - 1 / sin^2 a, e = e0 +- k x. Braid threads rub by
    pressure and contact, f p (1 + c e), which joins the balance: (1 + y) (g1 - f h1) - (1 - y) (g2 + f h2) = t(x).
    """

    sluggish = True
    widths = ranges.BRAID_WIDTH.lo, ranges.BRAID_WIDTH.hi
    rubs = (0.02, 1.2)

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(22, 38))
        braid = np.radians(rng.uniform(19, 25))
        self.a, self.b = float(3 / np.tan(braid) ** 2), float(1 / np.sin(braid) ** 2)
        self.e0 = float(rng.uniform(0.13, 0.17))
        self.k = float(rng.uniform(0.05, 0.085)) / self.limit  # contraction for a deg
        self.contact = float(rng.uniform(0.5, 2.5))
        self.weight, self.lean = float(rng.uniform(0.1, 0.8)), float(rng.uniform(-20, 20))

    def g(self, e: FloatArray) -> FloatArray:
        return self.a * (1 - e) ** 2 - self.b

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        turned = self.k * (1 + np.asarray(law)) * x
        e1, e2 = self.e0 + turned, self.e0 - turned
        g1, g2, h1, h2 = self.g(e1), self.g(e2), 1 + self.contact * e1, 1 + self.contact * e2
        torque = self.weight * np.sin(np.radians(x + self.lean)) + push
        return np.asarray((g2 - g1 + torque + f * (h1 + h2)) / (g1 + g2 - f * (h1 - h2)))


class Notched(Mechanism):
    """A laser-cut, precurved tube bent by one cable that rubs in the bend it makes itself.

    dT = -f T dy along the bend and dy proportional to T: T0 = K (exp(f y) - 1) / f for a bend y. The edges of notches
    meet over a spread of bends; the cable shortens by 2 n sin(y / 2 n) and stretches by its pull; a seal rubs too.
    """

    arm = False
    widths = ranges.SELF_WIDTH.lo, ranges.SELF_WIDTH.hi

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(30, 55))
        self.y0 = float(np.radians(self.limit) * rng.uniform(1.7, 2.6))
        self.notches = int(rng.integers(5, 21))
        self.stretch = float(rng.uniform(0.15, 0.7))
        self.seal = float(rng.uniform(0.5, 3.0))
        self.meet, self.spread = float(self.y0 * rng.uniform(1.0, 1.5)), float(self.y0 * rng.uniform(0.25, 0.5))
        self.stop = float(rng.uniform(0.1, 0.8))

    def closing(self, y: FloatArray) -> FloatArray:
        """Moment of edges that meet, normally spread: the integral of the share that has met."""
        z = (y - self.meet) / self.spread
        met = z * ndtr(z) + np.exp(-0.5 * z * z) / np.sqrt(2 * np.pi)
        return np.asarray(self.stop * self.spread * met)

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        y = self.y0 + np.radians(x)
        held = y + self.closing(y) + push
        z = f * y + 1e-12
        pull = held * np.expm1(z) / z + f * self.seal
        shortened = 2 * self.notches * np.sin(y / 2 / self.notches) + law * np.radians(x)
        return np.asarray(shortened + self.stretch * pull)


class Toggle(Mechanism):
    """A knee of two links pushed sideways by a rod; it opens a jaw against a spring.

    y = 2 (1 - cos a) = y0 + r sin x and F = 2 P tan(a + f): friction circles of the pins tilt the links' thrust by f;
    the drive moves sin a and gives by F; the rod's guide rubs too.
    """

    widths = ranges.PIN_WIDTH.lo, ranges.PIN_WIDTH.hi
    strokes = (1.5, 6.0)

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(18, 32))
        self.y0 = float(2 * (1 - np.cos(np.radians(rng.uniform(38, 46)))))
        self.r = float(rng.uniform(0.1, 0.19) / np.sin(np.radians(self.limit)))
        self.pre, self.spring = float(rng.uniform(0.5, 1.0)), float(rng.uniform(0.2, 0.6))
        self.stretch, self.guide = float(rng.uniform(0.05, 0.3)), float(rng.uniform(0.0, 2.0))

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        r, turned = self.r * (1 + np.asarray(law)), np.radians(x)
        cos = 1 - 0.5 * (self.y0 + r * np.sin(turned))
        thrust = self.pre + self.spring * x / self.limit + push / np.cos(turned)
        a = np.arccos(np.clip(cos, -1, 1))
        return np.asarray(np.sin(a) + self.stretch * (2 * thrust * np.tan(a + f) + self.guide * f))


class Pushrod(Mechanism):
    """A super-elastic rod pushed and pulled in a curved, wet channel, which bends a section at its end.

    F cosh(f b) + sinh(f b) sqrt(F^2 + F0^2) is the force at the drive: Euler's friction over the channel's bend b, on
    walls that the rod's own stiffness presses too. Under push it snakes in its clearance, shorter by the square of it.
    """

    arm, sluggish = False, True
    widths = ranges.CHANNEL_WIDTH.lo, ranges.CHANNEL_WIDTH.hi

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(35, 65))
        self.bend = float(rng.uniform(1.5, 5.0))
        self.pressed, self.hard = float(rng.uniform(0.5, 1.5)), float(rng.uniform(0.0, 0.35))
        self.stretch, self.snakes = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0.0, 0.15))

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        u = np.asarray(x) / self.limit
        out = u + self.hard * u**3 + push
        force = out * np.cosh(f * self.bend) + np.sinh(f * self.bend) * np.hypot(out, self.pressed)
        snaked = self.snakes * 0.25 * (force + np.hypot(force, 0.5)) ** 2
        return np.asarray((1 + np.asarray(law)) * u * (1 - 0.06 * u * u) + self.stretch * (force + snaked))


class Cycloid(Mechanism):
    """A cycloidal reducer, pins with clearance, and an arm that hangs.

    T = sum over pins of l (z l - g)^(3/2): Hertz's contacts that bear one after the other, z the wind-up. What rubs at
    the output is more than its weight, so the same flanks bear all along a stroke. Width: both gaps and both wind-ups.
    """

    unit = "deg"
    widths = ranges.CYCLOID_WIDTH.lo, ranges.CYCLOID_WIDTH.hi
    strokes = (90.0, 700.0)
    rubs = (0.2, 12.0)

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25, 40))
        levers = np.sin(np.pi * (np.arange(1, 12) - 0.5) / 11)
        gap = float(rng.uniform(0.2, 1.4))  # deg at the largest lever
        wind = np.concatenate([np.linspace(0, 1, 40) ** 2 * 0.1 * gap, np.geomspace(0.101 * gap, 12.0 + gap, 400)])
        stiff = float(rng.uniform(0.5, 3.0))
        over = np.maximum(wind[:, None] * levers - gap, 0.0)
        torque = stiff * np.sum(levers * over**1.5, axis=1)
        bears = torque > 0
        self.torques = np.concatenate([[0.0], torque[bears]])
        self.winds = np.concatenate([[gap], wind[bears]])
        self.weight, self.lean = float(rng.uniform(0.05, 0.5)), float(rng.uniform(-15, 15))
        self.grease = float(rng.uniform(0.0, 0.15))
        self.lever = float(rng.uniform(-0.08, 0.08))

    def wound(self, torque: FloatArray) -> FloatArray:
        """Wind-up under a torque, deg: even at a hair of it the flanks are a gap apart."""
        size = np.abs(torque)
        z = np.interp(size**0.5, self.torques**0.5, self.winds)
        return np.asarray(np.tanh(torque / 0.01) * z)

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        u = np.asarray(x) / self.limit
        weight = self.weight * np.sin(np.radians(x + self.lean)) + push
        torque = weight + f * (1 + self.grease * u)
        geared = np.asarray(x) * (1 + np.asarray(law) + self.lever * u + 0.5 * self.lever * u * u)
        return np.asarray(geared + self.wound(torque))


class Belt(Mechanism):
    """A long toothed belt round an idler, and an arm with mass on bearings that its tension loads.

    Spans stretch by the power n of their tension: give ((P + M)^n - (P - M)^n). Bearings rub by the tension, which an
    eccentric pulley varies over the turn. x'' / w^2 + 2 z x' / w + x follows the branches, held at rest by friction.
    """

    unit, massive = "deg", True
    widths = ranges.BELT_WIDTH.lo, ranges.BELT_WIDTH.hi
    strokes = (60.0, 400.0)

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25, 42))
        self.power, self.taut = float(rng.uniform(0.6, 0.95)), float(rng.uniform(1.0, 2.0))
        self.stretch = float(rng.uniform(3.0, 12.0))  # deg
        self.weight, self.lean = float(rng.uniform(0.1, 0.5)), float(rng.uniform(-15, 15))
        self.uneven, self.begins = float(rng.uniform(0.05, 0.3)), float(rng.uniform(0, 360))
        self.rate, self.damping = float(rng.uniform(40, 85)), float(rng.uniform(0.3, 0.8))

    def raw(self, x: Value, f: Value, push: Value, law: Value) -> FloatArray:
        taut = self.taut * (1 + self.uneven * np.sin(np.radians(2 * np.asarray(x) + self.begins)))
        moment = self.weight * np.sin(np.radians(x + self.lean)) + push + 2 * f * taut
        n = self.power
        spans = np.maximum(taut + moment / 2, 0.02) ** n - np.maximum(taut - moment / 2, 0.02) ** n
        return np.asarray(np.asarray(x) * (1 + np.asarray(law)) + self.stretch * spans + 0.02 * self.stretch * moment)
