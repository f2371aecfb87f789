"""Where the camera is, from the marker's places at known angles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tautline.errors import TautError
from tautline.geometry import PLACED_PX, project_with_slope, tip_bend
from tautline.rig import Actuator, Camera, Coarse, HandEye, Kinematics, Rig
from tautline.rigging.places import Places

Array = npt.NDArray[np.float64]
_LEAST_DEG = 1e-6  # tolerance: of a stated sigma of 0, which a residual is divided by
_RIVAL = 9.0  # tolerance: of its sum of squares: a pose that is as far off is left at 3 sigma
_STRAYS = 2.0  # tolerance: times what was stated
_SINGULAR = 1e12  # tolerance: condition of the scaled information: double precision has no pose left beyond it


@dataclass(frozen=True)
class HandEyeFit:
    """A fitted hand-eye transform (camera to the instrument's base) and how well it is known."""

    hand_eye: HandEye
    sigma: Array  # (6,): rx ry rz in deg, x y z in mm
    left_px: float  # rms per coordinate of what is left
    strays: float  # rms of what is left over its stated sigma: 1 where pixels and angles are as exact as said
    measures_deg: Array  # (m,) over the angles' range: sigma of an angle that is measured with this pose
    angle_sigma_deg: float  # of the known angles, as it was stated
    rival: float  # chi square of the other pose that a planar curve allows, less that of this one; inf without another

    def in_words(self) -> str:
        """One line for the terminal: rotation and translation with their sigmas, and how well angles are measured."""
        rx, ry, rz = self.hand_eye.rotation_deg
        x, y, z = self.hand_eye.translation_mm
        s = self.sigma
        return (
            f"hand_eye: rotation {rx:.2f} +- {s[0]:.2f}, {ry:.2f} +- {s[1]:.2f}, {rz:.2f} +- {s[2]:.2f} deg, "
            f"translation {x:.2f} +- {s[3]:.2f}, {y:.2f} +- {s[4]:.2f}, {z:.2f} +- {s[5]:.2f} mm; angles that are "
            f"measured with it: +- {self.measures_deg.min():.2g} to {self.measures_deg.max():.2g} deg"
        )

    @property
    def doubts(self) -> list[str]:
        """Sentences that say what speaks against this hand-eye transform: another pose that fits as well, or places
        farther off than stated. [] without doubts."""
        found = []
        if self.rival < _RIVAL:
            found.append(
                "a pose from the other side of the instrument explains the places as well: spread the angles further"
            )
        if self.strays > _STRAYS:
            found.append(
                f"the marker's places are {self.strays:.1f} times further off than pixels and angles of "
                f"{self.angle_sigma_deg:g} deg explain: are the angles' signs and the kinematics' lengths right?"
            )
        return found


def hand_eye(places: Places, kinematics: Kinematics, camera: Camera, angle_sigma_deg: float) -> HandEyeFit:
    """Fits the hand-eye transform to the marker's places at known angles: nonlinear least squares over the pose (6,)
    and the true angles (n,), which have the stated sigma `angle_sigma_deg`. It starts from both poses that a planar
    curve allows (cv2.SOLVEPNP_IPPE) and keeps the better result. If more is left than the stated sigmas explain, the
    result's sigmas grow with it. TautError where the places do not determine a pose."""
    sigma_px = np.hypot(places.sigma_px, PLACED_PX)  # no mean goes below what a place is off by
    sigma_c = max(angle_sigma_deg, _LEAST_DEG)

    def image_and_slope(pose: Array, c_deg: Array) -> tuple[Array, Array]:
        """Image positions (n, 2), px, at angles c_deg (n,) with this pose (6,), and their slopes (n, 2), px per deg."""
        return project_with_slope(_rig_with_pose(kinematics, camera, pose), c_deg)

    def residuals(x: Array) -> Array:
        """Residuals over their sigmas, (3 n,): of the image positions, u and v in turn, 1e6 where the tip is behind the
        camera; then of the angles. x (6 + n,): pose, then true angles, deg."""
        left = (image_and_slope(x[:6], x[6:])[0] - places.image_px) / sigma_px[:, None]
        return np.concatenate([np.nan_to_num(left, nan=1e6).ravel(), (x[6:] - places.c_deg) / sigma_c])

    fits = [
        least_squares(residuals, np.concatenate([start, places.c_deg]), x_scale="jac", method="lm")
        for start in _planar_poses(places, kinematics, camera)
    ]
    fits.sort(key=lambda fit: float(fit.cost))
    best = fits[0]
    if not np.isfinite(best.cost):
        raise _undetermined_error()
    freedom = 2 * len(places.c_deg) - 6  # 3 n residuals less 6 + n unknowns
    strays = float(np.sqrt(2.0 * best.cost / freedom))
    spread = max(strays, 1.0) ** 2  # factor by which all variances grow
    covariance = _covariance(np.asarray(best.jac, dtype=float))[:6, :6] * spread
    pose = best.x[:6]
    off = residuals(best.x)[: 2 * len(sigma_px)].reshape(-1, 2) * sigma_px[:, None]
    # Fits from other starts that did not end at the same pose.
    others = [fit for fit in fits[1:] if np.abs(fit.x[:6] - pose).max() > 1e-3 * np.abs(pose).max()]
    return HandEyeFit(
        hand_eye=_hand_eye_of_pose(pose),
        sigma=np.sqrt(np.diag(covariance)),
        left_px=float(np.sqrt(np.mean(off**2))),
        strays=strays,
        measures_deg=_angle_sigma(image_and_slope, pose, covariance, places.c_deg),
        angle_sigma_deg=angle_sigma_deg,
        rival=min((2.0 * float(fit.cost - best.cost) / spread for fit in others), default=np.inf),
    )


def _covariance(jacobian: Array) -> Array:
    """The covariance (k, k) of k parameters: the inverse of J'J, J (n, k) being the Jacobian of a fit's residuals over
    their sigmas. TautError where J'J, scaled to a unit diagonal, is singular."""
    information: Array = jacobian.T @ jacobian
    scale = np.sqrt(np.diag(information))
    if not (scale > 0.0).all() or np.linalg.cond(information / np.outer(scale, scale)) > _SINGULAR:
        raise _undetermined_error()
    covariance: Array = np.linalg.inv(information).astype(np.float64)
    return covariance


def _hand_eye_of_pose(pose: Array) -> HandEye:
    """The hand-eye transform of a pose (6,): rx, ry, rz in deg, then x, y, z in mm."""
    rx, ry, rz, x, y, z = pose.tolist()
    return HandEye((rx, ry, rz), (x, y, z))


def _rig_with_pose(kinematics: Kinematics, camera: Camera, pose: Array) -> Rig:
    """A rig for `project` with this hand-eye pose (6,), rx ry rz in deg and x y z in mm; its actuator and coarse law
    are placeholders that projection does not use."""
    unused = Actuator("mm", (-1.0, 1.0), 1.0), Coarse(1.0, 0.0)
    return Rig(*unused, kinematics, camera, _hand_eye_of_pose(pose))


def _planar_poses(places: Places, kinematics: Kinematics, camera: Camera) -> list[Array]:
    """The poses (6,), rx ry rz in deg and x y z in mm, from which `hand_eye` starts: those from which the tip's planar
    curve looks as it was seen, up to two, by IPPE. TautError where there is none: places on a line, in one pixel, or
    fewer than the four that IPPE needs."""
    # (x, y, z) to (x, -z, y): the bending plane becomes z = 0.
    to_plane = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    flat = tip_bend(kinematics, places.c_deg) @ to_plane.T
    middle = flat.mean(axis=0)
    if len(flat) < 4 or np.linalg.matrix_rank(flat - middle) < 2:
        raise _undetermined_error()
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        flat - middle, places.image_px, camera.matrix, np.array(camera.distortion), flags=cv2.SOLVEPNP_IPPE
    )
    starts = []
    for turn, shift in zip(turns, shifts, strict=True):
        if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
            continue
        matrix = cv2.Rodrigues(turn)[0]
        angles = Rotation.from_matrix(matrix @ to_plane).as_euler("xyz", degrees=True)  # Rz Ry Rx, as in rig.toml
        # IPPE took the points less their middle: a point is at matrix (flat - middle) + shift.
        starts.append(np.concatenate([angles, shift.ravel() - matrix @ middle]))
    if not starts:
        raise _undetermined_error()
    return starts


