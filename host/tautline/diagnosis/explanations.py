"""The frames of recordings that tell of events, and the log-density of each under every explanation of its scatter.

An explanation is a density of a frame's observation given the frames before it (scatter.py says which there are and
compares them). Many are families with one number, whose likeliest member counts.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.linalg import solveh_banded
from scipy.special import gammaincinv, log_ndtr

from tautline import _native
from tautline.coarse_grid import least_of
from tautline.core.samples import period_s, waits_s

Array = npt.NDArray[np.float64]

_MOVES = 0.02  # tolerance: share of the fastest drive from frame to frame: slower is at rest
_REMEMBERED = 3  # tolerance: frames that the rival "memory" reaches back
_BROAD = 0.03  # prior: share of frames that follow no model
_GAP = 2.5  # tolerance: frame periods: after a longer interval the frames before tell nothing
_FAST = 0.99  # tolerance: quantile of a fast drive
_LEAST, _MOST = 0.01, 0.99  # prior: limits of the probability that a tip sticks
_OUTLIERS = 0.97  # tolerance: quantile to which squared residuals are cut where a noise level is estimated
_PLACES = 96  # prior: places along the range at which a misfit may be another
_RIDGE = 1e-9  # tolerance: of a frame: for rounding
_DISTURBED_EVERY_S, _DISTURBED_S = 3.0, 0.5  # prior: mean time until frames are disturbed, and for which they are
_STICKS_S = 2.0  # prior: s: mean time until a tip begins to stick and jump, and for which it does
_DISTURBANCES = np.geomspace(0.3, 300.0, 16)  # prior: grid of standard deviations of disturbed frames, times the noise
_NEVER = -1e6  # tolerance: the log-density of what cannot be


@dataclass(frozen=True)
class Frames:
    """The n frames of a recording that count: those that are scored and whose _REMEMBERED predecessors arrived without
    a gap."""

    residual: Array  # (n, k) observed less predicted, px or deg
    moved: Array  # (n, k) observed, from the frame before
    velocity: Array  # (n, k) predicted, per second
    waited_s: Array  # (n,) by what its time of arrival says of when it was taken (`waits_s`)
    driven: Array  # (n,) by how much the play's centre moved since the frame before, unit of q
    place: Array  # (n,) the play's centre, unit of q
    way: Array  # (n,) sign of the centre's motion, at rest that of the last motion; 0 until it moves
    per_unit: Array  # (n, k) predicted image motion per unit of `driven`; at rest as in the last motion
    image: Array  # (n, k) observed
    before: Array  # (n, k, _REMEMBERED) residuals of the frames before
    period_s: float  # the usual one, from frame to frame
    follows: npt.NDArray[np.bool_]  # (n,) whether the one before it among these is the frame before
    block: npt.NDArray[np.int64]  # (n,) the number of the block of manoeuvres
    calibration: npt.NDArray[np.bool_]  # (n,) whether it is one of the calibration


def frames(
    t: Array, observed: Array, predicted: Array, p: Array, block: npt.NDArray[np.int64], calibration: bool = False
) -> Frames:
    """Collects the frames of one recording that count. t: arrival times (n,), s, rising; observed, predicted: (n, k),
    px or deg; p: the play's centre (n,), unit of q; block: (n,) the number of the block, -1 for frames that are not
    scored; calibration: whether this is the calibration's recording."""
    follows = np.concatenate([[False], np.diff(t) < _GAP * period_s(t)])  # the frame before
    counts = block >= 0
    for back in range(1, _REMEMBERED + 1):
        counts[back:] &= follows[back:] & follows[1 : len(t) - back + 1]
        counts[:back] = False
    kept = np.flatnonzero(counts)
    residual = observed - predicted
    driven, image_motion = np.abs(np.diff(p, prepend=p[0])), np.diff(predicted, axis=0, prepend=predicted[:1])
    moves = driven > _MOVES * max(float(np.quantile(driven, _FAST)), 1e-12)
    last_moving = np.maximum.accumulate(np.where(moves, np.arange(len(t)), 0))
    per_unit = (image_motion / np.maximum(driven, 1e-9)[:, None])[last_moving] * moves[last_moving, None]
    way = (np.sign(np.diff(p, prepend=p[0])) * moves)[last_moving]
    return Frames(
        residual=residual[kept],
        moved=observed[kept] - observed[kept - 1],
        velocity=np.gradient(predicted, t, axis=0)[kept],
        waited_s=waits_s(t)[kept],
        driven=driven[kept],
        place=p[kept],
        way=way[kept],
        per_unit=per_unit[kept],
        image=observed[kept],
        before=np.stack([residual[kept - back] for back in range(1, _REMEMBERED + 1)], axis=-1),
        period_s=period_s(t),
        follows=np.diff(kept, prepend=-2) == 1,
        block=block[kept],
        calibration=np.full(len(kept), calibration),
    )


