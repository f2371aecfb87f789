"""A section of constant curvature seen by a pinhole camera, in formats of rig.toml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Camera:
    width: int = 720
    height: int = 576
    fx: float = 520.0
    fy: float = 520.0
    cx: float = 360.0
    cy: float = 288.0
    distortion: tuple[float, float, float, float, float] = (0.0, 0.0, 0.0, 0.0, 0.0)  # k1 k2 p1 p2 k3
    frame_rate: float = 25.0
    delay: float = 0.080
    bending: float = 18.0  # mm
    tip: float = 6.0  # mm
    rotation: tuple[float, float, float] = (4.0, -3.0, 2.0)  # deg, about x, y, z
    translation: tuple[float, float, float] = (-4.0, 5.0, 14.0)  # mm


def turn(x_deg: Array | float, y_deg: Array | float, z_deg: Array | float) -> Array:
    """Rz Ry Rx, one matrix or one for each row."""
    x, y, z = np.broadcast_arrays(*(np.radians(np.asarray(a, float)) for a in (x_deg, y_deg, z_deg)))
    (sx, sy, sz), (cx, cy, cz) = (np.sin(a) for a in (x, y, z)), (np.cos(a) for a in (x, y, z))
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array([[np.broadcast_to(e, x.shape) for e in row] for row in rows]), (0, 1), (-2, -1))


def tip_place(c_deg: Array, camera: Camera, translation: Array | float = 0.0, rotation: Array | float = 0.0) -> Array:
    """The marker in the base frame, mm."""
    c = np.radians(np.asarray(c_deg, float))
    small = np.abs(c) < 1e-5
    safe = np.where(small, 1.0, c)
    x = camera.bending * np.where(small, c / 2, (1 - np.cos(safe)) / safe) + camera.tip * np.sin(c)
    z = camera.bending * np.where(small, 1 - c**2 / 6, np.sin(safe) / safe) + camera.tip * np.cos(c) + translation
    angle = np.radians(np.asarray(rotation, float))
    return np.stack([x * np.cos(angle), x * np.sin(angle), z + 0 * angle], axis=-1)


def project(place: Array, camera: Camera, tilt_deg: Array | None = None) -> Array:
    """px, one row a place. `tilt_deg` (rows of three) is added to the hand-eye's."""
    tilt = np.zeros(3) if tilt_deg is None else tilt_deg
    angles = np.asarray(camera.rotation) + tilt
    matrix = turn(angles[..., 0], angles[..., 1], angles[..., 2])
    seen = np.einsum("...ij,...j->...i", matrix, place) + np.asarray(camera.translation)
    x, y = seen[..., 0] / seen[..., 2], seen[..., 1] / seen[..., 2]
    k1, k2, p1, p2, k3 = camera.distortion
    r2 = x**2 + y**2
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
    v = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    return np.stack([camera.fx * u + camera.cx, camera.fy * v + camera.cy], axis=-1)


def in_view(camera: Camera, bends: Sequence[float], margin: float = 30.0, slowest: float = 1.0) -> bool:
    """Whether the marker stays inside the picture for these bends and moves at least `slowest` px/deg."""
    c = np.linspace(min(bends), max(bends), 181)
    place = tip_place(c, camera)
    depth = np.einsum("ij,nj->ni", turn(*camera.rotation), place)[:, 2] + camera.translation[2]
    if depth.min() < 8.0:
        return False
    uv = project(place, camera)
    inside = (
        (uv[:, 0] > margin)
        & (uv[:, 0] < camera.width - margin)
        & (uv[:, 1] > margin)
        & (uv[:, 1] < camera.height - margin)
    )
    pace = np.hypot(*np.diff(uv, axis=0).T) / np.diff(c)
    return bool(inside.all() and pace.min() > slowest)


def drawn_camera(rng: np.random.Generator, base: Camera, bends: Sequence[float]) -> Camera:
    """A hand-eye from which the whole motion is seen."""
    for _ in range(2000):
        camera = replace(
            base,
            rotation=tuple(rng.uniform([-8, -10, -12], [8, 10, 12]).tolist()),
            translation=tuple(rng.uniform([-7, -5, 12], [4, 6, 24]).tolist()),
        )
        if in_view(camera, bends):
            return camera
    raise RuntimeError("no camera sees this instrument")
