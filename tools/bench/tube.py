"""Recordings of an instrument without paint: a textured tube that bends over tissue, which may move itself.

The geometry, the motor and the files are those of `endoscopy`; the tube's surface is drawn sample by sample, lit from
the camera, with a glint that stays where the light is while the surface goes on beneath it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import cv2
import numpy as np

from tools.bench.endoscopy import BENDING_MM, EXPOSURE_S, TIP_MM, TUBE_MM, Condition, World

Array = np.ndarray
Place = tuple[slice, slice]

SHAFT_MM = 2.0  # of the straight shaft that the camera sees
PATCH_MM = 0.5 * TIP_MM  # before the end of the tip: the middle of what is followed
RULER_MM = 0.4  # standard deviation, by which the rig has that place elsewhere along the tip
_FINE = 32.0  # samples of the surface per mm
_BLUR_PX = 4  # what a blur reaches
_SMOOTH = 8  # px, within which smoke is alike
_FULL = 0.5  # samples in a pixel that hide what is behind
_GAUSS = 0.2887 * np.array([-1.0, 1.0])  # of an exposure: two times with its mean and its spread


@dataclass(frozen=True)
class Scene:
    """What is before the camera. `texture`: rms of the surface's own brightness, share; `breath_px`: how far the tissue
    goes to and fro; `glint`: levels; `smoke`: share of the light at its thickest; `still`: the tendon is torn."""

    name: str
    texture: float = 0.14
    breath_px: float = 0.0
    glint: float = 40.0
    smoke: float = 0.0
    codec: str = "MJPG"
    still: bool = False

    @property
    def condition(self) -> Condition:
        quality = 23.0 if self.codec == "h264" else 95.0
        return Condition(self.name, codec=self.codec, quality=quality, brief=True)

    @classmethod
    def drawn(cls, kind: str, seed: int) -> Self:
        """One of a kind: what is not as in a clean one is drawn from even distributions."""
        rng = np.random.default_rng([seed, KINDS.index(kind), 0xBA])
        if kind == "clean":
            return cls(kind, texture=float(rng.uniform(0.1, 0.18)))
        texture, breath, glint, smoke = rng.uniform([0.07, 3.0, 40.0, 0.0], [0.16, 10.0, 170.0, 0.35]).tolist()
        codec = "h264" if kind == "hard" or seed % 2 else "MJPG"
        return cls(kind, texture, breath, glint, smoke, codec, kind == "torn")


KINDS = ("torn", "clean", "hard")


class BareWorld(World):
    """An instrument that nobody marked."""

    def __init__(self, scene: Scene, seed: int, background: Array | None = None) -> None:
        self.scene = scene
        super().__init__(scene.condition, seed, background)
        if scene.still:
            self.c = np.full_like(self.t, float(self.c[0]))
        else:  # who shows the tip bends it before, until the camera sees it from its side
            shows = np.arange(len(self.t)) >= int(np.argmax(self.q <= self.q.min()))
            self.t, self.q, self.c = self.t[shows], self.q[shows], self.c[shows]
        self._before: tuple[Array, Any] = np.empty(0), None
        self._wind = self.rng.uniform(0.0, 6.3, 4)
        by_ruler = np.random.default_rng([seed, 0x7E1]).normal(0.0, RULER_MM)
        self.tip_mm = round(TIP_MM - PATCH_MM + float(by_ruler), 2)

    def patch(self, t: Array) -> Array:
        """Where the followed place of the surface is seen at scene times (n,): (n, 2) px."""
        along = SHAFT_MM + BENDING_MM + TIP_MM - PATCH_MM
        places = []
        for c in np.interp(t, self.t, self.c):
            middle, _, aside = self._spine(float(c), np.array([along]))
            facing = self._facing
            normal = np.cos(facing) * aside + np.sin(facing) * np.array([0.0, 1.0, 0.0])
            places.append(self._image(self._in_camera(middle + TUBE_MM * normal))[0])
        return np.array(places)

    @cached_property
    def side_px(self) -> float:
        """Of a square as wide as the tip, where it is shown."""
        along = np.array([SHAFT_MM + BENDING_MM + TIP_MM - PATCH_MM])
        return 2.0 * TUBE_MM * self.focal / float(self._in_camera(self._spine(float(self.c[0]), along)[0])[0, 2])

    @cached_property
    def _facing(self) -> float:
        """The angle about the tip at which its surface faces the camera where the motion begins."""
        along = np.array([SHAFT_MM + BENDING_MM + TIP_MM - PATCH_MM])
        middle, _, aside = self._spine(float(self.c[0]), along)
        angles = np.linspace(-np.pi, np.pi, 721)
        normal = np.cos(angles)[:, None] * aside + np.sin(angles)[:, None] * np.array([0.0, 1.0, 0.0])
        view = -self._in_camera(middle)[0]
        return float(angles[np.argmax(self._turned(normal) @ view)])

    def _turned(self, way: Array) -> Array:
        return self._in_camera(way) - self._in_camera(np.zeros(3))

    def _spine(self, c_deg: float, along: Array) -> tuple[Array, Array, Array]:
        """Middle, direction ahead and direction aside (n, 3) of the section at lengths (n,) mm from where it is first
        seen; it bends in the plane of x and z."""
        c = np.radians(c_deg if abs(c_deg) > 1e-6 else 1e-6)
        s = along - SHAFT_MM
        turned = c * np.clip(s / BENDING_MM, 0.0, 1.0)
        tip, shaft = np.maximum(s - BENDING_MM, 0.0), np.minimum(s, 0.0)
        x = BENDING_MM * (1.0 - np.cos(turned)) / c + tip * np.sin(turned)
        z = BENDING_MM * np.sin(turned) / c + tip * np.cos(turned) + shaft
        nothing = np.zeros_like(x)
        ahead = np.stack([np.sin(turned), nothing, np.cos(turned)], axis=-1)
        aside = np.stack([np.cos(turned), nothing, -np.sin(turned)], axis=-1)
        return np.stack([x, nothing, z], axis=-1), ahead, aside

    @cached_property
    def _surface(self) -> tuple[Array, Array, Array, Array]:
        """Of a grid of samples: lengths (rows,) mm and angles along the dome (rows,) that ends it, angles about the
        middle (columns,), and brightness (rows, columns)."""
        length = SHAFT_MM + BENDING_MM + TIP_MM
        rows, columns = int(length * _FINE), int(2.0 * np.pi * TUBE_MM * _FINE)
        beyond = int(0.5 * np.pi * TUBE_MM * _FINE)
        grain = self.rng.standard_normal((rows + beyond + 60, columns + 60)).astype(np.float32)
        marks = sum(
            weight * _unit(cv2.GaussianBlur(grain, (0, 0), size * _FINE))
            for size, weight in ((0.06, 0.6), (0.18, 0.7), (0.6, 0.4))
        )
        brightness = np.exp(self.scene.texture * marks[: rows + beyond, :columns])
        row = np.arange(rows + beyond)
        bend = np.clip((row - rows) / beyond, 0.0, 1.0) * 0.5 * np.pi
        along = np.minimum(row / _FINE, length) + TUBE_MM * np.sin(bend)
        return along, bend, 2.0 * np.pi * np.arange(columns) / columns, brightness

    @cached_property
    def _round(self) -> Array:
        """Cosine and sine of the samples' angles (2, columns)."""
        angle = self._surface[2]
        return np.stack([np.cos(angle), np.sin(angle)]).astype(np.float32)

    def _draw(self, scene: float) -> Array:
        behind = self._behind(scene)
        place, drawn = self._exposed(scene)
        within = behind[place].astype(np.float32)
        picture = _soft(behind)
        shown = np.clip(np.rint(_soft(within * (1.0 - drawn[..., 3:]) + drawn[..., :3])), 0, 255)
        # Its rim, which lacks what is beyond it, but where the picture ends.
        rim = [
            slice(_BLUR_PX * (part.start > 0), shown.shape[k] - _BLUR_PX * (part.stop < picture.shape[k]))
            for k, part in enumerate(place)
        ]
        picture[place][rim[0], rim[1]] = shown[rim[0], rim[1]]
        return self._smoked(picture, scene) if self.scene.smoke else picture

    def _exposed(self, scene: float) -> tuple[Place, Array]:
        """Where the tube is in the picture, its light there (.., .., 3), and how much of each pixel it hides, over an
        exposure."""
        bent = np.interp([scene + share * EXPOSURE_S for share in _GAUSS], self.t, self.c)
        if not np.array_equal(bent, self._before[0]):  # else it rests
            self._before = bent, self._drawn(bent.tolist())
        return self._before[1]

    def _drawn(self, bent: Sequence[float]) -> tuple[Place, Array]:
        shape = self.condition.height, self.condition.width
        parts = [self._tube(c_deg, shape) for c_deg in bent]
        corners = np.array([corner for corner, _ in parts])
        ends = corners + [part.shape[:2] for _, part in parts]
        first = np.maximum(corners.min(axis=0) - 2 * _BLUR_PX, 0)
        last = np.minimum(ends.max(axis=0) + 2 * _BLUR_PX, shape)
        drawn = np.zeros((*(last - first), 4), np.float32)
        for corner, end, (_, part) in zip(corners - first, ends - first, parts, strict=True):
            drawn[corner[0] : end[0], corner[1] : end[1]] += part / len(parts)
        return (slice(first[0], last[0]), slice(first[1], last[1])), drawn

    def _tube(self, c_deg: float, shape: tuple[int, int]) -> tuple[tuple[int, int], Array]:
        """The same at one angle, (.., .., 4), and its upper left corner (row, column)."""
        along, bend, angle, brightness = self._surface
        middle, ahead, aside = self._spine(c_deg, along)
        up = self._turned(np.array([[0.0, 1.0, 0.0]]))[0]
        middle, ahead, aside = self._in_camera(middle), self._turned(ahead), self._turned(aside)
        # Of each section the half that may face the camera.
        faces = np.arctan2(-middle @ up, -np.sum(middle * aside, axis=1)) / (2.0 * np.pi) * len(angle)
        half = np.arange(len(angle) // 2 + 6) - len(angle) // 4 - 3
        near = (np.rint(faces).astype(int)[:, None] + half) % len(angle)
        brightness = np.take_along_axis(brightness, near, axis=1)
        thick = np.cos(bend)[:, None].astype(np.float32)
        cos, sin = thick * self._round[0][near], thick * self._round[1][near]
        point, against = [], np.zeros(1, np.float32)
        for k in range(3):
            out = cos * aside[:, k, None].astype(np.float32) + sin * np.float32(up[k])
            point.append(middle[:, k, None].astype(np.float32) + np.float32(TUBE_MM) * out)
            against = against - (out + (np.sin(bend) * ahead[:, k])[:, None].astype(np.float32)) * point[k]
        facing = against / np.sqrt(point[0] ** 2 + point[1] ** 2 + point[2] ** 2)
        brightest = np.maximum(facing.max(axis=1, keepdims=True), np.float32(1e-3))
        seen = facing > 0.02
        glint = self.scene.glint * _sixtieth(np.minimum(facing / brightest, 1.0)[seen])  # where most faces the camera
        light = 150.0 * brightness[seen] * (0.25 + 0.75 * facing[seen]) + glint
        u, v = self._image(np.stack([part[seen] for part in point], axis=-1)).T
        height, width = shape
        left, top = np.floor(u).astype(int), np.floor(v).astype(int)
        x0, y0 = max(int(left.min()), 0), max(int(top.min()), 0)
        x1, y1 = min(int(left.max()) + 2, width), min(int(top.max()) + 2, height)
        inside = (left >= x0) & (left < x1 - 1) & (top >= y0) & (top < y1 - 1)
        u, v, left, top, light = (
            u[inside] - left[inside],
            v[inside] - top[inside],
            left[inside],
            top[inside],
            light[inside],
        )
        cells = (y1 - y0) * (x1 - x0)
        total, weight = np.zeros(cells), np.zeros(cells)
        for dx, across in ((0, 1.0 - u), (1, u)):
            for dy, down in ((0, 1.0 - v), (1, v)):
                at, share = (top - y0 + dy) * (x1 - x0) + left - x0 + dx, across * down
                total += np.bincount(at, share * light, cells)
                weight += np.bincount(at, share, cells)
        hidden = np.minimum(weight / _FULL, 1.0)
        grey = hidden * total / np.maximum(weight, 1e-9)
        drawn = np.stack([grey, grey, 0.95 * grey, hidden], axis=-1).reshape(y1 - y0, x1 - x0, 4)
        return (y0, x0), drawn.astype(np.float32)

    def _behind(self, scene: float) -> Array:
        """Tissue that goes to and fro, and is pulled out of shape a little as it does."""
        if not self.scene.breath_px:
            return self.background.copy()
        a, b, c, d = self._wind
        out = self.scene.breath_px * np.sin(1.7 * scene + a)
        aside = 0.5 * self.scene.breath_px * np.sin(2.9 * scene + b)
        pull = 0.012 * np.sin(1.7 * scene + c)
        shear = 0.008 * np.sin(2.3 * scene + d)
        height, width = self.background.shape[:2]
        warp = np.array([[1.0 + pull, shear, out - pull * width / 2], [shear, 1.0 - pull, aside + pull * height / 2]])
        return np.asarray(cv2.warpAffine(self.background, warp, (width, height), borderMode=cv2.BORDER_REFLECT))

    def _smoked(self, picture: Array, scene: float) -> Array:
        height, width = picture.shape[:2]
        drift = np.array([31.0 * scene + 9.0 * np.sin(scene), 17.0 * scene])
        y, x = np.mgrid[0 : height : 1j * (height // _SMOOTH), 0 : width : 1j * (width // _SMOOTH)]
        wave = (
            0.5
            + 0.25 * np.sin((x + drift[0]) / 57.0 + np.sin((y - drift[1]) / 41.0))
            + 0.25 * np.sin((y + drift[1]) / 73.0 + 1.3 * np.sin((x - drift[0]) / 90.0))
        )
        thick = self.scene.smoke * wave * (0.6 + 0.4 * np.sin(0.4 * scene + self._wind[0]))
        thick = cv2.resize(thick.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray(cv2.blendLinear(picture, np.full_like(picture, 205), 1.0 - thick, thick))


class MarkedWorld(BareWorld):
    """The same with a marker at the end of the tip, on a tube without texture."""

    def __init__(self, scene: Scene, seed: int, background: Array | None = None) -> None:
        super().__init__(scene, seed, background)
        self.tip_mm = TIP_MM

    def _draw(self, scene: float) -> Array:
        picture = World._draw(self, scene)
        return self._smoked(picture, scene) if self.scene.smoke else picture


def _soft(picture: Array) -> Array:
    return np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.7))


def _sixtieth(x: Array) -> Array:
    """x^60."""
    fourth = (x * x) ** 2
    eighth = fourth * fourth
    sixteenth = eighth * eighth
    return np.asarray(fourth * eighth * sixteenth * sixteenth * sixteenth)


def _unit(field: Array) -> Array:
    return (field - field.mean()) / field.std()
