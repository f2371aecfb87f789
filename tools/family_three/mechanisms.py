"""Five mechanisms, each by its own balance. Angles in deg, forces as shares of a preload, lengths in mm."""

import numpy as np
from numpy.typing import NDArray

from tools.family_three import ranges
from tools.family_three.mechanism import Mechanism, Number

FloatArray = NDArray[np.float64]
SLACK = 6.0  # times as yielding as when taut, where what pulls alone is asked to push


class Piston(Mechanism):
    """Hydraulic line: a master piston moves a slave piston, whose seals rub, and a pinion bends a section.

    The slave's seals are pressed on by the pressure p: A p = F(y) + s (f + b p), F a preloaded spring that hardens, so
    p = (F + s f) / (1 - s b). Oil and what air is in it give way, more the more of the slave is filled:
    q = ratio y + give (1 + y / filled) (p + air p / (p + 0.3)). At rest the seals hold a little more (Stribeck).
    """

    unit, arm, exact = "mm", False, False
    giving: float  # mm at the preload

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(55, 80))
        self.pinion = float(rng.uniform(3.0, 5.0))  # mm
        self.ratio = float(rng.uniform(0.7, 1.6))  # slave's area over the master's
        self.turn = float(rng.choice([1.5, 2.0, 3.0, 4.0]))  # mm: lead of the master's spindle
        while True:
            width = ranges.SEAL_WIDTH.draw(rng)
            self.spring = float(rng.uniform(0.25, 0.6))  # of the preload, at the limit
            self.harden = float(rng.uniform(0.0, 0.3))
            self.seal = float(rng.uniform(0.1, 0.35)) * (1 - self.spring * (1 + self.harden))  # of the preload
            self.pressed = float(rng.uniform(0.03, 0.12))
            self.filled = float(rng.uniform(15, 40))  # mm
            self.air = float(rng.uniform(0.0, 0.5))
            if self.tune("giving", 1e-4, 3.0, width) and self.healthy():
                break

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        y = self.pinion * np.radians(x)
        part = x / self.limit
        force = 1 + self.spring * part * (1 + self.harden * part**2) + torque
        pulls = np.maximum(force, 0.0)
        p = (pulls + s * rub * self.seal) / (1 - s * rub * self.pressed) + force - pulls
        liquid = np.maximum(p, -0.1)  # below, it boils and gives way
        pressed = liquid + self.air * liquid / (liquid + 0.3) + SLACK * (p - liquid)
        geometry = self.ratio * y * (1 + law * (1 + 0.25 * part))
        return np.asarray(geometry + self.giving * (1 + y / self.filled) * pressed)


class Worm(Mechanism):
    """Worm gear: a flank bears on one side or the other; the sector is worn in its middle, teeth and bearing give.

    The shaft's seals need T = T(x) + s f (1 + l |load|). A flank lies on the side of T, half a gap away; teeth and the
    worm's axial bearing give by Hertz, |T|^(2/3). The wheel sits off its shaft: e sin(x + phase).
    """

    unit = "deg"
    gap: float  # deg of the wheel

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(50, 75))
        self.teeth = float(rng.integers(20, 61))
        self.turn = 360.0
        while True:
            width = ranges.TOOTH_WIDTH.draw(rng)
            self.wear = float(rng.uniform(0.05, 0.5))
            self.worn_at = float(rng.uniform(-0.3, 0.3))
            self.gravity = float(rng.uniform(-0.35, 0.35))
            self.spring = float(rng.uniform(0.0, 0.3))
            self.hertz = width * float(rng.uniform(0.1, 0.35))
            self.off = float(rng.uniform(0.1, 1.2))  # deg
            self.phase = float(rng.uniform(0, 360))
            if self.tune("gap", 0.0, 20.0, width) and self.healthy():
                break

    def settle(self) -> None:
        """A pull is as strong as friction: much more only lays the teeth to one side."""
        super().settle()
        self.pull = 1.0

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        part = x / self.limit
        own = self.gravity * np.sin(np.radians(x)) + self.spring * part
        all_of = own + torque + s * rub * (1 + 0.15 * np.abs(torque))
        soft = all_of**2 + 0.05**2
        gap = self.gap * (1 - self.wear * (part - self.worn_at) ** 2) * (1 + 0.5 * (np.asarray(rub) - 1))
        flank = 0.5 * gap * all_of / np.sqrt(soft) + 0.5 * self.hertz * all_of / soft ** (1 / 6)
        wheel = x * (1 + law * (1 + 0.25 * part)) + self.off * np.sin(np.radians(x + self.phase))
        return np.asarray(self.teeth * (wheel + flank))

    def presliding(self) -> tuple[tuple[float, float], ...]:
        """Cattaneo and Mindlin: contacts slip from their edges inward, by 1 - (1 - F / mu N)^(2/3)."""
        return mindlin()


