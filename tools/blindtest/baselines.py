"""What others would do with the same cases: each baseline's answer, from the same files and the same simulation.

majority   the campaign's commonest verdict, whatever the case
joint      the parameters of all effects fitted at once; the one that is shifted most, in its own scale, is named
bic        one effect at a time on top of the recalibrated model, the Bayesian information criterion as in the textbook
forest     a random forest on features of the residual, trained on cases of tuning seeds
process    a Gaussian process of the residual over what the motor did (shrinkage only: it names nothing)
narx       the same by polynomial regression on the motor's history, terms chosen by SysIdentPy (shrinkage only)

joint and bic call it none where the gap is within _NO_GAP noises, and unknown where what they found leaves more than
_LEFT of what a recalibration leaves: without such a rule they could do neither.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import numpy.typing as npt

from tautline import effects
from tautline.diagnosis import candidates, gap, where
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit, Hypothesis, Scope
from tautline.diagnosis.screen import Screened, screen
from tautline.diagnosis.segment import Segment, load_reference, prepare
from tautline.effects import Kind
from tautline.model import Model
from tautline.recording import Recording
from tools.blindtest.scores import FAILED, NONE, STAGES, UNEXPLAINED, Answer

Array = npt.NDArray[np.float64]

METHODS = ("majority", "joint", "bic", "forest", "process", "narx")
SHRINKING = frozenset({"process", "narx"})  # these name nothing
NEEDS = {"narx": "sysidentpy", "forest": "sklearn", "process": "sklearn"}  # modules beyond tautline's own

_NO_GAP = 1.25
_LEFT = 0.3
_REFITTED = 4  # effects that bic fits in full, the best of a linear step
_JOINT_STEPS = 6
_TREES = 300
_POINTS = 250  # of a Gaussian process
_HISTORY_S = (0.0, 0.1, 0.3, 1.0)  # of the motor that narx sees
_TERMS = 12


class Comparison:
    """What every baseline of a case starts from. `further`: what a shrinkage is realised on."""

    def __init__(self, model: Model, recordings: Sequence[Recording], further: Recording | None = None) -> None:
        """The calibration first; `model` is what it gave."""
        segments = prepare(model, recordings[0], [*recordings[1:], *([further] if further else [])])
        self.further = segments.pop() if further else None
        self.fitter = Fitter(model, segments, load_reference(recordings[0]))
        self.tests = segments[1:]
        self.frozen = [self.residual(s) for s in segments]
        self.fitter.floor = self.floor = gap.noise_floor(segments, self.frozen)

    def residual(self, segment: Segment, fit: Fit | None = None) -> Array:
        """(scored, k) of the calibrated model, or of a fit."""
        model, at = (fit.state.model, fit.state.at(segment, fit.hypothesis)) if fit else (self.fitter.model, {})
        _, predicted = segment.predict(model, at, self.fitter.load_reference)
        return np.asarray((segment.observed - predicted)[segment.scored])

    @cached_property
    def base(self) -> Fit:
        return self.fitter.nominal()

    @cached_property
    def screened(self) -> dict[tuple[str, Scope], Screened]:
        """Every effect in its scopes (id, scope) after a linear step from the recalibrated model, best first."""
        kinds = candidates.applicable(self.fitter)
        best: dict[tuple[str, Scope], Screened] = {}
        for entry in screen(self.fitter, self.base, kinds, candidates.outlier_limits(self.fitter, self.base)):
            best.setdefault((entry.kind.id, entry.scope), entry)
        return best

    def answer(self, fit: Fit, leading: Kind | None) -> Answer:
        """With the rules for none and unknown; no effect at all is none."""
        before, after, recalibrated = (gap.rms(r[1:]) for r in (self.frozen, fit.residuals, self.base.residuals))
        left = (after**2 - self.floor**2) / max(recalibrated**2 - self.floor**2, 1e-12)
        named: tuple[str, ...] = ()
        if leading is None or before < _NO_GAP * self.floor:
            verdict = NONE
        elif left > _LEFT:
            verdict = UNEXPLAINED
        else:
            verdict, named = leading.id, (leading.id,)
        realised = None
        if self.further is not None:
            frozen = gap.rms([self.residual(self.further)])
            then = gap.rms([self.residual(self.further, fit)]) if named else frozen
            realised = {"before": frozen, "after": then, "floor": self.floor}
        return Answer(
            named,
            verdict,
            0.0,
            frozenset(named),
            None,
            leading.stage if leading else None,
            1.0 - after / before if named else 0.0,
            None,
            realised,
        )


class _Near(Fitter):
    """Effects' parameters are expected within their own scale: with all of them free at once, without that, those that
    hardly matter go farthest."""

    def spread(self, hypothesis: Hypothesis) -> Array:
        spread = super().spread(hypothesis)
        scales = [self.scale(p) for p in (slot.parameter for slot in hypothesis.slots)]
        spread[len(spread) - len(scales) :] = scales
        return spread


def joint(evidence: Comparison) -> Answer:
    plain = evidence.fitter
    fitter = _Near(plain.model, plain.segments, plain.load_reference)
    fitter.floor = plain.floor
    hypothesis = fitter.no_effect
    values: dict[str, float] = {}
    seen: set[str] = set()
    for start in evidence.screened.values():
        if start.kind.id not in seen:
            seen.add(start.kind.id)
            hypothesis = hypothesis.plus(start.kind, start.scope)
            amplitudes = {key for key in start.values if key.split("@")[0] in {p.name for p in start.kind.amplitudes}}
            values |= {**start.values, **dict.fromkeys(amplitudes, 0.0)}
    fit = fitter.descend(hypothesis, replace(evidence.base.state, values=values), _JOINT_STEPS)

    def shift(kind: Kind) -> float:
        own = {slot.key: slot.parameter for slot in hypothesis.slots if slot.parameter in kind.amplitudes}
        own |= {p.name: p for p in kind.amplitudes if p.searched}
        return max((abs(fit.state.values.get(key, 0.0)) / fitter.scale(p) for key, p in own.items()), default=0.0)

    return evidence.answer(fit, max(hypothesis.kinds, key=shift))


def bic(evidence: Comparison) -> Answer:
    fitter = evidence.fitter
    count = sum(r.size for r in evidence.base.residuals)

    def criterion(fit: Fit) -> float:
        squares = sum(float(np.sum(r**2)) for r in fit.residuals)
        return count * float(np.log(squares / count)) + fit.freedom * float(np.log(count))

    leading = list({name: None for name, _ in evidence.screened})[:_REFITTED]
    fits = [
        fitter.fit(fitter.no_effect.plus(entry.kind, scope), entry.values, evidence.base.state, entry.others)
        for (name, scope), entry in evidence.screened.items()
        if name in leading
    ]
    best = min([evidence.base, *(fit for fit in fits if fit.finite)], key=criterion)
    return evidence.answer(best, best.hypothesis.kinds[0] if best.hypothesis.kinds else None)


def features(evidence: Comparison) -> Array:
    """(n,) of a case, the same n for every case: sizes of the gap, where it is, what each effect would take of it."""
    floor = evidence.floor
    numbers = [np.log(gap.rms(r) / floor) for r in (evidence.frozen[1:], evidence.base.residuals[1:])]
    numbers += [np.log(gap.rms([r]) / floor) for r in (*evidence.frozen, *evidence.base.residuals)]
    numbers.append(np.log(gap.residuals_per_independent(evidence.base.residuals[1:])))
    everything = np.concatenate([r.ravel() for r in evidence.base.residuals[1:]])
    numbers.append(float(np.log(np.mean(everything**4) / np.mean(everything**2) ** 2)))
    for residuals in (evidence.frozen[1:], evidence.base.residuals[1:]):
        shares = {c.axis: c.share for c in where.conditions(evidence.tests, residuals)}
        numbers += [shares.get(axis, -1.0) for axis in where.AXES]
    gains = {key: entry.gain for key, entry in evidence.screened.items()}
    numbers += [gains.get((kind.id, scope), -1.0) for kind in effects.LIBRARY for scope in Scope]
    return np.array(numbers, dtype=float)


@dataclass(frozen=True)
class Forest:
    """Trained on features (n, k) and verdicts (n,)."""

    features: Array
    verdicts: tuple[str, ...]

    @cached_property
    def _trees(self):  # type: ignore[no-untyped-def]
        from sklearn.ensemble import RandomForestClassifier

        made = RandomForestClassifier(_TREES, class_weight="balanced", min_samples_leaf=2, random_state=0)
        return made.fit(self.features, list(self.verdicts))

    def answer(self, case: Array, core_s: float) -> Answer:
        probabilities = dict(zip(self._trees.classes_, self._trees.predict_proba(case[None])[0].tolist(), strict=True))
        verdict = max(probabilities, key=lambda name: probabilities[name])
        named = () if verdict in (NONE, UNEXPLAINED) else (verdict,)
        stage = STAGES.get(
            max((name for name in probabilities if name in STAGES), key=lambda name: probabilities[name])
        )
        return Answer(named, verdict, core_s, frozenset(named), probabilities, stage)


def majority(truths: Sequence[str]) -> Answer:
    """`truths`: of the campaign's own cases; no other baseline is told them."""
    commonest = Counter(truths).most_common(1)[0][0]
    named = () if commonest in (NONE, UNEXPLAINED) else (commonest,)
    return Answer(named, commonest, 0.0, frozenset(named), None, STAGES.get(commonest))


