"""Reasons to doubt a calibration, from its components (components.py): what each component says of the instrument, its
clock and its camera; and from errors of B that all strokes share, which no scatter shows."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.linalg import eigh

from tautline.calibration.components import Component, Components
from tautline.calibration.departures import SHARE, SPEED, STATES
from tautline.calibration.findings import Findings
from tautline.calibration.mixed_model import REML_GAIN
from tautline.calibration.observations import Track
from tautline.calibration.worth import PREDICTS
from tautline.encoder import between_samples
from tautline.quality import Reason
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

KNOWN = 0.05  # tolerance: of B: what is less of it need not be told, nor that it is known so well
_WHITE = 1.5  # prior: frames for each independent one up to which scatter is of single frames
_SPEEDS = 1.5  # prior: scatter of moving frames over that of resting ones, from which times are unsteady

_CYCLES = 4.0, 40.0  # prior: of a ripple over what was measured
_PLACES, _RATES = 160, 145  # tolerance: at which B is looked at; of a ripple that are tried
_SMOOTHINGS = np.logspace(-8, 8, 17)  # tolerance: of the spline beside a ripple, over the usual weight of a place
_SMOOTHED = 0.4  # prior: of the readings' noise: what smoothing leaves at a turn
_COARSE = 0.015  # tolerance: of B: a motor's path between its samples is known no better
_FINEST = 1e-3  # tolerance: of what is seen: no rate is told that would mend more

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
        "the sensor's clock runs at another rate than the motor's",
        "take both times from one clock; the rate is taken out here, not in a prediction",
    ),
    "clock.drift": (
        "clock.drift",
        "the sensor's delay changes during the session",
        "fix the sensor's rate, of a camera exposure and frame rate",
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


def component_reasons(
    components: Components, counted: npt.NDArray[np.bool_], usual: float, unit: str, motor_visible: bool, good: bool
) -> list[Reason]:
    """A reason for each component, strongest first, then one for scatter that no component explains. good: the model
    predicts and B is known; then reasons are mild, and only components are told that would spoil either if they were
    left out. counted (grid,): where B was measured; usual: typical B there, unit of q; motor_visible: the motor's
    counts or noise show in the image, so that a component of turns is the encoder's."""
    late = components.late_change
    reasons = []
    for part in sorted(components.parts, key=lambda each: -each.chi2):
        shift = float(np.sqrt(np.mean(part.width_shift[counted] ** 2))) if counted.any() else 0.0
        if part.name.startswith(SPEED):
            shift = abs(float(part.values[0])) * (usual if part.name.endswith(SHARE) else 1.0)
        spoils = np.hypot(1.0, part.rms) > PREDICTS or shift > KNOWN * usual
        kept = not part.name.startswith("clock")  # what a clock departs by is taken out of its times: none is left
        if not spoils and (good or (kept and part.chi2 < REML_GAIN)):  # as likely not there
            continue
        kind = "turn.itself" if part.name == "turn" and not motor_visible else part.name
        still = f", {late:.1f} in its last quarter" if part.name in STATES and late > 0.0 else ""
        reasons.append(_reason_of_component(kind, part, shift, unit, still, good))
    if components.unexplained > PREDICTS:
        reasons.append(_reason_of_scatter(components, good))
    return reasons


def _reason_of_component(kind: str, part: Component, shift: float, unit: str, still: str, mild: bool) -> Reason:
    """The reason of one component. kind: its name or "turn.itself", a key of _MEANS once numbers and "%" at its end are
    taken off. shift: rms by which B would change without it, unit of q; still: words that are added, of what it does at
    the session's end."""
    code, says, remedy = _MEANS[kind.rstrip("0123456789.%")]
    return Reason(code, f"{says} ({part.rms:.1f} times the noise, {shift:.2g} {unit} of B{still})", remedy, mild=mild)


def _reason_of_scatter(components: Components, good: bool) -> Reason:
    """The reason of residuals that no departure explains. If all else is good: a few frames are far off. Else by their
    look: white, which is unsteady frame times if they are larger while the tip moves, and noise if not; or correlated
    between neighbours, which no known departure explains."""
    times = f"{components.unexplained:.1f} times the noise of a tip at rest is left"
    if good:  # most frames are predicted
        says = f"some frames are far off ({components.unexplained:.1f} times the noise with them)"
        return Reason(
            "outliers", says, "look for a second blob of the marker's colour, or what disturbs the sensor", mild=True
        )
    if components.frames_per_independent < _WHITE and components.moving_ratio > _SPEEDS:
        return Reason(
            "acquisition.jitter",
            f"{times}, from frame to frame, while the tip moves",
            "take the hardware's times of frames or values",
        )
    if components.frames_per_independent < _WHITE:
        return Reason(
            "noise",
            f"{times}, from frame to frame",
            "check light, focus and the marker's colour, or the sensor's wiring",
        )
    return Reason("residual", f"{times}, which no known departure explains", "taut diagnose says where it is")