class Joined:
    """The n frames of all recordings, and their log-density (n,) under each explanation. Residuals are `as_it_is`, or
    `residual` after a constant lag of each recording is taken off."""

    def __init__(self, parts: Sequence[Frames], floor: float) -> None:
        """parts: the frames of each recording; floor: one standard deviation of the noise of a coordinate, px or
        deg."""

        def joined(field: Callable[[Frames], Array]) -> Array:
            """One field of the frames, concatenated over all recordings."""
            return np.concatenate([field(part) for part in parts])

        # Sticking holds the tip back by half a jump in the mean: this lag of each recording is taken off first.
        lag = np.concatenate([_fitted_lag(part.residual, part.per_unit) for part in parts])
        self.as_it_is, self.image = joined(lambda f: f.residual), joined(lambda f: f.image)
        self.residual = self.as_it_is - lag
        self._before = joined(lambda f: f.before) - lag[:, :, None]
        self._velocity, self._per_unit = joined(lambda f: f.velocity), joined(lambda f: f.per_unit)
        self._waited_s = joined(lambda f: f.waited_s)
        self._by_velocity = _along_and_across2(self.residual, self._velocity)
        self._by_direction = _along_and_across2(self.residual, self._per_unit)
        self._per_unit2 = np.sum(self._per_unit**2, axis=1)
        self.driven = joined(lambda f: f.driven)
        self._place, self._way = joined(lambda f: f.place), joined(lambda f: f.way)
        self.block = np.concatenate([part.block for part in parts])
        self._calibration = np.concatenate([part.calibration for part in parts])
        self._recording = np.repeat(np.arange(len(parts)), [len(part.block) for part in parts])
        self.coordinates = self.residual.shape[1]
        self._floor2 = floor**2
        self.speed = np.linalg.norm(self._velocity, axis=1)
        self._moving = self.driven > _MOVES * max(float(np.quantile(self.driven, _FAST)), 1e-12)
        power = max(float(np.mean(self.residual**2)), self._floor2)
        self._broad = _isotropic_log_density(np.sum(self.residual**2, axis=1), power, self.coordinates)
        self._begins = ~np.concatenate([part.follows for part in parts])
        self._periods_s = [part.period_s for part in parts]
        # Log-densities of an observation that is where that of the frame before was, or twice as far from there as
        # predicted; both frames have the noise floor^2.
        moved = joined(lambda f: f.moved)
        doubled = moved - 2.0 * (moved - self.residual + self._before[:, :, 0])
        self._repeated, self._doubled = (
            _isotropic_log_density(np.sum(off**2, axis=1), 2.0 * self._floor2, self.coordinates)
            for off in (moved, doubled)
        )

    @property
    def fast_drive(self) -> float:
        """A fast drive of the play's centre, unit of q from frame to frame."""
        return max(float(np.quantile(self.driven, _FAST)), 1e-9)

    def likeliest(self, family: Callable[[float], Array], scales: Array) -> tuple[Array, float]:
        """(Log-density (n,) of the likeliest member of a family of densities, after a broad one is mixed in; that
        member's parameter). family: maps a parameter to the log-density (n,); scales: the parameters to choose from, in
        order."""
        tried: dict[int, Array] = {}

        def unlikely(i: int) -> float:
            """Minus the log-likelihood of all frames with the i-th of the scales; its densities are kept in `tried`."""
            if i not in tried:
                tried[i] = self._with_broad(family(float(scales[i])))
            return -float(np.sum(tried[i]))

        best = least_of(len(scales), unlikely)
        return tried[best], float(scales[best])

    def _with_broad(self, log_density: Array) -> Array:
        """(n,) The log-density (n,) of frames of which a share _BROAD follows a Gaussian as wide as all residuals
        instead."""
        return np.asarray(np.logaddexp(np.log1p(-_BROAD) + log_density, np.log(_BROAD) + self._broad))

    def two_levels(self, residual: Array) -> Array:
        """(n,) Log-density of residuals (n, k) as Gaussian noise with one variance while the play's centre moves and
        one while it rests, for each recording. The variances are the mean squares after outliers are cut, at least
        floor^2; a broad density is mixed in."""
        squares = np.sum(residual**2, axis=1)
        variance = self._level_by_part(
            squares / self.coordinates, lambda powers: np.mean(np.minimum(powers, np.quantile(powers, _OUTLIERS)))
        )
        return self._with_broad(_isotropic_log_density(squares, variance, self.coordinates))

    def _level_by_part(self, powers: Array, level: Callable[[Array], np.floating[Any]]) -> Array:
        """(n,) For each recording the `level` of powers (n,) of its frames in which the play's centre moves, and of
        those in which it rests, at least floor^2."""
        of_each = np.empty(len(powers))
        for number in np.unique(self._recording):
            for part in (self._moving & (self._recording == number), ~self._moving & (self._recording == number)):
                if part.any():
                    of_each[part] = max(float(level(powers[part])), self._floor2)
        return of_each

    @cached_property
    def by_memory(self) -> Array:
        """(n, k) The linear prediction of each residual from those of the _REMEMBERED frames before it, by least
        squares."""
        n, k = self.residual.shape
        coefficients = np.linalg.lstsq(self._before.reshape(n * k, -1), self.residual.ravel(), rcond=None)[0]
        return np.asarray(self._before @ coefficients)

    def by_place(self) -> Array:
        """(n, k) The prediction of each residual by the place and direction of the motion, learnt from all other
        blocks, of the calibration or of the tests as the frame itself. It is linear between _PLACES places, and drawn
        to 0 by a prior as wide as all residuals."""
        low, high = float(self._place.min()), float(self._place.max())
        position = (self._place - low) / max(high - low, 1e-12) * (_PLACES - 1)
        left = np.clip(position.astype(int), 0, _PLACES - 2)
        share = position - left
        ridge = max(self._floor2 / max(float(np.mean(self.residual**2)), self._floor2), _RIDGE)
        result: Array = np.zeros_like(self.residual)
        for way, calibration in product((-1.0, 1.0), (False, True)):
            frames_of_part = np.flatnonzero((self._way == way) & (self._calibration == calibration))
            blocks = {
                int(number): frames_of_part[self.block[frames_of_part] == number]
                for number in np.unique(self.block[frames_of_part])
            }
            normals = {
                number: _normal_of_lines(left[rows], share[rows], self.residual[rows])
                for number, rows in blocks.items()
            }
            of_all = sum(normals.values(), np.zeros((_PLACES, 2 + self.coordinates)))
            for number, rows in blocks.items():
                others = of_all - normals[number]
                bands = np.stack([np.append(0.0, others[:-1, 1]), others[:, 0] + ridge])
                curve = solveh_banded(bands, others[:, 2:])
                result[rows] = (1.0 - share[rows, None]) * curve[left[rows]] + share[rows, None] * curve[left[rows] + 1]
        return result

    def jitter(self, seconds: float) -> Array:
        """(n,) Log-density if frame times scatter with a standard deviation of `seconds`: the variance of the residual
        is floor^2 + (seconds speed)^2 along the image's motion, and floor^2 across it."""
        along, across2 = self._by_velocity
        variance = self._floor2 + (seconds * self.speed) ** 2
        return _gaussian_along_log_density(along, across2, variance, self._floor2, self.coordinates)

    def waiting(self, seconds: float) -> Array:
        """(n,) Log-density if frames wait for a time that is exponentially distributed with the scale `seconds`, its
        median being part of the delay. Residuals lag along the motion: a Gaussian plus an exponential number of the
        scale seconds speed."""
        along, across2 = self._by_median_wait
        return _lagging_log_density(along, across2, seconds * self.speed, self._floor2, self.coordinates)

    def stamped(self, seconds: float) -> Array:
        """(n,) As `jitter`, for frames that were taken at even times: by their times of arrival each has waited some
        time (`waits_s`), by which it lags along the motion; the median wait is part of the delay."""
        along, across2 = self._by_stamped_wait
        variance = self._floor2 + (seconds * self.speed) ** 2
        return _gaussian_along_log_density(along, across2, variance, self._floor2, self.coordinates)

    def behind(self, length: float) -> Array:
        """(n,) Log-density of a tip that is behind the prediction by a length while the motor drives, whatever the
        speed, or ahead of it if `length` is negative. The length is exponentially distributed with the scale |length|,
        unit of q (of the play's centre), and its median is part of the fit."""
        along, across2, per_unit = self._by_median_length
        return _lagging_log_density(
            np.sign(length) * along, across2, abs(length) * per_unit, self._floor2, self.coordinates
        )

    @cached_property
    def _by_median_wait(self) -> tuple[Array, Array]:
        """((n,) residual along the image's motion, (n,) square of the residual across it). The former is shifted in
        proportion to the speed, so that the median frame of its recording is on time (`_median_part`)."""
        along, across2 = _along_and_across2(self.as_it_is, self._velocity)
        return along - self._median_part(along, self.speed), across2

    @property
    def waits_deviation_s(self) -> float:
        """Standard deviation, s, of the times that the frames waited, as their times of arrival tell (`waits_s`)."""
        return float(np.std(self._waited_s))

    @cached_property
    def _by_stamped_wait(self) -> tuple[Array, Array]:
        """As `_by_median_wait`, with the image's way during each frame's wait (`waits_s`) taken off the residual
        first."""
        along, across2 = self._by_median_wait
        along = along + self.speed * self._waited_s
        return along - self._median_part(along, self.speed), across2

    @cached_property
    def _by_median_length(self) -> tuple[Array, Array, Array]:
        """((n,) residual along the image's motion, (n,) square of the residual across it, (n,) image motion per unit of
        the play's centre, 0 at rest). The first is shifted by a constant length of the play's centre, so that the
        median frame of its recording is where the fit has it (`_median_part`)."""
        along, across2 = _along_and_across2(self.as_it_is, self._per_unit)
        per_unit = np.sqrt(self._per_unit2) * self._moving
        return along - self._median_part(along, per_unit), across2, per_unit

    def _median_part(self, along: Array, scale: Array) -> Array:
        """(n,) `scale` times the median of the ratio along / scale in each recording; along, scale: (n,). The median is
        over the faster half of the moving frames, as in the others noise dominates that ratio; 0 where none moves."""
        part = np.zeros(len(along))
        for number in np.unique(self._recording):
            in_recording = self._recording == number
            fast = in_recording & (scale > 0.0)
            fast &= scale >= np.median(scale[fast]) if fast.any() else False
            part[in_recording] = scale[in_recording] * (
                float(np.median(along[fast] / scale[fast])) if fast.any() else 0.0
            )
        return part

    def blur(self, seconds: float) -> Array:
        """(n,) Log-density of isotropic noise with the variance floor^2 + (seconds speed)^2 of a coordinate."""
        squares = np.sum(self.residual**2, axis=1)
        return _isotropic_log_density(squares, self._floor2 + (seconds * self.speed) ** 2, self.coordinates)

    def stick(self, jump: float) -> Array:
        """(n,) Log-density of a tip that at times sticks and jumps, and else follows the motor in bursts. While it
        does, it stays with probability 1 - driven / jump where it was at the frame before, and else lies anywhere
        within a jump of the prediction, along its path. jump: in the play's centre, unit of q. The probability is kept
        within _LEAST and _MOST."""
        return self._in_regimes(*self._quiet_and_disturbed, self._jumping(self._repeated, jump))

    def double(self, jump: float) -> Array:
        """(n,) As `stick`, of a tip that goes twice as far as predicted where that one stays."""
        return self._in_regimes(*self._quiet_and_disturbed, self._jumping(self._doubled, jump))

    def start_late(self, length: float) -> Array:
        """(n,) Log-density of a tip that stays where it was while the motor rests, and at times until the play's centre
        has moved on by `length`, unit of q, since it began to move or turned; else it follows the motor in bursts."""
        stays = np.where(self._travel <= length, self._repeated, _NEVER)
        return self._in_regimes(*self._quiet_and_disturbed, stays)

    @cached_property
    def _travel(self) -> Array:
        """(n,) By how much the play's centre has moved since it began to move or turned, unit of q; 0 at rest."""
        turned = np.diff(self._way, prepend=0.0) != 0.0
        travelled = np.cumsum(self.driven)
        begins = np.maximum.accumulate(np.where(turned | ~self._moving | self._begins, np.arange(len(turned)), 0))
        return np.where(self._moving, travelled - (travelled - self.driven)[begins], 0.0)

    def _jumping(self, stays_at: Array, jump: float) -> Array:
        """(n,) Log-density of frames that stay, with the log-density stays_at (n,), or have jumped: as `stick` says."""
        stays = np.where(self.driven > 0.0, np.clip(1.0 - self.driven / jump, _LEAST, _MOST), _MOST)
        variance = self._floor2 + self._per_unit2 * jump**2 / 12.0  # equation: of a uniform density
        along, across2 = self._by_direction
        within_jump = _gaussian_along_log_density(along, across2, variance, self._floor2, self.coordinates)
        return np.asarray(np.logaddexp(np.log(stays) + stays_at, np.log1p(-stays) + within_jump))

    @cached_property
    def bursts(self) -> Array:
        """(n,) Log-density of frames that follow those before them, disturbed for a while now and then
        (`_likeliest_bursts`), or of those that are on the path and leave it for a while (`returns`): the likelier of
        both."""
        returning = self.likeliest(self.returns, _DISTURBANCES * np.sqrt(self._floor2))[0]
        return max(self._likeliest_bursts[0], returning, key=np.sum)

    @property
    def _quiet_and_disturbed(self) -> tuple[Array, Array]:
        """(n,) Log-densities of frames that are quiet, and of those that are disturbed, in the likeliest `bursts`."""
        return self._likeliest_bursts[1]

    @cached_property
    def _likeliest_bursts(self) -> tuple[Array, tuple[Array, Array]]:
        """(Log-density (n,) of frames that follow those before them, disturbed for a while now and then, a broad one
        mixed in; `_quiet_and_disturbed`). A residual is expected to be what memory predicts, or that of the frame
        before, whichever is likelier of all."""
        of_each = [self._bursts_about(expected) for expected in (self.by_memory, self._before[:, :, 0])]
        return max(of_each, key=lambda one: float(np.sum(one[0])))

    def _bursts_about(self, expected: Array) -> tuple[Array, tuple[Array, Array]]:
        """As `_likeliest_bursts`, of residuals expected to be `expected` (n, k)."""
        squares = np.sum((self.residual - expected) ** 2, axis=1)
        variance = self._variance_of_most(squares)

        def parts(disturbance: float) -> tuple[Array, Array]:
            """(n,) Log-densities of quiet and disturbed frames; disturbance: a standard deviation, px or deg."""
            wide = variance + disturbance**2
            return (
                _isotropic_log_density(squares, variance, self.coordinates),
                _isotropic_log_density(squares, wide, self.coordinates),
            )

        of_all, disturbance = self.likeliest(
            lambda s: self._in_regimes(*parts(s)), _DISTURBANCES * np.sqrt(self._floor2)
        )
        return of_all, parts(disturbance)

    def returns(self, disturbance: float) -> Array:
        """(n,) Log-density of frames that are on the path, and of those that for a while stay as far off it as the
        frame before, but for a standard deviation `disturbance`, px or deg."""
        squares, of_change = (np.sum(off**2, axis=1) for off in (self.residual, self.residual - self._before[:, :, 0]))
        return self._in_regimes(
            _isotropic_log_density(squares, self._floor2, self.coordinates),
            _isotropic_log_density(of_change, 2.0 * self._floor2 + disturbance**2, self.coordinates),
        )

    def _variance_of_most(self, squares: Array) -> Array:
        """(n,) Variance of a coordinate of most frames (`_level_by_part`), by the median of squares (n,), of a
        Gaussian's k coordinates."""
        median = 2.0 * float(gammaincinv(0.5 * self.coordinates, 0.5))  # equation: of chi-square with k degrees
        return self._level_by_part(squares / median, np.median)

    def _in_regimes(self, quiet: Array, disturbed: Array, third: Array | None = None) -> Array:
        """(n,) Log-density of each frame given those before it, of frames that are quiet, or for a while disturbed, or
        for a while follow a third law, times being counted in the usual period of each recording; quiet, disturbed,
        third: (n,) log-densities."""
        of_each = np.column_stack([quiet, disturbed] if third is None else [quiet, disturbed, third])
        forward = []
        for number, usual_s in enumerate(self._periods_s):
            rows = self._recording == number
            transition, initial = _regimes(usual_s, third is not None)
            forward.append(_native.regimes_forward(of_each[rows], self._begins[rows], transition, initial))
        return np.concatenate(forward)

    def repeats(self, share: float) -> Array:
        """(n,) Log-density of a link that shows the frame before again in place of this share of the frames; such a
        frame differs from the one before by the noise of two frames. The others have Gaussian noise about the
        prediction, shifted so that the median frame is on time."""
        along, across2 = self._by_median_wait
        fresh = _isotropic_log_density(along**2 + across2, self._floor2, self.coordinates)
        return np.asarray(np.logaddexp(np.log(share) + self._repeated, np.log1p(-share) + fresh))


