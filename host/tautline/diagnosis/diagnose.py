"""The diagnosis: from a calibrated model and recordings to verdict, effects, their shares and a corrected model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from tautline.diagnosis import confounded, decide, gap, motion, moved, repeated, resembles, start, tip, tracker, where
from tautline.diagnosis.candidates import Candidate, applicable
from tautline.diagnosis.document import Found, to_document
from tautline.diagnosis.findings import Finding, Gap
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.gather import Gathered, gather
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.moved import Moved
from tautline.diagnosis.segment import Segment, load_reference, prepare, sensed
from tautline.diagnosis.tracker import TrackerError
from tautline.effects.library.registration import with_registration
from tautline.model import LOAD, Model, monotone
from tautline.recording import Recording
from tautline.simulators.nominal import SimulatedNominal
from tautline.value import Value

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

_NO_NOISE = 0.8  # tolerance: of a floor: a calibration that leaves less shows that it is none


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Value):
    document: dict[str, Any]  # diagnosis.json
    nominal: Model
    corrected: Model
    next_motion: motion.NextMotion | None
    segments: list[Segment]
    before: list[Array]  # residuals of each test, (scored, k)
    after: list[Array]
    conditions: list[where.Condition]
    evidence: CaseEvidence

    @property
    def verdict(self) -> Literal["effect", "none", "unknown"]:
        return cast(Literal["effect", "none", "unknown"], self.document["verdict"])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What is named, in the order it was added."""
        return tuple(map(Finding.of, self.document["effects"]))

    @property
    def gap(self) -> Gap:
        return Gap.of(self.document)

    @property
    def probabilities(self) -> dict[str, float]:
        """The probability of each effect to be the leading one, the likeliest first, and of "none" and "unknown"; they
        sum to 1."""
        leading = {each["id"]: float(each["probability"]) for each in self.document["candidates"]}
        return {**leading, "none": self.document["probability_none"], "unknown": self.document["probability_unknown"]}


def diagnose(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress = lambda fraction, text: None,
    left_out: Collection[str] = (),
    simulated: SimulatedNominal | None = None,
) -> Diagnosis:
    """`model` is what `calibration` gave; effects that it carries are looked for anew, and stay in `corrected` where
    nothing is named. `left_out`: effects that the library shall not know. `simulated`: where model, calibration and
    tests are a simulator's. Raises TautError where nothing can be scored."""
    with threadpool_limits(1, "blas"):  # its systems are small: threads that wait for each other cost 10 times more
        found = _diagnosis(model.alone, calibration, tests, progress, left_out, simulated)
    if found.findings or not model.effects:
        return found
    return replace(found, corrected=replace(model, extra=found.corrected.extra))


def _diagnosis(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress,
    left_out: Collection[str],
    simulated: SimulatedNominal | None,
) -> Diagnosis:
    """`diagnose`, in the order: segments and tracker errors, fits, verdict, what was there from the start, shares,
    document."""
    progress(0.0, "preparing")
    segments = prepare(model, calibration, tests, simulated.drives if simulated else ())
    tracked = tracker.of_videos(model, segments, load_reference(calibration), [calibration, *tests])
    fitter, frozen = _fitter_and_residuals(
        model, tracked.segments if tracked else segments, load_reference(calibration), simulated
    )
    base = _recalibrate_and_set_noise(fitter, frozen, tracked)
    segments = fitter.segments
    kinds = [*applicable(fitter, left_out), *(simulated.kinds if simulated else ())]
    hidden = confounded.hidden(kinds, segments)
    kinds = [kind for kind in kinds if kind.id not in hidden]

    gathered = gather(fitter, frozen, base, kinds, lambda done, text: progress(0.1 + 0.8 * done, text))
    verdict = decide.that_help(gathered.evidence, decide.decide(gathered.evidence))
    if verdict.name != "effect" and simulated is None and start.concerns(model):
        # Nothing that came later is the cause: what was there while calibrating, which the calibration has swallowed.
        from_start = start.of_segments(
            *(model, segments, fitter.load_reference, tracked),
            lambda done, text: progress(0.9 + 0.02 * done, text),
            left_out,
        )
        if from_start.named:
            fitter, gathered, verdict = from_start.fitter, from_start.gathered, from_start.verdict
    progress(0.92, "attributing")
    verdict, parts = _with_moved_parts(fitter, frozen, base, gathered, verdict)
    found = Found(
        *(model, segments, fitter, tracked, frozen, gap.rms(base.residuals[1:]), kinds, gathered, verdict),
        _chosen_candidate(fitter, frozen, gathered, verdict),
        parts,
    )
    document = to_document(found, hidden)
    if repeated.HELD not in left_out:
        repeated.add_repeats(document, model, segments, fitter.load_reference)
    document["resembles"] = (
        resembles.closest_effects(gathered, found.gap["before"]) if document["verdict"] == "unknown" else []
    )
    progress(1.0, "done")
    corrected = _corrected(found.chosen.fit, max(found.tests, key=lambda test: test.end_s)) if found.named else model
    corrected = replace(corrected, extra={**model.extra, LOAD: fitter.load_reference})
    # With the old tables, and with the new: a simulator's are for no board.
    document["tip"] = tip.simulated_error(model, corrected) if found.named and simulated is None else None
    if simulated is not None:
        document["simulator"] = simulated.to_json(document["effects"])
    return Diagnosis(
        *(document, model, corrected, found.next_motion),
        [replace(segment, drive=None) for segment in segments],  # what was simulated is in motor and residuals
        *(list(found.before), list(found.after), found.conditions, gathered.evidence),
    )


