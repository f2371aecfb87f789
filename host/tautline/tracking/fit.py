"""Fits of a law's parameters theta to a stretch of evidence by least squares, in pieces of work of known cost."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from tautline import _native
from tautline.tracking.beyond import OUTLYING, PLACES
from tautline.tracking.law import OFFSET, PARAMETERS, SCALE, SHAPE, SKEW, SPREAD, TIP, Law, LawFamily
from tautline.tracking.window import WindowKnots

Array = npt.NDArray[np.float64]
Found = TypeVar("Found")
# Before each piece it yields what that piece costs at most, us, as measured on a busy machine: so much for itself, and
# so much for its frames or knots. Work is counted by these numbers, not timed, so that a replay repeats.
Work = Generator[int, None, Found]

_TURNS = 8  # tolerance: steps, after which what is left to gain waits for the next judgement
_NEIGHBOURS = 0.21  # prior: of B: how far its share at one place is from that at the next
_BENT = 0.1  # prior: of f_remain's range, that its slope or bend has changed by at the ends
_FADES, _FADED = 0.7, 0.06  # prior: of what it has become at one place, beside it where it was not seen; and how surely
_DONE = 1e-3  # tolerance: of cost: steps that gain less
FOLLOWS, AHEAD = 0.5, 3.0  # limit: of the motor's way: on an envelope the tip moves by 1 / (1 +- B'/2), |B'| < 2
SURE = 2.5  # loss: standard deviations that a motion between two frames must have, and a tip be ahead both ways
_WITHOUT = 0.03  # prior: of the frames: left out of a rms, as outliers
REACH, _UNSURE = 1.8, 0.3  # prior: of B, that carries every element; until then a frame tells so much
_ALIKE = 0.25  # prior: of the measured range, along which a misfit is alike
_PIECE = 400  # tolerance: knots simulated at once
_LINE_STEPS, _ON_LINE = 4, 1e-3  # tolerance: of a line's weights; of the places' range: frames nearer to it weigh alike


@dataclass(frozen=True)
class Envelopes:
    """Frames at which the tip was seen to move with the motor: it was on an envelope of the play, p +- B(p)/2 = q."""

    at: npt.NDArray[np.intp]  # indices among the frames seen
    way: Array  # +1 rising q, -1 falling

    def range_both_ways(self, evidence: WindowKnots, law: Law) -> tuple[float, float] | None:
        """The range (low, high) of centre coordinates p, unit of q, in which frames on an envelope were seen on the way
        up and on the way down; None where the two ranges do not overlap, or one has fewer than three frames."""
        y = law.place(evidence.c_deg[self.at])
        up, down = y[self.way > 0], y[self.way < 0]
        if len(up) < 3 or len(down) < 3:
            return None
        low, high = max(up.min(), down.min()), min(up.max(), down.max())
        return (float(low), float(high)) if high > low else None


def envelopes(evidence: WindowKnots, law: Law) -> Envelopes:
    """Finds the frames at which the tip moved with the motor, and so was on an envelope of the play: since the frame
    before, of the same stroke, the motor moved clearly, and the tip's centre coordinate by FOLLOWS to AHEAD times as
    much. The first frame of each run is left out, as an onset may lie in it."""
    q, y = evidence.q[evidence.seen], law.place(evidence.c_deg)
    sigma = evidence.sigma / np.abs(law.slope(y))
    by_q, by_y = np.diff(q), np.diff(y)
    sure = SURE * np.hypot(sigma[1:], sigma[:-1])
    moves = (evidence.stroke[1:] == evidence.stroke[:-1]) & (np.abs(by_q) > sure)
    moves &= (by_y * np.sign(by_q) > FOLLOWS * np.abs(by_q)) & (np.abs(by_y) < AHEAD * np.abs(by_q))
    moves[1:] &= moves[:-1]  # the first one may hold an onset
    if len(moves):
        moves[0] = False
    at = np.flatnonzero(moves) + 1
    return Envelopes(at, np.sign(by_q[at - 1]))


@dataclass(frozen=True)
class LawFit:
    """A law fitted to evidence: parameters of theta with the indices `free` were varied, the others kept."""

    evidence: WindowKnots
    theta: Array
    free: tuple[int, ...]
    z: Array  # (seen,) residuals over sigma
    cost: float  # Huber's, with the prior's
    covariance: Array  # (free, free)

    @cached_property
    def level(self) -> float:
        """rms of the residuals over sigma, without outliers (`trimmed_rms`): 1 where only the stated noise is left."""
        return trimmed_rms(self.z)

    def spread_of(self, slopes: Array) -> float:
        """Standard deviation of a quantity whose derivatives by theta are `slopes` (PARAMETERS,), by the fit's
        covariance."""
        picked = slopes[list(self.free)]
        return float(np.sqrt(picked @ self.covariance @ picked))

    def sigma(self, parameter: int) -> float:
        """Standard deviation of the parameter with this index in theta, in its unit; 0 where it was not free."""
        return float(np.sqrt(self.covariance[i, i])) if (i := _index(self.free, parameter)) >= 0 else 0.0


def _index(free: Sequence[int], parameter: int) -> int:
    """The position of a parameter's index in `free`; -1 where it is not free."""
    return free.index(parameter) if parameter in free else -1


