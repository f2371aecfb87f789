"""The diagnosis: from a calibrated model and recordings to verdict, effects, their shares and a corrected model."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, cast

import numpy as np
import numpy.typing as npt
from threadpoolctl import threadpool_limits

from tautline import effects
from tautline.diagnosis import confounded, decide, gap, motion, moved, repeated, resembles, start, tip, tracker, where
from tautline.diagnosis.candidates import Candidate, applicable
from tautline.diagnosis.document import Found, to_document
from tautline.diagnosis.findings import Finding, Gap
from tautline.diagnosis.fit import STATIC, Fitter
from tautline.diagnosis.fitted import STATIC_NAMES, Fit
from tautline.diagnosis.gather import Gathered, gather
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.diagnosis.moved import Moved
from tautline.diagnosis.segment import Segment, load_reference, prepare, with_noise
from tautline.diagnosis.tracker import TrackerError
from tautline.effects import Kind
from tautline.effects.library.registration import with_registration
from tautline.model import Model, monotone
from tautline.recording import Recording
from tautline.simulators.nominal import SimulatedNominal
from tautline.value import Value

Array = npt.NDArray[np.float64]
Progress = Callable[[float, str], None]

_NO_NOISE = 0.8  # tolerance: share of a noise floor: a calibration that leaves less refutes it
_PREPARING, _FITTING, _STARTING = 0.1, 0.8, 0.02  # format: shares of the progress: recordings, all fits, `start`


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Value):
    """The result of a diagnosis. Residuals are (scored, k) of each test: scored observations, k = 2 px or 1 deg."""

    document: dict[str, Any]  # the content of diagnosis.json
    nominal: Model  # as calibrated, without the effects that it carries
    corrected: Model  # with what is named
    next_motion: motion.NextMotion | None  # expected to tell most; None where no effect has a path
    segments: list[Segment]  # the recordings as they were fitted, the calibration first
    before: list[Array]  # residuals by the calibrated model
    after: list[Array]  # held-out residuals with what is named
    conditions: list[where.Condition]  # under which the gap is large, the most telling first
    evidence: CaseEvidence  # what the verdict was worked out from

    @property
    def verdict(self) -> Literal["effect", "none", "unknown"]:
        """ "effect" where the gap has a known cause, "none" where there is no gap, "unknown" where its cause is
        unknown."""
        return cast(Literal["effect", "none", "unknown"], self.document["verdict"])

    @property
    def findings(self) -> tuple[Finding, ...]:
        """The named effects, in the order in which diagnosis.json lists them."""
        return tuple(map(Finding.of, self.document["effects"]))

    @property
    def gap(self) -> Gap:
        """The sizes of the gap before and after the correction, rms in the observations' unit, px or deg."""
        return Gap.of(self.document)

    @property
    def probabilities(self) -> dict[str, float]:
        """{effect's id: probability to be the main cause}, the likeliest first, followed by "none" and "unknown"; they
        sum to 1."""
        leading = {entry["id"]: float(entry["probability"]) for entry in self.document["candidates"]}
        return {**leading, "none": self.document["probability_none"], "unknown": self.document["probability_unknown"]}


def diagnose(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress = lambda fraction, text: None,
    left_out: Collection[str] = (),
    simulated: SimulatedNominal | None = None,
) -> Diagnosis:
    """Finds which effect explains the gap between a calibrated model and later recordings. model: calibrated on
    `calibration`; the search begins without the effects that it carries, and `corrected` is the model with these
    effects where nothing is named. progress: called with the share that is done, 0 to 1, and what is done now.
    left_out: ids of effects not to try. simulated: given where a user's simulator stands in the motor's place. Raises
    TautError where no observation can be scored."""
    with threadpool_limits(1, "blas"):  # the systems are small: threads that wait for each other cost 10 times more
        return _diagnosis(model, calibration, tests, progress, left_out, simulated)


