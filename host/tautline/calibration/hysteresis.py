"""Friction instead of plays, fitted to all frames beside B, path and delay; and which hysteresis it is, by evidence.

Unknown are numbers of one size each: the logit of the share of its later slope with which the tip starts where it
starts slowest, the part of the length that goes with B, the logarithm of the exponent, and of Bouc-Wen's the logit of
beta. Each has a normal prior; Gauss-Newton steps by the state's own derivatives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.special import expit

from tautline.calibration.components import interpolated, nominal_columns
from tautline.calibration.departures import CountedFrames, counted_frames, scaled_rows
from tautline.calibration.playfit import Curves, Fitted
from tautline.calibration.several import left, powers, rms_of_powers
from tautline.elements import Play
from tautline.friction import BOUC_WEN, DAHL, VALUES, Friction
from tautline.rig import Rig

Array = npt.NDArray[np.float64]

# Priors, mean and standard deviation: start (logit), part of the length that is B's, log exponent, beta (logit). A
# start of .05 to .95 within two; both pure cases of the length within one; Bouc-Wen's exponents from .3 to 8 and Dahl's
# from .45 to 2.2 within two, as the literature has them (n 1 to 5, i 1 in most); beta .2 to .9.
PRIORS = {
    BOUC_WEN: (np.array([0.0, 0.5, 0.4, 0.4]), np.array([1.5, 0.5, 0.8, 0.9])),  # prior: above
    DAHL: (np.array([0.0, 0.5, 0.0]), np.array([1.5, 0.5, 0.4])),  # prior: above
}
_STEPS, _SMOOTHED, _AGAIN = 12, 6, 2  # tolerance: of one descent, of the smoothing at most; how often both follow
_SHARES = (1.0, 0.5, 0.2)  # tolerance: of a step, tried in turn
_ENOUGH = 1e-3  # tolerance: of the squares; a step that gains less is the last
_LONGEST = 1.5  # tolerance: of what is straight; a step at most, in the prior's standard deviations
_THIN = 0.1  # prior: of the mean length, the least anywhere
_DIFFERENCE = 1e-5  # tolerance: over which the transform is straight


@dataclass(frozen=True)
class Tried:
    """A hysteresis fitted to the recordings."""

    fitted: Fitted
    unknowns: int  # beside B, path and delay
    spread: Array | None = None  # of B on the fit's grid: what the unknowns leave open of it

    def evidence(self, frames_each: float) -> float:
        """Logarithm of it but for what all have, by Schwarz's approximation: the noise unknown, and of each unknown as
        much known before as one independent frame says (the unit information prior). frames_each: frames for each
        independent one."""
        number = self.fitted.frames / max(frames_each, 1.0) * self.fitted.residuals[0].shape[1]
        rms = max(left(self.fitted), 1e-9)
        return float(-number * np.log(rms) - 0.5 * self.unknowns * np.log(number))


def likeliest(tried: list[Tried], frames_each: float) -> Tried:
    """The one of most evidence. frames_each: frames for each independent one, alike for all."""
    scale = min(one.fitted.scale for one in tried)  # strays count as much in all
    alike = [replace(one, fitted=replace(one.fitted, scale=scale)) for one in tried]
    return tried[int(np.argmax([one.evidence(frames_each) for one in alike]))]


def fit_friction(starts: Sequence[Fitted], rig: Rig, kind: str, fit_delay: bool) -> Tried | None:
    """From where joint fits stand, of which the one that leads furthest goes on. Its scale is what friction
    leaves. None where no frame tells of it, its start being felt throughout."""
    scale = max(start.scale for start in starts)  # strays count as much in all, and no frame is one before it is fitted
    mean = PRIORS[kind][0]
    begun = []
    for start in starts:
        fit = replace(start.fit, fit_delay=fit_delay, smoothing=dict(start.fit.smoothing))
        begun.append(_descended(_with(replace(start, fit=fit, scale=scale), kind, mean), rig, kind, mean))
    state, unknowns = min(begun, key=lambda one: left(one[0]))
    for _ in range(_AGAIN):
        if not np.isfinite(state.scale):
            return None
        solved = state.fit.solve(state.curves, iterations=_SMOOTHED)
        state = _with(replace(state, fit=solved.fit, curves=solved.curves), kind, unknowns)
        state, unknowns = _descended(state, rig, kind, unknowns)
    if not np.isfinite(state.scale):
        return None
    spread = _step(state, rig, kind, unknowns)[2]
    residuals, masks = state.fit.residuals(state.curves)
    return Tried(replace(state, residuals=residuals, masks=masks), len(unknowns), spread)


def _descended(state: Fitted, rig: Rig, kind: str, unknowns: Array) -> tuple[Fitted, Array]:
    """The joint fit and the unknowns after damped Gauss-Newton steps; its scale is what it leaves, infinite where no
    frame tells."""
    power = powers(state)
    for _ in range(_STEPS):
        state = replace(state, scale=rms_of_powers(power, state.scale))
        least = _cost(power, state, kind, unknowns)
        if not np.isfinite(least):
            break
        moved, step, _ = _step(state, rig, kind, unknowns)
        for share in _SHARES:
            then = unknowns + share * step
            trial = _with(replace(state, curves=interpolated(state.curves, moved, share)), kind, then)
            there = powers(trial)
            now = _cost(there, trial, kind, then)
            if now < least:
                break
        else:
            break
        gained, state, unknowns, power = 1.0 - now / least, trial, then, there
        if gained < _ENOUGH:
            break
    return replace(state, scale=rms_of_powers(power, state.scale)), unknowns


def _cost(power: Array, state: Fitted, kind: str, unknowns: Array) -> float:
    """Mean square of the residuals over noise, strays bounded, plus the unknowns' prior per frame; infinite where no
    frame tells. power: the state's `powers`."""
    mean, sigma = PRIORS[kind]
    prior = float(np.sum(((unknowns - mean) / sigma) ** 2)) / max(state.frames, 1)
    return rms_of_powers(power, state.scale) ** 2 + state.scale**2 * prior


