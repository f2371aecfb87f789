"""What the camera sees: the first family's pinhole and arcs, set-ups of this family's own, room for all that moves."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tools.family.view import ARCS, View, project, tip

FloatArray = NDArray[np.float64]
ROOM = 30  # px from the edge that set-ups leave


@dataclass
class Scene:
    """Where all is at each exposure beside the bending angle."""

    along: FloatArray  # mm
    rotation: FloatArray  # deg
    tilt: FloatArray  # (n, 3) deg, beside the known hand-eye
    shift: FloatArray  # (n, 3) mm
    lens: FloatArray  # (n, 5), beside the known k1 k2 p1 p2 k3
    uneven: FloatArray  # relative slope of the curvature along the section

    @staticmethod
    def still(count: int) -> "Scene":
        zero = np.zeros(count)
        return Scene(zero, zero, np.zeros((count, 3)), np.zeros((count, 3)), np.zeros((count, 5)), zero)


def picture(view: View, c: FloatArray, scene: Scene) -> FloatArray:
    """Pixels (n, 2) of the marker."""
    along = (np.arange(ARCS) + 0.5) / ARCS - 0.5
    pieces = c[:, None] / ARCS * (1 + scene.uneven[:, None] * along * 2)
    base = tip(view, pieces, scene.along, scene.rotation)
    seen: FloatArray = project(view, base, scene.tilt, scene.shift, scene.lens)
    return seen


def reference(view: View, c: FloatArray, pose: FloatArray, along: FloatArray, rotation: FloatArray) -> FloatArray:
    """The same without anything but a hand-eye that is off by `pose` (three deg, three mm): for the refit."""
    a, back = np.radians(c), np.radians(rotation)
    chord = view.bending_mm * np.sinc(a / 2 / np.pi)
    out = chord * np.sin(a / 2) + view.tip_mm * np.sin(a)
    up = chord * np.cos(a / 2) + view.tip_mm * np.cos(a)
    base = np.stack([out * np.cos(back), out * np.sin(back), up + along], axis=1)
    moved = np.broadcast_to(pose[:3], (1, 3))
    still = View(
        view.bending_mm, view.tip_mm, view.width_px, view.height_px, view.focal_px, view.centre_px,
        tuple(float(r + m) for r, m in zip(view.rotation_deg, moved[0], strict=True)),  # type: ignore[arg-type]
        tuple(float(s + m) for s, m in zip(view.translation_mm, pose[3:], strict=True)),  # type: ignore[arg-type]
        view.distortion,
    )  # fmt: skip
    seen: FloatArray = project(still, base)
    return seen


def draw(rng: np.random.Generator, arm: bool, largest_deg: float) -> View:
    """A set-up that keeps the marker in the picture to 1.12 of the reach, other joints and small leans included."""
    a = float(np.radians(largest_deg))
    while True:
        if arm:  # from beside, on a stand
            bending, length = float(rng.uniform(1.0, 4.0)), float(rng.uniform(20, 50))
            size, focal = ((1280, 720), (1920, 1080), (1280, 960))[int(rng.integers(3))], float(rng.uniform(900, 1700))
            angles = (float(rng.uniform(-102, -78)), float(rng.uniform(-10, 10)), float(rng.uniform(-20, 20)))
            height = bending + length * (1 + float(np.cos(a))) / 2  # half way between the middle and the ends
            middle, near = float(rng.uniform(-0.15, 0.15)) * length - height, 60.0
        else:  # an endoscope's view
            bending, length = float(rng.uniform(14, 32)), float(rng.uniform(4, 12))
            size, focal = ((720, 576), (640, 480), (1280, 720))[int(rng.integers(3))], float(rng.uniform(350, 750))
            angles = (float(rng.uniform(-12, 12)), float(rng.uniform(-12, 12)), float(rng.uniform(-180, 180)))
            middle, near = float(rng.uniform(-6, 6)), 5.0
        swept = 2 * (bending * (1 - np.cos(a)) / a + length * np.sin(min(a, np.pi / 2)))
        away = focal * swept / (float(rng.uniform(0.3, 0.8)) * size[1]) - (0.0 if arm else bending * np.sin(a) / a)
        if away < near:
            continue
        place = (float(rng.uniform(-6, 6)), middle, float(away))
        centre = (size[0] / 2 + float(rng.uniform(-15, 15)), size[1] / 2 + float(rng.uniform(-15, 15)))
        view = View(
            round(bending, 2), round(length, 2), *size, round(focal, 2), (round(centre[0], 2), round(centre[1], 2)),
            (round(angles[0], 3), round(angles[1], 3), round(angles[2], 3)),
            (round(place[0], 3), round(place[1], 3), round(place[2], 3)),
        )  # fmt: skip
        c = np.linspace(-1.12, 1.12, 31) * largest_deg
        worst = Scene.still(c.size)
        seen = []
        for move, turned, lean in ((0, 0, 0), (6, 11, 3), (-6, -11, -3), (6, -11, 3), (-6, 11, -3)):
            worst.along, worst.rotation = np.full(c.size, 1.0 * move), np.full(c.size, 1.0 * turned)
            worst.tilt = np.full((c.size, 3), 1.0 * lean)
            seen.append(picture(view, c, worst))
        every = np.concatenate(seen)
        spread = np.ptp(seen[0], axis=0).max()
        if np.all(every > ROOM) and np.all(every < np.array(size) - ROOM) and spread > 0.15 * size[0]:
            return view
