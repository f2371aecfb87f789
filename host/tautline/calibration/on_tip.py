"""Where on a bare instrument's tip the followed place lies, estimated together with the bending angles.

The rig says where a marker would be. A place on the surface that a user has pointed at lies beside that, and moves over
the surface as the tip turns another side to the camera. Its path in the image is known well (from the joint fit), but
which angle shows it where depends on the place. So at each of n motor positions (nodes) the angle and the place's three
coordinates in the tip's frame are unknown, 4 n in all; places have a prior as wide as a user points, and the posterior
is taken as Gaussian at its maximum (Laplace).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline

from tautline.calibration.playfit import Fitted
from tautline.geometry import about_base_z, rotation, tip_bend, to_camera, to_image
from tautline.least_squares import descend
from tautline.recording import Shown
from tautline.rig import PLACES, Camera, HandEye, Kinematics, Place, Rig

Array = npt.NDArray[np.float64]

_NODES = PLACES  # tolerance: motor positions at which angle and place are unknown
_SHOWN = 0.25  # prior: of the square's side: standard deviation of its middle from that of a tube as wide
_ROAMS = 0.25  # prior: of it, half a tube's radius: how far the place goes over to the side that the camera sees
_ANYWAY = 0.5  # prior: turns of that side, in radii, that it goes on by where the side is the one that was shown
_TURN_DEG = 20.0  # prior: of bending, over which that stays alike
_JITTER = 1e-4  # tolerance: of it, that keeps its covariance regular
_STEP = 1e-4  # tolerance: deg or mm, of a derivative by differences
_MOST_STEPS = 100  # tolerance
_ENOUGH = 1e-3  # tolerance: of the cost, sigma^2


def place_on_tip(fitted: Fitted, rig: Rig, shown: Shown) -> Place | None:
    """Where on a bare tip the square lies that was shown and followed, from the path of its image. fitted: the joint
    fit of the image itself. None if it is a fit of angles, the rig lacks a camera, hardly anything moved, or the angles
    that are found are not monotone along the path."""
    if fitted.fit.view is not None or fitted.curves.follow.shape[1] != 2:
        return None
    if rig.kinematics is None or rig.camera is None or rig.hand_eye is None:
        return None
    counted = np.concatenate([s.p[m] for s, m in zip(fitted.fit.simulated, fitted.masks, strict=True)])
    if len(counted) < _NODES or np.ptp(counted) <= 0.0:
        return None
    nodes = np.linspace(counted.min(), counted.max(), _NODES)
    path = fitted.fit.follow.value(fitted.curves.follow, nodes)
    track = fitted.fit.tracks[0].track
    seen = _View(rig.kinematics, rig.hand_eye, rig.camera, *track.others_reference)
    coarse = rig.coarse.gain * nodes + rig.coarse.offset
    at = float(coarse[np.argmin(np.sum((path - shown.at_px) ** 2, axis=1))])  # where it was shown
    mean, covariance = _prior_of_place(seen, coarse, at, shown.side_px, track.tracked_px)
    noise = float(np.median(track.sigma)) * max(fitted.scale, 1.0)
    problem = _PlaceProblem(seen, path, noise, mean, np.kron(np.eye(3), np.linalg.inv(covariance)))
    found = descend(problem, np.concatenate([coarse, mean]), _MOST_STEPS)
    spread = np.sqrt(np.diag(np.linalg.inv(problem.linearised(found)[0]))[:_NODES])
    return _tabulated_place(found[:_NODES], found[_NODES:].reshape(3, _NODES), spread)


def _prior_of_place(seen: _View, coarse: Array, at: float, side_px: float, tracked_px: float) -> tuple[Array, Array]:
    """Mean (3 n,) of the place's coordinates at the nodes, mm, and covariance (n, n) of each coordinate, mm^2. The mean
    is on a tube as wide as the square, on the side that the camera saw when it was shown; at a node the place may have
    moved over to the side that the camera sees there. coarse (n,): f_coarse at the nodes, deg; at: bending when it was
    shown, deg; side_px: of the square; tracked_px: the tracker's error."""
    mm_per_px, side = seen.mm_per_px(at), seen.towards_camera(at)
    side_mm = side_px * mm_per_px
    alike = np.exp(-0.5 * ((coarse[:, None] - coarse) / _TURN_DEG) ** 2) + _JITTER * np.eye(_NODES)
    turned = np.array([np.linalg.norm(seen.towards_camera(c) - side) for c in coarse.tolist()])
    roams = _ROAMS * side_mm * (_ANYWAY + turned)
    covariance = (_SHOWN * side_mm) ** 2 + np.outer(roams, roams) * alike
    # What the tracker makes of it is alike whenever it is there again, and another from one node to the next.
    covariance[np.diag_indices(_NODES)] += (tracked_px * mm_per_px) ** 2
    return np.repeat(0.5 * side_mm * side, _NODES), covariance


