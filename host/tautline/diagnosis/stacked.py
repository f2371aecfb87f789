"""A case's evidence as arrays over its hypotheses, and what of their weighing only a few hyperparameters change: who
weighs one case by many hyperparameters pays for it once for each of those few."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln, stdtr

from tautline.diagnosis.hypotheses import CaseEvidence
from tautline.effects import BY_ID, EVENTS, LIBRARY

Array = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

CONSTANT = frozenset(kind.id for kind in LIBRARY if kind.nominal)  # parts of the nominal model
LAWS = frozenset(kind.id for kind in LIBRARY if kind.law)
GEOMETRY = frozenset(kind.id for kind in LIBRARY if not kind.material and kind.transform is None)
MEASURED = frozenset(kind.id for kind in LIBRARY if kind.needs == "load")  # effects that follow a measured column
BROUGHT = {kind.id: frozenset(kind.brings) for kind in LIBRARY if kind.brings}
INEXACT = 4.0  # prior: times the floor's power that a nominal model may leave of its own calibration
CONFINED = 0.5  # prior: probability that what a wrong effect leaves is confined to its stage as well
FOLLOWED = 0.02  # prior: share of a power above the floor: what leaves less of unseen blocks has followed a path
SHARES = np.geomspace(1e-5, 1.0, 41)
WANDERS = np.geomspace(3e-3, 3.0, 31)  # prior: shares by which an amplitude may be another elsewhere
_A_GAP = 2.0  # times the floor's power: no noise
_DEGREES = 8.0  # prior: of freedom, of a block's noise
_WRONG_SHARES = (np.arange(10) + 0.5) / 10.0  # prior: of blocks that a wrong effect disturbs
_WIDEST = 12.0  # prior: of a disturbed block's logarithm
_AT_ONCE = 8  # tolerance: blocks whose product stays within a double
_REMEMBERED = 4  # tolerance: settings of a few hyperparameters


def log_sum(logarithms: Array) -> Array:
    """log(sum(exp(x))) along the last axis, without overflow."""
    most = np.max(logarithms, axis=-1)
    return np.asarray(most + np.log(np.sum(np.exp(logarithms - most[..., None]), axis=-1)))


def _student_log_density(x: Array) -> Array:
    """Log-density of Student's t with _DEGREES degrees of freedom."""
    n = _DEGREES
    constant = gammaln(0.5 * (n + 1.0)) - gammaln(0.5 * n) - 0.5 * np.log(n * np.pi)
    return np.asarray(constant - 0.5 * (n + 1.0) * np.log1p(np.square(x) / n))


def _wander_log_ratio(matrix: Array, gradient: Array) -> Array:
    """(WANDERS,) Log-likelihood ratio of an amplitude whose m factors have prior variances that sum to WANDERS^2,
    against a constant amplitude. matrix, gradient: the factors' normal equations over the noise's power."""
    tells, ways = np.linalg.eigh(matrix / len(gradient))
    squares, tells = np.square(ways.T @ gradient) / len(gradient), np.maximum(tells, 0.0)
    variance = np.square(WANDERS)[:, None]
    wider = 1.0 + variance * tells
    return np.asarray(0.5 * np.sum(variance * squares / wider - np.log(wider), axis=1))


def brought(ids: Collection[str]) -> frozenset[str]:
    """The parts of the nominal model among these that another of them brings with it."""
    return frozenset().union(*(BROUGHT.get(name, frozenset()) for name in ids)) & set(ids)


def _contains_and_replaces(key: frozenset[str], one: frozenset[str]) -> bool:
    """Whether the effects `key` can do what the single effect `one` does, as one of them contains it. Events do not
    count: one would be seen beside `one` too."""
    key = key - EVENTS
    if len(one) != 1 or key == one or not any(one <= {*BY_ID[name].contains} for name in key):
        return False
    return len(key) == 1 or (not one <= CONSTANT and key - one <= CONSTANT)


