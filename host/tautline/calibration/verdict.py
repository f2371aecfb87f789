"""From what was measured to a calibration: its model, what that predicts, and the verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from tautline.calibration import clock, coverage
from tautline.calibration.backlash import SLOPE_UNTOLD
from tautline.calibration.choice import JOINT, NOTHING, ONSETS, PASSES
from tautline.calibration.doubts import KNOWN, common_error, component_reasons
from tautline.calibration.measured_doubts import doubt_onsets_and_remaining, doubt_place
from tautline.calibration.measuring import Measured
from tautline.calibration.observations import usual_width
from tautline.calibration.onset import Delay, motor_speed, sigma_or_nominal, with_width
from tautline.calibration.remaining import pose_of
from tautline.calibration.result import Calibration, finite_or_none, foretold, onset_json
from tautline.calibration.smooth import overlap
from tautline.calibration.worth import PREDICTS, Worth, predictive_worth
from tautline.elements import SINGLE, Elements
from tautline.friction import Friction
from tautline.geometry import coarse_range_deg
from tautline.model import Model, Uncertainty
from tautline.nearest import Nearest
from tautline.quality import Quality, Reason
from tautline.undone import stands_in

Array = npt.NDArray[np.float64]

_SHOWN, _ODD = 3000, 10.0  # tolerance: frames of a picture; angles over the coarse range's largest: more is no angle
_TOLD_S = 0.001  # tolerance: standard deviation to which the offset of a clock that was off has to be known


@dataclass(frozen=True)
class _Extent:
    """Where B was measured, and how large it typically is there."""

    measured: tuple[float, float]  # lowest and highest position, unit of q
    inside: npt.NDArray[np.bool_]  # (grid,) between them
    usual: float  # typical B there, unit of q


def judged_calibration(found: Measured) -> Calibration:
    """Makes the calibration of what was measured: adds doubts, completes B's sigma by what no scatter shows, makes the
    model and its predictions, and judges them: verdict, reasons and notes."""
    doubt_onsets_and_remaining(found)
    doubt_place(found)
    extent = _extent(found)
    found = replace(found, sigma=_complete_sigma(found, extent))
    pass_width, pass_sigma = found.choice.opinion_of_passes(found.onsets, found.onset_curve, found.passes)
    characteristic = _characteristic(found, found.delay.delay_s)
    delay_of_tracks_s = found.delay.delay_s
    aligned, delay = found.aligned.with_delay(_delay_with_tracker_lag(found), found.nominal_s)
    found = replace(found, delay=delay)
    _doubt_clock(found, aligned, delay)
    model = _model(found, aligned, extent.measured)
    gaps = _gaps(found, model)
    predictions = _predictions(found, replace(model, delay_s=delay_of_tracks_s))
    _judge(found, predictions, extent)
    notes = tuple(dict.fromkeys(found.findings.notes))
    extra = _extra(found, notes, characteristic, pass_width)
    quality = Quality.of(found.findings.reasons)
    model = replace(model, quality=quality, extra=extra, uncertainty=_uncertainty(found))
    return Calibration(
        model=model,
        onsets=tuple(found.onsets),
        delay=delay,
        source=found.source,
        onset_curve=found.onset_curve,
        pass_width=pass_width,
        pass_sigma=pass_sigma,
        evidence=found.findings.evidence,
        notes=notes,
        names=tuple(track.name for track in found.tracks),
        offsets=aligned.offsets,
        predicted=tuple(foretold(model, track, delay_of_tracks_s) for track in found.tracks),
        gaps=gaps,
        path=None if found.joint_fit is None else found.joint_fit.path(),
    )


def _delay_with_tracker_lag(found: Measured) -> Delay:
    """The delay, its sigma increased (in quadrature) by the time, s, by which the tracker may show a moving tip
    late."""
    delay, lag_s = found.delay, 0.0 if found.components is None else found.components.tracker_lag_s
    return replace(delay, sigma_s=float(np.hypot(delay.sigma_s, lag_s)))


def _gaps(found: Measured, model: Model) -> tuple[coverage.Gap, ...]:
    """The stretches of the range in which B can be seen but is not measured. Adds a note on each."""
    joint_fit = found.joint_fit
    apart = None if joint_fit is None else coverage.distance_to_both_ways(joint_fit, found.grid)
    gaps = coverage.gaps(model, apart)
    found.findings.notes += [f"{gap.says(found.unit)}, and is held there" for gap in gaps]
    return gaps


def _predictions(found: Measured, model: Model) -> Worth | None:
    """How well the model predicts its own recordings; None if nothing could be predicted. Adds that to the evidence,
    and its doubts to the reasons. model: at the delay that the tracks have."""
    fit_of_remaining = None if found.remaining is None else found.remaining.fitted
    tracks = [each.track for each in found.ended] or found.tracks
    worth = predictive_worth(model, tracks, found.joint_fit, fit_of_remaining)
    if worth is not None:
        found.findings.reasons += worth.doubts
        found.findings.evidence |= {
            "error": worth.model,
            "foretold_over_noise": worth.over_noise,
            "foretold_blocks": float(worth.blocks),
            "error_coarse": worth.coarse,
            "error_constant": worth.constant,
        }
    return worth


def _judge(found: Measured, predictions: Worth | None, extent: _Extent) -> None:
    """Completes the reasons for the verdict. The model holds if its error on blocks that the fit has not seen, with
    what goes on to change, is within PREDICTS times the noise. Then what departs from it, held samples and a gradual
    start are mild, else doubts. If only its error is too large, and nothing departs or is doubted, a reason says so
    (`_unexplained`). Last, B must be known (`_doubt_sigma`). predictions: None if nothing could be predicted;
    found.sigma: with all that is uncertain."""
    components, frames = found.components, sum(len(track.t_s) for track in found.tracks)
    predicts = predictions is None or predictions.predicts
    goes_on = 0.0 if components is None else components.late_change  # as much again is expected in as long a time
    holds = math.hypot(1.0 if predictions is None else predictions.over_noise, goes_on) <= PREDICTS
    if found.held > 0:
        found.findings.notice(
            "acquisition.held_samples",
            f"{frames / (1.0 - found.held) * found.held:.0f} frames repeat a place that the tip had left",
            "let the tracker say when it does not see the marker",
        )
    if not found.hysteresis.single and not predicts:
        held = "several plays" if isinstance(found.hysteresis, Elements) else "Bouc-Wen's and Dahl's equations"
        found.findings.notice(
            "transmission.smooth_onset",
            f"after a reversal the tip starts gradually, and not as {held} do",
            "its hysteresis is of another kind: expect as much of a prediction",
        )
    departs: list[Reason] = []
    if components is not None:
        motor_visible = components.count_visible or any(track.motor_noise > 0 for track in found.tracks)
        departs = component_reasons(components, extent.inside, extent.usual, found.unit, motor_visible, holds)
    doubted = departs or any(not reason.mild for reason in found.findings.reasons)
    if predictions is not None and not predicts and not doubted:
        found.findings.reasons.append(_unexplained(found, predictions))
    found.findings.noticed = [*departs, *found.findings.noticed]
    found.findings.judge(holds)
    if not holds and found.camera:
        found.findings.reasons += clock.delay_jumps(found.tracks, found.rig)
    if found.source != NOTHING:
        _doubt_sigma(found, extent, holds)


def _doubt_sigma(found: Measured, extent: _Extent, holds: bool) -> None:
    """Adds a doubt of code "coverage" if B is measured at one place only, or if the rms of its sigma over the typical B
    is above KNOWN. The remedy is for the cause of more than half of that variance (the delay, or the law by which B
    follows the speed), else for too little motion. It is mild if the model predicts (holds) and sigma without the
    delay's part is within KNOWN: the errors of B and delay go together, and cancel in a prediction."""
    inside, usual, joint_fit = extent.inside, extent.usual, found.joint_fit
    if not inside.any():
        found.findings.doubt(
            "coverage", "B(q) is measured at one place only", "drive more slowly, and turn at more places"
        )
        return
    unsure = found.sigma[inside] / usual
    by_delay = np.zeros_like(unsure)
    if joint_fit is not None and joint_fit.width_by_delay is not None:
        by_delay = joint_fit.delay_sigma * joint_fit.width_by_delay[inside] / usual
    all_of_it, of_delay = (float(np.mean(part**2)) for part in (unsure, by_delay))
    if all_of_it <= KNOWN**2:
        return
    more = "move back and forth for longer, and turn at more places"
    if of_delay > 0.5 * all_of_it:
        more = "move at several speeds: at one a delay and a width look alike"
    elif (found.findings.evidence.get("width_by_law_of_speed", 0.0) / usual) ** 2 > 0.5 * all_of_it:
        more = "move slowly too: slower than what was seen, B may follow another law of the speed"
    mild = holds and all_of_it - of_delay <= KNOWN**2
    share = float(np.sqrt(all_of_it))
    says = f"B(q) is known to {share * usual:.2g} {found.unit} only ({share:.1%} of {usual:.2g} {found.unit})"
    found.findings.doubt("coverage", says, more, mild=mild)


