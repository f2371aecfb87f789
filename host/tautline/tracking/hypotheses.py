"""Which change of the law explains what is seen, and whether the evidence is enough to follow it.

Laws differ by offset, scale of B, shape of B, a gradual onset and a bent f_remain (`law.py`). Level: rms of the
residuals over sigma, without outliers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from tautline.tracking.case import (
    EASY,
    EXPLAINED,
    LATELY,
    OF_BEFORE,
    Case,
    changes_in_words,
    disturbance_in_words,
    likely_obstacle,
)
from tautline.tracking.fit import (
    BOTH,
    GRADUAL,
    ONLY_OFFSET,
    ONLY_SCALE,
    REMAINING,
    SHAPED,
    LawFit,
    Prior,
    Work,
    fit_law,
    learn_beyond,
    simulated_residuals,
    start_from_envelopes,
    trimmed_rms,
    with_offset_at_tip,
)
from tautline.tracking.law import OFFSET, SCALE, SHAPE, SPREAD, TIP, LawFamily, calibrated_theta
from tautline.tracking.window import WindowKnots

Array = npt.NDArray[np.float64]

_HOLDS = 1.3  # tolerance: times the level known so far, over the last strokes: nothing is to be learnt
_NOW = 2  # loss: strokes on each of which a law must leave less
_AGAIN = 1.1, 1.3  # loss: at most of what the fit, at least of what the law in use leaves: the calibrated one holds
_TURNS = 2  # loss: reversals that must agree before anything but a narrower B is learnt
_RICHER_TURNS = 3  # prior: before B has another shape, an onset is gradual or f_remain bends; with what is foretold
_ONE_MORE_STROKES = 3  # prior: strokes that tell one of these; more may tell two at once
_GAIN = 6.0  # prior: of cost, that a parameter must bring
_GOOD = 1.15  # tolerance: times the level known so far: nothing is left to explain
_GAIN_MORE = 12.0  # prior: and a richer law as a whole
_SHORT = 10  # loss: frames on an envelope from which a recording's posture is told
_ALONG = 2.0  # loss: of B, that they must cover
_NARROWER = 3.0  # loss: standard deviations by which B is narrower, that one reversal may tell
_LEAST_NARROWER = 0.01  # loss: of B, that is worth a step of the tables
_TOLD_APART = 0.6  # loss: of what a law changes in B: so much must have been passed before another law replaces it
_HARD, _GUESS = 200, 320  # tolerance: us, at most, of looks at a case
DECISION = 350  # tolerance: and of taking a law into use
_HELD = "the law in use held over the last strokes, and is trusted again once it has for more"
_NONE_BETTER = "no other law leaves clearly less than the one in use: what scatters more is the sensor, or no play"
_ONE_WAY = "the tip was not yet seen to move both ways since the model stopped holding"


@dataclass(frozen=True)
class Inference:
    """The verdict on a stretch of evidence. `theta`: the law to use from now on; None: the one in use stays."""

    says: str  # why, for the user
    evidence: WindowKnots
    theta: Array | None = None
    offset_sigma: float = 0.0  # unit of q
    scale_sigma: float = 0.0  # share of B
    passed: tuple[float, float] = (0.0, 0.0)  # centre coordinates between which the tip went both ways, unit of q
    turns: int = 0  # reversals after which the tip was seen to move
    level: float = 0.0  # rms of the residuals over sigma that this law leaves
    settled: bool = False  # this law explains what is seen: it may be trusted, if enough reversals agree
    proposed: Array | None = None  # the theta to be tried on the strokes to come
    disturbed: bool = False  # something that is no play moves the tip
    early: bool = False  # too little was seen to judge
    narrower: bool = False  # theta has a narrower B and no other change, which one reversal may tell
    refines: bool = False  # theta refines the law that is being learnt: its evidence goes on from where it began
    nominal: LawFamily | None = None  # with what this law tells beyond the measured range; None: as before

    @property
    def proposal(self) -> Inference | None:
        """This verdict if it names a law to be tried on the strokes to come, else None."""
        return self if self.proposed is not None else None


def judge(
    nominal: LawFamily,
    stretches: Sequence[tuple[WindowKnots, Array]],
    theta: Array,
    adapting: bool,
    least_offset: float | None,
    moved: bool,
    level: float,
    proposal: Inference | None,
) -> Work[Inference]:
    """Judges the stretches of evidence in order: returns the verdict on the first one that a law explains, else that on
    the last one, which says why none does. stretches: one or more of evidence with the law before anything was learnt
    of it. theta: the law in use; adapting: whether it is still being learnt; else, if it is the calibrated one,
    evidence before its first departure does not count. least_offset: where a recording has just begun, the least
    offset, unit of q, that one stroke alone may tell, else None. moved: another posture is being learnt, so that any
    simple law that leaves less refines it. level: that the law in use is known to leave. proposal: an earlier verdict,
    whose law is to foretell the strokes since. Yields each piece's cost beforehand, us."""
    verdict = None
    for evidence, origin in stretches:
        case = yield from Case.from_evidence(nominal, evidence, theta, origin, level)
        if not adapting and np.array_equal(theta, calibrated_theta()) and (first := case.first_departure):
            case = yield from Case.from_evidence(nominal, evidence.after(first), theta, origin, level)
        verdict = yield from _verdict_on_stretch(case, adapting, least_offset, moved, proposal)
        if verdict.theta is not None:
            refines = verdict.refines or (moved and evidence is not stretches[0][0])
            learnt = None  # a law with a narrower B alone keeps what is known beyond the range
            if not verdict.narrower:
                learnt = yield from learn_beyond(nominal, verdict.evidence, verdict.theta, level)
            verdict = replace(verdict, nominal=learnt, refines=refines)
            break
    assert verdict is not None
    yield DECISION
    return verdict


