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
    """A curve of each of n sessions (such as log B) at k places, with its errors."""

    q: Array  # (k,) places
    value: Array  # (n, k)
    sigma: Array  # (n, k) of `value`; _UNTOLD and more where a session says nothing
    names: tuple[str, ...]  # (n,) the robots whose sessions they are
    together: Array | None = None  # (n, k) the part of sigma by which all places of a curve are off together, signed

    def of(self, keep: npt.NDArray[np.intp]) -> Curves:
        """The curves of the sessions with the indices `keep` (m,)."""
        names = tuple(self.names[k] for k in keep)
        together = None if self.together is None else self.together[keep]
        return Curves(self.q, self.value[keep], self.sigma[keep], names=names, together=together)

    @property
    def dimensions(self) -> Array:
        """(n,) At how many places each session says anything: its number of dimensions in a density or a test."""
        return np.asarray(np.sum(self.sigma < _UNTOLD, axis=1), dtype=float)

    @cached_property
    def noise(self) -> Array:
        """(n, k, k) Covariance of each session's errors: each place's own on the diagonal, and the common part."""
        if self.together is None:
            return _diagonal(self.sigma**2)
        own = np.maximum(self.sigma**2 - self.together**2, (_OWN * self.sigma) ** 2)
        return _diagonal(own) + self.together[:, :, None] * self.together[:, None, :]

    @cached_property
    def robot(self) -> npt.NDArray[np.intp]:
        """(n,) The number of each session's robot, from 0 on."""
        return np.unique(self.names, return_inverse=True)[1]

    @property
    def weight(self) -> Array:
        """(n,) Weight of each session, 1 over the number of its robot's: each robot counts once."""
        return np.asarray(1.0 / np.bincount(self.robot)[self.robot])


@dataclass(frozen=True)
class Population:
    """A multivariate Student t of robots' curves at k places, in the curves' unit."""

    q: Array  # (k,) places
    mean: Array  # (k,)
    scale: Array  # (k, k) scale matrix
    freedom: float  # degrees of freedom: the smaller, the heavier the tail

    def distance(self, curves: Curves) -> Array:
        """(n,) Squared Mahalanobis distance of each curve from the mean, its errors included in the covariance. For
        robots of this fleet it is about the number of places that say anything (`Curves.dimensions`), more in the
        tail."""
        off = curves.value - self.mean
        return np.asarray(np.einsum("nk,nk->n", off, _solve_each(self.scale + curves.noise, off)))

    def chance(self, curves: Curves) -> Array:
        """(n,) For each curve the probability (p-value, by the F distribution) that a robot of this fleet is at least
        as far from the mean."""
        size = np.maximum(curves.dimensions, 1.0)
        return np.asarray(fdtrc(size, self.freedom, self.distance(curves) / size))

    def log_density(self, curves: Curves) -> Array:
        """(n,) Logarithm of each curve's density, to compare populations by. A constant of places that say nothing is
        left out: it is the same for all populations."""
        half_log = 0.5 * np.linalg.slogdet(self.scale + curves.noise)[1]
        return np.asarray(_log_student(self.distance(curves), curves.dimensions, self.freedom) - half_log)


def _log_student(squares: Array, size: npt.ArrayLike, freedom: float) -> Array:
    """Logarithm of a multivariate Student t's density at squared Mahalanobis distances `squares`, in `size` dimensions,
    less the term -log(det(scale matrix)) / 2, which the caller adds. freedom: its degrees of freedom. Element by
    element."""
    size = np.asarray(size)
    constant = gammaln(0.5 * (freedom + size)) - gammaln(0.5 * freedom) - 0.5 * size * np.log(freedom * np.pi)
    return np.asarray(constant - 0.5 * (freedom + size) * np.log1p(squares / freedom))


def log_widths(rows: Sequence[Row]) -> Curves:
    """The curves log B of the usable sessions, of those with the most common places (unit and q). In the logarithm a
    spread between robots is a share of B. Beyond a session's outermost reversals its sigma is _UNTOLD. TautError where
    fewer than LEAST_ROBOTS have one."""
    usable = _most_common_kind([row for row in rows if row.usable and row.q], lambda row: (row.unit, row.q))
    robots = len({row.robot for row in usable})
    if robots < LEAST_ROBOTS:
        raise TautError(f"{robots} robots of one range are calibrated: a fleet's spread takes {LEAST_ROBOTS}")
    width, stated = (np.array([getattr(row, name) for row in usable]) for name in ("width", "width_sigma"))
    q = np.array(usable[0].q)
    ends = np.array([(row.measured_low, row.measured_high) for row in usable], dtype=float)
    measured = (ends[:, :1] <= q) & (q <= ends[:, 1:])  # beyond, the stated sigma is the distance to a reversal
    width = np.maximum(width, np.where(measured, stated, 0.0))  # a B of 0 has no logarithm: B is its sigma at least
    width = np.where(measured, width, np.maximum(width, _LEAST * width.max(axis=1, keepdims=True)))
    sigma = np.where(measured, np.minimum(stated / width, _UNKNOWN), _UNTOLD)
    by_delay = np.array([row.width_by_delay or (0.0,) * len(q) for row in usable])
    together = np.where(measured, np.clip(by_delay / width, -sigma, sigma), 0.0)
    return Curves(q, np.log(width), sigma, names=tuple(row.robot for row in usable), together=together)


