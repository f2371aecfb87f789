"""taut rig [--board PICTURES --motion RECORDING] --out rig.toml"""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from tautline.cli._common import NumberRange, emit, json_option, log, progress_bar, warn
from tautline.cli._outputs import Output, check_no_input
from tautline.errors import TautError
from tautline.recording import load
from tautline.rig import ANGLE, FORMAT, MARKER, Coarse, Rig, Sensor
from tautline.rigging import (
    DICTIONARIES,
    Board,
    HandEyeFit,
    Intrinsics,
    Places,
    fit_coarse_law,
    hand_eye,
    intrinsics,
    places_of,
    read_known_angles,
)
from tautline.rigging import keys as rig_keys
from tautline.rigging.picture import picture
from tautline.vision.camera import read_picture, sample_video
from tautline.vision.marker import with_marker

_VIEWS = 60  # tolerance: frames of a video; enough to see a board that is moved slowly from everywhere
_BY_MOTION = ("coarse", "hand_eye")  # the sections of rig.toml that --motion measures


class _Squares(click.ParamType):  # type: ignore[type-arg]
    """A type of options: a board's numbers of squares, written ACROSSxDOWN."""

    name = "ACROSSxDOWN"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Parses the option's value: returns the numbers of squares across and down. A usage error where these are not
        two whole numbers above 0."""
        try:
            across, down = (int(part) for part in str(value).lower().split("x"))
            if min(across, down) < 1:
                raise ValueError
        except ValueError:
            self.fail(f"'{value}' are no squares: write how many across and down, as in 8x6", param, ctx)
        return across, down


@click.command("rig")
@click.option(
    "--out",
    type=Output(file=True),
    default=Path("rig.toml"),
    show_default=True,
    help="The file to write; one that is there is kept unless --from names it.",
)
@click.option(
    "--from", "start", type=click.Path(path_type=Path), help="A rig.toml to start from: what it says is not asked."
)
@click.option("--set", "given", multiple=True, metavar="KEY=VALUE", help="A key's value, as in actuator.range=-5,5.")
@click.option("--sensor", type=click.Choice([MARKER, ANGLE]), help="What sees the tip: a camera, or an angle sensor.")
@click.option("--board", multiple=True, type=click.Path(path_type=Path), help="A video or pictures of a ChArUco board.")
@click.option("--squares", type=_Squares(), help="Of the board, across and down.")
@click.option("--square-mm", type=NumberRange(0.0, min_open=True), help="A square's side, measured on the print.")
@click.option("--marker-mm", type=NumberRange(0.0, min_open=True), help="The side of a marker in a square.")
@click.option("--dictionary", type=click.Choice(sorted(DICTIONARIES)), default="4X4_50", show_default=True)
@click.option("--motion", type=click.Path(path_type=Path), help="A recording in which the tip rests at known angles.")
@click.option(
    "--angles",
    type=click.Path(path_type=Path),
    help="CSV with t_s,c_deg: when the tip came to rest for a second, and at which angle.",
)
@click.option(
    "--angle-sigma",
    type=NumberRange(0.0),
    default=0.5,
    show_default=True,
    help="How exactly the angles are known, deg.",
)
@json_option
def command(
    out: Path, start: Path | None, given: tuple[str, ...], sensor: Sensor | None, board: tuple[Path, ...],
    squares: tuple[int, int] | None, square_mm: float | None, marker_mm: float | None, dictionary: str,
    motion: Path | None, angles: Path | None, angle_sigma: float, as_json: bool,
) -> None:  # fmt: skip
    """Makes a rig.toml: measures what a board and a motion show, and asks for the rest.

    --board gives the camera's intrinsics, --motion where it looks from and the coarse law. In a terminal each key that
    is left is asked for; elsewhere it is named.
    """
    if out.exists() and (start is None or start.resolve() != out.resolve()):
        raise TautError(f"{out}: is there already: go on from it with --from {out}, or name another with --out")
    if motion is None and angles is not None:
        raise click.UsageError("--angles says how the tip was bent in --motion: name the recording")
    shown = out.with_suffix(".png")
    if motion is not None:
        check_no_input(shown, motion, *board)
    if not board and (squares or square_mm is not None or marker_mm is not None):
        raise click.UsageError("--squares, --square-mm and --marker-mm are of a --board: name its pictures or video")
    # The document grows in steps: --from and --set, then the camera from --board, then its pose from --motion.
    document = _first_document(start, given)
    if sensor == ANGLE and (board or motion):
        raise click.UsageError("--board and --motion are for a camera: leave --sensor angle out")
    if sensor is None:
        by_camera = bool(board or motion) or "camera" in document
        sensor = MARKER if by_camera else ANGLE if "angle" in document else _ask_for_sensor()
    result: dict[str, Any] = {"file": out, "sensor": sensor}
    lines: list[str] = []
    if board:
        seen = _fit_intrinsics(board, squares, square_mm, marker_mm, dictionary)
        document["camera"] = {**document.get("camera", {}), **seen.camera()}
        result["camera"] = {"sigma": seen.sigma, "rms_px": seen.rms_px, "views": seen.views, "of": seen.of}
        lines.append(seen.in_words())
    if motion is not None:
        # What the motion measures replaces what was there; the measurement needs all other keys before.
        document = {name: section for name, section in document.items() if name not in _BY_MOTION}
        _ask_for_keys(document, sensor, without=_BY_MOTION)
        places, found, law, left_deg = _measure_by_known_angles(document, motion, angles, angle_sigma)
        document["coarse"] = _rounded_section(asdict(law))
        document["hand_eye"] = _rounded_section(asdict(found.hand_eye))
        lines += [found.in_words(), _coarse_in_words(law, left_deg, document["actuator"]["unit"])]
        result["hand_eye"] = _hand_eye_result(found, places)
    _ask_for_keys(document, sensor)
    if sensor == ANGLE:
        document.setdefault("angle", {})  # all of its keys may be left out
    rig = Rig.from_document(document, str(out))
    rig.save(out)
    if motion is not None:
        result["picture"] = shown
        picture(rig, places).savefig(shown, dpi=120)
        lines.append(f"look at {shown}: the curve passes through the marker's places, angles rise where they should")
    emit(result, as_json, "\n".join([*lines, f"{out} is whole: taut calibrate RECORDING --rig {out}"]))


def _coarse_in_words(law: Coarse, left_deg: float, unit: str) -> str:
    """A text on the coarse law that was measured, c = gain q + offset. left_deg: rms of its residual, deg, backlash
    included; unit: of q."""
    return (
        f"coarse: gain {law.gain:.4g} deg per {unit}, offset {law.offset:.3g} deg; "
        f"{left_deg:.2g} deg are left, play among it"
    )


def _hand_eye_result(found: HandEyeFit, places: Places) -> dict[str, Any]:
    """The accuracy of a hand-eye fit, for the command's result: `sigma` of rx ry rz (deg) and x y z (mm); `left_px`,
    the rms residual per coordinate; `strays`, the rms of all residuals over their stated sigmas;
    `measured_angle_sigma_deg`, the lowest and the highest sigma of an angle that is measured with this transform; and
    `places`, the number of places that it was fitted to."""
    return {
        "sigma": found.sigma,
        "left_px": found.left_px,
        "strays": found.strays,
        "measured_angle_sigma_deg": [found.measures_deg.min(), found.measures_deg.max()],
        "places": len(places.c_deg),
    }


def _first_document(start: Path | None, given: tuple[str, ...]) -> rig_keys.Document:
    """The rig.toml's document (sections of keys) to begin with: that of the file `start`, or for None one without keys,
    with the keys set that `given` names, each as KEY=VALUE (of --set). TautError for an unknown key or a value that it
    does not take."""
    document: rig_keys.Document = Rig.load(start).to_document() if start is not None else {"format": FORMAT}
    for text in given:
        name, equals, value = text.partition("=")
        if not equals:
            raise TautError(f"--set {text}: write KEY=VALUE, as in actuator.range=-5,5")
        rig_keys.put(document, *rig_keys.find_key(name.strip()), value)
    return document


def _ask_for_sensor() -> Sensor:
    """The rig's sensor: asks the user in a terminal; without a terminal MARKER, a camera that sees a marker."""
    if not sys.stdin.isatty():
        return MARKER
    return (
        MARKER
        if click.confirm("Does a camera see a marker on the tip (else an angle sensor)?", True, err=True)
        else ANGLE
    )