def _verdict_on_stretch(
    case: Case, adapting: bool, least_offset: float | None, moved: bool, proposal: Inference | None
) -> Work[Inference]:
    """Judges one stretch (see `judge`). The first of these cases that holds decides: the tip is disturbed; it was not
    seen both ways; the law in use still holds; the calibrated one does again; no other leaves clearly less; there is
    enough evidence for the best fit; another posture's law is refined by it; there is not enough yet. Yields each
    piece's cost beforehand, us."""
    yield EASY + len(case.z) // 15
    disturbed = disturbance_in_words(case)
    if disturbed:
        return Inference(disturbed, case.evidence, disturbed=True)
    if case.passed is None:
        if least_offset is not None:
            return (yield from _verdict_by_offset(case, least_offset))
        return Inference(_ONE_WAY, case.evidence, early=True)
    if not adapting and case.level_lately(case.z) < _HOLDS * case.level:
        return Inference(_HELD, case.evidence, early=True)
    fit = yield from _simplest_sufficient_fit(case)
    yield _HARD
    if _calibrated_leaves_less(case, fit):
        return _verdict_calibrated_again(case)
    if not adapting and not case.worth_adopting(fit.z, _NOW, fit):
        return Inference(_NONE_BETTER, case.evidence, early=True)
    foretold = proposal is not None and (yield from _predicts_later_strokes(case, proposal))
    yield _HARD + len(case.z) // 8
    if _enough_evidence(case, fit, adapting, foretold):
        return _verdict_to_adopt(case, fit)
    if moved and not _richness(fit) and case.improves(fit):
        return replace(_verdict_to_adopt(case, fit), refines=True)
    return (yield from _verdict_before_enough(case, fit, least_offset is not None))


def _calibrated_leaves_less(case: Case, fit: LawFit) -> bool:
    """Whether the calibrated law, where another is in use, holds again in the last LATELY strokes: its level there is
    at most EXPLAINED times the known one, or _AGAIN[0] times that of the best fit; the law in use has more than
    _AGAIN[1] times that level, and no less on any of these strokes. The tip must have turned, and been where both laws
    differ."""
    if not case.turns or np.array_equal(case.theta, calibrated_theta()) or not _tells_apart(case, lately=True):
        return False
    calibrated = case.level_lately(case.z_calibrated)
    enough = max(EXPLAINED * case.level, _AGAIN[0] * case.level_lately(fit.z))
    less = case.level_lately(case.z) > _AGAIN[1] * calibrated and case.lowers_each_stroke(case.z_calibrated, LATELY)
    return calibrated <= enough and less


