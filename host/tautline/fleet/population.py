"""How a curve is spread between robots: a multivariate Student t of its values at places.

y_s = b_s + e_s: a session's curve is its robot's, and an error with the sigma that the session states: what its delay
is off by goes along the whole curve, the rest is each place's own. b_s is normal about the fleet's mean with covariance
S / u_s, u_s gamma with the mean 1: a worn robot is one of a heavy tail. Mean and S by expectation and maximisation,
each robot counted once however many sessions it has; S is shrunk towards a smooth kernel, as much as foretells robots
that were left out best, which tells the tail's degrees of freedom too.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
import numpy.typing as npt
from scipy.special import fdtrc, gammaln

from tautline.errors import TautError
from tautline.fleet.rows import Row

Array = npt.NDArray[np.float64]

LEAST_ROBOTS = 4  # tolerance: that a spread can be told of
_STEPS = 40  # tolerance: of expectation and maximisation
_SPREADS, _WIDEST = 200, 3.0  # tolerance: spreads of a single value that are tried, up to so many of what is seen
_PARTS = 3  # tolerance: in which robots are left out
_LENGTHS = (0.08, 0.16, 0.32)  # prior: of the range, over which a kernel's values go together
_WORTH = (0.1, 0.5, 2.0, 8.0, 32.0)  # prior: robots that the kernel counts as
_WORTH_OF_NEXT = 0.5  # prior: at least, of the next robot: wear is of shapes that no sound robot has
_TAILS = (4.0, 12.0, 1e6)  # prior: degrees of freedom: the last is a normal distribution, the first the next robot's
_MOST = 600  # tolerance: sessions, evenly taken, that S is found from
_UNKNOWN = 1.0  # prior: of log B: a sigma that says nothing
_UNTOLD = 1e3  # tolerance: of log B, where no reversal was
_OWN = 0.1  # tolerance: of a sigma, at least, that each place has alone: else a curve of no dimension is left
_LEAST = 1e-3  # tolerance: of a session's largest B


@dataclass(frozen=True)
class Curves:
    """Sessions' curves (n, k) at places q (k,), with one sigma each, the part of it by which all places are off
    together, and whose they are."""

    q: Array
    value: Array
    sigma: Array
    names: tuple[str, ...]
    together: Array | None = None

    def of(self, keep: npt.NDArray[np.intp]) -> Curves:
        """The curves with these indices, (n,)."""
        names = tuple(self.names[k] for k in keep)
        together = None if self.together is None else self.together[keep]
        return Curves(self.q, self.value[keep], self.sigma[keep], names, together)

    @property
    def told(self) -> Array:
        """(n,) at how many places each session says anything: a curve has no more dimensions than that."""
        return np.asarray(np.sum(self.sigma < _UNTOLD, axis=1), dtype=float)

    @cached_property
    def noise(self) -> Array:
        """(n, k, k) covariance of each session's errors."""
        if self.together is None:
            return _diagonal(self.sigma**2)
        own = np.maximum(self.sigma**2 - self.together**2, (_OWN * self.sigma) ** 2)
        return _diagonal(own) + self.together[:, :, None] * self.together[:, None, :]

    @cached_property
    def robot(self) -> npt.NDArray[np.intp]:
        """(n,) their numbers, from 0 on."""
        return np.unique(self.names, return_inverse=True)[1]

    @property
    def weight(self) -> Array:
        """(n,) 1 over the number of its robot's sessions: one robot is as much as another."""
        return np.asarray(1.0 / np.bincount(self.robot)[self.robot])


@dataclass(frozen=True)
class Population:
    """mean (k,) and scale matrix (k, k) at places q, unit of the curve; degrees of freedom of the tail."""

    q: Array
    mean: Array
    scale: Array
    freedom: float

    def distance(self, curves: Curves) -> Array:
        """(n,) Squared Mahalanobis distance from the mean, the session's own errors included: on average the number of
        places that told the curve, more in the tail."""
        off = curves.value - self.mean
        return np.asarray(np.einsum("nk,nk->n", off, _solved(self.scale + curves.noise, off)))

    def chance(self, curves: Curves) -> Array:
        """(n,) Probability that a robot of this fleet is at least as far off."""
        size = np.maximum(curves.told, 1.0)
        return np.asarray(fdtrc(size, self.freedom, self.distance(curves) / size))

    def log_density(self, curves: Curves) -> Array:
        """(n,) Logarithm of each curve's density, without the constant that places without a word add, which is the
        same for all populations."""
        half_log = 0.5 * np.linalg.slogdet(self.scale + curves.noise)[1]
        return np.asarray(_log_student(self.distance(curves), curves.told, self.freedom) - half_log)


