"""Bouc-Wen's or Dahl's friction (tautline.friction) instead of plays, fitted to all frames together with B, path and
delay; and which hysteresis it is, by evidence.

The unknowns (k,) are scaled to about 1 each: u[0] the logit of the share of its later slope with which the tip starts
where it starts slowest; u[1] the part of the friction's length that is proportional to B; u[2] the logarithm of the
exponent; of Bouc-Wen's u[3] the logit of beta. Each has a normal prior; Gauss-Newton steps use the state's own
derivatives. "state" below is the joint fit as it stands during the descent, its scale what it leaves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from tautline.calibration.components import interpolated
from tautline.calibration.counted import CountedFrames, counted_frames
from tautline.calibration.mixed_model import normal_with_columns
from tautline.calibration.playfit import Curves, Fitted, rms_of_frame_powers
from tautline.calibration.several import frame_powers, rms_over_noise
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
_RIDGE = 1e-9  # tolerance: of the curves' mean diagonal, added to all of a step's


@dataclass(frozen=True)
class HysteresisFit:
    """A joint fit with a hysteresis other than one play."""

    fitted: Fitted
    unknowns: int  # how many the hysteresis has
    spread: Array | None = None  # (grid,) standard deviation of B, unit of q, by the unknowns' uncertainty

    def evidence(self, frames_each: float) -> float:
        """Log evidence but for a constant, by Schwarz's approximation: -N log(rms) - k/2 log N, with N the number of
        independent residuals and k that of the hysteresis's unknowns; the noise's size is integrated out. frames_each:
        how many frames tell as much as one independent frame."""
        number = self.fitted.frames / max(frames_each, 1.0) * self.fitted.residuals[0].shape[1]
        rms = max(rms_over_noise(self.fitted), 1e-9)
        return float(-number * np.log(rms) - 0.5 * self.unknowns * np.log(number))


def most_evidence(candidates: list[HysteresisFit], frames_each: float) -> HysteresisFit:
    """The candidate with the largest evidence. frames_each: frames for each independent one, the same for all."""
    scale = min(candidate.fitted.scale for candidate in candidates)  # outliers are cut alike in all
    alike = [replace(candidate, fitted=replace(candidate.fitted, scale=scale)) for candidate in candidates]
    return candidates[int(np.argmax([candidate.evidence(frames_each) for candidate in alike]))]


def fit_friction(starts: Sequence[Fitted], rig: Rig, kind: str, fit_delay: bool) -> HysteresisFit | None:
    """The joint fit with friction of this kind (BOUC_WEN or DAHL). It is descended from each of the starts; the best
    goes on, descending _AGAIN times more after its smoothing was adapted. Its scale is what friction leaves. None if no
    frame counts: with a friction whose start is felt throughout."""
    scale = max(start.scale for start in starts)  # outliers are cut alike in all, and not before a fit is done
    mean = PRIORS[kind][0]
    descended = []
    for start in starts:
        fit = replace(start.fit, fit_delay=fit_delay, smoothing=dict(start.fit.smoothing))
        descended.append(_descended(_with_friction(replace(start, fit=fit, scale=scale), kind, mean), rig, kind, mean))
    state, unknowns = min(descended, key=lambda pair: rms_over_noise(pair[0]))
    for _ in range(_AGAIN):
        if not np.isfinite(state.scale):
            return None
        solved = state.fit.solve(state.curves, iterations=_SMOOTHED)
        state = _with_friction(replace(state, fit=solved.fit, curves=solved.curves), kind, unknowns)
        state, unknowns = _descended(state, rig, kind, unknowns)
    if not np.isfinite(state.scale):
        return None
    spread = _step(state, rig, kind, unknowns)[2]
    residuals, masks = state.fit.residuals(state.curves)
    return HysteresisFit(replace(state, residuals=residuals, masks=masks), len(unknowns), spread)


def _descended(state: Fitted, rig: Rig, kind: str, unknowns: Array) -> tuple[Fitted, Array]:
    """The joint fit and the unknowns (k,) after damped Gauss-Newton steps. The fit's scale becomes what it leaves,
    infinite if no frame counts."""
    power = frame_powers(state)
    for _ in range(_STEPS):
        state = replace(state, scale=rms_of_frame_powers(power, state.scale))
        least = _cost(power, state, kind, unknowns)
        if not np.isfinite(least):
            break
        moved, step, _ = _step(state, rig, kind, unknowns)
        for share in _SHARES:
            trial_unknowns = unknowns + share * step
            trial = _with_friction(
                replace(state, curves=interpolated(state.curves, moved, share)), kind, trial_unknowns
            )
            trial_power = frame_powers(trial)
            cost = _cost(trial_power, trial, kind, trial_unknowns)
            if cost < least:
                break
        else:
            break  # no share of the step lowers the cost
        gained, state, unknowns, power = 1.0 - cost / least, trial, trial_unknowns, trial_power
        if gained < _ENOUGH:
            break
    return replace(state, scale=rms_of_frame_powers(power, state.scale)), unknowns


def _cost(power: Array, state: Fitted, kind: str, unknowns: Array) -> float:
    """Mean square of the residuals over noise, outliers cut, plus the prior's cost: the unknowns' squared distance from
    the prior mean, in prior sigmas, times scale^2 over the number of frames. Infinite if no frame counts. power: the
    state's `frame_powers`."""
    mean, sigma = PRIORS[kind]
    prior = float(np.sum(((unknowns - mean) / sigma) ** 2)) / max(state.frames, 1)
    return rms_of_frame_powers(power, state.scale) ** 2 + state.scale**2 * prior