def _enough_evidence(case: Case, fit: LawFit, adapting: bool, foretold: bool) -> bool:
    """Whether a fit may be used: it explains the evidence, and at least _TURNS reversals agree, _RICHER_TURNS for each
    thing that it has beyond offset and scale. It is also enough that the fit leaves OF_BEFORE[1] of what other laws
    leave (`is_explained_by`), while a law is being learnt (`adapting`), or after _RICHER_TURNS reversals if the law
    that was proposed before foretold the strokes since (`foretold`)."""
    least = max(_TURNS, _RICHER_TURNS * _richness(fit))
    if case.turns >= least and case.is_explained_by(fit):
        return True
    return (adapting or (case.turns >= _RICHER_TURNS and foretold)) and case.is_explained_by(fit, OF_BEFORE[1])


def _verdict_before_enough(case: Case, fit: LawFit, begun_lately: bool) -> Work[Inference]:
    """Judges the best fit where there is not enough evidence for it yet. If it explains the evidence well, a narrower B
    alone is taken at once; where a recording has just begun, so is a fit that leaves little. Else the fit is proposed
    to be looked at again, if it explains anything."""
    if case.is_explained_by(fit, OF_BEFORE[0]):
        narrower = yield from _verdict_by_width(case, fit)
        if narrower is not None:
            return narrower
        if begun_lately and case.leaves_little(fit):
            return _verdict_to_adopt(case, fit)
        return Inference(
            f"{changes_in_words(case, fit.theta)}, if more reversals agree", case.evidence, proposed=fit.theta
        )
    says = likely_obstacle(case)
    return Inference(says, case.evidence, proposed=fit.theta if case.is_explained_by(fit, OF_BEFORE[1]) else None)


def _verdict_by_width(case: Case, fit: LawFit) -> Work[Inference | None]:
    """Judges a fit that too few reversals agree with by its width alone. If B is clearly narrower than by the law in
    use, that and nothing else is taken from the fit at once, provided that the fit leaves little, or the narrower B
    alone leaves less; else the fit is only proposed. None where the fit does not tell a clearly narrower B."""
    shaped = SHAPE.start in fit.free
    tells_width = case.is_explained_by(fit) if shaped else SCALE in fit.free
    learnt = _verdict_to_adopt(case, fit)
    # The least share of the calibrated B by the fit and by the law in use, and one over the other.
    now, before = (_least_share(case, theta, learnt.passed) for theta in (fit.theta, case.theta))
    share = now / before if before > 0.0 else 1.0
    sigma = _least_share_sigma(case, fit, learnt.passed)
    if not (tells_width and 1.0 - share > max(_NARROWER * sigma, _LEAST_NARROWER)):
        return None
    narrowed = case.theta.copy()  # the law in use but for its scale
    narrowed[SCALE] *= share
    z = (yield from simulated_residuals(case.nominal, case.evidence, narrowed, False))[0]
    if not case.leaves_little(fit) and not case.worth_adopting(z, 1, fit):
        return Inference(_NONE_BETTER, case.evidence, proposed=fit.theta)
    return Inference(
        f"transmission.backlash: {100 * share:.0f} % of the width as it was: no more is taken up",
        case.evidence,
        narrowed,
        offset_sigma=learnt.offset_sigma + abs(float(fit.theta[OFFSET] - case.theta[OFFSET])),
        scale_sigma=sigma,
        turns=case.turns,
        level=fit.level,
        proposed=fit.theta,
        narrower=True,
    )


