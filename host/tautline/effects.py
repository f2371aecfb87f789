"""The effects that a model can be extended by, and the simulation with them.

Every effect is a nested extension of the chain motor -> transmission -> configuration -> kinematics -> registration ->
camera -> acquisition: a few named parameters, and with its amplitudes at zero it is absent. What moves the tip is
simulated in C (host/native/effects.h names those parameters); where the marker is seen is computed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from tautline import _native, geometry
from tautline.model import Model
from tautline.recording import Motor
from tautline.rig import Camera, Kinematics

Array = npt.NDArray[np.float64]

STAGES = ("actuator", "transmission", "configuration", "kinematics", "registration", "camera", "acquisition")
NATIVE = frozenset(name for name, *_ in _native.effect_parameters)


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
        """Whether the board's tables can carry it: only what ends up in B and f_remain themselves."""
        return self.id == "transmission.drift"

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
        (Parameter("encoder_sin", "unit", 2e-3), Parameter("encoder_cos", "unit", 2e-3)),
        (Parameter("encoder_period", "unit", 0.05, (0.02, 0.03, 0.045, 0.065, 0.1, 0.14, 0.2, 0.3)),),
        "once-per-turn error of the measured motor position",
    ),
    Kind(
        "transmission.smooth_onset",
        (Parameter("onset_spread", "", 0.2, probe=2.5),),
        (),
        "motion starts gradually instead of at a corner",
    ),
    Kind(
        "transmission.asymmetric_backlash",
        (Parameter("asymmetry", "unit", 5e-3, one_way=True),),
        (Parameter("asymmetry_travel", "unit", 0.05, (0.01, 0.03, 0.08, 0.2)),),
        "after turning one way the tip starts late and catches up",
    ),
    Kind(
        "transmission.rate_dependent_backlash",
        (Parameter("width_per_speed", "s", 0.02),),
        (Parameter("width_held", "", 1.0, (0.0, 1.0)),),
        "the width grows with speed",
    ),
    Kind("transmission.lag", (Parameter("lag", "s", 0.02),), (), "the tip lags, viscous, first order"),
    Kind(
        "transmission.creep",
        (Parameter("creep_share", "", 0.05),),
        (Parameter("creep_time", "s", 1.0, (0.7, 2.0, 6.0)),),
        "the tip goes on moving after the motor stops",
    ),
    Kind("transmission.stick_slip", (Parameter("stick", "unit", 5e-3),), (), "the tip moves in jumps"),
    Kind(
        "transmission.drift",
        (Parameter("offset_drift", "unit/s", 5e-5), Parameter("width_drift", "1/s", 5e-4)),
        (),
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
        (Parameter("contact_c", "deg", 10.0), Parameter("contact_side", "", 1.0, (1.0, -1.0))),
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
        (),
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
        (Parameter("k1", "", 0.05), Parameter("k2", "", 0.05), Parameter("p1", "", 0.01), Parameter("p2", "", 0.01)),
        (),
        "the lens distorts otherwise than the rig says",
        needs="camera",
        folded=True,
    ),
    Kind("acquisition.delay", (Parameter("delay", "s", 0.01),), (), "the delay of the images is wrong", folded=True),
    Kind("acquisition.jitter", (Parameter("jitter", "s", 0.005),), (), "frame times are unsteady", needs="camera"),
)
BY_ID: Mapping[str, Kind] = {kind.id: kind for kind in LIBRARY}


@dataclass(frozen=True)
class Path:
    """What the simulation says at a number of scene times. All (n,) but image_px (n, 2), NaN without a camera."""

    c_deg: Array
    p: Array  # the play's centre coordinate
    side: Array  # the envelope that last carried the tip: +1 rising q, -1 falling, 0 not yet
    image_px: Array


def of_model(model: Model) -> dict[str, float]:
    """The parameters of a corrected model's effects that its tables, rig and delay do not hold already."""
    return {
        name: value
        for effect in model.effects
        if not BY_ID[effect.id].folded
        for name, value in effect.parameters.items()
    }


def simulate(
    model: Model,
    motor: Motor,
    scene_s: npt.ArrayLike,
    parameters: Mapping[str, float],
    start_deg: float | None = None,
    load_reference: float = 0.0,
    clock_offset_s: float = 0.0,
) -> Path:
    """The model with effects of these parameters (names of LIBRARY, values absolute) at scene times (n,), in any order.
    `motor` is used as it is: tautline.model.between_counts takes an encoder's steps out. clock_offset_s is added to its
    times where an effect depends on the time of the session (drift, shift). load_reference, mNm, is the load at which
    the model's tables hold. Stick-slip and jitter scatter at random: what is here is one course of the former, and
    nothing of the latter."""
    scene = np.asarray(scene_s, dtype=float) - parameters.get("delay", 0.0)
    c, p, side = _moved(model, motor, scene, parameters, start_deg, load_reference, clock_offset_s)
    return seen(model, motor, scene, parameters, clock_offset_s, c, p, side)


