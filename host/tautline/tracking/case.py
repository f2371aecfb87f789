"""One stretch of evidence, simulated by the law in use and by the calibrated one: what either leaves, where the tip
was, and what may keep any law from explaining it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.tracking.disturbance import REST_COUNTS
from tautline.tracking.fit import Envelopes, LawFit, Prior, Work, envelopes, simulated_residuals, trimmed_rms
from tautline.tracking.law import OFFSET, SCALE, SHAPE, SKEW, SPREAD, TIP, LawFamily, calibrated_theta
from tautline.tracking.window import WindowKnots

Array = npt.NDArray[np.float64]

EXPLAINED = 1.5  # tolerance: times the level known so far: a fit that explains its data
_FAR = 10.0  # loss: times the level known so far: it explains nothing, however little that is of what was left before
OF_BEFORE = 0.3, 0.5  # loss: of what was left before: enough at once, enough where it also foretells
_REFINES = 0.9  # loss: of what the law in use leaves: worth a step where one is being learnt
LATELY, _LATELY_OF = 3, 0.6  # loss: strokes, on which a law must leave so much less than others do
_OFF_TRACK = 3.0  # prior: standard deviations off the marker's track (rms), from which it is no motion of the play
_OFF_SHARE = 0.3  # prior: and that as a share of the residual along the track
_WANDERS = 4.0  # prior: standard deviations of the tip's motion while the motor rests
_DEPARTS = 3.0  # prior: standard deviations that each of three frames is off where a change shows
_REST_FRAMES = 5  # tolerance: frames at rest that tell whether the tip moves there
_LAST = 30  # prior: frames in which a tip that does not follow the motor shows it
_STUCK, _FURTHER = 0.1, 2.0  # prior: it moves by less than that share of the motor's way, and this by more B than that
_FAR_OFF = 3.0  # prior: times the residual of what explains its data: a frame that is far off
_PART = 0.2, 0.8  # prior: quantiles of where frames are not far off: beyond them is another part of the way
_WORTH = 0.5  # loss: times the level known so far, in quadrature: what a new law must take away
STROKE_FRAMES = 8  # loss: frames that a stroke has at least
EASY = 120  # tolerance: us, at most, of an easy look at a case


@dataclass(frozen=True)
class Case:
    """One stretch of evidence as the law in use and the calibrated one explain it. z: residuals over their sigmas.
    Level: rms of z without outliers (`trimmed_rms`)."""

    nominal: LawFamily
    evidence: WindowKnots
    theta: Array  # the law in use
    origin: Array  # the law before anything was learnt of this evidence
    level: float  # rms of z that the law is known to leave
    envelopes: Envelopes
    passed: tuple[float, float] | None  # centre coordinates between which the tip went both ways, unit of q
    turns: int  # reversals after which the tip was seen to move
    z: Array  # (seen,) residuals over sigma by the law in use
    z_calibrated: Array  # the same by the calibrated one

    @classmethod
    def from_evidence(
        cls, nominal: LawFamily, evidence: WindowKnots, theta: Array, origin: Array, level: float
    ) -> Work[Case]:
        """Simulates this evidence by the law in use (theta) and by the calibrated one; looks for the frames on an
        envelope of the play, the range that was passed both ways, and the turns. A turn counts if two frames of the
        stroke after it are on an envelope; the first such stroke has none before it. origin, level: as the fields of
        these names. Yields each piece's cost beforehand, us."""
        yield EASY + len(evidence.seen) // 10
        law = nominal.law(theta)
        envelope = envelopes(evidence, law)
        strokes, frames = np.unique(evidence.stroke[envelope.at], return_counts=True)
        turns = max(int(np.sum(frames >= 2)) - 1, 0) if len(strokes) else 0
        passed = envelope.range_both_ways(evidence, law)
        z = z_calibrated = (yield from simulated_residuals(nominal, evidence, theta, False))[0]
        if not np.array_equal(theta, calibrated_theta()):
            z_calibrated = (yield from simulated_residuals(nominal, evidence, calibrated_theta(), False))[0]
        return cls(nominal, evidence, theta, origin, level, envelope, passed, turns, z, z_calibrated)

    @property
    def level_in_use(self) -> float:
        """rms of the residuals over sigma that the law in use leaves, without outliers."""
        return trimmed_rms(self.z)

    def level_lately(self, z: Array) -> float:
        """rms of residuals over sigma z (seen,) in the last LATELY strokes alone, without outliers."""
        return trimmed_rms(z[self.evidence.stroke > self.evidence.stroke[-1] - LATELY])

    def is_explained_by(self, fit: LawFit, of_before: float | None = None) -> bool:
        """Whether a fit's level is at most EXPLAINED times the known one, over all strokes and over the last LATELY.
        With `of_before`, a share, it is also enough that the fit's level is at most _FAR times the known one and at
        most that share of the larger of those of the law in use and of the calibrated one, and over the last strokes at
        most _LATELY_OF of the smaller of theirs."""
        if max(fit.level, self.level_lately(fit.z)) <= EXPLAINED * self.level:
            return True
        if of_before is None or fit.level > _FAR * self.level:
            return False
        if fit.level > of_before * max(self.level_in_use, trimmed_rms(self.z_calibrated)):
            return False
        lesser = min(self.level_lately(self.z), self.level_lately(self.z_calibrated))
        return self.level_lately(fit.z) <= _LATELY_OF * lesser

    def leaves_little(self, fit: LawFit) -> bool:
        """Whether a fit's level is at most the share OF_BEFORE[0] of that of the law in use."""
        return fit.level <= OF_BEFORE[0] * self.level_in_use

    def worth_adopting(self, z: Array, now: int, fit: LawFit) -> bool:
        """Whether a law with residuals over sigma z (seen,) lowers the mean square by at least (_WORTH level)^2, over
        all strokes or over the last LATELY; and, unless the best fit, `fit`, leaves little, also on each of the last
        `now` strokes: a misfit that is over, as at a recording's begin, counts no more."""
        gain = max(
            trimmed_rms(self.z) ** 2 - trimmed_rms(z) ** 2, self.level_lately(self.z) ** 2 - self.level_lately(z) ** 2
        )
        enough = (_WORTH * self.level) ** 2
        return gain >= enough and (self.leaves_little(fit) or self.lowers_each_stroke(z, now, enough))

    def improves(self, fit: LawFit) -> bool:
        """Whether a fit's level is below _REFINES times that of the law in use, over all strokes and over the last
        LATELY."""
        return max(fit.level / self.level_in_use, self.level_lately(fit.z) / self.level_lately(self.z)) < _REFINES

    def lowers_each_stroke(self, z: Array, count: int, least: float = 0.0) -> bool:
        """Whether a law with residuals over sigma z (seen,) leaves a mean square that is lower than that of the law in
        use by `least` or more on each of the last `count` strokes that have STROKE_FRAMES frames or more."""
        strokes, frames = np.unique(self.evidence.stroke, return_counts=True)
        parts = [self.evidence.stroke == k for k in strokes[frames >= STROKE_FRAMES][-count:]]
        return all(trimmed_rms(self.z[part]) ** 2 - trimmed_rms(z[part]) ** 2 >= least for part in parts)

    def prior(self) -> Prior:
        """The prior of a fit. Its mean is the calibrated law with the offset and the shape of B from before this
        evidence, as places that are not seen again stay as they are."""
        mean = calibrated_theta()
        mean[OFFSET], mean[SHAPE] = self.origin[OFFSET], self.origin[SHAPE]
        span = self.nominal.model.rig.actuator.span
        return Prior.about(mean, span, span * abs(self.nominal.tip_slope), self.places_known)

    @property
    def first_departure(self) -> int:
        """Index, among the frames seen, of the first of three in a row whose residual by the law in use is more than
        _DEPARTS times the known level: frames before it say nothing of a change. 0, so that all frames count, where no
        three are, or fewer than STROKE_FRAMES frames follow from there."""
        far = np.abs(self.z) > _DEPARTS * self.level
        run = far[:-2] & far[1:-1] & far[2:]
        first = int(run.argmax()) if run.any() else 0
        return first if len(self.z) - first >= STROKE_FRAMES else 0

    @property
    def places_known(self) -> npt.NDArray[np.bool_]:
        """(PLACES,) Whether the evidence tells the shape of B at each place: whether it lies within the range in which
        the tip was seen on an envelope. All False if the tip passed no place both ways, as offset and width are not
        told apart then."""
        places = self.nominal.places
        if self.passed is None:
            return np.zeros(len(places), dtype=bool)
        y = self.places(self.theta, self.envelopes.at)
        passed: npt.NDArray[np.bool_] = (places > y.min()) & (places < y.max())
        return passed

    def places(self, theta: Array, at: npt.NDArray[np.intp] | slice = slice(None)) -> Array:
        """(n,) Centre coordinates, unit of q, at which the law of theta puts the tip that was seen. at: indices among
        the frames seen, by default all of them."""
        return self.nominal.law(theta).place(self.evidence.c_deg[at])