def _simplest_sufficient_fit(case: Case) -> Work[LawFit]:
    """Fits laws from simple to rich; returns the first fit that leaves nothing to explain (`_leaves_nothing`), else the
    best one that is worth its parameters. If the law in use has a shape of B, that shape is refined first. Then come
    offset and scale together: if they leave nothing, `_simpler_fit` tries less, else `_richer_fit` tries more. They
    start from the calibrated law, but with the scale and shape of the law in use where the frames do not tell the two
    laws apart (`_tells_apart`), so that what was learnt of B elsewhere is kept."""
    prior = case.prior()
    nominal, evidence = case.nominal, case.evidence
    if np.any(case.theta[SHAPE]):  # a shape that was not seen everywhere: most likely it only goes on
        start = nominal.rescaled(case.theta, case.origin[SCALE])
        refined = yield from fit_law(nominal, evidence, start, _free_with_shape(case.theta), prior)
        if _leaves_nothing(case, refined):
            return refined
    yield _GUESS
    base = calibrated_theta() if _tells_apart(case) else nominal.clipped(_with_width_alone(case.theta))
    both, side = yield from _fit_offset_and_scale(case, base, prior)
    if _leaves_nothing(case, both):
        return (yield from _simpler_fit(case, both, side, base, prior))
    return (yield from _richer_fit(case, both, prior))


def _leaves_nothing(case: Case, fit: LawFit) -> bool:
    """Whether a fit leaves nothing to explain: its level is at most _GOOD times the known one, over all strokes and
    over the last LATELY."""
    return max(fit.level, case.level_lately(fit.z)) <= _GOOD * case.level


def _fit_offset_and_scale(case: Case, base: Array, prior: Prior) -> Work[tuple[LawFit, int]]:
    """Fits offset and scale, from the law `base`; returns the fit and its index in BOTH: 0, the offset is before the
    play, or 1, it is behind it, if that lowers the cost by more than _GAIN. Where that fit does not explain the
    evidence, one from the law in use is tried, too."""
    nominal, evidence = case.nominal, case.evidence
    start = base if np.any(base[SHAPE]) else start_from_envelopes(nominal, evidence, base, case.envelopes, True)
    before = yield from fit_law(nominal, evidence, start, BOTH[0], prior)
    behind = yield from fit_law(nominal, evidence, with_offset_at_tip(nominal, before.theta), BOTH[1], prior)
    both, side = (before, 0) if before.cost <= behind.cost + _GAIN else (behind, 1)
    if not case.is_explained_by(both):
        in_use = nominal.clipped(case.theta)
        other = yield from fit_law(nominal, evidence, in_use, BOTH[side], prior)
        both = min(both, other, key=lambda fit: fit.cost)
    return both, side


def _simpler_fit(case: Case, both: LawFit, side: int, base: Array, prior: Prior) -> Work[LawFit]:
    """Returns the fit to use where offset and scale (`both`, of BOTH[side], from the law `base`) leave nothing to
    explain: the offset alone or the scale alone, if that costs less than _GAIN more, else `both`. But with enough
    reversals a gradual onset is tried first: it is short and hardly shows in the rms."""
    nominal, evidence = case.nominal, case.evidence
    if case.turns >= _RICHER_TURNS:
        gradual = yield from _fit_with_more(case, both, GRADUAL, prior)
        if _gain_of_richer(both, gradual) > _GAIN_MORE:
            return gradual
    simple = both.theta.copy()
    simple[SCALE] = base[SCALE]
    offset = yield from fit_law(nominal, evidence, simple, ONLY_OFFSET[side], prior)
    if offset.cost < both.cost + _GAIN:
        return offset
    simple = base.copy()
    simple[SCALE] = both.theta[SCALE]
    scale = yield from fit_law(nominal, evidence, simple, ONLY_SCALE, prior)
    return scale if scale.cost < both.cost + _GAIN else both


