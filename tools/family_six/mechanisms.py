"""The healthy mechanisms; each says where its motor has to be for the tip to slide at x."""

from typing import Any

import numpy as np

from tools.family_six import ranges
from tools.family_six.mechanism import Mechanism


class Bellows(Mechanism):
    """A syringe blows up an eccentric bellows that bends a section, which slides along a rod inside.

    p (1 - a u) = T + f N; plunger by the bellows' volume, its walls that bulge, and Boyle's law of the dead volume.
    """

    widths = ranges.BELLOWS_WIDTH

    def draw(self, rng: np.random.Generator) -> None:
        self.stroke = float(rng.uniform(3.0, 9.0))  # mm
        self.area, self.swell = float(rng.uniform(-0.25, 0.25)), float(rng.uniform(-0.12, 0.12))
        self.bulges, self.dead = float(rng.uniform(0.02, 0.2)), float(rng.uniform(0.3, 1.6))
        self.outside = float(rng.uniform(2.5, 6.0))  # pressure of the air, of what holds the tip at its limit

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        u = x / self.limit
        p = (self.spring(x) + push + f * self.pressed(x)) / (1 - self.area * u)
        volume = (1 + 0.5 * law) * u + (self.swell + law) * u * u + self.bulges * p
        return self.stroke * (volume + self.dead * p / (self.outside + np.maximum(p, -0.8 * self.outside)))


class Sleeve(Mechanism):
    """Two slotted tubes, one in the other, joined at the tip; pushing one along bends both.

    dF/ds = f (n0 N + c u F) along the section, closed: F0 = F exp(g) + n0 f N (exp(g) - 1) / g, g = f c u; the slots
    close, so the lever arm shrinks as 1 - k u^2.
    """

    widths = ranges.SLEEVE_WIDTH

    def draw(self, rng: np.random.Generator) -> None:
        self.stroke, self.closes = float(rng.uniform(1.5, 5.0)), float(rng.uniform(0.0, 0.25))
        self.clings, self.wraps = float(rng.uniform(0.6, 1.5)), float(rng.uniform(0.5, 1.6))
        self.gives = float(rng.uniform(0.08, 0.35))

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        u = x / self.limit
        end = (self.spring(x) + push) / (1 - self.closes * u * u)
        g = f * self.wraps * u
        grown = np.where(np.abs(g) < 1e-9, 1.0, np.expm1(g) / np.where(np.abs(g) < 1e-9, 1.0, g))
        begin = end * np.exp(g) + self.clings * f * self.pressed(x) * grown
        travel = (1 + law) * (u - self.closes * u**3 / 3) + 0.6 * law * u * u
        return self.stroke * (travel + self.gives * 0.5 * (begin + end))


class Leaves(Mechanism):
    """A stack of leaf springs as a backbone, clamped together so that they rub; a free wire pulls its end plate.

    M = T + f N; wire along the chord: q = l (1 - sin a / a) + 2 h sin a, a = x / 2, lever arm dq/dx; it stretches.
    """

    widths = ranges.LEAVES_WIDTH

    def draw(self, rng: np.random.Generator) -> None:
        self.off, self.slender = float(rng.uniform(2.0, 5.0)), float(rng.uniform(1.5, 3.5))  # mm; length over it
        self.bias, self.gives = float(rng.uniform(1.1, 1.8)), float(rng.uniform(0.1, 0.35))

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        a = np.radians(x) / 2
        small = np.abs(a) < 1e-4
        b = np.where(small, 1.0, a)
        long = self.slender * (1 + 3 * law)
        bow = np.where(small, a / 3, (np.sin(b) / b - np.cos(b)) / b)  # d(1 - sin a / a) / da
        arm = np.cos(a) + 0.5 * long * bow
        pull = (self.spring(x) + push + self.bias + f * self.pressed(x)) / arm
        return self.off * (long * (1 - np.sinc(a / np.pi)) + 2 * (1 + law) * np.sin(a) + self.gives * pull)