def _log_student(squares: Array, size: npt.ArrayLike, free: float) -> Array:
    """Logarithm of a multivariate Student t's density at squared Mahalanobis distances, in so many dimensions, without
    half that of its scale matrix's determinant. free: degrees of freedom."""
    size = np.asarray(size)
    top = gammaln(0.5 * (free + size)) - gammaln(0.5 * free) - 0.5 * size * np.log(free * np.pi)
    return np.asarray(top - 0.5 * (free + size) * np.log1p(squares / free))


def log_widths(rows: Sequence[Row]) -> Curves:
    """The logarithm of B, whose spread is a share, of the usable sessions at the places that most have. TautError where
    too few robots have any."""
    usable = _of_one_kind([row for row in rows if row.usable and row.q], lambda row: (row.unit, row.q))
    robots = len({row.robot for row in usable})
    if robots < LEAST_ROBOTS:
        raise TautError(f"{robots} robots of one range are calibrated: a fleet's spread takes {LEAST_ROBOTS}")
    width, stated = (np.array([getattr(row, name) for row in usable]) for name in ("width", "width_sigma"))
    q = np.array(usable[0].q)
    ends = np.array([(row.measured_low, row.measured_high) for row in usable], dtype=float)
    told = (ends[:, :1] <= q) & (q <= ends[:, 1:])  # beyond the reversals sigma is the distance to them, not B's size
    width = np.maximum(width, np.where(told, stated, 0.0))  # a B of 0 is small
    width = np.where(told, width, np.maximum(width, _LEAST * width.max(axis=1, keepdims=True)))
    sigma = np.where(told, np.minimum(stated / width, _UNKNOWN), _UNTOLD)
    by_delay = np.array([row.width_by_delay or (0.0,) * len(q) for row in usable])
    together = np.where(told, np.clip(by_delay / width, -sigma, sigma), 0.0)
    return Curves(q, np.log(width), sigma, tuple(row.robot for row in usable), together)


def paths(rows: Sequence[Row]) -> list[Curves]:
    """The path that the tip's sensor sees, a set of curves for each coordinate (px or deg), of the usable sessions with
    what most have; none where too few robots have any."""
    seen = _of_one_sensor(rows)
    if len({row.robot for row in seen}) < LEAST_ROBOTS:
        return []
    q, names = np.array(seen[0].q), tuple(row.robot for row in seen)
    value, sigma = (
        np.array([getattr(row, name) for row in seen]).reshape(len(seen), -1, len(q)) for name in ("path", "path_sigma")
    )
    return [Curves(q, value[:, k], sigma[:, k], names) for k in range(value.shape[1])]


def delays(rows: Sequence[Row]) -> Curves | None:
    """The delay of the sensor that sees `paths`, s, a curve of one place, of the usable sessions that tell it; None
    where too few robots have any."""
    told = [(row.robot, row.delay_s, row.delay_sigma_s) for row in _of_one_sensor(rows) if row.delay_sigma_s]
    if len({robot for robot, _, _ in told}) < LEAST_ROBOTS:
        return None
    names, value, sigma = zip(*told, strict=True)
    return Curves(np.zeros(1), np.array(value, dtype=float)[:, None], np.array(sigma, dtype=float)[:, None], names)


def _of_one_sensor(rows: Sequence[Row]) -> list[Row]:
    """The usable sessions whose path is of the range and of as many coordinates as most have."""
    seen = [row for row in rows if row.usable and row.path]
    return _of_one_kind(seen, lambda row: (row.unit, row.q, len(row.path)))


def _of_one_kind(rows: Sequence[Row], kind: Callable[[Row], Hashable]) -> list[Row]:
    """Those of the kind that most are of."""
    kinds = [kind(row) for row in rows]
    usual = max(set(kinds), key=kinds.count, default=None)
    return [row for row, own in zip(rows, kinds, strict=True) if own == usual]


def population(curves: Curves, of_next: bool = False) -> Population:
    """How the curves are spread, as the module says: kernel and tail are those that foretell left-out robots best.
    of_next: what the next robot may be, which may be worn as none of these is."""
    if len(curves.value) > _MOST:
        curves = curves.of(np.linspace(0, len(curves.value) - 1, _MOST).astype(np.intp))
    tails = _TAILS[:1] if of_next else _TAILS
    choices = [each for each in product(_LENGTHS, _WORTH, tails) if not of_next or each[1] >= _WORTH_OF_NEXT]
    told = np.zeros(len(choices))
    for part in range(_PARTS):
        out = curves.robot % _PARTS == part
        rest, left = curves.of(np.flatnonzero(~out)), curves.of(np.flatnonzero(out))
        fitted = {free: _fitted(rest, free) for free in tails}
        for i, (length, worth, free) in enumerate(choices):
            there = _shrunk(*fitted[free], rest, length, worth, free)
            told[i] += float(left.weight @ there.log_density(left))
    length, worth, free = choices[int(np.argmax(told))]
    return _shrunk(*_fitted(curves, free), curves, length, worth, free)


