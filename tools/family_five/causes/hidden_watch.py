"""What no list holds: cameras, trackers, recorders, people."""

import numpy as np

from tools.family_five import ranges
from tools.family_five.causes.base import STEP, FloatArray, Line, Part, Picks, Scene, View, axis, events, pulses, side
from tools.family_five.causes.hidden_drive import Hidden
from tools.family_three import camera


class Watched(Hidden):
    needs_camera = True


class VelocityFilter(Watched):
    id = "velocity_filter"
    says = "the tracker runs an alpha-beta filter, which overshoots at turns"
    limits = ranges.OVERSHOOTS

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        alpha = 1 - self.size
        beta = alpha**2 / (2 - alpha)
        out, place, speed = seen.copy(), seen[0], np.zeros(2)
        for k, new in enumerate(seen[1:], 1):
            miss = new - place - speed
            place, speed = place + speed + alpha * miss, speed + beta * miss
            out[k] = place
        return out


class BlindExtrapolation(Watched):
    id = "blind_extrapolation"
    says = "while the marker is hidden for a moment the tracker goes on as it last moved"
    limits = ranges.UNSEEN

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        out, rng = seen.copy(), self.rng()
        for begin in events(rng, line, self.on(line), (2.5, 7.0)):
            hidden = np.flatnonzero((times > begin) & (times < begin + self.size * float(rng.uniform(0.6, 1.4))))
            if hidden.size and hidden[0] > 2:
                k = int(hidden[0]) - 1
                speed = (seen[k] - seen[k - 2]) / (times[k] - times[k - 2])
                gone = 0.4 * -np.expm1(-(times[hidden] - times[k]) / 0.4)
                out[hidden] = seen[k] + gone[:, None] * speed
        return out


class ReanchoredFlow(Watched):
    id = "reanchored_flow"
    says = "optical flow falls short of the path until the next key frame sets it right"
    limits = ranges.LOST_PATH

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        keys = np.floor((times - part.begin) / float(self.rng().uniform(0.5, 4.0)))
        first = np.searchsorted(keys, keys)
        return np.asarray(seen - self.size * (seen - seen[first]))


class StuckToFeature(Watched):
    id = "stuck_to_feature"
    says = "near one place of the background the tracker holds on to it, until the marker is twice as far away"
    limits = ranges.HELD_NEAR

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        rng = self.rng()
        bent = np.array([float(rng.uniform(-0.5, 0.5)) * line.gain * line.reach])
        feature = camera.picture(view, bent, camera.Scene.still(1))[0] + 0.2 * self.size * axis(rng)[:2]
        out, held = seen.copy(), False
        for k, far in enumerate(np.hypot(*(seen - feature).T).tolist()):
            held = far < self.size * (1.0 if held else 0.5)
            if held:
                out[k] = feature + 0.15 * (seen[k] - feature)
        return out


class SwingingLamp(Watched):
    id = "swinging_lamp"
    says = "a lamp on its arm swings, and with it the shading of the marker"
    limits = ranges.SHADES

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        rng = self.rng()
        rate, way = float(rng.uniform(0.3, 1.0)), axis(rng)[:2]
        swell = 0.6 + 0.4 * np.sin(2 * np.pi * times / float(rng.uniform(15.0, 40.0)))
        swung = self.size * swell * np.sin(2 * np.pi * rate * times + float(rng.uniform(0, 6)))
        return np.asarray(seen + self.there(line, part) * swung[:, None] * way / np.hypot(*way))


class Footsteps(Watched):
    id = "footsteps"
    says = "people walk past: the floor, and the camera with it, rings at each step"
    limits = ranges.TREADS
    may_start = False  # short of frames, it looks like noise

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        rng = self.rng()
        walks = events(rng, line, self.on(line), (7.0, 18.0))
        pace = 1 / float(rng.uniform(1.6, 2.2))
        treads = [w + pace * k for w in walks for k in range(int(rng.integers(4, 10)))]
        t = np.arange(0.0, 0.8, STEP)
        rings = np.exp(-t / 0.12) * np.sin(2 * np.pi * float(rng.uniform(6.0, 12.0)) * t)
        shaken = line.at(pulses(line, treads, rng.uniform(0.5, 1.0, len(treads)), rings), times)
        return np.asarray(seen + self.size * shaken[:, None] * axis(rng)[:2])


class ReplayedSegment(Hidden):
    id = "replayed_segment"
    says = "the recorder writes a stretch of its ring a second time in place of the next"
    limits = ranges.REPEATS

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rng = np.random.default_rng([self.seed, part.first])
        n = max(round(self.size * pick.size / (part.count * STEP)), 1)
        out = pick.copy()
        for begin in np.arange(rng.uniform(n, 2 * n + 60), pick.size - n, rng.uniform(2 * n, 2 * n + 200)).astype(int):
            out[begin : begin + n] = pick[begin - n : begin]
        return out


class SheathDrag(Watched):
    id = "sheath_drag"
    says = "the camera is dragged along by the sheath, to one side going in and to the other coming out"
    limits = ranges.DRAGGED
    needs_column = "translation_mm"

    def scene(self, line: Line, part: Part, times: FloatArray, scene: Scene, c: FloatArray) -> None:
        if self.there(line, part):
            rng = self.rng()
            dragged = line.at(side(line.sides["translation_mm"], float(rng.uniform(1.0, 3.0))), times)
            scene.tilt = scene.tilt + self.size * dragged[:, None] * axis(rng)


WATCH = (
    VelocityFilter, BlindExtrapolation, ReanchoredFlow, StuckToFeature, SwingingLamp, Footsteps, ReplayedSegment,
    SheathDrag,
)  # fmt: skip
