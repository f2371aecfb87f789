"""A recording: what motor, marker and sensor did, as a folder of CSV files and perhaps a video."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tautline.rig import Rig

Array = np.ndarray


@dataclass(frozen=True)
class Motor:
    """Encoder samples, negligible delay. All arrays have one length; t_s rises strictly."""

    t_s: Array
    q: Array  # bending motor, the rig's unit
    q_cmd: Array | None = None
    translation_mm: Array | None = None  # along the base z axis; None = 0
    rotation_deg: Array | None = None  # about the base z axis; None = 0
    load_mNm: Array | None = None
    extra: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Marker:
    """Marker positions. t_s is when the frame arrived: it showed the scene t_delay earlier."""

    t_s: Array
    u_px: Array  # NaN where not valid
    v_px: Array
    valid: Array  # bool
    sigma_px: Array | None = None


@dataclass(frozen=True)
class Angle:
    """An external sensor's bending angle, no delay."""

    t_s: Array
    c_deg: Array


@dataclass(frozen=True)
class Video:
    path: Path
    arrival_s: Array | None  # of each frame, from frames.csv; None: the container's times


@dataclass(frozen=True)
class Recording:
    """marker, angle or video is there; several may be."""

    name: str
    motor: Motor
    marker: Marker | None = None
    angle: Angle | None = None
    video: Video | None = None
    rig: Rig | None = None
    warnings: tuple[str, ...] = ()
