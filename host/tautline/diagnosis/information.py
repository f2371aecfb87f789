"""How much recordings that are not made yet are expected to tell about which hypothesis is right, in nats.

Where hypothesis h is right, g is fitted anew to what h predicts (one linear step from all recordings so far, g's own
parameters and the nominal's) and leaves a power above the noise. That costs g as many nats as a verdict would take
for it (likelihoods.py): half of a block's independent observations, times the logarithm of the power over what h
itself leaves, noise and a share of the gap, for each block. An unknown cause leaves what the best imitation of it
does. The expected information is the mutual information between hypothesis and recording, -sum_h p_h log sum_g p_g
exp(-D_hg) (Kolchinsky and Tracey 2017).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve

from tautline.diagnosis.fit import Fitter
from tautline.diagnosis.fitted import Fit
from tautline.diagnosis.gap import BLOCK_S
from tautline.diagnosis.hyperparameters import learnt
from tautline.diagnosis.segment import Segment
from tautline.least_squares import factor

Array = npt.NDArray[np.float64]

_NEVER_SURER = 0.01  # prior: of each hypothesis, whatever the posterior says: a motion is to refute what leads, too


@dataclass(frozen=True)
class Rivals:
    """The hypotheses that could be right, with probabilities that sum to 1. The first fit is the nominal model without
    any effect."""

    fits: tuple[Fit, ...]
    probability: Array  # (fits + 1,): the last one of an unknown cause

    @classmethod
    def of(cls, fits: Sequence[Fit], probability: Sequence[float], parameters: int = 1) -> Rivals:
        """probability: of each fit and, last, of an unknown cause; each is raised to _NEVER_SURER at least, and they
        are normalised. Of an unknown cause, the share that the likeliest fit imitates everywhere is moved to that fit,
        as no motion could tell the two apart (`Hyperparameters.mimicked`, with the fit's number of `parameters`)."""
        hyper, known = learnt().center, np.asarray(probability, dtype=float)
        likeliest = int(np.argmax(known[:-1]))
        mimics = min(known[-1], hyper.odds_unknown * float(hyper.mimicked(parameters)) * known[likeliest])
        known[likeliest], known[-1] = known[likeliest] + mimics, known[-1] - mimics
        known = np.maximum(known, _NEVER_SURER)
        return cls(tuple(fits), known / float(np.sum(known)))

    @property
    def entropy(self) -> float:
        """The entropy of the probabilities, nats: the most that any recording can tell."""
        return -float(self.probability @ np.log(self.probability))


class Outlook:
    """What planned recordings would tell about the rivals. For each recording it holds what this would add to the least
    squares of every rival's refit to every other rival's prediction. These sums add up over recordings, so that any
    choice of recordings is evaluated without a simulation."""

    def __init__(self, fitter: Fitter, rivals: Rivals, planned: Sequence[Segment], weight: float) -> None:
        """fitter: of the recordings so far. planned: recordings to be made; their times and motors count, not
        `observed`. weight: how many of the sensor's observations one observation of `planned` stands for. It simulates
        every planned recording by every rival."""
        self.rivals = rivals
        fits, ahead = rivals.fits, fitter.on_recordings(planned)
        known = [self._known_precision(fitter, fit) for fit in fits]
        rows = [ahead.linearised(fit) for fit in fits]
        size = len(fits)
        self._noise2 = (1.0 + learnt().center.calibration_excess) * fitter.floor**2
        self._known_matrix = known
        # Of each rival g with m unknowns, refitted to what the rival h predicts of each recording: the normal matrices
        # (planned, m, m), whatever h is, and the gradients (planned, h, m).
        self._matrix = [np.zeros((len(planned), *matrix.shape)) for matrix in known]
        self._gradient = [np.zeros((len(planned), size, len(matrix))) for matrix in known]
        self._squares = np.zeros((len(planned), size, size))  # [recording, h, g]: what g leaves of h, not refitted
        self._count = np.zeros(len(planned))  # how many numbers each recording has
        for i in range(len(planned)):
            self._count[i] = weight * rows[0][i].residual.size
            for g in range(size):
                for h in range(size):
                    # h's prediction less g's: both residuals are of the same `observed`.
                    apart = np.nan_to_num(rows[g][i].residual - rows[h][i].residual)
                    part = ahead.normal(replace(rows[g][i], residual=apart))
                    self._gradient[g][i, h] = weight * part.gradient
                    self._squares[i, h, g] = weight * float(np.sum(apart**2))
                self._matrix[g][i] = weight * part.matrix

    @staticmethod
    def _known_precision(fitter: Fitter, fit: Fit) -> Array:
        """(m, m) The information of the recordings so far about a fit's unknowns: their normal matrix plus the prior's
        precision, multiplied by the noise power (px^2 or deg^2)."""
        rows = fitter.linearised(fit)
        parts = (
            fitter.normal(row, weight=np.full_like(row.residual, 1.0 / times**2)).matrix
            for row, times in zip(rows, fitter.relative_noise, strict=True)
        )
        return np.asarray(sum(parts) + fitter.floor**2 * fitter.prior_precision(fit.hypothesis))

    def power_left(self, which: Sequence[int]) -> Array:
        """(fits, fits) Element [h, g]: mean square above the noise, px^2 or deg^2, that rival g leaves of the
        recordings `which` (indices) after it is refitted, if rival h is right."""
        chosen = list(which)
        squares = np.sum(self._squares[chosen], axis=0)
        for g, (matrix, gradient) in enumerate(zip(self._matrix, self._gradient, strict=True)):
            total = np.sum(gradient[chosen], axis=0)  # (h, m)
            factored = factor(self._known_matrix[g] + np.sum(matrix[chosen], axis=0))
            squares[:, g] -= np.sum(total.T * cho_solve(factored, total.T, check_finite=False), axis=0)
        return np.asarray(np.maximum(squares, 0.0) / float(np.sum(self._count[chosen])))

    def expected(self, which: Sequence[int], seconds: float) -> float:
        """The expected information, nats, of the recordings `which` (indices), which last `seconds` s together. It is
        the formula of this module's docstring with D_hg = n / 2 log(1 + what g leaves / what h itself leaves), n the
        number of blocks."""
        hyper = learnt().center
        left = self.power_left(which)
        gap = left[:, 0]  # of each right hypothesis: what the nominal model leaves
        known = len(gap)
        power = np.zeros((known + 1, known + 1))
        power[:known, :known] = left
        power[:known, known] = power[known, :known] = hyper.unexplained_by_wrong * gap
        # An unknown cause looks like what is likeliest, and the others leave of it what they leave of that.
        likeliest = int(np.argmax(self.rivals.probability[:known]))
        power[known, :known] = left[likeliest] + hyper.unexplained_by_wrong * gap[likeliest]
        gap = np.append(gap, gap[likeliest])
        # Of a block one number is told beside the noise; the right one leaves some of it as no model is exact.
        own = self._noise2 / hyper.noise_tells + hyper.unexplained * gap
        against = 0.5 * (seconds / BLOCK_S) * np.log1p(power / own[:, None])
        p = self.rivals.probability
        return -float(p @ np.log(np.exp(-against) @ p))
