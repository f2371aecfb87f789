"""Which change explains what is seen, and whether the evidence is enough to follow it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.tracking.fit import (
    BOTH,
    GRADUAL,
    ONLY_OFFSET,
    ONLY_SCALE,
    REMAINING,
    SHAPED,
    Envelopes,
    LawFit,
    Prior,
    Work,
    envelopes,
    fitted,
    from_envelopes,
    learn_beyond,
    simulated,
    trimmed,
    with_offset_at_tip,
)
from tautline.tracking.law import OFFSET, SCALE, SHAPE, SKEW, SPREAD, TIP, LawFamily, unchanged
from tautline.tracking.window import WindowKnots

Array = npt.NDArray[np.float64]

_EXPLAINED = 1.5  # tolerance: times the level known so far: a fit that explains its data
_FAR = 10.0  # loss: times the level known so far: it explains nothing, however little that is of what was left before
_OF_BEFORE = 0.3, 0.5  # loss: of what was left before: enough at once, enough where it also foretells
_REFINES = 0.9  # loss: of what the law in use leaves: worth a step where one is being learnt
_HOLDS = 1.3  # tolerance: times the level known so far, over the last strokes: nothing is to be learnt
_LATELY, _LATELY_OF = 3, 0.6  # loss: strokes, on which a law must leave so much less than others do
_NOW, STROKE_FRAMES = 2, 8  # loss: strokes on each of which a law must leave less, frames that one has at least
_AGAIN = 1.1, 1.3  # loss: at most of what the fit, at least of what the law in use leaves: the calibrated one holds
_TURNS = 2  # loss: reversals that must agree before anything but a narrower B is learnt
_RICHER_TURNS = 3  # prior: before B has another shape, an onset is gradual or f_remain bends; with what is foretold
_GAIN = 6.0  # prior: of cost, that a parameter must bring
_GOOD = 1.15  # tolerance: times the level known so far: nothing is left to explain
_GAIN_MORE = 12.0  # prior: and a richer law as a whole
_SHORT = 10  # loss: frames on an envelope from which a recording's posture is told
_ALONG = 2.0  # loss: of B, that they must cover
_NARROWER = 3.0  # loss: standard deviations by which B is narrower, that one reversal may tell
_LEAST_NARROWER = 0.01  # loss: of B, that is worth a step of the tables
_OFF_TRACK = 3.0  # prior: standard deviations off the marker's track (rms), or
_OFF_SHARE = 0.3  # prior: of the residual along it: then it is no motion of the play
_WANDERS = 4.0  # prior: standard deviations of the tip's motion while the motor rests


_DEPARTS = 3.0  # prior: standard deviations that each of three frames is off where a change shows
_WORTH = 0.5  # loss: times the level known so far, in quadrature: what a new law must take away
_TOLD_APART = 0.6  # loss: of what a law changes in B: so much must have been passed before another law replaces it
_EASY, _HARD, _GUESS = 120, 200, 320  # tolerance: us, at most, of looks at a case
DECISION = 350  # tolerance: and of taking a law into use
_HOLDS_FOR_NOW = "the model holds for now"
_ONE_WAY = "the tip was not yet seen to move both ways since the model stopped holding"


@dataclass(frozen=True)
class Inference:
    """`theta`: the law to use, None: as before. `proposal` is looked at again with the frames to come."""

    says: str
    evidence: WindowKnots
    theta: Array | None = None
    offset_sigma: float = 0.0
    scale_sigma: float = 0.0
    passed: tuple[float, float] = (0.0, 0.0)
    turns: int = 0
    level: float = 0.0
    settled: bool = False
    proposed: Array | None = None
    disturbed: bool = False  # by something that is no play
    early: bool = False  # too little was seen to judge
    narrower: bool = False  # and nothing else: from one reversal
    refines: bool = False  # the law in use, for as long as no other explains what was seen since that was learnt
    nominal: LawFamily | None = None  # with what was seen beyond the measured range by that law

    @property
    def proposal(self) -> Inference | None:
        return self if self.proposed is not None else None


@dataclass(frozen=True)
class _Case:
    """One stretch of evidence, looked at with the law in use."""

    nominal: LawFamily
    evidence: WindowKnots
    theta: Array
    origin: Array  # the law before anything was learnt of this evidence
    level: float
    envelopes: Envelopes
    passed: tuple[float, float] | None
    turns: int  # reversals after which the tip was seen to move
    z: Array  # residuals by the law in use
    z_calibrated: Array

    @classmethod
    def of(cls, nominal: LawFamily, evidence: WindowKnots, theta: Array, origin: Array, level: float) -> Work[_Case]:
        """Looks at this evidence by the law in use (theta) and by the calibrated one. level: rms of z that the law is
        known to leave."""
        yield _EASY + len(evidence.seen) // 10
        law = nominal.law(theta)
        envelope = envelopes(evidence, law)
        strokes, frames = np.unique(evidence.stroke[envelope.at], return_counts=True)
        turns = max(int(np.sum(frames >= 2)) - 1, 0) if len(strokes) else 0
        passed = envelope.both(evidence, law)
        z = calibrated = (yield from simulated(nominal, evidence, theta, False))[0]
        first = unchanged()
        if not np.array_equal(theta, first):
            calibrated = (yield from simulated(nominal, evidence, first, False))[0]
        return cls(nominal, evidence, theta, origin, level, envelope, passed, turns, z, calibrated)

    @property
    def before(self) -> float:
        """rms of z by the law in use."""
        return trimmed(self.z)

    def lately(self, z: Array) -> float:
        """rms over the last strokes."""
        return trimmed(z[self.evidence.stroke > self.evidence.stroke[-1] - _LATELY])

    def explained(self, fit: LawFit, of_before: float | None = None) -> bool:
        """Whether a fit leaves no more than _EXPLAINED times the known level, in all and lately; or, with `of_before`,
        at most that share of what the law in use and the calibrated one leave, and lately clearly less than either."""
        if max(fit.level, self.lately(fit.z)) <= _EXPLAINED * self.level:
            return True
        if of_before is None or fit.level > _FAR * self.level:
            return False
        if fit.level > of_before * max(self.before, trimmed(self.z_calibrated)):
            return False
        return self.lately(fit.z) <= _LATELY_OF * min(self.lately(self.z), self.lately(self.z_calibrated))

    def clear(self, fit: LawFit) -> bool:
        """Whether a fit leaves next to nothing of what the law in use leaves."""
        return fit.level <= _OF_BEFORE[0] * self.before

    def worth_adopting(self, z: Array, now: int, fit: LawFit) -> bool:
        """Whether a law with residuals z lowers the mean square enough, in all or lately; and, unless the best `fit`
        leaves next to nothing, on each of the last `now` strokes: a misfit that is over, as at a recording's begin,
        counts no more."""
        gain = max(trimmed(self.z) ** 2 - trimmed(z) ** 2, self.lately(self.z) ** 2 - self.lately(z) ** 2)
        enough = (_WORTH * self.level) ** 2
        return gain >= enough and (self.clear(fit) or self.less_on_each(z, now, enough))

    def better(self, fit: LawFit) -> bool:
        """Whether it leaves less than the law in use, in all and lately."""
        return max(fit.level / self.before, self.lately(fit.z) / self.lately(self.z)) < _REFINES

    def less_on_each(self, z: Array, count: int, least: float = 0.0) -> bool:
        """Whether a law with residuals z lowers the mean square by `least` on each of the last `count` strokes."""
        strokes, frames = np.unique(self.evidence.stroke, return_counts=True)
        parts = [self.evidence.stroke == k for k in strokes[frames >= STROKE_FRAMES][-count:]]
        return all(trimmed(self.z[part]) ** 2 - trimmed(z[part]) ** 2 >= least for part in parts)

    def prior(self) -> Prior:
        """The prior of a fit: about the calibrated law, with offset and shape as they were before this evidence."""
        mean = unchanged()
        mean[OFFSET], mean[SHAPE] = self.origin[OFFSET], self.origin[SHAPE]  # places not seen again stay as they are
        span = self.nominal.model.rig.actuator.span
        return Prior.of(mean, span, span * abs(self.nominal.tip_slope), self.places_known)

    @property
    def first_departure(self) -> int:
        """Index of the first of three frames in a row that the law in use does not predict: what comes before is of the
        time before the change, or of places where there is none. 0 where there is no such run."""
        far = np.abs(self.z) > _DEPARTS * self.level
        run = far[:-2] & far[1:-1] & far[2:]
        first = int(run.argmax()) if run.any() else 0
        return first if len(self.z) - first >= STROKE_FRAMES else 0

    @property
    def places_known(self) -> npt.NDArray[np.bool_]:
        """(PLACES,) Whether the shape of B is told there: the tip was on either envelope, and somewhere on both, which
        tells the offset from the width."""
        places = self.nominal.places
        if self.passed is None:
            return np.zeros(len(places), dtype=bool)
        y = self.places(self.theta, self.envelopes.at)
        passed: npt.NDArray[np.bool_] = (places > y.min()) & (places < y.max())
        return passed

    def places(self, theta: Array, at: npt.NDArray[np.intp] | slice = slice(None)) -> Array:
        """The centre coordinates of frames by a law."""
        return self.nominal.law(theta).place(self.evidence.c_deg[at])


def judge(
    nominal: LawFamily,
    stretches: Sequence[tuple[WindowKnots, Array]],
    theta: Array,
    adapting: bool,
    posture: float | None,
    moved: bool,
    level: float,
    proposal: Inference | None,
) -> Work[Inference]:
    """The first stretch of evidence that a law explains, else why none does. stretches: evidence, and the law before
    anything was learnt of it. posture: where a recording has just begun, the least offset that one direction alone may
    tell. moved: another posture is being learnt, and any simple law that leaves less refines it. level: rms of z that
    is known to be left."""
    verdict = None
    for evidence, origin in stretches:
        case = yield from _Case.of(nominal, evidence, theta, origin, level)
        if not adapting and np.array_equal(theta, unchanged()) and (first := case.first_departure):
            case = yield from _Case.of(nominal, evidence.after(first), theta, origin, level)
        verdict = yield from _judged(case, adapting, posture, moved, proposal)
        if verdict.theta is not None:
            refines = verdict.refines or (moved and evidence is not stretches[0][0])
            further = None  # a narrower one keeps what is known beyond the range
            if not verdict.narrower:
                further = yield from learn_beyond(nominal, verdict.evidence, verdict.theta, level)
            verdict = replace(verdict, nominal=further, refines=refines)
            break
    assert verdict is not None
    yield DECISION
    return verdict


def _judged(
    case: _Case, adapting: bool, posture: float | None, moved: bool, proposal: Inference | None
) -> Work[Inference]:
    """`judge` for one stretch: disturbance, nothing seen, still holding, calibrated again, enough evidence for the best
    fit, a narrower B alone, else a proposal to look at again."""
    yield _EASY + len(case.z) // 15
    disturbed = _disturbance(case)
    if disturbed:
        return Inference(disturbed, case.evidence, disturbed=True)
    if case.passed is None:
        if posture is not None:
            return (yield from _judged_by_offset(case, posture))
        return Inference(_ONE_WAY, case.evidence, early=True)
    if not adapting and case.lately(case.z) < _HOLDS * case.level:
        return Inference(_HOLDS_FOR_NOW, case.evidence, early=True)
    fit = yield from _simplest_sufficient(case)
    yield _HARD
    if case.turns and not np.array_equal(case.theta, unchanged()) and _tells_apart(case, lately=True):
        lately = case.lately(case.z_calibrated)
        good = max(_EXPLAINED, _AGAIN[0] * case.lately(fit.z))
        better = case.lately(case.z) > _AGAIN[1] * lately and case.less_on_each(case.z_calibrated, _LATELY)
        if lately <= good and better:
            return _calibrated_holds(case, lately)
    if not adapting and not case.worth_adopting(fit.z, _NOW, fit):
        return Inference(_HOLDS_FOR_NOW, case.evidence, early=True)
    foretold = proposal is not None and (yield from _predicts_later_strokes(case, proposal))
    yield _HARD + len(case.z) // 8
    least = max(_TURNS, _RICHER_TURNS * _richness(fit))
    enough = case.turns >= least and case.explained(fit)
    enough |= case.turns >= _RICHER_TURNS and foretold and case.explained(fit, _OF_BEFORE[1])
    enough |= adapting and case.explained(fit, _OF_BEFORE[1])
    if enough:
        return _adopting(case, fit)
    if moved and not _richness(fit) and case.better(fit):
        return replace(_adopting(case, fit), refines=True)
    if case.explained(fit, _OF_BEFORE[0]):
        learnt = _adopting(case, fit)
        share = _least_share(case, fit.theta, learnt.passed) / _least_share(case, case.theta, learnt.passed)
        sure = SHAPE.start not in fit.free or case.explained(fit)
        if (
            (SCALE in fit.free or SHAPE.start in fit.free)
            and sure
            and 1.0 - share > max(_NARROWER * learnt.scale_sigma, _LEAST_NARROWER)
        ):
            only = case.theta.copy()
            only[SCALE] *= share
            left = (yield from simulated(case.nominal, case.evidence, only, False))[0]
            if not case.clear(fit) and not case.worth_adopting(left, 1, fit):
                return Inference(_HOLDS_FOR_NOW, case.evidence, proposed=fit.theta)
            return Inference(
                f"transmission.backlash: {100 * share:.0f} % of the width as it was: no more is taken up",
                case.evidence,
                only,
                learnt.offset_sigma + abs(float(fit.theta[OFFSET] - case.theta[OFFSET])),
                learnt.scale_sigma,
                (0.0, 0.0),
                case.turns,
                fit.level,
                proposed=fit.theta,
                narrower=True,
            )
        if posture is not None and case.clear(fit):
            return _adopting(case, fit)
        return Inference(
            f"{_changes_in_words(case, fit.theta)}, if more reversals agree", case.evidence, proposed=fit.theta
        )
    says = _likely_obstacle(case)
    return Inference(says, case.evidence, proposed=fit.theta if case.explained(fit, _OF_BEFORE[1]) else None)


def _simplest_sufficient(case: _Case) -> Work[LawFit]:
    """The fit of the simplest law whose cost no richer one lowers by more than the gain that its parameters must bring.
    Tried in order: the shape in use refined; offset and scale; either alone; gradual onset, shape of B and bent
    f_remain, one and then two of them."""
    prior = case.prior()
    nominal, evidence = case.nominal, case.evidence
    if np.any(case.theta[SHAPE]):  # a shape that was not seen everywhere: most likely it only goes on
        start = nominal.rescaled(case.theta, case.origin[SCALE])
        refined = yield from fitted(nominal, evidence, start, _free_with_shape(case.theta), prior)
        if max(refined.level, case.lately(refined.z)) <= _GOOD * case.level:
            return refined
    yield _GUESS
    base = unchanged() if _tells_apart(case) else nominal.clipped(_width_alone(case.theta))
    start = base if np.any(base[SHAPE]) else from_envelopes(nominal, evidence, base, case.envelopes, True)
    before = yield from fitted(nominal, evidence, start, BOTH[0], prior)
    behind = yield from fitted(nominal, evidence, with_offset_at_tip(nominal, before.theta), BOTH[1], prior)
    both, side = (before, 0) if before.cost <= behind.cost + _GAIN else (behind, 1)
    if not case.explained(both):
        kept = nominal.clipped(case.theta)
        other = yield from fitted(nominal, evidence, kept, BOTH[side], prior)
        both = min(both, other, key=lambda fit: fit.cost)
    if max(both.level, case.lately(both.z)) <= _GOOD * case.level:
        if case.turns >= _RICHER_TURNS:  # an onset is short: it hardly shows in the rms
            gradual = yield from _fit_with_more(case, both, GRADUAL, prior)
            if _gain_of_richer(both, gradual) > _GAIN_MORE:
                return gradual
        simple = both.theta.copy()
        simple[SCALE] = base[SCALE]
        offset = yield from fitted(nominal, evidence, simple, ONLY_OFFSET[side], prior)
        if offset.cost < both.cost + _GAIN:
            return offset
        simple = base.copy()
        simple[SCALE] = both.theta[SCALE]
        scale = yield from fitted(nominal, evidence, simple, ONLY_SCALE, prior)
        return scale if scale.cost < both.cost + _GAIN else both
    if case.turns < _TURNS:
        return both
    if case.turns < _RICHER_TURNS:  # enough for a narrower place, which is not waited for
        shaped = yield from _fit_with_more(case, both, SHAPED, prior)
        return shaped if _gain_of_richer(both, shaped) > _GAIN_MORE else both
    fits = [both]
    for more in (GRADUAL, SHAPED, REMAINING):
        fits.append((yield from _fit_with_more(case, both, more, prior)))
    best = min(fits, key=lambda fit: fit.cost)
    if best.level > _GOOD * case.level and len(evidence.strokes) > 3:
        for more in (GRADUAL, SHAPED, REMAINING):
            if not set(more) <= set(best.free):
                richer = yield from _fit_with_more(case, best, more, prior)
                best = richer if _gain_of_richer(best, richer) > _GAIN_MORE else best
    return best if _gain_of_richer(both, best) > _GAIN_MORE else both


def _free_with_shape(theta: Array) -> tuple[int, ...]:
    """The free parameters when a law with a shape is refined: its shape and what else it has."""
    others = [i for i in (OFFSET, *GRADUAL, *REMAINING) if theta[i]]
    return tuple(sorted({*SHAPED, *others}))


def _least_share(case: _Case, theta: Array, passed: tuple[float, float]) -> float:
    """The least ratio of a law's B to the calibrated one between two places."""
    inside = (case.nominal.model.q >= passed[0]) & (case.nominal.model.q <= passed[1])
    shares = case.nominal.width_ratio(case.nominal.law(theta))[inside]
    return float(np.min(shares)) if len(shares) else float(theta[SCALE])


