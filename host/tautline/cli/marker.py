"""taut marker SOURCE"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import click
import cv2
import numpy as np

from tautline.cli._common import emit, json_option, progress_bar
from tautline.cli._outputs import Output, check_no_input
from tautline.errors import TautError
from tautline.recording import COLOUR_FILE, REGION_FILE
from tautline.vision.camera import VideoCamera, read_picture, sample_video
from tautline.vision.colour import LARGEST_PX, MarkerColour, pick
from tautline.vision.marker import MarkerTracker, find_colour
from tautline.vision.patch import USUAL_PX, PatchTracker
from tautline.vision.region import Region
from tautline.vision.ros_camera import RosCamera, is_topic
from tautline.vision.sighting import Sighting

_STILL_FRAMES = 60  # tolerance: first frames, tracked to say how well the marker can be seen
_SPREAD = 12  # tolerance: frames from all over a video, in which the colour is looked for
_SEARCHED_LINES = 480  # tolerance: least height of a picture in which the colour is looked for, px
_WARM_UP = 15  # prior: frames that a camera needs to find its exposure


class _Square(click.ParamType):  # type: ignore[type-arg]
    """A type of options: a square in a picture, written U,V or U,V,SIDE."""

    name = "U,V[,SIDE]"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float, float]:
        """Parses the option's value: returns the square's middle u, v and its side, px, without SIDE the usual one. A
        usage error where the value is not two or three numbers."""
        try:
            u, v, *side = (float(part) for part in str(value).split(","))
            (long,) = side or (USUAL_PX,)
        except ValueError:
            self.fail(
                f"'{value}' is no square of the picture: write U,V or U,V,SIDE in px, as in 312,240,36", param, ctx
            )
        return u, v, long


class _Place(click.ParamType):  # type: ignore[type-arg]
    """A type of options: a place in a picture, written U,V."""

    name = "U,V"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Parses the option's value: returns the place u, v, px. A usage error where the value is not two numbers."""
        try:
            u, v = (float(part) for part in str(value).split(","))
        except ValueError:
            self.fail(f"'{value}' is no place in the picture: write U,V in px, as in 312,240", param, ctx)
        return u, v


@click.command("marker")
@click.argument("source")
@click.option(
    "--at", type=_Place(), help="Where the marker is in the first picture, px. Default: what stands out most."
)
@click.option(
    "--region",
    type=_Square(),
    help="No marker: follow this place of the bare instrument, a square of SIDE px around U,V in the first picture, at "
    f"its tip; SIDE is {USUAL_PX:g} if left out. The file is then {REGION_FILE}.",
)
@click.option(
    "--out",
    type=Output(file=True),
    help=f"File for the colour. Default: {COLOUR_FILE} where it is looked for: beside a video, where it is used by "
    "itself, else here, where --colour has it by default.",
)
@json_option
def command(
    source: str,
    at: tuple[float, float] | None,
    region: tuple[float, float, float] | None,
    out: Path | None,
    as_json: bool,
) -> None:
    """Pick the marker's colour, or the place of a bare instrument, once.

    SOURCE is a picture, a video, a camera (its number or device) or a stream's address. Beside --out goes a picture of
    what was found, as a PNG.
    """
    if region is not None:
        if at is not None:
            raise click.UsageError("--at is a marker's place, --region one without a marker: give one of both")
        _pick_region(source, region, out or _file_beside(source, REGION_FILE), as_json)
        return
    out = out or _file_beside(source, COLOUR_FILE)
    shown = out.with_suffix(".png")
    for written in (out, shown):
        check_no_input(written, Path(source))
    pictures, spread = _pictures(source)
    colour = pick(pictures[0], at) if at or len(spread) == 1 else _find_colour(spread)
    if colour is None:
        raise TautError(
            f"{source}: no marker stands out by its colour: show where it is in the first picture with --at U,V"
        )
    seen = _track(MarkerTracker(colour), pictures, "how well the marker is seen")
    valid = [s for s in seen if s.valid]
    if not valid:
        raise TautError(
            f"{source}: a colour was found at {_place_in_words(colour)} but no marker: {seen[0].lost}; try --at U,V"
        )
    first = seen.index(valid[0])
    _save(colour, out)
    cv2.imwrite(str(shown), _marker_picture(pictures[first], colour, seen[first]))
    result = {
        "file": out,
        "picture": shown,
        "at_px": [valid[0].u_px, valid[0].v_px],
        "diameter_px": valid[0].diameter_px,
        "colour_bgr": colour.colour,
        "sigma_px": _median_sigma_px(valid),
        "frames": len(seen),
        "frames_seen": len(valid),
    }
    text = _marker_in_words(colour, valid[0], _median_sigma_px(valid))
    if len(seen) > 1:
        text += f"; seen in {len(valid)} of the first {len(seen)} frames"
    emit(result, as_json, f"{text}\n{out} holds its colour; look at {shown} to see that it is the right one")