def _with_friction(state: Fitted, kind: str, unknowns: Array) -> Fitted:
    """The joint fit with friction of these unknowns (k,) as its hysteresis; nothing is fitted yet."""
    friction = _friction(kind, unknowns, _width_where_reached(state))
    return replace(state, fit=replace(state.fit, hysteresis=friction, smoothing=state.fit.smoothing))


def _width_where_reached(state: Fitted) -> Array:
    """(reached,) B, unit of q, at those positions of the grid that are within the motor's range of motion; all of B,
    (grid,), if none is."""
    fit = state.fit
    q = np.concatenate([prepared.corner_q for prepared in fit.tracks])
    inside = (fit.grid >= q.min()) & (fit.grid <= q.max())
    width = fit.width(state.curves)
    return width[inside] if inside.any() else width


def _friction(kind: str, unknowns: Array, width: Array) -> Friction:
    """The friction of unknowns u (k,) on B width (n,), unit of q. Its length L(q) = length + share B(q) has the
    proportions of u[1] and is scaled so that the tip starts with expit(u[0]) of its later slope where it starts
    slowest. Leaving an envelope it has 1 - steepest B / (2 L) of that slope, as the tip is off the motor by z B / 2; as
    expit is positive, it never goes backwards."""
    start, part_of_width = float(expit(unknowns[0])), float(unknowns[1])
    exponent = float(np.exp(unknowns[2]))
    beta = float(expit(unknowns[3])) if kind == BOUC_WEN else 1.0
    usual = max(float(np.mean(width)), 1e-12)
    relative = np.maximum(1.0 - part_of_width + part_of_width * width / usual, _THIN)
    steepest = Friction(kind, 1.0, 0.0, exponent, beta).steepest
    mean_length = 0.5 * steepest * float(np.max(width / relative)) / max(1.0 - start, 1e-9)
    return Friction(kind, (1.0 - part_of_width) * mean_length, part_of_width * mean_length / usual, exponent, beta)