def _regimes(usual_s: float, with_third: bool) -> tuple[Array, Array]:
    """(Probabilities (m, m) that a frame of the row's regime is followed by one of the column's; those (m,) of the
    first frame's regime): quiet, disturbed and, with_third, a third law, m = 2 or 3. usual_s: from frame to frame, s.
    """
    begin, end, turn = (min(0.5, usual_s / mean_s) for mean_s in (_DISTURBED_EVERY_S, _DISTURBED_S, _STICKS_S))
    transition = np.array([[1.0 - begin, begin], [end, 1.0 - end]])
    initial = np.array([end, begin]) / (begin + end)
    if with_third:
        transition = np.block([[(1.0 - turn) * transition, np.full((2, 1), turn)], [turn, 0.0, 1.0 - turn]])
        initial = 0.5 * np.append(initial, 1.0)
    return transition, initial


def _normal_of_lines(left: npt.NDArray[np.int64], share: Array, y: Array) -> Array:
    """(_PLACES, 2 + k) Normal equations of values at _PLACES places with straight lines between them: the matrix'
    diagonal, its next diagonal (0 in the last row), and k right-hand sides. For each row of y (n, k), left (n,) is the
    place before it, and share (n,), 0 to 1, how far it is from there to the next one."""
    near, far, n = 1.0 - share, share, _PLACES
    columns = [
        np.bincount(left, near**2, n) + np.bincount(left + 1, far**2, n),
        np.bincount(left, near * far, n),
        *(np.bincount(left, near * value, n) + np.bincount(left + 1, far * value, n) for value in y.T),
    ]
    return np.column_stack(columns)


