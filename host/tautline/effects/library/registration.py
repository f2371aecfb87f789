"""The registration, the rigid transform from the instrument to the camera: wrong, shifted, or different by
direction."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tautline.effects.kind import Kind, Parameter, rigid_motion
from tautline.geometry import rotation
from tautline.model import Model
from tautline.rig import HandEye


def with_registration(
    model: Model, values: Mapping[str, float], session_s: float = 0.0, prefix: str = "static"
) -> Model:
    """The model with its rig's hand-eye transform changed to X_cam = R (Exp(turn) X + move) + t. values: PREFIX_rx,
    _ry, _rz, the turn as a rotation vector in deg, and PREFIX_x, _y, _z, the move in mm; missing ones are 0. Returns
    the model itself without a hand-eye transform or without values. session_s is not used."""
    rig = model.rig
    if rig.hand_eye is None or not values:
        return model
    turn = Rotation.from_rotvec([values.get(f"{prefix}_r{a}", 0.0) for a in "xyz"], degrees=True).as_matrix()
    move = np.array([values.get(f"{prefix}_{a}", 0.0) for a in "xyz"])
    old = rotation(rig.hand_eye.rotation_deg)
    rz, ry, rx = Rotation.from_matrix(old @ turn).as_euler("ZYX", degrees=True)
    t = old @ move + np.asarray(rig.hand_eye.translation_mm)
    hand_eye = HandEye((float(rx), float(ry), float(rz)), (float(t[0]), float(t[1]), float(t[2])))
    return replace(model, rig=replace(rig, hand_eye=hand_eye))


def _with_shift(model: Model, values: Mapping[str, float], session_s: float) -> Model:
    """The model with the registration shifted if session_s is shift_time, s, or later; before it the model itself."""
    return with_registration(model, values, prefix="shift") if session_s >= values["shift_time"] else model


EFFECTS = (
    Kind(
        "registration.static",
        rigid_motion("static"),
        says="wrong hand-eye transform",
        tell="The marker is off its track everywhere, in all recordings alike; B fits all the same.",
        mend="Measure hand_eye again, or take over the corrected model's.",
        needs="camera",
        holds=with_registration,
        law=True,
        nominal=True,
    ),
    Kind(
        "registration.direction_dependent",
        (Parameter("tilt_x", "deg", 0.3), Parameter("tilt_y", "deg", 0.3), Parameter("tilt_z", "deg", 0.3)),
        (
            Parameter("tilt_pivot", "mm", 5.0, (0.0,)),
            Parameter("tilt_travel", "unit", 2e-3, (4e-3, 0.03, 0.12), low=0.0, high=0.3),
            Parameter("tilt_driven", "", 1.0, (0.0, 1.0), searched=True),
        ),
        says="the registration tilts with the direction of motion",
        tell="The marker's track on the way up lies beside that on the way down; an external angle sensor sees no "
        "difference.",
        mend="The instrument tilts in its channel: guide it more closely.",
        needs="camera",
        leaves="channel",
    ),
    Kind(
        "registration.shift",
        rigid_motion("shift"),
        (Parameter("shift_time", "s", 1.0, searched=True),),
        says="the registration changes once, during a recording or between two tests",
        tell="At one moment the whole track moves in the image and stays there.",
        mend="Fix camera and instrument to each other and calibrate again.",
        needs="camera",
        holds=_with_shift,
        law=True,
        scan="moment",
    ),
)