def _undetermined_error() -> TautError:
    """The error to raise where the places determine no pose."""
    return TautError("these angles do not tell where the camera is: spread 8 or more over the range")


def _angle_sigma(
    image_and_slope: Callable[[Array, Array], tuple[Array, Array]], pose: Array, covariance: Array, c_deg: Array
) -> Array:
    """The standard deviation (25,), deg, of an angle that is measured with this pose (6,), at 25 angles over the range
    of c_deg (n,), from the pose's covariance (6, 6). A pose that is off by dp moves the image by h_p dp, which is read
    as an angle dc = -(h_c . h_p dp) / |h_c|^2. image_and_slope: as in `hand_eye`; its slopes are h_c."""
    grid = np.linspace(c_deg.min(), c_deg.max(), 25)
    slope = image_and_slope(pose, grid)[1]
    step = 1e-4  # deg or mm, of central differences
    reads = []  # dc by each of the six parameters of the pose, (25,) deg per deg or mm
    for one in np.eye(6) * step:
        moved = (image_and_slope(pose + one, grid)[0] - image_and_slope(pose - one, grid)[0]) / (2.0 * step)  # h_p
        reads.append(-(slope * moved).sum(axis=1) / (slope * slope).sum(axis=1))
    sigma: Array = np.sqrt(np.einsum("kn,kl,ln->n", reads, covariance, reads))
    return sigma
