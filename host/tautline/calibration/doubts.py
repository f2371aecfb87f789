"""What the components of a calibration say of the instrument, its clock and its camera: reasons to doubt it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.calibration.components import CORRECTS, GAIN, LAW, Component, Components
from tautline.calibration.departures import SHARE, SPEED, STATES
from tautline.calibration.observations import Track
from tautline.encoder import between_samples
from tautline.quality import Reason
from tautline.rig import ANGLE
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

PREDICTS = 1.3  # residual over noise up to which a verdict is good (formats)
_LEFT = 2.0  # residual over noise, without its departures, from which a model does not predict
_MOST = 1.5  # the same, up to which it does where some frames show something else
_STRONG = 1.2  # of the noise: a departure that is a doubt whatever else is
_MOSTLY = 0.5  # of the strongest: one that has its part in what is left
_SHIFTED = 0.03  # of B: what leaving a component out would change, from which it is told
_STILL_MOVES = 0.83  # of the noise, in the last quarter: with the noise itself 1.3 times it
_SURE = 0.01  # of B, in sigma
_WHITE = 1.5  # frames for each independent one up to which scatter is of single frames
_SPEEDS = 1.5  # scatter of moving frames over that of resting ones, from which times are unsteady

_CYCLES = 4.0, 40.0  # of a ripple over what was measured
_RIPPLE = 0.02, 5.0  # of B, and of its sigma: less is none
_NO_WIDTH = 1e-12  # unit of q: B where there is none
_PLACES, _RATES = 160, 145  # at which B is looked at; of a ripple that are tried
_SMOOTHED = 0.4  # of the readings' noise: what smoothing leaves at a turn
_LEVELS = 0.5  # different values for each frame, below which a sensor rounds
_MUCH = 0.05  # of B: what is told, and in sigma, is no doubt below
_COARSE = 0.015  # of B: a motor's path between its samples is known no better

DRIVE = "calibrate again once it is mended, or let taut diagnose add it to the model"
# Component: code, what it looks like, what to do.
_MEANS: dict[str, tuple[str, str, str]] = {
    "phase.even": (
        "transmission.smooth_onset",
        "after a reversal the tip starts gradually, not at a corner",
        "one play leaves that out: " + DRIVE,
    ),
    "phase.odd": (
        "transmission.asymmetric_backlash",
        "after a reversal one way the tip starts otherwise than after one the other way",
        DRIVE,
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
    "turn.itself": (
        "repeatability",
        "where the tip rests after a turn differs from turn to turn",
        "look for stick-slip",
    ),
    "offset.recording": (
        "transmission.offset",
        "the tip's place at one motor position differs between the recordings",
        "re-tensioning, another posture or homing: calibrate with recordings of one state",
    ),
    "width.recording": (
        "transmission.backlash",
        "the backlash differs between the recordings, the last one's is kept",
        "re-tensioning or another posture: calibrate with recordings of one state",
    ),
    "offset.time": (
        "transmission.drift",
        "the tip's place at one motor position moves during the session",
        "warm the instrument up, check the cable's clamps, calibrate again",
    ),
    "offset.slip": (
        "transmission.slip",
        "the tip's place at one motor position jumped during the session",
        "look for a tooth or a winding that jumps, for lost counts or another posture; calibrate again",
    ),
    "width.time": (
        "transmission.drift",
        "the backlash grows or shrinks during the session",
        "re-tension the cable, warm the instrument up, calibrate again",
    ),
    "width.speed": ("transmission.rate_dependent_backlash", "the width depends on the motor's speed", DRIVE),
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
    "lag": ("transmission.lag", "the tip follows late, as through something viscous", DRIVE),
    "creep": ("transmission.creep", "the tip goes on moving after the motor has stopped", DRIVE),
    "load": ("transmission.load_dependence", "width, gain or offset follow the load", DRIVE),
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
    "tracker": (
        "tracker",
        "the marker's place errs anew along every stroke, as behind a video codec that holds back what moves little",
        "record raw or MJPEG frames, or give the codec more bits",
    ),
    "image.side": (
        "registration.direction_dependent",
        "the image lies elsewhere on the way up than on the way down",
        "the instrument tilts in its channel: guide it closer",
    ),
}


def doubts(
    components: Components,
    counted: npt.NDArray[np.bool_],
    unit: str,
    alone: float,
    rough: bool,
    *,
    ended: float | None = None,
) -> list[Reason]:
    """Likeliest first; mild where B holds, and the model predicts what was seen without its departures about as well as
    noise lets it. counted: the grid's places at which B was measured; unit: of q; alone: residual over noise of B,
    path and delay alone; rough: the motor's counts or noise show in the image; ended: what f_remain leaves, over the
    noise, where the model is that of the session's end: what changed before is not in `alone` then."""
    usual = max(float(np.median(components.width[counted])) if counted.any() else 0.0, 1e-12)
    sigma = float(np.sqrt(np.mean(components.sigma[counted] ** 2))) if counted.any() else np.inf
    strongest = max((part.rms for part in components.parts), default=0.0)
    reasons = []
    for part in components.parts:
        shift = float(np.sqrt(np.mean(part.shift[counted] ** 2))) if counted.any() else 0.0
        strong = np.hypot(1.0, part.rms) > PREDICTS
        if part.name == "turn" and shift < _SHIFTED * usual:
            strong = False  # a count is a count
        if ended is not None and part.name in STATES:
            predicts = _holds(part.name, components, ended) if strong else True
            held = predicts
        else:
            predicts = alone < _LEFT or part.rms < _MOSTLY * strongest
            held = not strong or part.rms < _STRONG
        moves = shift > max(_SHIFTED * usual, 3.0 * sigma)
        # What is uncertain of it is in sigma.
        doubted = moves and not (alone < PREDICTS and CORRECTS * shift < _SHIFTED * usual)
        if part.name.startswith(SPEED):
            shift = abs(float(part.values[0])) * (usual if part.name.endswith(SHARE) else 1.0)
            moves = shift > _SHIFTED * usual
            doubted = moves and not (alone < PREDICTS and LAW * shift < _MUCH * usual)
        if moves or strong or not predicts:
            kind = "turn.itself" if part.name == "turn" and not rough else part.name
            late = f", {components.late:.1f} in its last quarter: it goes on" if _goes_on(part.name, components) else ""
            reasons.append((part.chi2, _reason(kind, part, shift, unit, late, predicts and held and not doubted)))
    told = [reason for _, reason in sorted(reasons, key=lambda each: -each[0])]
    if components.noise > PREDICTS:
        told.append(_scatter(components, alone, sure=sigma < _SURE * usual))
    first: dict[str, Reason] = {}
    for reason in sorted(told, key=lambda each: each.mild):
        first.setdefault(reason.code, reason)
    return list(first.values())


