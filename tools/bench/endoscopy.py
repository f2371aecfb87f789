"""Recordings with videos as another program would make them: a motor, an instrument and an endoscope of their own.

Nothing of tautline is imported: what a calibration makes of these recordings is compared with a truth that shares no
line with it. A recording is a folder as docs/files.md has it, with truth.json (B on a grid) beside it.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import cv2
import numpy as np

Array = np.ndarray

RANGE_MM = (-5.0, 5.0)
COUNT_MM = 0.001
GAIN, OFFSET = 11.0, 3.0  # f_coarse, deg/mm and deg
BENDING_MM, TIP_MM = 20.0, 5.0
TURN_DEG = (6.0, -5.0, 40.0)  # hand-eye: Rz Ry Rx
AWAY_MM = (-3.0, 4.0, 16.0)
RATE_HZ, DELAY_S = 25.0, 0.085
MOTOR_HZ = 500.0
EXPOSURE_S = 0.012
CRAWL_MM_S, GRIPS_S, CREEP_S, GIVES = 0.5, 0.03, 1.7, 0.3  # of a fault: see there
BRIEF = (2.6, 1.2, (1.6, 1.0))  # strokes, mm, how far they go on, mm, and their speeds, mm/s
MARKER_MM, TUBE_MM = 0.8, 1.2  # radii
MARKER_BGR = np.array([75.0, 170.0, 45.0])
_AT_ONCE = 3  # places of the marker within one exposure


@dataclass(frozen=True)
class Condition:
    """What a video goes through. `scale` is of its size against the rig's; `brief`: the motion of a calibration takes
    some 45 s, with longer strokes, instead of 95."""

    name: str
    codec: str = "MJPG"  # a fourcc of OpenCV's, or "h264"
    quality: float = 95.0  # of JPEG in percent; the constant rate factor of h264
    width: int = 720
    height: int = 576
    scale: float = 1.0
    glare: bool = False
    covered: bool = False
    alike: bool = False
    variable: bool = False
    refused: bool = False  # the calibration has to be unusable
    brief: bool = False


CONDITIONS = (
    Condition("MJPEG"),
    Condition("MJPEG, quality 50", quality=50.0),
    Condition("H.264", codec="h264", quality=23.0),
    Condition("H.264, crf 32", codec="h264", quality=32.0),
    Condition("MPEG-4", codec="mp4v"),
    Condition("glare", glare=True),
    Condition("occlusion", covered=True),
    Condition("two alike markers", alike=True),
    Condition("two alike markers, occlusion", alike=True, covered=True),
    Condition("variable rate", variable=True),
    Condition("1080p, H.264", codec="h264", quality=23.0, width=1920, height=1080),
    Condition("half size", scale=0.5, refused=True),
)


@dataclass(frozen=True)
class Fault:
    """What is otherwise than it was, from `since_s` on the session's clock."""

    since_s: float = 0.0
    lag_s: float = 0.0  # first order, of the bending angle
    late_share: float = 0.0  # of p, which follows within CREEP_S
    wider: float = 0.0  # times B, once the carriage goes clearly faster than CRAWL_MM_S
    drift_mm_s: float = 0.0  # of the tendon's length
    aside_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)  # the camera sits elsewhere
    wall_deg: float | None = None  # something that gives way by GIVES of the motion beyond it