def trimmed_rms(z: Array) -> float:
    """rms of residuals over sigma z (n,) without the share _WITHOUT of them that is largest; 0 where there are none."""
    if len(z) == 0:
        return 0.0
    squares = np.sort(np.minimum(z * z, 1e12))  # tolerance: sums of them are finite
    return float(np.sqrt(np.mean(squares[: max(1, int(np.ceil((1.0 - _WITHOUT) * len(z))))])))


@dataclass(frozen=True)
class Prior:
    """The prior of theta in a fit: independent normal deviations from `mean` with standard deviations `sigma`. For the
    shape of B, neighbouring places are tied to each other, too (`information`)."""

    mean: Array
    sigma: Array
    known: npt.NDArray[np.bool_]  # (PLACES,) whether the evidence tells the shape there

    @classmethod
    def about(cls, mean: Array, span: float, span_deg: float, known: npt.NDArray[np.bool_]) -> Prior:
        """The prior about `mean` (PARAMETERS,). span: the motor's range, unit of q; span_deg: how much f_remain changes
        over it, deg; known (PLACES,): at which places the evidence tells the shape of B."""
        sigma = np.full(PARAMETERS, 0.5)  # shares of B: of shape, spread and skew
        sigma[OFFSET], sigma[SCALE] = span, 2.0
        sigma[TIP] = span_deg, _BENT * span_deg, _BENT * span_deg
        return cls(mean, sigma, known)

    def information(self, free: Sequence[int]) -> Array:
        """Precision matrix (free, free) of the parameters with the indices `free`. Neighbouring places of the shape
        differ by a standard deviation of _NEIGHBOURS. Where one of two is not known, the one that is farther from the
        known places is _FADES times the nearer one, within _FADED."""
        precision = np.diag(1.0 / self.sigma**2)
        ties = np.diff(np.eye(PLACES), axis=0) / _NEIGHBOURS  # each row: of one place to the next, over its sigma
        for i in np.flatnonzero(~(self.known[1:] & self.known[:-1])):
            near, far = (i, i + 1) if self.known[: i + 1].any() else (i + 1, i)
            ties[i] = 0.0
            ties[i, [near, far]] = -_FADES / _FADED, 1.0 / _FADED
        precision[SHAPE, SHAPE] += ties.T @ ties
        of_free: Array = precision[np.ix_(free, free)]
        return of_free


