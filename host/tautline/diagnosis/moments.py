"""When a shift or a slip happened, and whether a recording shows that it did.

A moment is no parameter with a derivative: a frame is before it or after it. It is found with a fit's other parameters
as they are, over the frames beside it, and these are fitted again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_MARGIN_S = 1.0  # before and after a moment that a recording has to show
_NEAR_S = 1.5  # tolerance: within which a linear step has found it: of a slip in the play nothing is seen at once
_BEFORE_S = 1e-3  # tolerance: a frame that shows it
_TRIED = 12  # tolerance: at once
_STEPS = 8
_ROUNDS = 2  # moments beside each other move each other


def moments_of(fit: Fit) -> list[str]:
    """Names of the fitted parameters that are times, s of the session, at which an effect happens (shift, slip)."""
    return [name for kind in fit.hypothesis.kinds for name in kind.moments]


def refined(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> Fit:
    """The fit with its events' moments searched to a frame and everything else fitted again. limits: of each recording,
    to which residuals are cut."""
    for _ in range(_ROUNDS):
        values = dict(fit.state.values)
        for moment in moments_of(fit):
            values[moment] = _best_moment(fitter, fit, values, moment, limits)
        if values == fit.state.values:
            return fit
        fit = fitter.descend(fit.hypothesis, replace(fit.state, values=values), _STEPS)
    return fit


def seen_to_happen(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> bool:
    """Whether each moment of the last added effect is shown by a recording: before it the frames fit better without the
    event, after it with it. A change between two recordings is another registration or offset instead."""
    return all(_is_seen(fitter, fit, moment, limits) for moment in fit.hypothesis.kinds[-1].moments)


def _is_seen(fitter: Fitter, fit: Fit, moment: str, limits: Sequence[float]) -> bool:
    """Whether some recording shows this moment with _MARGIN_S on either side, and fits better with the event after it
    only."""
    happens_s = fit.state.values[moment]
    for segment, limit in zip(fitter.segments, limits, strict=True):
        seen = _session_times(segment)
        if seen[0] + _MARGIN_S < happens_s < seen[-1] - _MARGIN_S:
            never, always = (
                _squares(fitter, fit, segment, {**fit.state.values, moment: at}, limit) for at in (np.inf, -np.inf)
            )
            before = seen < happens_s
            return bool(never[before].sum() < always[before].sum() and never[~before].sum() > always[~before].sum())
    return False


def _best_moment(fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: str, limits: Sequence[float]) -> float:
    """The moment, s of the session, of the smallest sum of squares among the frames beside the present one, which is
    values[moment]: evenly spaced ones first, then those between the best one's neighbours."""
    tried = {values[moment]: _squares_beside(fitter, fit, values, {moment: values[moment]}, limits)}
    near = _moments_beside(fitter, fit, values[moment])
    low, high = 0, len(near) - 1
    while low <= high:
        some = sorted(set(np.linspace(low, high, min(_TRIED, high - low + 1)).round().astype(int).tolist()))
        left = [_squares_beside(fitter, fit, values, {moment: near[i]}, limits) for i in some]
        tried |= {near[i]: one for i, one in zip(some, left, strict=True)}
        k = int(np.argmin(left))
        if len(some) == high - low + 1:
            break
        low, high = some[max(k - 1, 0)], some[min(k + 1, len(some) - 1)]
    return min(tried, key=tried.__getitem__)


def _moments_beside(fitter: Fitter, fit: Fit, at: float) -> list[float]:
    """Moments (scene time, s of the session, rising) just before each frame within _NEAR_S of `at`."""
    delay = fit.state.model.delay_s + fit.state.values.get("delay", 0.0)
    frames = np.concatenate([_session_times(segment) for segment in fitter.segments]) - delay
    return [float(frame) for frame in np.unique(frames[np.abs(frames - at) < _NEAR_S] - _BEFORE_S)]


def _squares_beside(
    fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: Mapping[str, float], limits: Sequence[float]
) -> float:
    """Sum of squared residuals, cut to `limits`, with the one moment {name: s of the session} put among `values`, over
    the recordings in which it lies or that are within _NEAR_S of it."""
    (at,) = moment.values()
    return sum(
        float(_squares(fitter, fit, segment, {**values, **moment}, limit).sum())
        for segment, limit in zip(fitter.segments, limits, strict=True)
        if _session_times(segment)[0] - _NEAR_S < at < _session_times(segment)[-1] + _NEAR_S
    )


def _session_times(segment: Segment) -> Array:
    """(scored,) Arrival times of the scored frames on the session's clock, s."""
    return np.asarray(segment.arrival_s[segment.scored] + segment.offset_s)


def _squares(fitter: Fitter, fit: Fit, segment: Segment, values: Mapping[str, float], limit: float) -> Array:
    """(scored,) Squared residual of each frame of a recording, coordinates cut to `limit`."""
    state = replace(fit.state, values=values)
    _, predicted = segment.predict(state.model, state.at(segment, fit.hypothesis), fitter.load_reference)
    left = (segment.observed - predicted)[segment.scored]
    return np.asarray(np.sum(np.minimum(np.abs(left), limit) ** 2, axis=1))