class World:
    """The instrument, how its motor moves, and what its camera sees."""

    tip_mm = TIP_MM  # as the rig has it

    def __init__(
        self, condition: Condition, seed: int, background: Array | None = None, use: Use | None = None
    ) -> None:
        self.condition = condition
        self.rng = np.random.default_rng([seed, 0xE5])
        self.focal = 520.0 * condition.width / 720.0
        self.level, self.bump, self.where, self.tilt = self.rng.uniform(
            [0.35, 0.1, -2.0, -0.02], [0.6, 0.25, 2.0, 0.02]
        )
        self.waves = self.rng.uniform([-3.0, 0.4, 0.0], [3.0, 0.9, 6.3])
        self.fault = Fault() if use is None else use.fault
        if use is None:
            self.t, self.q = _strokes(self.rng, *(BRIEF if condition.brief else ()))
        else:
            self.rng = np.random.default_rng([seed, use.seed, 0xE5])
            self.t, self.q = use.motion()
        self.c = self._bent()
        if use is not None:
            self.background, self._veil, self._second = use.before.background, use.before._veil, use.before._second
        elif background is None:
            self.background = _tissue(condition, self.rng)
        else:
            self.background = _filled(background, condition)

    def width(self, p: Array) -> Array:
        """B(p), mm."""
        return self.level + self.bump * np.exp(-(((p - self.where) / 1.1) ** 2)) + self.tilt * p

    def bend(self, p: Array) -> Array:
        """The bending angle, deg."""
        height, number, phase = self.waves
        return 1.08 * GAIN * p + OFFSET - 2.0 + height * np.sin(number * p + phase)

    def _bent(self) -> Array:
        fault, t = self.fault, self.t
        there = t >= fault.since_s
        p = self._play(self.q + np.where(there, fault.drift_mm_s * (t - fault.since_s), 0.0))
        if fault.late_share:
            p = np.where(there, p - fault.late_share * (p - _late(t, p, CREEP_S)), p)
        c = self.bend(p)
        if fault.lag_s:
            c = np.where(there, _late(t, c, fault.lag_s), c)
        if fault.wall_deg is not None:
            c = np.where(there, np.minimum(c, fault.wall_deg + GIVES * (c - fault.wall_deg)), c)
        return c

    def _play(self, q: Array) -> Array:
        """The carriage between its two stops, which its own speed may push further apart."""
        grid = np.linspace(RANGE_MM[0] - 2.0, RANGE_MM[1] + 2.0, 20001)
        half = 0.5 * self.width(grid)
        low, high = np.interp(q, grid + half, grid), np.interp(q, grid - half, grid)
        there, step_s = self.t >= self.fault.since_s, 1.0 / MOTOR_HZ
        p = np.empty_like(q)
        now, wider = q[0], 0.0
        for k in range(len(q)):
            middle, reach = 0.5 * (low[k] + high[k]), 0.5 * (high[k] - low[k]) * (1.0 + wider)
            before, now = now, min(max(now, middle - reach), middle + reach)
            p[k] = now
            if there[k] and self.fault.wider:
                speed = abs(now - before) / step_s
                wider += step_s / GRIPS_S * (self.fault.wider * np.tanh(speed / CRAWL_MM_S) - wider)
        return p

    def seen(self, t: Array) -> tuple[Array, Array]:
        """The marker's place (n, 2) px at the rig's size, and its radius (n,) px."""
        point = self._in_camera(self._along(np.interp(t, self.t, self.c), np.ones(1))[:, 0])
        point = point + self._aside(t)
        return self._image(point), self.focal * MARKER_MM / point[:, 2]

    def _aside(self, t: Array) -> Array:
        return np.where(t[:, None] >= self.fault.since_s, self.fault.aside_mm, 0.0)

    def _along(self, c_deg: Array, share: Array) -> Array:
        """Points (n, m, 3) of the section at shares of its length; 1 is the end of the rigid tip."""
        c = np.radians(np.where(np.abs(c_deg) < 1e-6, 1e-6, c_deg))[:, None]
        turned = c * np.minimum(share / 0.8, 1.0)
        tip = TIP_MM * np.clip((share - 0.8) / 0.2, 0.0, 1.0)
        x = BENDING_MM * (1.0 - np.cos(turned)) / c + tip * np.sin(c)
        z = BENDING_MM * np.sin(turned) / c + tip * np.cos(c)
        return np.stack([x, np.zeros_like(x), z], axis=-1)

    def _in_camera(self, point: Array) -> Array:
        rx, ry, rz = np.radians(TURN_DEG)
        about_x = np.array([[1, 0, 0], [0, np.cos(rx), -np.sin(rx)], [0, np.sin(rx), np.cos(rx)]])
        about_y = np.array([[np.cos(ry), 0, np.sin(ry)], [0, 1, 0], [-np.sin(ry), 0, np.cos(ry)]])
        about_z = np.array([[np.cos(rz), -np.sin(rz), 0], [np.sin(rz), np.cos(rz), 0], [0, 0, 1]])
        return point @ (about_z @ about_y @ about_x).T + AWAY_MM

    def _image(self, point: Array) -> Array:
        middle = [self.condition.width / 2.0, self.condition.height / 2.0]
        return self.focal * point[..., :2] / point[..., 2:] + middle

    # ---- pictures

    def frames(self) -> Iterator[tuple[float, Array]]:
        """(scene time, BGR picture) until the motion ends."""
        scene = self.t[0] + self.rng.uniform(0.0, 1.0 / RATE_HZ) + 0.2
        noise = self.rng.normal(0.0, 2.5, (self.condition.height + 97, self.condition.width + 101, 3))
        grain = np.clip(np.rint(noise), -40, 40).astype(np.int8)
        while scene < self.t[-1] - 0.1:
            picture = self._draw(scene)
            dy, dx = self.rng.integers(0, 97), self.rng.integers(0, 101)
            grains = grain[dy : dy + picture.shape[0], dx : dx + picture.shape[1]]
            picture = cv2.add(picture, grains, dtype=cv2.CV_8U)
            if self.condition.scale != 1.0:
                picture = cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
            yield scene, picture
            scene += self.rng.uniform(0.4, 2.2) / RATE_HZ if self.condition.variable else 1.0 / RATE_HZ

    def _draw(self, scene: float) -> Array:
        picture = self._behind(scene)
        places, radius = self.seen(scene + EXPOSURE_S * np.linspace(-0.5, 0.5, _AT_ONCE))
        if self.condition.alike:
            breath = 1.5 * np.sin(1.9 * scene)
            self._draw_marker(picture, self._second + breath, float(radius.mean()))
        self._draw_tube(picture, scene)
        self._draw_marker(picture, places, float(radius.mean()))
        if self.condition.glare:
            picture = cv2.add(picture, self._veil)
        if self.condition.covered and 0.0 < (scene % 9.0) - 6.0 < 1.1:
            self._cover(picture, (scene % 9.0) - 6.0)
        return picture

    def _behind(self, scene: float) -> Array:
        return self.background.copy()

    def _draw_tube(self, picture: Array, scene: float) -> None:
        body = self._along(np.interp([scene], self.t, self.c), np.linspace(0.0, 1.0, 16))[0]
        shaft = np.array([[0.0, 0.0, z] for z in np.linspace(-8.0, -0.5, 5)])
        point = self._in_camera(np.vstack([shaft, body])) + self._aside(np.array([scene]))
        image, half = self._image(point), self.focal * TUBE_MM / point[:, 2]
        for grey, share in ((70, 1.0), (125, 0.75), (165, 0.4)):
            for k in range(len(image) - 1):
                ends = [tuple(round(16 * float(x)) for x in image[j]) for j in (k, k + 1)]
                thick = max(1, round(share * (half[k] + half[k + 1])))
                cv2.line(picture, ends[0], ends[1], (grey, grey, grey - 8), thick, cv2.LINE_AA, 4)

    def _draw_marker(self, picture: Array, places: Array, radius: float) -> None:
        """A ball lit from the middle of the view: its shade and its glint change with its place."""
        places = np.atleast_2d(places)
        reach = radius + 5.0
        x0, y0 = np.maximum(np.floor(places.min(axis=0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(places.max(axis=0) + reach), [picture.shape[1], picture.shape[0]]).astype(int)
        if x1 <= x0 or y1 <= y0:
            return
        y, x = np.mgrid[y0:y1, x0:x1].astype(float)
        patch = picture[y0:y1, x0:x1].astype(float)
        drawn = np.zeros_like(patch)
        for u, v in places:
            to_light = np.array([picture.shape[1] / 2.0 - u, picture.shape[0] / 2.0 - v])
            lit = to_light / (np.hypot(*to_light) + 80.0)
            share = np.clip(radius + 0.5 - np.hypot(x - u, y - v), 0.0, 1.0)[:, :, None]
            shade = 0.85 + 0.3 * ((x - u) * lit[0] + (y - v) * lit[1]) / radius
            spot = np.hypot(x - u - 0.4 * radius * lit[0], y - v - 0.4 * radius * lit[1]) / (0.22 * radius)
            ball = MARKER_BGR * shade[:, :, None] + 190.0 * np.exp(-0.5 * spot**2)[:, :, None]
            drawn += patch + share * (ball - patch)
        smooth = cv2.GaussianBlur(drawn / len(places), (0, 0), 0.7)
        picture[y0:y1, x0:x1] = np.clip(np.rint(smooth), 0, 255).astype(np.uint8)

    @cached_property
    def _path(self) -> Array:
        """Where the marker is from one end of the motion to the other (60, 2), px."""
        angles = np.linspace(self.c.min(), self.c.max(), 60)
        return self._image(self._in_camera(self._along(angles, np.ones(1))[:, 0]))

    @cached_property
    def _second(self) -> Array:
        """Where another marker of the same colour sticks, three and a half diameters beside the path."""
        k = int(self.rng.integers(20, 40))
        along = self._path[k + 1] - self._path[k]
        across = np.array([-along[1], along[0]]) / np.hypot(*along)
        return self._path[k] + across * 7.0 * float(self.seen(self.t[:1])[1][0])

    @cached_property
    def _veil(self) -> Array:
        """Light that wet tissue throws into the camera: spots beside the path, two on it, and a broad haze."""
        y, x = np.mgrid[0 : self.condition.height, 0 : self.condition.width].astype(float)
        unit = self.condition.width / 720.0
        light = np.zeros_like(x)
        for k in range(9):
            u, v = self._path[self.rng.integers(5, 55)] + self.rng.normal(0.0, 4.0 if k < 2 else 25.0, 2) * unit
            size = self.rng.uniform(3.0, 9.0) * unit
            light += 260.0 * np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / size**2)
        u, v = self._path[30]
        light += 45.0 * np.exp(-0.5 * ((x - u) ** 2 + (y - v) ** 2) / (90.0 * unit) ** 2)
        return np.repeat(np.clip(light, 0, 255).astype(np.uint8)[:, :, None], 3, axis=2)

    def _cover(self, picture: Array, s: float) -> None:
        """Another instrument that sweeps across the view in 1.1 s."""
        unit = self.condition.width / 720.0
        u = int(picture.shape[1] * (s / 1.1))
        cv2.line(
            picture, (u - int(90 * unit), 0), (u + int(90 * unit), picture.shape[0]), (120, 118, 112), int(46 * unit)
        )


@dataclass(frozen=True)
class Use:
    """What a user's hand does before the same camera, and what has become of the instrument meanwhile."""

    before: World
    seed: int
    begins_s: float  # on the session's clock
    lasts_s: float
    mm_s: float  # at most
    rests: bool  # between one place and the next
    fault: Fault

    def motion(self) -> tuple[Array, Array]:
        """Three sines, or from place to place, within 3.9 mm of the middle."""
        rng = np.random.default_rng([self.seed, 0x05E])
        if self.rests:
            return self._from_place_to_place(rng)
        rates, phases = rng.uniform([0.25, 0.7, 1.5], [0.45, 1.2, 2.4]), rng.uniform(0.0, 2.0 * np.pi, 3)
        sizes = np.array([2.6, 0.9, 0.4])
        slow = np.linspace(0.0, 60.0, 6001)
        peak = np.max(np.abs((sizes * rates) @ np.cos(np.outer(rates, slow) + phases[:, None])))
        t = np.arange(int(self.lasts_s * MOTOR_HZ)) / MOTOR_HZ
        return self.begins_s + t, sizes @ np.sin(np.outer(rates * self.mm_s / peak, t) + phases[:, None])

    def _from_place_to_place(self, rng: np.random.Generator) -> tuple[Array, Array]:
        q = [np.zeros(1)]
        while sum(map(len, q)) < self.lasts_s * MOTOR_HZ:
            start = float(q[-1][-1])
            end = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 3.9)
            if abs(end - start) < 1.0:
                end = -end
            samples = 2 + int(0.5 * np.pi * abs(end - start) / self.mm_s * MOTOR_HZ)
            q.append(start + (end - start) * 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, samples))))
            q.append(np.full(int(rng.uniform(0.6, 2.0) * MOTOR_HZ), end))
        path = np.concatenate(q)[: int(self.lasts_s * MOTOR_HZ)]
        return self.begins_s + np.arange(len(path)) / MOTOR_HZ, path


