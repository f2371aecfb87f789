"""How a curve is distributed over a fleet's robots: a multivariate Student t of its values at k places.

Model: y_s = b_s + e_s, the curve of session s is its robot's curve b_s plus an error e_s with the sigma that the
session states. The part of e_s that comes from the sensor's delay is fully correlated over the places, the rest is
independent at each place. b_s is normal about the fleet's mean with covariance S / u_s, where u_s is gamma distributed
with mean 1: this makes b_s a Student t, whose heavy tail holds worn robots.

Mean and S are fitted by expectation and maximisation (EM); each robot counts once, however many sessions it has. S is
then shrunk towards a smooth kernel. How much, and the t's degrees of freedom, are chosen by cross-validation.
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
_STEPS = 40  # tolerance: steps of expectation and maximisation
_SPREADS, _WIDEST = 200, 3.0  # tolerance: spreads of a single value that are tried, up to 3 rms of the values
_PARTS = 3  # tolerance: parts of the cross-validation
_LENGTHS = (0.08, 0.16, 0.32)  # prior: lengths of the kernel, as shares of the range
_WORTH = (0.1, 0.5, 2.0, 8.0, 32.0)  # prior: the kernel's weight, in robots
_WORTH_OF_NEXT = 0.5  # prior: least weight of the kernel for the next robot, whose wear may have a new shape
_TAILS = (4.0, 12.0, 1e6)  # prior: degrees of freedom: the last is a normal distribution, the first the next robot's
_MOST = 600  # tolerance: sessions, evenly taken, that S is fitted to at most
_UNKNOWN = 1.0  # prior: largest sigma of log B where B was measured: it says almost nothing
_UNTOLD = 1e3  # tolerance: sigma of log B where B was not measured
_OWN = 0.1  # tolerance: least share of a sigma that is independent at each place: keeps a covariance regular
_LEAST = 1e-3  # tolerance: least B where it was not measured, as a share of the session's largest


@dataclass(frozen=True)
class Curves:
    """One curve (such as log B over q) for each of n sessions, at the same k places, with the sigmas of its errors."""

    q: Array  # (k,) places
    value: Array  # (n, k)
    sigma: Array  # (n, k) standard deviation of `value`; _UNTOLD or more where a session says nothing
    names: tuple[str, ...]  # (n,) the robot of each session
    together: Array | None = None  # (n, k) signed part of sigma that is fully correlated over the places; None: none

    def subset(self, keep: npt.NDArray[np.intp]) -> Curves:
        """The curves of the m sessions with the indices `keep` (m,)."""
        names = tuple(self.names[k] for k in keep)
        together = None if self.together is None else self.together[keep]
        return Curves(self.q, self.value[keep], self.sigma[keep], names=names, together=together)

    @property
    def dimensions(self) -> Array:
        """(n,) The number of places at which each session says anything (sigma below _UNTOLD): the number of dimensions
        of its density or test."""
        return np.asarray(np.sum(self.sigma < _UNTOLD, axis=1), dtype=float)

    @cached_property
    def noise(self) -> Array:
        """(n, k, k) Covariance of each session's errors: diag(sigma^2 - together^2) + together together'. The diagonal
        is at least (_OWN sigma)^2, so that the matrix can be inverted."""
        if self.together is None:
            return _diagonal(self.sigma**2)
        own = np.maximum(self.sigma**2 - self.together**2, (_OWN * self.sigma) ** 2)
        return _diagonal(own) + self.together[:, :, None] * self.together[:, None, :]

    @cached_property
    def robot(self) -> npt.NDArray[np.intp]:
        """(n,) The index, from 0 on, of each session's robot among the sorted different names."""
        return np.unique(self.names, return_inverse=True)[1]

    @property
    def weight(self) -> Array:
        """(n,) Weight of each session: 1 over the number of its robot's sessions, so that each robot counts once."""
        return np.asarray(1.0 / np.bincount(self.robot)[self.robot])