def _isotropic_log_density(squares: Array, variance: Array | float, k: int) -> Array:
    """(n,) Log-density of an isotropic Gaussian in k coordinates, up to a constant: -(k log(variance) + squares /
    variance) / 2. squares: (n,) squared distances from its centre; variance: of a coordinate, one number or (n,)."""
    return np.asarray(-0.5 * (k * np.log(variance) + squares / variance))


def _gaussian_along_log_density(along: Array, across2: Array, variance: Array, across_variance: float, k: int) -> Array:
    """(n,) Log-density of a Gaussian in k coordinates, up to a constant, whose variance is `variance` (n,) along the
    motion and across_variance in each direction across it. along (n,): distance along; across2 (n,): squared distance
    across, which counts for k > 1."""
    value: Array = -0.5 * (np.log(variance) + along**2 / variance)
    if k > 1:
        value = value - 0.5 * (np.log(across_variance) + across2 / across_variance)
    return value


def _lagging_log_density(along: Array, across2: Array, scale: Array, variance: float, k: int) -> Array:
    """(n,) Log-density in k coordinates, up to a constant, of a distance behind the prediction that is exponentially
    distributed with this scale (n,) about its median, plus Gaussian noise of `variance` in each coordinate: along the
    motion an exponentially modified Gaussian. along, across2: as in `_gaussian_along_log_density`."""
    noise = np.sqrt(variance)
    rate = noise / np.maximum(scale, _LEAST * noise)
    lag = np.log(2.0) / rate - along / noise  # above the least one, in the noise
    value = np.log(rate / noise) - rate * lag + 0.5 * rate**2 + log_ndtr(lag - rate) + 0.5 * np.log(2.0 * np.pi)
    if k > 1:
        value = value - 0.5 * (np.log(variance) + across2 / variance)
    return np.asarray(value)


