"""What a stretch of evidence says of the law: a least-squares fit, one simulation at a time."""

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
    """Frames at which the tip was seen to move with the motor."""

    at: npt.NDArray[np.intp]  # among those seen
    way: Array  # +1 rising q, -1 falling

    def both(self, evidence: WindowKnots, law: Law) -> tuple[float, float] | None:
        """The range (low, high) of centre coordinates p, unit of q, in which frames were seen on the way up and on the
        way down; None where these do not overlap, or one of them has fewer than three frames."""
        y = law.place(evidence.c_deg[self.at])
        up, down = y[self.way > 0], y[self.way < 0]
        if len(up) < 3 or len(down) < 3:
            return None
        low, high = max(up.min(), down.min()), min(up.max(), down.max())
        return (float(low), float(high)) if high > low else None


def envelopes(evidence: WindowKnots, law: Law) -> Envelopes:
    """The frames at which the tip moved with the motor by about the law's slope, and so was on an envelope of the play;
    the first of each run is left out, as an onset may lie in it."""
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
    """A law fitted to evidence by least squares, `free` parameters of theta varying."""

    evidence: WindowKnots
    theta: Array
    free: tuple[int, ...]
    z: Array  # residuals over sigma of the frames seen
    cost: float  # robust, priors included
    covariance: Array  # (free, free)

    @cached_property
    def level(self) -> float:
        """rms of the residuals over sigma without the outliers' share: 1 where only the stated noise is left."""
        return trimmed(self.z)

    def spread_of(self, slopes: Array) -> float:
        """Standard deviation of a quantity whose derivatives by theta are `slopes` (PARAMETERS,)."""
        picked = slopes[list(self.free)]
        return float(np.sqrt(picked @ self.covariance @ picked))

    def sigma(self, parameter: int) -> float:
        """Standard deviation of the parameter with this index in theta, its unit; 0 where it was not free."""
        return float(np.sqrt(self.covariance[i, i])) if (i := _index(self.free, parameter)) >= 0 else 0.0


def _index(free: Sequence[int], parameter: int) -> int:
    """The place of a parameter among the free ones; -1 where it is not free."""
    return free.index(parameter) if parameter in free else -1


def trimmed(z: Array) -> float:
    """rms of residuals over sigma z (n,) without the share _WITHOUT that is largest; 0 where there are none."""
    if len(z) == 0:
        return 0.0
    squares = np.sort(np.minimum(z * z, 1e12))  # tolerance: sums of them are finite
    return float(np.sqrt(np.mean(squares[: max(1, int(np.ceil((1.0 - _WITHOUT) * len(z))))])))


@dataclass(frozen=True)
class Prior:
    """Independent normal deviations from `mean`; the shape's are smooth besides, and fade where it was not seen."""

    mean: Array
    sigma: Array
    known: npt.NDArray[np.bool_]  # (PLACES,) of the shape

    @classmethod
    def of(cls, mean: Array, span: float, span_deg: float, known: npt.NDArray[np.bool_]) -> Prior:
        """The prior about `mean`. span: the motor's range; span_deg: f_remain's over it; known (PLACES,): where both
        envelopes tell the shape."""
        sigma = np.full(PARAMETERS, 0.5)  # shares
        sigma[OFFSET], sigma[SCALE] = span, 2.0
        sigma[TIP] = span_deg, _BENT * span_deg, _BENT * span_deg
        return cls(mean, sigma, known)

    def information(self, free: Sequence[int]) -> Array:
        """Precision matrix (free, free). Neighbouring places of the shape differ by _NEIGHBOURS; where one was not seen
        it follows the nearer seen one with a decay of _FADES."""
        whole = np.diag(1.0 / self.sigma**2)
        bend = np.diff(np.eye(PLACES), axis=0) / _NEIGHBOURS
        for i in np.flatnonzero(~(self.known[1:] & self.known[:-1])):
            near, far = (i, i + 1) if self.known[: i + 1].any() else (i + 1, i)
            bend[i] = 0.0
            bend[i, [near, far]] = -_FADES / _FADED, 1.0 / _FADED
        whole[SHAPE, SHAPE] += bend.T @ bend
        part: Array = whole[np.ix_(free, free)]
        return part


def simulated(
    nominal: LawFamily, evidence: WindowKnots, theta: Array, with_slopes: bool = True
) -> Work[tuple[Array, Array]]:
    """Residuals over sigma (seen,) of the centre coordinate, and their derivatives (seen, PARAMETERS) by theta, or (0,
    PARAMETERS) without. Frames before every element was carried weigh less. Yields each piece's cost beforehand, us."""
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
    slopes[:, : TIP.start] = -by[0]
    slopes[:, TIP] = -(nominal.powers(y) / by_y).T
    slopes *= scale[:, None]
    return z, slopes


