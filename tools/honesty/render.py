"""Frames with a marker on an instrument over a background, written as people's cameras write them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from tools.honesty.setup import Setup

Array = NDArray[np.float64]
Image = NDArray[np.uint8]
GLARE = (250.0, 250.0, 250.0)


@dataclass
class Film:
    codec: str = "MJPG"  # a four-character code of OpenCV's, or h264
    suffix: str = "mkv"
    crf: int = 23  # of h264: the lower, the better
    radius_px: float = 9.0
    colour: tuple[float, float, float] = (60.0, 190.0, 50.0)  # B, G, R
    textured: bool = True
    grain: float = 2.0  # grey levels of sensor noise
    glare: bool = False  # highlights that stay where they are in the picture
    covered: float = 0.0  # share of the frames in which something hides the marker
    twin: bool = False  # a second marker of the same colour that lies still
    times: bool = True  # frames.csv is written; else the first frame is at 0,
    motor_first_s: float = 0.0  # and the motor's log began this long before
    scale: float = 1.0  # of the frames against the rig


def background(rng: np.random.Generator, height: int, width: int, textured: bool) -> Array:
    """Tissue: red, with soft structure, vessels and an uneven light. Or a plain grey wall."""
    if not textured:
        return np.full((height, width, 3), [118.0, 120.0, 122.0])
    tint = np.array([80.0, 85.0, 165.0])
    out = np.ones((height, width, 3)) * tint
    for scale, amount in ((60, 22.0), (18, 12.0), (5, 5.0)):
        coarse = rng.normal(0, 1, (height // scale + 3, width // scale + 3))
        soft = cv2.resize(gaussian_filter(coarse, 0.7), (width, height), interpolation=cv2.INTER_CUBIC)
        out += (amount * soft / soft.std())[..., None] * np.array([0.7, 0.8, 1.0])
    for _ in range(25):
        points = np.cumsum(rng.normal(0, 14, (30, 2)), axis=0) + rng.uniform([0, 0], [width, height])
        cv2.polylines(out, [points.astype(np.int32)], False, (55.0, 45.0, 120.0), int(rng.integers(1, 4)), cv2.LINE_AA)
    y, x = np.mgrid[0:height, 0:width]
    light = np.exp(-(((x - width * 0.5) / width) ** 2 + ((y - height * 0.45) / height) ** 2) * 1.3)
    return np.asarray(np.clip(out * light[..., None], 0, 255))


def disc(
    canvas: NDArray[np.floating],
    at: tuple[float, float],
    radius: float,
    colour: tuple[float, float, float],
    shade: float = 0.0,
) -> None:
    """An antialiased disc; integers are pixels' middles. `shade` darkens one side of it."""
    u, v = at
    height, width = canvas.shape[:2]
    left, top = max(int(u - radius) - 3, 0), max(int(v - radius) - 3, 0)
    right, bottom = min(int(u + radius) + 5, width), min(int(v + radius) + 5, height)
    if right <= left or bottom <= top:
        return
    n = 5
    sub = (np.arange(n) + 0.5) / n - 0.5
    x = (np.arange(left, right)[:, None] + sub).ravel() - u
    y = (np.arange(top, bottom)[:, None] + sub).ravel() - v
    inside = (y[:, None] ** 2 + x[None, :] ** 2 <= radius**2).astype(float)
    share = inside.reshape(bottom - top, n, right - left, n).mean(axis=(1, 3))[..., None].astype(canvas.dtype)
    dx = (np.arange(left, right) - u) / radius
    light = (1.0 - shade * dx)[None, :, None]
    canvas[top:bottom, left:right] = (1 - share) * canvas[top:bottom, left:right] + share * np.asarray(colour) * light


class _OpenCv:
    def __init__(self, film: Film, path: Path, rate: float, size: tuple[int, int]) -> None:
        self.writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*film.codec), rate, size)
        if not self.writer.isOpened():
            raise RuntimeError(f"this OpenCV writes no {film.codec}")

    def write(self, frame: Image) -> None:
        self.writer.write(frame)

    def close(self) -> None:
        self.writer.release()


