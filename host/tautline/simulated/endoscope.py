"""The simulated endoscope: draws the instrument and its marker over tissue, in the rig's pinhole geometry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
from scipy.special import erfc

from tautline.errors import TautError
from tautline.geometry import about_base_z, project, tip_bend, to_camera, to_image
from tautline.rig import Camera, HandEye, Kinematics, Rig

Array = np.ndarray


@dataclass(frozen=True)
class Look:
    """What the picture is made of. Colours are B, G, R levels of 0 to 255; lengths in mm on the instrument."""

    marker_colour: tuple[float, float, float] = (70.0, 175.0, 40.0)
    marker_radius_mm: float = 0.75
    tube_radius_mm: float = 1.25
    glint: float = 0.8  # of the light on the wet marker: 0 none, 1 burns it out
    vignetting: float = 0.45  # brightness lost in the corners, share
    noise: float = 2.5  # rms of the sensor's noise, levels
    blur_px: float = 0.8  # rms width of lens and pixel
    exposure_s: float = 0.010


class Endoscope:
    """Draws frames of the instrument bent by c. The marker's disc is centred exactly on `geometry.project`: it is drawn
    as the mean over the exposure of its band-limited coverage of each pixel, and rounded to levels only after the noise
    is added.

    Takes about 2 ms for a 720 x 576 frame. Not thread-safe."""

    def __init__(self, rig: Rig, look: Look | None = None, background: Array | None = None, seed: int = 0) -> None:
        """background: a BGR picture (rows, columns, 3) uint8 of any size, scaled to cover the frame; without one a
        tissue-like picture is drawn. seed: of that picture and of the sensor's noise. look: None takes Look's own
        values. TautError where the rig lacks the kinematics, camera or hand-eye transform, or the background is no such
        picture."""
        if rig.camera is None or rig.kinematics is None or rig.hand_eye is None:
            raise TautError("the rig needs [kinematics], [camera] and [hand_eye] to draw what its camera sees")
        self.rig, self.look = rig, look or Look()
        self._camera: Camera = rig.camera
        self._kinematics: Kinematics = rig.kinematics
        self._hand_eye: HandEye = rig.hand_eye
        width, height = self._camera.width_px, self._camera.height_px
        self._rng = np.random.default_rng([seed, 0xE7D0])
        tissue = (
            _tissue_picture(width, height, self._rng)
            if background is None
            else _scaled_to_cover(background, width, height)
        )
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        # Squared distance from the middle, 1 in the corners.
        far = ((x - width / 2) ** 2 + (y - height / 2) ** 2) / ((width / 2) ** 2 + (height / 2) ** 2)
        self._brightness = (1.0 - self.look.vignetting * far)[:, :, None].repeat(3, axis=2)
        self._tissue_picture = tissue
        self._backdrop = _to_levels(tissue * self._brightness)
        # Frames take their noise from random places of one larger picture of noise.
        bank = self._rng.standard_normal((height + 256, width + 256, 3), dtype=np.float32) * self.look.noise
        self._noise = bank  # for the marker, which is rounded afterwards
        self._noise_levels = np.clip(np.rint(bank), -127, 127).astype(np.int8)  # for all else: fast

    def position(
        self, c_deg: npt.ArrayLike, translation_mm: npt.ArrayLike = 0.0, rotation_deg: npt.ArrayLike = 0.0
    ) -> Array:
        """The marker's true place (n, 2), px, in each state; c_deg, translation_mm and rotation_deg: (n,) or one number
        each."""
        image: Array = project(self.rig, c_deg, translation_mm, rotation_deg)
        return image

    def frame(
        self, c_deg: npt.ArrayLike, translation_mm: npt.ArrayLike = 0.0, rotation_deg: npt.ArrayLike = 0.0
    ) -> Array:
        """Draws a BGR picture (height, width, 3) uint8 of the tip at c_deg, with the instrument's translation and
        rotation, and new noise. Each argument is one number, or (n,) states through which the exposure passes at equal
        intervals; the marker is then blurred along them."""
        c, translation, turn = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(x, dtype=np.float64)) for x in (c_deg, translation_mm, rotation_deg))
        )
        picture = self._backdrop.copy()
        middle = len(c) // 2  # the tube is not blurred: it is drawn in the exposure's middle state
        self._draw_tube(picture, float(c[middle]), float(translation[middle]), float(turn[middle]))
        height, width = picture.shape[:2]
        # Where in the larger picture of noise this frame's noise begins.
        dy, dx = self._rng.integers(0, 256, 2)
        marker = self._marker_patch(picture, c, translation, turn)
        picture = cv2.add(picture, self._noise_levels[dy : dy + height, dx : dx + width], dtype=cv2.CV_8U)
        if marker is not None:
            (x0, y0), patch = marker
            rows, columns = patch.shape[:2]
            patch += self._noise[dy + y0 : dy + y0 + rows, dx + x0 : dx + x0 + columns]
            picture[y0 : y0 + rows, x0 : x0 + columns] = _to_levels(patch)
        return picture

    def _marker_patch(
        self, picture: Array, c: Array, translation: Array, turn: Array
    ) -> tuple[tuple[int, int], Array] | None:
        """Draws the marker and its highlight, blurred by lens and motion, over a copy of the part of `picture` that
        they reach. Returns that part's first (column, row), and its levels, float (rows, columns, 3), not rounded yet,
        so that noise can be added; None where the marker is not in view. c, translation, turn (n,): states over the
        exposure, deg, mm, deg."""
        track, distance = self._marker_track(c, translation, turn)
        if not np.isfinite(track).all():
            return None
        radius = self._camera.fx_px * self.look.marker_radius_mm / distance
        reach = radius + _BLUR_REACH * self.look.blur_px
        height, width = picture.shape[:2]
        x0, y0 = np.maximum(np.floor(track.min(axis=0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(track.max(axis=0) + reach) + 1, [width, height]).astype(int)
        if x0 >= x1 or y0 >= y1:
            return None
        discs = _spread_along(track, self.look.blur_px)
        # cover: share of a pixel that takes the marker's colour; light: the discs' highlights, added.
        cover, light = self._mean_of_discs(discs, radius, np.arange(x0, x1)[None, :], np.arange(y0, y1)[:, None])
        gain = self._brightness[y0:y1, x0:x1]
        patch = picture[y0:y1, x0:x1].astype(np.float32)
        patch += cover[:, :, None] * (np.asarray(self.look.marker_colour) * gain - patch)
        patch += (light * (self.look.glint * 255.0 / len(discs)))[:, :, None]
        return (int(x0), int(y0)), np.minimum(patch, 255.0)

    def _marker_track(self, c: Array, translation: Array, turn: Array) -> tuple[Array, float]:
        """The marker's centre in each state (n, 2), px, NaN where it is not in front of the camera, and its mean
        distance along the camera's axis, mm. c, translation, turn (n,): deg, mm, deg."""
        base = about_base_z(turn, tip_bend(self._kinematics, c) + np.column_stack([0 * c, 0 * c, translation]))
        point = to_camera(self._hand_eye, base)
        return to_image(self._camera, point), float(np.mean(point[:, 2]))

    def _mean_of_discs(self, centres: Array, radius: float, x: Array, y: Array) -> tuple[Array, Array]:
        """Over the pixels of columns x (1, columns) and rows y (rows, 1), (rows, columns) each: the share of a pixel
        that the disc covers, averaged over its centres (k, 2), and the sum over the centres of its highlight, which is
        1 at its peak. A disc's edge is blurred as by a Gaussian of rms blur_px: 0.5 erfc of the distance beyond it. All
        lengths are in px."""
        cover = np.zeros((y.size, x.size))
        light = np.zeros_like(cover)
        for u, v in centres:
            distance = np.hypot(x - u, y - v)
            cover += 0.5 * erfc((distance - radius) / (self.look.blur_px * np.sqrt(2.0)))
            if self.look.glint > 0:
                # A highlight up and to the left of its middle.
                spot = ((x - u + 0.35 * radius) ** 2 + (y - v + 0.4 * radius) ** 2) / (0.18 * radius) ** 2
                light += np.exp(-0.5 * spot)
        return cover / len(centres), light

    def _centre_line(self, c_deg: float, translation_mm: float, rotation_deg: float) -> Array:
        """Points (n, 3), mm in the camera's frame, along the tube's centre line: the shaft, the bending section, the
        rigid tip. Points behind the camera or nearer than 3 mm to it are left out."""
        share = np.linspace(0.0, 1.0, 14)
        length = self._kinematics.bending_length_mm
        # Up to a share of its length the section is itself an arc, of that share of its length and of its angle.
        arc = length * share[:, None] * tip_bend(Kinematics(bending_length_mm=1.0, tip_length_mm=0.0), c_deg * share)
        end = tip_bend(self._kinematics, c_deg)
        shaft = np.array([[0.0, 0.0, z] for z in np.linspace(-60.0, -1.0, 30)])
        base = np.vstack([shaft, arc, 0.5 * (arc[-1:] + end), end])
        base[:, 2] += translation_mm
        point: Array = to_camera(self._hand_eye, about_base_z(rotation_deg, base))
        return point[point[:, 2] > 3.0]

    def _draw_tube(self, picture: Array, c_deg: float, translation_mm: float, rotation_deg: float) -> None:
        """Draws the straight shaft from behind the camera, the constant-curvature section and the rigid tip into
        `picture`, in place; nothing where the tube is not in view."""
        point = self._centre_line(c_deg, translation_mm, rotation_deg)
        if len(point) < 2:
            return
        line = to_image(self._camera, point)
        height, width = picture.shape[:2]
        half = self._camera.fx_px * self.look.tube_radius_mm / point[:, 2]  # px, of its width at each point
        along = np.gradient(line, axis=0)  # across: unit normals of the line in the image
        norm = np.hypot(along[:, 0], along[:, 1])
        across = np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(norm, 1e-9)[:, None]
        reach = half.max()
        x0, y0 = np.maximum(np.floor(line.min(axis=0) - reach), 0).astype(int)
        x1, y1 = np.minimum(np.ceil(line.max(axis=0) + reach), [width, height]).astype(int)
        if x0 >= x1 or y0 >= y1:
            return
        patch = self._tissue_picture[y0:y1, x0:x1].copy()
        corner = np.array([x0, y0])
        for inset, level in _SHADES:
            # A cylinder lit from the camera: bright off its middle, dark at its edges.
            left = line + across * (half * (-1.0 + inset))[:, None]
            right = line + across * (half * (1.0 - 0.6 * inset))[:, None]
            outline = (np.vstack([left, right[::-1]]) - corner) * 16.0  # OpenCV's fixed point: 4 bits behind the point
            outline = np.clip(outline, -1e5, 1e5)
            colour = tuple(level * x for x in _STEEL)
            cv2.fillPoly(patch, [np.rint(outline).astype(np.int32)], colour, cv2.LINE_AA, 4)
        picture[y0:y1, x0:x1] = cv2.multiply(patch, self._brightness[y0:y1, x0:x1], dtype=cv2.CV_8U)


