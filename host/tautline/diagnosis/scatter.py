"""Effects without a reproducible path: frame jitter and stick-slip, told by the statistics of what a model leaves.

Each is a density of a frame's image position given the frames before it, so that their likelihoods compare. Unsteady
frame times scatter along the motion as far as the image moves in them. A sticking tip stays where it was while the
motor drives on, the likelier the less it has driven since, and then is anywhere within a jump. Rivals stand for
whatever else leaves a residual: one that is larger while something moves, one that remembers the frames before,
images that repeat whatever the motor did, and a tracker that errs with the place within a pixel. A share of every
density is broad: no model is right for every frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit

Array = npt.NDArray[np.float64]

STICK_SLIP, JITTER, HELD = "transmission.stick_slip", "acquisition.jitter", "acquisition.held_samples"
_AS_IT_IS = "as it is"
RIVALS = ("level", "memory", HELD, "pixels")
_MOVES = 0.02  # tolerance: of the fastest: slower is at rest
_REMEMBERED = 3  # tolerance: frames that the rival with a memory reaches back
_BROAD = 0.03  # prior: share of frames that follow no model
_HAPPENS_S = 0.5  # about a shift: it takes its time, and a model of before and after says nothing of how it moves
_LONGEST_S = 0.1  # prior: frame times are not less steady than this


@dataclass(frozen=True)
class Scatter:
    """How well each says what is seen: losses, twice the mean negative log-likelihood per coordinate of each block
    (blocks,), the constant left out so that a Gaussian of variance v gives log v."""

    loss: dict[str, Array]  # of the two events' ids, of RIVALS and of what is left "as it is"
    amount: dict[str, float]  # of each event: how much it scatters, in its parameter's unit

    @property
    def plain(self) -> Array:
        """(blocks,) of what is left as it is."""
        return self.loss[_AS_IT_IS]

    @property
    def white(self) -> float:
        """The share of the noise's variance that the frames before do not foretell."""
        told = self.loss["level"] != 0.0
        gained = (self.loss["memory"] - self.loss["level"])[told]
        return float(np.exp(min(0.0, float(np.mean(gained))))) if told.any() else 1.0

    def beats_noise(self, event: str) -> bool:
        """Whether an event says more than a level of noise."""
        return float(np.mean(self.loss[event])) < float(np.mean(self.loss["level"]))


@dataclass(frozen=True)
class Frames:
    """Observations with as many predecessors as a memory needs, none lost between; (n, k) px or deg, (n,)."""

    residual: Array
    moved: Array  # observed, from the frame before
    velocity: Array  # predicted, per second
    period: Array  # s, from the frame before
    driven: Array  # unit of the centre coordinate since the frame before
    per_unit: Array  # (n, k) predicted image motion per unit driven; at rest that of before
    image: Array  # (n, k) observed
    before: Array  # (n, k, _REMEMBERED) residuals
    block: npt.NDArray[np.int64]


def of_fit(fitter: Fitter, fit: Fit, labels: Sequence[npt.NDArray[np.int64]], only_tests: bool) -> Scatter:
    """Losses of each explanation of the residuals' scatter for one fit. labels: the block of each recording's scored
    observations. only_tests: an effect after the calibration, whose blocks' losses are 0 then. Frames near an event's
    moment are left out."""
    parts, count = [], 0
    for segment, label in zip(fitter.segments, labels, strict=True):
        block = np.full(len(segment.scored), -1)
        block[segment.scored] = label + count
        seen = segment.arrival_s + segment.offset_s - fit.state.model.delay_s
        for moment in (name for kind in fit.hypothesis.kinds for name in kind.moments):
            block[np.abs(seen - fit.state.values[moment]) < _HAPPENS_S] = -1
        count += int(label.max(initial=-1)) + 1
        if not (only_tests and segment.calibration):
            at = fit.state.at(segment, fit.hypothesis)
            path, predicted = segment.predict(fit.state.model, at, fitter.load_reference)
            parts.append(frames(segment.arrival_s, segment.observed, predicted, path.p, block))
    return weighed(parts, fitter.floor, count)


def frames(t: Array, observed: Array, predicted: Array, p: Array, block: npt.NDArray[np.int64]) -> Frames:
    """The frames of one recording that count: scored (block >= 0), with _REMEMBERED evenly timed predecessors. t:
    arrival times, s; observed, predicted: (n, k); p: the centre coordinate (n,)."""
    step = np.diff(t)
    whole = np.concatenate([[False], np.abs(step - np.median(step)) < 0.5 * np.median(step)])
    known = block >= 0
    for back in range(1, _REMEMBERED + 1):
        known[back:] &= whole[back:] & whole[1 : len(t) - back + 1]
        known[:back] = False
    at = np.flatnonzero(known)
    residual = observed - predicted
    driven, seen = np.abs(np.diff(p, prepend=p[0])), np.diff(predicted, axis=0, prepend=predicted[:1])
    moves = driven > _MOVES * max(float(np.quantile(driven, 0.99)), 1e-12)
    last = np.maximum.accumulate(np.where(moves, np.arange(len(t)), 0))
    per_unit = (seen / np.maximum(driven, 1e-9)[:, None])[last] * moves[last, None]
    return Frames(
        residual[at],
        observed[at] - observed[at - 1],
        np.gradient(predicted, t, axis=0)[at],
        np.diff(t, prepend=t[0])[at],
        driven[at],
        per_unit[at],
        observed[at],
        np.stack([residual[at - back] for back in range(1, _REMEMBERED + 1)], axis=-1),
        block[at],
    )