def _richness(fit: LawFit) -> int:
    """How many of these a law has beyond an offset and a scale: a gradual onset, a shape of B, a bent f_remain."""
    return sum(more[-1] in fit.free for more in (GRADUAL, SHAPED, REMAINING))


def _fit_with_more(case: _Case, fit: LawFit, more: tuple[int, ...], prior: Prior) -> Work[LawFit]:
    """A fit with `more` parameters free, from an existing one; with a shape the scale stays, as the shape holds it."""
    begin, free = fit.theta, {*fit.free, *more}
    if SPREAD in more:
        begin = case.nominal.gradual_start(begin)
    if SHAPE.start in free:  # it holds what a scale would
        begin, free = case.nominal.rescaled(begin, case.origin[SCALE]), free - {SCALE}
    return (yield from fitted(case.nominal, case.evidence, begin, tuple(sorted(free)), prior))


def _gain_of_richer(fit: LawFit, richer: LawFit) -> float:
    """By how much a richer fit lowers the cost, over its residual variance, beyond what its additional parameters bring
    by chance (2 each)."""
    return (fit.cost - richer.cost) / max(1.0, richer.level) ** 2 - 2.0 * (len(richer.free) - len(fit.free))


def _judged_by_offset(case: _Case, least: float) -> Work[Inference]:
    """The verdict on a recording's first stroke: the offset of another posture, if it is larger than `least` and
    explains a tip that follows the motor far enough; else too early."""
    at = case.envelopes.at
    nominal = case.nominal
    y = case.places(case.theta, at)
    if len(at) < _SHORT or np.ptp(y) < _ALONG * float(np.interp(y[0], nominal.model.q, nominal.model.width)):
        return Inference(_ONE_WAY, case.evidence, early=True)
    yield _GUESS
    start = from_envelopes(nominal, case.evidence, case.theta, case.envelopes, False)
    fit = yield from fitted(nominal, case.evidence, start, ONLY_OFFSET[0], case.prior())
    other = yield from fitted(nominal, case.evidence, with_offset_at_tip(nominal, start), ONLY_OFFSET[1], case.prior())
    fit = fit if fit.cost <= other.cost + _GAIN else other
    if case.explained(fit, _OF_BEFORE[0]) and abs(nominal.offset(fit.theta) - nominal.offset(case.theta)) > least:
        return _adopting(case, fit)
    return Inference(_ONE_WAY, case.evidence, early=True)


