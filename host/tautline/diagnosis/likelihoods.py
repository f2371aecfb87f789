"""How likely each hypothesis makes the evidence.

It predicts of each block the power floor^2 + left * (power before - floor^2), with `left` drawn from what right effects
leave; an effect that stands in for an unknown one leaves what wrong ones do. A block counts as few independent
observations, whatever its number of frames: what is left of it is one systematic misfit, not noise.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import log_expit, log_ndtr

from tautline.diagnosis.hyperparameters import Hyperparameters
from tautline.diagnosis.stacked import FOLLOWED, LAWS, SHARES, WANDERS, Stacked, log_sum
from tautline.effects import EVENTS

Array = npt.NDArray[np.float64]

COINCIDES = 0.1  # prior: probability that an unknown effect goes with a column that was measured beside the motion
LOG_ODDS_MARGIN = 5.0  # loss: of every rival, as a logarithm: an event beside another effect that is told for sure
_QUANTILES = -np.log1p(-(np.arange(15) + 0.5) / 15.0)  # equation: of an exponential prior


class Likelihoods:
    """Logarithms: `of` each hypothesis, its `prior`, of `unknown`, and of scatter of another origin (`elsewhere`) than
    a hypothesis says. A block's residual is Student's t in as many dimensions as it tells: blocks differ from what is
    predicted."""

    def __init__(self, case: Stacked, by: Hyperparameters) -> None:
        """Weighs every hypothesis of the evidence `case` by the hyperparameters `by`: `of` and `elsewhere`,
        (hypotheses,), and `unknown`, one number, are log-likelihoods up to a common constant; -inf where a hypothesis
        is excluded or, in `elsewhere`, is not of one event's scatter alone."""
        self.by = by
        self._case = case
        self._tells = case.tells(by.misfit_tells, by.noise_tells)
        table = case.by_share(by.misfit_tells, by.noise_tells, by.block_freedom, by.calibration_excess)
        told = float(np.sum(self._tells))
        # More parameters than observations are no freedom.
        price = 0.5 * by.parameter_price * np.log1p(told) * np.minimum(case.parameters, told)
        # The share that a set may well leave: as the worst of it.
        self._most = np.where(case.law, by.unexplained_by_law, by.unexplained)
        by_law, usual, any_share = (
            self._log_right_share(most) for most in (by.unexplained_by_law, by.unexplained, 1.0)
        )
        alone = np.where(case.law[:, None], by_law, usual)
        right = log_sum(table + np.where(case.scatters[:, None], any_share, alone)) - price
        gain, rival = self._gain(case.scatter), self._gain(case.rival)
        # A law is exact, but for what the nominal beside it leaves.
        beaten = np.log(by.mimics + (1.0 - by.mimics) * case.chance)
        own = np.where(case.size > 0, right + gain + beaten, self._log_likelihood_of_no_change)
        # Scatter of an event or of another origin: as their likelihoods are.
        other = np.where(case.scatters, rival - gain, -np.inf)
        self.elsewhere = np.where((case.size == 1) & ~case.path, own + log_expit(other), -np.inf)
        # Beside another effect an event has to say more than what that one leaves of itself, which remembers too: so
        # much is no sign of either, unless the event is far ahead of it.
        further = case.size > 1
        beside = np.where(case.scatters, np.maximum(rival, 0.0), 0.0)
        own = own - np.where(further, beside, np.logaddexp(0.0, other))
        far = np.where(further & (other < -LOG_ODDS_MARGIN), beside, 0.0)
        confined = case.confined(by.floor_known, by.floor_steady, by.disturbed)
        says_nothing = self._contained_suffices
        # What a simpler effect does as well says no more of those beside it than that one does.
        reached, by_chance = np.where(says_nothing, -np.inf, own), self._log_chance_of_misfit
        for size in range(int(case.size.max()), 1, -1):  # what two further ones close may be what one leaves as well
            pairs = case.size[case.further] == size
            i, j = case.fewer[pairs], case.further[pairs]
            np.maximum.at(reached, i, reached[j] + np.where(case.scatters[i], far[j], 0.0) + by_chance[pairs])
            reached[says_nothing] = -np.inf
        self.of: Array = np.maximum(own + far, reached) + confined + self.steady
        self.of[says_nothing | (case.repeats & ~further)] = -np.inf
        # Now and then the best effect follows an unknown one as closely as if it were right, with all that is granted
        # to one that is; more often two do together.
        pair = case.causes == 2
        mimics = np.where(pair, np.sqrt(by.mimics), by.mimics)
        granted = np.where(case.scatters, right, np.maximum(right, reached))
        follows = np.where(case.size > 0, np.log(mimics) + granted, -np.inf)
        stands_in = np.logaddexp(follows, np.log1p(-mimics) + log_sum(table + self._log_wrong_share) - price)
        stands_in = stands_in + np.where(case.measured, np.log(COINCIDES), 0.0)
        stands_in = stands_in + np.where(case.size > 0, self.prior, 0.0)
        # That it takes two costs nothing, as the cause is one; which two of all pairs they are is open.
        open_pairs = np.log(by.odds_further * 0.5 * max(case.applicable - 1, 1))
        stands_in = stands_in - np.where(pair, open_pairs, 0.0)
        self.unknown = float(np.max(stands_in[~case.scatters & ~says_nothing]))

    @cached_property
    def best(self) -> dict[frozenset[str], int]:
        """For each set of effects the index of its most probable hypothesis."""
        of = (self.of + self.prior).tolist()
        return {key: max(same, key=of.__getitem__) for key, same in self._case.same.items()}

    def leader(self, key: frozenset[str], best: Mapping[frozenset[str], int]) -> str:
        """Which effect of the set `key` leads: the one whose hypothesis alone is likeliest, not counting that its
        amplitude wanders as others are missing. Among laws the one that alone leaves the least power: a law leaves
        nothing of its own. best: the hypothesis of each set."""
        by_power = LAWS & key and not EVENTS & key

        def alone(name: str) -> float:
            """How well the effect does alone, the more the better; -inf where it was not fitted alone."""
            i = best.get(frozenset({name}))
            if i is None:
                return -np.inf
            return -float(self._case.mean[i]) if by_power else float(self.of[i] - self.steady[i])

        return max((alone(name), name) for name in self._case.leaders[key])[1]

    @cached_property
    def prior(self) -> Array:
        """(hypotheses,) Logarithm of each hypothesis' prior weight, by the number of its causes, up to a constant."""
        case, by = self._case, self.by
        some = (case.causes - 1) * np.log(by.odds_further) - np.log(case.applicable)
        some = some + np.where(case.brings, np.log(by.odds_brought), 0.0)
        some = some + np.where(case.each, np.log(by.odds_each), 0.0)
        return np.where(case.causes > 0, some, np.log(by.odds_none))

    def _gain(self, scatter: Array) -> Array:
        """(hypotheses,) Log-likelihood gained by an event. scatter (hypotheses,): logarithm of the factor that it puts
        on the blocks' power, summed over them, below 0 where it explains scatter."""
        return np.asarray(-0.5 * (self.by.misfit_tells + self.by.noise_tells * self._case.forgets) * scatter)

    @property
    def _contained_suffices(self) -> npt.NDArray[np.bool_]:
        """(hypotheses,) Whether a more flexible effect gives way to a simpler one that it contains: the simpler one
        alone leaves no more than a right effect may."""
        before = max(float(np.mean(self._case.before)), 1e-300)
        little = self._case.mean - self._case.floor2 < self._most * before
        return np.asarray(self._case.does_as_well[:, little].any(axis=1))

    @property
    def _log_likelihood_of_no_change(self) -> float:
        """Log-likelihood that nothing changed: the calibrated model leaves noise and what a nominal model may leave.
        What a recalibration takes off is improbable then, be it in one block only."""
        case, by, n = self._case, self.by, self._tells
        usual = (by.block_freedom + n) * np.log1p(n / by.block_freedom)  # where the power is as predicted both agree
        recalibrated = case.power[0]
        least = np.minimum(case.frozen, recalibrated)
        taken = max(float(np.mean(case.frozen - recalibrated)), 0.0) / case.floor2
        alone = (1.0 + by.calibration_excess * _QUANTILES)[:, None] * np.full(len(n), case.floor2)
        predicted, once = case.with_own(alone, least, by.misfit_tells, by.noise_tells)
        said = once - 0.5 * np.sum(usual + n * (np.log(predicted) + least / predicted - 1.0), axis=1)
        own = case.nominal2 / case.floor2 - 1.0
        return float(log_sum(said) - np.log(len(said))) - taken / (own + by.calibration_excess)

    @property
    def _log_chance_of_misfit(self) -> Array:
        """(pairs,) Logarithm of the probability that what one further effect closes is only the misfit that the right
        one leaves: that this misfit is as large, times that the further effect looks so like it (the share that it
        closes of it is uniform). A further part of the nominal model is a curve by place, which follows any small
        misfit."""
        case = self._case
        left, after = np.maximum(case.left[case.fewer], 1e-300), case.left[case.further]
        share = np.maximum((left - after) / max(float(np.sum(case.before)), 1e-300), 1e-12)
        parts = case.constant[case.further]
        most = np.where(parts, np.minimum(self._most[case.fewer], FOLLOWED), self._most[case.fewer])
        so_much = log_ndtr(-(np.log(share) - np.log(most)) / self.by.share_spread)
        return np.asarray(so_much + np.where(parts, 0.0, np.log(np.clip(after / left, 0.01, 1.0))))

    @cached_property
    def steady(self) -> Array:
        """(hypotheses,) Log-likelihood ratio, at most 0, of the amplitudes varying over place, speed, time, side and
        load as a right effect's do (little) against as a wrong one's do (by any share). The worst effect of each
        hypothesis counts."""
        case, by = self._case, self.by
        means = np.where(case.geometry, by.wanders, by.wanders_material)
        right, wrong = (log_sum(case.wander + _exponential(mean[:, None])) for mean in (means, np.ones_like(means)))
        each = right - np.logaddexp(np.log(by.mimics) + right, np.log1p(-by.mimics) + wrong)
        least = np.zeros(len(case.size))  # some imitations are steady too, and noise has no amplitude
        np.minimum.at(least, case.wandering, each)
        return least

    def _log_right_share(self, most: float) -> Array:
        """Log-probabilities of SHARES for what a right effect leaves: any magnitude up to `most` alike, log-normally
        falling above."""
        log: Array = -0.5 * np.square(np.maximum(np.log(SHARES / most), 0.0) / self.by.share_spread)
        return np.asarray(log - log_sum(log))

    @property
    def _log_wrong_share(self) -> Array:
        """Log-probabilities (sum 1) of SHARES, even in their logarithm, for the share of the gap that a wrong effect
        leaves: log-normally rising to the learnt least share, any magnitude from it to 1 alike."""
        log: Array = -0.5 * np.square(
            np.minimum(np.log(SHARES / self.by.unexplained_by_wrong), 0.0) / self.by.share_spread
        )
        return np.asarray(log - log_sum(log))


def _exponential(mean: Array) -> Array:
    """(..., WANDERS) Log-probabilities of WANDERS for an exponential density of each mean (..., 1) over a grid of
    logarithmic steps."""
    log: Array = np.log(WANDERS) - WANDERS / mean
    return np.asarray(log - log_sum(log)[..., None])
