"""How the joint fit of B, path and delay (playfit.py) is begun and which frames it counts; and the fit of the passes
alone, whose B is the distance between the ways up and down away from the reversals.

The first approach is the frames before the tip was driven both ways through the backlash: there B cannot be told from
the play's unknown start."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.backlash import WidthCurve
from tautline.calibration.beforehand import Beforehand
from tautline.calibration.observations import Mask, NoiseByPlace, Track, with_noise
from tautline.calibration.playfit import STRAY, Curves, Fitted, PlayFit, Point, rms_of_frame_powers
from tautline.calibration.simulated_track import PreparedTrack, Simulated
from tautline.coarse_grid import least_of
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

SPANS = 100  # tolerance: of B and of the path: a bump of B 0.6 mm wide on 10 mm has six of them
_MOST_FRAMES = 12000  # tolerance: of one fit; more are thinned out evenly
_SCANNED = 3000  # tolerance: frames, about, that tell where a fit begins
_REPEATS = 1.6  # prior: residual of the first approach over that of the rest, up to which it counts
_HARMLESS = 1.15  # tolerance: ratio by which the rest's residual may grow when the first approach counts
_PARTS, _AGAIN = 5, 4  # tolerance: parts in which strokes are left out in turn; steps of each fit without them
_FEWEST = 40  # tolerance: frames that a joint fit is tried with
_LEAST_SHARE = 0.25  # tolerance: of the frames that may count: fewer say nothing of a start's B
_LEAST_BOTH_WAYS = 0.8  # tolerance: of the positions seen, which the frames of either direction have in common
_FEW_ONE_WAY = 5  # tolerance: frames of one direction, from which their range is told
_REACHES = 0.02  # tolerance: of the domain: positions that go farther than what is covered both ways
_ROUGH_SPANS = 8, 16  # tolerance: of B and of the path, where the fit begins
_CONSTANT = np.linspace(0.0, 0.4, 41)  # tolerance: of the domain: constant B that are tried first
_ROUGH_STEPS, _STEPS_OF_PASSES = 7, 8  # tolerance: of the fit that begins, and of the passes alone, at most
_PLACES_EACH = 4  # tolerance: places at which a curve is asked for each coefficient of a spline


@dataclass(frozen=True)
class Domain:
    """Motor positions that tables cover: the rig's range and whatever the motor reached beyond it."""

    low: float
    high: float

    @property
    def span(self) -> float:
        """Its length, unit of q."""
        return self.high - self.low


def prepare_tracks(tracks: Sequence[Track], delay_s: float) -> list[PreparedTrack]:
    """Tracks prepared for a fit without poses, with the noise of each place. Only frames at which translation and
    rotation are where they mostly are may count, thinned out evenly to _MOST_FRAMES in all."""
    reference = tracks[0].others_reference
    stride = _counted_stride(sum(len(track.t_s) for track in tracks))
    prepared = []
    places = [track.motor_at(track.scene_s(delay_s)) for track in tracks]
    noise = NoiseByPlace.of(tracks, places)
    for track, place in zip(tracks, places, strict=True):
        track = with_noise(track, noise, place)
        use: Mask = track.at_reference(track.scene_s(delay_s), reference)
        if stride > 1:
            use &= np.arange(len(use)) % stride == 0
        prepared.append(PreparedTrack.of(track, use))
    return prepared


