"""From bending angles to pixels: arcs in series, a hand-eye transform, a pinhole with OpenCV's k1 k2 p1 p2 k3."""

from dataclasses import dataclass, field

import numpy as np

ARCS = 6  # pieces of the bending section; equal angles are one arc of constant curvature


@dataclass(frozen=True)
class View:
    """The nominal set-up, as rig.toml states it."""

    bending_mm: float
    tip_mm: float
    width_px: int
    height_px: int
    focal_px: float
    centre_px: tuple[float, float]
    rotation_deg: tuple[float, float, float]
    translation_mm: tuple[float, float, float]
    distortion: tuple[float, float, float, float, float] = field(default=(0.0, 0.0, 0.0, 0.0, 0.0))


def turn(axis: int, deg: np.ndarray | float) -> np.ndarray:
    """Rotation matrices about one axis, (..., 3, 3)."""
    a = np.radians(np.asarray(deg, dtype=float))
    c, s, o, i = np.cos(a), np.sin(a), np.zeros_like(a), np.ones_like(a)
    rows = {
        0: [[i, o, o], [o, c, -s], [o, s, c]],
        1: [[c, o, s], [o, i, o], [-s, o, c]],
        2: [[c, -s, o], [s, c, o], [o, o, i]],
    }[axis]
    return np.stack([np.stack(r, axis=-1) for r in rows], axis=-2)


def tip(view: View, pieces: np.ndarray, translation: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Marker in the base frame, mm, (n, 3), from the arcs' angles in deg, (n, ARCS)."""
    arc = view.bending_mm / ARCS
    heading, x, z = np.zeros(len(pieces)), np.zeros(len(pieces)), np.zeros(len(pieces))
    for piece in np.radians(pieces).T:
        chord = arc * np.sinc(piece / 2 / np.pi)  # of an arc: length sin(a/2)/(a/2)
        x += chord * np.sin(heading + piece / 2)
        z += chord * np.cos(heading + piece / 2)
        heading = heading + piece
    x += view.tip_mm * np.sin(heading)
    z += view.tip_mm * np.cos(heading)
    r = np.radians(rotation)
    return np.stack([x * np.cos(r), x * np.sin(r), z + translation], axis=1)


def project(
    view: View,
    base: np.ndarray,
    tilt: np.ndarray | None = None,
    shift: np.ndarray | None = None,
    lens: np.ndarray | None = None,
) -> np.ndarray:
    """Pixels (n, 2). tilt (n, 3) deg and shift (n, 3) mm add to the hand-eye, lens (n, 5) to the distortion."""
    rx, ry, rz = view.rotation_deg
    if tilt is None:
        seen = base @ (turn(2, rz) @ turn(1, ry) @ turn(0, rx)).T
    else:
        matrices = turn(2, rz + tilt[:, 2]) @ turn(1, ry + tilt[:, 1]) @ turn(0, rx + tilt[:, 0])
        seen = np.einsum("nij,nj->ni", matrices, base)
    seen = seen + np.asarray(view.translation_mm) + (0.0 if shift is None else shift)
    a, b = seen[:, 0] / seen[:, 2], seen[:, 1] / seen[:, 2]
    k1, k2, p1, p2, k3 = np.asarray(view.distortion) if lens is None else (np.asarray(view.distortion) + lens).T
    r2 = a * a + b * b
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u = a * radial + 2 * p1 * a * b + p2 * (r2 + 2 * a * a)
    v = b * radial + p1 * (r2 + 2 * b * b) + 2 * p2 * a * b
    return np.stack([view.focal_px * u + view.centre_px[0], view.focal_px * v + view.centre_px[1]], axis=1)


def even(c: np.ndarray) -> np.ndarray:
    """The arcs' angles of constant curvature."""
    return np.repeat(c[:, None] / ARCS, ARCS, axis=1)


def draw(rng: np.random.Generator, lever: bool, largest_deg: float) -> View:
    """A set-up whose marker stays in the image for |c| up to `largest_deg` and the other joints' small moves."""
    while True:
        if lever:  # a stiff arm on a short flexure, seen by a camera on a stand
            bending, length, away = (
                float(rng.uniform(1.5, 4.0)),
                float(rng.uniform(30.0, 60.0)),
                float(rng.uniform(90.0, 200.0)),
            )
            size, focal = (1280, 720), float(rng.uniform(800.0, 1300.0))
            angles = (float(rng.uniform(-100, -80)), float(rng.uniform(-8, 8)), float(rng.uniform(-15, 15)))
            offset = (float(rng.uniform(-5, 5)), length * 0.7 + float(rng.uniform(-5, 5)), away)
        else:
            bending, length, away = (
                float(rng.uniform(12.0, 35.0)),
                float(rng.uniform(4.0, 12.0)),
                float(rng.uniform(8.0, 30.0)),
            )
            size, focal = ((720, 576), (640, 480), (1280, 720))[rng.integers(3)], float(rng.uniform(380.0, 700.0))
            angles = tuple(float(x) for x in rng.uniform((-10, -10, -180), (10, 10, 180)))  # type: ignore[assignment]
            offset = (float(rng.uniform(-5, 5)), float(rng.uniform(-6, 6)), away)
        centre = (size[0] / 2 + float(rng.uniform(-12, 12)), size[1] / 2 + float(rng.uniform(-12, 12)))
        digits = tuple(round(a, 3) for a in angles), tuple(round(o, 3) for o in offset)
        view = View(
            round(bending, 2),
            round(length, 2),
            *size,
            round(focal, 2),
            (round(centre[0], 2), round(centre[1], 2)),
            *digits,
        )  # type: ignore[arg-type]
        c = np.linspace(-1.15 * largest_deg, 1.15 * largest_deg, 41)
        zeros = np.zeros_like(c)
        inside = [
            project(view, tip(view, even(c), zeros + move, zeros + angle))
            for move, angle in ((0.0, 0.0), (6.0, 12.0), (-6.0, -12.0))
        ]
        all_of = np.concatenate(inside)
        if (
            np.all(all_of > 12)
            and np.all(all_of < np.asarray(size) - 12)
            and np.ptp(inside[0], axis=0).max() > 0.15 * size[0]
        ):
            return view