def tip_paths(rows: Sequence[Row]) -> list[Curves]:
    """The path over q that the tip's sensor sees, of the usable sessions that share the most common unit, places and
    number of coordinates: one Curves for each coordinate (u and v in px, or an angle in deg). Empty where fewer than
    LEAST_ROBOTS have one."""
    seen = _most_common_paths(rows)
    if len({row.robot for row in seen}) < LEAST_ROBOTS:
        return []
    q, names = np.array(seen[0].q), tuple(row.robot for row in seen)
    value, sigma = (
        np.array([getattr(row, name) for row in seen]).reshape(len(seen), -1, len(q)) for name in ("path", "path_sigma")
    )
    return [Curves(q, value[:, k], sigma[:, k], names) for k in range(value.shape[1])]


def delays(rows: Sequence[Row]) -> Curves | None:
    """The delay, s, of the sensor that sees `tip_paths`, as curves of a single place (n, 1), of the usable sessions
    that have one with its sigma. None where fewer than LEAST_ROBOTS do."""
    told = [(row.robot, row.delay_s, row.delay_sigma_s) for row in _most_common_paths(rows) if row.delay_sigma_s]
    if len({robot for robot, _, _ in told}) < LEAST_ROBOTS:
        return None
    names, value, sigma = zip(*told, strict=True)
    return Curves(np.zeros(1), np.array(value, dtype=float)[:, None], np.array(sigma, dtype=float)[:, None], names)


def _most_common_paths(rows: Sequence[Row]) -> list[Row]:
    """The usable sessions with a path, of those with the most common unit, places and number of coordinates."""
    seen = [row for row in rows if row.usable and row.path]
    return _most_common_kind(seen, lambda row: (row.unit, row.q, len(row.path)))


def _most_common_kind(rows: Sequence[Row], kind: Callable[[Row], Hashable]) -> list[Row]:
    """The rows for which `kind` gives its most common value."""
    kinds = [kind(row) for row in rows]
    most_common = max(set(kinds), key=kinds.count, default=None)
    return [row for row, own in zip(rows, kinds, strict=True) if own == most_common]


def population(curves: Curves, of_next: bool = False) -> Population:
    """Fits how the curves are spread between robots (see the module). The kernel's length and worth and the tail are
    chosen by cross-validation: those under which robots that were left out are likeliest. of_next: the result is a
    prior for the next robot, which may be worn as none of these is: only the heaviest tail, and worths of
    _WORTH_OF_NEXT and more."""
    if len(curves.value) > _MOST:
        curves = curves.of(np.linspace(0, len(curves.value) - 1, _MOST).astype(np.intp))
    tails = _TAILS[:1] if of_next else _TAILS
    choices = [each for each in product(_LENGTHS, _WORTH, tails) if not of_next or each[1] >= _WORTH_OF_NEXT]
    score = np.zeros(len(choices))  # log density of robots that were left out
    for part in range(_PARTS):
        left_out = curves.robot % _PARTS == part
        training, test = curves.of(np.flatnonzero(~left_out)), curves.of(np.flatnonzero(left_out))
        fitted = {freedom: _fit_mean_and_scatter(training, freedom) for freedom in tails}
        for i, (length, worth, freedom) in enumerate(choices):
            candidate = _shrink_scatter(*fitted[freedom], training, length, worth, freedom)
            score[i] += float(test.weight @ candidate.log_density(test))
    length, worth, freedom = choices[int(np.argmax(score))]
    return _shrink_scatter(*_fit_mean_and_scatter(curves, freedom), curves, length, worth, freedom)


