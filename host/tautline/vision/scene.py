"""How far the tip of an endoscope that sees the world from there has turned, by how the world turns in its view.

Corners all over the picture are found again from the nearest of several keyframes. What most of them do together (a
homography, RANSAC) is the world's motion; tissue that moves by itself, glints that stay with the light, and the part of
the instrument in view move otherwise and are left out. One rotation takes the directions in which the corners were seen
to those in which they are seen now. The world is taken to be far: where it is near, the tip's own shift adds to the
turn, by the same amount at the same bending angle.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.recording import Angle, Motor, Video
from tautline.rig import Camera, Coarse, Rig
from tautline.vision.flow import Picture, corners_in, even_light, track_corners
from tautline.vision.frames import Progress, every_frame, half_progress
from tautline.vision.keyframes import Keyframes

Array = npt.NDArray[np.floating[Any]]

_CORNERS, _APART = 250, 5.0  # tolerance: of a keyframe; px between them
_FEWEST = 20  # tolerance: corners that go together: eight numbers make a homography, four corners
_BORDER_PX = 12  # tolerance: nothing is looked for nearer to the edge: a window of Lucas-Kanade is cut there
_TOGETHER_PX = 0.5  # tolerance: from the common motion
_OWN = 0.8  # tolerance: of the pictures in which a corner of the world that stays goes along
_STEP = 0.08  # tolerance: of the field of view, diagonal: from the nearest keyframe, from which a new one is taken
_REACH = 3.0  # tolerance: times that, within which a keyframe is tried
_KEYFRAMES = 256  # tolerance: memory
_FEWEST_TURNS = 20  # tolerance: of a video


@dataclass
class _Keyframe:
    """One picture of the world, the corners in it, and the camera's turn when it was taken."""

    picture: Picture  # grey, in even light
    corners: Array  # (n, 2) px
    towards: Array  # (n, 3) unit vectors from the camera to the corners
    turn: Array  # (3,) rad, rotation vector from the first picture's directions to its own
    tried: Array  # (n,) pictures in which a corner was found again
    met: Array  # (n,) pictures in which it also went along with most

    def settle(self) -> None:
        """Drops the corners that often move apart from the rest, as they are on tissue that moves by itself; keeps all
        if fewer than _FEWEST would be left."""
        own = self.met >= _OWN * self.tried
        if own.sum() >= _FEWEST:
            self.corners, self.towards, self.tried, self.met = (
                rows[own] for rows in (self.corners, self.towards, self.tried, self.met)
            )