def _unexplained(found: Measured, predictions: Worth) -> Reason:
    """The reason to give if a model does not predict although nothing departs from it: the paper's way to f_remain, if
    that was used; the rig's path in the image, if the fit without that path leaves only noise; else that the cause is
    not known."""
    times = f"{predictions.over_noise:.1f} times the noise"
    joint_fit, remaining = found.joint_fit, found.remaining
    if remaining is not None and remaining.fitted is None:
        says = f"what was seen is foretold to {times} by the paper's median line"
        return Reason("residual", says, "fit f_remain directly, without --remaining morphological")
    if found.camera and joint_fit is not None and found.choice.residual_with_width(joint_fit, found.width) <= PREDICTS:
        says = f"the tip's path in the image is not the rig's: {times} is left"
        return Reason("registration.static", says, "check hand_eye, kinematics and the camera's calibration")
    says = f"what the fit has not seen is foretold to {times}"
    return Reason("residual", says, "taut diagnose says where it is")


def _extent(found: Measured) -> _Extent:
    """Where B was measured, and how large it typically is there."""
    measured = _measured_range(found)
    inside = (found.grid > measured[0]) & (found.grid < measured[1])
    return _Extent(measured, inside, usual_width(found.width[inside], found.domain.span))


def _measured_range(found: Measured) -> tuple[float, float]:
    """The lowest and highest position, unit of q, at which B is measured. With friction the tip starts to move at every
    turn, wherever that is: then it is the range that was passed both ways near the envelopes."""
    if found.joint_fit is not None and isinstance(found.hysteresis, Friction):
        low, high = overlap(found.joint_fit)
        if low < high:
            return low, high
    return found.choice.measured_range(found.onset_curve, found.joint_fit, found.source)


