"""A place on a bare instrument, followed by what the surface around it looks like: no marker is needed.

Corners around the place are found again in every frame (pyramidal Lucas-Kanade) from the nearest of several keyframes,
not from the frame before: errors do not add up along a motion that comes back. The affine motion that most of them
follow (RANSAC) is the instrument's; tissue that shows beside it moves otherwise and is left out. Where the instrument
turns another side to the camera, the tracker goes over to the surface that is seen there; its place is the same at the
same bending angle.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Self

import cv2
import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.vision.flow import EvenLight, Picture, corners_in, track_corners
from tautline.vision.keyframes import Keyframes
from tautline.vision.sighting import SURE_PX, Sighting, check_in_picture, lost_sighting

Array = npt.NDArray[np.floating[Any]]

SMALLEST_PX, LARGEST_PX, USUAL_PX = 16.0, 400.0, 36.0  # side of the region

# tolerance of all, but for what is said to be a prior or memory.
_CORNERS, _APART = 80, 3.0  # of a keyframe; px between them
_FEWEST = 8  # corners that go together: three give the six parameters
_MARGIN_PX = 24.0  # around a region, which has not gone further than that from where it is expected
_TOGETHER_PX = 1.0  # from the common motion
_TURNED_DEG, _SCALED, _AWAY = 5.0, 0.06, 0.3  # (of the region's side) from the nearest keyframe: a new one is taken
_LEAST = 0.5  # times that, before a new one is taken for any reason
_REACH = 2.0  # times that, within which a keyframe says something
_KEYFRAMES = 128  # memory
_SHARE = 0.25  # of a keyframe's corners that have to go together
_FADES = 20  # of them that go together: with fewer a new keyframe is taken
_APART_PX = 3.0  # that a region has to go for what stays behind to be told from it
_OWN = 0.5  # of the pictures in which a corner of the region's own goes along
_TRIED = 2  # keyframes whose best places a lost region is looked for at
_SHRINK = 2  # of pictures in which a lost region is looked for
_TURNS_DEG = 60.0  # prior: either way, that a region may be turned by in the first picture of another video
_LIKE = 0.6  # correlation from which a place is tried


@dataclass(frozen=True)
class Pose:
    """Where the region is: its middle, px, and what it was turned and scaled by since it was picked."""

    u: float
    v: float
    a: float = 1.0  # scale * cos(turn)
    b: float = 0.0  # scale * sin(turn)

    def moved_by(self, motion: Array) -> Pose:
        """Returns the pose after a motion of the picture, an affine map (2, 3) of px to px: all of it moves the
        region's middle, its similarity part turns and scales the region."""
        # scale * cos(turn) and scale * sin(turn) of its nearest similarity
        c, s = 0.5 * float(motion[0, 0] + motion[1, 1]), 0.5 * float(motion[1, 0] - motion[0, 1])
        u, v = motion @ (self.u, self.v, 1.0)
        return Pose(float(u), float(v), c * self.a - s * self.b, s * self.a + c * self.b)

    def motion_to(self, other: Pose) -> Array:
        """Returns the similarity (2, 3), of px to px, that takes this pose to the other."""
        size = self.a**2 + self.b**2
        c = (other.a * self.a + other.b * self.b) / size
        s = (other.b * self.a - other.a * self.b) / size
        return np.array([[c, -s, other.u - c * self.u + s * self.v], [s, c, other.v - s * self.u - c * self.v]])

    @property
    def size(self) -> float:
        """The region's scale against the picture in which it was shown, 1 there."""
        return float(np.hypot(self.a, self.b))

    @staticmethod
    def mean(weighted: Sequence[tuple[float, Pose]]) -> Pose:
        """The weighted mean of poses, given as (weight, pose)."""
        weights = np.array([weight for weight, _ in weighted])
        rows = np.array([(pose.u, pose.v, pose.a, pose.b) for _, pose in weighted])
        return Pose(*map(float, weights @ rows / weights.sum()))

    def square(self, side_px: float) -> Array:
        """The corners (4, 2) px of a square of side_px around the region's middle, turned as the region is, but not
        scaled."""
        corners = 0.5 * side_px * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        placed: Array = corners @ np.array([[self.a, self.b], [-self.b, self.a]]) / self.size + (self.u, self.v)
        return placed

    def difference_to(self, other: Pose, side_px: float) -> float:
        """How different the region looks in two poses: a distance by turn, scale and shift, without unit; from 1 on a
        new keyframe is taken. side_px: side of the region."""
        motion = self.motion_to(other)
        turn = np.degrees(np.arctan2(motion[1, 0], motion[0, 0]))
        scale = np.log(np.hypot(motion[1, 0], motion[0, 0]))
        away = np.hypot(other.u - self.u, other.v - self.v) / (_AWAY * side_px)
        return float(np.sqrt((turn / _TURNED_DEG) ** 2 + (scale / _SCALED) ** 2 + away**2))