def _history(segment: Segment, span: float, since_s: float) -> Array:
    """(scored, 8): what the motor did, in shares of its range; other axes and load in what they reach; last, time."""
    motor, t = segment.motor, segment.arrival_s
    q = np.interp(t, motor.t_s, motor.q) / span
    rate = np.gradient(q, t)
    way, last, travel = 0.0, q[0], np.zeros_like(q)
    direction = np.zeros_like(q)
    for i in range(len(q)):
        step = np.sign(rate[i]) if abs(rate[i]) > 1e-3 else 0.0
        if step not in (0.0, way):
            way, last = step, q[i]
        direction[i], travel[i] = way, min(abs(q[i] - last), 0.3)
    others = [
        np.zeros_like(q) if values is None else np.interp(t, motor.t_s, values) / size
        for values, size in ((motor.translation_mm, 3.0), (motor.rotation_deg, 30.0), (motor.load_mNm, 40.0))
    ]
    columns = [q, direction, 4.0 * travel, 4.0 * np.abs(rate), *others, (t + segment.offset_s - since_s) / 200.0]
    return np.column_stack(columns)[segment.scored]


def process(evidence: Comparison) -> Answer:
    """A Gaussian process, ARD squared exponential, on _POINTS frames of the tests; claimed on the blocks left out."""
    from sklearn.exceptions import ConvergenceWarning
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

    def learn(x: Array, y: Array) -> Callable[[Array], Array]:
        chosen = np.random.default_rng(3).permutation(len(x))[:_POINTS]
        size = float(np.std(y))
        kernel = ConstantKernel(1.0) * RBF(np.full(x.shape[1], 0.5), (0.02, 50.0)) + WhiteKernel(0.1, (1e-5, 10.0))
        made = GaussianProcessRegressor(kernel, random_state=0)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            made.fit(x[chosen], y[chosen] / size)
        return lambda at: np.asarray(made.predict(at)).reshape(len(at), -1) * size

    return _learned(evidence, learn)


