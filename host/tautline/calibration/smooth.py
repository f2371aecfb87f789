"""Everything smooth in one calibration: the joint fit of B, path and delay, and B from the passes' distance alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.backlash import WidthCurve
from tautline.calibration.beforehand import Beforehand
from tautline.calibration.observations import Mask, Track
from tautline.calibration.playfit import Curves, Fitted, PlayFit, PreparedTrack
from tautline.splines import Basis

Array = npt.NDArray[np.float64]

SPANS = 100  # tolerance: of B and of the path: a bump of B 0.6 mm wide on 10 mm has six of them
_MOST_FRAMES = 12000  # tolerance: of one fit; more are thinned out evenly
_SCANNED = 3000  # tolerance: frames, about, that tell where a fit begins
_REPEATS = 1.6  # prior: residual of the first approach over that of the rest up to which it counts
_HARMLESS = 1.15  # tolerance: what counting the first approach may do to the residuals of the rest
_TURNS, _AGAIN = 5, 4  # tolerance: parts in which strokes are left out, of both directions; steps without them
_FEWEST = 40  # tolerance: frames that a joint fit is tried with


@dataclass(frozen=True)
class Domain:
    """Motor positions that tables cover: the rig's range and whatever the motor reached beyond it."""

    low: float
    high: float

    @property
    def span(self) -> float:
        return self.high - self.low