def _track(tracker: MarkerTracker | PatchTracker, pictures: Sequence[np.ndarray], doing: str) -> list[Sighting]:
    """Runs a tracker over BGR pictures (height, width, 3), one after the other, and returns a sighting for each. Shows
    a progress bar with the text `doing`."""
    seen = []
    with progress_bar("tracking") as progress:
        for k, picture in enumerate(pictures):
            progress(k / len(pictures), doing)
            seen.append(tracker.track(np.asarray(picture, dtype=np.uint8)))
    return seen


def _median_sigma_px(sightings: Sequence[Sighting]) -> float:
    """The median standard deviation of the sightings' positions, px. sightings: valid ones, at least one."""
    return float(np.median([s.sigma_px for s in sightings]))


def _marker_in_words(colour: MarkerColour, sighting: Sighting, sigma_px: float) -> str:
    """A text on the marker: its position and diameter by a sighting, its colour, and sigma_px, the usual standard
    deviation of a position."""
    blue, green, red = (round(level) for level in colour.colour)
    return (
        f"marker at {sighting.u_px:.1f}, {sighting.v_px:.1f} px, {sighting.diameter_px:.1f} px wide, "
        f"red {red} green {green} blue {blue}, each position good to {sigma_px:.3f} px"
    )


def _pick_region(source: str, square: tuple[float, float, float], out: Path, as_json: bool) -> None:
    """Does the command's work with --region: takes a square (u, v, side), px, of the source's first picture as the
    region to follow, tries whether it can be followed in the first pictures (TautError if in none), writes the region
    and pictures of it to `out` and beside it, and prints the result."""
    shown = out.with_suffix(".look.png")
    for written in (out, out.with_suffix(".png"), shown):  # the second is written by Region.save
        check_no_input(written, Path(source))
    pictures, _ = _pictures(source)
    region = Region(at=square[:2], side_px=square[2], picture=np.asarray(pictures[0], dtype=np.uint8))
    seen = _track(region.tracker(), pictures, "how well the place is followed")
    valid = [s for s in seen if s.valid]
    if not valid:
        raise TautError(
            f"{source}: the place cannot be followed from its first picture on: show another, or a larger one"
        )
    _save(region, out)
    cv2.imwrite(str(shown), _region_picture(pictures[0], region))
    sigma = _median_sigma_px(valid)
    result = {
        "file": out, "picture": shown, "at_px": region.at, "side_px": region.side_px, "sigma_px": sigma,
        "frames": len(seen), "frames_seen": len(valid),
    }  # fmt: skip
    text = (
        f"a square of {region.side_px:g} px around {region.at[0]:g}, {region.at[1]:g} px, followed in {len(valid)} of "
        f"the first {len(seen)} frames, each position good to {sigma:.3f} px\n{out} holds it; look at {shown} to see "
        "that it lies on the instrument's tip"
    )
    emit(result, as_json, text)


def _save(what: MarkerColour | Region, out: Path) -> None:
    """Writes a colour or a region to the file `out`, whose folder is made if it is missing. TautError where it cannot
    be written."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        what.save(out)
    except OSError as error:
        raise TautError(f"{out}: cannot be written ({error.strerror}): name another file with --out") from error


def _region_picture(picture: np.ndarray, region: Region) -> np.ndarray:
    """A BGR picture for a person to check the region by: on the left `picture` with the region's square drawn in, on
    the right the region enlarged to the picture's height."""
    drawn = picture.copy()
    corners = np.rint(np.array(region.at) + 0.5 * region.side_px * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]))
    cv2.polylines(drawn, [corners.astype(np.int32)], True, (255, 255, 255), 1, cv2.LINE_AA)
    side = round(region.side_px)
    large = cv2.getRectSubPix(picture, (side, side), region.at)
    return np.hstack([drawn, cv2.resize(large, (picture.shape[0], picture.shape[0]), interpolation=cv2.INTER_NEAREST)])


