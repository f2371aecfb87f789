"""The marker's colour, picked once: the direction in colour space along which the marker differs most from what is
around it, while tissue's own colours, its brightness and white glare differ least."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
import tomli_w

from tautline.errors import TautError
from tautline.vision.sighting import check_in_picture

Array = np.ndarray

FORMAT = "marker/1"
SMALLEST_PX, LARGEST_PX = 5.0, 200.0  # diameters that can be tracked

_GLARE = 60.0  # prior: rms of the grey light that may lie on anything, levels
_NOISE = 5.0  # prior: rms that each channel is trusted to, levels
_BLUR_PX = 2.5  # tolerance: sigma of the blur in which blobs are looked for
_BLANKED_PX = 12  # tolerance: radius of what is blanked around a place that was looked at
_BLANKED, _BLANKED_MORE_PX = 0.7, 3  # tolerance: and around a blob: of its diameter, and px more
_LARGEST = 0.1  # prior: of the picture: what is larger is no marker
_DISTINCT = 6.0  # tolerance: squared Mahalanobis distance from its surroundings, of a picked marker at least


@dataclass(frozen=True)
class MarkerColour:
    """Membership of a pixel: weights . (B, G, R) + offset, 1 on the marker as it was picked, about 0 around it."""

    weights: tuple[float, float, float]  # per level of B, G, R
    offset: float
    colour: tuple[float, float, float]  # the marker's B, G, R as it was picked
    diameter_px: float  # of the disc with the marker's area
    at: tuple[float, float] = (float("nan"), float("nan"))  # where it was picked, px

    def membership(self, picture: Array) -> Array:
        """(height, width) float32: how much each pixel of a BGR picture (height, width, 3) uint8 is of the marker's
        colour, 1 on the marker as it was picked, about 0 around it."""
        row = np.array([[*self.weights, self.offset]], dtype=np.float32)
        return np.asarray(cv2.transform(picture.astype(np.float32), row))

    def save(self, path: str | Path) -> None:
        """Writes the colour to a file, marker.toml."""
        document = {
            "format": FORMAT,
            "weights_bgr": list(self.weights),
            "offset": self.offset,
            "colour_bgr": list(self.colour),
            "diameter_px": self.diameter_px,
            "at_px": list(self.at),
        }
        Path(path).write_text(tomli_w.dumps(document), encoding="utf-8")

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads marker.toml. The place where the colour was picked is not read back: `at` is NaN. TautError where the
        file cannot be read, is no marker.toml, or holds numbers out of range."""
        path = Path(path)
        try:
            document = tomllib.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:  # no UTF-8, no TOML, or a number of too many digits
            raise TautError(
                f"{path}: cannot be read as a marker's colour ({error}): make one with 'taut marker'"
            ) from error
        if document.get("format") != FORMAT:
            raise TautError(
                f"{path}: format is {document.get('format')!r}, expected '{FORMAT}': run 'taut marker' again"
            )
        weights, colour = _three_numbers(document, "weights_bgr", path), _three_numbers(document, "colour_bgr", path)
        offset, diameter = _number(document, "offset", path), _number(document, "diameter_px", path)
        if not (np.isfinite([*weights, *colour, offset]).all() and SMALLEST_PX <= diameter <= LARGEST_PX):
            raise TautError(f"{path}: a number in it is out of range: run 'taut marker' again")
        return cls(weights, offset, colour, diameter)


def _number(document: dict[str, Any], key: str, path: Path) -> float:
    """The value of `key` in the document of marker.toml as a number, inf for an integer that is too large. TautError,
    which names `path`, where the value is no number."""
    value = document.get(key)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TautError(f"{path}: {key} is {value!r}, expected a number: run 'taut marker' again")
    try:
        return float(value)
    except OverflowError:
        return float("inf")


def _three_numbers(document: dict[str, Any], key: str, path: Path) -> tuple[float, float, float]:
    """The value of `key` in the document of marker.toml as three numbers. TautError, which names `path`, where the
    value is something else."""
    value = document.get(key)
    if not isinstance(value, list) or len(value) != 3:
        raise TautError(f"{path}: {key} is {value!r}, expected three numbers: run 'taut marker' again")
    return _triple(np.array([_number({key: x}, key, path) for x in value]))


def _triple(values: Array) -> tuple[float, float, float]:
    """An array (3,) as a tuple of floats."""
    return float(values[0]), float(values[1]), float(values[2])


def pick(picture: Array, at: tuple[float, float] | None = None) -> MarkerColour:
    """The marker's colour from a picture, BGR (height, width, 3) uint8: of the blob at `at` (u, v) px, or without `at`
    of the blob that stands out most. TautError where there is no such blob."""
    if at is None:
        best = candidates(picture)
        if not best:
            raise TautError("no marker stands out from its surroundings by its colour: show where it is with --at U,V")
        return best[0]
    _check_picture(picture)
    height, width = picture.shape[:2]
    check_in_picture(at, width, height)
    blob = _pick_blob_at(picture, at, _surroundings(picture))
    if blob is None:
        raise TautError(
            f"no blob of one colour stands out at ({at[0]:g}, {at[1]:g}): point at the middle of a marker "
            f"of {SMALLEST_PX:g} to {LARGEST_PX:g} px whose colour nothing else has"
        )
    return blob[0]