def single(curves: Curves) -> Population:
    """How a single value (n, 1) is spread, for the next robot: the mean of what may be, over all spreads from none on
    and all tails, none of which is likelier beforehand. One of no spread would be told by nothing but that the sessions
    state their errors exactly."""
    value, variance, weight = curves.value[:, 0], curves.sigma[:, 0] ** 2, curves.weight
    middle = float(np.median(value))
    scales = np.linspace(0.0, _WIDEST * float(np.sqrt(np.mean((value - middle) ** 2))), _SPREADS)[:, None]
    total = scales**2 + variance  # (spreads, n)
    told, mean2 = np.zeros((len(_TAILS), _SPREADS)), np.zeros((len(_TAILS), _SPREADS))
    means = np.zeros((len(_TAILS), _SPREADS))
    for i, free in enumerate(_TAILS):
        mean = np.full(_SPREADS, middle)
        for _ in range(_STEPS):
            pulls = weight * (free + 1.0) / (free + (value - mean[:, None]) ** 2 / total) / total
            mean = (pulls @ value) / pulls.sum(axis=1)
        means[i], mean2[i] = mean, 1.0 / (weight / total).sum(axis=1)
        density = _log_student((value - mean[:, None]) ** 2 / total, 1.0, free) - 0.5 * np.log(total)
        told[i] = density @ weight + 0.5 * np.log(mean2[i])
    chance = np.exp(told - told.max())
    chance /= chance.sum()
    usual = float(np.sum(chance * means))
    scale = float(np.sum(chance * (scales[:, 0] ** 2 + mean2 + (means - usual) ** 2)))
    return Population(curves.q, np.array([usual]), np.array([[scale]]), _TAILS[0])


def _fitted(curves: Curves, free: float) -> tuple[Array, Array]:
    """Mean (k,) and S (k, k) by expectation and maximisation, for a tail of `free` degrees of freedom."""
    weight, noise = curves.weight, curves.noise
    known = 1.0 / curves.sigma**2
    mean = np.sum(known * curves.value, axis=0) / np.sum(known, axis=0)
    scale = _kernel(curves, mean, _LENGTHS[1])
    mean = _smooth(mean, scale, 1.0 / np.sum(known, axis=0))  # where nobody tells it goes on from where somebody does
    size = curves.told
    for _ in range(_STEPS):
        off = curves.value - mean
        inverse = np.linalg.inv(scale + noise)
        pulled = np.einsum("nkl,nl->nk", inverse, off)
        tail = (free + size) / (free + np.einsum("nk,nk->n", off, pulled))
        own = mean + pulled @ scale
        shared = weight.sum() * scale - scale @ np.einsum("n,nkl->kl", weight, inverse) @ scale
        mean = (weight * tail) @ own / (weight @ tail)
        apart = own - mean
        spread = (weight * tail * apart.T) @ apart + shared
        scale = 0.5 * (spread + spread.T) / weight.sum()
    return mean, scale


def _shrunk(mean: Array, scale: Array, curves: Curves, length: float, worth: float, free: float) -> Population:
    """The population whose S is shrunk towards a smooth kernel of this length (share of the range) that counts as
    `worth` robots. free: the tail's degrees of freedom."""
    robots = float(curves.weight.sum())
    size = float(np.trace(scale)) / len(scale)
    kernel = _kernel(curves, mean, length)
    kernel *= size / (float(np.trace(kernel)) / len(kernel))
    return Population(curves.q, mean, (robots * scale + worth * kernel) / (robots + worth), free)


def _kernel(curves: Curves, mean: Array, length: float) -> Array:
    """(k, k) Matern's covariance of order 5/2, `length` a share of the range, with the variance that the curves
    have."""
    known = 1.0 / curves.sigma**2
    variance = float(np.sum(known * (curves.value - mean) ** 2) / np.sum(known))
    apart = np.abs(curves.q[:, None] - curves.q[None, :]) * np.sqrt(5.0) / (length * (curves.q[-1] - curves.q[0]))
    kernel = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(max(variance, 1e-18) * kernel)


def _smooth(value: Array, kernel: Array, noise: Array) -> Array:
    """(k,) what a Gaussian process of this covariance expects of values with these variances."""
    level = np.sum(value / noise) / np.sum(1.0 / noise)
    return np.asarray(level + kernel @ np.linalg.solve(kernel + np.diag(noise), value - level))


def _diagonal(values: Array) -> Array:
    """(n, k, k) Diagonal matrices of values (n, k)."""
    return values[:, :, None] * np.eye(values.shape[1])


def _solved(matrices: Array, values: Array) -> Array:
    """(n, k) The solutions x of matrices (n, k, k) times x = values (n, k)."""
    return np.asarray(np.linalg.solve(matrices, values[:, :, None])[:, :, 0])
