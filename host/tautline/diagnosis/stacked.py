"""The evidence of a diagnosis as arrays: rows are hypotheses, columns are blocks of manoeuvres.

Log-likelihoods that depend on few hyperparameters are remembered, as learning (tools/learning.py) weighs one case by
many sets of hyperparameters. A power is a mean square of held-out residuals, px^2 or deg^2 a coordinate.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, stdtr
from scipy.stats import invgamma

from tautline.diagnosis.hypotheses import CaseEvidence, Weighed
from tautline.effects import BY_ID, EVENTS, LIBRARY

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# Ids of effects, from their descriptors (effects/kind.py).
CONSTANT = frozenset(kind.id for kind in LIBRARY if kind.nominal)  # parts of the nominal model
LAWS = frozenset(kind.id for kind in LIBRARY if kind.law)
GEOMETRY = frozenset(kind.id for kind in LIBRARY if not kind.material and kind.transform is None)
MEASURED = frozenset(kind.id for kind in LIBRARY if kind.needs == "load")  # effects that follow a measured column
BROUGHT = {kind.id: frozenset(kind.brings) for kind in LIBRARY if kind.brings}
INEXACT = 4.0  # prior: times the floor's power that a nominal model may leave of its own calibration
CONFINED = 0.5  # prior: probability that what a wrong effect leaves is confined to its stage as well
SHARES = np.geomspace(1e-5, 1.0, 41)  # prior: grid of shares of a gap's power that an effect leaves
WANDERS = np.geomspace(3e-3, 3.0, 31)  # prior: grid of shares by which an amplitude may vary
_DEGREES = 8.0  # prior: degrees of freedom of Student's t, of the logarithm of a block's noise power
_WRONG_SHARES = (np.arange(10) + 0.5) / 10.0  # prior: grid of the share of blocks that hold what has another cause
_WIDEST = 12.0  # prior: largest logarithm of what a wrong effect leaves of a block, over the noise
_FLOOR_ERRORS = np.linspace(-20.0, 3.0, 116)  # tolerance: grid of the error of log(floor^2), in its deviations
_GAPS = np.linspace(0.0, _WIDEST, 25)  # tolerance: grid of the logarithm of a misfit's power over a number's noise
_TIMES = np.exp(np.linspace(-3.0, 12.0, 26))  # tolerance: grid of a block's misfit's power over the mean one
_AT_ONCE = 8  # tolerance: blocks whose product stays within a double
_REMEMBERED = 4  # tolerance: sets of hyperparameters of which results are kept


def log_sum(logarithms: Array) -> Array:
    """log(sum(exp(x))) along the last axis, without overflow."""
    most = np.max(logarithms, axis=-1)
    return np.asarray(most + np.log(np.sum(np.exp(logarithms - most[..., None]), axis=-1)))


@lru_cache(maxsize=8)
def _log_weights_of_times(freedom: float) -> Array:
    """(_TIMES,) Logarithms, of the sum 1, of the probability of each of _TIMES as an inverse-gamma number of mean
    precision 1: a normal number with that variance is Student's t with `freedom`."""
    log = invgamma(0.5 * freedom, scale=0.5 * freedom).logpdf(_TIMES) + np.log(_TIMES)
    return np.asarray(log - log_sum(log))


def _log_normal(square: Array, variance: Array) -> Array:
    """The normal log-density of a number with this square, up to a constant."""
    return np.asarray(-0.5 * (np.log(variance) + square / variance))


def _student_log_density(x: Array) -> Array:
    """Log-density at x (any shape) of the standard Student's t with _DEGREES degrees of freedom."""
    n = _DEGREES
    constant = gammaln(0.5 * (n + 1.0)) - gammaln(0.5 * n) - 0.5 * np.log(n * np.pi)
    return np.asarray(constant - 0.5 * (n + 1.0) * np.log1p(np.square(x) / n))


