"""Effects that were there from the first recording on, and so while calibrating.

A calibration looks for them in its own recordings, a diagnosis in all that it was given, by the same functions, so that
both give the same name. The nominal model is fitted anew beside each effect, a single play with smooth curves: what an
effect has left in a calibrated B and f_remain, or in its number of plays, is then evidence for the effect.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tautline.diagnosis import confounded, decide, gap, tracker
from tautline.diagnosis.candidates import applicable
from tautline.diagnosis.decide import Decision
from tautline.diagnosis.fit import WIDTH_PIECES, Fitter, spline_residual
from tautline.diagnosis.fitted import Fit, Scope
from tautline.diagnosis.gather import Gathered, gather
from tautline.diagnosis.segment import Segment, load_reference, prepare
from tautline.diagnosis.tracker import TrackerError
from tautline.effects import LIBRARY
from tautline.model import Effect, Model
from tautline.recording import Recording
from tautline.splines import Basis

Progress = Callable[[float, str], None]

# Ids of what may be named: no part of the nominal model, which is free beside it, and no event, which has no path.
NAMES = frozenset(kind.id for kind in LIBRARY if not kind.nominal and not kind.event)
_SURE = 2.0  # loss: rms of B's finest details over its standard deviation; where nothing is wrong 0.5 to 0.9


@dataclass(frozen=True)
class Start:
    """The fitted hypotheses of effects that were there from the start, and the verdict on them."""

    fitter: Fitter
    gathered: Gathered
    verdict: Decision

    @property
    def named(self) -> tuple[str, ...]:
        """Ids of the named effects, the leading one first; () where there is no gap, or no known effect explains it."""
        return self.verdict.named if self.verdict.name == "effect" else ()

    @property
    def fit(self) -> Fit:
        """The fit of the chosen hypothesis, with the nominal model free beside its effects."""
        return self.gathered.candidates[self.verdict.chosen].fit

    @property
    def effects(self) -> tuple[Effect, ...]:
        """The named effects with their fitted parameters, as a model carries them."""
        values = self.fit.state.values
        kinds = [kind for kind in self.fit.hypothesis.kinds if kind.id in self.named]
        return tuple(kind.of_values(values) for kind in kinds)


def concerns(model: Model) -> bool:
    """Whether there is reason to look for effects that were there while calibrating: the calibration's verdict names
    one as a reason, or B has details that no smooth B has (`in_the_width`)."""
    return any(reason.code in NAMES for reason in model.quality.reasons) or in_the_width(model)


def in_the_width(model: Model) -> bool:
    """Whether B has significant details that are finer than the nominal model's splines: their rms exceeds _SURE times
    the rms of B's standard deviation. An effect such as an encoder's ripple leaves such details. False where the
    measured range has fewer than 2 WIDTH_PIECES nodes."""
    low, high = model.measured
    inside = (model.q > low) & (model.q < high)
    q, width, sigma = (values[inside] for values in (model.q, model.width, model.width_sigma))
    if len(q) < 2 * WIDTH_PIECES:
        return False
    finer = spline_residual(Basis(float(q[0]), float(q[-1]), WIDTH_PIECES), q, width)
    return float(np.mean(finer**2)) > _SURE**2 * float(np.mean(sigma**2))


def of_recordings(model: Model, recordings: Sequence[Recording], progress: Progress) -> Start:
    """Finds which effects were there from the first recording on. model: the effects that it carries are left out, and
    looked for anew. recordings: on the motor's clock, the earliest first. progress: called with the share that is done,
    0 to 1, and what is done now. Raises TautError where none can be scored."""
    model = model.alone
    segments, reference = prepare(model, recordings[0], recordings[1:]), load_reference(recordings[0])
    tracked = tracker.of_videos(model, segments, reference, recordings)
    return of_segments(model, tracked.segments if tracked else segments, reference, tracked, progress)


def of_segments(
    model: Model,
    segments: Sequence[Segment],
    load_mNm: float,
    tracked: TrackerError | None,
    progress: Progress,
    left_out: Collection[str] = (),
) -> Start:
    """As `of_recordings`, from segments, all of which count as the calibration. load_mNm: at which the model's tables
    hold. tracked: the tracker's error in videos, which is taken off the segments already. left_out: ids of effects not
    to try. The noise floor is set twice: first by what the model leaves as it is, to weigh the recalibration, then by
    what the recalibrated model leaves."""
    as_calibration = [replace(segment, calibration=True) for segment in segments]
    fitter = Fitter(model, as_calibration, load_mNm, smooth=True)
    moving = tracked.noise if tracked else 0.0
    if tracked:
        fitter.doubt, fitter.unsteady = tracked.doubt, tracked.unsteady
    fitter.floor = max(gap.noise_floor(as_calibration, fitter.residuals(fitter.start(), fitter.no_effect)), moving)
    base = fitter.recalibrated()
    noise = gap.noise_floor(as_calibration, base.residuals, fitter.across(base), fitter.relative_noise)
    fitter.floor = max(noise, moving)
    kinds = [kind for kind in applicable(fitter, left_out) if kind.id in NAMES]
    hidden = confounded.drift_hidden_by_load(kinds, as_calibration)
    kinds = [kind for kind in kinds if kind.id not in hidden]
    gathered = gather(fitter, base.residuals, base, kinds, progress, (Scope.START,))
    return Start(fitter, gathered, decide.decide(gathered.evidence))