class _X264:
    """H.264 as capture programs write it: 4:2:0, key frames seconds apart, a constant quality."""

    def __init__(self, film: Film, path: Path, rate: float, size: tuple[int, int]) -> None:
        import av  # OpenCV's wheels have no encoder for H.264

        self.file = av.open(str(path), "w")
        options = {"crf": str(film.crf), "preset": "veryfast", "g": str(round(2 * rate)), "threads": "1"}
        self.stream = self.file.add_stream("libx264", rate=round(rate), options=options)
        self.stream.width, self.stream.height, self.stream.pix_fmt = *size, "yuv420p"

    def write(self, frame: Image) -> None:
        import av

        self.file.mux(self.stream.encode(av.VideoFrame.from_ndarray(frame, format="bgr24")))

    def close(self) -> None:
        self.file.mux(self.stream.encode())
        self.file.close()


GRAINS = 6  # patterns of sensor noise that take turns


def write_video(setup: Setup, path: Path, scene: Array, arrival: Array, uv: Array) -> None:
    film, rng, camera, image = setup.video, setup.rng, setup.camera, setup.image
    assert isinstance(film, Film) and camera is not None and image is not None
    height, width = round(camera.height * film.scale), round(camera.width * film.scale)
    radius = film.radius_px * film.scale
    wall = background(rng, height, width, film.textured)
    if film.twin:
        disc(wall, (0.12 * width, 0.15 * height), radius, film.colour)
    spots = [(float(x), float(y), float(r)) for x, y, r in rng.uniform([0, 0, 1.5], [width, height, 4.0], (60, 3))]
    for x, y, r in spots if film.glare else []:
        disc(wall, (x, y), r, GLARE)
    grain = [rng.normal(0, film.grain, (height, width, 1)).astype(np.float32) for _ in range(GRAINS)]
    still = [_bytes(wall + g) for g in grain]
    hidden = _covered(rng, len(uv), film.covered)
    rate = camera.frame_rate
    kind = _X264 if film.codec == "h264" else _OpenCv
    writer = kind(film, path / f"video.{film.suffix}", rate, (width, height))
    for k, (u, v) in enumerate(((uv + 0.5) * film.scale - 0.5).tolist()):
        reach = int(3.5 * radius) + 4
        left, top = max(int(u) - reach, 0), max(int(v) - reach, 0)
        box = slice(top, int(v) + reach), slice(left, int(u) + reach)
        patch, at = wall[box].copy(), (u - left, v - top)
        disc(patch, at, radius, film.colour, 0.12)
        if film.glare:
            for x, y, r in spots:
                disc(patch, (x - left, y - top), r, GLARE)
            disc(patch, (at[0] + 0.4 * radius, at[1] - 0.35 * radius), 1.6, GLARE)
        if hidden[k]:
            disc(patch, (at[0] + 4, at[1] + 3), 2.2 * radius, (30.0, 28.0, 60.0))
        frame = still[k % GRAINS].copy()
        frame[box] = _bytes(patch + grain[k % GRAINS][box])
        writer.write(frame)
    writer.close()
    if not film.times:
        image.offset_s = -float(arrival[0]) - film.motor_first_s
    else:
        stamps = image.stamp(arrival, rng) if image.stamp else arrival
        rows = "".join(f"{k},{t:.6f}\n" for k, t in enumerate(stamps.tolist()))
        (path / "frames.csv").write_text("frame,t_s\n" + rows)


def _bytes(picture: NDArray[np.floating]) -> Image:
    return np.clip(picture + 0.5, 0, 255).astype(np.uint8)


def _covered(rng: np.random.Generator, n: int, share: float) -> NDArray[np.bool_]:
    hidden = np.zeros(n, bool)
    while hidden.mean() < share:
        at = int(rng.integers(0, n))
        hidden[at : at + int(rng.integers(10, 40))] = True
    return hidden