@dataclass(frozen=True)
class Population:
    """The distribution of robots' curves at k places: a multivariate Student t, in the curves' unit."""

    q: Array  # (k,) places
    mean: Array  # (k,)
    scale: Array  # (k, k) scale matrix
    freedom: float  # degrees of freedom: the smaller, the heavier the tail

    def distance(self, curves: Curves) -> Array:
        """(n,) Squared Mahalanobis distance of each curve from the mean, with the covariance `scale` + `curves.noise`.
        For a usual robot of this fleet it is about the number of places that say anything (`Curves.dimensions`); in the
        tail it is larger."""
        deviation = curves.value - self.mean
        return np.asarray(np.einsum("nk,nk->n", deviation, _solve_each(self.scale + curves.noise, deviation)))

    def chance(self, curves: Curves) -> Array:
        """(n,) The p-value of each curve: the probability that a robot of this fleet is at least as far from the mean.
        Over its dimensions a Student t's squared distance has an F distribution."""
        size = np.maximum(curves.dimensions, 1.0)
        return np.asarray(fdtrc(size, self.freedom, self.distance(curves) / size))

    def log_density(self, curves: Curves) -> Array:
        """(n,) Logarithm of each curve's density, up to a constant that is the same for all populations: that of the
        places that say nothing. It serves to compare populations."""
        # equation: log(det) / 2 of the covariance, which `_log_student` leaves out
        half_log = 0.5 * np.linalg.slogdet(self.scale + curves.noise)[1]
        return np.asarray(_log_student(self.distance(curves), curves.dimensions, self.freedom) - half_log)


def _log_student(squares: Array, size: npt.ArrayLike, freedom: float) -> Array:
    """Logarithm of a multivariate Student t's density at squared Mahalanobis distances `squares`, in `size` dimensions
    with `freedom` degrees of freedom; element by element. The term -log(det(scale matrix)) / 2 is left out: the caller
    adds it."""
    size = np.asarray(size)
    constant = gammaln(0.5 * (freedom + size)) - gammaln(0.5 * freedom) - 0.5 * size * np.log(freedom * np.pi)
    return np.asarray(constant - 0.5 * (freedom + size) * np.log1p(squares / freedom))


def log_widths(rows: Sequence[Row]) -> Curves:
    """The curves log B of the usable sessions. Of these, only sessions with the most common unit and places q count. A
    standard deviation of log B is a share of B. Where a session did not measure B its sigma is _UNTOLD. TautError where
    they are of fewer than LEAST_ROBOTS robots."""
    usable = _most_common_kind([row for row in rows if row.usable and row.q], lambda row: (row.unit, row.q))
    robots = len({row.robot for row in usable})
    if robots < LEAST_ROBOTS:
        raise TautError(f"{robots} robots of one range are calibrated: a fleet's spread takes {LEAST_ROBOTS}")
    width, stated = (np.array([getattr(row, name) for row in usable]) for name in ("width", "width_sigma"))
    q = np.array(usable[0].q)
    ends = np.array([(row.measured_low, row.measured_high) for row in usable], dtype=float)
    # (n, k) Between a session's outermost reversals; beyond them the stated sigma is the distance to a reversal.
    measured = (ends[:, :1] <= q) & (q <= ends[:, 1:])
    # A B of 0 has no logarithm: raise B to its sigma where it was measured, and to a share of its largest elsewhere.
    width = np.maximum(width, np.where(measured, stated, 0.0))
    width = np.where(measured, width, np.maximum(width, _LEAST * width.max(axis=1, keepdims=True)))
    sigma = np.where(measured, np.minimum(stated / width, _UNKNOWN), _UNTOLD)
    by_delay = np.array([row.width_by_delay or (0.0,) * len(q) for row in usable])
    together = np.where(measured, np.clip(by_delay / width, -sigma, sigma), 0.0)
    return Curves(q, np.log(width), sigma, names=tuple(row.robot for row in usable), together=together)


def tip_paths(rows: Sequence[Row]) -> list[Curves]:
    """The tip's path over q as its sensor sees it, for the sessions of `_most_common_paths`: a list with one Curves for
    each coordinate, which are u and v in px, or an angle in deg. Empty where fewer than LEAST_ROBOTS robots have a
    path."""
    seen = _most_common_paths(rows)
    if len({row.robot for row in seen}) < LEAST_ROBOTS:
        return []
    q, names = np.array(seen[0].q), tuple(row.robot for row in seen)
    # A row has all u, then all v: (sessions, coordinates, k).
    value, sigma = (
        np.array([getattr(row, name) for row in seen]).reshape(len(seen), -1, len(q)) for name in ("path", "path_sigma")
    )
    return [Curves(q, value[:, k], sigma[:, k], names) for k in range(value.shape[1])]


