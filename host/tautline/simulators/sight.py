"""What a camera of an MJCF sees of a site that one hinge moves: its angle by the marker's place in the image."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Angle, Marker, Recording
from tautline.simulators.scene import check_mujoco, check_named, joints_above, read_mujoco

if TYPE_CHECKING:
    import mujoco

Array = npt.NDArray[np.float64]

_STEP_DEG = 0.25  # tolerance: of the track; straight lines between are 2e-6 of the site's radius off
_OFF = 0.05  # tolerance: of the track's extent in the image: a marker farther off is another site's, or camera's
_ALIKE_PX, _APART_DEG = 2.0, 20.0  # tolerance: places so near of angles so far apart cannot be told
_FAR_DEG = 170.0  # tolerance: of a hinge without limits, either way


@dataclass(frozen=True)
class Sight:
    """The track of a site in a camera's image by the angle of the hinge that moves it, px (0, 0 is the middle of the
    first pixel)."""

    hinge: str  # its name
    c_deg: Array  # (n,) rising by _STEP_DEG, by more where the camera does not see the site between
    px: Array  # (n, 2) finite

    def to_angle(self, recording: Recording, late_s: float = 0.0) -> Recording:
        """The recording with an angle instead of its marker and video: at each frame the hinge's angle at the place of
        the track that is nearest to the marker, not valid where that is farther off than _OFF of the track's extent.
        late_s: how much older, s, frames are than angles; it is subtracted from their times. TautError where there is
        no marker, or most of its places are that far off."""
        marker = recording.marker
        if marker is None:
            raise TautError(f"{recording.name}: has no marker.csv: --camera compares the marker's places in the image")
        angle, off = self.angle(marker)
        extent = float(np.linalg.norm(np.ptp(self.px, axis=0)))
        median = float(np.median(off[np.isfinite(off)])) if np.isfinite(off).any() else np.inf
        if median > _OFF * extent:
            raise TautError(
                f"{recording.name}: the marker is {median:.0f} px off the track of the site (in the median): "
                "name the --camera that filmed it, at its resolution, and the --tip that carries the marker"
            )
        seen = Angle(marker.t_s - late_s, angle, valid=off < _OFF * extent)
        return replace(recording, marker=None, video=None, angle=seen)

    def angle(self, marker: Marker) -> tuple[Array, Array]:
        """For each of n frames the hinge's angle (n,), deg, at the place of the track that is nearest to the marker,
        and the marker's distance from that place (n,), px; both NaN where the marker is not valid."""
        places = np.column_stack([marker.u_px, marker.v_px])
        # The track is a chain of straight pieces along `ahead`. The marker's projection on a piece gives the nearest
        # point of that piece, as a share of it.
        ahead = np.diff(self.px, axis=0)
        length2 = np.maximum(np.sum(ahead**2, axis=1), 1e-12)
        unseen = np.diff(self.c_deg) > 1.5 * _STEP_DEG  # the track leaves the image there, and comes back elsewhere
        angle, off = np.full(len(places), np.nan), np.full(len(places), np.nan)
        for i in np.flatnonzero(np.asarray(marker.valid, dtype=bool) & np.isfinite(places).all(axis=1)):
            share = np.clip(np.sum((places[i] - self.px[:-1]) * ahead, axis=1) / length2, 0.0, 1.0)
            away = np.linalg.norm(self.px[:-1] + share[:, None] * ahead - places[i], axis=1)
            away[unseen] = np.inf
            k = int(np.argmin(away))
            angle[i], off[i] = self.c_deg[k] + share[k] * (self.c_deg[k + 1] - self.c_deg[k]), away[k]
        return angle, off