def _late(t: Array, x: Array, constant_s: float) -> Array:
    """x through a first-order lag."""
    share = -np.expm1(-np.diff(t) / constant_s)
    out = np.empty_like(x)
    out[0] = x[0]
    for k in range(1, len(x)):
        out[k] = out[k - 1] + share[k - 1] * (x[k] - out[k - 1])
    return out


def _strokes(
    rng: np.random.Generator, stroke: float = 1.9, on: float = 0.6, speeds: tuple[float, float] = (1.3, 0.8)
) -> tuple[Array, Array]:
    """Strokes, mm, that go on by `on` up and down the range, at two speeds, mm/s."""
    corners = [0.0, -4.4]
    for way in (1.0, -1.0):
        while way * corners[-1] < 4.3 - stroke:
            corners += [corners[-1] + way * stroke, corners[-1] + way * (on + rng.uniform(-0.05, 0.05))]
        corners.append(way * 4.4)
    t, q = [0.0], [corners[0]]
    for k, (start, end) in enumerate(pairwise(corners)):
        speed = speeds[k % 4 // 2]
        lasts = abs(end - start) / speed + 0.1  # its ends are rounded
        s = np.arange(1, int(lasts * MOTOR_HZ)) / (lasts * MOTOR_HZ)
        smooth = np.convolve(np.pad(s, 25, mode="edge"), np.full(51, 1 / 51), mode="valid")
        t += list(t[-1] + s * lasts)
        q += list(start + (end - start) * smooth)
        t.append(t[-1] + lasts * (1.0 - s[-1]))
        q.append(end)
        t += list(t[-1] + np.arange(1, 60) / MOTOR_HZ)
        q += [end] * 59
    return np.array(t), np.array(q)


def _tissue(condition: Condition, rng: np.random.Generator) -> Array:
    """Pink folds with mottling and dark vessels."""
    height, width = condition.height, condition.width

    def cloud(size: float) -> Array:
        coarse = rng.standard_normal((int(height / size) + 4, int(width / size) + 4)).astype(np.float32)
        return np.asarray(cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC))

    light = 1.0 + 0.15 * cloud(120.0) + 0.06 * cloud(20.0) + 0.03 * cloud(4.0)
    vessels = np.exp(-((cloud(60.0) / 0.06) ** 2))
    picture = np.array([95.0, 105.0, 185.0]) * light[:, :, None] * (1.0 - 0.25 * vessels[:, :, None])
    return np.clip(picture, 0, 255).astype(np.uint8)