class Wrist(Mechanism):
    """Rolling joint: two cylinders of a wrist roll on each other between two cables on one drum.

    By the mirror in the tangent plane a cable is 2 (r + h cos(x/2) -+ a sin(x/2)) long. With both of stiffness k,
    2 k a cos(x/2) (q - 2 a sin(x/2)) = t(x) + s M - N h sin(x/2); N = 2 T + 4 k h (cos(x/2) - 1) presses the cylinders,
    and M goes as N^(3/2): the resistance of rolling is N times the half-width of Hertz's contact.
    """

    unit = "mm"
    resists: float  # torque of rolling, in the middle

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(50, 80))
        self.turn = float(rng.uniform(1.2, 3.5))  # mm: around the drum
        while True:
            width = ranges.ROLLING_WIDTH.draw(rng)
            self.side = float(rng.uniform(2.5, 5.0))  # a, mm
            self.height = float(rng.uniform(-1.2, 1.2))  # h, mm
            self.stiff = float(rng.uniform(0.3, 1.5))  # k, of the pretension for each mm
            self.flexure = float(rng.uniform(0.1, 0.8))  # torque at the limit
            if self.tune("resists", 1e-4, 3.0, width) and self.healthy():
                break

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        half = np.radians(x) / 2
        part = x / self.limit
        pressed = np.maximum(2 + 4 * self.stiff * self.height * (np.cos(half) - 1), 0.1)
        pressed = pressed + 0.1 * np.abs(torque) / (1 + 0.1 * np.abs(torque))
        moment = self.resists * rub * (pressed / 2) ** 1.5
        own = self.flexure * part + torque + s * moment - pressed * self.height * np.sin(half)
        cable = 2 * self.side * np.sin(half) * (1 + law * (1 + 0.25 * part))
        return np.asarray(cable + own / (2 * self.stiff * self.side * np.cos(half)))

    def presliding(self) -> tuple[tuple[float, float], ...]:
        return mindlin()


class Fusee(Mechanism):
    """Spiral drum: a cable off a drum of changing radius runs over idlers whose wraps change, against a spring.

    The drum takes up q + k q^2 / 2 r. Idlers leave T exp(s mu w(x)) + s f of the pull T(x) at the section, with wraps
    w(x) that grow as it bends, and a rope that is bent and unbent costs f. The cable stretches with the mean pull.
    """

    unit, arm = "deg", False
    giving: float  # deg of the drum at the preload

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(50, 85))
        self.ratio = float(rng.uniform(0.8, 3.0))  # deg of the drum for each of the section
        self.turn = float(rng.choice([45.0, 60.0, 90.0]))  # geared up behind the encoder
        while True:
            width = ranges.IDLER_WIDTH.draw(rng)
            self.spiral = float(rng.uniform(-0.3, 0.3))
            self.rubs = float(rng.uniform(0.06, 0.2))  # mu times the wraps in the middle
            self.wraps = float(rng.uniform(-0.3, 0.3))  # their change to the limit
            self.bending = float(rng.uniform(0.01, 0.06))
            self.spring = float(rng.uniform(0.2, 0.6))
            if self.tune("giving", 1e-3, 300.0, width) and self.healthy():
                break

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        part = x / self.limit
        asked = 1 + self.spring * part + torque
        pull = np.maximum(asked, 0.05)  # a cable does not push
        drum = pull * np.exp(s * rub * self.rubs * (1 + self.wraps * part)) + s * rub * self.bending
        drum = drum + SLACK * (asked - pull)
        taken = self.ratio * x * (1 + law * (1 + 0.25 * part)) + self.giving * 0.5 * (drum + pull - 2)
        share = taken / (self.ratio * self.limit)  # = t + spiral t^2 / 2 for t of the range
        inside = np.clip(share, -1.5, 1.5)  # beyond, the drum is round
        root = np.sqrt(1 + 2 * self.spiral * inside)
        turned = 2 * inside / (1 + root) + (share - inside) / root
        return np.asarray(self.ratio * self.limit * turned)


