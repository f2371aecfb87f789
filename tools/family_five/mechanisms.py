"""Six mechanisms by their balances. u = x / limit; T = u + h u^3 is the return spring's torque, 1 at the limit."""

import math
from typing import Any

import numpy as np

from tools.family_five import ranges
from tools.family_five.mechanism import Ask, FloatArray, Mechanism, Values, asked
from tools.family_two.motion import STEP


def _torque(m: Any, u: Any, pull: Values) -> Any:
    return (u + m.hardens * u**3) / (1 + m.hardens) + pull


class Magnet(Mechanism):
    """A section with a magnet at its tip, steered by a dipole that turns beside its axis; the tip rubs on tissue.

    Field on the axis of a dipole turned by q (Jackson 1999, 5.56): 2 cos q along, sin q across, so the torque on the
    tip is sin q cos x + 2 cos q sin -x; it holds k (T(x) + f N(x)) (Petruska and Abbott 2013).
    """

    unit, arm = "deg", False
    widths = ranges.MAGNET_WIDTH

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(16.0, 26.0))
        self.soft = float(rng.uniform(0.15, 0.4))  # spring at the limit over the magnets' torque
        self.hardens = float(rng.uniform(0.0, 0.3))
        self.leans = float(rng.uniform(0.1, 0.6))  # growth of the contact force with the bend
        self.tilt = float(rng.uniform(-0.1, 0.1))

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        u, a = np.asarray(x) / self.limit, np.radians(x)
        held = self.soft * (_torque(self, u, pull) + f * (1 + self.leans * u * u + self.tilt * u))
        far = np.hypot(np.cos(a), 2 * np.sin(a))
        turned = np.arcsin(np.clip(held * (1 + 4 * law) / far, -1.0, 1.0)) + np.arctan2(2 * np.sin(a), np.cos(a))
        return np.degrees(turned) * (1 + law)


class Drawer(Mechanism):
    """A push rod on a carriage that binds in its guide as a drawer does, bending section with a preloaded spring.

    Load off the guide's middle by e, engaged length l: F = (T + f S) / (1 - 2 f e / l) (Slocum 1992, Saint-Venant).
    """

    arm = False
    widths = ranges.DRAWER_WIDTH

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(28.0, 60.0))
        self.stroke = float(rng.uniform(2.0, 6.0))  # mm
        self.off = float(rng.uniform(0.6, 1.6))  # eccentricity over engaged length
        self.engages = float(rng.uniform(-0.25, 0.25))  # change of the engaged length over the range
        self.hardens, self.pre = float(rng.uniform(0.0, 0.4)), float(rng.uniform(1.6, 2.5))
        self.seal = float(rng.uniform(0.2, 1.0))
        self.gives = float(rng.uniform(0.06, 0.25))  # rod's shortening by the spring's force, of the stroke

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        u = np.asarray(x) / self.limit
        binds = np.minimum(2 * f * self.off / (1 + self.engages * u), 0.8)  # short of jamming
        force = (self.pre + _torque(self, u, pull) + f * self.seal) / (1 - binds)
        bend = 0.5 * np.radians(self.limit)
        way = np.sin(bend * u) / np.sin(bend)
        return self.stroke * (way * (1 + law) + self.gives * force)