def delays(rows: Sequence[Row]) -> Curves | None:
    """The delay, s, of the tip's sensor as curves of a single place (n, 1), for those sessions of `_most_common_paths`
    that state its sigma. None where they are of fewer than LEAST_ROBOTS robots."""
    told = [(row.robot, row.delay_s, row.delay_sigma_s) for row in _most_common_paths(rows) if row.delay_sigma_s]
    if len({robot for robot, _, _ in told}) < LEAST_ROBOTS:
        return None
    names, value, sigma = zip(*told, strict=True)
    return Curves(np.zeros(1), np.array(value, dtype=float)[:, None], np.array(sigma, dtype=float)[:, None], names)


def _most_common_paths(rows: Sequence[Row]) -> list[Row]:
    """The usable sessions that have a path and, among these, the most common unit, places q and length of the path
    (which tells one coordinate from two)."""
    seen = [row for row in rows if row.usable and row.path]
    return _most_common_kind(seen, lambda row: (row.unit, row.q, len(row.path)))


def _most_common_kind(rows: Sequence[Row], kind: Callable[[Row], Hashable]) -> list[Row]:
    """The rows for which `kind` returns the value that it returns for most rows; [] for no rows."""
    kinds = [kind(row) for row in rows]
    most_common = max(set(kinds), key=kinds.count, default=None)
    return [row for row, own in zip(rows, kinds, strict=True) if own == most_common]


def population(curves: Curves, of_next: bool = False) -> Population:
    """Fits the distribution of the curves over robots (see the module). The kernel's length and worth and the degrees
    of freedom are chosen by cross-validation: those under which robots that were left out are likeliest. of_next: the
    result is to be a prior for the next robot, which may be worn as none of these is, so only the heaviest tail and
    worths of at least _WORTH_OF_NEXT are tried. At most _MOST sessions, evenly taken, are used."""
    if len(curves.value) > _MOST:
        curves = curves.subset(np.linspace(0, len(curves.value) - 1, _MOST).astype(np.intp))
    tails = _TAILS[:1] if of_next else _TAILS
    choices = [each for each in product(_LENGTHS, _WORTH, tails) if not of_next or each[1] >= _WORTH_OF_NEXT]
    score = np.zeros(len(choices))  # by choice: sum of log densities of robots when they were left out
    for part in range(_PARTS):
        left_out = curves.robot % _PARTS == part
        training, test = curves.subset(np.flatnonzero(~left_out)), curves.subset(np.flatnonzero(left_out))
        fitted = {freedom: _fit_mean_and_scatter(training, freedom) for freedom in tails}
        for i, (length, worth, freedom) in enumerate(choices):
            candidate = _shrink_scatter(*fitted[freedom], training, length, worth, freedom)
            score[i] += float(test.weight @ candidate.log_density(test))
    length, worth, freedom = choices[int(np.argmax(score))]
    return _shrink_scatter(*_fit_mean_and_scatter(curves, freedom), curves, length, worth, freedom)


def population_of_single_value(curves: Curves) -> Population:
    """The distribution of a single value (n, 1), such as the delay, over robots, as a prior for the next robot. A grid
    of spreads (standard deviations between robots, from 0 on) and of tails is tried; mean and variance are averages
    over it, each point weighted by its posterior probability under a flat prior. The likeliest spread alone would not
    do: it is 0 whenever sessions overstate their errors."""
    value, variance, weight = curves.value[:, 0], curves.sigma[:, 0] ** 2, curves.weight
    middle = float(np.median(value))
    spreads = np.linspace(0.0, _WIDEST * float(np.sqrt(np.mean((value - middle) ** 2))), _SPREADS)[:, None]
    total = spreads**2 + variance  # (spreads, n) variance of each session's value about the mean
    means, mean_variances, log_evidence = (np.zeros((len(_TAILS), _SPREADS)) for _ in range(3))
    for i, freedom in enumerate(_TAILS):
        mean = np.full(_SPREADS, middle)
        for _ in range(_STEPS):  # iteratively reweighted least squares: the location of a Student t
            pulls = weight * (freedom + 1.0) / (freedom + (value - mean[:, None]) ** 2 / total) / total
            mean = (pulls @ value) / pulls.sum(axis=1)
        means[i], mean_variances[i] = mean, 1.0 / (weight / total).sum(axis=1)
        log_density = _log_student((value - mean[:, None]) ** 2 / total, 1.0, freedom) - 0.5 * np.log(total)
        # equation: the mean is integrated out by Laplace's method, with its variance at the optimum
        log_evidence[i] = log_density @ weight + 0.5 * np.log(mean_variances[i])
    probability = np.exp(log_evidence - log_evidence.max())
    probability /= probability.sum()
    usual = float(np.sum(probability * means))
    # Variance of the mixture: that between robots, that of the mean, and that of the mean between grid points.
    scale = float(np.sum(probability * (spreads[:, 0] ** 2 + mean_variances + (means - usual) ** 2)))
    return Population(curves.q, np.array([usual]), np.array([[scale]]), _TAILS[0])  # the next robot's tail is heavy


