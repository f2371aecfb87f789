"""The tracker's error that depends on the place in the image, and how many frames make one independent one.

Lossy video, glare, a lens and the marker's own shading move the marker by what is around it. Neighbouring frames then
err alike, and tell less than as many independent ones. What other passes repeat at the same places is such an error;
what they do not repeat is scatter, or the model's error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.observations import Mask
from tautline.calibration.playfit import Fitted
from tautline.calibration.simulated_track import PreparedTrack
from tautline.independence import frames_each

Array = npt.NDArray[np.float64]

_WINDOW = 5.0  # tolerance: correlation times over which an autocorrelation is summed (Sokal)
_LONGEST = 0.5  # prior: of a stroke: what stays alike for longer is the path's or the width's error, not the tracker's
_TOGETHER = 2.0  # prior: times the noise at rest, within which two frames show one place
_MOSTLY = 0.7  # prior: of what neighbouring frames share: least part that other passes repeat
_ALIKE = 1.5  # tolerance: frames for each independent one, from which they count as correlated
_ITERATIONS = 10  # tolerance: steps at most
_FEWEST = 40  # tolerance: frames from which anything is said
_NEIGHBOURS = 5  # tolerance: frames ahead on the path with which one is compared


@dataclass(frozen=True)
class PlaceNoise:
    """Errors per coordinate in the sensor's unit, px or deg."""

    rms: float  # of what neighbouring frames share
    at_rest: float  # scatter from frame to frame where nothing moves
    length: float  # along the image path, over which the error stays alike
    common: float  # rms of the part that passes at other times repeat at the same place
    effect: float  # design effect: frames that count as one independent frame; at least 1


def place_noise(fitted: Fitted) -> PlaceNoise | None:
    """How a fit's residuals are correlated along strokes, and what of them is repeated at places. None with fewer than
    _FEWEST counted frames. `length` is 0.5 (effect - 1) times the usual way between two frames of a moving tip: if an
    error's correlation falls as exp(-distance / length), about 1 + 2 length / way frames count as one."""
    whole = _joined_tracks([_errors_along_path(fitted, k) for k in range(len(fitted.masks))])
    error, at, stroke, moving = whole.error, whole.at, whole.stroke, whole.moving
    if len(error) < _FEWEST:
        return None
    total2 = float(np.mean(error**2))
    rest2 = min(_variance_at_rest(error, stroke, moving), total2)
    longest = max(int(_LONGEST * np.median(np.unique(stroke, return_counts=True)[1])), 1)
    effect = frames_each(whole.score, longest, window=_WINDOW, group=stroke)
    step = np.abs(np.diff(at))[(stroke[1:] == stroke[:-1]) & moving[1:]]
    usual = float(np.median(step)) if len(step) else 0.0
    return PlaceNoise(
        rms=float(np.sqrt(total2 - rest2)),
        at_rest=float(np.sqrt(rest2)),
        length=0.5 * (effect - 1.0) * usual,
        common=_repeated_by_passes(error[moving], at[moving], stroke[moving], float(np.sqrt(rest2))),
        effect=effect,
    )


def as_many_as_independent(fitted: Fitted) -> Fitted:
    """The same fit with its covariance multiplied by `PlaceNoise.effect`, as if it had been fitted to independent
    frames only."""
    noise = place_noise(fitted)
    return fitted if noise is None else replace(fitted, covariance=fitted.covariance * noise.effect)


def allowing_for_place(fitted: Fitted, noise: PlaceNoise | None) -> Fitted:
    """The fit made again with the error `common`, which goes with the place, added to the noise of each frame, so that
    any number of frames at one place tell it to `common` at best. The same fit if passes repeat less than _MOSTLY of
    what neighbouring frames share, or that is not known."""
    if noise is None or noise.common <= _MOSTLY * noise.rms:
        return fitted
    tracks = [_with_place_noise(fitted, k, noise.common) for k in range(len(fitted.masks))]
    fit = replace(fitted.fit, tracks=tracks, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves, iterations=_ITERATIONS)


def as_smooth_as_independent(fitted: Fitted, noise: PlaceNoise | None) -> Fitted:
    """The fit made again with smoothing for as many frames as are independent. (With less smoothing B bends to what a
    real joint does differently from stroke to stroke.) The same fit if frames are nearly independent, or that is not
    known."""
    if noise is None or noise.effect < _ALIKE:
        return fitted
    fit = replace(fitted.fit, frames_per_independent=noise.effect, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves, iterations=_ITERATIONS)