def _diagnosis(
    calibrated: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    progress: Progress,
    left_out: Collection[str],
    simulated: SimulatedNominal | None,
) -> Diagnosis:
    """As `diagnose`, step by step: prepares the recordings and takes the tracker's error off, fits hypotheses, decides
    (looking also for effects that the calibration has swallowed), writes the document, and makes the corrected
    model."""
    progress(0.0, "preparing")
    ready = _prepare(calibrated.alone, calibration, tests, left_out, simulated)
    weighed = _fit_and_decide(ready, progress, left_out, simulated)
    progress(_PREPARING + _FITTING + _STARTING, "attributing")
    found = _collect(ready, weighed, calibrated)
    model, segments, load_mNm = found.model, found.segments, found.fitter.load_reference
    document = to_document(found, ready.hidden)
    repeated.add_repeats(document, model, segments, load_mNm)
    document["resembles"] = (
        resembles.closest_effects(found.gathered, found.gap["before"]) if document["verdict"] == "unknown" else []
    )
    progress(1.0, "done")
    corrected = _corrected_model(found.chosen.fit, found.latest) if found.named else calibrated
    corrected = replace(corrected, extra=model.extra, load_reference_mNm=load_mNm)
    # With the old tables, and with the new: a simulator's are for no board.
    document["tip"] = tip.simulated_error(model, corrected) if found.named and simulated is None else None
    if simulated is not None:
        document["simulator"] = simulated.to_json(document["effects"])
    return Diagnosis(
        document=document,
        nominal=model,
        corrected=corrected,
        next_motion=found.next_motion,
        segments=[replace(segment, drive=None) for segment in segments],  # what was simulated is in motor and residuals
        before=list(found.before),
        after=list(found.after),
        conditions=found.conditions,
        evidence=found.gathered.evidence,
    )


@dataclass(frozen=True)
class _Prepared:
    """The recordings' fitter, the models and effects to try: all that is needed before hypotheses are fitted."""

    model: Model  # as calibrated, without effects
    fitter: Fitter  # with its noise floor
    tracked: TrackerError | None  # of videos
    frozen: list[Array]  # (scored, k) of each recording: residuals by the model as it is
    base: Fit  # the recalibrated nominal model's
    kinds: list[Kind]  # effects to try
    hidden: dict[str, str]  # {id of an effect that is not fitted: id of the one it is confounded with}


@dataclass(frozen=True)
class _Weighed:
    """The fitted hypotheses and the verdict on them."""

    fitter: Fitter
    gathered: Gathered
    verdict: decide.Decision


def _prepare(
    model: Model,
    calibration: Recording,
    tests: Sequence[Recording],
    left_out: Collection[str],
    simulated: SimulatedNominal | None,
) -> _Prepared:
    """Makes segments of the recordings, takes the tracker's error off them, estimates their noise floor, fits the
    recalibrated nominal model, and selects the effects to try. model: without effects; further arguments as of
    `diagnose`."""
    load_mNm = load_reference(calibration)
    segments = prepare(model, calibration, tests, simulated.drives if simulated else ())
    if repeated.HELD in left_out:
        segments = [segment.with_repeats() for segment in segments]
    tracked = tracker.of_videos(model, segments, load_mNm, [calibration, *tests])
    fitter, frozen = _fitter_and_residuals(model, tracked.segments if tracked else segments, load_mNm, simulated)
    base = _recalibrate(fitter, frozen, tracked)
    fitter.floor = _noise_floor(fitter, frozen[0], base, tracked.noise if tracked else 0.0)
    kinds = [*applicable(fitter, left_out), *(simulated.kinds if simulated else ())]
    hidden = confounded.drift_hidden_by_load(kinds, fitter.segments)
    return _Prepared(model, fitter, tracked, frozen, base, [kind for kind in kinds if kind.id not in hidden], hidden)


