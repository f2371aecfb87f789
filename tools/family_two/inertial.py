"""The mechanism with mass: an arm on a cable that gives and damps, with LuGre friction, stepped in time."""

from math import exp

import numpy as np
from numpy.typing import NDArray

from tools.family_two import ranges
from tools.family_two.mechanism import Demand, Mechanism, Number
from tools.family_two.motion import STEP

FloatArray = NDArray[np.float64]


class Inertial(Mechanism):
    """Cable, arm with inertia, LuGre friction: x'' = w^2 (T(q, x) l'(x) - spring) - 2 z w x' - friction.

    Implicit Euler, the bristle's equation solved exactly within a step; all moments are over the inertia. At rest it
    holds anywhere in its sticking interval; bristles yield by less than a thousandth of it unless softened.
    """

    unit = "mm"
    massive = True
    bristles = 3000.0  # their stiffness over the cable's

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 40.0))
        self.radius = float(rng.uniform(6.0, 14.0))  # mm
        self.bulge = float(rng.uniform(-0.1, 0.1))  # of the radius, over the limit
        self.rate = float(rng.uniform(40.0, 80.0)) * 2 * np.pi
        self.damping = float(rng.uniform(0.3, 0.6))
        self.spring = float(rng.uniform(0.0, 0.15))
        self.press = float(rng.uniform(-0.2, 0.4))
        self.finish(ranges.WINCH_WIDTH.draw(rng))

    def need(self, x: FloatArray, s: Number, torque: Number = 0.0) -> FloatArray:
        """At rest: where the cable's moment is the spring's and friction's. Moments in deg of the cable's give."""
        a, share = np.radians(x), x / self.limit
        along = self.radius * (a + self.bulge * self.limit * np.pi / 180 * share**3 / 3)
        lever = 1 + self.bulge * share**2  # along' = radius * lever
        moment = self.spring * x + self.unit_torque * torque
        moment = moment + s * self.friction * (1 + self.press * share**2)
        return np.asarray(along + self.radius * np.radians(moment) / lever)

    def run(self, d: Demand) -> FloatArray:
        h, limit, w2 = STEP, self.limit, self.rate**2
        hw2 = h * w2
        damp = 2 * self.damping * self.rate
        e3 = self.bulge / 3 / limit**2
        drive = np.degrees(d.q) / self.radius
        viscous = np.full(d.q.size, damp)
        if d.feel.drag is not None:
            viscous = viscous + w2 * d.feel.drag
        stiff = np.where(np.isnan(d.spread), self.bristles, 1.0 / np.maximum(d.spread, 1.0 / self.bristles))
        static = np.ones(d.q.size) if d.stribeck is None else d.stribeck
        slow = 0.5 * self.limit  # deg/s, Stribeck
        extra = np.zeros(d.q.size) if d.feel.extra is None else d.feel.extra * self.friction
        pulls = self.unit_torque * d.torque
        wall_at, wall = (0.0, np.zeros(d.q.size)) if d.wall is None else d.wall
        way, wears = d.feel.way, d.feel.wears * self.half
        x, v, z, slid = float(np.interp(d.q[0], self.need(self.xs, 0.0), self.xs)), 0.0, 0.0, 0.0
        out, tiny = [], 1e-4
        each = (drive, d.friction * self.friction, viscous, stiff, static, extra, pulls, wall)
        for u, f, c, b, st, more, pull, block in zip(*(a.tolist() for a in each), strict=True):
            share2 = (x / limit) ** 2
            lever = 1 + self.bulge * share2
            g = f * (1 + self.press * share2)
            if st > 1:
                g *= 1 + (st - 1) * exp(-abs(v) / slow)
            if more:
                slid = slid + v * h * way if v * way > -1e-9 else 0.0
                if v * way > 0:
                    g += more * exp(-slid / wears)
            # x+ = x + h v with all forces at the step's end, and the bristle's equation exactly for a constant v.
            # What is left of the balance is monotone in v and bends one way on the root's side of 0: Newton from there
            beyond = x - wall_at
            kw = block if block and beyond * wall_at > 0 else 0.0
            grip = lever * lever + self.spring + kw
            free = lever * (u - x - e3 * x * x * x) - self.spring * x - kw * beyond - pull
            rest, mass = v + hw2 * free, 1 + h * c + h * hw2 * grip
            most, rate = g / b, h * b / g
            side = 1.0 if rest > hw2 * b * z else -1.0
            v = side * max(0.0, (side * rest - hw2 * g) / mass)
            for _ in range(12):
                e = exp(-rate * v * side)
                new = side * most + (z - side * most) * e
                step = (mass * v - rest + hw2 * b * new) / (mass + hw2 * b * h * e * (1 - side * z / most))
                v -= step
                if -tiny < step < tiny:
                    break
            e = exp(-rate * v * side)
            z = side * most + (z - side * most) * e
            x += h * v
            out.append(x)
        return np.array(out)