class Meniscus(Mechanism):
    """A syringe lifts a liquid column in a conical bore; a float on it turns an arm. The contact line is pinned.

    Contact angle between receding and advancing (de Gennes 1985): cos t = c - f rising, c + f falling. The meniscus
    holds pi r^3 k (3 + k^2) / 6 less, k = cos t / (1 + sin t); trapped air gives by weight, Laplace's 2 s cos t / r and
    the spring.
    """

    sluggish = True
    widths = ranges.MENISCUS_WIDTH
    most_friction = 0.45

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 45.0))
        self.lift = float(rng.uniform(6.0, 14.0))  # mm of the float at the limit
        self.bore = float(rng.uniform(0.35, 0.8))  # radius over lift
        self.cone, self.bulge = float(rng.uniform(-0.2, 0.2)), float(rng.uniform(-0.08, 0.08))
        self.wets = float(rng.uniform(0.1, 0.5))  # cosine of the mean contact angle
        self.air, self.laplace = float(rng.uniform(0.02, 0.2)), float(rng.uniform(0.1, 0.5))
        self.hardens, self.plunger = float(rng.uniform(0.0, 0.3)), float(rng.uniform(0.7, 1.4))

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        u = np.asarray(x) / self.limit
        h = np.sin(np.radians(x)) / np.sin(np.radians(self.limit)) * (1 + law)
        r = 1 + self.cone * h + self.bulge * h * h
        below = np.polynomial.Polynomial([1.0, self.cone, self.bulge]) ** 2
        cos = np.clip(self.wets - f, -0.98, 0.98)
        k = cos / (1 + np.sqrt(1 - cos * cos))
        capped = self.bore * r**3 * k * (3 + k * k) / 6
        pressed = 0.5 * h + 0.5 * _torque(self, u, pull) - self.laplace * cos / r
        return self.lift / self.plunger**2 * (below.integ()(h) - capped + self.air * pressed)


class Tackle(Mechanism):
    """A block and tackle raises a hinged arm against its spring: each sheave takes its share, every part stretches.

    Tensions grow by (1 + f) / (1 - f) at each sheave, n parts bear W: F = W p^n / (1 + p + ... + p^(n-1)) (Feyrer
    2015, 3.1); the block's distance is the law of cosines, W the torque over its slope.
    """

    sluggish = True
    widths = ranges.TACKLE_WIDTH
    most_friction = 0.3

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 42.0))
        self.parts = int(rng.integers(2, 6))
        self.far, self.opens = float(rng.uniform(1.6, 3.0)), float(rng.uniform(75.0, 105.0))  # post, angle to it
        self.crank = float(rng.uniform(4.0, 12.0))  # mm
        self.hardens, self.pre = float(rng.uniform(0.0, 0.4)), float(rng.uniform(1.6, 3.0))
        self.stretch = float(rng.uniform(0.02, 0.08))  # of the crank, for the whole length and the spring's torque
        self.lead = float(rng.uniform(0.5, 3.0))  # rope to the winch, over a part's length

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        a, straight = np.radians(self.opens - np.asarray(x)), np.cos(np.radians(self.opens))
        far = self.far * (1 - law)
        apart = np.sqrt(1 + far**2 - 2 * far * np.cos(a))
        way = self.parts * (np.sqrt(1 + far**2 - 2 * far * straight) - apart)
        bears = (self.pre + _torque(self, np.asarray(x) / self.limit, pull)) * apart / (far * np.sin(a))
        ratio, shares = (1 + f) / (1 - f), np.ones_like(f)
        for _ in range(self.parts - 1):
            shares = shares * ratio + 1
        hauled = bears * ratio**self.parts / shares
        return self.crank * (way + self.stretch * (bears * apart / self.far + self.lead * hauled))


class Cardan(Mechanism):
    """A shaft with a Hooke's joint turns an arm under gravity: uneven ratio, crosses that rub by torque, wind-up.

    tan q' = tan x cos b from the joint's phase on; torque by the ratio; crosses rub by T tan b (Seherr-Thoss et al.
    2006); the shaft winds up by T^0.8 / k (a stiffening spline).
    """

    unit = "deg"
    widths = ranges.CARDAN_WIDTH

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 50.0))
        self.bent, self.phase = float(rng.uniform(20.0, 40.0)), float(rng.uniform(0.0, 180.0))
        self.hardens, self.heavy = float(rng.uniform(0.0, 0.3)), float(rng.uniform(0.0, 0.6))
        self.hangs = float(rng.uniform(-60.0, 60.0))
        self.winds = float(rng.uniform(3.0, 9.0))  # deg at the spring's torque
        self.seal = float(rng.uniform(0.5, 1.5))

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        u, a = np.asarray(x) / self.limit, np.radians(np.asarray(x) + self.phase)
        b = np.radians(self.bent) * (1 + 3 * law)
        cos = np.cos(b)
        uneven = np.arctan2((cos - 1) * np.sin(a) * np.cos(a), np.cos(a) ** 2 + cos * np.sin(a) ** 2)
        ratio = cos / (np.cos(a) ** 2 + (cos * np.sin(a)) ** 2)
        weight = self.heavy * (np.sin(np.radians(np.asarray(x) + self.hangs)) - np.sin(np.radians(self.hangs)))
        torque = _torque(self, u, pull) + weight
        rubs = f * (self.seal + np.sqrt(torque**2 + 0.5) * np.tan(b))
        turned = (torque + rubs) / ratio
        wound = turned * (turned**2 + 0.3) ** -0.1
        return np.asarray(x) + np.degrees(uneven) + self.winds * wound