_STEEL = (150.0, 150.0, 145.0)  # levels, B, G, R, of the tube where it is lit
_SHADES = tuple((0.12 * k, 0.35 + 0.11 * k) for k in range(7))  # of the half width: inset of a strip; share of _STEEL
_BLUR_REACH = 5.0  # tolerance: blur widths beyond a disc's edge, where nothing of it is seen any more
_RESTS_PX = 0.02  # tolerance: in an exposure: less blurs nothing that is seen
_DISCS_A_BLUR, _MOST_DISCS = 2.0, 64  # tolerance: along the way: no steps are seen


def _spread_along(track: Array, blur_px: float) -> Array:
    """Places (k, 2), px, on a marker's track (n, 2) over an exposure, at equal intervals of time. They are so near to
    each other that discs at them, averaged, with the blur blur_px look like one disc that moved. A marker that rests
    gives its mean place, k = 1."""
    # px, u and v added
    travelled = float(np.abs(np.diff(track, axis=0)).sum()) if len(track) > 1 else 0.0
    steps = 1 if travelled < _RESTS_PX else min(_MOST_DISCS, 2 + int(_DISCS_A_BLUR * travelled / blur_px))
    if steps == 1:
        return np.asarray(track.mean(axis=0, keepdims=True))
    shares = (np.arange(steps) + 0.5) / steps  # of the exposure
    return np.column_stack([np.interp(shares, np.linspace(0, 1, len(track)), track[:, i]) for i in (0, 1)])