class _Keyframe:
    """What the region and its surroundings looked like at one pose, and the corners in the region."""

    def __init__(self, cut: Picture, corner: Array, pose: Pose, side_px: float) -> None:
        """Finds the corners in the region's square. cut: the part of a grey picture around the region; corner (2,): the
        place (u, v) of its first pixel in the picture, px; pose: of the region in the picture."""
        self.picture, self.corner, self.pose, self._side_px = cut, corner, pose, side_px
        mask = np.zeros(cut.shape, dtype=np.uint8)
        cv2.fillConvexPoly(mask, np.rint(pose.square(side_px) - corner).astype(np.int32), 255)
        self.corners = corners_in(cut, mask, _CORNERS, _APART) + corner
        self.together = len(self.corners)  # how many went along with the region in the last picture
        self.off_px = 0.0  # rms error of its pose's middle, per coordinate, beyond what its corners say
        # Of each corner: pictures in which the region was elsewhere, and in how many of them it went along.
        self._tried, self._met = np.zeros((2, len(self.corners)))

    @classmethod
    def from_picture(cls, light: EvenLight, pose: Pose, side_px: float) -> Self:
        """Makes a keyframe of the region as a picture shows it at this pose. It keeps a part of the picture that holds
        the region however it is turned (1.5 sides), and a margin."""
        long = int(1.5 * side_px + 2.0 * _MARGIN_PX)
        return cls(*light.cut(pose.u, pose.v, (min(long, light.shape[0]), min(long, light.shape[1]))), pose, side_px)

    def turned(self, turn_deg: float) -> _Keyframe:
        """Returns the keyframe as it would look with the region turned by turn_deg about its middle."""
        pose = self.pose
        middle = (pose.u - float(self.corner[0]), pose.v - float(self.corner[1]))
        warp = cv2.getRotationMatrix2D(middle, -turn_deg, 1.0)  # its angles are against ours, which go from u to v
        size = self.picture.shape[1], self.picture.shape[0]
        picture = cv2.warpAffine(self.picture, warp, size, borderMode=cv2.BORDER_REPLICATE)
        cos, sin = float(np.cos(np.radians(turn_deg))), float(np.sin(np.radians(turn_deg)))
        turned_pose = Pose(pose.u, pose.v, cos * pose.a - sin * pose.b, sin * pose.a + cos * pose.b)
        return _Keyframe(np.asarray(picture, dtype=np.uint8), self.corner, turned_pose, self._side_px)

    @property
    def square(self) -> Picture:
        """The square of the region's side around its middle, upright in the picture, (side, side) grey levels, for
        template matching."""
        side = max(int(self._side_px), 2)
        middle = self.pose.u - float(self.corner[0]), self.pose.v - float(self.corner[1])
        return np.asarray(cv2.getRectSubPix(self.picture, (side, side), middle), dtype=np.uint8)

    def locate(self, light: EvenLight, expected: Pose) -> tuple[Pose, float] | None:
        """Finds the region in another picture by this keyframe's corners, looked for around the pose `expected`.
        Returns its pose, by the corners that follow one affine motion (RANSAC), and the standard deviation of its
        middle, px per coordinate; None where too few corners do. Notes how many follow it, and, if the region has moved
        since the keyframe, which, for `settle`."""
        motion = self.pose.motion_to(expected)
        cut, corner = light.cut(expected.u, expected.v, (self.picture.shape[0], self.picture.shape[1]))
        if len(self.corners) < _FEWEST:
            return None
        start = (self.corners - self.corner).astype(np.float32)
        guess = (self.corners @ motion[:, :2].T + motion[:, 2] - corner).astype(np.float32)
        there, kept = track_corners(self.picture, cut, start, guess)
        if len(kept) < _FEWEST:
            return None
        before, after = self.corners[kept], there[kept] + corner
        fit, inliers = cv2.estimateAffine2D(
            before, after, method=cv2.RANSAC, ransacReprojThreshold=_TOGETHER_PX, maxIters=300
        )
        together = np.flatnonzero(inliers)
        if fit is None or len(together) < max(_FEWEST, _SHARE * len(self.corners)):
            return None
        self.together = len(together)
        pose = self.pose.moved_by(np.asarray(fit))
        if np.hypot(pose.u - self.pose.u, pose.v - self.pose.v) > _APART_PX:
            self._tried += 1
            self._met[kept[together]] += 1
        sigma = _sigma_of_affine(
            np.asarray(fit, dtype=np.float64), before[together], after[together], np.array([self.pose.u, self.pose.v])
        )
        return pose, max(float(np.hypot(sigma, self.off_px)), SURE_PX)

    def settle(self) -> bool:
        """Drops the corners that mostly stayed behind when the region moved, as they are on the background. Returns
        whether enough are left for the keyframe to be used."""
        own = self._met >= _OWN * self._tried
        self.corners, self._tried, self._met = self.corners[own], self._tried[own], self._met[own]
        return len(self.corners) >= _FEWEST


