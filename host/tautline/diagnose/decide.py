"""Which effect: screening by score, refits of the leading ones, likelihoods, and the probabilities that follow."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnose.fit import Fit, Fitter, inside, robust_deviation, velocity
from tautline.diagnose.gap import memory
from tautline.effects import Kind

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

EVENTS = ("transmission.stick_slip", "acquisition.jitter")  # no reproducible path: told by the scatter they make
_REFITS = 7  # effects refitted in full after screening
_TEMPERATURE = 4.0  # real residuals tell less than independent samples would: every model is a little wrong


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


def applicable(fitter: Fitter) -> list[Kind]:
    """The effects that these recordings could show at all."""
    load = any(s.motor.load_mNm is not None for s in fitter.segments)
    freedom = any(
        values is not None and float(np.ptp(values)) > 0.0
        for s in fitter.segments
        for values in (s.motor.translation_mm, s.motor.rotation_deg)
    )
    has = {"": True, "camera": fitter.px, "load": load, "freedom": freedom}
    kinds = [kind for kind in effects.LIBRARY if has[kind.needs]]
    return [kind for kind in kinds if fitter.px or kind.id != "acquisition.delay"]


def candidates(
    fitter: Fitter, base: Fit, kinds: Sequence[Kind], progress: Progress, refits: int = _REFITS
) -> tuple[list[Candidate], float]:
    """Every effect on top of `base`, best first, and the effective number of observations."""
    screened = _screen(fitter, base, kinds)
    fits: list[Candidate] = []
    waveform = [s for s in screened if s[1].id not in EVENTS]
    seen: dict[tuple[str, bool], tuple[float, Kind, bool, dict[str, float]]] = {}
    for entry in waveform:
        seen.setdefault((entry[1].id, entry[2]), entry)
    leading = list(seen.values())[: 2 * refits]
    leading = [e for i, e in enumerate(leading) if sum(x[1].id == e[1].id for x in leading[:i]) < 2]
    chosen_ids: list[str] = []
    for entry in leading:
        if entry[1].id not in chosen_ids:
            chosen_ids.append(entry[1].id)
    leading = [e for e in leading if e[1].id in chosen_ids[:refits]]
    for i, (_, kind, only, values) in enumerate(leading):
        progress(i / max(1, len(leading)), f"fitting {kind.id}")
        hypothesis = base.hypothesis.plus(kind, only)
        start = {**base.state.values, **values}
        fit = fitter.fit(hypothesis, start, start=base.state)
        fits.append(Candidate(kind, only, 0.0, fit))

    best = min((c.fit for c in fits if c.fit), key=lambda f: _robust_rss(fitter, f), default=base)
    effective = sum(r.size for r in base.residuals) / memory(best.residuals)
    total = sum(r.size for r in base.residuals)

    def gaussian(rss: float) -> float:
        return -0.5 * effective * float(np.log(rss / total))

    scored = [Candidate(c.kind, c.only_tests, gaussian(_robust_rss(fitter, c.fit)), c.fit) for c in fits if c.fit]
    done = {(c.kind.id, c.only_tests) for c in scored}
    rss0 = _robust_rss(fitter, base)
    for (name, only), (gain, kind, _, _) in seen.items():
        if (name, only) not in done:
            scored.append(Candidate(kind, only, gaussian(max(rss0 * (1.0 - gain), 1e-12 * rss0)), None))
    for kind in kinds:
        if kind.id in EVENTS:
            scored.append(_event(fitter, base, kind, gaussian(rss0), effective / total))
    ordered = sorted(scored, key=lambda c: -c.penalised(effective))
    first: dict[str, Candidate] = {}
    for c in ordered:
        first.setdefault(c.kind.id, c)
    return list(first.values()), effective


def probabilities(ordered: Sequence[Candidate], effective: float, base: float) -> Array:
    """(len + 1,): of each candidate to be the leading effect, and last of `base` (the log-likelihood without any)."""
    score = np.array([c.penalised(effective) for c in ordered] + [2.0 * base]) / (2.0 * _TEMPERATURE)
    weight = np.exp(score - score.max())
    result: Array = weight / weight.sum()
    return result


def log_likelihood(fitter: Fitter, fit: Fit, effective: float) -> float:
    total = sum(r.size for r in fit.residuals)
    return -0.5 * effective * float(np.log(_robust_rss(fitter, fit) / total))


def _robust_rss(fitter: Fitter, fit: Fit) -> float:
    """Sum of squares with outliers pulled in: a lost marker must not decide."""
    total = 0.0
    for r in fit.residuals:
        limit = 8.0 * max(robust_deviation(r), fitter.floor)
        total += float(np.sum(np.minimum(np.abs(r), limit) ** 2))
    return total


def _screen(fitter: Fitter, base: Fit, kinds: Iterable[Kind]) -> list[tuple[float, Kind, bool, dict[str, float]]]:
    """(share of the sum of squares that the effect would take, effect, scope, values to start from), best first. A
    linear score: residual and effect's Jacobian, both with what the nominal model would absorb projected out."""
    linear = fitter.linearise(base.state, base.hypothesis)
    nominal = np.column_stack([linear.nominal, fitter.effect_jacobian(base.state, base.hypothesis)])
    q, r = np.linalg.qr(nominal)
    q = q[:, np.abs(np.diag(r)) > 1e-9 * np.abs(np.diag(r)).max()]
    limit = 8.0 * robust_deviation(linear.residual)
    residual = np.clip(linear.residual, -max(limit, fitter.floor * 8), max(limit, fitter.floor * 8))
    residual = residual - q @ (q.T @ residual)
    rss = float(residual @ residual)
    calibration = np.zeros(len(residual), dtype=bool)
    calibration[linear.rows[0]] = True
    result = []
    for kind in kinds:
        if kind.id in EVENTS or kind in base.hypothesis.kinds:
            continue
        for values in _shape_starts(fitter, base, kind):
            full = _columns(fitter, base, kind, values)
            for only in (True, False):
                columns = np.where(calibration[:, None], 0.0, full) if only else full
                free = columns - q @ (q.T @ columns)
                size = np.linalg.norm(columns, axis=0)
                left = np.linalg.norm(free, axis=0)
                if not (left > 1e-3 * np.maximum(size, 1e-12)).any():
                    continue
                amplitude, *_ = np.linalg.lstsq(free, residual, rcond=1e-6)
                gain = 1.0 - float(np.sum((residual - free @ amplitude) ** 2)) / rss
                start = dict(values)
                for parameter, a in zip(kind.amplitudes, amplitude, strict=True):
                    reach = 10.0 * fitter.scale(parameter)
                    value = inside(parameter.name, float(np.clip(a, -reach, reach)))
                    start[parameter.name] = value if value != 0.0 else 0.2 * fitter.scale(parameter)
                result.append((gain, kind, only, start))
    return sorted(result, key=lambda entry: -entry[0])


