"""When a shift or a slip happened, and whether a recording shows that it did.

A moment is no parameter with a derivative: a frame is before it or after it. It is found with a fit's other parameters
as they are, over the frames beside it, and these are fitted again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fit, Fitter
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_MARGIN_S = 1.0  # before and after a moment that a recording has to show
_NEAR_S = 1.5  # tolerance: within which a linear step has found it: of a slip in the play nothing is seen at once
_BEFORE_S = 1e-3  # tolerance: a frame that shows it
_TRIED = 12  # tolerance: at once
_STEPS = 8
_ROUNDS = 2  # moments beside each other move each other


def moments_of(fit: Fit) -> list[str]:
    return [name for kind in fit.hypothesis.kinds for name in kind.moments]


def refined(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> Fit:
    """A fit with its moments to a frame. limits: of each recording, what residuals are cut to."""
    for _ in range(_ROUNDS):
        values = dict(fit.state.values)
        for moment in moments_of(fit):
            values[moment] = _best(fitter, fit, values, moment, limits)
        if values == fit.state.values:
            return fit
        fit = fitter.descend(fit.hypothesis, replace(fit.state, values=values), _STEPS)
    return fit


def seen_to_happen(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> bool:
    """Of the effect that was added last: a recording shows each of its moments: what comes before in it fits better
    without, and what comes after with it. What happens between two recordings is another registration or offset of
    those after it."""
    return all(_is_seen(fitter, fit, moment, limits) for moment in fit.hypothesis.kinds[-1].moments)


def _is_seen(fitter: Fitter, fit: Fit, moment: str, limits: Sequence[float]) -> bool:
    happens_s = fit.state.values[moment]
    for segment, limit in zip(fitter.segments, limits, strict=True):
        seen = _times(segment)
        if seen[0] + _MARGIN_S < happens_s < seen[-1] - _MARGIN_S:
            never, always = (
                _squares(fitter, fit, segment, {**fit.state.values, moment: at}, limit) for at in (np.inf, -np.inf)
            )
            before = seen < happens_s
            return bool(never[before].sum() < always[before].sum() and never[~before].sum() > always[~before].sum())
    return False


def _best(fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: str, limits: Sequence[float]) -> float:
    """Of the moment as it is and those beside it that which leaves least: a few that lie evenly, then a few between the
    neighbours of the best one, to a frame."""
    tried = {values[moment]: _after(fitter, fit, values, {moment: values[moment]}, limits)}
    near = _near(fitter, fit, values[moment])
    low, high = 0, len(near) - 1
    while low <= high:
        some = sorted(set(np.linspace(low, high, min(_TRIED, high - low + 1)).round().astype(int).tolist()))
        left = [_after(fitter, fit, values, {moment: near[i]}, limits) for i in some]
        tried |= {near[i]: one for i, one in zip(some, left, strict=True)}
        k = int(np.argmin(left))
        if len(some) == high - low + 1:
            break
        low, high = some[max(k - 1, 0)], some[min(k + 1, len(some) - 1)]
    return min(tried, key=tried.__getitem__)


def _near(fitter: Fitter, fit: Fit, at: float) -> list[float]:
    """Moments beside one, of the scene, rising: a little before each frame, as the fit has its delay."""
    delay = fit.state.model.delay_s + fit.state.values.get("delay", 0.0)
    frames = np.concatenate([_times(segment) for segment in fitter.segments]) - delay
    return [float(frame) for frame in np.unique(frames[np.abs(frames - at) < _NEAR_S] - _BEFORE_S)]


def _after(
    fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: Mapping[str, float], limits: Sequence[float]
) -> float:
    """Sum of squares of the recording in which it happens."""
    (at,) = moment.values()
    return sum(
        float(_squares(fitter, fit, segment, {**values, **moment}, limit).sum())
        for segment, limit in zip(fitter.segments, limits, strict=True)
        if _times(segment)[0] - _NEAR_S < at < _times(segment)[-1] + _NEAR_S
    )


def _times(segment: Segment) -> Array:
    """Of the session, at which scored frames arrived."""
    return np.asarray(segment.arrival_s[segment.scored] + segment.offset_s)


def _squares(fitter: Fitter, fit: Fit, segment: Segment, values: Mapping[str, float], limit: float) -> Array:
    """(scored,) of a recording, outliers pulled in."""
    state = replace(fit.state, values=values)
    _, predicted = segment.predict(state.model, state.at(segment, fit.hypothesis), fitter.load_reference)
    left = (segment.observed - predicted)[segment.scored]
    return np.asarray(np.sum(np.minimum(np.abs(left), limit) ** 2, axis=1))