def _complete_sigma(found: Measured, extent: _Extent) -> Array:
    """(grid,) B's sigma with errors that its scatter does not show. Always those that all strokes share; SLOPE_UNTOLD
    times the distance beyond what was measured, unless B was known beforehand. For B of the onsets also the delay's
    error at the motor's speed, by which all of them are late alike; else what B may change by where the tip passed one
    way only."""
    inside = extent.inside
    known_at = found.grid[inside], found.width[inside], found.sigma[inside]
    floor = common_error(found.tracks, *known_at, extent.usual, found.unit, found.findings)
    known = found.options.beforehand is not None and found.source in (JOINT, PASSES)
    beyond = np.abs(found.grid - np.clip(found.grid, *extent.measured))
    sigma = np.hypot(np.hypot(found.sigma, floor), 0.0 if known else SLOPE_UNTOLD * beyond)
    if found.source == ONSETS:
        speeds = [motor_speed(onset, found.tracks[onset.track]) for onset in with_width(found.onsets)]
        late = float(np.median(speeds)) * sigma_or_nominal(found.delay.sigma_s) if speeds else 0.0
        sigma = np.hypot(sigma, late)
    elif found.joint_fit is not None:
        one_way = found.choice.sigma_where_passed_one_way(found.joint_fit, found.width, inside)
        sigma = np.hypot(sigma, one_way)
    return np.asarray(sigma)


def _doubt_clock(found: Measured, aligned: clock.AlignedTracks, delay: Delay) -> None:
    """Adds a fatal doubt if a sensor's clock was off and its offset is not known to _TOLD_S, and a note if nothing told
    the delay."""
    if any(aligned.offsets_s) and delay.sigma_s > _TOLD_S:
        found.findings.doubt(
            "clock.offset",
            f"the sensor's clock was off, and its offset is known to {2e3 * delay.sigma_s:.2g} ms only (2 sigma)",
            "put both on one clock"
            + (": what a codec or glare holds back of the marker looks like a delay" if found.camera else ""),
            fatal=True,
        )
    if not np.isfinite(delay.sigma_s):
        found.findings.notes.append(
            f"no stop of the tip told the delay: the nominal {delay.delay_s * 1e3:.0f} ms is used"
        )