def _with_place_noise(fitted: Fitted, k: int, common: float) -> PreparedTrack:
    """Track k with each frame's variance increased by m common^2, where m is the number of frames in a row that show
    the same place: together they then tell that place to `common`, sensor's unit, at best."""
    prepared = fitted.fit.tracks[k]
    seen = fitted.fit.predicted(prepared.track, fitted.curves, fitted.fit.simulated[k].tip)
    step = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    place = np.concatenate([[0], np.cumsum(step > _TOGETHER * prepared.track.sigma[1:])])
    frames = np.bincount(place, weights=prepared.use)[place]
    sigma = np.sqrt(prepared.track.sigma**2 + np.maximum(frames, 1.0) * common**2)
    return replace(prepared, track=replace(prepared.track, sigma=sigma))


@dataclass(frozen=True)
class _PathErrors:
    """The counted frames of one track, or of all one after the other, (n,) all; sensor's unit."""

    error: Array  # residual along the path of the tip's image
    score: Array  # its part in the gradient by p: error times the path's slope over the noise's variance
    at: Array  # length of the path up to the frame
    stroke: npt.NDArray[np.int_]  # number of the half-cycle
    moving: Mask


def _errors_along_path(fitted: Fitted, k: int) -> _PathErrors:
    """The counted frames of track k, with their residuals projected on the direction of the image's path, sensor's
    unit, and multiplied by the root of the frame's weight."""
    fit, curves = fitted.fit, fitted.curves
    sim, mask = fit.simulated[k], fitted.masks[k]
    prepared = fit.tracks[k]
    slope = fit.slope_in_view(prepared.track, curves, sim.tip)
    steep = np.maximum(np.linalg.norm(slope, axis=1), 1e-12)
    weight = np.minimum(fitted.weights[k], 1.0)
    error = np.sum(fitted.residuals[k] * prepared.track.sigma[:, None] * slope, axis=1) / steep * np.sqrt(weight)
    stroke = sim.half_cycle
    at = np.interp(sim.p, *_path_length(sim.p[mask], steep[mask])) if mask.any() else sim.p
    score = error * steep / prepared.track.sigma**2
    return _PathErrors(error[mask], score[mask], at[mask], stroke[mask], sim.moving[mask])


def _joined_tracks(parts: Sequence[_PathErrors]) -> _PathErrors:
    """The frames of all tracks one after the other, strokes numbered on: no two tracks have a stroke in common."""
    strokes, before = [], 0
    for part in parts:
        strokes.append(part.stroke + before)
        before = int(strokes[-1].max(initial=before - 1)) + 1
    error, score, at, moving = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("error", "score", "at", "moving")
    )
    return _PathErrors(error, score, at, np.concatenate(strokes), moving)


def _path_length(p: Array, steep: Array) -> tuple[Array, Array]:
    """Positions p (n,) in rising order, unit of q, and the length of the image's path from the first to each of them
    (trapezoidal rule). steep (n,): the path's length per unit of p."""
    order = np.argsort(p)
    p, steep = p[order], steep[order]
    length = np.concatenate([[0.0], np.cumsum(0.5 * (steep[1:] + steep[:-1]) * np.diff(p))])
    return p, length


def _variance_at_rest(error: Array, stroke: npt.NDArray[np.int_], moving: Mask) -> float:
    """Half the mean squared difference of neighbouring frames' errors (n,) within strokes, which is the noise's
    variance: of resting frames, or of all if fewer than _FEWEST pairs rest; 0 without pairs."""
    pair = stroke[1:] == stroke[:-1]
    still = pair & ~moving[1:] & ~moving[:-1]
    used = still if still.sum() >= _FEWEST else pair
    return 0.5 * float(np.mean(np.diff(error)[used] ** 2)) if used.any() else 0.0


def _repeated_by_passes(error: Array, at: Array, stroke: npt.NDArray[np.int_], at_rest: float) -> float:
    """rms of the part of the error (n,) that different strokes share at one place: root of the mean product of two
    errors from different strokes, each with its next _NEIGHBOURS along the path if these are within _TOGETHER times
    at_rest, the noise. at (n,): place along the path; all in the sensor's unit. For frames that move only, as where the
    tip rests for many frames the path follows their errors. 0 with fewer than _FEWEST pairs."""
    order = np.argsort(at)
    error, at, stroke = error[order], at[order], stroke[order]
    total, count = 0.0, 0
    for ahead in range(1, _NEIGHBOURS + 1):
        pair = (stroke[ahead:] != stroke[:-ahead]) & (at[ahead:] - at[:-ahead] < _TOGETHER * max(at_rest, 1e-9))
        total += float(np.sum((error[ahead:] * error[:-ahead])[pair]))
        count += int(pair.sum())
    return float(np.sqrt(max(total / count, 0.0))) if count >= _FEWEST else 0.0
