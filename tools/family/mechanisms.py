"""Five mechanisms between motor and tip, each integrated by its own equations of force balance, not by a play operator.

A step takes the motor's position and the two friction bounds (1 = healthy) and gives the configuration x. All are
quasi-static: a step solves the balance with set-valued Coulomb friction exactly, so any step within which the motor
does not turn round gives the same end. At healthy bounds each is a plain hysteresis: after a reversal nothing moves for
a width that depends on the place alone.
"""

import math
from collections.abc import Callable
from typing import ClassVar, Protocol

import numpy as np
from tools.family import ranges


class Mechanism(Protocol):
    unit: ClassVar[str]
    reach: float  # the motor's range is -reach .. reach, in the unit

    def step(self, q: float, rising: float, falling: float) -> float:
        """Configuration, degrees, before the static law; rising and falling scale the friction bounds."""


def root(balance: Callable[[float], float], lo: float, hi: float, enough: float) -> float:
    """Where a falling function is 0 inside [lo, hi], to |balance| < enough: regula falsi with the Illinois rule."""
    f_lo, f_hi = balance(lo), balance(hi)
    if f_lo <= 0:
        return lo
    if f_hi >= 0:
        return hi
    x, side = lo, 0
    for _ in range(80):
        x = (lo * f_hi - hi * f_lo) / (f_hi - f_lo)
        f = balance(x)
        if abs(f) < enough:
            return x
        if f > 0:
            lo, f_lo = x, f
            f_hi = f_hi / 2 if side == 1 else f_hi
            side = 1
        else:
            hi, f_hi = x, f
            f_lo = f_lo / 2 if side == -1 else f_lo
            side = -1
    return x


class Sheath:
    """One tendon through a curved sheath against a return spring (capstan friction along the whole path).

    Node j sits at wrap angle theta_j. Its tension stays while T0 exp(-mu theta_j) <= T_j <= T0 exp(mu theta_j);
    the tendon stretches by sum(w_j T_j). The tip's tension is T_pre + K x. T0 follows from q = x + stretch.
    """

    unit = "mm"
    nodes = 9

    def __init__(self, rng: np.random.Generator) -> None:
        self.reach = float(rng.uniform(3.0, 6.0))  # mm
        wrap, mu = ranges.WRAP.draw(rng), ranges.MU.draw(rng)
        self.theta = [mu * wrap * j / self.nodes for j in range(self.nodes + 1)]
        self.spring = float(rng.uniform(1.0, 3.0))  # N/mm
        self.pre = self.spring * self.reach * float(rng.uniform(1.6, 3.0))  # N: never slack
        self.gain = ranges.BENDING.draw(rng)  # deg/mm
        width = min(ranges.FLEXIBLE_WIDTH.draw(rng) / self.gain, 0.35 * self.reach)  # mm
        spread = sum(2 * math.sinh(t) for t in self.theta[:-1]) / self.nodes
        self.stretch = width / (self.pre * spread) / self.nodes  # mm/N of each piece, so that B(0) is about `width`
        self.tension = [self.pre] * (self.nodes + 1)
        self._scaled = (0.0, 0.0)

    def step(self, q: float, rising: float, falling: float) -> float:
        if self._scaled != (rising, falling):
            self._scaled = (rising, falling)
            self._down = [math.exp(-t * rising) for t in self.theta]
            self._up = [math.exp(t * falling) for t in self.theta]
        down, up, tension = self._down, self._up, self.tension
        weight = [self.stretch] * self.nodes + [1.0 / self.spring]
        t0 = tension[0]
        for _ in range(40):
            excess, slope = -q - self.pre / self.spring, 0.0
            for w, t, d, u in zip(weight, tension, down, up, strict=True):
                if t < t0 * d:
                    excess += w * t0 * d
                    slope += w * d
                elif t > t0 * u:
                    excess += w * t0 * u
                    slope += w * u
                else:
                    excess += w * t
            if abs(excess) < 1e-10:
                break
            t0 -= excess / max(slope, self.stretch)
        self.tension = [min(max(t, t0 * d), t0 * u) for t, d, u in zip(tension, down, up, strict=True)]
        return self.gain * (self.tension[-1] - self.pre) / self.spring


