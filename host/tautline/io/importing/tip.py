"""The bending angle of a tip whose orientation was recorded."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

Array = np.ndarray
QUATERNION = ("x", "y", "z", "w")
_UNIT_LENGTH = 0.01  # tolerance: by which a quaternion's length may be off from 1: float32, rounded text


def bending_deg(quaternions: Array) -> tuple[Array, float]:
    """The bending angle of a tip from its recorded orientations, quaternions (n, 4) as x, y, z, w. Returns their angles
    (n,), deg, about the one axis that they turn about most, NaN where a quaternion has not length 1, and the share of
    their turning that is about this axis, 0 to 1. With fewer than two good quaternions all are NaN and the share is 0.

    With the mean orientation m and r = m^-1 q, the axis n is the first principal one of r's rotation vectors. The angle
    is the twist about n, 2 atan2(r_v . n, r_w), of r plus that of m: 0 is the base's own orientation."""
    length = np.linalg.norm(quaternions, axis=1)
    good = np.abs(length - 1.0) < _UNIT_LENGTH
    angles = np.full(len(quaternions), np.nan)
    if good.sum() < 2:
        return angles, 0.0
    turned = Rotation.from_quat(quaternions[good])
    mean = turned.mean()
    relative = mean.inv() * turned
    vectors = relative.as_rotvec()
    spread = vectors.T @ vectors
    variances, axes = np.linalg.eigh(spread)
    # The eigenvector of the largest eigenvalue; its largest component is made positive, so that the sign is unique.
    axis = axes[:, -1] * (1.0 if axes[np.abs(axes[:, -1]).argmax(), -1] > 0.0 else -1.0)
    total = float(variances.sum())
    angles[good] = np.degrees(np.unwrap(_twist(relative.as_quat(), axis)) + _twist(mean.as_quat()[None], axis)[0])
    return angles, float(variances[-1]) / total if total > 0.0 else 0.0


def _twist(quaternions: Array, axis: Array) -> Array:
    """The angle (n,), rad in [-pi, pi), by which each rotation, quaternions (n, 4) as x, y, z, w, turns about the unit
    vector `axis` (3,)."""
    angle = 2.0 * np.arctan2(quaternions[:, :3] @ axis, quaternions[:, 3])
    wrapped: Array = (angle + np.pi) % (2.0 * np.pi) - np.pi
    return wrapped
