"""Doubts about what was measured, before anything is predicted with it: a motion that tells too little, a tip whose
place is not known, a rig that is not of this set-up."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from tautline.calibration.acquisition import mistaken_unit
from tautline.calibration.choice import JOINT, PASSES
from tautline.calibration.measuring import Measured
from tautline.calibration.onset import BOUND, with_width
from tautline.calibration.playfit import NODES
from tautline.calibration.remaining import Remaining

Array = npt.NDArray[np.float64]

_UNIT_SLACK = 1.6  # prior: ratio by which f_coarse's gain and f_remain's may differ beside a mistaken unit
_LIKELY_GAIN = (0.4, 2.5)  # prior: range of f_remain's gain over f_coarse's that is no wrong scale
_LIKELY_BEND = 0.5  # prior: of f_coarse's span of angles: by how much f_remain may leave it
_TOLD = 0.1  # tolerance: of the span of angles: f_remain is not known if its sigma by the place is more
_OFF_PX, _OFF_NOISES = 5.0, 20.0  # prior: rms residual, px and times the noise: more is no marker where the rig has it
_LARGE = 0.1  # tolerance: of the image's motion (rms): a registration that is off by less still tells angles


def doubt_onsets_and_remaining(found: Measured) -> None:
    """Adds notes and doubts about onsets and f_remain: no turn, no onset, reversals that were not used, a tip that did
    not move, a rig that does not fit."""
    if found.options.beforehand is not None:
        found.findings.notes.append("B(q) was known beforehand, from other robots: these recordings add to it")
    if strays := sum(track.stray for track in found.tracks):
        elsewhere = "frames show the marker" if found.camera else "values are"
        found.findings.notes.append(f"{strays} {elsewhere} elsewhere for a while: left out")
    _doubt_onsets(found)
    remaining = found.remaining
    if remaining is None:
        found.findings.doubt(
            "coverage",
            "the tip was never seen to move, f_remain is f_coarse",
            "move by more than the backlash, within the view",
            fatal=True,
        )
        return
    found.findings.notes += remaining.notes
    _doubt_rig(found, remaining)


def _doubt_onsets(found: Measured) -> None:
    """Adds a fatal doubt if the motor never turned, a doubt if no reversal showed an onset, and notes on why reversals
    were not used. The second is mild if B is known otherwise (by the joint fit or the passes), whose own sigma and
    predictions judge it, unless a stroke moved nothing."""
    onsets, known_otherwise = found.onsets, found.source in (JOINT, PASSES)
    if not onsets:
        found.findings.doubt(
            "coverage", "the motor never turned back", "move back and forth by more than B", fatal=True
        )
    counted = with_width(onsets)
    bounds = [o for o in onsets if o.used and o.kind == BOUND]
    if onsets and not counted:
        longest = max((o.low for o in bounds), default=0.0)
        strokes = "1 stroke" if len(bounds) == 1 else f"{len(bounds)} strokes"
        moved = f", {strokes} up to {longest:.3g} {found.unit} moved nothing, so B is wider"
        found.findings.doubt(
            "coverage",
            f"none of {len(onsets)} reversals showed an onset" + (moved if bounds else ""),
            "make longer strokes" if bounds else "turn where the tip is seen to move",
            mild=known_otherwise and not bounds,
        )
    for reason in dict.fromkeys(o.reason for o in onsets if o.reason and not o.used):
        count = sum(o.reason == reason and not o.used for o in onsets)
        found.findings.notes.append(f"{count} of {len(onsets)} reversals not used: {reason}")


def doubt_place(found: Measured) -> None:
    """Adds a doubt about f_remain, not B, if what was followed is no marker at a known place: what the tip's own camera
    sees, or a place on a bare tip that was shown. It is mild for such a place if the angles' sigma by it is at most
    _TOLD of their span."""
    place, remaining = found.rig.place, found.remaining
    if remaining is None:
        return
    if found.rig.sees_from_tip:
        found.findings.doubt(
            "scene",
            "f_remain is not known from this, B is: what the tip's own camera sees turns by more than the tip "
            "does, by the tip's own way over its distance, and the offset is f_coarse's",
            "measure f_remain with a camera that sees the instrument, or an angle sensor",
        )
        return
    if place is None:
        if any(track.shown is not None for track in found.tracks):
            found.findings.doubt(
                "place",
                "f_remain is not known from this, B is: the recordings do not tell where on the tip the place lies",
                "show one place for all recordings (the same region.toml beside each video), or mark the tip",
            )
        return
    c = np.interp(np.linspace(*found.reached, NODES), found.grid, remaining.c_deg)
    sigma, bends = float(np.sqrt(np.mean(place.sigma_at(c) ** 2))), float(np.ptp(c))
    found.findings.evidence["place_sigma_deg"] = sigma
    unknown = sigma > _TOLD * bends
    found.findings.doubt(
        "place",
        ("f_remain is not known from this, B is" if unknown else "B is known as with a marker, f_remain less so")
        + f": {sigma:.2g} deg of {bends:.3g} deg, all of it together, as the place on the tip is not known",
        "give tip_length_mm of the place that was shown, show a smaller one, or mark the tip",
        mild=not unknown,
    )


def _doubt_rig(found: Measured, remaining: Remaining) -> None:
    """Adds doubts about the rig if f_remain's mean slope has another sign than f_coarse's or is not of its size
    (_LIKELY_GAIN), or if the marker is not where the rig puts it. Adds `gain` and `residual` to the evidence."""
    p = np.clip(found.grid, *found.reached)
    c = np.interp(p, found.grid, remaining.c_deg)
    gain = float(np.polyfit(p, c, 1)[0]) if np.ptp(p) > 0 else found.rig.coarse.gain
    found.findings.evidence["gain"] = gain
    ratio = gain / found.rig.coarse.gain
    if ratio < 0:
        image = "hand_eye, a mirrored image" if found.framed else "which way the sensor counts"
        found.findings.doubt(
            "coarse",
            f"the tip bends {gain:.3g} deg/{found.unit} where f_coarse says {found.rig.coarse.gain:.3g}",
            f"a sign is wrong: check encoder direction, coarse.gain, {image}",
        )
    elif not _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1]:
        found.findings.doubt(
            "coarse",
            f"the tip bends {gain:.3g} deg/{found.unit} where f_coarse says {found.rig.coarse.gain:.3g}",
            _remedy_of_scale(found, ratio),
            mild=found.camera and not _misplaced(found, remaining.residual),
        )
    found.findings.evidence["residual"] = remaining.residual
    if found.camera and _misplaced(found, remaining.residual):
        _doubt_registration(found, remaining.residual, ratio, p, c)


def _remedy_of_scale(found: Measured, ratio: float) -> str:
    """What to check, in words, if the tip bends `ratio` times as much as f_coarse says."""
    if name := mistaken_unit(ratio, found.unit, _UNIT_SLACK):
        return f"a motor in {name} looks like this: write q_{found.unit} of motor.csv in {found.unit}"
    if found.camera:
        return "check actuator.unit, the encoder's scale, camera.fx_px and the marker's distance"
    if name := mistaken_unit(1.0 / ratio, "deg", _UNIT_SLACK):
        return f"a sensor in {name} looks like this: write c_deg of angle.csv in deg"
    return "check actuator.unit, the encoder's scale, coarse.gain, and that angle.csv is in deg"


def _misplaced(found: Measured, residual: float) -> bool:
    """Whether the marker is not where camera, hand_eye and kinematics put it: its residual (px, rms) is more than both
    _OFF_PX and _OFF_NOISES times the noise."""
    return residual > max(_OFF_PX, _OFF_NOISES * float(np.median(found.tracks[0].sigma)))


def _doubt_registration(found: Measured, residual: float, ratio: float, p: Array, c: Array) -> None:
    """Adds a doubt about the registration: the marker is `residual` (px, rms) off the rig's path. It is fatal if
    f_remain also had to leave f_coarse by more than is likely and the residual is not small against the image's motion:
    then no angle means anything. ratio: f_remain's slope over f_coarse's; c (n,): f_remain, deg, at p (n,), unit of
    q."""
    coarse = found.rig.coarse
    bent = float(np.max(np.abs(c - (coarse.gain * p + coarse.offset))))
    whole = abs(coarse.gain) * float(np.ptp(p))
    moved = float(np.std(np.concatenate([t.y for t in found.tracks]), axis=0).max())
    likely = _LIKELY_GAIN[0] < ratio < _LIKELY_GAIN[1] and bent < _LIKELY_BEND * whole
    says = f"the marker is {residual:.3g} px (rms) off where camera, hand_eye and kinematics put it"
    if likely or residual < _LARGE * moved:
        found.findings.doubt("registration.static", says, "f_remain absorbs what it can, but check them")
        return
    found.findings.doubt(
        "registration.static",
        f"{says}, and f_remain had to leave f_coarse by {bent:.3g} of {whole:.3g} deg",
        "rig.toml is not of this set-up: check camera (fx_px, size), hand_eye, kinematics and coarse.gain",
        fatal=True,
    )
