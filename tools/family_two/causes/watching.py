"""Causes that no list holds, in what watches."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, cont2discrete, lfilter, sosfiltfilt

from tools.family_two import ranges
from tools.family_two.camera import Scene, View
from tools.family_two.causes.base import Cause, follow
from tools.family_two.causes.seeing import direction
from tools.family_two.motion import STEP, other_joint
from tools.family_two.timeline import Part, Timeline

FloatArray = NDArray[np.float64]


class Untwist(Cause):
    id = "cable_untwist"
    says = "a laid rope under pull turns its free end about its axis, over seconds"
    limits = ranges.ROLL
    unlisted = needs_camera = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        pull = np.abs(c) / np.max(np.abs(c))
        late = follow(pull, STEP, float(rng.uniform(2.0, 8.0))) - 0.5 * pull
        scene.rotation = scene.rotation + float(rng.choice([-1.0, 1.0])) * self.size * line.at(late * self.on(line), t)


class Insertion(Cause):
    id = "unlogged_insertion"
    says = "someone moves the instrument in and out by hand now and then, and no column says so"
    limits = ranges.INSERTION
    unlisted, needs_camera, may_start = True, True, False

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        moved = other_joint(self.rng, line.t.size, 1.0) * follow(self.on(line), STEP, 0.5)
        scene.translation = scene.translation + self.size * line.at(moved, t)


class Nudges(Cause):
    id = "nudges"
    says = "someone leans on the camera's stand for a second or two, several times, and it comes back"
    limits = ranges.NUDGE
    unlisted, needs_camera, may_start = True, True, False

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        pushed = np.zeros(line.t.size)
        for part in line.parts[1:]:
            for _ in range(int(rng.integers(2, 5))):
                begin = part.first + int(rng.uniform(0.1, 0.9) * part.count)
                pushed[begin : begin + int(rng.uniform(0.8, 3.0) / STEP)] = float(rng.uniform(0.4, 1.0))
        scene.turn = scene.turn + line.at(follow(pushed, STEP, 0.1), t)[:, None] * self.size * direction(rng)


class HandHeld(Cause):
    id = "hand_held"
    says = "the camera is held by hand: slow sway and tremor"
    limits = ranges.HELD_BY_HAND
    unlisted = needs_camera = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        slow = sosfiltfilt(butter(2, [0.08, 0.6], "bandpass", fs=1 / STEP, output="sos"), rng.normal(size=(3, c.size)))
        fast = sosfiltfilt(butter(2, [8.0, 11.0], "bandpass", fs=1 / STEP, output="sos"), rng.normal(size=(3, c.size)))
        sway = slow / slow.std() + 0.15 * fast / fast.std()
        for i in range(3):
            scene.turn = scene.turn.copy()
            scene.turn[:, i] += self.size * line.at(sway[i] * self.on(line), t)


class Ringing(Cause):
    id = "stand_ringing"
    says = "the camera's stand rings after each start and stop of the motor"
    limits = ranges.RINGING
    unlisted = needs_camera = True

    def parameters(self, line: Timeline) -> dict[str, float | str]:
        return {"rate_hz": float(self.rng.uniform(2.0, 6.0))}

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        w, z = 2 * np.pi * float(self.parameters(line)["rate_hz"]), float(rng.uniform(0.02, 0.08))
        # moved by the drive's acceleration: w s^2 / (s^2 + 2 z w s + w^2) of its place is w s / (...) of its speed
        num, den, _ = cont2discrete((np.array([w, 0.0]), np.array([1.0, 2 * z * w, w * w])), STEP, method="bilinear")
        rung = lfilter(np.ravel(num), den, line.speed / line.usual_speed)
        axis = direction(np.random.default_rng([self.seed, 1]))
        scene.turn = scene.turn + line.at(rung * self.on(line), t)[:, None] * self.size * axis


class LooseMarker(Cause):
    id = "loose_marker"
    says = "the marker is loose and flops to its other side when the tip has turned over far enough"
    limits = ranges.LOOSE
    unlisted = needs_camera = True

    def pose(self, scene: Scene, line: Timeline, c: FloatArray, t: FloatArray) -> None:
        rng = self.rng
        most = float(np.max(np.abs(c)))
        turned = c / most - float(rng.uniform(-0.25, 0.25))
        far = float(rng.uniform(0.15, 0.3))
        event = np.where(turned > far, 1.0, np.where(turned < -far, -1.0, 0.0))
        last = np.maximum.accumulate(np.where(event != 0, np.arange(event.size), 0))
        flop = event[last]
        scene.loose = scene.loose + self.size * line.at(follow(flop, STEP, 0.03) * self.on(line), t)


class TemplateDrift(Cause):
    id = "template_drift"
    says = "the tracker renews its template: of each frame's motion an error stays, which wanders"
    limits = ranges.TEMPLATE
    unlisted = needs_camera = True

    def image(self, line: Timeline, part: Part, seen: FloatArray, view: View | None) -> FloatArray:
        rng = np.random.default_rng([self.seed, part.first])
        way = np.abs(np.diff(seen, axis=0, prepend=seen[:1]))
        steps = self.size * np.sqrt(way) * rng.normal(size=seen.shape)
        err = np.cumsum(steps, axis=0) * line.at(self.on(line), part.exposed)[:, None]
        return np.asarray(seen + err)


class PixelLocking(Cause):
    id = "pixel_locking"
    says = "sub-pixel estimates of a binned image lean to its pixels, two of the frame's apart"
    limits = ranges.PIXEL
    unlisted = needs_camera = True

    def image(self, line: Timeline, part: Part, seen: FloatArray, view: View | None) -> FloatArray:
        on = line.at(self.on(line), part.exposed)[:, None]
        return np.asarray(seen - on * self.size * np.sin(np.pi * seen))


class HuntingExposure(Cause):
    id = "hunting_exposure"
    says = "automatic exposure hunts: the middle of the exposure comes earlier and later, slowly"
    limits = ranges.HUNTING_EXPOSURE
    unlisted = needs_camera = True

    def early(self, line: Timeline, t: FloatArray) -> FloatArray:
        rng = self.rng
        low = butter(1, float(rng.uniform(0.08, 0.3)), fs=1 / STEP, output="sos")
        wave = sosfiltfilt(low, rng.normal(size=line.t.size))
        return self.size * line.at(np.tanh(1.5 * wave / wave.std()) * self.on(line), t)


class Fields(Cause):
    id = "interlaced_fields"
    says = "frames are single fields of an interlaced camera: every other one a part of a line higher"
    limits = ranges.FIELDS
    unlisted = needs_camera = True

    def image(self, line: Timeline, part: Part, seen: FloatArray, view: View | None) -> FloatArray:
        parity = np.where(np.arange(len(seen)) % 2 == 0, 0.5, -0.5) * line.at(self.on(line), part.exposed)
        return np.asarray(seen + self.size * np.stack([np.zeros(parity.size), parity], axis=1))


class OneEuro(Cause):
    id = "one_euro_filter"
    says = "the tracker smooths what is slow and lets pass what is fast: late at low speed alone"
    limits = ranges.FILTER
    unlisted = True

    def image(self, line: Timeline, part: Part, seen: FloatArray, view: View | None) -> FloatArray:
        period = float(np.median(np.diff(part.exposed)))
        speed = np.linalg.norm(np.gradient(seen, period, axis=0), axis=1)
        fast = float(np.percentile(speed, 80)) * float(self.rng.uniform(0.1, 0.4))
        on = line.at(self.on(line), part.exposed)
        out = seen.copy()
        for i in range(1, len(seen)):
            slow = out[i - 1] + (seen[i] - out[i - 1]) / (1 + on[i] * self.size / (1 + speed[i] / fast) / period)
            out[i] = slow
        return out


WATCHING: tuple[type[Cause], ...] = (
    Untwist, Insertion, Nudges, HandHeld, Ringing, LooseMarker, TemplateDrift, PixelLocking, HuntingExposure, Fields,
    OneEuro,
)  # fmt: skip