def _wander_log_ratio(matrix: Array, gradient: Array) -> Array:
    """(len(WANDERS),) For each w of WANDERS: log of p(residuals | the effect's amplitude varies) / p(residuals | it is
    constant). If it varies, the coefficients of m polynomials of place, speed, time, side and load by which the
    effect's signal is multiplied (wander.py) are N(0, w^2 / m) each. With eigenpairs (l, v) of matrix / m and b =
    v'gradient / sqrt(m) the ratio is sum(w^2 b^2 / (1 + w^2 l) - log(1 + w^2 l)) / 2. matrix (m, m), gradient (m,):
    normal equations of the coefficients, divided by the noise's power."""
    eigenvalues, vectors = np.linalg.eigh(matrix / len(gradient))
    squares, eigenvalues = np.square(vectors.T @ gradient) / len(gradient), np.maximum(eigenvalues, 0.0)
    variance = np.square(WANDERS)[:, None]
    widened = 1.0 + variance * eigenvalues
    return np.asarray(0.5 * np.sum(variance * squares / widened - np.log(widened), axis=1))


def brought_parts(ids: Collection[str]) -> frozenset[str]:
    """Those of these effects that are parts of the nominal model which another of them changes too (`Kind.brings`)."""
    return frozenset().union(*(BROUGHT.get(name, frozenset()) for name in ids)) & set(ids)


def _beside(flexible: frozenset[str], simple: frozenset[str]) -> frozenset[str] | None:
    """Whether the set of effects `flexible` gives way to the set `simple` if that suffices: an effect of the former
    contains one of the latter (`Kind.contains`), and the others are the same; parts of the nominal model may be beside
    the flexible effect alone. If so the effects that both have, else None. Events of the flexible set do not count:
    they would be seen beside the simple one too."""
    flexible = flexible - EVENTS
    others = flexible - simple
    for inner in simple:
        in_its_place = len(others) == 1 and inner not in flexible
        of_the_nominal = others <= CONSTANT and inner not in CONSTANT
        contained = any(inner in BY_ID[name].contains for name in others)
        if contained and simple - {inner} <= flexible and (in_its_place or of_the_nominal):
            return simple - {inner}
    return None