def simulated_residuals(
    nominal: LawFamily, evidence: WindowKnots, theta: Array, with_slopes: bool = True
) -> Work[tuple[Array, Array]]:
    """Simulates the evidence with theta; returns the residuals (seen,) of the centre coordinate, seen less predicted,
    over their sigmas, and their derivatives (seen, PARAMETERS) by theta, or an empty array (0, PARAMETERS) without
    slopes. Frames before the motor carried every element of the play weigh less. Yields each piece's cost beforehand,
    us."""
    seen = evidence.seen
    yield 110 + len(seen) // 20
    law = nominal.law(theta)
    y = law.place(evidence.c_deg)
    by_y = law.slope(y)
    scale = 1.0 / nominal.sigma(y, evidence.sigma / by_y)
    scale[: _first_carried(nominal, evidence, y)] *= _UNSURE
    parts = yield from _run_along_path(law.native, law.elements, evidence, theta, float(y[0]), with_slopes)
    yield 15 + len(seen) // (12 if with_slopes else 200)
    p, _, *by = (np.concatenate(column)[seen] for column in parts)
    z = (y - p) * scale
    if not with_slopes:
        return z, np.empty((0, PARAMETERS))
    slopes = np.empty((len(y), PARAMETERS))
    slopes[:, : TIP.start] = -by[0]  # of -p: of the play's own parameters
    slopes[:, TIP] = -(nominal.powers(y) / by_y).T  # of y: what is added to f_remain shifts y by that over its slope
    slopes *= scale[:, None]
    return z, slopes


