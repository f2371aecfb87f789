"""The effects that a model can be extended by, and the simulation with them.

Every effect is a nested extension of the chain motor -> transmission -> configuration -> kinematics -> registration ->
camera -> acquisition: a few named parameters, and with its amplitudes at zero it is absent. What moves the tip is
simulated in C (host/native/effects.h names those parameters), and so is where the marker is seen (sight.h).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline import _native, geometry
from tautline.model import Model
from tautline.recording import Motor
from tautline.rig import Camera, Rig

Array = npt.NDArray[np.float64]

STAGES = ("actuator", "transmission", "configuration", "kinematics", "registration", "camera", "acquisition")
STICK_SLIP, JITTER = "transmission.stick_slip", "acquisition.jitter"
NATIVE = frozenset(name for name, *_ in _native.effect_parameters)  # what moves the tip
SIGHT = frozenset(name for name, *_ in _native.sight_parameters)  # what changes where it is seen


@dataclass(frozen=True)
class Parameter:
    """`scale` is a change that a user would notice: the step of differences and the unit of priors. For a parameter in
    the actuator's unit it is a share of the motor's range."""

    name: str
    unit: str
    scale: float
    shape: tuple[float, ...] = ()  # values to start from; empty: an amplitude, zero when absent
    probe: float = 0.3  # of `scale`: how far to go to see what an amplitude does
    one_way: bool = False  # what it does when negative is another thing


@dataclass(frozen=True)
class Kind:
    """An effect of the library."""

    id: str
    amplitudes: tuple[Parameter, ...]
    shapes: tuple[Parameter, ...] = ()
    says: str = ""
    needs: str = ""  # "", "camera", "load", "freedom" (a second degree of freedom that moves)
    folded: bool = False  # a corrected model holds it in its own tables, rig or delay, as it is at the end of a session

    @property
    def on_board(self) -> bool:
        """Whether the tables of a corrected model, as they are, put the tip where that model says: what ends up in B
        and f_remain themselves, and what only changes how the tip is seen."""
        return self.id == "transmission.drift" or self.stage in ("kinematics", "registration", "camera", "acquisition")

    @property
    def repeats(self) -> bool:
        """Whether it has a path that a prediction can follow; the others scatter."""
        return self.id not in (STICK_SLIP, JITTER)

    @property
    def stage(self) -> str:
        return self.id.split(".", 1)[0]


def _six(prefix: str) -> tuple[Parameter, ...]:
    turn = tuple(Parameter(f"{prefix}_r{axis}", "deg", 0.5) for axis in "xyz")
    move = tuple(Parameter(f"{prefix}_{axis}", "mm", 0.2) for axis in "xyz")
    return turn + move


# scale of "unit" parameters is a share of the motor's range; shapes likewise.
LIBRARY: tuple[Kind, ...] = (
    Kind(
        "actuator.encoder_periodic",
        tuple(Parameter(f"encoder_{name}", "unit", 2e-3) for name in ("sin", "cos", "sin2", "cos2")),
        (Parameter("encoder_period", "unit", 0.05, (0.02, 0.3)),),  # from the shortest to the longest
        "once-per-turn error of the measured motor position",
    ),
    Kind(
        "transmission.smooth_onset",
        (Parameter("onset_spread", "", 0.2, probe=2.5),),
        (Parameter("onset_tail", "", 0.5, (0.0, 1.0)),),
        "motion starts gradually instead of at a corner",
    ),
    Kind(
        "transmission.asymmetric_backlash",
        (Parameter("asymmetry", "unit", 5e-3, one_way=True),),
        (
            Parameter("asymmetry_travel", "unit", 0.05, (0.01, 0.03, 0.08, 0.2)),
            Parameter("asymmetry_form", "", 1.0, (1.0, 2.0)),
        ),
        "after turning one way the tip starts late and catches up",
    ),
    Kind(
        "transmission.rate_dependent_backlash",
        (Parameter("width_per_speed", "s", 0.02),),
        (
            Parameter("speed_exponent", "", 0.5, (1.0, 0.5)),
            Parameter("speed_time", "s", 0.02, (0.02, 0.2)),
            Parameter("width_held", "", 1.0, (0.0, 1.0)),
        ),
        "the width grows with speed",
    ),
    Kind(
        "transmission.lag",
        (Parameter("lag", "s", 0.02),),
        (Parameter("lag_second", "", 0.2, (0.0, 0.5)),),
        "the tip lags, viscous, first order",
    ),
    Kind(
        "transmission.creep",
        (Parameter("creep_share", "", 0.05),),
        (Parameter("creep_time", "s", 1.0, (0.5, 1.5, 5.0)), Parameter("creep_slow", "", 0.3, (0.0, 0.5))),
        "the tip goes on moving after the motor stops",
    ),
    Kind(
        STICK_SLIP,
        (Parameter("stick", "unit", 5e-3), Parameter("held_back", "unit", 5e-3)),
        (),
        "the tip moves in jumps",
    ),
    Kind(
        "transmission.drift",
        (Parameter("offset_drift", "unit/s", 5e-5), Parameter("width_drift", "1/s", 5e-4)),
        (Parameter("drift_decay", "1/s", 5e-3, (0.0, 0.01)),),
        "width or offset changes with time",
        folded=True,
    ),
    Kind(
        "transmission.load_dependence",
        (
            Parameter("width_per_load", "1/mNm", 5e-3),
            Parameter("gain_per_load", "1/mNm", 2e-3),
            Parameter("offset_per_load", "unit/mNm", 2e-4),
        ),
        (),
        "width, gain or offset follow the load",
        needs="load",
    ),
    Kind(
        "configuration.axis_coupling",
        (Parameter("c_per_translation", "deg/mm", 0.2), Parameter("c_per_rotation", "deg/deg", 0.02)),
        (),
        "another degree of freedom moves the bending angle",
        needs="freedom",
    ),
    Kind(
        "configuration.contact",
        (Parameter("contact_hold", "", 0.3),),
        (
            Parameter("contact_c", "deg", 10.0),
            Parameter("contact_side", "", 1.0, (1.0, -1.0)),
            Parameter("contact_soft", "deg", 2.0, (1.0, 5.0)),
        ),
        "an obstacle holds the tip back beyond some bending angle",
    ),
    Kind(
        "kinematics.nonconstant_curvature",
        (Parameter("curvature_gradient", "", 0.2),),
        (),
        "the bending section is curved more at one end",
        needs="camera",
    ),
    Kind("registration.static", _six("static"), (), "wrong hand-eye transform", needs="camera", folded=True),
    Kind(
        "registration.direction_dependent",
        (Parameter("tilt_x", "deg", 0.3), Parameter("tilt_y", "deg", 0.3), Parameter("tilt_z", "deg", 0.3)),
        (Parameter("tilt_pivot", "mm", 5.0, (0.0,)), Parameter("tilt_travel", "unit", 2e-3, (0.0, 4e-3))),
        "the registration tilts with the direction of motion",
        needs="camera",
    ),
    Kind(
        "registration.shift",
        _six("shift"),
        (Parameter("shift_time", "s", 1.0),),
        "the registration changes once, during a recording",
        needs="camera",
        folded=True,
    ),
    Kind(
        "camera.distortion",
        (
            *(Parameter(name, "", 0.05) for name in ("k1", "k2")),
            *(Parameter(name, "", 0.01) for name in ("p1", "p2")),
            Parameter("k3", "", 0.05),
        ),
        (),
        "the lens distorts otherwise than the rig says",
        needs="camera",
        folded=True,
    ),
    Kind("acquisition.delay", (Parameter("delay", "s", 0.01),), (), "the delay of the images is wrong", folded=True),
    Kind(JITTER, (Parameter("jitter", "s", 0.005),), (), "frame times are unsteady", needs="camera"),
)
BY_ID: Mapping[str, Kind] = {kind.id: kind for kind in LIBRARY}
# Told by their scatter: at most what it is in the mean can be predicted.
EVENTS = frozenset(kind.id for kind in LIBRARY if not kind.repeats)
SCATTERS = frozenset({"stick", "jitter"})  # their parameters that say how much


@dataclass(frozen=True)
class Path:
    """Where the tip is at a number of scene times. All (n,)."""

    scene_s: Array
    translation_mm: Array | None  # of the instrument; None where it never moves
    rotation_deg: Array | None
    c_deg: Array
    p: Array  # the play's centre coordinate
    tip: Array  # the same after lag, creep and stick-slip: c = f_remain(tip) but for the configuration's effects
    gain: Array  # dc / df_remain
    way: Array  # which way the instrument lies in its channel, -1 to 1
    side: Array  # the envelope that last carried the tip: +1 rising q, -1 falling, 0 not yet


@dataclass(frozen=True)
class Seen(Path):
    image_px: Array  # (n, 2), NaN without a camera


def of_model(model: Model, scatter: bool = False) -> dict[str, float]:
    """The parameters of a corrected model's effects that its tables, rig and delay do not hold already. `scatter`: with
    one course of stick-slip instead of what it is in the mean."""
    return {
        name: value
        for effect in model.effects
        if not BY_ID[effect.id].folded
        for name, value in effect.parameters.items()
        if (name != "held_back" if scatter else name not in SCATTERS)
    }


def simulate(
    model: Model,
    motor: Motor,
    scene_s: npt.ArrayLike,
    parameters: Mapping[str, float],
    start_deg: float | None = None,
    load_reference: float = 0.0,
    clock_offset_s: float = 0.0,
) -> Seen:
    """The model with effects of these parameters (names of LIBRARY, values absolute) at scene times (n,), in any order.
    `motor` is used as it is: tautline.encoder takes an encoder's steps out. clock_offset_s is added to its times where
    an effect depends on the time of the session (drift, shift). load_reference, mNm, is the load at which
    the model's tables hold. Stick-slip and jitter scatter at random: what is here is one course of the former, and
    nothing of the latter."""
    path = follow(model, motor, scene_s, parameters, start_deg, load_reference, clock_offset_s)
    px = image(model, path, parameters, clock_offset_s) if model.rig.has_camera else np.full((len(path.p), 2), np.nan)
    return Seen(**{f.name: getattr(path, f.name) for f in fields(Path)}, image_px=px)


def follow(
    model: Model,
    motor: Motor,
    scene_s: npt.ArrayLike,
    parameters: Mapping[str, float],
    start_deg: float | None = None,
    load_reference: float = 0.0,
    clock_offset_s: float = 0.0,
) -> Path:
    """Where the tip is, as in `simulate`."""
    scene = np.asarray(scene_s, dtype=float) - parameters.get("delay", 0.0)
    order = np.argsort(scene, kind="stable") if len(scene) > 1 and (np.diff(scene) < 0).any() else None
    rising = scene if order is None else scene[order]
    translation, rotation = (
        None if values is None else np.interp(rising, motor.t_s, values)
        for values in (motor.translation_mm, motor.rotation_deg)
    )
    moved = _native.simulate_effects(
        {name: value for name, value in parameters.items() if name in NATIVE},
        model.q,
        model.width,
        model.c_deg,
        motor.t_s,
        motor.q,
        rising,
        translation,
        rotation,
        None if motor.load_mNm is None else motor.load_mNm - load_reference,
        clock_offset_s,
        np.nan if start_deg is None else float(model.remaining_inverse(start_deg)),
        model.play.native,
    )
    found = (rising, translation, rotation, *moved)
    if order is None:
        return Path(*found)
    back = np.argsort(order, kind="stable")
    return Path(*(None if values is None else values[back] for values in found))  # type: ignore[arg-type]


def image(model: Model, path: Path, parameters: Mapping[str, float], clock_offset_s: float = 0.0) -> Array:
    """Where the marker is seen, (n, 2) px, with the effects of kinematics, registration and camera."""
    return _see(model, path, parameters, clock_offset_s, False)  # type: ignore[no-any-return]


def see(
    model: Model,
    c_deg: Array,
    way: Array,
    translation_mm: npt.ArrayLike,
    rotation_deg: npt.ArrayLike,
    parameters: Mapping[str, float],
) -> Array:
    """As `image`, of tips whose c and way (n,) are known and whose registration does not change."""
    n = np.ones(len(c_deg))
    known = {name: value for name, value in parameters.items() if name in SIGHT}
    rig = sight_rig(model.rig)
    translation, rotation = n * np.asarray(translation_mm), n * np.asarray(rotation_deg)
    return _native.see(known, rig, c_deg, translation, rotation, way, None, False)  # type: ignore[no-any-return]


def image_with_slopes(
    model: Model, path: Path, parameters: Mapping[str, float], clock_offset_s: float = 0.0
) -> tuple[Array, Array, Array]:
    """The image and its derivatives: by c (n, 2) px per deg, by a further static registration (n, 2, 6)."""
    return _see(model, path, parameters, clock_offset_s, True)  # type: ignore[no-any-return]


def _see(model: Model, path: Path, parameters: Mapping[str, float], clock_offset_s: float, slopes: bool) -> Any:
    shifted = None
    if "shift_time" in parameters:
        shifted = (path.scene_s + clock_offset_s >= parameters["shift_time"]).view(np.uint8)
    return _native.see(
        {name: value for name, value in parameters.items() if name in SIGHT},
        sight_rig(model.rig),
        path.c_deg,
        path.translation_mm,
        path.rotation_deg,
        path.way,
        shifted,
        slopes,
    )


def sight_rig(rig: Rig) -> Array:
    """The numbers of struct sight_rig (host/native/sight.h)."""
    assert rig.kinematics and rig.camera and rig.hand_eye
    camera = rig.camera
    return np.array(
        [
            rig.kinematics.bending_length_mm,
            rig.kinematics.tip_length_mm,
            *geometry.rotation(rig.hand_eye.rotation_deg).ravel(),
            *rig.hand_eye.translation_mm,
            *(camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px),
            *camera.distortion,
        ]
    )


def distorted(camera: Camera, parameters: Mapping[str, float]) -> Camera:
    """The camera with the effect's distortion on top of the rig's."""
    k1, k2, p1, p2, k3 = (
        here + parameters.get(name, 0.0)
        for here, name in zip(camera.distortion, ("k1", "k2", "p1", "p2", "k3"), strict=True)
    )
    return replace(camera, distortion=(k1, k2, p1, p2, k3))