@dataclass
class SceneTracker:
    """Tells how far the tip's own camera has turned, from what it sees: `track` gives its turn since the first
    keyframe, picture by picture; `settle`, after a motion, makes the keyframes agree."""

    camera: Camera
    _keyframes: Keyframes[_Keyframe] | None = None  # from the first picture on
    _turns: list[Array] = field(default_factory=list)  # the last two

    def __post_init__(self) -> None:
        """Sets _step, rad: how far the camera has to turn from the nearest keyframe for a new one to be taken, _STEP of
        the field of view's diagonal."""
        across = np.hypot(self.camera.width_px / self.camera.fx_px, self.camera.height_px / self.camera.fy_px)
        self._step = _STEP * 2.0 * float(np.arctan(0.5 * across))

    def track(self, picture: Picture) -> Array | None:
        """Returns the camera's turn since the first keyframe, a rotation vector (3,), rad; None where the scene is not
        found again. picture: the next frame, BGR (height, width, 3) uint8. As long as no frame has shown anything of
        the first keyframe (which was dark, or covered), each frame becomes the first one anew."""
        grey = even_light(picture)
        if self._keyframes is None:
            return self._begin_anew(grey)
        expected = self._turns[-1] if self._turns else np.zeros(3)
        if len(self._turns) == 2:  # as much further as between the last two frames: R1 R0^T R1
            before, last = (_rotation_matrix(turn) for turn in self._turns)
            expected = _rotation_vector(last @ before.T @ last)
        turn = self._turn_by_nearest(self._keyframes, grey, expected)
        if turn is None and (turn := self._turn_by_best(self._keyframes, grey)) is None:
            self._turns.clear()
            alone = len(self._keyframes.keys) == 1 and not self._keyframes.keys[0].met.any()
            return self._begin_anew(grey) if self._keyframes.learns and alone else None
        self._turns = [*self._turns[-1:], turn]
        return turn

    def _begin_anew(self, grey: Picture) -> Array:
        """Makes this grey picture the first and only keyframe, from which turns are told. Returns its turn, (3,)
        zeros."""
        self._keyframes = Keyframes(self._keyframe(grey, np.zeros(3)), _KEYFRAMES, _REACH)
        return np.zeros(3)

    def settle(self) -> None:
        """Ends learning, after a motion: turns the keyframes so that they differ least in the pictures that two of them
        saw (least squares), and drops corners on what moves by itself. The next picture may be any."""
        if self._keyframes is not None:
            shifted = self._keyframes.settle()
            if shifted is not None:
                for key, by in zip(self._keyframes.keys, shifted[0], strict=True):
                    key.turn = _rotation_vector(_rotation_matrix(by) @ _rotation_matrix(key.turn))
            for key in self._keyframes.keys:
                key.settle()
        self._turns.clear()

    def _keyframe(self, grey: Picture, turn: Array) -> _Keyframe:
        """Makes a keyframe of a grey picture, which the camera took at this turn (3,) rad, with its best corners, none
        of them within _BORDER_PX of the border."""
        mask = np.zeros_like(grey)
        mask[_BORDER_PX:-_BORDER_PX, _BORDER_PX:-_BORDER_PX] = 255
        corners = corners_in(grey, mask, _CORNERS, _APART)
        return _Keyframe(grey, corners, self._directions(corners), turn, *np.zeros((2, len(corners))))

    def _directions(self, places: Array) -> Array:
        """Unit vectors (n, 3) from the camera to what it sees at places (n, 2) px, lens distortion undone."""
        if not len(places):
            return np.empty((0, 3))
        distortion = np.array(self.camera.distortion)
        flat = cv2.undistortPoints(places.reshape(-1, 1, 2), self.camera.matrix, distortion).reshape(-1, 2)
        rays = np.column_stack([flat, np.ones(len(flat))])
        return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))

    def _turn_by_keyframe(self, key: _Keyframe, grey: Picture, expected: Array) -> tuple[Array, int] | None:
        """The camera's turn (3,) rad in a grey picture by one keyframe's corners, and how many of them tell it: those
        that follow one homography (RANSAC). None where too few do. expected (3,) rad: the turn at which they are looked
        for. Counts, for `settle`, which corners were found and which followed it."""
        # (n, 3) Directions in which the corners are seen if the camera is at the turn `expected`.
        directions = key.towards @ (_rotation_matrix(expected) @ _rotation_matrix(key.turn).T).T
        if not len(directions):
            return None
        guess, _ = cv2.projectPoints(
            directions, np.zeros(3), np.zeros(3), self.camera.matrix, np.array(self.camera.distortion)
        )
        guess = guess.reshape(-1, 2)
        size = np.array([grey.shape[1], grey.shape[0]])
        # 0.1: what is nearly across the line of sight or behind has no place in the picture.
        shown = np.flatnonzero((directions[:, 2] > 0.1) & (guess > 0.0).all(axis=1) & (guess < size).all(axis=1))
        if len(shown) < _FEWEST:
            return None
        start = key.corners[shown].astype(np.float32)
        there, kept = track_corners(key.picture, grey, start, guess[shown].astype(np.float32))
        if len(kept) < _FEWEST:
            return None
        one, other = key.towards[shown[kept]], self._directions(there[kept].astype(float))
        within = _TOGETHER_PX / self.camera.fx_px
        _, inliers = cv2.findHomography(one[:, :2] / one[:, 2:], other[:, :2] / other[:, 2:], cv2.RANSAC, within)
        together = np.zeros(0, int) if inliers is None else np.flatnonzero(inliers)
        if len(together) < max(_FEWEST, 0.25 * len(kept)):
            return None
        key.tried[shown[kept]] += 1
        key.met[shown[kept[together]]] += 1
        since = _rotation_between(one[together], other[together])
        return _rotation_vector(since @ _rotation_matrix(key.turn)), len(together)

    def _turn_by_nearest(self, keyframes: Keyframes[_Keyframe], grey: Picture, expected: Array) -> Array | None:
        """The camera's turn (3,) rad by the keyframes nearest to the turn `expected` (3,), rad, weighted by nearness;
        None where none of them finds the scene. While learning, the difference of two keyframes is noted, and a
        keyframe is added where the nearest one is far."""
        away = np.array([np.linalg.norm(_relative_turn(key.turn, expected)) for key in keyframes.keys]) / self._step
        found = keyframes.nearest(away.tolist(), lambda key: self._turn_by_keyframe(key, grey, expected))
        if not found:
            return None
        (weight, first, (turn, _)), *others = found
        for other_weight, second, (other, _) in others:
            by = _relative_turn(turn, other)
            keyframes.note(first, second, -by)
            part = other_weight / (weight + other_weight) * by  # of the way to the other keyframe's turn
            turn = _rotation_vector(_rotation_matrix(part) @ _rotation_matrix(turn))
        if keyframes.has_room and away.min() > 1.0:
            keyframes.keys.append(self._keyframe(grey, turn))
        return turn

    def _turn_by_best(self, keyframes: Keyframes[_Keyframe], grey: Picture) -> Array | None:
        """The camera's turn (3,) rad where it may be anywhere: by the keyframe that finds most of its corners again.
        Each is tried as if the camera were back at the keyframe's turn. None where none finds the scene."""
        seen = [self._turn_by_keyframe(key, grey, key.turn) for key in keyframes.keys]
        found = max((one for one in seen if one is not None), key=lambda one: one[1], default=None)
        return None if found is None else found[0]


