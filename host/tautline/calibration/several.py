"""A play of several elements, as the tip starts gradually: their weights are fitted together with B, path and delay.

The tip is the weighted mean of plays whose widths are fixed shares s of B (SHARES). Their weights w are unknowns, none
negative, with sum w = 1 and sum w s = 1, so that B remains the width of the whole. Each Gauss-Newton step eliminates
the unknowns of B, path and delay (Schur complement) and solves for the weights by non-negative least squares.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import nnls

from tautline import _native
from tautline.calibration.components import interpolated
from tautline.calibration.counted import counted_frames
from tautline.calibration.mixed_model import normal_with_columns
from tautline.calibration.playfit import Curves, Fitted, rms_of_frame_powers
from tautline.elements import SINGLE, Elements, Play, warp_of
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

# Widths of the elements, of B: a seventh apart about 1, then by a third.
SHARES = np.array([0.07, 0.2, 0.4, 0.6, 0.8, 0.95, 1.1, 1.4, 1.9, 2.6, 3.6, 5.0])  # tolerance: what lies between
_FIRST = 0.05  # limit: least weight of the first element: the inverse's slope is one over it (1 / 0.05 = 20)
_LEAST = 0.01  # tolerance: of a weight that is kept
_STEPS = 12  # tolerance: of one descent
_STEP_SHARES = (1.0, 0.5, 0.2)  # tolerance: of a step, tried in turn
_STRICT = 10.0  # tolerance: how much more than the data the two sums weigh
_STIFF = 1e4  # tolerance: how much more than the weights the two sums weigh
_RANK = 1e-10  # tolerance: of the largest eigenvalue: less is no direction that frames tell
_RIDGE = 1e-9  # tolerance: of the mean diagonal of the curves' system, added to all of it
_ENOUGH = 2e-3  # tolerance: of the squares: a step that gains less is the last


def fit_elements(fitted: Fitted, rig: Rig, fit_delay: bool) -> Fitted:
    """The joint fit with several elements. It is descended from weights near one play and from equal weights; the
    result is the one with the smaller residual, and its scale is that residual (`rms_over_noise`)."""
    at = int(np.searchsorted(SHARES, 1.0))
    narrow, wide = np.zeros(len(SHARES)), np.full(len(SHARES), 1.0 / len(SHARES))
    narrow[at - 1 : at + 1] = 2 / 3, 1 / 3  # of 0.95 and 1.1: their mean is 1
    fits = [_descended(fitted, _allowed_weights(start), rig, fit_delay) for start in (narrow, wide)]
    best = min(fits, key=lambda one: one.scale)
    residuals, masks = best.fit.residuals(best.curves)
    return replace(best, residuals=residuals, masks=masks)


def _descended(fitted: Fitted, weights: Array, rig: Rig, fit_delay: bool) -> Fitted:
    """The joint fit after damped Gauss-Newton steps of curves and weights, from these weights (shares,). Its scale is
    what it leaves, infinite if the tip was never driven through the widest element."""
    fit = replace(fitted.fit, hysteresis=_elements(weights), fit_delay=fit_delay, smoothing=fitted.fit.smoothing)
    state = replace(fitted, fit=fit)
    least = rms_over_noise(state)
    for _ in range(_STEPS if np.isfinite(least) else 0):
        moved, target = _step(state, weights, rig)
        for share in _STEP_SHARES:
            trial_weights = _allowed_weights(weights + share * (target - weights))
            fit = replace(state.fit, hysteresis=_elements(trial_weights), smoothing=state.fit.smoothing)
            trial = replace(state, fit=fit, curves=interpolated(state.curves, moved, share))
            left = rms_over_noise(trial)
            if left < least:
                break
        else:
            break  # no share of the step lowers the residual
        gained, state, weights, least = 1.0 - (left / least) ** 2, trial, trial_weights, left
        if gained < _ENOUGH:
            break
    return replace(state, scale=least)


def _elements(weights: Array) -> Elements:
    """The elements whose weights (shares,) are above _LEAST. Weights and widths are scaled so that both sums stay 1;
    one play if only one element is left."""
    kept = weights > _LEAST
    width, weight = SHARES[kept], weights[kept] / weights[kept].sum()
    if len(width) == 1:
        return SINGLE
    return Elements(tuple((width / float(weight @ width)).tolist()), tuple(weight.tolist()))


def _allowed_weights(weights: Array) -> Array:
    """The nearest weights (shares,), in least squares, that are not negative, with both sums 1. If the narrowest
    element that counts weighs less than _FIRST its weight is moved to the next element, and so on."""
    equations = np.vstack([np.eye(len(SHARES)), _STIFF * np.ones(len(SHARES)), _STIFF * SHARES])
    nearest = nnls(equations, np.concatenate([weights, [_STIFF, _STIFF]]))[0]
    first = int(np.argmax(nearest > _LEAST))
    if nearest[first] < _FIRST:
        nearest[:first] = 0.0
        nearest[first + 1] += nearest[first]
        nearest[first] = 0.0
        return _allowed_weights(nearest)
    return np.asarray(nearest)


def rms_over_noise(fitted: Fitted) -> float:
    """rms residual over noise of the counted frames, simulated anew; outliers are cut at STRAY times the fit's scale.
    Infinite if no frame counts, as when the tip was never driven through the widest element."""
    return rms_of_frame_powers(frame_powers(fitted), fitted.scale)


def frame_powers(fitted: Fitted) -> Array:
    """(counted frames of all tracks,) mean squared residual over noise of each frame, simulated anew."""
    residuals, masks = fitted.fit.residuals(fitted.curves)
    return np.concatenate([np.mean(r[m] ** 2, axis=1) for r, m in zip(residuals, masks, strict=True)])


def _step(fitted: Fitted, weights: Array, rig: Rig) -> tuple[Curves, Array]:
    """One Gauss-Newton step: the curves after it, and the weights (shares,) after it, by non-negative least squares
    once the curves' unknowns are eliminated (Schur complement)."""
    counted = counted_frames(fitted, fitted.curves, rig, np.zeros(2))
    assert counted is not None  # it was fitted to frames
    gram, gradient, size = normal_with_columns(fitted.fit, counted, _by_weight(fitted))
    penalty, pull = fitted.fit.penalty(fitted.curves, max(fitted.scale, 1e-6))
    nominal = gram[:size, :size] + penalty
    nominal[np.diag_indices_from(nominal)] += _RIDGE * float(np.mean(np.diag(nominal)))
    factor = cho_factor(nominal, check_finite=False)
    across, of_curves = gram[:size, size:], gradient[:size] - pull
    schur = gram[size:, size:] - across.T @ cho_solve(factor, across, check_finite=False)
    of_weights = gradient[size:] - across.T @ cho_solve(factor, of_curves, check_finite=False)
    solved = _nonnegative_weights(schur, of_weights, weights)
    step = cho_solve(factor, of_curves - across @ (solved - weights), check_finite=False)
    return fitted.fit.moved(fitted.curves, np.asarray(step)), solved


