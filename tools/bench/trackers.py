"""Our marker tracker beside OpenCV's blob detector and ArUco and ViSP's blob tracker, in one run on one scene.

The scene: 720 x 576, tissue, the instrument, a still marker of 20 px, at several places and so at several phases of the
pixels. The blob trackers get the best picture that a colour marker can give them, its membership as grey levels, made
before the clock starts; ours starts from the colour picture. ArUco gets a printed marker in the same place and light.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tautline.simulated.endoscope import Endoscope, Look
from tautline.simulated.instrument import reference_rig
from tautline.vision.colour import MarkerColour, pick
from tautline.vision.marker import MarkerTracker

Array = np.ndarray
Find = Callable[[Array], "tuple[float, float] | None"]

STATES_DEG = (-45.3, -20.0, 0.4, 17.1, 33.8)
REGION_PX = 48  # side of the region where a marker of 20 px is looked for, when its place is known
ARUCO_PX = (20, 26, 32)  # sides to try: the smallest that is found is compared


@dataclass(frozen=True)
class Shot:
    """Frames of a marker that stays where it is, and where that is."""

    place: Array  # (2,) px
    frames: list[Array]


@dataclass(frozen=True)
class Score:
    name: str
    frame_us: float  # median
    noise_px: float  # rms about the mean at each place, per coordinate
    error_px: float  # rms about the truth, per coordinate
    detected: float  # share of the frames

    @property
    def frames_per_s(self) -> float:
        return 1e6 / self.frame_us


def run(frames: int = 40, progress: Callable[[float, str], None] | None = None) -> tuple[list[Score], list[str]]:
    """Scores, and notes on what is not in them."""
    say = progress or (lambda fraction, text: None)
    say(0.0, "drawing frames")
    scope = Endoscope(reference_rig(), seed=7)
    shots = [Shot(scope.position(c)[0], [scope.frame(c) for _ in range(frames)]) for c in STATES_DEG]
    colour = pick(shots[0].frames[0], _pair(shots[0].place))
    grey = [Shot(shot.place, [_grey(colour, frame) for frame in shot.frames]) for shot in shots]
    notes: list[str] = []

    scores = []
    say(0.2, "ours")
    scores.append(_score("tautline, following", shots, lambda shot: _ours(colour)))
    scores.append(_score("tautline, whole frame", shots, lambda shot: _ours(colour, afresh=True)))
    say(0.3, "OpenCV's SimpleBlobDetector")
    scores.append(
        _score("OpenCV SimpleBlobDetector, region", grey, lambda shot: _in_region(shot, _blob_detector(shot.place)))
    )
    scores.append(_score("OpenCV SimpleBlobDetector, whole frame", grey, lambda shot: _blob_detector(shot.place)))
    say(0.6, "OpenCV's ArUco")
    for side in ARUCO_PX:
        printed = list(_aruco_shots(frames, side))
        whole = _score(f"OpenCV ArUco of {side} px, whole frame", printed, lambda shot: _aruco())
        if whole.detected >= 0.9:
            scores.append(
                _score(f"OpenCV ArUco of {side} px, region", printed, lambda shot: _in_region(shot, _aruco()))
            )
            scores.append(whole)
            break
        notes.append(f"ArUco of {side} px is found in {100 * whole.detected:.0f} % of the frames only")
    say(0.8, "ViSP's vpDot2")
    visp = _visp(shots, grey)
    if isinstance(visp, str):
        notes.append(visp)
    else:
        scores += visp
    return scores, notes


def _pair(place: Array) -> tuple[float, float]:
    return float(place[0]), float(place[1])


def _grey(colour: MarkerColour, frame: Array) -> Array:
    return np.clip(40.0 + 180.0 * colour.membership(frame), 0, 255).astype(np.uint8)


def _score(name: str, shots: list[Shot], make: Callable[[Shot], Find]) -> Score:
    times, places = [], []
    for shot in shots:
        find = make(shot)
        find(shot.frames[0])  # warm, and where it has to be found first
        here = []
        for frame in shot.frames:
            start = time.perf_counter_ns()
            place = find(frame)
            times.append(time.perf_counter_ns() - start)
            here.append(place or (np.nan, np.nan))
        places.append(np.array(here))
    return _summary(name, times, shots, places)


def _summary(name: str, times_ns: list[int], shots: list[Shot], places: list[Array]) -> Score:
    seen = [here[np.isfinite(here[:, 0])] for here in places]
    noise = np.concatenate([here - here.mean(axis=0) for here in seen if len(here)] or [np.full((1, 2), np.nan)])
    error = np.concatenate([here - shot.place for here, shot in zip(seen, shots, strict=True)])
    return Score(
        name,
        float(np.median(times_ns)) / 1e3,
        float(np.sqrt(np.mean(noise**2))),
        float(np.sqrt(np.mean(error**2))) if len(error) else float("nan"),
        sum(map(len, seen)) / sum(map(len, places)),
    )


def _ours(colour: MarkerColour, afresh: bool = False) -> Find:
    tracker = MarkerTracker(colour)

    def find(frame: Array) -> tuple[float, float] | None:
        if afresh:
            tracker.reset()
        seen = tracker.track(frame)
        return (seen.u_px, seen.v_px) if seen.valid else None

    return find


def _blob_detector(near: Array) -> Find:
    parameters = cv2.SimpleBlobDetector_Params()
    parameters.filterByColor, parameters.blobColor = True, 255
    parameters.filterByArea, parameters.minArea, parameters.maxArea = True, 80, 1500
    parameters.filterByCircularity, parameters.minCircularity = True, 0.7
    parameters.filterByConvexity = parameters.filterByInertia = False
    detector = cv2.SimpleBlobDetector_create(parameters)

    def find(grey: Array) -> tuple[float, float] | None:
        blobs = [blob.pt for blob in detector.detect(grey)]
        return min(blobs, key=lambda at: np.hypot(at[0] - near[0], at[1] - near[1]), default=None)

    return find


def _in_region(shot: Shot, find: Find) -> Find:
    half = REGION_PX // 2
    u, v = round(float(shot.place[0])), round(float(shot.place[1]))
    x0, y0 = max(0, u - half), max(0, v - half)

    def in_region(frame: Array) -> tuple[float, float] | None:
        at = find(np.ascontiguousarray(frame[y0 : v + half, x0 : u + half]))
        return None if at is None else (at[0] + x0, at[1] + y0)

    return in_region


def _aruco_shots(frames: int, side_px: int) -> Iterator[Shot]:
    """A printed marker, with the white rim that it needs, in place of the coloured one."""
    look = Look()
    rng = np.random.default_rng(11)
    bare = Endoscope(reference_rig(), Look(marker_radius_mm=1e-6, noise=0.0, glint=0.0), seed=7)
    cell, cells, rim = 48, 6, 1
    printed = np.full(((cells + 2 * rim) * cell,) * 2, 255, np.uint8)
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    printed[rim * cell : -rim * cell, rim * cell : -rim * cell] = cv2.aruco.generateImageMarker(
        dictionary, 3, cells * cell
    )
    fine = 8  # drawn so many times larger, then averaged: its centre is exact
    for c in STATES_DEG:
        place = bare.position(c)[0]
        frame = bare.frame(c)
        reach = side_px
        x0, y0 = (np.floor(place) - reach).astype(int)
        size = 2 * reach + 1
        scale = side_px * fine / (cells * cell)
        middle = (place - [x0, y0] + 0.5) * fine - 0.5
        to_patch = np.array([[scale, 0, middle[0]], [0, scale, middle[1]]])
        to_patch[:, 2] -= scale * (printed.shape[0] - 1) / 2
        large = cv2.warpAffine(np.dstack([printed, np.full_like(printed, 255)]), to_patch, (size * fine, size * fine))
        small = cv2.resize(large.astype(np.float32), (size, size), interpolation=cv2.INTER_AREA)
        level, cover = cv2.GaussianBlur(small, (0, 0), look.blur_px).transpose(2, 0, 1)[..., None]
        patch = frame[y0 : y0 + size, x0 : x0 + size].astype(np.float32)
        picture = frame.astype(np.float32)
        # Paper in the endoscope's light: white at 200 levels, black at 20.
        ink = cover / 255.0 * 20.0 + level / 255.0 * 180.0
        picture[y0 : y0 + size, x0 : x0 + size] = patch * (1.0 - cover / 255.0) + ink
        noisy = (picture + rng.normal(0.0, look.noise, picture.shape).astype(np.float32) for _ in range(frames))
        yield Shot(place, [np.clip(np.rint(noise), 0, 255).astype(np.uint8) for noise in noisy])


def _aruco() -> Find:
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.cornerRefinementWinSize = 3
    parameters.minMarkerPerimeterRate = 0.02
    detector = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50), parameters)

    def find(frame: Array) -> tuple[float, float] | None:
        corners, ids, _ = detector.detectMarkers(frame)
        if ids is None:
            return None
        for corner, marker in zip(corners, ids.ravel(), strict=True):
            if marker == 3:
                return _pair(corner[0].mean(axis=0))
        return None

    return find


def _visp(shots: list[Shot], grey: list[Shot]) -> list[Score] | str:
    """ViSP's scores, without and with the making of its grey picture (by OpenCV), or why there are none."""
    compiler = shutil.which("c++")
    if compiler is None:
        return "ViSP: not compared, there is no C++ compiler"
    with tempfile.TemporaryDirectory() as folder:
        program = Path(folder) / "visp_dot"
        source = Path(__file__).with_name("visp_dot.cpp")
        built = subprocess.run(
            [compiler, "-O3", "-std=c++17", str(source), "-o", str(program), "-lvisp_blob", "-lvisp_core"],
            capture_output=True,
            text=True,
        )
        if built.returncode:
            missing = "visp3/" in built.stderr
            return (
                "ViSP: not compared; install libvisp-blob-dev to have it" if missing else f"ViSP: {built.stderr[:200]}"
            )
        times: list[int] = []
        places = []
        for shot in grey:
            height, width = shot.frames[0].shape
            arguments = [width, height, len(shot.frames), *np.rint(shot.place).astype(int)]
            pixels = b"".join(frame.tobytes() for frame in shot.frames)
            ran = subprocess.run([program, *map(str, arguments)], input=pixels, capture_output=True, check=True)
            rows = [line.split() for line in ran.stdout.decode().splitlines()]
            places.append(
                np.array([[float(x) for x in row[:2]] if len(row) == 3 else [np.nan, np.nan] for row in rows])
            )
            times += [int(row[2]) for row in rows if len(row) == 3]
        if not times:
            return "ViSP: its blob tracker lost the marker in every frame"
        convert = _score(
            "", shots, lambda shot: lambda frame: (float(cv2.cvtColor(frame, cv2.COLOR_BGR2GRAY)[0, 0]), 0.0)
        )
        with_grey = [ns + round(1e3 * convert.frame_us) for ns in times]
        return [
            _summary("ViSP vpDot2, grey picture given", times, grey, places),
            _summary("ViSP vpDot2, grey picture made", with_grey, grey, places),
        ]