def _fit_and_decide(
    ready: _Prepared, progress: Progress, left_out: Collection[str], simulated: SimulatedNominal | None
) -> _Weighed:
    """Fits all hypotheses and decides. Where no effect after the calibration is named and there is no simulator,
    effects that were there while calibrating are looked for too, if the calibration gives reason to; their result is
    returned instead if it names an effect. Arguments as of `diagnose`."""

    def report_fits(done: float, text: str) -> None:
        """Reports the progress of the fits as a part of the whole diagnosis."""
        progress(_PREPARING + _FITTING * done, text)

    def report_start(done: float, text: str) -> None:
        """Reports the progress of the fits of effects from the start as a part of the whole diagnosis."""
        progress(_PREPARING + _FITTING + _STARTING * done, text)

    model, fitter, tracked = ready.model, ready.fitter, ready.tracked
    gathered = gather(fitter, ready.frozen, ready.base, ready.kinds, report_fits)
    verdict = decide.decide(gathered.evidence)
    asked = start.concerns(model) or decide.is_open(gathered.evidence, gathered.evidence.calibrated)
    if verdict.name != "effect" and simulated is None and asked:
        from_start = start.of_segments(model, fitter.segments, fitter.load_reference, tracked, report_start, left_out)
        if from_start.named:
            return _Weighed(from_start.fitter, from_start.gathered, from_start.verdict)
    return _Weighed(fitter, gathered, verdict)


def _collect(ready: _Prepared, weighed: _Weighed, calibrated: Model) -> Found:
    """Collects what a document is made of: the verdict, completed by the parts of the nominal model that moved, the
    hypothesis that it chooses, and what the `calibrated` model leaves with the effects that it carries."""
    fitter, gathered, frozen, base = weighed.fitter, weighed.gathered, ready.frozen, ready.base
    verdict, parts = _with_moved_parts(fitter, frozen, base, gathered, weighed.verdict)
    return Found(
        model=ready.model,
        segments=ready.fitter.segments,
        fitter=fitter,
        tracked=ready.tracked,
        frozen=frozen,
        recalibrated=gap.rms(base.residuals[1:]),
        kinds=ready.kinds,
        gathered=gathered,
        verdict=verdict,
        chosen=_chosen_candidate(fitter, frozen, gathered, verdict),
        parts=parts,
        carried=_left_with_effects(ready.fitter, calibrated) if calibrated.effects else None,
    )


def _left_with_effects(fitter: Fitter, model: Model) -> list[Array]:
    """Residuals of the tests, (scored, k) each, by a model with the effects that it carries."""
    parameters, load = effects.of_model(model), fitter.load_reference
    tests = fitter.segments[1:]
    return [(test.observed - test.predict(model, parameters, load)[1])[test.scored] for test in tests]


def _fitter_and_residuals(
    model: Model, segments: list[Segment], load_mNm: float, simulated: SimulatedNominal | None
) -> tuple[Fitter, list[Array]]:
    """(A fitter of these recordings, residuals (scored, k) of each by the calibrated model as it is). load_mNm: at
    which the model's tables hold. With a simulator, white noise of the robot's sensor is added to segments[0], which is
    the simulator's own recording and has none."""
    fitter = Fitter(model, segments, load_mNm)
    frozen = fitter.residuals(fitter.start(), fitter.no_effect)
    if simulated is None:
        return fitter, frozen
    segments = [with_noise(segments[0], gap.noise_floor(segments[1:], frozen[1:])), *segments[1:]]
    fitter = Fitter(model, segments, load_mNm)
    return fitter, fitter.residuals(fitter.start(), fitter.no_effect)


def _recalibrate(fitter: Fitter, frozen: Sequence[Array], tracked: TrackerError | None) -> Fit:
    """Fits the recalibrated nominal model. Sets the fitter's `floor` first: the larger of the noise at rest or in what
    the calibrated model leaves (`frozen`, (scored, k) of each recording) and the tracker's noise; with tracked videos
    also its `doubt` and `unsteady`."""
    fitter.floor = max(gap.noise_floor(fitter.segments, frozen), tracked.noise if tracked else 0.0)
    if tracked is not None:
        fitter.doubt, fitter.unsteady = tracked.doubt, tracked.unsteady
    return fitter.recalibrated()


