"""What was there from the first recording on, and so while calibrating: one name of it, whoever asks.

A calibration asks of its own recordings, a diagnosis of all that it was given. The nominal model is fitted anew beside
each effect, a single play with smooth curves: what an effect has left in a calibrated B and f_remain, or in its
number of plays, speaks for the effect.
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

# What may be named: no part of the nominal model, which is free beside it, and no scatter, which a fit has no path of.
NAMES = frozenset(kind.id for kind in LIBRARY if not kind.nominal and not kind.event)
_SURE = 2.0  # standard deviations: of B where nothing was wrong its shape is 0.5 to 0.9 of one finer than the splines


@dataclass(frozen=True)
class Start:
    """What was weighed, and what is likeliest of it."""

    fitter: Fitter
    gathered: Gathered
    verdict: Decision

    @property
    def named(self) -> tuple[str, ...]:
        """Ids of the library, the leading one first; none where nothing is left, or nothing known explains it."""
        return self.verdict.named if self.verdict.name == "effect" else ()

    @property
    def fit(self) -> Fit:
        """Of what is named, the nominal model free beside it."""
        return self.gathered.candidates[self.verdict.chosen].fit

    @property
    def effects(self) -> tuple[Effect, ...]:
        """What is named, as strong as it was fitted."""
        values = self.fit.state.values
        kinds = [kind for kind in self.fit.hypothesis.kinds if kind.id in self.named]
        return tuple(kind.of_values(values) for kind in kinds)


def concerns(model: Model) -> bool:
    """Whether the model's calibration says that something was there beside it, or has taken it for a part of B."""
    return any(reason.code in NAMES for reason in model.quality.reasons) or in_the_width(model)


def in_the_width(model: Model) -> bool:
    """Whether B holds what none of the nominal's splines follows, by more than it is uncertain by: no smooth B does."""
    low, high = model.measured
    inside = (model.q > low) & (model.q < high)
    q, width, sigma = (values[inside] for values in (model.q, model.width, model.width_sigma))
    if len(q) < 2 * WIDTH_PIECES:
        return False
    finer = spline_residual(Basis(float(q[0]), float(q[-1]), WIDTH_PIECES), q, width)
    return float(np.mean(finer**2)) > _SURE**2 * float(np.mean(sigma**2))


def of_recordings(model: Model, recordings: Sequence[Recording], progress: Progress) -> Start:
    """What was there from the first recording on. recordings: on the motor's clock, the earliest first. Effects that
    the model carries are looked for anew. Raises TautError where none can be scored."""
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
    """`of_recordings` of segments, each as if it were the calibration. load_mNm: at which the model's tables hold.
    tracked: of videos, what their tracker errs by, taken off the segments already. left_out: effects not to try."""
    alike = [replace(segment, calibration=True) for segment in segments]
    fitter = Fitter(model, alike, load_mNm, smooth=True)
    moving = tracked.noise if tracked else 0.0
    if tracked:
        fitter.doubt, fitter.unsteady = tracked.doubt, tracked.unsteady
    fitter.floor = max(gap.noise_floor(alike, fitter.residuals(fitter.start(), fitter.nothing)), moving)
    base = fitter.nominal()
    fitter.floor = max(gap.noise_floor(alike, base.residuals, fitter.across(base)), moving)
    kinds = [kind for kind in applicable(fitter, left_out) if kind.id in NAMES]
    hidden = confounded.hidden(kinds, alike)
    kinds = [kind for kind in kinds if kind.id not in hidden]
    gathered = gather(fitter, base.residuals, base, kinds, progress, (Scope.START,))
    return Start(fitter, gathered, decide.that_help(gathered.evidence, decide.decide(gathered.evidence)))
