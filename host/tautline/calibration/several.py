"""Whether the play has several elements: their weights beside B, path and delay, from all frames at once.

The widths of the elements are fixed shares of B, their weights are unknowns with sum w = 1 and sum w (2 r) = 1, none
negative. Each step eliminates the nominal's unknowns and solves for the weights as a non-negative least squares.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls

from tautline import _native
from tautline.calibration.components import interpolated, nominal_columns
from tautline.calibration.departures import counted_frames, scaled_rows
from tautline.calibration.playfit import Curves, Fitted
from tautline.elements import SINGLE, Elements, Play, warp_of
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

# Widths of the elements, of B: a seventh apart about 1, then by a third.
SHARES = np.array([0.07, 0.2, 0.4, 0.6, 0.8, 0.95, 1.1, 1.4, 1.9, 2.6, 3.6, 5.0])  # tolerance: what lies between
_FIRST = 0.05  # limit: least weight of the first element: the inverse's slope is one over it (1 / 0.05 = 20)
_LEAST = 0.01  # tolerance: of a weight that is kept
_STEPS = 12
_STRICT = 10.0  # tolerance: how much more than the data the two sums weigh
_ENOUGH = 2e-3  # tolerance: of the squares: a step that gains less is the last


def fit_elements(fitted: Fitted, rig: Rig, fit_delay: bool) -> Fitted:
    """The joint fit with as many elements as help, from where it stands; its scale is what they leave (`left`)."""
    at = int(np.searchsorted(SHARES, 1.0))
    narrow, wide = np.zeros(len(SHARES)), np.full(len(SHARES), 1.0 / len(SHARES))
    narrow[at - 1 : at + 1] = 2 / 3, 1 / 3
    fits = [_descended(fitted, _lawful(start), rig, fit_delay) for start in (narrow, wide)]
    return min(fits, key=lambda one: one.scale)


def _descended(fitted: Fitted, weights: Array, rig: Rig, fit_delay: bool) -> Fitted:
    """The joint fit after damped Gauss-Newton steps from these weights (shares,); its scale is what it leaves, infinite
    where no frame tells of the elements."""
    fit = replace(fitted.fit, hysteresis=_elements(weights), fit_delay=fit_delay, smoothing=fitted.fit.smoothing)
    state = replace(fitted, fit=fit)
    least = left(state)
    for _ in range(_STEPS if np.isfinite(least) else 0):
        moved, target = _step(state, weights, rig)
        for share in (1.0, 0.5, 0.2):
            then = _lawful(weights + share * (target - weights))
            fit = replace(state.fit, hysteresis=_elements(then), smoothing=state.fit.smoothing)
            trial = replace(state, fit=fit, curves=interpolated(state.curves, moved, share))
            now = left(trial)
            if now < least:
                break
        else:
            break
        gained, state, weights, least = 1.0 - (now / least) ** 2, trial, then, now
        if gained < _ENOUGH:
            break
    return replace(state, scale=least)


def _elements(weights: Array) -> Elements:
    """The elements of weights (shares,), without those that weigh next to nothing; the rest keep both sums."""
    kept = weights > _LEAST
    width, weight = SHARES[kept], weights[kept] / weights[kept].sum()
    if len(width) == 1:
        return SINGLE
    return Elements(tuple((width / float(weight @ width)).tolist()), tuple(weight.tolist()))


def _lawful(weights: Array) -> Array:
    """The nearest weights, none negative, the first that counts not too small, with both sums one."""
    rows = np.vstack([np.eye(len(SHARES)), 1e4 * np.ones(len(SHARES)), 1e4 * SHARES])
    weighted = nnls(rows, np.concatenate([weights, [1e4, 1e4]]))[0]
    first = int(np.argmax(weighted > _LEAST))
    if weighted[first] < _FIRST:
        weighted[:first] = 0.0
        weighted[first + 1] += weighted[first]
        weighted[first] = 0.0
        return _lawful(weighted)
    return np.asarray(weighted)


def left(fitted: Fitted) -> float:
    """Residual over noise (rms) of all counted frames; strays count as four scales. Infinite where the tip was never
    driven through the widest element: no frame tells of that."""
    return rms_of_powers(powers(fitted), fitted.scale)


def powers(fitted: Fitted) -> Array:
    """(counted frames,) Mean square of each one's residual over noise."""
    residuals, masks = fitted.fit.residuals(fitted.curves)
    return np.concatenate([np.mean(r[m] ** 2, axis=1) for r, m in zip(residuals, masks, strict=True)])