class Coupling(Mechanism):
    """Two magnets through a wall turn an arm with mass in a plain bearing.

    Torque M sin p(q - x) (Furlani 2001); I x'' + c x' + T(x) + f N sign x' = M sin p(q - x): an implicit step for what
    is linear, the dry friction as an impulse of at most its size (Moreau's time stepping). 40 to 75 Hz, z 0.3 to 0.8.
    """

    unit, massive = "deg", True
    widths = ranges.COUPLING_WIDTH

    def shape(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(25.0, 50.0))
        self.pairs, self.pulls = int(rng.integers(1, 4)), float(rng.uniform(3.0, 6.0))
        self.hardens, self.leans = float(rng.uniform(0.0, 0.3)), float(rng.uniform(0.0, 0.5))
        self.hangs = float(rng.uniform(-0.3, 0.3))
        self.rate, self.damping = 2 * np.pi * float(rng.uniform(40.0, 75.0)), float(rng.uniform(0.3, 0.8))

    def raw(self, x: Values, f: Values, pull: Values, law: Values) -> Any:
        u = np.asarray(x) / self.limit
        held = _torque(self, u, pull) + f * (1 + self.leans * u * u + self.hangs * u)
        return np.asarray(x) * (1 + law) + np.degrees(np.arcsin(np.clip(held / self.pulls, -1.0, 1.0))) / self.pairs

    def run(self, demand: Any) -> FloatArray:
        ask = asked(demand)
        n = ask.q.size
        per_rad = np.degrees(1.0) / self.limit
        stiff = self.pulls * self.pairs + per_rad  # torque for a rad
        inertia = stiff / self.rate**2
        x = 0.5 * float(self.inverted(Ask(ask.q[:1]), 1.0)[0] + self.inverted(Ask(ask.q[:1]), -1.0)[0])
        zero = np.zeros(n)
        damped = 2 * self.damping * stiff / self.rate + stiff * (zero if ask.drag is None else ask.drag)
        whole = inertia + STEP * damped + STEP**2 * stiff
        side, hard, at = ask.tissue_side, ask.tissue_hardens or 1.0, ask.tissue_at
        rows = zip(
            np.radians(ask.q + self.zero).tolist(), whole.tolist(), *(np.asarray(v + zero).tolist() for v in (
                self.f * ask.rub, ask.pull, ask.law, ask.tissue)), strict=True,
        )  # fmt: skip
        out, speed, deg = np.empty(n), 0.0, float(np.degrees(1.0))
        for k, (q, mass, f, pull, law, tissue) in enumerate(rows):
            u = x / self.limit
            torque = self.pulls * math.sin(self.pairs * (q - x * (1 + law) / deg))
            torque -= (u + self.hardens * u * u * u) / (1 + self.hardens) + pull
            if tissue and side * x > at:
                torque -= side * tissue * math.expm1(min(hard * (side * x - at), 3.0)) / hard / self.limit
            free = (inertia * speed + STEP * torque) / mass
            held = STEP * f * (1 + self.leans * u * u + self.hangs * u) / mass
            speed = free - held if free > held else free + held if free < -held else 0.0
            x += STEP * deg * speed
            out[k] = x
        return out