def _run_along_path(
    play: Any, elements: int, evidence: WindowKnots, theta: Array, start: float, with_slopes: bool
) -> Work[list[tuple[Array, ...]]]:
    """Runs a native play along the motor's path in pieces, from the tip at `start`, unit of q. Returns columns, each a
    tuple of one array per piece: p (n,), unit of q; whether the motor carries it (n,); with slopes, the derivatives of
    p (n, k), first by the offset. Yields each piece's cost beforehand, us."""
    state = _native.TrackState(start)
    q = evidence.q + theta[OFFSET]
    parts = []
    for first in range(0, len(q), _PIECE):
        part = q[first : first + _PIECE]
        yield 10 + (len(part) * (6 + 2 * elements) // 100 if with_slopes else len(part) // 12)
        parts.append(play.run(state, part, with_slopes))
    return list(zip(*parts, strict=True))


def _first_carried(nominal: LawFamily, evidence: WindowKnots, y: Array) -> int:
    """Index of the first of the frames seen at which the motor has gone so far that it has carried every element of the
    play; the number of frames if it never has. y (seen,): centre coordinates, unit of q."""
    reach = REACH * float(np.interp(y[0], nominal.model.q, nominal.model.width))
    carried = np.abs(evidence.q - evidence.q[0]) > reach
    return int(np.searchsorted(evidence.seen, carried.argmax() if carried.any() else len(carried)))


def learn_beyond(nominal: LawFamily, evidence: WindowKnots, theta: Array, level: float) -> Work[LawFamily]:
    """Returns the family with what these frames tell of f_remain and B beyond the measured range, where theta's law is
    taken to hold everywhere; `nominal` itself where no frame lies there. level: rms of residuals over sigma that the
    law leaves. Yields each piece's cost beforehand, us."""
    seen = evidence.seen
    yield 150 + len(seen) // 20
    law = nominal.law(theta)
    y = law.place(evidence.c_deg)
    if not nominal.beyond.curves(y).any():
        return nominal
    parts = yield from _run_along_path(law.followed, law.elements, evidence, theta, float(y[0]), True)
    yield 300
    p, _, by = (np.concatenate(column)[seen] for column in parts)
    sigma = level * nominal.sigma(y, evidence.sigma / law.slope(y)) * np.abs(law.slope(y))
    carried = slice(_first_carried(nominal, evidence, y), None)  # before, where the elements are is not sure
    by_width = by[carried, 1:]  # the first column is by the offset
    return nominal.with_frames(nominal, law, p[carried], by_width, evidence.c_deg[carried], sigma[carried])


def fit_law(
    nominal: LawFamily, evidence: WindowKnots, start: Array, free: tuple[int, ...], prior: Prior
) -> Work[LawFit]:
    """Fits a law to evidence: varies the parameters with the indices `free` from `start` on, in at most _TURNS steps of
    Levenberg and Marquardt, to minimise Huber's cost of the residuals plus the prior's. The prior's precision is
    multiplied by the residuals' mean square (`_level2`), so that residuals that no law explains do not outweigh it.
    Yields each piece's cost beforehand, us."""
    picked = list(free)
    of_prior = prior.information(picked)
    theta = nominal.clipped(start)
    z, by = yield from simulated_residuals(nominal, evidence, theta)
    information = of_prior * _level2(z)
    algebra = 70 + len(z) * (3 + len(free)) // 300  # us
    yield algebra
    cost = _huber_cost(z, theta, prior, picked, information)
    damping = 1e-3  # tolerance: to begin with
    for _ in range(_TURNS):
        if not free:
            break
        weight = OUTLYING / np.maximum(np.abs(z), OUTLYING)  # Huber's: 1 up to OUTLYING standard deviations
        slopes = by[:, picked]
        away = (theta - prior.mean)[picked]
        normal = slopes.T @ (slopes * weight[:, None]) + information
        descent = -(slopes.T @ (z * weight)) - information @ away  # the cost's gradient, negative
        damped = normal + damping * np.diag(np.diag(normal))
        step = np.linalg.solve(damped, descent)
        trial = theta.copy()
        trial[picked] += step
        trial = nominal.clipped(trial)
        trial_z, trial_by = yield from simulated_residuals(nominal, evidence, trial)
        yield algebra
        trial_cost = _huber_cost(trial_z, trial, prior, picked, information)
        if trial_cost < cost:
            gained = cost - trial_cost
            theta, z, by = trial, trial_z, trial_by
            information = of_prior * _level2(z)
            cost = _huber_cost(z, theta, prior, picked, information)
            damping *= 0.1  # tolerance: of Levenberg and Marquardt's steps
            if gained < _DONE:
                break
        else:
            damping *= 10.0  # tolerance: the same
            if damping > 1e4:  # tolerance: no step is short enough
                break
    yield 2 * algebra + 40
    return LawFit(evidence, theta, free, z, cost, _covariance(nominal, evidence, z, by, free, information))


def _level2(z: Array) -> float:
    """Mean square of residuals over sigma z (n,) without outliers, but at least 1, that of the stated noise."""
    return max(1.0, trimmed_rms(z)) ** 2


def _huber_cost(z: Array, theta: Array, prior: Prior, free: list[int], information: Array) -> float:
    """Half the Huber cost of residuals over sigma z (n,) plus half the prior's quadratic form of the free parameters'
    deviations. information (free, free): the prior's precision."""
    size = np.abs(z)
    robust = np.where(size < OUTLYING, 0.5 * z * z, OUTLYING * (size - 0.5 * OUTLYING))
    away = (theta - prior.mean)[free]
    return float(np.sum(robust) + 0.5 * away @ information @ away)


def _covariance(
    nominal: LawFamily, evidence: WindowKnots, z: Array, slopes: Array, free: Sequence[int], information: Array
) -> Array:
    """Covariance (free, free) of the fitted parameters, A S A with A = (J^T J + information)^-1; J (seen, free) from
    `slopes` (seen, PARAMETERS), the derivatives of the residuals over sigma z (seen,) by theta; information (free,
    free): the prior's. S adds up three variances: of the frames' own noise; of what the law leaves beyond it
    (`_misfit2`), taken for one error that all frames on one side of the play share, so that more frames make it no
    smaller; of the prior, in units of the residuals' squares."""
    picked = slopes[:, list(free)]
    if not free:
        return np.zeros((0, 0))
    by_frames = picked.T @ picked
    inverse = np.linalg.inv(by_frames + information)
    level2, noise2 = _level2(z), evidence.noise**2
    misfit2 = _misfit2(nominal, evidence, level2, float(np.trace(inverse @ by_frames)))
    by_width = slopes[:, SCALE]  # its sign tells the side of the play
    sides = np.stack([picked[by_width > 0.0].sum(axis=0), picked[by_width < 0.0].sum(axis=0)])
    spread = noise2 * by_frames + misfit2 * (sides.T @ sides) + level2 * information
    return np.asarray(inverse @ spread @ inverse)


def _misfit2(nominal: LawFamily, evidence: WindowKnots, level2: float, taken: float) -> float:
    """Variance, in units of a frame's stated one, of what a law leaves beyond the frames' own noise: (level2 - noise^2)
    n / (n - taken). level2: the mean square that is left, which the fit made small. n: in how many places misfits
    differ, one for each stroke and one for each _ALIKE of the measured range on the motor's way; taken: degrees of
    freedom that the fit used of them."""
    alike = _ALIKE * float(np.ptp(nominal.places))
    count = len(evidence.strokes) + float(np.abs(np.diff(evidence.q)).sum()) / alike
    return max(level2 - evidence.noise**2, 0.0) * count / max(count - taken, 1.0)


def start_from_envelopes(
    nominal: LawFamily, evidence: WindowKnots, theta: Array, envelope: Envelopes, both: bool
) -> Array:
    """Returns theta with a start for a fit of the offset, with `both` of the scale, too, from the frames on an
    envelope. There, way (q - y) = scale B/2 - way offset; the line is fitted by least absolute deviations, which
    outliers move little (iteratively reweighted least squares). y: centre coordinates by theta's law, unit of q. B is
    the calibrated one at y + median(q - y), about where the motor was: an offset of another posture is behind the play,
    so that the tip is seen elsewhere while the play is where it was. theta is copied unchanged if no frame is on an
    envelope."""
    theta = theta.copy()
    if len(envelope.at) == 0:
        return theta
    law = nominal.law(theta)
    seen_q = evidence.q[evidence.seen]  # q is of every knot of the motor's path, c_deg of those alone that a frame saw
    q, y = seen_q[envelope.at], law.place(evidence.c_deg[envelope.at])
    half = 0.5 * np.interp(y + float(np.median(q - y)), nominal.model.q, nominal.model.width)
    if not both:
        theta[OFFSET] = float(np.median(y - q + envelope.way * theta[SCALE] * half))
        return theta
    design = np.column_stack([half, -envelope.way])  # of scale and offset
    right = envelope.way * (q - y)
    weight = np.ones(len(y))
    for _ in range(_LINE_STEPS):
        weighted = design.T * weight**2
        solution = np.linalg.lstsq(weighted @ design, weighted @ right, rcond=None)[0]  # B may be 0
        off = np.abs(right - design @ solution)
        weight = 1.0 / np.sqrt(np.maximum(off, _ON_LINE * np.ptp(y) + 1e-9))
    theta[SCALE], theta[OFFSET] = float(solution[0]), float(solution[1])
    return nominal.clipped(theta)


def with_offset_at_tip(nominal: LawFamily, theta: Array) -> Array:
    """Returns theta with its offset moved from before the play to behind it, where it is a shift of f_remain."""
    theta = theta.copy()
    theta[TIP.start] += theta[OFFSET] * nominal.tip_slope
    theta[OFFSET] = 0.0
    return theta


_TIP = TIP.start
# Where the offset is, before the play or behind it.
BOTH = ((OFFSET, SCALE), (SCALE, _TIP))
ONLY_OFFSET = ((OFFSET,), (_TIP,))
ONLY_SCALE = (SCALE,)
# What may come with an offset and a scale.
GRADUAL = (SPREAD, SKEW)
SHAPED = tuple(range(SHAPE.start, SHAPE.stop))
REMAINING = (_TIP, _TIP + 1, _TIP + 2)
