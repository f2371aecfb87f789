"""rig.toml: what is known of a set-up before calibration (format rig/1)."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
import tomli_w

from tautline.errors import TautError

FORMAT = "rig/1"
UNITS = ("mm", "deg")
Sensor = Literal["marker", "angle"]
MARKER: Sensor = "marker"
ANGLE: Sensor = "angle"


@dataclass(frozen=True)
class Actuator:
    unit: str  # of q everywhere: "mm" of cable travel or "deg" of a spindle
    range: tuple[float, float]  # useful motor range, unit
    encoder_resolution: float  # unit per count
    speed_max: float | None = None  # unit/s, of the motor; None: not known
    instrument: str | None = None  # the serial of what it moves, at most 8 ASCII characters; None: not said

    @property
    def span(self) -> float:
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
class Rig:
    actuator: Actuator
    coarse: Coarse
    kinematics: Kinematics | None = None  # None with angle.csv alone
    camera: Camera | None = None
    hand_eye: HandEye | None = None
    extra: Mapping[str, Any] = field(default_factory=dict)  # unknown keys, kept
    angle: AngleSensor | None = None

    @property
    def delay_s(self) -> float:
        """The camera's, nominal."""
        return self.camera.delay_s if self.camera else 0.0

    def nominal_delay_s(self, sensor: Sensor) -> float:
        return self.delay_s if sensor == MARKER else self.angle.delay_s if self.angle else 0.0

    @property
    def has_camera(self) -> bool:
        return self.camera is not None

    def with_camera(self, **changes: Any) -> Rig:
        """The same rig with fields of its camera replaced. Raises TautError where it has none."""
        if self.camera is None:
            raise TautError("the rig has no [camera] section: add one to rig.toml")
        return replace(self, camera=replace(self.camera, **changes))

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """rig.toml. Raises TautError with the key that is missing or wrong."""
        path = Path(path)
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise TautError(f"{path}: cannot be read as a rig file ({_reason(error)}): name one with --rig") from error
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise TautError(f"{path}: not valid TOML: {error}") from error
        return cls.from_document(document, str(path))

    @classmethod
    def from_document(cls, document: Mapping[str, Any], where: str) -> Self:
        """From what its TOML holds. Raises TautError that says what is wrong where; `where` names the file in it."""
        if document.get("format") != FORMAT:
            raise TautError(f'{where}: format is {document.get("format")!r}, expected "{FORMAT}" in the first line')
        read = _Reader(document, where)
        unit = read.text("actuator", "unit")
        if unit not in UNITS:
            raise TautError(f'{where}: actuator.unit is {unit!r}, expected "mm" or "deg"')
        low, high = read.numbers("actuator", "range", 2)
        if not low < high:
            raise TautError(f"{where}: actuator.range is [{low}, {high}], expected [low, high] with low < high")
        resolution = read.number("actuator", "encoder_resolution", above=0.0)
        limited = "speed_max" in document["actuator"]
        speed_max = read.number("actuator", "speed_max", above=0.0) if limited else None
        instrument = read.text("actuator", "instrument") if "instrument" in document["actuator"] else None
        if instrument is not None and not re.fullmatch(r"[!-~]{1,8}", instrument):
            raise TautError(f"{where}: actuator.instrument is {instrument!r}, expected 1 to 8 letters, digits or signs")
        actuator = Actuator(unit, (low, high), resolution, speed_max, instrument)
        coarse = Coarse(read.number("coarse", "gain"), read.number("coarse", "offset"))
        if coarse.gain == 0.0:
            raise TautError(f"{where}: coarse.gain is 0, expected deg per {unit} (negative where c falls with q)")
        kinematics = camera = hand_eye = None
        if "kinematics" in document:
            kinematics = Kinematics(
                read.number("kinematics", "bending_length_mm", above=0.0),
                read.number("kinematics", "tip_length_mm", at_least=0.0),
            )
        if "camera" in document:
            distortion = read.numbers("camera", "distortion", 5)
            camera = Camera(
                width_px=int(read.number("camera", "width_px", above=0.0)),
                height_px=int(read.number("camera", "height_px", above=0.0)),
                fx_px=read.number("camera", "fx_px", above=0.0),
                fy_px=read.number("camera", "fy_px", above=0.0),
                cx_px=read.number("camera", "cx_px"),
                cy_px=read.number("camera", "cy_px"),
                distortion=(distortion[0], distortion[1], distortion[2], distortion[3], distortion[4]),
                frame_rate_hz=read.number("camera", "frame_rate_hz", above=0.0),
                delay_s=read.number("camera", "delay_s", at_least=0.0),
            )
        angle = None
        if "angle" in document:
            given = isinstance(document["angle"], Mapping) and "delay_s" not in document["angle"]
            angle = AngleSensor() if given else AngleSensor(read.number("angle", "delay_s"))
        if "hand_eye" in document:
            rotation = read.numbers("hand_eye", "rotation_deg", 3)
            translation = read.numbers("hand_eye", "translation_mm", 3)
            hand_eye = HandEye(
                (rotation[0], rotation[1], rotation[2]), (translation[0], translation[1], translation[2])
            )
        if camera and not (kinematics and hand_eye):
            missing = "kinematics" if kinematics is None else "hand_eye"
            raise TautError(f"{where}: has [camera] but no [{missing}] section, which a marker's pose needs: add it")
        return cls(actuator, coarse, kinematics, camera, hand_eye, _unknown(document), angle)

    def to_document(self) -> dict[str, Any]:
        document: dict[str, Any] = {"format": FORMAT}
        for name in ("actuator", "coarse", "kinematics", "camera", "angle", "hand_eye"):
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
        Path(path).write_bytes(tomli_w.dumps(self.to_document()).encode())


