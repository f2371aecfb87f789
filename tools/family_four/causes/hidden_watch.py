"""Causes that no list holds, from the lens to the frames' stamps."""

import numpy as np
from scipy.signal import lfilter

from tools.family.view import View
from tools.family_four import ranges
from tools.family_four.causes.base import Cause, FloatArray, Line, Part, rising
from tools.family_three.camera import Scene, picture
from tools.family_three.causes.base import Picks


class Hidden(Cause):
    unlisted = True

    def of_part(self, part: Part) -> np.random.Generator:
        return np.random.default_rng([self.seed, part.first])


class ZoomCreep(Hidden):
    id = "zoom_creep"
    says = "the zoom ring sinks under its weight: the focal length moves, evenly"
    limits = ranges.ZOOMS
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        begin = 0.0 if self.since == "start" else line.changed
        gone = np.maximum(times - begin, 0.0) / 100.0 * (1.0 if self.seed % 2 else -1.0)
        centre = np.asarray(view.centre_px)
        return np.asarray(centre + (seen - centre) * (1 + self.size * gone[:, None]))


class ThreadAcross(Hidden):
    id = "thread_across"
    says = "a thread hangs before the lens: where it covers a part of the marker, the rest's centroid is found"
    limits = ranges.CUT_OFF
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        rng = self.rng()
        at = float(rng.uniform(-0.4, 0.4)) * line.gain * line.reach
        place, beyond = picture(view, np.array([at, at + 1.0]), Scene.still(2))
        turned = float(rng.uniform(-0.7, 0.7))  # from square to the marker's way
        along = (beyond - place) / np.linalg.norm(beyond - place)
        across = np.array([[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]) @ along
        return np.asarray(seen + uncovered((seen - place) @ across, self.size, 0.5 * self.size)[:, None] * across)


def uncovered(d: FloatArray, radius: float, half: float) -> FloatArray:
    """By how much the centroid of a disc, d beyond a bar's middle, moves where the bar covers a part of it."""
    ends = np.clip(np.stack([-d - half, -d + half]) / radius, -1, 1)
    areas = ends * np.sqrt(1 - ends**2) + np.arcsin(ends)
    moments = -2 / 3 * (1 - ends**2) ** 1.5
    return np.asarray(-(moments[1] - moments[0]) / (np.pi - areas[1] + areas[0]) * radius)


class FrameBlending(Hidden):
    id = "frame_blending"
    says = "a converter of frame rates mixes each frame with the one before, in a beat"
    limits = ranges.BLENDED
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        beat = float(self.rng().choice([0.2, 0.25, 0.5, 1 / 6, 0.4]))
        share = self.size * np.mod(np.arange(times.size) * beat, 1.0)[:, None]
        return np.asarray(seen + share * (np.concatenate([seen[:1], seen[:-1]]) - seen))


class SilentDrops(Hidden):
    id = "silent_drops"
    says = "frames are lost and the file's even stamps do not say so, until it is set right with repeated frames"
    limits = ranges.LOST

    def picks(self, line: Line, part: Part, pick: Picks, values: FloatArray) -> Picks:
        if not self.there(line, part):
            return pick
        rng = self.of_part(part)
        lost = np.cumsum(rng.random(pick.size) < self.size)
        since = np.searchsorted(np.cumsum(rng.uniform(6.0, 14.0, 60)), part.exposed - part.begin)
        first = np.searchsorted(since, since)  # where each stretch begins
        ahead = np.maximum.accumulate(np.arange(pick.size) + lost - lost[first])
        return np.asarray(pick[np.minimum(ahead, pick.size - 1)])


class FillingBuffer(Hidden):
    id = "filling_buffer"
    says = "a queue fills, so frames come ever later, and is flushed every some seconds"
    limits = ranges.FILLS

    def stamps(self, line: Line, part: Part, arrival: FloatArray) -> FloatArray:
        if not self.there(line, part):
            return arrival
        ends = np.cumsum(np.concatenate([[0.0], self.of_part(part).uniform(3.0, 12.0, 60)]))
        t = arrival - part.begin
        stretch = np.searchsorted(ends, t, side="right") - 1
        full = (t - ends[stretch]) / (ends[stretch + 1] - ends[stretch])
        return rising(arrival + self.size * full)


class FanVibration(Hidden):
    id = "fan_vibration"
    says = "a fan shakes the camera, faster than frames come: its beat with them is seen"
    limits = ranges.SHAKES
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        rng = self.rng()
        rate, way = float(rng.uniform(20, 50)), float(rng.uniform(0, np.pi))
        wanders = 0.4 * np.sin(2 * np.pi * 0.11 * times)  # turns: the speed of the fan is not quite even
        shaken = self.size * np.sin(2 * np.pi * (rate * times + wanders))
        return np.asarray(seen + shaken[:, None] * np.array([np.cos(way), np.sin(way)]))


class HeatHaze(Hidden):
    id = "heat_haze"
    says = "warm air or vapour before the lens: the picture wanders and comes back"
    limits = ranges.WANDERS
    needs_camera = True

    def picture(self, line: Line, part: Part, times: FloatArray, seen: FloatArray, view: View) -> FloatArray:
        if not self.there(line, part):
            return seen
        keeps = float(np.exp(-np.median(np.diff(times)) / self.rng().uniform(0.3, 2.5)))
        fresh = self.of_part(part).normal(size=(times.size, 2)) * np.sqrt(1 - keeps**2)
        fresh[0] = 0.0
        return np.asarray(seen + self.size * lfilter([1.0], [1.0, -keeps], fresh, axis=0))


WATCH = (ZoomCreep, ThreadAcross, FrameBlending, SilentDrops, FillingBuffer, FanVibration, HeatHaze)
