"""The moments at which a shift or a slip happened, and whether a recording shows that it did.

A moment, s on the session's clock, has no derivative: a frame is before it or after it. It is searched over the frames
with all other parameters of a fit held, and these are fitted again. Residuals are cut to a limit of each recording, px
or deg.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter, moves_tip
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.segment import Segment

Array = npt.NDArray[np.float64]

_MARGIN_S = 1.0  # tolerance: s that a recording has to show before and after a moment
_NEAR_S = 1.5  # tolerance: s by which a linear step may be off: a slip within the play is not seen at once
_BEFORE_S = 1e-3  # tolerance: s by which a moment comes before the first frame that shows it
_TRIED = 12  # tolerance: moments tried in each round of the search
_STEPS = 8  # tolerance: Gauss-Newton steps with the moments held
_ROUNDS = 2  # tolerance: of search and fit: moments near each other depend on each other


def moments_of(fit: Fit) -> list[str]:
    """Names of a fit's parameters that are moments at which an effect happens (shift, slip)."""
    return [name for kind in fit.hypothesis.kinds for name in kind.moments]


def refine_moments(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> Fit:
    """The fit with its moments searched to a frame and all else fitted again, in up to _ROUNDS rounds. limits: of each
    recording, px or deg, to which residuals are cut."""
    for _ in range(_ROUNDS):
        values = dict(fit.state.values)
        for moment in moments_of(fit):
            values[moment] = _best_moment(fitter, fit, values, moment, limits)
        if values == fit.state.values:
            return fit
        fit = fitter.descend(fit.hypothesis, replace(fit.state, values=values), _STEPS)
    return fit


def moments_are_seen(fitter: Fitter, fit: Fit, limits: Sequence[float]) -> bool:
    """Whether each moment of the last added effect is shown by its recording or by all tests together; True for an
    effect without moments."""
    return all(_is_seen(fitter, fit, moment, limits) for moment in fit.hypothesis.kinds[-1].moments)


def _is_seen(fitter: Fitter, fit: Fit, moment: str, limits: Sequence[float]) -> bool:
    """Whether the recording that contains this moment, at least _MARGIN_S from either end, or all tests together show
    it: their frames before the moment fit better without the change, those after it better with the change. What comes
    between two tests counts if it is one of the registration: of the tip it is another offset in each test, an effect
    of its own (`Kind.each`)."""
    moment_s = fit.state.values[moment]
    frames_s = [_scene_times(fit, segment) for segment in fitter.segments]

    def contains(indices: Sequence[int]) -> bool:
        """Whether the moment is within the time of these recordings together, _MARGIN_S from either end."""
        times = np.concatenate([np.empty(0), *(frames_s[i] for i in indices)])
        return len(times) > 0 and bool(times.min() + _MARGIN_S < moment_s < times.max() - _MARGIN_S)

    def shows(indices: Sequence[int]) -> bool:
        """Whether these recordings together show the moment."""
        before = np.concatenate([frames_s[i] for i in indices]) < moment_s
        never, always = (
            np.concatenate(
                [
                    _squares(fitter, fit, fitter.segments[i], {**fit.state.values, moment: at_s}, limits[i])
                    for i in indices
                ]
            )
            for at_s in (np.inf, -np.inf)
        )
        return bool(never[before].sum() < always[before].sum() and never[~before].sum() > always[~before].sum())

    within_one = [[i] for i in range(len(frames_s)) if contains([i])]
    tests = [i for i, segment in enumerate(fitter.segments) if not segment.calibration]
    of_registration = not any(moves_tip(p) for p in fit.hypothesis.kinds[-1].amplitudes)
    together = [tests] if len(tests) > 1 and (within_one or of_registration) and contains(tests) else []
    return any(shows(indices) for indices in (*within_one, *together))


def _best_moment(fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: str, limits: Sequence[float]) -> float:
    """The value, s, of the parameter `moment` with the smallest sum of squares, among its present value values[moment]
    and the frames near it. Evenly spaced frames are tried first, then those between the neighbours of the best, and so
    on."""
    sums = {values[moment]: _sum_of_squares(fitter, fit, values, moment, values[moment], limits)}
    near = _moments_near(fitter, fit, values[moment])
    low, high = 0, len(near) - 1
    while low <= high:
        tried = sorted(set(np.linspace(low, high, min(_TRIED, high - low + 1)).round().astype(int).tolist()))
        of_tried = [_sum_of_squares(fitter, fit, values, moment, near[i], limits) for i in tried]
        sums |= {near[i]: total for i, total in zip(tried, of_tried, strict=True)}
        k = int(np.argmin(of_tried))
        if len(tried) == high - low + 1:
            break
        low, high = tried[max(k - 1, 0)], tried[min(k + 1, len(tried) - 1)]
    return min(sums, key=sums.__getitem__)


def _moments_near(fitter: Fitter, fit: Fit, moment_s: float) -> list[float]:
    """Times, s on the session's clock, rising, each a little before the scene time of a frame within _NEAR_S of
    `moment_s`."""
    scene_s = np.concatenate([_scene_times(fit, segment) for segment in fitter.segments])
    return [float(at_s) for at_s in np.unique(scene_s[np.abs(scene_s - moment_s) < _NEAR_S] - _BEFORE_S)]


def _sum_of_squares(
    fitter: Fitter, fit: Fit, values: Mapping[str, float], moment: str, moment_s: float, limits: Sequence[float]
) -> float:
    """Sum of squared residuals, px^2 or deg^2, over the recordings within _NEAR_S of moment_s, with the parameter
    `moment` at moment_s and all others as in `values`."""
    total = 0.0
    for segment, limit in zip(fitter.segments, limits, strict=True):
        frames_s = _scene_times(fit, segment)
        if frames_s[0] - _NEAR_S < moment_s < frames_s[-1] + _NEAR_S:
            total += float(_squares(fitter, fit, segment, {**values, moment: moment_s}, limit).sum())
    return total


def _scene_times(fit: Fit, segment: Segment) -> Array:
    """(scored,) Scene times, s, of the scored frames on the session's clock, by the fit's delay."""
    return segment.scene_s(fit.state.model, fit.state.at(segment, fit.hypothesis))[segment.scored]


def _squares(fitter: Fitter, fit: Fit, segment: Segment, values: Mapping[str, float], limit: float) -> Array:
    """(scored,) Squared residual of each frame of a recording, px^2 or deg^2, summed over its coordinates after these
    are cut to `limit`, with the effects' parameters `values`."""
    state = replace(fit.state, values=values)
    _, predicted = segment.predict(state.model, state.at(segment, fit.hypothesis), fitter.load_reference)
    residual = (segment.observed - predicted)[segment.scored]
    return np.asarray(np.sum(np.minimum(np.abs(residual), limit) ** 2, axis=1))
