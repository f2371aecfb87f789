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

from tautline.diagnosis.fit import Fit, Fitter

Array = npt.NDArray[np.float64]

STICK_SLIP, JITTER, HELD = "transmission.stick_slip", "acquisition.jitter", "acquisition.held_samples"
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
    """Of what a fit leaves; labels: blocks of each recording's scored observations. only_tests: the calibration has
    none of it; its blocks' losses are zero."""
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
    """Of one recording; block -1: not scored."""
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
    """floor: the noise of one coordinate."""

    def joined(of: Callable[[Frames], Array]) -> Array:
        return np.concatenate([of(part) for part in parts])

    # Sticking holds the tip back by half a jump in the mean: more of it than while calibrating widens the play.
    behind = np.concatenate([_mean_along(part.residual, part.per_unit) for part in parts])
    as_it_is, moved = joined(lambda f: f.residual), joined(lambda f: f.moved)
    r, before = as_it_is - behind, joined(lambda f: f.before) - behind[:, :, None]
    velocity, per_unit = joined(lambda f: f.velocity), joined(lambda f: f.per_unit)
    driven, period = joined(lambda f: f.driven), joined(lambda f: f.period)
    block = np.concatenate([part.block for part in parts])
    recording = np.repeat(np.arange(len(parts)), [len(part.block) for part in parts])
    n, k = r.shape
    f2 = floor**2
    speed = np.linalg.norm(velocity, axis=1)
    along, across2 = _split(r, velocity)
    moving = driven > _MOVES * max(float(np.quantile(driven, 0.99)), 1e-12)
    broad = _isotropic(np.sum(r**2, axis=1), max(float(np.mean(r**2)), f2), k)

    def with_broad(log_density: Array) -> Array:
        return np.asarray(np.logaddexp(np.log1p(-_BROAD) + log_density, np.log(_BROAD) + broad))

    def best(family: Callable[[float], Array], scales: Array) -> tuple[Array, float]:
        tried = [with_broad(family(float(s))) for s in scales]
        chosen = int(np.argmax([float(np.sum(x)) for x in tried]))
        return tried[chosen], float(scales[chosen])

    def two_levels(left: Array) -> Array:
        """Of each recording one variance while the motor drives, another while it does not, both told robustly."""
        squares = np.sum(left**2, axis=1)
        variance = np.empty(n)
        for number in range(len(parts)):
            for part in (moving & (recording == number), ~moving & (recording == number)):
                if part.any():
                    here = squares[part] / k
                    variance[part] = max(float(np.mean(np.minimum(here, np.quantile(here, 0.97)))), f2)
        return with_broad(_isotropic(squares, variance, k))

    memory = np.linalg.lstsq(before.reshape(n * k, -1), r.ravel(), rcond=None)[0]
    repeated = _isotropic(np.sum(moved**2, axis=1), 2.0 * f2, k)  # the place of before, both with their noise

    def jitter(seconds: float) -> Array:
        variance = f2 + (seconds * speed) ** 2
        return _apart(along, across2, variance, f2, k)

    def stick(jump: float) -> Array:
        held = np.where(driven > 0.0, np.clip(1.0 - driven / jump, 0.01, 0.99), 0.99)
        variance = f2 + np.sum(per_unit**2, axis=1) * jump**2 / 12.0
        within = _apart(*_split(r, per_unit), variance, f2, k)
        return np.asarray(np.logaddexp(np.log(held) + repeated, np.log1p(-held) + within))

    def repeats(share: float) -> Array:
        # The fitted delay has taken up how late such images are in the mean.
        early = r - share * velocity * period[:, None]
        steady = _isotropic(np.sum(early**2, axis=1), 2.0 * f2, k)
        return np.asarray(np.logaddexp(np.log(share) + repeated, np.log1p(-share) + steady))

    finest = floor / max(float(np.quantile(speed, 0.9)), 1e-9)
    jittered, jitter_s = best(jitter, np.geomspace(min(0.1 * finest, 0.1 * _LONGEST_S), _LONGEST_S, 41))
    reach = max(float(np.quantile(driven, 0.99)), 1e-9)
    stuck, jump = best(stick, np.geomspace(0.1 * reach, 30.0 * reach, 61))
    frozen, held = best(repeats, np.array([0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.65, 0.8, 0.9]))
    told = {
        JITTER: jittered,
        STICK_SLIP: stuck,
        "as it is": two_levels(as_it_is),
        "level": two_levels(r),
        "memory": two_levels(r - before @ memory),
        HELD: frozen,
        "pixels": two_levels(r - _of_place_in_pixel(r, joined(lambda f: f.image))),
    }
    count = np.maximum(np.bincount(block, minlength=blocks), 1)
    seen = np.bincount(block, minlength=blocks) > 0
    loss = {name: seen * (-2.0 / k * np.bincount(block, x, minlength=blocks) / count - 1.0) for name, x in told.items()}
    return Scatter(loss, {JITTER: jitter_s, STICK_SLIP: jump, HELD: held})


def _isotropic(squares: Array, variance: Array | float, k: int) -> Array:
    return np.asarray(-0.5 * (k * np.log(variance) + squares / variance))


def _apart(along: Array, across2: Array, variance: Array, across_variance: float, k: int) -> Array:
    """Gaussian with its own variance along the motion."""
    value: Array = -0.5 * (np.log(variance) + along**2 / variance)
    if k > 1:
        value = value - 0.5 * (np.log(across_variance) + across2 / across_variance)
    return value


def _split(r: Array, direction: Array) -> tuple[Array, Array]:
    """(n,) along a direction, and squared across it."""
    unit = direction / np.maximum(np.linalg.norm(direction, axis=1), 1e-9)[:, None]
    along = np.sum(r * unit, axis=1)
    return along, np.maximum(np.sum(r**2, axis=1) - along**2, 0.0)


def _mean_along(r: Array, per_unit: Array) -> Array:
    """(n, k): what one length along the motion explains of a recording's residual."""
    length = float(np.sum(r * per_unit)) / max(float(np.sum(per_unit**2)), 1e-12)
    return length * per_unit


def _of_place_in_pixel(r: Array, image: Array) -> Array:
    """(n, k): what the place within a pixel explains of each coordinate: two harmonics."""
    explained = np.empty_like(r)
    for i, (left, x) in enumerate(zip(r.T, image.T, strict=True)):
        turns = 2.0 * np.pi * x
        waves = np.column_stack([f(n * turns) for n in (1, 2) for f in (np.sin, np.cos)])
        explained[:, i] = waves @ np.linalg.lstsq(waves, left, rcond=None)[0]
    return explained