class Stacked:
    """Rows are hypotheses, columns blocks; powers are mean squares."""

    def __init__(self, evidence: CaseEvidence) -> None:
        """Arrays over the hypotheses: power and scatter by block, which effects each holds, which sets contain
        which."""
        hypotheses = evidence.hypotheses
        self.floor2 = evidence.floor**2
        self._doubt, self._unsteady = evidence.doubt, evidence.unsteady
        self.frozen = evidence.frozen
        self.applicable = evidence.applicable
        self.nominal2 = float(np.clip(evidence.calibrated, self.floor2, INEXACT * self.floor2))
        self.ids = [h.ids for h in hypotheses]
        self.sets = [frozenset(h.ids) for h in hypotheses]
        self.same: dict[frozenset[str], list[int]] = {}  # of the same effects
        for i, key in enumerate(self.sets):
            self.same.setdefault(key, []).append(i)
        self.leaders = {key: key - brought(key) for key in self.same}  # what may lead a set
        self.power = np.array([h.power for h in hypotheses])
        self.before = np.maximum(self.power[0] - self.floor2, 0.0)
        self.mean = np.mean(self.power, axis=1)
        scatter, rival = np.array([h.scatter for h in hypotheses]), np.array([h.rival for h in hypotheses])
        self.scatters: Flags = np.asarray(scatter.any(axis=1))
        # What a path follows on blocks that its fit did not see is no scatter, of whatever origin; nor is noise.
        of_paths = np.where(self.scatters, np.inf, self.mean)
        followed = np.min(of_paths, initial=np.inf)
        least = np.minimum(self.power, self.floor2)
        scattered = np.maximum(self.power * np.exp(np.minimum(scatter, rival)), least)
        # Frames foretell the next ones of any smooth misfit, the better the faster the sensor: a path that leaves more
        # than they do, but next to nothing of what is there without it, is one all the same, and the rest its misfit.
        misfit = followed - self.floor2 < FOLLOWED * (self.mean - self.floor2)
        self.path: Flags = self.scatters & ((followed < np.mean(scattered, axis=1)) | misfit)
        # An event has no path that repeats: what one follows so closely, and is no noise, is none.
        self.repeats: Flags = self.scatters & misfit & (self.mean > _A_GAP * self.floor2)
        rest = np.maximum(self.power[int(np.argmin(of_paths))], self.floor2)
        self._least = np.where(misfit[:, None], rest, self.floor2)
        self.scatter, self.rival = self._event_log_factor(scatter), self._event_log_factor(rival)
        self.forgets = np.where(self.path, 0.0, np.square([h.white for h in hypotheses]))
        self.parameters = np.array([h.parameters for h in hypotheses], dtype=float)
        self.chance = np.array([h.chance for h in hypotheses])

        self.size = np.array([len(key) for key in self.sets])
        self.law: Flags = np.array([key <= LAWS for key in self.sets])
        self.constant = np.array([bool(key) and key <= CONSTANT for key in self.sets])
        self.measured = np.array([bool(key & MEASURED) for key in self.sets])
        own = [self.leaders[key] & CONSTANT for key in self.sets]
        # Parts of the nominal model move together; what brings one with it is one cause.
        self.causes = np.array([len(key - CONSTANT) + bool(mine) for key, mine in zip(self.sets, own, strict=True)])
        self.brings = np.array([mine != key & CONSTANT for key, mine in zip(self.sets, own, strict=True)])
        self.does_as_well = np.array([[_contains_and_replaces(k, m) for m in self.sets] for k in self.sets])
        self.left = np.sum(self.power * np.exp(scatter) - self.floor2, axis=1)
        pairs = [
            (i, j)
            for i, less in enumerate(self.sets)
            for j, more in enumerate(self.sets)
            if less and len(more) == len(less) + 1 and less < more
        ]
        self.fewer, self.further = np.array(pairs, dtype=int).reshape(-1, 2).T

        told = [(i, _wander_log_ratio(of.matrix, of.gradient)) for i, h in enumerate(hypotheses) for of in h.wanders]
        self.each: Flags = np.array([h.each for h in hypotheses])
        self.wandering = np.array([i for i, _ in told], dtype=int)  # of each row of `wander` its hypothesis
        self.wander = np.array([of for _, of in told]).reshape(-1, len(WANDERS))
        self.geometry: Flags = np.array([of.id in GEOMETRY for h in hypotheses for of in h.wanders], dtype=bool)
        self._beyond: list[int] = []  # of each hypothesis the row of what is left beyond its stages; none: -1
        rows: dict[bytes, int] = {}  # hypotheses of one stage leave the same
        power, count = [], []
        for h in hypotheses:
            if h.beyond is None:
                self._beyond.append(-1)
                continue
            key_of = h.beyond.power.tobytes()
            if key_of not in rows:
                rows[key_of] = len(rows)
                power.append(h.beyond.power)
                count.append(h.beyond.count)
            self._beyond.append(rows[key_of])
        self._beyond_power, self._beyond_count = np.array(power), np.array(count)
        self.by_share = lru_cache(_REMEMBERED)(self._log_likelihood_by_share)
        self.confined = lru_cache(_REMEMBERED)(self._confined_log_ratio)

    def _event_log_factor(self, scatter: Array) -> Array:
        """(hypotheses,) By how much an event lowers the power of all blocks, sums of logarithms. Not counted is what
        the hypothesis' own path had added before; where the path follows the event, no more than down to the least
        power that any path leaves, or the noise."""
        put_on = np.maximum(np.log(self.power / self.power[0]), 0.0)
        off = scatter + np.minimum(put_on, np.maximum(-scatter, 0.0))
        above = np.maximum(np.log(self.power / self._least), 0.0)
        return np.asarray(np.sum(np.where(self.path[:, None], np.maximum(off, -above), off), axis=1))

    def tells(self, misfit_tells: float, noise_tells: float) -> Array:
        """(blocks,) How many independent observations each block counts as: a few for a systematic misfit, more the
        closer its power is to the noise."""
        return np.asarray(misfit_tells + noise_tells * np.square(self.floor2 / (self.floor2 + self.before)))

    def _log_likelihood_by_share(
        self, misfit_tells: float, noise_tells: float, block_freedom: float, calibration_excess: float
    ) -> Array:
        """(hypotheses, SHARES) Log-likelihood of all blocks' powers, if the hypothesis leaves that share of the gap's
        power."""
        n = self.tells(misfit_tells, noise_tells)
        alone = (1.0 + calibration_excess) * self.floor2 + SHARES[:, None] * self.before
        seen = self.power[:, None, :]
        predicted, once = self.with_own(alone, seen, misfit_tells, noise_tells)
        unlike = np.log1p(n / block_freedom * seen / predicted) @ (block_freedom + n)
        return np.asarray(once - 0.5 * (np.log(predicted) @ n + unlike))

    def with_own(self, alone: Array, seen: Array, misfit_tells: float, noise_tells: float) -> tuple[Array, Array]:
        """The predicted powers (..., blocks) with the nominal model's own misfit added where a block shows more
        (`seen`) than a hypothesis predicts (`alone`), up to what the calibration leaves of its own recording; and a
        correction (...,) of the log-likelihood, as this one misfit is common to all blocks but counted in each: log|I +
        J J'| in place of its diagonal's, J the misfit's columns, of which n of all blocks tell each n / k times."""
        n = self.tells(misfit_tells, noise_tells)
        predicted = alone + np.clip(seen - alone, 0.0, self.nominal2 - self.floor2)
        more = predicted / alone - 1.0
        numbers = min(misfit_tells + noise_tells, float(np.sum(n)))
        once = 0.5 * (np.log1p(more) @ n - numbers * np.log1p(more @ n / numbers))
        return predicted, np.asarray(once)

    def _confined_log_ratio(self, floor_known: float, floor_steady: float, disturbed: float) -> Array:
        """(hypotheses,) Log-likelihood ratio of what is left beyond the effects' stages (confined.py): noise in all but
        a share `disturbed` of the blocks, as beside right effects, against more than noise in any share of the blocks,
        as beside wrong ones. floor_known: standard deviation of the log noise power's error; floor_steady: between
        blocks."""
        if not len(self._beyond_power):
            return np.zeros(len(self._beyond))
        x = np.log(np.maximum(self._beyond_power / self.floor2, 1e-6))[:, None]
        spread = np.sqrt(2.0 / np.maximum(self._beyond_count, 1.0) + floor_steady**2 + self._unsteady**2)[:, None]
        floor_known = float(np.hypot(floor_known, self._doubt))
        # Of the case's noise: less than the floor often, as what rests may well scatter more.
        off = np.linspace(-20.0, 3.0, 116) * floor_known
        prior = np.where(off > 0.0, -0.5 * np.square(off / floor_known), -np.abs(off))
        away = x - off[:, None]
        noise = _student_log_density(away / spread) - np.log(spread)
        # What disturbs a block comes on top of its noise, which has to be low where the block is.
        low = np.log(stdtr(_DEGREES, away / spread))
        any_size = low - np.log((np.maximum(away, 0.0) + spread) * np.log1p(_WIDEST / spread))
        more = np.exp(any_size - noise) - 1.0
        shares = np.array([disturbed, *_WRONG_SHARES])[:, None, None]
        mixed = np.zeros((len(shares), *noise.shape[:2]))
        for at in range(0, noise.shape[2], _AT_ONCE):
            product = np.ones_like(mixed)
            for block in range(at, min(at + _AT_ONCE, noise.shape[2])):
                product *= 1.0 + shares * more[:, :, block]
            mixed += np.log(product)
        said = log_sum(prior + np.sum(noise, axis=2) + mixed) - log_sum(prior)
        right, wrong = said[0], log_sum(said[1:].T) - np.log(len(_WRONG_SHARES))
        ratio = right - np.logaddexp(np.log(CONFINED) + right, np.log1p(-CONFINED) + wrong)
        return np.append(ratio, 0.0)[self._beyond]