def candidates(picture: Array, places: int = 12) -> list[MarkerColour]:
    """Picks the colours of up to `places` blobs that stand out in a picture, BGR (height, width, 3) uint8; the most
    marker-like is first. It looks where the smoothed colour is farthest from the picture's own colours (Mahalanobis
    distance), blanks that place, and looks again, `places` times."""
    _check_picture(picture)
    around = _surroundings(picture)
    mean, covariance = around
    root = np.linalg.cholesky(np.linalg.inv(covariance)).T  # equation: Mahalanobis distance = |root (colour - mean)|
    affine = np.column_stack([root, -root @ mean]).astype(np.float32)
    smooth = cv2.GaussianBlur(picture.astype(np.float32), (0, 0), _BLUR_PX)
    distance = np.linalg.norm(cv2.transform(smooth, affine), axis=2)
    blobs = []
    for _ in range(places):
        _, _, _, place = cv2.minMaxLoc(distance)
        blob = _pick_blob_at(picture, (float(place[0]), float(place[1])), around)
        cv2.circle(distance, place, _BLANKED_PX, 0.0, -1)
        if blob is not None:
            blobs.append(blob)
            u, v = blob[0].at
            radius = round(_BLANKED * blob[0].diameter_px) + _BLANKED_MORE_PX
            cv2.circle(distance, (round(u), round(v)), radius, 0.0, -1)
    blobs.sort(key=lambda blob: -blob[1])
    return [colour for colour, _ in blobs]


def _check_picture(picture: Array) -> None:
    """Raises TautError unless a picture is BGR (height, width, 3) uint8 with 16 px a side or more."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8 or min(picture.shape[:2]) < 16:
        raise TautError("a marker is picked from a BGR picture of 8 bits: (height, width, 3) uint8, 16 px and more")


def _surroundings(picture: Array) -> tuple[Array, Array]:
    """Mean (3,), levels of B, G, R, and covariance (3, 3) of a picture's colours, by some 40 000 of its pixels.
    Variances of glare, which changes all channels alike, and of noise are added, so that neither of them looks like a
    marker."""
    step = max(1, int(np.sqrt(picture.shape[0] * picture.shape[1] / 40_000)))
    sample = picture[::step, ::step].reshape(-1, 3).astype(np.float64)
    covariance = np.cov(sample.T) + _GLARE**2 * np.ones((3, 3)) + _NOISE**2 * np.eye(3)
    return sample.mean(axis=0), covariance


def _pick_blob_at(
    picture: Array, at: tuple[float, float], around: tuple[Array, Array]
) -> tuple[MarkerColour, float] | None:
    """Picks the colour of the blob at `at` (u, v) px by Fisher's linear discriminant against `around`, the mean and
    covariance of `_surroundings`, in three passes, each from the median colour of the blob found before. Returns it
    with a score without unit, which grows with the blob's distinctness, compactness, share of all pixels of this
    colour, and size up to 15 px. None where it does not stand out, or there is no blob of a marker's size."""
    column, row = int(at[0]), int(at[1])
    close = slice(max(0, row - 2), row + 3), slice(max(0, column - 2), column + 3)
    colour = np.median(picture[close].reshape(-1, 3), axis=0)
    mean, covariance = around
    picked = None
    for _ in range(3):
        weights = np.linalg.solve(covariance, colour - mean)  # Fisher's direction
        separation = float(weights @ (colour - mean))  # squared Mahalanobis distance of the colour from around
        if separation < _DISTINCT:
            return None
        weights /= separation  # so that membership is 1 at the colour, 0 at the mean around it
        candidate = MarkerColour(
            _triple(weights), offset=float(-weights @ mean), colour=_triple(colour), diameter_px=SMALLEST_PX, at=at
        )  # its diameter is not known yet
        inside = candidate.membership(picture) > 0.5
        blob = _blob_in(inside, close)
        if blob is None:
            return None
        colour = np.median(picture[blob.pixels], axis=0)
        alone = blob.area / np.count_nonzero(inside)
        score = np.sqrt(separation) * blob.compactness * alone * min(1.0, blob.diameter_px / 15.0)
        picked = replace(candidate, colour=_triple(colour), diameter_px=blob.diameter_px, at=blob.at), float(score)
    return picked


@dataclass(frozen=True)
class _Blob:
    """Connected pixels of one colour."""

    pixels: Array  # (height, width) bool
    area: int  # px
    diameter_px: float  # of a disc of this area
    compactness: float  # 0 to 1: 1.3 times its area against that of a disc as wide as it is, at most 1
    at: tuple[float, float]  # centroid (u, v) px


def _blob_in(inside: Array, window: tuple[slice, slice]) -> _Blob | None:
    """The blob of `inside`, (height, width) bool, that has most pixels in a window of rows and columns. None where no
    blob has any, or it is too small or too large for a marker."""
    _, labels, stats, centroids = cv2.connectedComponentsWithStats(inside.astype(np.uint8), connectivity=8)
    near = labels[window]
    near = near[near > 0]
    if not len(near):
        return None
    label = np.bincount(near).argmax()
    area = int(stats[label, cv2.CC_STAT_AREA])
    diameter = float(np.sqrt(4.0 * area / np.pi))
    if not SMALLEST_PX <= diameter <= LARGEST_PX or area > _LARGEST * inside.size:
        return None
    box = max(int(stats[label, cv2.CC_STAT_WIDTH]), int(stats[label, cv2.CC_STAT_HEIGHT]))
    compactness = min(1.0, 1.3 * area / (0.785 * box * box))  # 1: an ellipse of up to 1.3 : 1; 0.785: pi / 4
    u, v = centroids[label].tolist()
    return _Blob(labels == label, area=area, diameter_px=diameter, compactness=compactness, at=(u, v))
