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
WIDEST = 12.0  # prior: largest logarithm of what a wrong effect leaves of a block, over the noise
_FLOOR_ERRORS = np.linspace(-20.0, 3.0, 116)  # tolerance: grid of the error of log(floor^2), in its deviations
_GAPS = np.linspace(0.0, WIDEST, 25)  # tolerance: grid of the logarithm of a misfit's power over a number's noise
_TIMES = np.exp(np.linspace(-3.0, 12.0, 26))  # tolerance: grid of a block's misfit's power over the mean one
_AT_ONCE = 8  # tolerance: blocks whose product stays within a double
_REMEMBERED = 4  # tolerance: sets of hyperparameters of which results are kept


def log_sum(logarithms: Array) -> Array:
    """log(sum(exp(x))) along the last axis, computed without overflow."""
    most = np.max(logarithms, axis=-1)
    return np.asarray(most + np.log(np.sum(np.exp(logarithms - most[..., None]), axis=-1)))


@lru_cache(maxsize=8)
def _log_weights_of_times(freedom: float) -> Array:
    """(_TIMES,) Log-probabilities (sum of probabilities 1) of the variances _TIMES under an inverse-gamma density of
    mean precision 1. A normal number whose variance is drawn from it follows Student's t with `freedom` degrees of
    freedom."""
    log = invgamma(0.5 * freedom, scale=0.5 * freedom).logpdf(_TIMES) + np.log(_TIMES)
    return np.asarray(log - log_sum(log))


def _log_normal(square: Array, variance: Array) -> Array:
    """Log-density, up to a constant, of a normal number with mean 0 and this variance, given the number's square."""
    return np.asarray(-0.5 * (np.log(variance) + square / variance))


def _student_log_density(x: Array) -> Array:
    """Log-density of the standard Student's t with _DEGREES degrees of freedom, at x (any shape)."""
    n = _DEGREES
    constant = gammaln(0.5 * (n + 1.0)) - gammaln(0.5 * n) - 0.5 * np.log(n * np.pi)
    return np.asarray(constant - 0.5 * (n + 1.0) * np.log1p(np.square(x) / n))


def _wander_log_ratio(matrix: Array, gradient: Array) -> Array:
    """(WANDERS,) For each w of WANDERS the log of p(residuals | the effect's amplitude varies by w) / p(residuals | it
    is constant). If it varies, the effect's signal is multiplied by m functions of place, speed, time, side and load
    (wander.py), whose coefficients are N(0, w^2 / m) each. With eigenpairs (l, v) of matrix / m and b = v'gradient /
    sqrt(m) the result is sum(w^2 b^2 / (1 + w^2 l) - log(1 + w^2 l)) / 2. matrix (m, m), gradient (m,): normal
    equations of the coefficients, divided by the noise's power."""
    eigenvalues, vectors = np.linalg.eigh(matrix / len(gradient))
    squares, eigenvalues = np.square(vectors.T @ gradient) / len(gradient), np.maximum(eigenvalues, 0.0)
    variance = np.square(WANDERS)[:, None]
    widened = 1.0 + variance * eigenvalues
    return np.asarray(0.5 * np.sum(variance * squares / widened - np.log(widened), axis=1))


def brought_parts(ids: Collection[str]) -> frozenset[str]:
    """The ids among `ids` that are parts of the nominal model and are brought by another effect among them
    (`Kind.brings`)."""
    return frozenset().union(*(BROUGHT.get(name, frozenset()) for name in ids)) & set(ids)