def _ask_for_keys(document: rig_keys.Document, sensor: Sensor, without: tuple[str, ...] = ()) -> None:
    """Adds to a rig.toml's document each required key that it lacks, by asking the user in a terminal, again until the
    answer fits. Without a terminal raises a TautError that names all missing keys. without: sections that may lack
    keys."""
    left = [(section, key) for section, key in rig_keys.missing(document, sensor) if section.name not in without]
    if left and not sys.stdin.isatty():
        raise TautError(
            "not known yet, with a value as an example"
            + (" (--board measures the camera, --motion its place): " if sensor == MARKER else ": ")
            + " ".join(f"--set {s.name}.{k.name}={_without_spaces(rig_keys.example(k))}" for s, k in left)
        )
    section_said = ""
    for section, key in left:
        if section.name != section_said:
            log(f"\n[{section.name}] {section.says}")
            section_said = section.name
        log(f"  {key.says}" + (f" (if it is wrong: {key.wrong})" if key.wrong else ""))
        while True:
            try:
                text = click.prompt(f"  {section.name}.{key.name}, such as {rig_keys.example(key)}", err=True)
                rig_keys.put(document, section, key, text)
                break
            except TautError as error:
                log(f"  {error}")


def _without_spaces(text: str) -> str:
    """The text without its spaces, so that it is one word in a shell."""
    return text.replace(" ", "")


