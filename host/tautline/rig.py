"""rig.toml: what is known of a set-up before calibration (format rig/1)."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
import tomli_w

from tautline import _native
from tautline.errors import TautError, nearest
from tautline.folders import write_file
from tautline.schema import Key, Section

# format of all: rig.toml's examples, counts and units

FORMAT = "rig/1"
RIG_FILE = "rig.toml"
UNITS = ("mm", "deg")
MOUNTS = ("base", "tip")
PLACES: int = _native.projection_places
Sensor = Literal["marker", "angle"]
MARKER: Sensor = "marker"
ANGLE: Sensor = "angle"


@dataclass(frozen=True)
class Actuator:
    """The motor that bends the instrument."""

    unit: str  # of q everywhere: "mm" of cable travel or "deg" of a spindle
    range: tuple[float, float]  # useful motor range, unit
    encoder_resolution: float  # unit per count
    speed_max: float | None = None  # unit/s, of the motor; None: not known
    instrument: str | None = None  # the serial of what it moves, at most 8 ASCII characters; None: not said
    board: str | None = None  # as --board has it; None: the only one on USB

    @property
    def span(self) -> float:
        """Length of the range, unit of q."""
        return self.range[1] - self.range[0]


@dataclass(frozen=True)
class Coarse:
    """f_coarse: c = gain * q + offset, c in deg."""

    gain: float
    offset: float


@dataclass(frozen=True)
class Kinematics:
    """g: a constant-curvature section, then a straight rigid tip with the marker at its end."""

    bending_length_mm: float
    tip_length_mm: float


@dataclass(frozen=True)
class Camera:
    """Pinhole with OpenCV's k1 k2 p1 p2 k3."""

    width_px: int
    height_px: int
    fx_px: float
    fy_px: float
    cx_px: float
    cy_px: float
    distortion: tuple[float, float, float, float, float]
    frame_rate_hz: float
    delay_s: float  # t_delay, nominal
    mount: str | None = None  # "tip": it sees the world from there; else it sees the instrument

    @property
    def matrix(self) -> np.ndarray:
        """(3, 3) intrinsic matrix, px."""
        return np.array([[self.fx_px, 0.0, self.cx_px], [0.0, self.fy_px, self.cy_px], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class AngleSensor:
    """An external sensor of the bending angle."""

    delay_s: float = 0.0  # nominal


@dataclass(frozen=True)
class HandEye:
    """X_cam = R X_base + t with R = Rz(rz) Ry(ry) Rx(rx), angles [rx, ry, rz]."""

    rotation_deg: tuple[float, float, float]
    translation_mm: tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """Where on a bare instrument's tip lies what is followed, as a calibration has estimated it: at PLACES bending
    angles a step apart, a smooth curve between them, held beyond. A model's own: no key of rig.toml."""

    from_deg: float
    step_deg: float
    mm: tuple[tuple[float, ...], ...]  # (3, PLACES) from the tip's end, in its frame: aside, out of the plane, ahead
    sigma_deg: tuple[float, ...]  # (PLACES,) of an angle that is told by this place, alike along the curve

    def sigma_at(self, c_deg: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """(n,) One standard deviation, deg, of angles c_deg (n,), as it is not known exactly where the place lies. No
        predicted image has this error: it shifts the angle and leaves the image as it is."""
        at = self.from_deg + self.step_deg * np.arange(PLACES)
        return np.asarray(np.interp(np.asarray(c_deg, dtype=float), at, self.sigma_deg))

    @classmethod
    def from_json(cls, document: Mapping[str, Any]) -> Self:
        """Reads what dataclasses.asdict made of a Place. KeyError, TypeError or ValueError where it is something
        else."""
        mm = tuple(tuple(float(x) for x in row) for row in document["mm"])
        sigma_deg = tuple(float(x) for x in document["sigma_deg"])
        if [len(row) for row in (*mm, sigma_deg)] != 4 * [PLACES]:
            raise ValueError(f"a place is told at {PLACES} angles")
        return cls(float(document["from_deg"]), float(document["step_deg"]), mm, sigma_deg)


_SECTIONS = (
    Section(
        "actuator",
        "The motor that bends the instrument.",
        (
            Key(
                "unit", "the unit of q everywhere: mm of cable travel, or deg of a spindle", "mm", "text", choices=UNITS
            ),
            Key(
                "range",
                "the useful motor range, in its unit: from where to where it may go",
                [-5.0, 5.0],
                "numbers",
                count=2,
                wrong="the calibration says `range`: the motor goes far beyond it, or hardly into it",
            ),
            Key(
                "encoder_resolution",
                "one count of the encoder, in the motor's unit",
                0.001,
                above=0.0,
                wrong="motor and encoder disagree on how far it went; B comes out wrong by a factor",
            ),
            Key(
                "speed_max",
                "the motor's top speed, units per second; `taut compensate` keeps to it",
                20.0,
                needed=False,
                above=0.0,
            ),
            Key(
                "instrument",
                "the instrument's serial: a board whose settings name another one refuses the tables",
                "SN-7",
                "text",
                needed=False,
                pattern="[!-~]{1,8}",
                described="1 to 8 letters, digits or signs",
            ),
            Key(
                "board",
                "what moves it, as `--board` takes it, which wins over it; else the only board on USB",
                "dynamixel:/dev/ttyUSB0:1",
                "text",
                needed=False,
                pattern="[!-~]{1,128}",
                described="an address without spaces",
            ),
        ),
    ),
    Section(
        "coarse",
        "f_coarse, what the kinematics alone says: c = gain * q + offset, c in deg.",
        (
            Key(
                "gain",
                "deg of bending per unit of q; negative where c falls as q rises",
                12.0,
                wrong="the marker moves too much, too little or backwards: the calibration says `coarse`",
            ),
            Key("offset", "deg: the bending at q = 0", 0.0),
        ),
    ),
    Section(
        "kinematics",
        "A section of constant curvature, then a straight tip with the marker at its end. It bends in the base's x-z "
        "plane: c > 0 towards +x, c = 0 along +z.",
        (
            Key("bending_length_mm", "mm: the bending section along its middle", 18.0, above=0.0),
            Key("tip_length_mm", "mm: from the end of the bending section to the marker", 6.0, at_least=0.0),
        ),
    ),
    Section(
        "camera",
        "A pinhole camera with OpenCV's distortion, as cv2.calibrateCamera gives it.",
        (
            Key("width_px", "px: the frames' width that the other numbers hold for", 720, "whole", above=0.0),
            Key("height_px", "px: their height", 576, "whole", above=0.0),
            Key("fx_px", "px: focal length across", 520.0, above=0.0, wrong="angles come out too large or too small"),
            Key("fy_px", "px: focal length down", 520.0, above=0.0),
            Key("cx_px", "px: principal point from the left", 360.0),
            Key("cy_px", "px: principal point from the top", 288.0),
            Key("distortion", "k1 k2 p1 p2 k3, OpenCV's", [0.0, 0.0, 0.0, 0.0, 0.0], "numbers", count=5),
            Key("frame_rate_hz", "Hz: frames per second", 25.0, above=0.0),
            Key(
                "delay_s", "s: how old a frame is when it arrives, nominal; calibration measures it", 0.08, at_least=0.0
            ),
            Key(
                "mount",
                "where it sits: on the base, and sees the instrument, or on its tip, and sees the world, which turns "
                "as the tip bends; then kinematics and hand_eye are not needed",
                "base",
                "text",
                needed=False,
                choices=MOUNTS,
            ),
        ),
    ),
    Section(
        "angle",
        "An external sensor of the bending angle, where there is one.",
        (
            Key(
                "delay_s",
                "s: how old its value is when it arrives, nominal; calibration measures it",
                0.0,
                needed=False,
            ),
        ),
    ),
    Section(
        "hand_eye",
        "From the instrument's base to the camera: X_cam = R X_base + t, R = Rz(rz) Ry(ry) Rx(rx).",
        (
            Key(
                "rotation_deg",
                "deg: rx, ry, rz",
                [4.0, -3.0, 2.0],
                "numbers",
                count=3,
                wrong="f_remain bends away from f_coarse: the calibration says `registration.static`",
            ),
            Key(
                "translation_mm",
                "mm: where the base's origin is, seen from the camera",
                [-4.0, 5.0, 14.0],
                "numbers",
                count=3,
            ),
        ),
    ),
)
SECTIONS = {section.name: section for section in _SECTIONS}
_NEEDED = ("actuator", "coarse")  # the others are there with a camera, or an angle sensor


@dataclass(frozen=True)
class Rig:
    """What is known of a set-up before calibration."""

    actuator: Actuator
    coarse: Coarse
    kinematics: Kinematics | None = None  # None with angle.csv alone
    camera: Camera | None = None
    hand_eye: HandEye | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)  # unknown keys, kept
    angle: AngleSensor | None = None
    place: Place | None = None  # None: what is followed is a marker at the tip's end

    @property
    def delay_s(self) -> float:
        """The camera's nominal delay, s, as rig.toml says; 0 without a camera."""
        return self.camera.delay_s if self.camera else 0.0

    def nominal_delay_s(self, sensor: Sensor) -> float:
        """How old, s, a sensor's reading is when it arrives, as rig.toml says; 0 where it says nothing. For a camera on
        the tip, which is the angle sensor, it is the camera's."""
        if sensor == MARKER or self.sees_from_tip:
            return self.delay_s
        return self.angle.delay_s if self.angle else 0.0

    @property
    def misspelt(self) -> list[str]:
        """A sentence on each unknown key or section that looks like a known one."""
        said = []
        for name, value in self.extra.items():
            section = SECTIONS.get(name)
            if section is not None:
                keys = section.misspelt(value)
                said += [f"{name}.{key} is no key that is known: did you mean {meant}?" for key, meant in keys]
            elif meant := nearest(name, SECTIONS):
                said.append(f"[{name}] is no section that is known: did you mean [{meant}]?")
        return said

    @property
    def has_camera(self) -> bool:
        """Whether a camera sees the tip. One that sits on the tip and sees the world is an angle sensor instead
        (`sees_from_tip`): the rig then has a `camera`, but this is False."""
        return self.camera is not None and not self.sees_from_tip

    @property
    def sees_from_tip(self) -> bool:
        """Whether the camera is an angle sensor: it sits on the tip and sees the world turn as the tip bends."""
        return self.camera is not None and self.camera.mount == "tip"

    def with_camera(self, **changes: Any) -> Rig:
        """A copy of the rig with these fields of its camera replaced. TautError where it has no camera."""
        if self.camera is None:
            raise TautError("the rig has no [camera] section: add one to rig.toml")
        return replace(self, camera=replace(self.camera, **changes))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Reads a rig.toml. TautError, which names the key that is missing or wrong, where it is no such file."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8-sig")
        except OSError as error:
            raise TautError(
                f"{path}: cannot be read as a rig file ({error.strerror or error}): name one with --rig"
            ) from error
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            raise TautError(
                f"{path}, line {line}: is not UTF-8 text, which TOML has to be: save it as UTF-8"
            ) from error
        try:
            document = tomllib.loads(text)
        except (ValueError, RecursionError) as error:
            raise TautError(f"{path}: not valid TOML: {error}") from error
        return cls.from_document(document, str(path))

    @classmethod
    def from_document(cls, document: Mapping[str, Any], where: str) -> Self:
        """Makes a rig of what its TOML holds, checked; unknown keys are kept in `extra`. TautError for a missing or
        wrong key. where: the file's name, for the error."""
        if document.get("format") != FORMAT:
            raise TautError(f'{where}: format is {document.get("format")!r}, expected "{FORMAT}" in the first line')
        read = {
            name: section.read(document, where)
            for name, section in SECTIONS.items()
            if name in _NEEDED or name in document
        }
        actuator = Actuator(**read["actuator"])
        low, high = actuator.range
        if not low < high:
            raise _wrong(where, "actuator.range", f"[{low}, {high}], expected [low, high] with low < high")
        coarse = Coarse(**read["coarse"])
        if coarse.gain == 0.0:
            raise _wrong(where, "coarse.gain", f"0, expected deg per {actuator.unit} (negative where c falls with q)")
        kinematics = Kinematics(**read["kinematics"]) if "kinematics" in read else None
        camera = Camera(**read["camera"]) if "camera" in read else None
        angle = AngleSensor(**read["angle"]) if "angle" in read else None
        hand_eye = HandEye(**read["hand_eye"]) if "hand_eye" in read else None
        if camera and camera.mount != "tip" and not (kinematics and hand_eye):
            missing = "kinematics" if kinematics is None else "hand_eye"
            raise TautError(f"{where}: has [camera] but no [{missing}] section, which a marker's pose needs: add it")
        return cls(actuator, coarse, kinematics, camera, hand_eye, extra=_unknown(document), angle=angle)

    def to_document(self) -> dict[str, Any]:
        """What rig.toml is to hold: the sections that the rig has, without fields that are None, and unknown keys as
        they were read."""
        document: dict[str, Any] = {"format": FORMAT}
        for name in SECTIONS:
            section = getattr(self, name)
            if section is not None:
                document[name] = {
                    key: list(value) if isinstance(value, tuple) else value
                    for key, value in asdict(section).items()
                    if value is not None
                }
        for key, value in self.extra.items():
            if isinstance(value, Mapping) and isinstance(document.get(key), dict):
                document[key].update(value)
            else:
                document[key] = value
        return document

    def save(self, path: str | Path) -> None:
        """Writes rig.toml. TautError where it cannot be written."""
        write_file(Path(path), tomli_w.dumps(self.to_document()))


def _wrong(where: str, name: str, says: str) -> TautError:
    """The error to raise for a wrong key. where: the file; name: the key, section.key; says: what it is, and what was
    expected."""
    return TautError(f"{where}: {name} is {says} (taut explain rig.{name})")


def _unknown(document: Mapping[str, Any]) -> dict[str, Any]:
    """The sections of the document that no definition has, and the unknown keys of known sections, as the document has
    them."""
    extra: dict[str, Any] = {}
    for key, value in document.items():
        if key == "format":
            continue
        section = SECTIONS.get(key)
        known = {k.name for k in section.keys} if section else set()
        if section is None:
            extra[key] = value
        elif isinstance(value, Mapping) and (rest := {k: v for k, v in value.items() if k not in known}):
            extra[key] = rest
    return extra