def _predicts_later_strokes(case: _Case, proposal: Inference) -> Work[bool]:
    """Whether the law that was proposed before predicts at least two strokes that came since."""
    evidence = case.evidence
    new = evidence.t_s > proposal.evidence.t_s[-1]
    if len(np.unique(evidence.stroke[new])) < 2 or proposal.proposed is None:
        return False
    z = (yield from simulated(case.nominal, evidence, proposal.proposed, False))[0]
    off, before = trimmed(z[new]), trimmed(case.z[new])
    return off <= max(_EXPLAINED * case.level, _OF_BEFORE[1] * before)


def _width_alone(theta: Array) -> Array:
    """The calibrated law with theta's scale and shape of B."""
    kept = unchanged()
    kept[SCALE], kept[SHAPE] = theta[SCALE], theta[SHAPE]
    return kept


def _tells_apart(case: _Case, lately: bool = False) -> bool:
    """Whether the frames on an envelope cover most of the places where the law in use has another B than the calibrated
    one: elsewhere either holds. lately: of the last strokes alone."""
    if not np.any(case.theta[SHAPE]):
        return True
    at = case.envelopes.at
    if lately:
        at = at[case.evidence.stroke[at] > case.evidence.stroke[-1] - _LATELY]
    if len(at) == 0:
        return False
    model, y = case.nominal.model, case.places(case.theta, at)
    low, high = case.nominal.places[0], case.nominal.places[-1]
    off = np.abs(case.nominal.law(case.theta).width - model.width) * ((model.q >= low) & (model.q <= high))
    inside = (model.q >= y.min()) & (model.q <= y.max())
    return bool(off[inside].sum() >= _TOLD_APART * off.sum())