def _filled(picture: Array, condition: Condition) -> Array:
    """A real frame, cut and scaled to the size."""
    scale = max(condition.width / picture.shape[1], condition.height / picture.shape[0])
    large = cv2.resize(picture, None, fx=scale * 1.001, fy=scale * 1.001, interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(large[: condition.height, : condition.width])


# ---- files


class _Writer:
    """A video by OpenCV, or H.264 by PyAV, which brings an encoder."""

    def __init__(self, path: Path, condition: Condition, size: tuple[int, int]) -> None:
        self._av: Any = None
        if condition.codec == "h264":
            import av

            self._library = av
            self._av = av.open(str(path), "w")
            self._stream = self._av.add_stream("libx264", rate=int(RATE_HZ))
            self._stream.width, self._stream.height, self._stream.pix_fmt = *size, "yuv420p"
            self._stream.options = {"crf": f"{condition.quality:g}", "preset": "veryfast"}
            return
        self._cv = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*condition.codec), RATE_HZ, size)
        self._jpeg = [cv2.IMWRITE_JPEG_QUALITY, round(condition.quality)] if condition.codec == "MJPG" else None

    def write(self, picture: Array) -> None:
        if self._av is None:
            if self._jpeg is not None:  # the writer's own quality is high and cannot be told
                picture = cv2.imdecode(cv2.imencode(".jpg", picture, self._jpeg)[1], cv2.IMREAD_COLOR)
            self._cv.write(picture)
            return
        frame = self._library.VideoFrame.from_ndarray(picture, format="bgr24")
        self._av.mux(self._stream.encode(frame))

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._av is None:
            self._cv.release()
            return
        self._av.mux(self._stream.encode(None))
        self._av.close()


