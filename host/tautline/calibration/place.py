"""The error that goes with the place: what the tracker does alike for as long as the marker is near.

Lossy video, glare, a lens and the marker's own shading move the marker by what is around it: neighbouring frames then
err alike, and say less than as many independent ones. Passes over the same places tell it from scatter at rest.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.playfit import Fitted, PreparedTrack
from tautline.independence import frames_each

Array = npt.NDArray[np.float64]

_WINDOW = 5.0  # tolerance: correlation times over which an autocorrelation is summed (Sokal)
_LONGEST = 0.5  # prior: of a stroke: alike for longer is no error of the tracker's but the path's or the width's own
_TOGETHER = 2.0  # prior: noises at rest within which two frames show one place
_MOSTLY = 0.7  # prior: of what neighbouring frames share, that other passes repeat
_ALIKE = 1.5  # tolerance: frames for each independent one, from which they err alike
_ITERATIONS = 10  # tolerance: steps at most
_FEWEST = 40  # tolerance: frames from which anything is said


@dataclass(frozen=True)
class PlaceNoise:
    """Errors per coordinate in the sensor's unit, px or deg."""

    rms: float  # of what neighbouring frames share
    at_rest: float  # scatter from frame to frame where nothing moves
    length: float  # along the image path, over which the error stays alike
    common: float  # rms of the part that passes at other times repeat at the same place
    effect: float  # frames that count as one independent frame; at least 1


def place_noise(fitted: Fitted) -> PlaceNoise | None:
    """From the residuals of a fit. None where too few frames counted."""
    parts = [_along(fitted, k) for k in range(len(fitted.masks))]
    error = np.concatenate([part.error for part in parts])
    if len(error) < _FEWEST:
        return None
    stroke = np.concatenate([part.stroke + 1_000_000 * k for k, part in enumerate(parts)])
    moving = np.concatenate([part.moving for part in parts])
    at = np.concatenate([part.at for part in parts])
    total2 = float(np.mean(error**2))
    rest2 = min(_at_rest(error, stroke, moving), total2)
    score = np.concatenate([part.score for part in parts])
    longest = max(int(_LONGEST * np.median(np.unique(stroke, return_counts=True)[1])), 1)
    effect = frames_each(score, longest, window=_WINDOW, group=stroke)
    step = np.abs(np.diff(at))[(stroke[1:] == stroke[:-1]) & moving[1:]]
    usual = float(np.median(step)) if len(step) else 0.0
    return PlaceNoise(
        rms=float(np.sqrt(total2 - rest2)),
        at_rest=float(np.sqrt(rest2)),
        length=0.5 * (effect - 1.0) * usual,
        common=_common(error[moving], at[moving], stroke[moving], float(np.sqrt(rest2))),
        effect=effect,
    )


def as_many_as_independent(fitted: Fitted) -> Fitted:
    """The same fit, its covariance that of as many frames as are independent."""
    noise = place_noise(fitted)
    return fitted if noise is None else replace(fitted, covariance=fitted.covariance * noise.effect)


def allowing_for_place(fitted: Fitted, noise: PlaceNoise | None) -> Fitted:
    """A fit again with what goes with the place in the noise of each frame: however many frames show the tip at rest,
    all are wrong by what is wrong there. Not where most of what neighbouring frames share is another in each pass."""
    if noise is None or noise.common <= _MOSTLY * noise.rms:
        return fitted
    tracks = [_noisier(fitted, k, noise.common) for k in range(len(fitted.masks))]
    fit = replace(fitted.fit, tracks=tracks, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves, iterations=_ITERATIONS)


def as_smooth_as_independent(fitted: Fitted, noise: PlaceNoise | None) -> Fitted:
    """A fit again, whose curves bend only for what frames that err alike tell together: else what a real joint does
    from stroke to stroke is taken for the shape of B."""
    if noise is None or noise.effect < _ALIKE:
        return fitted
    fit = replace(fitted.fit, frames_per_independent=noise.effect, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves, iterations=_ITERATIONS)