def prepare_tracks(tracks: Sequence[Track], delay_s: float) -> list[PreparedTrack]:
    """Tracks for a pose-free fit: frames at which translation and rotation are where they mostly are."""
    reference = tracks[0].others_reference
    total = sum(len(track.t_s) for track in tracks)
    stride = max(1, -(-total // _MOST_FRAMES))
    prepared = []
    for track in tracks:
        use: Mask = track.at_reference(track.scene_s(delay_s), reference)
        if stride > 1:
            use &= np.arange(len(use)) % stride == 0
        prepared.append(PreparedTrack.of(track, use))
    return prepared


def fit_jointly(
    prepared: Sequence[PreparedTrack],
    domain: Domain,
    delay_s: float,
    *,
    fit_delay: bool,
    guess: WidthCurve | None = None,
    beforehand: Beforehand | None = None,
) -> Fitted | None:
    """B, the path in the sensor's own coordinates and the delay, from all frames at once. None where the tip was never
    driven through a backlash (or next to nothing was seen). A path that is no other robot's is not known beforehand."""
    if beforehand is None or not beforehand.path:
        return _fitted(prepared, domain, delay_s, fit_delay, guess, beforehand)
    fitted = _fitted(prepared, domain, delay_s, fit_delay, guess, replace(beforehand, path=()))
    if fitted is None or not _has_path(beforehand, fitted):
        return fitted
    fit = replace(fitted.fit, beforehand=beforehand, smoothing=dict(fitted.fit.smoothing))
    return fit.solve(fitted.curves)


def _has_path(known: Beforehand, fitted: Fitted) -> bool:
    """Whether a path that was fitted without them may be one of those that are known."""
    basis, follow = fitted.fit.follow, fitted.curves.follow
    if follow.shape[1] != len(known.path):
        return False
    size, told = basis.size, []
    for k, spread in enumerate(known.path):
        design, block = basis.design(spread.q).toarray(), slice(k * size, (k + 1) * size)
        told.append(spread.has(design @ follow[:, k], design @ fitted.covariance[block, block] @ design.T))
    return all(told)


def _fitted(
    prepared: Sequence[PreparedTrack], domain: Domain, delay_s: float, fit_delay: bool, guess: WidthCurve | None,
    beforehand: Beforehand | None,
) -> Fitted | None:  # fmt: skip
    """As `fit_jointly`: from the best constant width (or guess), few spans and few frames, to all of them. Frames of
    the first approach count where they follow the same curves, or are needed and do no harm."""
    coarse = _scan(_thinned(prepared), domain, delay_s, guess, beforehand)
    if coarse is None:
        return None
    fit, curves = coarse
    rough = fit.solve(curves, iterations=7)
    fine = PlayFit(
        prepared, Basis(domain.low, domain.high, SPANS), Basis(domain.low, domain.high, SPANS),
        fit_delay=fit_delay, settled_only=fit.settled_only, beforehand=beforehand,
    )  # fmt: skip
    start = Curves(
        _lift(fine.backlash, lambda x: fit.backlash.value(rough.curves.backlash, x)),
        _lift(fine.follow, lambda x: fit.follow.value(rough.curves.follow, x)),
        delay_s,
    )
    fitted = fine.solve(start)
    if fine.settled_only and _repeats(fitted):
        fine.settled_only = False
        return fine.solve(fitted.curves)
    if fine.settled_only and _reaches_further(fitted, domain):
        # Without the first approach B and the path are not apart everywhere: does it do harm?
        whole = replace(fine, settled_only=False, smoothing=dict(fine.smoothing)).solve(start)
        if _settled_scale(whole) < _HARMLESS * fitted.scale and _foretells(whole, fitted):
            return whole
        fitted.fit.residuals(fitted.curves)
    return fitted


def _thinned(prepared: Sequence[PreparedTrack]) -> list[PreparedTrack]:
    """About _SCANNED of the frames, evenly."""
    stride = max(1, sum(len(each.track.t_s) for each in prepared) // _SCANNED)
    if stride == 1:
        return list(prepared)
    every = slice(None, None, stride)
    return [replace(each, track=each.track.only(every), use=each.use[every]) for each in prepared]


def _reaches_further(fitted: Fitted, domain: Domain) -> bool:
    """Whether the tip was somewhere that the counted frames do not cover both ways."""
    low, high = overlap(fitted)
    known = np.concatenate([s.p[s.known] for s in fitted.fit.simulated])
    return bool(low - known.min() > 0.02 * domain.span or known.max() - high > 0.02 * domain.span)


def _settled_scale(fitted: Fitted) -> float:
    """Residual over noise (rms) of frames after the tip was driven both ways, strays as four scales; infinite where
    there are none."""
    seen = zip(fitted.residuals, fitted.masks, fitted.fit.simulated, strict=True)
    squares = np.concatenate([np.mean(r[m & s.settled] ** 2, axis=1) for r, m, s in seen])
    return float(np.sqrt(np.mean(np.minimum(squares, (4.0 * fitted.scale) ** 2)))) if len(squares) else np.inf


def _foretells(whole: Fitted, alone: Fitted) -> bool:
    """Whether strokes that were left out are foretold as well with the first approach as without it."""
    fit = alone.fit
    fit.residuals(alone.curves)
    late, before = [], 0
    for sim, mask in zip(fit.simulated, alone.masks, strict=True):
        stroke = before + np.cumsum(np.diff(sim.side, prepend=sim.side[:1]) != 0)
        before = int(stroke.max(initial=before)) + 1
        late.append(np.where(mask, stroke, -1))
    with_it, without = (_missed(fitted, late, alone.scale) for fitted in (whole, alone))
    whole.fit.residuals(whole.curves)
    return with_it <= without


def _missed(fitted: Fitted, strokes: Sequence[npt.NDArray[np.intp]], scale: float) -> float:
    """Mean square over the noise of strokes that the fit did not see, some at a time; strays count as four scales."""
    total, frames = 0.0, 0
    for turn in range(_TURNS):
        out = [(each >= 0) & (each % _TURNS == turn) for each in strokes]
        if not any(each.any() for each in out):
            continue
        kept = [
            replace(prepared, use=prepared.use & ~each) for prepared, each in zip(fitted.fit.tracks, out, strict=True)
        ]
        fit = replace(fitted.fit, tracks=kept, smoothing=dict(fitted.fit.smoothing))
        curves = fit.solve(fitted.curves, iterations=_AGAIN, adapt=False).curves
        for row, each in zip(fit.residuals(curves)[0], out, strict=True):
            total += float(np.sum(np.minimum(np.mean(row[each] ** 2, axis=1), (4.0 * scale) ** 2)))
            frames += int(each.sum())
    return total / max(frames, 1)


def overlap(fitted: Fitted) -> tuple[float, float]:
    """The range of p, unit of q, that counted frames cover in both directions; empty (1, -1) where few or none do."""
    low, high = -np.inf, np.inf
    for side in (1, -1):
        seen = zip(fitted.fit.simulated, fitted.masks, strict=True)
        p = np.concatenate([sim.p[mask & (sim.side == side)] for sim, mask in seen])
        if len(p) < 5:
            return 1.0, -1.0
        low, high = max(low, float(p.min())), min(high, float(p.max()))
    return low, high


def _repeats(fitted: Fitted) -> bool:
    """Whether the first approach, before the tip was driven both ways, follows the same curves as all that came after:
    a start pose with other friction or slack must not spoil the fit."""
    fit, squares = fitted.fit, []
    low, high = overlap(fitted)
    for prepared, sim, rows in zip(fit.tracks, fit.simulated, fitted.residuals, strict=True):
        early = prepared.use & sim.known & ~sim.settled & (sim.p > low) & (sim.p < high)
        squares.append(np.mean(rows[early] ** 2, axis=1))
    early_squares = np.concatenate(squares)  # their median: where B is not settled yet some are off
    return len(early_squares) < 5 or float(np.median(early_squares)) < (_REPEATS * fitted.scale) ** 2


def fit_passes(joint_fit: Fitted, margin: float) -> Fitted | None:
    """B again from the horizontal distance between the passes alone: only frames well beyond an onset, with the delay
    as it is. margin: how far beyond, unit of q. None where too few are."""
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
    return again.solve(joint_fit.curves, iterations=8)


def _beyond_onset(p: Array, side: npt.NDArray[np.int8]) -> Array:
    """(n,) how far the centre p (n,) has gone since the tip last began to move, unit of q."""
    gone = np.zeros(len(p))
    start = 0
    for k in range(1, len(p)):
        if side[k] != side[k - 1]:
            start = k
        gone[k] = abs(p[k] - p[start])
    return gone


def _scan(
    prepared: Sequence[PreparedTrack],
    domain: Domain,
    delay_s: float,
    guess: WidthCurve | None,
    beforehand: Beforehand | None,
) -> tuple[PlayFit, Curves] | None:
    """The best constant width, or the guess where that is better, with a path of 16 spans; frames before the tip was
    driven both ways are left out unless little else is there. None where too few frames tell any."""
    channels = prepared[0].track.y.shape[1]
    flat, path = Basis(domain.low, domain.high, 8), Basis(domain.low, domain.high, 16)
    candidates = [np.full(flat.size, b) for b in domain.span * np.linspace(0.0, 0.4, 41)]
    if guess is not None:
        candidates.append(_lift(flat, guess.at))
    if beforehand is not None:
        candidates.append(_lift(flat, beforehand.usual))
    for settled_only in (True, False):
        best: tuple[float, PlayFit, Curves] | None = None
        for candidate in candidates:
            fit = PlayFit(prepared, flat, path, fit_backlash=False, fit_delay=False, settled_only=settled_only)
            curves = Curves(candidate, np.zeros((path.size, channels)), delay_s)
            residuals, masks = fit.residuals(curves)
            if sum(int(m.sum()) for m in masks) < max(_FEWEST, 0.25 * sum(int(f.use.sum()) for f in prepared)):
                continue
            if settled_only and not _both_ways(fit, masks, domain):
                continue
            curves = fit.step(curves, residuals, masks)
            residuals, masks = fit.residuals(curves)
            cost = float(np.mean(np.concatenate([np.abs(r[m]).ravel() for r, m in zip(residuals, masks, strict=True)])))
            if best is None or cost < best[0]:
                best = (cost, fit, curves)
        if best is not None:
            fit = PlayFit(prepared, flat, path, fit_delay=False, settled_only=settled_only)
            return fit, best[2]
    return None


def _both_ways(fit: PlayFit, masks: Sequence[Mask], domain: Domain) -> bool:
    """Whether what is left once the tip was driven both ways still covers, in both directions, what was covered."""
    spans = []
    for side in (1, -1):
        p = np.concatenate([s.p[m & (s.side == side)] for s, m in zip(fit.simulated, masks, strict=True)])
        if len(p) < _FEWEST // 2:
            return False
        spans.append((p.min(), p.max()))
    known = np.concatenate([s.p[s.known] for s in fit.simulated])
    low, high = max(s[0] for s in spans), min(s[1] for s in spans)
    return bool(high - low > 0.8 * np.ptp(known))


def _lift(basis: Basis, curve: object) -> Array:
    """Spline coefficients, (size,) or (size, channels), nearest to a curve: a function of positions x (n,) whose values
    are (n,) or (n, channels)."""
    x = np.linspace(basis.low, basis.high, 4 * basis.size)
    values = np.asarray(curve(x))  # type: ignore[operator]
    design = basis.design(x).toarray()
    flat = values.reshape(len(x), -1)
    rows = np.vstack([design, 1e-6 * np.diff(np.eye(basis.size), 2, axis=0)])
    solved = np.linalg.lstsq(rows, np.vstack([flat, np.zeros((basis.size - 2, flat.shape[1]))]), rcond=None)[0]
    return np.asarray(solved[:, 0] if values.ndim == 1 else solved)