def sight(path: Path, site: str, camera: str) -> Sight:
    """The track of a site in a camera's image, both named in an MJCF file, with all other joints in the file's own
    pose. By it a recording with a marker on this site is compared with the simulator's angle. TautError where the file
    lacks one of them, not exactly one hinge moves the site, the camera does not see it move, or one place in the image
    has several angles."""
    check_mujoco()
    model = read_mujoco(path)
    check_named(path, "site", site, [str(model.site(i).name) for i in range(model.nsite)])
    check_named(path, "camera", camera, [str(model.camera(i).name) for i in range(model.ncam)])
    at = model.camera(camera).id
    if model.cam_resolution[at].min() < 2 or model.cam_intrinsic[at][2:].any():
        raise TautError(
            f"{path}: the camera {camera} needs the resolution of its frames, and its principal point in their middle"
        )
    hinge = _hinge_above(model, path, site)
    c_deg, px = _track(model, hinge, site, camera)
    size = model.cam_resolution[at]
    with np.errstate(invalid="ignore"):  # NaN is not seen
        seen = ((px > -size) & (px < 2 * size)).all(axis=1)  # also within one frame size beyond each border
    if seen.sum() < 2 or np.ptp(px[seen], axis=0).max() < 1.0:
        raise TautError(f"{path}: the camera {camera} does not see the site {site} move: name another --camera")
    c_deg, px = c_deg[seen], px[seen]
    # Every two places of the track: near to each other though their angles are far apart.
    alike = np.linalg.norm(px[:, None] - px[None], axis=2) < _ALIKE_PX
    if (alike & (np.abs(c_deg[:, None] - c_deg[None]) > _APART_DEG)).any():
        raise TautError(
            f"{path}: the camera {camera} sees the site {site} at one place for different angles of {hinge}: give the "
            "hinge the range that it moves in, or name another --camera"
        )
    return Sight(hinge, c_deg, px)


def _track(model: mujoco.MjModel, hinge: str, site: str, camera: str) -> tuple[Array, Array]:
    """The places at which the camera sees the site at the hinge's angles, over its range if it has one, else _FAR_DEG
    either way. Returns angles (n,), deg, _STEP_DEG apart, and places (n, 2), px, NaN behind the camera. Other joints
    are in the file's first key frame, or without one in the zero pose."""
    import mujoco

    joint = model.joint(hinge)
    low, high = np.degrees(model.jnt_range[joint.id]) if model.jnt_limited[joint.id] else (-_FAR_DEG, _FAR_DEG)
    c_deg = np.arange(low, high + _STEP_DEG, _STEP_DEG)
    data = mujoco.MjData(model)
    if model.nkey:
        mujoco.mj_resetDataKeyframe(model, data, 0)
    px = np.empty((len(c_deg), 2))
    for i, angle in enumerate(np.radians(c_deg)):
        data.qpos[joint.qposadr[0]] = angle
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        px[i] = _project(model, data, camera, data.site(site).xpos)
    return c_deg, px


def _hinge_above(model: mujoco.MjModel, path: Path, site: str) -> str:
    """The name of the one joint that moves the site. TautError unless there is exactly one and it is a hinge with a
    name. path: the file's, for messages."""
    import mujoco

    above = joints_above(model, site)
    if len(above) != 1 or model.jnt_type[above[0]] != mujoco.mjtJoint.mjJNT_HINGE:
        raise TautError(f"{path}: {len(above)} joints move the site {site}: with --camera weld all but one hinge")
    if not model.joint(above[0]).name:
        raise TautError(f"{path}: the hinge above the site {site} has no name: give it one")
    return str(model.joint(above[0]).name)


def _project(model: mujoco.MjModel, data: mujoco.MjData, camera: str, place: Array) -> Array:
    """The place in a camera's image (2,), px, of a point `place` (3,), m in the world; NaN behind the camera, which
    looks along its own -z with y up. Focal lengths are from its intrinsics where the file states the sensor's size,
    else from its field of view."""
    at = model.camera(camera).id
    width, height = (float(n) for n in model.cam_resolution[at])
    x, y, z = data.cam_xmat[at].reshape(3, 3).T @ (place - data.cam_xpos[at])
    if z >= 0.0:
        return np.full(2, np.nan)
    if model.cam_sensorsize[at].all():
        per_m = np.array([width, height]) / model.cam_sensorsize[at]
        focal = model.cam_intrinsic[at][:2] * per_m
    else:
        focal = np.full(2, 0.5 * height / math.tan(0.5 * math.radians(float(model.cam_fovy[at]))))
    middle = 0.5 * np.array([width, height]) - 0.5
    return np.asarray(middle + focal * np.array([x, -y]) / -z)