def load_background(path: str | Path) -> Array:
    """Reads a picture file as BGR levels, (height, width, 3) uint8. TautError where it cannot be read as a picture."""
    picture = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if picture is None:
        raise TautError(f"{path}: cannot be read as a picture: give a PNG or JPEG file")
    return np.asarray(picture)


def _to_levels(picture: Array) -> Array:
    """Rounds a picture of any shape to levels as a camera gives them: 0 to 255, uint8."""
    levels: Array = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    return levels


def _scaled_to_cover(picture: Array, width: int, height: int) -> Array:
    """Scales a picture to cover width x height px and crops it to its middle, BGR (height, width, 3) uint8. TautError
    where it is not a BGR picture of 8 bits."""
    if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
        raise TautError("a background is a BGR picture of 8 bits: (height, width, 3) uint8")
    scale = max(width / picture.shape[1], height / picture.shape[0])
    size = (max(width, round(picture.shape[1] * scale)), max(height, round(picture.shape[0] * scale)))
    large = cv2.resize(picture, size, interpolation=cv2.INTER_LINEAR)
    x0, y0 = (size[0] - width) // 2, (size[1] - height) // 2
    return np.ascontiguousarray(large[y0 : y0 + height, x0 : x0 + width])


def _tissue_picture(width: int, height: int, rng: np.random.Generator) -> Array:
    """Draws a random tissue-like picture, BGR (height, width, 3) uint8: folds around a dark lumen, mottling, vessels
    and wet highlights."""

    def cloud(scale: float) -> Array:
        """A smooth random field (height, width) of rms 1, with spots some `scale` px wide."""
        small = rng.standard_normal((int(height / scale) + 4, int(width / scale) + 4)).astype(np.float32)
        large = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
        return np.asarray(large / max(float(large.std()), 1e-6))

    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    centre = np.array([width, height]) * rng.uniform(0.4, 0.6, 2)
    depth = np.hypot((x - centre[0]) / width, (y - centre[1]) / height)
    lumen = np.exp(-((depth / 0.16) ** 2))
    folds = np.sin(2 * np.pi * (depth * 5.0 + 0.25 * cloud(90.0))) * np.clip(depth * 2.5, 0, 1)
    light = 0.78 + 0.07 * folds + 0.05 * cloud(40.0) + 0.02 * cloud(6.0) - 0.5 * lumen
    pallor = cloud(60.0)
    red = 192.0 + 6.0 * cloud(70.0) + 5.0 * pallor
    green = 92.0 + 13.0 * pallor + 3.0 * cloud(50.0) + 2.0 * cloud(5.0)
    blue = 84.0 + 11.0 * pallor + 4.0 * cloud(60.0) + 2.0 * cloud(5.0)
    picture = np.dstack([blue, green, red]) * np.clip(light, 0.08, 1.0)[:, :, None]

    picture = picture * (1.0 - _vessels(width, height, rng)[:, :, None] * np.array([0.30, 0.38, 0.14]))

    for _ in range(22):  # wet highlights
        at, size = rng.uniform(0, [width, height]), rng.uniform(1.0, 4.0, 2)
        spot = np.exp(-0.5 * (((x - at[0]) / size[0]) ** 2 + ((y - at[1]) / size[1]) ** 2))
        picture = picture + (255.0 * 1.4 * spot)[:, :, None]
    return _to_levels(picture)


def _vessels(width: int, height: int, rng: np.random.Generator) -> Array:
    """Draws random blood vessels: (height, width), 1 on a vessel, 0 beside it, blurred. Each is a line whose direction
    wanders from step to step."""
    drawn = np.zeros((height, width), np.float32)
    for _ in range(14):
        at, heading = rng.uniform(0, [width, height]), rng.uniform(0, 2 * np.pi)
        path = [at]
        for _ in range(40):
            heading += rng.normal(0, 0.28)
            at = at + 9.0 * np.array([np.cos(heading), np.sin(heading)])
            path.append(at)
        points = np.rint(np.array(path) * 16).astype(np.int32)  # OpenCV's fixed point: 4 bits behind the point
        cv2.polylines(drawn, [points], False, 1.0, int(rng.integers(1, 4)), lineType=cv2.LINE_AA, shift=4)
    return np.asarray(cv2.GaussianBlur(drawn, (0, 0), 1.3))