def _friction_by_unknowns(kind: str, unknowns: Array, width: Array) -> Array:
    """(values of Friction, unknowns) derivatives of `_friction` with B width (n,), by central differences."""
    columns = []
    for i in range(len(unknowns)):
        away = np.zeros(len(unknowns))
        away[i] = _DIFFERENCE
        ends = [_friction(kind, unknowns + side * away, width) for side in (1.0, -1.0)]
        columns.append([(getattr(ends[0], name) - getattr(ends[1], name)) / (2.0 * _DIFFERENCE) for name in VALUES])
    return np.array(columns).T


def _step(state: Fitted, rig: Rig, kind: str, unknowns: Array) -> tuple[Curves, Array, Array]:
    """One Gauss-Newton step: the curves after it, the unknowns' step (k,), at most _LONGEST prior standard deviations,
    and the standard deviation of B (grid,), unit of q, that the unknowns' uncertainty causes."""
    counted = counted_frames(state, state.curves, rig, np.zeros(2))
    assert counted is not None  # it was fitted to frames
    fit, scale = state.fit, max(state.scale, 1e-6)
    by_unknown = _place_by_friction(state, counted) @ _friction_by_unknowns(kind, unknowns, _width_where_reached(state))
    gram, gradient, size = normal_with_columns(fit, counted, by_unknown)
    penalty, pull = fit.penalty(state.curves, scale)
    mean, sigma = PRIORS[kind]
    gram[:size, :size] += penalty
    gradient[:size] -= pull
    gram[size:, size:] += np.diag((scale / sigma) ** 2)
    gradient[size:] -= scale**2 * (unknowns - mean) / sigma**2
    diagonal = np.diag_indices_from(gram)
    gram[diagonal] += _RIDGE * float(np.mean(gram[diagonal][:size]))
    step: Array = np.asarray(np.linalg.solve(gram, gradient), dtype=np.float64)
    # How many times longer than allowed the step of the unknowns is; the whole step is shortened.
    too_far = float(np.max(np.abs(step[size:]) / (_LONGEST * sigma)))
    step = np.asarray(step / max(too_far, 1.0), dtype=np.float64)
    return fit.moved(state.curves, step[:size]), step[size:], _width_sigma_by_unknowns(state, gram, size)


def _width_sigma_by_unknowns(state: Fitted, gram: Array, size: int) -> Array:
    """(grid,) standard deviation of B, unit of q, by the uncertainty of the friction's unknowns u alone: the diagonal
    of D C D', with C their covariance once the curves are eliminated (Schur complement), and D = dB/du how B follows
    them. gram (m, m): normal matrix with priors, whose first `size` unknowns are the curves'."""
    fit, scale = state.fit, max(state.scale, 1e-6)
    # Curves eliminated: they follow the unknowns by -G_cc^-1 G_cu, whose sign does not matter here.
    follows = np.linalg.solve(gram[:size, :size], gram[:size, size:])
    schur = gram[size:, size:] - gram[size:, :size] @ follows
    by = fit.backlash.design(fit.grid) @ follows[fit.layout(state.curves).backlash]
    return np.asarray(scale * np.sqrt(np.maximum(np.sum((by @ np.linalg.inv(schur)) * by, axis=1), 0.0)))


def _place_by_friction(state: Fitted, counted: CountedFrames) -> Array:
    """(counted frames, VALUES) derivatives of the tip's place p, unit of q, by each of the friction's values. p starts
    so far below the motor that it begins on an envelope, as in `PreparedTrack.simulate`."""
    fit, curves = state.fit, state.curves
    native = Play(fit.grid, fit.width(curves), fit.hysteresis).native
    far = 10.0 * float(np.abs(fit.grid).max() + np.ptp(fit.grid))
    rows = []
    for number, prepared in enumerate(fit.tracks):
        driven = prepared.driven(curves.delay_s)
        positions, at = driven.positions, driven.at
        by = native.slopes(positions, -far).reshape(-1, len(VALUES))
        rows.append(by[at][counted.frame[counted.recording == number]])
    return np.concatenate(rows)