class Pair:
    """Two antagonistic cables on one pulley, with slack and a soft toe, a joint spring and joint friction.

    The pulley turns only while |r (t1 - t2) - K c| exceeds the friction F; t = k d ln(1 + exp(e / d)), e the stretch.
    """

    unit = "mm"

    def __init__(self, rng: np.random.Generator) -> None:
        self.radius = float(rng.uniform(3.0, 6.0))  # mm
        self.reach = self.radius * math.radians(float(rng.uniform(45.0, 70.0)))
        width = math.radians(ranges.WRIST_WIDTH.draw(rng)) * self.radius  # mm
        share = float(rng.uniform(0.2, 0.6))  # of the width from slack
        self.slack = width * share / 2
        self.stiffness = float(rng.uniform(5.0, 30.0))  # N/mm
        self.friction = (1 - share) * width / 2 * self.stiffness * self.radius  # N mm
        self.toe = width * float(rng.uniform(0.05, 0.2))
        self.spring = (
            self.friction * float(rng.uniform(0.2, 0.7)) / (self.reach / self.radius)
        )  # N mm/rad, below friction
        self.c = 0.0

    def _pull(self, e: float) -> float:
        z = e / self.toe
        return self.stiffness * (e if z > 30 else self.toe * math.log1p(math.exp(max(z, -40.0))))

    def step(self, q: float, rising: float, falling: float) -> float:
        def moment(c: float) -> float:
            x = q - self.radius * c
            return self.radius * (self._pull(x - self.slack) - self._pull(-x - self.slack)) - self.spring * c

        now, span = moment(self.c), 2 * self.reach / self.radius
        if now > self.friction * rising:
            self.c = root(lambda c: moment(c) - self.friction * rising, self.c, self.c + span, 1e-8 * self.friction)
        elif now < -self.friction * falling:
            self.c = root(lambda c: moment(c) + self.friction * falling, self.c - span, self.c, 1e-8 * self.friction)
        return math.degrees(self.c)


class Pendulum:
    """Gear with a tooth gap, an elastic cable that stiffens to one side, and an arm under gravity.

    F sgn(dc/dt) + G sin(c - c_g) = S(q/n - c), S with a gap of g. F > G: the arm rests in the gap.
    """

    unit = "deg"

    def __init__(self, rng: np.random.Generator) -> None:
        self.ratio = float(rng.choice([1.0, 2.0, 4.0]))
        self.reach = self.ratio * float(rng.uniform(35.0, 60.0))
        width = ranges.WRIST_WIDTH.draw(rng)  # deg of the tip
        share = float(rng.uniform(0.2, 0.7))
        self.gap = width * share
        self.friction = (1 - share) * width / 2  # over the stiffness: deg
        self.gravity = self.friction * float(rng.uniform(0.2, 0.8))
        self.upright = float(rng.uniform(-90.0, 90.0))
        self.stiffening = float(rng.uniform(-0.3, 0.3)) / (self.reach / self.ratio)
        self.c = 0.0

    def step(self, q: float, rising: float, falling: float) -> float:
        drive, half = q / self.ratio, self.gap / 2

        def torque(c: float) -> float:
            e = drive - c
            e = e - half if e > half else e + half if e < -half else 0.0
            return e * (1 + self.stiffening * c) - self.gravity * math.sin(math.radians(c - self.upright))

        now, span = torque(self.c), 2 * self.reach / self.ratio
        if now > self.friction * rising:
            self.c = root(lambda c: torque(c) - self.friction * rising, self.c, self.c + span, 1e-7)
        elif now < -self.friction * falling:
            self.c = root(lambda c: torque(c) + self.friction * falling, self.c - span, self.c, 1e-7)
        return self.c