def _calibrated_holds(case: _Case, level: float) -> Inference:
    """The verdict that the calibrated law holds again."""
    return Inference(
        "the calibrated law holds again",
        case.evidence,
        unchanged(),
        passed=case.passed or (0.0, 0.0),
        turns=case.turns,
        level=level,
        settled=True,
    )


def _adopting(case: _Case, fit: LawFit) -> Inference:
    """The verdict to use a fit's law from now on."""
    assert case.evidence is fit.evidence
    y = case.places(fit.theta, case.envelopes.at)
    passed = case.envelopes.both(case.evidence, case.nominal.law(fit.theta)) or (float(y.min()), float(y.max()))
    return Inference(
        _changes_in_words(case, fit.theta),
        case.evidence,
        fit.theta,
        max(fit.sigma(OFFSET), fit.sigma(TIP.start) / abs(case.nominal.tip_slope)),
        _scale_sigma(case, fit, passed),
        passed,
        case.turns,
        fit.level,
        case.explained(fit, _OF_BEFORE[1]),
        proposed=fit.theta,
    )


def _scale_sigma(case: _Case, fit: LawFit, passed: tuple[float, float]) -> float:
    """Standard deviation of the mean ratio of B to the calibrated one over the places that were passed."""
    return fit.spread_of(case.nominal.ratio_slopes(fit.theta, np.linspace(*passed, 9)))