def _tabulated_place(c_deg: Array, mm: Array, sigma_deg: Array) -> Place | None:
    """The place as a table at evenly spaced angles, from angles c_deg (n,), places mm (3, n) and the angles' sigma
    (n,). None where the angles are not monotone along the path."""
    order = slice(None) if c_deg[-1] > c_deg[0] else slice(None, None, -1)
    c_deg, mm, sigma_deg = c_deg[order], mm[:, order], sigma_deg[order]
    if not (np.diff(c_deg) > 0).all():
        return None
    at: Array = np.linspace(c_deg[0], c_deg[-1], PLACES)
    rows = CubicSpline(c_deg, mm, axis=1)(at)
    return Place(
        float(c_deg[0]),
        float(at[1] - at[0]),
        tuple(tuple(float(x) for x in row) for row in np.asarray(rows)),
        tuple(float(x) for x in np.asarray(np.interp(at, c_deg, sigma_deg))),
    )


@dataclass(frozen=True)
class _View:
    """The camera's view of places in the tip's frame, while the other degrees of freedom rest."""

    kinematics: Kinematics
    hand_eye: HandEye
    camera: Camera
    translation_mm: float
    rotation_deg: float

    def in_camera(self, c_deg: Array, place: Array) -> Array:
        """Positions (n, 3), mm, in the camera's frame of places (3, n), mm, in the frame of the tip's end at bending
        angles (n,), deg."""
        c = np.radians(c_deg)
        sin, cos = np.sin(c), np.cos(c)
        aside, out, ahead = place
        point = tip_bend(self.kinematics, c_deg)
        point += np.column_stack([cos * aside + sin * ahead, out, cos * ahead - sin * aside])
        point[:, 2] += self.translation_mm
        return to_camera(self.hand_eye, about_base_z(self.rotation_deg, point))

    def image(self, unknown: Array) -> Array:
        """(2 n,) image positions u, v of each node in turn, px, for the unknowns (4 n,): n angles, deg, then n first
        coordinates of the places, n second and n third ones, mm."""
        c_deg, *place = unknown.reshape(4, -1)
        return to_image(self.camera, self.in_camera(c_deg, np.array(place))).ravel()

    def by_unknown(self, unknown: Array) -> Array:
        """(2 n, 4 n) derivatives of `image`, by central differences, for all nodes at once: each depends on its own
        angle and place alone."""
        n = len(unknown) // 4
        slopes = np.zeros((n, 2, 4, n))
        node = np.arange(n)
        for k in range(4):
            step = np.zeros((4, n))
            step[k] = _STEP
            change = self.image(unknown + step.ravel()) - self.image(unknown - step.ravel())
            slopes[node, :, k, node] = change.reshape(n, 2) / (2.0 * _STEP)
        return slopes.reshape(2 * n, 4 * n)

    def mm_per_px(self, c_deg: float) -> float:
        """mm across the view for each pixel, at the depth of a tip bent by c_deg."""
        depth = self.in_camera(np.array([c_deg]), np.zeros((3, 1)))[0, 2]
        return float(depth / np.sqrt(self.camera.fx_px * self.camera.fy_px))

    def towards_camera(self, c_deg: float) -> Array:
        """The direction from a tip bent by c_deg to the camera, less its part along the tip: (3,) a unit vector in the
        tip's frame."""
        view = -self.in_camera(np.array([c_deg]), np.zeros((3, 1)))[0] @ rotation(self.hand_eye.rotation_deg)
        aside, out, ahead = about_base_z(-self.rotation_deg, view[None])[0]
        c = np.radians(c_deg)
        across = np.array([np.cos(c) * aside - np.sin(c) * ahead, out, 0.0])
        return np.asarray(across / max(float(np.linalg.norm(across)), 1e-9))


@dataclass(frozen=True)
class _PlaceProblem:
    """The posterior of the unknowns (4 n,) as a `least_squares.Problem`; angles, deg, have no prior, places, mm, a
    Gaussian one."""

    seen: _View
    path: Array  # (n, 2) px
    noise_px: float
    mean: Array  # (3 n,)
    precision: Array  # (3 n, 3 n)

    def linearised(self, point: Array) -> tuple[Array, Array, float]:
        """Normal matrix (4 n, 4 n), gradient (4 n,) along which the cost falls, and the cost, at a point (4 n,)."""
        n = len(self.path)
        rows = self.seen.by_unknown(point) / self.noise_px
        left = (self.path.ravel() - self.seen.image(point)) / self.noise_px
        matrix, gradient = rows.T @ rows, rows.T @ left
        matrix[n:, n:] += self.precision
        gradient[n:] -= self.precision @ (point[n:] - self.mean)
        return matrix, gradient, self.cost(point)

    def moved(self, point: Array, step: Array) -> Array:
        """The point (4 n,) after a step (4 n,)."""
        return point + step

    def cost(self, point: Array) -> float:
        """Chi-square of the path plus that of the prior at a point (4 n,)."""
        left = (self.path.ravel() - self.seen.image(point)) / self.noise_px
        off = point[len(self.path) :] - self.mean
        return float(left @ left + off @ self.precision @ off)

    def enough(self, gained: float, cost: float) -> bool:
        """Whether the last step gained less than _ENOUGH of the cost, so that the descent ends."""
        return gained < _ENOUGH