class Backbone:
    """Joints in series, each with a spring and Coulomb friction, pulled by one elastic cable: a bending section.

    Joint j rests while |M - K theta_j| <= F_j(M), M the cable's moment; F grows with |M|: the cable presses.
    `spread` makes the last joints rub more than the first: they start one after another, and it is no arc meanwhile.
    """

    unit = "mm"
    joints = 6

    def __init__(self, rng: np.random.Generator) -> None:
        self.reach = float(rng.uniform(3.0, 6.0))
        self.gain = ranges.BENDING.draw(rng)  # deg/mm
        width = min(ranges.FLEXIBLE_WIDTH.draw(rng) / self.gain, 0.3 * self.reach)
        self.yielding = float(rng.uniform(0.15, 0.5))  # share of the cable's travel that stretches it
        self.friction = width / 2 / self.yielding  # moment in mm of cable: M = (q - bend) / yielding
        self.press = float(rng.uniform(0.0, 0.5)) * self.friction / self.reach
        self.soft = 0.2 * self.reach
        self.spread = 0.0
        self.angles = [0.0] * self.joints  # each in mm of cable
        self.moment = 0.0

    def step(self, q: float, rising: float, falling: float) -> float:
        n = self.joints
        uneven = [1 + self.spread * (2 * j / (n - 1) - 1) for j in range(n)]
        share, k = (1 - self.yielding) / n, self.yielding
        m = self.moment
        for _ in range(40):
            pressed = math.sqrt(m * m + self.soft * self.soft)
            bound, grow = self.friction + self.press * (pressed - self.soft), self.press * m / pressed
            excess, slope = k * m - q, k
            for theta, f in zip(self.angles, uneven, strict=True):
                lo, hi = m - bound * f * rising, m + bound * f * falling
                if theta < lo:
                    excess += share * lo
                    slope += share * (1 - grow * f * rising)
                elif theta > hi:
                    excess += share * hi
                    slope += share * (1 + grow * f * falling)
                else:
                    excess += share * theta
            if abs(excess) < 1e-10:
                break
            m -= excess / max(slope, 0.5 * k)
        pressed = math.sqrt(m * m + self.soft * self.soft)
        bound = self.friction + self.press * (pressed - self.soft)
        self.moment = m
        self.angles = [
            min(max(theta, m - bound * f * rising), m + bound * f * falling)
            for theta, f in zip(self.angles, uneven, strict=True)
        ]
        return self.gain * share * sum(self.angles)

    def unevenness(self) -> list[float]:
        """Each joint's angle less the joints' mean, deg."""
        mean = sum(self.angles) / self.joints
        return [self.gain * (1 - self.yielding) / self.joints * (a - mean) for a in self.angles]


class Linkage:
    """A servo's horn, a push-pull wire with pin clearance and a lever whose friction grows with the wire's force.

    Wire force f = k gap(a sin q - b (sin(c + c0) - sin c0)); the lever turns while |f| b cos(c + c0) > F + mu |f|.
    """

    unit = "deg"

    def __init__(self, rng: np.random.Generator) -> None:
        self.reach = float(rng.uniform(35.0, 50.0))
        self.arm = float(rng.uniform(0.7, 1.0))  # horn over lever arm
        self.skew = float(rng.uniform(-8.0, 8.0))  # deg of the lever at the horn's middle
        width = math.radians(ranges.SERVO_WIDTH.draw(rng)) * self.arm
        share = float(rng.uniform(0.4, 0.9))
        self.clearance = width * share / 2
        self.friction = width * (1 - share) / 2  # over k b: a length over b
        self.rub = float(rng.uniform(0.02, 0.12))  # mu r / b
        self.c = self.skew

    def step(self, q: float, rising: float, falling: float) -> float:
        horn = self.arm * math.sin(math.radians(q))
        zero = math.sin(math.radians(self.skew))

        def net(c: float) -> float:
            e = horn - (math.sin(math.radians(c)) - zero)
            e = e - self.clearance if e > self.clearance else e + self.clearance if e < -self.clearance else 0.0
            return e * (math.cos(math.radians(c)) - self.rub)

        now = net(self.c)
        if now > self.friction * rising:
            self.c = root(lambda c: net(c) - self.friction * rising, self.c, 80.0, 1e-9)
        elif now < -self.friction * falling:
            self.c = root(lambda c: net(c) + self.friction * falling, -80.0, self.c, 1e-9)
        return self.c


MECHANISMS: dict[str, type[Sheath] | type[Pair] | type[Pendulum] | type[Backbone] | type[Linkage]] = {
    "sheath": Sheath,
    "pair": Pair,
    "pendulum": Pendulum,
    "backbone": Backbone,
    "linkage": Linkage,
}