def changes_in_words(case: Case, theta: Array) -> str:
    """The effects by which theta differs from the calibrated law, for messages: their ids with their sizes, joined by
    "; ", or "the calibrated law" if there are none."""
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


def disturbance_in_words(case: Case) -> str:
    """What moves the tip and is no play, in words: the marker leaves its track in the image, or the tip moves while the
    motor rests. "" where neither is seen."""
    evidence = case.evidence
    off = trimmed_rms(evidence.off)
    if off > max(_OFF_TRACK * case.level, _OFF_SHARE * case.level_in_use):
        return "registration.shift or breathing: the marker leaves the track that the joint can give it"
    q = evidence.q[evidence.seen]
    count = case.nominal.model.rig.actuator.encoder_resolution
    rests = np.abs(np.diff(q)) <= REST_COUNTS * count
    if rests.sum() >= _REST_FRAMES:
        wander = np.diff(evidence.c_deg)[rests] / np.hypot(evidence.sigma[1:], evidence.sigma[:-1])[rests]
        if trimmed_rms(np.sort(np.abs(wander))[:-1]) > _WANDERS * case.level:  # the largest may be a sudden change
            return "the tip moves while the motor rests: breathing or a hand on the shaft"
    return ""


def likely_obstacle(case: Case) -> str:
    """What may be the cause, in words, where no law explains the tip: it hardly followed the motor in the last _LAST
    frames, or it is far off in one end of its range alone. Else the words say that the cause is unknown."""
    evidence = case.evidence
    q, y = evidence.q[evidence.seen], case.places(case.theta)
    late = slice(-_LAST, None)
    moved = float(np.ptp(q[late]))
    width = float(np.interp(y[-1], case.nominal.model.q, case.nominal.model.width))
    if moved > _FURTHER * width and float(np.ptp(y[late])) < _STUCK * moved:
        return "configuration.contact or a hand: the tip does not follow the motor"
    far = np.abs(case.z) > EXPLAINED * _FAR_OFF * case.level
    if far.any() and not far.all():
        inner, outer = y[~far], y[far]
        if outer.min() > np.quantile(inner, _PART[1]) or outer.max() < np.quantile(inner, _PART[0]):
            return "configuration.contact: the tip is held back in one part of its way"
    return "unknown: no change of offset or backlash explains where the tip is"
