"""From the bending angle to the image and back: g, h, their Jacobian (eq. 7; host/native/projection.h) and the pose
(eq. 8)."""

from __future__ import annotations

import cv2
import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from tautline import _native
from tautline.errors import TautError
from tautline.rig import PLACES, Camera, HandEye, Kinematics, Rig

Array = npt.NDArray[np.float64]
STRIDE_DEG = 20.0  # tolerance: the longest step in a search for a bending angle: an image's slope holds no further
_DAMPING, _TIMES, _MOST_DAMPING = 1e-3, 10.0, 1e3  # tolerance: at first, from step to step, where no step helps
_CLOSE_DEG = 1e-10  # tolerance: deg, of a step after which a sample is done
_BESIDE, _GRID = 0.25, 121  # tolerance: of the coarse range, on either side of it; angles where a search may begin
# px: standard deviation, per coordinate, of what this package's tracker is off by in every frame alike near one
# place: the rms of what docs/marker.md has, 0.02 (a flat disc) to 0.17 (a ball lit from one side, in MJPEG).
TRACKED_PX = 0.1  # prior: by docs/marker.md
# px, likewise, but another at each place: by how the marker lies on the pixels, its shade and what is beside it.
PLACED_PX = 0.05  # prior: by docs/marker.md, 0.015 to 0.05


def tip_bend(kinematics: Kinematics, c_deg: npt.ArrayLike) -> Array:
    """g of the paper: the marker's position (n, 3), mm, in the frame of the bending section, at bending angles c (n,),
    deg: a section of constant curvature, then a straight tip. c > 0 bends towards +x."""
    c = np.radians(np.atleast_1d(np.asarray(c_deg, dtype=float)))
    length, tip = kinematics.bending_length_mm, kinematics.tip_length_mm
    sin, cos = np.sin(c), np.cos(c)
    sinc = np.sinc(c / np.pi)  # equation: sin(c) / c
    versc = 0.5 * c * np.sinc(0.5 * c / np.pi) ** 2  # equation: (1 - cos(c)) / c
    return np.stack([length * versc + tip * sin, np.zeros_like(c), length * sinc + tip * cos], axis=1)


def rotation(angles_deg: tuple[float, float, float]) -> Array:
    """The rotation matrix (3, 3) Rz(rz) Ry(ry) Rx(rx) of angles [rx, ry, rz], deg."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(angles_deg)), np.cos(np.radians(angles_deg))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    product: Array = about_z @ about_y @ about_x
    return product


def about_base_z(angle_deg: npt.ArrayLike, vector: Array) -> Array:
    """(n, 3) Vectors turned by `angle_deg` about z, Rz(angle) v; angle (n,) or scalar, deg."""
    a = np.radians(np.asarray(angle_deg, dtype=float))
    sin, cos = np.sin(a), np.cos(a)
    x, y, z = vector.T
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)


def to_camera(hand_eye: HandEye, base: Array) -> Array:
    """Base points (n, 3), mm, in the camera's frame: X_cam = R X_base + t."""
    product: Array = base @ rotation(hand_eye.rotation_deg).T + np.asarray(hand_eye.translation_mm)
    return product


def to_image(camera: Camera, point: Array) -> Array:
    """h of the paper: the image positions (n, 2), px, of points (n, 3), mm, in the camera's frame, by a pinhole with
    OpenCV's distortion k1 k2 p1 p2 k3; NaN where a point is not in front of the camera."""
    seen = point[:, 2:] > 1e-6
    ahead = np.where(seen, point, [0.0, 0.0, 1.0])
    image, _ = cv2.projectPoints(ahead, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion))
    return np.where(seen, image[:, 0], np.nan)