def _run_along_path(
    native: Any, elements: int, evidence: WindowKnots, theta: Array, start: float, with_slopes: bool
) -> Work[list[tuple[Array, ...]]]:
    """The native play's output along the motor's path in pieces, from the tip at `start`, unit of q: p, whether it
    moves and, with slopes, dp/dtheta. Yields each piece's cost beforehand, us."""
    state = _native.TrackState(start)
    q = evidence.q + theta[OFFSET]
    parts = []
    for first in range(0, len(q), _PIECE):
        part = q[first : first + _PIECE]
        yield 10 + (len(part) * (6 + 2 * elements) // 100 if with_slopes else len(part) // 12)
        parts.append(native.run(state, part, with_slopes))
    return list(zip(*parts, strict=True))


def _first_carried(nominal: LawFamily, evidence: WindowKnots, y: Array) -> int:
    """Index of the first seen frame at which the motor has moved far enough to have carried every element; their number
    where there is none. y (seen,): centre coordinates."""
    reach = REACH * float(np.interp(y[0], nominal.model.q, nominal.model.width))
    carried = np.abs(evidence.q - evidence.q[0]) > reach
    return int(np.searchsorted(evidence.seen, carried.argmax() if carried.any() else len(carried)))


def learn_beyond(nominal: LawFamily, evidence: WindowKnots, theta: Array, level: float) -> Work[LawFamily]:
    """The family with what these frames tell beyond the measured range, theta's law holding everywhere; as it was where
    none lies there. level: rms of residuals over sigma. Yields each piece's cost beforehand, us."""
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
    sure = slice(_first_carried(nominal, evidence, y), None)
    return nominal.with_frames(nominal, law, p[sure], by[sure, 1:], evidence.c_deg[sure], sigma[sure])


def fitted(
    nominal: LawFamily, evidence: WindowKnots, start: Array, free: tuple[int, ...], prior: Prior
) -> Work[LawFit]:
    """The law of least cost, parameters with the indices `free` varying, by Levenberg-Marquardt on Huber's cost with
    the prior, which counts in units of the residuals' level^2: what no law explains bends none. Yields each piece's
    cost beforehand, us."""
    picked = list(free)
    known = prior.information(picked)
    theta = nominal.clipped(start)
    z, by = yield from simulated(nominal, evidence, theta)
    information = known * _level2(z)
    algebra = 70 + len(z) * (3 + len(free)) // 300
    yield algebra
    cost = _huber_cost(z, theta, prior, picked, information)
    damping = 1e-3  # tolerance: to begin with
    for _ in range(_TURNS):
        if not free:
            break
        weight = OUTLYING / np.maximum(np.abs(z), OUTLYING)
        slopes = by[:, picked]
        away = (theta - prior.mean)[picked]
        normal = slopes.T @ (slopes * weight[:, None]) + information
        force = -(slopes.T @ (z * weight)) - information @ away
        damped = normal + damping * np.diag(np.diag(normal))
        step = np.linalg.solve(damped, force)
        trial = theta.copy()
        trial[picked] += step
        trial = nominal.clipped(trial)
        trial_z, trial_by = yield from simulated(nominal, evidence, trial)
        yield algebra
        trial_cost = _huber_cost(trial_z, trial, prior, picked, information)
        if trial_cost < cost:
            gained = cost - trial_cost
            theta, z, by = trial, trial_z, trial_by
            information = known * _level2(z)
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
    """Square of the level of residuals over sigma z (n,), that of the noise at least."""
    return max(1.0, trimmed(z)) ** 2


def _huber_cost(z: Array, theta: Array, prior: Prior, free: list[int], information: Array) -> float:
    """Half the Huber cost of the residuals plus half the prior's quadratic form."""
    size = np.abs(z)
    robust = np.where(size < OUTLYING, 0.5 * z * z, OUTLYING * (size - 0.5 * OUTLYING))
    away = (theta - prior.mean)[free]
    return float(np.sum(robust) + 0.5 * away @ information @ away)


def _covariance(
    nominal: LawFamily, evidence: WindowKnots, z: Array, slopes: Array, free: Sequence[int], information: Array
) -> Array:
    """Covariance (free, free) of the free parameters' estimate, by residuals over sigma z (seen,) and their derivatives
    by theta, slopes (seen, PARAMETERS): of the frames' own noise; of what the law leaves beyond that (`_misfit2`),
    which is taken for one error of all frames on each side of the play (it most likely goes with place and side, so
    that more frames make it no smaller); and of the prior, `information` in units of the residuals' squares."""
    picked = slopes[:, list(free)]
    if not free:
        return np.zeros((0, 0))
    told = picked.T @ picked
    inverse = np.linalg.inv(told + information)
    level2, noise2 = _level2(z), evidence.noise**2
    misfit2 = _misfit2(nominal, evidence, level2, float(np.trace(inverse @ told)))
    by_width = slopes[:, SCALE]
    sides = np.stack([picked[by_width > 0.0].sum(axis=0), picked[by_width < 0.0].sum(axis=0)])
    spread = noise2 * told + misfit2 * (sides.T @ sides) + level2 * information
    return np.asarray(inverse @ spread @ inverse)


def _misfit2(nominal: LawFamily, evidence: WindowKnots, level2: float, taken: float) -> float:
    """Variance, over that stated of a frame, of what a law leaves beyond the frames' own noise. level2: mean square
    that is left. A fit has made it small: it is over as many degrees of freedom as misfits have on such a way, one a
    stroke and one each _ALIKE of the measured range, less those that the fit took (`taken`)."""
    alike = _ALIKE * float(np.ptp(nominal.places))
    values = len(evidence.strokes) + float(np.abs(np.diff(evidence.q)).sum()) / alike
    return max(level2 - evidence.noise**2, 0.0) * values / max(values - taken, 1.0)


def from_envelopes(nominal: LawFamily, evidence: WindowKnots, theta: Array, envelope: Envelopes, both: bool) -> Array:
    """theta with the offset, and with `both` also the scale, as a start for a fit: a line is fitted to the frames on an
    envelope, where way (q - y) = scale B/2 - way offset, by least absolute deviations, in which outliers count little
    (iteratively reweighted least squares). y: centre coordinates by theta's law, unit of q. B is the calibrated one at
    y + median(q - y), about where the motor was: another posture's offset is behind the play, so that the tip is seen
    elsewhere and the play is where it was."""
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
    """theta with its offset behind the play (a shift of f_remain) instead of before it."""
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