def _with(state: Fitted, kind: str, unknowns: Array) -> Fitted:
    """The joint fit with friction of these unknowns in place of its hysteresis, not fitted to it yet."""
    friction = _friction(kind, unknowns, _reached(state))
    return replace(state, fit=replace(state.fit, hysteresis=friction, smoothing=state.fit.smoothing))


def _reached(state: Fitted) -> Array:
    """(k,) B, unit of q, at the table's positions between the lowest and the highest that the motor reached; all of B
    where none is."""
    fit = state.fit
    q = np.concatenate([prepared.corner_q for prepared in fit.tracks])
    inside = (fit.grid >= q.min()) & (fit.grid <= q.max())
    width = fit.width(state.curves)
    return width[inside] if inside.any() else width


def _friction(kind: str, unknowns: Array, width: Array) -> Friction:
    """Friction of these unknowns (k,), in the order of PRIORS, on B width (n,), unit of q: as long as makes the tip
    start with the share expit(unknowns[0]) of its later slope where it starts slowest, so that it goes nowhere back."""
    start, part = float(expit(unknowns[0])), float(unknowns[1])
    exponent = float(np.exp(unknowns[2]))
    beta = float(expit(unknowns[3])) if kind == BOUC_WEN else 1.0
    usual = max(float(np.mean(width)), 1e-12)
    relative = np.maximum(1.0 - part + part * width / usual, _THIN)
    steepest = Friction(kind, 1.0, 0.0, exponent, beta).steepest
    whole = 0.5 * steepest * float(np.max(width / relative)) / max(1.0 - start, 1e-9)
    return Friction(kind, (1.0 - part) * whole, part * whole / usual, exponent, beta)


def _by_unknown(kind: str, unknowns: Array, width: Array) -> Array:
    """(values of Friction, unknowns) derivatives of `_friction`, by differences."""
    columns = []
    for i in range(len(unknowns)):
        away = np.zeros(len(unknowns))
        away[i] = _DIFFERENCE
        ends = [_friction(kind, unknowns + side * away, width) for side in (1.0, -1.0)]
        columns.append([(getattr(ends[0], name) - getattr(ends[1], name)) / (2.0 * _DIFFERENCE) for name in VALUES])
    return np.array(columns).T


def _step(state: Fitted, rig: Rig, kind: str, unknowns: Array) -> tuple[Curves, Array, Array]:
    """The curves after a Gauss-Newton step, the unknowns' step (k,), and what these leave open of B (grid,), one
    standard deviation in the unit of q."""
    counted = counted_frames(state, state.curves, rig, np.zeros(2))
    assert counted is not None  # it was fitted to frames
    fit, scale = state.fit, max(state.scale, 1e-6)
    nominal = nominal_columns(fit, counted)
    own = counted.along_path(_slopes(state, counted) @ _by_unknown(kind, unknowns, _reached(state)))
    design = sparse.csr_matrix(sparse.hstack([nominal, own]))
    heavy = scaled_rows(np.tile(counted.weight, counted.residuals.shape[1]), design)
    gram, force = np.asarray((heavy.T @ design).toarray()), np.asarray(heavy.T @ counted.residuals.T.ravel()).ravel()
    head = nominal.shape[1]
    base, pull = fit.penalty(state.curves, scale)
    mean, sigma = PRIORS[kind]
    gram[:head, :head] += base
    force[:head] -= pull
    gram[head:, head:] += np.diag((scale / sigma) ** 2)
    force[head:] -= scale**2 * (unknowns - mean) / sigma**2
    diagonal = np.diag_indices_from(gram)
    gram[diagonal] += 1e-9 * float(np.mean(gram[diagonal][:head]))
    step = np.linalg.solve(gram, force)
    along = step[head:]
    too_far = float(np.max(np.abs(along) / (_LONGEST * sigma)))
    step = step / max(too_far, 1.0)
    answer = np.linalg.solve(gram[:head, :head], gram[:head, head:])  # of the curves to the unknowns
    schur = gram[head:, head:] - gram[head:, :head] @ answer
    first = state.curves.follow.size
    by = fit.backlash.design(fit.grid) @ answer[first : first + fit.backlash.size]
    spread = scale * np.sqrt(np.maximum(np.sum((by @ np.linalg.inv(schur)) * by, axis=1), 0.0))
    return fit.moved(state.curves, step[:head]), step[head:], spread


def _slopes(state: Fitted, counted: CountedFrames) -> Array:
    """(counted frames, values of Friction) derivatives of p by these."""
    fit, curves = state.fit, state.curves
    native = Play(fit.grid, fit.width(curves), fit.hysteresis).native
    far = 10.0 * float(np.abs(fit.grid).max() + np.ptp(fit.grid))
    rows = []
    for number, prepared in enumerate(fit.tracks):
        positions, at = prepared.course(prepared.track.scene_s(curves.delay_s))
        by = native.slopes(positions, -far).reshape(-1, len(VALUES))
        rows.append(by[at][counted.frame[counted.recording == number]])
    return np.concatenate(rows)