def _fit_intrinsics(
    sources: tuple[Path, ...],
    squares: tuple[int, int] | None,
    square_mm: float | None,
    marker_mm: float | None,
    dictionary: str,
) -> Intrinsics:
    """Fits the camera's intrinsics to pictures or videos of a ChArUco board and prints a warning for each doubt about
    them. squares: numbers across and down; square_mm, marker_mm: sides of a square and of the marker in it; dictionary:
    of the markers. TautError where one of squares, square_mm and marker_mm is None."""
    if squares is None or square_mm is None or marker_mm is None:
        raise TautError("--board needs --squares, --square-mm and --marker-mm, as they are on the print")
    pictures = []
    for source in sources:
        one = read_picture(source)
        pictures += sample_video(source, _VIEWS) if one is None else [one]
    with progress_bar("board") as progress:
        seen = intrinsics(pictures, Board(*squares, square_mm, marker_mm, dictionary), progress)
    for text in seen.doubts:
        warn(text)
    return seen


def _measure_by_known_angles(
    document: rig_keys.Document, motion: Path, angles: Path | None, angle_sigma: float
) -> tuple[Places, HandEyeFit, Coarse, float]:
    """Measures the hand-eye transform and the coarse law with the recording `motion`, in which the tip rests at known
    angles. Returns the marker's places at these rests, the fitted transform, the coarse law, and the rms of the law's
    residual, deg; prints a warning for each doubt. document: of rig.toml, with camera and kinematics; angles: CSV of
    the rests, None: angles.csv in the recording; angle_sigma: standard deviation of the angles, deg."""
    known = read_known_angles(angles or motion / "angles.csv")
    # A rig needs a coarse law and a hand-eye transform: placeholders until they are measured below.
    unknown = {"rotation_deg": [0.0, 0.0, 0.0], "translation_mm": [0.0, 0.0, 0.0]}
    so_far = Rig.from_document({**document, "coarse": {"gain": 1.0, "offset": 0.0}, "hand_eye": unknown}, "so far")
    assert so_far.kinematics is not None and so_far.camera is not None
    with progress_bar("marker") as progress:
        recording = with_marker(load(motion, so_far), so_far, progress)
    for text in recording.warnings:
        warn(text)
    places = places_of(recording, known)
    law, left_deg = fit_coarse_law(places)
    found = hand_eye(places, so_far.kinematics, so_far.camera, angle_sigma)
    for text in found.doubts:
        warn(text)
    return places, found, law, left_deg


def _rounded_section(section: dict[str, Any]) -> dict[str, Any]:
    """A section of rig.toml (numbers, or tuples of numbers, by key) with its numbers rounded to 9 significant digits,
    so that the file is readable; that is far finer than every sigma. Tuples become lists."""

    def rounded(value: float) -> float:
        """The number rounded to 9 significant digits."""
        return float(f"{value:.9g}")

    return {key: [rounded(x) for x in v] if isinstance(v, tuple) else rounded(v) for key, v in section.items()}