_KNOWN = {
    "actuator": {"unit", "range", "encoder_resolution", "speed_max", "instrument"},
    "coarse": {"gain", "offset"},
    "kinematics": {"bending_length_mm", "tip_length_mm"},
    "camera": {"width_px", "height_px", "fx_px", "fy_px", "cx_px", "cy_px", "distortion", "frame_rate_hz", "delay_s"},
    "angle": {"delay_s"},
    "hand_eye": {"rotation_deg", "translation_mm"},
}


def _unknown(document: Mapping[str, Any]) -> dict[str, Any]:
    extra: dict[str, Any] = {}
    for key, value in document.items():
        if key == "format":
            continue
        known = _KNOWN.get(key)
        if known is None:
            extra[key] = value
        elif isinstance(value, Mapping) and (rest := {k: v for k, v in value.items() if k not in known}):
            extra[key] = rest
    return extra


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)


@dataclass(frozen=True)
class _Reader:
    document: Mapping[str, Any]
    where: str

    def value(self, section: str, key: str) -> Any:
        table = self.document.get(section)
        if not isinstance(table, Mapping):
            raise TautError(
                f"{self.where}: section [{section}] is missing: it holds {', '.join(sorted(_KNOWN[section]))}"
            )
        if key not in table:
            raise TautError(f"{self.where}: {section}.{key} is missing")
        return table[key]

    def text(self, section: str, key: str) -> str:
        value = self.value(section, key)
        if not isinstance(value, str):
            raise TautError(f"{self.where}: {section}.{key} is {value!r}, expected a text in quotes")
        return value

    def number(self, section: str, key: str, above: float | None = None, at_least: float | None = None) -> float:
        value = self._finite(self.value(section, key), f"{section}.{key}")
        if above is not None and not value > above:
            raise TautError(f"{self.where}: {section}.{key} is {value:g}, expected a number above {above:g}")
        if at_least is not None and not value >= at_least:
            raise TautError(f"{self.where}: {section}.{key} is {value:g}, expected {at_least:g} or more")
        return value

    def numbers(self, section: str, key: str, count: int) -> list[float]:
        value = self.value(section, key)
        if not isinstance(value, list) or len(value) != count:
            raise TautError(f"{self.where}: {section}.{key} is {value!r}, expected a list of {count} numbers")
        return [self._finite(item, f"{section}.{key}") for item in value]

    def _finite(self, value: Any, name: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
            raise TautError(f"{self.where}: {name} is {value!r}, expected a finite number")
        return float(value)
