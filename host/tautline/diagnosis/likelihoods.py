"""How likely each hypothesis makes the evidence.

It predicts of each block the power floor^2 + left * (power before - floor^2), with `left` drawn from what right effects
leave; an effect that stands in for an unknown one leaves what wrong ones do. A block counts as few independent
observations, whatever its number of frames: what is left of it is one systematic misfit, not noise.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, log_expit, log_ndtr

from tautline.diagnosis.hyperparameters import Hyperparameters
from tautline.diagnosis.hypotheses import Beyond, CaseEvidence, Weighed
from tautline.effects import BY_ID, EVENTS, LIBRARY

Array = npt.NDArray[np.float64]

COINCIDES = 0.1  # probability that an unknown effect goes with a column that was measured beside the motion
MEASURED = frozenset(kind.id for kind in LIBRARY if kind.needs == "load")  # effects that follow such a column
CONSTANT = frozenset(kind.id for kind in LIBRARY if kind.nominal)  # parts of the nominal model
LAWS = frozenset(kind.id for kind in LIBRARY if kind.law)
BROUGHT = {kind.id: frozenset(kind.brings) for kind in LIBRARY if kind.brings}
LOG_ODDS_MARGIN = 5.0  # of every rival, as a logarithm: an event beside another effect that is told for sure
OWN_EXCESS = 0.5  # of the floor's power: what its own calibration may leave above it and nothing be wrong
INEXACT = 4.0  # times the floor's power that a nominal model may leave of its own calibration
CONFINED = 0.5  # probability that what a wrong effect leaves is confined to its stage as well
_SHARES = np.geomspace(1e-5, 1.0, 41)
_DEGREES = 8.0  # of freedom, of a block's noise
_WRONG_SHARES = (np.arange(10) + 0.5) / 10.0  # of blocks that a wrong effect disturbs
_WIDEST = 12.0  # of a disturbed block's logarithm


def _log_sum(logarithms: Array) -> Array:
    """Of exponentials along the last axis, as a logarithm."""
    most = np.max(logarithms, axis=-1)
    return np.asarray(most + np.log(np.sum(np.exp(logarithms - most[..., None]), axis=-1)))


def _student(x: Array) -> Array:
    """Logarithm of the density of Student's t."""
    n = _DEGREES
    constant = gammaln(0.5 * (n + 1.0)) - gammaln(0.5 * n) - 0.5 * np.log(n * np.pi)
    return np.asarray(constant - 0.5 * (n + 1.0) * np.log1p(np.square(x) / n))


def brought(ids: Collection[str]) -> frozenset[str]:
    """The parts of the nominal model among these that another of them brings with it."""
    return frozenset().union(*(BROUGHT.get(name, frozenset()) for name in ids)) & set(ids)