def population_of_single_value(curves: Curves) -> Population:
    """How a single value (n, 1), such as the delay, is spread between robots, as a prior for the next one: the mean
    over a grid of spreads, from 0 on, and tails, each weighted by its posterior probability under a flat prior. The
    likeliest spread alone would not do: it is 0 whenever sessions overstate their errors."""
    value, variance, weight = curves.value[:, 0], curves.sigma[:, 0] ** 2, curves.weight
    middle = float(np.median(value))
    spreads = np.linspace(0.0, _WIDEST * float(np.sqrt(np.mean((value - middle) ** 2))), _SPREADS)[:, None]
    total = spreads**2 + variance  # (spreads, n)
    means, mean_variances, log_evidence = (np.zeros((len(_TAILS), _SPREADS)) for _ in range(3))
    for i, freedom in enumerate(_TAILS):
        mean = np.full(_SPREADS, middle)
        for _ in range(_STEPS):  # iteratively reweighted, to the mean of a Student t
            pulls = weight * (freedom + 1.0) / (freedom + (value - mean[:, None]) ** 2 / total) / total
            mean = (pulls @ value) / pulls.sum(axis=1)
        means[i], mean_variances[i] = mean, 1.0 / (weight / total).sum(axis=1)
        log_density = _log_student((value - mean[:, None]) ** 2 / total, 1.0, freedom) - 0.5 * np.log(total)
        # equation: the mean integrated out, by Laplace
        log_evidence[i] = log_density @ weight + 0.5 * np.log(mean_variances[i])
    probability = np.exp(log_evidence - log_evidence.max())
    probability /= probability.sum()
    usual = float(np.sum(probability * means))
    scale = float(np.sum(probability * (spreads[:, 0] ** 2 + mean_variances + (means - usual) ** 2)))
    return Population(curves.q, np.array([usual]), np.array([[scale]]), _TAILS[0])  # the next robot's tail is heavy


def _fit_mean_and_scatter(curves: Curves, freedom: float) -> tuple[Array, Array]:
    """The fleet's mean (k,) and the robots' scale matrix S (k, k), by expectation and maximisation, for a tail of
    `freedom` degrees of freedom; not shrunk yet."""
    weight, noise = curves.weight, curves.noise
    known = 1.0 / curves.sigma**2
    mean = np.sum(known * curves.value, axis=0) / np.sum(known, axis=0)
    scale = _kernel(curves, mean, _LENGTHS[1])
    # At places of which no session says anything the mean goes on from its neighbours.
    mean = _smoothed_mean(mean, scale, 1.0 / np.sum(known, axis=0))
    size = curves.dimensions
    for _ in range(_STEPS):
        off = curves.value - mean
        inverse = np.linalg.inv(scale + noise)
        pulled = np.einsum("nkl,nl->nk", inverse, off)
        tail = (freedom + size) / (freedom + np.einsum("nk,nk->n", off, pulled))  # E[u_s]
        own = mean + pulled @ scale  # E[b_s]
        uncertain = weight.sum() * scale - scale @ np.einsum("n,nkl->kl", weight, inverse) @ scale  # sum of Cov[b_s]
        mean = (weight * tail) @ own / (weight @ tail)
        apart = own - mean
        spread = (weight * tail * apart.T) @ apart + uncertain
        scale = 0.5 * (spread + spread.T) / weight.sum()
    return mean, scale


def _shrink_scatter(
    mean: Array, scale: Array, curves: Curves, length: float, worth: float, freedom: float
) -> Population:
    """The population with this mean (k,) and a scale matrix that is the weighted mean of `scale` (k, k), with the
    number of robots as its weight, and a smooth kernel of the same trace, with the weight `worth`. length: the
    kernel's, a share of the range; freedom: the population's degrees of freedom."""
    robots = float(curves.weight.sum())
    size = float(np.trace(scale)) / len(scale)
    kernel = _kernel(curves, mean, length)
    kernel *= size / (float(np.trace(kernel)) / len(kernel))
    return Population(curves.q, mean, (robots * scale + worth * kernel) / (robots + worth), freedom)


def _kernel(curves: Curves, mean: Array, length: float) -> Array:
    """(k, k) Matern covariance of order 5/2 between the places of the curves, with the variance that these have about
    `mean` (k,). length: over which values go together, a share of the range."""
    known = 1.0 / curves.sigma**2
    variance = float(np.sum(known * (curves.value - mean) ** 2) / np.sum(known))
    apart = np.abs(curves.q[:, None] - curves.q[None, :]) * np.sqrt(5.0) / (length * (curves.q[-1] - curves.q[0]))
    kernel = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(max(variance, 1e-18) * kernel)


def _smoothed_mean(value: Array, kernel: Array, noise: Array) -> Array:
    """(k,) The posterior mean of a Gaussian process with covariance `kernel` (k, k) about a constant level, given
    values (k,) with variances `noise` (k,)."""
    level = np.sum(value / noise) / np.sum(1.0 / noise)
    return np.asarray(level + kernel @ np.linalg.solve(kernel + np.diag(noise), value - level))


def _diagonal(values: Array) -> Array:
    """(n, k, k) Diagonal matrices, each with a row of `values` (n, k) on its diagonal."""
    return values[:, :, None] * np.eye(values.shape[1])


def _solve_each(matrices: Array, values: Array) -> Array:
    """(n, k) The solution x of matrix @ x = value for each of matrices (n, k, k) and values (n, k)."""
    return np.asarray(np.linalg.solve(matrices, values[:, :, None])[:, :, 0])