def _fitter_and_residuals(
    model: Model, segments: list[Segment], load_mNm: float, simulated: SimulatedNominal | None
) -> tuple[Fitter, list[Array]]:
    """A fitter of these recordings, and the residuals (scored, k) that the calibrated model leaves of each as it is. A
    simulator's recording is given noise like the robot's sensor."""
    fitter = Fitter(model, segments, load_mNm)
    frozen = fitter.residuals(fitter.start(), fitter.nothing)
    if simulated is None:
        return fitter, frozen
    segments = [sensed(segments[0], gap.noise_floor(segments[1:], frozen[1:])), *segments[1:]]
    fitter = Fitter(model, segments, load_mNm)
    return fitter, fitter.residuals(fitter.start(), fitter.nothing)


def _recalibrate_and_set_noise(fitter: Fitter, frozen: Sequence[Array], tracked: TrackerError | None) -> Fit:
    """The recalibrated nominal model's fit. Sets the fitter's noise floor: from the rests and the calibration's own
    residuals; where videos were tracked, at least the noise of a moving marker."""
    moving, segments = tracked.noise if tracked else 0.0, fitter.segments
    fitter.floor = max(gap.noise_floor(segments, frozen), moving)
    if tracked is not None:
        fitter.doubt, fitter.unsteady = tracked.doubt, tracked.unsteady
    base = fitter.nominal()
    # A rest in which the tip goes on moving is no noise: the calibration has no more of it than its own fit leaves. A
    # simulator's has none at all, and the robot's sensor still has its own.
    floor = gap.noise_floor(segments, base.residuals, fitter.across(base))
    left = max(gap.rms(frozen[:1]), gap.rounding_noise(segments), gap.second_difference_noise(base.residuals[1:]))
    fitter.floor = max(left if left < _NO_NOISE * floor else floor, moving)
    return base


def _with_moved_parts(
    fitter: Fitter, frozen: Sequence[Array], base: Fit, gathered: Gathered, verdict: decide.Decision
) -> tuple[decide.Decision, list[Moved]]:
    """The verdict and the parts of the nominal model that moved: where a recalibration closes an unexplained gap, these
    are named; else the verdict as it is and no parts."""
    before, recalibrated = gap.rms(frozen[1:]), gap.rms(base.residuals[1:])
    still_open = decide.is_open(gathered.evidence, recalibrated**2)
    swallowed = moved.is_all(before, recalibrated, fitter.floor, still_open, learnt().center.unexplained_by_law)
    parts = moved.from_the_start(fitter, frozen, base) if swallowed and verdict.name == "unknown" else []
    return (decide.with_moved(verdict, [(part.id, part.share) for part in parts]) if parts else verdict), parts


def _chosen_candidate(fitter: Fitter, frozen: list[Array], gathered: Gathered, verdict: decide.Decision) -> Candidate:
    """The hypothesis of what is named. Where it has events only and its recalibrated nominal does not surely leave
    less, its effects on the calibrated model as it is."""
    chosen = gathered.candidates[verdict.chosen]
    if verdict.name != "effect" or not verdict.named or chosen.follows:
        return chosen
    if gap.probability_of_shrinking(frozen[1:], chosen.left[1:], fitter.segments[1:]) >= gap.SURELY:
        return chosen
    return chosen.of(fitter.start(), frozen)


def _corrected(fit: Fit, last: Segment) -> Model:
    """The fitted model with its effects, its state as at the end of the last test: a shift has happened, a drift has
    gone so far."""
    model = fit.state.model
    model = with_registration(replace(model, c_deg=monotone(model.c_deg)), fit.state.static)
    values = fit.state.at(last, fit.hypothesis)
    end = last.end_s
    added = []
    for kind in fit.hypothesis.kinds:
        own = kind.of_values(values)
        if kind.holds is not None:
            model = kind.holds(model, own.parameters, end)
        added.append(own)
    return replace(model, effects=tuple(added))