class Likelihoods:
    """Logarithms: `of` each hypothesis, of `unknown`, and of scatter of another origin (`elsewhere`) than a hypothesis
    says. A block's residual is Student's t in as many dimensions as it tells: blocks differ from what is predicted."""

    def __init__(self, evidence: CaseEvidence, by: Hyperparameters) -> None:
        self.by = by
        self._floor2 = evidence.floor**2
        self._applicable = evidence.applicable
        self._before = np.maximum(evidence.hypotheses[0].power - self._floor2, 0.0)
        self._nominal2 = float(np.clip(evidence.calibrated, self._floor2, INEXACT * self._floor2))
        self._tells = self.by.misfit_tells + self.by.noise_tells * np.square(
            self._floor2 / (self._floor2 + self._before)
        )
        # What a path follows on blocks that its fit did not see is no scatter, of whatever origin.
        paths = [float(np.mean(h.power)) for h in evidence.hypotheses if not h.scatter.any()]
        self._followed = min(paths, default=np.inf)
        self._price = 0.5 * self.by.parameter_price * np.log1p(float(np.sum(self._tells)))
        hypotheses = self._hypotheses = evidence.hypotheses
        tables = [self._by_share(h) for h in hypotheses]
        own = [
            float(_log_sum(table + self._right(h))) + self._gain(h, h.scatter)
            if h.ids
            else self._nothing(evidence.frozen)
            for h, table in zip(hypotheses, tables, strict=True)
        ]
        # Scatter of an event or of another origin: as their likelihoods are.
        other = [self._gain(h, h.rival) - self._gain(h, h.scatter) if h.scatter.any() else -np.inf for h in hypotheses]
        alone = np.array([0.0 if len(h.ids) == 1 and not self._is_a_path(h) else -np.inf for h in hypotheses])
        self.elsewhere = np.array(own) + log_expit(other) + alone
        # Beside another effect an event has to say more than what that one leaves of itself, which remembers too: so
        # much is no sign of either, unless the event is far ahead of it.
        single = [float(np.logaddexp(0.0, more)) for more in other]
        beside = [max(0.0, self._gain(h, h.rival)) if h.scatter.any() else 0.0 for h in hypotheses]
        lost = [b if len(h.ids) > 1 else a for h, a, b in zip(hypotheses, single, beside, strict=True)]
        own = list(np.array(own) - lost)
        far = [
            b if len(h.ids) > 1 and more < -LOG_ODDS_MARGIN else 0.0
            for h, b, more in zip(hypotheses, beside, other, strict=True)
        ]
        memo: dict[bytes, float] = {}  # hypotheses of one stage leave the same beyond it
        confined = np.zeros(len(hypotheses))
        for i, h in enumerate(hypotheses):
            if h.beyond is not None:
                beyond = h.beyond.power.tobytes()
                memo[beyond] = memo.get(beyond) or self._confined(h.beyond)
                confined[i] = memo[beyond]
        self.of = np.array(own) + far + confined
        sets = [frozenset(h.ids) for h in hypotheses]
        left = [float(np.sum(h.power * np.exp(h.scatter) - self._floor2)) for h in hypotheses]
        for i, h in enumerate(hypotheses):
            for j in range(len(hypotheses)) if h.ids else ():
                if len(hypotheses[j].ids) == len(h.ids) + 1 and sets[i] < sets[j]:
                    all_of_it = own[j] + (far[j] if h.scatter.any() else 0.0)
                    by_chance = self._by_chance(h, max(left[i], 1e-300), left[j])
                    self.of[i] = max(self.of[i], all_of_it + by_chance + confined[i])
        self._give_way(hypotheses)
        self.unknown = max(
            self._stands_in(h, table) + (self.prior(h.ids) if h.ids else 0.0)
            for h, table in zip(hypotheses, tables, strict=True)
            if not h.scatter.any()
        )

    def alone(self, i: int | None, key: Collection[str]) -> float:
        """How much a single effect, if it was tried, says of a set that it is in. Of a law nothing may be left, but
        what it leaves beside others is not its own: there the one leads that leaves least."""
        if i is None:
            return -np.inf
        by_power = LAWS & set(key) and not EVENTS & set(key)
        return -float(np.mean(self._hypotheses[i].power)) if by_power else float(self.of[i])

    def _give_way(self, hypotheses: Sequence[Weighed]) -> None:
        """An effect that can do a simpler one's part too says nothing where the simpler one alone leaves no more than a
        right effect may: it is that one, and more of it only beside it."""
        before = max(float(np.mean(self._before)), 1e-300)
        simple = {
            h.ids[0]
            for h in hypotheses
            if len(h.ids) == 1 and float(np.mean(h.power)) - self._floor2 < self._most(h.ids) * before
        }
        for i, h in enumerate(hypotheses):
            if len(h.ids) == 1 and simple & set(BY_ID[h.ids[0]].contains):
                self.of[i] = -np.inf

    def _stands_in(self, h: Weighed, table: Array) -> float:
        """For an unknown effect, which now and then it follows as closely as if it were right."""
        follows = np.log(self.by.mimics) + _log_sum(table + self._right(h)) if h.ids else -np.inf
        chance = np.log(COINCIDES) if MEASURED & set(h.ids) else 0.0
        return float(chance + np.logaddexp(follows, np.log1p(-self.by.mimics) + _log_sum(table + self._wrong)))

    def prior(self, ids: Collection[str]) -> float:
        """Of one hypothesis. Parts of the nominal model move together; what brings one with it is one cause."""
        moved = CONSTANT & set(ids)
        own = moved - brought(ids)
        effects = len(set(ids) - CONSTANT) + bool(own)
        if effects == 0:
            return float(np.log(self.by.odds_none))
        with_it = np.log(self.by.odds_brought) if own != moved else 0.0
        return float((effects - 1) * np.log(self.by.odds_further) - np.log(self._applicable) + with_it)

    def _by_share(self, h: Weighed) -> Array:
        """Of what is left of each block, at every one of _SHARES. Other parts in the nominal model make it no more
        exact than it was where it was calibrated; more parameters than observations are no freedom."""
        floor2 = self._nominal2 if h.ids and set(h.ids) <= CONSTANT else self._floor2
        predicted = (1.0 + self.by.calibration_excess) * floor2 + _SHARES[:, None] * self._before
        n = self._tells
        freedom = min(h.parameters, float(np.sum(n)))
        loss = n * np.log(predicted) + (self.by.block_freedom + n) * np.log1p(
            n * h.power / (self.by.block_freedom * predicted)
        )
        return np.asarray(-0.5 * np.sum(loss, axis=1) - self._price * freedom)

    def _gain(self, h: Weighed, scatter: Array) -> float:
        forgets = 0.0 if self._is_a_path(h) else h.white**2
        return -0.5 * (self.by.misfit_tells + self.by.noise_tells * forgets) * float(np.sum(scatter))

    def _is_a_path(self, h: Weighed) -> bool:
        """Whether a path leaves less than scatter on top of this hypothesis would."""
        scattered = float(np.mean(h.power * np.exp(np.minimum(h.scatter, h.rival))))
        return bool(h.scatter.any()) and self._followed < scattered

    def _confined(self, beyond: Beyond) -> float:
        """Logarithm of how much likelier what is left beyond the effects' stages is as noise, in all blocks but a few,
        than as what a wrong effect leaves: noise as well, or noise in any share of the blocks only."""
        x = np.log(np.maximum(beyond.power / self._floor2, 1e-6))
        spread = np.sqrt(2.0 / np.maximum(beyond.count, 1.0) + self.by.floor_steady**2)
        # Of the case's noise: less than the floor often, as what rests may well scatter more.
        off = np.linspace(-20.0, 3.0, 116) * self.by.floor_known
        prior = np.where(off > 0.0, -0.5 * np.square(off / self.by.floor_known), -np.abs(off))
        away = x - off[:, None]
        noise = _student(away / spread) - np.log(spread)
        disturbed = -np.log((np.maximum(away, 0.0) + spread) * np.log1p(_WIDEST / spread))  # as likely any size
        ratio = np.exp(disturbed - noise)
        rest = prior + np.sum(noise, axis=1)

        def in_all_but(shares: Array) -> Array:
            mixed = np.log1p(shares[:, None, None] * (ratio - 1.0)).sum(axis=2)
            return _log_sum(rest + mixed) - _log_sum(prior)

        right, *some = in_all_but(np.array([self.by.disturbed, *_WRONG_SHARES]))
        wrong = _log_sum(np.array(some)) - np.log(len(some))
        return float(right - np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + wrong))

    def _nothing(self, frozen: Array) -> float:
        """The calibrated model as it is leaves noise and little more: what a recalibration takes of it is what the
        calibration did not know, and a gap that it closes is a gap, one in a single block too."""
        n = self._tells
        freedom = self.by.block_freedom
        usual = (freedom + n) * np.log1p(n / freedom)  # where the power is as predicted both agree
        quantiles = -np.log1p(-(np.arange(15) + 0.5) / 15.0)  # of an exponential prior
        own = min(self._nominal2 / self._floor2 - 1.0, OWN_EXCESS)
        above = own + self.by.calibration_excess * quantiles
        predicted = (1.0 + above[:, None]) * self._floor2
        recalibrated = self._hypotheses[0].power
        taken = max(float(np.mean(frozen - recalibrated)), 0.0) / self._floor2
        loss = usual + n * (np.log(predicted) + np.minimum(frozen, recalibrated) / predicted - 1.0)
        said = float(_log_sum(-0.5 * np.sum(loss, axis=1)) - np.log(len(above)))
        return said - taken / (own + self.by.calibration_excess)

    def _by_chance(self, h: Weighed, left: float, after: float) -> float:
        """Logarithm of the probability that what a further effect closes is what a right one leaves: that this is so
        much, and that another effect looks so like it (what it closes of it is as likely to be any share)."""
        closed = left - after
        share = max(closed / max(float(np.sum(self._before)), 1e-300), 1e-12)
        so_much = float(log_ndtr(-(np.log(share) - np.log(self._most(h.ids))) / self.by.share_spread))
        return so_much + float(np.log(np.clip(1.0 - closed / left, 0.01, 1.0)))

    def _up_to(self, most: float) -> Array:
        """Logarithms of _SHARES' probabilities where any magnitude up to `most` may well be left; falling beyond."""
        log: Array = -0.5 * np.square(np.maximum(np.log(_SHARES / most), 0.0) / self.by.share_spread)
        return np.asarray(log - _log_sum(log))

    def _right(self, h: Weighed) -> Array:
        """The same if a hypothesis is right; with scatter, whose power stays, any."""
        return self._up_to(1.0 if h.scatter.any() else self._most(h.ids))

    @cached_property
    def _wrong(self) -> Array:
        """The same if the best effect stands in for another: from a least share any magnitude to 1, falling below."""
        log: Array = -0.5 * np.square(
            np.minimum(np.log(_SHARES / self.by.unexplained_by_wrong), 0.0) / self.by.share_spread
        )
        return np.asarray(log - _log_sum(log))

    def _most(self, ids: Collection[str]) -> float:
        """The share that these may well leave: as the worst of them."""
        return self.by.unexplained_by_law if set(ids) <= LAWS else self.by.unexplained