def _richer_fit(case: Case, both: LawFit, prior: Prior) -> Work[LawFit]:
    """Returns the fit to use where offset and scale (`both`) do not explain the evidence: with one of a gradual onset,
    a shape of B and a bent f_remain, or with more of them where many strokes are not explained by one. Each must bring
    its gain (_GAIN_MORE), else `both` is returned. With _TURNS reversals only a shape is tried, with fewer nothing."""
    if case.turns < _TURNS:
        return both
    if case.turns < _RICHER_TURNS:  # enough for a narrower place, which is not waited for
        shaped = yield from _fit_with_more(case, both, SHAPED, prior)
        return shaped if _gain_of_richer(both, shaped) > _GAIN_MORE else both
    fits = [both]
    for more in (GRADUAL, SHAPED, REMAINING):
        fits.append((yield from _fit_with_more(case, both, more, prior)))
    best = min(fits, key=lambda fit: fit.cost)
    if best.level > _GOOD * case.level and len(case.evidence.strokes) > _ONE_MORE_STROKES:
        for more in (GRADUAL, SHAPED, REMAINING):
            if not set(more) <= set(best.free):
                richer = yield from _fit_with_more(case, best, more, prior)
                best = richer if _gain_of_richer(best, richer) > _GAIN_MORE else best
    return best if _gain_of_richer(both, best) > _GAIN_MORE else both


def _free_with_shape(theta: Array) -> tuple[int, ...]:
    """Indices of the parameters that are free when a law with a shape of B is refined: the shape, and of the others,
    but the scale, those that are not 0."""
    others = [i for i in (OFFSET, *GRADUAL, *REMAINING) if theta[i]]
    return tuple(sorted({*SHAPED, *others}))


def _least_share(case: Case, theta: Array, passed: tuple[float, float]) -> float:
    """The least ratio of the B of theta's law to the calibrated one between two centre coordinates `passed`, unit of q;
    theta's scale where no node of the table lies between."""
    inside = (case.nominal.model.q >= passed[0]) & (case.nominal.model.q <= passed[1])
    shares = case.nominal.width_ratio(case.nominal.law(theta))[inside]
    return float(np.min(shares)) if len(shares) else float(theta[SCALE])


def _richness(fit: LawFit) -> int:
    """How many of these are free in a fit beyond offset and scale: a gradual onset, a shape of B, a bent f_remain."""
    return sum(more[-1] in fit.free for more in (GRADUAL, SHAPED, REMAINING))


def _fit_with_more(case: Case, fit: LawFit, more: tuple[int, ...], prior: Prior) -> Work[LawFit]:
    """Fits with the parameters of the indices `more` free, too, from an existing fit on. With a shape of B the scale is
    not free, but the one from before the evidence, as the shape holds what it would."""
    start, free = fit.theta, {*fit.free, *more}
    if SPREAD in more:
        start = case.nominal.gradual_start(start)
    if SHAPE.start in free:  # it holds what a scale would
        start, free = case.nominal.rescaled(start, case.origin[SCALE]), free - {SCALE}
    return (yield from fit_law(case.nominal, case.evidence, start, tuple(sorted(free)), prior))


def _gain_of_richer(fit: LawFit, richer: LawFit) -> float:
    """By how much a richer fit lowers the cost, in units of its residual variance (1 at least), beyond what its
    additional parameters bring by chance (2 each)."""
    return (fit.cost - richer.cost) / max(1.0, richer.level) ** 2 - 2.0 * (len(richer.free) - len(fit.free))


def _verdict_by_offset(case: Case, least: float) -> Work[Inference]:
    """Judges a recording's first stroke. Returns the verdict to use the offset of another posture, if it differs by
    more than `least`, unit of q, explains the evidence, and the tip followed the motor far enough (_SHORT, _ALONG);
    else that it is too early."""
    at = case.envelopes.at
    nominal = case.nominal
    y = case.places(case.theta, at)
    if len(at) < _SHORT or np.ptp(y) < _ALONG * float(np.interp(y[0], nominal.model.q, nominal.model.width)):
        return Inference(_ONE_WAY, case.evidence, early=True)
    yield _GUESS
    start = start_from_envelopes(nominal, case.evidence, case.theta, case.envelopes, False)
    fit = yield from fit_law(nominal, case.evidence, start, ONLY_OFFSET[0], case.prior())
    other = yield from fit_law(nominal, case.evidence, with_offset_at_tip(nominal, start), ONLY_OFFSET[1], case.prior())
    fit = fit if fit.cost <= other.cost + _GAIN else other
    if case.is_explained_by(fit, OF_BEFORE[0]) and abs(nominal.offset(fit.theta) - nominal.offset(case.theta)) > least:
        return _verdict_to_adopt(case, fit)
    return Inference(_ONE_WAY, case.evidence, early=True)


