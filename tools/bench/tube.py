"""Recordings of an instrument without paint: a textured tube that bends over tissue, which may move itself.

The geometry, the motor and the files are those of `endoscopy`; the tube's surface is drawn sample by sample, lit from
the camera, with a glint that stays where the light is while the surface goes on beneath it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np

from tools.bench.endoscopy import BENDING_MM, EXPOSURE_S, TIP_MM, TUBE_MM, Condition, World

Array = np.ndarray

SHAFT_MM = 2.0  # of the straight shaft that the camera sees
PATCH_MM = 1.6  # before the end of the tip: the middle of what is followed
RULER_MM = 0.4  # standard deviation, by which the rig has that place elsewhere along the tip
_FINE = 32.0  # samples of the surface per mm
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
        return Condition(self.name, codec=self.codec, quality=23.0 if self.codec == "h264" else 95.0)


SCENES = (
    Scene("bare"),
    Scene("bare, smooth steel", texture=0.05),
    Scene("bare, tissue breathes", breath_px=6.0),
    Scene("bare, glints", glint=170.0),
    Scene("bare, smoke", smoke=0.35),
    Scene("bare, H.264", codec="h264"),
    Scene("bare, all of it", texture=0.1, breath_px=6.0, glint=110.0, smoke=0.25, codec="h264"),
)
STILL = (
    Scene("torn tendon", still=True),
    Scene("torn tendon, tissue breathes", breath_px=6.0, still=True),
    Scene("torn tendon, breathes, glints", breath_px=10.0, glint=170.0, still=True),
    Scene("torn tendon, smoke, H.264", breath_px=3.0, smoke=0.3, codec="h264", still=True),
)
STILL_S = 40.0  # of the motion, some 15 reversals: every frame of a torn tendon's tip is like the one before


class BareWorld(World):
    """An instrument that nobody marked."""

    def __init__(self, scene: Scene, seed: int, background: Array | None = None) -> None:
        self.scene = scene
        super().__init__(scene.condition, seed, background)
        if scene.still:
            begun = self.t - self.t[0] < STILL_S
            self.t, self.q = self.t[begun], self.q[begun]
            self.c = np.full_like(self.t, float(self.c[0]))
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

    def _draw(self, scene: float) -> Array:
        behind = self._behind(scene)
        drawn = self._resting if self.scene.still else self._exposed(scene)
        hidden = drawn[..., 3:]
        picture = behind * (1.0 - hidden) + drawn[..., :3]
        if self.scene.smoke:
            picture = self._smoked(picture, scene)
        smooth = cv2.GaussianBlur(picture, (0, 0), 0.7)
        return np.clip(np.rint(smooth), 0, 255).astype(np.uint8)

    @cached_property
    def _resting(self) -> Array:
        return self._exposed(float(self.t[0]))

    def _exposed(self, scene: float) -> Array:
        """Light of the tube (height, width, 3), and how much of each pixel it hides, over an exposure."""
        shape = self.condition.height, self.condition.width
        return sum((self._tube(scene + share * EXPOSURE_S, shape) for share in _GAUSS), np.zeros(())) / len(_GAUSS)

    def _tube(self, scene: float, shape: tuple[int, int]) -> Array:
        """The same at one time, (height, width, 4)."""
        along, bend, angle, brightness = self._surface
        middle, ahead, aside = self._spine(float(np.interp(scene, self.t, self.c)), along)
        up = self._turned(np.array([[0.0, 1.0, 0.0]]))[0]
        middle, ahead, aside = self._in_camera(middle), self._turned(ahead), self._turned(aside)
        near = (
            int(np.rint(self._facing / (2.0 * np.pi) * len(angle)))
            + np.arange(len(angle) // 2 + 6)
            - len(angle) // 4
            - 3
        )
        angle, brightness = (
            angle[near % len(angle)],
            brightness[:, near % len(angle)],
        )  # the half that may face the camera
        out = np.cos(angle)[None, :, None] * aside[:, None] + np.sin(angle)[None, :, None] * up
        out *= np.cos(bend)[:, None, None]
        point = middle[:, None] + TUBE_MM * out
        normal = out + (np.sin(bend)[:, None] * ahead)[:, None]
        facing = -np.sum(normal * point, axis=2) / np.sqrt(np.sum(point * point, axis=2))
        brightest = np.maximum(facing.max(axis=1, keepdims=True), 1e-3)
        glint = (
            self.scene.glint * np.clip(facing / brightest, 0.0, 1.0) ** 60
        )  # along the line that faces the camera most
        seen = facing > 0.02
        point, facing, brightness, glint = point[seen], facing[seen], brightness[seen], glint[seen]
        light = 150.0 * brightness * (0.25 + 0.75 * facing) + glint
        u, v = self._image(point).T
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
        drawn = np.zeros((height, width, 4))
        drawn[y0:y1, x0:x1] = np.stack([grey, grey, 0.95 * grey, hidden], axis=-1).reshape(y1 - y0, x1 - x0, 4)
        return drawn

    def _behind(self, scene: float) -> Array:
        """Tissue that goes to and fro, and is pulled out of shape a little as it does."""
        if not self.scene.breath_px:
            return self.background.astype(float)
        a, b, c, d = self._wind
        out = self.scene.breath_px * np.sin(1.7 * scene + a)
        aside = 0.5 * self.scene.breath_px * np.sin(2.9 * scene + b)
        pull = 0.012 * np.sin(1.7 * scene + c)
        shear = 0.008 * np.sin(2.3 * scene + d)
        height, width = self.background.shape[:2]
        warp = np.array([[1.0 + pull, shear, out - pull * width / 2], [shear, 1.0 - pull, aside + pull * height / 2]])
        moved = cv2.warpAffine(self.background, warp, (width, height), borderMode=cv2.BORDER_REFLECT)
        return moved.astype(float)

    def _smoked(self, picture: Array, scene: float) -> Array:
        height, width = picture.shape[:2]
        drift = np.array([31.0 * scene + 9.0 * np.sin(scene), 17.0 * scene])
        y, x = np.mgrid[0:height, 0:width]
        wave = (
            0.5
            + 0.25 * np.sin((x + drift[0]) / 57.0 + np.sin((y - drift[1]) / 41.0))
            + 0.25 * np.sin((y + drift[1]) / 73.0 + 1.3 * np.sin((x - drift[0]) / 90.0))
        )
        thick = self.scene.smoke * wave * (0.6 + 0.4 * np.sin(0.4 * scene + self._wind[0]))
        return picture * (1.0 - thick[..., None]) + 205.0 * thick[..., None]


def _unit(field: Array) -> Array:
    return (field - field.mean()) / field.std()