def projection_rig(rig: Rig) -> Array:
    """(m,) The rig as C has it: the fields of struct projection_rig (host/native/projection.h) in order, mm, px and
    deg. TautError where the rig has no camera that a marker can be projected to."""
    if rig.kinematics is None or rig.camera is None or rig.hand_eye is None:
        raise TautError("the rig needs [kinematics], [camera] and [hand_eye] to project a marker: add them to rig.toml")
    camera, place = rig.camera, rig.place
    return np.array(
        [
            rig.kinematics.bending_length_mm,
            rig.kinematics.tip_length_mm,
            *rotation(rig.hand_eye.rotation_deg).ravel(),
            *rig.hand_eye.translation_mm,
            *(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px),
            *camera.distortion,
            *((0.0,) * (2 + 3 * PLACES) if place is None else (place.from_deg, place.step_deg, *np.ravel(place.mm))),
        ]
    )


def project_with_slope(
    rig: Rig, c_deg: npt.ArrayLike, translation_mm: npt.ArrayLike = 0.0, rotation_deg: npt.ArrayLike = 0.0
) -> tuple[Array, Array]:
    """The marker's image position h(g(c)) (n, 2), px, and its derivative d(h g)/dc (n, 2), px per deg (eqs. 6 and 7),
    at bending angles c_deg (n,). The instrument's two other axes are (n,) or scalar: P_base = Rz(rotation) (P_bend(c) +
    [0, 0, translation]). NaN where the marker is not in front of the camera."""
    image, slope, _ = _native.see({}, projection_rig(rig), *_poses(c_deg, translation_mm, rotation_deg), slopes=True)
    return image, slope


def project(
    rig: Rig, c_deg: npt.ArrayLike, translation_mm: npt.ArrayLike = 0.0, rotation_deg: npt.ArrayLike = 0.0
) -> Array:
    """The marker's image position (n, 2), px, at bending angles c_deg (n,) (eq. 6); arguments and NaN as in
    `project_with_slope`."""
    image: Array = _native.see({}, projection_rig(rig), *_poses(c_deg, translation_mm, rotation_deg))
    return image


def across(vectors: Array, way: Array) -> Array:
    """(n, ...) The component of image vectors (n, 2, ...) along the normal of the direction `way` (n, 2), which may
    have any length: way turned by 90 deg from u towards v."""
    unit = way / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
    return np.asarray(np.einsum("nk,nk...->n...", np.column_stack([-unit[:, 1], unit[:, 0]]), vectors))


def px_per_deg(
    rig: Rig, c_deg: npt.ArrayLike, translation_mm: npt.ArrayLike = 0.0, rotation_deg: npt.ArrayLike = 0.0
) -> Array:
    """(n,) How far, px, the marker moves in the image per deg of bending, at bending angles c_deg (n,); other arguments
    as in `project_with_slope`."""
    return np.asarray(np.linalg.norm(project_with_slope(rig, c_deg, translation_mm, rotation_deg)[1], axis=1))


def tracked_deg(
    tracked_px: float,
    rig: Rig,
    c_deg: npt.ArrayLike,
    translation_mm: npt.ArrayLike = 0.0,
    rotation_deg: npt.ArrayLike = 0.0,
) -> Array:
    """(n,) One standard deviation, deg, of f_remain by a tracker whose error d = (du, dv) is constant, of rms
    tracked_px per coordinate. Frames show f + s.d / |s|^2, where s is the marker's motion in px per deg, so that no
    number of frames tells d from f. B and the delay, which compare passes over one place, are free of it."""
    if not tracked_px:
        return np.zeros(np.shape(c_deg))
    return tracked_px / px_per_deg(rig, c_deg, translation_mm, rotation_deg)


def _poses(*columns: npt.ArrayLike) -> list[Array]:
    """The columns, each (n,) or scalar, broadcast to one length (n,) and contiguous, as C takes them."""
    flat = np.broadcast_arrays(*(np.atleast_1d(np.asarray(column, dtype=float)) for column in columns))
    return [np.ascontiguousarray(column) for column in flat]