def _noisier(fitted: Fitted, k: int, common: float) -> PreparedTrack:
    """Track k, with more noise in each frame: together its frames know each place no better than `common`, sensor's
    unit."""
    prepared = fitted.fit.tracks[k]
    seen = fitted.fit.predicted(prepared.track, fitted.curves, fitted.fit.simulated[k].tip)
    step = np.linalg.norm(np.diff(seen, axis=0), axis=1)
    place = np.concatenate([[0], np.cumsum(step > _TOGETHER * prepared.track.sigma[1:])])
    frames = np.bincount(place, weights=prepared.use)[place]
    sigma = np.sqrt(prepared.track.sigma**2 + np.maximum(frames, 1.0) * common**2)
    return replace(prepared, track=replace(prepared.track, sigma=sigma))


@dataclass(frozen=True)
class _Along:
    """Frames of one track that count, along the path of the tip's image."""

    error: Array  # of the place along the path
    score: Array  # what it pulls a width or a path with
    at: Array  # where on the path
    stroke: npt.NDArray[np.int_]
    moving: npt.NDArray[np.bool_]


def _along(fitted: Fitted, k: int) -> _Along:
    """The counted frames of track k, their residuals taken along the path of the tip's image, sensor's unit."""
    fit, curves = fitted.fit, fitted.curves
    sim, mask = fit.simulated[k], fitted.masks[k]
    prepared = fit.tracks[k]
    slope = fit.slope_in_view(prepared.track, curves, sim.tip)
    steep = np.maximum(np.linalg.norm(slope, axis=1), 1e-12)
    weight = np.minimum(fitted.weights[k], 1.0)
    error = np.sum(fitted.residuals[k] * prepared.track.sigma[:, None] * slope, axis=1) / steep * np.sqrt(weight)
    stroke = sim.half_cycle
    at = np.interp(sim.p, *_path_length(sim.p[mask], steep[mask])) if mask.any() else sim.p
    return _Along(error[mask], (error * steep)[mask], at[mask], stroke[mask], sim.moving[mask])


def _path_length(p: Array, steep: Array) -> tuple[Array, Array]:
    """p in order, unit of q, and how long the image's path is up to each, steep (n,) being its length per unit of p."""
    order = np.argsort(p)
    p, steep = p[order], steep[order]
    length = np.concatenate([[0.0], np.cumsum(0.5 * (steep[1:] + steep[:-1]) * np.diff(p))])
    return p, length


def _at_rest(error: Array, stroke: npt.NDArray[np.int_], moving: npt.NDArray[np.bool_]) -> float:
    """Variance of the noise, from one frame to the next where the tip rests, else wherever it is; 0 where no two frames
    are of one stroke."""
    pair = stroke[1:] == stroke[:-1]
    still = pair & ~moving[1:] & ~moving[:-1]
    used = still if still.sum() >= _FEWEST else pair
    return 0.5 * float(np.mean(np.diff(error)[used] ** 2)) if used.any() else 0.0


def _common(error: Array, at: Array, stroke: npt.NDArray[np.int_], at_rest: float) -> float:
    """rms, sensor's unit, of the error that strokes share at one place, from products of frames that other strokes took
    in passing it; 0 where few did. Where the tip rests for many frames the path is what they show."""
    order = np.argsort(at)
    error, at, stroke = error[order], at[order], stroke[order]
    total, count = 0.0, 0
    for ahead in range(1, 6):
        pair = (stroke[ahead:] != stroke[:-ahead]) & (at[ahead:] - at[:-ahead] < _TOGETHER * max(at_rest, 1e-9))
        total += float(np.sum((error[ahead:] * error[:-ahead])[pair]))
        count += int(pair.sum())
    return float(np.sqrt(max(total / count, 0.0))) if count >= _FEWEST else 0.0