class PatchTracker:
    """Follows a region that was shown in one picture: `track` gives the place of its middle, as a marker's tracker
    does. Takes some 1.6 ms a frame while the region is followed."""

    def __init__(self, picture: Picture, at: tuple[float, float], side_px: float = USUAL_PX) -> None:
        """Takes the first keyframe. picture: BGR (height, width, 3) uint8, in which the region is a square of side_px
        around `at` (u, v), px. It should lie on the instrument's tip with as little background as possible. TautError
        where the region has no such size, is outside of the picture, or shows nothing to follow."""
        if not SMALLEST_PX <= side_px <= LARGEST_PX:
            raise TautError(
                f"a region of {side_px:g} px: between {SMALLEST_PX:g} and {LARGEST_PX:g} px can be followed"
            )
        height, width = picture.shape[:2]
        check_in_picture(at, width, height)
        self.side_px, self._shape = side_px, picture.shape[:2]
        self._first = _Keyframe.from_picture(EvenLight(picture), Pose(*at), side_px)
        if len(self._first.corners) < _FEWEST:
            raise TautError(
                f"around {at[0]:g}, {at[1]:g} px there is hardly anything to follow: show a place with structure, or a "
                "larger one"
            )
        self._keyframes = Keyframes(self._first, _KEYFRAMES, _REACH)
        self._poses: deque[Pose] = deque(maxlen=2)  # in the last frames; empty where it was lost

    def settle(self) -> None:
        """Ends learning, after a motion: adjusts the keyframes to each other and drops corners of the background, and
        keyframes that have too few others. The next picture may be any, such as the motion's first again."""
        shifted = self._keyframes.settle()
        if shifted is not None:
            for key, (u, v), off_px in zip(self._keyframes.keys, *shifted, strict=True):
                key.pose = replace(key.pose, u=key.pose.u + float(u), v=key.pose.v + float(v))
                key.off_px = float(off_px)
        self._keyframes.keys = [key for key in self._keyframes.keys if key.settle()] or [self._first]
        self._poses.clear()

    def track(self, picture: Picture) -> Sighting:
        """Finds the region in the next frame, BGR (height, width, 3) uint8: near where it should be, else in the whole
        frame. Returns its middle, px, and its side as diameter_px; lost where it is not found. TautError where the
        frame has not the size of the picture that the region was shown in."""
        if picture.shape[:2] != self._shape:
            (height, width), (shown_height, shown_width) = picture.shape[:2], self._shape
            raise TautError(
                f"frames are {width} x {height} px, the place was shown in one of {shown_width} x {shown_height}: "
                "show it again with 'taut marker VIDEO --region U,V'"
            )
        light = EvenLight(picture)
        found = self._pose_by_nearest(light, self._expected) if self._poses else None
        if found is None:
            self._poses.clear()
            found = self._search(light)
        if found is None:
            return lost_sighting("the region is not found")
        pose, sigma = found
        self._poses.append(pose)
        return Sighting(pose.u, pose.v, sigma, self.side_px * pose.size)

    @property
    def _expected(self) -> Pose:
        """The pose in the next frame if the last step is repeated; needs a pose of the last frame."""
        before, last = self._poses[0], self._poses[-1]
        return last.moved_by(before.motion_to(last))

    def _pose_by_nearest(self, light: EvenLight, expected: Pose) -> tuple[Pose, float] | None:
        """The region's pose and its sigma, px per coordinate, by the nearest keyframes that find it near `expected`,
        weighted by nearness; None where none does. While learning, the difference of two keyframes is noted, and a
        keyframe is added where the nearest one is far, or less far but finds few of its corners."""
        away = [key.pose.difference_to(expected, self.side_px) for key in self._keyframes.keys]
        found = self._keyframes.nearest(away, lambda key: key.locate(light, expected), beyond=True)
        if not found:
            return None
        if len(found) == 2:
            (_, i, (one, _)), (_, j, (other, _)) = found
            self._keyframes.note(i, j, np.array([one.u - other.u, one.v - other.v]))
        mean = Pose.mean([(weight, pose) for weight, _, (pose, _) in found])
        nearest = int(np.argmin(away))
        fades = away[nearest] > _LEAST and self._keyframes.keys[nearest].together < _FADES
        if self._keyframes.has_room and (away[nearest] > 1.0 or fades):
            self._keyframes.keys.append(_Keyframe.from_picture(light, mean, self.side_px))
        total = sum(weight for weight, _, _ in found)
        # Sigma of the weighted mean of independent poses.
        return mean, float(np.sqrt(sum((weight / total * sigma) ** 2 for weight, _, (_, sigma) in found)))

    def _search(self, light: EvenLight) -> tuple[Pose, float] | None:
        """The region's pose and its sigma, px per coordinate, anywhere in the frame: keyframes are matched as templates
        with the shrunk picture, then located (`locate`) at the likeliest places. A keyframe that is the only one, as in
        another video, is also tried turned. None where nothing is found."""
        small = _smaller(light.whole)
        views = self._keyframes.keys
        if len(views) == 1:
            turns = np.arange(-_TURNS_DEG, _TURNS_DEG + 1, 2 * _TURNED_DEG)
            views = [self._first, *(self._first.turned(turn) for turn in turns.tolist() if turn)]
        ranked = []
        for view in views:
            square = _smaller(view.square)
            if square.shape[0] <= small.shape[0] and square.shape[1] <= small.shape[1]:
                _, like, _, place = cv2.minMaxLoc(cv2.matchTemplate(small, square, cv2.TM_CCOEFF_NORMED))
                ranked.append((like, _SHRINK * (np.array(place) + 0.5 * np.array(square.shape[::-1])), view))
        ranked.sort(key=lambda entry: -entry[0])
        for like, (u, v), view in ranked[:_TRIED]:
            found = view.locate(light, replace(view.pose, u=float(u), v=float(v))) if like > _LIKE else None
            if found is not None:
                return found
        return None


def _sigma_of_affine(fit: Array, before: Array, after: Array, at: Array) -> float:
    """The standard deviation, px per coordinate, of where an affine motion (2, 3) takes the point `at` (2,), by the
    residuals of the n corners that it was fitted to: `before` (n, 2) px went to `after` (n, 2) px. It grows with the
    distance of the point from the corners' mean (linear regression)."""
    residual = after - before @ fit[:, :2].T - fit[:, 2]
    scatter = float(np.sum(residual**2)) / (2 * len(before) - 6)  # px squared; six numbers were fitted
    away, lever = before - before.mean(axis=0), at - before.mean(axis=0)
    spread = away.T @ away + 1e-9 * np.eye(2)  # regular even where all corners are on a line
    return float(np.sqrt(scatter * (1.0 / len(before) + lever @ np.linalg.solve(spread, lever))))


def _smaller(grey: Picture) -> Picture:
    """Returns a grey picture shrunk by _SHRINK, for the search of a lost region."""
    small = cv2.resize(grey, None, fx=1 / _SHRINK, fy=1 / _SHRINK, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8)