def _fit_mean_and_scatter(curves: Curves, freedom: float) -> tuple[Array, Array]:
    """Fits the fleet's mean (k,) and the robots' scale matrix S (k, k), not shrunk yet, by _STEPS of expectation and
    maximisation (EM) for a Student t with `freedom` degrees of freedom. Symbols b_s, u_s: as in the module."""
    weight, noise = curves.weight, curves.noise
    precision = 1.0 / curves.sigma**2
    mean = np.sum(precision * curves.value, axis=0) / np.sum(precision, axis=0)
    scale = _kernel(curves, mean, _LENGTHS[1])
    # At places that no session measured the mean is carried on from its neighbours.
    mean = _smoothed_mean(mean, scale, 1.0 / np.sum(precision, axis=0))
    size = curves.dimensions
    for _ in range(_STEPS):
        deviation = curves.value - mean
        inverse = np.linalg.inv(scale + noise)
        weighted_deviation = np.einsum("nkl,nl->nk", inverse, deviation)
        # Expectation: E[u_s] is small for a robot that is far off; b_s has the normal posterior of a Kalman update.
        expected_u = (freedom + size) / (freedom + np.einsum("nk,nk->n", deviation, weighted_deviation))
        own = mean + weighted_deviation @ scale  # (n, k) E[b_s]
        # Sum over the sessions of weight times Cov[b_s] = S - S (S + noise)^-1 S.
        posterior_covariance = weight.sum() * scale - scale @ np.einsum("n,nkl->kl", weight, inverse) @ scale
        # Maximisation.
        mean = (weight * expected_u) @ own / (weight @ expected_u)
        apart = own - mean
        spread = (weight * expected_u * apart.T) @ apart + posterior_covariance
        scale = 0.5 * (spread + spread.T) / weight.sum()
    return mean, scale


def _shrink_scatter(
    mean: Array, scale: Array, curves: Curves, length: float, worth: float, freedom: float
) -> Population:
    """The population with this mean (k,), `freedom` degrees of freedom, and a scale matrix that is the weighted mean of
    two: `scale` (k, k), with the number of robots as its weight, and a smooth kernel (`_kernel`) that is scaled to the
    same trace, with the weight `worth`. length: of the kernel, as a share of the range."""
    robots = float(curves.weight.sum())
    size = float(np.trace(scale)) / len(scale)
    kernel = _kernel(curves, mean, length)
    kernel *= size / (float(np.trace(kernel)) / len(kernel))
    return Population(curves.q, mean, (robots * scale + worth * kernel) / (robots + worth), freedom)


def _kernel(curves: Curves, mean: Array, length: float) -> Array:
    """(k, k) Matern covariance of order 5/2 between the places of the curves. Its variance is the weighted mean square
    of the curves about `mean` (k,), with weights 1 / sigma^2. length: its length scale, as a share of the range of
    q."""
    precision = 1.0 / curves.sigma**2
    variance = float(np.sum(precision * (curves.value - mean) ** 2) / np.sum(precision))
    apart = np.abs(curves.q[:, None] - curves.q[None, :]) * np.sqrt(5.0) / (length * (curves.q[-1] - curves.q[0]))
    kernel = (1.0 + apart + apart**2 / 3.0) * np.exp(-apart)
    return np.asarray(max(variance, 1e-18) * kernel)


def _smoothed_mean(value: Array, kernel: Array, noise: Array) -> Array:
    """(k,) The posterior mean of a Gaussian process with covariance `kernel` (k, k) about a constant level, given
    observations `value` (k,) with variances `noise` (k,). The level is their weighted mean."""
    level = np.sum(value / noise) / np.sum(1.0 / noise)
    return np.asarray(level + kernel @ np.linalg.solve(kernel + np.diag(noise), value - level))


def _diagonal(values: Array) -> Array:
    """(n, k, k) Diagonal matrices, each with one row of `values` (n, k) on its diagonal."""
    return values[:, :, None] * np.eye(values.shape[1])


def _solve_each(matrices: Array, values: Array) -> Array:
    """(n, k) For each of the n sessions the solution x of A x = b, A of `matrices` (n, k, k), b of `values` (n, k)."""
    return np.asarray(np.linalg.solve(matrices, values[:, :, None])[:, :, 0])