def seen(
    model: Model,
    motor: Motor,
    scene: Array,
    parameters: Mapping[str, float],
    clock_offset_s: float,
    c_deg: Array,
    p: Array,
    side: Array,
) -> Path:
    """The path of a tip that moved so, at scene times (n,): what comes after the configuration."""
    if not model.rig.has_camera:
        return Path(c_deg, p, side, np.full((len(c_deg), 2), np.nan))
    translation = 0.0 if motor.translation_mm is None else np.interp(scene, motor.t_s, motor.translation_mm)
    turn = 0.0 if motor.rotation_deg is None else np.interp(scene, motor.t_s, motor.rotation_deg)
    after = scene + clock_offset_s >= parameters.get("shift_time", np.inf)
    return Path(c_deg, p, side, image(model, c_deg, translation, turn, parameters, side, after))


def _moved(
    model: Model,
    motor: Motor,
    scene: Array,
    parameters: Mapping[str, float],
    start_deg: float | None,
    load_reference: float,
    clock_offset_s: float,
) -> tuple[Array, Array, Array]:
    """c, p and side at scene times (n,)."""
    times = np.concatenate([motor.t_s, scene])
    order = np.argsort(times, kind="stable")

    def at_all(values: Array | None, reference: float = 0.0) -> Array | None:
        if values is None:
            return None
        joined = np.concatenate([values, np.interp(scene, motor.t_s, values)])
        return np.ascontiguousarray(joined[order] - reference)

    sampled = _native.simulate_effects(
        {name: value for name, value in parameters.items() if name in NATIVE},
        model.q,
        model.width,
        model.c_deg,
        np.ascontiguousarray(times[order] + clock_offset_s),
        at_all(motor.q),
        at_all(motor.translation_mm),
        at_all(motor.rotation_deg),
        at_all(motor.load_mNm, load_reference),
        np.nan if start_deg is None else float(model.remaining_inverse(start_deg)),
    )
    restored = []
    for values in sampled:
        back = np.empty(len(times))
        back[order] = values
        restored.append(back[len(motor.t_s) :])
    c, p, side = restored
    return c, p, side


def image(
    model: Model,
    c_deg: Array,
    translation_mm: npt.ArrayLike,
    rotation_deg: npt.ArrayLike,
    parameters: Mapping[str, float],
    side: Array,
    after_shift: npt.NDArray[np.bool_],
) -> Array:
    """Where the marker is seen, (n, 2) px, with the effects of kinematics, registration and camera."""
    rig = model.rig
    assert rig.kinematics and rig.camera and rig.hand_eye
    bend = tip_bend(rig.kinematics, c_deg, parameters.get("curvature_gradient", 0.0))
    bend[:, 2] += np.asarray(translation_mm, dtype=float)
    base = geometry.about_base_z(rotation_deg, bend)
    tilt = np.array([parameters.get(f"tilt_{axis}", 0.0) for axis in "xyz"])
    if tilt.any():
        for way in (-1.0, 1.0):
            held = side == way
            base[held] = base[held] @ Rotation.from_rotvec(way * tilt, degrees=True).as_matrix().T
    for prefix, here in (("static", np.ones(len(c_deg), dtype=bool)), ("shift", after_shift)):
        turn = np.array([parameters.get(f"{prefix}_r{axis}", 0.0) for axis in "xyz"])
        move = np.array([parameters.get(f"{prefix}_{axis}", 0.0) for axis in "xyz"])
        if turn.any() or move.any():
            base[here] = base[here] @ Rotation.from_rotvec(turn, degrees=True).as_matrix().T + move
    return geometry.to_image(distorted(rig.camera, parameters), geometry.to_camera(rig.hand_eye, base))[0]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)


def tip_bend(kinematics: Kinematics, c_deg: Array, gradient: float) -> Array:
    """The marker (n, 3) mm in the section's frame when the curvature runs linearly from (1 - gradient) at the base to
    (1 + gradient) at the tip, times its mean c / length."""
    if gradient == 0.0:
        return geometry.tip_bend(kinematics, c_deg)[0]
    c = np.radians(np.asarray(c_deg, dtype=float))[:, None]
    s = 0.5 * (_NODES + 1.0)
    angle = c * (s + gradient * (s * s - s))
    length, tip = kinematics.bending_length_mm, kinematics.tip_length_mm
    x = 0.5 * length * (np.sin(angle) @ _WEIGHTS) + tip * np.sin(c[:, 0])
    z = 0.5 * length * (np.cos(angle) @ _WEIGHTS) + tip * np.cos(c[:, 0])
    return np.stack([x, np.zeros_like(x), z], axis=1)


def distorted(camera: Camera, parameters: Mapping[str, float]) -> Camera:
    """The camera with the effect's distortion on top of the rig's."""
    added = tuple(parameters.get(name, 0.0) for name in ("k1", "k2", "p1", "p2"))
    if not any(added):
        return camera
    k1, k2, p1, p2, k3 = camera.distortion
    return replace(camera, distortion=(k1 + added[0], k2 + added[1], p1 + added[2], p2 + added[3], k3))