def pose(
    rig: Rig,
    image_px: npt.ArrayLike,
    translation_mm: npt.ArrayLike = 0.0,
    rotation_deg: npt.ArrayLike = 0.0,
    start_deg: npt.ArrayLike | None = None,
    iterations: int = 60,
) -> tuple[Array, Array]:
    """The bending angle (n,), deg, whose projection is nearest to the image positions image_px (n, 2), and the distance
    that is left (n,), px; both NaN where a position is NaN. Solves eq. 8 by Levenberg-Marquardt for all samples at
    once, in at most `iterations` steps, from start_deg or else from the nearest angle of a grid over the coarse range
    and half as much again. translation_mm, rotation_deg: of the other axes, (n,) or scalar."""
    image = np.atleast_2d(np.asarray(image_px, dtype=float))
    count = len(image)
    translation = np.broadcast_to(np.asarray(translation_mm, dtype=float), (count,))
    turn = np.broadcast_to(np.asarray(rotation_deg, dtype=float), (count,))
    if start_deg is None:
        c = _nearest_on_grid(rig, image, translation, turn)
    else:
        c = np.array(np.broadcast_to(np.asarray(start_deg, dtype=float), (count,)))

    damping = np.full(count, _DAMPING)  # of Levenberg and Marquardt's steps
    predicted, slope = project_with_slope(rig, c, translation, turn)
    error = image - predicted
    cost = np.sum(error * error, axis=1)
    going = np.flatnonzero(np.isfinite(cost))  # samples whose search goes on
    for _ in range(iterations):
        if not len(going):
            break
        before, steep, off = c[going], slope[going], error[going]
        # equation: J.e / (|J|^2 (1 + damping)), J px per deg, e px; deg
        step = np.sum(steep * off, axis=1) / (np.sum(steep * steep, axis=1) * (1 + damping[going]) + 1e-12)
        trial = before + np.clip(np.nan_to_num(step), -STRIDE_DEG, STRIDE_DEG)
        predicted, steep = project_with_slope(rig, trial, translation[going], turn[going])
        off = image[going] - predicted
        squares = np.sum(off * off, axis=1)
        better = squares < cost[going]
        nearer = going[better]
        c[nearer], cost[nearer] = trial[better], squares[better]
        error[nearer], slope[nearer] = off[better], steep[better]
        damping[going] = np.where(better, damping[going] / _TIMES, damping[going] * _TIMES)
        settled = np.where(better, np.abs(trial - before) <= _CLOSE_DEG, damping[going] > _MOST_DAMPING)
        going = going[~settled]
    seen = np.isfinite(image).all(axis=1)
    return np.where(seen, c, np.nan), np.where(seen, np.sqrt(cost), np.nan)


def coarse_range_deg(rig: Rig) -> tuple[float, float]:
    """The lowest and highest bending angle, deg, that f_coarse gives over the motor's range."""
    ends = [rig.coarse.gain * q + rig.coarse.offset for q in rig.actuator.range]
    return min(ends), max(ends)


def _nearest_on_grid(rig: Rig, image: Array, translation: Array, turn: Array) -> Array:
    """Start angles (n,), deg, for `pose`: of a grid over the coarse range and half as much again, the angle whose image
    is nearest to image (n, 2), px; the range's middle where that is NaN. translation, turn (n,): of the other axes, mm
    and deg."""
    low, high = coarse_range_deg(rig)
    margin = _BESIDE * (high - low)
    grid = np.linspace(low - margin, high + margin, _GRID)
    best = np.full(len(image), (low + high) / 2)
    if len(image) == 0:
        return best
    if np.ptp(translation) == 0.0 and np.ptp(turn) == 0.0:
        places, seen = project(rig, grid, translation[0], turn[0]), np.isfinite(image).all(axis=1)
        ahead = np.isfinite(places).all(axis=1)
        if ahead.any():
            best[seen] = grid[ahead][KDTree(places[ahead]).query(image[seen])[1]]
        return best
    smallest = np.full(len(image), np.inf)
    for c in grid:
        distance = np.sum((image - project(rig, np.full(len(image), c), translation, turn)) ** 2, axis=1)
        closer = distance < smallest
        best[closer], smallest[closer] = c, distance[closer]
    return best