def _holds(state: str, components: Components, ended: float) -> bool:
    """Whether a model holds what this came to: nothing still moves, and the image is where f_remain can put it. What
    happened once, or between recordings, is over."""
    if ended > PREDICTS * max(components.noise, 1.0):
        return False
    return not _goes_on(state, components)


def _goes_on(state: str, components: Components) -> bool:
    return state in STATES and state.endswith("time") and components.late > _STILL_MOVES


def _reason(kind: str, part: Component, shift: float, unit: str, late: str, mild: bool) -> Reason:
    code, says, remedy = _MEANS[kind.rstrip("0123456789.%")]
    return Reason(code, f"{says} ({part.rms:.1f} times the noise, {shift:.2g} {unit} of B{late})", remedy, mild=mild)


def _scatter(components: Components, alone: float, sure: bool) -> Reason:
    """sure: B is as well known as one would ask for with all that scatters in its sigma."""
    if alone < _MOST:  # of most frames
        says = f"some frames are far off ({components.noise:.1f} times the noise with them, {alone:.1f} without)"
        return Reason("outliers", says, "look for a second blob of the marker's colour", mild=True)
    times = f"{components.noise:.1f} times the noise of a tip at rest is left"
    if components.effective < _WHITE and components.moving > _SPEEDS:
        return Reason(
            "acquisition.jitter",
            f"{times}, from frame to frame, while the tip moves",
            "take the frames' hardware times",
        )
    if components.effective < _WHITE:
        return Reason(
            "noise",
            f"{times}, from frame to frame",
            "check light, focus and the marker's colour",
            mild=alone < _LEFT or sure,
        )
    return Reason("residual", f"{times}, which no known departure explains", "taut diagnose says where it is")


@dataclass(frozen=True)
class Floor:
    """What every stroke is wrong by alike: no scatter shows it, so it is added to B's sigma."""

    sigma: float  # unit of q
    reasons: tuple[Reason, ...]