class Stacked:
    """Arrays over the hypotheses of one case. The first hypothesis is without any effect."""

    def __init__(self, evidence: CaseEvidence) -> None:
        """Reads all arrays out of the evidence of a case."""
        hypotheses = evidence.hypotheses
        self.floor2 = evidence.floor**2
        self._doubt, self._unsteady, self.noisier = evidence.doubt, evidence.unsteady, evidence.noisier
        # A block with less power than the noise has had less noise, whatever the hypothesis.
        self.frozen = np.maximum(evidence.frozen, self.floor2)  # (blocks,) left by the calibrated model as it is
        self.applicable = evidence.applicable
        # What a nominal model may leave of any recording above the noise: what it leaves of its own calibration. Where
        # an effect was there while calibrating, that is what the effect left, and says nothing of the model.
        self.calibrated = evidence.calibrated / self.floor2  # what the calibrated model leaves of it, over the floor's
        self.own_misfit = float(np.clip(self.calibrated, 1.0, INEXACT) - 1.0) * self.floor2
        self._own_misfit_of = np.where([h.from_start for h in hypotheses], 0.0, self.own_misfit)  # (hypotheses,)
        self.power = np.maximum([h.power for h in hypotheses], self.floor2)  # (hypotheses, blocks)
        self.before = self.power[0] - self.floor2  # (blocks,) the gap's power above the floor
        self.mean = np.mean(self.power, axis=1)  # (hypotheses,)
        self.parameters = np.array([h.parameters for h in hypotheses], dtype=float)
        self.acts = self._blocks_in_which_effects_act
        self.chance = np.array([h.chance for h in hypotheses])
        self.each: Flags = np.array([h.each for h in hypotheses])  # an effect has its own amplitude in each recording
        self._set_scatter(hypotheses)
        self._set_effects(hypotheses)
        self._set_inexact()
        self._set_wander(hypotheses)
        self._set_beyond(hypotheses)
        self.log_likelihood_by_share = lru_cache(_REMEMBERED)(self._log_likelihood_by_share)
        self.log_likelihood_by_right_share = lru_cache(_REMEMBERED)(self._log_likelihood_by_right_share)
        self.confined_log_ratio = lru_cache(_REMEMBERED)(self._confined_log_ratio)

    @property
    def _blocks_in_which_effects_act(self) -> Array:
        """(hypotheses,) In how many blocks each leaves less power than the nominal model alone: Kish's effective number
        by how much less, at least 1; all blocks where it leaves nowhere less."""
        less = np.maximum(self.power[0] - self.power, 0.0)
        squares = np.sum(less**2, axis=1)
        count = np.square(np.sum(less, axis=1)) / np.where(squares > 0.0, squares, 1.0)
        return np.where(squares > 0.0, np.maximum(count, 1.0), len(self.before))

    def _set_scatter(self, hypotheses: Sequence[Weighed]) -> None:
        """Which hypotheses have an event (`scatters`), and (hypotheses, blocks) each: logarithms of the power over the
        noise's that is left of a block's frames, with the event as the explanation of their scatter (`by_event`), and
        with the best one that is none, if that leaves less than the path alone (`without_event`); and whether frames of
        the block count for the event (`in_sight`)."""
        scatter, rival = np.array([h.scatter for h in hypotheses]), np.array([h.rival for h in hypotheses])
        self.scatters: Flags = np.asarray(scatter.any(axis=1))
        # Of an event that came later the calibration's blocks do not count: `scatter` and `rival` are 0 there.
        self.in_sight: Flags = (scatter != 0.0) | (rival != 0.0) | ~self.scatters[:, None]
        above_noise = np.log(self.power / self.floor2)
        self.by_event, self.without_event = above_noise + scatter, above_noise + np.minimum(rival, 0.0)

    def _set_effects(self, hypotheses: Sequence[Weighed]) -> None:
        """Which effects each hypothesis has: flags of their kinds, the number of its causes, which hypothesis replaces
        which (`contained`), and all pairs of which the second has one effect more (`fewer`, `further`: indices)."""
        self.ids = [h.ids for h in hypotheses]
        self.sets = [frozenset(h.ids) for h in hypotheses]
        self.same: dict[frozenset[str], list[int]] = {}  # indices of the hypotheses with the same effects
        for i, key in enumerate(self.sets):
            self.same.setdefault(key, []).append(i)
        self.leaders = {key: key - brought_parts(key) for key in self.same}  # which effects may lead a set
        self.size = np.array([len(key) for key in self.sets])
        self.law: Flags = np.array([key <= LAWS for key in self.sets])
        self.constant = np.array([bool(key) and key <= CONSTANT for key in self.sets])
        self.measured = np.array([bool(key & MEASURED) for key in self.sets])
        parts = [self.leaders[key] & CONSTANT for key in self.sets]
        # Parts of the nominal model move together and are one cause; with an effect that brings them they are none.
        self.causes = np.array([len(key - CONSTANT) + bool(own) for key, own in zip(self.sets, parts, strict=True)])
        self.brings = np.array([own != key & CONSTANT for key, own in zip(self.sets, parts, strict=True)])
        self._set_contained()
        pairs = [
            (i, j)
            for i, less in enumerate(self.sets)
            for j, more in enumerate(self.sets)
            if less and len(more) == len(less) + 1 and less < more
        ]
        self.fewer, self.further = np.array(pairs, dtype=int).reshape(-1, 2).T

    def _set_contained(self) -> None:
        """`contained` (hypotheses, hypotheses): where a set is replaced by a simpler one, the power above the floor
        that is left without the flexible effect and what stands for it; else -inf."""
        least = {key: float(np.min(self.mean[same])) - self.floor2 for key, same in self.same.items()}
        beside = [[_beside(key, simple) for simple in self.sets] for key in self.sets]
        self.contained = np.array(
            [[-np.inf if rest is None else least.get(rest, -np.inf) for rest in of] for of in beside]
        )

    def _set_inexact(self) -> None:
        """`inexact` (hypotheses, blocks): of which power above the floor right effects leave a share. What laws among
        them take they take whole, so beside laws it is what these leave: the least that was fitted with some of them
        alone. The whole gap of a set of laws, or without any."""
        of_laws = {key: same for key, same in self.same.items() if key and key <= LAWS}
        left = {key: self.power[min(same, key=lambda i: self.mean[i])] - self.floor2 for key, same in of_laws.items()}
        self.inexact = np.tile(self.before, (len(self.sets), 1))
        for i in np.flatnonzero(~self.law):
            beside = [power for key, power in left.items() if key <= self.sets[i]]
            if beside:
                self.inexact[i] = np.minimum(min(beside, key=lambda power: float(np.mean(power))), self.before)

    def _set_wander(self, hypotheses: Sequence[Weighed]) -> None:
        """Prepares the test of whether an effect's amplitude is the same everywhere; if it wanders with place, speed,
        time, side or load, the effect is hardly the cause. A row for each effect in `wanders` of each hypothesis:
        `wandering` (rows,) the hypothesis' index; `wander` (rows, WANDERS) the log-likelihood ratio of an amplitude
        that varies by each of these shares of itself to a constant one; `geometry` (rows,) whether the effect is one of
        geometry or time."""
        effects = [(i, effect) for i, h in enumerate(hypotheses) for effect in h.wanders]
        ratios = [_wander_log_ratio(effect.matrix, effect.gradient) for _, effect in effects]
        self.wandering = np.array([i for i, _ in effects], dtype=int)
        self.wander = np.array(ratios).reshape(-1, len(WANDERS))
        self.geometry: Flags = np.array([effect.id in GEOMETRY for _, effect in effects], dtype=bool)

    def _set_beyond(self, hypotheses: Sequence[Weighed]) -> None:
        """(rows, blocks) the powers that no law of the effects' stages could leave and how many independent numbers
        each is of; hypotheses whose stages leave the same share a row."""
        self._beyond_row: list[int] = []  # of each hypothesis; -1: its stages could leave anything
        rows: dict[bytes, int] = {}
        power, count = [], []
        for h in hypotheses:
            if h.beyond is None:
                self._beyond_row.append(-1)
                continue
            content = h.beyond.power.tobytes()
            if content not in rows:
                rows[content] = len(rows)
                power.append(h.beyond.power)
                count.append(h.beyond.count)
            self._beyond_row.append(rows[content])
        self._beyond_power, self._beyond_count = np.array(power), np.array(count)

    def foretold_better(self, calibration_excess: float) -> Array:
        """(hypotheses,) By how much an event foretells the frames better than anything that is none: the sum over its
        blocks of the logarithm of the power, below 0 where it foretells them worse; 0 without an event. Nothing is
        foretold better than a sound calibration does, (1 + calibration_excess) floor^2."""
        least = np.log1p(calibration_excess)
        by_event, without = (np.maximum(left, least) for left in (self.by_event, self.without_event))
        gained = np.zeros(len(self.scatters))
        for i in np.flatnonzero(self.scatters):
            here = self.in_sight[i]
            of_all = np.sum(without[:, here], axis=1)
            same = ~self.scatters | (self.in_sight == here).all(axis=1)
            gained[i] = float(np.min(of_all[same])) - float(np.sum(by_event[i, here]))
        return gained

    def log_likelihood(
        self,
        power: Array,
        misfit: Array | float,
        excess: Array | float,
        own_misfit: Array | float,
        tells: float,
        freedom: float,
        disturbed: float = 1.0,
    ) -> Array:
        """(...,) Log-likelihood, up to a constant, of all blocks' powers (..., blocks) if a share `disturbed` of them
        holds, beside noise of (1 + excess) floor^2, a misfit of mean power `misfit`, and each the nominal model's own,
        at most `own_misfit`.

        A block counts as `tells` numbers of noise, and what it holds beyond noise as one, x: of the block's power v in
        units of floor^2 the noise has up to n = 1 + excess, and x^2 = n + tells (v - n). x is normal with variance w =
        n + tells u misfit / floor^2; u, by how much a block's misfit is more or less than its mean, is inverse-gamma,
        so that x is Student's t with `freedom` beside normal noise; a sum over _TIMES. Where x^2 exceeds the mean of w
        the model's own misfit adds up to tells own_misfit / floor^2. That is k = blocks / 2 numbers, as each is there
        twice, in the calibration and in a test: k log(1 + sum(y) / k) replaces sum(log(1 + y)), y the relative increase
        of w."""
        noise = 1.0 + np.asarray(excess)
        square, of_noise = self._beyond_noise(power, noise, tells)
        of_misfit = tells * np.asarray(misfit) / self.floor2
        mean = noise + of_misfit
        increase = np.clip(square - mean, 0.0, tells * np.asarray(own_misfit) / self.floor2) / mean
        k = 0.5 * increase.shape[-1]
        shared = 0.5 * (np.sum(np.log1p(increase), axis=-1) - k * np.log1p(np.sum(increase, axis=-1) / k))
        times = noise[..., None] + _TIMES * of_misfit[..., None]
        by_times = _log_normal(square[..., None], times * (1.0 + increase[..., None])) + _log_weights_of_times(freedom)
        of_number = log_sum(by_times)
        if disturbed < 1.0:
            undisturbed = np.log1p(-disturbed) + _log_normal(square, noise * (1.0 + increase))
            of_number = np.logaddexp(undisturbed, np.log(disturbed) + of_number)
        return np.asarray(shared + np.sum(of_noise + of_number, axis=-1))

    def _beyond_noise(self, power: Array, noise: Array, tells: float) -> tuple[Array, Array]:
        """(x^2 of blocks' powers (..., blocks), the log-likelihood of the other tells - 1 numbers), as in
        `log_likelihood`. noise: its power over floor^2."""
        of_noise = np.minimum(power / self.floor2, noise)
        square = of_noise + tells * (power / self.floor2 - of_noise)
        return square, -0.5 * (tells - 1.0) * (np.log(noise) + of_noise / noise)

    def _log_likelihood_by_share(self, tells: float, freedom: float, excess: float) -> Array:
        """(hypotheses, SHARES) Log-likelihood of all blocks' powers if a hypothesis' effects leave each of SHARES of
        the gap's power (`before`). tells, freedom, excess: the hyperparameters noise_tells, block_freedom and
        calibration_excess."""
        every = np.arange(len(self.sets))
        return self._log_likelihood_of_shares(every, np.tile(self.before, (len(every), 1)), tells, freedom, excess)

    def _log_likelihood_by_right_share(self, tells: float, freedom: float, excess: float) -> Array:
        """(hypotheses, SHARES) As `log_likelihood_by_share`, of shares of `inexact`."""
        by_share = self.log_likelihood_by_share(tells, freedom, excess).copy()
        beside_law = np.flatnonzero((self.inexact < self.before).any(axis=1))
        if len(beside_law):
            of_inexact = self._log_likelihood_of_shares(beside_law, self.inexact[beside_law], tells, freedom, excess)
            by_share[beside_law] = of_inexact
        return by_share

    def _log_likelihood_of_shares(
        self, of: npt.NDArray[np.int64], power: Array, tells: float, freedom: float, excess: float
    ) -> Array:
        """(n, SHARES) Log-likelihood of all blocks' powers if each of n hypotheses (indices `of`) leaves that share of
        `power` (n, blocks)."""
        own_misfit = self._own_misfit_of[of, None]
        return np.stack(
            [
                self.log_likelihood(self.power[of], share * power, excess, own_misfit, tells, freedom)
                for share in SHARES
            ],
            axis=1,
        )

    def log_likelihood_of_any_gap(self, tells: float, freedom: float, excess: float) -> float:
        """Log-likelihood of the gap itself if nothing imitates its cause: a share of the blocks, any, holds a misfit,
        of any mean power up to _WIDEST in its logarithm over the noise; the same constant as `log_likelihood`'s."""
        misfits = self.floor2 / tells * np.exp(_GAPS)[:, None]
        by_share = [
            self.log_likelihood(self.power[0], misfits, excess, self.own_misfit, tells, freedom, share)
            for share in _WRONG_SHARES
        ]
        return float(log_sum(np.ravel(by_share)) - np.log(np.size(by_share)))

    def _confined_log_ratio(self, floor_known: float, floor_steady: float, disturbed: float) -> Array:
        """(hypotheses,) Log-likelihood ratio of the power that is left beyond the effects' stages (confined.py): noise
        in all but a share `disturbed` of the blocks, as beside right effects, against more than noise in a share of the
        blocks that may be any, as beside wrong ones; 0 where nothing is known of it. floor_known, floor_steady:
        standard deviations of the logarithm of the noise's power, between cases and between the blocks of one."""
        if not len(self._beyond_power):
            return np.zeros(len(self._beyond_row))
        by_share = self._log_likelihood_of_disturbed(floor_known, floor_steady, np.array([disturbed, *_WRONG_SHARES]))
        right, wrong = by_share[0], log_sum(by_share[1:].T) - np.log(len(_WRONG_SHARES))
        ratio = right - np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + wrong)
        return np.append(ratio, 0.0)[self._beyond_row]

    def _log_likelihood_of_disturbed(self, floor_known: float, floor_steady: float, shares: Array) -> Array:
        """(shares, rows) Log-likelihood of the powers beyond the effects' stages if each block is noise, or with the
        probability of that share noise and any disturbance on top of it: prod((1 - s) noise + s disturbed), integrated
        over the error of the floor. The logarithm x of a disturbed block's power over the noise has a density
        proportional to 1 / (x + its spread) from 0 to _WIDEST. The parameters are `_confined_log_ratio`'s."""
        x = np.log(np.maximum(self._beyond_power / self.floor2, 1e-6))[:, None]  # (rows, 1, blocks)
        spread = np.sqrt(2.0 / np.maximum(self._beyond_count, 1.0) + floor_steady**2 + self._unsteady**2)[:, None]
        floor_known = float(np.hypot(floor_known, self._doubt))
        # The error of the log noise power: below the floor exponential, as what rests may well scatter more.
        error = _FLOOR_ERRORS * floor_known
        prior = np.where(error > 0.0, -0.5 * np.square(error / floor_known), -np.abs(error))
        above_noise = x - error[:, None]  # (rows, errors, blocks)
        noise = _student_log_density(above_noise / spread) - np.log(spread)
        # What disturbs a block comes on top of its noise, which has to be low where the block is.
        noise_is_lower = np.log(stdtr(_DEGREES, above_noise / spread))
        disturbed = noise_is_lower - np.log((np.maximum(above_noise, 0.0) + spread) * np.log1p(_WIDEST / spread))
        relative = np.exp(disturbed - noise) - 1.0
        share = shares[:, None, None]
        mixed = np.zeros((len(shares), *noise.shape[:2]))  # sum over blocks of log(1 + share relative)
        for first in range(0, noise.shape[2], _AT_ONCE):
            product = np.ones_like(mixed)
            for block in range(first, min(first + _AT_ONCE, noise.shape[2])):
                product *= 1.0 + share * relative[:, :, block]
            mixed += np.log(product)
        return log_sum(prior + np.sum(noise, axis=2) + mixed) - log_sum(prior)