@lru_cache(maxsize=2**16)  # tolerance: the pairs of hypotheses of a case or two: all are asked for at each verdict
def _in_common_if_replaced(flexible: frozenset[str], simple: frozenset[str]) -> frozenset[str] | None:
    """The effects that two sets have in common, if the set `flexible` gives way to the set `simple` where that
    suffices; else None. It gives way if one of its effects contains one of `simple` (`Kind.contains`) and the other
    effects are the same; parts of the nominal model may be beside the containing effect alone. Events of `flexible` are
    ignored, as they would be seen beside the simple effect too."""
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
    """Arrays over the hypotheses and blocks of one case. The first hypothesis is without any effect."""

    def __init__(self, evidence: CaseEvidence) -> None:
        """Computes all arrays from the evidence of a case. Powers below the noise's, floor^2, count as that."""
        hypotheses = evidence.hypotheses
        self.floor2 = evidence.floor**2
        self._doubt, self._unsteady = evidence.doubt, evidence.unsteady
        # A block with less power than the noise has had less noise, whatever the hypothesis.
        self.frozen = np.maximum(evidence.frozen, self.floor2)  # (blocks,) left by the calibrated model as it is
        self.applicable = evidence.applicable
        # What a nominal model may leave of any recording above the noise: what it leaves of its own calibration. Where
        # an effect was there while calibrating, that is what the effect left, and says nothing of the model.
        self.calibrated = evidence.calibrated / self.floor2  # power left of the own calibration, over the floor's
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
        """(hypotheses,) The effective number of blocks in which a hypothesis leaves less power than the nominal model
        alone: Kish's (sum d)^2 / sum d^2 of the differences d, at least 1; all blocks where it leaves less in none."""
        less = np.maximum(self.power[0] - self.power, 0.0)
        squares = np.sum(less**2, axis=1)
        count = np.square(np.sum(less, axis=1)) / np.where(squares > 0.0, squares, 1.0)
        return np.where(squares > 0.0, np.maximum(count, 1.0), len(self.before))

    def _set_scatter(self, hypotheses: Sequence[Weighed]) -> None:
        """Sets `scatters` (hypotheses,), whether a hypothesis has an event, and three arrays (hypotheses, blocks).
        `by_event` and `without_event` are logs of the power, over the noise's, that is left of a block's frames: with
        the event as the explanation of their scatter, and with the best explanation that is no event (the path alone,
        if no rival is better). `in_sight` is whether frames of the block count for the event."""
        scatter, rival = np.array([h.scatter for h in hypotheses]), np.array([h.rival for h in hypotheses])
        self.scatters: Flags = np.asarray(scatter.any(axis=1))
        # Of an event that came later the calibration's blocks do not count: `scatter` and `rival` are 0 there.
        self.in_sight: Flags = (scatter != 0.0) | (rival != 0.0) | ~self.scatters[:, None]
        above_noise = np.log(self.power / self.floor2)
        self.by_event, self.without_event = above_noise + scatter, above_noise + np.minimum(rival, 0.0)

    def _set_effects(self, hypotheses: Sequence[Weighed]) -> None:
        """Sets which effects each hypothesis has: flags of their kinds, the number of its causes, and which hypothesis
        replaces which (`contained`). `fewer` and `further` are the indices of all pairs of hypotheses with at least one
        effect of which the second has exactly one effect more."""
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
        """Sets `contained` (hypotheses, hypotheses): for each set of effects (row) and each simpler set that replaces
        it (column), the smallest mean power above the floor of the effects that both have (`_in_common_if_replaced`);
        -inf for all other pairs, and where these were not fitted."""
        least = {key: float(np.min(self.mean[same])) - self.floor2 for key, same in self.same.items()}
        beside = [[_in_common_if_replaced(key, simple) for simple in self.sets] for key in self.sets]
        self.contained = np.array(
            [[-np.inf if rest is None else least.get(rest, -np.inf) for rest in of] for of in beside]
        )

    def _set_inexact(self) -> None:
        """Sets `inexact` (hypotheses, blocks): the power above the floor of which right effects leave a share. That is
        the whole gap for laws alone, and without laws. Laws take their part exactly; beside laws it is therefore the
        smallest power that was left with some of these laws alone, at most the gap."""
        of_laws = {key: same for key, same in self.same.items() if key and key <= LAWS}
        left = {key: self.power[min(same, key=lambda i: self.mean[i])] - self.floor2 for key, same in of_laws.items()}
        self.inexact = np.tile(self.before, (len(self.sets), 1))
        for i in np.flatnonzero(~self.law):
            beside = [power for key, power in left.items() if key <= self.sets[i]]
            if beside:
                self.inexact[i] = np.minimum(min(beside, key=lambda power: float(np.mean(power))), self.before)

    def _set_wander(self, hypotheses: Sequence[Weighed]) -> None:
        """Sets the arrays for the test of whether an effect's amplitude is constant; if it varies with place, speed,
        time, side or load, the effect is hardly the cause. A row is one effect of one hypothesis. `wandering` (rows,):
        index of the hypothesis; `wander` (rows, WANDERS): log-likelihood ratio of an amplitude that varies by each of
        WANDERS to a constant one; `geometry` (rows,): whether the effect is one of geometry or time."""
        effects = [(i, effect) for i, h in enumerate(hypotheses) for effect in h.wanders]
        ratios = [_wander_log_ratio(effect.matrix, effect.gradient) for _, effect in effects]
        self.wandering = np.array([i for i, _ in effects], dtype=int)
        self.wander = np.array(ratios).reshape(-1, len(WANDERS))
        self.geometry: Flags = np.array([effect.id in GEOMETRY for _, effect in effects], dtype=bool)

    def _set_beyond(self, hypotheses: Sequence[Weighed]) -> None:
        """Sets `_beyond_power` (rows, blocks), the powers that no law of the effects' stages could leave, and
        `_beyond_count`, how many independent numbers each is the mean of. `_beyond_row` is the row of each hypothesis
        (-1: none); hypotheses with the same powers share one."""
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

    def gain_by_event(self, calibration_excess: float) -> Array:
        """(hypotheses,) By how much an event predicts the frames better than anything without an event: the sum over
        its blocks of the log of the power, the best without less that with the event; negative where it predicts them
        worse, 0 without an event. Powers count as at least what a sound calibration leaves, (1 + calibration_excess)
        floor^2."""
        least = np.log1p(calibration_excess)
        by_event, without = (np.maximum(left, least) for left in (self.by_event, self.without_event))
        gained = np.zeros(len(self.scatters))
        for i in np.flatnonzero(self.scatters):
            counts = self.in_sight[i]
            sums_without = np.sum(without[:, counts], axis=1)
            # Hypotheses without an event, and those whose event counts in the same blocks.
            comparable = ~self.scatters | (self.in_sight == counts).all(axis=1)
            gained[i] = float(np.min(sums_without[comparable])) - float(np.sum(by_event[i, counts]))
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
        """(...,) Log-likelihood, up to a constant, of all blocks' powers (..., blocks), px^2 or deg^2. Each block holds
        noise of (1 + excess) floor^2 and the nominal model's own misfit, at most `own_misfit`; with probability
        `disturbed` also a misfit of mean power `misfit`.

        A block counts as `tells` numbers of noise, and what it holds beyond noise as one number x. Of the block's power
        v, in units of floor^2, the noise has up to n = 1 + excess, and x^2 = n + tells (v - n). x is normal with
        variance w = n + tells u misfit / floor^2. The factor u, by how much a block's misfit differs from the mean one,
        is inverse-gamma, so that x is Student's t with `freedom` beside normal noise; the integral over u is a sum over
        _TIMES. Where x^2 exceeds the mean of w, the model's own misfit raises w by a share y, by up to tells own_misfit
        / floor^2. As each block's own misfit is there twice, in the calibration and in a test, there are k = blocks / 2
        of them: k log(1 + sum(y) / k) replaces sum(log(1 + y))."""
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
        """(x^2 of each block, log-likelihood of its other tells - 1 numbers), both (..., blocks), as defined in
        `log_likelihood`. power: (..., blocks); noise: n there, its power over floor^2."""
        of_noise = np.minimum(power / self.floor2, noise)
        square = of_noise + tells * (power / self.floor2 - of_noise)
        return square, -0.5 * (tells - 1.0) * (np.log(noise) + of_noise / noise)

    def _log_likelihood_by_share(self, tells: float, freedom: float, excess: float) -> Array:
        """(hypotheses, SHARES) Log-likelihood of all blocks' powers if a hypothesis' effects leave each of SHARES of
        the gap's power, `before`. tells, freedom, excess: the hyperparameters noise_tells, block_freedom and
        calibration_excess."""
        all_hypotheses = np.arange(len(self.sets))
        return self._log_likelihood_of_shares(
            all_hypotheses, np.tile(self.before, (len(all_hypotheses), 1)), tells, freedom, excess
        )

    def _log_likelihood_by_right_share(self, tells: float, freedom: float, excess: float) -> Array:
        """(hypotheses, SHARES) As `_log_likelihood_by_share`, but of shares of the power `inexact`."""
        by_share = self.log_likelihood_by_share(tells, freedom, excess).copy()
        beside_law = np.flatnonzero((self.inexact < self.before).any(axis=1))
        if len(beside_law):
            of_inexact = self._log_likelihood_of_shares(beside_law, self.inexact[beside_law], tells, freedom, excess)
            by_share[beside_law] = of_inexact
        return by_share

    def _log_likelihood_of_shares(
        self, indices: npt.NDArray[np.int64], power: Array, tells: float, freedom: float, excess: float
    ) -> Array:
        """(n, SHARES) Log-likelihood of all blocks' powers if each of n hypotheses, with these indices (n,), leaves
        each of SHARES of `power` (n, blocks)."""
        own_misfit = self._own_misfit_of[indices, None]
        return np.stack(
            [
                self.log_likelihood(self.power[indices], share * power, excess, own_misfit, tells, freedom)
                for share in SHARES
            ],
            axis=1,
        )

    def log_likelihood_of_any_gap(self, tells: float, freedom: float, excess: float) -> float:
        """Log-likelihood of the gap itself, the powers that the hypothesis without effects leaves, if its cause is
        unknown and no effect closes it by imitating that cause. An unknown share of the blocks holds a misfit of
        unknown mean power, 1 to exp(WIDEST) times the noise of one of the `tells` numbers that a block tells, floor^2 /
        tells; it is the mean over a grid of both. tells, freedom, excess, and the constant: as of `log_likelihood`."""
        misfits = self.floor2 / tells * np.exp(_GAPS)[:, None]
        by_share = [
            self.log_likelihood(self.power[0], misfits, excess, self.own_misfit, tells, freedom, share)
            for share in _WRONG_SHARES
        ]
        return float(log_sum(np.ravel(by_share)) - np.log(np.size(by_share)))

    def _confined_log_ratio(self, floor_known: float, floor_steady: float, disturbed: float) -> Array:
        """(hypotheses,) Log-likelihood ratio, right to wrong effects, of the power that is left beyond the effects'
        stages (confined.py); 0 where that is not known. Beside right effects all but a share `disturbed` of the blocks
        is noise; beside wrong ones any share may be more than noise, or with probability CONFINED it is as beside right
        ones. floor_known, floor_steady: standard deviations of the log of the noise's power, between cases and between
        the blocks of one."""
        if not len(self._beyond_power):
            return np.zeros(len(self._beyond_row))
        by_share = self._log_likelihood_of_disturbed(floor_known, floor_steady, np.array([disturbed, *_WRONG_SHARES]))
        right, wrong = by_share[0], log_sum(by_share[1:].T) - np.log(len(_WRONG_SHARES))
        ratio = right - np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + wrong)
        return np.append(ratio, 0.0)[self._beyond_row]

    def _log_likelihood_of_disturbed(self, floor_known: float, floor_steady: float, shares: Array) -> Array:
        """(shares, rows) Log-likelihood of the powers beyond the effects' stages if each block is, with the probability
        s of `shares`, noise with a disturbance on top of it, and else noise: the product over blocks of (1 - s) noise +
        s disturbed, integrated over the error of the floor. The log x of a disturbed block's power over the noise has a
        density proportional to 1 / (x + its spread) from 0 to WIDEST. Further parameters as of
        `_confined_log_ratio`."""
        x = np.log(np.maximum(self._beyond_power / self.floor2, 1e-6))[:, None]  # (rows, 1, blocks)
        spread = np.sqrt(2.0 / np.maximum(self._beyond_count, 1.0) + floor_steady**2 + self._unsteady**2)[:, None]
        floor_known = float(np.hypot(floor_known, self._doubt))
        # Log prior of the error of the log noise power: normal above the floor, exponential below it, as the floor is
        # estimated at rest, where the marker may well scatter more.
        error = _FLOOR_ERRORS * floor_known
        prior = np.where(error > 0.0, -0.5 * np.square(error / floor_known), -np.abs(error))
        above_noise = x - error[:, None]  # (rows, errors, blocks)
        noise = _student_log_density(above_noise / spread) - np.log(spread)
        # What disturbs a block comes on top of its noise, which has to be low where the block is.
        noise_is_lower = np.log(stdtr(_DEGREES, above_noise / spread))
        disturbed = noise_is_lower - np.log((np.maximum(above_noise, 0.0) + spread) * np.log1p(WIDEST / spread))
        # (1 - s) noise + s disturbed = noise (1 + s relative). Products of a few blocks save logarithms.
        relative = np.exp(disturbed - noise) - 1.0
        share = shares[:, None, None]
        mixed = np.zeros((len(shares), *noise.shape[:2]))  # sum over blocks of log(1 + share relative)
        for first in range(0, noise.shape[2], _AT_ONCE):
            product = np.ones_like(mixed)
            for block in range(first, min(first + _AT_ONCE, noise.shape[2])):
                product *= 1.0 + share * relative[:, :, block]
            mixed += np.log(product)
        return log_sum(prior + np.sum(noise, axis=2) + mixed) - log_sum(prior)