def floor_of(tracks: Sequence[Track], grid: Array, width: Array, sigma: Array, unit: str) -> Floor:
    """grid, width and sigma where B was measured."""
    if len(grid) < 2:
        return Floor(0.0, ())
    reasons, usual = [], float(np.median(width))
    between = max(between_samples(track.path.sampled) for track in tracks)
    if between > _COARSE * usual:
        period = max(float(np.median(np.diff(track.reading.t_s))) for track in tracks)
        reasons.append(
            Reason(
                "rate",
                f"the motor's samples are {period * 1e3:.0f} ms apart, its turns are known to {between:.2g} {unit}",
                f"log the motor at {_faster_hz(period, between, _COARSE * usual)} Hz or more",
                mild=between < _MUCH * usual,
            )
        )
    scatter = _SMOOTHED * max(track.motor_noise for track in tracks)
    if scatter > _COARSE * usual:
        reasons.append(
            Reason(
                "encoder",
                f"the motor's readings scatter, its turns are known to {scatter:.2g} {unit}",
                "shield the encoder's lines, or take one with finer counts",
                mild=scatter < _MUCH * usual,
            )
        )
    rounded = max(_rounded(track) for track in tracks)
    if rounded > _COARSE * usual:
        reasons.append(
            Reason(
                "angle" if tracks[0].sensor == ANGLE else "tracker",
                f"the tip's place is told in steps: a turn is known to {rounded:.2g} {unit}",
                "read the sensor with more digits, or take a finer one",
                mild=rounded < _MUCH * usual,
            )
        )
    rippled, wave = _ripple(grid, width, sigma)
    if rippled < max(_RIPPLE[0] * usual, _RIPPLE[1] * float(np.median(sigma))):
        rippled = 0.0
    else:
        reasons.append(
            Reason(
                "actuator.encoder_periodic",
                f"B(q) ripples by {rippled:.2g} {unit} (rms) every {wave:.3g} {unit}, as an encoder may",
                "centre the encoder's magnet or disc and calibrate again",
            )
        )
    return Floor(float(np.sqrt(between**2 + scatter**2 + rounded**2 + rippled**2)), tuple(reasons))


_FINEST = 1e-3  # of what is seen: no rate is told that would mend more


def _faster_hz(period_s: float, between: float, allowed: float) -> int:
    """The rate at which straight lines between samples are within `allowed` of the motor's path, a round number: what
    they are off by falls as the period does at a sharp turn, and with its square at others."""
    least = between / max(allowed, _FINEST * between) / period_s
    decade = 10.0 ** math.floor(math.log10(least))
    return round(decade * next(step for step in (1, 2, 5, 10) if step * decade >= least * (1.0 - 1e-9)))


def _rounded(track: Track) -> float:
    """What the steps of a sensor that rounds are in the motor's positions, as a standard deviation; 0 of one that does
    not."""
    levels = np.unique(track.y[:, 0])
    if len(levels) > _LEVELS * len(track.y) or len(levels) < 2:
        return 0.0
    steep = float(np.ptp(track.y[:, 0])) / max(float(np.ptp(track.motor.q)), 1e-12)
    return float(np.median(np.diff(levels)) / np.sqrt(12.0) / max(steep, 1e-12))


def _ripple(grid: Array, width: Array, sigma: Array) -> tuple[float, float]:
    """(rms, period) of one wave that goes on all over what was measured, where B is likelier with it than as a smooth
    curve alone: rms 0 where it is not. B's shape is a cubic smoothing spline whose variance is the likeliest, with and
    without the wave; the wave's prior is as large as B, its rate anywhere alike."""
    at = np.linspace(grid[0], grid[-1], _PLACES)
    y, weight = np.interp(at, grid, width), np.interp(at, grid, sigma) ** -2
    basis = Basis(float(at[0]), float(at[-1]), _PLACES // 2)
    design, usual = basis.design(at).toarray(), max(float(np.median(width)), _NO_WIDTH)
    heavy = design * weight[:, None]
    rates = np.linspace(_CYCLES[0], _CYCLES[1], _RATES) / float(at[-1] - at[0])
    turn = 2.0 * np.pi * np.outer(rates, at)
    waves = np.stack([np.cos(turn), np.sin(turn)], axis=2)
    smooth, waved = np.inf, (np.inf, 0, np.zeros(2))
    for smoothing in np.logspace(-8, 8, 17) * float(np.median(weight)):
        system = heavy.T @ design + smoothing * basis.bending
        within = np.diag(weight) - heavy @ np.linalg.solve(system, heavy.T)
        without = float(y @ within @ y + np.linalg.slogdet(system)[1] - (basis.size - 2) * np.log(smoothing))
        seen = within @ waves
        pull = np.einsum("rnc,n->rc", seen, y)
        known = np.einsum("rnc,rnd->rcd", waves, seen) + np.eye(2) / usual**2
        size = np.linalg.solve(known, pull[..., None])[..., 0]
        gains = np.sum(pull * size, axis=1) - np.linalg.slogdet(usual**2 * known)[1] - 2.0 * np.log(_RATES)
        best = int(np.argmax(gains))
        smooth, waved = min(smooth, without), min(waved, (without - gains[best], best, size[best]), key=lambda w: w[0])
    surprise, best, size = waved
    there = surprise + GAIN < smooth  # what any departure has to gain
    return (float(np.linalg.norm(size)) / np.sqrt(2.0) if there else 0.0), 1.0 / float(rates[best])
