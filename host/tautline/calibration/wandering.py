"""The covariance of B, path and delay when effects are fitted with them, allowing for effects whose laws are not exact.

The amplitude of a real effect varies with place, speed, time, side and load by a share of itself (standard deviation),
which is learnt. A fit with one constant amplitude puts that variation into B and the delay. So further columns are
added to the normal equations: the tip's motion by the effects times each function by which a diagnosis lets amplitudes
vary (diagnosis/wander.py). Their factors are normal about 0 and integrated out. Besides, the effect as a whole may
differ from its law by the same share (`_covariance_of_form`)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.place import place_noise
from tautline.calibration.playfit import Fitted
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.wander import Course, axes_values, varying_columns

Array = npt.NDArray[np.float64]

_RIDGE = 1e-12  # tolerance: information on each unknown that is added, so that what no frame tells has an inverse


def _varying_share(fitted: Fitted) -> float:
    """By which share of itself (standard deviation) the effects' amplitude varies, as learnt for effects of the
    material. 1 if a value ended at an end of its range: then the fit tells nothing of the effect, and it may be
    absent."""
    effects, values = fitted.effects_and_values
    return 1.0 if effects.any_at_end(values) else learnt().center.wanders_material


def allowing_for_wander(fitted: Fitted) -> Fitted:
    """The same fit with another covariance: as of independent frames only, and with effects whose amplitude varies by
    `_varying_share` of itself, a variance that is spread evenly over the columns by which it may."""
    noise = place_noise(fitted)
    unit2 = fitted.scale**2 * (1.0 if noise is None else noise.effect)
    fit, curves, share = fitted.fit, fitted.curves, _varying_share(fitted)
    matrix, _ = fit.normal(curves, fitted.residuals, fitted.weights, _varying_columns(fitted))
    penalty, _ = fit.penalty(curves, fitted.scale)
    known = len(penalty)
    matrix[:known, :known] += penalty
    information = matrix / unit2 + _RIDGE * np.eye(len(matrix))
    factors = np.arange(known, len(matrix))
    information[factors, factors] += len(factors) / share**2
    covariance = np.linalg.inv(information)[:known, :known]
    return replace(fitted, covariance=covariance + _covariance_of_form(fitted, information[:known, :known], share))


def _covariance_of_form(fitted: Fitted, information: Array, share: float) -> Array:
    """Covariance (m, m) to be added because each effect as a whole may differ by `share` of itself from what its law
    makes of the frames: its amplitudes change by that share, and all other unknowns follow. information (m, m): inverse
    covariance of the unknowns, in the order of PlayFit.layout."""
    effects, values = fitted.effects_and_values
    own = np.arange(len(information) - 1 - len(values), len(information) - 1)
    rest = np.setdiff1d(np.arange(len(information)), own)
    follows = -np.linalg.solve(information[np.ix_(rest, rest)], information[np.ix_(rest, own)])
    moved = np.zeros((len(information), len(effects.kinds)))
    for k, kind in enumerate(effects.kinds):
        moved[own, k] = share * effects.amplitudes(values, kind)
        moved[rest, k] = follows @ moved[own, k]
    return np.asarray(moved @ moved.T)


def _varying_columns(fitted: Fitted) -> list[Array]:
    """Columns for the normal equations by which the effects' amplitude may vary from place to place, so that B and the
    delay are not thought surer than an inexact law allows. By track, (n, k): what the effects add to the tip's place,
    unit of q, times each of k polynomials of place, speed, time, side and load (`varying_columns`), scaled so that a
    factor's square is a share of the effects' whole power. 0 at frames that do not count; [] where nothing varies."""
    fit, (effects, values) = fitted.fit, fitted.effects_and_values
    fit.simulate(fitted.curves)
    amplitudes = effects.amplitudes(values)
    courses, signals = [], []
    for prepared, sim, mask in zip(fit.tracks, fit.simulated, fitted.masks, strict=True):
        track = prepared.track
        at = track.scene_s(fitted.curves.delay_s)
        _, by = fit.slopes(prepared, sim, mask, fitted.curves)
        signals.append((by[:, :-1] @ amplitudes)[:, None])
        load = track.reading.load_mNm
        loads = np.zeros_like(at) if load is None else np.interp(at, track.reading.t_s, load)
        courses.append(Course(sim.p, at, at + track.session_s, loads, mask))
    power = sum(float(np.sum(signal**2)) for signal in signals)
    columns, _ = varying_columns(axes_values(courses), signals, power)
    if not columns:
        return []
    spread = []
    for mask, column in zip(fitted.masks, columns, strict=True):
        every = np.zeros((len(mask), column.shape[2]))
        every[mask] = column[:, 0, :]
        spread.append(every)
    return spread
