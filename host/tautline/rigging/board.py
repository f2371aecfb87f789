"""A camera's intrinsics from pictures of a ChArUco board, by OpenCV's own functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from tautline.errors import TautError
from tautline.vision.frames import Progress

Array = npt.NDArray[np.float64]
DICTIONARIES = {
    name.removeprefix("DICT_"): getattr(cv2.aruco, name)
    for name in dir(cv2.aruco)
    if name.startswith(("DICT_4X4", "DICT_5X5", "DICT_6X6", "DICT_7X7"))
}
_LEAST_CORNERS = 6  # tolerance: of a view: a homography's four and two that check it
_LEAST_VIEWS = 4  # tolerance: two give five intrinsics; a view that is off must not decide
_FOCAL_SHARE = 0.005  # tolerance: sigma of the focal length: it goes into every angle as it is


@dataclass(frozen=True)
class Board:
    """A ChArUco board (a chessboard with markers in it, for calibrating cameras) as it was printed."""

    columns: int  # squares across
    rows: int  # squares down
    square_mm: float  # side of a square
    marker_mm: float  # side of a marker
    dictionary: str = "4X4_50"  # of the markers, a key of DICTIONARIES

    def opencv(self) -> cv2.aruco.CharucoBoard:
        """The board as OpenCV's object. TautError where no board of these numbers is possible."""
        if not 0.0 < self.marker_mm < self.square_mm:
            raise TautError(
                f"a marker of {self.marker_mm:g} mm does not lie within a square of {self.square_mm:g} mm: measure both"
            )
        dictionary = cv2.aruco.getPredefinedDictionary(DICTIONARIES[self.dictionary])
        try:
            return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_mm, self.marker_mm, dictionary)
        except cv2.error as error:
            raise TautError(
                f"no board of {self.columns} x {self.rows} squares can be made of {self.dictionary}: "
                "it has 3 x 3 or more, and the dictionary a marker for every second one"
            ) from error


@dataclass(frozen=True)
class Intrinsics:
    """A camera's intrinsics, each with its standard deviation (cv2.calibrateCameraExtended's)."""

    size: tuple[int, int]  # width, height, px
    values: Array  # (9,): fx fy cx cy in px, k1 k2 p1 p2 k3
    sigma: Array  # (9,)
    rms_px: float  # of the corners about what is fitted
    views: int  # that the board was found in
    of: int  # pictures in all

    def camera(self) -> dict[str, Any]:
        """The keys of rig.toml's [camera] that these intrinsics give, with their values."""
        width, height = self.size
        fx, fy, cx, cy, *distortion = self.values.tolist()
        keys = {"width_px": width, "height_px": height, "fx_px": fx, "fy_px": fy, "cx_px": cx, "cy_px": cy}
        return {**keys, "distortion": distortion}

    def in_words(self) -> str:
        """One line for the terminal: focal lengths and centre with their sigmas, and how many pictures were used."""
        fx, fy, cx, cy = self.values[:4]
        s = self.sigma
        return (
            f"camera: fx {fx:.1f} +- {s[0]:.1f}, fy {fy:.1f} +- {s[1]:.1f}, centre {cx:.1f} +- {s[2]:.1f}, "
            f"{cy:.1f} +- {s[3]:.1f} px; {self.views} of {self.of} pictures show the board, "
            f"its corners lie within {self.rms_px:.2g} px"
        )

    @property
    def doubts(self) -> list[str]:
        """Sentences that say what speaks against these intrinsics: a focal length that is not known to _FOCAL_SHARE. []
        without doubts."""
        share = float(self.sigma[0] / self.values[0])
        if share <= _FOCAL_SHARE:
            return []
        return [f"the focal length is known to {100 * share:.1f} % only: tilt the board by 30 deg and more, both ways"]


def intrinsics(pictures: Sequence[npt.NDArray[Any]], board: Board, progress: Progress | None = None) -> Intrinsics:
    """Calibrates a camera from pictures of a board: BGR or grey, all of one size, at least _LEAST_VIEWS of which show
    the board. The coefficient k3 is fitted only if the Bayesian information criterion asks for it, as over a moderate
    view it can hardly be told from k1 and k2. progress: gets the share done, 0 to 1, and a word. TautError where too
    few pictures show the board, or sizes differ."""
    size = (pictures[0].shape[1], pictures[0].shape[0])
    objects, images = _corners_of(pictures, size, board, progress)
    if len(objects) < _LEAST_VIEWS:
        raise TautError(
            f"{len(objects)} of {len(pictures)} pictures show a ChArUco board of {board.columns} x {board.rows} "
            f"squares of {board.dictionary}, {_LEAST_VIEWS} are needed: are --squares and --dictionary the print's, "
            "and is it sharp?"
        )
    count = 2 * sum(len(points) for points in objects)  # of measured coordinates
    without_k3, with_k3 = (_calibrate_camera(objects, images, size, flags) for flags in (cv2.CALIB_FIX_K3, 0))
    # equation: n log(rms^2) falls by more than one parameter costs, log n
    k3_asked_for = 2.0 * count * np.log(without_k3[0] / with_k3[0]) > np.log(count)
    rms_px, values, sigma = with_k3 if k3_asked_for else without_k3
    return Intrinsics(size, values, sigma, rms_px, views=len(objects), of=len(pictures))


def _corners_of(
    pictures: Sequence[npt.NDArray[Any]], size: tuple[int, int], board: Board, progress: Progress | None
) -> tuple[list[Any], list[Any]]:
    """The board's corners in each picture that shows at least _LEAST_CORNERS of them, not all on one line; other
    pictures are left out. Returns lists, one item a picture: corners on the board (n, 1, 3), mm, and in the image (n,
    1, 2), px. TautError where a picture has another size than `size` (width, height)."""
    opencv = board.opencv()
    detector = cv2.aruco.CharucoDetector(opencv)
    objects, images = [], []
    for k, picture in enumerate(pictures):
        if progress is not None:
            progress(k / len(pictures), "looking for the board")
        if (picture.shape[1], picture.shape[0]) != size:
            raise TautError(
                f"picture {k + 1} has {picture.shape[1]} x {picture.shape[0]} px, the first {size[0]} x {size[1]}: "
                "take all of the size that is recorded later"
            )
        corners, ids, _, _ = detector.detectBoard(picture)
        if ids is None or len(ids) < _LEAST_CORNERS:
            continue
        on_board, in_image = opencv.matchImagePoints(list(corners), ids)
        if np.linalg.matrix_rank(on_board[:, 0, :2] - on_board[0, 0, :2], tol=1e-6) == 2:  # not all on a line
            objects.append(on_board)
            images.append(in_image)
    return objects, images


def _calibrate_camera(objects: Any, images: Any, size: tuple[int, int], flags: int) -> tuple[float, Array, Array]:
    """Calibrates with OpenCV from corners as `_corners_of` gives them. flags: of cv2.CALIB_... Returns the rms of what
    is left of the corners, px, the values (9,) as in Intrinsics, and their standard deviations (9,)."""
    rms, matrix, distortion, _, _, sigma, _, _ = cv2.calibrateCameraExtended(
        objects, images, size, np.eye(3), np.zeros(5), flags=flags
    )
    values = np.array([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *distortion.ravel()[:5]])
    return float(rms), values, np.asarray(sigma, dtype=float).ravel()[:9]
