"""Events: effects without a reproducible path (frame jitter, stick-slip), identified by the statistics of residuals.

Each explanation is a density of a frame's observation given the frames before it, with one free number by maximum
likelihood, so that their likelihoods compare. Jitter: frame times are unsteady, and the image scatters along its motion
in proportion to its speed, both ways or, of frames that wait, one way, by chance or by what their times of arrival say.
Stick-slip: for a while the tip stays where it was while the motor drives on, the likelier the less it has driven since,
and else is anywhere within a jump; between such times the frames are as in bursts. Rivals stand for whatever else
leaves a residual: noise whose level is another while the motor drives ("level"), lengths by which the tip is behind or
ahead at any speed ("behind"), noise that grows with the speed both along the motion and across it, as of a marker that
blurs ("blur"; of an angle that is jitter), noise that is correlated with the frames before ("memory"), a misfit that
comes and goes ("bursts"), a link that sends frames twice, a tracker that errs with the position within a pixel
("pixels"), and a misfit that is the same whenever the motor comes to a place from one side ("place"). A tip that goes
twice as far for a while instead of staying ("doubles") is none that there is: it tells how much of what sticking
explains any further law of the motion would. One that stays after a start or a turn alone ("starts") does not stick on
its way. Every density is mixed with a broad one: no model is right for every frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.explanations import Frames, Joined, frames, pixel_phase_part
from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.repeated import HELD

Array = npt.NDArray[np.float64]

STICK_SLIP, JITTER = "transmission.stick_slip", "acquisition.jitter"
_AS_IT_IS = "as it is"
RIVALS = ("level", "blur", "behind", "memory", "bursts", "doubles", "starts", HELD, "pixels", "place")
_HAPPENS_S = 0.5  # tolerance: s about a shift or slip that are left out: no model says how it moves meanwhile
_LONGEST_S = 0.1  # prior: s: the largest standard deviation of frame times
_FAST_IMAGE = 0.9  # tolerance: quantile of a fast image
_HELD_SHARES = np.array([0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 0.9])  # prior: grid of repeats
_JUMPS = (0.1, 30.0)  # prior: range of jumps, times a fast drive from frame to frame
# tolerance: of the smallest jump, and of the time in which a fast image shows beside noise: grids begin there
_FINEST = 0.1
_SECONDS, _JUMP_SIZES, _LENGTHS = 41, 61, 31  # tolerance: members of each family that are tried


@dataclass(frozen=True)
class Scatter:
    """How well each explanation predicts the residuals of a fit, block by block."""

    # By explanation (the events' ids, RIVALS, _AS_IT_IS): (blocks,) -2 mean log-likelihood per coordinate, less a
    # constant, so that a Gaussian of variance v gives log v; 0 of blocks in which no frame counts.
    loss: dict[str, Array]
    amount: dict[str, float]  # by event: its one number, in its parameter's unit

    @property
    def plain(self) -> Array:
        """(blocks,) The loss of the residuals as they are: Gaussian noise of one level at rest and one while the motor
        drives."""
        return self.loss[_AS_IT_IS]

    def beats_rivals(self, event: str) -> bool:
        """Whether the event with this id predicts the residuals better than each of the rivals does."""
        least = min(float(np.mean(self.loss[rival])) for rival in RIVALS if rival != event)
        return float(np.mean(self.loss[event])) < least


def of_fit(fitter: Fitter, fit: Fit, labels: Sequence[npt.NDArray[np.int64]], tests_only: bool) -> Scatter:
    """Compares how well each explanation predicts the residuals of a fit. labels: (scored,) of each recording, the
    number of each observation's block. tests_only: leave the calibration's frames out, for an event that came after it.
    Frames near a moment of the fit (shift, slip) are left out always."""
    parts, blocks = [], 0
    for segment, label, times in zip(fitter.segments, labels, fitter.relative_noise, strict=True):
        block = np.full(len(segment.scored), -1)
        block[segment.scored] = label + blocks
        parameters = fit.state.at(segment, fit.hypothesis)
        scene_s = segment.scene_s(fit.state.model, parameters)
        for moment in (name for kind in fit.hypothesis.kinds for name in kind.moments):
            block[np.abs(scene_s - fit.state.values[moment]) < _HAPPENS_S] = -1
        blocks += int(label.max(initial=-1)) + 1
        if not (tests_only and segment.calibration):
            path, predicted = segment.predict(fit.state.model, parameters, fitter.load_reference)
            seen = segment.observed / times
            parts.append(frames(segment.arrival_s, seen, predicted / times, path.p, block, segment.calibration))
    return compare_explanations(parts, fitter.floor, blocks)


def compare_explanations(parts: Sequence[Frames], floor: float, blocks: int) -> Scatter:
    """The loss of each explanation and the amount of each event, by maximum likelihood; all are 0 where no frame
    counts. parts: the frames of each recording; floor: one standard deviation of the noise of a coordinate, px or deg;
    blocks: the number of blocks in all."""
    if not any(len(part.block) for part in parts):
        names = (JITTER, STICK_SLIP, _AS_IT_IS, *RIVALS)
        return Scatter({name: np.zeros(blocks) for name in names}, dict.fromkeys((JITTER, STICK_SLIP, HELD), 0.0))
    joined = Joined(parts, floor)
    # The time, s, in which a fast image moves as far as one standard deviation of the noise.
    finest_s = floor / max(float(np.quantile(joined.speed, _FAST_IMAGE)), 1e-9)
    seconds = np.geomspace(min(_FINEST * finest_s, _FINEST * _LONGEST_S), _LONGEST_S, _SECONDS)
    # Three kinds of jitter, each with the part of its scatter, s, that the times of arrival tell.
    jitters = (joined.jitter, 0.0), (joined.waiting, 0.0), (joined.stamped, joined.waits_deviation_s)
    of_each = [(joined.likeliest(kind, seconds), told_s) for kind, told_s in jitters]
    (jittered, beside_s), told_s = max(of_each, key=lambda one: _log_likelihood(one[0]))
    fast_drive = joined.fast_drive  # unit of q from frame to frame
    jumps = np.geomspace(_JUMPS[0] * fast_drive, _JUMPS[1] * fast_drive, _JUMP_SIZES)
    stuck, jump = joined.likeliest(joined.stick, jumps)
    rivals = jumps[::2]  # no size is read off them
    doubled, starting = (joined.likeliest(family, rivals)[0] for family in (joined.double, joined.start_late))
    lengths = np.geomspace(_FINEST * _JUMPS[0] * fast_drive, fast_drive, _LENGTHS)
    behind, ahead = (joined.likeliest(joined.behind, way * lengths) for way in (1.0, -1.0))
    repeated, held_share = joined.likeliest(joined.repeats, _HELD_SHARES)
    level = joined.two_levels(joined.residual)
    log_densities = {
        JITTER: jittered,
        STICK_SLIP: stuck,
        _AS_IT_IS: joined.two_levels(joined.as_it_is),
        "level": level,
        "blur": joined.likeliest(joined.blur, seconds)[0] if joined.coordinates > 1 else level,
        "behind": max(behind, ahead, key=_log_likelihood)[0],
        "memory": joined.two_levels(joined.residual - joined.by_memory),
        "bursts": joined.bursts,
        "doubles": doubled,
        "starts": starting,
        HELD: repeated,
        "pixels": joined.two_levels(joined.residual - pixel_phase_part(joined.residual, joined.image)),
        "place": joined.two_levels(joined.residual - joined.by_place()),
    }
    count = np.maximum(np.bincount(joined.block, minlength=blocks), 1)
    has_frames = np.bincount(joined.block, minlength=blocks) > 0
    # Less 1, the mean of square over variance: a Gaussian of variance v then gives log v.
    loss = {
        name: has_frames * (-2.0 / joined.coordinates * np.bincount(joined.block, x, minlength=blocks) / count - 1.0)
        for name, x in log_densities.items()
    }
    return Scatter(loss, {JITTER: float(np.hypot(beside_s, told_s)), STICK_SLIP: jump, HELD: held_share})


def _log_likelihood(likeliest: tuple[Array, float]) -> float:
    """The log-likelihood of all frames, from the pair that `Joined.likeliest` returns."""
    return float(np.sum(likeliest[0]))