def _counted_stride(frames: int) -> int:
    """The stride k so that, if every k-th of this many frames counts, at most _MOST_FRAMES do."""
    return max(1, -(-frames // _MOST_FRAMES))


def fit_jointly(
    prepared: Sequence[PreparedTrack],
    domain: Domain,
    delay_s: float,
    *,
    fit_delay: bool,
    guess: WidthCurve | None = None,
    beforehand: Beforehand | None = None,
) -> Fitted | None:
    """The joint fit of B, the path in the sensor's own coordinates, and the delay (held at delay_s unless fit_delay) to
    all frames. guess: a B to begin with. What is known of the path beforehand is used only if a fit without it gives a
    path that may be one of those. None if the tip was never driven through a backlash, or too few frames were seen."""
    if beforehand is None or not beforehand.path:
        return _fit_in_steps(prepared, domain, delay_s, fit_delay, guess, beforehand)
    fitted = _fit_in_steps(prepared, domain, delay_s, fit_delay, guess, replace(beforehand, path=()))
    if fitted is None or not _path_may_be_one_of(beforehand, fitted):
        return fitted
    fit = replace(fitted.fit, beforehand=beforehand, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves)


def _path_may_be_one_of(known: Beforehand, fitted: Fitted) -> bool:
    """Whether the path of a fit without a prior may be one more draw from the known distribution, in each channel.
    False if it has another number of channels."""
    basis, follow = fitted.fit.follow, fitted.curves.follow
    if follow.shape[1] != len(known.path):
        return False
    size, told = basis.size, []
    for k, spread in enumerate(known.path):
        design, block = basis.design(spread.q).toarray(), slice(k * size, (k + 1) * size)
        told.append(spread.may_contain(design @ follow[:, k], design @ fitted.covariance[block, block] @ design.T))
    return all(told)


def _fit_in_steps(
    prepared: Sequence[PreparedTrack], domain: Domain, delay_s: float, fit_delay: bool, guess: WidthCurve | None,
    beforehand: Beforehand | None,
) -> Fitted | None:  # fmt: skip
    """The joint fit, as in `fit_jointly`: first with few spans and few frames, from the best constant B (or the guess),
    then with all of them. The first approach is counted too if it follows the same curves as the rest, or if without it
    some positions would be seen one way only and it does no harm to the rest."""
    coarse = _coarse_start(_thinned(prepared), domain, delay_s, guess, beforehand)
    if coarse is None:
        return None
    fit, curves = coarse
    rough = fit.descended(curves, _ROUGH_STEPS)
    fine = PlayFit(
        prepared, Basis(domain.low, domain.high, SPANS), Basis(domain.low, domain.high, SPANS),
        fit_delay=fit_delay, settled_only=fit.settled_only, beforehand=beforehand,
    )  # fmt: skip
    start = Curves(
        _coefficients_of(fine.backlash, lambda x: fit.backlash.value(rough.curves.backlash, x)),
        _coefficients_of(fine.follow, lambda x: fit.follow.value(rough.curves.follow, x)),
        delay_s,
    )
    point = fine.descended(start)
    if fine.settled_only and _approach_fits(fine, point):
        fine.settled_only = False
        return fine.solve(point.curves)
    fitted = fine.fitted(point)
    if fine.settled_only and _reaches_further(fitted, domain):
        # Without the first approach B and the path are not told apart everywhere: does it do harm?
        whole = replace(fine, settled_only=False, smoothing=dict(fine.smoothing)).solve(start)
        if _settled_scale(whole) < _HARMLESS * fitted.scale and _predicts_no_worse(whole, fitted):
            return whole
        fitted.fit.simulate(fitted.curves)  # not those of `whole`
    return fitted


def _thinned(prepared: Sequence[PreparedTrack]) -> list[PreparedTrack]:
    """The tracks with about _SCANNED frames in all, taken evenly from those that `prepare_tracks` let count."""
    frames = sum(len(each.track.t_s) for each in prepared)
    counted = _counted_stride(frames)
    stride = counted * max(1, frames // counted // _SCANNED)
    if stride == 1:
        return list(prepared)
    every = slice(None, None, stride)
    return [replace(each, track=each.track.only(every), use=each.use[every]) for each in prepared]


def _reaches_further(fitted: Fitted, domain: Domain) -> bool:
    """Whether the tip was at positions more than _REACHES of the domain beyond those that the counted frames cover both
    ways."""
    low, high = overlap(fitted)
    known = np.concatenate([s.p[s.known] for s in fitted.fit.simulated])
    return bool(max(low - known.min(), known.max() - high) > _REACHES * domain.span)


def _settled_scale(fitted: Fitted) -> float:
    """rms residual over noise of the frames after the first approach, outliers cut at STRAY of the fit's scales;
    infinite without such frames."""
    seen = zip(fitted.residuals, fitted.masks, fitted.fit.simulated, strict=True)
    squares = np.concatenate([np.mean(r[m & s.settled] ** 2, axis=1) for r, m, s in seen])
    return rms_of_frame_powers(squares, fitted.scale)


def _predicts_no_worse(whole: Fitted, alone: Fitted) -> bool:
    """Whether the fit with the first approach (whole) predicts strokes that are left out as well as the fit without it
    (alone) does. Simulates both fits, `whole` last."""
    fit = alone.fit
    fit.simulate(alone.curves)
    strokes, before = [], 0
    for sim, mask in zip(fit.simulated, alone.masks, strict=True):
        stroke = before + sim.half_cycle
        before = int(stroke.max(initial=before)) + 1
        strokes.append(np.where(mask, stroke, -1))
    with_it, without = (_held_out_power(fitted, strokes, alone.scale) for fitted in (whole, alone))
    whole.fit.simulate(whole.curves)
    return with_it <= without


def _held_out_power(fitted: Fitted, strokes: Sequence[npt.NDArray[np.intp]], scale: float) -> float:
    """Mean squared error over noise at strokes that a fit has not seen. Every _PARTS-th stroke is left out in turn, and
    the fit descends for _AGAIN steps without it. Frames are cut at STRAY times `scale`. strokes: by track, (n,) the
    number of each frame's stroke, -1 where it does not count. 0 if no stroke counts."""
    total, frames = 0.0, 0
    for part in range(_PARTS):
        out = [(each >= 0) & (each % _PARTS == part) for each in strokes]
        if not any(each.any() for each in out):
            continue
        kept = [
            replace(prepared, use=prepared.use & ~each) for prepared, each in zip(fitted.fit.tracks, out, strict=True)
        ]
        fit = replace(fitted.fit, tracks=kept, smoothing=dict(fitted.fit.smoothing))
        curves = fit.descended(fitted.curves, _AGAIN, adapt=False).curves
        for row, each in zip(fit.residuals(curves)[0], out, strict=True):
            total += float(np.sum(np.minimum(np.mean(row[each] ** 2, axis=1), (STRAY * scale) ** 2)))
            frames += int(each.sum())
    return total / max(frames, 1)


def overlap(fitted: Fitted) -> tuple[float, float]:
    """The lowest and highest p, unit of q, between which counted frames cover both directions. (1, -1), an empty range,
    with fewer than _FEW_ONE_WAY frames of one direction."""
    return _covered_both_ways(fitted.fit.simulated, fitted.masks)


def _covered_both_ways(simulated: Sequence[Simulated], masks: Sequence[Mask]) -> tuple[float, float]:
    """As `overlap`, of the frames that count by these masks (n,), by track."""
    low, high = -np.inf, np.inf
    for side in (1, -1):
        seen = zip(simulated, masks, strict=True)
        p = np.concatenate([sim.p[mask & (sim.side == side)] for sim, mask in seen])
        if len(p) < _FEW_ONE_WAY:
            return 1.0, -1.0
        low, high = max(low, float(p.min())), min(high, float(p.max()))
    return low, high


def _approach_fits(fit: PlayFit, point: Point) -> bool:
    """Whether the first approach follows the same curves as the rest, at positions that the rest covers both ways: its
    residual, in the median, is less than _REPEATS times the fit's scale. If it does not, as with other friction or
    slack at the start, it must not spoil the fit. True with fewer than _FEW_ONE_WAY frames."""
    squares = []
    low, high = _covered_both_ways(point.simulated, point.masks)
    for prepared, sim, rows in zip(fit.tracks, point.simulated, point.residuals, strict=True):
        early = prepared.use & sim.known & ~sim.settled & (sim.p > low) & (sim.p < high)
        squares.append(np.mean(rows[early] ** 2, axis=1))
    early_squares = np.concatenate(squares)
    # The median: frames at which the play has not forgotten its start are off.
    return len(early_squares) < _FEW_ONE_WAY or float(np.median(early_squares)) < (_REPEATS * point.scale) ** 2


def fit_passes(joint_fit: Fitted, margin: float) -> Fitted | None:
    """B from the passes alone: the joint fit made again with only the frames at which the tip moves and has gone by
    more than `margin`, unit of q, since it began to; the delay is held. None with fewer than _FEWEST such frames."""
    fit = joint_fit.fit
    prepared = []
    for track, sim in zip(fit.tracks, fit.simulated, strict=True):
        beyond = _beyond_onset(sim.p, sim.side)
        prepared.append(replace(track, use=track.use & sim.moving & (beyond > margin)))
    again = PlayFit(
        prepared, fit.backlash, fit.follow, fit_delay=False, settled_only=fit.settled_only,
        smoothing=dict(fit.smoothing),
    )  # fmt: skip
    if sum(int((f.use).sum()) for f in prepared) < _FEWEST:
        return None
    return again.solve(joint_fit.curves, iterations=_STEPS_OF_PASSES)


def _beyond_onset(p: Array, side: npt.NDArray[np.int8]) -> Array:
    """(n,) how far the play's centre p (n,) has gone, unit of q, since its envelope, side (n,), last changed: since the
    tip last began to move."""
    turns = np.flatnonzero(np.diff(side, prepend=side[:1]))
    start = np.zeros(len(p), dtype=np.intp)
    start[turns] = turns
    return np.asarray(np.abs(p - p[np.maximum.accumulate(start)]))


def _coarse_start(
    prepared: Sequence[PreparedTrack],
    domain: Domain,
    delay_s: float,
    guess: WidthCurve | None,
    beforehand: Beforehand | None,
) -> tuple[PlayFit, Curves] | None:
    """The fit with which the joint fit begins, of _ROUGH_SPANS, and its first curves: those that leave least with the
    best constant B, the guess or the B known beforehand. The first approach counts only if without it no start has
    enough frames. None if no start has enough either way."""
    channels = prepared[0].track.y.shape[1]
    flat, path = (Basis(domain.low, domain.high, spans) for spans in _ROUGH_SPANS)
    no_path = np.zeros((path.size, channels))
    constant = [Curves(np.full(flat.size, b), no_path, delay_s) for b in domain.span * _CONSTANT]
    candidates = []
    if guess is not None:
        candidates.append(_coefficients_of(flat, guess.at))
    if beforehand is not None:
        candidates.append(_coefficients_of(flat, beforehand.usual))
    for settled_only in (True, False):
        fit = PlayFit(prepared, flat, path, fit_backlash=False, fit_delay=False, settled_only=settled_only)
        starts = [Curves(candidate, no_path, delay_s) for candidate in candidates]
        steps = [_best_step(fit, constant), *(_path_step(fit, start) for start in starts)]
        if steps := [step for step in steps if step is not None]:
            best = min(steps, key=lambda step: step[0])[1]
            return PlayFit(prepared, flat, path, fit_delay=False, settled_only=settled_only), best
    return None


def _best_step(fit: PlayFit, starts: Sequence[Curves]) -> tuple[float, Curves] | None:
    """Of `_path_step` from each of the starts the one that leaves least. The starts have ever wider B, and what they
    leave is taken to have one minimum, so that only some are tried. None if too few frames count from the best of
    them."""
    steps: dict[int, tuple[float, Curves] | None] = {}

    def residual_of(k: int) -> float:
        """What the step from start k leaves; infinite if too few frames count."""
        if k not in steps:
            steps[k] = _path_step(fit, starts[k])
        step = steps[k]
        return np.inf if step is None else step[0]

    return steps[least_of(len(starts), residual_of)]


def _path_step(fit: PlayFit, start: Curves) -> tuple[float, Curves] | None:
    """The path fitted in one step with `start`'s B and delay held: the mean absolute residual over noise that it
    leaves, and the curves. None if too few frames count (fewer than _FEWEST, or than _LEAST_SHARE of those that may)
    or, if the first approach is left out (settled_only), if they do not cover the same positions both ways."""
    residuals, masks = fit.residuals(start)
    if sum(int(m.sum()) for m in masks) < max(_FEWEST, _LEAST_SHARE * sum(int(f.use.sum()) for f in fit.tracks)):
        return None
    if fit.settled_only and not _covers_both_ways(fit, masks):
        return None
    curves = fit.step(start, residuals, masks)
    residuals, masks = fit.residuals_of_simulated(curves)
    left = np.concatenate([np.abs(r[m]).ravel() for r, m in zip(residuals, masks, strict=True)])
    return float(np.mean(left)), curves


def _covers_both_ways(fit: PlayFit, masks: Sequence[Mask]) -> bool:
    """Whether the range that the counted frames of both directions have in common is more than _LEAST_BOTH_WAYS of the
    range of positions seen. False with fewer than half of _FEWEST frames of one direction."""
    spans = []
    for side in (1, -1):
        p = np.concatenate([s.p[m & (s.side == side)] for s, m in zip(fit.simulated, masks, strict=True)])
        if len(p) < _FEWEST // 2:
            return False
        spans.append((p.min(), p.max()))
    known = np.concatenate([s.p[s.known] for s in fit.simulated])
    low, high = max(s[0] for s in spans), min(s[1] for s in spans)
    return bool(high - low > _LEAST_BOTH_WAYS * np.ptp(known))


def _coefficients_of(basis: Basis, curve: Callable[[Array], Array]) -> Array:
    """Spline coefficients (size,) or (size, channels) nearest in least squares to a curve, a function of positions
    (n,), unit of q, with values (n,) or (n, channels). The curve is evaluated at _PLACES_EACH positions for each
    coefficient."""
    x = np.linspace(basis.low, basis.high, _PLACES_EACH * basis.size)
    return basis.nearest(x, curve(x))
