"""What the components of a calibration say of the instrument, its clock and its camera: reasons to doubt it."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.calibration.components import Component, Components
from tautline.quality import Reason

Array = npt.NDArray[np.float64]

_EXPLAINED = 1.3  # residual over noise up to which a model explains its data (formats: good)
_SHIFTED = 0.03  # of B: what leaving a component out would change, from which it is told
_UM = 5e-3  # and at least this share of B's sigma beside it
_WHITE = 1.5  # frames for each independent one up to which scatter is of single frames
_SPEEDS = 1.5  # scatter of moving frames over that of resting ones, from which times are unsteady

_DRIVE = "calibrate again once it is mended, or let taut diagnose add it to the model"
# Component: code, what it looks like, what to do.
_MEANS: dict[str, tuple[str, str, str]] = {
    "phase.even": (
        "transmission.smooth_onset",
        "after a reversal the tip starts gradually, not at a corner",
        "one play leaves that out: " + _DRIVE,
    ),
    "phase.odd": (
        "transmission.asymmetric_backlash",
        "after a reversal one way the tip starts otherwise than after one the other way",
        _DRIVE,
    ),
    "stroke": (
        "repeatability",
        "the tip takes another path on every stroke",
        "look for stick-slip, a loose coupling or a slipping cable",
    ),
    "turn": (
        "encoder",
        "where the tip rests after a turn is not where the motor's counts say that it turned",
        "look for stick-slip, a coarse or noisy encoder",
    ),
    "offset.time": (
        "transmission.drift",
        "the tip's place at one motor position moves during the session",
        "warm the instrument up, check the cable's clamps, calibrate again",
    ),
    "width.time": (
        "transmission.drift",
        "the backlash grows or shrinks during the session",
        "re-tension the cable, warm the instrument up, calibrate again",
    ),
    "width.speed": ("transmission.rate_dependent_backlash", "the width depends on the motor's speed", _DRIVE),
    "clock.rate": (
        "clock.rate",
        "the camera's clock runs at another rate than the motor's",
        "take both times from one clock; the rate is taken out here, not in a prediction",
    ),
    "clock.drift": (
        "clock.drift",
        "the delay of the images changes during the session",
        "fix exposure and frame rate of the camera",
    ),
    "lag": ("transmission.lag", "the tip follows late, as through something viscous", _DRIVE),
    "creep": ("transmission.creep", "the tip goes on moving after the motor has stopped", _DRIVE),
    "load": ("transmission.load_dependence", "width, gain or offset follow the load", _DRIVE),
    "image.time": (
        "registration.drift",
        "the image moves slowly against the instrument",
        "fix camera and instrument to each other",
    ),
    "image.shift": (
        "registration.shift",
        "the image moved once against the instrument",
        "fix camera and instrument to each other and calibrate again",
    ),
    "image.breath": (
        "registration.breathing",
        "the image sways against the instrument, as with breathing",
        "hold the scope still while calibrating",
    ),
    "image.stroke": (
        "registration.repeatability",
        "the image is moved otherwise on every stroke",
        "fix camera and instrument to each other",
    ),
    "image.side": (
        "registration.direction_dependent",
        "the image lies elsewhere on the way up than on the way down",
        "the instrument tilts in its channel: guide it closer",
    ),
}


def doubts(found: Components, counted: npt.NDArray[np.bool_], unit: str, seen: str) -> list[Reason]:
    """Likeliest first. counted: the grid's places at which B was measured; unit: of q; seen: of the observations."""
    usual = max(float(np.median(found.width[counted])) if counted.any() else 0.0, 1e-12)
    sigma = float(np.sqrt(np.mean(found.sigma[counted] ** 2))) if counted.any() else np.inf
    reasons = []
    for part in found.parts:
        shift = float(np.sqrt(np.mean(part.shift[counted] ** 2))) if counted.any() else 0.0
        if np.hypot(1.0, part.rms) > _EXPLAINED or shift > max(_SHIFTED * usual, 3.0 * sigma):
            reasons.append((part.chi2, _reason(part, shift, unit)))
    told = [reason for _, reason in sorted(reasons, key=lambda each: -each[0])]
    if found.noise > _EXPLAINED:
        told.insert(0 if not told else len(told), _scatter(found, seen))
    return list({reason.code: reason for reason in reversed(told)}.values())[::-1]


def _reason(part: Component, shift: float, unit: str) -> Reason:
    code, says, remedy = _MEANS[part.name]
    return Reason(code, f"{says} ({part.rms:.1f} times the noise, {shift:.2g} {unit} of B)", remedy)


def _scatter(found: Components, seen: str) -> Reason:
    times = f"{found.noise:.1f} times the noise of a tip at rest is left"
    if found.effective < _WHITE and found.moving > _SPEEDS:
        return Reason(
            "acquisition.jitter",
            f"{times}, from frame to frame, while the tip moves",
            "take the frames' hardware times",
        )
    if found.effective < _WHITE:
        return Reason("noise", f"{times}, from frame to frame", "check light, focus and the marker's colour")
    return Reason("residual", f"{times}, which no known departure explains", "taut diagnose says where it is")
