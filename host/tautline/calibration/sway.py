"""The probability that a bare instrument's tip rests, though the place that is followed on it sways in the image.

Tissue that moves behind the place takes it along a little. If the tip does not move that sway is the only motion, and
whatever the motor does, something begins after each of its turns: onsets would be invented. Three explanations of a
recording are compared:

- it rests: y is a level plus an Ornstein-Uhlenbeck process in time that is small against the square that is followed;
- it follows the motor: y is an unknown path, about as long as the rig makes it, over the centre of a play, plus such a
  process;
- it roams: a level plus a process that is larger than a resting place could sway.

All are linear with Gaussian unknowns and white noise, so their marginal likelihoods are exact; size and memory of the
process and the play's width are averaged over grids, which are their priors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.special import logsumexp

from tautline.elements import Play
from tautline.recording import Motor

Array = npt.NDArray[np.float64]

# Each prior is flat over its values.
_SIZES, _STEPS = 9, 14  # prior: how far it goes at all, and from one frame to the next
_LEAST = 0.3  # prior: of the noise: a sway that is none
_RESTS = 0.25  # prior: of the square's side: a place that goes farther (standard deviation) does not rest
_WIDTHS = np.array([0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 0.8])  # prior: of a play, in shares of the motor's way
_NODES = 12  # prior: places of the path at which it is unknown, straight between them


@dataclass(frozen=True)
class _Sway:
    """The covariance S of n frames of Ornstein-Uhlenbeck sway plus white noise, by a banded Cholesky factor."""

    factor: Array  # of the sway's posterior precision given the frames, tridiagonal
    variance: float  # of the noise
    volume: float  # log det S

    @classmethod
    def of(cls, t_s: Array, size: float, memory_s: float, sigma: float) -> _Sway:
        """The process at times t_s (n,), s. size: its standard deviation; memory_s: its correlation time, s; sigma:
        standard deviation of the white noise."""
        kept, fresh = np.exp(-np.diff(t_s) / memory_s), -np.expm1(-2.0 * np.diff(t_s) / memory_s)
        # Precision of the process at unit size, tridiagonal: each value is `kept` times the one before plus noise of
        # variance `fresh`.
        precision = np.zeros((2, len(t_s)))  # upper form: what is beside the diagonal, the diagonal
        precision[1] = np.append(1.0, 1.0 / fresh) + np.append(kept**2 / fresh, 0.0)
        precision[0, 1:] = -kept / fresh
        precision /= size**2
        precision[1] += sigma**-2
        factor = cholesky_banded(precision)
        volume = 2.0 * float(np.log(factor[1]).sum()) + float(np.log(fresh).sum())
        return cls(factor, sigma**2, volume + 2.0 * len(t_s) * float(np.log(size * sigma)))

    def expected(self, rows: Array) -> Array:
        """(n, k) posterior mean of the sway, if each column of rows (n, k) is sway plus noise."""
        return np.asarray(cho_solve_banded((self.factor, False), rows / self.variance))

    def log_likelihood(self, columns: Array, spread: float, y: Array) -> float:
        """Log marginal likelihood of y (n, channels), if each channel is columns (n, k) times amplitudes N(0,
        spread^2), plus sway and noise; without the constant -n channels / 2 log 2 pi. It is -1/2 (y' V^-1 y + channels
        log det V) with V = S + spread^2 columns columns', by the Woodbury identity."""
        k = columns.shape[1]
        rows = np.hstack([columns, y])
        solved = (rows - self.expected(rows)) / self.variance
        normal = columns.T @ solved[:, :k] + np.eye(k) / spread**2
        right = columns.T @ solved[:, k:]
        squares = float(np.sum(y * solved[:, k:]) - np.sum(right * np.linalg.solve(normal, right)))
        volume = self.volume + float(np.linalg.slogdet(normal)[1]) + 2.0 * k * float(np.log(spread))
        return float(-0.5 * (squares + y.shape[1] * volume))


def probability_of_rest(t_s: Array, y: Array, sigma: float, paths: Sequence[Array], swing: float, side: float) -> float:
    """The probability that the place rests. Before, resting is as probable as not resting, and the latter is divided
    equally between following the motor and roaming. y (n, channels): seen at t_s (n,), s, with noise sigma; paths: for
    each width of the play its centre (n,) at these times; swing: how far the rig moves the image over the motor's
    range; side: of the square that is followed. All in y's unit but paths."""
    y = y - np.median(y, axis=0)
    sizes = np.geomspace(_LEAST * sigma, max(swing, side), _SIZES)
    # Frames tell best how far it goes in one of their periods: a small and a large one are tried at the same steps.
    steps, period_s = np.geomspace(_LEAST * sigma, side, _STEPS), float(np.median(np.diff(t_s)))
    pairs = [
        (size, 2.0 * period_s * (size / step) ** 2)
        for size in sizes.tolist()
        for step in steps.tolist()
        if step <= size
    ]
    sways = [_Sway.of(t_s, size, memory, sigma) for size, memory in pairs]
    lasts = float(t_s[-1] - t_s[0])
    # The standard deviation about the mean in such a time: size / sqrt(1 + 3 memory / lasts), to a twentieth.
    may_rest = np.array([size <= _RESTS * side * np.sqrt(1.0 + 3.0 * memory / lasts) for size, memory in pairs])
    level = np.ones((len(y), 1))
    told = np.array([sway.log_likelihood(level, swing, y) for sway in sways])
    follows = [sway.log_likelihood(_hat_functions(path), swing, y) for path in paths for sway in sways]
    # Marginal log likelihoods, each averaged over its prior's grid: `moving` half following the motor and half roaming.
    resting = logsumexp(told[may_rest]) - np.log(may_rest.sum())
    moving = np.logaddexp(
        logsumexp(follows) - np.log(len(follows)), logsumexp(told[~may_rest]) - np.log((~may_rest).sum())
    ) - np.log(2.0)
    return float(np.exp(-np.logaddexp(0.0, moving - resting)))


def _hat_functions(path: Array) -> Array:
    """(n, nodes) piecewise linear basis over the range of path (n,)."""
    nodes = np.linspace(path.min(), path.max(), _NODES)
    return np.stack([np.interp(path, nodes, row) for row in np.eye(_NODES)], axis=1)


def play_paths(motor: Motor, scene_s: Array) -> list[Array]:
    """For each width of the prior the centre (n,) of a play that the motor drives, unit of q, at times scene_s (n,),
    s."""
    low, high = float(motor.q.min()), float(motor.q.max())
    paths = []
    for width in (_WIDTHS * (high - low)).tolist():
        play = Play(np.array([low, high]), np.full(2, width))
        centre = play.forward(motor.q) if width else motor.q
        paths.append(np.interp(scene_s, motor.t_s, centre))
    return paths