def _columns(fitter: Fitter, base: Fit, kind: Kind, shapes: Mapping[str, float]) -> Array:
    """d prediction / d amplitude, rows as in Linear, the effect present in every recording."""
    hypothesis = base.hypothesis.plus(kind, False)
    absent = {p.name: 0.0 for p in kind.amplitudes}
    state = replace(base.state, values={**base.state.values, **shapes, **absent})
    here = fitter.residual(state, hypothesis)
    columns = []
    for parameter in kind.amplitudes:
        step = 0.3 * fitter.scale(parameter)
        moved = replace(state, values={**state.values, parameter.name: step})
        columns.append((here - fitter.residual(moved, hypothesis)) / step)
    return np.column_stack(columns)


def _shape_starts(fitter: Fitter, base: Fit, kind: Kind) -> list[dict[str, float]]:
    choices = []
    for parameter in kind.shapes:
        if parameter.name == "contact_c":
            c = np.concatenate([s.predict(base.state.model, {}, 0.0)[0].c_deg for s in fitter.segments])
            values = list(np.quantile(c, [0.1, 0.25, 0.5, 0.75, 0.9]))
        elif parameter.name == "shift_time":
            begin = min(float(s.arrival_s[0]) + s.offset_s for s in fitter.segments)
            end = max(float(s.arrival_s[-1]) + s.offset_s for s in fitter.segments)
            values = list(np.linspace(begin, end, 33)[1:-1])
        else:
            unit = fitter.model.rig.actuator.span if parameter.unit == "unit" else 1.0
            values = [v * unit for v in parameter.shape]
        choices.append([(parameter.name, float(v)) for v in values])
    return [dict(choice) for choice in itertools.product(*choices)]


def _event(fitter: Fitter, base: Fit, kind: Kind, without: float, share: float) -> Candidate:
    """Scatter along the marker's motion that its speed explains (jitter) or that is there whenever it moves
    (stick-slip): a Gaussian whose variance follows it, against one of constant variance."""
    along, drive = [], []
    for segment, r in zip(fitter.segments, base.residuals, strict=True):
        path, predicted = segment.predict(base.state.model, base.state.at(segment, base.hypothesis), 0.0)
        keep = segment.scored
        seen = np.gradient(predicted, segment.arrival_s, axis=0)[keep] if len(predicted) > 2 else np.zeros_like(r)
        speed = np.linalg.norm(seen, axis=1)
        unit = seen / np.maximum(speed, 1e-9)[:, None]
        along.append(np.sum(r * unit, axis=1))
        if kind.id == "acquisition.jitter":
            drive.append(speed)
        else:
            turning = np.abs(velocity(segment, path.p)[keep])
            drive.append(
                np.where(turning > 0.02 * max(float(turning.max()), 1e-12), speed / np.maximum(turning, 1e-9), 0)
            )
    a, d = np.concatenate(along), np.concatenate(drive)
    moving = d > 0
    if moving.sum() < 50:
        return Candidate(kind, True, without, None)
    limit = 8.0 * robust_deviation(a[moving])
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
    whiteness = 1.0 / memory([a[moving][:, None]])
    gain = max(0.0, best - homoscedastic) * min(whiteness, share * 4.0)
    if kind.id == "transmission.stick_slip":
        amplitude *= float(np.sqrt(12.0))
    values = {**base.state.values, kind.amplitudes[0].name: amplitude}
    fit = replace(base, hypothesis=base.hypothesis.plus(kind, True), state=replace(base.state, values=values))
    return Candidate(kind, True, without + gain, fit)
