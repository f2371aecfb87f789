"""Causes that no list holds, in what is seen: clocks, buffers, light, lens and tracker."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tools.family_three import ranges
from tools.family_three.causes.base import Cause, Picks, follow, gates, rising
from tools.family_three.line import Line, Part

if TYPE_CHECKING:
    from tools.family.view import View

FloatArray = NDArray[np.float64]
Said = dict[str, float | str]


class Seen(Cause):
    unlisted = needs_camera = True


class ClockStep(Cause):
    id, says = "clock_step", "the camera's clock is set right by a step in the middle of the tests"
    limits = ranges.CLOCK_STEP
    unlisted, may_start = True, False

    def _how(self, line: Line) -> tuple[float, float]:
        rng = self.rng()
        first = next(p for p in line.parts if p.tested)
        inside = rng.uniform(0.35, 0.65) * first.exposed[-1] + (1 - rng.uniform(0.35, 0.65)) * first.exposed[0]
        time = float(np.clip(inside, first.exposed[0] + 5, first.exposed[-1] - 5))
        return time, float(rng.choice([-1.0, 1.0]))

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        time, way = self._how(line)
        return rising(arrival + way * self.size * (part.exposed >= time))

    def parameters(self, line: Line) -> Said:
        return {"time_s": self._how(line)[0], "sign": self._how(line)[1]}


class SwappedFrames(Cause):
    id, says = "swapped_frames", "neighbouring frames come out of the ring in the wrong order"
    limits = ranges.EXCHANGED
    unlisted = True

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rng = np.random.default_rng([self.seed, part.first])
        out, k = pick.copy(), 0
        while k + 1 < out.size:
            if rng.random() < self.size:
                out[k], out[k + 1] = out[k + 1], out[k]
                k += 1
            k += 1
        return out


class DarkSide(Seen):
    id, says = "dark_side", "the exposure is longer where the tip is out of the light, so its middle is later"
    limits = ranges.DARK

    def later(self, line: Line, part: Part, times: FloatArray, c: FloatArray) -> FloatArray:
        rng = self.rng()
        way, place = float(rng.choice([-1.0, 1.0])), float(rng.uniform(-0.3, 0.3))
        share = line.at(c, times) / (line.gain * line.reach)
        late = 1 / (1 + np.exp(-12 * (way * share - place)))
        return np.asarray(self.size * late * self.there(line, part))


class WetLens(Seen):
    id, says = "wet_lens", "drops run down the window and bend the light around them"
    limits = ranges.WET

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        if not self.there(line, part):
            return seen
        rng = np.random.default_rng([self.seed, part.first])
        out = seen.copy()
        low, high = seen.min(axis=0), seen.max(axis=0)
        for _ in range(3):
            radius = float(rng.uniform(0.04, 0.1)) * view.width_px
            begin = rng.uniform(low, high)
            path = begin[1] + float(rng.uniform(1.0, 6.0)) * (times - times[0] - rng.uniform(0, 15))
            off = seen - np.stack([np.full(times.size, begin[0]), path], axis=1)
            far = np.linalg.norm(off, axis=1) / radius
            out += self.size * off / radius * np.exp(0.5 - 0.5 * far**2)[:, None]
        return out


class Stabiliser(Seen):
    id, says = "stabiliser", "the camera takes fast motion of the picture for shake and keeps out a part of it"
    limits = ranges.STABILISED

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        rate = float(self.rng().uniform(0.3, 1.5))
        beat = float(np.median(np.diff(times)))
        slow = np.stack([follow(v, 1 / (2 * np.pi * rate), beat) for v in seen.T], axis=1)
        return seen - self.size * self.there(line, part) * (seen - slow)


class GhostReflection(Seen):
    id, says = "ghost_reflection", "now and then the marker's reflection in wet tissue is tracked with it"
    limits = ranges.REFLECTION

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        rng = self.rng()
        turn, off = float(rng.uniform(0, np.pi)), rng.uniform(-30, 30, 2)
        mirror = np.array([[np.cos(2 * turn), np.sin(2 * turn)], [np.sin(2 * turn), -np.cos(2 * turn)]])
        middle = np.median(seen, axis=0)
        ghost = middle + off + (seen - middle) @ mirror.T
        there = line.at(gates(rng, line.t, (0.8, 4.0), (1.5, 5.0)), times) > 0.5
        return np.asarray(seen + self.size * self.there(line, part) * there[:, None] * (ghost - seen))


class CodecSkip(Seen):
    id, says = "codec_skip", "compressed video shows small motions only at its next key frame"
    limits = ranges.SKIPPED

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        if not self.there(line, part):
            return seen
        every = float(self.rng().uniform(0.4, 2.0))
        key = np.diff(np.floor(times / every), prepend=-1.0) > 0
        last, out = seen[0], []
        for here, fresh in zip(seen, key.tolist(), strict=True):
            if fresh or float(np.abs(here - last).max()) > self.size:
                last = here
            out.append(last)
        return np.array(out)


class CauteryBursts(Seen):
    id, says = "cautery_bursts", "a cutting current disturbs picture and tracker in bursts"
    limits = ranges.BURSTS

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: "View") -> FloatArray:
        burning = line.at(gates(self.rng(), line.t, (0.3, 2.0), (2.0, 7.0)), times) > 0.5
        wild = np.random.default_rng([self.seed, part.first]).normal(size=seen.shape)
        return np.asarray(seen + self.size * self.there(line, part) * burning[:, None] * wild)


EYE = (ClockStep, SwappedFrames, DarkSide, WetLens, Stabiliser, GhostReflection, CodecSkip, CauteryBursts)
