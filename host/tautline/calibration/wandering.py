"""What B, the delay and the path are uncertain by, as an effect beside them is another elsewhere.

A right effect's amplitude is the same at all places, speeds, times, sides and loads but for a share of itself, which is
learnt. Whatever a fit of one amplitude makes of that goes to B and the delay: so factors on what the effect adds, one
for each function that a diagnosis asks of an amplitude (diagnosis/wander.py), are unknowns of the same normal
equations, each normal about 0, and are integrated out. No law is exact either: frames that tell the amplitude tell that
of the law, and it may be another by the same share as a whole.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.calibration.place import place_noise
from tautline.calibration.playfit import Fitted
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.wander import Course, axes_values, varying_columns

Array = npt.NDArray[np.float64]


def _share(fitted: Fitted) -> float:
    """Of itself, by which the effects' amplitude is another elsewhere (one standard deviation), whatever they are as
    much as friction's. At an end of its range the fit says nothing of a value: it may be as without the effect."""
    beside, values = fitted.effects_and_values
    return 1.0 if beside.ended(values) else learnt().center.wanders_material


def allowing_for_wander(fitted: Fitted) -> Fitted:
    """The same fit, its covariance that of as many frames as are independent and of effects whose amplitude
    wanders."""
    noise = place_noise(fitted)
    unit2 = fitted.scale**2 * (1.0 if noise is None else noise.effect)
    fit, curves, share = fitted.fit, fitted.curves, _share(fitted)
    matrix, _ = fit.normal(curves, fitted.residuals, fitted.weights, _functions(fitted))
    penalty, _ = fit.penalty(curves, fitted.scale)
    known = len(penalty)
    matrix[:known, :known] += penalty
    information = matrix / unit2 + 1e-12 * np.eye(len(matrix))
    factors = np.arange(known, len(matrix))
    information[factors, factors] += len(factors) / share**2
    covariance = np.linalg.inv(information)[:known, :known]
    return replace(fitted, covariance=covariance + _of_form(fitted, information[:known, :known], share))


def _of_form(fitted: Fitted, information: Array, share: float) -> Array:
    """Covariance (unknowns, unknowns) where each effect as a whole is another by this share than its law makes of the
    frames, everything but the effects following it. information: inverse covariance of the same."""
    beside, values = fitted.effects_and_values
    own = np.arange(len(information) - 1 - len(values), len(information) - 1)
    rest = np.setdiff1d(np.arange(len(information)), own)
    follows = -np.linalg.solve(information[np.ix_(rest, rest)], information[np.ix_(rest, own)])
    moved = np.zeros((len(information), len(beside.kinds)))
    for k, kind in enumerate(beside.kinds):
        moved[own, k] = share * beside.amplitudes(values, kind)
        moved[rest, k] = follows @ moved[own, k]
    return np.asarray(moved @ moved.T)


def _functions(fitted: Fitted) -> list[Array]:
    """Of each track (frames, m): what the effects add to the tip's place, times the functions by which that may vary,
    each of the power of it all; 0 at frames that do not count."""
    fit, (beside, values) = fitted.fit, fitted.effects_and_values
    fit.residuals(fitted.curves)
    amplitudes = beside.amplitudes(values)
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