def _noise_floor(fitter: Fitter, of_calibration: Array, base: Fit, moving: float) -> float:
    """The noise floor, px or deg. It is estimated at rest from what `base` leaves; where the tip creeps at rest this is
    too large. So a bound replaces it that is clearly less (below a share _NO_NOISE): what the calibrated model leaves
    of its own calibration, `of_calibration` (scored, k), but no less than the least noise and the tests' white noise,
    as a simulator's calibration leaves nothing. The result is never below `moving`, the noise of a moving marker in
    tracked videos."""
    segments, relative = fitter.segments, fitter.relative_noise
    at_rest = gap.noise_floor(segments, base.residuals, fitter.across(base), relative)
    of_tests = [left / times for left, times in zip(base.residuals[1:], relative[1:], strict=True)]
    by_calibration = gap.rms([of_calibration]) / relative[0]
    bound = max(by_calibration, gap.least_noise(segments), gap.second_difference_noise(of_tests))
    return max(bound if bound < _NO_NOISE * at_rest else at_rest, moving)


def _with_moved_parts(
    fitter: Fitter, frozen: Sequence[Array], base: Fit, gathered: Gathered, verdict: decide.Decision
) -> tuple[decide.Decision, list[Moved]]:
    """(Verdict, parts of the nominal model that moved). Where the verdict is unknown but a recalibration closes the
    gap, the parts that it moved are named; else the verdict is returned as it is, with no parts."""
    before, recalibrated = gap.rms(frozen[1:]), gap.rms(base.residuals[1:])
    still_open = decide.is_open(gathered.evidence, recalibrated**2)
    swallowed = moved.closes_all(before, recalibrated, fitter.floor, still_open, learnt().center.unexplained_by_law)
    if verdict.name != "unknown" or not swallowed:
        return verdict, []
    parts = moved.by_freeing(fitter, frozen, base)
    return (decide.with_moved(verdict, [(part.id, part.share) for part in parts]) if parts else verdict), parts


def _chosen_candidate(fitter: Fitter, frozen: list[Array], gathered: Gathered, verdict: decide.Decision) -> Candidate:
    """The fitted hypothesis of what is named. If its path contains none of the named effects (events only, or parts of
    the nominal model), its recalibrated nominal model is replaced by the calibrated one, unless it shrinks the gap with
    a probability of at least gap.SURELY."""
    chosen = gathered.candidates[verdict.chosen]
    if verdict.name != "effect" or not verdict.named or chosen.predicts_an_effect:
        return chosen
    if gap.probability_of_shrinking(frozen[1:], chosen.held_out[1:], fitter.segments[1:]) >= gap.SURELY:
        return chosen
    return chosen.with_nominal(fitter.start(), frozen)


def _corrected_model(fit: Fit, last: Segment) -> Model:
    """The fitted model with its effects, in its state at the end of the recording `last`: shifts until then have
    happened, and a drift has gone on until then. Effects that tables, rig or delay hold are put into these."""
    model = fit.state.model
    values = fit.state.at(last, fit.hypothesis)
    # Where another registration is an effect, these are the nominal's and the effect's together.
    registered = {name: values[name] for name in STATIC_NAMES if name in values}
    model = with_registration(replace(model, c_deg=monotone(model.c_deg)), registered)
    added = []
    for kind in fit.hypothesis.kinds:
        effect = kind.of_values(fit.state.values if kind.id == STATIC else values)
        if kind.holds is not None and kind.id != STATIC:
            model = kind.holds(model, effect.parameters, last.end_s)
        added.append(effect)
    return replace(model, effects=tuple(added))