def weighed(parts: Sequence[Frames], floor: float, blocks: int) -> Scatter:
    """Losses and amounts of each explanation, its one number by maximum likelihood. parts: of each recording; floor:
    the noise of one coordinate; blocks: how many there are in all. Where no frame counts nothing is told of any."""
    if not any(len(part.block) for part in parts):
        told = (JITTER, STICK_SLIP, _AS_IT_IS, *RIVALS)
        return Scatter({name: np.zeros(blocks) for name in told}, dict.fromkeys((JITTER, STICK_SLIP, HELD), 0.0))
    frames = _Joined(parts, floor)
    speed, driven = frames.speed, frames.driven
    # finest: s in which a fast image moves as far as the noise; reach: what a fast motor drives between two frames
    finest = floor / max(float(np.quantile(speed, 0.9)), 1e-9)
    jittered, jitter_s = frames.likeliest(
        frames.jitter, np.geomspace(min(0.1 * finest, 0.1 * _LONGEST_S), _LONGEST_S, 41)
    )
    reach = max(float(np.quantile(driven, 0.99)), 1e-9)
    stuck, jump = frames.likeliest(frames.stick, np.geomspace(0.1 * reach, 30.0 * reach, 61))
    frozen, held = frames.likeliest(
        frames.repeats, np.array([0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 0.9])
    )
    log_densities = {
        JITTER: jittered,
        STICK_SLIP: stuck,
        _AS_IT_IS: frames.two_levels(frames.as_it_is),
        "level": frames.two_levels(frames.residual),
        "memory": frames.two_levels(frames.residual - frames.by_memory()),
        HELD: frozen,
        "pixels": frames.two_levels(frames.residual - _pixel_phase_part(frames.residual, frames.image)),
    }
    count = np.maximum(np.bincount(frames.block, minlength=blocks), 1)
    seen = np.bincount(frames.block, minlength=blocks) > 0
    # Less 1, the mean of square over variance: a Gaussian of variance v then gives log v.
    loss = {
        name: seen * (-2.0 / frames.coordinates * np.bincount(frames.block, x, minlength=blocks) / count - 1.0)
        for name, x in log_densities.items()
    }
    return Scatter(loss, {JITTER: jitter_s, STICK_SLIP: jump, HELD: held})