class Yoke(Mechanism):
    """A Scotch yoke: a crank's pin in a cross-slot drives a slide, a block on it the arm's forked lever.

    y = l tan x = r sin q'; F = (T + f N) cos^2 x; the crank's shaft winds up by F (cos q' + f sin q').
    """

    unit = "deg"
    arm = True
    widths = ranges.YOKE_WIDTH
    limits = (22.0, 42.0)

    def draw(self, rng: np.random.Generator) -> None:
        self.share, self.winds = float(rng.uniform(0.4, 0.75)), float(rng.uniform(2.0, 9.0))  # of the crank; deg

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        a = np.radians(x)
        lifted = np.clip(self.share * (1 - law) * np.tan(a) / np.tan(np.radians(self.limit)), -0.999, 0.999)
        crank = np.arcsin(lifted)
        force = (self.spring(x) + push + f * self.pressed(x)) * np.cos(a) ** 2
        return np.degrees(crank) + self.winds * force * (np.cos(crank) + f * np.sin(crank))


class Wedge(Mechanism):
    """A hollow-ground wedge pushed under a roller lifts a weighted arm.

    Slope t(u) = s (1 + k u): way = log(1 + k u) / (k s); H = W ((t + f) / (1 - f t) + f), and the push rod gives.
    """

    arm = True
    widths = ranges.WEDGE_WIDTH
    limits = (20.0, 40.0)

    def draw(self, rng: np.random.Generator) -> None:
        self.lever, self.steep = float(rng.uniform(6.0, 15.0)), float(rng.uniform(0.6, 1.2))
        self.ground, self.weight = float(rng.uniform(0.08, 0.4)), float(rng.uniform(1.3, 2.2))
        self.gives = float(rng.uniform(0.1, 0.5))  # mm for the spring's force at the limit

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        a, end = np.radians(x), np.sin(np.radians(self.limit))
        u = np.sin(a) / end
        ground = self.ground + 2 * law
        slope = self.steep * (1 + self.ground * u)
        way = self.lever * end / self.steep * (1 + law) * np.log1p(ground * u) / ground
        load = (self.weight + self.spring(x) + push) / np.cos(a)
        rubs = f * self.pressed(x)
        return way + self.gives * load * ((slope + rubs) / (1 - rubs * slope) + rubs)


class Capstan(Mechanism):
    """A cable in a figure of eight round a small drum and a large sector that is not quite round; a hanging arm.

    F = G + T + f P(u); z = F / P: spans stretch by F, the cable creeps on both drums by -ln(1 - z^2) (Euler).
    """

    unit = "deg"
    arm = True
    widths = ranges.CAPSTAN_WIDTH
    limits = (25.0, 48.0)

    def draw(self, rng: np.random.Generator) -> None:
        self.ratio, self.stretches = float(rng.uniform(2.0, 7.0)), float(rng.uniform(2.0, 8.0))  # ; deg
        self.creeps, self.tight = float(rng.uniform(0.3, 2.0)), float(rng.uniform(4.5, 8.0))
        self.hangs, self.uneven = float(rng.uniform(1.2, 1.7)), float(rng.uniform(-0.06, 0.06))

    def raw(self, x: Any, f: Any, push: Any, law: Any) -> Any:
        u = x / self.limit
        force = self.hangs * np.cos(np.radians(x) * 0.4) + self.spring(x) + push + f * self.pressed(x)
        z = force / (self.tight * (1 + 0.3 * self.leans * u * u + 0.3 * self.tilt * u))
        z = np.clip(z, -0.97, 0.97)  # then it slips
        wound = x * (1 + law) + self.limit * (self.uneven + 0.7 * law) * u * u
        return self.ratio * (wound + 0.3 * (self.stretches * force - self.creeps * self.limit * np.log1p(-z * z)))
