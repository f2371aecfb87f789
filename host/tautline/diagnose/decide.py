"""Which effect: screening by score, refits of the leading ones, likelihoods, and the probabilities that follow."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnose import repeats
from tautline.diagnose.fit import Fit, Fitter, outlier_limit, velocity
from tautline.diagnose.gap import memory
from tautline.diagnose.screen import Screened, screen
from tautline.effects import Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

EVENTS = ("transmission.stick_slip", "acquisition.jitter")  # no reproducible path: told by the scatter they make
_REFITS = 6  # effects refitted in full after screening
_BOTH_SCOPES = 3  # of them also in the other scope
_EXPLAINS = 0.3  # share of the squares from which on an effect with a path has a say before scatter has
_REMEMBERS = 3.0  # an autocorrelation of 1 / this, where scatter has forgotten, says that it is none
_REPEATS = 2.5  # a residual of which 1 / this repeats is no scatter at all
TEMPERATURE = 4.0  # real residuals tell less than independent samples would: every model is a little wrong


@dataclass(frozen=True)
class Candidate:
    """One more effect on top of a hypothesis."""

    kind: Kind
    only_tests: bool
    log_likelihood: float  # of all data, per the effective number of observations
    fit: Fit | None  # None where screening left it behind

    def penalised(self, effective: float) -> float:
        """Twice the log-likelihood less its price (the Bayesian information criterion's, sign turned)."""
        freedom = len(self.kind.amplitudes) + len(self.kind.shapes)
        return 2.0 * self.log_likelihood - freedom * float(np.log(max(effective, 2.0)))


def applicable(fitter: Fitter, left_out: Collection[str] = ()) -> list[Kind]:
    """The effects that these recordings could show at all, but for those left out."""
    load = any(s.motor.load_mNm is not None for s in fitter.segments)
    freedom = any(
        values is not None and float(np.ptp(values)) > 0.0
        for s in fitter.segments
        for values in (s.motor.translation_mm, s.motor.rotation_deg)
    )
    has = {"": True, "camera": fitter.px, "load": load, "freedom": freedom}
    kinds = [kind for kind in effects.LIBRARY if has[kind.needs] and kind.id not in left_out]
    return [kind for kind in kinds if fitter.px or kind.id != "acquisition.delay"]


def candidates(
    fitter: Fitter, base: Fit, kinds: Sequence[Kind], progress: Progress, refits: int = _REFITS
) -> tuple[list[Candidate], float]:
    """Every effect on top of `base`, best first, and the effective number of observations. The leading ones are
    refitted in full: each in the scope that screens better, the best of them in the other scope too."""
    limits = outlier_limits(fitter, base)
    rss0 = robust_rss(base, limits)
    seen: dict[str, dict[bool, Screened]] = {}
    for entry in screen(fitter, base, [kind for kind in kinds if kind.id not in EVENTS], limits):
        seen.setdefault(entry.kind.id, {}).setdefault(entry.only_tests, entry)
    fits: dict[tuple[str, bool], Fit] = {}

    def refit(entry: Screened) -> None:
        progress(min(1.0, len(fits) / (refits + 3)), f"fitting {entry.kind.id}")
        hypothesis = base.hypothesis.plus(entry.kind, entry.only_tests)
        start = {**base.state.values, **entry.values}
        fits[entry.kind.id, entry.only_tests] = fitter.fit(hypothesis, start, base.state, entry.others)

    for scopes in list(seen.values())[:refits]:
        refit(next(iter(scopes.values())))
    for name, only in sorted(fits, key=lambda key: robust_rss(fits[key], limits))[:_BOTH_SCOPES]:
        other = seen[name].get(not only)
        if other is not None:
            refit(other)

    best = min(fits.values(), key=lambda f: robust_rss(f, limits), default=base)
    total = sum(r.size for r in base.residuals)
    effective = total / memory(best.residuals)

    def gaussian(rss: float) -> float:
        return -0.5 * effective * float(np.log(max(rss, 1e-12 * rss0) / total))

    def ranked() -> list[Candidate]:
        scored = []
        for name, scopes in seen.items():
            for only, entry in scopes.items():
                fit = fits.get((name, only))
                rss = robust_rss(fit, limits) if fit else rss0 * (1.0 - entry.gain)
                scored.append(Candidate(entry.kind, only, gaussian(rss), fit))
        scored += events
        best: dict[str, Candidate] = {}
        for candidate in sorted(scored, key=lambda c: -c.penalised(effective)):
            best.setdefault(candidate.kind.id, candidate)
        return list(best.values())

    explained = 1.0 - robust_rss(best, limits) / rss0
    judged = best if explained > _EXPLAINS else base
    repeating = repeats.share(fitter.segments[1:], judged.residuals[1:])
    events = [
        _event(fitter, judged, base, kind, gaussian(rss0), (1.0 - min(1.0, _REPEATS * repeating)) * effective / total)
        for kind in kinds
        if kind.id in EVENTS
    ]
    ordered = ranked()
    while ordered[0].fit is None:
        refit(seen[ordered[0].kind.id][ordered[0].only_tests])
        ordered = ranked()
    return ordered, effective


def probabilities(ordered: Sequence[Candidate], effective: float, base: float) -> Array:
    """(len + 1,): of each candidate to be the leading effect, and last of `base` (the log-likelihood without any)."""
    score = np.array([c.penalised(effective) for c in ordered] + [2.0 * base]) / (2.0 * TEMPERATURE)
    weight = np.exp(score - score.max())
    result: Array = weight / weight.sum()
    return result


def log_likelihood(fitter: Fitter, fit: Fit, effective: float) -> float:
    """Of the fit that candidates were put on top of."""
    total = sum(r.size for r in fit.residuals)
    return -0.5 * effective * float(np.log(robust_rss(fit, outlier_limits(fitter, fit)) / total))


def outlier_limits(fitter: Fitter, base: Fit) -> list[float]:
    """Of each recording, one for all that are compared."""
    return [max(outlier_limit(r), 8.0 * fitter.floor) for r in base.residuals]


def robust_rss(fit: Fit, limits: Sequence[float]) -> float:
    """Sum of squares with outliers pulled in."""
    return sum(float(np.sum(np.minimum(np.abs(r), limit) ** 2)) for r, limit in zip(fit.residuals, limits, strict=True))


def _event(fitter: Fitter, judged: Fit, base: Fit, kind: Kind, without: float, share: float) -> Candidate:
    """Scatter along the marker's motion that its speed explains (jitter) or that is there whenever it moves
    (stick-slip): a Gaussian whose variance follows it, against one of constant variance. Looked for in what `judged`
    leaves: what an effect with a path explains is no scatter. share: effective observations per observation."""
    along, drive, steps = [], [], []
    for segment, r in zip(fitter.segments, judged.residuals, strict=True):
        at = judged.state.at(segment, judged.hypothesis)
        path, predicted = segment.predict(judged.state.model, at, fitter.load_reference)
        keep = segment.scored
        seen = np.gradient(predicted, segment.arrival_s, axis=0)[keep] if len(predicted) > 2 else np.zeros_like(r)
        speed = np.linalg.norm(seen, axis=1)
        unit = seen / np.maximum(speed, 1e-9)[:, None]
        along.append(np.sum(r * unit, axis=1))
        if kind.id == "acquisition.jitter":
            drive.append(speed)
        else:
            turning = np.abs(velocity(segment, path.p)[keep])
            steps.append(turning * float(np.median(np.diff(segment.arrival_s))))
            drive.append(
                np.where(turning > 0.02 * max(float(turning.max()), 1e-12), speed / np.maximum(turning, 1e-9), 0)
            )
    a, d = np.concatenate(along), np.concatenate(drive)
    moving = d > 0
    if moving.sum() < 50:
        return _scatter(base, kind, 0.0, without)
    limit = outlier_limit(a[moving])
    square = np.clip(a, -limit, limit) ** 2
    floor2 = max(float(np.mean(square[~moving])) if (~moving).sum() > 50 else 0.0, fitter.floor**2)
    best, amplitude = -np.inf, 0.0
    for s in np.geomspace(1e-3, 1e3, 121) * fitter.floor / max(float(np.median(d[moving])), 1e-12):
        variance = floor2 + (s * d) ** 2
        value = -0.5 * float(np.sum(np.log(variance) + square / variance))
        if value > best:
            best, amplitude = value, float(s)
    constant = float(np.mean(square))
    homoscedastic = -0.5 * float(np.sum(np.log(constant) + square / constant))
    lag = 1
    if kind.id == "transmission.stick_slip":
        amplitude *= float(np.sqrt(12.0))
        lag = int(np.clip(np.ceil(2.0 * amplitude / np.median(np.concatenate(steps)[moving])), 1, 100))
    # Jitter forgets within a frame, stick-slip within two jumps: what remembers longer is neither.
    both = moving[:-lag] & moving[lag:]
    kept = abs(float(np.sum(a[:-lag] * a[lag:] * both))) / max(float(np.sum(a[moving] ** 2)), 1e-300)
    gain = max(0.0, best - homoscedastic) * max(0.0, 1.0 - _REMEMBERS * kept) * min(1.0, share * 4.0)
    return _scatter(base, kind, amplitude, without + gain)


def _scatter(base: Fit, kind: Kind, amplitude: float, log_likelihood: float) -> Candidate:
    values = {**base.state.values, kind.amplitudes[0].name: amplitude}
    fit = replace(base, hypothesis=base.hypothesis.plus(kind, True), state=replace(base.state, values=values))
    return Candidate(kind, True, log_likelihood, fit)