class _Joined:
    """The frames of all recordings, and the log-density (n,) of each under each explanation."""

    def __init__(self, parts: Sequence[Frames], floor: float) -> None:
        """parts: frames of each recording; floor: the noise of one coordinate."""

        def joined(of: Callable[[Frames], Array]) -> Array:
            return np.concatenate([of(part) for part in parts])

        # Sticking holds the tip back by half a jump in the mean: more of it than while calibrating widens the play.
        behind = np.concatenate([_fitted_lag(part.residual, part.per_unit) for part in parts])
        self.as_it_is, self.image = joined(lambda f: f.residual), joined(lambda f: f.image)
        self.residual = self.as_it_is - behind
        self._before = joined(lambda f: f.before) - behind[:, :, None]
        self._velocity, self._per_unit = joined(lambda f: f.velocity), joined(lambda f: f.per_unit)
        self._by_velocity = _along_and_across2(self.residual, self._velocity)
        self._by_way = _along_and_across2(self.residual, self._per_unit)
        self._steep2 = np.sum(self._per_unit**2, axis=1)
        self.driven, self._period = joined(lambda f: f.driven), joined(lambda f: f.period)
        self.block = np.concatenate([part.block for part in parts])
        self._recording = np.repeat(np.arange(len(parts)), [len(part.block) for part in parts])
        self.coordinates = self.residual.shape[1]
        self._floor2 = floor**2
        self.speed = np.linalg.norm(self._velocity, axis=1)
        self._moving = self.driven > _MOVES * max(float(np.quantile(self.driven, 0.99)), 1e-12)
        level = max(float(np.mean(self.residual**2)), self._floor2)
        self._broad = _isotropic(np.sum(self.residual**2, axis=1), level, self.coordinates)
        # The place of the frame before, both with their noise.
        moved = joined(lambda f: f.moved)
        self._repeated = _isotropic(np.sum(moved**2, axis=1), 2.0 * self._floor2, self.coordinates)

    def likeliest(self, family: Callable[[float], Array], scales: Array) -> tuple[Array, float]:
        """The log-density (n,) of the likeliest member of a family, with a broad share, and its scale. family: of a
        scale; scales: those to try."""
        tried = [self._with_broad(family(float(s))) for s in scales]
        chosen = int(np.argmax([float(np.sum(x)) for x in tried]))
        return tried[chosen], float(scales[chosen])

    def _with_broad(self, log_density: Array) -> Array:
        """A mixture with a broad density: of a share _BROAD of the frames nothing is said."""
        return np.asarray(np.logaddexp(np.log1p(-_BROAD) + log_density, np.log(_BROAD) + self._broad))

    def two_levels(self, left: Array) -> Array:
        """(n,) Log-density of residuals `left` (n, k) as Gaussian noise of one variance while the motor drives and
        another while it rests, for each recording, both estimated with outliers cut; a broad share is mixed in."""
        squares = np.sum(left**2, axis=1)
        variance = np.empty(len(left))
        for number in np.unique(self._recording):
            for part in (self._moving & (self._recording == number), ~self._moving & (self._recording == number)):
                if part.any():
                    here = squares[part] / self.coordinates
                    clipped = np.minimum(here, np.quantile(here, 0.97))
                    variance[part] = max(float(np.mean(clipped)), self._floor2)
        return self._with_broad(_isotropic(squares, variance, self.coordinates))

    def by_memory(self) -> Array:
        """(n, k) The part of the residual that the residuals of the frames before predict linearly."""
        n, k = self.residual.shape
        memory = np.linalg.lstsq(self._before.reshape(n * k, -1), self.residual.ravel(), rcond=None)[0]
        return np.asarray(self._before @ memory)

    def jitter(self, seconds: float) -> Array:
        """(n,) Log-density if frame times scatter by so many seconds, one standard deviation: the image then scatters
        along its motion in proportion to its speed."""
        along, across2 = self._by_velocity
        variance = self._floor2 + (seconds * self.speed) ** 2
        return _gaussian_along(along, across2, variance, self._floor2, self.coordinates)

    def stick(self, jump: float) -> Array:
        """(n,) Log-density of a tip that stays while the motor drives, with a probability that falls to 0 over a drive
        by `jump` (of the centre coordinate, unit of q), and else is anywhere within a jump of the prediction."""
        held = np.where(self.driven > 0.0, np.clip(1.0 - self.driven / jump, 0.01, 0.99), 0.99)
        variance = self._floor2 + self._steep2 * jump**2 / 12.0  # equation: of a uniform density
        along, across2 = self._by_way
        within = _gaussian_along(along, across2, variance, self._floor2, self.coordinates)
        return np.asarray(np.logaddexp(np.log(held) + self._repeated, np.log1p(-held) + within))

    def repeats(self, share: float) -> Array:
        """(n,) Log-density of a link that shows this share of the frames a second time, in place of the next ones."""
        # The fitted delay has taken up how late such images are in the mean.
        early = self.residual - share * self._velocity * self._period[:, None]
        steady = _isotropic(np.sum(early**2, axis=1), 2.0 * self._floor2, self.coordinates)
        return np.asarray(np.logaddexp(np.log(share) + self._repeated, np.log1p(-share) + steady))


def _isotropic(squares: Array, variance: Array | float, k: int) -> Array:
    """Log-density (n,) of an isotropic Gaussian in k coordinates, less its constant. squares: of the distance;
    variance: of a coordinate, one or (n,)."""
    return np.asarray(-0.5 * (k * np.log(variance) + squares / variance))


def _gaussian_along(along: Array, across2: Array, variance: Array, across_variance: float, k: int) -> Array:
    """Log-density (n,) of a Gaussian with `variance` along the motion and `across_variance` across it; across2: squared
    distance across."""
    value: Array = -0.5 * (np.log(variance) + along**2 / variance)
    if k > 1:
        value = value - 0.5 * (np.log(across_variance) + across2 / across_variance)
    return value


def _along_and_across2(r: Array, direction: Array) -> tuple[Array, Array]:
    """(n,) The component of r (n, k) along a direction (n, k) of any length, in the unit of r, and the square of what
    is across it."""
    unit = direction / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)[:, None]
    along = np.sum(r * unit, axis=1)
    return along, np.maximum(np.sum(r**2, axis=1) - along**2, 0.0)


def _fitted_lag(r: Array, per_unit: Array) -> Array:
    """(n, k) The part of a recording's residual that a constant lag of the centre coordinate along the motion
    explains."""
    length = float(np.sum(r * per_unit)) / max(float(np.sum(per_unit**2)), 1e-12)
    return length * per_unit


def _pixel_phase_part(r: Array, image: Array) -> Array:
    """(n, k) The part of the residual that the position within a pixel explains: two harmonics of each image
    coordinate."""
    explained = np.empty_like(r)
    for i, (left, x) in enumerate(zip(r.T, image.T, strict=True)):
        turns = 2.0 * np.pi * x
        waves = np.column_stack([f(n * turns) for n in (1, 2) for f in (np.sin, np.cos)])
        explained[:, i] = waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return explained