def _changes_in_words(case: _Case, theta: Array) -> str:
    """The ids of the effects by which theta differs from the calibration, with their size."""
    unit = case.nominal.model.rig.actuator.unit
    changes = []
    if np.any(theta[SHAPE]):
        changes.append("transmission.backlash: B has another shape")
    elif theta[SCALE] != 1.0:
        changes.append(f"transmission.backlash: {100 * theta[SCALE]:.0f} % of the calibrated width")
    if theta[SPREAD] or theta[SKEW]:
        changes.append("transmission.smooth_onset: the tip starts gradually")
    offset = case.nominal.offset(theta)
    if offset != 0.0:
        changes.append(f"transmission.offset: {offset:+.4g} {unit}")
    if np.any(theta[TIP][1:]):
        changes.append("configuration.remaining: the static law bends otherwise")
    return "; ".join(changes) or "the calibrated law"


def _disturbance(case: _Case) -> str:
    """What moves the tip and is no play, in words: it leaves the marker's track, or moves while the motor rests; else
    ""."""
    evidence = case.evidence
    off = trimmed(evidence.off)
    if off > max(_OFF_TRACK * case.level, _OFF_SHARE * case.before):
        return "registration.shift or breathing: the marker leaves the track that the joint can give it"
    q = evidence.q[evidence.seen]
    count = case.nominal.model.rig.actuator.encoder_resolution
    rests = np.abs(np.diff(q)) <= 2.0 * count
    if rests.sum() >= 5:
        wander = np.diff(evidence.c_deg)[rests] / np.hypot(evidence.sigma[1:], evidence.sigma[:-1])[rests]
        if trimmed(np.sort(np.abs(wander))[:-1]) > _WANDERS * case.level:  # a change that comes at once is one of them
            return "the tip moves while the motor rests: breathing or a hand on the shaft"
    return ""


def _likely_obstacle(case: _Case) -> str:
    """What may stand in the way where no law explains the tip, in words: it does not follow the motor, or not in one
    part of its range."""
    evidence = case.evidence
    q, y = evidence.q[evidence.seen], case.places(case.theta)
    late = slice(-min(len(y), 30), None)
    moved = float(np.ptp(q[late]))
    width = float(np.interp(y[-1], case.nominal.model.q, case.nominal.model.width))
    if moved > 2.0 * width and float(np.ptp(y[late])) < 0.1 * moved:
        return "configuration.contact or a hand: the tip does not follow the motor"
    far = np.abs(case.z) > _EXPLAINED * 3.0 * case.level
    if far.any() and not far.all():
        inner, outer = y[~far], y[far]
        if outer.min() > np.quantile(inner, 0.8) or outer.max() < np.quantile(inner, 0.2):
            return "configuration.contact: the tip is held back in one part of its way"
    return "unknown: no change of offset or backlash explains where the tip is"