def common_error(
    tracks: Sequence[Track], grid: Array, width: Array, sigma: Array, usual: float, unit: str, findings: Findings
) -> float:
    """The error of B, unit of q, that all strokes share, so that their scatter does not show it; in quadrature: the
    motor's path between its samples at turns, its readings' noise at turns, and a ripple of B (rms). Each that is large
    is noticed in the findings. grid, width, sigma (k,): B where it was measured; usual: typical B there; unit: of q. 0
    with fewer than two positions."""
    if len(grid) < 2:
        return 0.0
    each = [between_samples(track.path.sampled) for track in tracks]
    told = [value if np.isfinite(value) else 0.0 for value in each]  # of too few readings for a turn nothing is
    worst = int(np.argmax(told))
    between = told[worst]
    if between > _COARSE * usual:
        period = tracks[worst].reading.period_s
        findings.notice(
            "rate",
            f"the motor's samples are {period * 1e3:.0f} ms apart, its turns are known to {between:.2g} {unit}",
            f"log the motor at {_faster_hz(period, between, _COARSE * usual):.10g} Hz or more",
        )
    scatter = _SMOOTHED * max(track.motor_noise for track in tracks)
    if scatter > _COARSE * usual:
        findings.notice(
            "encoder",
            f"the motor's readings scatter, its turns are known to {scatter:.2g} {unit}",
            "shield the encoder's lines, or take one with finer counts",
        )
    rippled, wave = _ripple(grid, width, sigma, usual)
    if rippled:
        findings.notice(
            "actuator.encoder_periodic",
            f"B(q) ripples by {rippled:.2g} {unit} (rms) every {wave:.3g} {unit}, as an encoder may",
            "centre the encoder's magnet or disc and calibrate again",
        )
    return float(np.sqrt(between**2 + scatter**2 + rippled**2))


def _faster_hz(period_s: float, between: float, allowed: float) -> float:
    """The rate, Hz, at which the motor must be sampled so that straight lines between its samples are off its path by
    `allowed` at most. At samples period_s apart they are off by `between` (both in the unit of q), and the error is
    taken to fall with the period, as at a sharp turn. Rounded up to 1, 2 or 5 times a power of ten."""
    # At 1 / period_s samples a second the error is `between`; it falls with the period.
    least = between / max(allowed, _FINEST * between) / period_s
    decade = 10.0 ** math.floor(math.log10(least))
    return decade * next(step for step in (1, 2, 5, 10) if step * decade >= least * (1.0 - 1e-9))


def _ripple(grid: Array, width: Array, sigma: Array, usual: float) -> tuple[float, float]:
    """(rms, period), both in the unit of q, of a sine of constant amplitude in B; rms 0 if the restricted likelihood
    does not gain REML_GAIN (of twice its logarithm) by it. B width (k,) with sigma (k,) at grid (k,) is modelled as a
    cubic smoothing spline, with the likeliest smoothing with and without the sine, plus the sine. Its two amplitudes
    (cosine, sine) have the prior N(0, usual^2), and each of _RATES frequencies is as likely as any other."""
    at = np.linspace(grid[0], grid[-1], _PLACES)
    y, weight = np.interp(at, grid, width), np.interp(at, grid, sigma) ** -2
    basis = Basis(float(at[0]), float(at[-1]), _PLACES // 2)
    design = basis.design(at).toarray()
    rates = np.linspace(_CYCLES[0], _CYCLES[1], _RATES) / float(at[-1] - at[0])
    angle = 2.0 * np.pi * np.outer(rates, at)
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # (rates, 2, places)
    # The spline integrated out, in the basis V that makes what is told of it and its bending diagonal at once: V' along
    # V = 1 and V' bending V = bends, so that V' told V = trace (1 - bends / size), `tells`.
    told = design.T @ (weight[:, None] * design)
    along = told / np.trace(told) + basis.bending / basis.size
    bends, vectors = eigh(basis.bending, along, check_finite=False)
    tells = np.maximum(1.0 - bends / basis.size, 0.0) * np.trace(told)
    seen = (weight[:, None] * design) @ vectors
    y_seen, waves_seen = y @ seen, waves @ seen
    information_alone = np.einsum("rcn,n,rdn->rcd", waves, weight, waves) + np.eye(2) / usual**2
    # -2 log restricted likelihood: the best without a wave; with one (deviance, its rate's index, its amplitudes).
    smooth, waved = np.inf, (np.inf, 0, np.zeros(2))
    for smoothing in _SMOOTHINGS * float(np.median(weight)):
        system = tells + smoothing * np.maximum(bends, 0.0)
        volume = float(np.sum(np.log(system)) + np.linalg.slogdet(along)[1]) - basis.bending_rank * np.log(smoothing)
        without = float(weight @ y**2 - np.sum(y_seen**2 / system)) + volume
        pull = waves @ (weight * y) - waves_seen @ (y_seen / system)
        information = information_alone - (waves_seen / system) @ waves_seen.transpose(0, 2, 1)
        amplitudes = np.linalg.solve(information, pull[..., None])[..., 0]
        gains = np.sum(pull * amplitudes, axis=1) - np.linalg.slogdet(usual**2 * information)[1] - 2.0 * np.log(_RATES)
        best = int(np.argmax(gains))
        smooth = min(smooth, without)
        waved = min(waved, (without - gains[best], best, amplitudes[best]), key=lambda wave: wave[0])
    deviance, best, amplitudes = waved
    there = deviance + REML_GAIN < smooth  # what any departure has to gain
    return (float(np.linalg.norm(amplitudes)) / np.sqrt(2.0) if there else 0.0), 1.0 / float(rates[best])