def _model(found: Measured, aligned: clock.AlignedTracks, measured: tuple[float, float]) -> Model:
    """The model, without verdict, uncertainty and extra. A board can hold a few plays only: if it cannot hold the
    hysteresis a note says which plays come nearest, and a model with friction carries these beside it."""
    coarse, remaining = found.rig.coarse, found.remaining
    c = remaining.c_deg if remaining is not None else coarse.gain * found.grid + coarse.offset
    c_sigma = remaining.sigma_deg if remaining is not None else np.full(len(c), np.nan)
    if found.rig.place is not None:
        c_sigma = np.hypot(c_sigma, found.rig.place.sigma_at(c))
    model = Model(
        found.rig, found.grid, found.width, found.sigma, c, found.delay.delay_s, measured, c_sigma=c_sigma,
        sensor=found.tracks[0].sensor, offset_s=aligned.offset_s,
        effects=() if found.effects is None else found.effects[0].to_effects(found.effects[1]),
        elements=found.hysteresis if isinstance(found.hysteresis, Elements) else SINGLE,
        friction=found.hysteresis if isinstance(found.hysteresis, Friction) else None,
        load_reference_mNm=found.load_mNm,
    )  # fmt: skip
    if (near := stands_in(model)) is not None:
        found.findings.notes.append(_note_of_plays(found, near))
        model = model if model.friction is None else replace(model, elements=near.elements)
    return model


def _extra(
    found: Measured, notes: Sequence[str], characteristic: dict[str, Any], pass_width: Array | None
) -> dict[str, Any]:
    """The object `extra` of model.json: what report.html tells of the calibration beside the model's tables. found:
    what was measured and judged. notes: as the result has them. characteristic: lists `q`, unit of q, and `c_deg`, of
    `_characteristic`. pass_width (nodes,): B from the passes alone, unit of q, on model.q; NaN, then null, where ways
    up and down do not overlap; None, then left out, where they nowhere do. Of the options what was known of B
    beforehand is left out: it is curves by other robots (Beforehand), and nothing that a user chose."""
    names = tuple(track.name for track in found.tracks)
    extra: dict[str, Any] = {
        "source": found.source,
        "onsets": [onset_json(o, names) for o in found.onsets],
        "evidence": {key: finite_or_none(value) for key, value in found.findings.evidence.items()},
        "notes": list(notes),
        "characteristic": characteristic,
        "options": asdict(replace(found.options, beforehand=None)),
    }
    if pass_width is not None:
        extra["pass_width"] = [finite_or_none(v) for v in pass_width]
    return extra


def _uncertainty(found: Measured) -> Uncertainty:
    """The model's errors beside its tables' sigmas. Its noise, px or deg, is the larger of what f_remain's fit leaves
    and of the error on the blocks left out; None if neither is known."""
    evidence, joint_fit = found.findings.evidence, found.joint_fit
    left = [value for name in ("residual", "error") if 0.0 < (value := evidence.get(name, np.nan)) < np.inf]
    by_delay = joint_fit.width_by_delay if joint_fit is not None and found.source == JOINT else None
    return Uncertainty(
        noise=max(left, default=None),
        noise_times=None if found.remaining is None else found.remaining.noise_times,
        delay_sigma_s=finite_or_none(found.delay.sigma_s),
        width_by_delay=by_delay,
        tracked_px=max(track.tracked_px for track in found.tracks),
    )


def _note_of_plays(found: Measured, near: Nearest) -> str:
    """The note that a board's tables hold a few plays (near) instead of the found hysteresis, and what share these
    leave of what there is to undo."""
    plays = f"{len(near.elements.width)} plays, which leave {100.0 * near.share:.2g} % of what there is to undo"
    if isinstance(found.hysteresis, Friction):
        its = found.hysteresis.says(found.unit)
        return f"its hysteresis is {its}: a board's tables and what follows the tip in use hold {plays}"
    return f"its hysteresis is {len(found.hysteresis.width)} plays: a board's tables hold {plays}"


def _characteristic(found: Measured, delay_s: float) -> dict[str, Any]:
    """About _SHOWN frames of (q, c) for the report's picture, at this delay, s: lists `q`, unit of q, and `c_deg`, the
    bending angle by pose, without angles that are far off the coarse range (_ODD)."""
    stride = max(1, sum(len(track.t_s) for track in found.tracks) // _SHOWN)
    tracks = [track.only(slice(None, None, stride)) for track in found.tracks]
    q = np.concatenate([t.motor_at(t.scene_s(delay_s)) for t in tracks])
    c = np.concatenate([pose_of(t, found.rig, delay_s) for t in tracks])
    low, high = coarse_range_deg(found.rig)
    good = np.flatnonzero(np.isfinite(c) & (np.abs(c) < _ODD * max(abs(low), abs(high), 1.0)))
    return {"q": np.round(q[good], 5).tolist(), "c_deg": np.round(c[good], 4).tolist()}
