"""The log-likelihood of the evidence under each hypothesis.

A hypothesis predicts of each block the power floor^2 + left * (power before - floor^2), with the share `left` drawn
from what right effects leave; an effect that stands in for an unknown one leaves what wrong ones do. What a block holds
beyond noise counts as one number, whatever its frames: it is one systematic misfit.
docs/diagnosis.md, "How it is weighed", has the reasons.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import log_ndtr

from tautline.diagnosis.hyperparameters import Hyperparameters
from tautline.diagnosis.stacked import LAWS, SHARES, WANDERS, WIDEST, Stacked, log_sum
from tautline.effects import EVENTS

Array = npt.NDArray[np.float64]

COINCIDES = 0.1  # prior: probability that an unknown effect goes with a column that was measured beside the motion
OWN_MISFIT = 0.3  # prior: mean power, times the floor's, that a nominal model leaves above it of its own calibration
EARLY = 0.5  # prior: probability that an unknown cause was there while calibrating, if it is one
_QUANTILES = -np.log1p(-(np.arange(15) + 0.5) / 15.0)  # equation: of an exponential prior of mean 1
_ALIKE = (0.01, 1.0)  # tolerance: limits of the share of a misfit by which a further effect looks like it


class Likelihoods:
    """Log-likelihoods of the hypotheses of a case, up to a common constant; arrays are (hypotheses,). `log_likelihood`:
    of each hypothesis, -inf where it is excluded. `prior`: its log prior weight. `unknown_scatter`: of scatter of
    unknown origin in the place of an event, which predicts frames as well as anything but that event; -inf where a
    hypothesis is not one event alone. `unknown`: one number, of an unknown cause that the best effects only imitate."""

    def __init__(self, case: Stacked, hyper: Hyperparameters) -> None:
        """Computes all of them for the hypotheses of `case` with these hyperparameters: the likelihood of the blocks'
        powers and of an event's scatter, times the likelihoods of what is left beyond the effects' stages (confined.py)
        and of how the effects' amplitudes vary (wander.py)."""
        self.hyper = hyper
        self._case = case
        known = hyper.noise_tells, hyper.block_freedom, hyper.calibration_excess
        self._by_share = case.log_likelihood_by_share(*known)
        self._by_right_share = case.log_likelihood_by_right_share(*known)
        # (hypotheses,) More than blocks in which the effects act count no more: of a block one number is told.
        self._parameters = np.minimum(case.parameters, case.acts)
        self._mimics = hyper.mimicked(self._parameters / np.maximum(case.size, 1))  # of a set as of its effects' mean
        # The share that a set of effects may well leave: as the worst of it.
        self._most = np.where(case.law, hyper.unexplained_by_law, hyper.unexplained)
        right = self._as_right_effects
        own = np.where(case.size > 0, right + self._log_chance_of_rival, self._log_likelihood_of_no_change)
        # Scatter is told from frame to frame: a block of it counts as many observations as one of noise.
        own = own + 0.5 * hyper.noise_tells * case.gain_by_event(hyper.calibration_excess)
        self.unknown_scatter: Array = np.where(case.scatters & (case.size == 1), right, -np.inf)
        replaced = self._replaced_by_contained
        reached = self._with_imitating_misfit(own, replaced)
        confined = case.confined_log_ratio(hyper.floor_known, hyper.floor_steady, hyper.disturbed)
        self.log_likelihood: Array = np.where(replaced, -np.inf, reached + confined + self.log_ratio_of_steadiness)
        self.unknown = self._log_likelihood_of_unknown(np.maximum(right, reached), replaced)

    @cached_property
    def best(self) -> dict[frozenset[str], int]:
        """{set of effects: index of the most probable hypothesis with exactly these effects}."""
        log_posterior = (self.log_likelihood + self.prior).tolist()
        return {key: max(same, key=log_posterior.__getitem__) for key, same in self._case.same.items()}

    def leader(self, key: frozenset[str], best: Mapping[frozenset[str], int]) -> str:
        """The effect of the set `key` that leads it. That is the effect whose hypothesis alone is likeliest; how its
        amplitude varies does not count, as the other effects are missing beside it. If the set has laws and no event it
        is the effect that alone leaves the smallest power, as laws leave nothing of their own. best: {set of effects:
        index of its hypothesis}."""
        by_power = LAWS & key and not EVENTS & key

        def alone(name: str) -> float:
            """How well the effect alone explains the gap, the larger the better; -inf where it was not fitted alone."""
            i = best.get(frozenset({name}))
            if i is None:
                return -np.inf
            return (
                -float(self._case.mean[i])
                if by_power
                else float(self.log_likelihood[i] - self.log_ratio_of_steadiness[i])
            )

        return max((alone(name), name) for name in self._case.leaders[key])[1]

    @cached_property
    def prior(self) -> Array:
        """(hypotheses,) Logarithm of each hypothesis' prior weight, up to a constant: odds_none without effects, else
        odds_further^(causes - 1) / (number of applicable effects), times odds_brought where an effect brings parts of
        the nominal model, and odds_each where one has amplitudes of its own in each recording."""
        case, hyper = self._case, self.hyper
        with_effects = (case.causes - 1) * np.log(hyper.odds_further) - np.log(case.applicable)
        with_effects = with_effects + np.where(case.brings, np.log(hyper.odds_brought), 0.0)
        with_effects = with_effects + np.where(case.each, np.log(hyper.odds_each), 0.0)
        return np.where(case.causes > 0, with_effects, np.log(hyper.odds_none))

    @property
    def _price(self) -> Array:
        """(hypotheses,) Nats that a hypothesis' d parameters cost by the Bayesian information criterion with n blocks:
        parameter_price d log(1 + n) / 2."""
        return np.asarray(0.5 * self.hyper.parameter_price * np.log1p(len(self._case.before)) * self._parameters)

    @property
    def _as_right_effects(self) -> Array:
        """(hypotheses,) Log-likelihood of the blocks' powers if the hypothesis' effects are right, minus the price of
        its parameters. It is summed over the prior of the share that right effects leave; beside an event any share is
        alike."""
        case, hyper = self._case, self.hyper
        of_law, usual, any_share = (
            self._log_right_share(most) for most in (hyper.unexplained_by_law, hyper.unexplained, 1.0)
        )
        log_prior = np.where(case.scatters[:, None], any_share, np.where(case.law[:, None], of_law, usual))
        return np.asarray(log_sum(self._by_right_share + log_prior) - self._price)

    @property
    def _log_chance_of_rival(self) -> Array:
        """(hypotheses,) For laws: log of the probability that some other effect leaves as much less as it does,
        although the law is right. That happens by noise alone (`Weighed.chance`), or with probability `mimics`, as the
        nominal model beside a law is not exact. 0 for other effects: no model of them is exact, so that an effect that
        leaves less is no evidence against them."""
        return np.asarray(np.log(self._mimics + (1.0 - self._mimics) * self._case.chance))

    def _with_imitating_misfit(self, own: Array, replaced: npt.NDArray[np.bool_]) -> Array:
        """(hypotheses,) For each hypothesis the larger of its own log-likelihood and that of a set with one effect
        more, reduced by the chance that what the additional effect closes is only misfit of the right ones
        (`_log_chance_of_misfit`). Events do not count as the additional effect. own: log-likelihood of each; replaced:
        which hypotheses are excluded."""
        case, by_chance = self._case, self._log_chance_of_misfit
        reached = np.where(replaced, -np.inf, own)
        for size in range(int(case.size.max()), 1, -1):  # the largest first: two further ones may imitate as well
            pairs = (case.size[case.further] == size) & (case.scatters[case.further] == case.scatters[case.fewer])
            i, j = case.fewer[pairs], case.further[pairs]
            np.maximum.at(reached, i, reached[j] + by_chance[pairs])
            reached[replaced] = -np.inf
        return reached

    def _log_likelihood_of_unknown(self, as_if_right: Array, replaced: npt.NDArray[np.bool_]) -> float:
        """Log-likelihood times prior of an unknown cause, for which the best one or two effects stand in. With
        probability `mimics` (its square root for the best of all pairs) they follow it as closely as if they were
        right, else they leave what wrong effects leave. In the hypothesis without effects any gap may be there.
        as_if_right: log-likelihoods as right effects; replaced: which hypotheses are excluded."""
        case, hyper = self._case, self.hyper
        pair = case.causes == 2
        mimics = np.where(pair, np.sqrt(self._mimics), self._mimics)
        imitates = np.where(case.size > 0, np.log(mimics) + as_if_right, -np.inf)
        as_wrong = log_sum(self._by_share + self._log_wrong_share) - self._price
        nothing_imitates = case.log_likelihood_of_any_gap(
            hyper.noise_tells, hyper.block_freedom, hyper.calibration_excess
        )
        as_wrong = np.log1p(-mimics) + np.where(case.size > 0, as_wrong, nothing_imitates)
        stands_in = np.logaddexp(imitates, as_wrong)
        stands_in = stands_in + np.where(case.measured, np.log(COINCIDES), 0.0)
        stands_in = stands_in + np.where(case.size > 0, self.prior, 0.0)
        # That it takes two costs nothing, as the cause is one; which two of all pairs they are is open.
        open_pairs = np.log(hyper.odds_further * 0.5 * max(case.applicable - 1, 1))
        stands_in = stands_in - np.where(pair, open_pairs, 0.0)
        return float(np.max(stands_in[~case.scatters & ~replaced]))

    @property
    def _replaced_by_contained(self) -> npt.NDArray[np.bool_]:
        """(hypotheses,) Whether a flexible effect is excluded in favour of a simpler one that it contains
        (`Stacked.contained`): the simpler one's power above the floor is below the share that a right effect may leave,
        of what is left without either."""
        left = self._case.mean - self._case.floor2
        return np.asarray((left < self._most * self._case.contained).any(axis=1))

    @property
    def _log_likelihood_of_no_change(self) -> float:
        """Log-likelihood that nothing changed since the calibration: in each block the calibrated model or its
        recalibration, whichever leaves less, leaves noise and an excess, which has an exponential prior of mean
        calibration_excess. If the recalibration takes a mean power `taken` off, in units of floor^2, that is
        improbable: exp(-taken / (the nominal model's own misfit + calibration_excess))."""
        case, hyper = self._case, self.hyper
        recalibrated = case.power[0]  # (blocks,) of the hypothesis without effects
        lesser = np.minimum(case.frozen, recalibrated)  # the difference counts in `taken`
        taken = max(float(np.mean(case.frozen - recalibrated)), 0.0) / case.floor2
        excess = hyper.calibration_excess * _QUANTILES[:, None]
        by_excess = case.log_likelihood(lesser, 0.0, excess, case.own_misfit, hyper.noise_tells, hyper.block_freedom)
        over_prior = float(log_sum(by_excess) - np.log(len(by_excess)))
        return over_prior - taken / (case.own_misfit / case.floor2 + hyper.calibration_excess)

    @property
    def unknown_from_start(self) -> float:
        """Probability that the calibrated model has an unknown cause in its own calibration, if nothing changed since.
        It compares two densities of x = power / floor^2 - 1 that is left there: 1 / (OWN_MISFIT + x) up to exp(WIDEST)
        for a cause, and an exponential one of mean OWN_MISFIT for a nominal model."""
        x = max(self._case.calibrated - 1.0, 0.0)
        of_cause = self.hyper.odds_unknown * EARLY / ((OWN_MISFIT + x) * np.log1p(np.exp(WIDEST) / OWN_MISFIT))
        of_nominal = self.hyper.odds_none * np.exp(-x / OWN_MISFIT) / OWN_MISFIT
        return float(of_cause / (of_cause + of_nominal))

    @property
    def _log_chance_of_misfit(self) -> Array:
        """(pairs,) For each pair of hypotheses, the second with one effect more: log of the probability that what this
        effect closes is only misfit that the right effects, those of the first, leave. With `left` and `after` the mean
        power above floor^2 that the first and the second leave, and s = (left - after) / (`inexact` power of the
        first), it is the sum of two terms. Misfit has to be so large: log Phi(-log(s / most) / share_spread). It has to
        look like the additional effect by chance: log(after / left) within _ALIKE; 0 where all effects of the second
        are parts of the nominal model, as curves follow any small misfit."""
        case = self._case
        left, after = (np.maximum(case.mean[of] - case.floor2, 1e-300) for of in (case.fewer, case.further))
        may_leave = np.maximum(np.mean(case.inexact[case.fewer], axis=1), 1e-300)
        share = np.maximum((left - after) / may_leave, 1e-12)
        parts = case.constant[case.further]
        as_large = log_ndtr(-np.log(share / self._most[case.fewer]) / self.hyper.share_spread)
        return np.asarray(as_large + np.where(parts, 0.0, np.log(np.clip(after / left, *_ALIKE))))

    @cached_property
    def log_ratio_of_steadiness(self) -> Array:
        """(hypotheses,) log p(w | right) - log p(w | wrong) of the effect with the smallest ratio, at most 0. w is the
        share of itself by which an effect's amplitude varies over place, speed, time, side and load (wander.py). For a
        right effect w is exponential with mean `wanders` (effects of geometry and time) or `wanders_material` (others).
        For a wrong one it is with probability `mimics` as for a right one, else exponential with mean 1."""
        case, hyper = self._case, self.hyper
        means = np.where(case.geometry, hyper.wanders, hyper.wanders_material)
        right, wrong = (log_sum(case.wander + _log_exponential(mean[:, None])) for mean in (means, np.ones_like(means)))
        mimics = self._mimics[case.wandering]
        ratio = right - np.logaddexp(np.log(mimics) + right, np.log1p(-mimics) + wrong)
        worst = np.zeros(len(case.size))  # 0 at most: some imitations are steady too, and noise has no amplitude
        np.minimum.at(worst, case.wandering, ratio)
        return worst

    def _log_right_share(self, most: float) -> Array:
        """(SHARES,) Log-probabilities (sum of probabilities 1) of the share of the gap that right effects leave:
        uniform in its logarithm up to `most`, falling like a log-normal density above it."""
        log: Array = -0.5 * np.square(np.maximum(np.log(SHARES / most), 0.0) / self.hyper.share_spread)
        return np.asarray(log - log_sum(log))

    @property
    def _log_wrong_share(self) -> Array:
        """(SHARES,) Log-probabilities (sum of probabilities 1) of the share of the gap that a wrong effect leaves:
        rising like a log-normal density up to the learnt share unexplained_by_wrong, uniform in its logarithm from
        there to 1."""
        log: Array = -0.5 * np.square(
            np.minimum(np.log(SHARES / self.hyper.unexplained_by_wrong), 0.0) / self.hyper.share_spread
        )
        return np.asarray(log - log_sum(log))


def _log_exponential(mean: Array) -> Array:
    """(..., WANDERS) Log-probabilities (sum of probabilities 1) of the values w in WANDERS under an exponential density
    with each mean (..., 1). As the grid is even in log w, they are proportional to w exp(-w / mean)."""
    log: Array = np.log(WANDERS) - WANDERS / mean
    return np.asarray(log - log_sum(log)[..., None])
