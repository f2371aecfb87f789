"""Recordings of an endoscope that sees the world from its own tip: a textured vessel, of which a part breathes.

The motor, the instrument and the files are those of `endoscopy`; the camera sits at the end of the tip and looks ahead,
rolled about its axis. The world is the inside of a cylinder across the bending plane, seen ray by ray, so that the
tip's own way shows as well as its turning.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np

from tools.bench import endoscopy
from tools.bench.endoscopy import EXPOSURE_S, Condition, World, rig_camera, rig_head

Array = np.ndarray

WIDTH, HEIGHT = 256, 208
ROLL_DEG = 25.0
_FINE = 4.0  # samples of the wall per mm: about one a pixel
_HALF_MM = 70.0  # of the wall, along the cylinder
_GAUSS = 0.2887 * np.array([-1.0, 1.0])  # of an exposure: two times with its mean and its spread


@dataclass(frozen=True)
class Inside:
    """`radius_mm` of the vessel; `breath_mm`: how far the part of its wall that breathes goes to and fro; `share` of
    the view that does; `still`: the tendon is torn."""

    name: str
    radius_mm: float = 70.0
    breath_mm: float = 0.0
    share: float = 0.35
    still: bool = False


class InsideWorld(World):
    def __init__(
        self, inside: Inside, seed: int, seconds: tuple[float, float], background: Array | None = None
    ) -> None:
        """seconds: from when to when of the motion."""
        self.inside = inside
        super().__init__(Condition(inside.name, width=WIDTH, height=HEIGHT), seed, np.zeros((2, 2, 3), np.uint8))
        within = (self.t >= seconds[0]) & (self.t < seconds[1])
        self.t, self.q, self.c = self.t[within], self.q[within], self.c[within]
        if inside.still:
            self.c = np.full_like(self.c, float(self.c[0]))
        self._picture = background

    @cached_property
    def _wall(self) -> Array:
        """(along the cylinder, around it, 3): pink with mottling and vessels, or a picture over and over."""
        height, width = int(2 * _HALF_MM * _FINE), int(2 * np.pi * self.inside.radius_mm * _FINE)
        if self._picture is not None:
            tile = np.vstack([np.hstack([self._picture, self._picture[:, ::-1]])] * 2)
            rows, columns = np.arange(height) % tile.shape[0], np.arange(width) % tile.shape[1]
            return np.asarray(tile[rows[:, None], columns].astype(np.float32))
        light = np.ones((height, width), np.float32)
        for size_mm, weight in ((20.0, 0.15), (3.0, 0.14), (0.8, 0.1)):
            coarse = self.rng.standard_normal((int(height / _FINE / size_mm) + 4, int(width / _FINE / size_mm) + 4))
            light += weight * cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray(np.array([95.0, 105.0, 185.0], np.float32) * np.clip(light, 0.1, 1.5)[..., None])

    @cached_property
    def _rays(self) -> Array:
        """(height, width, 3) of each pixel in the tip's frame: x aside in the bending plane, y out of it, z ahead."""
        v, u = np.mgrid[0:HEIGHT, 0:WIDTH].astype(float)
        x, y = (u - WIDTH / 2.0) / self.focal, (v - HEIGHT / 2.0) / self.focal
        roll = np.radians(ROLL_DEG)
        rays = [np.cos(roll) * x - np.sin(roll) * y, np.sin(roll) * x + np.cos(roll) * y, np.ones_like(x)]
        return np.stack(rays, axis=-1)

    def _draw(self, scene: float) -> Array:
        times = scene + EXPOSURE_S * _GAUSS
        picture = np.mean([self._view(t) for t in times.tolist()], axis=0)
        return np.clip(np.rint(cv2.GaussianBlur(picture, (0, 0), 0.5)), 0, 255).astype(np.uint8)

    def _view(self, t: float) -> Array:
        c = float(np.interp(t, self.t, self.c))
        at = self._along(np.array([c]), np.ones(1))[0, 0]
        sin, cos = np.sin(np.radians(c)), np.cos(np.radians(c))
        x, y, z = np.moveaxis(self._rays, -1, 0)
        across, ahead = cos * x + sin * z, cos * z - sin * x
        # |(at.x, at.z) + s (across, ahead)| = radius
        a, b = across**2 + ahead**2, at[0] * across + at[2] * ahead
        s = (-b + np.sqrt(b * b + a * (self.inside.radius_mm**2 - at[0] ** 2 - at[2] ** 2))) / a
        around = self.inside.radius_mm * np.arctan2(at[0] + s * across, at[2] + s * ahead)
        along = s * y
        if self.inside.breath_mm:
            edge = np.quantile(along[::8, ::8], 1.0 - self.inside.share)
            soft = 1.0 / (1.0 + np.exp(-(along - edge) / 2.0))
            around = around + self.inside.breath_mm * soft * np.sin(1.7 * t)
            along = along + 0.5 * self.inside.breath_mm * soft * np.sin(1.7 * t + 0.9)
        wall = self._wall
        columns = ((np.pi * self.inside.radius_mm + around) * _FINE).astype(np.float32)
        rows = ((_HALF_MM + along) * _FINE).astype(np.float32)
        shown = cv2.remap(wall, columns, rows, cv2.INTER_LINEAR, None, cv2.BORDER_REFLECT)
        # Its light comes with it: less from afar, less at the picture's edge.
        far, vignette = s / self.inside.radius_mm, 1.0 / np.linalg.norm(self._rays, axis=-1)
        return np.asarray(shown * (vignette**2 / (0.4 + 0.6 * far**2))[..., None])


def make(
    folder: Path, inside: Inside, seed: int, seconds: tuple[float, float] = (0.0, 90.0), background: Array | None = None
) -> InsideWorld:
    """Writes the recording, with truth.json."""
    world = InsideWorld(inside, seed, seconds, background)
    endoscopy.write(folder, world)
    rig = f'{rig_head()}[camera]\nmount = "tip"\n{rig_camera(world.focal, WIDTH, HEIGHT)}'
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    return world