def _predicts_later_strokes(case: Case, proposal: Inference) -> Work[bool]:
    """Whether the law that was proposed before predicts the frames since, of two strokes at least: with a level of at
    most EXPLAINED times the known one, or OF_BEFORE[1] times that of the law in use."""
    evidence = case.evidence
    new = evidence.t_s > proposal.evidence.t_s[-1]
    if len(np.unique(evidence.stroke[new])) < 2 or proposal.proposed is None:
        return False
    z = (yield from simulated_residuals(case.nominal, evidence, proposal.proposed, False))[0]
    proposed, in_use = trimmed_rms(z[new]), trimmed_rms(case.z[new])
    return proposed <= max(EXPLAINED * case.level, OF_BEFORE[1] * in_use)


def _with_width_alone(theta: Array) -> Array:
    """Returns the calibrated law with theta's scale and shape of B."""
    kept = calibrated_theta()
    kept[SCALE], kept[SHAPE] = theta[SCALE], theta[SHAPE]
    return kept


def _tells_apart(case: Case, lately: bool = False) -> bool:
    """Whether the frames on an envelope were in most of the places where the law in use has another B than the
    calibrated one: in other places either may hold. lately: only frames of the last LATELY strokes count. True for a
    law without a shape, which differs everywhere."""
    if not np.any(case.theta[SHAPE]):
        return True
    at = case.envelopes.at
    if lately:
        at = at[case.evidence.stroke[at] > case.evidence.stroke[-1] - LATELY]
    if len(at) == 0:
        return False
    model, y = case.nominal.model, case.places(case.theta, at)
    low, high = case.nominal.places[0], case.nominal.places[-1]
    # (nodes,) by how much both laws' B differ, in the measured range.
    differs = np.abs(case.nominal.law(case.theta).width - model.width) * ((model.q >= low) & (model.q <= high))
    inside = (model.q >= y.min()) & (model.q <= y.max())
    return bool(differs[inside].sum() >= _TOLD_APART * differs.sum())


def _verdict_calibrated_again(case: Case) -> Inference:
    """Returns the verdict that the calibrated law holds again."""
    return Inference(
        "the calibrated law holds again",
        case.evidence,
        calibrated_theta(),
        passed=case.passed or (0.0, 0.0),
        turns=case.turns,
        level=case.level_lately(case.z_calibrated),
        settled=True,
    )


def _verdict_to_adopt(case: Case, fit: LawFit) -> Inference:
    """Returns the verdict to use a fit's law from now on."""
    assert case.evidence is fit.evidence
    y = case.places(fit.theta, case.envelopes.at)
    both_ways = case.envelopes.range_both_ways(case.evidence, case.nominal.law(fit.theta))
    passed = both_ways or (float(y.min()), float(y.max()))
    return Inference(
        changes_in_words(case, fit.theta),
        case.evidence,
        fit.theta,
        # One of both offsets was free, before the play or behind it.
        offset_sigma=max(fit.sigma(OFFSET), fit.sigma(TIP.start) / abs(case.nominal.tip_slope)),
        scale_sigma=_least_share_sigma(case, fit, case.nominal.model.measured),
        passed=passed,
        turns=case.turns,
        level=fit.level,
        settled=case.is_explained_by(fit, OF_BEFORE[1]),
        proposed=fit.theta,
    )


def _least_share_sigma(case: Case, fit: LawFit, between: tuple[float, float]) -> float:
    """Standard deviation of the least ratio of B to the calibrated one (`_least_share`) by a fit, between two centre
    coordinates, unit of q: that of the ratio at the place where it is least."""
    model = case.nominal.model
    inside = (model.q >= between[0]) & (model.q <= between[1])
    places = model.q[inside] if inside.any() else np.array(between)
    shares = np.interp(places, model.q, case.nominal.width_ratio(case.nominal.law(fit.theta)))
    return fit.spread_of(case.nominal.ratio_slopes(fit.theta, places[[int(np.argmin(shares))]]))