class Jaw(Mechanism):
    """Gripper jaw with mass: a rod moves a pin in a cam's slot against a leaf spring; the rod gives.

    The cam's slope changes along the slot and with it the pressure angle: tan p = slope / arm. Friction in the slot
    adds its angle, F = t(x) / arm tan(p + s phi), with the leaf's t(x) preloaded and hardening. The rod gives F / k.
    The jaw swings on the rod: x'' / w^2 + 2 z x' / w + x = where a branch has it, by steps of the free oscillator.
    """

    unit, massive = "mm", True
    giving: float  # mm at the preload

    def __init__(self, rng: np.random.Generator) -> None:
        self.limit = float(rng.uniform(22, 40))
        self.lever = float(rng.uniform(4.0, 9.0))  # mm
        self.turn = float(rng.choice([1.0, 2.0, 3.0]))  # mm: lead of the spindle behind the rod
        self.rate = float(rng.uniform(40, 80))
        self.damping = float(rng.uniform(0.25, 0.7))
        while True:
            width = ranges.CAM_WIDTH.draw(rng)
            self.rise = float(rng.uniform(0.7, 1.2))  # tan of the pressure angle, in the middle
            self.cam = float(rng.uniform(-0.25, 0.25))  # its change to the limit
            self.phi = float(rng.uniform(6, 13))  # deg
            self.leaf = float(rng.uniform(0.2, 0.6))  # of the preload, at the limit
            self.harden = float(rng.uniform(0.0, 0.3))
            if self.tune("giving", 1e-4, 6.0, width) and self.healthy():
                break

    def drive(self, x: FloatArray, s: float, rub: Number, torque: Number, law: Number) -> FloatArray:
        part, a = x / self.limit, np.radians(x)
        slope = self.rise * (1 + self.cam * part)
        moved = self.lever * self.rise * a * (1 + 0.5 * self.cam * part) * (1 + law * (1 + 0.25 * part))
        asked = 1 + self.leaf * part * (1 + self.harden * part**2) + torque
        leaf = np.maximum(asked, 0.05)  # below, the pin leaves its flank
        turned = np.minimum(np.arctan(slope) + s * rub * np.radians(self.phi), 1.45)
        return np.asarray(moved + self.giving * (leaf * np.tan(turned) + SLACK * (asked - leaf)))

    def presliding(self) -> tuple[tuple[float, float], ...]:
        return mindlin()


def mindlin(count: int = 6) -> tuple[tuple[float, float], ...]:
    """The spheres' 1 - (1 - f)^(2/3) at f = 1/count, 2/count .. as elements: what goes from each f to the next."""
    f = np.arange(count + 1) / count
    slid = 1 - (1 - f) ** (2 / 3)
    thresholds = (np.arange(count) + 0.5) / count
    slopes = np.diff(slid) * count  # compliance over each piece; it rises by each element's weight as that lets go
    weights = np.diff(np.concatenate([[0.0], slopes]))
    weights = weights / weights.sum()
    return tuple((float(w), float(r)) for w, r in zip(weights, thresholds, strict=True))