def _nonnegative_weights(matrix: Array, gradient: Array, weights: Array) -> Array:
    """The weights w (shares,) that minimise d' matrix d / 2 - gradient' d, with d = w - weights, none negative and both
    sums 1. It is least squares with the root of the matrix; the two sums are further equations that weigh _STRICT times
    as much."""
    roots, vectors = np.linalg.eigh(matrix)
    kept = roots > _RANK * roots.max()
    rows = np.sqrt(roots[kept])[:, None] * vectors[:, kept].T
    values = rows @ weights + (vectors[:, kept].T @ gradient) / np.sqrt(roots[kept])
    strict = _STRICT * float(np.sqrt(roots.max()))
    rows = np.vstack([rows, strict * np.ones(len(weights)), strict * SHARES])
    return np.asarray(nnls(rows, np.concatenate([values, [strict, strict]]))[0])


def _by_weight(fitted: Fitted) -> Array:
    """(counted frames, elements) derivatives of the tip's place p by the elements' weights, but for a part that the two
    sums forbid. Each is the centre of the element's own play, in the coordinate x = G(q) in which every width is
    constant (elements.Warp), times dp/dx."""
    fit, curves = fitted.fit, fitted.curves
    width = fit.width(curves)
    narrow = Play(fit.grid, width).narrow
    warp = warp_of(fit.grid, width, narrow)
    # x of the play's centre at each p of the grid, so that dp/dx is one over its slope.
    middle = 0.5 * (np.interp(fit.grid + width / 2, warp.q, warp.x) + np.interp(fit.grid - width / 2, warp.q, warp.x))
    by_x = 1.0 / np.maximum(np.gradient(middle, fit.grid), 1e-9)
    _, masks = fit.residuals(curves)
    far = 10.0 * float(np.abs(warp.x).max())
    plays = [_native.Plays(np.array([-far, far]), np.full(2, share)) for share in SHARES]
    columns = []
    for prepared, sim, mask in zip(fit.tracks, fit.simulated, masks, strict=True):
        driven = prepared.driven(curves.delay_s)
        positions, at = driven.positions, driven.at
        x = np.interp(positions, warp.q, warp.x)
        alone = [play.forward(x, -far)[0] for play in plays]
        columns.append(np.column_stack(alone)[at][mask] * np.interp(sim.p[mask], fit.grid, by_x)[:, None])
    return np.concatenate(columns)