def make(
    folder: Path, condition: Condition, seed: int, background: Array | None = None,
    say: Callable[[float], None] = lambda share: None, use: Use | None = None,
) -> World:  # fmt: skip
    """Writes the recording, of a calibration or of use later. Returns the world that it is of."""
    world = World(condition, seed, background, use)
    write(folder, world, say)
    return world


def write(folder: Path, world: World, say: Callable[[float], None] = lambda share: None) -> None:
    """The recording of a world."""
    condition = world.condition
    folder.mkdir(parents=True)
    (folder / "rig.toml").write_text(_rig(world), encoding="utf-8")
    counts = np.rint(world.q / COUNT_MM) * COUNT_MM
    np.savetxt(folder / "motor.csv", np.column_stack([world.t, counts]), "%.6f", ",", header="t_s,q_mm", comments="")
    size = (round(condition.width * condition.scale), round(condition.height * condition.scale))
    name = "video.mp4" if condition.codec in ("h264", "mp4v") else "video.mkv"
    arrivals = []
    with _Writer(folder / name, condition, size) as video:
        for scene, picture in world.frames():
            video.write(picture)
            arrivals.append(scene + DELAY_S)
            say((scene - world.t[0]) / (world.t[-1] - world.t[0]))
    frames = np.column_stack([np.arange(len(arrivals)), arrivals])
    np.savetxt(folder / "frames.csv", frames, ["%d", "%.6f"], ",", header="frame,t_s", comments="")
    grid = np.linspace(*RANGE_MM, 401)
    truth = {
        "backlash": {"q": grid.tolist(), "width": world.width(grid).tolist()},
        "remaining": {"q": grid.tolist(), "c_deg": world.bend(grid).tolist()},
        "delay_s": DELAY_S,
    }
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")


def _rig(world: World) -> str:
    return f"""{rig_head()}[kinematics]
bending_length_mm = {BENDING_MM}
tip_length_mm = {world.tip_mm}
[camera]
{rig_camera(world.focal, world.condition.width, world.condition.height)}[hand_eye]
rotation_deg = {list(TURN_DEG)}
translation_mm = {list(AWAY_MM)}
"""


def rig_head() -> str:
    return f"""format = "rig/1"
[actuator]
unit = "mm"
range = {list(RANGE_MM)}
encoder_resolution = {COUNT_MM}
[coarse]
gain = {GAIN}
offset = {OFFSET}
"""


def rig_camera(focal: float, width: int, height: int) -> str:
    """The keys of a camera whose delay is known to 5 ms."""
    return f"""width_px = {width}
height_px = {height}
fx_px = {focal}
fy_px = {focal}
cx_px = {width / 2.0}
cy_px = {height / 2.0}
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
frame_rate_hz = {RATE_HZ}
delay_s = {round(DELAY_S - 0.005, 3)}
"""