def rms_of_powers(power: Array, scale: float) -> float:
    """Root of the mean of `powers`, those of strays as of four scales; infinite of none."""
    return float(np.sqrt(np.mean(np.minimum(power, (4.0 * scale) ** 2)))) if len(power) else np.inf


def _step(fitted: Fitted, weights: Array, rig: Rig) -> tuple[Curves, Array]:
    """The curves and the weights (shares,) of a Gauss-Newton step, these by non-negative least squares."""
    counted = counted_frames(fitted, fitted.curves, rig, np.zeros(2))
    assert counted is not None  # it was fitted to frames
    nominal = nominal_columns(fitted.fit, counted)
    design = sparse.csr_matrix(sparse.hstack([nominal, counted.along_path(_by_weight(fitted))]))
    heavy = scaled_rows(np.tile(counted.weight, counted.residuals.shape[1]), design)
    gram, force = np.asarray((heavy.T @ design).toarray()), np.asarray(heavy.T @ counted.residuals.T.ravel()).ravel()
    head = nominal.shape[1]
    base, pull = fitted.fit.penalty(fitted.curves, max(fitted.scale, 1e-6))
    own = gram[:head, :head] + base
    own[np.diag_indices_from(own)] += 1e-9 * float(np.mean(np.diag(own)))
    factor = cho_factor(own, check_finite=False)
    across, first = gram[:head, head:], force[:head] - pull
    schur = gram[head:, head:] - across.T @ cho_solve(factor, across, check_finite=False)
    right = force[head:] - across.T @ cho_solve(factor, first, check_finite=False)
    roots, vectors = np.linalg.eigh(schur)
    kept = roots > 1e-10 * roots.max()
    rows = np.sqrt(roots[kept])[:, None] * vectors[:, kept].T
    values = rows @ weights + (vectors[:, kept].T @ right) / np.sqrt(roots[kept])
    strict = _STRICT * float(np.sqrt(roots.max()))
    rows = np.vstack([rows, strict * np.ones(len(weights)), strict * SHARES])
    then = np.asarray(nnls(rows, np.concatenate([values, [strict, strict]]))[0])
    step = cho_solve(factor, first - across @ (then - weights), check_finite=False)
    return fitted.fit.moved(fitted.curves, np.asarray(step)), then


def _by_weight(fitted: Fitted) -> Array:
    """(counted frames, elements): dp/dw, but for what the two sums make of it."""
    fit, curves = fitted.fit, fitted.curves
    width = fit.width(curves)
    narrow = Play(fit.grid, width).narrow
    warp = warp_of(fit.grid, width, narrow)
    middle = 0.5 * (np.interp(fit.grid + width / 2, warp.q, warp.x) + np.interp(fit.grid - width / 2, warp.q, warp.x))
    by_y = 1.0 / np.maximum(np.gradient(middle, fit.grid), 1e-9)
    _, masks = fit.residuals(curves)
    far = 10.0 * float(np.abs(warp.x).max())
    plays = [_native.Plays(np.array([-far, far]), np.full(2, share)) for share in SHARES]
    fits = []
    for prepared, sim, mask in zip(fit.tracks, fit.simulated, masks, strict=True):
        positions, at = prepared.course(prepared.track.scene_s(curves.delay_s))
        x = np.interp(positions, warp.q, warp.x)
        alone = [play.forward(x, -far)[0] for play in plays]
        fits.append(np.column_stack(alone)[at][mask] * np.interp(sim.p[mask], fit.grid, by_y)[:, None])
    return np.concatenate(fits)