def narx(evidence: Comparison) -> Answer:
    """Polynomials of second order in the motor's history, _TERMS chosen by forward regression."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    def ahead(x: Array) -> Array:  # a model of lag 1 sees the row before: that one must be the frame's own
        return np.concatenate([x[1:], x[-1:]])

    def learn(x: Array, y: Array) -> Callable[[Array], Array]:
        models = []
        for column in y.T:
            made = FROLS(
                order_selection=False,
                n_terms=_TERMS,
                xlag=[[1]] * x.shape[1],
                ylag=1,
                model_type="NFIR",
                basis_function=Polynomial(degree=2),
                estimator=LeastSquares(),
            )
            with warnings.catch_warnings():  # terms that are nearly each other's multiples
                warnings.simplefilter("ignore", UserWarning)
                models.append(made.fit(X=ahead(x), y=column[:, None]))

        def said(at: Array) -> Array:
            blank = np.zeros((len(at), 1))
            return np.column_stack([made.predict(X=ahead(at), y=blank)[:, 0] for made in models])

        return said

    return _learned(evidence, learn, lags=_HISTORY_S)


def _learned(
    evidence: Comparison, learn: Callable[[Array, Array], Callable[[Array], Array]], lags: Sequence[float] = ()
) -> Answer:
    assert evidence.further is not None
    span = evidence.fitter.model.rig.actuator.span
    since = evidence.tests[0].arrival_s[0] + evidence.tests[0].offset_s

    def seen(segment: Segment) -> Array:
        rows = _history(segment, span, since)
        if lags:  # a polynomial in time runs away from the first recording on that it has not seen
            rows = rows[:, :-1]
        times = segment.arrival_s[segment.scored]
        late = [np.interp(times - lag, segment.motor.t_s, segment.motor.q)[:, None] / span for lag in lags[1:]]
        return np.concatenate([rows, *late], axis=1)

    x = np.concatenate([seen(s) for s in evidence.tests])
    y = np.concatenate(evidence.frozen[1:])
    odd = np.concatenate([gap.blocks(s) % 2 == 1 for s in evidence.tests])
    if not 0 < odd.sum() < len(odd):
        odd = np.arange(len(odd)) % 2 == 1
    claimed = 1.0 - gap.rms([y[odd] - learn(x[~odd], y[~odd])(x[odd])]) / gap.rms([y[odd]])
    frozen = evidence.residual(evidence.further)
    after = frozen - learn(x, y)(seen(evidence.further))
    realised = {"before": gap.rms([frozen]), "after": gap.rms([after]), "floor": evidence.floor}
    return Answer((), FAILED, 0.0, claimed=claimed, realised=realised, names=False)


# What they cost is for the caller to take.
ON_CASES: Mapping[str, Callable[[Comparison], Answer]] = {"joint": joint, "bic": bic, "process": process, "narx": narx}
