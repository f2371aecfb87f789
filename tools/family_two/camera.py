"""What the camera sees: a section of constant curvature with a stiff tip, a pose, a pinhole and a lens."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
NODES, WEIGHTS = np.polynomial.legendre.leggauss(8)
NODES, WEIGHTS = (NODES + 1) / 2, WEIGHTS / 2


@dataclass(frozen=True)
class View:
    bending_mm: float
    tip_mm: float
    width_px: int
    height_px: int
    focal_px: float
    centre_px: tuple[float, float]
    distortion: tuple[float, ...]  # k1 k2 p1 p2 k3
    rotation_deg: tuple[float, ...]
    translation_mm: tuple[float, ...]


@dataclass
class Scene:
    """What besides the bend moves what the camera sees, by frame. Small turns are about the base's axes."""

    translation: FloatArray  # of the instrument along its axis, mm
    rotation: FloatArray  # about it, deg
    turn: FloatArray  # (n, 3) of the base against the camera, deg
    shift: FloatArray  # (n, 3) of it, mm
    uneven: FloatArray  # slope of the curvature along the section
    loose: FloatArray  # of the marker across the plane of bending, mm
    lens: FloatArray  # (n, 2), k1 and k2 added

    @classmethod
    def still(cls, n: int) -> "Scene":
        z = np.zeros(n)
        return cls(z, z, np.zeros((n, 3)), np.zeros((n, 3)), z, z, np.zeros((n, 2)))


def matrix(angles: FloatArray) -> FloatArray:
    """Rz Ry Rx of (..., 3) degrees."""
    (cx, cy, cz), (sx, sy, sz) = np.cos(np.radians(angles)).T, np.sin(np.radians(angles)).T
    rows = [
        [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
        [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
        [-sy, cy * sx, cy * cx],
    ]
    return np.moveaxis(np.array(rows), [0, 1], [-2, -1])


def tip(view: View, c_deg: FloatArray, scene: Scene) -> FloatArray:
    """The marker in the base, (n, 3)."""
    c = np.radians(c_deg)[:, None]
    e = scene.uneven[:, None]
    along = c * ((1 - e) * NODES + e * NODES**2)  # slope at each node; the end's is c whatever e is
    x = view.bending_mm * (np.sin(along) @ WEIGHTS) + view.tip_mm * np.sin(c[:, 0])
    z = view.bending_mm * (np.cos(along) @ WEIGHTS) + view.tip_mm * np.cos(c[:, 0]) + scene.translation
    roll = np.radians(scene.rotation)
    y = scene.loose
    return np.stack([np.cos(roll) * x - np.sin(roll) * y, np.sin(roll) * x + np.cos(roll) * y, z], axis=1)


def project(view: View, c_deg: FloatArray, scene: Scene) -> FloatArray:
    """Pixels, (n, 2)."""
    base = tip(view, c_deg, scene)
    if np.any(scene.turn):
        base = np.einsum("nij,nj->ni", matrix(scene.turn), base)
    pose = matrix(np.array(view.rotation_deg))
    seen = (base + scene.shift) @ pose.T + np.array(view.translation_mm)
    x, y = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
    own1, own2, p1, p2, k3 = view.distortion
    k1, k2 = own1 + scene.lens[:, 0], own2 + scene.lens[:, 1]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    xd = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
    yd = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    u = view.focal_px * xd + view.centre_px[0]
    v = view.focal_px * yd + view.centre_px[1]
    return np.stack([u, v], axis=1)


def draw(rng: np.random.Generator, arm: bool, reach_deg: float) -> View:
    """A camera that sees all of the motion: on a stand beside a stiff arm, or along a bending section."""
    width, height = [(720, 576), (640, 480), (1280, 720)][int(rng.integers(3))]
    focal = float(rng.uniform(0.75, 1.3)) * width
    if arm:
        bending, stiff = float(rng.uniform(2.0, 4.0)), float(rng.uniform(15.0, 60.0))
        over = float(rng.choice([-1, 1]) * rng.uniform(25, 65))
        angles = [over, float(rng.uniform(-25, 25)), float(rng.uniform(-40, 40))]
    else:
        bending, stiff = float(rng.uniform(12.0, 30.0)), float(rng.uniform(3.0, 10.0))
        angles = [float(rng.uniform(-15, 15)), float(rng.uniform(-15, 15)), float(rng.uniform(-180, 180))]
    rotation = tuple(round(a, 2) for a in angles)
    lens = (0.0,) * 5
    if rng.random() < 0.4:
        lens = (float(rng.uniform(-0.25, 0.05)), float(rng.uniform(0.0, 0.08)), 0.0, 0.0, 0.0)
    centre = (width / 2 + float(rng.uniform(-10, 10)), height / 2 + float(rng.uniform(-10, 10)))
    view = View(
        round(bending, 2), round(stiff, 2), width, height, round(focal, 1), (round(centre[0], 1), round(centre[1], 1)),
        tuple(round(k, 4) for k in lens), rotation, (0.0, 0.0, 0.0),
    )  # fmt: skip
    c = np.linspace(-reach_deg, reach_deg, 61)
    points = tip(view, c, Scene.still(61)) @ matrix(np.array(rotation)).T
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    extent = float(np.linalg.norm(np.ptp(points[:, :2], axis=0)))
    depth = view.focal_px * extent / (float(rng.uniform(0.5, 0.75)) * height)
    depth = max(depth, 1.6 * float(np.ptp(points[:, 2])), 0.8 * extent)
    place = np.array([0.0, 0.0, depth]) - middle
    return replace(view, translation_mm=tuple(round(float(x), 3) for x in place))