def _along_and_across2(r: Array, direction: Array) -> tuple[Array, Array]:
    """(Component (n,) of r (n, k) along `direction` (n, k), which may have any length; square (n,) of the rest of r).
    Where the direction is 0, at rest, the first coordinate counts as along, so that nothing of r is lost."""
    length = np.linalg.norm(direction, axis=1)[:, None]
    unit = np.where(length > 1e-9, direction / np.maximum(length, 1e-9), np.eye(1, r.shape[1]))
    along = np.sum(r * unit, axis=1)
    return along, np.maximum(np.sum(r**2, axis=1) - along**2, 0.0)


def _fitted_lag(r: Array, per_unit: Array) -> Array:
    """(n, k) The part of one recording's residual r (n, k) that a constant lag of the play's centre explains, by least
    squares. per_unit (n, k): image motion per unit of the centre."""
    length = float(np.sum(r * per_unit)) / max(float(np.sum(per_unit**2)), 1e-12)
    return length * per_unit


def pixel_phase_part(r: Array, image: Array) -> Array:
    """(n, k) The part of the residual r (n, k), px, that depends on the position within a pixel: the first two
    harmonics of each image coordinate, image (n, k) px, fitted by least squares."""
    explained = np.empty_like(r)
    for i, (residual, x) in enumerate(zip(r.T, image.T, strict=True)):
        phase = 2.0 * np.pi * x
        waves = np.column_stack([f(n * phase) for n in (1, 2) for f in (np.sin, np.cos)])
        explained[:, i] = waves @ np.linalg.lstsq(waves, residual, rcond=None)[0]
    return explained