def _file_beside(source: str, name: str) -> Path:
    """The default path of the file `name`, at which other commands look for it: beside the source if that is a video's
    file, else in the working directory."""
    video = Path(source)
    return (video.parent if video.is_file() and not cv2.haveImageReader(source) else Path()) / name


def _pictures(source: str) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Two lists of pictures of a source, BGR (height, width, 3) uint8. The first has up to _STILL_FRAMES consecutive
    frames from its beginning, in which tracking is tried. The second, in which the colour is looked for, has frames
    from all over a video, or some of the first list for a camera. A picture file is the only element of both. A camera
    that is named by its number first gets time to find its exposure. TautError where there are no frames."""
    if source.isdigit() and not Path(source).exists():
        with VideoCamera(int(source)) as camera:
            for _ in range(_WARM_UP):
                camera.read()
            pictures = [read[0] for _ in range(_STILL_FRAMES) if (read := camera.read())]
        return pictures, pictures[:: _STILL_FRAMES // 10]
    if (picture := read_picture(source)) is not None:
        return [picture], [picture]
    with RosCamera(source) if is_topic(source) else VideoCamera(source) as camera:
        pictures = [read[0] for _ in range(_STILL_FRAMES) if (read := camera.read())]
        is_file = camera.frames is not None
    if not pictures:
        raise TautError(f"{source}: holds no frames")
    return pictures, sample_video(Path(source), _SPREAD) if is_file else pictures[:: _STILL_FRAMES // 10]


def _find_colour(pictures: list[np.ndarray]) -> MarkerColour | None:
    """The marker's colour in BGR pictures of one scene; None where no colour stands out. Large pictures are searched
    shrunk, which is faster: the marker found there is tracked at full size, and its colour picked anew where it is
    seen. Where that fails, as for a marker of a few pixels, the pictures are searched at full size."""
    shrink = min(pictures[0].shape[:2]) // _SEARCHED_LINES  # the factor by which pictures can be shrunk
    if shrink < 2:
        return find_colour(pictures)
    small = [cv2.resize(p, None, fx=1 / shrink, fy=1 / shrink, interpolation=cv2.INTER_AREA) for p in pictures]
    coarse = find_colour(small)
    if coarse is None:
        return find_colour(pictures)  # a marker of a few pixels
    tracker = MarkerTracker(replace(coarse, diameter_px=min(coarse.diameter_px * shrink, LARGEST_PX)))
    for picture in pictures:
        tracker.reset()
        seen = tracker.track(picture)
        if seen.valid:
            with suppress(TautError):
                return pick(picture, (seen.u_px, seen.v_px))
    return find_colour(pictures)


def _place_in_words(colour: MarkerColour) -> str:
    """The place in the picture at which a colour was picked, as text."""
    return f"{colour.at[0]:.0f}, {colour.at[1]:.0f} px"


def _marker_picture(picture: np.ndarray, colour: MarkerColour, sighting: Sighting) -> np.ndarray:
    """A BGR picture for a person to check the colour by: on the left `picture` with a ring and four lines around the
    marker, on the right, in grey, how much each pixel has the marker's colour, with the marker enlarged in its corner
    if there is room."""
    ringed = picture.copy()
    # OpenCV draws at fractions of a pixel if coordinates are fixed-point numbers with 4 fractional bits: times 16.
    centre = np.rint([sighting.u_px * 16, sighting.v_px * 16]).astype(int).tolist()
    cv2.circle(ringed, centre, round((0.5 * sighting.diameter_px + 4) * 16), (255, 255, 255), 1, cv2.LINE_AA, 4)
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        reach = np.array([0.5 * sighting.diameter_px + 6, 0.5 * sighting.diameter_px + 18]) * 16
        near, far = ([round(centre[0] + dx * r), round(centre[1] + dy * r)] for r in reach)
        cv2.line(ringed, near, far, (255, 255, 255), 1, cv2.LINE_AA, 4)
    grey = np.clip(255 * colour.membership(picture), 0, 255).astype(np.uint8)
    member = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    size = max(8, round(2.5 * sighting.diameter_px))
    cut = cv2.getRectSubPix(picture, (size, size), (sighting.u_px, sighting.v_px))
    side = min(180, min(picture.shape[:2]) // 2)
    if side >= 16:
        enlarged = cv2.resize(cut, (side, side), interpolation=cv2.INTER_NEAREST)
        enlarged = cv2.copyMakeBorder(enlarged[2:-2, 2:-2], 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        member[:side, :side] = enlarged
    return np.hstack([ringed, member])