def _rotation_between(one: Array, other: Array) -> Array:
    """The least-squares rotation (3, 3) that takes directions `one` (n, 3) to `other` (n, 3) (Kabsch). The
    determinant's sign keeps it from being a reflection."""
    left, _, right = np.linalg.svd(other.T @ one)
    return np.asarray(left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right)


def _rotation_matrix(turn: Array) -> Array:
    """The rotation matrix (3, 3) of a rotation vector (3,) rad."""
    return np.asarray(cv2.Rodrigues(np.asarray(turn, dtype=float))[0])


def _rotation_vector(rotation: Array) -> Array:
    """The rotation vector (3,) rad of a matrix (3, 3)."""
    turn: Array = np.asarray(cv2.Rodrigues(rotation)[0], dtype=float).ravel()
    return turn


def _relative_turn(one: Array, other: Array) -> Array:
    """(3,) rad Rotation vector that takes the turn `one` to `other`, rotation vectors (3,) rad too."""
    return _rotation_vector(_rotation_matrix(other) @ _rotation_matrix(one).T)


def bending_by_scene(video: Video, motor: Motor, rig: Rig, progress: Progress | None = None) -> Angle:
    """Measures the tip's bending angle over a video that its own camera took (see `angle_of`), from how the camera
    turned. The video is read twice: the first pass learns the keyframes. TautError where frames have another size than
    the rig's, or fewer than _FEWEST_TURNS frames find the scene."""
    assert rig.camera is not None
    tracker, rig_size = SceneTracker(rig.camera), (rig.camera.width_px, rig.camera.height_px)
    size = every_frame(video, tracker.track, half_progress(progress, 0.0))[2]
    if size not in (None, rig_size):
        raise TautError(
            f"{video.path}: its frames are {size[0]} x {size[1]} px, the rig's {rig_size[0]} x {rig_size[1]}: record "
            "at the rig's size, or calibrate the camera at this one"
        )
    tracker.settle()
    t_s, turns, _ = every_frame(video, tracker.track, half_progress(progress, 0.5))
    timed = np.isfinite(t_s)
    rows = np.array([np.full(3, np.nan) if turn is None else turn for turn in turns])[timed]
    if np.sum(np.isfinite(rows).all(axis=1)) < _FEWEST_TURNS:
        raise TautError(
            f'{video.path}: the world is not found again from frame to frame: is [camera] mount = "tip" right, and is '
            "there light and structure in its view?"
        )
    return angle_of(t_s[timed], rows, motor, rig.coarse, rig.delay_s)


def angle_of(t_s: Array, turns: Array, motor: Motor, coarse: Coarse, delay_s: float) -> Angle:
    """Returns the bending angle, deg, by the camera's turns (n, 3), rotation vectors in rad (NaN: not found), of frames
    that arrived at t_s (n,): the component along the axis about which the camera turns most. A turn tells neither sign
    nor zero of bending: these are chosen so that the angle goes with the coarse law of the motor, delay_s before
    arrival, and has the same mean."""
    seen = np.asarray(np.isfinite(turns).all(axis=1))
    middle = np.median(turns[seen], axis=0)
    axis = np.linalg.svd(turns[seen] - middle, full_matrices=False)[2][0]  # first principal component
    along = np.degrees((turns - middle) @ axis)
    expected = coarse.gain * np.interp(t_s - delay_s, motor.t_s, motor.q) + coarse.offset
    if np.sum((along * (expected - expected[seen].mean()))[seen]) < 0.0:
        along = -along
    return Angle(t_s, along + float(np.mean((expected - along)[seen])), seen)
