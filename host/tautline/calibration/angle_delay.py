"""The delay of an angle sensor, by all its values: real joints do not stop so sharply that stops alone tell it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tautline.calibration.lag_scan import DELAY_REACH_S, FRAMES, WIDTHS, LagScan, period_s
from tautline.calibration.observations import Track
from tautline.calibration.onset import Delay
from tautline.calibration.playfit import Curves, Fitted, PlayFit, Point
from tautline.calibration.simulated_track import PreparedTrack
from tautline.independence import first_order
from tautline.rig import Rig
from tautline.splines import Basis
from tautline.spread import of_rounding

_STATED_S = 0.05  # prior: standard deviation of an angle sensor's delay about what the rig states
_UNSTATED_S = 0.05, 0.07  # prior: mean and standard deviation where the rig states none: of bus, filter or servo
_SPANS = (8, 16), (1, 6)  # prior: of B and of the path; the stiffer pair where the first does not tell the delay
_TOLD_S = 0.025  # tolerance: standard deviation up to which a delay counts as told
_COARSE_S = 0.02  # tolerance: between delays of the first search
_GRIDS = (2.0, 1.0, 0.4, 0.12)  # tolerance: of that: between delays of the posterior's grids, from the coarsest
_PER_STROKE = 4.0  # prior: independent residuals of a model with errors within a stroke, at most
_STROKES = 10  # prior: strokes that count for that at most: model errors repeat in further ones
_WHITE = 1.05  # tolerance: residual over noise up to which nothing but noise is in it
_CLEARLY = 1.03  # prior: ratio of residuals from which one fit is clearly worse
_LIKELY = 3.0  # prior: standard deviations within which a delay is likely
_LAGS, _EITHER_SIDE = 21, 3  # tolerance: lags of the first search; delays of a posterior's grid on either side
_STEPS = 6  # tolerance: of a fit at one delay
_SAMPLES, _LITTLE_S = 1.5, 0.01  # prior: frame periods, and s: a delay that is off by less may be a model error's


def delay_of_all(tracks: Sequence[Track], rig: Rig) -> Delay:
    """The delay of an angle sensor by all its frames: posterior mean and standard deviation, by how closely a smooth B
    and a smooth path fit at each delay. Its prior is normal, about the rig's delay with sigma _STATED_S, or _UNSTATED_S
    (mean, sigma) if the rig states none. The nominal delay with sigma inf if no track can be scanned (`LagScan.of`), or
    the tip is seen at too few places."""
    nominal_s = rig.nominal_delay_s(tracks[0].sensor)
    scans = [scan for scan in (LagScan.of(track, rig, FRAMES[1]) for track in tracks) if scan is not None]
    if not scans:
        return Delay(nominal_s, np.inf, 0)
    lags = nominal_s + np.linspace(-DELAY_REACH_S, DELAY_REACH_S, _LAGS)
    start = float(lags[int(np.argmin(np.sum([scan.least_misfits(lags) for scan in scans], axis=0)))])
    try:
        stated = rig.angle is not None or rig.sees_from_tip
        prior_mean_s, prior_sigma_s = (nominal_s, _STATED_S) if stated else _UNSTATED_S
        return _delay_posterior(scans, prior_mean_s, start, prior_sigma_s)
    except np.linalg.LinAlgError:  # the tip is seen at too few places
        return Delay(nominal_s, np.inf, 0)


def _delay_posterior(scans: Sequence[LagScan], prior_mean_s: float, start_s: float, prior_sigma_s: float) -> Delay:
    """Posterior mean and standard deviation of the delay, s: a search in steps of _COARSE_S, then grids of ever finer
    pitch until one is finer than the posterior's spread. If that is not below _TOLD_S, all is done again with stiffer
    curves. prior_mean_s, prior_sigma_s: of the normal prior; start_s: delay at which plays of constant width fit
    best."""
    for spans in _SPANS:
        profile = _DelayDeviance(scans, spans, prior_mean_s, prior_sigma_s, start_s)
        best = min((prior_mean_s, 0.5 * (start_s + prior_mean_s), start_s), key=profile.deviance)
        while (better := min((best, best - _COARSE_S, best + _COARSE_S), key=profile.deviance)) != best:
            best = better
        for pitch_s in (share * _COARSE_S for share in _GRIDS):
            best, spread = profile.posterior(best, pitch_s)
            if spread > pitch_s:
                break
        if spread < _TOLD_S:
            break
    return Delay(best, spread, len(scans))


def at_credible_delay(free: Fitted, delay: Delay, tracks: Sequence[Track], nominal_s: float) -> Fitted:
    """The joint fit of an angle sensor at a delay that model errors cannot have moved. free: the fit with the delay
    fitted, which is returned as it is if it leaves only noise. Else the fit is repeated with the delay held: at the
    nominal one if the fitted one is near it (within _SAMPLES frame periods and _LITTLE_S), else at `delay` (of
    `delay_of_all`). In the latter case `free` is returned all the same if its delay is within _LIKELY sigmas of `delay`
    and the fit that holds it leaves more than _CLEARLY times the residual."""
    own_s = free.curves.delay_s
    if free.scale <= _WHITE:
        return free
    # A fitted delay that is off by so little may be due to a model error.
    at_nominal = abs(own_s - nominal_s) <= min(_SAMPLES * period_s(tracks), _LITTLE_S)
    fixed = replace(free.fit, fit_delay=False, smoothing=dict(free.fit.smoothing))
    fitted = fixed.solve(replace(free.curves, delay_s=nominal_s if at_nominal else delay.delay_s))
    likely = not at_nominal and abs(own_s - delay.delay_s) < _LIKELY * delay.sigma_s
    return free if likely and fitted.scale > _CLEARLY * free.scale else fitted


class _DelayDeviance:
    """The deviance (-2 log posterior density but for a constant) of a delay, by all frames of all tracks and a normal
    prior. The frames' part is 2 N log(scale), where scale is the residual over noise that the best smooth B and path
    leave at that delay, and N the number of independent residuals, at most _PER_STROKE for each of _STROKES strokes, as
    model errors repeat from stroke to stroke."""

    def __init__(
        self,
        scans: Sequence[LagScan],
        spans: tuple[int, int],
        prior_mean_s: float,
        prior_sigma_s: float,
        start_s: float,
    ) -> None:
        """spans: numbers of spans of the splines of B and of the path. prior_mean_s, prior_sigma_s: of the normal
        prior. start_s: the delay at which N is counted."""
        self._scans, self._prior_mean_s, self._prior_sigma_s = scans, prior_mean_s, prior_sigma_s
        low = min(scan.low for scan in scans)
        high = max(scan.low + scan.span for scan in scans)
        self._fit = PlayFit(
            [PreparedTrack.of(scan.track, scan.moving()) for scan in scans],
            Basis(low, high, spans[0]),
            Basis(low, high, spans[1]),
            fit_delay=False,
            settled_only=False,
        )
        self._smoothing = dict(self._fit.smoothing)
        self._found: dict[float, float] = {}
        strokes = sum(len(scan.turn_t) - 1 for scan in scans)
        self._independent = min(_independent_residuals(self._solved(start_s)), _PER_STROKE * min(strokes, _STROKES))

    def deviance(self, delay_s: float) -> float:
        """The deviance of a delay, s; computed once for each."""
        key = round(delay_s, 7)
        if key not in self._found:
            left = 2.0 * self._independent * float(np.log(self._solved(delay_s).scale))
            self._found[key] = left + ((delay_s - self._prior_mean_s) / self._prior_sigma_s) ** 2
        return self._found[key]

    def posterior(self, centre_s: float, pitch_s: float) -> tuple[float, float]:
        """Posterior mean and standard deviation, s, from the deviance on a grid of delays, pitch_s apart, _EITHER_SIDE
        of them on each side of centre_s. The standard deviation includes that of a uniform density of one pitch."""
        delays = centre_s + pitch_s * np.arange(-_EITHER_SIDE, _EITHER_SIDE + 1)
        deviance = np.array([self.deviance(float(delay)) for delay in delays])
        weight = np.exp(-0.5 * (deviance - deviance.min()))
        weight /= weight.sum()
        mean = float(weight @ delays)
        return mean, float(np.hypot(np.sqrt(weight @ (delays - mean) ** 2), of_rounding(pitch_s)))

    def _solved(self, delay_s: float) -> Point:
        """The fit of B and path with the delay held at delay_s. It starts from the constant width with the least misfit
        there, a path of 0 and the smoothing of a new fit, so that it depends on no delay that was solved before."""
        fit, channels = self._fit, self._scans[0].track.y.shape[1]
        fit.smoothing = dict(self._smoothing)
        widths = [share * self._scans[0].span for share in WIDTHS]
        width = min(widths, key=lambda w: sum(scan.misfit(delay_s, w) for scan in self._scans))
        flat = Curves(np.full(fit.backlash.size, width), np.zeros((fit.follow.size, channels)), delay_s)
        return fit.descended(flat, _STEPS)


def _independent_residuals(point: Point) -> float:
    """The number of independent residuals of a fit, 1 at least: each track's counted frames over `first_order`, which
    says how many correlated neighbours tell as much as one independent frame."""
    count = 0.0
    for rows, mask in zip(point.residuals, point.masks, strict=True):
        r = rows[mask]
        if len(r) > 2:
            count += len(r) / first_order(r)
    return max(count, 1.0)
