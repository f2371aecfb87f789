"""A set-up to be recorded: an instrument, its motions, sensors and clocks, and every way in which they can be wrong.

All defaults are benign. A condition changes fields; `record.py` turns the result into folders and a truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tools.honesty.motion import Motion
from tools.honesty.optics import Camera
from tools.honesty.plant import Curve, Hysteresis

Array = NDArray[np.float64]
Wave = Callable[[Array], Array]  # of time, s


@dataclass
class Actuator:
    unit: str = "mm"  # or "deg"
    low: float = -5.0
    high: float = 5.0
    resolution: float = 0.001
    um_per_unit: float = 1000.0  # what one unit of q is on the cable: scores are in um


@dataclass
class MotorLog:
    rate_hz: float = 500.0
    resolution: float | None = None  # None: what the rig says
    noise: float = 0.0  # of the reading, unit of q, white
    vibration: float = 0.0  # of the motor itself, rms, unit of q
    vibration_hz: float = 35.0
    periodic: float = 0.0  # once-per-turn error of the reading: amplitude
    period: float = 1.0
    phase: float = 0.0  # of counts and turns against zero, in shares of them; the same in every log
    lead_s: float = 0.0  # what is logged is the command, ahead of the motor by this
    change: Callable[[Array, Array], tuple[Array, Array]] | None = None  # (t, q) as they would be logged


@dataclass
class ImageLog:
    noise_px: float = 0.05
    delay_s: float = 0.080  # true
    place_error: Callable[[Array], Array] | None = None  # px error that goes with the place (rows u, v)
    sigma_column: bool = False
    noise_wave: Wave | None = None  # factor of the noise over time
    exposure: Wave | None = None  # s, added to the delay over time
    stamp: Callable[[Array, np.random.Generator], Array] | None = None  # true arrival times -> those written
    offset_s: float = 0.0  # of the image's clock, constant; found or refused
    missed: float = 0.0  # share of frames in which the marker is flagged invalid, in stretches
    lost: float = 0.0  # share of frames that never arrive
    spoil: Callable[[Array, Array, np.random.Generator], Array] | None = None  # (arrival, rows u v) -> rows u v
    extra: Callable[[dict[str, Array], np.random.Generator], dict[str, Array]] | None = None  # the finished columns


@dataclass
class AngleLog:
    rate_hz: float = 100.0
    noise_deg: float = 0.02
    delay_s: float = 0.0  # true
    told_delay_s: float | None = None
    held: int = 1  # each value is repeated this many times
    resolution_deg: float = 0.0
    error: Callable[[Array], Array] | None = None  # deg error that goes with the angle
    spoil: Callable[[Array, Array, np.random.Generator], Array] | None = None
    valid: Callable[[Array, np.random.Generator], Array] | None = None


@dataclass
class Setup:
    rng: np.random.Generator
    actuator: Actuator
    width: Curve  # for effects that need a nominal width, e.g. margins
    hysteresis: Hysteresis
    law: Curve  # c (deg) of the centre coordinate
    gain: float  # told
    offset: float
    recordings: list[Motion]
    test: Motion
    camera: Camera | None = field(default_factory=Camera)  # as told
    seen_by: Camera | None = None  # the true one; None: as told
    image: ImageLog | None = field(default_factory=ImageLog)
    angle: AngleLog | None = None
    motor: MotorLog = field(default_factory=MotorLog)
    own_clocks: bool = False  # each recording starts at 0
    gap_s: float = 12.0  # between recordings on one clock
    benign: bool = False
    must_not_pass: bool = False  # files contradict each other: good is wrong whatever B says
    codes: frozenset[str] = frozenset()  # reasons that are right
    # Effects. Time is the set-up's, over all recordings; it stands still for the test.
    scale: Callable[[Array, Array], Array] | None = None  # (t, q) -> factor of the width
    comes_and_goes: bool = False  # scale and shift have no end state: their mean is the truth
    shift: Callable[[Array, Array], Array] | None = None  # (t, q) -> offset of q between motor and play
    wider: float = 0.0  # what a tendon's effect adds to the distance between full-stroke envelopes, unit of q
    tendon: list[Callable[[Array, Array], Array]] = field(default_factory=list)  # (t, p) -> p
    bend: list[Callable[[Array, Array, dict[str, Array]], Array]] = field(default_factory=list)  # (t, c, columns) -> c
    columns: Callable[[Motion, np.random.Generator], dict[str, Array]] | None = (
        None  # other joints and load of a motion
    )
    load_scale: Callable[[dict[str, Array]], tuple[Array, Array]] | None = (
        None  # columns -> (factor of width, offset of q)
    )
    tilt: Callable[[Array, Array], Array] | None = None  # (t, c) -> rows of hand-eye angles to add, deg
    rig_file: Callable[[dict[str, Any]], dict[str, Any]] | None = None
    video: Any = None  # render.Film: frames instead of marker.csv
    logged: frozenset[str] | None = None  # columns that are written; None: all


def accept(setup: Setup, *codes: str) -> Setup:
    setup.codes = frozenset(codes)
    setup.benign = False
    return setup
